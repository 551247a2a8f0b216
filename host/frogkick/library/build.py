"""Makes libraries: simulates all actions from sampled states, in parallel, with checkpoints to resume from.

A library can also be cut to a shorter period.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Float32, Float64
from frogkick.core.chunks import WORKERS_MAX, Job, code_stamp, run_chunks
from frogkick.core.errors import ConvergenceError, InputError
from frogkick.core.files import write_bytes, write_text
from frogkick.core.poses import body_from_world
from frogkick.der import Rods, cubic
from frogkick.effects import rods_of
from frogkick.effects.registry import own_code
from frogkick.library.sampling import Starts, sample_starts
from frogkick.library.store import (
    Library,
    library_of,
    read_library,
    read_recorded,
    write_library,
)
from frogkick.library.transitions import (
    Failed,
    Transitions,
    recorded_times,
    rigid_task,
    simulate_task,
)  # fmt: skip
from frogkick.library.wear import wear_curves
from frogkick.robot import Robot

_FORMAT = "frogkick library parts"


def checkpoint_folder(out: Path) -> Path:
    """Folder of the checkpoints of a library."""
    return out.with_name(out.name + ".parts")


class Checkpoints:
    """Folder ``OUT.parts`` of one build: a build that is started again resumes from the finished parts."""

    def __init__(self, out: Path, job: bytes, name: str = "", keep_others: bool = False) -> None:
        """Open the folder; the first part creates it.

        Args:
            out: the library's file.
            job: everything that its content depends on.
            name: of the job, for people.
            keep_others: raise if there are parts of another job, instead of deleting them.
        """
        self.folder = checkpoint_folder(out)
        self._name = name
        self._key = hashlib.sha256(job).hexdigest()
        if not self.folder.exists():
            return
        key, whose = self._found()
        if key == self._key:
            return
        if keep_others and key and any(self.folder.glob("*.npz")):
            if whose == name:
                whose = "made by another frogkick, other packages or another effect file"
            raise InputError(
                f"{str(self.folder)!r} holds finished parts of another library ({whose}), this one is "
                f"{name}: build that one to its end, choose another --out, or delete the folder"
            )
        self.remove()

    def _found(self) -> tuple[str, str]:
        """Key and name of the job whose parts are there; two empty texts if unknown."""
        try:
            text = json.loads((self.folder / "job.json").read_text(encoding="utf-8"))
            if str(text["format"]).startswith(_FORMAT):
                return str(text["key"]), str(text.get("name", "by an earlier version"))
        except (OSError, ValueError, KeyError, TypeError):
            pass
        if self.folder.is_dir() and all(file.suffix == ".npz" for file in self.folder.iterdir()):
            return "", ""  # stopped before job.json was written
        raise InputError(
            f"{str(self.folder)!r} is where the library's parts would go, and frogkick did not "
            "make it: move it or choose another --out"
        )

    def _file(self, index: int) -> Path:
        return self.folder / f"{index:06d}.npz"

    def save(self, index: int, part: Transitions) -> None:
        """Write a part atomically."""
        if not self.folder.exists():
            about = {"format": _FORMAT, "key": self._key, "name": self._name}
            write_text(self.folder / "job.json", json.dumps(about) + "\n")
        content = io.BytesIO()
        np.savez(
            content,
            velocity=part.velocity_body,
            previous=part.previous,
            rows=part.rows,
            recorded=part.recorded,
            failed=np.array([(f.state, f.action) for f in part.failed], dtype=np.int64).reshape(-1, 2),
            reasons=np.array([f.reason for f in part.failed], dtype=np.str_),
        )
        write_bytes(self._file(index), content.getvalue())

    def load(self, index: int) -> Transitions | None:
        """A part, or None if it is missing or damaged."""
        try:
            content = io.BytesIO(self._file(index).read_bytes())
            with np.load(content, allow_pickle=False) as part:
                reasons: list[str] = part["reasons"].tolist()
                places: list[list[int]] = part["failed"].tolist()
                rows: Float64 = part["rows"]
                failed = tuple(Failed(s, a, r) for (s, a), r in zip(places, reasons, strict=True))
                return Transitions(part["velocity"], part["previous"], rows, part["recorded"], failed)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def remove(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)


RECORD_S = 5.0
"""Recorded time of each transition, as in the paper: a library can be cut to any shorter period."""

RECORD_MAX_S = 60.0
_REPORTED_FAILURES = 20

Progress = Callable[[int, int], None]
"""Called with transitions done and all transitions."""


def _warm(rods: Rods) -> None:
    simulate_task(rods, rigid_task(np.zeros((1, 3))))


def require_workers(workers: int) -> None:
    """Raise InputError for a number of processes that is out of range."""
    if not 1 <= workers <= WORKERS_MAX:
        raise InputError(f"workers is {workers}: give 1 to {WORKERS_MAX}")


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
    swims: Sequence[Sequence[int]] = (),
) -> Library:
    """Simulate ``states`` initial velocities times all actions, write the library, and return it.

    For the other arguments and errors see ``frogkick.build_library``. The file's bytes depend on robot,
    states, seed, sampling and record_s only. After Ctrl-C finished parts stay in ``OUT.parts``, and the same
    build resumes from them. Transitions that fail are listed in the file, with NaN in their rows.

    Args:
        keep_others: raise if ``OUT.parts`` belongs to another build, instead of deleting it.
        swims: of the sampling ``RUNS``, see ``sample_starts``.

    Raises:
        FrogkickError: a worker process died, or the cluster failed; finished parts are kept.
    """
    require_workers(workers)
    if not 0.0 <= record_s <= RECORD_MAX_S:
        raise InputError(f"record is {record_s} s: give 0 to {RECORD_MAX_S:g}")
    starts = sample_starts(robot, states, seed, sampling, workers, cluster, swims)
    name = f"{robot.id} {robot.sha256.hex()[:8]}, {states} states, seed {seed}, {sampling}, {record_s:g} s"
    parts = Checkpoints(Path(out), _job(robot, starts, record_s), name, keep_others)
    done = _simulate_parts(robot, starts, record_s, parts, progress, workers, cluster)
    library = library_of(robot, sampling, seed, starts.unfolded(done))
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
    library = library_of(robot, sampling, seed, starts.unfolded(done))
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
    numbers = json.dumps([record_s, shapes, code_stamp()]).encode()
    return b"\n".join([robot.sha256, digest.digest(), numbers, own_code(robot)])


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
    job = Job(rods_of, (robot,), partial(simulate_task, record_s=record_s), _warm)
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


def truncate_library(path: Path | str, robot: Robot) -> Library:
    """The library of a robot with another period, from one that was recorded up to that period.

    Displacements and velocities at the new period are on the cubic through two recorded poses and velocities.
    Settings of the robot that do not move it may differ too.

    Raises:
        InputError: another robot, a period that was not recorded, or states in the course of a swim.
    """
    library, recorded = read_library(path), read_recorded(path)
    if _moves_like(robot) != _moves_like(library.robot()):
        raise InputError(
            f"robot {robot.id!r} is not the one of library {str(path)!r} with another period only: "
            "build a library for it"
        )
    if library.has_history():
        raise InputError(
            f"library {str(path)!r} has states of swims with a period of {library.period_s:g} s: "
            f"build one for {robot.period_s:g} s, or give one of --sampling box, which serves other periods"
        )
    times, period = recorded.time_s, robot.period_s
    if not len(times) or not times[0] <= period <= times[-1]:
        range_s = f"{times[0]:g}-{times[-1]:g} s are" if len(times) else "nothing is"
        raise InputError(
            f"a period of {period:g} s cannot be taken from library {str(path)!r}, where {range_s} recorded: "
            "build a library for it"
        )
    left = int(np.clip(np.searchsorted(times, period, side="right") - 1, 0, len(times) - 2))
    ends = recorded.motion[:, :, left : left + 2].astype(np.float64)
    pose, rate = ends[..., :3], body_from_world(-ends[..., 2], ends[..., 3:])
    length = np.asarray(times[left + 1] - times[left])
    share = np.asarray((period - times[left]) / length)
    at, slope = cubic(pose[:, :, 0], pose[:, :, 1], rate[:, :, 0], rate[:, :, 1], length, share)
    rows = np.concatenate([at, body_from_world(at[..., 2], slope)], axis=-1)
    none = np.empty((*rows.shape[:2], 0, 6), dtype=np.float32)
    found = Transitions(library.initial_velocity_body, library.previous_actions, rows, none, library.failed)
    return library_of(robot, library.sampling, library.seed, found)


def _moves_like(robot: Robot) -> tuple[object, ...]:
    """Everything that decides how a robot moves in water after an action."""
    return (
        robot.frame,
        robot.limbs,
        robot.actions,
        robot.second_delay_s,
        robot.profiles,
        robot.egain_percent,
        robot.profile_frequency_hz,
        robot.water_density_kg_per_m3,
        robot.effects,
    )
