"""Paired simulation of two models: sequences of actions from rest, one period at a time.

The second model's robot is put to the pose that the first one's camera shows whenever a period begins, with
its limbs amid their own strokes, as identification does with fixes. So each period discriminates by itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.poses import rotate
from frogkick.der import WIDTH, Checkpoint
from frogkick.effects import ActingLanes, Effect, Fix, body_at, changed_robot
from frogkick.effects.registry import effects_of
from frogkick.identification.fit import Model
from frogkick.identification.predict import CLIP_SIGMA, PHASES, replay_batch
from frogkick.identification.screening import COARSE_STEP_S
from frogkick.identification.segments import Segments
from frogkick.robot import Robot

CAMERA_S, LATE_S = 1.0 / 15.0, 0.08
"""Time between fixes, and from a picture to its fix."""

_BACK_S = 0.7  # of trajectory before the present, for fixes that are older than stated
_GLIDE_S = 0.4  # at a period's end, that the start of the next one is estimated from


@dataclass(frozen=True, eq=False)
class RobotState:
    """A simulated robot when a period begins.

    Attributes:
        checkpoint: its rods.
        acting: its effects, with the history of strokes.
        times_s, poses: (n,) and (n, 3) its trajectory just before.
    """

    checkpoint: Checkpoint
    acting: ActingLanes
    times_s: Float64
    poses: Float64


@dataclass(frozen=True, eq=False)
class ActionSequence:
    """A sequence of actions and the robots after it.

    Attributes:
        actions: by index.
        distance2: squared separation of both models so far.
        robots: robots of both models.
        shown: for each period the (n, 3) poses that the first one's camera shows at ``_instants``.
    """

    actions: tuple[int, ...]
    distance2: float
    robots: tuple[RobotState, ...]
    shown: tuple[Float64, ...]


class Side:
    """One of the two models, as robots to simulate."""

    def __init__(self, model: Model) -> None:
        every = (*effects_of(model.robot), *(term.effect() for term in model.terms))
        effects = tuple(effect.likeliest() for effect in every)
        self.effects = effects
        self.robot = changed_robot(model.robot, effects)
        self.camera_effects = [effect for effect in effects if type(effect).fix is not Effect.fix]
        self._leg_s = model.leg_s

    def at_rest(self, shown: Float64) -> RobotState:
        """A robot at rest whose camera shows a pose."""
        pose = np.array(shown, dtype=np.float64)
        for _ in range(4):
            pose = pose + shown - self._camera_fix(0.0, pose)[1:]
        acting = ActingLanes(self.effects, self.robot, [np.random.default_rng(0)], self._leg_s)
        batch = replay_batch(self.robot, pose[None, :], COARSE_STEP_S)
        return RobotState(batch.save(0), acting, np.array([-_BACK_S, 0.0]), np.array([pose, pose]))

    def advanced(self, given: Sequence[tuple[RobotState, int]]) -> Iterator[tuple[RobotState, Float64]]:
        """Robots after one period with an action each, and (n, 3) what the camera shows of it."""
        for first in range(0, len(given), WIDTH):
            yield from self._advanced(given[first : first + WIDTH])

    def _advanced(self, given: Sequence[tuple[RobotState, int]]) -> Iterator[tuple[RobotState, Float64]]:
        start_s, period_s = given[0][0].checkpoint.time_s, self.robot.period_s
        batch = replay_batch(self.robot, np.zeros((len(given), 3)), COARSE_STEP_S)
        actings = []
        for lane, (robot, action) in enumerate(given):
            batch.restore(lane, robot.checkpoint)
            actings.append(robot.acting.copy())
            for at_s, limb in strokes_of(self.robot, action, start_s):
                row = batch.motion_world()[lane]
                stroke = actings[-1].stroke(0, limb, at_s, body_at(at_s, row[:3], row[3:6]))
                later_s, slower = at_s + stroke.delay_s, stroke.duration_scale
                batch.fire(lane, limb, later_s, gain=stroke.gain, duration_scale=slower)
        leg_s = actings[0].leg_s
        legs = 1 if math.isinf(leg_s) else max(1, round(period_s / leg_s))
        parts: list[list[tuple[Float64, Float64]]] = [[] for _ in given]
        for leg in range(1, legs + 1):
            if not math.isinf(leg_s):
                now_s, motion = start_s + period_s * (leg - 1) / legs, batch.motion_world()
                for lane, acting in enumerate(actings):
                    row = motion[lane]
                    batch.set_water(lane, acting.water(batch, now_s, row[:3], row[3:6]))
            traces = batch.advance(start_s + period_s * leg / legs, trace=True)
            for part, (times_s, rows) in zip(parts, traces, strict=True):
                part.append((times_s, rows[:, :3]))
        for lane, ((robot, _), part) in enumerate(zip(given, parts, strict=True)):
            times_s = np.concatenate([robot.times_s, *(at_s for at_s, _ in part)])
            poses = np.concatenate([robot.poses, *(rows for _, rows in part)])
            poses[:, 2] = np.unwrap(poses[:, 2])
            advanced = RobotState(batch.save(lane), actings[lane], times_s, poses)
            yield advanced, self._camera_fixes(advanced, _instants(start_s, period_s))

    def put(self, robot: RobotState, offset: Float64, rate: Float64) -> RobotState:
        """A robot at another pose and velocity, and the last of its trajectory moved likewise."""
        batch = replay_batch(self.robot, np.zeros((1, 3)), COARSE_STEP_S)
        batch.restore(0, robot.checkpoint)
        batch.shift({0: (offset, rate)})
        now_s = robot.checkpoint.time_s
        kept = robot.times_s >= now_s - _BACK_S
        poses = robot.poses + offset + (robot.times_s - now_s)[:, None] * rate
        return RobotState(batch.save(0), robot.acting, robot.times_s[kept], poses[kept])

    def _camera_fixes(self, robot: RobotState, corrected_s: Float64) -> Float64:
        """(n, 3) poses that fixes with these stated times show."""
        times_s, poses = robot.times_s, robot.poses
        if self.camera_effects:
            some = np.linspace(max(times_s[0], corrected_s[0] - _BACK_S), times_s[-1], 60)
            captured = [
                self._camera_fix(at_s, _interpolated(times_s, poses, np.array([at_s]))[0])
                for at_s in some.tolist()
            ]
            times_s, poses = np.array(captured)[:, 0], np.array(captured)[:, 1:]
        return _interpolated(times_s, poses, corrected_s)

    def _camera_fix(self, time_s: float, pose: Float64) -> Float64:
        """(4,) the stated time of a fix of a pose, and the pose that it shows."""
        x, y, heading = (float(value) for value in pose)
        fix = Fix(time_s, LATE_S, x, y, heading)
        for effect in self.camera_effects:
            fix = effect.fix(fix, np.random.default_rng(0)) or fix
        turned = math.remainder(fix.heading_rad - heading, math.tau)
        return np.array([fix.capture_s, fix.x_m, fix.y_m, heading + turned])


def strokes_of(robot: Robot, action: int, start_s: float) -> list[tuple[float, int]]:
    """(time_s, limb) of an action, in order."""
    chosen = robot.actions[action]
    pairs = ((start_s, chosen.first_mask), (start_s + robot.second_delay_s, chosen.second_mask))
    return [(at_s, limb) for at_s, mask in pairs for limb in range(len(robot.limbs)) if mask >> limb & 1]


def _instants(start_s: float, period_s: float) -> Float64:
    """Capture times in a period."""
    count = max(len(PHASES), round(period_s / CAMERA_S))
    return start_s + period_s * (np.arange(count) + 0.5) / count


def _interpolated(times_s: Float64, poses: Float64, at_s: Float64) -> Float64:
    return np.column_stack([np.interp(at_s, times_s, poses[:, axis]) for axis in range(3)])


def extend(
    sequences: Sequence[ActionSequence],
    sides: Sequence[Side],
    white: Float64,
    robot: Robot,
    actions: Sequence[int] | None = None,
) -> Iterator[ActionSequence]:
    """Extend every sequence by every action."""
    pairs = [
        (sequence, a)
        for sequence in sequences
        for a in (range(len(robot.actions)) if actions is None else actions)
    ]
    advanced = [
        list(side.advanced([(sequence.robots[k], a) for sequence, a in pairs]))
        for k, side in enumerate(sides)
    ]
    for (sequence, action), (one, shown), (other, beside) in zip(pairs, *advanced, strict=True):
        start_s = sequence.robots[0].checkpoint.time_s
        instants = _instants(start_s, robot.period_s)
        gap = shown - beside
        ahead = _residuals(gap, (instants - start_s) / robot.period_s, float(shown[0, 2]))
        distance2 = sequence.distance2 + float((np.clip(ahead @ white, -CLIP_SIGMA, CLIP_SIGMA) ** 2).sum())
        if one.checkpoint.failed or other.checkpoint.failed:
            continue
        late = instants >= start_s + robot.period_s - _GLIDE_S
        design = np.column_stack([np.ones(late.sum()), instants[late] - start_s - robot.period_s])
        offset, rate = np.linalg.lstsq(design, gap[late], rcond=None)[0]
        robots = (sides[0].put(one, np.zeros(3), np.zeros(3)), sides[1].put(other, offset, rate))
        yield ActionSequence((*sequence.actions, action), distance2, robots, (*sequence.shown, shown))


def _residuals(gap: Float64, share: Float64, heading_rad: float) -> Float64:
    """(9,) residuals of a period; see Rollout.residuals."""
    found: list[float] = []
    for low, high in PHASES:
        x, y, turn = gap[(low <= share) & (share < high)].mean(axis=0).tolist()
        found += [*rotate(-heading_rad, x, y), turn]
    return np.array(found)


def segments_of_sequence(robot: Robot, sequence: ActionSequence, start: Float64) -> Segments:
    """The first model's trajectory along a sequence, as a run of fixes without noise."""
    start_s = np.asarray(robot.period_s * np.arange(len(sequence.actions)), dtype=np.float64)
    before_s = -CAMERA_S * np.arange(15, 0, -1)
    time_s = np.concatenate([before_s, *(_instants(float(at_s), robot.period_s) for at_s in start_s)])
    pose = np.concatenate([np.tile(start, (len(before_s), 1)), *sequence.shown])
    strokes = [
        each
        for at_s, action in zip(start_s.tolist(), sequence.actions, strict=True)
        for each in strokes_of(robot, action, at_s)
    ]
    return Segments(
        name="planned",
        robot_id=robot.id,
        action_names=tuple(action.name for action in robot.actions),
        time_s=time_s,
        arrival_s=time_s + LATE_S,
        pose=np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])]),
        strokes=tuple(strokes),
        start_s=start_s,
        action=np.array(sequence.actions, dtype=np.int64),
        end_s=np.asarray(start_s + robot.period_s),
        period_s=robot.period_s,
        lag_s=0.0,
    )
