"""Libraries and tables in memory, each with its robot; the default table of a robot is kept in the cache.

What does not fit raises an ``InputError``: an unknown robot or file, a value out of range, a table for
another robot. A file that is not a valid table image raises a ``TableError``.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from frogkick import library as libraries
from frogkick.core.arguments import typed
from frogkick.core.chunks import numerical_versions
from frogkick.core.errors import InputError
from frogkick.core.files import (
    cache_folder,
    existing_file,
    one_at_a_time,
    require_writable,
    sole_writer,
    write_bytes,
)
from frogkick.core.progress import Progress, progress_bar, shown, tell_line
from frogkick.effects.registry import own_code
from frogkick.library import RECORD_S, Library, library_info, wear
from frogkick.library.fitting import SAMPLING, SEED, STATES
from frogkick.planner.plan import (
    PLAN_TIME_WATCHDOG_US,
    look_up_most_ns,
    transitions_of,
    transitions_within,
)
from frogkick.report.style import page_of
from frogkick.robot import Robot, built_in_robots, load_robot
from frogkick.tables.image import Tables, open_image, read_image

__all__ = ["RECORD_S", "Table", "build_library", "fit_table", "library_info", "load_library", "load_table"]

KIB = 1024
DEFAULT_ROBOT = "frog2022"


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """A robot's transition table as in the robot's flash, with its robot.

    Attributes:
        tables: the image, checked and decoded.
        robot: the robot, with its geometry and its planner.
        name: name of its file, for messages.
    """

    tables: Tables
    robot: Robot
    name: str = "tables.fkt"

    @property
    def image(self) -> bytes:
        """The bytes of the image, the same in flash, in a file and on the radio."""
        return self.tables.image

    @property
    def kind(self) -> str:
        """``nearest`` or ``affine``."""
        return self.tables.kind

    @property
    def states(self) -> int:
        """Number of initial velocities of the table."""
        return len(self.tables.states)

    @property
    def crc32(self) -> int:
        """CRC-32 of the image, which the robot reports too."""
        return self.tables.crc32

    def facts(self) -> dict[str, Any]:
        """Return the facts of the image: the keys of ``tables info``, without the error."""
        return facts_of(self.tables)

    def error(
        self, states: int = 64, seed: int = 1, sampling: str = "planned", progress: Progress = False
    ) -> dict[str, float]:
        """Return the root-mean-square error of one-period predictions on states that are not in the table.

        Args:
            states: number of unseen initial velocities to simulate.
            seed: seed of their sampling.
            sampling: of these states, as for ``build_library``: "planned" (where the planner leads the
                robot), "visited" (where random strokes lead it) or "box" (any velocity, also those that no
                swim has).
            progress: True for a bar, or a function of (done, all).

        Returns:
            Among others ``position_m`` (m) and ``heading_rad`` (rad).
        """
        with shown(progress, "unseen states") as tell:
            unseen = libraries.sample_library(self.robot, states, seed, sampling, tell)
            return libraries.error_on(self.tables, unseen)

    def save(self, file: Path | str) -> None:
        """Write the image (.fkt). A file that cannot be written is an ``InputError``."""
        write_bytes(file, self.image)

    @contextmanager
    def file(self) -> Iterator[Path]:
        """Yield a file of the image that exists as long as the context."""
        with tempfile.TemporaryDirectory(prefix="frogkick-table-") as folder:
            file = Path(folder) / self.name
            file.write_bytes(self.image)
            yield file

    def __repr__(self) -> str:
        return (
            f"Table({self.kind}, {self.states} states, {len(self.tables.actions)} actions, "
            f"{len(self.image) / KIB:.1f} KiB, for {self.robot.id!r}, crc32 {self.crc32:08x})"
        )

    def _repr_html_(self) -> str:
        return page_of("Table", self.facts())


def facts_of(tables: Tables) -> dict[str, Any]:
    """Return the facts of an image, whose robot need not be known."""
    return {
        "bytes": len(tables.image),
        "states": len(tables.states),
        "actions": len(tables.actions),
        "kind": tables.kind,
        "robot": tables.robot_id,
        "period_s": tables.period_us / 1e6,
        "pulse_s": tables.pulse_us / 1e6,
        "crc32": f"{tables.crc32:08x}",
        "provenance": tables.provenance.hex(),
        "wear": {"knots": tables.limb_wear.shape[1], "bytes": 2 * tables.limb_wear.size},
        "limb_use": {"decay": tables.use_decay / 2**15, "gain": tables.use_gain / 2**15},
        "look_up_bound_ms": look_up_most_ns(len(tables.states), tables.tree_levels) * 1e-6,
        "transitions_max": min(transitions_within(PLAN_TIME_WATCHDOG_US), transitions_of(tables)),
    }


def read_facts(file: Path | str) -> dict[str, Any]:
    """Return the facts of the image in a file."""
    return facts_of(read_image(file))


def default_tables(robot: Robot | str, states: int | None = None, sampling: str = SAMPLING) -> Path:
    """Return the path of a robot's table image, which is built on first use (about a minute).

    ``states`` (None: ``STATES``) and ``sampling`` are those of its library.
    """
    robot = load_robot(robot)
    states = STATES if states is None else states
    made_of = f"{_source_sha256()} {states} {SEED} {sampling} {wear.GAINS}\n{numerical_versions()}".encode()
    key = hashlib.sha256(robot.sha256 + made_of + own_code(robot)).hexdigest()[:24]
    target = cache_folder("tables") / f"{robot.id}-{key}.fkt"
    if _is_valid(target):
        return target
    with one_at_a_time(cache_folder("building"), key) as work:
        if not _is_valid(target):  # otherwise another process has built it meanwhile
            file = work / "library.h5"
            title = f"library for {robot.id}"
            image = libraries.default_table(robot, file, progress_bar, title, states, SEED, sampling)
            write_bytes(target, image)
            file.unlink()
    return target


MADE_BY = ("core", "robot", "der", "effects", "library", "tables", "planner")
"""Packages of frogkick whose code decides the bytes of a table."""


def _source_sha256() -> str:
    """Return the hash of the simulating and quantising code, so that new physics gives a new table."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[1]
    for folder in MADE_BY:
        for file in sorted((package / folder).glob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _is_valid(target: Path) -> bool:
    """Return whether a valid table exists; a damaged one is made again without an error."""
    try:
        read_image(target)
    except InputError:
        return False
    return True


def table_image(file: Path | str | None, robot: Robot | str | None) -> Path:
    """Return the given table image, or the default one of a robot."""
    return default_tables(robot or DEFAULT_ROBOT) if file is None else existing_file(file, "table image")


def robot_of_table(file: Path, robot: Robot | str | None = None, opened: Tables | None = None) -> Robot:
    """Return a table's robot: the given one, if it fits, else a built-in one, or ID.toml beside the file.

    ``opened`` is the image, if it has been read.
    """
    tables = opened or read_image(file)
    if robot is None and tables.robot_id not in built_in_robots():
        beside = file.parent / f"{tables.robot_id}.toml"
        if not beside.is_file():
            raise InputError(
                f"table {file.name!r} is for robot {tables.robot_id!r}, which is not built in: give its TOML "
                f"file with --model, or put it beside the table as {tables.robot_id}.toml"
            )
        robot = str(beside)
    described = load_robot(tables.robot_id if robot is None else robot)
    tables.require_robot(described.id)
    rows = [(row.name, row.first_mask, row.second_mask) for row in tables.actions]
    if tables.limbs != len(described.limbs) or rows != [
        (code, action.first_mask, action.second_mask)
        for code, action in zip(described.action_codes, described.actions, strict=True)
    ]:
        raise InputError(
            f"table {file.name!r} has other limbs or actions than robot {described.id!r}: "
            "build the library and the table again from this robot"
        )
    return described


@typed
def load_table(file: Table | Path | str | None = None, robot: Robot | str | None = None) -> Table:
    """Read a table image (.fkt) and check every part of it.

    Args:
        file: the image; None: the robot's default table, which is made on first use and kept in the user's
            cache (about a minute, with a bar on stderr). A table in memory keeps its robot, unless another
            one is given.
        robot: the robot, its name or its TOML file; None: the robot that the image names, built-in or ID.toml
            beside the file.

    Raises:
        InputError: an unknown file or robot, or a table for another robot or another version of it.
        TableError: the file is not a valid table image.
    """
    if isinstance(file, Table):
        if robot is None:
            return file
        image, tables = Path(file.name), open_image(file.image)
    else:
        image = table_image(file, robot)
        tables = read_image(image)
    return _called(tables, robot_of_table(image, robot, tables), image.name)


def _called(tables: Tables, robot: Robot, name: str = Table.name) -> Table:
    """Return a table whose actions have the names of the robot's file."""
    return Table(tables.called([action.name for action in robot.actions]), robot, name)


@typed
def build_library(
    robot: Robot | Path | str,
    states: int = 300,
    seed: int = 0,
    *,
    sampling: str = "box",
    record_s: float = 0.0,
    workers: int | None = None,
    cluster: str | None = None,
    out: Path | str | None = None,
    progress: Progress = False,
) -> Library:
    """Simulate every action from each of many initial velocities.

    The numbers depend on robot, states, seed and sampling, but not on the machine.

    Args:
        robot: the robot, its name or its TOML file.
        states: number of initial velocities, 1 to 65535.
        seed: seed of their sampling.
        sampling: "box" (uniform in the robot's velocity box, as in the paper), "visited" (from swims with
            random strokes) or "planned" (from swims that the planner steers).
        record_s: time to record each transition (s), for tables of another period; 0: one period. The
            recording is kept in ``out`` only.
        workers: number of processes; None: one for each core.
        cluster: address of a Dask scheduler whose workers simulate instead.
        out: HDF5 file to write as well. An interrupted build resumes if it is started again with the same
            arguments; parts of another robot, seed or version are refused.
        progress: True for a bar, or a function of (transitions done, all).

    Raises:
        InputError: a value out of range, a file that cannot be written, or no cluster at the address.
        ConvergenceError: every simulation failed.
    """
    robot = load_robot(robot)
    with ExitStack() as stack:
        if out is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="frogkick-library-"))
            file = Path(folder) / "library.h5"
        else:
            require_writable(out)
            file = Path(out)
            stack.enter_context(sole_writer(file))  # and of the checkpoints beside it
        tell = stack.enter_context(shown(progress, "library"))
        processes = 1 if cluster else workers or os.cpu_count() or 1
        try:
            made = libraries.build_library(
                robot, states, seed, processes, file, tell, sampling, record_s, cluster, keep_others=True
            )
        except KeyboardInterrupt:
            parts = libraries.checkpoint_folder(file)
            if out is not None and parts.exists():
                tell_line(
                    f"frogkick: finished parts are in {str(parts)!r}: the same command resumes from there"
                )
            raise
        return replace(made, folder=robot.folder)


@typed
def load_library(file: Path | str) -> Library:
    """Read a library (HDF5) that ``Library.save`` or ``frogkick library build`` wrote.

    Raises:
        InputError: the file is missing, incomplete, or not a library.
    """
    return libraries.read_library(file)


@typed
def fit_table(
    library: Library | Path | str,
    kind: str | None = None,
    budget_kib: float | None = None,
    *,
    progress: Progress = False,
) -> Table:
    """Make the robot's table from a library.

    Args:
        library: the result of ``build_library``, or its file.
        kind: "nearest" (the paper's: one row for each state), "affine" (fewer states, with a local linear
            correction and limb use as an input); None: the kind with the smaller error. That is affine,
            unless the library has too few states.
        budget_kib: largest size of the image, KiB; None: 64 for affine, no limit for nearest.
        progress: True for a bar, or a function of (done, all).

    Raises:
        InputError: an unknown kind, too few states, or a budget that holds no state.
    """
    if not isinstance(library, Library):
        library = load_library(library)
    if budget_kib is not None and not (
        isinstance(budget_kib, int | float | np.number) and 0.5 <= budget_kib <= 16384
    ):
        raise InputError(f"budget is {budget_kib!r} KiB: give 0.5 to 16384")
    budget = None if budget_kib is None else int(budget_kib * KIB)
    with shown(progress, "tables tried") as tell:
        image = libraries.fit_table(library, kind, budget, tell).image
    return _called(open_image(image), library.robot())
