"""firmware/robot/build.sh and CMakeLists.txt, as far as they run without Zephyr."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from bench_build import build_text
from tests.extra.tools import program, run
from zephyr_robot import ROBOT

pytestmark = pytest.mark.extra

SCRIPT = ROBOT / "build.sh"
KIB = 1024


def image(folder: Path, ram: int, flash: int) -> Path:
    """Link a firmware for this chip with so much data, behind a stack of 8 KB.

    Args:
        folder: to build in.
        ram: bytes of data without first values.
        flash: bytes of constants.
    """
    source = f"""
    __attribute__((section(".store"))) const char store[4096];
    volatile char data[{ram}];
    const volatile char constants[{flash}] = {{1}};
    _Noreturn void fk_reset(void);
    _Noreturn void fk_reset(void) {{ for (;;) {{ data[constants[1] & 1] = 1; }} }}
    """
    return build_text(source, folder)


def script(*words: str | Path, folder: Path, **environment: str) -> tuple[int, str, str]:
    west = str(Path(sys.executable).parent)  # of this environment
    done = subprocess.run(
        ["bash", SCRIPT, *words],
        cwd=folder,
        env={"PATH": f"{west}:{os.environ['PATH']}", **environment},
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    return done.returncode, done.stdout, done.stderr


def test_the_script_is_clean(tmp_path: Path) -> None:
    done = run([program("shellcheck", "shellcheck"), SCRIPT], tmp_path)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("ram", "flash", "refused"),
    [
        (48 * KIB - 64, 1000, ""),
        (49 * KIB, 1000, "bytes of RAM are left, and 8192 are asked for"),
        (1000, 299 * KIB, ""),
        (1000, 300 * KIB, "it would lie over the tables"),
    ],
)
def test_an_image_keeps_to_its_partition_and_leaves_ram(
    ram: int, flash: int, refused: str, tmp_path: Path
) -> None:
    code, told, error = script("--check", image(tmp_path, ram, flash), folder=tmp_path)
    numbers = re.search(r"flash (\d+) of 307200 bytes, RAM (\d+) of 65536 bytes, (\d+) left", told)
    assert numbers is not None, told + error
    in_flash, in_ram, left = map(int, numbers.groups())
    assert flash < in_flash < flash + 500 and in_ram == 8 * KIB + ram == 64 * KIB - left
    assert (code, bool(error)) == ((2, True) if refused else (0, False))
    assert refused in error


def test_what_is_no_image_of_this_chip_is_not_judged(tmp_path: Path) -> None:
    (tmp_path / "text.elf").write_text("no ELF")
    for file, message in (
        (tmp_path / "text.elf", "is no ELF"),
        (tmp_path / "none.elf", "is not there"),
        (Path(sys.executable).resolve(), "is not for this chip"),
    ):
        code, told, error = script("--check", file, folder=tmp_path)
        assert (code, told, error.count("\n")) == (2, "", 1) and message in error


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """What west made, of folders that hold no more than their versions."""
    for name in ("zephyr", "hal/nrfx", "frogkick"):
        (tmp_path / name).mkdir(parents=True)
    projects = ("zephyr", "zephyr"), ("hal_nordic", "hal")
    listed = [f"{{name: {name}, path: {path}, url: here, revision: here}}" for name, path in projects]
    (tmp_path / "frogkick" / "west.yml").write_text(f"manifest: {{projects: [{', '.join(listed)}]}}")
    done = run([sys.executable, "-m", "west", "init", "-l", "frogkick"], tmp_path)
    assert done.returncode == 0, done.stderr
    return tmp_path


@pytest.mark.parametrize(
    ("zephyr", "nrfx", "message"),
    [
        ((3, 6, 99), "3.5.0", "Zephyr is 3.6.99, and the firmware is written for 3.7 to 4.3"),
        ((4, 4, 0), "3.14.0", "Zephyr is 4.4.0"),
        ((4, 3, 0), "4.0.0", "nrfx is 4.0.0, and limbs.c is written for nrfx 3"),
        ((3, 7, 1), "3.5.0", "nrf52dk/nrf52832 does not build"),  # as there is no Zephyr
        ((4, 3, 0), "3.14.0", "nrf52dk/nrf52832 does not build"),
    ],
)
def test_another_zephyr_is_refused_before_it_is_built(
    zephyr: tuple[int, int, int], nrfx: str, message: str, workspace: Path, made: Path
) -> None:
    names = ("VERSION_MAJOR", "VERSION_MINOR", "PATCHLEVEL")
    lines = [f"{name} = {number}\n" for name, number in zip(names, zephyr, strict=True)]
    (workspace / "zephyr" / "VERSION").write_text("".join(lines))
    (workspace / "hal" / "nrfx" / "CHANGELOG.md").write_text(
        f"# Changelog\n\n## [{nrfx}] - a day\n\n## [3.0.0]\n"
    )
    code, told, error = script(made, folder=workspace)
    assert code == 2 and message in error
    version = ".".join(map(str, zephyr))
    assert told == (
        f"Zephyr {version} in {workspace / 'zephyr'}, nrfx {nrfx}\n" if "does not build" in message else ""
    )


def test_it_says_what_it_needs(tmp_path: Path, made: Path) -> None:
    for words, message in (
        ([], "usage: build.sh FOLDER"),
        ([tmp_path], "was not made by 'frogkick firmware build"),
        ([made], "no Zephyr here"),
    ):
        code, told, error = script(*words, folder=tmp_path)
        assert (code, told, error.count("\n")) == (2, "", 1) and message in error


def test_warnings_of_conversion_are_for_files_without_zephyr_s_headers(tmp_path: Path, made: Path) -> None:
    """Its CMakeLists.txt with a package that makes Zephyr's library for applications and nothing else."""
    (tmp_path / "ZephyrConfig.cmake").write_text("enable_language(C)\nadd_library(app STATIC)\n")
    cmake = [program("cmake", "cmake"), "-G", "Unix Makefiles", "-S", ROBOT, "-B", "out"]
    cmake += ["-DCMAKE_EXPORT_COMPILE_COMMANDS=ON", f"-DZephyr_DIR={tmp_path}"]
    refused = run(cmake, tmp_path)
    assert refused.returncode != 0 and "give the absolute path of a folder made by" in refused.stderr
    done = run([*cmake, f"-DFROGKICK_BUILD={made}"], tmp_path)
    assert done.returncode == 0, done.stderr
    commands = {
        Path(c["file"]): c["command"]
        for c in json.loads((tmp_path / "out" / "compile_commands.json").read_text())
    }
    own = {file.name for file in (ROBOT / "src").glob("*.c")}
    assert own < {file.name for file in commands}
    for file, command in commands.items():
        assert ("-Wconversion" in command) == (file.name not in own), file
        assert "-ffp-contract=off" in command, "the planner's bits are the host's"
        if file.name not in own:
            assert "#include <zephyr" not in file.read_text(), file
