"""The ring's last stretch: something changes, logs tell what, the model learns it, new firmware knows it."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.files import write_bytes
from frogkick.effects import World
from frogkick.effects.registry import make_effects
from frogkick.identification.outcome import Outcome, identify, write_robot
from frogkick.identification.retune import steps
from frogkick.identification.swim import read_swim
from frogkick.library import build_library, quantise, read_library
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot, load_robot
from frogkick.runs.closed_loop import RunOptions
from frogkick.runs.runlog_file import write_run
from frogkick.study.trial import Trial, swim
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.firmware import build

Bar = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Makes a progress bar with a title; inside it is a function of (done, all)."""

HELD_OUT = "bends"
"""The path that nothing is learned from."""


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


def plant(robot: Robot, seed: int) -> dict[str, Any]:
    """A worn limb: which one, and how strong it still is, by the seed."""
    rng = np.random.default_rng([seed, 2])
    limb = robot.limbs[int(rng.integers(len(robot.limbs)))].name
    return {"name": "limb_wear", "limb": limb, "gain": round(float(rng.uniform(0.6, 0.8)), 3)}


def close_ring(
    robot: Robot,
    tables: Tables,
    firmware: Path,
    out: Path,
    options: RunOptions,
    seed: int,
    bar: Bar,
    paths: Sequence[str],
    held_out: str = HELD_OUT,
    lap: Callable[[str], None] = lambda _stage: None,
) -> Closing:
    """Let a limb wear, find it from logs alone, make tables and firmware that know it, swim again.

    Args:
        robot: the model, which is not told.
        tables, firmware: the robot's own so far, for the virtual chip.
        out: folder for logs (``worn-PATH.h5``), ``found.toml`` and, where something was found, ``new/`` with
            library, table and firmware.
        options: of every run.
        seed: of what wears, of the library and of the camera's noise.
        bar: makes progress bars.
        paths: learned from, and swum again.
        held_out: path of the run that is only predicted.
        lap: told at the end of each stage.

    Raises:
        FrogkickError: any stage's own.
    """
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
        run = swum(firmware, tables, name, "swim with a worn limb")
        logs.append(out / f"worn-{name}.h5")
        write_run(logs[-1], dataclasses.replace(run.log, truth=None))
        old.append(run)
    lap("swim with a worn limb")
    swims = [read_swim(log, robot) for log in logs]
    with steps(bar) as tell:
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
        image = make_tables(found, out / "new", len(tables.states), seed, bar, title)
        built = build("bench", image, found, out / "new" / "firmware")
        lap("new library, tables, firmware")
        opened = read_image(image)
        new = [swum(built.image, opened, name, "swim with the new firmware") for name in paths]
        lap("swim with the new firmware")
    return Closing(planted, outcome, old[:-1], new)


def make_tables(robot: Robot, out: Path, states: int, seed: int, bar: Bar, title: str) -> Path:
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
