"""Cycles of each instruction on the Cortex-M4 with FPU, as a table over the flash, and a profile of them.

Source: Arm, Cortex-M4 Technical Reference Manual r0p1 (DDI 0439D), tables 3-1 and 7-1 and section 3.3.2;
Nordic, nRF52832 Product Specification, chapter CPU, wait states. Where they give a range, its upper end:

- a load takes 2 cycles, a store 2, or 1 with an immediate offset, n words 1 + n; a load or store right after
  a load takes one less, unless its address needs that load; it takes one more if the instruction before has
  computed its address, and if the address is relative to the program counter; an unaligned access counts as
  two or three, a cycle each;
- UDIV and SDIV take 12 of 2 to 12, VDIV and VSQRT 14, multiplications 1, with an addition 2 (VMLA 3), between
  core and float registers 2; a float result that the next instruction needs costs one more;
- wherever the next instruction is not the next in memory, 3 of 1 to 3 cycles refill the pipeline;
- an instruction skipped by its condition in an IT block takes one cycle, an IT itself one;
- each read of data from flash waits 2 of 0 to 2 cycles more, each word of it: the cache holds no data;
- instructions come through the instruction cache: 2 KB, lines of 16 bytes, two ways, the older one goes.
  That is an assumption, after the later chips of the family, which document theirs; a line that is not there
  waits 3 of 0 to 3 cycles. RAM has no wait states. EasyDMA's share of the buses is not counted.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import capstone
import numpy as np
from capstone import arm

from frogkick.pool.chip.bus import FLASH_BYTES, ChipError
from frogkick.pool.chip.emulator import Flag
from frogkick.pool.chip.image import FirmwareImage

PARTS: Final = 256
"""Time is counted in 1/256 of a cycle, so that average wait states stay integers."""


@dataclass(frozen=True)
class CostModel:
    """What an instruction costs beyond its own cycles; all adjustable, all integers."""

    # where the next instruction is not the next in memory. The manual says 1 to 3.
    branch_refill_cycles: int = 3
    # each line of 16 bytes that the instruction cache does not hold. Upper end of the product specification's
    # 0 to 3 wait states with the cache on.
    cache_miss_cycles: int = 3
    # with the cache off, per instruction, in 1/256 cycle. An assumption: two wait states for each word of two
    # instructions.
    fetch_wait_uncached_parts: int = 256
    # each read of data from flash; the cache holds instructions only. Upper end of the product
    # specification's 0 to 2 wait states.
    flash_data_wait_cycles: int = 2


LEAST_COST: Final = CostModel(
    branch_refill_cycles=1, cache_miss_cycles=0, fetch_wait_uncached_parts=0, flash_data_wait_cycles=0
)
"""The lower end of each range, where ``CostModel()`` takes the upper one. Divisions keep their 12 or 14."""


_MULTIPLE: Final = ("ldm", "stm", "push", "pop", "vldm", "vstm", "vpush", "vpop")
_FIXED: Final = {
    **dict.fromkeys(("udiv", "sdiv"), 12),
    **dict.fromkeys(("mla", "mls"), 2),
    **dict.fromkeys(("vdiv", "vsqrt"), 14),
    **dict.fromkeys(("vmla", "vmls", "vnmla", "vnmls", "vfma", "vfms", "vfnma", "vfnms"), 3),
    **dict.fromkeys(("tbb", "tbh"), 3),
    **dict.fromkeys(("dsb", "dmb", "isb"), 4),
}
_DOUBLE: Final = ("ldrd", "strd")
_LOAD_STORE: Final = ("ldr", "str", "vldr", "vstr", "ldrex", "strex")
_FLOAT_ARITHMETIC: Final = (
    "vadd", "vsub", "vmul", "vnmul", "vdiv", "vsqrt", "vmla", "vmls", "vnml", "vfma", "vfms", "vfnm", "vcvt",
)  # fmt: skip


def _stem(name: str) -> str:
    """Mnemonic without data type and width: ``vdiv.f32`` -> ``vdiv``, ``ldr.w`` -> ``ldr``."""
    return name.split(".")[0]


_CORE: Final = frozenset(range(arm.ARM_REG_R0, arm.ARM_REG_R12 + 1)) | {arm.ARM_REG_SP, arm.ARM_REG_LR}


def disassembler() -> Any:
    """A disassembler of Thumb code of the Cortex-M, with details."""
    reader = capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)
    reader.detail = True
    return reader


def register_words(operands: Iterable[Any]) -> int:
    """Words of the registers among some operands, a double float register counting twice."""
    return sum(
        2 if arm.ARM_REG_D0 <= one.reg <= arm.ARM_REG_D31 else 1
        for one in operands
        if one.type == arm.ARM_OP_REG
    )


def _memory(instruction: Any) -> Any:
    return next((one for one in instruction.operands if one.type == arm.ARM_OP_MEM), None)


def cycles_and_flags(instruction: Any) -> tuple[int, Flag]:
    """Cost of one capstone instruction (with details), without what is before it, refill and wait states."""
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
        return 1 + register_words(instruction.operands) - base, flags | Flag.ALIGNED
    if name.startswith(_DOUBLE):
        return 3, flags | Flag.ALIGNED
    if name.startswith(_LOAD_STORE):
        memory = _memory(instruction)
        literal = 1 if memory is not None and memory.mem.base == arm.ARM_REG_PC else 0
        if name.startswith("v"):
            return 1 + register_words(instruction.operands) + literal, flags | Flag.ALIGNED
        if "ex" in name:
            return 2, flags | Flag.ALIGNED
        plain_store = name.startswith("str") and not memory.mem.index and not instruction.writeback
        return (1 if plain_store else 2) + literal, flags
    for stem, cycles in _FIXED.items():
        # A condition may follow the stem ("vdivne"), but vmla must not catch "mla".
        if name.startswith(stem) and len(name) - len(stem) in (0, 2):
            return cycles, flags
    if name.startswith("vmov") and any(one.reg in _CORE for one in instruction.operands):
        return 2, flags
    return 1, flags


@dataclass(frozen=True, slots=True)
class Decoded:
    """What the count takes of an instruction."""

    offset: int  # bytes behind the first of its run
    size: int  # bytes
    # cycles, flags: as ``cycles_and_flags`` gives them
    cycles: int
    flags: int
    guarded: int  # how many instructions behind it are in its IT block; 0 where it is no IT
    jumps: bool  # whether the next instruction may be elsewhere
    written: frozenset[int]  # registers that it writes
    floats_read: frozenset[int]  # registers that it reads, with the single ones that a double one is made of
    address: frozenset[int] | None  # registers that it needs for an address; None if it has none
    gives_float: bool
    loads: bool  # a load or store of any kind
    first: bool  # a load that others may follow within its time
    second: bool  # a single load or store that may follow


def decoded(instruction: Any) -> Decoded:
    """What the count takes of a capstone instruction (with details)."""
    name = _stem(instruction.mnemonic)
    read, written = instruction.regs_access()
    memory = _memory(instruction)
    address = None
    if memory is not None:
        address = frozenset({memory.mem.base, memory.mem.index} - {0, arm.ARM_REG_PC})
    elif name.startswith(_MULTIPLE):
        on_stack = name.startswith(("push", "pop", "vp"))
        address = frozenset({arm.ARM_REG_SP if on_stack else instruction.operands[0].reg})
    doubles = [each - arm.ARM_REG_D0 for each in read if arm.ARM_REG_D0 <= each <= arm.ARM_REG_D15]
    parts = {arm.ARM_REG_S0 + 2 * double + half for double in doubles for half in (0, 1)}
    cycles, flags = cycles_and_flags(instruction)
    return Decoded(
        instruction.address,
        instruction.size,
        cycles,
        int(flags),
        guarded=len(name) - 1 if instruction.id == arm.ARM_INS_IT else 0,
        jumps=instruction.group(capstone.CS_GRP_JUMP),
        written=frozenset(written),
        floats_read=frozenset(read) | parts,
        address=address,
        gives_float=name.startswith(_FLOAT_ARITHMETIC),
        loads=name.startswith(_LOAD_STORE + _DOUBLE + _MULTIPLE),
        first=name.startswith("ldr") and not name.startswith(("ldrd", "ldrex")),
        second=name.startswith(("ldr", "str")) and not name.startswith((*_DOUBLE, "ldrex", "strex")),
    )


@lru_cache(maxsize=1 << 14)  # a firmware has some two thousand runs, and most chips of a process have one
def _run(code: bytes) -> tuple[Decoded, ...]:
    """The instructions from the beginning of these bytes to the next branch, 64 at most."""
    found: list[Decoded] = []
    in_it = 0
    for instruction in disassembler().disasm(code, 0, 64):
        found.append(decoded(instruction))
        in_it = in_it - 1 if in_it else found[-1].guarded
        if not in_it and found[-1].jumps:
            break
    return tuple(found)


def cycles_behind(before: Decoded, instruction: Decoded) -> int:
    """What an instruction costs more, or less, right behind the one before it in memory."""
    if before.gives_float:
        # A core register takes a float result by VMOV, which reads it as another does.
        return 1 if before.written & instruction.floats_read else 0
    if instruction.address is None:
        return 0
    if not before.loads:
        return 1 if before.written & instruction.address & _CORE else 0
    pipelined = before.first and instruction.second and not before.written & instruction.address
    return -1 if pipelined and instruction.cycles > 1 else 0


class CostTable:
    """Entries for the hook, decoded when the core first comes by.

    Decoding follows the core and not the section, so literal pools and jump tables between the functions are
    never taken for code.
    """

    def __init__(self, flash: bytes) -> None:
        self._flash = flash
        self.entries = (ctypes.c_uint32 * (FLASH_BYTES // 2))()
        self._last: dict[int, Decoded] = {}  # address -> the last instruction of a run that was cut off there

    def decode_from(self, address: int) -> None:
        """Fill entries from here to the next branch, or to one that is known.

        Raises:
            ChipError: there is no instruction at ``address``.
        """
        in_it = it_place = 0
        first = address
        before: Decoded | None = self._last.pop(address, None)
        # 64 instructions of at most 4 bytes: longer runs are continued when the core gets there.
        for instruction in _run(self._flash[address : address + 256]):
            place = (first + instruction.offset) // 2
            flags = instruction.flags
            behind = instruction.cycles + (0 if before is None else cycles_behind(before, instruction))
            if in_it:
                flags |= int(Flag.IN_IT)
                in_it -= 1
            elif self.entries[place]:
                # Known from another run, in which the instruction before it was not known.
                self.entries[place] = self.entries[place] & 0xFFFF | behind << 16
                return
            if instruction.guarded:
                in_it, it_place = instruction.guarded, place
            self.entries[place] = behind << 16 | instruction.cycles << 8 | flags
            address = first + instruction.offset + instruction.size
            before = instruction
            if not in_it and instruction.jumps:
                self._last[address] = instruction
                return
        if before is not None:
            self._last[address] = before
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


@dataclass(frozen=True)
class FunctionCost:
    """Cost of a function without the functions that it calls."""

    name: str  # of the C function
    calls: int  # number of executions of its first instruction
    instructions: int  # number of executed instructions
    cycles: float  # with wait states


class Profile:
    """Counts that the hook fills while the chip runs."""

    def __init__(self, image: FirmwareImage) -> None:
        self._image = image
        self.parts = (ctypes.c_uint64 * (FLASH_BYTES // 2))()
        self.visits = (ctypes.c_uint32 * (FLASH_BYTES // 2))()

    def functions(self) -> list[FunctionCost]:
        """Functions that ran, the most expensive first."""
        parts = np.ctypeslib.as_array(self.parts)
        visits = np.ctypeslib.as_array(self.visits)
        begins = [address // 2 for address, _ in self._image.functions]
        found = []
        for place, (address, name) in enumerate(self._image.functions):
            begin = address // 2
            end = begins[place + 1] if place + 1 < len(begins) else len(visits)
            instructions = int(visits[begin:end].sum(dtype=np.uint64))
            if instructions:
                cycles = int(parts[begin:end].sum()) / PARTS
                found.append(FunctionCost(name, int(visits[begin]), instructions, cycles))
        return sorted(found, key=lambda function: -function.cycles)
