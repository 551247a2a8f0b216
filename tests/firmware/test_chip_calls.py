"""Functions of a firmware called from outside: their arguments, their cycles, their structures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench_build import build

from frogkick.pool.chip import ChipError, VirtualChip
from frogkick.pool.chip.image import Layouts
from frogkick.pool.chip.stack import StackAnalysis


@pytest.fixture
def called(tmp_path: Path) -> VirtualChip:
    chip = VirtualChip(build([Path(__file__).with_name("called.c")], tmp_path / "program.elf"))
    chip.run_until(2000)
    assert chip.sleeping
    return chip


def test_a_function_is_called_with_words_on_registers_and_stack_and_floats(called: VirtualChip) -> None:
    assert called.call("sum", 1, 10, 100, 1000, 10_000, 100_000)[0] == 1 + 20 + 300 + 4000 + 50_000 + 600_000
    assert called.call("scaled", 2.5, 10, 4.0)[0] == 29


def test_a_call_leaves_the_program_as_it_was(called: VirtualChip, tmp_path: Path) -> None:
    stack = called.stack_high_water_bytes()
    for turns in (1, 10):
        called.call("slow", turns)
    assert called.sleeping
    called.run_until(called.time_us + 1000)
    assert called.sleeping
    # Its stack lay below that of the program, as deep as the analysis says.
    bound = StackAnalysis(tmp_path / "program.elf").bound("slow")
    assert called.stack_high_water_bytes() == stack + bound.total_bytes


def test_a_call_s_cycles_are_those_of_its_instructions(called: VirtualChip) -> None:
    found = [called.call("slow", turns)[1] for turns in (100, 200, 300, 100)]
    per_turn = (found[1] - found[0]) / 100
    assert found[2] - found[1] == found[1] - found[0]
    assert found[3] == found[0]
    assert per_turn == pytest.approx(
        3 + 1 + 1 + 3 + 5, abs=0.1
    )  # nops, subs, bne, its refill, no cache: a wait each


def test_the_profile_adds_up_and_names_functions(called: VirtualChip) -> None:
    profile = called.profile()
    cycles = called.call("slow", 50)[1] + called.call("sum", 1, 2, 3, 4, 5, 6)[1] + called.call("slow", 50)[1]
    functions = {one.name: one for one in profile.functions()}
    assert set(functions) == {"slow", "sum"}
    assert (functions["slow"].calls, functions["sum"].calls) == (2, 1)
    # The last instruction of a call has its refill outside, where nothing comes after it.
    assert sum(one.cycles for one in functions.values()) == pytest.approx(cycles, rel=0.05)
    assert max(profile.visits) == 100


def test_structures_are_read_and_written_by_their_members_names(called: VirtualChip, tmp_path: Path) -> None:
    types = Layouts(tmp_path / "program.elf")
    assert types["fk_inner_t"].itemsize == 12
    assert types["fk_outer_t"].itemsize == 40
    assert "fk_nothing_t" not in types
    with pytest.raises(ChipError, match="no type 'fk_nothing_t'"):
        types["fk_nothing_t"]
    outer = np.zeros((), dtype=types["fk_outer_t"])
    outer["count"] = 21
    outer["inner"][0]["small"] = 200
    outer["inner"][0]["value"] = 3.0
    outer["wide"] = (1 << 32) - 1
    address = called.symbol("fk_bss_end") + 7 & ~7
    called.ram_write(address, outer.tobytes())
    assert called.call("fill", address)[0] == 200
    after = np.frombuffer(called.ram_read(address, outer.itemsize), dtype=outer.dtype)[0]
    assert (after["inner"][1]["pair"][1], after["inner"][1]["value"], after["wide"]) == (-42, 1.5, 1 << 32)


def test_a_call_that_faults_or_cannot_be(called: VirtualChip, tmp_path: Path) -> None:
    with pytest.raises(ChipError, match="no symbol 'nothing'"):
        called.call("nothing")
    with pytest.raises(ChipError, match="hard fault"):
        called.call("broken")
    awake = VirtualChip(tmp_path / "program.elf")
    with pytest.raises(ChipError, match="the chip is awake"):
        awake.call("sum", 1)
