"""Functions of a firmware on the emulated core alone: the same instructions, nothing counted or watched."""

from __future__ import annotations

from typing import Final

from unicorn import arm_const

from frogkick.core.interrupts import ctrl_c_comes_after
from frogkick.pool.chip.bus import RAM_BASE, RAM_BYTES, ChipError
from frogkick.pool.chip.chip import VirtualChip
from frogkick.pool.chip.emulator import (
    RETURN_ADDRESS,
    HookState,
    Stop,
    add_hooks,
    bare_core,
    set_arguments,
    unicorn,
)

_LONGEST: Final = 2_000_000_000
"""A call that takes more instructions is taken for one that never ends."""


class UncountedCalls:
    """Calls functions of a booted firmware, in a copy of its memory, with an empty stack.

    The instructions are the same, without counting cycles and watching accesses, which take nine tenths of a
    virtual chip's time. It suits functions of which only the results matter, and that use only flash and RAM.
    """

    def __init__(self, chip: VirtualChip) -> None:
        """Copy a chip that is booted and asleep; it is left alone from here on."""
        self._symbol = chip.symbol
        self._stack_top = chip.symbol("fk_stack_top")
        self._uc = bare_core(chip.flash.content(), chip.ram_read(RAM_BASE, RAM_BYTES))
        # unicorn's own limit of instructions is a call for each of them, half of the time that all takes.
        self._state = HookState()
        add_hooks(self._uc, self._state, {unicorn.UC_HOOK_BLOCK: "fk_hook_block"})

    def ram_write(self, address: int, data: bytes) -> None:
        self._uc.mem_write(address, data)

    def ram_read(self, address: int, count: int) -> bytes:
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
