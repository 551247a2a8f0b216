"""The log of a run in progress, ``run.h5.part``: HDF5 that is flushed after each row, readable after a kill.

It has the layout of a run's log. The caller deletes it once the complete log is written.
"""

from __future__ import annotations

import math
import pathlib
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from frogkick.core.arrays import AnyArray
from frogkick.core.errors import InputError
from frogkick.core.interrupts import Bell
from frogkick.runs.record import UNKNOWN, Recording
from frogkick.runs.runlog import PathChange, RunLog
from frogkick.runs.runlog_file import fill

CHUNK_ROWS = 256
GATHER_S = 0.02
SPEED_MAX_MPS = 0.05
HOLDS_MAX = 200
"""Number of holding paths that a log in progress has room for: about an hour. The complete log has all."""
CUT_OFF = "cut off while it ran"


_Write = tuple[str, Any, Any]
"""A dataset, a position in it (None: append; _WHOLE: replace the content), and the values."""
_WHOLE = slice(None)


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
        self._unanswered: list[int] = []
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
        self._waiting: list[_Write] = []
        self._writing = self._closing = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._live, name="log", daemon=True)
        self._thread.start()

    def keep(self, recording: Recording) -> None:
        """Hand over new rows, which are on the disk some 0.02 s later. InputError: the disk is full."""
        if self._error is not None:
            raise self._full() from self._error
        writes: list[_Write] = []
        first, self._fixes = self._fixes, len(recording.fixes)
        if self._fixes > first:
            fixes = recording.fix_columns(first)
            writes += [(f"fixes/{name}", None, values) for name, values in fixes.all_columns().items()]
        for row in self._unanswered:
            if (status := recording.fix_status[row]) is not None:
                taken_us = recording.capture_us[row]
                writes.append(("fixes/robot_capture_us", row, -1 if taken_us is None else taken_us))
                writes.append(("fixes/robot_status", row, status))
                heard_us, heard_after = recording.heard[row] or UNKNOWN
                writes += [("fixes/heard_after", row, heard_after), ("fixes/heard_us", row, heard_us)]
        waiting = [*self._unanswered, *range(first, self._fixes)]
        self._unanswered = [row for row in waiting[-CHUNK_ROWS:] if recording.fix_status[row] is None]
        for row, (rested_us, after) in list(recording.rested.items())[self._rested :]:
            self._rested += 1
            if row < self._decisions:  # else it is appended below
                writes += [("decisions/rested_after", row, after), ("decisions/rested_us", row, rested_us)]
        first, self._decisions = self._decisions, len(recording.decisions)
        if self._decisions > first:
            made = recording.decision_columns(first)
            writes += [(f"decisions/{name}", None, values) for name, values in made.all_columns().items()]
            for number, change in list(enumerate(recording.then))[self._changes : self._room]:
                self._changes += 1
                for name in ("x_m", "y_m", "tangent_rad"):
                    writes.append((f"then/{number}/{name}", _WHOLE, getattr(change.path, name)))
                if change.hold is not None:
                    writes.append(("then/hold", number, change.hold))
                writes.append(("then/decision", number, change.decision))
        if writes:
            with self._lock:
                self._waiting += writes
                self._condition.notify_all()

    def settle(self) -> None:
        """Wait until all rows are on the disk."""
        self._written.wait_for(lambda: self._error or not (self._waiting or self._writing))

    def close(self) -> None:
        """Write the remaining rows and close the file. InputError: the disk is full."""
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
        while True:
            with self._lock:
                self._condition.wait_for(lambda: self._waiting or self._closing)
                self._writing = True  # before _waiting is emptied: settle reads both without the lock
                writes, self._waiting = self._waiting, []
                if not writes:
                    return
            try:
                self._write(writes)
            except Exception as error:  # keep and close raise it
                self._error = error
            with self._lock:
                self._writing = False
                self._written.ring()
                if self._error is not None:
                    return
                # Writing one row takes as long as writing ten, so gather some.
                self._condition.wait_for(lambda: self._closing, GATHER_S)

    def _write(self, writes: list[_Write]) -> None:
        """Write and flush changes in earlier rows, then new fixes, then paths, then decisions.

        In an interrupted log, everything that was known before a decision is therefore present, and the path
        that it follows.
        """
        parts: dict[str, list[AnyArray]] = {}
        for name, place, values in writes:
            if place is None:
                parts.setdefault(name, []).append(values)
        new = {name: np.concatenate(some) for name, some in parts.items()}
        changed: dict[str, h5py.Dataset] = {}
        for name, place, values in writes:
            if place is None or name.startswith("then/"):
                continue
            data = self._file[name]
            if place < len(data):
                changed[name] = data
                data[place] = values
            else:
                new[name][place - len(data)] = values
        for data in changed.values():
            data.flush()
        self._append({name: rows for name, rows in new.items() if name.startswith("fixes/")})
        for name, place, values in writes:
            if name.startswith("then/"):
                data = self._file[name]
                if place == _WHOLE:
                    data.resize((len(values),))
                data[place] = values
                data.flush()
        self._append({name: rows for name, rows in new.items() if not name.startswith("fixes/")})

    def _append(self, rows: Mapping[str, AnyArray]) -> None:
        for name, values in rows.items():
            data = self._file[name]
            data.resize(len(data) + len(values), axis=0)
            data[len(data) - len(values) :] = values
            data.flush()


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
