"""The log of a run in progress, ``run.h5.part``: HDF5 that is flushed after each row, readable after a kill.

It has the layout of a run's log. The caller deletes it once the complete log is written.
"""

from __future__ import annotations

import math
import pathlib
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace

import h5py
import numpy as np

from frogkick.core.arrays import AnyArray
from frogkick.core.errors import InputError
from frogkick.runs.record import Recording
from frogkick.runs.runlog import Decisions, Fixes, PathChange, RunLog
from frogkick.runs.runlog_file import fill

CHUNK_ROWS = 256
GATHER_S = 0.02
SPEED_MAX_MPS = 0.05
HOLDS_MAX = 200
"""Number of holding paths that a log in progress has room for: about an hour. The complete log has all."""
CUT_OFF = "cut off while it ran"


_Rows = tuple[str, int, AnyArray]
"""A dataset, a row of it, and the values from this row on to its end."""


def part_of(target: pathlib.Path) -> pathlib.Path:
    """File of the log in progress, beside the run's log."""
    return target.with_name(target.name + ".part")


class LiveLog:
    """Appends and flushes rows of a run in a thread of its own, so that no fix waits for the disk."""

    def __init__(self, target: pathlib.Path, empty: RunLog) -> None:
        """Create the file beside ``target``, the run's log, with the robot, path and planner of an empty log.

        Raises:
            InputError: the file cannot be written.
        """
        self.path = part_of(target)
        self._made = [place for place in target.parents if not place.exists()]
        self._fixes = self._decisions = self._changes = self._rested = 0
        self._room = len(empty.then)  # a file that others read takes no further groups
        self._has_holds = any(change.hold for change in empty.then)
        self._unanswered: list[int] = []
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            self._file = h5py.File(self.path, "w", libver="latest", locking="best-effort")
        except OSError as error:
            raise InputError(f"cannot write {str(self.path)!r} ({error}): choose another --out") from error
        fill(self._file, empty, CHUNK_ROWS)
        self._file.attrs["live"] = True
        self._file.swmr_mode = True  # from here on other programs can read what was flushed
        # An empty list ends the thread. ``queue.Queue`` is Python code, which a Ctrl-C could leave locked.
        self._waiting: queue.SimpleQueue[list[_Rows]] = queue.SimpleQueue()
        self._handed_over = self._written = 0  # lists of rows
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._live, name="log", daemon=True)
        self._thread.start()

    def keep(self, recording: Recording) -> None:
        """Hand over new rows, which are on the disk some 0.02 s later. InputError: the disk is full."""
        if self._error is not None:
            raise self._full() from self._error
        writes: list[_Rows] = []
        fixes, count = recording.fixes, len(recording.fixes)
        first = min([self._fixes, *(row for row in self._unanswered if fixes[row].is_answered)])
        if first < count:
            writes += _rows(recording.fix_columns(first), first)
        waiting = [*self._unanswered, *range(self._fixes, count)][-CHUNK_ROWS:]
        self._unanswered = [row for row in waiting if not fixes[row].is_answered]
        self._fixes = count
        rested, count = list(recording.rested), len(recording.decisions)
        first = min([self._decisions, *rested[self._rested :]])
        if first < count:
            writes += self._changed_paths(recording.then[: self._room])
            writes += _rows(recording.decision_columns(first), first)
        self._rested, self._decisions = len(rested), count
        if writes:
            self._handed_over += 1
            self._waiting.put(writes)

    def _changed_paths(self, then: Sequence[PathChange]) -> list[_Rows]:
        """The paths that have taken over since the last call, and the columns of all."""
        writes: list[_Rows] = []
        for number, change in list(enumerate(then))[self._changes :]:
            points = {name: getattr(change.path, name) for name in ("x_m", "y_m", "tangent_rad")}
            writes += [(f"then/{number}/{name}", 0, values) for name, values in points.items()]
        if writes:
            self._changes, rest = len(then), self._room - len(then)
            holds = [*(change.hold or (np.nan,) * 3 for change in then), *[(0.0, 0.0, 0.0)] * rest]
            writes += [("then/hold", 0, np.array(holds))] if self._has_holds else []
            writes.append(("then/decision", 0, np.array([*(one.decision for one in then), *[-1] * rest])))
        return writes

    def settle(self) -> None:
        """Wait until all rows are on the disk."""
        while self._written < self._handed_over and self._error is None:
            time.sleep(0.001)

    def close(self) -> None:
        """Write the remaining rows and close the file. InputError: the disk is full."""
        self._waiting.put([])
        self._thread.join()
        try:
            self._file.close()
        except (OSError, RuntimeError) as error:
            raise self._full() from error
        if self._error is not None:
            raise self._full() from self._error

    def discard_if_empty(self) -> None:
        """Remove the closed file of a run that has not begun, with the folders that were made for it."""
        if self._fixes or self._decisions:
            return
        self.path.unlink(missing_ok=True)
        for place in self._made:
            with suppress(OSError):  # something else is in it
                place.rmdir()

    def _full(self) -> InputError:
        return InputError(f"the log {str(self.path)!r} cannot be continued: is the disk full?")

    def _live(self) -> None:
        is_over = False
        while not is_over:
            taken = [self._waiting.get()]
            if taken[0]:  # writing one row takes as long as writing ten, so gather some
                time.sleep(GATHER_S)
            while not self._waiting.empty():
                taken.append(self._waiting.get())
            try:
                self._write([rows for writes in taken for rows in writes])
            except Exception as error:  # keep and close raise it
                self._error = error
            self._written += len(taken)
            is_over = [] in taken or self._error is not None

    def _write(self, writes: list[_Rows]) -> None:
        """Write and flush fixes, then paths, then decisions.

        In an interrupted log, everything that was known before a decision is therefore present, and the path
        that it follows: a decision is not read before all of its columns are there.
        """
        new: dict[str, tuple[int, AnyArray]] = {}
        for name, first, values in writes:
            begin, before = new.get(name, (first, values[:0]))
            new[name] = min(begin, first), np.concatenate([before[: max(0, first - begin)], values])
        for group in ("fixes/", "then/", "decisions/"):
            for name in (name for name in new if name.startswith(group)):
                first, values = new[name]
                data = self._file[name]
                if len(data) != first + len(values):
                    data.resize(first + len(values), axis=0)
                data[first:] = values
                data.flush()


def _rows(group: Fixes | Decisions, first: int) -> list[_Rows]:
    return [(f"{group.NAME}/{name}", first, values) for name, values in group.all_columns().items()]


@contextmanager
def logged(target: pathlib.Path | None, recording: Recording) -> Iterator[Callable[[Recording], None]]:
    """Yield a function that keeps a recording in a live log beside ``target``; without one it has no effect.

    ``recording``: of the run that is to begin.
    """
    if target is None:
        yield lambda _recording: None
        return
    options, path = recording.options, recording.path
    planned = tuple(PathChange(-1, one.path) for one in options.then)
    if options.hold_m is not None:  # where and when each takes over is not known yet
        lap_s = 2.0 * math.pi * options.hold_m / SPEED_MAX_MPS
        again = min(HOLDS_MAX, 2 * (len(planned) + 1) + math.ceil(options.time_limit_s / lap_s))
        planned += (PathChange(-1, path, (0.0, 0.0, 0)),) * again
    empty = replace(recording.log(), then=planned, measured=recording.known, notes=CUT_OFF)
    live = LiveLog(target, empty)
    try:
        yield live.keep
    finally:
        live.close()
        live.discard_if_empty()
