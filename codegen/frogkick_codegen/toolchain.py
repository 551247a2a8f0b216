"""C compilers: the one that came as a wheel (zig), others where a machine has them; and what they need.

The sources of the firmware are inside this package where a wheel was installed, beside it in a clone. What a
compiler made of the same files before is kept in the user's cache folder.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from frogkick.core.errors import FrogkickError, InputError, nearest_name, require
from frogkick.core.files import cache_folder, write_bytes

STANDARD = ("-std=c99", "-O2")
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wmissing-prototypes", "-Werror")
FLOAT_RULES = ("-ffp-contract=off", "-fno-math-errno")
"""Every operation rounds to float32 once, and a square root is the machine's own instruction."""
FLAGS = (*STANDARD, *WARNINGS, *FLOAT_RULES)

ZIG_CHIP = ("-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4+vfp4d16sp")
ZIG_HOST = ("-mcpu=baseline",)
"""zig would build for exactly this machine's processor, and a cached library may meet another one."""
GCC_CHIP = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffreestanding")

_OTHERS = {"gcc": (), "clang": (), "arm-none-eabi-gcc": GCC_CHIP}
_TIMEOUT_S = 300.0
_LINES_SHOWN = 6


class ToolchainError(FrogkickError):
    """A compiler is missing, or refused the source."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler driver."""

    name: str  # "zig", "gcc", "clang" or "arm-none-eabi-gcc"
    command: tuple[str, ...]  # how to call it
    target_flags: tuple[str, ...]  # flags that choose the machine it builds for
    version: str  # its first version line

    def run(self, arguments: Sequence[str | Path], folder: Path | None = None) -> None:
        """Call the compiler with these arguments, after the target's flags, in a working directory.

        ToolchainError, with its first lines, where it failed or ran over 300 s.
        """
        command = [*self.command, *self.target_flags, *(str(argument) for argument in arguments)]
        result = _run(self.name, command, folder)
        if result.returncode != 0:
            text = (result.stderr or result.stdout).strip().splitlines()
            more = f"\n... {len(text) - _LINES_SHOWN} more lines" if len(text) > _LINES_SHOWN else ""
            raise ToolchainError(
                f"{self.name} failed with exit code {result.returncode}, correct what it names:\n"
                + "\n".join(text[:_LINES_SHOWN])
                + more
            )


def zig(target: str = "host") -> Compiler:
    """Return the compiler of the ziglang wheel for a target.

    Args:
        target: "host" for this machine, "chip" for the nRF52832 (Cortex-M4 with single-precision FPU).
    """
    targets = {"host": ZIG_HOST, "chip": ZIG_CHIP}
    if target not in targets:
        raise ToolchainError(f"target {target!r} is not one of host, chip{nearest_name(target, targets)}")
    require("the C compiler", "ziglang", error=ToolchainError)
    driver = (sys.executable, "-m", "ziglang")
    return Compiler("zig", (*driver, "cc"), targets[target], f"zig {_version_of_zig(driver)}")


def zig_folders() -> list[Path]:
    """Folders of the wheel with zig and its headers, which debug information must not name."""
    found = importlib.util.find_spec("ziglang")
    places = () if found is None else found.submodule_search_locations or ()
    return [Path(place).resolve() for place in places]


@cache
def _version_of_zig(driver: tuple[str, ...]) -> str:
    """Asked once in a process, which takes a tenth of a second."""
    return _run("zig", [*driver, "version"], None).stdout.strip()


def other(name: str) -> Compiler | None:
    """Return "gcc", "clang" or, for the chip, "arm-none-eabi-gcc", or None where this machine has none."""
    if name not in _OTHERS:
        raise ToolchainError(f"compiler {name!r} is not known{nearest_name(name, _OTHERS)}: use zig()")
    path = shutil.which(name)
    if path is None:
        return None
    lines = _run(name, [path, "--version"], None).stdout.strip().splitlines()
    return Compiler(name, (path,), _OTHERS[name], lines[0] if lines else name)


def _run(name: str, command: list[str], folder: Path | None) -> subprocess.CompletedProcess[str]:
    environment = dict(os.environ)
    if name == "zig":  # its caches would otherwise appear beside the sources
        cache = str(cache_folder("zig"))
        environment.setdefault("ZIG_GLOBAL_CACHE_DIR", cache)
        environment.setdefault("ZIG_LOCAL_CACHE_DIR", cache)
    try:
        return subprocess.run(
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise ToolchainError(
            f"{name} ran longer than {_TIMEOUT_S:.0f} s: try again on a quieter machine"
        ) from error
    except OSError as error:
        raise ToolchainError(f"{name} cannot be started ({error.strerror}): install it again") from error


KEPT_MAX = 64
"""Builds kept, some 350 KB each; the least recently used one is deleted first."""

_DIGEST_BYTES = 32


def built_once(
    compiler: Compiler,
    flags: Sequence[str],
    places: Sequence[str | Path],
    files: Iterable[Path],
    output: Path,
) -> bytes:
    """Compile, or return what this compiler made of the same flags and files before.

    Several processes may do so at once, because a whole file is renamed into place. A damaged file is
    ignored, and in a folder that cannot be written to nothing is kept.

    Args:
        compiler: called as ``flags places -o output`` in the folder of ``output``.
        flags: those that name no place.
        places: sources, folders of headers and such; where they are must not change a byte of the output.
        files: all that is read there, in the same order each time.
        output: what is made, where it must be.
    """
    digest = hashlib.sha256()
    for text in (compiler.name, compiler.version, *compiler.target_flags, *flags):
        digest.update(text.encode() + b"\0")
    for file in files:
        content = file.read_bytes()
        digest.update(file.name.encode() + b"\0" + len(content).to_bytes(8, "little") + content)
    kept = cache_folder("firmware") / digest.hexdigest()[:_DIGEST_BYTES]
    with suppress(OSError):
        stored = kept.read_bytes()
        if hashlib.sha256(stored[_DIGEST_BYTES:]).digest() == stored[:_DIGEST_BYTES]:
            os.utime(kept)
            return stored[_DIGEST_BYTES:]
    compiler.run([*flags, *places, "-o", output], folder=output.parent)
    made = output.read_bytes()
    with suppress(OSError, InputError):
        write_bytes(kept, hashlib.sha256(made).digest() + made)
        newest = sorted(kept.parent.iterdir(), key=lambda file: file.stat().st_mtime_ns, reverse=True)
        for file in newest[KEPT_MAX:]:
            file.unlink()
    return made


_PACKAGE = Path(__file__).resolve().parent
_PLACES = (_PACKAGE / "firmware_sources", _PACKAGE.parents[1] / "firmware")
_PARTS = ("core", "bench")


def firmware_sources() -> Path:
    """Return the folder that holds the core, the bench image's port and the Zephyr application."""
    for folder in _PLACES:
        if all((folder / part).is_dir() for part in _PARTS):
            return folder
    raise InputError("the firmware's C sources are not with the package that is installed: install it again")
