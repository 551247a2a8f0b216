"""A virtual nRF52832: runs the bench firmware's ELF, counts cycles, knows the peripherals that it uses."""

from frogkick.core.errors import require

# Every import of this package runs this line, so a missing package gives one line and no traceback.
require("the virtual chip", "unicorn", "capstone", "elftools", "ziglang")

from frogkick.pool.chip.bus import ChipError  # noqa: E402
from frogkick.pool.chip.chip import VirtualChip  # noqa: E402
from frogkick.pool.chip.cost import CostModel  # noqa: E402

__all__ = ["ChipError", "CostModel", "VirtualChip"]
