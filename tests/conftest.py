"""Fixtures that every suite shares."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
FULL = os.environ.get("FK_FULL", "0") == "1"


@pytest.fixture(scope="session")
def frog2022_dir() -> Path:
    """The paper's recorded data, where this machine has it."""
    folder = Path(os.environ.get("FROG2022_DATA", REPOSITORY.parent / "shared" / "data" / "frog2022"))
    if not folder.is_dir():
        pytest.skip(f"the paper's data is not at {folder} and FROG2022_DATA names no folder")
    return folder


def count(normal: int, full: int) -> int:
    """The number of cases: ``normal`` in make test, ``full`` in make test-full."""
    return full if FULL else normal
