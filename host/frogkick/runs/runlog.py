"""The log of a run in columns, of our own runs and of imported ones.

Times are monotonic seconds from the run's start. Poses are in the world frame, velocities in the body frame
except in columns whose name says `world`. `runlog_file` describes the HDF5 layout.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from functools import cache
from typing import Annotated, Any, ClassVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError
from frogkick.paths import Path

Array = NDArray[Any]


class FixFlag(enum.IntFlag):
    """Bits of `fixes/flags`."""

    UNTRUSTED_TIME = 1  # the frame is valid, but its time is not; capture_time_s is NaN
    AFTER_GAP = 2  # frames were lost before this one
    MISDETECTION = 4  # a wrong detection, so the pose is not the robot's; quality is 0
    JUMP = 8  # farther from the previous fix than the robot can move; which of the two is wrong is unknown
    MISSING = 16  # the fix was lost; its pose is NaN
    AT_REST = 32  # before the first stroke
    REPAIRED_STAMP = 64  # time_s is not the stamp in the file
    DUPLICATE = 128  # exactly the pose of the previous row, so no new picture; quality is 0


class DecisionFlag(enum.IntFlag):
    """Bits of `decisions/flags`."""

    NO_PLAN = 1  # decided without a plan; cost, estimate, predicted and plan_s are NaN
    UNSEEN = 2  # the recording does not show the action; action is -1


@dataclass(frozen=True)
class Column:
    """A dataset: unit, type, numbers per row (0: a scalar), and the flag bits of a row that allow NaN."""

    unit: str
    dtype: str
    width: int = 0
    missing_bits: int = 0
    optional: bool = False


STOOD_DECISIONS, STOOD_MPS = 10, 1e-4
STATE_UNIT = "m, m, rad, m/s, m/s, rad/s"


@dataclass(frozen=True, eq=False)
class _Group:
    """Columns of equal length, checked when made.

    Attributes:
        time_s: (n,) s, not decreasing.
        extra: further columns of n rows; the end of a name is its unit.
    """

    NAME: ClassVar[str]
    time_s: Annotated[Array, Column("s", "<f8")]
    extra: Mapping[str, Array] = field(default_factory=dict, kw_only=True)

    @classmethod
    @cache
    def columns(cls) -> dict[str, Column]:
        """The columns by name, without the extra ones."""
        hints = get_type_hints(cls, include_extras=True).items()
        return {name: hint.__metadata__[0] for name, hint in hints if hasattr(hint, "__metadata__")}

    def __post_init__(self) -> None:
        flags = getattr(self, "flags", None)
        flags = None if flags is None else np.asarray(flags)
        checked: dict[str, Array] = {}
        for name, column in self.columns().items():
            given = getattr(self, name)
            if given is None and column.optional:
                continue
            values = _as_column(self.NAME, name, given, column)
            count = len(checked.get("time_s", values))
            checked[name] = _checked(self.NAME, name, values, count, flags, column.missing_bits)
        extra: dict[str, Array] = {}
        missing_bits = FixFlag.MISSING if self.NAME == "fixes" else 0xFFFF
        for name, given in self.extra.items():
            values = np.asarray(given)
            if values.dtype.kind not in "iufb" or values.ndim == 0:
                raise InputError(f"run: {self.NAME}/{name} holds {values.dtype}: give a column of numbers")
            extra[name] = _checked(self.NAME, name, values, len(checked["time_s"]), flags, missing_bits)
        for name, fixed in {**checked, "extra": extra}.items():
            object.__setattr__(self, name, fixed)
        back = np.flatnonzero(np.diff(self.time_s) < 0.0)
        if back.size:
            row = int(back[0]) + 1
            raise InputError(
                f"run: {self.NAME}/time_s row {row} goes back from {self.time_s[row - 1]:.6f} to "
                f"{self.time_s[row]:.6f} s: sort the rows or cut the run there"
            )

    def all_columns(self) -> dict[str, Array]:
        """The columns that there are, by name, and after them the extra ones in the order of their names."""
        own = {name: getattr(self, name) for name in self.columns()}
        there = {name: values for name, values in own.items() if values is not None}
        return there | dict(sorted(self.extra.items()))

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, eq=False)
class Fixes(_Group):
    """Position fixes in order of arrival.

    Attributes:
        time_s: (n,) arrival at the logger.
        capture_time_s: (n,) time at which the picture was taken; NaN only where flagged UNTRUSTED_TIME or
            MISSING.
        x_m, y_m: (n,) position, world frame; NaN only where flagged MISSING.
        heading_rad: (n,) heading, world frame, in (-pi, pi]; NaN only where flagged MISSING.
        quality: (n,) 1, or 0 for a fix that must not be used.
        flags: (n,) bits of FixFlag.
    """

    NAME = "fixes"
    capture_time_s: Annotated[
        Array, Column("s", "<f8", missing_bits=FixFlag.UNTRUSTED_TIME | FixFlag.MISSING)
    ]
    x_m: Annotated[Array, Column("m", "<f8", missing_bits=FixFlag.MISSING)]
    y_m: Annotated[Array, Column("m", "<f8", missing_bits=FixFlag.MISSING)]
    heading_rad: Annotated[Array, Column("rad", "<f8", missing_bits=FixFlag.MISSING)]
    quality: Annotated[Array, Column("1", "u1")]
    flags: Annotated[Array, Column("bits", "<u2")]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(n,) rows with quality 1 and a time that can be trusted."""
        unknown = self.flags & int(FixFlag.UNTRUSTED_TIME | FixFlag.MISSING)
        return np.asarray((self.quality == 1) & (unknown == 0))

    @property
    def pose_world(self) -> NDArray[np.float64]:
        """(n, 3) x_m, y_m, heading_rad."""
        return np.column_stack([self.x_m, self.y_m, self.heading_rad])


@dataclass(frozen=True, eq=False)
class Decisions(_Group):
    """Decisions, one row per period.

    Attributes:
        time_s: (n,) time of the decision.
        action: (n,) index into the actions' names; -1 only where flagged UNSEEN.
        fix_sequence: (n,) row of `fixes` that was the newest one; -1 without one.
        flags: (n,) bits of DecisionFlag.
        cost: (n,) cost of the chosen sequence of actions; None if the run has none.
        estimate: (n, 6) estimated state: x, y, heading (world frame), forward, left velocity, turn rate (body
            frame); None if the run has none.
        predicted: (n, 6) the state predicted for the end of the period, likewise; None if the run has none.
        plan_s: (n,) computing time of the planner; None if the run has none.
    """

    NAME = "decisions"
    action: Annotated[Array, Column("index", "<i2")]
    fix_sequence: Annotated[Array, Column("row of fixes", "<i8")]
    flags: Annotated[Array, Column("bits", "<u2")]
    cost: Annotated[Array | None, Column("1", "<f8", 0, DecisionFlag.NO_PLAN, optional=True)] = None
    estimate: Annotated[Array | None, Column(STATE_UNIT, "<f8", 6, DecisionFlag.NO_PLAN, optional=True)] = (
        None
    )
    predicted: Annotated[Array | None, Column(STATE_UNIT, "<f8", 6, DecisionFlag.NO_PLAN, optional=True)] = (
        None
    )
    plan_s: Annotated[Array | None, Column("s", "<f8", 0, DecisionFlag.NO_PLAN, optional=True)] = None


@dataclass(frozen=True, eq=False)
class Strokes(_Group):
    """Pulses of the limbs.

    Attributes:
        time_s: (n,) start of the pulse.
        limb_mask: (n,) limbs that are heated: bit i for limb i.
        pulse_s: (n,) duration of the pulse.
    """

    NAME = "strokes"
    limb_mask: Annotated[Array, Column("bits", "u1")]
    pulse_s: Annotated[Array, Column("s", "<f8")]


@dataclass(frozen=True, eq=False)
class Truth(_Group):
    """The robot's true motion in a simulated pool, which neither planner nor identification reads.

    Attributes:
        time_s: (n,) time in the run.
        pose_world: (n, 3) true x, y, heading, world frame.
        velocity_body: (n, 3) true forward, left velocity and turn rate, body frame.
    """

    NAME = "truth"
    pose_world: Annotated[Array, Column("m, m, rad", "<f8", 3)]
    velocity_body: Annotated[Array, Column("m/s, m/s, rad/s", "<f8", 3)]


@dataclass(frozen=True, eq=False)
class PathChange:
    """A path that took over during a run."""

    decision: int  # its first decision; -1 in the log of a run that has not reached it yet
    path: Path  # the path
    # of a path that holds at the end of the previous one: x and y of that end, m, world, and the index of the
    # path's first point on the circle around it; None: an ordinary path
    hold: tuple[float, float, int] | None = None


@dataclass(frozen=True)
class Tracking:
    """How well a run followed its path, from the first decision to the end.

    Distances are from the path's polyline to the true poses (simulated runs) or to the fixes.
    ``limit_violations`` is None if the pins were not seen. ``plan_ms_p99`` is None where planning takes no
    time of the run: in the simulated pool, whose clock stands still meanwhile.
    """

    mean_distance_m: float
    p95_distance_m: float
    progress_mps: float
    completed: bool
    decisions: int
    fixes_lost: int
    limit_violations: int | None
    plan_ms_p99: float | None

    @property
    def stood(self) -> bool:
        """Whether many decisions gave less than 0.1 mm/s of progress."""
        return not self.completed and self.decisions >= STOOD_DECISIONS and self.progress_mps < STOOD_MPS

    def as_json(self) -> dict[str, Any]:
        """Keys of the command ``run``."""
        return asdict(self)


def _is_moment(text: str) -> bool:
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


@dataclass(frozen=True, eq=False)
class RunLog:
    """A run.

    Attributes:
        robot_id: the robot ("frog2022").
        source: name of the file or program it comes from, without folders.
        period_s, pulse_s: s, both above 0.
        action_names: names of the actions in `decisions.action`.
        table_crc: CRC-32 of the planner's table image, or None.
        seed: of the simulation, or None.
        notes: free text.
        path: the path from the first decision on, or None.
        then: paths that took its place, in the order of their decisions.
        measured: numbers about the run (name with unit suffix -> finite value).
        planner: the planner's weights and depth (field of PlanConfig -> finite value), where known.
        made: provenance as texts, where known: ``began_at`` (UTC at a real run's time 0, ISO 8601),
            ``frogkick`` (its version), ``robot_toml``, ``robot_sha256``, ``table_sha256``, ``command``; and,
            for a run that estimated wear, ``learn``: the names of the limbs. Its decisions have a further
            column ``lost`` (n, 8), for each limb, 0 to 32767.
        tracked: how well the path was followed, as measured during the run; None: of a log from a file.
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
    then: tuple[PathChange, ...] = ()
    truth: Truth | None = None
    table_crc: int | None = None
    seed: int | None = None
    notes: str = ""
    measured: Mapping[str, float] = field(default_factory=dict)
    planner: Mapping[str, float] = field(default_factory=dict)
    made: Mapping[str, str] = field(default_factory=dict)
    tracked: Tracking | None = None

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
        changed = [change.decision for change in self.then]
        if changed != sorted(changed) or not all(-1 <= row < len(self.decisions) for row in changed):
            raise InputError(
                f"run: its paths change at the decisions {changed}, of {len(self.decisions)}: correct them"
            )
        wrong = np.flatnonzero(
            (self.decisions.fix_sequence < -1) | (self.decisions.fix_sequence >= len(self.fixes))
        )
        if wrong.size:
            raise InputError(
                f"run: decisions/fix_sequence row {wrong[0]} is {self.decisions.fix_sequence[wrong[0]]}, "
                f"the run has {len(self.fixes)} fixes: correct it or give -1"
            )

    @property
    def paths(self) -> list[tuple[float, Path]]:
        """Every path that was followed, with its first time, s; -inf for the first path."""
        first = [] if self.path is None else [(-math.inf, self.path)]
        return first + [(float(self.decisions.time_s[change.decision]), change.path) for change in self.then]

    def decided(self, unseen: str = "?") -> list[str]:
        """Name of each decision's action; ``unseen`` where it is not known."""
        return [self.action_names[index] if index >= 0 else unseen for index in self.decisions.action]


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


def _checked(
    group: str, name: str, values: Array, count: int, flags: Array | None, missing_bits: int
) -> Array:
    """A copy of a column of ``count`` rows that cannot be written to."""
    if len(values) != count:
        raise InputError(f"run: {group}/{name} has {len(values)} rows, time_s has {count}: make them equal")
    copy = np.array(values)
    copy.flags.writeable = False
    if copy.dtype.kind != "f":
        return copy
    bad = ~np.isfinite(copy).reshape(count, math.prod(copy.shape[1:])).all(axis=1)
    if flags is not None and missing_bits:
        bad &= (flags.astype(np.int64) & int(missing_bits)) == 0
    rows = np.flatnonzero(bad)
    if rows.size:
        raise InputError(
            f"run: {group}/{name} row {rows[0]} is {values[rows[0]]} (not finite) and not flagged "
            "as missing: repair the log or flag the row"
        )
    return copy
