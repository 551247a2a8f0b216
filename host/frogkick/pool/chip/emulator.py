"""The emulated core: unicorn's Cortex-M4 with the chip's memory and our callbacks.

What cannot be done is a ``ChipError``.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from unicorn import arm_const
from unicorn.unicorn_py3.unicorn import uclib

from frogkick.core.interrupts import ctrl_c_comes_after
from frogkick.pool.chip.bus import FLASH_BYTES, RAM_BASE, RAM_BYTES, ChipError
from frogkick.pool.chip.hook import HookState, Stop, load_hook, unicorn
from frogkick.pool.chip.image import FirmwareImage

if TYPE_CHECKING:
    from frogkick.pool.chip.chip import VirtualChip

PAGE: Final = 0x1000
RETURN_ADDRESS: Final = FLASH_BYTES - 16
"""Where a call from outside returns to: erased flash, which no program runs."""
_ACCESS: Final = unicorn.UC_HOOK_MEM_READ | unicorn.UC_HOOK_MEM_WRITE
_UNINITIALISED: Final = b"\xcd"  # RAM after power-on: what .data and .bss do not set is not zero


def _bare_core(flash: bytes, ram: bytes) -> Any:
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
    uc = _bare_core(image.flash, _UNINITIALISED * RAM_BYTES)

    def read(_uc: Any, offset: int, size: int, base: int) -> int:
        return access(base, offset, size)

    def write(_uc: Any, offset: int, size: int, value: int, base: int) -> None:
        access(base, offset, size, value)

    for base in pages:
        uc.mmio_map(base, PAGE, read, base, write, base)
    uc.hook_add(unicorn.UC_HOOK_MEM_INVALID, on_invalid)
    uc.reg_write(arm_const.UC_ARM_REG_SP, image.stack_pointer)
    _add_hooks(uc, state, {unicorn.UC_HOOK_CODE: "fk_hook_code", _ACCESS: "fk_hook_memory"})
    return uc


def _add_hooks(uc: Any, state: HookState, functions: Mapping[int, str]) -> None:
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


_LONGEST: Final = 2_000_000_000
"""Instructions of a call that does not end."""


class UncountedCalls:
    """Calls functions of a booted firmware, in a copy of its memory, with an empty stack.

    The instructions are the same, but nothing is counted or watched, which takes nine tenths of a virtual
    chip's time: for functions of which only the bits matter, and that touch nothing but flash and RAM.
    """

    def __init__(self, chip: VirtualChip) -> None:
        """Copy a chip that is booted and asleep; it is left alone from here on."""
        self._symbol = chip.symbol
        self._stack_top = chip.symbol("fk_stack_top")
        self._uc = _bare_core(chip.flash.content(), chip.ram_read(RAM_BASE, RAM_BYTES))
        # unicorn's own limit of instructions is a call for each of them, half of the time that all takes.
        self._state = HookState()
        _add_hooks(self._uc, self._state, {unicorn.UC_HOOK_BLOCK: "fk_hook_block"})

    def ram_write(self, address: int, data: bytes) -> None:
        """Write to the copy's RAM."""
        self._uc.mem_write(address, data)

    def ram_read(self, address: int, count: int) -> bytes:
        """Read the copy's RAM."""
        return bytes(self._uc.mem_read(address, count))

    @ctrl_c_comes_after()
    def call(self, function: str, *arguments: int | float) -> int:
        """Call a function: see ``VirtualChip.call``. Returns register r0."""
        self._uc.reg_write(arm_const.UC_ARM_REG_SP, self._stack_top)
        set_arguments(self._uc, arguments, RETURN_ADDRESS)
        self._state.instructions, self._state.limit, self._state.stop = 0, _LONGEST, Stop.NONE
        try:
            self._uc.emu_start(self._symbol(function) | 1, RETURN_ADDRESS)
        except unicorn.UcError as error:
            raise ChipError(f"{function} failed at 0x{self._pc:08x}: {error}") from error
        if self._pc != RETURN_ADDRESS:
            raise ChipError(f"{function} has not returned after {_LONGEST} instructions, at 0x{self._pc:08x}")
        return int(self._uc.reg_read(arm_const.UC_ARM_REG_R0))

    @property
    def _pc(self) -> int:
        return int(self._uc.reg_read(arm_const.UC_ARM_REG_PC))
