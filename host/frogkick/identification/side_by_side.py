"""Two models side by side: rows of actions from rest, a period at a time, each tried after the same start.

The second model's robot is put where the first one's is shown to be whenever a period begins, with its limbs
amid their own strokes, as identification does with fixes: so each period is told apart by itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.der import WIDTH
from frogkick.effects import ActingLanes, Effect, Fix, body_at, changed_robot
from frogkick.effects.registry import effects_of
from frogkick.identification.columns import COARSE_STEP_S
from frogkick.identification.fit import Model
from frogkick.identification.gentle import Amid, gentle
from frogkick.identification.predict import PARTS, WILD
from frogkick.identification.segments import Segments
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

CAMERA_S, LATE_S = 1.0 / 15.0, 0.08
"""From fix to fix, and from a picture to its fix."""

_BACK_S = 0.7  # of the way behind, for fixes that are older than they say
_GLIDE_S = 0.4  # at a period's end, that tells where the next one begins


@dataclass(frozen=True, eq=False)
class Swimming:
    """A simulated robot when a period begins.

    Attributes:
        amid: its rods.
        acting: its effects, with the strokes so far.
        times_s, poses: (n,) and (n, 3) its way just before.
    """

    amid: Amid
    acting: ActingLanes
    times_s: FloatArray
    poses: FloatArray


@dataclass(frozen=True, eq=False)
class Row:
    """Actions so far.

    Attributes:
        actions: by index.
        square: of how far both models are apart by now.
        robots: of both.
        told: of each period (n, 3) poses that the first one's camera shows, at ``_instants``.
    """

    actions: tuple[int, ...]
    square: float
    robots: tuple[Swimming, ...]
    told: tuple[FloatArray, ...]


class Side:
    """One of the models, as robots to simulate."""

    def __init__(self, model: Model) -> None:
        effects = (*effects_of(model.robot), *(term.effect() for term in model.terms))
        self.effects = effects
        self.robot = changed_robot(model.robot, effects)
        self.seeing = [effect for effect in effects if type(effect).fix is not Effect.fix]
        self._leg_s = model.leg_s

    def at_rest(self, shown: FloatArray) -> Swimming:
        """A robot at rest that a camera shows at a pose."""
        pose = np.array(shown, dtype=np.float64)
        for _ in range(4):
            pose = pose + shown - self._seen(0.0, pose)[1:]
        acting = ActingLanes(self.effects, self.robot, [np.random.default_rng(0)], self._leg_s)
        batch = gentle(self.robot, pose[None, :], COARSE_STEP_S)
        return Swimming(batch.leave(0), acting, np.array([-_BACK_S, 0.0]), np.array([pose, pose]))

    def swum(self, given: Sequence[tuple[Swimming, int]]) -> Iterator[tuple[Swimming, FloatArray]]:
        """Robots after one period with an action each, and what a camera shows in it (n, 3)."""
        for first in range(0, len(given), WIDTH):
            yield from self._swum(given[first : first + WIDTH])

    def _swum(self, given: Sequence[tuple[Swimming, int]]) -> Iterator[tuple[Swimming, FloatArray]]:
        start_s, period_s = given[0][0].amid.time_s, self.robot.period_s
        batch = gentle(self.robot, np.zeros((len(given), 3)), COARSE_STEP_S)
        actings = []
        for lane, (robot, action) in enumerate(given):
            batch.enter(lane, robot.amid)
            actings.append(robot.acting.copy())
            for at_s, limb in strokes_of(self.robot, action, start_s):
                row = batch.motion_world()[lane]
                stroke = actings[-1].stroke(0, limb, at_s, body_at(at_s, row[:3], row[3:6]))
                later_s, slower = at_s + stroke.delay_s, stroke.duration_scale
                batch.fire(lane, limb, later_s, gain=stroke.gain, duration_scale=slower)
        leg_s = actings[0].leg_s
        legs = 1 if math.isinf(leg_s) else max(1, round(period_s / leg_s))
        parts: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in given]
        for leg in range(1, legs + 1):
            if not math.isinf(leg_s):
                now_s, motion = start_s + period_s * (leg - 1) / legs, batch.motion_world()
                for lane, acting in enumerate(actings):
                    row = motion[lane]
                    batch.set_water(lane, acting.water(batch, now_s, row[:3], row[3:6]))
            told = batch.advance(start_s + period_s * leg / legs, trace=True)
            for part, (times_s, rows) in zip(parts, told, strict=True):
                part.append((times_s, rows[:, :3]))
        for lane, ((robot, _), part) in enumerate(zip(given, parts, strict=True)):
            times_s = np.concatenate([robot.times_s, *(at_s for at_s, _ in part)])
            poses = np.concatenate([robot.poses, *(rows for _, rows in part)])
            poses[:, 2] = np.unwrap(poses[:, 2])
            swum = Swimming(batch.leave(lane), actings[lane], times_s, poses)
            yield swum, self._shown(swum, _instants(start_s, period_s))

    def put(self, robot: Swimming, offset: FloatArray, rate: FloatArray) -> Swimming:
        """A robot moved and sped up as a whole, and its way with it, of which only the last is kept."""
        batch = gentle(self.robot, np.zeros((1, 3)), COARSE_STEP_S)
        batch.enter(0, robot.amid)
        batch.shift(0, offset.tolist(), rate.tolist())
        now_s = robot.amid.time_s
        kept = robot.times_s >= now_s - _BACK_S
        poses = robot.poses + offset + (robot.times_s - now_s)[:, None] * rate
        return Swimming(batch.leave(0), robot.acting, robot.times_s[kept], poses[kept])

    def _shown(self, robot: Swimming, claims_s: FloatArray) -> FloatArray:
        """(n, 3) what fixes that claim these times show."""
        times_s, poses = robot.times_s, robot.poses
        if self.seeing:
            some = np.linspace(max(times_s[0], claims_s[0] - _BACK_S), times_s[-1], 60)
            seen = [self._seen(at_s, _at(times_s, poses, np.array([at_s]))[0]) for at_s in some.tolist()]
            times_s, poses = np.array(seen)[:, 0], np.array(seen)[:, 1:]
        return _at(times_s, poses, claims_s)

    def _seen(self, time_s: float, pose: FloatArray) -> FloatArray:
        """(4,) the time that a fix of a pose claims, and what it shows."""
        x, y, heading = (float(value) for value in pose)
        fix = Fix(time_s, LATE_S, x, y, heading)
        for effect in self.seeing:
            fix = effect.fix(fix, np.random.default_rng(0)) or fix
        turned = math.remainder(fix.heading_rad - heading, math.tau)
        return np.array([fix.capture_s, fix.x_m, fix.y_m, heading + turned])


def strokes_of(robot: Robot, action: int, start_s: float) -> list[tuple[float, int]]:
    """(time_s, limb) of an action, in order."""
    chosen = robot.actions[action]
    pairs = ((start_s, chosen.first_mask), (start_s + robot.second_delay_s, chosen.second_mask))
    return [(at_s, limb) for at_s, mask in pairs for limb in range(len(robot.limbs)) if mask >> limb & 1]


def _instants(start_s: float, period_s: float) -> FloatArray:
    """When a camera looks in a period."""
    count = max(len(PARTS), round(period_s / CAMERA_S))
    return start_s + period_s * (np.arange(count) + 0.5) / count


def _at(times_s: FloatArray, poses: FloatArray, at_s: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(at_s, times_s, poses[:, axis]) for axis in range(3)])


def grow(
    rows: Sequence[Row],
    sides: Sequence[Side],
    white: FloatArray,
    robot: Robot,
    actions: Sequence[int] | None = None,
) -> Iterator[Row]:
    """Every row with every action after it."""
    pairs = [(row, a) for row in rows for a in (range(len(robot.actions)) if actions is None else actions)]
    swum = [list(side.swum([(row.robots[k], a) for row, a in pairs])) for k, side in enumerate(sides)]
    for (row, action), (one, shown), (other, beside) in zip(pairs, *swum, strict=True):
        start_s = row.robots[0].amid.time_s
        instants = _instants(start_s, robot.period_s)
        gap = shown - beside
        ahead = _miss(gap, (instants - start_s) / robot.period_s, float(shown[0, 2]))
        square = row.square + float((np.clip(ahead @ white, -WILD, WILD) ** 2).sum())
        if one.amid.failed or other.amid.failed:
            continue
        late = instants >= start_s + robot.period_s - _GLIDE_S
        design = np.column_stack([np.ones(late.sum()), instants[late] - start_s - robot.period_s])
        offset, rate = np.linalg.lstsq(design, gap[late], rcond=None)[0]
        robots = (sides[0].put(one, np.zeros(3), np.zeros(3)), sides[1].put(other, offset, rate))
        yield Row((*row.actions, action), square, robots, (*row.told, shown))


def _miss(gap: FloatArray, share: FloatArray, heading_rad: float) -> FloatArray:
    """(9,) what Track.missed has of a period."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    found: list[float] = []
    for low, high in PARTS:
        x, y, turn = gap[(low <= share) & (share < high)].mean(axis=0).tolist()
        found += [c * x + s * y, c * y - s * x, turn]
    return np.array(found)


def segments_of_row(robot: Robot, row: Row, start: FloatArray) -> Segments:
    """The first model's way along a row, as a run of fixes without noise."""
    start_s = np.asarray(robot.period_s * np.arange(len(row.actions)), dtype=np.float64)
    before_s = -CAMERA_S * np.arange(15, 0, -1)
    time_s = np.concatenate([before_s, *(_instants(float(at_s), robot.period_s) for at_s in start_s)])
    pose = np.concatenate([np.tile(start, (len(before_s), 1)), *row.told])
    strokes = [
        each
        for at_s, action in zip(start_s.tolist(), row.actions, strict=True)
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
        action=np.array(row.actions, dtype=np.int64),
        end_s=np.asarray(start_s + robot.period_s),
        period_s=robot.period_s,
        lag_s=0.0,
    )
