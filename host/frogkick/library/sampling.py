"""States at the start of a library's transitions: drawn from a box, or visited by random or planned swims.

Planned swims take the actions that the planner chooses while it follows random paths, by a small table from
random swims; the rods simulate its choices. The states at the start of these strokes are those that a better
table should have.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Float32, Float64
from frogkick.core.chunks import Job, run_chunks
from frogkick.core.errors import ConvergenceError, InputError, nearest_name
from frogkick.core.poses import wrap_angle
from frogkick.der import STEP_S, WIDTH, Batch, Rods
from frogkick.effects import rods_of
from frogkick.effects.acting import lane_effects, program_of
from frogkick.library.starts import Starts, VisitedStates, random_swims, rigid_starts
from frogkick.library.store import library_of, quantise
from frogkick.library.transitions import simulate_task
from frogkick.planner.plan import config_of, plan_batch
from frogkick.robot import Robot, mirror_of
from frogkick.tables.image import Tables, open_image

_FIRST_TABLE_STATES = 64
_STROKES = 16  # of a planned swim: as long as the paper's shorter runs
_CLUSTER_BATCHES = 32  # of WIDTH swims each, sent to a cluster at once
_POINTS = 100
_ARCS = 3  # a path is this many arcs of random curvature
_TIGHTEST = 3.0  # of their curvature over the tightest turn of a single stroke
# The paper's cost rewards the finished part of the path. On longer paths moving would not pay, so the reward
# grows with the length.
_REWARDED_LENGTH_M = 0.45


@dataclass(frozen=True, eq=False)
class _Path:
    """A path for the planner: (n,) float32 each, world frame."""

    x_m: Float32
    y_m: Float32
    tangent_rad: Float32


def planned_swims(
    robot: Robot, seed: int, workers: int = 1, cluster: str | None = None
) -> Iterator[list[list[int]]]:
    """Yield the actions of planned swims from rest, without end.

    Each swim has a path and a generator of its own; workers and cluster do not change the swims.
    """
    job = Job(_start, (robot, seed, first_table(robot, seed)), _run, _warm)
    swims_per_round = _CLUSTER_BATCHES if cluster is not None else workers
    for first in itertools.count(0, swims_per_round):
        numbers = list(range(first, first + swims_per_round))
        done = dict(run_chunks(job, numbers, workers, cluster))
        yield from (done[place] for place in range(swims_per_round))


def first_table(robot: Robot, seed: int) -> bytes:
    """The table image of planned swims, from a few states of random swims."""
    rods, visited = rods_of(robot), VisitedStates(robot)
    visited.add(random_swims(robot, seed), _FIRST_TABLE_STATES)
    starts = visited.starts()
    found = starts.unfolded([simulate_task(rods, task) for task in starts.tasks])
    return quantise(library_of(robot, "visited", seed, found))


_Ready = tuple[Rods, Tables, int]


def _start(robot: Robot, seed: int, image: bytes) -> _Ready:
    return rods_of(robot), open_image(image), seed


def _run(ready: _Ready, number: int) -> list[list[int]]:
    rods, tables, seed = ready
    lanes = [np.random.default_rng([seed, 1, number * WIDTH + lane]) for lane in range(WIDTH)]
    return _swim(rods, tables, [_random_path(tables, rng) for rng in lanes], _STROKES)


def _warm(ready: _Ready) -> None:
    _swim(ready[0], ready[1], [_random_path(ready[1], np.random.default_rng(0))], 1)


def _path_length_m(tables: Tables) -> float:
    """Length of a path: the reach of a swim by the longest strokes."""
    return _STROKES * float(tables.stroke_max_m)


def _random_path(tables: Tables, rng: np.random.Generator) -> _Path:
    """Random arcs from the origin."""
    length_m = _path_length_m(tables)
    tightest = _TIGHTEST * float(tables.turn_max_rad) / float(tables.stroke_max_m)
    curvature = tightest * rng.uniform(-1.0, 1.0, _ARCS)
    along = np.linspace(0.0, length_m, _POINTS)
    bend = curvature[np.minimum((along / length_m * _ARCS).astype(int), _ARCS - 1)]
    heading = np.concatenate([[0.0], np.cumsum(bend[:-1] * np.diff(along))])
    steps = np.diff(along)
    x = np.concatenate([[0.0], np.cumsum(np.cos(heading[:-1]) * steps)])
    y = np.concatenate([[0.0], np.cumsum(np.sin(heading[:-1]) * steps)])
    return _Path(*(column.astype(np.float32) for column in (x, y, wrap_angle(heading))))


def _swim(rods: Rods, tables: Tables, paths: Sequence[_Path], strokes: int) -> list[list[int]]:
    """The planner's actions in swims side by side."""
    robot = rods.robot
    config = config_of(robot.planner)
    config = replace(
        config,
        progress_weight=config.progress_weight * _path_length_m(tables) / _REWARDED_LENGTH_M,
        depth=min(config.depth, 2),  # deeper searches cost ten times more and choose nearly the same strokes
    )
    along = [0.0] * len(paths)
    still = np.zeros((len(paths), 3))
    batch = Batch([rods] * len(paths), still, still, 0.0, STEP_S, WIDTH)
    acting = lane_effects(robot, len(paths))
    chosen: list[list[int]] = [[] for _ in paths]
    for stroke in range(strokes):
        pose, velocity = batch.pose_world(), batch.velocity_body()
        for lane, path in enumerate(paths):
            state = np.concatenate([pose[lane], velocity[lane]])
            state[2] = math.remainder(state[2], 2.0 * math.pi)
            made = plan_batch(tables, path, config, state[None], along_points=along[lane])[0]
            along[lane] = float(made["along_points"])
            chosen[lane].append(int(made["action"]))
            action = robot.actions[chosen[lane][-1]]
            acting.fire_all(batch, lane, program_of(robot, action, stroke * robot.period_s))
        acting.advance(batch, (stroke + 1) * robot.period_s)
    for lane, failure in batch.failures.items():
        raise ConvergenceError(f"a planned swim of {robot.id!r} {failure} (lane {lane})")
    return chosen


STATES_MAX = 65535  # a table image counts its states in 16 bits
SAMPLINGS = ("box", "visited", "planned")

_PLANNED_BATCHES_MAX = 1000


def require_draw(states: int, seed: int) -> None:
    """Raise an error if no library has this number of states, or no file holds this seed.

    Raises:
        InputError: states outside of 1 to 65535, or a seed that is negative or too large.
    """
    if not isinstance(states, int | np.integer) or not 1 <= states <= STATES_MAX:
        raise InputError(f"states is {states!r}: give 1 to {STATES_MAX}, a whole number")
    if not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise InputError(f"seed is {seed!r}: give 0 or more, a whole number below 2^63, as files hold it")


def sample_starts(
    robot: Robot,
    states: int,
    seed: int,
    sampling: str = "box",
    workers: int = 1,
    cluster: str | None = None,
) -> Starts:
    """Draw the states of a library.

    Args:
        sampling: "box" draws velocities uniformly from the robot's library box with all limbs at rest, as the
            paper does. "visited" takes the states at the start of the strokes of random swims, which fill a
            small part of the box and contain the limbs' last strokes. "planned" lets the planner steer along
            random paths; a quarter of its states are visited ones. Each state is followed by its mirror
            image if the robot is symmetric. A smaller number of visited states gives the first of them.
        workers, cluster: for planned swims; see frogkick.core.chunks. They do not change the states.

    Raises:
        InputError: states outside of 1 to 65535, a negative seed, an unknown sampling, or planned swims with
            too few states.
        ConvergenceError: a planned swim could not be simulated.
    """
    require_draw(states, seed)
    if sampling == "box":
        return rigid_starts(robot, box_velocities(robot, states, seed))
    visited = VisitedStates(robot)
    if sampling == "visited":
        visited.add(random_swims(robot, seed), states)
        return visited.starts()
    if sampling == "planned":
        visited.add(random_swims(robot, seed), max(1, states // 4))
        for number, swims in enumerate(planned_swims(robot, seed, workers, cluster)):
            visited.add(swims, states)
            if len(visited) == states:
                return visited.starts()
            if number == _PLANNED_BATCHES_MAX:
                raise InputError(
                    f"planned swims of {robot.id!r} visited {len(visited)} different states, wanted are "
                    f"{states}: give fewer --states, or --sampling visited"
                )
    raise InputError(
        f"sampling is {sampling!r}{nearest_name(sampling, SAMPLINGS)}: give {', '.join(SAMPLINGS)}"
    )


def box_velocities(robot: Robot, states: int, seed: int) -> Float64:
    """(states, 3) forward, left (m/s) and turn rate (rad/s), uniform in the library box, in mirror pairs."""
    box = robot.library_box
    low, high = np.array([box.forward_mps, box.left_mps, box.omega_rad_s]).T
    drawn = np.random.default_rng(seed).uniform(low, high, size=(states, 3))
    if mirror_of(robot) is None:
        return drawn
    pairs = np.stack([drawn, drawn * [1.0, -1.0, -1.0]], axis=1) + 0.0
    kept = np.ones((len(drawn), 2), dtype=bool)
    kept[:, 1] = (drawn[:, 1:] != 0.0).any(axis=1)
    return np.asarray(pairs[kept][:states])
