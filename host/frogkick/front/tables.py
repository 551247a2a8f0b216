"""Libraries and tables in memory, each with the robot that it is of."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from frogkick import library as libraries
from frogkick.core.errors import InputError
from frogkick.core.files import write_bytes
from frogkick.core.progress import Progress, shown, tell_line
from frogkick.front.default_tables import default_tables
from frogkick.front.html import page_of
from frogkick.front.places import DEFAULT_ROBOT, called_by, robot_of_image
from frogkick.library import RECORD_S, Library, library_info
from frogkick.robot import Robot, load_robot
from frogkick.tables.image import Tables, open_image, read_image

__all__ = ["RECORD_S", "Table", "build_library", "fit_table", "library_info", "load_library", "load_table"]

KIB = 1024


@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """A robot's transition table, as it lies in the robot's flash, and the robot that it is for.

    Attributes:
        tables: the image, checked and decoded.
        robot: whose geometry and planner's settings count.
        name: of its file, for messages.
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
        """How many initial velocities the table has."""
        return len(self.tables.states)

    @property
    def crc32(self) -> int:
        """CRC-32 that the robot says of it, too."""
        return self.tables.crc32

    def facts(self) -> dict[str, Any]:
        """What the image says of itself: the keys of ``tables info``, without the error."""
        return facts_of(self.tables)

    def error(
        self, states: int = 64, seed: int = 1, sampling: str = "box", progress: Progress = False
    ) -> dict[str, float]:
        """Root-mean-square error of a period's prediction on states that are not in the table.

        Args:
            states: how many unseen initial velocities are simulated.
            seed: of their sampling.
            sampling: "box", "visited" or "planned", as for ``build_library``.
            progress: True for a bar, or a function of (done, all).

        Returns:
            Among others ``position_m`` (m) and ``heading_rad`` (rad).
        """
        with shown(progress, "unseen states") as tell:
            return libraries.table_error(self.tables, self.robot, states, seed, sampling, tell)

    def save(self, file: Path | str) -> None:
        """Write the image (.fkt).

        Raises:
            InputError: the file cannot be written.
        """
        write_bytes(file, self.image)

    @contextmanager
    def file(self) -> Iterator[Path]:
        """A file of the image for as long as the context lives."""
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
    """What an image says of itself."""
    return {
        "bytes": len(tables.image),
        "states": len(tables.states),
        "actions": len(tables.actions),
        "kind": tables.kind,
        "robot": tables.robot_id,
        "period_s": tables.period_us * 1e-6,
        "pulse_s": tables.pulse_us * 1e-6,
        "crc32": f"{tables.crc32:08x}",
        "provenance": tables.provenance.hex(),
        "limb_use": {"decay": tables.use_decay / 2**15, "gain": tables.use_gain / 2**15},
    }


def read_facts(file: Path | str) -> dict[str, Any]:
    """What the image in a file says of itself, whatever robot it is for.

    Raises:
        InputError: no such file.
        TableError: the file is no usable table image.
    """
    return facts_of(read_image(file))


def load_table(file: Path | str | None = None, robot: Robot | str | None = None) -> Table:
    """Read a table image (.fkt) and check every part of it.

    Args:
        file: the image; None: the robot's default table, which is made on first use and kept in the user's
            cache (about a minute, with a bar on stderr).
        robot: the robot or its name or TOML file; None: the one that the image names, built-in or ID.toml
            beside the file.

    Raises:
        InputError: no such file or robot, or the table is for another robot or another version of it.
        TableError: the file is no usable table image.
    """
    if file is None:
        file = default_tables(robot or DEFAULT_ROBOT)
    tables = read_image(file)
    described = robot_of_image(tables, robot, Path(file))
    return Table(called_by(described, tables), described, Path(file).name)


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

    The numbers depend on robot, states, seed and sampling, not on who simulates.

    Args:
        robot: what to simulate, or its name or TOML file.
        states: initial velocities, 1 to 65535.
        seed: of their sampling.
        sampling: "box" (uniform in the robot's velocity box, the paper's), "visited" (at random strokes) or
            "planned" (at the planner's).
        record_s: follow each transition so long (s), for tables of another period; 0: one period. What is
            recorded is kept in ``out`` only.
        workers: processes; None: one for each core.
        cluster: address of a Dask scheduler whose workers simulate instead.
        out: HDF5 file to write as well. Stopped and started again with the same arguments, a build goes on
            from what is finished; parts of another robot, seed or the like are refused.
        progress: True for a bar, or a function of (transitions done, all).

    Raises:
        InputError: a value out of range, a file that cannot be written, or no cluster there.
        ConvergenceError: every simulation failed.
    """
    robot = load_robot(robot)
    with ExitStack() as stack:
        if out is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="frogkick-library-"))
            file = Path(folder) / "library.h5"
        else:
            file = Path(out)
            stack.enter_context(_tells_that_it_goes_on(file))
        tell = stack.enter_context(shown(progress, "library"))
        processes = 1 if cluster else workers or os.cpu_count() or 1
        libraries.build_library(
            robot, states, seed, processes, file, tell, sampling, record_s, cluster, keep_others=True
        )
        return replace(libraries.read_library(file), folder=robot.folder)


@contextmanager
def _tells_that_it_goes_on(out: Path) -> Iterator[None]:
    """Where a build is interrupted, say what is finished and how it goes on."""
    try:
        yield
    except KeyboardInterrupt:
        if libraries.checkpoint_folder(out).exists():
            tell_line(
                f"frogkick: finished parts are in {str(libraries.checkpoint_folder(out))!r}: "
                "the same command goes on from there"
            )
        raise


def load_library(file: Path | str) -> Library:
    """Read a library (HDF5) that ``Library.save`` or ``frogkick library build`` wrote.

    Raises:
        InputError: missing, not whole, or no library.
    """
    return libraries.read_library(file)


def fit_table(
    library: Library | Path | str,
    kind: str | None = None,
    budget_kib: float | None = None,
    *,
    progress: Progress = False,
) -> Table:
    """Make the robot's table of a library.

    Args:
        library: of ``build_library``, or its file.
        kind: "nearest" (the paper's: one row for each state), "affine" (fewer states, a local linear
            correction, how much limbs were used lately); None: nearest with all states, or with a budget the
            one that errs less.
        budget_kib: the most KiB of the image; None: 64 for affine, as many as it takes for nearest.
        progress: True for a bar, or a function of (done, all).

    Raises:
        InputError: an unknown kind, too few states, or a budget that holds no state.
    """
    if not isinstance(library, Library):
        library = load_library(library)
    if budget_kib is None and kind in (None, "nearest"):
        image = libraries.quantise(library)
    else:
        if budget_kib is not None and not 0.5 <= budget_kib <= 16384:
            raise InputError(f"budget is {budget_kib:g} KiB: give 0.5 to 16384")
        budget = None if budget_kib is None else int(budget_kib * KIB)
        with shown(progress, "tables tried") as tell:
            image = libraries.fit_table(library, kind, budget, tell).image
    robot = library.robot()
    return Table(called_by(robot, open_image(image)), robot)
