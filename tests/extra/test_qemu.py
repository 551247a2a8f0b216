"""A second opinion on a Cortex-M4 that is not ours: QEMU plans what the Python twin plans, bit for bit.

The virtual chip's core comes from QEMU too, but here the set-up of the float unit, the memory map, the linker
script and, with ARM gcc, the compiler are others.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile
from tests.codegen import made_up
from tests.conftest import count
from tests.extra.tools import chip_compiler, emitted_firmware, program, run
from tests.planner import synthetic

from frogkick.planner.kernel import PLAN_ROW
from frogkick.planner.plan import PlanConfig, config_of, path_rows, plan_batch
from frogkick.robot import load_robot
from frogkick.tables.image import open_image
from frogkick_codegen.emit import SOURCES
from frogkick_codegen.parity import KINDS, Cases, compare, make_cases
from frogkick_codegen.toolchain import FLAGS, zig

pytestmark = pytest.mark.extra

BOARD = Path(__file__).resolve().parent / "qemu"
COMPILERS = ("zig", "arm-none-eabi-gcc")
IMAGE = synthetic.image()
TABLES = open_image(IMAGE)
PATH = synthetic.wave_path()
CONFIGS = {
    "paper": PlanConfig(),
    "route within a budget": dataclasses.replace(
        config_of(load_robot("frog2022").planner), transitions_max=150
    ),
}
STATES = -(-count(20_000, 1_000_000, 10_000) // (len(COMPILERS) * len(made_up.KINDS) * len(CONFIGS)))
"""Of each compiler, kind and cost: 10^5 in all, 10^6 in make test-full."""
BATCH = 12_500  # as many as fit into the board's memory for code
SEED = 386
ERROR_FLOAT_RULES = -10  # FK_ERROR_FLOAT_RULES in fk_tables.h
EXIT_FAULT = 9  # FK_EXIT_FAULT in startup.h
NO_COPROCESSOR = 1 << 19  # UFSR.NOCP in CFSR: ARMv7-M, B3.2.15


def cases_header(cases: Cases, config: PlanConfig) -> str:
    """Return cases.h: every float as its bits."""

    def rows(values: np.ndarray) -> str:
        words = np.ascontiguousarray(values, dtype=np.float32).view(np.uint32)
        return ",\n".join("    {" + ", ".join(f"0x{word:08x}u" for word in row) + "}" for row in words)

    path = path_rows(PATH)
    weights = ", ".join(f"0x{word:08x}u" for word in config.weights().view(np.uint32))
    return f"""/* Made by tests/extra/test_qemu.py from seed {cases.seed}. Do not edit. */
#include <stdint.h>
#define FK_CASES {len(cases.states)}u
#define FK_CASE_POINTS {path.shape[1]}u
#define FK_CASE_COST {int(config.cost)}u
#define FK_CASE_TRANSITIONS_MAX {config.transitions_max}u
static const uint32_t fk_case_weights[] = {{{weights}}};
static const uint32_t fk_case_path[3][FK_CASE_POINTS] = {{
{rows(path)}
}};
static const uint8_t fk_case_depths[FK_CASES] = {{{", ".join(f"{depth}u" for depth in cases.depths)}}};
static const uint32_t fk_case_states[FK_CASES][7] = {{ /* and the place along the path */
{rows(np.column_stack([cases.states, cases.along_points]))}
}};
static const uint16_t fk_case_limb_use[FK_CASES][8] = {{
{",".join("{" + ", ".join(f"{use}u" for use in row) + "}" for row in cases.limb_use)}
}};
"""


def build_hosted(cases: Cases, folder: Path, target: str, image: bytes, config: PlanConfig) -> Path:
    """The same program for an operating system, by zig."""
    emitted, _ = emitted_firmware(image, folder)
    (folder / "cases.h").write_text(cases_header(cases, config))
    driver = dataclasses.replace(zig(), target_flags=("-target", target))
    sources = [BOARD / "main.c", BOARD / "hosted.c", *(emitted / source for source in SOURCES)]
    made = folder / "planner"
    driver.run([*FLAGS, f"-I{folder}", f"-I{emitted}", f"-I{BOARD}", "-static", *sources, "-o", made])
    return made


def build(
    name: str,
    cases: Cases,
    folder: Path,
    *options: str,
    image: bytes = IMAGE,
    config: PlanConfig = CONFIGS["paper"],
) -> Path:
    """Build the test program around the emitted table and the cases."""
    driver, libraries = chip_compiler(name)
    emitted, _ = emitted_firmware(image, folder)
    (folder / "cases.h").write_text(cases_header(cases, config))
    sources = [
        BOARD / "startup.c",
        BOARD / "main.c",
        BOARD / "memory.c",
        *(emitted / source for source in SOURCES),
    ]
    elf = folder / "planner.elf"
    driver.run(
        [
            *FLAGS, "-ffreestanding", "-nostdlib", *options,
            f"-I{folder}", f"-I{emitted}", f"-I{BOARD}",
            f"-Wl,-T,{BOARD / 'board.ld'}", "-Wl,--entry=fk_reset", *sources, *libraries, "-o", elf,
        ]
    )  # fmt: skip
    return elf


def boot(elf: Path) -> tuple[int, list[str]]:
    """Run an image on QEMU's board and return its exit code and the lines on its UART."""
    qemu = program("qemu-system-arm", "qemu-system-arm")
    done = run(
        [
            qemu, "-machine", "mps2-an386", "-nodefaults", "-display", "none", "-monitor", "none",
            "-serial", "stdio", "-semihosting-config", "enable=on,target=native", "-kernel", elf,
        ],
        elf.parent,
    )  # fmt: skip
    # QEMU warns on stderr about hardware that nobody uses here; it matters only if the output is not there.
    assert done.stdout, done.stderr
    return done.returncode, done.stdout.splitlines()


def decisions(lines: list[str]) -> np.ndarray:
    """Turn the UART's lines into PLAN_ROW."""
    assert lines[-1:] == ["done"], lines[-3:]
    words = np.array([[int(word, 16) for word in line.split()] for line in lines[:-1]], dtype="<u4")
    return np.ascontiguousarray(words).view(PLAN_ROW).reshape(-1)


@pytest.mark.parametrize("cost", CONFIGS)
@pytest.mark.parametrize("kind", made_up.KINDS)
@pytest.mark.parametrize("name", COMPILERS)
def test_qemu_decides_as_the_twin_does(name: str, kind: str, cost: str, tmp_path: Path) -> None:
    program("qemu-system-arm", "qemu-system-arm")
    image = made_up.image(kind)
    tables, config = open_image(image), CONFIGS[cost]
    cases = make_cases(tables, PATH, STATES, SEED)
    parts = []
    for at in range(0, STATES, BATCH):
        folder = tmp_path / str(at)
        folder.mkdir()
        elf = build(name, cases.part(at, BATCH), folder, image=image, config=config)
        code, lines = boot(elf)
        assert code == 0, lines[:3]
        parts.append(decisions(lines))
    rows = np.concatenate(parts)
    assert len(rows) == STATES
    (pair,) = compare(
        cases,
        {
            "python": lambda *given: plan_batch(tables, PATH, config, *given),
            f"qemu ({name})": lambda *given: rows,
        },
    )
    assert pair.mismatches == 0, pair.first_failure
    # What was compared is worth comparing: every kind and depth, most with a decision, some refused.
    assert set(cases.kinds.tolist()) == set(range(len(KINDS)))
    assert set(cases.depths.tolist()) == {1, 2, 3, 4}
    assert set(rows["status"].tolist()) == {0, -2, -3}
    assert (rows["status"] == 0).mean() > 0.8
    assert len(set(rows["action"].tolist())) > 3


@pytest.mark.parametrize("kind", made_up.KINDS)
def test_a_64_bit_arm_decides_as_the_twin_does(kind: str, tmp_path: Path) -> None:
    """As a lab's single-board computer or laptop has it: another instruction set, whose compiler may fuse."""
    qemu = program("qemu-aarch64", "qemu-user")
    image, config = made_up.image(kind), CONFIGS["route within a budget"]
    tables = open_image(image)
    cases = make_cases(tables, PATH, STATES, SEED + 1)
    done = run([qemu, build_hosted(cases, tmp_path, "aarch64-linux-musl", image, config)], tmp_path)
    assert done.returncode == 0, done.stderr
    rows = decisions(done.stdout.splitlines())
    places = {
        "python": lambda *given: plan_batch(tables, PATH, config, *given),
        "aarch64": lambda *given: rows,
    }
    (pair,) = compare(cases, places)
    assert len(rows) == STATES and pair.mismatches == 0, pair.first_failure


@pytest.mark.parametrize("name", COMPILERS)
def test_without_the_fpu_the_image_faults(name: str, tmp_path: Path) -> None:
    """QEMU starts with the FPU off as the chip does, so the start-up code's switch is what makes it work."""
    program("qemu-system-arm", "qemu-system-arm")
    cases = make_cases(TABLES, PATH, len(KINDS), SEED)
    code, lines = boot(build(name, cases, tmp_path, "-DFK_LEAVE_FPU_OFF"))
    assert code == EXIT_FAULT
    assert len(lines) == 1
    word, fault = lines[0].split()
    assert word == "fault"
    assert int(fault, 16) & NO_COPROCESSOR


def test_a_build_that_fuses_multiply_and_add_refuses_its_table(tmp_path: Path) -> None:
    """The Cortex-M4 has the fused instruction; its bits are not the twin's, and the start says so.

    With gcc only: zig's clang never fuses for this processor, where the fused instruction is the slower one.
    """
    program("qemu-system-arm", "qemu-system-arm")
    cases = make_cases(TABLES, PATH, len(KINDS), SEED)
    code, lines = boot(build("arm-none-eabi-gcc", cases, tmp_path, "-ffp-contract=fast"))
    assert (code, lines) == (1, [f"refused {ERROR_FLOAT_RULES & 0xFFFFFFFF:08x}"])


@pytest.mark.parametrize("name", COMPILERS)
def test_the_image_uses_the_fpu_and_no_library_for_floats(name: str, tmp_path: Path) -> None:
    elf = build(name, make_cases(TABLES, PATH, len(KINDS), SEED), tmp_path)
    with elf.open("rb") as file:
        content = ELFFile(file)
        symbols = {symbol.name for symbol in content.get_section_by_name(".symtab").iter_symbols()}
    soft = {name for name in symbols if name.startswith(("__aeabi_f", "__aeabi_d", "sqrt"))}
    assert soft == set()
