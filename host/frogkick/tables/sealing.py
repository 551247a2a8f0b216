"""Common parts of packing both kinds of table image: metadata, scales, sections and CRC."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from frogkick.core.arrays import Float32, Float64, Int16, Int64
from frogkick.tables import coding, layout
from frogkick.tables.checks import (
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
    """The fields that table images of both kinds have."""

    robot_id: str  # 1 to 15 printable ASCII characters
    provenance: bytes  # SHA-256 of the library's content
    period_us: int
    # shorter than the period
    pulse_us: int
    second_delay_us: int
    limbs: int  # 1 to 8
    action_rows: ActionRows  # name, mask of the first group, mask of the second
    velocity_resolution: Sequence[float]  # velocity per code, (m/s, m/s, rad/s)

    @property
    def velocity_scale(self) -> Float32:
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


def require_shapes(**arrays: tuple[Float64, tuple[int, ...]]) -> None:
    for name, (array, shape) in arrays.items():
        require(array.shape == shape, f"{name} has shape {array.shape}, needed is {shape}: check the library")


def velocity_codes(what: str, values: Float64, about: Metadata) -> Int16:
    """Velocities (..., 3) as codes, rounded half away from zero."""
    scale = about.velocity_scale
    _require_within(what, VELOCITY_COLUMNS, values, layout.VELOCITY_CODE_MAX, scale, about.action_rows)
    ratio = values / scale.astype(np.float64)
    return np.copysign(np.floor(np.abs(ratio) + 0.5), ratio).astype(np.int16)


def scales_of(motion: Float64, about: Metadata, error_max: Sequence[float]) -> tuple[Float32, Int64]:
    """Motion per code, (3,), and codes per unit of a residual, (6,), that keep the wanted errors."""
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


def sealed(
    about: Metadata,
    kind: int,
    codes: Int16,
    axes: tuple[int, ...],
    residuals: Int64,
    bits: Int64,
    columns: bytes,
    limb_wear: npt.ArrayLike,
    models: bytes = b"",
    **numbers: Any,
) -> bytes:
    """Join the sections and add the header with its CRC.

    Args:
        codes: (n, 3) states in k-d order.
        axes: of the search tree's levels.
        residuals: (n, c) unsigned, of ``bits`` (c,).
        columns, models: these sections.
        limb_wear: (l, k, 6) in SI; empty: no curves.
        numbers: further fields of layout.HEADER, zero where none is given.
    """
    fits = residuals.max(axis=0) < 1 << np.minimum(bits, layout.BITS_MAX)
    require(bool(fits.all()), "a residual needs more bits than it has: choose a coarser error_max")
    scale = np.concatenate([numbers["motion_scale"], about.velocity_scale]).astype(np.float64)
    knots, wear = _wear_codes(np.asarray(limb_wear, dtype=np.float64), about.limbs, scale)
    record = np.zeros(1, dtype=layout.HEADER)
    numbers |= {
        "magic": layout.MAGIC,
        "format_version": layout.FORMAT_VERSION if knots else layout.FORMAT_PLAIN,
        "kind": kind,
        "robot_id": about.robot_id.encode("utf-8"),
        "states": len(codes),
        "actions": len(about.action_rows),
        "row_bytes": (int(bits.sum()) + 7) // 8,
        "tree_levels": len(axes),
        "motion_limit": np.clip(numbers["motion_limit"], 1, layout.MOTION_CODE_MAX),
        "wear_knots": knots,
        "axes": layout.axes_word(axes),
    }
    for name in ("provenance", "period_us", "pulse_us", "second_delay_us", "limbs", "velocity_scale"):
        numbers[name] = getattr(about, name)
    for name, value in numbers.items():
        record[name] = value
    right = layout.sections(layout.header_of(record.tobytes()))
    for name, at in right._asdict().items():
        if name != "wear":
            record[name if name == "length" else f"{name}_at"] = at
    body = b""
    for section, end in (
        (b"".join(action_bytes(row) for row in about.action_rows), right.columns),
        (columns, right.wear),
        (wear, right.splits),
        (layout.kd_splits(codes, axes).astype("<i2").tobytes(), right.models),
        (models, right.states),
        (codes.astype("<i2").tobytes(), right.transitions),
        (coding.put_residuals(residuals, bits), right.length),
    ):
        body = (body + section).ljust(end - layout.HEADER_BYTES, b"\0")
    record["crc32"] = zlib.crc32(record.tobytes()[16:] + body)
    return record.tobytes() + body


def _wear_codes(curves: Float64, limbs: int, scale: Float64) -> tuple[int, bytes]:
    """The knots of the wear curves, and their section. A library without curves gives none."""
    if not curves.size:
        return 0, b""
    knots = curves.shape[1]
    require_shapes(limb_wear=(curves, (limbs, knots, 6)))
    require(
        knots <= layout.WEAR_KNOTS_MAX and bool(np.isfinite(curves).all()),
        f"limb_wear has {knots} knots or a value that is not finite: check the library",
    )
    codes = np.clip(np.floor(curves / scale + 0.5), -layout.WEAR_CODE_MAX, layout.WEAR_CODE_MAX)
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
