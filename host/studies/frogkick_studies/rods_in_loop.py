"""Planners with three models in the simulated pool: two tables, and the rods themselves.

The paper asks what its planner would do with the rod simulation in the loop instead of a table. Here one
planner, with one cost and one depth, follows paths in the simulated pool without hidden effects. Its model of
the actions is the full nearest table, the robot's affine table, or the rods themselves (a model oracle):
copies of the simulated robots, with body and limbs, try every sequence of actions. No table can be a better
model.

All three start equally, at a seed's distance from the path, get the same late, noisy fixes and use the
robot's own estimator, so they differ only in the transitions. The rods need no measured velocity; a table is
looked up with the estimated one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.chunks import Job, run_chunks
from frogkick.core.errors import ConvergenceError, FrogkickError
from frogkick.core.poses import Fix, body_from_world, relative, wrap_angle
from frogkick.der import STEP_S, WIDTH, Batch, interpolate
from frogkick.effects import Acting, rods_of
from frogkick.effects.acting import lane_effects, program_of
from frogkick.estimator.estimator import Estimator
from frogkick.estimator.follow import End, Follow
from frogkick.library.fitting import looked_up
from frogkick.library.transitions import previous_actions
from frogkick.paths import Path, shape
from frogkick.planner.plan import PlanConfig, config_of, plan
from frogkick.pool.pool import Camera, measure
from frogkick.robot import Robot
from frogkick.tables.image import Tables, open_image
from frogkick_studies.configs import Ceiling

NEAREST, AFFINE, RODS = "nearest", "affine", "rods"
SOURCES = (NEAREST, AFFINE, RODS)
SETTLE_S = 1.0
"""Time of fixes before the first decision, in which the estimator finds the robot at rest."""

TIME = "time limit"
_START = np.array([0.005, 0.005, np.deg2rad(5.0)])
"""Spread of the initial pose around the path's start: m, m, rad."""


@dataclass(frozen=True)
class Task:
    """A batch of runs of one model at one depth along one path, with a lane for each seed."""

    path: str
    source: str
    depth: int
    seeds: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Run:
    """One run.

    Attributes:
        source: the planner's model, one of SOURCES.
        depth: its search depth.
        mean_distance_m: mean distance of the true poses to the path, from the first decision on.
        progress_mps: progress along it, from the first decision to the end of the run.
        ended: reason of its end, a value of ``End`` or TIME.
        planned: (n, 3) forward, left (m), turn (rad): the motion that the planner predicted from the
            estimated state minus the motion that followed; a row for each decision.
        told: (n, 3) the same, predicted from the true state: without the estimator's error.
    """

    path: str
    source: str
    depth: int
    seed: int
    mean_distance_m: float
    progress_mps: float
    ended: str
    planned: Float64
    told: Float64

    @property
    def completed(self) -> bool:
        """Whether the path's end was reached."""
        return self.ended == End.COMPLETED.value


Progress = Callable[[int, int], None]


def follow_paths(
    robot: Robot,
    images: Mapping[str, bytes],
    paths: Sequence[str],
    depths: Sequence[int],
    seeds: int,
    limit_s: float = Ceiling.simulated_time,
    workers: int = 1,
    progress: Progress = lambda _done, _all: None,
) -> list[Run]:
    """Follow each path with each model at each depth.

    Args:
        robot: the robot, with its planner's cost and weights.
        images: NEAREST and AFFINE -> table image. The estimator uses the affine one.
        depths: search depths, 1 or 2: a beam search looks further than the rods are asked.
        seeds: number of seeds, of the camera's noise and of the start.
        limit_s: time limit of a run in pool time, s.

    Returns:
        The runs, by path, source, depth and seed; the same for any number of processes.
    """
    lanes = [tuple(range(first, min(first + WIDTH, seeds))) for first in range(0, seeds, WIDTH)]
    tasks = [Task(p, s, d, some) for p in paths for s in SOURCES for d in depths for some in lanes]
    # The longest first, so that no process is left with one at the end.
    tasks.sort(key=lambda task: (-task.depth, task.source != RODS))
    job = Job(_start, (robot, dict(images), limit_s), _run, _warm)
    found: list[Run] = []
    whole = sum(len(task.seeds) for task in tasks)
    progress(0, whole)
    for _, runs in run_chunks(job, tasks, workers):
        found += runs
        progress(len(found), whole)
    return sorted(found, key=lambda r: (paths.index(r.path), SOURCES.index(r.source), r.depth, r.seed))


@dataclass(frozen=True)
class _Ready:
    robot: Robot
    tables: dict[str, Tables]
    limit_s: float


def _start(robot: Robot, images: dict[str, bytes], limit_s: float) -> _Ready:
    return _Ready(robot, {name: open_image(image) for name, image in images.items()}, limit_s)


def _warm(ready: _Ready) -> None:
    """Make one decision, which compiles all that a run calls."""
    for source in SOURCES:
        _run(replace(ready, limit_s=SETTLE_S), Task("line", source, 1, (0,)))


class _Lane:
    """The state of one run's planner: fixes, place along the path, actions and predictions."""

    def __init__(self, reference: Tables, path: Path, config: PlanConfig, seed: int) -> None:
        self.seed = seed
        self.ended = ""
        self.end_s = np.inf
        self.actions: list[int] = []
        self.velocity_body: list[Float64] = []
        self.expected: list[Float64] = []
        self.made: list[Float64] = []
        self.seen: list[tuple[float, Float64]] = []
        self._path, self._config = path, config
        self._camera = Camera()
        self._rng = np.random.default_rng(seed)
        self._estimator, self._follow = Estimator(reference), Follow(reference, path, config)
        self._captured = 0
        self._under_way: list[Fix] = []

    def look(self, times_s: Float64, rows: Float64) -> None:
        """Take the camera's pictures of a part of the swim."""
        captures = []
        while (capture_s := (self._captured + 1) / self._camera.rate_hz) <= times_s[-1]:
            captures.append(capture_s)
            self._captured += 1
        first = self._captured - len(captures)
        poses = interpolate(times_s, rows, np.array(captures))[0]
        for number, (capture_s, pose) in enumerate(zip(captures, poses, strict=True), start=first):
            self._under_way.append(measure(self._camera, number, capture_s, pose, self._rng))
            self.seen.append((capture_s, pose))

    def hear(self, until_s: float) -> None:
        """Receive fixes; one of them may end the run."""
        while self._under_way and self._under_way[0].arrival_s <= until_s and not self.ended:
            fix = self._under_way.pop(0)
            if self._estimator.add(round(fix.capture_s * 1e6), fix.pose_world, fix.sequence) == 0:
                end = self._follow.fixed(fix.pose_world[0], fix.pose_world[1])
                if end is not None:
                    self.ended, self.end_s = end.value, fix.arrival_s

    def decide(self, at_s: float, tables: Tables, is_tree: bool) -> int | None:
        """Return the next action, or None if the run is over; a table of a tree begins at the velocity 0."""
        at_us = round(at_s * 1e6)
        estimate = self._estimator.at(at_us)
        if estimate is None:
            raise FrogkickError(f"no state is known at {at_s} s of a run without lost fixes")
        state = estimate.state.copy()
        if is_tree:
            state[3:] = 0.0
        made = plan(
            tables, self._path, self._config, state, estimate.limb_use, float(self._follow.along_points)
        )
        end = self._follow.decided(made)
        if end is not None:
            self.ended, self.end_s = end.value, at_s
            return None
        self._estimator.act(at_us, made.action)
        apart = made.predicted[:3].astype(np.float64) - state[:3]
        apart[2] = wrap_angle(apart[2])
        self.expected.append(body_from_world(np.float64(state[2]), apart))
        self.actions.append(made.action)
        return made.action

    def progress_mps(self) -> float:
        """Return the progress along the path, by the place that the planner carries along."""
        arc_m = self._path.along_m
        reached = len(arc_m) - 1 if self.ended == End.COMPLETED.value else float(self._follow.along_points)
        return float(np.interp(reached, np.arange(len(arc_m)), arc_m)) / (self.end_s - SETTLE_S)


def _run(ready: _Ready, task: Task) -> list[Run]:
    """Simulate runs side by side until all are over."""
    robot, path, reference = ready.robot, shape(task.path), ready.tables[AFFINE]
    # No time limit: otherwise the models would differ in the depth of their searches as well.
    config = replace(config_of(robot.planner), depth=task.depth, transitions_max=0)
    lanes = [_Lane(reference, path, config, seed) for seed in task.seeds]
    first = np.array([path.x_m[0], path.y_m[0], path.tangent_rad[0]], dtype=np.float64)
    begin = np.array([first + np.random.default_rng([seed, 1]).normal(0.0, _START) for seed in task.seeds])
    batch = Batch([rods_of(robot)] * len(lanes), begin, np.zeros_like(begin), 0.0, STEP_S, WIDTH)
    acting = lane_effects(robot, len(lanes))
    still = batch.motion_world()
    for (times_s, rows), lane, row in zip(
        acting.advance(batch, SETTLE_S, trace=True), lanes, still, strict=True
    ):
        lane.look(np.concatenate([[0.0], times_s]), np.concatenate([row[None], rows]))
    asked: list[list[Float64]] = [[] for _ in lanes]
    at_s = SETTLE_S
    while True:
        for lane in lanes:
            lane.hear(at_s)
        going = [k for k, lane in enumerate(lanes) if not lane.ended]
        if not going:
            break
        motions = ask_rods(robot, batch, acting, task.depth) if task.source == RODS else None
        velocity = batch.velocity_body()
        chosen: dict[int, int] = {}
        for k in going:
            tree = None if motions is None else table_of_motions(motions[k], reference)
            action = lanes[k].decide(
                at_s, ready.tables[task.source] if tree is None else tree, tree is not None
            )
            if action is not None:
                chosen[k] = action
                lanes[k].velocity_body.append(velocity[k])
                if motions is not None:
                    asked[k].append(motions[k, 0, action])
        if chosen:
            for k, (times_s, rows) in swim_a_period(robot, batch, acting, chosen).items():
                lanes[k].made.append(motion_of(times_s, rows))
                lanes[k].look(times_s, rows)
        at_s += robot.period_s
        if at_s > ready.limit_s:
            for lane in lanes:
                lane.ended, lane.end_s = (lane.ended, lane.end_s) if lane.ended else (TIME, at_s)
    return [
        _result(ready, task, path, lane, np.array(said).reshape(-1, 3))
        for lane, said in zip(lanes, asked, strict=True)
    ]


def _result(ready: _Ready, task: Task, path: Path, lane: _Lane, asked: Float64) -> Run:
    made = np.array(lane.made).reshape(-1, 3)
    done = np.array(lane.actions, dtype=np.int64)
    if task.source != RODS and len(done):
        earlier = np.array([previous_actions(done, stroke) for stroke in range(len(done))])
        found = looked_up(ready.tables[task.source], np.array(lane.velocity_body), earlier)
        asked = found[np.arange(len(done)), done, :3]
    during = [(time_s, pose) for time_s, pose in lane.seen if SETTLE_S <= time_s <= lane.end_s]
    poses = np.array([pose for _, pose in during]).reshape(-1, 3)
    planned = np.array(lane.expected).reshape(-1, 3) - made
    return Run(
        task.path,
        task.source,
        task.depth,
        lane.seed,
        float(path.distance_m(poses[:, :2]).mean()),
        lane.progress_mps(),
        lane.ended,
        _wrapped(planned),
        _wrapped(asked - made),
    )


def _wrapped(errors: Float64) -> Float64:
    found = errors.copy()
    found[:, 2] = wrap_angle(found[:, 2])
    return found


_APART = 100  # velocity codes between the names of a tree's nodes


def swim_a_period(
    robot: Robot, batch: Batch, acting: Acting, actions: Mapping[int, int]
) -> dict[int, tuple[Float64, Float64]]:
    """Advance some lanes by one action and period.

    Returns:
        lane -> (k,) times, s, and (k, MOTION) rows, the start first.
    """
    start_s, before, until = batch.time_s.copy(), batch.motion_world(), batch.time_s.copy()
    for lane, action in actions.items():
        acting.fire_all(batch, lane, program_of(robot, robot.actions[action], float(start_s[lane])))
        until[lane] += robot.period_s
    traces = acting.advance(batch, until, trace=True)
    for lane, failure in batch.failures.items():
        raise ConvergenceError(f"a swim of {robot.id!r} {failure} (lane {lane})")
    return {
        lane: (
            np.concatenate([start_s[lane : lane + 1], traces[lane][0]]),
            np.concatenate([before[lane : lane + 1], traces[lane][1]]),
        )
        for lane in actions
    }


def motion_of(times_s: Float64, rows: Float64) -> Float64:
    """Return (3,) the motion from the first row to the last one, in the body frame of the first."""
    pose = interpolate(times_s, rows, times_s[[0, -1]])[0]
    return relative(pose[0], pose[1])


def ask_rods(robot: Robot, batch: Batch, acting: Acting, depth: int) -> Float64:
    """Let copies of the simulated robots try every sequence of actions.

    Args:
        batch, acting: the robots at a decision; they are not changed.
        depth: number of actions in a sequence.

    Returns:
        (lanes, nodes, a, 3) motions over a period, forward, left (m), turn (rad), in the body frame at its
        start. The nodes of the tree are the present, then the ends of actions 0, 1, ..., then those of the
        sequences (0, 0), (0, 1), ...
    """
    lanes, actions, nodes = batch.lanes, len(robot.actions), 1
    levels: list[Float64] = []
    level = [(batch, acting, [(lane, 0) for lane in range(lanes)])]  # and whose robots, at which node
    while len(levels) < depth:
        motions, following = np.empty((lanes, nodes, actions, 3)), []
        for before, acted, who in level:
            tries = [(place, action) for action in range(actions) for place in range(len(who))]
            for first in range(0, len(tries), WIDTH):
                some = tries[first : first + WIDTH]
                of = [place for place, _ in some]
                twin, twin_acting = before.pick(of), acted.pick(of)
                done = {to: action for to, (_, action) in enumerate(some)}
                swum = swim_a_period(robot, twin, twin_acting, done)
                ends = []
                for to, (place, action) in enumerate(some):
                    lane, node = who[place]
                    motions[lane, node, action] = motion_of(*swum[to])
                    ends.append((lane, node * actions + action))
                if len(levels) < depth - 1:
                    following.append((twin, twin_acting, ends))
        levels.append(motions)
        level, nodes = following, nodes * actions
    return np.concatenate(levels, axis=1)


def table_of_motions(motions: Float64, like: Tables) -> Tables:
    """Return a table in which the planner finds the motions of a tree instead of those of velocities.

    The velocity at the end of an action is replaced by the name of the next node; the present has the
    velocity 0. The planner's costs depend only on poses, so it searches as in any table.

    Args:
        motions: (nodes, a, 3) result of ``ask_rods`` for a lane.
        like: table with the actions, scales and reach; the reach grows if a motion exceeds it.
    """
    nodes, actions = motions.shape[:2]
    name = np.zeros((nodes * actions + 1, 3), dtype=np.int64)
    name[:nodes, 0], name[:nodes, 1] = np.arange(nodes) % _APART, np.arange(nodes) // _APART
    name *= _APART
    leads_to = 1 + np.arange(nodes * actions).reshape(nodes, actions)
    codes = np.rint(motions / like.motion_scale.astype(np.float64)).astype(np.int64)
    arrays = {
        "states": name[:nodes].astype(np.int16),
        "transitions": np.concatenate([codes, name[leads_to]], axis=2).astype(np.int32),
        "derivatives": np.empty((0, actions, 6, 3), dtype=np.int32),
        "motion_limit": np.maximum(like.motion_limit, np.abs(codes).max(axis=(0, 1))),
    }
    for array in arrays.values():
        array.setflags(write=False)  # as an opened image's: else numba compiles the planner once more
    return replace(like, image=b"", kind="nearest", **arrays)  # the image is nowhere but here
