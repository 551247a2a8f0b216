"""Functions called on the core alone: results of the counted calls, and what fails is told."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench_build import build

from frogkick.pool.chip import ChipError, VirtualChip, uncounted
from frogkick.pool.chip.bus import RAM_BASE
from frogkick.pool.chip.uncounted import UncountedCalls


@pytest.fixture
def chip(tmp_path: Path) -> VirtualChip:
    chip = VirtualChip(build([Path(__file__).with_name("called.c")], tmp_path / "program.elf"))
    chip.run_until(2000)
    return chip


def test_a_function_gives_what_it_gives_on_the_chip(chip: VirtualChip) -> None:
    alone = UncountedCalls(chip)
    assert alone.call("sum", 1, 10, 100, 1000, 10_000, 100_000) == 654_321
    assert alone.call("scaled", 2.5, 10, 4.0) == chip.call("scaled", 2.5, 10, 4.0)[0] == 29
    assert alone.call("slow", 10) == 7


def test_its_ram_is_a_copy(chip: VirtualChip) -> None:
    chip.ram_write(RAM_BASE, b"\x01\x02")
    alone = UncountedCalls(chip)
    assert alone.ram_read(RAM_BASE, 2) == b"\x01\x02"
    alone.ram_write(RAM_BASE, b"\x03")
    assert (alone.ram_read(RAM_BASE, 2), chip.ram_read(RAM_BASE, 2)) == (b"\x03\x02", b"\x01\x02")


def test_what_fails_is_told(chip: VirtualChip, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = UncountedCalls(chip)
    with pytest.raises(ChipError, match="broken failed at 0x"):
        alone.call("broken")
    with pytest.raises(ChipError, match="no symbol 'nothing'"):
        alone.call("nothing")
    monkeypatch.setattr(uncounted, "_LONGEST", 1000)
    with pytest.raises(ChipError, match="slow has not returned after 1000 instructions"):
        alone.call("slow", 1_000_000)
    assert alone.call("slow", 3) == 7
