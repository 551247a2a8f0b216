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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The dearest folders first: files are dealt to processes in this order, which then end together."""
    dear = ("study", "identify", "library", "codegen", "loop")

    def rank(item: pytest.Item) -> int:
        folder = item.path.relative_to(REPOSITORY / "tests").parts[0]
        return dear.index(folder) if folder in dear else len(dear)

    items.sort(key=rank)
