"""The log of a run in progress, ``run.h5.part``: HDF5 that is flushed after each row, readable after a kill.

It has the layout of a run's log. The caller deletes it once the complete log is written.
"""

from __future__ import annotations

import math
import pathlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import h5py
import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.interrupts import Bell
from frogkick.paths import Path
from frogkick.robot import Robot
from frogkick.runs.closed_loop import Recording, RunOptions
from frogkick.runs.record import LEARN, decision_columns, fix_columns, run_log
from frogkick.runs.runlog import Decisions, Fixes, PathChange, RunLog
from frogkick.runs.runlog_file import fill
from frogkick.tables.image import Tables

CHUNK_ROWS = 256
GATHER_S = 0.02
SPEED_MAX_MPS = 0.05
HOLDS_MAX = 200
"""Paths that hold, of which a log in progress has room for: about an hour. The complete one has them all."""
CUT_OFF = "cut off while it ran"


@dataclass(frozen=True)
class _Answer:
    """The robot's answer to the fix of an earlier row."""

    row: int
    capture_us: int
    status: int


@dataclass(frozen=True, eq=False)
class _Change:
    """A path that took over, the ``number``-th."""

    number: int
    change: PathChange


def part_of(target: pathlib.Path) -> pathlib.Path:
    """File of the log in progress, beside the run's log."""
    return target.with_name(target.name + ".part")


class LiveLog:
    """Appends and flushes rows of a run in a thread of its own, so that no fix waits for the disk."""

    def __init__(self, target: pathlib.Path, empty: RunLog, onboard: bool) -> None:
        """Create the file beside ``target``, the run's log, with the robot, path and planner of an empty log.

        ``onboard``: decision times are on the robot's clock.

        Raises:
            InputError: the file cannot be written.
        """
        self.path = part_of(target)
        self._fixes = self._decisions = self._changes = 0
        self._room = len(empty.then)  # a file that others read takes no further groups
        self._unanswered: list[int] = []
        self._onboard, self._learn = onboard, LEARN in empty.made
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            self._file = h5py.File(self.path, "w", libver="latest")
        except OSError as error:
            raise InputError(f"cannot write {str(self.path)!r} ({error}): choose another --out") from error
        fill(self._file, empty, CHUNK_ROWS)
        self._file.attrs["live"] = True
        self._file.swmr_mode = True  # from here on other programs can read what was flushed
        self._lock = threading.Lock()
        self._condition = threading.Condition(self._lock)
        self._written = Bell()
        self._waiting: list[Fixes | Decisions | _Answer | _Change] = []
        self._writing = self._closing = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._live, name="log", daemon=True)
        self._thread.start()

    def keep(self, recording: Recording) -> None:
        """Hand over new rows, which are on the disk some 0.02 s later.

        Raises:
            InputError: the disk is full.
        """
        if self._error is not None:
            raise self._full() from self._error
        new, decided = len(recording.fixes) - self._fixes, len(recording.decisions) - self._decisions
        answered = [row for row in self._unanswered if recording.fix_status[row] is not None]
        if not (new or decided or answered):
            return
        rows: list[Fixes | Decisions | _Answer | _Change] = []
        if new or answered:
            rows += self._new_fixes(recording, answered)
        if decided:
            first, self._decisions = self._decisions, len(recording.decisions)
            rows.append(decision_columns(recording, self._onboard, self._learn, first))
            changes = list(enumerate(recording.then))[self._changes : self._room]
            rows += [_Change(number, change) for number, change in changes]
            self._changes += len(changes)
        with self._lock:
            self._waiting += rows
            self._condition.notify_all()

    def settle(self) -> None:
        """Wait until all rows are on the disk."""
        self._written.wait_for(lambda: self._error or not (self._waiting or self._writing))

    def close(self) -> None:
        """Write the remaining rows and close the file.

        Raises:
            InputError: the disk is full.
        """
        with self._lock:
            self._closing = True
            self._condition.notify_all()
        self._thread.join()
        try:
            self._file.close()
        except (OSError, RuntimeError) as error:
            raise self._full() from error
        if self._error is not None:
            raise self._full() from self._error

    def _full(self) -> InputError:
        return InputError(f"the log {str(self.path)!r} cannot be continued: is the disk full?")

    def _new_fixes(self, recording: Recording, answered: list[int]) -> list[Fixes | _Answer]:
        first, self._fixes = self._fixes, len(recording.fixes)
        rows: list[Fixes | _Answer] = []
        if self._fixes > first:
            rows.append(fix_columns(recording, first))
        for row in answered:
            taken_us, status = recording.capture_us[row], recording.fix_status[row]
            assert status is not None
            rows.append(_Answer(row, -1 if taken_us is None else taken_us, status))
        waiting = [*self._unanswered, *range(first, self._fixes)]
        self._unanswered = [row for row in waiting[-CHUNK_ROWS:] if recording.fix_status[row] is None]
        return rows

    def _live(self) -> None:
        while True:
            with self._lock:
                self._condition.wait_for(lambda: self._waiting or self._closing)
                self._writing = True  # before _waiting is emptied: settle reads both without the lock
                rows, self._waiting = self._waiting, []
                if not rows:
                    return
            try:
                self._write(rows)
            except Exception as error:  # keep and close raise it
                self._error = error
            with self._lock:
                self._writing = False
                self._written.ring()
                if self._error is not None:
                    return
                # Writing one row takes as long as writing ten, so gather some.
                self._condition.wait_for(lambda: self._closing, GATHER_S)

    def _write(self, rows: list[Fixes | Decisions | _Answer | _Change]) -> None:
        """Append and flush new rows, then fill in the answers to earlier ones, and paths that took over."""
        for kind in (Fixes, Decisions):
            groups = [group for group in rows if isinstance(group, kind)]
            if groups:
                self._append(groups)
        answers = {answer.row: answer for answer in rows if isinstance(answer, _Answer)}
        if answers:
            order = sorted(answers)
            for name, values in (
                ("robot_capture_us", [answers[row].capture_us for row in order]),
                ("robot_status", [answers[row].status for row in order]),
            ):
                data = self._file[f"{Fixes.NAME}/{name}"]
                data[order] = values
                data.flush()
        for row in rows:
            if isinstance(row, _Change):
                self._write_change(row)

    def _write_change(self, row: _Change) -> None:
        for name in ("x_m", "y_m", "tangent_rad"):
            data = self._file[f"then/{row.number}/{name}"]
            data.resize((len(row.change.path),))
            data[:] = getattr(row.change.path, name)
            data.flush()
        if row.change.hold is not None:
            self._file["then/hold"][row.number] = row.change.hold
            self._file["then/hold"].flush()
        data = self._file["then/decision"]
        data[row.number] = row.change.decision
        data.flush()

    def _append(self, groups: Sequence[Fixes | Decisions]) -> None:
        kind = groups[0]
        for name in [*kind.columns(), *kind.extra]:
            if f"{kind.NAME}/{name}" not in self._file:
                continue  # the host's own planning times are not logged
            columns = [g.extra[name] if name in g.extra else getattr(g, name) for g in groups]
            values = np.concatenate(columns)
            data = self._file[f"{kind.NAME}/{name}"]
            data.resize(len(data) + len(values), axis=0)
            data[len(data) - len(values) :] = values
            data.flush()


@contextmanager
def logged(
    target: pathlib.Path | None,
    robot: Robot,
    tables: Tables,
    path: Path,
    options: RunOptions,
    source: str,
    known: Mapping[str, float] | None = None,
    made: Mapping[str, str] | None = None,
) -> Iterator[Callable[[Recording], None]]:
    """Yield a function that keeps a recording in a live log beside ``target``; without one it has no effect.

    ``known`` are numbers for ``RunLog.measured``, ``made`` is ``RunLog.made``.
    """
    if target is None:
        yield lambda _recording: None
        return
    empty = run_log(Recording(), None, robot, tables, path, options, None, source, made=made)
    planned = tuple(PathChange(-1, one.path) for one in options.then)
    if options.hold_m is not None:  # where and when each takes over is not known yet
        lap_s = 2.0 * math.pi * options.hold_m / SPEED_MAX_MPS
        again = min(HOLDS_MAX, 2 * (len(planned) + 1) + math.ceil(options.time_limit_s / lap_s))
        planned += (PathChange(-1, path, (0.0, 0.0, 0)),) * again
    empty = replace(empty, then=planned, measured=known or {}, notes=CUT_OFF)
    live = LiveLog(target, empty, options.onboard)
    try:
        yield live.keep
    finally:
        live.close()
