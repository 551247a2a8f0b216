"""A run as identification needs it: trusted fixes, strokes, and periods on the fixes' clock."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from frogkick.core.arrays import AnyArray, Bool, Float64, Int64
from frogkick.core.errors import InputError
from frogkick.identification.filter import Filter, Noise, initial_rate_std
from frogkick.robot import Robot
from frogkick.runs.recorded.importer import clock_problem, load_run
from frogkick.runs.runlog import FixFlag, RunLog

LEAD_S = 1.0  # how long before the first stroke the simulation starts
ACTUATION_S = 0.3  # a limb pushes hardest within this time after its pulse starts

_END_BEFORE_S, _END_AFTER_S = 0.24, 0.03
"""Fixes from this time before a period's end to this time after it determine the pose there: the robot
glides. If they are too few, those from twice as long before count as well."""

SPEED_MOST_MPS = 1.0
"""The median speed from fix to fix is lower in any pool; above it positions must be in another unit."""

AGE_OFF_S, AGE_SHARE = 1.0, 0.05
"""At most this share of the fixes may be older than the others by this time, because they were delayed."""

_STILL = 8  # number of fixes at rest that distinguish one camera's noise from another's

_UNTIMED = int(FixFlag.UNTRUSTED_TIME | FixFlag.AT_REST)
_REST_BLOCK_S = 1.0  # means over this time at rest are compared: the noise of the fixes is small in them

FOLDS_MIN = 4  # fewer runs than this are cut into parts for the folds of a cross-validation

PERIODS_LEAST, ACTIONS_LEAST, MOTION_LEAST_M = 20, 2, 0.01
"""Periods, different actions, and extent of the motion along an axis that a search needs at least."""

_ABSENT = int(FixFlag.MISSING | FixFlag.DUPLICATE)
_SPOILED = _ABSENT | int(FixFlag.MISDETECTION | FixFlag.JUMP)


@dataclass(frozen=True, eq=False)
class Segments:
    """The segments of one run, one for each period, with the run's fixes and strokes."""

    name: str  # name of the run's file
    robot_id: str  # id of its robot
    action_names: tuple[str, ...]  # names of the actions that ``action`` indexes
    time_s: Float64  # (n,) capture times of the usable fixes
    arrival_s: Float64  # (n,) arrival time of each fix
    pose: Float64  # (n, 3) x, y (m), heading (rad, not wrapped), world frame
    # (time_s, limb index) of each stroke, in order, on the fixes' clock
    strokes: tuple[tuple[float, int], ...]
    start_s: Float64  # (m,) start of each period on the fixes' clock
    action: Int64  # (m,) action of each period; -1: unknown
    end_s: Float64  # (m,) end of each period
    period_s: float  # period of the run
    lag_s: float  # delay from a command's time in the log to its motion on the fixes' clock, already added
    problem: str = ""  # why the times of its strokes are unreliable; "" if they are reliable
    # (m/s, m/s, rad/s) root mean square velocity of the robot at rest, from frames before the first stroke
    # that came in order but without known times; None without enough of these
    rest_rate: tuple[float, float, float] | None = None
    judged_from: int = 0  # only this period and later ones are judged

    def first_periods(self, count: int) -> Segments:
        """The run with the first ``count`` periods; its fixes and strokes stay."""
        cut = {name: getattr(self, name)[:count] for name in ("start_s", "end_s", "action")}
        return replace(self, **cut)

    def with_fixes(self, kept: Bool) -> Segments:
        """The run with some of its fixes."""
        return replace(self, **{name: getattr(self, name)[kept] for name in ("time_s", "arrival_s", "pose")})

    @cached_property
    def begin_s(self) -> float:
        """Start of the simulation: a fix at most LEAD_S before the first stroke or period."""
        first = min([self.start_s[0], *(time_s for time_s, _ in self.strokes[:1])])
        return float(self.time_s[min(np.searchsorted(self.time_s, first - LEAD_S), len(self.time_s) - 1)])

    @cached_property
    def actuated_s(self) -> Float64:
        """(2, k) knots: time, and cumulative actuation time by then."""
        knots, total, until = [(self.begin_s - 1e3, 0.0)], 0.0, -math.inf
        for time_s, _ in self.strokes:
            start = max(time_s, until)
            if start > until:
                knots.append((start, total))
            if time_s + ACTUATION_S > start:
                total += time_s + ACTUATION_S - start
                until = time_s + ACTUATION_S
                knots.append((until, total))
        return np.array([*knots, (knots[-1][0] + 1e6, total)]).T

    @cached_property
    def segment_times_s(self) -> Float64:
        """Times at which fixes correct the simulation: all starts and ends of periods."""
        times = [float(time) for time in self.start_s if time > self.begin_s]
        times += [float(end) for end in self.end_s if end > self.begin_s]
        kept: list[float] = []
        for time in sorted(times):
            if not kept or time - kept[-1] > 1e-6:
                kept.append(time)
        return np.array(kept)

    def fired_s(self, limbs: int) -> Float64:
        """(m, limbs) time of each limb's first stroke in each period, s; NaN if it did not fire."""
        found = np.full((len(self.start_s), limbs), np.nan)
        for time_s, limb in reversed(self.strokes):
            found[(self.start_s - 1e-6 <= time_s) & (time_s < self.end_s - 1e-6), limb] = time_s
        return found

    def states_at_starts(self, noise: Noise) -> Iterator[tuple[float, Float64]]:
        """Time and covariance (see ``Filter``) of the state of a perfect simulation at each period's start.

        The simulation agrees with all fixes, and those count that have arrived by then.
        """
        state = Filter(noise, self.actuated_s, self.begin_s, initial_rate_std(self.rest_rate))
        order, next_fix = np.argsort(self.arrival_s, kind="stable"), 0
        for start_s in self.start_s:
            while next_fix < len(order) and self.arrival_s[order[next_fix]] <= start_s:
                state.update(float(self.time_s[order[next_fix]]), np.zeros(3))
                next_fix += 1
            yield state.time_s, state.covariance

    @cached_property
    def measured(self) -> Float64:
        """(m, 3) pose at the ends of the judged periods, from the fixes around; NaN if there are too few."""
        ends = [self.pose_at(float(end)) for end in self.end_s]
        return np.array([np.full(3, np.nan)] * self.judged_from + ends[self.judged_from :]).reshape(-1, 3)

    @cached_property
    def end_noise(self) -> Float64:
        """(m,) variance of the poses in ``measured`` over that of a fix; NaN where one is not known."""
        found = np.full(len(self.end_s), np.nan)
        for k, end in enumerate(self.end_s):
            near = self._near(float(end))
            if near is not None and np.isfinite(self.measured[k]).all():
                design = near[1]
                found[k] = np.linalg.pinv(design.T @ design)[0, 0]
        return found

    def pose_at(self, at_s: float) -> Float64:
        """(3,) pose at a time by a line through the fixes around, most of them before; NaN if too few."""
        near = self._near(at_s)
        if near is None:
            return np.full(3, np.nan)
        line, *_ = np.linalg.lstsq(near[1], self.pose[near[0]], rcond=None)
        return np.asarray(line[0])

    def _near(self, at_s: float) -> tuple[Bool, Float64] | None:
        """Which fixes determine a pose, and the (n, 2) design matrix of a line; None if there are too few."""
        for before_s in (_END_BEFORE_S, 2.0 * _END_BEFORE_S):
            near = (self.time_s >= at_s - before_s) & (self.time_s <= at_s + _END_AFTER_S)
            if near.sum() >= 3:
                return near, np.column_stack([np.ones(near.sum()), self.time_s[near] - at_s])
        return None


@dataclass(frozen=True, eq=False)
class Data:
    """The runs that models are fitted to."""

    swims: Sequence[Segments]  # the runs
    rows: Bool  # (m,) which of all their periods count; n of them do

    def used(self, parts: Iterable[ArrayLike]) -> AnyArray:
        """(n, ...) values of the periods that count, from the (m_k, ...) values of each run's periods."""
        return np.asarray(np.concatenate([*parts])[self.rows])

    @cached_property
    def run(self) -> Int64:
        """(n,) index of the run of each period."""
        return self.used(np.full(len(swim.start_s), k) for k, swim in enumerate(self.swims))

    @cached_property
    def order(self) -> Int64:
        """(n,) number of each period in its run."""
        return self.used(np.arange(len(swim.start_s)) for swim in self.swims)

    @cached_property
    def folds(self) -> Int64:
        """(n,) cross-validation fold of each period: a run, or a stretch of one where runs are few."""
        parts = -(-FOLDS_MIN // max(len(self.swims), 1))
        counts = [len(swim.start_s) for swim in self.swims]
        return self.used(
            index * parts + parts * np.arange(count) // max(count, 1) for index, count in enumerate(counts)
        )

    @cached_property
    def replicate_count(self) -> int:
        """Runs that are replicates with the same noise: their gain counts once."""
        return replicate_count(self.swims)


def read_segments(path: Path | str, robot: Robot | None = None) -> Segments:
    """Read a run, a log of ours or a recorded run of the paper; see ``segments_of``."""
    return segments_of(load_run(path), Path(path).name, robot)


def segments_of(run: RunLog, name: str, robot: Robot | None = None) -> Segments:
    """A run's fixes, strokes and periods on one clock.

    If the log does not know when pictures were taken (its capture times are arrival times), the delay between
    a command and its motion is estimated from the motion and added to the times of commands.

    Raises:
        InputError: the run is another robot's, its limbs cannot be this robot's, or its units are wrong.
    """
    if robot is not None:
        if not robot.swam(run.robot_id):
            raise InputError(
                f"run {name!r} is of robot {run.robot_id!r}, the model is {robot.id!r}: "
                "give --robot or other runs"
            )
        if len(run.strokes) and int(run.strokes.limb_mask.max()) >= 1 << len(robot.limbs):
            raise InputError(
                f"run {name!r} fires limb {int(run.strokes.limb_mask.max()).bit_length() - 1}, robot "
                f"{robot.id!r} has {len(robot.limbs)} limbs: give --robot"
            )
    fixes = run.fixes
    usable = fixes.usable & ((fixes.flags & _SPOILED) == 0)
    time_s, arrival_s = fixes.capture_time_s[usable], fixes.time_s[usable]
    order = np.argsort(time_s, kind="stable")
    pose = np.column_stack([fixes.x_m[usable], fixes.y_m[usable], fixes.heading_rad[usable]])[order]
    # Fixes that the import took for jumps are included: in another unit all of them are.
    seen = fixes.usable & ((fixes.flags & _ABSENT) == 0)
    late = np.argsort(fixes.capture_time_s[seen], kind="stable")
    shown = np.column_stack([fixes.x_m[seen], fixes.y_m[seen], fixes.heading_rad[seen]])[late]
    _check_units(name, fixes.capture_time_s[seen][late], shown)
    _check_clock(name, arrival_s - time_s)
    pose[:, 2] = np.unwrap(pose[:, 2])
    has_capture_times = len(time_s) > 0 and not np.allclose(time_s, arrival_s, atol=1e-9)
    lag_s = 0.0 if has_capture_times else float(run.measured.get("motion_lag_s", 0.0))
    strokes = sorted(
        (float(at_s) + lag_s, limb)
        for at_s, mask in zip(run.strokes.time_s, run.strokes.limb_mask, strict=True)
        for limb in range(8)
        if int(mask) >> limb & 1
    )
    start_s = run.decisions.time_s + lag_s
    last_s = float(time_s.max()) if len(time_s) else -math.inf
    ends = np.append(start_s[1:], np.inf)
    end_s = np.where(np.abs(ends - start_s - run.period_s) < 0.2 * run.period_s, ends, start_s + run.period_s)
    # If a clock slipped, the period before may be cut short: another stroke falls into it.
    whole = (end_s <= last_s + _END_AFTER_S) & (ends > end_s - 1e-9)
    made = Segments(
        name=name,
        robot_id=run.robot_id,
        action_names=run.action_names,
        time_s=time_s[order],
        arrival_s=arrival_s[order],
        pose=pose,
        strokes=tuple(strokes),
        start_s=start_s[whole],
        action=np.asarray(run.decisions.action[whole], dtype=np.int64),
        end_s=end_s[whole],
        period_s=run.period_s,
        lag_s=lag_s,
        problem=clock_problem(run),
        rest_rate=_rest_rate(run, time_s[order]),
    )
    if len(made.start_s) and not np.isfinite(made.measured).all(axis=1).any():
        raise InputError(f"run {name!r}: {_nothing_compared(run, time_s)}")
    return made


def _nothing_compared(run: RunLog, time_s: Float64) -> str:
    """Why no period of a run ends at fixes; ``time_s`` are those of its fixes."""
    strokes_s = run.decisions.time_s
    lies = f"at {time_s.min():.1f} to {time_s.max():.1f} s" if len(time_s) else "nowhere"
    return (
        f"none of its {len(strokes_s)} strokes has position fixes at the end of its period: its strokes lie "
        f"at {strokes_s.min():.1f} to {strokes_s.max():.1f} s, its fixes {lies}; give both on one clock, in "
        "seconds"
    )


def reliable(swims: Sequence[Segments]) -> tuple[list[Segments], list[dict[str, str]]]:
    """Runs whose strokes have reliable times (an InputError without any), and the others: run and reason."""
    kept = [swim for swim in swims if not swim.problem]
    if swims and not kept:
        raise InputError(f"run {swims[0].name!r} cannot be used: {swims[0].problem}: give other runs")
    return kept, [{"run": swim.name, "reason": swim.problem} for swim in swims if swim.problem]


def too_little(swims: Sequence[Segments]) -> str:
    """Why runs are too little data, and what to record; "" if they suffice."""
    periods = sum(len(swim.start_s) for swim in swims)
    if periods < PERIODS_LEAST:
        return (
            f"the runs have {periods} whole periods with fixes, but {PERIODS_LEAST} are needed: record about "
            f"{PERIODS_LEAST - periods} periods more"
        )
    actions = {int(action) for swim in swims for action in swim.action if action >= 0}
    if len(actions) < ACTIONS_LEAST:
        return "the runs contain only one action: record one that turns both ways, or actions in random order"
    reach = max(float(np.ptp(swim.pose[:, :2], axis=0).max()) for swim in swims if len(swim.pose))
    if reach < MOTION_LEAST_M:
        return f"the robot moved {1e3 * reach:.1f} mm: record a run that swims (or check the fixes' unit)"
    return ""


def part_of(swims: Sequence[Segments], periods: int) -> list[Segments]:
    """The first periods of each run, the same share of each, ``periods`` in total."""
    share = min(1.0, periods / max(sum(len(swim.start_s) for swim in swims), 1))
    some = [swim.first_periods(round(share * len(swim.start_s))) for swim in swims]
    return [swim for swim in some if len(swim.start_s)]


def _rest_rate(run: RunLog, time_s: Float64) -> tuple[float, float, float] | None:
    """See Segments.rest_rate; frames are taken to be as far apart as those whose times are known."""
    fixes = run.fixes
    rest = (fixes.flags & _UNTIMED) == _UNTIMED
    rest &= (fixes.flags & _SPOILED) == 0
    if len(time_s) < _STILL:
        return None
    spacing_s = float(np.median(np.diff(time_s)))
    size = max(round(_REST_BLOCK_S / max(spacing_s, 1e-3)), 1)
    pose = np.column_stack([fixes.x_m[rest], fixes.y_m[rest], np.unwrap(fixes.heading_rad[rest])])
    pose = pose[np.isfinite(pose).all(axis=1)]
    blocks = len(pose) // size
    if blocks < 2:
        return None
    means = pose[: blocks * size].reshape(blocks, size, 3).mean(axis=1)
    x, y, turn = ((np.diff(means, axis=0) / (size * spacing_s)) ** 2).mean(axis=0).tolist()
    along = math.sqrt((x + y) / 2.0)
    return along, along, math.sqrt(turn)


def replicate_count(swims: Sequence[Segments]) -> int:
    """Largest number of runs with identical camera noise, because they were simulated with the same seed.

    Such runs are recognised by their fixes at rest. Whatever they have in common may be that noise.
    """
    kinds: dict[bytes, int] = {}
    for swim in swims:
        still = swim.pose[swim.time_s < swim.start_s[0]][:_STILL] if len(swim.start_s) else swim.pose[:0]
        if len(still) == _STILL and np.ptp(still, axis=0).max() > 1e-4:
            key = np.round((still[:, :2] - still[0, :2]) * 1e5).astype(np.int64).tobytes()
            kinds[key] = kinds.get(key, 0) + 1
    return max(kinds.values(), default=1)


def _check_units(name: str, time_s: Float64, pose: Float64) -> None:
    """Refuse headings and positions that cannot be in radians and metres."""
    if not len(pose):
        return
    widest = float(np.abs(pose[:, 2]).max())
    if widest > 2.0 * math.tau:
        raise InputError(
            f"run {name!r} has a heading of {widest:.1f}: headings are radians from -pi to pi, convert them"
        )
    steps_s = np.maximum(np.diff(time_s), 1e-3)
    if (
        len(steps_s)
        and float(np.median(np.hypot(*np.diff(pose[:, :2], axis=0).T) / steps_s)) > SPEED_MOST_MPS
    ):
        raise InputError(
            f"run {name!r} moves faster than {SPEED_MOST_MPS:g} m/s from fix to fix, mostly: positions are "
            "metres and times seconds, convert them"
        )


def _check_clock(name: str, age_s: Float64) -> None:
    """Refuse capture times by a clock that jumped against the one of arrivals."""
    off = np.abs(age_s - np.median(age_s)) if len(age_s) else age_s
    if np.count_nonzero(off > AGE_OFF_S) > AGE_SHARE * len(off):
        raise InputError(
            f"run {name!r}: the camera's clock jumps by {float(off.max()):.1f} s against the arrivals of its "
            "fixes: cut the run there or correct fixes/capture_time_s"
        )
