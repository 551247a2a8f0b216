"""The cost of a generated planner: sizes of its image for the chip, times on the virtual chip."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from frogkick.paths import SHAPES, shape
from frogkick.planner.plan import PlanConfig
from frogkick.pool.chip.image import Layouts, load_image
from frogkick.pool.chip.stack import StackAnalysis
from frogkick.runs.chip_planner import CYCLES_PER_MS, ChipPlanner, states_for_timing
from frogkick.tables.image import read_image
from frogkick_codegen.emit import NOT_PLANNER, DepthTime, Figures, build_planner, compiler_name, emit

STATES: Mapping[int, int] = {1: 60, 2: 30, 3: 12}
"""Depth -> number of timed states; this takes seconds, ``frogkick study chip`` takes minutes."""
_TYPES = ("fk_tables_t", "fk_path_t", "fk_plan_config_t", "fk_state_t", "fk_plan_t")
_FUNCTIONS = ("fk_plan", "fk_tables_open")


def measure(
    image: Path,
    config: PlanConfig | None = None,
    states: Mapping[int, int] = STATES,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Figures:
    """Generate the C code of a table, build it for the chip, and measure it.

    The same table gives the same figures on every machine.

    Args:
        image: table image.
        config: weights; None: the paper's.
        states: depth -> number of decisions to time.
        progress: called with the decisions done and their total.

    Raises:
        InputError: an invalid table, or the chip's start-up code is not installed.
        ToolchainError: no compiler is found.
        ChipError: the planner does what the chip does not allow.
    """
    settings = config or PlanConfig()
    with tempfile.TemporaryDirectory(prefix="frogkick-measure-") as folder:
        work = Path(folder).resolve()
        emit(image, work / "emitted", "frogkick codegen", settings)
        elf = build_planner(work / "emitted", work / "planner.elf")
        planner = ChipPlanner(elf)
        times = _times(planner, image, settings, states, progress)
        stack = StackAnalysis(elf)
        types = Layouts(elf)
        compiler, flags = compiler_name()
        return Figures(
            compiler=compiler,
            flags=flags,
            code_bytes=_code_bytes(elf),
            ram_bytes={name: types[name].itemsize for name in _TYPES},
            static_bytes=_static_bytes(elf),
            stack_bytes={name: stack.bound(name).total_bytes for name in _FUNCTIONS},
            open_ms=planner.open_cycles / CYCLES_PER_MS,
            times=times,
        )


def _times(
    planner: ChipPlanner,
    image: Path,
    config: PlanConfig,
    states: Mapping[int, int],
    progress: Callable[[int, int], None],
) -> dict[int, DepthTime]:
    """Return the decisions at each depth, spread over the paths, with the most expensive depth first."""
    shares = {depth: -(-states[depth] // len(SHAPES)) for depth in sorted(states, reverse=True)}
    tables, found, done = read_image(image), {}, 0
    for depth, share in shares.items():
        cycles = []
        for index, name in enumerate(SHAPES):
            planner.configure(shape(name), config)
            timed = states_for_timing(tables, shape(name), share, np.random.default_rng([0, depth, index]))
            depths = np.full(share, depth, dtype=np.int32)
            cycles.append(planner.plan(timed.states, depths, timed.limb_use, timed.along_points)[1])
            progress(done := done + share, len(SHAPES) * sum(shares.values()))
        taken = np.concatenate(cycles)
        found[depth] = DepthTime(
            len(taken), float(taken.sum()) / len(taken) / CYCLES_PER_MS, float(taken.max()) / CYCLES_PER_MS
        )
    return {depth: found[depth] for depth in states}


def _code_bytes(elf: Path) -> int:
    """Return the flash of all functions and constants except the table and the start-up code."""
    sizes = load_image(elf).sizes
    table = {"fk_table_bytes", "fk_table_image", "fk_table_image_bytes"}
    return sum(size for name, size in sizes.items() if name not in {*NOT_PLANNER, *table})


def _static_bytes(elf: Path) -> int:
    """Return the RAM of variables; the start-up code has none."""
    symbols = load_image(elf).symbols
    return sum(symbols[f"fk_{part}_end"] - symbols[f"fk_{part}_begin"] for part in ("data", "bss"))
