"""Sample initial velocities and simulate every action from each, on all cores."""

from __future__ import annotations

import multiprocessing
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frogkick.der import Rods, prepare, simulate_action
from frogkick.errors import ConvergenceError, FrogkickError, InputError
from frogkick.library.sampling import sample_velocities
from frogkick.library.store import Library, make_library, write_library
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

_CHUNK_STATES = 2  # some 0.4 s of work: fine progress, quick end on Ctrl-C, no cost to speak of
_REPORTED_FAILURES = 20


@dataclass(frozen=True)
class BuildReport:
    """What a build came to: transitions, and seconds simulated and waited."""

    transitions: int
    simulated_s: float
    wall_s: float


@dataclass(frozen=True)
class _Chunk:
    """Results of a few states: (k, a, 6) rows of simulate_action, and what failed."""

    first: int
    rows: FloatArray
    failures: tuple[str, ...]


def simulate_transitions(rods: Rods, velocities: FloatArray, first: int = 0) -> tuple[FloatArray, list[str]]:
    """Simulate every action of a robot from each of (k, 3) body velocities.

    Returns:
        (k, a, 6) displacement and end velocity, NaN where a simulation failed; and one line for each failure,
        states counted from ``first``.
    """
    robot = rods.robot
    rows = np.full((len(velocities), len(robot.actions), 6), np.nan)
    failures: list[str] = []
    for k, velocity in enumerate(velocities):
        for a, action in enumerate(robot.actions):
            try:
                rows[k, a] = simulate_action(robot, velocity.tolist(), action, robot.period_s, rods=rods)
            except ConvergenceError as error:
                failures.append(f"state {first + k} action {action.name}: {error}")
    return rows, failures


# Set in each worker process by _start_worker, so that a chunk carries numbers only.
_worker_rods: Rods | None = None


def _start_worker(robot: Robot) -> None:
    global _worker_rods
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business: it ends the workers
    _worker_rods = prepare(robot)


def _run_chunk(first: int, velocities: FloatArray) -> _Chunk:
    if _worker_rods is None:
        raise FrogkickError("a library worker has no robot: build through build_library")
    rows, failures = simulate_transitions(_worker_rods, velocities, first)
    return _Chunk(first, rows, tuple(failures))


def _chunks(rods: Rods, velocities: FloatArray, workers: int) -> Iterator[_Chunk]:
    """Yield all chunks in any order."""
    starts = range(0, len(velocities), _CHUNK_STATES)
    if workers == 1:
        for start in starts:
            rows, failures = simulate_transitions(rods, velocities[start : start + _CHUNK_STATES], start)
            yield _Chunk(start, rows, tuple(failures))
        return
    # A forked worker inherits what the parent has compiled. Elsewhere it loads it from numba's cache.
    method = "fork" if sys.platform == "linux" else "spawn"
    executor = ProcessPoolExecutor(
        min(workers, len(starts)),
        mp_context=multiprocessing.get_context(method),
        initializer=_start_worker,
        initargs=(rods.robot,),
    )
    try:
        pending = [executor.submit(_run_chunk, s, velocities[s : s + _CHUNK_STATES]) for s in starts]
        for future in as_completed(pending):
            yield future.result()
    except BrokenProcessPool as error:
        raise FrogkickError(
            "a library worker process ended unexpectedly (killed, or out of memory): use fewer --workers"
        ) from error
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def build_library(
    robot: Robot,
    states: int,
    seed: int,
    workers: int,
    out: Path | str,
    progress: Callable[[int, int], None] | None = None,
    sampling: str = "box",
) -> BuildReport:
    """Simulate ``states`` initial velocities times all actions and write the library.

    The file's bytes depend on robot, states and seed, not on the number of workers. Nothing is written
    unless every simulation succeeded; on Ctrl-C the workers end within a chunk and no file is left.

    Args:
        robot: what to simulate, for one period each.
        states: initial velocities, 1 to 65535.
        seed: of their sampling.
        workers: processes; 1 simulates in this one.
        out: the HDF5 file to write.
        progress: called with (transitions done, all).
        sampling: "box" or "visited"; see ``sample_velocities``.

    Raises:
        InputError: states, seed or workers out of range, or a place that cannot be written to.
        ConvergenceError: simulations failed; the text lists them.
        FrogkickError: a worker process died.
    """
    if not 1 <= workers <= 256:
        raise InputError(f"workers is {workers}: give 1 to 256")
    began = time.monotonic()
    velocities = sample_velocities(robot, states, seed, sampling)
    rods = prepare(robot)
    # Compile here, once, before any worker starts.
    simulate_action(robot, (0.0, 0.0, 0.0), robot.actions[0], 0.002, rods=rods)
    actions = len(robot.actions)
    rows = np.empty((states, actions, 6))
    failures: list[tuple[int, tuple[str, ...]]] = []
    done, total = 0, states * actions
    if progress is not None:
        progress(0, total)
    for chunk in _chunks(rods, velocities, workers):
        rows[chunk.first : chunk.first + len(chunk.rows)] = chunk.rows
        if chunk.failures:
            failures.append((chunk.first, chunk.failures))
        done += len(chunk.rows) * actions
        if progress is not None:
            progress(done, total)
    if failures:
        lines = [line for _, chunk_lines in sorted(failures) for line in chunk_lines]
        shown = "; ".join(lines[:_REPORTED_FAILURES])
        more = f"; and {len(lines) - _REPORTED_FAILURES} more" if len(lines) > _REPORTED_FAILURES else ""
        raise ConvergenceError(
            f"{len(lines)} of {total} simulations failed, no library written: {shown}{more}"
        )
    write_library(library_of(robot, sampling, seed, velocities, rows), out)
    return BuildReport(total, total * robot.period_s, time.monotonic() - began)


def library_of(robot: Robot, sampling: str, seed: int, velocities: FloatArray, rows: FloatArray) -> Library:
    """A library in memory from (n, 3) velocities and (n, a, 6) rows of simulate_action."""
    return make_library(
        robot,
        sampling,
        seed,
        velocities,
        np.ascontiguousarray(rows[:, :, :3]),
        np.ascontiguousarray(rows[:, :, 3:]),
    )
