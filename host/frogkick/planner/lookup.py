"""Look-up of a state in a table: the twin of nearest.c and lookup.c, by brute force instead of a tree."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from frogkick.core.arrays import AnyArray
from frogkick.core.compiled import BARE, INNER, cached_njit
from frogkick.tables.image import Tables
from frogkick.tables.layout import LIMBS_MAX, VELOCITY_CODE_MAX

_F0 = np.float32(0)
_HALF = np.float32(0.5)
_CODE_MAX = np.float32(VELOCITY_CODE_MAX)


class TableArrays(NamedTuple):
    """A table as the kernels read it; for the fields see frogkick.tables.image.Tables.

    A state's dynamics are an int64 row of 3 + LIMBS_MAX: velocity codes, then how much each limb was used.
    ``least`` and ``most`` (3,) int64 hold what a velocity's codes are clamped to before a row is looked for:
    all states and the offset beyond them that is corrected for. ``fires`` (a, l) is 1 where an action fires a
    limb; ``use`` holds decay and gain; stroke_max_m (no look-up moves the robot further) and period_s are
    (1,) float32. ``shift`` (a, 6) int64 is what worn limbs add to the codes of every look-up.
    """

    states: AnyArray
    transitions: AnyArray
    derivatives: AnyArray
    history: AnyArray
    shift: AnyArray
    fires: AnyArray
    velocity_scale: AnyArray
    motion_scale: AnyArray
    motion_limit: AnyArray
    correction_shift: AnyArray
    offset_limit: AnyArray
    least: AnyArray
    most: AnyArray
    use: AnyArray
    stroke_max_m: AnyArray
    period_s: AnyArray


DYNAMICS = 3 + LIMBS_MAX


def arrays_of(tables: Tables) -> TableArrays:
    """The arrays of a table as the compiled functions take them."""
    states = tables.states.astype(np.int64)
    same = TableArrays._fields[: TableArrays._fields.index("least")]  # those up to it are called so in Tables
    return TableArrays(
        **{name: getattr(tables, name) for name in same},
        least=states.min(axis=0) - tables.offset_limit,
        most=states.max(axis=0) + tables.offset_limit,
        use=np.array([tables.use_decay, tables.use_gain], dtype=np.int64),
        stroke_max_m=np.array([tables.stroke_max_m], dtype=np.float32),
        period_s=np.array([tables.period_us], dtype=np.float32) * np.float32(1e-6),
    )


@cached_njit(**BARE)
def velocity_code(velocity: np.float32, codes_per_velocity: np.float32) -> Any:
    """Return a velocity as a code, rounded half away from zero, clamped to +-16383."""
    code = velocity * codes_per_velocity
    size = min(abs(code), _CODE_MAX)
    whole = int(size)
    if size - np.float32(whole) >= _HALF:
        whole += 1
    return -whole if code < _F0 else whole


@njit(**INNER)
def nearest_state(states: AnyArray, code_0: Any, code_1: Any, code_2: Any) -> int:
    """Return the row nearest to a velocity in codes, the lowest on ties; 64-bit sums."""
    best = np.int64(2) ** 62
    row = 0
    for index in range(states.shape[0]):
        d0 = np.int64(states[index, 0]) - code_0
        d1 = np.int64(states[index, 1]) - code_1
        d2 = np.int64(states[index, 2]) - code_2
        distance2 = d0 * d0 + d1 * d1 + d2 * d2
        if distance2 < best:
            best = distance2
            row = index
    return row


@njit(**INNER)
def action_count(table: TableArrays) -> int:
    return int(table.transitions.shape[1])


@cached_njit(**BARE)
def find_row(table: TableArrays, dynamics: AnyArray) -> int:
    """The row that a state with these dynamics is looked up in: the nearest to its velocity, clamped."""
    code_0 = min(max(dynamics[0], table.least[0]), table.most[0])
    code_1 = min(max(dynamics[1], table.least[1]), table.most[1])
    code_2 = min(max(dynamics[2], table.least[2]), table.most[2])
    row: int = nearest_state(table.states, code_0, code_1, code_2)
    return row


@njit(**INNER)
def _value(table: TableArrays, row: int, dynamics: AnyArray, action: int, value: int, limit: int) -> Any:
    """One of the six values of a transition in codes: the row's, corrected (affine), worn, clamped."""
    code = np.int64(table.transitions[row, action, value])
    if table.derivatives.shape[0] > 0:
        rise = np.int64(0)
        for axis in range(3):
            offset = dynamics[axis] - np.int64(table.states[row, axis])
            offset = max(-table.offset_limit[axis], min(table.offset_limit[axis], offset))
            rise += np.int64(table.derivatives[row, action, value, axis]) * offset
        shift = table.correction_shift[value]
        # Rounded to the nearest, halves up: the floor of a quotient that is half a unit larger.
        code += (rise + (np.int64(1) << shift) // 2) // (np.int64(1) << shift)
        used = np.int64(0)
        for limb in range(table.history.shape[1]):
            used += np.int64(table.history[action, limb, value]) * dynamics[3 + limb]
        code += used // 32768
    code += table.shift[action, value]
    if code > limit:
        return limit
    return -limit if code < -limit else code


@cached_njit(**BARE)
def motion_of(table: TableArrays, row: int, dynamics: AnyArray, action: int, motion: AnyArray) -> None:
    """Write the motion (3,) float32 m, m, rad over one period, in the body frame at its start."""
    for axis in range(3):
        code = _value(table, row, dynamics, action, axis, table.motion_limit[axis])
        motion[axis] = np.float32(code) * table.motion_scale[axis]


@cached_njit(**BARE)
def limb_use_after(table: TableArrays, use: AnyArray, action: int, after: AnyArray) -> None:
    """Write how much each limb was used lately, (LIMBS_MAX,), after an action: 0 for limbs not there."""
    after[:] = 0
    for limb in range(table.fires.shape[1]):
        left = use[limb] * table.use[0] // 32768
        after[limb] = min(left + table.fires[action, limb] * table.use[1], 32767)


@cached_njit(**BARE)
def dynamics_after(table: TableArrays, row: int, dynamics: AnyArray, action: int, after: AnyArray) -> None:
    """Write the dynamics (DYNAMICS,) at the period's end."""
    for axis in range(3):
        after[axis] = _value(table, row, dynamics, action, 3 + axis, np.int64(VELOCITY_CODE_MAX))
    limb_use_after(table, dynamics[3:], action, after[3:])
