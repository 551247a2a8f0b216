"""All stages once (``frogkick demo``): library, table, firmware, runs on the virtual chip, a worn limb.

The model does not contain the wear. Identification finds it from logs, and a new table and firmware are made.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.files import write_bytes
from frogkick.core.poses import PredictionError
from frogkick.core.progress import Stage, in_stages
from frogkick.effects import World
from frogkick.effects.registry import make_effects
from frogkick.identification.outcome import Outcome, identify, write_robot
from frogkick.identification.segments import read_segments
from frogkick.library import default_table
from frogkick.paths import SHAPES, shape
from frogkick.planner.plan import config_of
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot, load_robot
from frogkick.runs.chip_check import ChipReport, check_on_chip
from frogkick.runs.closed_loop import run_in_pool
from frogkick.runs.decision import DecisionTwin
from frogkick.runs.record import RunOptions
from frogkick.runs.replay import compare, replay_on_host
from frogkick.runs.runlog import RunLog, Tracking
from frogkick.runs.runlog_file import write_run
from frogkick.runs.summary import residual, tracking_of_log
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.emit import emit
from frogkick_codegen.firmware import Firmware, build

HELD_OUT = "bends"
"""The path of the test run."""


@dataclass(frozen=True, eq=False)
class RingRun:
    """A run along one path, and in how many decisions chip and twin differ."""

    log: RunLog
    mismatches: int

    @property
    def tracking(self) -> Tracking:
        """How well it followed its path."""
        return tracking_of_log(self.log)

    @cached_property
    def gap_body(self) -> Float64:
        """(n, 3) errors of the table's predictions, see ``residual``."""
        return residual(self.log)[1]


@dataclass(frozen=True, eq=False)
class Adaptation:
    """The result for the worn limb; its runs are along the same paths, with the same noise."""

    true_effect: dict[str, Any]  # acts in the pool, as in a world's TOML file
    outcome: Outcome
    old: list[RunLog]  # with the old table
    learned: list[RunLog]  # with the old table, while the robot estimated the wear of its limbs
    new: list[RunLog]  # with the new table; empty if no effect was found

    @staticmethod
    def distance_m(runs: Sequence[RunLog]) -> float:
        """Return the mean over runs of the mean distance to the path; NaN without runs."""
        distances_m = [tracking_of_log(run).mean_distance_m for run in runs]
        return float(np.mean(distances_m)) if runs else float("nan")

    def as_json(self) -> dict[str, Any]:
        """Errors one period ahead on the test run, identified effects, and distances to the paths."""
        tested = self.outcome.tested
        periods = {"periods": tested.before.count}
        return {
            "before": {**tested.before.as_json(), **periods},
            "after": {**tested.after.as_json(), **periods},
            "noise_floor": tested.noise_floor.as_json(),
            "horizons": [each.as_json() for each in self.outcome.horizons],
            "verdict": self.outcome.verdict,
            "planted": self.true_effect,
            "found": self.outcome.effects_as_json(),
            "changed_robot": {
                "mean_distance_before_m": self.distance_m(self.old),
                "mean_distance_learning_m": self.distance_m(self.learned),
                "mean_distance_after_m": self.distance_m(self.new),
            },
        }


@dataclass
class Ring:
    """The results of all stages."""

    robot: Robot  # nominal
    states: int  # of its library
    tables: Tables
    built: Firmware
    options: RunOptions  # of every run
    runs: list[RingRun] = field(default_factory=list)  # one along each path
    chip: ChipReport = field(default_factory=ChipReport)  # the test of the firmware
    stage_s: dict[str, float] = field(default_factory=dict)  # stage -> its duration, s
    adaptation: Adaptation | None = None  # None before ``adapt``

    @property
    def mean_distance_m(self) -> float:
        """Mean over the paths of the mean distance to each."""
        return float(np.mean([run.tracking.mean_distance_m for run in self.runs]))

    @property
    def prediction_error(self) -> PredictionError:
        """Prediction error of the table one period ahead, over all paths."""
        return PredictionError.of(np.concatenate([run.gap_body for run in self.runs]))

    @property
    def passed(self) -> bool:
        """Whether chip and twin agreed, no limit was violated, and the firmware passed its tests."""
        broken = any(run.mismatches or run.tracking.limit_violations for run in self.runs)
        return self.chip.passed and not broken

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``demo``, without the report; before and after: see ``Adaptation``."""
        return {
            "mean_distance_m": self.mean_distance_m,
            "paths": {
                run.log.path.name: {**run.tracking.as_json(), "mismatches": run.mismatches}
                for run in self.runs
                if run.log.path is not None
            },
            **(self.adaptation.as_json() if self.adaptation else {}),
            "table_missed": {**self.prediction_error.as_json(), "periods": self.prediction_error.count},
            "chip_checks_passed": self.chip.passed,
        }


def run_demo(
    robot: Robot,
    out: Path,
    states: int,
    depth: int,
    seed: int,
    bar: Stage,
    paths: Sequence[str] = tuple(SHAPES),
    time_limit_s: float = 120.0,
) -> Ring:
    """Make library, table, C code and firmware, and follow three paths on the virtual chip.

    Args:
        out: folder for library.h5, tables.fkt, emitted/, firmware/ and the log of each path.
        states: number of initial velocities of the library.
        depth: search depth of the planner, periods.
        seed: seed of the library's sampling and of the camera's noise.
        bar: makes a progress bar.
        time_limit_s: time limit of each run in pool time, s.
    """
    stage_s: dict[str, float] = {}
    lap = _stage_clock(stage_s)
    image = make_tables(robot, out, states, seed, bar, "library: simulate transitions")
    lap("library, tables")
    tables = read_image(image)
    emit(image, out / "emitted", "frogkick codegen tables.fkt --out emitted")
    built = build("bench", image, robot, out / "firmware")
    lap("C, firmware")
    options = RunOptions(
        dataclasses.replace(config_of(robot.planner), depth=depth), time_limit_s=time_limit_s
    )
    ring = Ring(robot, states, tables, built, options, stage_s=stage_s)
    with bar("firmware on the virtual chip: commands and limits") as progress:
        ring.chip = check_on_chip(built.image, tables, robot, progress)
    lap("tests of the firmware")
    for name in paths:
        with bar(f"swim the {name}: path points") as progress:
            ring.runs.append(_follow(ring, name, seed, progress))
        write_run(out / f"{name}.h5", ring.runs[-1].log)
        lap(f"swim the {name}")
    return ring


def _follow(ring: Ring, name: str, seed: int, progress: Callable[[int, int], None]) -> RingRun:
    port = VirtualRobot(ring.built.image, len(ring.robot.limbs))
    recording = run_in_pool(
        port, ring.tables, ring.robot, shape(name), ring.options, seed, "demo", progress=progress
    )
    again = replay_on_host(recording.events, DecisionTwin(ring.tables, recording.path, ring.options.config))
    return RingRun(recording.log(), len(compare(recording.decisions, again)))


def draw_wear(robot: Robot, seed: int) -> dict[str, Any]:
    """Return the wear of a random limb by a random gain of 0.6 to 0.8, as in a world's TOML file."""
    rng = np.random.default_rng([seed, 2])
    limb = robot.limbs[int(rng.integers(len(robot.limbs)))].name
    return {"name": "limb_wear", "limb": limb, "gain": round(float(rng.uniform(0.6, 0.8)), 3)}


def adapt(ring: Ring, out: Path, seed: int, bar: Stage) -> None:
    """Wear a limb, identify the wear from logs, make a new table and firmware, and follow the paths again.

    In between, the paths are followed with the old table while the robot estimates the wear of its limbs.

    Args:
        ring: result of ``run_demo``, whose ``adaptation`` is set. The runs along its paths are the training
            runs.
        out: the same folder, for logs (``worn-PATH.h5``), ``found.toml`` and, if an effect is found, ``new/``
            with library, table and firmware.
        seed: seed of the wear, the library and the camera's noise.
    """
    lap = _stage_clock(ring.stage_s)
    robot, tables, options = ring.robot, ring.tables, ring.options
    paths = [run.log.path.name for run in ring.runs if run.log.path is not None]
    true_effect = draw_wear(robot, seed)

    def follow(image: Path, with_tables: Tables, name: str, title: str, learn: bool = False) -> RunLog:
        with bar(f"{title}, the {name}: path points") as progress:
            return run_in_pool(
                VirtualRobot(image, len(robot.limbs)),
                with_tables,
                robot,
                shape(name),
                dataclasses.replace(options, learn=learn),
                [seed, 1],
                "demo",
                World(make_effects([true_effect], Path())),
                progress=progress,
            ).log()

    logs, old = [], []
    for name in (*paths, HELD_OUT):
        run = follow(ring.built.image, tables, name, "swim with a worn limb")
        logs.append(out / f"worn-{name}.h5")
        write_run(logs[-1], dataclasses.replace(run, truth=None))
        old.append(run)
    lap("swim with a worn limb")
    learned = [follow(ring.built.image, tables, name, "swim and learn", learn=True) for name in paths]
    lap("swim and learn")
    swims = [read_segments(log, robot) for log in logs]
    with in_stages(bar, "identify") as tell:
        outcome = identify(swims[:-1], swims[-1:], robot, progress=tell)
    with bar("predict several periods ahead") as progress:
        ahead = len(outcome.horizons)
        progress(ahead, ahead)
    write_robot(out / "found.toml", outcome)
    lap("identify")
    new = []
    if outcome.terms:
        found = load_robot(out / "found.toml")
        title = "new library: simulate transitions"
        image = make_tables(found, out / "new", ring.states, seed, bar, title)
        built = build("bench", image, found, out / "new" / "firmware")
        lap("new library, tables, firmware")
        opened = read_image(image)
        new = [follow(built.image, opened, name, "swim with the new firmware") for name in paths]
        lap("swim with the new firmware")
    ring.adaptation = Adaptation(true_effect, outcome, old[:-1], learned, new)


def make_tables(robot: Robot, out: Path, states: int, seed: int, bar: Stage, title: str) -> Path:
    """Make ``library.h5`` and from it ``tables.fkt`` in a folder; return the path of the table."""
    image = out / "tables.fkt"
    write_bytes(image, default_table(robot, out / "library.h5", bar, title, states, seed))
    return image


def _stage_clock(stage_s: dict[str, float]) -> Callable[[str], None]:
    """Return a function that is called at the end of each stage and records its duration, s."""
    since_s = time.perf_counter()

    def lap(stage: str) -> None:
        nonlocal since_s
        now_s = time.perf_counter()
        stage_s[stage], since_s = now_s - since_s, now_s

    return lap
