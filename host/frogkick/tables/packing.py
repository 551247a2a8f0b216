"""Pack table images of both kinds: round transitions to codes, choose the coding, write the bytes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from frogkick.core.arrays import AnyArray, Float64, Int16, Int64
from frogkick.tables import layout
from frogkick.tables.checks import require
from frogkick.tables.coding import best_prediction, bits_for
from frogkick.tables.sealing import (
    ERROR_MAX,
    Metadata,
    require_shapes,
    scales_of,
    sealed,
    velocity_codes,
)

_DERIVATIVE_MAX = 32000.0  # the least and any residual of 7 bits stay within 16 bits
_DERIVATIVE_SPREAD = 126.0  # rounding adds at most one
_VALUE_SPREAD = 2046.0
_REACH_MAX = 980.0  # m, rad: within the coarsest scale's codes
_MARGIN = 0.03  # of the largest motion on the grid, for larger ones between its points
_GRID = 17  # lines of each axis of the grid


def pack_nearest(
    about: Metadata,
    velocities: npt.ArrayLike,
    displacements: npt.ArrayLike,
    velocities_end: npt.ArrayLike,
    error_max: Sequence[float] = ERROR_MAX,
    limb_wear: npt.ArrayLike = (),
) -> bytes:
    """Quantise transitions to a table image of kind ``nearest``.

    Each value is predicted from its state's velocity codes by a quadratic of its block of rows, and the
    residual is stored in as many bits as the precision needs. Rows are put into k-d order.

    Args:
        about: robot, provenance, times and actions.
        velocities: (n, 3) body-frame initial velocities (forward m/s, left m/s, rad/s).
        displacements: (n, a, 3) motion over one period (m, m, rad), body frame at its start.
        velocities_end: (n, a, 3) body-frame velocities at the end of the period.
        error_max: largest rounding error of a stored value: position m, heading rad, velocity m/s, turn rate
            rad/s. Initial velocities are rounded to codes, end velocities at best to half a code, motions at
            best to 1/32767 of the largest.
        limb_wear: (l, k, 6) change of a transition by limb and lost share, SI; empty: no curves.

    Returns:
        The image; the same input gives the same bytes.

    Raises:
        TableError: wrong shapes or counts, or a value that is not finite or out of range, with its row of the
            input and its column.
    """
    start = np.asarray(velocities, dtype=np.float64)
    motion = np.asarray(displacements, dtype=np.float64)
    end = np.asarray(velocities_end, dtype=np.float64)
    states, actions = len(start), len(about.action_rows)
    about.require_valid(states)
    shape = (states, actions, 3)
    require_shapes(
        velocities=(start, (states, 3)), displacements=(motion, shape), velocities_end=(end, shape)
    )
    codes = velocity_codes("initial velocities", start, about)
    velocity_codes("end velocities", end, about)
    motion_scale, unit = scales_of(motion, about, error_max)
    order, axes = layout.kd_order(codes, layout.tree_levels_for(states))
    wanted = np.concatenate(
        [motion / motion_scale.astype(np.float64), end / about.velocity_scale.astype(np.float64)], axis=2
    )
    chosen = best_prediction(codes[order], wanted[order].reshape(states, -1), np.tile(unit, actions))
    decoded = chosen.decoded.reshape(states, actions, 6)
    bits = bits_for(chosen.residuals.max(axis=0))
    columns = np.zeros(len(bits), dtype=layout.COLUMN)
    columns["at"], columns["bits"] = np.cumsum(bits) - bits, bits
    return sealed(
        about,
        layout.KIND_NEAREST,
        codes[order],
        axes,
        chosen.residuals,
        bits,
        columns.tobytes(),
        limb_wear,
        chosen.coefficients.astype("<i2").tobytes(),
        motion_scale=motion_scale,
        motion_limit=np.abs(decoded[..., :3]).max(axis=(0, 1)),
        shift=chosen.shift[:6],
        unit=unit,
        up=chosen.up,
        block_levels=chosen.levels,
    )


def pack_affine(
    about: Metadata,
    velocities: npt.ArrayLike,
    base: npt.ArrayLike,
    jacobian: npt.ArrayLike,
    history: npt.ArrayLike,
    use_decay: float,
    use_gain: float,
    offset_limit: Sequence[float] | None = None,
    error_max: Sequence[float] = ERROR_MAX,
    velocity_box: npt.ArrayLike | None = None,
    limb_wear: npt.ArrayLike = (),
) -> bytes:
    """Quantise states with a local linear correction to a table image of kind ``affine``.

    Args:
        about: robot, provenance, times and actions.
        velocities: (n, 3) body-frame velocities of the states.
        base: (n, a, 6) at each state with rested limbs: motion (m, m, rad), end velocity (m/s, m/s, rad/s).
        jacobian: (n, a, 6, 3) derivative of these by the initial velocity, SI.
        history: (a, l, 6) what a fully used limb adds to these, SI.
        use_decay: part of a limb's use that remains a period later, 0 to 1.
        use_gain: what firing adds to a limb's use, 0 to 1; a use saturates at 1.
        offset_limit: largest |query - state| that the derivatives are applied to (m/s, m/s, rad/s); None: the
            largest distance of a velocity in the states' box from its nearest state.
        error_max: largest rounding of a base, and of a correction at the offset limit, as for pack_nearest;
            but no finer than 1/2046 of a base's span over the states, and 1/126 of a derivative's.
        velocity_box: (2, 3) lowest and highest velocity of queries; motions are clamped to the largest one
            within it. None: the states' box.
        limb_wear: as for pack_nearest.

    Returns:
        The image; the same input gives the same bytes.

    Raises:
        TableError: as pack_nearest, or a decay or gain out of range.
    """
    start = np.asarray(velocities, dtype=np.float64)
    given = np.asarray(base, dtype=np.float64)
    slopes = np.asarray(jacobian, dtype=np.float64)
    used = np.asarray(history, dtype=np.float64)
    states, actions = len(start), len(about.action_rows)
    about.require_valid(states)
    require_shapes(
        velocities=(start, (states, 3)),
        base=(given, (states, actions, 6)),
        jacobian=(slopes, (states, actions, 6, 3)),
        history=(used, (actions, about.limbs, 6)),
    )
    codes = velocity_codes("initial velocities", start, about)
    velocity_codes("end velocities", given[..., 3:], about)
    scales_of(given[..., :3], about, error_max)  # refuses a base out of range by its row
    for name, array in (("jacobian", slopes), ("history", used)):
        require(bool(np.isfinite(array).all()), f"{name} holds NaN or infinity: check the fit")
    decay, gain = _fraction("use_decay", use_decay), _fraction("use_gain", use_gain)
    order, axes = layout.kd_order(codes, layout.tree_levels_for(states))
    codes, given, slopes = codes[order], given[order], slopes[order]
    velocity = about.velocity_scale.astype(np.float64)
    box = codes if velocity_box is None else np.asarray(velocity_box, dtype=np.float64) / velocity
    grid, row = _grid_in_box(codes, box)
    offsets = grid - codes[row].astype(np.int64)
    limit = np.abs(offsets).max(axis=0) if offset_limit is None else _limit_codes(offset_limit, velocity)
    limit = np.minimum(limit, layout.VELOCITY_CODE_MAX)
    reach = _reach(given, slopes, used, row, np.clip(offsets, -limit, limit) * velocity)
    require(
        float(reach.max()) <= _REACH_MAX,
        f"jacobian and history let a motion reach {reach.max():.4g} m or rad, at most {_REACH_MAX:.0f} is "
        "allowed: check the fit",
    )
    motion_scale, unit = scales_of(reach[None, None], about, error_max)
    scale = np.concatenate([motion_scale, about.velocity_scale]).astype(np.float64)

    unit = np.maximum(unit, np.ptp(given, axis=0).max(axis=0) / scale // _VALUE_SPREAD + 1).astype(np.int64)
    values = np.floor(given / scale / unit + 0.5).astype(np.int64)
    slope = _derivatives(slopes * velocity / scale[:, None], int(limit.max()), unit)
    parts = np.concatenate([slope[1], values[..., None]], axis=3)
    least = parts.min(axis=0)
    residuals = parts - least
    least[..., 3] *= unit
    require(int(np.abs(least).max()) <= 32767, "base is beyond 32767 codes: choose a coarser scale")
    columns = np.zeros(6 * actions, dtype=layout.affine_column(about.limbs))
    columns["least"] = least.reshape(-1, 4)
    added = np.moveaxis(_history(used / scale), 1, 2).reshape(-1, about.limbs)
    columns["history"][:, : about.limbs] = added
    return sealed(
        about,
        layout.KIND_AFFINE,
        codes,
        axes,
        residuals.reshape(states, -1),
        np.tile(layout.AFFINE_BITS, 6 * actions).astype(np.int64),
        columns.tobytes(),
        limb_wear,
        motion_scale=motion_scale,
        motion_limit=np.ceil(reach / scale[:3]).astype(np.int64),
        shift=slope[0],
        unit=unit,
        offset_limit=limit,
        use=(decay, gain),
    )


def _derivatives(ratio: Float64, offset: int, unit: Int64) -> tuple[Int64, Int64]:
    """Shift (6,), and derivatives (n, a, 6, 3) as codes per code times 2**shift.

    It is the smallest shift at which the rounding of a derivative, times the offset, is below half a unit, or
    a smaller one if the derivatives of an action's value would span more than 7 bits or exceed 16.
    """
    shift = np.empty(6, dtype=np.int64)
    largest = np.abs(ratio).max(axis=(0, 1, 3))
    spread = np.ptp(ratio, axis=0).max(axis=(0, 2))
    for value in range(6):
        bits = max(int(np.ceil(np.log2(max(offset, 1) / float(unit[value])))), 0)
        bits = min(bits, layout.CORRECTION_SHIFT_MAX)
        while bits > 0 and (
            largest[value] * 2.0**bits > _DERIVATIVE_MAX or spread[value] * 2.0**bits > _DERIVATIVE_SPREAD
        ):
            bits -= 1
        require(
            largest[value] <= _DERIVATIVE_MAX and spread[value] * 2.0**bits <= _DERIVATIVE_SPREAD,
            f"jacobian's value {value} spans {spread[value]:.4g} codes per code, at most "
            f"{_DERIVATIVE_SPREAD:.0f} is allowed: check the fit",
        )
        shift[value] = bits
    return shift, np.floor(ratio * 2.0 ** shift[:, None] + 0.5).astype(np.int64)


def _limit_codes(offset_limit: Sequence[float], velocity_scale: Float64) -> Int64:
    furthest = np.asarray(offset_limit, dtype=np.float64)
    require(
        furthest.shape == (3,) and bool(np.all(furthest >= 0.0)),
        f"offset_limit is {offset_limit}, needed are three numbers from 0 on: m/s, m/s, rad/s",
    )
    return np.ceil(np.minimum(furthest / velocity_scale, layout.VELOCITY_CODE_MAX)).astype(np.int64)


def _reach(base: Float64, slopes: Float64, history: Float64, row: Int64, offsets: Float64) -> Float64:
    """(3,) m, m, rad: the largest motion of states and of queries with fully used limbs.

    The queries are at offsets (g, 3) from their nearest states, of rows (g,).
    """
    largest = np.abs(base[..., :3]).max(axis=(0, 1))
    for some in np.array_split(np.arange(len(row)), max(1, len(row) // 1000)):
        motion = base[row[some], :, :3]
        for axis in range(3):  # in a fixed order of sums
            motion = motion + slopes[row[some], :, :3, axis] * offsets[some, None, None, axis]
        largest = np.maximum(largest, np.abs(motion).max(axis=(0, 1)))
    used = np.zeros((len(history), 3))
    for limb in range(history.shape[1]):
        used += np.abs(history[:, limb, :3])
    return np.asarray(largest * (1.0 + _MARGIN) + used.max(axis=0), dtype=np.float64)


def _grid_in_box(codes: Int16, box: AnyArray) -> tuple[Int64, Int64]:
    """Velocities (g, 3) on a grid over a box of codes, and the row of the nearest state to each (g,)."""
    states = codes.astype(np.int64)
    low, high = box.min(axis=0).astype(np.int64), box.max(axis=0).astype(np.int64)
    lines = [low[axis] + np.arange(_GRID) * (high - low)[axis] // (_GRID - 1) for axis in range(3)]
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    rows = [
        ((some[:, None, :] - states[None, :, :]) ** 2).sum(axis=2).argmin(axis=1)
        for some in np.array_split(grid, max(1, len(states) // 64))
    ]
    return grid, np.concatenate(rows)


def _history(codes: Float64) -> Int64:
    rounded = np.floor(np.clip(codes, -1e9, 1e9) + 0.5).astype(np.int64)
    sums = np.abs(rounded).sum(axis=1)
    require(
        int(np.abs(rounded).max()) <= 32767 and int(sums.max()) <= layout.HISTORY_SUM_MAX,
        "history holds a value beyond 32767 codes: check the fit",
    )
    return rounded


def _fraction(name: str, value: float) -> int:
    require(0.0 <= value <= 1.0, f"{name} is {value}, allowed is 0 to 1: check the fit")
    return min(int(value * 2**layout.USE_SHIFT + 0.5), layout.USE_MAX)
