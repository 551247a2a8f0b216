"""Tools that are not wheels: found, or the test is skipped with one clear line."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from frogkick.robot import load_robot
from frogkick_codegen.emit import emit
from frogkick_codegen.firmware import robot_config
from frogkick_codegen.toolchain import Compiler, other, zig

TIMEOUT_S = 300.0


def program(name: str, package: str) -> str:
    """Return a program's path, or skip."""
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed (Debian: apt-get install {package})")
    return path


def compiler(name: str, package: str) -> Compiler:
    """Return a compiler of this machine, or skip."""
    found = other(name)
    if found is None:
        pytest.skip(f"{name} is not installed (Debian: apt-get install {package})")
    return found


def chip_compiler(name: str) -> tuple[Compiler, list[str]]:
    """Return a compiler for the Cortex-M4 and what its link line needs at the end, or skip.

    Args:
        name: "zig" or "arm-none-eabi-gcc".
    """
    if name == "zig":
        return zig("chip"), []
    # zig brings its own 64-bit division and the like; gcc has them in libgcc.
    return compiler(name, "gcc-arm-none-eabi"), ["-lgcc"]


def emitted_firmware(image: bytes, folder: Path) -> tuple[Path, Path]:
    """Emit a table and write the robot's limits.

    Returns:
        The emitted directory and the directory of fk_robot_config.h.
    """
    emitted, config = folder / "emitted", folder / "config"
    emit(image, emitted, "frogkick codegen made_up.fkt --out emitted")
    config.mkdir()
    (config / "fk_robot_config.h").write_text(robot_config(load_robot("frog2022")))
    return emitted, config


def run(command: list[str | Path], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, whatever its exit code; over 300 s is a failure."""
    return subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
        stdin=subprocess.DEVNULL,
    )
