"""The drivers' test firmware, built once."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench_build import build


@pytest.fixture(scope="session")
def echo_elf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Firmware that echoes bytes and starts pulses on command: driver_echo.c."""
    source = Path(__file__).with_name("driver_echo.c")
    return build([source], tmp_path_factory.mktemp("echo") / "echo.elf")
