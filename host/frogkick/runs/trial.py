"""Trial runs of a table in a simulated pool, whose effects its model may lack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from frogkick.effects import World
from frogkick.link.wire import RobotPort
from frogkick.paths import SHAPES, shape
from frogkick.planner.plan import config_of
from frogkick.pool.camera import Camera
from frogkick.pool.native_robot import NativeRobot
from frogkick.pool.pool import Pool
from frogkick.robot import Robot
from frogkick.runs.closed_loop import Recording, RunOptions, run_session
from frogkick.runs.record import run_log
from frogkick.runs.runlog import RunLog, Tracking
from frogkick.runs.session import Session
from frogkick.runs.summary import tracking_of_log
from frogkick.tables.image import Tables

TIME_LIMIT_S = 90.0
SEEDS = 2

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Trial:
    """One run in a pool."""

    recording: Recording
    log: RunLog

    @property
    def tracking(self) -> Tracking:
        """How well it followed its path."""
        return tracking_of_log(self.log)


def swim(
    port: RobotPort,
    tables: Tables,
    robot: Robot,
    name: str,
    options: RunOptions,
    seed: int | Sequence[int],
    source: str,
    world: World = World(),  # noqa: B008 - frozen
    progress: Progress = lambda _done, _whole: None,
) -> Trial:
    """Follow a path from its first point on.

    Args:
        port, tables: the robot, and its own tables.
        robot: the swimmer in the pool.
        name: of the path.
        options, source: of the run.
        seed: of the camera's noise; the log keeps the first of several.
        world: effects in the pool; a new object for each run.
        progress: called with the path points passed and all path points.
    """
    path = shape(name)
    start = (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0]))
    pool = Pool(robot, start, Camera(), np.random.default_rng(seed), world)
    recording = run_session(
        Session(port), pool, tables, path, options, lambda _time_s, index: progress(index + 1, len(path))
    )
    first = seed if isinstance(seed, int) else int(seed[0])
    return Trial(recording, run_log(recording, pool, robot, tables, path, options, first, source))


def trials(
    core: Path,
    tables: Tables,
    robot: Robot,
    world: Callable[[], World],
    paths: Sequence[str] = tuple(SHAPES),
    seeds: int = SEEDS,
    time_limit_s: float = TIME_LIMIT_S,
    progress: Progress = lambda _done, _whole: None,
) -> list[Trial]:
    """Follow paths with the robot's core on this computer, each with several seeds.

    Args:
        core: image of the target "native" with these tables.
        robot: the swimmer in the pool, with the planner's settings.
        world: makes the effects in the pool, anew for each run, as effects may have state.
        seeds: number of seeds of the camera's noise, from 0.
        progress: called with runs done and all runs.
    """
    options = RunOptions(config_of(robot.planner), time_limit_s=time_limit_s)
    found: list[Trial] = []
    for name in paths:
        for seed in range(seeds):
            progress(len(found), len(paths) * seeds)
            port = NativeRobot(core, len(robot.limbs))
            found.append(swim(port, tables, robot, name, options, [seed, 7], "trial", world()))
    progress(len(found), len(found))
    return found
