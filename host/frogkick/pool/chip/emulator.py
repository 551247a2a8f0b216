"""The emulated core: unicorn with the memory of the chip, and the C callbacks that count cycles (hook.c).

hook.c is compiled once by the zig wheel and kept in the user's cache folder. What cannot be done raises a
``ChipError``.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from enum import IntEnum, IntFlag
from functools import cache
from pathlib import Path
from typing import Any, Final

import unicorn as unicorn_module
from unicorn import arm_const
from unicorn.unicorn_py3.unicorn import uclib

from frogkick.core.errors import install_command
from frogkick.core.files import cache_folder
from frogkick.pool.chip.bus import FLASH_BYTES, RAM_BASE, RAM_BYTES, ChipError

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
    """Load the compiled hook.c, compiling it first if needed."""
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


PAGE: Final = 0x1000
RETURN_ADDRESS: Final = FLASH_BYTES - 16
"""Where a call from outside returns to: erased flash, which no program runs."""


def bare_core(flash: bytes, ram: bytes) -> Any:
    """A core with the chip's memory and no registers."""
    uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    uc.ctl_set_cpu_model(arm_const.UC_CPU_ARM_CORTEX_M4)
    uc.mem_map(0, FLASH_BYTES, unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC)
    uc.mem_map(RAM_BASE, RAM_BYTES, unicorn.UC_PROT_READ | unicorn.UC_PROT_WRITE)
    uc.mem_write(0, flash)
    uc.mem_write(RAM_BASE, ram)
    return uc


def add_hooks(uc: Any, state: HookState, functions: Mapping[int, str]) -> None:
    """Let a core call functions of hook.c, by unicorn's kinds of hooks; the state must live as long."""
    state.emu_stop = ctypes.cast(uclib.uc_emu_stop, ctypes.c_void_p)
    state.reg_read = ctypes.cast(uclib.uc_reg_read, ctypes.c_void_p)
    state.reg_write = ctypes.cast(uclib.uc_reg_write, ctypes.c_void_p)
    state.cpsr = arm_const.UC_ARM_REG_CPSR
    library = load_hook()
    for kind, name in functions.items():
        handle = ctypes.c_size_t()
        # The Python binding would put a Python function between; the C one is handed over as it is.
        error = uclib.uc_hook_add(
            uc._uch,
            ctypes.byref(handle),
            kind,
            ctypes.cast(getattr(library, name), ctypes.c_void_p),
            ctypes.byref(state),
            ctypes.c_uint64(0),
            ctypes.c_uint64(0xFFFF_FFFF),
        )
        if error != unicorn.UC_ERR_OK:
            raise ChipError(f"unicorn refuses {name} (error {error}): install unicorn 2.1")
    uc.ctl_flush_tb()  # code translated before a hook was added would not call it


def set_arguments(uc: Any, arguments: Sequence[int | float], return_address: int) -> None:
    """Lay out a call as AAPCS with float registers says: r0 to r3, s0 on, then the stack on 8 bytes."""
    words = [argument for argument in arguments if not isinstance(argument, float)]
    floats = [argument for argument in arguments if isinstance(argument, float)]
    pointer = uc.reg_read(arm_const.UC_ARM_REG_SP) - 4 * max(0, len(words) - 4) & ~7
    for place, word in enumerate(words):
        if place < 4:
            uc.reg_write(arm_const.UC_ARM_REG_R0 + place, word)
        else:
            uc.mem_write(pointer + 4 * (place - 4), word.to_bytes(4, "little"))
    for place, value in enumerate(floats):
        uc.reg_write(arm_const.UC_ARM_REG_S0 + place, struct.unpack("<I", struct.pack("<f", value))[0])
    uc.reg_write(arm_const.UC_ARM_REG_SP, pointer)
    uc.reg_write(arm_const.UC_ARM_REG_LR, return_address | 1)


def invalid_access(access: int, address: int, size: int) -> str:
    """Say what the hardware would have done at an access that unicorn refused."""
    if access == unicorn.UC_MEM_WRITE_PROT:
        return f"write of {size} bytes to flash at 0x{address:08x}: flash is written through NVMC only"
    if access in (unicorn.UC_MEM_FETCH_PROT, unicorn.UC_MEM_FETCH_UNMAPPED):
        return f"hard fault: execution at 0x{address:08x}, where there is no flash"
    verb = "write" if access == unicorn.UC_MEM_WRITE_UNMAPPED else "read"
    return f"bus fault: {verb} of {size} bytes at 0x{address:08x}, where the model has nothing"
