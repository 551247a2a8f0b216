"""The emulated core: unicorn's Cortex-M4 with the chip's memory and our callbacks.

What cannot be done is a ``ChipError``.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

from unicorn import arm_const
from unicorn.unicorn_py3.unicorn import uclib

from frogkick.pool.chip.bus import FLASH_BYTES, RAM_BASE, RAM_BYTES, ChipError
from frogkick.pool.chip.hook import HookState, load_hook, unicorn
from frogkick.pool.chip.image import FirmwareImage

PAGE: Final = 0x1000
RETURN_ADDRESS: Final = FLASH_BYTES - 16
"""Where a call from outside returns to: erased flash, which no program runs."""
_ACCESS: Final = unicorn.UC_HOOK_MEM_READ | unicorn.UC_HOOK_MEM_WRITE
_UNINITIALISED: Final = b"\xcd"  # RAM after power-on: what .data and .bss do not set is not zero


def bare_core(flash: bytes, ram: bytes) -> Any:
    """A core with the chip's memory and no registers."""
    uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    uc.ctl_set_cpu_model(arm_const.UC_CPU_ARM_CORTEX_M4)
    uc.mem_map(0, FLASH_BYTES, unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC)
    uc.mem_map(RAM_BASE, RAM_BYTES, unicorn.UC_PROT_READ | unicorn.UC_PROT_WRITE)
    uc.mem_write(0, flash)
    uc.mem_write(RAM_BASE, ram)
    return uc


def make_core(
    image: FirmwareImage,
    pages: Iterable[int],
    access: Callable[..., int],
    on_invalid: Callable[..., bool],
    state: HookState,
) -> Any:
    """Return a core with the image in flash, at reset.

    Args:
        pages: base address of each page of registers.
        access: reads or writes a register, by (base, offset, size) or (base, offset, size, value).
        on_invalid: hears of accesses to where nothing is.
        state: what the callbacks of hook.c work on; gets unicorn's functions.
    """
    uc = bare_core(image.flash, _UNINITIALISED * RAM_BYTES)

    def read(_uc: Any, offset: int, size: int, base: int) -> int:
        return access(base, offset, size)

    def write(_uc: Any, offset: int, size: int, value: int, base: int) -> None:
        access(base, offset, size, value)

    for base in pages:
        uc.mmio_map(base, PAGE, read, base, write, base)
    uc.hook_add(unicorn.UC_HOOK_MEM_INVALID, on_invalid)
    uc.reg_write(arm_const.UC_ARM_REG_SP, image.stack_pointer)
    add_hooks(uc, state, {unicorn.UC_HOOK_CODE: "fk_hook_code", _ACCESS: "fk_hook_memory"})
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
