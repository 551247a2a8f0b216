"""Builds small firmwares from the bench's drivers, as firmware/bench/README.md says."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from frogkick.core.files import cache_folder

BENCH = Path(__file__).resolve().parents[2] / "firmware" / "bench"
CORE = BENCH.parent / "core"
DRIVERS = ("clock.c", "pulse.c", "sleep.c", "startup.c", "time.c", "uart.c", "watchdog.c")
WARNINGS = (
    "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wmissing-prototypes", "-Werror",
)  # fmt: skip
CODE = (
    "-O2", "-std=c99", "-ffreestanding", "-ffp-contract=off", "-fno-math-errno",
    "-fno-unwind-tables", "-fno-asynchronous-unwind-tables", "-ffunction-sections", "-fdata-sections",
)  # fmt: skip
LINK = ("-nostdlib", "-Wl,--entry=fk_reset", "-Wl,--gc-sections", f"-Wl,-T,{BENCH / 'nrf52832.ld'}")
ZIG = (
    sys.executable, "-m", "ziglang", "cc",
    "-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4+vfp4d16sp",
)  # fmt: skip
GCC = ("arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")


def build(
    sources: Sequence[Path], elf: Path, *options: str, drivers: bool = True, compiler: Sequence[str] = ZIG
) -> Path:
    """Compile and link; return the ELF. A warning or error fails with the compiler's own words."""
    files = [str(source) for source in sources] + [str(BENCH / name) for name in DRIVERS if drivers]
    command = [
        *compiler,
        *CODE,
        *WARNINGS,
        f"-I{BENCH}",
        f"-I{CORE}",
        *options,
        *LINK,
        "-o",
        str(elf),
        *files,
    ]
    cache = str(cache_folder("zig"))
    environment = {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache, **os.environ}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr, done.stderr
    return elf


def build_text(source: str, folder: Path, *options: str, drivers: bool = False) -> Path:
    """Build a firmware from a few lines of C."""
    file = folder / "program.c"
    file.write_text(source)
    return build([file], folder / "program.elf", *options, drivers=drivers)
