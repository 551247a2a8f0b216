"""The log of a run: the same columns for ours (on board, in the pool) and for imported ones.

Times are monotonic seconds from the run's start; poses are in the world frame, velocities in the body frame
except columns whose name says `world`. `runlog_file` has the HDF5 layout.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError
from frogkick.paths import Path

Array = NDArray[Any]


class FixFlag(enum.IntFlag):
    """Bits of `fixes/flags`."""

    UNTRUSTED_TIME = 1  # the frame is real, its time is not: capture_time_s is NaN
    AFTER_GAP = 2  # more frames were lost before this one than the usual spacing has
    MISDETECTION = 4  # the pose is not the robot's: quality is 0
    JUMP = 8  # farther from its neighbour than the robot can go, and which of both is wrong is unknown
    MISSING = 16  # the fix was lost: its pose is NaN
    AT_REST = 32  # before the first stroke
    REPAIRED_STAMP = 64  # time_s is not the stamp in the file
    DUPLICATE = 128  # the very pose of the row before, so no new picture: quality is 0


class DecisionFlag(enum.IntFlag):
    """Bits of `decisions/flags`."""

    NO_PLAN = 1  # decided without a plan: cost, estimate, predicted and plan_s are NaN
    UNSEEN = 2  # nothing in the record shows which action it was: action is -1


@dataclass(frozen=True)
class Column:
    """What one dataset holds: unit, type, numbers per row, and the flag bits of a row that allow NaN."""

    unit: str
    dtype: str
    width: int = 0
    missing_bits: int = 0
    optional: bool = False


STATE_UNIT = "m, m, rad, m/s, m/s, rad/s"
_FIXES = {
    "time_s": Column("s", "<f8"),
    "capture_time_s": Column("s", "<f8", missing_bits=FixFlag.UNTRUSTED_TIME | FixFlag.MISSING),
    "x_m": Column("m", "<f8", missing_bits=FixFlag.MISSING),
    "y_m": Column("m", "<f8", missing_bits=FixFlag.MISSING),
    "heading_rad": Column("rad", "<f8", missing_bits=FixFlag.MISSING),
    "quality": Column("1", "u1"),
    "flags": Column("bits", "<u2"),
}
_DECISIONS = {
    "time_s": Column("s", "<f8"),
    "action": Column("index", "<i2"),
    "fix_sequence": Column("row of fixes", "<i8"),
    "flags": Column("bits", "<u2"),
    "cost": Column("1", "<f8", missing_bits=DecisionFlag.NO_PLAN, optional=True),
    "estimate": Column(STATE_UNIT, "<f8", 6, DecisionFlag.NO_PLAN, optional=True),
    "predicted": Column(STATE_UNIT, "<f8", 6, DecisionFlag.NO_PLAN, optional=True),
    "plan_s": Column("s", "<f8", missing_bits=DecisionFlag.NO_PLAN, optional=True),
}
_STROKES = {
    "time_s": Column("s", "<f8"),
    "limb_mask": Column("bits", "u1"),
    "pulse_s": Column("s", "<f8"),
}
_TRUTH = {
    "time_s": Column("s", "<f8"),
    "pose_world": Column("m, m, rad", "<f8", 3),
    "velocity_body": Column("m/s, m/s, rad/s", "<f8", 3),
}


class _Group:
    """Columns of equal length, checked when made; `extra` holds additional ones."""

    SCHEMA: ClassVar[Mapping[str, Column]]
    NAME: ClassVar[str]
    extra: Mapping[str, Array]

    def __post_init__(self) -> None:
        count = -1
        flags: Array | None = None
        if "flags" in self.SCHEMA:
            flags = np.asarray(self.flags)  # type: ignore[attr-defined]
        for name, column in self.SCHEMA.items():
            given = getattr(self, name)
            if given is None and column.optional:
                continue
            values = _as_column(self.NAME, name, given, column)
            count = len(values) if count < 0 else count
            if len(values) != count:
                raise InputError(
                    f"run: {self.NAME}/{name} has {len(values)} rows, time_s has {count}: make them equal"
                )
            _check_finite(self.NAME, name, values, flags, column.missing_bits)
            object.__setattr__(self, name, _frozen(values))
        extra = {}
        for name, given in self.extra.items():
            values = np.asarray(given)
            if values.dtype.kind not in "iufb" or values.ndim == 0:
                raise InputError(f"run: {self.NAME}/{name} holds {values.dtype}: give a column of numbers")
            if len(values) != count:
                raise InputError(
                    f"run: {self.NAME}/{name} has {len(values)} rows, time_s has {count}: make them equal"
                )
            if values.dtype.kind == "f":
                _check_finite(
                    self.NAME, name, values, flags, FixFlag.MISSING if self.NAME == "fixes" else 0xFFFF
                )
            extra[name] = _frozen(values)
        object.__setattr__(self, "extra", extra)
        time = np.asarray(self.time_s)  # type: ignore[attr-defined]
        back = np.flatnonzero(np.diff(time) < 0.0)
        if back.size:
            row = int(back[0]) + 1
            raise InputError(
                f"run: {self.NAME}/time_s row {row} goes back from {time[row - 1]:.6f} to {time[row]:.6f} s: "
                "sort the rows or cut the run there"
            )

    def __len__(self) -> int:
        return len(self.time_s)  # type: ignore[attr-defined]


@dataclass(frozen=True, eq=False)
class Fixes(_Group):
    """Position fixes in order of arrival.

    Args:
        time_s: (n,) s, arrival at the logger, not decreasing.
        capture_time_s: (n,) s, when the picture was taken; NaN only where flagged UNTRUSTED_TIME or MISSING.
        x_m, y_m, heading_rad: (n,) world; heading in (-pi, pi]; NaN only where flagged MISSING.
        quality: (n,) 0 (do not use) or 1.
        flags: (n,) FixFlag bits.
        extra: further columns of n rows, unit in the name's suffix.
    """

    SCHEMA = _FIXES
    NAME = "fixes"
    time_s: Array
    capture_time_s: Array
    x_m: Array
    y_m: Array
    heading_rad: Array
    quality: Array
    flags: Array
    extra: Mapping[str, Array] = field(default_factory=dict)

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(n,) rows with quality 1 and a time that can be trusted."""
        unknown = self.flags & int(FixFlag.UNTRUSTED_TIME | FixFlag.MISSING)
        return np.asarray((self.quality == 1) & (unknown == 0))


@dataclass(frozen=True, eq=False)
class Decisions(_Group):
    """What was decided, one row per period.

    Args:
        time_s: (n,) s.
        action: (n,) index into RunLog.action_names, -1 only where flagged UNSEEN.
        fix_sequence: (n,) row of `fixes` that was the newest, -1 where none was.
        flags: (n,) DecisionFlag bits.
        cost, plan_s: (n,) or None where the run has none.
        estimate, predicted: (n,6) x m, y m, heading rad (world), vx, vy m/s, omega rad/s (body), or None.
        extra: further columns of n rows.
    """

    SCHEMA = _DECISIONS
    NAME = "decisions"
    time_s: Array
    action: Array
    fix_sequence: Array
    flags: Array
    cost: Array | None = None
    estimate: Array | None = None
    predicted: Array | None = None
    plan_s: Array | None = None
    extra: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Strokes(_Group):
    """Pulses: time_s (n,), limb_mask (n,) bit i = limb i, pulse_s (n,)."""

    SCHEMA = _STROKES
    NAME = "strokes"
    time_s: Array
    limb_mask: Array
    pulse_s: Array
    extra: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Truth(_Group):
    """What a simulated pool knows: time_s (n,), pose_world (n,3), velocity_body (n,3)."""

    SCHEMA = _TRUTH
    NAME = "truth"
    time_s: Array
    pose_world: Array
    velocity_body: Array
    extra: Mapping[str, Array] = field(default_factory=dict)


def _is_moment(text: str) -> bool:
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


@dataclass(frozen=True, eq=False)
class RunLog:
    """A whole run.

    Args:
        robot_id: which robot ("frog2022").
        source: name of the file or program it comes from, without folders.
        period_s, pulse_s: s, both above 0.
        action_names: names that `decisions.action` counts.
        table_crc: CRC-32 of the table image that planned, or None.
        seed: of the simulation, or None.
        notes: free text.
        measured: numbers about the run (name with unit suffix -> finite value).
        planner: weights and depth that decided (field of PlanConfig -> finite value), where they are known.
        made: how it came about, as texts: ``began_at`` (UTC at the log's time 0, ISO 8601), ``frogkick`` (its
            version), ``robot_toml``, ``robot_sha256``, ``table_sha256``, ``command``; not all are always
            known.
    """

    robot_id: str
    source: str
    period_s: float
    pulse_s: float
    action_names: tuple[str, ...]
    fixes: Fixes
    decisions: Decisions
    strokes: Strokes
    path: Path | None = None
    truth: Truth | None = None
    table_crc: int | None = None
    seed: int | None = None
    notes: str = ""
    measured: Mapping[str, float] = field(default_factory=dict)
    planner: Mapping[str, float] = field(default_factory=dict)
    made: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("period_s", "pulse_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"run: {name} is {value}: give a finite time above 0 s")
        if "/" in self.source or "\\" in self.source:
            raise InputError(f"run: source {self.source!r} has folders in it: give the file's name only")
        began_at = self.made.get("began_at")
        if began_at is not None and not _is_moment(began_at):
            raise InputError(f"run: made/began_at is {began_at!r}: give it as 2026-03-01T12:00:00+00:00")
        for group in ("measured", "planner"):
            for name, number in getattr(self, group).items():
                if not math.isfinite(number):
                    raise InputError(f"run: {group} {name} is {number}: give a finite number or leave it out")
        action, flags = self.decisions.action, self.decisions.flags
        unseen = (flags & int(DecisionFlag.UNSEEN)) != 0
        wrong = np.flatnonzero(
            np.where(unseen, action != -1, (action < 0) | (action >= len(self.action_names)))
        )
        if wrong.size:
            raise InputError(
                f"run: decisions/action row {wrong[0]} is {action[wrong[0]]}, the run names "
                f"{len(self.action_names)} actions: correct the action or its UNSEEN flag"
            )
        wrong = np.flatnonzero(
            (self.decisions.fix_sequence < -1) | (self.decisions.fix_sequence >= len(self.fixes))
        )
        if wrong.size:
            raise InputError(
                f"run: decisions/fix_sequence row {wrong[0]} is {self.decisions.fix_sequence[wrong[0]]}, "
                f"the run has {len(self.fixes)} fixes: correct it or give -1"
            )


def _as_column(group: str, name: str, given: Any, column: Column) -> Array:
    values = np.asarray(given)
    if values.size == 0:
        values = np.zeros((0, column.width) if column.width else (0,))
    shape = (len(values), column.width) if column.width else (values.size,)
    if values.shape != shape or values.dtype.kind not in "iufb":
        raise InputError(
            f"run: {group}/{name} has shape {values.shape} of {values.dtype}, "
            f"expected {shape} numbers: correct it"
        )
    if np.dtype(column.dtype).kind in "iu" and values.size:
        limits = np.iinfo(column.dtype)
        beyond = np.flatnonzero(~((values >= limits.min) & (values <= limits.max)))
        if beyond.size:
            raise InputError(
                f"run: {group}/{name} row {beyond[0]} is {values[beyond[0]]}, the limits are {limits.min} to "
                f"{limits.max}: correct it"
            )
    return values.astype(column.dtype)


def _check_finite(group: str, name: str, values: Array, flags: Array | None, missing_bits: int) -> None:
    if values.dtype.kind != "f":
        return
    bad = ~np.isfinite(values).reshape(len(values), math.prod(values.shape[1:])).all(axis=1)
    if flags is not None and missing_bits:
        bad &= (flags.astype(np.int64) & int(missing_bits)) == 0
    rows = np.flatnonzero(bad)
    if rows.size:
        raise InputError(
            f"run: {group}/{name} row {rows[0]} is {values[rows[0]]} (not finite) and not flagged "
            "as missing: repair the log or flag the row"
        )


def _frozen(values: Array) -> Array:
    copy = np.array(values)
    copy.flags.writeable = False
    return copy
