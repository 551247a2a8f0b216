"""Upper bound of the cycles of a firmware's function by its machine code, over all paths, inputs and memory.

The function and all that it calls are one graph of basic blocks (``flow``). How often the blocks run is
bounded by the graph (what flows into a block flows out of it), by the bounds of its loops, which are known by
the source line of the jump back, and by counts of calls that the caller knows. A linear program finds the
counts with the most cycles. Source: Li & Malik 1995, implicit path enumeration.

A line of the instruction cache waits once while a loop or a function runs in which no more than the cache's
two ways compete for its set, and at each fetch elsewhere.

Where there is no bound (a loop without one, recursion): ``ChipError``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from frogkick.pool.chip.bus import ChipError
from frogkick.pool.chip.flow import FlowGraphs, Function, Line, Loop

_SETS: Final = 64
_WAYS: Final = 2
"""The instruction cache, as in hook.c."""


class Times(NamedTuple):
    """How often the body of a loop runs at the most."""

    most: int
    # False: each time that the loop begins. True: in all, while its function runs once
    per_call: bool = False
    # an instruction of which the body in C has one: a block with several is as many runs of it at once
    mark: str = ""


Bounds = Callable[[Line], Times]
"""Bound of the loop whose jump back has this line; raises ChipError for one that it does not know."""


@dataclass(frozen=True)
class Longest:
    """The bound: cycles, and executions and cycles of each function on the longest path."""

    cycles: float
    functions: Mapping[str, tuple[float, float]]


def longest(
    graphs: FlowGraphs,
    function: str,
    bounds: Bounds,
    calls: Mapping[str, int] | None = None,
    never: Collection[str] = (),
) -> Longest:
    """The bound of one call of a function.

    Args:
        graphs: of the firmware.
        function: name of the C function.
        bounds: of the loops.
        calls: function -> how often it is called at the most.
        never: functions that are not called, and files (with a dot) of which no line runs.
    """
    return _Program(graphs, function, bounds, calls or {}, never).solve()


class _Program:
    """The linear program of one bound: a count for each block and each edge between blocks."""

    def __init__(
        self,
        graphs: FlowGraphs,
        function: str,
        bounds: Bounds,
        calls: Mapping[str, int],
        never: Collection[str],
    ) -> None:
        self.graphs, self.bounds, self.never = graphs, bounds, never
        self.root = graphs.entry(function)
        self.calls = calls
        self.functions: list[Function] = []
        self.columns: dict[tuple[int, ...], int] = {}
        self.equal: list[dict[int, float]] = []
        self.at_most: list[tuple[dict[int, float], float]] = []
        self.ceiling: dict[int, float] = {}
        self.cost: dict[int, float] = {}

    def solve(self) -> Longest:
        from scipy.optimize import linprog
        from scipy.sparse import coo_array

        self._collect(self.root)
        begun: dict[int, dict[int, float]] = {each.entry: {} for each in self.functions}
        for each in self.functions:
            self._flow(each, begun)
        for entry, row in begun.items():
            once = self.column(entry)
            if entry == self.root:
                self.ceiling[once] = 1.0
            else:
                self.equal.append({**row, once: -1.0})
        for each in self.functions:
            self._loops(each)
            self._waits(each)
            if each.name in self.calls:
                self.ceiling[self.column(each.entry)] = float(self.calls[each.name])
        count = len(self.columns)

        def matrix(rows: Sequence[Mapping[int, float]]) -> Any:
            places = [(value, at, column) for at, row in enumerate(rows) for column, value in row.items()]
            values, at, columns = zip(*places, strict=True)
            return coo_array((values, (at, columns)), shape=(len(rows), count)).tocsr()

        cost = np.zeros(count)
        for column, value in self.cost.items():
            cost[column] = value
        found = linprog(
            -cost,
            A_ub=matrix([row for row, _ in self.at_most]) if self.at_most else None,
            b_ub=[most for _, most in self.at_most] or None,
            A_eq=matrix(self.equal),
            b_eq=np.zeros(len(self.equal)),
            bounds=[(0.0, self.ceiling.get(column)) for column in range(count)],
        )
        if found.status != 0:
            raise ChipError(
                f"no bound of the time of {self.graphs.function(self.root).name}: {found.message}"
            )
        functions = {}
        for each in self.functions:
            mine = [(key, column) for key, column in self.columns.items() if key[0] in each.blocks]
            cycles = sum(cost[column] * found.x[column] for _, column in mine)
            functions[each.name] = (float(found.x[self.column(each.entry)]), float(cycles))
        return Longest(-float(found.fun), functions)

    def column(self, *key: int) -> int:
        """(function): its calls; (block, next): an edge; (block, -1): a return; (block, -2): the block."""
        return self.columns.setdefault(key, len(self.columns))

    def _collect(self, entry: int) -> None:
        function = self.graphs.function(entry)
        if function in self.functions:
            return
        self.functions.append(function)
        for block in function.blocks.values():
            for callee in block.calls:
                if self.graphs.function(callee).name not in self.never:
                    self._collect(callee)

    def _flow(self, function: Function, begun: dict[int, dict[int, float]]) -> None:
        """What flows into a block flows out of it, and calls what it calls."""
        refill = self.graphs.model.branch_refill_cycles
        into: dict[int, dict[int, float]] = {at: {} for at in function.blocks}
        into[function.entry][self.column(function.entry)] = 1.0
        for at, block in function.blocks.items():
            for follower, jumped in block.out:
                edge = self.column(at, follower)
                into[follower][edge] = 1.0
                self.cost[edge] = float(refill * jumped)
        for at, block in function.blocks.items():
            runs = self.column(at, -2)
            self.cost[runs] = float(block.cycles)
            self.equal.append({**into[at], runs: -1.0})
            out = {self.column(at, follower): 1.0 for follower, _ in block.out}
            if block.ends:
                out[self.column(at, -1)] = 1.0
            self.equal.append({**out, runs: -1.0})
            for callee in block.calls:
                if callee in begun:
                    begun[callee][runs] = begun[callee].get(runs, 0.0) + 1.0
                else:
                    self.ceiling[runs] = 0.0
            lines = [
                line for one, _ in block.code if (line := self.graphs.lines.get(one.address)) and line.number
            ]
            if lines and all(line.file in self.never for line in lines):
                self.ceiling[runs] = 0.0

    def _begins(self, function: Function, loop: Loop) -> dict[int, float]:
        """The edges into a loop from outside."""
        outside = {at: block for at, block in function.blocks.items() if at not in loop.body}
        begins = {
            self.column(at, follower): 1.0
            for at, block in outside.items()
            for follower, _ in block.out
            if follower == loop.header
        }
        if loop.header == function.entry:
            begins[self.column(function.entry)] = 1.0
        return begins

    def _loops(self, function: Function) -> None:
        # What a loop may do in all is shared by its copies.
        in_all: dict[frozenset[Line], tuple[dict[int, float], int]] = {}
        for loop in function.loops:
            times = max(self.bounds(line) for line in loop.lines)
            most = times.most
            if times.mark and len(loop.body) == 1:
                code = function.blocks[loop.header].code
                most //= max(1, sum(one.mnemonic.startswith(times.mark) for one, _ in code))
            back = {self.column(latch, loop.header): 1.0 for latch in loop.latches}
            begins = self._begins(function, loop)
            # Tested where it jumps back, the loop has run its body once more than it jumps; else as often.
            tested = all(
                any(follower not in loop.body for follower, _ in function.blocks[latch].out)
                for latch in loop.latches
            )
            first = 1 if tested and most > 0 else 0
            if times.per_call:
                in_all.setdefault(frozenset(loop.lines), ({}, most))[0].update(
                    {**back, **(begins if first else {})}
                )
            else:
                self.at_most.append(({**back, **{edge: -float(most - first) for edge in begins}}, 0.0))
        for row, most in in_all.values():
            self.at_most.append(({**row, self.column(function.entry): -float(most)}, 0.0))

    def _waits(self, function: Function) -> None:
        """The waits for lines: once in the outermost scope that holds a line, else at each fetch."""
        wait = float(self.graphs.model.cache_miss_cycles)
        scopes: list[tuple[set[int], Mapping[int, float]]] = [
            (set(function.blocks), {self.column(function.entry): 1.0})
        ]
        for loop in sorted(function.loops, key=lambda loop: -len(loop.body)):
            scopes.append((loop.body, self._begins(function, loop)))
        held: list[tuple[set[int], set[int]]] = []
        for body, begins in scopes:
            blocks = [function.blocks[at] for at in body]
            lines = {line for block in blocks for line in block.lines}
            all_lines = lines.union(
                *(self.graphs.fetched(callee) for block in blocks for callee in block.calls)
            )
            in_set = np.bincount([line % _SETS for line in all_lines], minlength=_SETS)
            kept = {line for line in lines if in_set[line % _SETS] <= _WAYS}
            new = kept - {line for outer, of_outer in held if body <= outer for line in of_outer}
            for begin in begins:
                self.cost[begin] = self.cost.get(begin, 0.0) + wait * len(new)
            held.append((body, kept))
        for at, block in function.blocks.items():
            inside = {line for body, kept in held if at in body for line in kept}
            misses = sum(fetches for line, fetches in block.lines.items() if line not in inside)
            self.cost[self.column(at, -2)] += wait * misses
