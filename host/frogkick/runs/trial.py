"""Trial runs of a table in a simulated pool, whose effects its model may lack."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Sequence

import numpy as np

from frogkick.effects import World
from frogkick.link.wire import RobotPort
from frogkick.paths import SHAPES, Path, shape
from frogkick.planner.plan import config_of
from frogkick.pool.camera import Camera
from frogkick.pool.native_robot import NativeRobot
from frogkick.pool.pool import Pool
from frogkick.robot import Robot
from frogkick.runs.closed_loop import run_session
from frogkick.runs.record import Recording, RunOptions
from frogkick.runs.runlog import Tracking
from frogkick.runs.session import Session
from frogkick.tables.image import Tables

TIME_LIMIT_S = 90.0
SEEDS = 2

Progress = Callable[[int, int], None]


def swim(
    port: RobotPort,
    tables: Tables,
    robot: Robot,
    path: Path,
    options: RunOptions,
    seed: int | Sequence[int],
    source: str,
    world: World = World(),  # noqa: B008 - frozen
    start_world: tuple[float, float, float] | None = None,
    progress: Progress = lambda _done, _whole: None,
) -> Recording:
    """Follow a path in a pool.

    Args:
        port, tables: the robot, and its own tables.
        robot: the swimmer in the pool.
        options, source: of the run.
        seed: of the camera's noise; the log keeps the first of several.
        world: effects in the pool; a new object for each run.
        start_world: pose of the robot at rest; None: at the path's first point, along it.
        progress: called with the path points passed and all path points.
    """
    start = start_world or (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0]))
    pool = Pool(robot, start, Camera(), np.random.default_rng(seed), world)
    first = seed if isinstance(seed, int) else int(seed[0])
    recording = Recording(robot, tables, path, options, source, first, pool=pool)
    return run_session(Session(port), pool, recording, lambda _time_s, index: progress(index + 1, len(path)))


def trials(
    core: pathlib.Path,
    tables: Tables,
    robot: Robot,
    world: Callable[[], World],
    paths: Sequence[str] = tuple(SHAPES),
    seeds: int = SEEDS,
    time_limit_s: float = TIME_LIMIT_S,
    progress: Progress = lambda _done, _whole: None,
) -> list[Tracking]:
    """How well paths are followed with the robot's core on this computer, each with several seeds.

    Args:
        core: image of the target "native" with these tables.
        robot: the swimmer in the pool, with the planner's settings.
        world: makes the effects in the pool, anew for each run, as effects may have state.
        seeds: number of seeds of the camera's noise, from 0.
        progress: called with runs done and all runs.
    """
    options = RunOptions(config_of(robot.planner), time_limit_s=time_limit_s)
    found: list[Tracking] = []
    for name in paths:
        for seed in range(seeds):
            progress(len(found), len(paths) * seeds)
            port = NativeRobot(core, len(robot.limbs))
            swum = swim(port, tables, robot, shape(name), options, [seed, 7], "trial", world())
            found.append(swum.tracking())
    progress(len(found), len(found))
    return found
