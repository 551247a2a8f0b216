"""A run's log while it runs: HDF5 whose rows are on disk a moment after they come, readable after a kill.

Beside the log that is asked for, as ``run.h5.part``, in its layout; what was not known yet (the robot's
answer to a fix) is as if it never came. A run that ends by itself writes its log whole, and this one goes.
"""

from __future__ import annotations

import pathlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace

import h5py
import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.interrupts import Bell
from frogkick.paths import Path
from frogkick.robot import Robot
from frogkick.runs.closed_loop import Recording, RunOptions
from frogkick.runs.record import decision_columns, fix_columns, run_log
from frogkick.runs.runlog import Decisions, Fixes, RunLog
from frogkick.runs.runlog_file import fill
from frogkick.tables.image import Tables

CHUNK_ROWS = 256
GATHER_S = 0.02
CUT_OFF = "cut off while it ran"


@dataclass(frozen=True)
class _Answer:
    """What the robot answered to the fix of a row that was written before."""

    row: int
    capture_us: int
    status: int


def part_of(target: pathlib.Path) -> pathlib.Path:
    """Where the rows of a run are kept until it has ended."""
    return target.with_name(target.name + ".part")


class LiveLog:
    """Rows of one run, appended and flushed by a thread of its own, so that no fix waits for the disk."""

    def __init__(self, target: pathlib.Path, empty: RunLog, onboard: bool) -> None:
        """Begin a log beside ``target``.

        Args:
            target: the run's log, not written here.
            empty: a log of the run without any row: robot, path, planner.
            onboard: the robot decides, on its own clock.

        Raises:
            InputError: it cannot be written there.
        """
        self.path = part_of(target)
        self._fixes = self._decisions = 0
        self._open: list[int] = []
        self._onboard = onboard
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            self._file = h5py.File(self.path, "w", libver="latest")
        except OSError as error:
            raise InputError(f"cannot write {str(self.path)!r} ({error}): choose another --out") from error
        fill(self._file, empty, CHUNK_ROWS)
        self._file.attrs["live"] = True
        # From here on another program, or the next one after a kill, reads what was flushed.
        self._file.swmr_mode = True
        self._lock = threading.Lock()
        self._condition = threading.Condition(self._lock)
        self._written = Bell()
        self._waiting: list[Fixes | Decisions | _Answer] = []
        self._writing = self._closing = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._live, name="log", daemon=True)
        self._thread.start()

    def keep(self, recording: Recording) -> None:
        """Hand over what is new: it is on the disk a few hundredths of a second later.

        Raises:
            InputError: the disk is full.
        """
        if self._error is not None:
            raise self._full() from self._error
        new, decided = len(recording.fixes) - self._fixes, len(recording.decisions) - self._decisions
        told = [row for row in self._open if recording.fix_status[row] is not None]
        if not (new or decided or told):
            return
        rows: list[Fixes | Decisions | _Answer] = []
        if new or told:
            rows += self._new_fixes(recording, told)
        if decided:
            rows.append(self._new_decisions(recording))
        with self._lock:
            self._waiting += rows
            self._condition.notify_all()

    def settle(self) -> None:
        """Wait until all that was handed over is on the disk."""
        self._written.wait_for(lambda: self._error or not (self._waiting or self._writing))

    def close(self) -> None:
        """Write what waits, and end it.

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
        return InputError(f"the log {str(self.path)!r} cannot be written on: is the disk full?")

    def _new_fixes(self, recording: Recording, told: list[int]) -> list[Fixes | _Answer]:
        first, self._fixes = self._fixes, len(recording.fixes)
        rows: list[Fixes | _Answer] = []
        if self._fixes > first:
            rows.append(fix_columns(recording, first))
        for row in told:
            taken_us, status = recording.capture_us[row], recording.fix_status[row]
            assert status is not None
            rows.append(_Answer(row, -1 if taken_us is None else taken_us, status))
        waiting = [*self._open, *range(first, self._fixes)]
        self._open = [row for row in waiting[-CHUNK_ROWS:] if recording.fix_status[row] is None]
        return rows

    def _new_decisions(self, recording: Recording) -> Decisions:
        first, self._decisions = self._decisions, len(recording.decisions)
        rows = {fix.sequence: row for row, fix in reversed(list(enumerate(recording.fixes)))}
        offset_us = recording.clock_offset_us if self._onboard else 0
        return decision_columns(recording.decisions[first:], rows, offset_us)

    def _live(self) -> None:
        while True:
            with self._lock:
                self._condition.wait_for(lambda: self._waiting or self._closing)
                self._writing = True  # first: who settles looks without the lock
                rows, self._waiting = self._waiting, []
                if not rows:
                    return
            try:
                self._write(rows)
            except Exception as error:  # the run has to hear of it, whatever it is
                self._error = error
            with self._lock:
                self._writing = False
                self._written.ring()
                if self._error is not None:
                    return
                # A row costs as much as ten: what comes meanwhile is written with it.
                self._condition.wait_for(lambda: self._closing, GATHER_S)

    def _write(self, rows: list[Fixes | Decisions | _Answer]) -> None:
        """Append and flush: whole tables at once, then the answers that belong to rows in them."""
        for kind in (Fixes, Decisions):
            groups = [one for one in rows if isinstance(one, kind)]
            if groups:
                self._append(groups)
        answers = sorted((one for one in rows if isinstance(one, _Answer)), key=lambda one: one.row)
        while answers:
            joined = [k for k, one in enumerate(answers) if one.row == answers[0].row + k]
            block, answers = answers[: len(joined)], answers[len(joined) :]
            rows_here = slice(block[0].row, block[-1].row + 1)
            for name, values in (
                ("robot_capture_us", [one.capture_us for one in block]),
                ("robot_status", [one.status for one in block]),
            ):
                data = self._file[f"{Fixes.NAME}/{name}"]
                data[rows_here] = values
                data.flush()

    def _append(self, groups: Sequence[Fixes | Decisions]) -> None:
        kind = groups[0]
        for name in [*kind.columns(), *kind.extra]:
            if f"{kind.NAME}/{name}" not in self._file:
                continue  # times of plans made on this computer are not logged
            columns = [one.extra[name] if name in one.extra else getattr(one, name) for one in groups]
            values = np.concatenate(columns)
            data = self._file[f"{kind.NAME}/{name}"]
            data.resize(len(data) + len(values), axis=0)
            data[len(data) - len(values) :] = values
            data.flush()


def logged(
    target: pathlib.Path | None,
    robot: Robot,
    tables: Tables,
    options: RunOptions,
    source: str,
    known: Mapping[str, float] | None = None,
) -> Callable[..., AbstractContextManager[Callable[[Recording], None]]]:
    """What begins, once the path is known, a live log beside ``target``; without a target there is none.

    ``known``: numbers about the run that are told from its start on. It is called with the path, and with how
    the run came about where that is known (``RunLog.made``).
    """

    @contextmanager
    def begin(path: Path, made: Mapping[str, str] | None = None) -> Iterator[Callable[[Recording], None]]:
        if target is None:
            yield lambda _recording: None
            return
        empty = run_log(Recording(), None, robot, tables, path, options, None, source, made=made)
        live = LiveLog(target, replace(empty, measured=known or {}, notes=CUT_OFF), options.onboard)
        try:
            yield live.keep
        finally:
            live.close()

    return begin
