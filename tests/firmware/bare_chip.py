"""A virtual chip that runs a few instructions and nothing else."""

from __future__ import annotations

from pathlib import Path

from bench_build import build_text

from frogkick.pool.chip import CostModel, VirtualChip
from frogkick.pool.chip.power import Clock, Power

NO_WAITS = CostModel(
    branch_refill_cycles=2, cache_miss_cycles=0, fetch_wait_uncached_parts=0, flash_data_wait_cycles=0
)
BARE = """
#include <stdint.h>
void fk_reset(void);
{helpers}
__attribute__((naked)) void fk_reset(void) {{ __asm__ volatile({assembly}); }}
extern uint32_t fk_stack_top[];
typedef struct {{ uint32_t *stack_top; void (*reset)(void); }} vectors_t;
__attribute__((section(".vectors"), used)) static const vectors_t vectors = {{fk_stack_top, fk_reset}};
"""


def bare(folder: Path, assembly: str, cost: CostModel | None = None) -> VirtualChip:
    """A chip that runs nothing but these instructions from reset, without our startup code."""
    text = " ".join(f'"{line.strip()}\\n"' for line in assembly.strip().splitlines())
    return VirtualChip(build_text(BARE.format(helpers="", assembly=text), folder), cost)


def clock_of(chip: VirtualChip) -> Clock:
    return next(block for block in chip.peripherals if isinstance(block, Clock))


def power_of(chip: VirtualChip) -> Power:
    return next(block for block in chip.peripherals if isinstance(block, Power))
