"""Flow graphs of a firmware's functions, with the most cycles of each basic block, and their loops.

What a block costs, by the virtual chip's model (``cost``): each instruction its cycles and those behind the
one before it, a refill of the pipeline for a call and its return, and the waits of a read from flash for each
load that is not relative to the stack pointer; such a load is taken as unaligned where it may be. Jumps and
the instruction cache come on top.

Where the graph is not known (a call through a pointer, a jump into a loop): ``ChipError``.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from capstone import arm
from elftools.elf.elffile import ELFFile

from frogkick.pool.chip.bus import ChipError
from frogkick.pool.chip.cost import CostModel, Decoded, cycles_behind, decoded, register_words
from frogkick.pool.chip.stack import StackAnalysis

LINE_BYTES = 16
"""Of the instruction cache, as in hook.c."""


class Line(NamedTuple):
    """A line of a C source: file's name without folder, number from 1."""

    file: str
    number: int


@dataclass
class Block:
    """A basic block."""

    code: list[tuple[Any, Decoded]]
    cycles: int = 0  # the most, without the functions that it calls
    lines: dict[int, int] = field(default_factory=dict)  # line of the cache -> fetches in one execution
    calls: list[int] = field(default_factory=list)  # entries of functions
    out: list[tuple[int, bool]] = field(default_factory=list)  # following blocks; whether it is jumped to
    ends: bool = False  # the function may return from here


@dataclass
class Loop:
    """A natural loop."""

    header: int
    body: set[int]  # first addresses of its blocks
    latches: set[int]  # of blocks that jump back
    lines: set[Line]  # in C, that the jumps back belong to; number 0 of the function where there is none


@dataclass
class Function:
    """A function; blocks by their first address."""

    name: str
    entry: int
    blocks: dict[int, Block]
    loops: list[Loop]


class FlowGraphs:
    """The functions of an ELF for the chip."""

    def __init__(
        self, elf_path: Path | str, aligned: Collection[str] = (), cost: CostModel | None = None
    ) -> None:
        """Read code and lines.

        ``aligned``: C files whose functions access words and halfwords at multiples of their size, and
        floats, but for constants, in RAM alone.
        """
        self._aligned = aligned
        self._code = StackAnalysis(elf_path)
        self._path = Path(elf_path)
        self.model = cost or CostModel()
        self._functions: dict[int, Function] = {}
        self._fetched: dict[int, frozenset[int]] = {}

    @cached_property
    def lines(self) -> dict[int, Line]:
        """Address of each instruction -> its line."""
        found: dict[int, Line] = {}
        with self._path.open("rb") as stream:
            elf = ELFFile(stream)
            if not elf.has_dwarf_info():
                raise ChipError(f"firmware {self._path.name!r} has no debug information: do not strip it")
            information: Any = elf.get_dwarf_info()
            for unit in information.iter_CUs():
                program = information.line_program_for_CU(unit)
                first = 0 if program["version"] >= 5 else 1
                names = [entry.name.decode() for entry in program["file_entry"]]
                before: tuple[int, Line] | None = None
                for state in (entry.state for entry in program.get_entries() if entry.state is not None):
                    if before is not None:
                        found.update(dict.fromkeys(range(before[0], state.address, 2), before[1]))
                    line = Line(Path(names[state.file - first]).name, state.line)
                    before = None if state.end_sequence else (state.address, line)
        return found

    def entry(self, name: str) -> int:
        """Address of a function."""
        return self._code.entry(name)

    def function(self, entry: int) -> Function:
        """The flow graph of the function at an address."""
        if entry not in self._functions:
            self._functions[entry] = self._graph(entry)
        return self._functions[entry]

    def fetched(self, entry: int, active: tuple[int, ...] = ()) -> frozenset[int]:
        """Lines of the cache that a function and all that it calls are in."""
        if entry in active:
            raise ChipError(f"recursion of {self._code.name_at(entry)}, so no bound of the time")
        if entry not in self._fetched:
            blocks = self.function(entry).blocks.values()
            own = {line for block in blocks for line in block.lines}
            callees = {callee for block in blocks for callee in block.calls}
            self._fetched[entry] = frozenset(own).union(
                *(self.fetched(callee, (*active, entry)) for callee in callees)
            )
        return self._fetched[entry]

    def _graph(self, entry: int) -> Function:
        code = self._code.instructions(entry)
        name = self._code.name_at(entry)
        follow: dict[int, list[int]] = {}
        called: dict[int, list[int]] = {}
        for address, one in code.items():
            targets: set[tuple[int, int | None]] = set()
            follow[address] = list(self._code.followers(one, entry, 0, targets, code))
            called[address] = [self._known(target, name, one) for _, target in targets]
        reached, waiting = {entry}, [entry]
        while waiting:
            for each in follow[waiting.pop()]:
                if each not in reached:
                    reached.add(each)
                    waiting.append(each)
        heads = {entry}
        for address in reached:
            if follow[address] != [address + code[address].size]:
                heads.update(follow[address])
                heads.add(address + code[address].size)
        blocks: dict[int, Block] = {}
        for address in sorted(reached):
            if address in heads:
                block = blocks[address] = Block([])
            block.code.append((code[address], decoded(code[address])))
            block.calls += called[address]
            after = address + code[address].size
            if after in heads or after not in reached:
                # The target of a conditional jump to the next instruction is not jumped to either.
                block.out = [(each, each != after) for each in dict.fromkeys(follow[address])]
                tail = called[address] and code[address].id != arm.ARM_INS_BL
                block.cycles += self.model.branch_refill_cycles if tail else 0
                block.ends = not follow[address] or bool(tail) or _may_return(code[address])
        for address, block in blocks.items():
            self._weigh(entry, address, block, code)
        return Function(name, entry, blocks, self._loops(name, entry, blocks))

    def _known(self, target: int | None, name: str, one: Any) -> int:
        if target is None:
            raise ChipError(f"{name} calls through a pointer at 0x{one.address:08x}: no bound of its time")
        return target

    def _weigh(self, entry: int, address: int, block: Block, code: Mapping[int, Any]) -> None:
        """The most cycles of a block without calls, and the lines that it fetches."""
        before: Decoded | None = None
        jumped = True  # whether the instruction before may not be the one before it in memory
        line = -1
        if (preceding := next((code[address - n] for n in (2, 4) if address - n in code), None)) is not None:
            before = decoded(preceding)
        for one, taken in block.code:
            behind = cycles_behind(before, taken) if before is not None else 0
            block.cycles += (
                taken.cycles + (max(behind, 0) if jumped else behind) + self._data(entry, one, taken)
            )
            for fetched in range(one.address // LINE_BYTES, (one.address + one.size - 1) // LINE_BYTES + 1):
                if fetched != line:
                    block.lines[fetched] = block.lines.get(fetched, 0) + 1
                line = fetched
            before, jumped = taken, one.cc not in (arm.ARM_CC_AL, arm.ARM_CC_INVALID)
            if one.id in (arm.ARM_INS_BL, arm.ARM_INS_BLX):
                block.cycles += 2 * self.model.branch_refill_cycles  # to the function, and back
                jumped, line = True, -1

    def _data(self, entry: int, one: Any, taken: Decoded) -> int:
        """Cycles that the data of one instruction may take more: waits for flash, unaligned parts."""
        if not taken.loads:
            return 0
        name = one.mnemonic.split(".")[0]
        memory = next((each.mem for each in one.operands if each.type == arm.ARM_OP_MEM), None)
        on_stack = name.startswith(("push", "pop", "vp")) or (
            memory is not None and memory.base == arm.ARM_REG_SP and not memory.index
        )
        if on_stack:
            return 0
        many = name.startswith(("ldm", "stm", "vldm", "vstm"))
        words = register_words(one.operands[1:] if many else one.operands) if many or name[0] == "v" else 1
        words = 2 if name.startswith(("ldrd", "strd")) else words
        wait = 0 if name.startswith(("st", "vst")) else self.model.flash_data_wait_cycles
        if memory is not None and memory.base == arm.ARM_REG_PC:
            return words * wait
        line = self.lines.get(entry)
        if line is not None and line.file in self._aligned:
            return words - 1 if name[0] == "v" else words * wait + (words - 1)
        if name.startswith(("ldrb", "ldrsb", "strb")):
            parts = 1
        elif name.startswith(("ldrh", "ldrsh", "strh")):
            parts = 2
        elif name.startswith(("ldr", "str")) and words == 1:
            parts = 3
        else:
            return words - 1 + words * wait  # it faults where a word is not aligned; two words may be apart
        return parts - 1 + parts * words * wait

    def _loops(self, name: str, entry: int, blocks: Mapping[int, Block]) -> list[Loop]:
        """The natural loops, one for each header."""
        order, before = _depth_first(entry, blocks)
        number = {block: place for place, block in enumerate(order)}
        above = _dominators(order, before, number)
        found: dict[int, Loop] = {}
        for block in order:
            for header, _ in blocks[block].out:
                if number[header] > number[block]:
                    continue
                at = block
                while at != header:
                    if at == entry:
                        raise ChipError(f"{name} jumps into a loop at 0x{header:08x}: no bound of its time")
                    at = above[at]
                loop = found.setdefault(header, Loop(header, {header}, set(), set()))
                loop.latches.add(block)
                waiting = [block]
                while waiting:
                    at = waiting.pop()
                    if at not in loop.body:
                        loop.body.add(at)
                        waiting += before[at]
        for loop in found.values():
            jumps = (self.lines.get(blocks[latch].code[-1][0].address) for latch in loop.latches)
            loop.lines = {line for line in jumps if line is not None and line.number} or {Line(name, 0)}
        return list(found.values())


def _may_return(one: Any) -> bool:
    return bool(one.id in (arm.ARM_INS_BX, arm.ARM_INS_POP))


def _depth_first(entry: int, blocks: Mapping[int, Block]) -> tuple[list[int], dict[int, list[int]]]:
    """Blocks in reverse postorder, and those before each."""
    before: dict[int, list[int]] = {block: [] for block in blocks}
    order: list[int] = []
    seen = {entry}
    waiting = [(entry, iter([each for each, _ in blocks[entry].out]))]
    while waiting:
        block, followers = waiting[-1]
        for each in followers:
            before[each].append(block)
            if each not in seen:
                seen.add(each)
                waiting.append((each, iter([next_ for next_, _ in blocks[each].out])))
                break
        else:
            order.append(block)
            waiting.pop()
    return order[::-1], before


def _dominators(
    order: Sequence[int], before: Mapping[int, Sequence[int]], number: Mapping[int, int]
) -> dict[int, int]:
    """Immediate dominator of each block. Source: Cooper, Harvey & Kennedy 2001."""
    above = {order[0]: order[0]}
    changed = True
    while changed:
        changed = False
        for block in order[1:]:
            known = [each for each in before[block] if each in above]
            new = known[0]
            for other in known[1:]:
                while new != other:
                    while number[new] > number[other]:
                        new = above[new]
                    while number[other] > number[new]:
                        other = above[other]
            changed = changed or above.get(block) != new
            above[block] = new
    return above
