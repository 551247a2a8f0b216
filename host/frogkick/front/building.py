"""C code and firmware of a table: generate, build, measure, test on the virtual chip, and flash them.

A compiler that is missing raises a ``ToolchainError``, whose text says what to install.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.errors import InputError, require
from frogkick.core.files import existing_file
from frogkick.core.progress import Progress, shown, tell_line
from frogkick.front.places import built_firmware
from frogkick.front.tables import Table, load_table
from frogkick.paths import SHAPES, shape
from frogkick.planner.plan import SEARCH_MOST_US, Cost, PlanConfig, config_of, on_robot
from frogkick.robot import Robot, load_robot
from frogkick.tables.image import Tables, open_image, read_image
from frogkick_codegen.emit import NOT_PLANNER, DepthTime, Figures, build_planner, emit
from frogkick_codegen.firmware import CHIPS, Firmware, build, require_tools
from frogkick_codegen.probe import check_image, flash
from frogkick_codegen.toolchain import STANDARD, zig

if TYPE_CHECKING:
    from frogkick.runs.chip_check import ChipPlanner, ChipReport

__all__ = ["Firmware", "build_firmware", "emit_c", "flash_firmware", "try_firmware"]

STATES: Mapping[int, int] = {1: 60, 2: 30, 3: 12}
"""Depth -> number of timed states; this takes seconds, ``frogkick study chip`` takes minutes."""
HALF_WORN = (16384,)
"""The share of its contribution that each limb has lost, of 32767: decisions with worn limbs take longest."""
_TYPES = ("fk_tables_t", "fk_path_t", "fk_plan_config_t", "fk_state_t", "fk_plan_t")
_FUNCTIONS = ("fk_plan", "fk_tables_open")


@typed
def build_firmware(
    table: Table | Path | str, target: str = "bench", out: Path | str | None = None
) -> Firmware:
    """Build the firmware around a table.

    Args:
        table: the robot's table or its file. The image also holds the robot's guard limits and planner.
        target: "bench" (bare metal, nRF52832) or "native" (the same core as a library for this computer).
        out: folder for the files; None: a temporary one, which is deleted with the object.

    Raises:
        InputError: an unknown target, invalid limits of the guard, an image that does not fit, or decisions
            that may take the chip longer than its watchdog waits.
        ToolchainError: no compiler here; the text says what to install.
    """
    table = load_table(table)
    place = Path(tempfile.mkdtemp(prefix="frogkick-firmware-")) if out is None else Path(out)
    with table.file() as image:
        made = build(target, image, table.robot, place, timed=partial(_plan_time, table))
    if out is None:
        weakref.finalize(made, shutil.rmtree, place, ignore_errors=True)
    return made


def _plan_time(table: Table, elf: Path, sources: Path) -> dict[str, Any]:
    """How long a bench image plans: ``plan_time`` of the command ``firmware build``.

    Raises InputError where a decision may take longer than the watchdog allows.
    """
    # These cannot be loaded without the extra.
    from frogkick.front.plan_time import PlanBound, shape_of
    from frogkick.runs.chip_check import ChipPlanner

    bound = PlanBound(elf, sources)
    turn_us = bound.require_in_time(table.tables)
    config = on_robot(config_of(table.robot.planner), table.tables)
    planner, states = ChipPlanner(elf), {config.depth: STATES.get(config.depth, min(STATES.values()))}
    planner.wear(HALF_WORN)
    sampled = _times(planner, table.tables, config, states, lambda _done, _all: None)[config.depth]
    bound_us = bound.plan_us(shape_of(table.tables), config.depth, Cost(config.cost), config.transitions_max)
    return {
        "depth": config.depth,
        "transitions_max": config.transitions_max,
        "sampled_states": sampled.states,
        "sampled_ms": round(sampled.worst_ms, 3),
        "bound_ms": round(1e-3 * bound_us, 3),
        "any_bound_ms": round(1e-3 * turn_us, 3),
        "any_limit_ms": 1e-3 * SEARCH_MOST_US,
    }


@typed
def emit_c(
    table: Table | Path | str,
    out: Path | str,
    *,
    robot: Robot | Path | str | None = None,
    measure: bool = False,
    progress: Progress = False,
) -> dict[str, str]:
    """Write table and planner as C99 into a folder, with an example and a README.

    Args:
        table: the table or its file.
        out: the folder to make; a folder that was generated before is replaced, any other is refused.
        robot: whose planner's weights and depth the code gets, its name or its TOML file; None: the robot of
            a table in memory, or the one that the file names, built-in or ID.toml beside it. Where that one
            cannot be used, the code gets the weights of the paper and depth 1, and a line on stderr says so.
        measure: build for the chip and run on the virtual chip, for sizes and times in the README.
        progress: of measuring: True for a bar, or a function of (done, all).

    Returns:
        File name -> SHA-256 of its content, hexadecimal.

    Raises:
        InputError: the folder holds something else, or cannot be written, or the robot does not fit.
        TableError: the file is not a valid table image.
    """
    image = table.image if isinstance(table, Table) else read_image(table).image
    name = table.name if isinstance(table, Table) else Path(table).name
    config, robot_sha256, figures = PlanConfig(), None, None
    try:
        known = load_table(table, robot if robot is None else load_robot(robot)).robot
        config, robot_sha256 = config_of(known.planner), known.sha256
    except InputError as error:
        if robot is not None:
            raise
        tell_line(
            f"frogkick: the planner gets the weights of the paper and depth 1, not its robot's: {error}"
        )
    if measure:
        with shown(progress, "measuring") as tell:
            figures = measure_emitted(image, config, progress=tell)
    named = "" if robot is None or isinstance(robot, Robot) else f" --robot {Path(robot).name}"
    command = f"frogkick codegen {name}{named} --out {Path(out).name}"
    return emit(image, out, command, config, robot_sha256, figures)


def measure_emitted(
    image: bytes,
    config: PlanConfig | None = None,
    states: Mapping[int, int] = STATES,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Figures:
    """Generate the C code of a table, build it for the chip, and measure it.

    The same table gives the same figures on every machine. Without ``config`` the weights are the paper's;
    ``states`` is the number of decisions to time at each depth.
    """
    # These cannot be loaded without the extra.
    from frogkick.pool.chip.image import Layouts, load_image
    from frogkick.pool.chip.stack import StackAnalysis
    from frogkick.runs.chip_check import CYCLES_PER_MS, ChipPlanner

    settings = config or PlanConfig()
    with tempfile.TemporaryDirectory(prefix="frogkick-measure-") as folder:
        work = Path(folder).resolve()
        emit(image, work / "emitted", "frogkick codegen", settings)
        elf = build_planner(work / "emitted", work / "planner.elf")
        planner = ChipPlanner(elf)
        times = _times(planner, open_image(image), settings, states, progress)
        stack = StackAnalysis(elf)
        types = Layouts(elf)
        content = load_image(elf)
        others = {*NOT_PLANNER, "fk_table_bytes", "fk_table_image", "fk_table_image_bytes"}
        symbols = content.symbols  # the start-up code has no variables
        variables = (symbols[f"fk_{part}_end"] - symbols[f"fk_{part}_begin"] for part in ("data", "bss"))
        return Figures(
            compiler=f"{zig('chip').version} cc",
            flags=STANDARD[-1],  # what size and speed depend on
            code_bytes=sum(size for name, size in content.sizes.items() if name not in others),
            ram_bytes={name: types[name].itemsize for name in _TYPES},
            static_bytes=sum(variables),
            stack_bytes={name: stack.bound(name).total_bytes for name in _FUNCTIONS},
            open_ms=planner.open_cycles / CYCLES_PER_MS,
            times=times,
        )


def _times(
    planner: ChipPlanner,
    tables: Tables,
    config: PlanConfig,
    states: Mapping[int, int],
    progress: Callable[[int, int], None],
) -> dict[int, DepthTime]:
    """Return the decisions at each depth, spread over the paths, with the most expensive depth first."""
    from frogkick.runs.chip_check import CYCLES_PER_MS, states_for_timing

    shares = {depth: -(-states[depth] // len(SHAPES)) for depth in sorted(states, reverse=True)}
    found, done = {}, 0
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


def sizes_of(built: Firmware, report: ChipReport) -> dict[str, Any]:
    """The keys of the command ``firmware size``: bytes, and shares of the chip's memory."""
    chip = CHIPS[built.target]
    return {
        "flash_bytes": built.flash_bytes,
        "flash_of_chip": round(built.flash_bytes / chip.flash_bytes, 4),
        "ram_bytes": built.ram_bytes,
        "ram_of_chip": round(built.ram_bytes / chip.ram_bytes, 4),
        "stack_bytes": report.stack_bytes,
        "stack_bound_bytes": report.stack_bound_bytes,
        "stack_bound_chain": list(report.stack_chain),
        "stack_reserved_bytes": built.stack_bytes,
    }


def checks_of(built: Firmware, report: ChipReport) -> dict[str, Any]:
    """The keys of the command ``firmware test``."""
    return {
        "passed": report.passed,
        "checks": {name: "ok" if ok else "FAILED" for name, ok in report.checks.items()},
        "plan_ms": report.plan_ms,
        "plan_cycles": report.plan_cycles,
        "flash_bytes": built.flash_bytes,
        "ram_bytes": built.ram_bytes,
        "stack_bytes": report.stack_bytes,
        "stack_bound_bytes": report.stack_bound_bytes,
    }


def try_firmware(
    table: Table | Path | str | None = None, robot: Robot | str | None = None, progress: Progress = False
) -> tuple[Firmware, ChipReport]:
    """Build the bench image around a table (None: the default one) and test it on the virtual chip.

    The files of the build are deleted.
    """
    require_tools("bench")
    from frogkick.runs.chip_check import check_on_chip  # it cannot be loaded without the extra

    used = load_table(table, robot)
    with ExitStack() as stack:
        image = stack.enter_context(used.file())
        built = stack.enter_context(built_firmware("bench", image, used.robot))
        tell = stack.enter_context(shown(progress, "virtual chip"))
        return built, check_on_chip(built.image, used.tables, used.robot, tell)


def flash_firmware(
    image: Path | None = None,
    *,
    table: Table | Path | str | None = None,
    robot: Robot | str | None = None,
    probe: str | None = None,
    progress: Progress = False,
) -> dict[str, Any]:
    """Flash the bench image into a development kit through its debug probe.

    The arguments are the options of the command ``firmware flash``. Returned are the keys that it prints: the
    probe's name, the image's bytes.
    """
    if image is not None and table is not None:
        raise InputError("give either --image or --tables, not both: an image already contains its table")
    require("flashing", "pyocd")
    if image is None:
        require_tools("bench")
    with ExitStack() as stack:
        if image is None:
            used = load_table(table, robot)
            file = stack.enter_context(used.file())
            image = stack.enter_context(built_firmware("bench", file, used.robot)).files["hex"]
        length = check_image(existing_file(image, "image"))
        tell = stack.enter_context(shown(progress, "flash"))
        return {"probe": flash(image, probe, tell), "bytes": length}
