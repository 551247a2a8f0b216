"""Functions in the cache of an earlier frogkick, with other modules or constants, are compiled again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.conftest import from_ci

MAIN = """
from frogkick.core.compiled import cached_njit
from pack.{module} import Pair

@{decorator}
def total(pair):
    return pair.one + pair.two

print(total(Pair(1.0, 2.0)))
"""


BOUNDED = """
from frogkick.core.compiled import cached_njit
from pack.limits import LIMIT

@{decorator}
def bounded(value):
    return min(value, LIMIT)

print(bounded(9))
"""


@from_ci
@pytest.mark.parametrize(
    ("decorator", "second"), [("cached_njit()", "2"), ("__import__('numba').njit(cache=True)", "1")]
)
def test_a_constant_of_another_file_that_has_changed(tmp_path: Path, decorator: str, second: str) -> None:
    """The second case shows that numba alone keeps the old one."""
    folder = tmp_path / "pack"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "main.py").write_text(BOUNDED.format(decorator=decorator))
    for limit, expected in (("1", "1"), ("2", second)):
        (folder / "limits.py").write_text(f"LIMIT = {limit}\n")
        assert _run(tmp_path).stdout.strip() == expected


def _run(folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "kept")}
    return subprocess.run(
        [sys.executable, "-B", "-m", "pack.main"],
        env=environment, cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


@from_ci
@pytest.mark.parametrize(
    ("decorator", "returncode"), [("cached_njit()", 0), ("__import__('numba').njit(cache=True)", 1)]
)
def test_types_that_have_moved(tmp_path: Path, decorator: str, returncode: int) -> None:
    """The second case shows that numba alone fails. If it no longer does, ``cached_njit`` is not needed."""
    folder = tmp_path / "pack"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    for module, expected in (("before", 0), ("after", returncode)):
        for old in folder.glob("*.py"):
            if old.stem in ("before", "after"):
                old.unlink()
        (folder / f"{module}.py").write_text(
            "from typing import NamedTuple\nclass Pair(NamedTuple):\n    one: float\n    two: float\n"
        )
        (folder / "main.py").write_text(MAIN.format(module=module, decorator=decorator))
        done = _run(tmp_path)
        assert done.returncode == expected, done.stderr
        if not expected:
            assert done.stdout.strip() == "3.0"
