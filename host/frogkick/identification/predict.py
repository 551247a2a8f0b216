"""Batch rollouts of runs with the rod simulation: each period is predicted from its measured start.

One lane simulates one run with one set of effects from its first fix to its last, with the strokes of the
run. A run is cut into segments at the starts and ends of its periods. At the start of each segment the whole
lane is moved and its velocity changed to the error-state Kalman filter's estimate from the fixes known by
then (its limbs stay as they are, between their strokes). Then a segment is simulated without any use of
fixes: that is the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.poses import body_from_world, rotate, wrap_angle
from frogkick.der import WIDTH, Batch, Checkpoint, prepare
from frogkick.effects import Acting, Effect, Fix, changed_robot
from frogkick.effects.base import fix_by
from frogkick.identification.filter import Filter, Noise, Series, initial_rate_std
from frogkick.identification.segments import Segments
from frogkick.robot import Robot

STEP_S = 1.2e-3
"""Finest time step here: coarser than the pool's, which changes a period's end by some 0.02 mm."""

PHASES = ((0.12, 0.35), (0.35, 0.65), (0.65, 1.0))
"""Phases of a period, as shares of it: limbs straighten, the robot glides, the period ends."""

_HISTORY_S = 1.0  # of the trajectory before the latest fix that are stored, for late fixes

LONGEST_S = 8e-3
"""Longest step. Some longer ones fail to converge, and then their lane goes on alone at the cost of eight
lanes."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """The prediction of one run by one model."""

    time_s: Float64  # (n,) capture times of the fixes
    innovation: Float64  # (n, 3) innovations of the fixes, in standard deviations
    difference: Float64  # (n, 3) fix minus a trajectory that was never corrected: for the fit of the noise
    predicted: Float64  # (m, 3) pose at each period's end as the camera would show it, NaN where none
    start: Float64  # (m, 6) pose (world) and velocity (body) at each period's start
    # (m, 9) mean of fix minus prediction over the three phases of each period: forward, left (m) and heading
    # (rad) by the pose at its start; NaN if a phase has no fix
    residuals: Float64
    failed: bool  # the simulation did not converge

    def end_errors(self, swim: Segments) -> Float64:
        """(m, 3) measured minus predicted pose at each period's end, by the pose at its start."""
        gap = swim.measured - self.predicted
        gap[:, 2] = wrap_angle(gap[:, 2])
        return body_from_world(self.start[:, 2], gap)

    def series(self, swim: Segments) -> tuple[Series, ...]:
        """The series that noise is fitted to, for x, y and heading."""
        actuation = np.interp(self.time_s, *swim.actuated_s)
        rate_std = initial_rate_std(swim.rest_rate)
        return tuple(Series(self.time_s, actuation, self.difference[:, k], rate_std[k]) for k in range(3))


@dataclass(frozen=True, eq=False)
class Lane:
    """What to roll out: a run, by a robot with effects."""

    swim: Segments
    robot: Robot
    effects: tuple[Effect, ...]
    noise: Noise
    leg_s: float
    step_s: float = STEP_S


def roll_out(lanes: Sequence[Lane]) -> list[Rollout]:
    """Roll out runs, those of one body in one batch."""
    rollouts: dict[int, Rollout] = {}
    for indices, robot in lanes_by_body(lanes):
        rollouts.update(zip(indices, RolloutBatch([lanes[i] for i in indices], robot).run(), strict=True))
    return [rollouts[index] for index in range(len(lanes))]


def lanes_by_body(lanes: Sequence[Lane]) -> Iterator[tuple[list[int], Robot]]:
    """Indices of the lanes that share a batch, and the body that they share."""
    bodies: dict[tuple[Robot, float, float], list[int]] = {}
    for index, lane in enumerate(lanes):
        # The effects of the robot's file are among the lane's; their tables cannot be part of a key.
        robot = replace(changed_robot(lane.robot, lane.effects), effects=())
        # Effects that are evaluated in every leg would slow down the other lanes.
        leg_s = Acting(lane.effects, robot, [], lane.leg_s).leg_s
        bodies.setdefault((robot, leg_s, lane.step_s), []).append(index)
    for (robot, *_), indices in bodies.items():
        yield indices, robot


@dataclass(eq=False)
class LaneState:
    """State of one lane on its way through its run; for its predictions see Rollout."""

    lane: Lane
    acting: Acting

    def __post_init__(self) -> None:
        swim = self.lane.swim
        periods = len(swim.start_s)
        self.filter = Filter(self.lane.noise, swim.actuated_s, swim.begin_s, initial_rate_std(swim.rest_rate))
        self.camera_effects = [effect for effect in self.lane.effects if effect.overrides("fix")]
        self.corrected_s = swim.begin_s  # time of the latest correction
        self.next_fix = int(np.searchsorted(swim.time_s, swim.begin_s))
        self.next_stroke = self.next_segment = 0
        self.times, self.poses = np.empty(0), np.empty((0, 3))
        self.moved = np.zeros((3, 2))  # all corrections, as of time 0
        self.predicted = np.full((periods, 3), np.nan)
        self.start = np.full((periods, 6), np.nan)
        self.residuals = np.full((periods, 3 * len(PHASES)), np.nan)
        # time_s, innovation and difference of Rollout, from each correction
        self.rows = [(np.empty(0), *[np.empty((0, 3))] * 2)]
        self.failed = False

    @property
    def segment_end_s(self) -> float:
        """Where its segment ends; infinite after the last one."""
        ends = self.lane.swim.segment_times_s
        return float(ends[self.next_segment]) if self.next_segment < len(ends) else math.inf

    def rollout(self) -> Rollout:
        """Its prediction, at the end."""
        time_s, innovation, difference = (np.concatenate(parts) for parts in zip(*self.rows, strict=True))
        if self.failed:
            innovation = np.full_like(innovation, np.nan)
        ends = self.predicted, self.start, self.residuals
        return Rollout(time_s, innovation, difference, *ends, self.failed)


class RolloutBatch:
    """Rollouts of lanes of one body, in a batch of as many slots as are fastest. Where a lane has come to its
    end, the next one takes over its slot, the longest first.
    """

    def __init__(self, lanes: Sequence[Lane], robot: Robot) -> None:
        self.lanes = lanes
        self.robot = robot
        # Each lane has its own generator: the result shall not depend on the other lanes.
        self.lane_states = [
            LaneState(lane, Acting(lane.effects, robot, [np.random.default_rng(0)], lane.leg_s))
            for lane in lanes
        ]
        self.waiting = sorted(range(len(lanes)), key=lambda index: len(lanes[index].swim.segment_times_s))
        self.slots = [self.waiting.pop() for _ in range(min(WIDTH, len(lanes)))]
        first = np.array([self._first_pose(self.lane_states[index]) for index in self.slots])
        self.batch = replay_batch(robot, first, lanes[0].step_s)
        self.batch.time_s[:] = [lanes[index].swim.begin_s for index in self.slots]
        self.leg_s = min(lane_state.acting.leg_s for lane_state in self.lane_states)
        self._prepared: dict[int, Checkpoint] = {}

    def occupied(self) -> list[tuple[int, LaneState]]:
        """Slots of the batch that are in use, and the states of their lanes."""
        return [(slot, self.lane_states[index]) for slot, index in enumerate(self.slots) if index >= 0]

    @staticmethod
    def _first_pose(lane_state: LaneState) -> Float64:
        """The true pose that the camera shows as the first fix."""
        wanted = lane_state.lane.swim.pose[lane_state.next_fix]
        pose = wanted.copy()
        for _ in range(4):
            pose = pose + wanted - _camera_fix(lane_state, lane_state.lane.swim.begin_s, pose)[1]
        return np.asarray(pose)

    def run(self) -> list[Rollout]:
        """Roll out all lanes to their ends."""
        while occupied := self.occupied():
            there = [row for row in occupied if math.isfinite(row[1].segment_end_s)]
            until = self.batch.time_s.copy()
            for slot, lane_state in there:
                until[slot] = lane_state.segment_end_s
            self.advance(until)
            self.batch.shift({slot: self._correct(lane_state) for slot, lane_state in there})
            motion = self.batch.motion_world()
            for slot, lane_state in there:
                self._begin(slot, lane_state, motion[slot, :6])
            for slot, lane_state in occupied:
                if math.isinf(lane_state.segment_end_s):
                    self._retire(slot, lane_state)
        return [lane_state.rollout() for lane_state in self.lane_states]

    def _retire(self, slot: int, lane_state: LaneState) -> None:
        """Retire a lane at its end; the next one takes over its slot."""
        lane_state.failed = self.batch.failures.pop(slot, None) is not None
        self.slots[slot] = self.waiting.pop() if self.waiting else -1
        if self.slots[slot] >= 0:
            self.batch.restore(slot, self._initial_checkpoint(self.slots[slot]))

    def _initial_checkpoint(self, index: int) -> Checkpoint:
        """Checkpoint of a lane's robot at rest where its run begins; made for the next lanes as well."""
        if index not in self._prepared:
            some = [index, *self.waiting[:-WIDTH:-1]]
            poses = np.array([self._first_pose(self.lane_states[each]) for each in some])
            batch = replay_batch(self.robot, poses, self.lanes[index].step_s)
            batch.time_s[:] = [self.lanes[each].swim.begin_s for each in some]
            # They start from rest in the same water as the first lanes.
            _set_waters(batch, [(lane, self.lane_states[each]) for lane, each in enumerate(some)])
            self._prepared = {each: batch.save(lane) for lane, each in enumerate(some)}
        return self._prepared.pop(index)

    def advance(self, until: Float64) -> None:
        """Simulate all lanes to the ends of their segments."""
        occupied = self.occupied()
        for slot, lane_state in occupied:
            strokes = lane_state.lane.swim.strokes
            while (
                lane_state.next_stroke < len(strokes)
                and strokes[lane_state.next_stroke][0] < until[slot] - 1e-9
            ):
                time_s, limb = strokes[lane_state.next_stroke]
                lane_state.acting.fire(self.batch, slot, limb, time_s, 0)
                lane_state.next_stroke += 1
        start = self.batch.time_s.copy()
        # Each lane has its own count: the result shall not depend on the other lanes.
        legs = np.maximum(1.0, np.rint((until - start) / self.leg_s))
        parts: list[list[tuple[Float64, Float64]]] = [[] for _ in self.slots]
        for leg in range(1, int(legs.max()) + 1):
            going = (leg <= legs) & (start < until)
            _set_waters(self.batch, [(slot, lane_state) for slot, lane_state in occupied if going[slot]])
            aim = np.where(leg < legs, start + (until - start) * leg / legs, until)
            for part, (at, rows) in zip(parts, self.batch.advance(aim, trace=True), strict=True):
                part.append((at, rows[:, :3]))
        for slot, lane_state in occupied:
            lane_state.times = np.concatenate([lane_state.times, *(at for at, _ in parts[slot])])
            joined = np.concatenate([lane_state.poses, *(rows for _, rows in parts[slot])])
            joined[:, 2] = np.unwrap(joined[:, 2])
            lane_state.poses = joined

    def _correct(self, lane_state: LaneState) -> tuple[Float64, Float64]:
        """At a segment's end: record the prediction that ends here and update by the fixes known by now.

        Returned is the estimated error of pose and velocity, (3,) each, world frame.
        """
        swim, at_s = lane_state.lane.swim, lane_state.segment_end_s
        ended = -1
        for period in np.flatnonzero(np.abs(swim.end_s - at_s) < 1e-6):
            if lane_state.corrected_s <= swim.start_s[period] + 1e-6 and len(lane_state.times):
                lane_state.predicted[period] = self.shown_at_end(lane_state, at_s)
                ended = int(period)
        first = lane_state.next_fix
        while lane_state.next_fix < len(swim.time_s) and swim.arrival_s[lane_state.next_fix] <= at_s + 1e-9:
            lane_state.next_fix += 1
        times_s = swim.time_s[first : lane_state.next_fix]
        differences = np.empty((0, 3))
        if len(times_s):
            true_s, shown = self._camera_fixes(lane_state, times_s)
            differences = swim.pose[first : lane_state.next_fix] - shown
            innovations, variances = lane_state.filter.update_all(true_s, differences)
            unbroken = differences + lane_state.moved[:, 0] + true_s[:, None] * lane_state.moved[:, 1]
            lane_state.rows.append((true_s, innovations / np.sqrt(variances), unbroken))
        if ended >= 0:
            length_s = float(swim.end_s[ended] - swim.start_s[ended])
            share = (times_s - float(swim.start_s[ended])) / length_s
            heading_rad = float(lane_state.start[ended, 2])
            lane_state.residuals[ended] = phase_residuals(differences, share, heading_rad)
        offset, rate = lane_state.filter.reset(at_s)
        lane_state.moved[:, 0] += offset - at_s * rate
        lane_state.moved[:, 1] += rate
        lane_state.poses = lane_state.poses + offset + (lane_state.times - at_s)[:, None] * rate
        kept = lane_state.times >= min(at_s, lane_state.filter.time_s) - _HISTORY_S
        lane_state.times, lane_state.poses = lane_state.times[kept], lane_state.poses[kept]
        lane_state.corrected_s = at_s
        return offset, rate

    def _begin(self, slot: int, lane_state: LaneState, motion: Float64) -> None:
        """Begin the next segment, with the corrected motion."""
        starts = np.abs(lane_state.lane.swim.start_s - lane_state.segment_end_s) < 1e-6
        lane_state.next_segment += 1
        for period in np.flatnonzero(starts):
            lane_state.start[period] = motion
            self.began(slot, int(period))

    def began(self, slot: int, period: int) -> None:
        """Hook for subclasses: a period of a lane's run begins."""

    def _camera_fixes(self, lane_state: LaneState, times_s: Float64) -> tuple[Float64, Float64]:
        """(n,) true capture times of fixes with these stated times, and (n, 3) the poses that they show."""
        if not lane_state.camera_effects:
            return times_s, interpolated(lane_state.times, lane_state.poses, times_s)
        every = [self.camera_fix_at(lane_state, float(time_s)) for time_s in times_s]
        return np.array([true_s for true_s, _ in every]), np.array([pose for _, pose in every])

    def camera_fix_at(self, lane_state: LaneState, time_s: float) -> tuple[float, Float64]:
        """True capture time of a fix with the stated time ``time_s``, and the pose that it shows."""
        pose = interpolated(lane_state.times, lane_state.poses, np.array([time_s]))[0]
        true_s, shown = _camera_fix(lane_state, time_s, pose)
        for _ in range(2):
            if true_s == time_s:
                break
            pose = interpolated(lane_state.times, lane_state.poses, np.array([true_s]))[0]
            mirrored_s, shown = _camera_fix(lane_state, true_s, pose)
            off_s = 2.0 * true_s - mirrored_s - time_s
            # The delay of a clock that drifts is another one then. One that comes and goes never agrees.
            if not 1e-6 < abs(off_s) < 0.1 * abs(true_s - time_s):
                break
            true_s -= off_s
        return true_s, shown

    def shown_at_end(self, lane_state: LaneState, at_s: float) -> Float64:
        """(3,) pose at a period's end, as ``Segments.measured`` would have it.

        By a camera's clock that is slow, fixes stated for the end are of the next period, whose strokes no
        prediction knows. The pose that is predicted for the end is then held against the fixes stated for it.
        """
        true_s, shown = self.camera_fix_at(lane_state, at_s)
        if true_s <= at_s:
            return shown
        pose = interpolated(lane_state.times, lane_state.poses, np.array([at_s]))[0]
        mirrored_s, shown = _camera_fix(lane_state, at_s, pose)
        swim = lane_state.lane.swim
        return np.asarray(shown + swim.pose_at(at_s) - swim.pose_at(2.0 * at_s - mirrored_s))


def phase_residuals(gaps: Float64, share: Float64, heading_rad: float) -> Float64:
    """(9,) residuals of a period, from (n, 3) gaps at (n,) shares of it; see Rollout.residuals."""
    found: list[float] = []
    for low, high in PHASES:
        rows = gaps[(low <= share) & (share < high)]
        if not len(rows):
            return np.full(3 * len(PHASES), np.nan)
        x, y, turn = rows.mean(axis=0).tolist()
        found += [*rotate(-heading_rad, x, y), turn]
    return np.array(found)


def interpolated(times: Float64, poses: Float64, at_s: Float64) -> Float64:
    """(n, 3) poses of a trajectory at times, constant beyond its ends."""
    if not len(times):
        return np.full((len(at_s), 3), np.nan)
    return np.column_stack([np.interp(at_s, times, poses[:, axis]) for axis in range(3)])


def _set_waters(batch: Batch, going: Sequence[tuple[int, LaneState]]) -> None:
    """Evaluate the effects on water and wrenches where lanes are now."""
    active = [(lane, lane_state) for lane, lane_state in going if not math.isinf(lane_state.acting.leg_s)]
    motion = batch.motion_world() if active else np.empty((0, 6))
    for lane, lane_state in active:
        now_s, row = float(batch.time_s[lane]), motion[lane]
        batch.set_water(lane, lane_state.acting.water(batch, now_s, row[:3], row[3:6]))


def _camera_fix(lane_state: LaneState, time_s: float, pose: Float64) -> tuple[float, Float64]:
    """True capture time of a fix with the stated time ``time_s``, and what the camera shows of ``pose``."""
    if not lane_state.camera_effects:
        return time_s, pose
    stated_s, *shown = shown_fix(
        lane_state.camera_effects, Fix(time_s, 0.0, *pose.tolist()), lane_state.acting.rngs[0]
    )
    return 2.0 * time_s - stated_s, np.array(shown)


def shown_fix(
    effects: Sequence[Effect], fix: Fix, rng: np.random.Generator
) -> tuple[float, float, float, float]:
    """Stated time and pose of a fix by a camera with effects; its heading goes on from the true one.

    An effect that drops fixes did not drop this one, because it is there.
    """
    heading_rad = fix.heading_rad
    for effect in effects:
        fix = fix_by(effect, fix, rng) or fix
    turned_rad = math.remainder(fix.heading_rad - heading_rad, math.tau)
    return fix.capture_s, fix.x_m, fix.y_m, heading_rad + turned_rad


_rods = lru_cache(maxsize=64)(prepare)


def replay_batch(robot: Robot, pose_world: Float64, step_s: float) -> Batch:
    """Robots at rest at (lanes, 3) poses, to replay runs: with bounded steps."""
    still = np.zeros((len(pose_world), 3))
    return Batch([_rods(robot)] * len(pose_world), pose_world, still, 0.0, step_s, WIDTH, LONGEST_S)
