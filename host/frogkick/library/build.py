"""Sample initial velocities and simulate every action from each, on all cores; a stopped build goes on."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frogkick import __version__ as VERSION
from frogkick.chunks import WORKERS_MAX, Job, run_chunks
from frogkick.der import WIDTH, Rods, prepare
from frogkick.der.compiled import SOURCES
from frogkick.errors import ConvergenceError, InputError
from frogkick.library.parts import Parts
from frogkick.library.sampling import sample_velocities
from frogkick.library.store import make_library, write_library
from frogkick.library.transitions import (
    SAMPLE_S,
    Failed,
    Pairing,
    SampleArray,
    Transitions,
    pair_up,
    recorded_times,
    simulate_states,
)
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

RECORD_S = 5.0
"""How long each transition is followed and recorded, as in the paper: any period up to it can be cut out."""

RECORD_MAX_S = 60.0
_PART_STATES = 2 * WIDTH  # some 0.4 s of work: fine progress, quick end on Ctrl-C, no cost to speak of
_REPORTED_FAILURES = 20


@dataclass(frozen=True)
class BuildReport:
    """What a build came to: transitions, seconds simulated and waited, and one line for each failure."""

    transitions: int
    simulated_s: float
    wall_s: float
    failures: tuple[str, ...] = ()


_Ready = tuple[Rods, float]


def _start(robot: Robot, record_s: float) -> _Ready:
    return prepare(robot), record_s


def _run(ready: _Ready, velocities: FloatArray) -> Transitions:
    return simulate_states(ready[0], velocities, ready[1])


def _warm(ready: _Ready) -> None:
    simulate_states(ready[0], np.zeros((1, 3)), 0.0)


def build_library(
    robot: Robot,
    states: int,
    seed: int,
    workers: int,
    out: Path | str,
    progress: Callable[[int, int], None] | None = None,
    sampling: str = "box",
    record_s: float = RECORD_S,
    cluster: str | None = None,
) -> BuildReport:
    """Simulate ``states`` initial velocities times all actions and write the library.

    The file's bytes depend on robot, states, seed, sampling and record_s, not on who simulates. On Ctrl-C
    the workers end within a part, and finished parts stay in ``OUT.parts``: the same build started
    again goes on from there, to the same bytes. Transitions that fail are listed in the file, NaN in its
    rows; the others are not touched by them.

    Args:
        robot: what to simulate.
        states: initial velocities, 1 to 65535.
        seed: of their sampling.
        workers: processes; 1 simulates in this one.
        out: the HDF5 file to write.
        progress: called with (transitions done, all).
        sampling: "box" or "visited", see ``sample_velocities``.
        record_s: how long to follow and record each transition; up to the period, nothing is recorded.
        cluster: address of a Dask scheduler whose workers simulate instead; see frogkick.chunks.

    Raises:
        InputError: states, seed, sampling, workers or record_s out of range, a place that cannot be written
            to, or no cluster there.
        ConvergenceError: every simulation failed; the text lists the first. Nothing is written.
        FrogkickError: a worker process died, or the cluster failed. What is finished is kept.
    """
    if not 1 <= workers <= WORKERS_MAX:
        raise InputError(f"workers is {workers}: give 1 to {WORKERS_MAX}")
    if not 0.0 <= record_s <= RECORD_MAX_S:
        raise InputError(f"record is {record_s} s: give 0 to {RECORD_MAX_S:g}")
    began = time.monotonic()
    velocities = sample_velocities(robot, states, seed, sampling)
    pairing = pair_up(robot, velocities)
    rods = prepare(robot)
    parts = Parts(Path(out), _job(robot, velocities, record_s))

    def run(tasks: Sequence[FloatArray]) -> Iterator[tuple[int, Transitions]]:
        return run_chunks(Job(_start, (robot, record_s), _run, _warm), tasks, workers, cluster)

    done = _simulate_parts(pairing, len(robot.actions), parts, run, progress)
    rows = np.array(
        [
            pairing.rows(state, done[source // _PART_STATES].rows[source % _PART_STATES])
            for state, source in enumerate(pairing.source.tolist())
        ]
    )
    failed = pairing.failed(
        [
            Failed(index * _PART_STATES + f.state, f.action, f.reason)
            for index, part in enumerate(done)
            for f in part.failed
        ]
    )
    lines = tuple(f"state {f.state} action {robot.actions[f.action].name}: {f.reason}" for f in failed)
    transitions = states * len(robot.actions)
    if len(failed) == transitions:
        parts.remove()
        shown = "; ".join(lines[:_REPORTED_FAILURES])
        more = f"; and {len(lines) - _REPORTED_FAILURES} more" if len(lines) > _REPORTED_FAILURES else ""
        raise ConvergenceError(f"all {transitions} simulations failed, no library written: {shown}{more}")
    library = make_library(robot, sampling, seed, velocities, rows, failed)
    write_library(library, out, recorded_times(robot, record_s), _recorded(rods, pairing, record_s, parts))
    parts.remove()
    simulated_s = transitions * max(robot.period_s, record_s)
    return BuildReport(transitions, simulated_s, time.monotonic() - began, lines)


def _job(robot: Robot, velocities: FloatArray, record_s: float) -> bytes:
    """All that a part depends on."""
    numbers = [record_s, SAMPLE_S, _PART_STATES, SOURCES]
    return b"\n".join([robot.sha256, velocities.tobytes(), json.dumps(numbers).encode(), VERSION.encode()])


def _part(velocities: FloatArray, index: int) -> FloatArray:
    return velocities[index * _PART_STATES : (index + 1) * _PART_STATES]


def _simulate_parts(
    pairing: Pairing,
    actions: int,
    parts: Parts,
    run: Callable[[Sequence[FloatArray]], Iterator[tuple[int, Transitions]]],
    progress: Callable[[int, int], None] | None,
) -> list[Transitions]:
    """All parts, kept in their folder; without what they recorded, which would fill the memory."""
    shared = np.bincount(pairing.source, minlength=len(pairing.velocities)) * actions
    whole, told = int(shared.sum()), 0
    done: dict[int, Transitions] = {}
    count = math.ceil(len(pairing.velocities) / _PART_STATES)

    def take(index: int, part: Transitions) -> None:
        nonlocal told
        done[index] = replace(part, recorded=part.recorded[:, :, :0].copy())
        told += int(shared[index * _PART_STATES : (index + 1) * _PART_STATES].sum())

    for index in range(count):
        part = parts.load(index)
        if part is not None:
            take(index, part)
    if progress is not None:
        progress(told, whole)
    missing = [index for index in range(count) if index not in done]
    for place, part in run([_part(pairing.velocities, index) for index in missing]):
        parts.keep(missing[place], part)
        take(missing[place], part)
        if progress is not None:
            progress(told, whole)
    return [done[index] for index in range(count)]


def _recorded(rods: Rods, pairing: Pairing, record_s: float, parts: Parts) -> Iterator[SampleArray]:
    """Recorded motions (a, s, 6) of one state after another."""

    @lru_cache(maxsize=2)  # states that follow each other share a part
    def of(index: int) -> SampleArray:
        part = parts.load(index)
        if part is None:  # somebody removed it: simulate it again
            part = simulate_states(rods, _part(pairing.velocities, index), record_s)
        return part.recorded

    for state, source in enumerate(pairing.source.tolist()):
        recorded = of(source // _PART_STATES)[source % _PART_STATES]
        yield pairing.rows(state, recorded).astype(np.float32, copy=False)
