"""Error of tables against their size, and against the size of their library."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.core.progress import shown
from frogkick.library import Library, error_on, fit_table, quantise, read_library, sample_library
from frogkick.library.fitting import require_enough
from frogkick.report import style
from frogkick.tables.image import open_image
from frogkick_studies import StudyResult
from frogkick_studies.configs import Tables

KIB = 1024
NEAREST_STATES = (100, 300, 1000, 3000)
"""Number of states of nearest tables, besides the whole library: its first states."""

AFFINE_KIB = (4, 8, 16, 32, 64, 128)
LIBRARY_STATES = (60, 125, 250, 500, 1000, 2000, 4000)
"""Number of states of a library for an affine table of 64 KiB, besides the whole one."""

_AFFINE_KIB = 64

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class TablePoint:
    """One table.

    Attributes:
        library_states: number of states of the library, or of its part.
        bytes: size of the image.
        states: number of states in the image.
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
class TableSizes(StudyResult):
    """Tables by their size, and affine ones of 64 KiB by their library's size; the unseen states' seed."""

    by_size: tuple[TablePoint, ...]
    by_library: tuple[TablePoint, ...]
    seed: int = 0

    def plot(self) -> Figure:
        """Draw two errors against bytes, and the position error against library states."""
        with style.new_figure(11.0, 4.4) as figure:
            panels = figure.subplots(1, 3)
            for axes, name in zip(panels, _UNIT, strict=False):
                for kind in _COLOUR:
                    points = [p for p in self.by_size if p.kind == kind]
                    _curve(axes, points, [p.bytes / KIB for p in points], name)
                axes.axvline(64, color=style.DESIRED, linewidth=0.8, linestyle=":")
                axes.text(
                    66, 0.99, "64 KiB", color=style.DESIRED, va="top", fontsize=7.5,
                    transform=axes.get_xaxis_transform(),
                )  # fmt: skip
                axes.set_xlabel("table image (KiB)")
                _finish(axes, name)
            panels[0].set_title("Error one period ahead, by table size")
            panels[1].set_title("The same for the heading")
            nearest = [p for p in self.by_size if p.kind == "nearest"]
            for points in (nearest, list(self.by_library)):
                _curve(panels[2], points, [p.library_states for p in points], "position_m")
            panels[2].set_xlabel("states of the library (each times all actions)")
            panels[2].set_title("By library size (affine: 64 KiB)")
            _finish(panels[2], "position_m")
            style.legend_below(figure, panels[0], 4)
        return figure

    def as_json(self) -> dict[str, Any]:
        affine = tuple(point for point in self.by_size if point.kind == "affine")
        return {
            "by_size": [dataclasses.asdict(point) for point in self.by_size],
            "by_library": [dataclasses.asdict(point) for point in self.by_library],
            "affine_bytes_as_good_as_nearest": least_bytes_as_good(self),
            "affine_64_kib_over_full_nearest": over_full_nearest(self),
            "affine_exponent": {
                name: round(slope(affine, name), 3) for name in ("position_m", "heading_rad")
            },
            "seed": self.seed,
        }


def table_sizes(
    library: Library,
    test_states: int,
    seed: int,
    progress: Progress = lambda _done, _all: None,
    swims: str = "planned",
) -> TableSizes:
    """Make tables of several sizes from a library, and measure each on unseen states.

    Args:
        seed: seed of their sampling, not that of the library.
        swims: "planned" or "visited", see ``sample_starts``.
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

    by_size = [point(quantise(library.part(np.arange(states))), states) for states in nearest]
    by_size += [point(fit_table(library, "affine", kib * KIB).image, whole) for kib in AFFINE_KIB]
    by_library = [
        point(fit_table(library.part(np.arange(states)), "affine", _AFFINE_KIB * KIB).image, states)
        for states in libraries
    ]
    return TableSizes(tuple(by_size), tuple(by_library), seed)


def least_bytes_as_good(sizes: TableSizes) -> int | None:
    """Return the size of the smallest affine table no worse than the largest nearest one; None without
    any."""
    best = max((p for p in sizes.by_size if p.kind == "nearest"), key=lambda p: p.states)
    good = [
        p.bytes
        for p in sizes.by_size
        if p.kind == "affine" and all(p.box[name] <= best.box[name] for name in ("position_m", "heading_rad"))
    ]
    return min(good, default=None)


def over_full_nearest(sizes: TableSizes) -> dict[str, dict[str, float]]:
    """Return errors of the largest affine table of at most 64 KiB over those of the largest nearest one.

    Returns:
        For "box" and "visited" states the ratio of each error; empty without such a table.
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
    """Return the exponent of an error over the size, by least squares of the logarithms."""
    logs = np.log([[p.bytes, p.box[name]] for p in points])
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])


def run(config: Tables) -> TableSizes:
    content = read_library(config.library)
    with shown(True, "tables") as tell:
        return table_sizes(content, config.test_states, config.seed, tell, config.swims)


_COLOUR = {"nearest": style.MEASURED, "affine": style.TRUE}
_MARKER = {"nearest": "o", "affine": "s"}
_NOISE = {"position_m": (0.2e-3, "0.2 mm"), "heading_rad": (np.deg2rad(0.2), "0.2°")}
_UNIT = {
    "position_m": (1e3, "position error (mm)"),
    "heading_rad": (180.0 / np.pi, "heading error (degrees)"),
}


def _curve(axes: Axes, points: Sequence[TablePoint], along: Sequence[float], name: str) -> None:
    factor = _UNIT[name][0]
    for tested, line, fill in (("box", "-", "full"), ("visited", "--", "none")):
        kind = points[0].kind
        axes.loglog(
            along,
            [factor * getattr(p, tested)[name] for p in points],
            _MARKER[kind] + line,
            color=_COLOUR[kind],
            fillstyle=fill,
            markersize=4.5,
            linewidth=1.2,
            label=f"{kind}, unseen states {'of the box' if tested == 'box' else 'of swims'}",
        )


def _finish(axes: Axes, name: str) -> None:
    factor, label = _UNIT[name]
    noise, text = _NOISE[name]
    axes.axhline(factor * noise, color=style.ALARM, linewidth=1)
    axes.text(
        0.99, factor * noise * 1.06, f"measurement's noise, {text}", color=style.ALARM, ha="right",
        va="bottom", fontsize=7.5, transform=axes.get_yaxis_transform(),
    )  # fmt: skip
    axes.set_ylabel(label)
    style.plain_decades(axes.yaxis)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
