"""C code and firmware of a table: generate, build, test on the virtual chip, and flash them."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frogkick.core.errors import InputError
from frogkick.core.extras import require
from frogkick.core.files import existing_file
from frogkick.core.progress import Progress, shown
from frogkick.front.places import built_firmware
from frogkick.front.tables import Table, load_table
from frogkick.robot import Robot
from frogkick.tables.image import read_image
from frogkick_codegen.emit import emit
from frogkick_codegen.firmware import FLASH_BYTES, RAM_BYTES, Firmware, build, require_tools
from frogkick_codegen.probe import check_image, flash

if TYPE_CHECKING:
    from frogkick.runs.chip_check import ChipReport

__all__ = ["Firmware", "build_firmware", "emit_c", "flash_firmware", "try_firmware"]


def build_firmware(
    table: Table | Path | str, target: str = "bench", out: Path | str | None = None
) -> Firmware:
    """Build the firmware around a table.

    Args:
        table: the robot's table or its file. The image also holds the robot's guard limits and planner.
        target: "bench" (bare metal, nRF52832) or "native" (the same core as a library for this computer).
        out: folder for the files; None: a temporary one, which is deleted with the object.

    Raises:
        InputError: an unknown target, invalid limits of the guard, or an image that does not fit.
        ToolchainError: no compiler here; the text says what to install.
    """
    table = load_table(table)
    place = Path(tempfile.mkdtemp(prefix="frogkick-firmware-")) if out is None else Path(out)
    with table.file() as image:
        made = build(target, image, table.robot, place)
    if out is None:
        weakref.finalize(made, shutil.rmtree, place, ignore_errors=True)
    return made


def emit_c(
    table: Table | Path | str, out: Path | str, *, measure: bool = False, progress: Progress = False
) -> dict[str, str]:
    """Write table and planner as C99 into a folder, with an example and a README.

    Args:
        table: the table or its file.
        out: the folder to make; a folder that was generated before is replaced, any other is refused.
        measure: build for the chip and run on the virtual chip, for sizes and times in the README.
        progress: of measuring: True for a bar, or a function of (done, all).

    Returns:
        File name -> SHA-256 of its content, hexadecimal.

    Raises:
        InputError: the folder holds something else, or cannot be written.
        TableError: the file is not a valid table image.
    """
    image = table.image if isinstance(table, Table) else read_image(table).image
    name = table.name if isinstance(table, Table) else Path(table).name
    figures = None
    if measure:
        from frogkick.front.emitted import measure as measured

        with tempfile.TemporaryDirectory(prefix="frogkick-table-") as folder:
            file = Path(folder) / name
            file.write_bytes(image)
            with shown(progress, "measuring") as tell:
                figures = measured(file, progress=tell)
    return emit(image, out, f"frogkick codegen {name} --out {Path(out).name}", figures=figures)


@dataclass(frozen=True, eq=False, repr=False)
class FirmwareTrial:
    """The test of a bench image on the virtual chip: every command, stroke and limit.

    Attributes:
        build: sizes of the image; its files are deleted.
        report: the checks, the planning times, the measured stack and its bound.
    """

    build: Firmware
    report: ChipReport

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return self.report.passed

    def sizes(self) -> dict[str, Any]:
        """The keys of the command ``firmware size``: bytes, and shares of the chip's memory."""
        return {
            "flash_bytes": self.build.flash_bytes,
            "flash_of_chip": round(self.build.flash_bytes / FLASH_BYTES, 4),
            "ram_bytes": self.build.ram_bytes,
            "ram_of_chip": round(self.build.ram_bytes / RAM_BYTES, 4),
            "stack_bytes": self.report.stack_bytes,
            "stack_bound_bytes": self.report.stack_bound_bytes,
            "stack_bound_chain": list(self.report.stack_chain),
            "stack_reserved_bytes": self.build.stack_bytes,
        }

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``firmware test``."""
        report = self.report
        return {
            "passed": report.passed,
            "checks": {name: "ok" if ok else "FAILED" for name, ok in report.checks.items()},
            "plan_ms": report.plan_ms,
            "plan_cycles": report.plan_cycles,
            "flash_bytes": self.build.flash_bytes,
            "ram_bytes": self.build.ram_bytes,
            "stack_bytes": report.stack_bytes,
            "stack_bound_bytes": report.stack_bound_bytes,
        }

    def __repr__(self) -> str:
        held = sum(self.report.checks.values())
        return (
            f"FirmwareTrial({held} of {len(self.report.checks)} checks held, "
            f"flash {self.build.flash_bytes} bytes, stack {self.report.stack_bytes} bytes)"
        )


def try_firmware(
    table: Table | Path | str | None = None, robot: Robot | str | None = None, progress: Progress = False
) -> FirmwareTrial:
    """Build the bench image around a table and test it on the virtual chip.

    Args:
        table: the robot's table or its file; None: the robot's default table.
        robot: the robot, its name or its TOML file; None: the table's own.
        progress: of the checks: True for a bar, or a function of (done, all).

    Raises:
        InputError: the table is for another robot, or the firmware's sources are not installed.
        ToolchainError: no compiler here; the text says what to install.
        LinkError: the image does not answer.
        ChipError: the image does what the chip does not allow.
    """
    require_tools("bench")
    from frogkick.runs.chip_check import check_on_chip  # it cannot be loaded without the extra

    used = load_table(table, robot)
    with ExitStack() as stack:
        image = stack.enter_context(used.file())
        built = stack.enter_context(built_firmware("bench", image, used.robot))
        tell = stack.enter_context(shown(progress, "virtual chip"))
        return FirmwareTrial(built, check_on_chip(built.image, used.tables, used.robot, tell))


@dataclass(frozen=True)
class Flashed:
    """The result of flashing an image.

    Attributes:
        probe: name of the debug probe.
        bytes: size of the image.
    """

    probe: str
    bytes: int


def flash_firmware(
    image: Path | None = None,
    *,
    table: Table | Path | str | None = None,
    robot: Robot | str | None = None,
    probe: str | None = None,
    progress: Progress = False,
) -> Flashed:
    """Flash the bench image into a development kit through its debug probe.

    Args:
        image: Intel HEX, ``bench.hex`` of a build; None: built around ``table``.
        table, robot: as for ``try_firmware``.
        probe: serial number of the debug probe, if several are plugged in.
        progress: True for a bar, or a function of (done, all).

    Raises:
        InputError: both an image and a table, an invalid image, or one that does not fit.
        ProbeError: no probe is found, or it does not answer.
    """
    if image is not None and table is not None:
        raise InputError("give either --image or --tables, not both: an image already contains its table")
    require("flashing", "pyocd")
    if image is None:
        require_tools("bench")
    with ExitStack() as stack:
        if image is None:
            used = load_table(table, robot)
            file = stack.enter_context(used.file())
            image = stack.enter_context(built_firmware("bench", file, used.robot)).files["hex"]
        length = check_image(existing_file(image, "image"))
        tell = stack.enter_context(shown(progress, "flash"))
        return Flashed(flash(image, probe, tell), length)
