"""The whole ring: library, tables, firmware, paths on the virtual chip; then a change (``frogkick demo``)."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from frogkick.paths import SHAPES
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot
from frogkick.runs.chip_check import ChipReport, check_on_chip
from frogkick.runs.closed_loop import RunOptions, robot_plan_config
from frogkick.runs.decision import DecisionTwin
from frogkick.runs.record import Tracking
from frogkick.runs.replay import compare, replay_on_host
from frogkick.runs.residual import Residual, residual
from frogkick.runs.runlog import RunLog
from frogkick.runs.runlog_file import write_run
from frogkick.study.closing import HELD_OUT, Bar, Closing, close_ring, make_tables
from frogkick.study.trial import swim
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.emit import emit
from frogkick_codegen.firmware import Build, build


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
    """Everything that going round the ring gave."""

    robot: Robot
    tables: Tables
    built: Build
    options: RunOptions
    runs: list[RingRun] = field(default_factory=list)
    chip: ChipReport = field(default_factory=ChipReport)
    stage_s: dict[str, float] = field(default_factory=dict)
    closing: Closing | None = None

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
    clock = _StageClock({})
    image = make_tables(robot, out, states, seed, bar, "library: simulate transitions")
    clock.lap("library, tables")
    tables = read_image(image)
    emit(image, out / "emitted", "frogkick codegen tables.fkt --out emitted")
    built = build("bench", image, robot, out / "firmware")
    clock.lap("C, firmware")
    options = RunOptions(
        dataclasses.replace(robot_plan_config(robot), depth=depth), time_limit_s=time_limit_s
    )
    ring = Ring(robot, tables, built, options, stage_s=clock.laps)
    with bar("firmware on the virtual chip: commands and limits") as progress:
        ring.chip = check_on_chip(built.image, tables, robot, progress)
    clock.lap("trial of the firmware")
    for name in paths:
        with bar(f"swim the {name}: path points") as progress:
            ring.runs.append(_swim(ring, name, seed, progress))
        write_run(out / f"{name}.h5", ring.runs[-1].log)
        clock.lap(f"swim the {name}")
    return ring


def _swim(ring: Ring, name: str, seed: int, progress: Callable[[int, int], None]) -> RingRun:
    port = VirtualRobot(ring.built.image, len(ring.robot.limbs))
    trial = swim(port, ring.tables, ring.robot, name, ring.options, seed, "demo", progress=progress)
    assert trial.log.path is not None
    again = replay_on_host(
        trial.recording.events, DecisionTwin(ring.tables, trial.log.path, ring.options.config)
    )
    mismatches = len(compare(trial.recording.decisions, again))
    return RingRun(trial.log, trial.tracking, mismatches, residual(trial.log))


def close(ring: Ring, out: Path, seed: int, bar: Bar, held_out: str = HELD_OUT) -> None:
    """Let the robot change in a way that the model is not told, and go round once more; see ``close_ring``.

    Args:
        ring: of ``go_round``; gets ``closing``.
        out: the same folder.
        seed: the same.
        bar: makes progress bars.
        held_out: path of the run that nothing is learned from.
    """
    clock = _StageClock(ring.stage_s)
    paths = [run.log.path.name for run in ring.runs if run.log.path is not None]
    ring.closing = close_ring(
        ring.robot, ring.tables, ring.built.image, out, ring.options, seed, bar, paths, held_out, clock.lap
    )


class _StageClock:
    """How long each stage took, s."""

    def __init__(self, laps: dict[str, float]) -> None:
        self.laps = laps
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.laps[stage] = now - self._since
        self._since = now
