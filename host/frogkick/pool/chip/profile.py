"""Profile of a firmware: cycles and calls of each function."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from frogkick.pool.chip.bus import FLASH_BYTES
from frogkick.pool.chip.cost import PARTS
from frogkick.pool.chip.image import FirmwareImage


@dataclass(frozen=True)
class FunctionCost:
    """Cost of a function without the functions that it calls.

    Attributes:
        name: of the C function.
        calls: number of executions of its first instruction.
        instructions: number of executed instructions.
        cycles: with wait states.
    """

    name: str
    calls: int
    instructions: int
    cycles: float


class Profile:
    """Counts that the hook fills while the chip runs."""

    def __init__(self, image: FirmwareImage) -> None:
        """Start with zero counts; ``image`` has the functions."""
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

    def lines(self, function: str) -> list[tuple[int, int, float]]:
        """Address, visits and cycles of each instruction of a function that ran."""
        found = []
        for address in range(0, FLASH_BYTES, 2):
            if self.visits[address // 2] and self._image.function_at(address) == function:
                found.append((address, int(self.visits[address // 2]), self.parts[address // 2] / PARTS))
        return found
