"""What it is worth to tell a table how recently each limb was used: for a robot as it is, for tiring ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from frogkick.effects import rods_of
from frogkick.library import Library, error_on, fit_table, sample_library
from frogkick.library.starts import gliding
from frogkick.library.store import make_library
from frogkick.library.transitions import RESTED, simulate_task
from frogkick.robot import Robot, parse_robot
from frogkick.tables.image import open_image

VARIANTS = {
    "as described": "",
    "limbs curl back 4 times as slowly": '[[effect]]\nname = "limb_wear"\nduration_scale = 4.0\n',
    "strokes soon after another lose half": '[[effect]]\nname = "limb_memory"\nloss = 0.5\nfade_s = 2.0\n',
}
"""What is added to the robot's TOML."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class HistoryResult:
    """Errors of affine tables of 64 KiB on unseen states of steered swims; see ``error_on``.

    Attributes:
        variant: which robot.
        restarted: table of transitions that begin as rigid bodies with limbs at rest.
        without: table of transitions that begin amid strokes, limb use not an input.
        with_use: the same with limb use as an input.
        decay, gain: of the limb use that was found.
        largest_mm: the most that full use of one limb moves the end of a stroke.
    """

    variant: str
    restarted: dict[str, float]
    without: dict[str, float]
    with_use: dict[str, float]
    decay: float
    gain: float
    largest_mm: float


def history_worth(
    robot: Robot, states: int, test_states: int, seed: int, progress: Progress = lambda _done, _all: None
) -> list[HistoryResult]:
    """Measure the three tables for each of VARIANTS.

    Args:
        robot: the plain one.
        states: of each library, from steered swims.
        test_states: unseen ones.
        seed: of the libraries; the unseen states have the next one.
        progress: called with steps done and to do.

    Raises:
        InputError: too few states for an affine table.
        ConvergenceError: a state cannot be simulated.
    """
    results: list[HistoryResult] = []
    steps = 6
    for index, (variant, text) in enumerate(VARIANTS.items()):
        told = [0]

        def step(index: int = index, told: list[int] = told) -> None:
            progress(index * steps + told[0], len(VARIANTS) * steps)
            told[0] += 1

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
    progress(len(VARIANTS) * steps, len(VARIANTS) * steps)
    return results


def _restarted(robot: Robot, library: Library) -> Library:
    """The same velocities, each a rigid robot's with all limbs at rest."""
    starts, rods = gliding(robot, library.initial_velocity_body), rods_of(robot)
    done = [simulate_task(rods, task) for task in starts.tasks]
    return make_library(robot, library.sampling, library.seed, starts, done)
