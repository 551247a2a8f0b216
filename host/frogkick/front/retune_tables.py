"""Tables in a retune: how they are made, their error on held-out periods, and how they follow paths."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError, compose, wrap_angle
from frogkick.core.progress import Stage
from frogkick.effects import Effect, Fix, World, effects_of
from frogkick.effects.base import fix_by
from frogkick.front.places import built_firmware
from frogkick.identification.fit import rollouts_of
from frogkick.identification.horizons import HORIZONS, Horizon
from frogkick.identification.outcome import Outcome
from frogkick.identification.predict import Rollout
from frogkick.identification.segments import Segments
from frogkick.library import build_library, fit_table
from frogkick.library.build import require_workers
from frogkick.library.fitting import WHOLE_MIN, looked_up
from frogkick.library.sampling import RUNS, require_draw
from frogkick.library.transitions import HISTORY, RESTED
from frogkick.paths import SHAPES, Path, shape
from frogkick.planner.plan import config_of
from frogkick.pool.native_robot import NativeRobot
from frogkick.robot import Robot
from frogkick.runs.closed_loop import run_in_pool
from frogkick.runs.record import RunOptions
from frogkick.runs.runlog import RunLog
from frogkick.tables.image import open_image, read_image
from frogkick_codegen.firmware import build

LOOP_PATHS, LOOP_SEEDS, LOOP_LIMIT_S = tuple(SHAPES), 2, 90.0
"""The paths on which tables are tested in closed loop beside those of the runs, the runs along each path, and
their shortest time limit."""

LOOP_PATHS_MIN, LOOP_PATHS_MAX = 3, 4  # shapes are added up to the first, older runs' paths left out above
SHAPES_SUIT_M = 0.043  # longest stroke of the robot that SHAPES were made for
SHAPES_OTHER = 2.0  # they are scaled for a robot whose strokes are longer or shorter by more than this
LOOP_SLOWEST = 3.0  # times the time that a path takes by the longest strokes are simulated

PERIOD_OFF = 0.1  # largest relative difference of a run's period from the table's


@dataclass(frozen=True)
class TrackedRun:
    """Closed-loop performance of a table in one run."""

    path: str
    seed: int
    mean_distance_m: float
    progress_mps: float
    completed: bool


@dataclass(frozen=True)
class Tracked:
    """Closed-loop performance of a table in a simulated pool: means over the runs."""

    mean_distance_m: float  # to the path
    progress_mps: float  # along it
    completed: int  # runs that reached its end
    runs: int
    each: tuple[TrackedRun, ...] = ()

    def means(self) -> dict[str, float]:
        """The means, by name."""
        return {key: value for key, value in asdict(self).items() if key != "each"}

    @staticmethod
    def of(each: Sequence[TrackedRun]) -> Tracked:
        """The means over some runs."""
        return Tracked(
            float(np.mean([run.mean_distance_m for run in each])),
            float(np.mean([run.progress_mps for run in each])),
            sum(run.completed for run in each),
            len(each),
            tuple(each),
        )


@dataclass(frozen=True)
class Lost:
    """The cost of effects that no table can contain (of position, heading, time, water or camera).

    Attributes:
        effects: their titles.
        with_them, without: closed-loop performance of the table that the robot has after the retune, in a
            pool with all identified effects and in one without these.
    """

    effects: tuple[str, ...]
    with_them: Tracked
    without: Tracked

    def as_json(self) -> dict[str, Any]:
        """The key ``lost`` of the command."""
        return {
            "effects": list(self.effects),
            "with": self.with_them.means(),
            "without": self.without.means(),
        }


def swims_of(swims: Sequence[Segments]) -> list[list[int]]:
    """The actions of each unbroken stretch of runs."""
    found: list[list[int]] = []
    for swim in swims:
        for period, action in enumerate(swim.action.tolist()):
            if action < 0:
                continue
            if not period or earlier_actions(swim)[period, 0] == RESTED:
                found.append([])
            found[-1].append(action)
    return found


def paths_of(runs: Sequence[RunLog]) -> list[Path]:
    """The different paths of runs, the last ones first."""
    found: list[Path] = []
    for run in reversed(runs):
        if run.path is not None and run.path not in found:
            found.append(run.path)
    return found


def longest_stroke_m(swims: Sequence[Segments]) -> float:
    """How far the robot came in the fastest tenth of the periods of its runs; NaN if none has fixes."""
    moved = [np.hypot(*np.diff(swim.measured[:, :2], axis=0).T) for swim in swims if len(swim.start_s) > 1]
    known = np.concatenate([np.full(1, np.nan), *moved])
    return float(np.percentile(known[np.isfinite(known)], 90.0)) if np.isfinite(known).any() else math.nan


@dataclass(frozen=True)
class TableMaker:
    """Makes tables of libraries of ``count`` states, tests them in closed loop, builds firmware with them.

    The states are those of the robot's earlier ``swims`` (actions from rest), and others, see ``RUNS`` of
    ``sample_starts``. The loop is closed along the ``paths`` of its runs; ``stroke_m`` is its longest stroke.
    """

    count: int
    seed: int
    workers: int
    swims: Sequence[Sequence[int]] = ()
    paths: Sequence[Path] = ()
    stroke_m: float = SHAPES_SUIT_M

    def __post_init__(self) -> None:
        # Checked here, because the identification before its use takes minutes.
        require_draw(self.count, self.seed)
        require_workers(self.workers)
        if self.count < WHOLE_MIN:
            raise InputError(f"states is {self.count}: give {WHOLE_MIN} or more, as many as a table takes")

    def tables(self, robot: Robot, library: FilePath, stage: Stage) -> bytes:
        """Simulate a robot's library into a file, and make the table image of it."""
        with stage(f"library of {self.count} states") as progress:
            made = build_library(
                robot, self.count, self.seed, self.workers, library, progress, RUNS, 0.0, swims=self.swims
            )
        with stage("tables tried") as progress:
            return fit_table(made, "affine", progress=progress).image

    def states(self, image: bytes) -> int:
        """How many states a table image has."""
        return len(open_image(image).states)

    def looked_up(self, image: bytes, velocity_body: Float64, previous: Int64) -> Float64:
        """(n, a, 6) transitions in a table image from (n, 3) velocities after (n, HISTORY) actions."""
        return looked_up(open_image(image), velocity_body, previous)

    def tracked(self, tables: FilePath, robot: Robot, progress: Callable[[int, int], None]) -> Tracked:
        """Follow a fixed set of paths with a table file, in a pool with the robot's effects."""
        opened, numbers = read_image(tables), list[TrackedRun]()
        paths, fastest_mps = self.loop_paths(), self.stroke_m / robot.period_s
        with built_firmware("native", tables, robot) as built:
            for path, seed in product(paths, range(LOOP_SEEDS)):
                progress(len(numbers), len(paths) * LOOP_SEEDS)
                port, world = NativeRobot(built.image, len(robot.limbs)), World(effects_of(robot))
                limit_s = max(LOOP_LIMIT_S, LOOP_SLOWEST * path.length_m / fastest_mps)
                options = RunOptions(config_of(robot.planner), time_limit_s=limit_s)
                swum = run_in_pool(port, opened, robot, path, options, [seed, 7], "trial", world).tracking()
                numbers.append(
                    TrackedRun(path.name, seed, swum.mean_distance_m, swum.progress_mps, swum.completed)
                )
        progress(len(numbers), len(numbers))
        return Tracked.of(numbers)

    def loop_paths(self) -> list[Path]:
        """The paths of the runs, and shapes in the robot's size where there are few."""
        paths, scale = list(self.paths[:LOOP_PATHS_MAX]), self.stroke_m / SHAPES_SUIT_M
        if 1.0 / SHAPES_OTHER <= scale <= SHAPES_OTHER:
            scale = 1.0
        for name in LOOP_PATHS:
            if len(paths) < LOOP_PATHS_MIN and name not in [path.name for path in paths]:
                made = shape(name)
                x_m, y_m = (scale * made.points_m).T
                paths.append(Path.from_arrays(x_m, y_m, made.tangent_rad, name))
        return paths

    def firmware(self, tables: FilePath, robot: Robot, out: FilePath) -> Mapping[str, Any]:
        """Build the robot's image around a table file into a folder; its sizes."""
        built = build("bench", tables, robot, out)
        return {"image": built.image.name, "flash_bytes": built.flash_bytes, "ram_bytes": built.ram_bytes}


def table_error(tools: TableMaker, image: bytes, outcome: Outcome, periods: int = 1) -> PredictionError:
    """Error of a table some periods ahead on the test runs, from the start of each period.

    Old and new tables start from the same states, those of the fitted rods, which are the best estimate.
    Their poses are those that the camera shows, as the robot will receive them. Further periods start from
    the table's own prediction.
    """
    effects = _likeliest(outcome)
    gaps = [
        _gaps(tools, image, swim, rollout, effects, swim.measured, periods)
        for swim, rollout in zip(outcome.test, outcome.rollouts, strict=True)
    ]
    return PredictionError.of(np.concatenate(gaps))


def error_on_runs(tools: TableMaker, image: bytes, outcome: Outcome) -> PredictionError:
    """What a table errs against the rods with the identified effects, on the states of all runs.

    The states are those at the starts of the runs' periods as they occurred, with their actions.
    """
    assert outcome.found is not None
    (learned,) = rollouts_of([outcome.found.fitted.model], outcome.train)
    effects, gaps = _likeliest(outcome), []
    for swim, rollout in zip((*outcome.train, *outcome.test), (*learned, *outcome.rollouts), strict=True):
        ends = np.where(np.arange(len(swim.start_s))[:, None] < swim.judged_from, np.nan, rollout.predicted)
        gaps.append(_gaps(tools, image, swim, rollout, effects, ends))
    return PredictionError.of(np.concatenate(gaps))


def table_horizons(tools: TableMaker, old: bytes, new: bytes, outcome: Outcome) -> list[Horizon]:
    """Errors of two tables by horizon, without horizons for which no run is long enough."""
    every = [
        Horizon(periods, *(table_error(tools, image, outcome, periods) for image in (old, new)))
        for periods in HORIZONS
    ]
    return [each for each in every if each.before.count]


def _likeliest(outcome: Outcome) -> list[Effect]:
    return [term.effect().likeliest() for term in outcome.terms]


def _gaps(
    tools: TableMaker,
    image: bytes,
    swim: Segments,
    rollout: Rollout,
    effects: Sequence[Effect],
    ends: Float64,
    periods: int = 1,
) -> Float64:
    """(m, 3) poses at the periods' ``ends`` minus looked-up ones so many periods after each start, or NaN."""
    gap = np.full((len(swim.start_s), 3), np.nan)
    # Periods that were cut short or lengthened are excluded, because a table has one period.
    whole = (swim.action >= 0) & (np.abs((swim.end_s - swim.start_s) / swim.period_s - 1.0) < PERIOD_OFF)
    follows = np.append(np.abs(swim.start_s[1:] - swim.end_s[:-1]) < 1e-6, False)
    known = np.isfinite(rollout.start).all(axis=1) & whole
    for step in range(1, periods):
        known &= np.append(whole[step:], np.zeros(min(step, len(whole)), dtype=bool))
        known &= np.append(follows[step - 1 :], np.zeros(min(step - 1, len(whole)), dtype=bool))
    rows = np.flatnonzero(known)
    if not len(rows):
        return gap
    rng = np.random.default_rng(0)  # anew for each table, so that all have the same starts
    pose = np.array(
        [
            _shown(effects, rng, float(at_s), start)
            for at_s, start in zip(swim.start_s[rows], rollout.start[rows, :3], strict=True)
        ]
    )
    velocity, previous = rollout.start[rows, 3:], earlier_actions(swim)
    for step in range(periods):
        found = tools.looked_up(image, velocity, previous[rows + step])
        moved = found[np.arange(len(rows)), swim.action[rows + step]]
        pose = compose(pose, moved[:, :3])
        velocity = moved[:, 3:]
    gap[rows] = ends[rows + periods - 1] - pose
    gap[:, 2] = wrap_angle(gap[:, 2])
    return gap


def _shown(
    effects: Sequence[Effect], rng: np.random.Generator, time_s: float, pose: Float64
) -> tuple[float, float, float]:
    """A pose as the camera measures it, with the effects on its fixes."""
    seen = Fix(time_s, 0.0, *(float(value) for value in pose))
    for effect in effects:
        seen = fix_by(effect, seen, rng) or seen
    return seen.x_m, seen.y_m, seen.heading_rad


def earlier_actions(swim: Segments) -> Int64:
    """(m, HISTORY) actions of the periods before each one, newest first, RESTED beyond a gap or the start."""
    previous = np.full((len(swim.start_s), HISTORY), RESTED, dtype=np.int64)
    for period in range(1, len(previous)):
        apart_s = float(swim.start_s[period] - swim.start_s[period - 1])
        if swim.action[period - 1] >= 0 and apart_s < 1.5 * swim.period_s:
            previous[period] = [swim.action[period - 1], *previous[period - 1, :-1]]
    return previous
