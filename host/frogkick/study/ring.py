"""The whole ring once: library, tables, firmware, three paths on the virtual chip (``frogkick demo``)."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from frogkick.files import write_bytes
from frogkick.library import build_library, quantise, read_library
from frogkick.loop.chip_check import ChipReport, check_on_chip
from frogkick.loop.closed_loop import RunOptions, robot_plan_config, run_in_pool
from frogkick.loop.decision import DecisionTwin
from frogkick.loop.record import Tracking, run_log, tracking_of_recording
from frogkick.loop.replay import compare, replay_on_host
from frogkick.loop.residual import Residual, residual
from frogkick.loop.runlog import RunLog
from frogkick.loop.runlog_file import write_run
from frogkick.paths import SHAPES, shape
from frogkick.planner.image import Tables, read_image
from frogkick.pool.camera import Camera
from frogkick.pool.pool import Pool
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot
from frogkick_codegen.emit import emit
from frogkick_codegen.firmware import Build, build

Bar = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Makes a progress bar with a title; inside it is a function of (done, all)."""


@dataclass(frozen=True)
class RingRun:
    """One path of the ring.

    Attributes:
        log: the run.
        tracking: its numbers.
        mismatches: decisions of the chip that the Python twin makes otherwise.
        missed: predicted against happened, one period ahead.
    """

    log: RunLog
    tracking: Tracking
    mismatches: int
    missed: Residual


@dataclass
class Ring:
    """Everything that going round the ring once gave."""

    robot: Robot
    tables: Tables
    runs: list[RingRun] = field(default_factory=list)
    chip: ChipReport = field(default_factory=ChipReport)
    flash_bytes: int = 0
    ram_bytes: int = 0
    stage_s: dict[str, float] = field(default_factory=dict)

    @property
    def mean_distance_m(self) -> float:
        """Mean over the paths of the mean distance to each."""
        return float(np.mean([run.tracking.mean_distance_m for run in self.runs]))

    @property
    def missed(self) -> dict[str, float | int]:
        """Prediction error one period ahead, over all paths."""
        position = np.concatenate([run.missed.position_body_m for run in self.runs])
        heading = np.concatenate([run.missed.heading_rad for run in self.runs])
        return {
            "position_rmse_m": float(np.sqrt((position**2).sum(axis=1).mean())),
            "heading_rmse_rad": float(np.sqrt((heading**2).mean())),
            "periods": len(heading),
        }


def go_round(
    robot: Robot,
    out: Path,
    states: int,
    depth: int,
    seed: int,
    bar: Bar,
    paths: Sequence[str] = tuple(SHAPES),
    time_limit_s: float = 120.0,
) -> Ring:
    """Simulate, tabulate, emit, build, and swim three paths with the firmware on the virtual chip.

    Args:
        robot: the swimmer, in the library and in the pool.
        out: folder for library.h5, tables.fkt, emitted/, firmware/ and a log for each path.
        states: initial velocities of the library.
        depth: levels that the planner looks ahead.
        seed: of the library's sampling and of the camera's noise.
        bar: makes progress bars.
        paths: names of the shapes to swim.
        time_limit_s: longest pool time for each.

    Raises:
        FrogkickError: any stage's own.
    """
    clock = _StageClock()
    with bar("library: simulate transitions") as progress:
        build_library(
            robot,
            states=states,
            seed=seed,
            workers=os.cpu_count() or 1,
            out=out / "library.h5",
            progress=progress,
            sampling="visited",
        )
    clock.lap("library")
    image = out / "tables.fkt"
    write_bytes(image, quantise(read_library(out / "library.h5")))
    tables = read_image(image)
    emit(image, out / "emitted", "frogkick codegen tables.fkt --out emitted")
    clock.lap("tables, C")
    built = build("bench", image, robot, out / "firmware")
    clock.lap("firmware")
    options = RunOptions(
        dataclasses.replace(robot_plan_config(robot), depth=depth), time_limit_s=time_limit_s
    )
    ring = Ring(robot, tables, flash_bytes=built.flash_bytes, ram_bytes=built.ram_bytes, stage_s=clock.laps)
    with bar("firmware on the virtual chip: commands and limits") as progress:
        ring.chip = check_on_chip(built.image, tables, robot, progress)
    clock.lap("trial of the firmware")
    for name in paths:
        with bar(f"swim the {name}: path points") as progress:
            ring.runs.append(_swim(ring, built, name, options, seed, progress))
        write_run(out / f"{name}.h5", ring.runs[-1].log)
        clock.lap(f"swim the {name}")
    return ring


def _swim(
    ring: Ring,
    built: Build,
    name: str,
    options: RunOptions,
    seed: int,
    progress: Callable[[int, int], None],
) -> RingRun:
    robot, tables, path = ring.robot, ring.tables, shape(name)
    start = (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0]))
    pool = Pool(robot, start, Camera(), np.random.default_rng(seed))
    recording = run_in_pool(
        VirtualRobot(built.image, len(robot.limbs)),
        pool,
        tables,
        path,
        options,
        lambda _time_s, index: progress(index + 1, len(path)),
    )
    again = replay_on_host(recording.events, DecisionTwin(tables, path, options.config))
    log = run_log(recording, pool, robot, tables, path, options, seed, "demo")
    return RingRun(
        log,
        tracking_of_recording(recording, pool, robot, path),
        len(compare(recording.decisions, again)),
        residual(log),
    )


class _StageClock:
    """How long each stage took, s."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.laps[stage] = now - self._since
        self._since = now
