"""The table of least error within a budget of bytes, of one kind or of any."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError, nearest_name
from frogkick.core.poses import wrap_angle
from frogkick.library.error import looked_up, rms_gap
from frogkick.library.quantise import quantise, table_metadata
from frogkick.library.store import Library
from frogkick.library.surface import STATES_MIN, Surface, fit_surface, noise_of
from frogkick.library.transitions import IntArray
from frogkick.library.voronoi import VoronoiCells, VoronoiRegression
from frogkick.tables.image import open_image
from frogkick.tables.packing import pack_affine, pack_nearest
from frogkick.tables.sealing import ERROR_MAX

FloatArray = NDArray[np.float64]

KINDS = ("nearest", "affine")
BUDGET_BYTES = 64 * 1024
"""Of an affine table, unless another one is given."""

_HELD_OUT_EVERY = 8  # states that no fit has seen, to choose by
_COARSENESS = {  # of stored values, tried one after another
    "nearest": (1.0, 4.0, 8.0, 16.0),
    "affine": (0.125, 0.1875, 0.25, 0.375, 0.5, 1.0),
}
_ROW_BYTES = {"nearest": 20, "affine": 160}  # about the least
WHOLE_MIN = next(n for n in range(STATES_MIN, 2 * STATES_MIN) if n - n // _HELD_OUT_EVERY >= STATES_MIN)
"""Whole states of a library that states and corrections can be fitted to."""

_SAMPLES_A_CELL = 64
_SAMPLES = (8192, 131072)
_TRIES = 12
_MARGIN = 1.25  # beyond the furthest sample a correction goes on so far
_NEIGHBOURS = 8  # one of which a sample lies towards


@dataclass(frozen=True, eq=False)
class Fitted:
    """A table fitted to a library.

    Attributes:
        image: of it.
        kind: "nearest" or "affine".
        held_out: its error on states of the library that it was not fitted to, as ``table_error`` gives it.
        score: of that: root mean square of the errors in units of the position measurement's noise.
    """

    image: bytes
    kind: str
    held_out: dict[str, float]
    score: float


Progress = Callable[[int, int], None]


def fit_table(
    library: Library,
    kind: str | None = None,
    budget_bytes: int | None = None,
    progress: Progress = lambda _done, _all: None,
) -> Fitted:
    """The table with the least error on held-out states of a library.

    A table of kind "nearest" within whose budget the whole library fits has every state of it, as in the
    paper. Otherwise states are chosen where the error is (see frogkick.library.voronoi), and how coarsely
    values are rounded is chosen against how many states that leaves room for.

    Args:
        library: at least WHOLE_MIN whole states; any number for a whole "nearest" table.
        kind: "nearest", "affine", or None for the better one.
        budget_bytes: most bytes of the image; None: as many as it takes for "nearest", 64 KiB for "affine".
        progress: called with tables tried and to try.

    Returns:
        The table. The same library gives the same bytes on the same machine.

    Raises:
        InputError: an unknown kind, too few states, or a budget that holds no state.
    """
    if kind is not None and kind not in KINDS:
        raise InputError(f"kind is {kind!r}{nearest_name(kind, KINDS)}: give {' or '.join(KINDS)}")
    asked = KINDS if kind is None else (kind,)
    fit = _Fit(library)
    tries = [(each, coarseness) for each in asked for coarseness in _COARSENESS[each]]
    best: Fitted | None = None
    refused: InputError | None = None
    for tried, (each, coarseness) in enumerate(tries):
        progress(tried, len(tries))
        try:
            found = fit.table(each, coarseness, budget_bytes)
        except InputError as error:  # a budget may hold a state of the other kind, or more coarsely
            refused = error
            continue
        if best is None or found.score < best.score:
            best = found
    progress(len(tries), len(tries))
    if best is None:
        raise refused or InputError(f"kind {kind!r} has no table")
    return best


def require_enough(library: Library) -> None:
    """Refuse a library that no table can be fitted to, before anything is done with it.

    Raises:
        InputError: too few whole states.
    """
    whole = int(library.whole_states().sum())
    if whole < WHOLE_MIN:
        raise InputError(
            f"the library has {whole} whole states, to fit a table takes {WHOLE_MIN}: build it with more "
            "--states"
        )


class _Fit:
    """What all tables of one library share."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self._robot = library.robot()
        self._about = table_metadata(self._robot, library.content_sha256())
        self._whole = np.flatnonzero(library.whole_states())
        self._held = self._whole[_HELD_OUT_EVERY - 1 :: _HELD_OUT_EVERY]
        self._regressions: dict[tuple[str, int], VoronoiRegression] = {}

    @cached_property
    def _seen(self) -> IntArray:
        return np.setdiff1d(self._whole, self._held)

    @cached_property
    def _surface(self) -> Surface:
        library, seen = self._library, self._seen
        require_enough(library)
        return fit_surface(
            self._robot,
            library.initial_velocity_body[seen],
            library.rows()[seen],
            library.previous_actions[seen],
        )

    @cached_property
    def _whole_table(self) -> Fitted:
        """Every state as it is; scored by a table of those that are not held out."""
        image = quantise(self._library)
        if not len(self._held):
            return Fitted(image, "nearest", {}, math.inf)
        library, seen = self._library, self._seen
        part = replace(
            library,
            initial_velocity_body=library.initial_velocity_body[seen],
            displacement_body=library.displacement_body[seen],
            velocity_body_end=library.velocity_body_end[seen],
            previous_actions=library.previous_actions[seen],
            failed=(),
        )
        return replace(self._scored("nearest", quantise(part)), image=image)

    def table(self, kind: str, coarseness: float, budget_bytes: int | None) -> Fitted:
        """The table of a kind with as many states as fit, values rounded so many times more coarsely."""
        if kind == "nearest" and (budget_bytes is None or len(self._whole_table.image) <= budget_bytes):
            return self._whole_table
        budget = BUDGET_BYTES if budget_bytes is None else budget_bytes
        regression = self._regression(kind, budget)

        def packed(states: int) -> bytes:
            return self._packed(kind, regression.cells(states), coarseness)

        return self._scored(kind, _fill(packed, budget, len(self._whole), _ROW_BYTES[kind]))

    def _regression(self, kind: str, budget: int) -> VoronoiRegression:
        """Samples between the library's states, as dense as these are, for as many cells as may be needed."""
        wanted = _SAMPLES_A_CELL * min(budget // _ROW_BYTES[kind], len(self._whole))
        count = min(max(wanted, _SAMPLES[0]), _SAMPLES[1])
        if (kind, count) not in self._regressions:
            codes = _between(self._surface.codes, count)
            values = self._surface.at(codes).reshape(count, -1)
            weight = np.tile(noise_of(self._robot), len(self._robot.actions))
            self._regressions[kind, count] = VoronoiRegression(codes, values, weight, linear=kind == "affine")
        return self._regressions[kind, count]

    def _packed(self, kind: str, cells: VoronoiCells, coarseness: float) -> bytes:
        resolution = np.array(self._robot.velocity_resolution)
        error_max = [coarseness * error for error in ERROR_MAX]
        base = cells.base.reshape(len(cells.codes), -1, 6)
        if kind == "nearest":
            return pack_nearest(
                self._about,
                velocities=cells.codes * resolution,
                displacements=base[..., :3],
                velocities_end=base[..., 3:],
                error_max=error_max,
            )
        slope = cells.slope / resolution[:, None]
        history = self._surface.history
        return pack_affine(
            self._about,
            velocities=cells.codes * resolution,
            base=base,
            jacobian=np.moveaxis(slope, 1, 2).reshape(*base.shape, 3),
            history=history.effect,
            use_decay=history.decay,
            use_gain=history.gain,
            offset_limit=_MARGIN * cells.reach * resolution,
            velocity_box=self._library.initial_velocity_body[self._whole],
            error_max=error_max,
        )

    def _scored(self, kind: str, image: bytes) -> Fitted:
        library, held = self._library, self._held
        found = looked_up(
            open_image(image), library.initial_velocity_body[held], library.previous_actions[held]
        )
        gap = found - library.rows()[held]
        gap[..., 2] = wrap_angle(gap[..., 2])
        score = float(np.sqrt(np.mean((gap / noise_of(self._robot)) ** 2)))
        return Fitted(image, kind, rms_gap(gap), score)


def _between(codes: FloatArray, count: int) -> FloatArray:
    """(count, 3) points between states and one of their nearest neighbours each."""
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    neighbours = min(_NEIGHBOURS, len(codes) - 1)
    near = cKDTree(codes).query(codes, neighbours + 1)[1]
    first = np.arange(count) % len(codes)
    second = near[first, rng.integers(1, neighbours + 1, count)]
    return np.asarray(codes[first] + rng.uniform(0.0, 1.0, (count, 1)) * (codes[second] - codes[first]))


def _fill(packed: Callable[[int], bytes], budget: int, states_max: int, row_bytes: float) -> bytes:
    """The image with most states within a budget.

    Args:
        packed: makes the image with so many states, more states more bytes.
        budget: bytes.
        states_max: at most.
        row_bytes: a first guess of what a state takes.

    Raises:
        InputError: one state is too many.
    """
    image = packed(1)
    if len(image) > budget:
        raise InputError(
            f"a budget of {budget} bytes holds no table of this kind, the smallest takes {len(image)}: give "
            f"--budget-kib {math.ceil(len(image) / 102.4) / 10:g} or more"
        )
    fits, too_many = 1, states_max + 1
    for _ in range(_TRIES):
        if too_many - fits <= 1 or budget - len(image) < row_bytes:
            break
        states = min(fits + max(1, int((budget - len(image)) / row_bytes)), too_many - 1)
        larger = packed(states)
        row_bytes = max((len(larger) - len(image)) / (states - fits), 1.0)
        if len(larger) <= budget:
            fits, image = states, larger
        else:
            too_many = states
    return image
