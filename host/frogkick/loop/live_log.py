"""A run's log while it runs: HDF5 whose rows are on disk as soon as they are known, readable after a kill.

Beside the log that is asked for, as ``run.h5.part``, in its layout; what was not known yet (the robot's
answer to a fix) is as if it never came. A run that ends by itself writes its log whole, and this one goes.
"""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace

import h5py

from frogkick.errors import InputError
from frogkick.loop.closed_loop import Recording, RunOptions
from frogkick.loop.record import decision_columns, fix_columns, run_log
from frogkick.loop.runlog import Decisions, Fixes, RunLog
from frogkick.loop.runlog_file import fill
from frogkick.paths import Path
from frogkick.planner.image import Tables
from frogkick.robot import Robot

CHUNK_ROWS = 256
CUT_OFF = "cut off while it ran"


def part_of(target: pathlib.Path) -> pathlib.Path:
    """Where the rows of a run are kept until it has ended."""
    return target.with_name(target.name + ".part")


class LiveLog:
    """Rows of one run, appended and flushed."""

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

    def keep(self, recording: Recording) -> None:
        """Write what is new.

        Raises:
            InputError: the disk is full.
        """
        new, decided = len(recording.fixes) - self._fixes, len(recording.decisions) - self._decisions
        told = [row for row in self._open if recording.fix_status[row] is not None]
        if not (new or decided or told):
            return
        try:
            if new or told:
                self._keep_fixes(recording, told)
            if decided:
                self._keep_decisions(recording)
        except (OSError, RuntimeError) as error:
            raise self._full() from error

    def close(self) -> None:
        """End it.

        Raises:
            InputError: the disk is full.
        """
        try:
            self._file.close()
        except (OSError, RuntimeError) as error:
            raise self._full() from error

    def _full(self) -> InputError:
        return InputError(f"the log {str(self.path)!r} cannot be written on: is the disk full?")

    def _keep_fixes(self, recording: Recording, told: list[int]) -> None:
        first, self._fixes = self._fixes, len(recording.fixes)
        if self._fixes > first:
            self._append(fix_columns(recording, first))
        for row in told:
            taken_us = recording.capture_us[row]
            for name, value in (
                ("robot_capture_us", -1 if taken_us is None else taken_us),
                ("robot_status", recording.fix_status[row]),
            ):
                data = self._file[f"{Fixes.NAME}/{name}"]
                data[row] = value
                data.flush()
        waiting = [*self._open, *range(first, self._fixes)]
        self._open = [row for row in waiting[-CHUNK_ROWS:] if recording.fix_status[row] is None]

    def _keep_decisions(self, recording: Recording) -> None:
        first, self._decisions = self._decisions, len(recording.decisions)
        rows = {fix.sequence: row for row, fix in reversed(list(enumerate(recording.fixes)))}
        offset_us = recording.clock_offset_us if self._onboard else 0
        made = decision_columns(recording.decisions[first:], rows, offset_us)
        self._append(made)

    def _append(self, group: Fixes | Decisions) -> None:
        columns = {name: getattr(group, name) for name in group.SCHEMA} | dict(group.extra)
        for name, rows in columns.items():
            if f"{group.NAME}/{name}" not in self._file:
                continue  # times of plans made on this computer are not logged
            data = self._file[f"{group.NAME}/{name}"]
            data.resize(len(data) + len(rows), axis=0)
            data[len(data) - len(rows) :] = rows
            data.flush()


def logged(
    target: pathlib.Path | None, robot: Robot, tables: Tables, options: RunOptions, source: str
) -> Callable[[Path], AbstractContextManager[Callable[[Recording], None]]]:
    """What begins, once the path is known, a live log beside ``target``; without a target there is none."""

    @contextmanager
    def begin(path: Path) -> Iterator[Callable[[Recording], None]]:
        if target is None:
            yield lambda _recording: None
            return
        empty = run_log(Recording(), None, robot, tables, path, options, None, source)
        live = LiveLog(target, replace(empty, measured={}, notes=CUT_OFF), options.onboard)
        try:
            yield live.keep
        finally:
            live.close()

    return begin
