"""What to record next: optimal experiment design for the discrimination of two models.

Two models explain the runs equally well: the one found, and the one with a confounded effect in its place, or
with a parameter at either end of its interval and all others refitted. From rest both are simulated side by
side. A beam search keeps the sequences of actions whose periods the two models predict farthest apart, in
units of the residuals' scale (the T-optimality of Atkinson, Fedorov 1975). The second robot is put to the
first one's pose when a period begins. The separation that is reported is computed as identification would see
it: both models are rolled out on the first one's fixes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.der import WIDTH, Checkpoint
from frogkick.effects import Acting, Fix, Law, changed_robot
from frogkick.effects.acting import program_of
from frogkick.identification.fit import CONFOUNDED_MARGIN, Model, residuals_of, rollouts_of
from frogkick.identification.predict import PHASES, interpolated, phase_residuals, replay_batch, shown_fix
from frogkick.identification.refine import fixed_at
from frogkick.identification.screening import COARSE_STEP_S
from frogkick.identification.search import Found
from frogkick.identification.segments import Segments
from frogkick.identification.steps import whitener
from frogkick.identification.terms import Interval, Term
from frogkick.robot import Robot, in_a_row

PERIODS = 10  # periods of a planned sequence
BEAM_WIDTH = 3  # width of the beam: sequences that are extended
WIDE = 0.5  # an interval that covers this share of a parameter's bounds calls for an experiment
PAIRS_MAX = 2  # pairs that are planned for at most: each costs some seconds

DECISIVE_SIGMA = math.sqrt(CONFOUNDED_MARGIN) + 1.0
"""From this separation on, one recording is decisive: models are confounded up to CONFOUNDED_MARGIN."""

POOL_M = 0.6
"""Side of the square that a sequence stays in, about the middle of the runs, unless these went further."""

CLIP_SIGMA = 8.0  # differences between two predictions are clipped at this many standard deviations

CAMERA_S, LATE_S = 1.0 / 15.0, 0.08  # time between fixes, and from a picture to its fix

_BACK_S = 0.7  # of trajectory before the present, for fixes that are older than stated
_GLIDE_S = 0.4  # at a period's end, that the start of the next one is estimated from


@dataclass(frozen=True, eq=False)
class ModelPair:
    """Two models that the runs do not discriminate, and their names."""

    between: tuple[str, str]
    models: tuple[Model, Model]


@dataclass(frozen=True, eq=False)
class Experiment:
    """A sequence of actions from rest.

    Attributes:
        between: names of the two models.
        actions: their names.
        start: pose (world: m, m, rad) that it starts from.
        separation_sigma: distance between both predictions of its periods: norm of the whitened difference.
    """

    between: tuple[str, str]
    actions: tuple[str, ...]
    start: tuple[float, float, float]
    separation_sigma: float

    @property
    def decisive(self) -> bool:
        """Whether one recording discriminates the two models."""
        return self.separation_sigma >= DECISIVE_SIGMA

    @property
    def sequence(self) -> str:
        """Its actions as text."""
        return in_a_row(self.actions)

    @property
    def text(self) -> str:
        """What to record, in words."""
        one, other = self.between
        apart = f"{len(self.actions)} periods, {self.separation_sigma:.1f} sigma apart"
        if self.decisive:
            return f"to distinguish {one} from {other}, record from rest: {self.sequence} ({apart})"
        times = math.ceil((DECISIVE_SIGMA / max(self.separation_sigma, 1e-3)) ** 2)
        if times <= PERIODS:
            return (
                f"to distinguish {one} from {other}, record {times} times from rest: {self.sequence} "
                f"({apart} each)"
            )
        return (
            f"no sequence of these actions from rest distinguishes {one} from {other} "
            f"(the best one is {self.sequence}: {apart})"
        )

    def as_json(self) -> dict[str, Any]:
        """The key ``experiment`` of the command ``identify``."""
        return {
            "between": list(self.between),
            "actions": self.sequence,
            "periods": len(self.actions),
            "separation_sigma": self.separation_sigma,
            "tells": self.decisive,
            "text": self.text,
        }


def experiment_of(
    found: Found, parameters: Sequence[Sequence[Interval]], swims: Sequence[Segments], periods: int = PERIODS
) -> Experiment | None:
    """The experiment that discriminates best what a search left open; None if nothing is open.

    A sequence starts where the first of the runs did and stays where they went.
    """
    return _best(open_pairs(found, parameters), found, swims, periods)


def law_test(found: Found, swims: Sequence[Segments]) -> Experiment | None:
    """The experiment that distinguishes a model best from itself without one of its laws; None without laws.

    A formula that was chosen among many is worth a test, even if nothing else is open.
    """
    model, pairs = found.fitted.model, []
    for place, term in enumerate(model.terms):
        effect = term.effect()
        if isinstance(effect, Law) and not effect.by_chance:
            terms = (*model.terms[:place], *model.terms[place + 1 :])
            without = replace(model, terms=terms, fixed=frozenset())
            pairs.append(ModelPair((term.title, f"no {term.title}"), (model, without)))
    return _best(pairs, found, swims)


def _best(
    pairs: Sequence[ModelPair], found: Found, swims: Sequence[Segments], periods: int = PERIODS
) -> Experiment | None:
    """The experiment that discriminates one of the pairs best; None without pairs."""
    white = whitener(found.fitted.residuals)
    first = swims[0]
    start = first.pose[np.searchsorted(first.time_s, first.begin_s)]
    pool = pool_of(swims)
    best: Experiment | None = None
    for pair in pairs[:PAIRS_MAX]:
        planned = plan(pair, white, start, pool, periods)
        if best is None or planned.separation_sigma > best.separation_sigma:
            best = planned
        if best.decisive:
            break
    return best


def open_pairs(found: Found, parameters: Sequence[Sequence[Interval]]) -> list[ModelPair]:
    """Pairs of models to discriminate: confounded effects, then parameters, the widest interval first."""
    model, pairs = found.fitted.model, list[ModelPair]()
    for place, others in enumerate(found.rivals):
        for other in others:
            terms = (*model.terms[:place], other, *model.terms[place + 1 :])
            names = (model.terms[place].title, other.title)
            pairs.append(ModelPair(names, (model, replace(model, terms=terms, fixed=frozenset()))))
    wide: list[tuple[float, ModelPair]] = []
    for place, row in enumerate(parameters):
        for k, interval in zip(model.indices(place), row, strict=True):
            share = (interval.high - interval.low) / float(model.reach[k])
            if share >= WIDE:
                wide.append((share, _ends(found, model.terms[place], k, interval)))
    wide.sort(key=lambda each: -each[0])
    return pairs + [pair for _, pair in wide]


def _ends(found: Found, term: Term, k: int, interval: Interval) -> ModelPair:
    """A parameter at either end of its interval, the others refitted."""
    low, high = (fixed_at(found.fitted, k, end) for end in (interval.low, interval.high))
    names = [f"{term.title} {interval.name} {end:.3g}" for end in (interval.low, interval.high)]
    return ModelPair((names[0], names[1]), (low, high))


def pool_of(swims: Sequence[Segments]) -> Float64:
    """(2, 2) low and high corner of the square that a sequence must stay in."""
    every = np.concatenate([swim.pose[:, :2] for swim in swims])
    low, high = every.min(axis=0), every.max(axis=0)
    half = max(POOL_M, float((high - low).max())) / 2.0
    return np.array([(low + high) / 2.0 - half, (low + high) / 2.0 + half])


def plan(
    pair: ModelPair, white: Float64, start: Float64, pool: Float64, periods: int = PERIODS
) -> Experiment:
    """The sequence of actions that discriminates two models best, by beam search.

    Args:
        white: (9, 9) whitening matrix of residuals (Rollout.residuals).
        start: (3,) pose of the robot at rest, as the camera shows it.
        pool: (2, 2) see ``pool_of``.
        periods: actions at most; fewer where all further ones leave the pool.
    """
    robot = pair.models[0].robot
    sides = [Side(model) for model in pair.models]
    sequences = [ActionSequence((), 0.0, tuple(side.at_rest(start) for side in sides), ())]
    for _ in range(periods):
        reached = [
            sequence
            for sequence in extend(sequences, sides, white, robot)
            if ((sequence.shown[-1][:, :2] >= pool[0]) & (sequence.shown[-1][:, :2] <= pool[1])).all()
        ]
        if not reached:
            break
        sequences = sorted(reached, key=lambda sequence: -sequence.distance2)[:BEAM_WIDTH]
    best = sequences[0]
    names = tuple(robot.actions[index].name for index in best.actions)
    at = (float(start[0]), float(start[1]), float(start[2]))
    return Experiment(
        pair.between, names, at, separation(pair, white, segments_of_sequence(robot, best, start))
    )


def separation(pair: ModelPair, white: Float64, swim: Segments) -> float:
    """Separation of two models on a sequence of the first one; see ``Experiment.separation_sigma``."""
    if not len(swim.start_s):
        return 0.0
    one, other = (
        residuals_of(rollouts, np.ones(len(swim.start_s), dtype=bool))
        for rollouts in rollouts_of(pair.models, [swim])
    )
    apart = np.clip((other - one) @ white, -CLIP_SIGMA, CLIP_SIGMA)
    return float(np.sqrt((apart**2).sum()))


@dataclass(frozen=True, eq=False)
class RobotState:
    """A simulated robot when a period begins, and (n,), (n, 3) its trajectory just before."""

    checkpoint: Checkpoint
    acting: Acting
    times_s: Float64
    poses: Float64


@dataclass(frozen=True, eq=False)
class ActionSequence:
    """A sequence of actions and the robots after it."""

    actions: tuple[int, ...]  # by index
    distance2: float  # squared separation of both models so far
    robots: tuple[RobotState, ...]  # of both models
    shown: tuple[Float64, ...]  # (n, 3) poses that the first one's camera shows in each period


class Side:
    """One of the two models, as robots to simulate."""

    def __init__(self, model: Model) -> None:
        self.effects = model.effects
        self.robot = changed_robot(model.robot, self.effects)
        self.camera_effects = [effect for effect in self.effects if effect.overrides("fix")]
        self._leg_s = model.leg_s

    def at_rest(self, shown: Float64) -> RobotState:
        """A robot at rest whose camera shows a pose."""
        pose = np.array(shown, dtype=np.float64)
        for _ in range(4):
            pose = pose + shown - self._camera_fix(0.0, pose)[1:]
        acting = Acting(self.effects, self.robot, [np.random.default_rng(0)], self._leg_s)
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
            program = program_of(self.robot, self.robot.actions[action], start_s)
            actings[-1].fire_all(batch, lane, program, 0)
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

    def _camera_fixes(self, robot: RobotState, stated_s: Float64) -> Float64:
        """(n, 3) poses that fixes with these stated times show."""
        times_s, poses = robot.times_s, robot.poses
        if self.camera_effects:
            some = np.linspace(max(times_s[0], stated_s[0] - _BACK_S), times_s[-1], 60)
            fixes = [
                self._camera_fix(at_s, interpolated(times_s, poses, np.array([at_s]))[0])
                for at_s in some.tolist()
            ]
            times_s, poses = np.array(fixes)[:, 0], np.array(fixes)[:, 1:]
        return interpolated(times_s, poses, stated_s)

    def _camera_fix(self, time_s: float, pose: Float64) -> Float64:
        """(4,) the stated time of a fix of a pose, and the pose that it shows."""
        fix = Fix(time_s, LATE_S, *pose.tolist())
        return np.array(shown_fix(self.camera_effects, fix, np.random.default_rng(0)))


def _instants(start_s: float, period_s: float) -> Float64:
    """Capture times in a period."""
    count = max(len(PHASES), round(period_s / CAMERA_S))
    return start_s + period_s * (np.arange(count) + 0.5) / count


def extend(
    sequences: Sequence[ActionSequence],
    sides: Sequence[Side],
    white: Float64,
    robot: Robot,
    actions: Sequence[int] | None = None,
) -> Iterator[ActionSequence]:
    """Extend every sequence by every action."""
    some = range(len(robot.actions)) if actions is None else actions
    pairs = [(sequence, action) for sequence in sequences for action in some]
    advanced = [
        list(side.advanced([(sequence.robots[k], a) for sequence, a in pairs]))
        for k, side in enumerate(sides)
    ]
    for (sequence, action), (one, shown), (other, beside) in zip(pairs, *advanced, strict=True):
        start_s = sequence.robots[0].checkpoint.time_s
        instants = _instants(start_s, robot.period_s)
        gap = shown - beside
        ahead = phase_residuals(gap, (instants - start_s) / robot.period_s, float(shown[0, 2]))
        distance2 = sequence.distance2 + float((np.clip(ahead @ white, -CLIP_SIGMA, CLIP_SIGMA) ** 2).sum())
        if one.checkpoint.failed or other.checkpoint.failed:
            continue
        late = instants >= start_s + robot.period_s - _GLIDE_S
        design = np.column_stack([np.ones(late.sum()), instants[late] - start_s - robot.period_s])
        offset, rate = np.linalg.lstsq(design, gap[late], rcond=None)[0]
        robots = (sides[0].put(one, np.zeros(3), np.zeros(3)), sides[1].put(other, offset, rate))
        yield ActionSequence((*sequence.actions, action), distance2, robots, (*sequence.shown, shown))


def segments_of_sequence(robot: Robot, sequence: ActionSequence, start: Float64) -> Segments:
    """The first model's trajectory along a sequence, as a run of fixes without noise."""
    start_s = np.asarray(robot.period_s * np.arange(len(sequence.actions)), dtype=np.float64)
    before_s = -CAMERA_S * np.arange(15, 0, -1)
    time_s = np.concatenate([before_s, *(_instants(float(at_s), robot.period_s) for at_s in start_s)])
    pose = np.concatenate([np.tile(start, (len(before_s), 1)), *sequence.shown])
    strokes = [
        (fired_s, limb)
        for at_s, action in zip(start_s.tolist(), sequence.actions, strict=True)
        for fired_s, mask in program_of(robot, robot.actions[action], at_s)
        for limb in range(len(robot.limbs))
        if mask >> limb & 1
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
