"""The value of limb use as an input of a table: for a robot as it is, and for robots that tire."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.progress import shown
from frogkick.effects import rods_of
from frogkick.library import Library, error_on, fit_table, sample_library
from frogkick.library.sampling import rigid_starts
from frogkick.library.store import library_of
from frogkick.library.transitions import RESTED, simulate_task
from frogkick.report import style
from frogkick.robot import Robot, load_robot, parse_robot
from frogkick.tables.image import open_image
from frogkick_studies import StudyResult
from frogkick_studies.configs import History

VARIANTS = {
    "as described": "",
    "limbs recover 4 times as slowly": '[[effect]]\nname = "limb_wear"\nduration_scale = 4.0\n',
    "strokes soon after another lose half": '[[effect]]\nname = "limb_memory"\nloss = 0.5\nfade_s = 2.0\n',
}
"""Additions to the robot's TOML text."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class HistoryResult:
    """Errors of affine tables of 64 KiB on unseen states of swims with random strokes; see ``error_on``.

    Attributes:
        restarted: table of transitions that begin as rigid bodies with limbs at rest.
        without: table of transitions that begin during strokes, without limb use as an input.
        with_use: the same with limb use as an input.
        decay, gain: the limb use that was found.
        largest_mm: largest effect of full use of one limb on the end of a stroke.
    """

    variant: str
    restarted: dict[str, float]
    without: dict[str, float]
    with_use: dict[str, float]
    decay: float
    gain: float
    largest_mm: float


def measure_limb_use(
    robot: Robot, states: int, test_states: int, seed: int, progress: Progress = lambda _done, _all: None
) -> list[HistoryResult]:
    """Measure the errors of the three tables for each of VARIANTS."""
    results: list[HistoryResult] = []
    steps = itertools.count()

    def step() -> None:
        progress(next(steps), 6 * len(VARIANTS))

    for variant, text in VARIANTS.items():
        step()
        tiring = parse_robot(f"{robot.toml}\n{text}", source=variant) if text else robot
        library = sample_library(tiring, states, seed, "visited")
        step()
        unseen = sample_library(tiring, test_states, seed + 1, "visited")
        step()
        restarted = open_image(fit_table(_restarted(tiring, library), "affine").image)
        step()
        rested = replace(library, previous_actions=np.full_like(library.previous_actions, RESTED))
        without = open_image(fit_table(rested, "affine").image)
        step()
        tables = open_image(fit_table(library, "affine").image)
        moved = tables.history[..., :2] * tables.motion_scale[:2].astype(np.float64)
        results.append(
            HistoryResult(
                variant,
                error_on(restarted, unseen),
                error_on(without, unseen),
                error_on(tables, unseen),
                tables.use_decay / 2**15,
                tables.use_gain / 2**15,
                float(1e3 * np.hypot(moved[..., 0], moved[..., 1]).max()),
            )
        )
        step()
    step()
    return results


def _restarted(robot: Robot, library: Library) -> Library:
    """Return the library of the same velocities, each of a rigid robot with all limbs at rest."""
    starts, rods = rigid_starts(robot, library.initial_velocity_body), rods_of(robot)
    done = [simulate_task(rods, task) for task in starts.tasks]
    return library_of(robot, library.sampling, library.seed, starts.unfolded(done))


@dataclass(frozen=True, eq=False)
class HistoryStudy(StudyResult):
    """Errors of tables with and without limb use, for each of VARIANTS, and the seed of the states."""

    results: Sequence[HistoryResult]
    seed: int

    def plot(self) -> Figure:
        """Draw errors one period ahead of three tables for each robot."""
        with style.new_figure(9.0, 3.8) as figure:
            places = np.arange(len(self.results))
            for axes, (name, factor, label) in zip(figure.subplots(1, 2), _PANELS, strict=True):
                for offset, (table, text, colour) in zip((-0.27, 0.0, 0.27), _BARS, strict=True):
                    heights = [factor * getattr(result, table)[name] for result in self.results]
                    bars = axes.bar(places + offset, heights, 0.25, color=colour, label=text)
                    axes.bar_label(bars, [f"{height:.2g}" for height in heights], fontsize=7.5, padding=1)
                axes.set_yscale("log")
                axes.set_xticks(places, [_wrapped(result.variant) for result in self.results])
                axes.set_ylabel(label)
                axes.set_title(f"Affine tables of 64 KiB: {label.split(' (')[0]}")
            style.legend_below(figure, axes, 3)
        return figure

    def as_json(self) -> dict[str, Any]:
        return {"robots": [dataclasses.asdict(result) for result in self.results], "seed": self.seed}


def run(config: History) -> HistoryStudy:
    with shown(True, "limb history") as tell:
        robot = load_robot(config.robot)
        return HistoryStudy(
            measure_limb_use(robot, config.states, config.test_states, config.seed, tell), config.seed
        )


_BARS = (
    ("restarted", "limbs at rest in the library", style.DESIRED),
    ("without", "states of swims, limb use no input", style.MEASURED),
    ("with_use", "limb use as an input", style.TRUE),
)
_PANELS = (
    ("position_m", 1e3, "position error (mm)"),
    ("heading_rad", 180.0 / np.pi, "heading error (degrees)"),
)


def _wrapped(text: str) -> str:
    words = text.split(" ")
    half = (len(words) + 1) // 2
    return " ".join(words[:half]) + "\n" + " ".join(words[half:])
