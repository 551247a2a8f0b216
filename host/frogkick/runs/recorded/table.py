"""The paper's run file: two header lines, and twelve columns under nine names."""

from __future__ import annotations

import csv
import math
import pathlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError
from frogkick.core.files import existing_file

Float64 = NDArray[np.float64]

FIRST_CELL = "CV Data Logger started on:"
# The header that the authors' logger writes: "cost" stands for four columns.
HEADER = (
    "Timestamp (millisec since midnight today)", "x", "y", "theta", "xdot", "ydot", "thetadot", "cost",
    "last action",
)  # fmt: skip
COLUMNS = (
    "time_ms", "x", "y", "theta", "xdot", "ydot", "thetadot", "cost_total", "cost_distance", "cost_angle",
    "cost_progress", "last action",
)  # fmt: skip
ACTION_NAMES = tuple("ABCDEFGHI")
HEADER_LINES = 2
DAY_MS = 86_400_000


@dataclass(frozen=True)
class Table:
    """The rows as recorded.

    Args:
        started: the logger's own date and time text.
        time_s: (n,) s from the first row, not decreasing (midnight is carried over).
        carried: (n,) bool, rows whose stamp had a day added.
        pose_world: (n,3) x m, y m, theta rad, as recorded.
        velocity_world: (n,3) m/s, m/s, rad/s, as recorded.
        cost: (n,4) total, distance, angle, progress.
        action: (n,) index into ACTION_NAMES.
    """

    started: str
    time_s: Float64
    carried: NDArray[np.bool_]
    pose_world: Float64
    velocity_world: Float64
    cost: Float64
    action: NDArray[np.int64]


def read_table(file: pathlib.Path | str) -> Table:
    """Read a run file of the paper.

    Raises:
        InputError: missing, empty or foreign file, missing columns, a cell that is not a finite number, an
            unknown action, or time going back; with line and column.
    """
    source = existing_file(file, "recorded run")
    name = source.name
    try:
        text = source.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{name!r} is not a run: give a log (.h5) of 'frogkick run', or a recorded one like line1.csv"
        ) from error
    try:
        lines = list(csv.reader(text.replace("\0", "?").splitlines()))
    except csv.Error as error:
        raise InputError(f"{name!r} is not a recorded run ({error}): give a run like line1.csv") from error
    if not lines or not lines[0] or lines[0][0].strip() != FIRST_CELL:
        raise InputError(
            f"{name!r} is not a recorded run (no {FIRST_CELL!r} in line 1): give one like line1.csv"
        )
    header = tuple(cell.strip() for cell in lines[1]) if len(lines) > 1 else ()
    missing = [column for column in HEADER if column not in header]
    if missing:
        raise InputError(
            f"recorded run {name!r}: column {missing[0]!r} is missing in line 2: give the whole file"
        )
    rows = lines[HEADER_LINES:]
    while rows and not any(cell.strip() for cell in rows[-1]):
        rows.pop()
    if len(rows) < 2:
        raise InputError(f"recorded run {name!r} holds {len(rows)} rows: at least 2 are needed")
    values = np.empty((len(rows), len(COLUMNS) - 1))
    action = np.empty(len(rows), dtype=np.int64)
    for index, row in enumerate(rows):
        number = index + HEADER_LINES + 1
        if len(row) != len(COLUMNS):
            raise InputError(
                f"recorded run {name!r} line {number} has {len(row)} columns, expected {len(COLUMNS)}: "
                "repair or cut that line"
            )
        for column, cell in enumerate(row[:-1]):
            values[index, column] = _number(
                cell, f"recorded run {name!r} line {number} column {COLUMNS[column]!r}"
            )
        label = row[-1].strip()
        if label not in ACTION_NAMES:
            raise InputError(
                f"recorded run {name!r} line {number}: last action is {label!r}, known are "
                f"{ACTION_NAMES[0]} to {ACTION_NAMES[-1]}: repair that line"
            )
        action[index] = ACTION_NAMES.index(label)
    time_ms, carried = _carry_midnight(values[:, 0], name)
    return Table(
        started=lines[0][1].strip() if len(lines[0]) > 1 else "",
        time_s=(time_ms - time_ms[0]) * 1e-3,
        carried=carried,
        pose_world=values[:, 1:4],
        velocity_world=values[:, 4:7],
        cost=values[:, 7:11],
        action=action,
    )


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise InputError(f"{where} is {cell.strip()!r}: give a number") from None
    if not math.isfinite(value):
        raise InputError(f"{where} is {cell.strip()!r}: give a finite number or cut that line")
    return value


def _carry_midnight(stamp_ms: Float64, name: str) -> tuple[Float64, NDArray[np.bool_]]:
    """Time stamps across midnight: a step back by half a day or more is the next day."""
    step = np.diff(stamp_ms)
    days = np.concatenate([[0.0], np.cumsum(step < -DAY_MS / 2)])
    carried = stamp_ms + days * DAY_MS
    back = np.flatnonzero(np.diff(carried) < 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise InputError(
            f"recorded run {name!r} line {row + HEADER_LINES + 1}: time goes back from "
            f"{stamp_ms[row - 1]:.0f} to "
            f"{stamp_ms[row]:.0f} ms: sort the lines or cut the run there"
        )
    return carried, days > 0
