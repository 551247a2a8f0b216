"""States at the start of a library's transitions: drawn from a box, or visited by random or planned swims.

Planned swims take the actions that the planner chooses while it follows random paths, by a small table from
random swims; the rods simulate its choices. The states at the start of these strokes are those that a better
table should have. A robot that has swum gets the states of its runs as well: its planner may have held one
action for longer than random or short swims do, up to speeds that they do not reach.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frogkick.core.arrays import Bool, Float32, Float64, Int64
from frogkick.core.chunks import Job, run_chunks
from frogkick.core.errors import ConvergenceError, InputError, nearest_name
from frogkick.core.poses import wrap_angle
from frogkick.der import STEP_S, WIDTH, Batch, Rods
from frogkick.effects import rods_of
from frogkick.effects.acting import lane_effects, program_of
from frogkick.library.store import library_of, quantise
from frogkick.library.transitions import RESTED, Failed, Task, Transitions, rigid_task, simulate_task
from frogkick.planner.plan import config_of, plan_batch
from frogkick.robot import Mirror, Robot, mirror_of
from frogkick.tables.image import Tables, open_image
from frogkick.tables.layout import STATES_MAX

TASK_ROBOTS = 2 * WIDTH
"""Robots of a task, some 0.4 s of work, for fine progress and a quick end on Ctrl-C."""

SWIM_STROKES = 12  # from rest to cruising takes about six
_HOLD_STROKES_MAX = 4  # an action is held for 1 to 4 strokes, as turns build up over several
_BARREN_SWIMS_MAX = 1000  # that visit no new state, one after the other
_LONG_STROKES = 32  # a heavy hull takes 25 strokes to 90 % of a steady turn

_LEFT = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # mirrors (x, y, heading, vx, vy, omega)


@dataclass(frozen=True, eq=False)
class Starts:
    """n states and their simulations, one for each pair of mirror images.

    Attributes:
        tasks: simulations.
        part, row: (n,) the task of each state, and its state within the task.
        mirrored: (n,) whether the state is the mirror image of the simulated one.
        mirror: of the robot; None if it is not symmetric.
    """

    tasks: tuple[Task, ...]
    part: Int64
    row: Int64
    mirrored: Bool
    mirror: Mirror | None

    def __len__(self) -> int:
        return len(self.part)

    def of(self, state: int, simulated: NDArray[np.floating]) -> NDArray[np.floating]:
        """Results (a, .., 6) of a state from those of its simulation."""
        if not self.mirrored[state] or self.mirror is None:
            return simulated
        return np.asarray(simulated[list(self.mirror.actions)] * _LEFT.astype(simulated.dtype))

    def unfolded(self, parts: Sequence[Transitions]) -> Transitions:
        """Transitions from all states by those of the simulations, without recorded motions."""
        first = np.cumsum([0, *(len(part.rows) for part in parts)])
        source = first[self.part] + self.row
        velocity, previous, simulated = (
            np.concatenate([getattr(part, name) for part in parts])[source]
            for name in ("velocity_body", "previous", "rows")
        )
        if self.mirror is not None:
            velocity = np.where(self.mirrored[:, None], velocity * _LEFT[3:], velocity)
            actions = np.array([*self.mirror.actions, RESTED])  # index RESTED is the last entry
            previous = np.where(self.mirrored[:, None], actions[previous], previous)
        rows = np.array([self.of(state, row) for state, row in enumerate(simulated)])
        recorded = np.empty((*rows.shape[:2], 0, 6), dtype=np.float32)
        return Transitions(velocity + 0.0, previous, rows, recorded, self._failed(parts))  # -0.0 is 0.0

    def _failed(self, parts: Sequence[Transitions]) -> tuple[Failed, ...]:
        failures = [{(f.state, f.action): f.reason for f in part.failed} for part in parts]
        found: list[Failed] = []
        for state, (part, row) in enumerate(zip(self.part.tolist(), self.row.tolist(), strict=True)):
            for (source, action), reason in failures[part].items():
                if source == row and self.mirrored[state] and self.mirror is not None:
                    action, reason = self.mirror.actions.index(action), f"its mirror image {reason}"
                if source == row:
                    found.append(Failed(state, action, reason))
        return tuple(sorted(found, key=lambda f: (f.state, f.action)))


def rigid_starts(robot: Robot, velocities: Float64) -> Starts:
    """States with all limbs at rest and (n, 3) body velocities; one of each mirror pair is simulated."""
    mirror = mirror_of(robot)
    plain = velocities + 0.0
    if mirror is None:
        mirrored = np.zeros(len(plain), dtype=bool)
    else:
        mirrored = (plain[:, 1] < 0.0) | ((plain[:, 1] == 0.0) & (plain[:, 2] < 0.0))
    folded = np.where(mirrored[:, None], plain * _LEFT[3:], plain) + 0.0
    place: dict[tuple[float, ...], int] = {}
    source = np.array([place.setdefault(tuple(row), len(place)) for row in folded.tolist()], dtype=np.int64)
    unique = np.array(list(place), dtype=np.float64).reshape(-1, 3)
    tasks = [rigid_task(unique[first : first + TASK_ROBOTS]) for first in range(0, len(unique), TASK_ROBOTS)]
    return Starts(tuple(tasks), source // TASK_ROBOTS, source % TASK_ROBOTS, mirrored, mirror)


Swims = Iterable[Sequence[int]]
"""Actions of each swim from rest, one action a period."""


def random_swims(robot: Robot, seed: int) -> Iterator[list[int]]:
    """Yield the random actions of swims from rest, without end; each action is held for a few strokes."""
    swim = 0
    while True:
        rng = np.random.default_rng([seed, swim])
        actions: list[int] = []
        while len(actions) < SWIM_STROKES:
            action = int(rng.integers(len(robot.actions)))
            actions += [action] * int(rng.integers(1, _HOLD_STROKES_MAX + 1))
        yield actions[:SWIM_STROKES]
        swim += 1


def held_swims(robot: Robot, seed: int) -> Iterator[list[int]]:
    """Yield the random actions of long swims from rest, without end; each is held for 1 to all strokes.

    The logarithm of the number of strokes is uniform, so that robots that are slow to reach a steady turn
    are in one as often as others are between two actions.
    """
    swim = 0
    while True:
        rng = np.random.default_rng([seed, 2, swim])
        actions: list[int] = []
        while len(actions) < _LONG_STROKES:
            action = int(rng.integers(len(robot.actions)))
            actions += [action] * round(_LONG_STROKES ** rng.uniform(0.0, 1.0))
        yield actions[:_LONG_STROKES]
        swim += 1


class VisitedStates:
    """Distinct states at the decisions of swims from rest, with their mirror images."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._mirror = mirror_of(robot)
        self._seen: set[tuple[int, ...]] = set()
        self._swims: list[tuple[int, ...]] = []
        self._states: list[tuple[int, int, bool]] = []  # swim, stroke, mirrored

    def __len__(self) -> int:
        return len(self._states)

    def add(self, swims: Swims, states: int, share: float = 1.0) -> None:
        """Add the states of swims, or an evenly spread share of them, up to a number of states.

        Raises:
            InputError: swims without end visit no more different states.
        """
        barren = passed = 0
        for actions in swims:
            if len(self) >= states:
                return
            if barren == _BARREN_SWIMS_MAX:
                raise InputError(
                    f"swims of {self._robot.id!r} visit {len(self)} different states, wanted are {states}: "
                    "give fewer --states, or --sampling box"
                )
            had = len(self)
            for stroke in range(len(actions)):
                passed += 1
                if int(passed * share) == int((passed - 1) * share):
                    continue
                before = self._moved(actions[:stroke])
                for mirrored, done in ((False, before), (True, self._mirrored(before))):
                    if done not in self._seen and len(self) < states:
                        self._states.append((len(self._swims), stroke, mirrored))
                        self._seen.add(done)
            barren = 0 if len(self) > had else barren + 1
            if not barren:
                self._swims.append(tuple(actions))

    def add_some(self, swims: Sequence[Sequence[int]], states: int) -> None:
        """Add at most a number of states, from all parts of the swims."""
        strokes = max(1, sum(map(len, swims)) * (1 if self._mirror is None else 2))
        self.add(swims, len(self) + states, min(1.0, states / strokes))

    def _moved(self, actions: Sequence[int]) -> tuple[int, ...]:
        """The actions since the first limb fired, which determine the state."""
        masks = [self._robot.actions[a].first_mask | self._robot.actions[a].second_mask for a in actions]
        first = next((i for i, mask in enumerate(masks) if mask), len(actions))
        return tuple(actions[first:])

    def _mirrored(self, actions: tuple[int, ...]) -> tuple[int, ...]:
        return actions if self._mirror is None else tuple(self._mirror.actions[a] for a in actions)

    def starts(self) -> Starts:
        """All visited states, in the order of the first visit."""
        tasks: list[Task] = []
        part, row = np.empty(len(self), np.int64), np.empty(len(self), np.int64)
        order = np.array(self._states, dtype=np.int64).reshape(-1, 3)
        for first in range(0, len(self._swims), WIDTH):
            swims = self._swims[first : first + WIDTH]
            mine = (order[:, 0] >= first) & (order[:, 0] < first + WIDTH)
            strokes = int(order[mine, 1].max(initial=0))
            wanted = np.zeros((len(swims), strokes + 1), dtype=bool)
            wanted[order[mine, 0] - first, order[mine, 1]] = True
            at = np.cumsum(wanted.ravel()).reshape(wanted.shape) - 1
            part[mine], row[mine] = len(tasks), at[order[mine, 0] - first, order[mine, 1]]
            # A shorter swim is padded with its last action, where no state is wanted.
            actions = [list(swim[:strokes]) + [swim[-1]] * (strokes - len(swim)) for swim in swims]
            shaped = np.array(actions, dtype=np.int64).reshape(wanted.shape[0], strokes)
            tasks.append(Task(np.zeros((len(swims), 3)), shaped, wanted))
        return Starts(tuple(tasks), part, row, order[:, 2].astype(bool), self._mirror)


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
    robot: Robot,
    seed: int,
    workers: int = 1,
    cluster: str | None = None,
    swims: Sequence[Sequence[int]] = (),
) -> Iterator[list[list[int]]]:
    """Yield the actions of planned swims from rest, without end.

    Each swim has a path and a generator of its own; workers and cluster do not change the swims. After
    earlier ``swims`` of the robot, which the small table contains as well, they are longer.
    """
    strokes = _LONG_STROKES if swims else _STROKES
    job = Job(_start, (robot, seed, first_table(robot, seed, swims), strokes), _run, _warm)
    swims_per_round = _CLUSTER_BATCHES if cluster is not None else workers
    for first in itertools.count(0, swims_per_round):
        numbers = list(range(first, first + swims_per_round))
        done = dict(run_chunks(job, numbers, workers, cluster))
        yield from (done[place] for place in range(swims_per_round))


def first_table(robot: Robot, seed: int, swims: Sequence[Sequence[int]] = ()) -> bytes:
    """The table image of planned swims, from a few states of random swims and as many of earlier ones."""
    rods, visited = rods_of(robot), VisitedStates(robot)
    visited.add(random_swims(robot, seed), _FIRST_TABLE_STATES)
    visited.add_some(swims, _FIRST_TABLE_STATES)
    starts = visited.starts()
    found = starts.unfolded([simulate_task(rods, task) for task in starts.tasks])
    return quantise(library_of(robot, "visited", seed, found))


_Ready = tuple[Rods, Tables, int, int]


def _start(robot: Robot, seed: int, image: bytes, strokes: int) -> _Ready:
    return rods_of(robot), open_image(image), seed, strokes


def _run(ready: _Ready, number: int) -> list[list[int]]:
    rods, tables, seed, strokes = ready
    lanes = [np.random.default_rng([seed, 1, number * WIDTH + lane]) for lane in range(WIDTH)]
    return _swim(rods, tables, [_random_path(tables, rng, strokes) for rng in lanes], strokes)


def _warm(ready: _Ready) -> None:
    _swim(ready[0], ready[1], [_random_path(ready[1], np.random.default_rng(0), 1)], 1)


def _path_length_m(tables: Tables, strokes: int) -> float:
    """Length of a path: the reach of a swim by the longest strokes."""
    return strokes * float(tables.stroke_max_m)


def _random_path(tables: Tables, rng: np.random.Generator, strokes: int) -> _Path:
    """Random arcs from the origin."""
    length_m = _path_length_m(tables, strokes)
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
        progress_weight=config.progress_weight * _path_length_m(tables, strokes) / _REWARDED_LENGTH_M,
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


SAMPLINGS = ("box", "visited", "planned")
RUNS = "runs"
"""Sampling of a library for a robot that has swum: see ``sample_starts``."""

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
    swims: Sequence[Sequence[int]] = (),
) -> Starts:
    """Draw the states of a library.

    Args:
        sampling: "box" draws velocities uniformly from the robot's library box with all limbs at rest, as the
            paper does. "visited" takes the states at the start of the strokes of random swims, which fill a
            small part of the box and contain the limbs' last strokes. "planned" lets the planner steer along
            random paths; a quarter of its states are visited ones. Each state is followed by its mirror
            image if the robot is symmetric. A smaller number of visited states gives the first of them.
            ``RUNS``: up to half of the states are those of earlier swims, then planned ones up to three
            quarters, and the rest is visited by ``held_swims``, because the planner looks ahead along
            actions that it does not take.
        swims: of ``RUNS``: the actions of the robot's runs from rest.
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
    if sampling in ("planned", RUNS):
        if sampling == RUNS:
            visited.add_some(swims, max(1, states // 2))
        else:
            visited.add(random_swims(robot, seed), max(1, states // 4))
        upto = states if sampling == "planned" else max(len(visited), 3 * states // 4)
        for number, planned in enumerate(planned_swims(robot, seed, workers, cluster, swims)):
            visited.add(planned, upto)
            if len(visited) == upto:
                break
            if number == _PLANNED_BATCHES_MAX:
                raise InputError(
                    f"planned swims of {robot.id!r} visited {len(visited)} different states, wanted are "
                    f"{upto}: give fewer --states, or --sampling visited"
                )
        visited.add(held_swims(robot, seed), states)
        return visited.starts()
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
