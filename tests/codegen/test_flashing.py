"""Flashing a kit: what is refused before the chip is touched, and what is written. No probe hangs here."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
from intelhex import IntelHex
from tests.cli.commands import frogkick
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick_codegen import probe
from frogkick_codegen.probe import PART, PART_ADDRESS, TARGET, ProbeError, check_image, flash


@pytest.fixture(scope="module")
def image() -> Path:
    return rig.firmware("bench").files["hex"]


class Chip(AbstractContextManager["Chip"]):
    """A session with a probe: a chip that says what it is, and remembers what was done to it."""

    def __init__(self, part: int = PART) -> None:
        self.done: list[str] = []
        self.probe = SimpleNamespace(description="a probe")
        self.target = SimpleNamespace(
            read32=lambda address: part if address == PART_ADDRESS else 0,
            reset=lambda: self.done.append("reset"),
        )

    def __exit__(self, *_error: object) -> None:
        self.done.append("closed")


def programming(done: list[str], fails: bool = False) -> Callable[..., Any]:
    def program(path: str, file_format: str) -> None:
        if fails:
            raise RuntimeError("SWD/JTAG communication failure")
        done.append(f"{file_format} of {IntelHex(path).segments()[0][0]}")

    return lambda _session, _progress: SimpleNamespace(program=program)


def test_the_image_is_written_and_started(image: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chip = Chip()
    monkeypatch.setattr(probe, "_programmer", programming(chip.done))
    assert flash(image, None, connect=lambda _id: chip) == "a probe"
    assert chip.done == ["hex of 0", "reset", "closed"]


def test_another_chip_is_left_alone(image: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chip = Chip(0x52840)
    monkeypatch.setattr(probe, "_programmer", programming(chip.done))
    with pytest.raises(ProbeError, match="says it is an nRF52840, the image is for the nRF52832"):
        flash(image, None, connect=lambda _id: chip)
    assert chip.done == ["closed"]


def test_a_broken_cable_is_one_line(image: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chip = Chip()
    monkeypatch.setattr(probe, "_programmer", programming(chip.done, fails=True))
    with pytest.raises(ProbeError, match=r"failed \(RuntimeError: SWD/JTAG communication failure\): check"):
        flash(image, None, connect=lambda _id: chip)
    assert chip.done == ["closed"]


def test_pyocd_knows_the_chip_and_how_to_program_it() -> None:
    """Its own target and programmer, as far as they go without a probe."""
    from pyocd.core.memory_map import MemoryType
    from pyocd.flash.file_programmer import FileProgrammer
    from pyocd.target import TARGET as targets

    known = targets[TARGET].MEMORY_MAP
    region = known.get_first_matching_region(type=MemoryType.FLASH, is_boot_memory=True)
    assert (region.start, region.length) == (0, probe.FLASH_BYTES)
    made = probe._programmer(MagicMock(), lambda _done, _all: None)
    assert isinstance(made, FileProgrammer)


def test_what_is_no_image_is_refused(image: Path, tmp_path: Path) -> None:
    assert 0 < check_image(image) <= probe.FLASH_BYTES
    (tmp_path / "text.hex").write_text("no hex\n")
    (tmp_path / "empty.hex").write_text(":00000001FF\n")
    beyond = IntelHex()
    beyond.puts(probe.FLASH_BYTES - 1, b"ab")
    text = io.StringIO()
    beyond.write_hex_file(text)
    (tmp_path / "beyond.hex").write_text(text.getvalue())
    for name, complaint in (
        ("text.hex", "is no Intel HEX"),
        ("empty.hex", "is empty: build it again"),
        ("beyond.hex", "has bytes at 0x80000, the chip's flash ends at 0x80000"),
    ):
        with pytest.raises(InputError, match=complaint):
            check_image(tmp_path / name)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--image", "IMAGE"), "no debug probe is plugged in: plug in"),
        (("--image", "IMAGE", "--probe", "12"), "no debug probe whose number begins with '12'"),
        (("--image", "none.hex"), "'none.hex' does not exist"),
        (("--image", "IMAGE", "--tables", "x.fkt"), "give either --image or --tables"),
    ],
)
def test_the_command(
    image: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], words: str
) -> None:
    output = frogkick(
        capsys, "firmware", "flash", *[str(image) if word == "IMAGE" else word for word in options]
    )
    assert (output.code, output.stdout) == (2, "")
    assert output.stderr.count("\n") == 1 and words in output.stderr, output.stderr
