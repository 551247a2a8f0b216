"""Fixtures that every suite shares."""

from __future__ import annotations

import hashlib
import os
import signal
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import hypothesis
import pytest

# Matrices here are small: with a process on each core, threads of the linear algebra wait for each other and
# take a hundred times as long. Read when numpy is imported, by this process and those that it starts.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

REPOSITORY = Path(__file__).resolve().parents[1]
LEVELS = ("quick", "ci", "full")
"""How many cases tests count: for a newcomer, for each change, for a release (see ``count``)."""
LEVEL = os.environ.get("FK_LEVEL") or "quick"
FULL = LEVEL == "full"
from_ci = pytest.mark.from_ci
"""A slow test, which make test leaves out: cheaper ones hold most of it."""
LEFT_OUT = "slow tests that are left out: FK_LEVEL=ci runs them"
counted: dict[str, int] = {}
"""Place -> number of cases that a test of this process asked for; ``LEFT_OUT`` -> number of tests."""
# pytest loads this file under another name than tests do: both share it.
if __name__ != "tests.conftest":
    from tests.conftest import counted

# A case takes as long as the machine lets it. The same cases everywhere; make test-full looks for others.
hypothesis.settings.register_profile(
    "frogkick", deadline=None, derandomize=not FULL, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("frogkick")


@pytest.fixture(scope="session")
def frog2022_dir() -> Path:
    """The paper's recorded data, where this machine has it."""
    folder = Path(os.environ.get("FROG2022_DATA", REPOSITORY.parent / "shared" / "data" / "frog2022"))
    if not folder.is_dir():
        pytest.skip(f"the paper's data is not at {folder} and FROG2022_DATA names no folder")
    return folder


def count(ci: int, full: int, quick: int | None = None) -> int:
    """The number of cases at the level that runs, FK_LEVEL: quick is make test, ci .ci/run, full test-full.

    Args:
        ci, full: at these levels.
        quick: in make test; None: as many as at ``ci``.
    """
    chosen = {"quick": ci if quick is None else quick, "ci": ci, "full": full}[LEVEL]
    caller = sys._getframe(1 if sys._getframe(1).f_code.co_name not in ("cases", "some") else 2)
    file = Path(caller.f_code.co_filename)
    place = file.relative_to(REPOSITORY) if file.is_relative_to(REPOSITORY) else file
    counted[f"{place}:{caller.f_lineno}"] = chosen
    return chosen


def some(cases: Iterable[Any], quick: int, ci: int | None = None) -> list[Any]:
    """All cases of a parametrized test; in make test ``quick`` of them, evenly spread, with the first.

    ``ci``: as many in .ci/run, of slow cases that resemble each other.
    """
    every = list(cases)
    wanted = count(len(every) if ci is None else ci, len(every), min(quick, len(every)))
    return [every[k * len(every) // wanted] for k in range(wanted)]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Half as many processes again as cores: while some tests wait for a radio or a clock, others compute."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores + (cores + 1) // 2


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    """What a process counted, to the one that prints."""
    counted.update(getattr(node, "workeroutput", {}).get("counted", {}))


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["counted"] = counted


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Which level ran, with which counts, and how many tests it left out."""
    terminalreporter.section(f"level {LEVEL} of {', '.join(LEVELS)} (FK_LEVEL); cases by place")
    for place in sorted(counted):
        terminalreporter.write_line(f"{counted[place]:>9,} {place}")


def pytest_configure(config: pytest.Config) -> None:
    # What a shell starts in the background begins with Ctrl-C ignored, and so would all that tests start.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if LEVEL not in LEVELS:
        raise pytest.UsageError(f"FK_LEVEL is {LEVEL!r}: give {', '.join(LEVELS)}")
    if hasattr(config, "workerinput"):
        if not sys.dont_write_bytecode:
            rewrite_a_share(
                config, int(config.workerinput["workerid"][2:]), config.workerinput["workercount"]
            )
        if sys.platform != "win32":
            compile_once()
        from frogkick.identification import batching

        # Processes side by side have no processors left: a rollout's lanes stay in the one that asks.
        batching._processors = lambda: 1


def rewrite_a_share(config: pytest.Config, worker: int, workers: int) -> None:
    """Each process prepares the asserts of some test files, for all to load, instead of each of all files.

    pytest by itself does that in every process of a fresh clone, for ten seconds.
    """
    from _pytest.assertion import rewrite

    state = config.stash[rewrite.assertstate_key]
    for file in sorted((REPOSITORY / "tests").rglob("test_*.py"))[worker::workers]:
        folder = rewrite.get_cache_dir(file)
        kept = folder / (file.stem + rewrite.PYC_TAIL)
        if rewrite.try_makedirs(folder) and rewrite._read_pyc(file, kept, state.trace) is None:
            source, code = rewrite._rewrite_test(file, config)
            rewrite._write_pyc(state, code, source, kept)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Wear curves from two gains but in make test-full: those of six are most of a small library's time.

    ``library/test_wear.py`` looks at all of them.
    """
    from frogkick.library import wear

    wear.GAINS = tuple(some(wear.GAINS[::-1], 2, 2)[::-1])


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
    """In make test without the tests from_ci; the dearest first.

    Files are dealt to processes in this order, which then end together. First three files that compile
    different parts in a fresh clone: rods (the longest file of all), planner and C. Files that wait for a
    radio in real time are spread among those that compute, or all processes would wait at once.
    """
    if LEVEL == "quick":
        kept = [item for item in items if not item.get_closest_marker("from_ci")]
        counted[LEFT_OUT] = len(items) - len(kept)
        items[:] = kept
    dear = (
        "identification/test_laws.py", "codegen/test_parity.py", "core/test_core_fuzz.py",
        "studies", "front", "identification", "library", "cli/test_commands.py", "robot/test_family_chain.py",
        "structure/test_wheel.py", "report", "bench", "codegen", "core", "firmware/test_zephyr_lives.py",
        "soak",
    )  # fmt: skip

    def rank(file: Path) -> int:
        place = file.relative_to(REPOSITORY / "tests")
        names = (place.as_posix(), place.parts[0])
        return next((k for k, name in enumerate(dear) if name in names), len(dear))

    files = sorted(dict.fromkeys(item.path for item in items), key=rank)
    waiting = [file for file in files if file.parent.name == "link"]
    computing = [file for file in files if file.parent.name != "link"]
    turn = {file: (k + 0.5) / len(computing) for k, file in enumerate(computing)}
    turn |= {file: 0.8 * (k + 0.5) / len(waiting) for k, file in enumerate(waiting)}
    items.sort(key=lambda item: turn[item.path])
