"""The default table: what a robot carries where no other table is asked for.

The demo, commands without ``--tables`` and ``fk.load_table()`` use it. Its kind and size are those of
``fit_table`` without arguments: an affine table of ``BUDGET_BYTES``, which fits a slot of every robot.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from frogkick.core.progress import Tell
from frogkick.library.build import build_library
from frogkick.library.fitting import fit_table
from frogkick.robot import Robot

STATES = 300
"""Number of states of its library: what an affine table of 64 KiB holds, and a few more."""
SEED = 0
SAMPLING = "planned"
"""The planner leads to these states: there a table from random swims errs six times as much."""


def default_table(
    robot: Robot,
    library: Path,
    stage: Callable[[str], AbstractContextManager[Tell]],
    title: str,
    states: int = STATES,
    seed: int = SEED,
    sampling: str = SAMPLING,
) -> bytes:
    """Simulate a library and fit the default table to it.

    Args:
        robot: the robot.
        library: file to write the library to (HDF5).
        stage: makes a progress bar with a title.
        title: of the library's bar.
        states: number of states of the library. Too few for an affine table give one of kind nearest.
        seed, sampling: how they are drawn; see ``sample_starts``.

    Returns:
        The table image.

    Raises:
        InputError: a number of states out of range.
        ConvergenceError: a simulation failed.
    """
    with stage(title) as tell:
        made = build_library(
            robot,
            states=states,
            seed=seed,
            workers=os.cpu_count() or 1,
            out=library,
            progress=tell,
            sampling=sampling,
            record_s=0.0,
        )
    with stage("tables tried") as tell:
        return fit_table(made, progress=tell).image
