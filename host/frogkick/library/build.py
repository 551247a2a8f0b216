"""Samples states and simulates all actions from each, in parallel, with resumable builds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Float32
from frogkick.core.chunks import WORKERS_MAX, Job, run_chunks
from frogkick.core.errors import ConvergenceError, InputError
from frogkick.core.version import VERSION
from frogkick.der import Rods
from frogkick.der.compiled import SOURCES
from frogkick.effects import rods_of
from frogkick.library.checkpoints import Checkpoints
from frogkick.library.sampling import sample_starts
from frogkick.library.starts import Starts, rigid_starts
from frogkick.library.store import Library, make_library, write_library
from frogkick.library.transitions import SAMPLE_S, Task, Transitions, recorded_times, simulate_task
from frogkick.library.wear import wear_curves
from frogkick.robot import Robot

RECORD_S = 5.0
"""Recorded time of each transition, as in the paper: a library can be cut to any shorter period."""

RECORD_MAX_S = 60.0
_REPORTED_FAILURES = 20

Progress = Callable[[int, int], None]
"""Called with transitions done and all transitions."""


_Ready = tuple[Rods, float]


def _start(robot: Robot, record_s: float) -> _Ready:
    return rods_of(robot), record_s


def _run(ready: _Ready, task: Task) -> Transitions:
    return simulate_task(ready[0], task, ready[1])


def _warm(ready: _Ready) -> None:
    simulate_task(ready[0], rigid_starts(ready[0].robot, np.zeros((1, 3))).tasks[0])


def build_library(
    robot: Robot,
    states: int,
    seed: int,
    workers: int,
    out: Path | str,
    progress: Progress = lambda _done, _all: None,
    sampling: str = "box",
    record_s: float = RECORD_S,
    cluster: str | None = None,
    keep_others: bool = False,
) -> Library:
    """Simulate ``states`` initial velocities times all actions, write the library, and return it.

    The file's bytes depend on robot, states, seed, sampling and record_s only. After Ctrl-C finished parts
    stay in ``OUT.parts``, and the same build resumes from them. Transitions that fail are listed in the file,
    with NaN in their rows.

    Args:
        robot: the robot to simulate.
        states: number of states, 1 to 65535.
        seed: of their sampling.
        workers: number of processes; 1: this one.
        out: the HDF5 file to write.
        progress: called with transitions done and all transitions.
        sampling: "box", "visited" or "planned", see ``sample_starts``.
        record_s: recorded time of each transition; nothing is recorded up to the period.
        cluster: address of a Dask scheduler whose workers simulate instead; see frogkick.core.chunks.
        keep_others: raise if ``OUT.parts`` belongs to another build, instead of deleting it.

    Raises:
        InputError: an argument out of its range, a file that cannot be written, no such cluster, or parts of
            another library.
        ConvergenceError: all simulations failed; nothing is written.
        FrogkickError: a worker process died, or the cluster failed; finished parts are kept.
    """
    if not 1 <= workers <= WORKERS_MAX:
        raise InputError(f"workers is {workers}: give 1 to {WORKERS_MAX}")
    if not 0.0 <= record_s <= RECORD_MAX_S:
        raise InputError(f"record is {record_s} s: give 0 to {RECORD_MAX_S:g}")
    starts = sample_starts(robot, states, seed, sampling, workers, cluster)
    name = f"{robot.id} {robot.sha256.hex()[:8]}, {states} states, seed {seed}, {sampling}, {record_s:g} s"
    parts = Checkpoints(Path(out), _job(robot, starts, record_s), name, keep_others)
    done = _simulate_parts(robot, starts, record_s, parts, progress, workers, cluster)
    library = make_library(robot, sampling, seed, starts, done)
    failed = library.failed
    transitions = states * len(robot.actions)
    if len(failed) == transitions:
        parts.remove()
        lines = [f"state {f.state} action {robot.actions[f.action].name}: {f.reason}" for f in failed]
        shown = "; ".join(lines[:_REPORTED_FAILURES])
        more = f"; and {len(lines) - _REPORTED_FAILURES} more" if len(lines) > _REPORTED_FAILURES else ""
        raise ConvergenceError(f"all {transitions} simulations failed, no library written: {shown}{more}")
    simulated = library.initial_velocity_body[library.whole_states()]
    if len(simulated):
        library = replace(library, limb_wear=wear_curves(rods_of(robot), simulated))
    recorded = _recorded(robot, starts, record_s, parts)
    write_library(library, out, recorded_times(robot, record_s), recorded)
    parts.remove()
    return library


def sample_library(
    robot: Robot, states: int, seed: int, sampling: str = "box", progress: Progress = lambda _done, _all: None
) -> Library:
    """Simulate states like ``build_library``, in this process and without a file.

    Raises:
        InputError: see ``sample_starts``.
        ConvergenceError: a simulation failed.
    """
    starts, rods = sample_starts(robot, states, seed, sampling), rods_of(robot)
    done: list[Transitions] = []
    for task in starts.tasks:
        done.append(simulate_task(rods, task))
        states_done = int((starts.part < len(done)).sum())
        progress(states_done * len(robot.actions), states * len(robot.actions))
    library = make_library(robot, sampling, seed, starts, done)
    for failure in library.failed:
        raise ConvergenceError(
            f"unseen state {failure.state} of {robot.id!r} cannot be simulated: {failure.reason}"
        )
    return library


def _job(robot: Robot, starts: Starts, record_s: float) -> bytes:
    """Everything that a part depends on."""
    tasks = [(task.velocity_body, task.actions, task.wanted) for task in starts.tasks]
    digest = hashlib.sha256(b"".join(array.tobytes() for task in tasks for array in task))
    shapes = [array.shape for task in tasks for array in task]
    numbers = json.dumps([record_s, SAMPLE_S, SOURCES, shapes]).encode()
    return b"\n".join([robot.sha256, digest.digest(), numbers, VERSION.encode()])


def _simulate_parts(
    robot: Robot,
    starts: Starts,
    record_s: float,
    parts: Checkpoints,
    progress: Progress,
    workers: int,
    cluster: str | None,
) -> list[Transitions]:
    """Results of all tasks, saved as checkpoints; without the recorded motions, which are large."""
    shared = np.bincount(starts.part, minlength=len(starts.tasks)) * len(robot.actions)
    done: dict[int, Transitions] = {}

    def note(index: int, part: Transitions) -> None:
        done[index] = replace(part, recorded=part.recorded[:, :, :0].copy())

    def report() -> None:
        progress(int(shared[list(done)].sum()), int(shared.sum()))

    for index in range(len(starts.tasks)):
        part = parts.load(index)
        if part is not None:
            note(index, part)
    report()
    missing = [index for index in range(len(starts.tasks)) if index not in done]
    job = Job(_start, (robot, record_s), _run, _warm)
    for place, part in run_chunks(job, [starts.tasks[index] for index in missing], workers, cluster):
        parts.save(missing[place], part)
        note(missing[place], part)
        report()
    return [done[index] for index in range(len(starts.tasks))]


def _recorded(robot: Robot, starts: Starts, record_s: float, parts: Checkpoints) -> Iterator[Float32]:
    """Recorded motions (a, t, 6) of each state."""
    rods = rods_of(robot)

    @lru_cache(maxsize=2)  # successive states share a part
    def of(index: int) -> Float32:
        part = parts.load(index)
        if part is None:  # it was deleted meanwhile
            part = simulate_task(rods, starts.tasks[index], record_s)
        return part.recorded

    for state, (part, row) in enumerate(zip(starts.part.tolist(), starts.row.tolist(), strict=True)):
        yield starts.of(state, of(part)[row]).astype(np.float32, copy=False)
