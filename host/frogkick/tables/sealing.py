"""Common parts of packing both kinds of table image: metadata, scales, sections and CRC."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float32, Float64, Int16, Int64
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

ActionRows = Sequence[tuple[str, int, int]]

VELOCITY_COLUMNS = ("vx_mps", "vy_mps", "omega_rad_s")
MOTION_COLUMNS = ("dx_m", "dy_m", "dheading_rad")
ERROR_MAX = (1e-4, 1.74533e-3, 1e-4, 1.74533e-3)
"""Default rounding error of a stored value: position m, heading rad, velocity m/s, turn rate rad/s: 0.1 mm
and degrees, half of the position measurement's noise."""
_FINER = 16  # codes per unit of a motion's residual


@dataclass(frozen=True, eq=False)
class Metadata:
    """The fields that table images of both kinds have.

    Attributes:
        robot_id: 1 to 15 printable ASCII characters.
        provenance: SHA-256 of the library's content, 32 bytes.
        period_us, pulse_us, second_delay_us: integer microseconds, pulse and delay shorter than the period.
        limbs: 1 to 8.
        action_rows: (name, mask of the first group, mask of the second) per action.
        velocity_resolution: velocity per code, (m/s, m/s, rad/s).
    """

    robot_id: str
    provenance: bytes
    period_us: int
    pulse_us: int
    second_delay_us: int
    limbs: int
    action_rows: ActionRows
    velocity_resolution: Sequence[float]

    @property
    def velocity_scale(self) -> Float32:
        """(3,) ``velocity_resolution``."""
        return np.array(self.velocity_resolution, dtype=np.float32)

    def require_valid(self, states: int) -> None:
        """Raise TableError where a field, or the number of states, is out of its range."""
        require_counts(states, len(self.action_rows), self.limbs, "check the robot and --states")
        require(
            len(self.provenance) == 32,
            f"provenance has {len(self.provenance)} bytes, a SHA-256 has 32: pass the digest",
        )
        robot_id_of(self.robot_id.encode("utf-8").ljust(layout.ROBOT_ID_BYTES, b"\0"))
        require_times(self.period_us, self.pulse_us, self.second_delay_us)
        action_rows_of(b"".join(action_bytes(row) for row in self.action_rows), self.limbs)
        scale = self.velocity_scale
        require(
            scale.shape == (3,) and bool(np.all((scale >= layout.SCALE_MIN) & (scale <= layout.SCALE_MAX))),
            f"velocity_resolution is {tuple(self.velocity_resolution)}, allowed are three values of 1e-9 to "
            "0.03: check the robot",
        )


@dataclass(frozen=True, eq=False)
class Coded:
    """The numbers of an image; for the fields see layout.py.

    Attributes:
        codes: (n, 3) states in k-d order.
        axes: of the search tree's levels.
        residuals: (n, c) unsigned.
        coefficients: kind nearest: the models' section.
        least, history: kind affine: (a, 6, 4) of three derivatives and the value, (a, l, 6).
        motion_scale: (3,) float32.
        motion_limit: (3,) largest code that a look-up gives, clipped to 32767.
        shift, unit: (6,).
        up, offset_limit: (3,).
        limb_wear: (l, k, 6) in SI; empty: no curves.
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
    limb_wear: Float64
    coefficients: bytes = b""
    block_levels: int = 0
    least: Int64 | None = None
    history: Int64 | None = None
    use: tuple[int, int] = (0, 0)

    @property
    def kind(self) -> int:
        """layout.KIND_NEAREST or KIND_AFFINE."""
        return layout.KIND_NEAREST if self.least is None else layout.KIND_AFFINE

    def columns(self, bits: Int64) -> bytes:
        """The columns' section, given the bits of each residual (c,)."""
        if self.least is None or self.history is None:
            plain = np.zeros(len(bits), dtype=layout.COLUMN)
            plain["at"], plain["bits"] = np.cumsum(bits) - bits, bits
            return plain.tobytes()
        limbs = self.history.shape[1]
        columns = np.zeros(len(bits) // 4, dtype=layout.affine_column(limbs))
        columns["least"] = self.least.reshape(-1, 4)
        columns["history"][:, :limbs] = np.moveaxis(self.history, 1, 2).reshape(-1, limbs)
        return columns.tobytes()


def require_shapes(**arrays: tuple[Float64, tuple[int, ...]]) -> None:
    """Raise TableError for an array that does not have the shape beside it."""
    for name, (array, shape) in arrays.items():
        require(array.shape == shape, f"{name} has shape {array.shape}, needed is {shape}: check the library")


def velocity_codes(what: str, values: Float64, about: Metadata) -> Int16:
    """Velocities (..., 3) as codes, rounded half away from zero.

    Raises:
        TableError: a value that no code holds, by row and column.
    """
    scale = about.velocity_scale
    _require_within(what, VELOCITY_COLUMNS, values, layout.VELOCITY_CODE_MAX, scale, about.action_rows)
    ratio = values / scale.astype(np.float64)
    return np.copysign(np.floor(np.abs(ratio) + 0.5), ratio).astype(np.int16)


def scales_of(motion: Float64, about: Metadata, error_max: Sequence[float]) -> tuple[Float32, Int64]:
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
    _require_within("displacements", MOTION_COLUMNS, motion, most, ceiling, about.action_rows)
    error = wanted[[0, 0, 1, 2, 2, 3]]
    finest = np.abs(motion).max(axis=(0, 1)) / most
    # Rounded up to the next float32: a smaller scale might miss the largest motion.
    scale = np.nextafter(np.maximum(2.0 * error[:3] / _FINER, finest).astype(np.float32), np.float32(1))
    scale = np.clip(scale, np.float32(layout.SCALE_MIN), ceiling)
    code = np.concatenate([scale, about.velocity_scale]).astype(np.float64)
    unit = np.clip(np.floor(2.0 * error / code + 1e-5), 1, 4096)
    return scale, unit.astype(np.int64)


def sealed(about: Metadata, coded: Coded) -> bytes:
    """Join the sections and add the header with its CRC.

    Raises:
        TableError: a residual of more than 16 bits.
    """
    states, actions, levels = len(coded.codes), len(about.action_rows), len(coded.axes)
    bits = coding.bits_for(coded.residuals.max(axis=0))
    if coded.kind == layout.KIND_AFFINE:
        bits = np.tile(layout.AFFINE_BITS, 6 * actions).astype(np.int64)
    fits = coded.residuals.max(axis=0) < 1 << np.minimum(bits, layout.BITS_MAX)
    require(bool(fits.all()), "a residual needs more bits than it has: choose a coarser error_max")
    row_bytes = (int(bits.sum()) + 7) // 8
    knots, wear = _wear_codes(about, coded)
    right = layout.sections(
        coded.kind, states, actions, about.limbs, levels, coded.block_levels, row_bytes, knots
    )
    body = b""
    for section, end in (
        (b"".join(action_bytes(row) for row in about.action_rows), right.columns),
        (coded.columns(bits), right.wear),
        (wear, right.splits),
        (layout.kd_splits(coded.codes, coded.axes).astype("<i2").tobytes(), right.models),
        (coded.coefficients, right.states),
        (coded.codes.astype("<i2").tobytes(), right.transitions),
        (coding.put_residuals(coded.residuals, bits), right.length),
    ):
        body = (body + section).ljust(end - layout.HEADER_BYTES, b"\0")
    limit = np.clip(coded.motion_limit, 1, layout.MOTION_CODE_MAX)
    numbers = np.concatenate([limit, coded.offset_limit, coded.shift, coded.unit, coded.up]).tolist()

    def header(crc: int) -> bytes:
        return layout.HEADER.pack(
            layout.MAGIC, layout.FORMAT_VERSION if knots else layout.FORMAT_PLAIN, coded.kind,
            right.length, crc,
            about.robot_id.encode("utf-8"), about.provenance, about.period_us, about.pulse_us,
            states, actions, about.limbs, right.actions, right.states, right.transitions,
            *about.velocity_scale.tolist(), *coded.motion_scale.tolist(), about.second_delay_us,
            right.columns, right.splits, right.models, row_bytes, levels, coded.block_levels,
            *numbers, knots, *coded.use, layout.axes_word(coded.axes),
        )  # fmt: skip

    crc = zlib.crc32(header(0)[16:] + body)
    return header(crc) + body


def _wear_codes(about: Metadata, coded: Coded) -> tuple[int, bytes]:
    """The knots of the wear curves, and their section. A library without curves gives none."""
    if not coded.limb_wear.size:
        return 0, b""
    knots = coded.limb_wear.shape[1]
    require_shapes(limb_wear=(coded.limb_wear, (about.limbs, knots, 6)))
    require(
        knots <= layout.WEAR_KNOTS_MAX and bool(np.isfinite(coded.limb_wear).all()),
        f"limb_wear has {knots} knots or a value that is not finite: check the library",
    )
    scale = np.concatenate([coded.motion_scale, about.velocity_scale]).astype(np.float64)
    codes = np.clip(np.floor(coded.limb_wear / scale + 0.5), -layout.WEAR_CODE_MAX, layout.WEAR_CODE_MAX)
    return knots, codes.astype("<i2").tobytes()


def _require_within(
    what: str, columns: tuple[str, ...], values: Float64, limit: int, scale: Float32, rows: ActionRows
) -> None:
    """Raise TableError for the first value beyond the limit in codes, with its row and column."""
    bad = ~(np.abs(values / scale.astype(np.float64)) < limit + 0.5)  # true for NaN as well
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        axis = where[-1]
        action = f", action {rows[where[1]][0]}" if len(where) == 3 else ""
        raise TableError(
            f"{what}: row {where[0]}{action}, column {columns[axis]} is {float(values[where])!r}, allowed is "
            f"+-{limit * float(scale[axis]):.6g}: leave the row out or choose a coarser scale"
        )
