"""The C callback that counts cycles: compiled once by the zig wheel, kept in the user's cache folder.

Where it does not compile or load: ``ChipError``.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import subprocess
import sys
import tempfile
from enum import IntEnum, IntFlag
from functools import cache
from pathlib import Path
from typing import Any, Final

import unicorn as unicorn_module

from frogkick.core.extras import install_command
from frogkick.core.files import cache_folder
from frogkick.pool.chip.bus import ChipError

unicorn: Any = unicorn_module  # its type hints do not export what it documents
_SOURCE: Final = Path(__file__).with_name("hook.c")
# baseline: zig would build for exactly this processor, and a cache folder may be shared with another.
_FLAGS: Final = ("-mcpu=baseline", "-O2", "-shared", "-fPIC", "-std=c99", "-Wall", "-Wextra", "-Werror")

CACHE_WORDS: Final = 64 * 2
"""Sets times ways of the instruction cache, as in hook.c."""
Stop = IntEnum("Stop", "NONE LIMIT WFE WFI FPU UNKNOWN UNALIGNED RETURN", start=0)
"""Why the callback stopped the core; the same order as in hook.c."""
Flag = IntFlag("Flag", "KNOWN WFE WFI FPU IN_IT ALIGNED RETURN")
"""Bits of a table entry's low byte; the same order as in hook.c."""


class HookState(ctypes.Structure):
    """``fk_hook_state_t`` of hook.c, which says what each field is."""

    _fields_ = [
        *((name, ctypes.c_uint64) for name in ("time", "limit", "instructions")),
        *((name, ctypes.c_uint32) for name in ("address", "expected", "entry", "stop", "fpu_enabled")),
        *((name, ctypes.c_uint32) for name in ("fetch_wait", "miss_wait", "line", "misses", "data_wait")),
        *((name, ctypes.c_uint32) for name in ("refill", "flash_bytes", "unaligned", "late")),
        *((name, ctypes.c_void_p) for name in ("table", "cache", "profile", "visits")),
        ("counted", ctypes.c_uint64),
        *((name, ctypes.c_void_p) for name in ("emu_stop", "reg_read", "reg_write")),
        ("cpsr", ctypes.c_int32),
    ]


@cache
def load_hook() -> ctypes.CDLL:
    """Compile hook.c where its cache does not hold it yet, and load it."""
    digest = hashlib.sha256(" ".join((*_FLAGS, sys.platform)).encode() + _SOURCE.read_bytes()).hexdigest()
    library = cache_folder("chip") / f"hook-{digest[:24]}.so"
    if not library.exists():
        _compile(library)
    try:
        return ctypes.CDLL(str(library))
    except OSError as error:
        raise ChipError(
            f"the virtual chip's hook does not load ({error}): remove {str(library)!r}"
        ) from error


def _compile(library: Path) -> None:
    """Compile into a folder beside the target and rename: two processes may do this at the same time."""
    try:
        with tempfile.TemporaryDirectory(dir=library.parent) as folder:
            built = Path(folder) / "hook.so"
            command = [sys.executable, "-m", "ziglang", "cc", *_FLAGS, "-o", str(built), str(_SOURCE)]
            zig_cache = str(cache_folder("zig"))  # where its run-time library is compiled already
            environment = {"ZIG_GLOBAL_CACHE_DIR": zig_cache, "ZIG_LOCAL_CACHE_DIR": zig_cache, **os.environ}
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                raise ChipError(
                    f"the virtual chip's hook.c does not compile: {done.stderr.strip()[-400:]}; "
                    f"install again what compiles it: {install_command('ziglang')}"
                )
            os.replace(built, library)
    except OSError as error:
        raise ChipError(
            f"cannot keep the virtual chip's hook in {str(library.parent)!r}: {error.strerror}; "
            "set FROGKICK_CACHE_DIR to a folder that can be written"
        ) from error
