"""Fits a table to a library: the least error within a budget of bytes; also a robot's default table."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.core.compiled import cached_njit, stamp_of
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.poses import wrap_angle
from frogkick.core.progress import Tell
from frogkick.library.build import Progress, build_library
from frogkick.library.store import Library, quantise, table_metadata
from frogkick.library.surface import STATES_MIN, Surface, fit_surface, noise_of
from frogkick.library.voronoi import VoronoiCells, VoronoiRegression
from frogkick.planner.lookup import DYNAMICS, arrays_of, dynamics_after, find_row, motion_of, velocity_code
from frogkick.robot import Robot
from frogkick.tables.image import Tables, open_image
from frogkick.tables.packing import pack_affine, pack_nearest
from frogkick.tables.sealing import ERROR_MAX

KINDS = ("nearest", "affine")
BUDGET_BYTES = 64 * 1024
"""Default of an affine table. Whatever table a firmware was built with, its slots for tables by radio have at
least this size, and the flash holds two of them beside a built-in table as large."""

_HELD_OUT_EVERY = 8  # every eighth state is held out to choose the table
_COARSENESS = {  # of stored values, tried in turn
    "nearest": (1.0, 4.0, 8.0, 16.0),
    "affine": (0.125, 0.1875, 0.25, 0.375, 0.5, 1.0),
}
_ROW_BYTES = {"nearest": 20, "affine": 160}  # approximate minimum
WHOLE_MIN = next(n for n in range(STATES_MIN, 2 * STATES_MIN) if n - n // _HELD_OUT_EVERY >= STATES_MIN)
"""Fewest complete states of a library for a fit."""

_SAMPLES_A_CELL = 64
_SAMPLES = (8192, 131072)
_TRIES = 12
_MARGIN = 1.25  # range of a correction over the distance of the farthest sample
_NEIGHBOURS = 8  # a sample lies between a state and one of these


def error_on(tables: Tables, unseen: Library) -> dict[str, float]:
    """Root mean square error of a table's transitions on the complete states of a library.

    Returns:
        ``position_m``, ``heading_rad`` at the period's end, and ``velocity_mps``, ``omega_rad_s`` there.
    """
    return _rms(_gap(tables, unseen.part(np.flatnonzero(unseen.whole_states()))))


def _gap(tables: Tables, unseen: Library) -> Float64:
    """(n, a, 6) what a table looks up less what a library has."""
    gap = looked_up(tables, unseen.initial_velocity_body, unseen.previous_actions) - unseen.rows()
    gap[..., 2] = wrap_angle(gap[..., 2])
    return gap


def _rms(gap: Float64) -> dict[str, float]:
    def rms(*columns: Float64) -> float:
        return float(np.sqrt(np.mean(np.sum(np.square(columns), axis=0))))

    return {
        "position_m": rms(gap[..., 0], gap[..., 1]),
        "heading_rad": rms(gap[..., 2]),
        "velocity_mps": rms(gap[..., 3], gap[..., 4]),
        "omega_rad_s": rms(gap[..., 5]),
    }


def looked_up(tables: Tables, velocities: Float64, previous: Int64) -> Float64:
    """Transitions that the robot's planner looks up in a table.

    Args:
        tables: the table.
        velocities: (n, 3) forward, left (m/s), turn rate (rad/s), body frame.
        previous: (n, s) earlier actions, newest first, then RESTED.

    Returns:
        (n, a, 6) displacements (m, m, rad) and velocities at the end, SI units.
    """
    found = np.empty((len(velocities), len(tables.actions), 6))
    _look_up_many(arrays_of(tables), velocities.astype(np.float32), previous, found)
    return found


def _compiled(stamp: int) -> Any:
    @cached_njit()
    def look_up_many(table, velocities, previous, found):  # type: ignore[no-untyped-def]
        one = np.float32(1)
        now, after = np.zeros(DYNAMICS, dtype=np.int64), np.zeros(DYNAMICS, dtype=np.int64)
        motion = np.zeros(3, dtype=np.float32)
        for k in range(len(velocities)):
            now[:] = 0
            for place in range(previous.shape[1] - 1, -1, -1):
                if previous[k, place] >= 0:  # a limb's use does not depend on the row
                    dynamics_after(table, np.int64(0), now, np.int64(previous[k, place]), after)
                    now[3:] = after[3:]
            for axis in range(3):
                now[axis] = velocity_code(velocities[k, axis], one / table.velocity_scale[axis])
            row = find_row(table, now)
            for action in range(found.shape[1]):
                motion_of(table, row, now, action, motion)
                dynamics_after(table, row, now, action, after)
                for axis in range(3):
                    found[k, action, axis] = motion[axis]
                    found[k, action, 3 + axis] = np.float32(after[axis]) * table.velocity_scale[axis]
        return stamp

    return look_up_many


_look_up_many = _compiled(stamp_of("frogkick.planner"))


@dataclass(frozen=True, eq=False)
class FittedTable:
    """A table fitted to a library.

    Attributes:
        image: table image.
        kind: "nearest" or "affine".
        held_out: its error on held-out states of the library, as of ``error_on``.
        score: root mean square of these errors in units of the position measurement's noise.
    """

    image: bytes
    kind: str
    held_out: dict[str, float]
    score: float


def fit_table(
    library: Library,
    kind: str | None = None,
    budget_bytes: int | None = None,
    progress: Progress = lambda _done, _all: None,
) -> FittedTable:
    """The table with the least error on held-out states of a library.

    A table of kind "nearest" has all states of the library if they fit into the budget, as in the paper.
    Otherwise states are chosen where the error is large (see frogkick.library.voronoi), and the best of
    several roundings of the values is taken: coarser values leave room for more states.

    The same library gives the same bytes on every x86-64 processor with FMA. For arguments and errors see
    ``frogkick.fit_table``. A fit needs WHOLE_MIN complete states, a "nearest" table of all states any number.
    """
    if kind is not None and kind not in KINDS:
        raise InputError(f"kind is {kind!r}{nearest_name(kind, KINDS)}: give {' or '.join(KINDS)}")
    asked = KINDS if kind is None else (kind,)
    fit = _Fit(library)
    tries = [(each, coarseness) for each in asked for coarseness in _COARSENESS[each]]
    best: FittedTable | None = None
    refused: InputError | None = None
    for tried, (each, coarseness) in enumerate(tries):
        progress(tried, len(tries))
        try:
            found = fit.table(each, coarseness, budget_bytes)
        except InputError as error:  # the budget may suffice for another kind or rounding
            refused = error
            continue
        if best is None or found.score < best.score:
            best = found
    progress(len(tries), len(tries))
    if best is None:
        raise refused or InputError(f"kind {kind!r} has no table")
    return best


def require_enough(library: Library) -> None:
    """Raise InputError unless a library has enough complete states for a fit."""
    complete = int(library.whole_states().sum())
    if complete < WHOLE_MIN:
        raise InputError(
            f"the library has {complete} complete states, to fit a table takes {WHOLE_MIN}: build it with "
            "more --states"
        )


class _Fit:
    """State shared by all tables of a library."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self._robot = library.robot()
        self._about = table_metadata(self._robot, library.content_sha256())
        self._whole = np.flatnonzero(library.whole_states())
        self._held = self._whole[_HELD_OUT_EVERY - 1 :: _HELD_OUT_EVERY]
        self._regressions: dict[tuple[str, int], VoronoiRegression] = {}

    @cached_property
    def _seen(self) -> Library:
        """The library of the complete states that are not held out."""
        return self._library.part(np.setdiff1d(self._whole, self._held))

    @cached_property
    def _surface(self) -> Surface:
        require_enough(self._library)
        seen = self._seen
        return fit_surface(self._robot, seen.initial_velocity_body, seen.rows(), seen.previous_actions)

    @cached_property
    def _whole_table(self) -> FittedTable:
        """The table of all states, scored by a table of those that are not held out."""
        image = quantise(self._library)
        if not len(self._held):
            return FittedTable(image, "nearest", {}, math.inf)
        return replace(self._scored("nearest", quantise(self._seen)), image=image)

    def table(self, kind: str, coarseness: float, budget_bytes: int | None) -> FittedTable:
        """The table of a kind with as many states as fit, with a multiple of the default rounding."""
        if kind == "nearest" and (budget_bytes is None or len(self._whole_table.image) <= budget_bytes):
            return self._whole_table
        budget = BUDGET_BYTES if budget_bytes is None else budget_bytes
        regression = self._regression(kind, budget)

        def packed(states: int) -> bytes:
            return self._packed(kind, regression.cells(states), coarseness)

        return self._scored(kind, _fill(packed, budget, len(self._whole), _ROW_BYTES[kind]))

    def _regression(self, kind: str, budget: int) -> VoronoiRegression:
        """Regression on samples between the library's states, as dense as these."""
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
                limb_wear=self._library.limb_wear,
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
            limb_wear=self._library.limb_wear,
        )

    def _scored(self, kind: str, image: bytes) -> FittedTable:
        gap = _gap(open_image(image), self._library.part(self._held))
        score = float(np.sqrt(np.mean((gap / noise_of(self._robot)) ** 2)))
        return FittedTable(image, kind, _rms(gap), score)


def _between(codes: Float64, count: int) -> Float64:
    """(count, 3) points between states and one of their nearest neighbours each."""
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    neighbours = min(_NEIGHBOURS, len(codes) - 1)
    near = cKDTree(codes).query(codes, neighbours + 1)[1]
    first = np.arange(count) % len(codes)
    second = near[first, rng.integers(1, neighbours + 1, count)]
    return np.asarray(codes[first] + rng.uniform(0.0, 1.0, (count, 1)) * (codes[second] - codes[first]))


def _fill(packed: Callable[[int], bytes], budget: int, states_max: int, row_bytes: float) -> bytes:
    """The image with the most states, at most ``states_max``, within a budget; ``row_bytes`` is a guess."""
    image = packed(1)
    if len(image) > budget:
        raise InputError(
            f"a budget of {budget} bytes is too small for a table of this kind, the smallest has "
            f"{len(image)}: give --budget-kib {math.ceil(len(image) / 102.4) / 10:g} or more"
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


STATES = 300
"""Number of states of the default table's library: what an affine table of 64 KiB holds, and a few more."""
SEED = 0
SAMPLING = "planned"
"""The planner leads to these states: there a table from random swims errs six times as much."""


def default_table(
    robot: Robot,
    library: Path,
    stage: Callable[[str], AbstractContextManager[Tell]],
    title: str,
    states: int = STATES,
    seed: int = SEED,
    sampling: str = SAMPLING,
) -> bytes:
    """Simulate a library and fit the default table to it: what a robot carries where no other is asked for.

    The demo, commands without ``--tables`` and ``fk.load_table()`` use it. Its kind and size are those of
    ``fit_table`` without arguments: an affine table of ``BUDGET_BYTES``, which fits a slot of every robot.

    Args:
        library: file to write the library to (HDF5).
        stage: makes a progress bar with a title.
        title: of the library's bar.
        states: number of states of the library. Too few for an affine table give one of kind nearest.
    """
    with stage(title) as tell:
        made = build_library(robot, states, seed, os.cpu_count() or 1, library, tell, sampling, 0.0)
    with stage("tables tried") as tell:
        return fit_table(made, progress=tell).image
