"""The compiler that most firmware is built with accepts all of ours, with every warning an error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile
from tests.conftest import REPOSITORY, count
from tests.extra.tools import chip_compiler, emitted_firmware
from tests.planner import synthetic

from frogkick.paths import shape
from frogkick.planner.plan import (
    PLAN_TIME_WATCHDOG_US,
    PlanConfig,
    config_of,
    transitions_of,
    transitions_within,
)
from frogkick.pool.chip.image import load_image, unwanted
from frogkick.pool.chip.stack import StackAnalysis
from frogkick.robot import load_robot
from frogkick.runs.chip_check import ChipPlanner, check_on_chip, states_for_timing
from frogkick.tables.image import open_image
from frogkick_codegen.emit import SOURCES
from frogkick_codegen.firmware import image_sizes
from frogkick_codegen.toolchain import FLAGS, ToolchainError

pytestmark = pytest.mark.extra

ROBOT = load_robot("frog2022")
CORE = REPOSITORY / "firmware" / "core"
BENCH = REPOSITORY / "firmware" / "bench"
# More than the project's own flags: what gcc knows and clang does not.
STRICTER = (
    "-Wshadow", "-Wstrict-prototypes", "-Wundef", "-Wcast-align", "-Wlogical-op", "-Wduplicated-cond",
    "-Wduplicated-branches", "-Wvla", "-Wwrite-strings", "-Wfloat-conversion",
)  # fmt: skip


def robot_image() -> bytes:
    """Return a made-up table with the real robot's actions, which its guard lets pass."""
    rows = [(one.name, one.first_mask, one.second_mask) for one in ROBOT.actions]
    return synthetic.pack(*synthetic.transitions(300, len(rows), 1), action_rows=rows)


def build_bench(folder: Path, *options: str) -> Path:
    """Build the bench image of the emitted table with ARM gcc, as firmware/bench/README.md says."""
    driver, libraries = chip_compiler("arm-none-eabi-gcc")
    emitted, config = emitted_firmware(robot_image(), folder)
    sources = [*(emitted / name for name in SOURCES), *sorted(CORE.glob("*.c")), *sorted(BENCH.glob("*.c"))]
    elf = folder / "bench.elf"
    driver.run(
        [
            *FLAGS, *options, "-ffunction-sections", "-fdata-sections",
            f"-I{emitted}", f"-I{config}", f"-I{CORE}", f"-I{BENCH}",
            "-nostdlib", f"-Wl,-T,{BENCH / 'nrf52832.ld'}", "-Wl,--gc-sections", "-Wl,--entry=fk_reset",
            "-Wl,--fatal-warnings", *sources, *libraries, "-o", elf,
        ]
    )  # fmt: skip
    return elf


@pytest.mark.parametrize("level", ["-O2", "-Os", "-O0"])
def test_arm_gcc_builds_the_whole_bench_image(tmp_path: Path, level: str) -> None:
    elf = build_bench(tmp_path, level)
    flash_bytes, ram_bytes, stack_bytes = image_sizes(elf)  # raises where the chip is too small
    assert len(robot_image()) < flash_bytes
    assert stack_bytes < ram_bytes
    with elf.open("rb") as file:
        symbols = {one.name for one in ELFFile(file).get_section_by_name(".symtab").iter_symbols()}
    assert {"fk_plan", "fk_robot_tick", "fk_table_image"} <= symbols
    assert unwanted(symbols) == []
    assert [name for name in symbols if "printf" in name] == []


DIVISION = """#include <stdint.h>
uint64_t fk_share(uint64_t whole, uint64_t parts);
uint64_t fk_share(uint64_t whole, uint64_t parts) { return whole / parts; }
"""


def test_a_division_that_libgcc_does_is_found(tmp_path: Path) -> None:
    """With gcc's library on the link line nothing fails: the image's symbols tell."""
    source = tmp_path / "share.c"
    source.write_text(DIVISION)
    elf = build_bench(tmp_path, str(source), "-Wl,--undefined=fk_share")
    found = unwanted(load_image(elf).symbols)
    assert "__aeabi_uldivmod: 64-bit division" in found
    report = check_on_chip(elf, open_image(robot_image()), ROBOT)
    assert [name for name, passed in report.checks.items() if not passed] == [
        "no 64-bit division, soft float, double, libm or heap"
    ]


def test_the_analysis_of_the_stack_agrees_with_the_compiler_s_own(tmp_path: Path) -> None:
    """gcc writes down what each function puts on the stack; the machine code says the same."""
    elf = build_bench(tmp_path, "-fstack-usage")
    analysis = StackAnalysis(elf)
    reported: dict[str, int] = {}
    for file in tmp_path.glob("*.su"):
        for line in file.read_text().splitlines():
            place, size, kind = line.split("\t")
            assert kind == "static", line  # no alloca, no array of variable length
            reported[place.rsplit(":", 1)[1]] = int(size)
    common = sorted(set(reported) & set(analysis.functions))
    assert len(common) > 60
    assert {name: analysis.own_bytes(name) for name in common} == {name: reported[name] for name in common}


def test_the_image_of_arm_gcc_passes_the_trial_on_the_virtual_chip(tmp_path: Path) -> None:
    """Frames, strokes, limits, plans of every depth and the stack's mark, as the demo tries zig's image."""
    report = check_on_chip(build_bench(tmp_path), open_image(robot_image()), ROBOT)
    assert [name for name, passed in report.checks.items() if not passed] == []
    assert len(report.checks) > 10


WATCHDOG_US = 980_000


@pytest.mark.parametrize("level", ["-O2", "-Os"])
def test_the_longest_plan_of_arm_gcc_ends_before_the_watchdog(tmp_path: Path, level: str) -> None:
    """By the most that the manuals allow an instruction; zig's image is timed by `study chip`."""
    planner, tables = ChipPlanner(build_bench(tmp_path, level, "-g")), open_image(robot_image())
    path = shape("ellipse")
    planner.configure(path, replace(config_of(ROBOT.planner), depth=3))
    timed = states_for_timing(tables, path, count(16, 400), np.random.default_rng(3))
    depths = np.full(len(timed.states), 3, dtype=np.int32)
    rows, cycles = planner.plan(timed.states, depths, timed.limb_use, timed.along_points)
    many = rows["transitions"] > 100
    per_transition_us = (cycles[many] / 64.0 / rows["transitions"][many]).max()
    print(f"{level}: {per_transition_us:.2f} us for a transition, with its share of all else")
    assert many.sum() > 5 and per_transition_us > 10.0
    assert transitions_within(PLAN_TIME_WATCHDOG_US) * per_transition_us < WATCHDOG_US
    # The paper's cost, by the distance alone and in a place where it prunes nothing: far beside the path.
    planner.configure(path, PlanConfig(angle_weight_per_rad=50.0, progress_weight=0.0))
    far = np.array([[0.0, -900.0, -1.0, 0.0, 0.0, 0.0]], dtype=np.float32)
    rows, cycles = planner.plan(far, np.array([3], dtype=np.int32))
    per_transition_us = cycles[0] / 64.0 / rows["transitions"][0]
    print(f"{level}: {per_transition_us:.2f} us with the paper's cost")
    assert rows["transitions"][0] > 500 and per_transition_us > 45.0
    assert transitions_of(tables) * per_transition_us < WATCHDOG_US


def test_arm_gcc_finds_nothing_with_stricter_warnings(tmp_path: Path) -> None:
    build_bench(tmp_path, *STRICTER)


def test_a_warning_stops_the_build(tmp_path: Path) -> None:
    driver, _ = chip_compiler("arm-none-eabi-gcc")
    source = tmp_path / "wrong.c"
    source.write_text("float half(float x);\nfloat half(float x)\n{\n    return (float)(x * 0.5);\n}\n")
    with pytest.raises(ToolchainError, match="double-promotion"):
        driver.run([*FLAGS, "-c", source, "-o", tmp_path / "wrong.o"])
