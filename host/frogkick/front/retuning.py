"""New tables for a worn robot, made from its last runs and sent to it if they are better."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import FrogkickError, InputError
from frogkick.core.files import require_writable
from frogkick.core.progress import Progress, shown
from frogkick.effects import World, effects_of
from frogkick.front.html import page_of
from frogkick.front.identifying import Given, LeftOut, log_of
from frogkick.front.places import built_firmware
from frogkick.front.robots import VIRTUAL, Pushed, push_table, require_target
from frogkick.front.tables import Table, load_table
from frogkick.identification import retune as retuning
from frogkick.identification.retune import BEFORE, ROBOT, TABLES, Retuned, require_new
from frogkick.identification.segments import reliable, segments_of
from frogkick.identification.tables import Stage, Tracked
from frogkick.library import build_library, fit_table
from frogkick.library.fitting import looked_up
from frogkick.paths import SHAPES
from frogkick.robot import Robot, load_robot
from frogkick.runs.trial import trials
from frogkick.tables.image import open_image, read_image
from frogkick_codegen.firmware import build, require_tools

__all__ = ["BEFORE", "STATES", "TABLES", "Pushed", "Retuning", "retune"]

STATES = 800
SAMPLING = "visited"
KIND = "affine"
LOOP_PATHS, LOOP_SEEDS = tuple(SHAPES), 2


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Retuning(Retuned):
    """The result of retuning a robot.

    Attributes:
        outcome: the identification: its verdict and its effects.
        before, after: prediction errors of the old and the new tables one period ahead on held-out periods;
            NaN if no tables were made.
        better: whether the new tables predict better; otherwise the robot keeps its old ones.
        done: whether the tables are right now: better new ones, or old ones that lack nothing.
        reason: the reason why the old tables stay; "" if they do not.
        out: folder of the results; see ``retune``.
        left_out: runs that were not used: ``run`` and ``reason`` of each.
        pushed: the tables of the robot after sending, if they were sent.
        not_pushed: the error that prevented sending, or None.
    """

    out: Path
    left_out: Sequence[Mapping[str, str]] = ()
    pushed: Pushed | None = None
    not_pushed: FrogkickError | None = None

    @property
    def robot(self) -> Robot:
        """The robot with the identified effects, as in ``out``.

        Raises:
            InputError: no tables were made.
        """
        return load_robot(self.out / ROBOT)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``retune``."""
        values = {
            **super().as_json(),
            "out": str(self.out) if self.tables else None,
            "pushed": None,
            "left_out": list(self.left_out),
        }
        if self.pushed is not None:
            values |= {"bytes_sent": self.pushed.bytes_sent, "pushed": self.pushed.as_json()}
        return values

    def __repr__(self) -> str:
        names = ", ".join(term.title for term in self.outcome.terms) or "no effect"
        errors = " / ".join(f"{1e3 * error.position_rmse_m:.2f}" for error in (self.before, self.after))
        kept = "new tables" if self.better else "old tables stay"
        return f"Retuning({self.outcome.verdict}: {names}; {kept}; old / new {errors} mm)"

    def _repr_html_(self) -> str:
        return page_of(repr(self), {"verdict": self.outcome.verdict, "out": self.out, "reason": self.reason})


def retune(
    runs: Sequence[Given],
    *,
    robot: Robot | str,
    out: Path | str,
    table: Table | Path | str | None = None,
    states: int = STATES,
    workers: int | None = None,
    push: str | None = None,
    key: Path | str | None = None,
    seed: int = 0,
    left_out: LeftOut = lambda _rows: None,
    progress: Progress = False,
    laws: bool = True,
) -> Retuning:
    """Identify what a model lacks, make tables with it, and keep them if they predict better.

    Args:
        runs: the robot's last runs in the order of their dates. The last run is the test run; of a single run
            the last third is.
        robot: the robot that its tables were made from, its name or its TOML file.
        out: folder, new or empty, for ``robot.toml``, ``library.h5``, ``before.fkt`` (the old tables), and
            ``tables.fkt`` with ``firmware``, or ``refused.fkt`` if these are no better. The folder is made
            only if tables are made.
        table: the table that the robot carries, or its file, to compare with; None: made like the new one,
            without effects.
        states: number of states of the simulated libraries, 46 to 65535.
        workers: number of processes; None: one for each core.
        push: ``ble:NAME``, ``serial:PORT`` or ``virtual``, where better tables are sent; None: nowhere.
        key: key file of that robot's owner, if it has one; None: the user's own, see ``connect``.
        seed: seed of the libraries' sampling.
        left_out: called before the work with the runs that are not used.
        progress: True for bars on stderr, or a function of (done, all) of each stage.
        laws: search formulas as well, see ``identify``. Those that hang on place, heading or time cannot go
            into a table; ``lost`` says which, and what that costs.

    Raises:
        InputError: runs of several robots or of another period, a folder ``out`` that is not empty, or tables
            of another robot.
        ToolchainError: no compiler for the firmware is found.
    """
    if push is not None:
        require_target(push, (VIRTUAL,))
    require_tools("bench")
    folder = Path(out)
    require_writable(folder, folder=True)
    require_new(folder)
    described = load_robot(robot)
    swims, unused = reliable([segments_of(*log_of(each), described) for each in runs])
    left_out(unused)
    old = None if table is None else _carried(table, described)
    tools = _Tools(states, seed, workers or os.cpu_count() or 1)
    found = retuning.retune(swims, described, folder, tools, partial(shown, progress), old, laws)
    sent = failed = None
    if push is not None and found.better:
        try:
            owner = None if key is None else Path(key)
            sent = push_table(push, folder / TABLES, folder / BEFORE, progress, owner)
        except FrogkickError as error:  # the results stay
            failed = error
    return Retuning(**vars(found), out=folder, left_out=unused, pushed=sent, not_pushed=failed)


def _carried(table: Table | Path | str, robot: Robot) -> bytes:
    """Return the image that a robot carries."""
    used = load_table(table, robot)
    opened = used.tables
    opened.require_robot(robot.id)
    if opened.period_us != round(robot.period_s * 1e6):
        raise InputError(
            f"table {used.name!r} has a period of {opened.period_us * 1e-6:.3f} s, but robot "
            f"{robot.id!r} has {robot.period_s:.3f} s: give the robot's own table"
        )
    return opened.image


@dataclass(frozen=True)
class _Tools:
    """Makes tables with a number of states and processes; see frogkick.identification.tables.Tools."""

    count: int
    seed: int
    workers: int

    def tables(self, robot: Robot, library: Path, stage: Stage) -> bytes:
        with stage(f"library of {self.count} states") as progress:
            made = build_library(
                robot, self.count, self.seed, self.workers, library, progress, SAMPLING, record_s=0.0
            )
        with stage("tables tried") as progress:
            return fit_table(made, KIND, progress=progress).image

    def states(self, image: bytes) -> int:
        return len(open_image(image).states)

    def looked_up(
        self, image: bytes, velocity_body: NDArray[np.float64], previous: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        return looked_up(open_image(image), velocity_body, previous)

    def tracked(self, tables: Path, robot: Robot, progress: Callable[[int, int], None]) -> Tracked:
        with built_firmware("native", tables, robot) as built:
            runs = trials(
                built.image,
                read_image(tables),
                robot,
                lambda: World(effects_of(robot)),
                LOOP_PATHS,
                LOOP_SEEDS,
                progress=progress,
            )
        numbers = [run.tracking for run in runs]
        return Tracked(
            float(np.mean([each.mean_distance_m for each in numbers])),
            float(np.mean([each.progress_mps for each in numbers])),
            sum(each.completed for each in numbers),
            len(numbers),
        )

    def firmware(self, tables: Path, robot: Robot, out: Path) -> Mapping[str, Any]:
        built = build("bench", tables, robot, out)
        return {"image": built.image.name, "flash_bytes": built.flash_bytes, "ram_bytes": built.ram_bytes}
