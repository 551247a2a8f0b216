"""How far tables err against how large they are, and how large the library is that they are made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from frogkick.library import Library, error_on, fit_table, quantise, sample_library
from frogkick.library.fitting import require_enough
from frogkick.tables.image import open_image

KIB = 1024
NEAREST_STATES = (100, 300, 1000, 3000)
"""States of nearest tables, besides the whole library: the first ones of it, as fewer would be drawn."""

AFFINE_KIB = (4, 8, 16, 32, 64, 128)
LIBRARY_STATES = (60, 125, 250, 500, 1000, 2000, 4000)
"""States of a library that an affine table of 64 KiB is fitted to, besides the whole one."""

_AFFINE_KIB = 64

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class TablePoint:
    """One table.

    Attributes:
        kind: "nearest" or "affine".
        library_states: of the library, or the part of it, that it was made of.
        bytes: of the image.
        states: in the image.
        box: its error on unseen states of the robot's library box, see ``frogkick.library.error_on``.
        visited: its error on unseen states of swims.
    """

    kind: str
    library_states: int
    bytes: int
    states: int
    box: dict[str, float]
    visited: dict[str, float]


@dataclass(frozen=True)
class TableSizes:
    """Tables by their size, and affine ones of one size by the library's size."""

    by_size: tuple[TablePoint, ...]
    by_library: tuple[TablePoint, ...]


def first_states(library: Library, count: int) -> Library:
    """The library that a smaller ``--states`` would have given: its first states."""
    return replace(
        library,
        initial_velocity_body=library.initial_velocity_body[:count],
        displacement_body=library.displacement_body[:count],
        velocity_body_end=library.velocity_body_end[:count],
        previous_actions=library.previous_actions[:count],
        failed=tuple(failure for failure in library.failed if failure.state < count),
    )


def table_sizes(
    library: Library,
    test_states: int,
    seed: int,
    progress: Progress = lambda _done, _all: None,
    swims: str = "planned",
) -> TableSizes:
    """Make tables of several sizes from a library and measure each on states that none has seen.

    Args:
        library: as large as there is.
        test_states: unseen states of each sampling, box and swims.
        seed: of their sampling, not the library's.
        progress: called with tables made and to make.
        swims: "planned" or "visited", see ``sample_starts``.

    Raises:
        InputError: the library has too few states for an affine table.
        ConvergenceError: an unseen state cannot be simulated.
    """
    require_enough(library)
    robot = library.robot()
    whole = len(library.initial_velocity_body)
    nearest = [*(states for states in NEAREST_STATES if states < whole), whole]
    libraries = [*(states for states in LIBRARY_STATES if states < whole), whole]
    done, to_do = 0, len(nearest) + len(AFFINE_KIB) + len(libraries) + 2
    progress(done, to_do)
    box = sample_library(robot, test_states, seed, "box")
    progress(done := done + 1, to_do)
    visited = sample_library(robot, test_states, seed, swims)
    progress(done := done + 1, to_do)

    def point(image: bytes, library_states: int) -> TablePoint:
        nonlocal done
        tables = open_image(image)
        progress(done := done + 1, to_do)
        return TablePoint(
            tables.kind,
            library_states,
            len(image),
            len(tables.states),
            error_on(tables, box),
            error_on(tables, visited),
        )

    by_size = [point(quantise(first_states(library, states)), states) for states in nearest]
    by_size += [point(fit_table(library, "affine", kib * KIB).image, whole) for kib in AFFINE_KIB]
    by_library = [
        point(fit_table(first_states(library, states), "affine", _AFFINE_KIB * KIB).image, states)
        for states in libraries
    ]
    return TableSizes(tuple(by_size), tuple(by_library))


def least_bytes_as_good(sizes: TableSizes) -> int | None:
    """Bytes of the smallest affine table no worse than the largest nearest one, in position and heading."""
    best = max((p for p in sizes.by_size if p.kind == "nearest"), key=lambda p: p.states)
    good = [
        p.bytes
        for p in sizes.by_size
        if p.kind == "affine" and all(p.box[name] <= best.box[name] for name in ("position_m", "heading_rad"))
    ]
    return min(good, default=None)


def over_full_nearest(sizes: TableSizes) -> dict[str, dict[str, float]]:
    """Errors of the largest affine table of at most 64 KiB as parts of those of the largest nearest one.

    Returns:
        For states of the "box" and "visited" ones the ratio of each error; nothing without such a table.
    """
    full = max((p for p in sizes.by_size if p.kind == "nearest"), key=lambda p: p.states)
    small = [p for p in sizes.by_size if p.kind == "affine" and p.bytes <= _AFFINE_KIB * KIB]
    if not small:
        return {}
    best = max(small, key=lambda p: p.bytes)
    return {
        tested: {name: getattr(best, tested)[name] / error for name, error in getattr(full, tested).items()}
        for tested in ("box", "visited")
    }


def slope(points: tuple[TablePoint, ...], name: str) -> float:
    """Exponent of an error's fall with bytes, by least squares of the logarithms."""
    logs = np.log([[p.bytes, p.box[name]] for p in points])
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])
