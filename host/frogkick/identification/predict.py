"""Follow runs with the rod simulation: predict each period from its start, then take in what was seen.

One lane swims one run with one set of effects from its first fix to its last, all strokes as they were. At
the start of each period the lane is moved and sped up as a whole to where the fixes known by then say it is,
its limbs staying amid their strokes; then a period is simulated without any look at the fixes, which is the
prediction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from frogkick.der import WIDTH
from frogkick.effects import ActingLanes, Effect, Fix, body_at, changed_robot
from frogkick.identification.filter import Filter, Noise, Series, first_rate_std
from frogkick.identification.gentle import Amid, Gentle, gentle
from frogkick.identification.segments import Segments
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

STEP_S = 1.2e-3
"""Finest time step here: coarser than the pool's, which moves a period's end by some 0.02 mm."""

WILD = 8.0
"""How many standard deviations a miss counts at most."""

PARTS = ((0.12, 0.35), (0.35, 0.65), (0.65, 1.0))
"""Of a period: while limbs straighten, while the robot glides on, towards the end."""

_CHANCE = np.random.default_rng(0)
_KEPT_S = 1.0  # of the trajectory before a correction, for fixes that are late


@dataclass(frozen=True, eq=False)
class Track:
    """What one lane gave.

    Attributes:
        time_s: (n,) capture times of the fixes after its beginning.
        innovation: (n, 3) fix minus what was expected of it (m, m, rad).
        variance: (n, 3) of the innovations.
        difference: (n, 3) fix minus one unbroken trajectory: for other noises.
        predicted: (m, 3) pose at each period's end as the camera would show it, NaN where none.
        spread: (m, 3) standard deviation of these, from that of the pose and rate at the period's start.
        start: (m, 6) pose (world) and velocity (body) at each period's start.
        missed: (m, 9) mean of fix minus prediction over three parts of each period, forward, left (m) and
            heading (rad) by the pose at its start; NaN where a part has no fix.
        failed: it did not converge.
    """

    time_s: FloatArray
    innovation: FloatArray
    variance: FloatArray
    difference: FloatArray
    predicted: FloatArray
    spread: FloatArray
    start: FloatArray
    missed: FloatArray
    failed: bool

    def series(self, swim: Segments) -> tuple[Series, ...]:
        """What other noises are tried on, for x, y and heading."""
        busy = np.interp(self.time_s, *swim.actuated_s)
        rate_std = first_rate_std(swim.rest_rate)
        return tuple(Series(self.time_s, busy, self.difference[:, k], rate_std[k]) for k in range(3))


@dataclass(frozen=True, eq=False)
class Lane:
    """What to follow: a run, by a robot with effects."""

    swim: Segments
    robot: Robot
    effects: tuple[Effect, ...]
    noise: Noise
    leg_s: float
    step_s: float = STEP_S


def follow(lanes: Sequence[Lane]) -> list[Track]:
    """Follow runs, those of one body side by side."""
    tracks: dict[int, Track] = {}
    for indices, robot in parties(lanes):
        tracks.update(zip(indices, Party([lanes[i] for i in indices], robot).go(), strict=True))
    return [tracks[index] for index in range(len(lanes))]


def parties(lanes: Sequence[Lane]) -> Iterator[tuple[list[int], Robot]]:
    """Indices of lanes that go side by side, and the body that they have."""
    bodies: dict[tuple[Robot, float, float], list[int]] = {}
    for index, lane in enumerate(lanes):
        robot = changed_robot(lane.robot, lane.effects)
        # What is asked every leg would slow down its neighbours.
        leg_s = ActingLanes(lane.effects, robot, [], lane.leg_s).leg_s
        bodies.setdefault((robot, leg_s, lane.step_s), []).append(index)
    for (robot, *_), indices in bodies.items():
        yield indices, robot


@dataclass(eq=False)
class Course:
    """A lane's own way through its run."""

    lane: Lane
    acting: ActingLanes
    filter: Filter
    segment_times_s: FloatArray
    claims_s: list[float] = field(default_factory=list)
    next_fix: int = 0
    next_stroke: int = 0
    times: FloatArray = field(default_factory=lambda: np.empty(0))
    poses: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    moved: FloatArray = field(default_factory=lambda: np.zeros((3, 2)))  # all corrections, as of time 0
    rows: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = field(default_factory=list)
    next_corner: int = 0
    failed: bool = False

    def __post_init__(self) -> None:
        self.seeing = [effect for effect in self.lane.effects if type(effect).fix is not Effect.fix]


class Party:
    """Lanes of one body on their ways through their runs: as many side by side as are fastest.

    Where one has come to its end the next one, the longest first, goes on in its place.
    """

    def __init__(self, lanes: Sequence[Lane], robot: Robot) -> None:
        self.lanes = lanes
        self.robot = robot
        self.courses = []
        for lane in lanes:
            acting = ActingLanes(lane.effects, robot, [np.random.default_rng(0)], lane.leg_s)
            swim, rate_std = lane.swim, first_rate_std(lane.swim.rest_rate)
            state = Filter(lane.noise, swim.actuated_s, swim.begin_s, rate_std)
            course = Course(lane, acting, state, swim.segment_times_s)
            course.next_fix = int(np.searchsorted(lane.swim.time_s, lane.swim.begin_s))
            course.claims_s = [lane.swim.begin_s]
            self.courses.append(course)
        self.waiting = sorted(range(len(lanes)), key=lambda index: len(self.courses[index].segment_times_s))
        self.seats = [self.waiting.pop() for _ in range(min(WIDTH, len(lanes)))]
        first = np.array([self._first_pose(self.courses[index]) for index in self.seats])
        self.batch = gentle(robot, first, lanes[0].step_s)
        self.batch.time_s[:] = [lanes[index].swim.begin_s for index in self.seats]
        self.leg_s = min(course.acting.leg_s for course in self.courses)
        self._ready: dict[int, Amid] = {}

    def seated(self) -> list[tuple[int, Course]]:
        """Lanes of the batch that are in use, and who swims there."""
        return [(seat, self.courses[index]) for seat, index in enumerate(self.seats) if index >= 0]

    @staticmethod
    def _first_pose(course: Course) -> FloatArray:
        """The true pose that shows as the first fix."""
        wanted = course.lane.swim.pose[course.next_fix]
        pose = wanted.copy()
        for _ in range(4):
            pose = pose + wanted - _shown(course.lane.effects, course.lane.swim.begin_s, pose)[1]
        return np.asarray(pose)

    def go(self) -> list[Track]:
        """Swim all lanes to their ends."""
        outcome = [
            (
                np.full((len(lane.swim.start_s), 3), np.nan),
                np.full((len(lane.swim.start_s), 3), np.nan),
                np.full((len(lane.swim.start_s), 6), np.nan),
                np.full((len(lane.swim.start_s), 3 * len(PARTS)), np.nan),
            )
            for lane in self.lanes
        ]
        while seated := self.seated():
            until = self.batch.time_s.copy()
            for seat, course in seated:
                if course.next_corner < len(course.segment_times_s):
                    until[seat] = course.segment_times_s[course.next_corner]
            self.advance(until)
            there = [row for row in seated if row[1].next_corner < len(row[1].segment_times_s)]
            moves = {seat: self._arrive(course, outcome[self.seats[seat]]) for seat, course in there}
            self.batch.shift_some(moves)
            motion = self.batch.motion_world()
            for seat, course in there:
                self._begin(seat, course, motion[seat, :6], outcome[self.seats[seat]][2])
            for seat, course in seated:
                if course.next_corner >= len(course.segment_times_s):
                    self._leave(seat, course)
        return [self._track(course, *outcome[index]) for index, course in enumerate(self.courses)]

    def _leave(self, seat: int, course: Course) -> None:
        """A lane has come to its end: the next one takes its place."""
        course.failed = self.batch.failures.pop(seat, None) is not None
        self.seats[seat] = self.waiting.pop() if self.waiting else -1
        if self.seats[seat] >= 0:
            self.batch.enter(seat, self._placed(self.seats[seat]))

    def _placed(self, index: int) -> Amid:
        """A lane's robot at rest where its run begins; those of the next ones are placed with it."""
        if index not in self._ready:
            some = [index, *self.waiting[:-WIDTH:-1]]
            poses = np.array([self._first_pose(self.courses[each]) for each in some])
            batch = gentle(self.robot, poses, self.lanes[index].step_s)
            batch.time_s[:] = [self.lanes[each].swim.begin_s for each in some]
            # They speed up from rest as those do that were there first.
            _set_waters(batch, [(lane, self.courses[each]) for lane, each in enumerate(some)])
            self._ready = {each: batch.leave(lane) for lane, each in enumerate(some)}
        return self._ready.pop(index)

    def advance(self, until: FloatArray) -> None:
        """All lanes to their next corner, strokes fired, water asked as often as effects need it."""
        seated = self.seated()
        for seat, course in seated:
            strokes = course.lane.swim.strokes
            while course.next_stroke < len(strokes) and strokes[course.next_stroke][0] < until[seat] - 1e-9:
                self._fire(seat, course, *strokes[course.next_stroke])
                course.next_stroke += 1
        start = self.batch.time_s.copy()
        # Each lane's own count: who swims beside it shall not matter.
        legs = np.maximum(1.0, np.rint((until - start) / self.leg_s))
        parts: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in self.seats]
        for leg in range(1, int(legs.max()) + 1):
            going = (leg <= legs) & (start < until)
            _set_waters(self.batch, [(seat, course) for seat, course in seated if going[seat]])
            aim = np.where(leg < legs, start + (until - start) * leg / legs, until)
            for part, (at, rows) in zip(parts, self.batch.advance(aim, trace=True), strict=True):
                part.append((at, rows[:, :3]))
        for seat, course in seated:
            course.times = np.concatenate([course.times, *(at for at, _ in parts[seat])])
            joined = np.concatenate([course.poses, *(rows for _, rows in parts[seat])])
            joined[:, 2] = np.unwrap(joined[:, 2])
            course.poses = joined

    def _fire(self, seat: int, course: Course, time_s: float, limb: int) -> None:
        body = None
        if course.acting.asks_body:
            row = self.batch.motion_world()[seat]
            body = body_at(time_s, row[:3], row[3:6])
        stroke = course.acting.stroke(0, limb, time_s, body)
        start_s = time_s + stroke.delay_s
        self.batch.fire(seat, limb, start_s, gain=stroke.gain, duration_scale=stroke.duration_scale)

    def _arrive(self, course: Course, outcome: tuple[FloatArray, ...]) -> tuple[FloatArray, FloatArray]:
        """At a corner: note the prediction that ends here, take in the fixes known by now.

        Returns:
            By what pose and velocity these say that the robot is off, (3,) each, world frame.
        """
        swim, at_s = course.lane.swim, float(course.segment_times_s[course.next_corner])
        predicted, spread, start, missed = outcome
        ended = -1
        for period in np.flatnonzero(np.abs(swim.end_s - at_s) < 1e-6):
            if course.claims_s[-1] <= swim.start_s[period] + 1e-6 and len(course.times):
                predicted[period] = self.shown_at(course, at_s)[1]
                before = Filter(course.lane.noise, swim.actuated_s, course.filter.time_s)
                before.covariance = course.filter.covariance.copy()
                before.go_to(at_s)
                spread[period] = np.sqrt(before.covariance[:, 0])
                ended = int(period)
        first = course.next_fix
        while course.next_fix < len(swim.time_s) and swim.arrival_s[course.next_fix] <= at_s + 1e-9:
            course.next_fix += 1
        times_s = swim.time_s[first : course.next_fix]
        differences = np.empty((0, 3))
        if len(times_s):
            true_s, shown = self._shown_all(course, times_s)
            differences = swim.pose[first : course.next_fix] - shown
            innovations, variances = course.filter.take_all(true_s, differences)
            unbroken = differences + course.moved[:, 0] + true_s[:, None] * course.moved[:, 1]
            course.rows.append((true_s, innovations, variances, unbroken))
        if ended >= 0:
            missed[ended] = _by_parts(swim, ended, times_s, differences, float(start[ended, 2]))
        offset, rate = course.filter.correct(at_s)
        course.moved[:, 0] += offset - at_s * rate
        course.moved[:, 1] += rate
        course.poses = course.poses + offset + (course.times - at_s)[:, None] * rate
        kept = course.times >= at_s - _KEPT_S
        course.times, course.poses = course.times[kept], course.poses[kept]
        course.claims_s.append(at_s)
        return offset, rate

    def _begin(self, seat: int, course: Course, motion: FloatArray, start: FloatArray) -> None:
        """Start anew from a corner, where the robot is now known to move like this."""
        at_s = float(course.segment_times_s[course.next_corner])
        course.next_corner += 1
        for period in np.flatnonzero(np.abs(course.lane.swim.start_s - at_s) < 1e-6):
            start[period] = motion
            self.began(seat, int(period))

    def began(self, seat: int, period: int) -> None:
        """A lane stands where a period of its run begins; for those who want to know."""

    def _shown_all(self, course: Course, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) when fixes that claim these times were really taken, and (n, 3) what they would say."""
        if not course.seeing:
            return times_s, _at(course.times, course.poses, times_s)
        every = [self.shown_at(course, float(time_s)) for time_s in times_s]
        return np.array([true_s for true_s, _ in every]), np.array([pose for _, pose in every])

    def shown_at(self, course: Course, time_s: float) -> tuple[float, FloatArray]:
        """What a fix that claims ``time_s`` would say, and when it was really taken."""
        pose = _at(course.times, course.poses, np.array([time_s]))[0]
        true_s, shown = _shown(course.seeing, time_s, pose)
        if true_s != time_s:
            pose = _at(course.times, course.poses, np.array([true_s]))[0]
            _, shown = _shown(course.seeing, true_s, pose)
        return true_s, shown

    def _track(
        self,
        course: Course,
        predicted: FloatArray,
        spread: FloatArray,
        start: FloatArray,
        missed: FloatArray,
    ) -> Track:
        empty = (np.empty(0), *[np.empty((0, 3))] * 3)
        columns = [np.concatenate(parts) for parts in zip(empty, *course.rows, strict=True)]
        if course.failed:
            columns[1] = np.full_like(columns[1], np.nan)
        return Track(
            columns[0],
            columns[1],
            columns[2],
            columns[3],
            predicted,
            spread,
            start,
            missed,
            course.failed,
        )


def _by_parts(
    swim: Segments, period: int, times_s: FloatArray, gaps: FloatArray, heading_rad: float
) -> FloatArray:
    """(9,) what a period's prediction missed; see Track.missed."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    start_s, length_s = float(swim.start_s[period]), float(swim.end_s[period] - swim.start_s[period])
    share = (times_s - start_s) / length_s
    found: list[float] = []
    for low, high in PARTS:
        rows = gaps[(low <= share) & (share < high)]
        if not len(rows):
            return np.full(3 * len(PARTS), np.nan)
        x, y, turn = rows.mean(axis=0).tolist()
        found += [c * x + s * y, c * y - s * x, turn]
    return np.array(found)


def _at(times: FloatArray, poses: FloatArray, at_s: FloatArray) -> FloatArray:
    """(n, 3) poses of a trajectory at times, held at its ends."""
    if not len(times):
        return np.full((len(at_s), 3), np.nan)
    return np.column_stack([np.interp(at_s, times, poses[:, axis]) for axis in range(3)])


def _set_waters(batch: Gentle, going: Sequence[tuple[int, Course]]) -> None:
    """Let water and wrenches be what effects make of them where lanes are now."""
    asking = [(lane, course) for lane, course in going if not math.isinf(course.acting.leg_s)]
    motion = batch.motion_world() if asking else np.empty((0, 6))
    for lane, course in asking:
        now_s, row = float(batch.time_s[lane]), motion[lane]
        batch.set_water(lane, course.acting.water(batch, now_s, row[:3], row[3:6]))


def _shown(effects: Sequence[Effect], time_s: float, pose: FloatArray) -> tuple[float, FloatArray]:
    """When a fix that claims ``time_s`` was taken, and what one taken of ``pose`` then says."""
    if not effects:
        return time_s, pose
    x, y, heading = (float(value) for value in pose)
    seen = Fix(time_s, 0.0, x, y, heading)
    for effect in effects:
        seen = effect.fix(seen, _CHANCE) or seen  # one that drops fixes has not dropped this one
    turned = math.remainder(seen.heading_rad - heading, math.tau)
    return 2.0 * time_s - seen.capture_s, np.array([seen.x_m, seen.y_m, heading + turned])
