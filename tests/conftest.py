"""Fixtures that every suite shares."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path
from typing import Any

import pytest

# Matrices here are small: with a process on each core, threads of the linear algebra wait for each other and
# take a hundred times as long. Read when numpy is imported, by this process and those that it starts.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

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


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput") and sys.platform != "win32":
        compile_once()


def compile_once() -> None:
    """Of processes that want the same compiled function one compiles, the others wait and load what it kept.

    numba by itself compiles in each of them, for most of a minute in a fresh clone. A function is locked
    together with the types that it is compiled for, and waits for none but those that it calls, so no two
    wait for each other.
    """
    import fcntl

    from numba.core.caching import Cache
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    compile_here = Dispatcher.compile

    def compile_or_load(self: Any, signature: Any) -> Any:
        if not isinstance(self._cache, Cache):
            return compile_here(self, signature)
        folder = Path(self._cache.cache_path)
        folder.mkdir(parents=True, exist_ok=True)
        types = hashlib.sha256(str(signature).encode()).hexdigest()[:16]
        # The lock on this process's compiler first, as within compile: another order could block threads.
        with global_compiler_lock, (folder / f"{self.__name__}-{types}.lock").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            return compile_here(self, signature)

    Dispatcher.compile = compile_or_load


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The dearest folders first: files are dealt to processes in this order, which then end together.

    Before them two files that compile different halves in a fresh clone, the rods and the planner.
    """
    first = ("study/test_convergence.py", "codegen/test_parity.py")
    dear = ("study", "identify", "library", "codegen", "loop")

    def rank(item: pytest.Item) -> int:
        place = item.path.relative_to(REPOSITORY / "tests")
        if place.as_posix() in first:
            return first.index(place.as_posix()) - len(first)
        return dear.index(place.parts[0]) if place.parts[0] in dear else len(dear)

    items.sort(key=rank)
