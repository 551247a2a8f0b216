"""What packing both kinds of table image shares: plain fields, scales, the sections and their seal."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frogkick.tables import coding, layout
from frogkick.tables.fields import (
    TableError,
    action_bytes,
    action_rows_of,
    require,
    require_counts,
    require_times,
    robot_id_of,
)

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int16 = npt.NDArray[np.int16]
Int64 = npt.NDArray[np.int64]
ActionRows = Sequence[tuple[str, int, int]]

VELOCITY_COLUMNS = ("vx_mps", "vy_mps", "omega_rad_s")
MOTION_COLUMNS = ("dx_m", "dy_m", "dheading_rad")
ERROR_MAX = (1e-4, 1.74533e-3, 1e-4, 1.74533e-3)
"""Largest rounding of a stored value, unless the caller says otherwise: position m, heading rad, velocity
m/s, turn rate rad/s: 0.1 mm and degrees, half of the position measurement's noise."""
_FINER = 16  # codes per unit of a motion's residual: what the prediction gets right is kept that fine


@dataclass(frozen=True)
class Plain:
    """The fields that every image has, checked.

    Attributes:
        kind: layout.KIND_NEAREST or KIND_AFFINE.
        robot: the id's bytes.
        provenance: 32 bytes.
        times_us: period, pulse, delay of the second group.
        limbs: 1 to 8.
        rows: the actions.
        velocity_scale: (3,) velocity per code.
    """

    kind: int
    robot: bytes
    provenance: bytes
    times_us: tuple[int, int, int]
    limbs: int
    rows: ActionRows
    velocity_scale: Float32


@dataclass(frozen=True, eq=False)
class Coded:
    """The numbers of an image, integers all but the scale; for the fields see layout.py.

    Attributes:
        codes: (n, 3) states in k-d order.
        axes: of the search tree's levels.
        residuals: (n, c) unsigned.
        coefficients: kind nearest, the models' section.
        least, history: kind affine: (a, 6, 4) of three derivatives and the value, (a, l, 6).
        motion_scale: (3,) float32.
        motion_limit: (3,) largest code that a look-up gives; above 32767 it is cut to that.
        shift, unit: (6,).
        up, offset_limit: (3,).
        block_levels: 0 for kind affine.
        use: decay and gain.
    """

    codes: Int16
    axes: tuple[int, ...]
    residuals: Int64
    motion_scale: Float32
    motion_limit: Int64
    shift: Int64
    unit: Int64
    up: Int64
    offset_limit: Int64
    coefficients: bytes = b""
    block_levels: int = 0
    least: Int64 | None = None
    history: Int64 | None = None
    use: tuple[int, int] = (0, 0)

    def columns(self, bits: Int64) -> bytes:
        """The columns' section, for so many bits of each residual (c,)."""
        if self.least is None or self.history is None:
            plain = np.zeros(len(bits), dtype=layout.COLUMN)
            plain["at"], plain["bits"] = np.cumsum(bits) - bits, bits
            return plain.tobytes()
        limbs = self.history.shape[1]
        columns = np.zeros(len(bits) // 4, dtype=layout.affine_column(limbs))
        columns["least"] = self.least.reshape(-1, 4)
        columns["history"][:, :limbs] = np.moveaxis(self.history, 1, 2).reshape(-1, limbs)
        return columns.tobytes()


def plain_fields(
    kind: int,
    robot_id: str,
    provenance: bytes,
    times_us: tuple[int, int, int],
    limbs: int,
    action_rows: ActionRows,
    velocity_scale: Sequence[float],
    states: int,
) -> Plain:
    """Check what every image has; arguments as for ``pack_nearest``.

    Raises:
        TableError: something is out of its range.
    """
    require_counts(states, len(action_rows), limbs, "check the robot and --states")
    require(
        len(provenance) == 32, f"provenance has {len(provenance)} bytes, a SHA-256 has 32: pass the digest"
    )
    robot = robot_id.encode("utf-8")
    robot_id_of(robot.ljust(layout.ROBOT_ID_BYTES, b"\0"))
    require_times(*times_us)
    action_rows_of(b"".join(action_bytes(row) for row in action_rows), limbs)
    scale = np.array(velocity_scale, dtype=np.float32)
    require(
        scale.shape == (3,) and bool(np.all((scale >= layout.SCALE_MIN) & (scale <= layout.SCALE_MAX))),
        f"velocity_scale is {tuple(velocity_scale)}, allowed are three values of 1e-9 to 0.03: "
        "check the robot",
    )
    return Plain(kind, robot, provenance, times_us, limbs, action_rows, scale)


def require_shapes(**arrays: tuple[Float64, tuple[int, ...]]) -> None:
    """Refuse an array that has not the shape beside it."""
    for name, (array, shape) in arrays.items():
        require(array.shape == shape, f"{name} has shape {array.shape}, needed is {shape}: check the library")


def velocity_codes(what: str, values: Float64, plain: Plain) -> Int16:
    """Velocities (..., 3) as codes, rounded half away from zero.

    Raises:
        TableError: a value that no code holds, by row and column.
    """
    _require_within(
        what, VELOCITY_COLUMNS, values, layout.VELOCITY_CODE_MAX, plain.velocity_scale, plain.rows
    )
    ratio = values / plain.velocity_scale.astype(np.float64)
    return np.copysign(np.floor(np.abs(ratio) + 0.5), ratio).astype(np.int16)


def scales_of(motion: Float64, plain: Plain, error_max: Sequence[float]) -> tuple[Float32, Int64]:
    """Motion per code, (3,), and codes per unit of a residual, (6,), that keep the wanted errors.

    Raises:
        TableError: a motion (n, a, 3) that no code holds, by row and column, or an unusable error.
    """
    wanted = np.array(error_max, dtype=np.float64)
    require(
        wanted.shape == (4,) and bool(np.all(np.isfinite(wanted) & (wanted > 0.0))),
        f"error_max is {tuple(error_max)}, needed are four numbers above 0: m, rad, m/s, rad/s",
    )
    ceiling = np.full(3, layout.SCALE_MAX, dtype=np.float32)
    most = layout.MOTION_CODE_MAX - 1
    _require_within("displacements", MOTION_COLUMNS, motion, most, ceiling, plain.rows)
    error = wanted[[0, 0, 1, 2, 2, 3]]
    finest = np.abs(motion).max(axis=(0, 1)) / most
    # Rounded up to the next float32: a scale a hair smaller than wanted might miss the largest motion.
    scale = np.nextafter(np.maximum(2.0 * error[:3] / _FINER, finest).astype(np.float32), np.float32(1))
    scale = np.clip(scale, np.float32(layout.SCALE_MIN), ceiling)
    code = np.concatenate([scale, plain.velocity_scale]).astype(np.float64)
    unit = np.clip(np.floor(2.0 * error / code + 1e-5), 1, 4096)
    return scale, unit.astype(np.int64)


def sealed(plain: Plain, coded: Coded) -> bytes:
    """Put the sections together and seal them with the CRC.

    Raises:
        TableError: a residual of more than 16 bits.
    """
    states, actions, levels = len(coded.codes), len(plain.rows), len(coded.axes)
    bits = coding.bits_for(coded.residuals.max(axis=0))
    if plain.kind == layout.KIND_AFFINE:
        bits = np.tile(layout.AFFINE_BITS, 6 * actions).astype(np.int64)
    fits = coded.residuals.max(axis=0) < 1 << np.minimum(bits, layout.BITS_MAX)
    require(bool(fits.all()), "a residual needs more bits than it has: choose a coarser error_max")
    row_bytes = (int(bits.sum()) + 7) // 8
    right = layout.sections(plain.kind, states, actions, plain.limbs, levels, coded.block_levels, row_bytes)
    body = b""
    for section, end in (
        (b"".join(action_bytes(row) for row in plain.rows), right.columns),
        (coded.columns(bits), right.splits),
        (layout.kd_splits(coded.codes, coded.axes).astype("<i2").tobytes(), right.models),
        (coded.coefficients, right.states),
        (coded.codes.astype("<i2").tobytes(), right.transitions),
        (coding.put_residuals(coded.residuals, bits), right.length),
    ):
        body = (body + section).ljust(end - layout.HEADER_BYTES, b"\0")
    limit = np.clip(coded.motion_limit, 1, layout.MOTION_CODE_MAX)
    numbers = np.concatenate([limit, coded.offset_limit, coded.shift, coded.unit, coded.up]).tolist()

    def header(crc: int) -> bytes:
        period, pulse, delay = plain.times_us
        return layout.HEADER.pack(
            layout.MAGIC, layout.FORMAT_VERSION, plain.kind, right.length, crc, plain.robot, plain.provenance,
            period, pulse, states, actions, plain.limbs, right.actions, right.states, right.transitions,
            *plain.velocity_scale.tolist(), *coded.motion_scale.tolist(), delay,
            right.columns, right.splits, right.models, row_bytes, levels, coded.block_levels,
            *numbers, *coded.use, layout.axes_word(coded.axes),
        )  # fmt: skip

    crc = zlib.crc32(header(0)[16:] + body)
    return header(crc) + body


def _require_within(
    what: str, columns: tuple[str, ...], values: Float64, limit: int, scale: Float32, rows: ActionRows
) -> None:
    """Refuse the first value beyond the limit in codes, naming its row and column."""
    bad = ~(np.abs(values / scale.astype(np.float64)) < limit + 0.5)  # true for NaN as well
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        axis = where[-1]
        action = f", action {rows[where[1]][0]}" if len(where) == 3 else ""
        raise TableError(
            f"{what}: row {where[0]}{action}, column {columns[axis]} is {float(values[where])!r}, allowed is "
            f"+-{limit * float(scale[axis]):.6g}: leave the row out or choose a coarser scale"
        )
