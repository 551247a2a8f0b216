"""Built once for several files: the drivers' test firmware, and the Zephyr application on its stage."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench_build import build
from tests.runs import rig
from zephyr_robot import ROBOT, Life, configuration, defines, play

from frogkick.robot import load_robot
from frogkick_codegen import firmware


@pytest.fixture(scope="session")
def echo_elf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Firmware that echoes bytes and starts pulses on command: driver_echo.c."""
    source = Path(__file__).with_name("driver_echo.c")
    return build([source], tmp_path_factory.mktemp("echo") / "echo.elf")


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `frogkick firmware build` leaves, and the application's CMake file takes."""
    folder = tmp_path_factory.mktemp("made")
    firmware.build("bench", rig.small_table(), load_robot("frog2022"), folder / "out")
    return folder / "out"


@pytest.fixture(scope="session")
def played(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        options = defines(configuration(patch, ROBOT / "prj.conf"))
    return play(made, tmp_path_factory.mktemp("played"), options)


@pytest.fixture
def life(played: Path) -> Life:
    return Life(played)
