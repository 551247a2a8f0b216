"""Built firmware is kept for its content: not compiled twice, and never another one's."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from tests.codegen import made_up
from tests.conftest import from_ci
from tests.runs import rig

from frogkick.core.files import cache_folder
from frogkick.robot import Robot, load_robot
from frogkick_codegen import firmware, toolchain
from frogkick_codegen.firmware import TARGETS, build
from frogkick_codegen.toolchain import Compiler, firmware_sources

ROBOT = load_robot("frog2022")


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """A cache folder of the test's own, and what a compiler was called for.

    Of firmware it makes what others use as well: here it matters who is called.
    """
    built = {image.suffix: image.read_bytes() for image in (rig.firmware(name).image for name in TARGETS)}
    for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"):  # which takes seconds to fill
        monkeypatch.setenv(name, str(cache_folder("zig")))
    monkeypatch.setenv("FROGKICK_CACHE_DIR", str(tmp_path / "cache"))
    made: list[Path] = []
    run = Compiler.run

    def counted(self: Compiler, arguments: list[str | Path], folder: Path | None = None) -> None:
        output = Path(arguments[-1])
        made.append(output)
        if output.suffix in built:
            output.write_bytes(built[output.suffix])
        else:
            run(self, arguments, folder)

    monkeypatch.setattr(Compiler, "run", counted)
    return made


def table(folder: Path, kind: str = "affine") -> Path:
    file = folder / f"{kind}.fkt"
    file.write_bytes(made_up.image(kind))
    return file


@pytest.mark.parametrize("target", TARGETS)
def test_the_same_firmware_is_compiled_once(target: str, tmp_path: Path, calls: list[Path]) -> None:
    first = build(target, table(tmp_path), ROBOT, tmp_path / "one")
    again = build(target, table(tmp_path), ROBOT, tmp_path / "two")
    assert len(calls) == 1
    assert again.image.read_bytes() == first.image.read_bytes()
    assert again.image.name == first.image.name
    assert (again.flash_bytes, again.ram_bytes, again.stack_bytes) == (
        first.flash_bytes,
        first.ram_bytes,
        first.stack_bytes,
    )
    assert {file.name for file in (tmp_path / "two").iterdir()} == {
        file.name for file in (tmp_path / "one").iterdir()
    }


@from_ci
def test_whatever_is_read_or_said_makes_another_one(
    tmp_path: Path, calls: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Target, table, robot, sources, headers, linker script, flags and compiler."""
    file = table(tmp_path)
    guard = replace(ROBOT.guard, pulse_max_s=0.9 * ROBOT.guard.pulse_max_s)

    def is_new(robot: Robot = ROBOT, image: Path = file, target: str = "bench") -> bool:
        before = len(calls)
        build(target, image, robot, tmp_path / f"out{before}")
        return len(calls) == before + 1

    assert is_new()
    assert is_new(target="native")
    assert is_new(image=table(tmp_path, "nearest"))
    assert is_new(robot=replace(ROBOT, guard=guard))
    for number, name in enumerate(
        ("core/fk_guard.c", "core/fk_guard.h", "bench/clock.h", "bench/nrf52832.ld")
    ):
        copy = tmp_path / f"sources{number}"
        shutil.copytree(firmware_sources(), copy)
        (copy / name).write_text("/* Changed. */\n" + (copy / name).read_text())
        with monkeypatch.context() as changed:
            changed.setattr(firmware, "firmware_sources", lambda folder=copy: folder)
            assert is_new(), name
    with monkeypatch.context() as changed:
        changed.setattr(firmware, "FLAGS", (*firmware.FLAGS, "-DFK_ANOTHER=1"))
        assert is_new()
    with monkeypatch.context() as changed:
        changed.setattr(toolchain, "_version_of_zig", lambda _driver: "another")
        assert is_new()
    assert not is_new()


@from_ci
def test_where_firmware_is_built_what_has_not_changed_stays_and_nothing_else(
    tmp_path: Path, calls: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """So zig compiles only the table: lines that name it are blank there, and others keep their numbers."""
    copy = tmp_path / "sources"
    shutil.copytree(firmware_sources(), copy)
    (copy / "core" / "fk_more.c").write_text("/* More. */\n")
    with monkeypatch.context() as changed:
        changed.setattr(firmware, "firmware_sources", lambda: copy)
        build("bench", table(tmp_path), ROBOT, tmp_path / "one")
    work = calls[-1].parent
    more, tree = work / "firmware" / "core" / "fk_more.c", work / "emitted" / "tree.c"
    assert more.exists()
    written_ns = tree.stat().st_mtime_ns
    build("bench", table(tmp_path, "nearest"), ROBOT, tmp_path / "two")
    assert calls[-1].parent == work and len(calls) == 2
    assert not more.exists() and tree.stat().st_mtime_ns == written_ns
    built = sorted((work / "emitted").iterdir())
    assert "fk_table.c" in [file.name for file in built]
    for file in (*built, work / "config" / "fk_robot_config.h"):
        given = tmp_path / "two" / ("emitted" if file in built else "") / file.name
        here, there = file.read_bytes(), given.read_bytes()
        assert here != there and there.endswith(here.lstrip(b"\n")), file.name
        assert here.count(b"\n") == there.count(b"\n"), file.name


@from_ci
def test_a_damaged_one_is_not_believed(tmp_path: Path, calls: list[Path]) -> None:
    whole = build("native", table(tmp_path), ROBOT, tmp_path / "one").image.read_bytes()
    assert len(whole) > 10_000
    (file,) = (tmp_path / "cache" / "firmware").iterdir()
    for damaged in (b"", file.read_bytes()[:-4], b"\0" + file.read_bytes()[1:]):
        before = len(calls)
        file.write_bytes(damaged)
        assert build("native", table(tmp_path), ROBOT, tmp_path / "again").image.read_bytes() == whole
        assert len(calls) == before + 1


def test_only_so_many_are_kept_and_the_last_wanted_stay(
    tmp_path: Path, calls: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(toolchain, "KEPT_MAX", 2)
    source = tmp_path / "small.c"

    def compiled(number: int) -> int:
        source.write_text(f"int fk_small(void);\nint fk_small(void) {{ return {number}; }}\n")
        toolchain.built_once(toolchain.zig(), ["-c"], [source], [source], tmp_path / "small.o")
        return len(calls)

    assert [compiled(number) for number in (1, 2, 1, 3, 1, 2)] == [1, 2, 2, 3, 3, 4]
    assert len(list((tmp_path / "cache" / "firmware").iterdir())) == 2
