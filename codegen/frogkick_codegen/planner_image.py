"""The planner of an emitted directory alone, built for the chip: what a host calls to measure it."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from frogkick_codegen.emit import SOURCES
from frogkick_codegen.sources import firmware_sources
from frogkick_codegen.toolchain import FLAGS, STANDARD, zig

_BARE = (
    "-ffreestanding", "-ffunction-sections", "-fdata-sections",
    "-fno-unwind-tables", "-fno-asynchronous-unwind-tables",
)  # fmt: skip
NOT_PLANNER = ("main", "fk_reset", "fk_fault", "fk_clock_init", "memcpy", "memset", "vectors")
"""What such an image holds besides planner and table."""


def compiler_name() -> tuple[str, str]:
    """Return who compiles it, with the version, and the flags that size and speed depend on."""
    return f"{zig('chip').version} cc", STANDARD[-1]


def build_planner(emitted: Path, elf: Path) -> Path:
    """Build the planner of an emitted directory for the chip.

    Args:
        emitted: what ``emit`` wrote.
        elf: where the image goes.

    Raises:
        InputError: the chip's start-up code is not installed.
        ToolchainError: no compiler, or a refused source.
    """
    bench = firmware_sources() / "bench"
    main = resources.files("frogkick_codegen") / "templates" / "measure_main.c"
    with resources.as_file(main) as file:
        zig("chip").run(
            [
                *FLAGS, *_BARE, f"-I{emitted}", f"-I{bench}",
                "-nostdlib", "-Wl,--entry=fk_reset", f"-Wl,-T,{bench / 'nrf52832.ld'}", "-Wl,--gc-sections",
                *(emitted / name for name in SOURCES), bench / "startup.c", bench / "clock.c",
                file, "-o", elf,
            ],
            folder=elf.parent,
        )  # fmt: skip
    return elf
