"""The bench image has none of what a chip without an operating system should not need."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench_build import build_text
from elftools.elf.elffile import ELFFile
from tests.planner import synthetic

from frogkick.core.errors import FrogkickError
from frogkick.core.files import write_bytes
from frogkick.pool.chip.image import UNWANTED, load_image, unwanted
from frogkick.pool.chip.stack import StackAnalysis
from frogkick.robot import load_robot
from frogkick_codegen import firmware
from frogkick_codegen.firmware import Firmware

PROGRAM = """#include <stdint.h>
int main(void);
extern volatile {kind} first; extern volatile {kind} second;
volatile {kind} first = 3, second = 5;
{helper}
int main(void) {{ {body} for (;;) {{ }} }}
"""
USES = {
    "64-bit division": ("uint64_t", "__aeabi_uldivmod", "first = first / second;"),
    "float arithmetic in software": (
        "uint64_t",
        "__aeabi_ul2f",
        "volatile float f = (float)first; (void)f;",
    ),
    "double": ("double", "__aeabi_dadd", "first = first + second;"),
    "libm": ("float", "sinf", "first = sinf(second);"),
    "heap": ("uint32_t", "malloc", "first = (uint32_t)(uintptr_t)malloc(second);"),
}
DECLARED = {
    "libm": "float sinf(float x);",
    "heap": "void *malloc(__SIZE_TYPE__ n);",
}
DEFINED = """__attribute__((naked, used)) void helper(void) __asm__("{name}");
void helper(void) {{ __asm__("bx lr"); }}"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Firmware:
    """The whole bench firmware around a table; by these names the one of test_parity_places.py too."""
    file = tmp_path_factory.mktemp("bench") / "nearest.fkt"
    write_bytes(file, synthetic.image())
    return firmware.build("bench", file, load_robot("frog2022"), file.parent / "out")


def test_the_bench_image_has_nothing_unwanted(bench: Firmware) -> None:
    symbols = load_image(bench.image).symbols
    assert unwanted(symbols) == []
    assert {"fk_plan", "fk_robot_tick", "fk_estimator_at", "main"} <= set(symbols)


def test_the_bound_of_the_bench_image_s_stack_fits_its_reserve(bench: Firmware) -> None:
    bound = StackAnalysis(bench.image).bound()
    assert bound.indirect == ()
    assert "fk_plan" in [name for name, _ in bound.chain]
    assert bound.total_bytes <= bench.stack_bytes


@pytest.mark.parametrize("what", sorted(UNWANTED))
def test_each_unwanted_thing_is_found_when_it_is_put_in(what: str, tmp_path: Path) -> None:
    kind, name, body = USES[what]
    source = PROGRAM.format(kind=kind, helper=DECLARED.get(what, ""), body=body)
    options = ("-Wno-conversion", "-Wno-missing-prototypes", "-Wno-double-promotion")
    # Without a library the link fails: no image with it can be made unnoticed.
    with pytest.raises(AssertionError, match=f"undefined symbol: {name}"):
        build_text(source, tmp_path, *options, drivers=True)
    # With one, the image's symbols tell.
    source = PROGRAM.format(kind=kind, helper=DECLARED.get(what, "") + DEFINED.format(name=name), body=body)
    elf = build_text(source, tmp_path, *options, drivers=True)
    assert unwanted(load_image(elf).symbols) == [f"{name}: {what}"]


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("__aeabi_ldivmod", "64-bit division"),
        ("__udivdi3", "64-bit division"),
        ("__udivmoddi4", "64-bit division"),
        ("__aeabi_fadd", "float arithmetic in software"),
        ("__aeabi_fcmplt", "float arithmetic in software"),
        ("__addsf3", "float arithmetic in software"),
        ("__aeabi_ddiv", "double"),
        ("__aeabi_f2d", "double"),
        ("__muldf3", "double"),
        ("sqrt", "libm"),
        ("sqrtf", "libm"),
        ("atan2f", "libm"),
        ("expf", "libm"),
        ("_malloc_r", "heap"),
        ("_sbrk", "heap"),
        ("free", "heap"),
    ],
)
def test_names_of_unwanted_helpers(name: str, what: str) -> None:
    assert unwanted([name]) == [f"{name}: {what}"]


@pytest.mark.parametrize(
    "name",
    ["__aeabi_memclr4", "__aeabi_memcpy", "memset", "fk_sincos", "fk_float_check", "main", "fk_path_free"],
)
def test_names_of_what_may_be_there(name: str) -> None:
    assert unwanted([name]) == []


def test_a_stripped_image_has_no_bound(tmp_path: Path) -> None:
    elf = build_text(
        PROGRAM.format(kind="float", helper="", body=""), tmp_path, "-Wl,--strip-all", drivers=True
    )
    with pytest.raises(FrogkickError, match="unstripped"):
        StackAnalysis(elf).bound()


def test_a_symbol_of_a_kind_without_a_name_is_read(tmp_path: Path) -> None:
    elf = build_text(PROGRAM.format(kind="float", helper="", body=""), tmp_path, drivers=True)
    whole = load_image(elf)
    with elf.open("rb") as file:
        table = ELFFile(file).get_section_by_name(".symtab")
        place = [symbol.name for symbol in table.iter_symbols()].index("fk_stack_top")
        kind_at = table["sh_offset"] + place * table["sh_entsize"] + 12  # st_info
    content = bytearray(elf.read_bytes())
    content[kind_at] = content[kind_at] & 0xF0 | 11  # between STT_LOOS and STT_HIOS
    write_bytes(elf, bytes(content))
    odd = load_image(elf)
    assert odd.symbols == whole.symbols and odd.functions == whole.functions
