"""C and firmware of a table."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from frogkick.front.tables import Table
from frogkick.planner.image import read_image
from frogkick.progress import Progress, shown
from frogkick_codegen.emit import emit
from frogkick_codegen.firmware import Build, build


@dataclass(frozen=True, eq=False, repr=False)
class Firmware:
    """A built image.

    Attributes:
        build: its files and their sizes.
    """

    build: Build

    @property
    def flash_bytes(self) -> int:
        """Of the chip's flash; 0 for the target "native"."""
        return self.build.flash_bytes

    @property
    def ram_bytes(self) -> int:
        """Of the chip's RAM, with the stack; 0 for the target "native"."""
        return self.build.ram_bytes

    @property
    def stack_bytes(self) -> int:
        """Reserved for the stack; 0 for the target "native"."""
        return self.build.stack_bytes

    @property
    def files(self) -> dict[str, Path]:
        """By what they are: elf, hex and map, or library. Without ``out`` they go with this object."""
        return self.build.files

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``firmware build``."""
        return self.build.as_json()

    def __repr__(self) -> str:
        return f"Firmware({self.build.target}, flash {self.flash_bytes} bytes, RAM {self.ram_bytes} bytes)"


def build_firmware(table: Table, target: str = "bench", out: Path | str | None = None) -> Firmware:
    """Build the firmware around a table.

    Args:
        table: of the robot; its guard's limits and planner's settings go into the image, too.
        target: "bench" (bare metal, nRF52832) or "native" (the same core as a library for this computer).
        out: folder for the files; None: a temporary one that lives as long as the object.

    Raises:
        InputError: an unknown target, a guard whose limits are none, or an image that does not fit.
        ToolchainError: no compiler here; the text says what to install.
    """
    place = Path(tempfile.mkdtemp(prefix="frogkick-firmware-")) if out is None else Path(out)
    with table.file() as image:
        made = Firmware(build(target, image, table.robot, place))
    if out is None:
        weakref.finalize(made, shutil.rmtree, place, ignore_errors=True)
    return made


def emit_c(
    table: Table | Path | str, out: Path | str, *, measure: bool = False, progress: Progress = False
) -> dict[str, str]:
    """Write table and planner as C99 into a folder, with an example and a README.

    Args:
        table: to emit, or its file.
        out: the folder to make; one that was emitted before is replaced, any other is refused.
        measure: build for the chip and run on the virtual one, for sizes and times in the README.
        progress: of measuring: True for a bar, or a function of (done, all).

    Returns:
        File name -> SHA-256 of its content, hexadecimal.

    Raises:
        InputError: the folder is another's, or cannot be written.
        TableError: the file is no usable table image.
    """
    image = table.image if isinstance(table, Table) else read_image(table).image
    name = table.name if isinstance(table, Table) else Path(table).name
    figures = None
    if measure:
        from frogkick.study.emitted import measure as measured

        with tempfile.TemporaryDirectory(prefix="frogkick-table-") as folder:
            file = Path(folder) / name
            file.write_bytes(image)
            with shown(progress, "measuring") as tell:
                figures = measured(file, progress=tell)
    return emit(image, out, f"frogkick codegen {name} --out {Path(out).name}", figures=figures)
