"""Checks and opens table images (``.fkt``); ``layout.py`` describes them, ``packing.py`` makes them."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from frogkick.core.arrays import Float32, Int16, Int32, Int64
from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.tables import checks, coding, layout
from frogkick.tables.checks import AGAIN, ActionRow, Columns, TableError, require_codes, require_usable

__all__ = ["ActionRow", "TableError", "Tables", "open_image", "read_image"]

_SAME = ("provenance", "period_us", "pulse_us", "second_delay_us", "limbs", "tree_levels", "block_levels")
"""Fields that are called so in the header."""


@dataclass(frozen=True, eq=False)
class Tables:
    """A checked and decoded table image of n states, a actions and l limbs. All arrays are read-only."""

    image: bytes
    kind: str  # "nearest" or "affine"
    robot_id: str
    provenance: bytes  # SHA-256 of the library's content
    period_us: int
    pulse_us: int
    second_delay_us: int
    limbs: int  # 1 to 8
    actions: tuple[ActionRow, ...]  # in table order
    velocity_scale: Float32  # (3,) velocity per code: m/s, m/s, rad/s, body frame
    motion_scale: Float32  # (3,) motion per code: m, m, rad, body frame at the action's start
    motion_limit: Int64  # (3,) largest |motion code| that a look-up gives
    states: Int16  # (n, 3) velocity codes in k-d order
    # (n, a, 6) decoded: three motion codes, three velocity codes at the action's end; kind affine: without
    # correction and not clamped
    transitions: Int32
    derivatives: Int32  # kind affine: (n, a, 6, 3) codes per code, times 2**correction_shift; else (0, ...)
    correction_shift: Int64  # (6,) of the values
    offset_limit: Int64  # (3,) largest |query - state| of the correction, codes
    history: Int32  # (a, l, 6) codes that a fully used limb adds; kind nearest: zeros
    use_decay: int  # 1/32768: part of a limb's use that remains a period later
    use_gain: int  # 1/32768: what firing adds to it
    residual_codes: Int64  # (6,) codes per unit of a residual; values are rounded to half of it
    # (l, k, 6) codes that a transition changes where a limb has lost 1 to k of k parts of its contribution;
    # (l, 0, 6) in an image without wear curves
    limb_wear: Int32
    sections: layout.Sections
    tree_levels: int  # of the search tree over the states
    block_levels: int  # 2**block_levels blocks of rows with separate predictions (kind nearest)
    # (l,) share of its contribution that each limb has lost, 0 to 32767: no part of the image, and 0 until
    # ``worn`` says otherwise
    lost: Int64

    def __post_init__(self) -> None:
        for field in fields(self):
            if isinstance(array := getattr(self, field.name), np.ndarray):
                array = np.ascontiguousarray(array)
                array.setflags(write=False)
                object.__setattr__(self, field.name, array)

    @property
    def format_version(self) -> int:
        return layout.FORMAT_VERSION if self.limb_wear.size else layout.FORMAT_PLAIN

    @property
    def crc32(self) -> int:
        """CRC-32 of the image, as in its header and in the robot's HELLO."""
        return zlib.crc32(self.image[16:])

    @property
    def stroke_max_m(self) -> np.float32:
        """Largest motion of a look-up, m, float32 as in fk_tables_t."""
        forward, left = self.motion_limit[:2].astype(np.float32) * self.motion_scale[:2]
        return np.float32(np.sqrt(forward * forward + left * left))

    @property
    def turn_max_rad(self) -> np.float32:
        """Largest turn of a look-up, rad, float32 as in fk_tables_t."""
        return np.float32(np.float32(self.motion_limit[2]) * self.motion_scale[2])

    @property
    def fires(self) -> Int64:
        """(a, l) 1 where an action fires a limb."""
        masks = np.array([row.first_mask | row.second_mask for row in self.actions], dtype=np.int64)
        return (masks[:, None] >> np.arange(self.limbs)) & 1

    @property
    def shift(self) -> Int64:
        """(a, 6) codes that the worn limbs change of each action: the twin of wear.c."""
        if not self.limb_wear.size:
            return np.zeros((len(self.actions), 6), dtype=np.int64)
        changes = np.array([self.wear_at(limb, int(lost)) for limb, lost in enumerate(self.lost)])
        limit = layout.WEAR_CODE_MAX
        return np.asarray(np.clip(self.fires @ changes, -limit, limit), dtype=np.int64)

    def wear_at(self, limb: int, lost: int) -> Int64:
        """(6,) codes that a limb changes which has lost a share, 0 to 32767: the twin of fk_wear_curve()."""
        curve = np.concatenate([np.zeros((1, 6), dtype=np.int64), self.limb_wear[limb].astype(np.int64)])
        knots = len(curve) - 1
        knot, part = divmod(lost * knots, 2**15)
        return np.asarray(curve[knot] + (((curve[knot + 1] - curve[knot]) * part) >> 15))

    def worn(self, lost: npt.ArrayLike) -> Tables:
        """The table of a robot whose limbs have lost (l,) shares, 0 to 32767."""
        return replace(self, lost=np.array(lost, dtype=np.int64)[: self.limbs])

    def called(self, names: Sequence[str]) -> Tables:
        """The table with the robot's names of the actions, which may be longer than the image's."""
        rows = [replace(row, name=name) for row, name in zip(self.actions, names, strict=True)]
        return replace(self, actions=tuple(rows))

    def require_robot(self, robot_id: str) -> None:
        """Check that the table was made for a robot.

        Raises:
            TableError: it was made for another.
        """
        if robot_id != self.robot_id:
            raise TableError(
                f"table image is for robot {self.robot_id!r}, this robot is {robot_id!r}: "
                f"build tables from a library of {robot_id!r}"
            )


def read_image(path: Path | str) -> Tables:
    """Open a table image file; TableError for another file, InputError where there is none."""
    file = existing_file(path, "table image")
    try:
        return open_image(file.read_bytes())
    except TableError as error:
        raise TableError(f"{str(path)!r}: {error}") from None
    except OSError as error:
        raise InputError(
            f"table image {str(path)!r} cannot be read: {error.strerror}; check access"
        ) from None


def open_image(image: bytes) -> Tables:
    """Check and decode a table image; TableError for the first error in it."""
    head = checks.identified(image)
    kind = head.kind
    checks.require_counts(head.states, head.actions, head.limbs, f"the table image is wrong, {AGAIN}")
    right = checks.laid_out(head)
    robot_id = checks.robot_id_of(head.robot_id)
    checks.require_times(head.period_us, head.pulse_us, head.second_delay_us)
    checks.require_numbers(head)
    require_usable(head.zero == 0, "table image has a reserved byte that is not zero")
    actions = checks.action_rows_of(image[right.actions : right.columns], head.limbs)
    columns = checks.columns_of(image, head, right)
    wear = np.frombuffer(image[right.wear : right.splits], "<i2")
    require_codes("wear curves", wear, layout.WEAR_CODE_MAX)
    splits = np.frombuffer(image, "<i2", 2**head.tree_levels - 1, right.splits)
    require_codes("splits", splits, layout.VELOCITY_CODE_MAX)
    codes = np.frombuffer(image, "<i2", 3 * head.states, right.states).reshape(-1, 3)
    for start, used, end in (
        (right.splits, 2 * len(splits), right.models),
        (right.states, 6 * head.states, right.transitions),
        (right.transitions, head.row_bytes * head.states, right.length),
    ):
        require_usable(not any(image[start + used : end]), "table image has a padding byte that is not zero")
    coefficients = np.frombuffer(image[right.models : right.states], "<i2").astype(np.int64)
    most = np.abs(coefficients.reshape(-1, layout.COEFFICIENTS)).sum(axis=1).max(initial=0)
    good = int(most) <= layout.COEFFICIENT_SUM_MAX
    require_usable(
        good, f"table image has coefficients that sum to {most}, allowed is {layout.COEFFICIENT_SUM_MAX}"
    )
    if kind == layout.KIND_AFFINE:
        _require_affine(columns)
    require_codes("states", codes, [layout.VELOCITY_CODE_MAX >> up for up in head.up])
    axes = layout.axes_of(head.axes, head.tree_levels)
    require_usable(3 not in axes, "table image's search tree has a level without an axis")
    wrong = layout.kd_violation(codes, splits, axes)
    require_usable(wrong is None, f"table image's state {wrong} breaks the k-d order")

    residuals = coding.take_residuals(image[right.transitions :], head.states, head.row_bytes, columns.bits)
    residuals = residuals.reshape(head.states, head.actions, 6, -1)
    if kind == layout.KIND_NEAREST:
        transitions = _predicted(head, coefficients, codes, residuals[..., 0])
        derivatives = np.empty((0, head.actions, 6, 3), dtype=np.int64)
    else:
        transitions = columns.least[..., 3] + residuals[..., 3] * np.array(head.unit)
        derivatives = columns.least[..., :3] + residuals[..., :3]
    history = np.moveaxis(columns.history, 1, 2)  # actions, limbs, values
    return Tables(
        image=bytes(image),
        kind=layout.KINDS[kind],
        robot_id=robot_id,
        **{name: getattr(head, name) for name in _SAME},
        actions=actions,
        velocity_scale=np.array(head.velocity_scale, dtype=np.float32),
        motion_scale=np.array(head.motion_scale, dtype=np.float32),
        motion_limit=np.array(head.motion_limit, dtype=np.int64),
        states=codes.astype(np.int16),
        transitions=transitions.astype(np.int32),
        derivatives=derivatives.astype(np.int32),
        correction_shift=np.array(head.shift, dtype=np.int64),
        offset_limit=np.array(head.offset_limit, dtype=np.int64),
        history=history.astype(np.int32),
        use_decay=head.use[0],
        use_gain=head.use[1],
        residual_codes=np.array(head.unit, dtype=np.int64),
        limb_wear=wear.reshape(head.limbs, head.wear_knots, 6).astype(np.int32),
        sections=right,
        lost=np.zeros(head.limbs, dtype=np.int64),
    )


def _require_affine(columns: Columns) -> None:
    """Raise TableError for derivatives and history whose sums could overflow."""
    top = columns.least + (1 << np.array(layout.AFFINE_BITS)) - 1
    good = (
        int(columns.least.min()) >= -32767
        and int(top[..., :3].max()) <= 32767
        and int(columns.history.min()) >= -32767
        and int(np.abs(columns.history).sum(axis=2).max()) <= layout.HISTORY_SUM_MAX
    )
    require_usable(good, "table image has a least value, derivative or history out of range")


def _predicted(head: Any, model: Int64, codes: Int16, residuals: Int64) -> Int64:
    """Transitions of kind nearest: (n, a, 6) predictions and residuals, clamped."""
    coefficients = model.reshape(2**head.block_levels, -1, layout.COEFFICIENTS)
    factors = coding.products(codes, np.array(head.up))
    first = layout.first_rows(head.states, head.block_levels)
    values = np.empty(residuals.shape, dtype=np.int64)
    shift = np.tile(head.shift, head.actions)
    for block in range(2**head.block_levels):
        rows = slice(first[block], first[block + 1])
        predicted = coding.predictions(factors[rows], coefficients[block].T, shift)
        values[rows] = predicted.reshape(-1, head.actions, 6)
    values += residuals * np.array(head.unit)
    limit = np.array([*head.motion_limit, *[layout.VELOCITY_CODE_MAX] * 3])
    return np.clip(values, -limit, limit)
