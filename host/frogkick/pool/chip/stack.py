"""Upper bound of a firmware's stack by its machine code, over all paths and calls.

Where there is no bound (recursion, a stack pointer that is not moved by constants): ``ChipError``.
"""

from __future__ import annotations

import bisect
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capstone import arm

from frogkick.pool.chip.bus import FLASH_BYTES, ChipError
from frogkick.pool.chip.cost import disassembler, register_words
from frogkick.pool.chip.image import load_image

_PC = arm.ARM_REG_PC
_SP = arm.ARM_REG_SP
_ALWAYS = (arm.ARM_CC_AL, arm.ARM_CC_INVALID)
_STORES = ("stmdb", "vstmdb", "stm", "vstm")
_LOADS = ("ldm", "vldm", "ldmia", "vldmia")
_Deepest = tuple[int, tuple[tuple[str, int], ...]]  # the first two of StackBound


@dataclass(frozen=True)
class StackBound:
    """The deepest chain of calls."""

    total_bytes: int  # its stack
    # (function, bytes of stack in use when it calls the next; its own deepest for the last)
    chain: tuple[tuple[str, int], ...]
    # functions that call through a pointer; any function whose address is in flash may be called
    indirect: tuple[str, ...]


@dataclass(frozen=True)
class _Frame:
    """Stack of a function: its own deepest, and its calls as (depth, target; None: a pointer)."""

    deepest: int
    calls: tuple[tuple[int, int | None], ...]


class StackAnalysis:
    """The functions of an ELF for the chip."""

    def __init__(self, elf_path: Path | str) -> None:
        """Read code and symbols; mapping symbols tell code from data (Arm's ELF supplement, 5.5.5)."""
        self._disassembler = disassembler()
        self._names: dict[int, str] = {}
        self._sizes: dict[int, int] = {}
        image = load_image(elf_path)
        self._flash = image.flash
        marks: list[tuple[int, bool]] = []
        for symbol in image.table:
            if symbol.kind == "FUNC" and symbol.bytes:
                address = symbol.address & ~1
                self._names.setdefault(address, symbol.name)
                self._sizes[address] = max(symbol.bytes, self._sizes.get(address, 0))
            elif symbol.name.split(".")[0] in ("$t", "$d"):
                marks.append((symbol.address, symbol.name.startswith("$t")))
        self._marks = sorted(marks)
        self._frames: dict[int, _Frame] = {}

    def bound(self, function: str = "fk_reset") -> StackBound:
        """The bound of the stack of a function and all that it calls."""
        entry = self.entry(function)
        known: dict[int, _Deepest] = {}
        total, chain = self._deepest(entry, known, [])
        indirect = sorted(
            self._names[address]
            for address in known
            if any(target is None for _, target in self._frames[address].calls)
        )
        return StackBound(total, chain, tuple(indirect))

    def own_bytes(self, function: str) -> int:
        """The largest stack of a function without the functions that it calls."""
        return self._frame(self.entry(function)).deepest

    @property
    def functions(self) -> list[str]:
        """Names of all functions."""
        return sorted(self._names.values())

    def entry(self, function: str) -> int:
        """Address of a function."""
        for address, name in self._names.items():
            if name == function:
                return address
        raise ChipError(f"the firmware has no function {function!r}: build it unstripped")

    def name_at(self, entry: int) -> str:
        """Name of the function that begins at an address."""
        return self._names.get(entry, hex(entry))

    def _deepest(self, entry: int, known: dict[int, _Deepest], active: list[int]) -> _Deepest:
        if entry in known:
            return known[entry]
        name = self._names.get(entry, hex(entry))
        if entry in active:
            loop = " -> ".join(self._names[address] for address in [*active[active.index(entry) :], entry])
            raise ChipError(f"recursion, so no bound of the stack: {loop}")
        frame = self._frame(entry)
        best: _Deepest = (frame.deepest, ((name, frame.deepest),))
        for depth, target in frame.calls:
            for callee in self._pointed_at() if target is None else [target]:
                total, chain = self._deepest(callee, known, [*active, entry])
                if depth + total > best[0]:
                    best = (depth + total, ((name, depth), *chain))
        known[entry] = best
        return best

    def _pointed_at(self) -> list[int]:
        """Functions that a pointer may call: their address is a word in flash after the vectors."""
        words = struct.unpack(f"<{FLASH_BYTES // 4}I", self._flash)[16:]
        return sorted({word & ~1 for word in words if word & 1 and word & ~1 in self._names})

    def _is_code(self, address: int) -> bool:
        place = bisect.bisect_right(self._marks, (address, True)) - 1
        return place < 0 or self._marks[place][1]

    def instructions(self, entry: int) -> dict[int, Any]:
        """The instructions of a function by their addresses."""
        found: dict[int, Any] = {}
        address, end = entry, entry + self._sizes[entry]
        while address < end:
            if not self._is_code(address):
                address += 2
                continue
            stop = address
            while stop < end and self._is_code(stop):
                stop += 2
            # All at once, as the condition of an instruction is in the IT before it.
            for decoded in self._disassembler.disasm(self._flash[address:stop], address):
                found[address] = decoded
                address += decoded.size
            if address < stop:
                raise ChipError(f"no instruction at 0x{address:08x} in {self._names[entry]}")
        return found

    def _frame(self, entry: int) -> _Frame:
        """Follow all paths through a function, with the depth of its stack at each instruction."""
        if entry in self._frames:
            return self._frames[entry]
        if entry not in self._sizes:
            raise ChipError(f"a call to 0x{entry:08x}, where no function begins: no bound of the stack")
        code = self.instructions(entry)
        depths: dict[int, int] = {}
        calls: set[tuple[int, int | None]] = set()
        waiting = [(entry, 0)]
        deepest = 0
        while waiting:
            address, depth = waiting.pop()
            if depths.get(address, -1) >= depth or address not in code:
                continue
            depths[address] = depth
            if depth > 1 << 16:
                raise ChipError(f"the stack of {self._names[entry]} grows in a loop: no bound")
            one = code[address]
            after = depth + self._moved(one, entry)
            if one.cc not in _ALWAYS:
                after = max(after, depth)
            deepest = max(deepest, depth, after)
            waiting += [(follower, after) for follower in self.followers(one, entry, after, calls, code)]
        frame = _Frame(deepest, tuple(sorted(calls, key=str)))
        self._frames[entry] = frame
        return frame

    def _moved(self, one: Any, entry: int) -> int:
        """Bytes by which an instruction moves the stack pointer down."""
        name, operands = one.mnemonic.split(".")[0], one.operands
        if name.startswith(("push", "vpush")):
            return 4 * register_words(operands)
        if name.startswith(("pop", "vpop")):
            return -4 * register_words(operands)
        _, written = one.regs_access()
        if _SP not in written:
            return 0
        if name.startswith(_STORES + _LOADS):
            down = name.startswith(_STORES)
            return 4 * register_words(operands[1:]) * (1 if down else -1)
        if name.startswith(("str", "ldr")):
            return -_written_back(operands)
        by_constant = name.startswith(("sub", "add")) and operands[-1].type == arm.ARM_OP_IMM
        if by_constant and (len(operands) == 2 or operands[1].reg == _SP):
            return int(operands[-1].imm) * (1 if name.startswith("sub") else -1)
        raise ChipError(
            f"{self._names[entry]} moves its stack pointer by no constant ({one.mnemonic} {one.op_str} at "
            f"0x{one.address:08x}): no bound of the stack"
        )

    def followers(
        self, one: Any, entry: int, depth: int, calls: set[tuple[int, int | None]], code: dict[int, Any]
    ) -> Iterator[int]:
        """Yield the possible next instructions of this function, and add calls."""
        name, next_address = one.mnemonic.split(".")[0], one.address + one.size
        conditional = one.cc not in _ALWAYS
        first: Any = one.operands[0] if one.operands else None
        if name.startswith(("tbb", "tbh")):
            yield from self._table(one, code)
        elif one.id in (arm.ARM_INS_BL, arm.ARM_INS_BLX):
            direct = first is not None and first.type == arm.ARM_OP_IMM
            calls.add((depth, int(first.imm) & ~1 if direct else None))
            yield next_address
        elif one.id in (arm.ARM_INS_CBZ, arm.ARM_INS_CBNZ):
            yield int(one.operands[1].imm)
            yield next_address
        elif one.id == arm.ARM_INS_B:
            target = int(first.imm)
            if target in code:
                yield target
            else:
                calls.add((depth, target & ~1))
            if conditional:
                yield next_address
        elif one.id == arm.ARM_INS_BX or _PC in one.regs_access()[1] or _loads_pc(one):
            if one.id == arm.ARM_INS_BX:
                if first.reg != arm.ARM_REG_LR:
                    calls.add((depth, None))
            elif not name.startswith(("pop", "ldm", "ldr")):
                raise ChipError(
                    f"{self._names[entry]} jumps to a computed place ({one.mnemonic} {one.op_str}): no bound"
                )
            if conditional:
                yield next_address
        elif one.id != arm.ARM_INS_UDF:
            yield next_address

    def _table(self, one: Any, code: dict[int, Any]) -> Iterator[int]:
        """Targets of a table branch: the table follows it up to the next code."""
        size = 2 if one.mnemonic.startswith("tbh") else 1
        begin = at = one.address + one.size
        while not self._is_code(at):
            if at >= FLASH_BYTES:
                raise ChipError(f"there is no code behind the table at 0x{begin:08x}")
            entry = int.from_bytes(self._flash[at : at + size], "little")
            if begin + 2 * entry in code:
                yield begin + 2 * entry
            at += size


def _written_back(operands: Sequence[Any]) -> int:
    """Offset that a load or store adds to its base."""
    memory = next(one for one in operands if one.type == arm.ARM_OP_MEM)
    if memory.mem.disp:
        return int(memory.mem.disp)
    after = operands[-1]
    return int(after.imm) * (-1 if after.subtracted else 1) if after.type == arm.ARM_OP_IMM else 0


def _loads_pc(one: Any) -> bool:
    return one.mnemonic.startswith(("pop", "ldm")) and any(operand.reg == _PC for operand in one.operands)
