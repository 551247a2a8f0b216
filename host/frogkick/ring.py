"""The whole ring: library, tables, firmware, paths on the virtual chip; then a change (``frogkick demo``).

Something changes that the model was not told of; logs tell what, the model learns it, new firmware knows it.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.files import write_bytes
from frogkick.core.poses import PredictionError
from frogkick.effects import World
from frogkick.effects.registry import make_effects
from frogkick.identification.outcome import Outcome, identify, write_robot
from frogkick.identification.retune import steps
from frogkick.identification.segments import read_segments
from frogkick.identification.tables import Stage
from frogkick.library import build_library, quantise, read_library
from frogkick.paths import SHAPES
from frogkick.planner.plan import config_of
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot, load_robot
from frogkick.runs.chip_check import ChipReport, check_on_chip
from frogkick.runs.closed_loop import RunOptions
from frogkick.runs.decision import DecisionTwin
from frogkick.runs.record import Tracking
from frogkick.runs.replay import compare, replay_on_host
from frogkick.runs.residual import Residual, residual
from frogkick.runs.runlog import RunLog
from frogkick.runs.runlog_file import write_run
from frogkick.runs.trial import Trial, swim
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.emit import emit
from frogkick_codegen.firmware import Build, build

HELD_OUT = "bends"
"""The path that nothing is learned from."""


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


@dataclass(frozen=True, eq=False)
class Closing:
    """What came of a change that the model was not told of.

    Attributes:
        planted: the effect that was true in the pool, as a world's file would have it.
        outcome: what identification made of the logs.
        old, new: runs of the changed robot with the tables made before and after, on the same paths with the
            same noise; no new ones where nothing was found.
    """

    planted: dict[str, Any]
    outcome: Outcome
    old: list[Trial]
    new: list[Trial]

    @staticmethod
    def distance_m(runs: Sequence[Trial]) -> float:
        """Mean over runs of the mean distance to the path."""
        return float(np.mean([run.tracking.mean_distance_m for run in runs])) if runs else float("nan")

    def as_json(self) -> dict[str, Any]:
        """Errors a period ahead on the run kept out of learning, what was found, and the paths."""
        tested = self.outcome.tested
        periods = {"periods": tested.before.count}
        return {
            "before": {**tested.before.as_json(), **periods},
            "after": {**tested.after.as_json(), **periods},
            "noise_floor": tested.noise_floor.as_json(),
            "horizons": [each.as_json() for each in self.outcome.horizons],
            "verdict": self.outcome.verdict,
            "planted": self.planted,
            "found": self.outcome.effects_as_json(),
            "changed_robot": {
                "mean_distance_before_m": self.distance_m(self.old),
                "mean_distance_after_m": self.distance_m(self.new),
            },
        }


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
    def missed(self) -> PredictionError:
        """Prediction error one period ahead, over all paths."""
        return PredictionError.of(np.concatenate([run.missed.gap_body for run in self.runs]))


def go_round(
    robot: Robot,
    out: Path,
    states: int,
    depth: int,
    seed: int,
    bar: Stage,
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
        dataclasses.replace(config_of(robot.planner), depth=depth), time_limit_s=time_limit_s
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


def plant(robot: Robot, seed: int) -> dict[str, Any]:
    """A worn limb: which one, and how strong it still is, by the seed."""
    rng = np.random.default_rng([seed, 2])
    limb = robot.limbs[int(rng.integers(len(robot.limbs)))].name
    return {"name": "limb_wear", "limb": limb, "gain": round(float(rng.uniform(0.6, 0.8)), 3)}


def close(ring: Ring, out: Path, seed: int, bar: Stage, held_out: str = HELD_OUT) -> None:
    """Let a limb wear, find it from logs alone, make tables and firmware that know it, swim again.

    Args:
        ring: of ``go_round``, whose model is not told; gets ``closing``. Its paths are learned from, and swum
            again.
        out: the same folder: for logs (``worn-PATH.h5``), ``found.toml`` and, where something was found,
            ``new/`` with library, table and firmware.
        seed: of what wears, of the library and of the camera's noise.
        bar: makes progress bars.
        held_out: path of the run that is only predicted.

    Raises:
        FrogkickError: any stage's own.
    """
    clock = _StageClock(ring.stage_s)
    robot, tables, options = ring.robot, ring.tables, ring.options
    paths = [run.log.path.name for run in ring.runs if run.log.path is not None]
    planted = plant(robot, seed)

    def swum(image: Path, with_tables: Tables, name: str, title: str) -> Trial:
        with bar(f"{title}, the {name}: path points") as progress:
            return swim(
                VirtualRobot(image, len(robot.limbs)),
                with_tables,
                robot,
                name,
                options,
                [seed, 1],
                "demo",
                World(make_effects([planted], Path())),
                progress,
            )

    logs, old = [], []
    for name in (*paths, held_out):
        run = swum(ring.built.image, tables, name, "swim with a worn limb")
        logs.append(out / f"worn-{name}.h5")
        write_run(logs[-1], dataclasses.replace(run.log, truth=None))
        old.append(run)
    clock.lap("swim with a worn limb")
    swims = [read_segments(log, robot) for log in logs]
    with steps(bar) as tell:
        outcome = identify(swims[:-1], swims[-1:], robot, progress=tell)
    with bar("predict several periods ahead") as progress:
        ahead = len(outcome.horizons)
        progress(ahead, ahead)
    write_robot(out / "found.toml", outcome)
    clock.lap("identify")
    new = []
    if outcome.terms:
        found = load_robot(out / "found.toml")
        title = "new library: simulate transitions"
        image = make_tables(found, out / "new", len(tables.states), seed, bar, title)
        built = build("bench", image, found, out / "new" / "firmware")
        clock.lap("new library, tables, firmware")
        opened = read_image(image)
        new = [swum(built.image, opened, name, "swim with the new firmware") for name in paths]
        clock.lap("swim with the new firmware")
    ring.closing = Closing(planted, outcome, old[:-1], new)


def make_tables(robot: Robot, out: Path, states: int, seed: int, bar: Stage, title: str) -> Path:
    """Simulate ``library.h5`` in a folder and quantise it to ``tables.fkt`` beside it.

    Raises:
        FrogkickError: of the library.
    """
    with bar(title) as progress:
        build_library(
            robot,
            states=states,
            seed=seed,
            workers=os.cpu_count() or 1,
            out=out / "library.h5",
            progress=progress,
            sampling="visited",
        )
    image = out / "tables.fkt"
    write_bytes(image, quantise(read_library(out / "library.h5")))
    return image


class _StageClock:
    """How long each stage took, s."""

    def __init__(self, laps: dict[str, float]) -> None:
        self.laps = laps
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.laps[stage] = now - self._since
        self._since = now
