"""A virtual nRF52832: runs the bench firmware's ELF, counts cycles, knows the peripherals that it uses."""

from frogkick.pool.chip.chip import VirtualChip
from frogkick.pool.chip.cost import CostModel
from frogkick.pool.chip.errors import ChipError

__all__ = ["ChipError", "CostModel", "VirtualChip"]
