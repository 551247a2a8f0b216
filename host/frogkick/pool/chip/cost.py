"""Cycles of each instruction on the Cortex-M4 with FPU, as a table over the flash.

Source: Arm, Cortex-M4 Technical Reference Manual r0p1, tables 3-1 and 7-1. Where it gives a range, the upper
end is taken, so that times on the chip are rather too long than too short. Not modelled: the overlap of
neighbouring loads and stores, early termination of a division, folded IT. An instruction that is skipped by
its condition in an IT block costs one cycle.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any, Final

import capstone
from capstone import arm

from frogkick.pool.chip.bus import FLASH_BYTES
from frogkick.pool.chip.errors import ChipError
from frogkick.pool.chip.hook import Flag

PARTS: Final = 256
"""Time is counted in 1/256 of a cycle, so that average wait states stay integers."""


@dataclass(frozen=True)
class CostModel:
    """What an instruction costs beyond its own cycles; all adjustable, all integers.

    Attributes:
        branch_refill_cycles: where the next instruction is not the next in memory. The manual says 1 to 3.
        fetch_wait_cached_parts: average per instruction with the cache on, in 1/256 cycle: 4 is what lies
            between the 3.36 CoreMark/MHz of the nRF52832 product specification (flash, cache on) and Arm's
            3.40.
        fetch_wait_uncached_parts: the same with the cache off. An assumption: two wait states for each word
            of two instructions.
        flash_data_wait_cycles: each read of data from flash; the cache holds instructions only. Upper end of
            the product specification's 0 to 2 wait states.
    """

    branch_refill_cycles: int = 3
    fetch_wait_cached_parts: int = 4
    fetch_wait_uncached_parts: int = 256
    flash_data_wait_cycles: int = 2


_MULTIPLE: Final = ("ldm", "stm", "push", "pop", "vldm", "vstm", "vpush", "vpop")
_FIXED: Final = {
    "udiv": 12,
    "sdiv": 12,
    "mla": 2,
    "mls": 2,
    "vdiv": 14,
    "vsqrt": 14,
    "vmla": 3,
    "vmls": 3,
    "vnmla": 3,
    "vnmls": 3,
    "vfma": 3,
    "vfms": 3,
    "vfnma": 3,
    "vfnms": 3,
    "tbb": 2,
    "tbh": 2,
    "dsb": 4,
    "dmb": 4,
    "isb": 4,
}
_DOUBLE: Final = ("ldrd", "strd")
_LOAD_STORE: Final = ("ldr", "str", "vldr", "vstr", "ldrex", "strex")


def _stem(name: str) -> str:
    """Mnemonic without data type and width: ``vdiv.f32`` -> ``vdiv``, ``ldr.w`` -> ``ldr``."""
    return name.split(".")[0]


def _words(instruction: Any) -> int:
    """Registers of a transfer of several, a double float register counting twice."""
    count = 0
    for operand in instruction.operands:
        if operand.type == arm.ARM_OP_REG:
            count += 2 if arm.ARM_REG_D0 <= operand.reg <= arm.ARM_REG_D31 else 1
    return count


def cycles_and_flags(instruction: Any) -> tuple[int, Flag]:
    """Cost of one capstone instruction (with details), without refill and wait states."""
    name = _stem(instruction.mnemonic)
    flags = Flag.KNOWN
    if name.startswith("v"):
        flags |= Flag.FPU
    if name == "wfe":
        return 1, flags | Flag.WFE
    if name == "wfi":
        return 1, flags | Flag.WFI
    multiple = next((stem for stem in _MULTIPLE if name.startswith(stem)), None)
    if multiple is not None:
        # ldm, stm, vldm, vstm have their base register among the operands, push and pop have none: 1 + N.
        base = 0 if multiple.endswith(("push", "pop")) else 1
        return 1 + _words(instruction) - base, flags | Flag.ALIGNED
    if name.startswith(_DOUBLE):
        return 3, flags | Flag.ALIGNED
    if name.startswith(_LOAD_STORE):
        if not name.startswith("v"):
            return 2, flags | (Flag.ALIGNED if "ex" in name else Flag(0))
        return 1 + _words(instruction), flags | Flag.ALIGNED
    for stem, cycles in _FIXED.items():
        # A condition may follow the stem ("vdivne"), but vmla must not catch "mla".
        if name.startswith(stem) and len(name) - len(stem) in (0, 2):
            return cycles, flags
    if name == "vmov" and len(instruction.operands) > 2:
        return 2, flags
    return 1, flags


class CostTable:
    """Entries for the hook, decoded when the core first comes by.

    Decoding follows the core and not the section, so literal pools and jump tables between the functions are
    never taken for code.
    """

    def __init__(self, flash: bytes) -> None:
        """``flash``: the whole flash, as loaded."""
        self._flash = flash
        self.entries = (ctypes.c_uint16 * (FLASH_BYTES // 2))()
        self._capstone = capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)
        self._capstone.detail = True

    def decode_from(self, address: int) -> None:
        """Fill entries from here to the next branch, or to one that is known.

        Raises:
            ChipError: there is no instruction at ``address``.
        """
        in_it = it_place = 0
        first = address
        # 64 instructions of at most 4 bytes: longer runs are continued when the core gets there.
        for instruction in self._capstone.disasm(self._flash[address : address + 256], address, 64):
            place = instruction.address // 2
            cycles, flags = cycles_and_flags(instruction)
            if in_it:
                flags |= Flag.IN_IT
                in_it -= 1
            elif self.entries[place]:
                return
            if instruction.id == arm.ARM_INS_IT:
                in_it, it_place = len(_stem(instruction.mnemonic)) - 1, place
            self.entries[place] = cycles * 256 | flags
            address = instruction.address + instruction.size
            if not in_it and instruction.group(capstone.CS_GRP_JUMP):
                return
        if in_it:
            # Cut off inside an IT block, where the core must not be stopped: the next run begins with the IT.
            for place in range(it_place, address // 2):
                self.entries[place] = 0
        if address == first:
            raise ChipError(
                f"no instruction of the Cortex-M4 at 0x{address:08x} "
                f"(bytes {self._flash[address : address + 4].hex()}): the firmware ran into data, or is "
                "for another core"
            )
