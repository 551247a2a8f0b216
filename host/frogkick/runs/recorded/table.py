"""The rows of a recorded run, read from the paper's file, and the errors of single frames marked.

The file has two header lines, and twelve columns under nine names. Thresholds come from the published runs:
the noise at rest is 0.2 mm and 0.2 degrees, the fastest stroke moves the robot at 0.13 m/s and 1.6 rad/s.
NOISE_POSITION_M was chosen on these seven runs so that an error of 3.9 mm in ellipse6 is found; it has not
been tested on other runs.
"""

from __future__ import annotations

import csv
import math
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.runs.runlog import FixFlag

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
LARGEST = 1e9
"""No number of a run is larger, its time stamps included."""
SPACING_MIN_S = 0.020
"""Every second frame of a 30 Hz camera is logged, so true spacings are longer."""
SETTLED_ROWS = 5
"""Successive rows with a credible spacing that end the backlog at the start."""
GAP_S = 0.150
"""The usual spacing is 67 ms, 133 ms with one lost frame: a longer one means at least two."""
# Six times the noise between frames, and more acceleration and speed than in any stroke.
NOISE_POSITION_M, NOISE_HEADING_RAD = 1.5e-3, np.radians(2.0)
ACCELERATION_MPS2, ACCELERATION_RADPS2 = 1.0, np.radians(1000.0)
SPEED_MAX_MPS, TURN_MAX_RADPS = 0.2, 2.5
MISDETECTED_ROWS_MAX = 3
"""Largest number of successive wrong frames."""
IMPOSSIBLE_SHARE, IMPOSSIBLE_MOST = 0.25, 5
"""More wrong frames and jumps than both are no errors of single frames, but other units or columns. Published
runs have a share of up to 0.004; one of them in mm or cm has 0.98, in degrees 0.64."""


@dataclass(frozen=True)
class Table:
    """The rows as recorded."""

    started: str  # the logger's own date and time text
    time_s: Float64  # (n,) s from the first row, not decreasing (midnight is carried over)
    carried: Bool  # (n,) bool, rows whose stamp had a day added
    pose_world: Float64  # (n,3) x m, y m, theta rad, as recorded
    velocity_world: Float64  # (n,3) m/s, m/s, rad/s, as recorded
    cost: Float64  # (n,4) total, distance, angle, progress
    action: Int64  # (n,) index into ACTION_NAMES


def read_table(file: pathlib.Path | str) -> Table:
    """Read a run file of the paper.

    Raises:
        InputError: missing, empty or foreign file, missing columns, a cell that is not a finite number, an
            unknown action, or time going back; with line and column.
    """
    source = existing_file(file, "recorded run")
    name = source.name
    numbered = _numbered_lines(source)
    _check_header(name, numbered)
    rows = numbered[HEADER_LINES:]
    if len(rows) < 2:
        raise InputError(f"recorded run {name!r} holds {len(rows)} rows: at least 2 are needed")
    values = np.empty((len(rows), len(COLUMNS) - 1))
    action = np.empty(len(rows), dtype=np.int64)
    for index, (number, row) in enumerate(rows):
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
    time_ms, carried = _carry_midnight(values[:, 0], name, [number for number, _ in rows])
    return Table(
        started=numbered[0][1][1].strip() if len(numbered[0][1]) > 1 else "",
        time_s=(time_ms - time_ms[0]) * 1e-3,
        carried=carried,
        pose_world=values[:, 1:4],
        velocity_world=values[:, 4:7],
        cost=values[:, 7:11],
        action=action,
    )


def _numbered_lines(source: pathlib.Path) -> list[tuple[int, list[str]]]:
    """(number in the file, cells) of the lines of a CSV file that are not empty."""
    name = source.name
    try:
        text = source.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raw = source.read_bytes()
        if any(FIRST_CELL.encode(code) in raw for code in ("ascii", "utf-16-le", "utf-16-be")):
            raise InputError(
                f"recorded run {name!r} is not UTF-8 from byte {error.start} on: save it again as UTF-8"
            ) from error
        raise InputError(
            f"{name!r} is not a run: give a log (.h5) of 'frogkick run', or a recorded one like line1.csv"
        ) from error
    try:
        reader = csv.reader(text.replace("\0", "?").splitlines())
        return [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]
    except csv.Error as error:
        raise InputError(f"{name!r} is not a recorded run ({error}): give a run like line1.csv") from error


def _check_header(name: str, numbered: Sequence[tuple[int, list[str]]]) -> None:
    """Refuse lines that do not begin as the authors' logger begins a file."""
    first = numbered[0][1][0].strip() if numbered else ""
    if first != FIRST_CELL:
        if first.startswith(FIRST_CELL):
            raise InputError(
                f"recorded run {name!r} separates its columns by {first[len(FIRST_CELL)]!r}: needed are "
                "commas, and a point in decimal numbers"
            )
        raise InputError(
            f"{name!r} is not a recorded run (no {FIRST_CELL!r} in line 1): give one like line1.csv"
        )
    line, cells = numbered[1] if len(numbered) > 1 else (2, [])
    header = {cell.strip() for cell in cells}
    missing = [column for column in HEADER if column not in header]
    if missing:
        raise InputError(
            f"recorded run {name!r}: column {missing[0]!r} is missing in line {line}: give the whole file"
        )


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise InputError(f"{where} is {cell.strip()!r}: give a number") from None
    if not math.isfinite(value):
        raise InputError(f"{where} is {cell.strip()!r}: give a finite number or cut that line")
    if abs(value) > LARGEST:
        raise InputError(f"{where} is {cell.strip()!r}, more than {LARGEST:g}: correct it or cut that line")
    return value


def _carry_midnight(stamp_ms: Float64, name: str, lines: Sequence[int]) -> tuple[Float64, Bool]:
    """Time stamps across midnight: a step back by half a day or more is the next day."""
    step = np.diff(stamp_ms)
    days = np.concatenate([[0.0], np.cumsum(step < -DAY_MS / 2)])
    carried = stamp_ms + days * DAY_MS
    back = np.flatnonzero(np.diff(carried) < 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise InputError(
            f"recorded run {name!r} line {lines[row]}: time goes back from "
            f"{stamp_ms[row - 1]:.0f} to "
            f"{stamp_ms[row]:.0f} ms: sort the lines or cut the run there"
        )
    return carried, days > 0


def untrusted_times(time_s: Float64) -> Bool:
    """(n,) rows whose time stamp is not the time of their frame.

    These are the leading rows up to the first with five credible spacings after it (a backlog that the logger
    wrote at once), and any later row within 20 ms of the row before.
    """
    spacing = np.diff(time_s)
    untrusted = np.concatenate([[False], spacing < SPACING_MIN_S])
    if not untrusted[: SETTLED_ROWS + 1].any():
        return untrusted
    close = np.flatnonzero(spacing < SPACING_MIN_S)
    # The backlog ends at the first row after which the next spacings are all credible.
    end = next(
        (
            int(row) + 1
            for row in close
            if not (spacing[row + 1 : row + 1 + SETTLED_ROWS] < SPACING_MIN_S).any()
        ),
        len(time_s),
    )
    untrusted[:end] = True
    return untrusted


def misdetections(time_s: Float64, pose: Float64, trusted: Bool) -> Bool:
    """(n,) rows where the tag jumped away and back.

    A group of up to three successive frames is wrong if all of them are off the straight line in time between
    the frames before and after, by more than noise + a/2 (t - t_before)(t_after - t) in position or heading
    (1.5 mm and 1 m/s^2; 2 degrees and 1000 degrees/s^2), while these two frames agree within 0.2 m/s and 2.5
    rad/s. The worst group is removed first, then the search is repeated.

    Args:
        time_s: (n,) s.
        pose: (n, 3) x m, y m, heading rad (any wrapping).
        trusted: (n,) rows with a usable time; others are left out.
    """
    unwrapped = np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])])
    kept = np.flatnonzero(trusted)
    wrong = np.zeros(len(time_s), dtype=bool)
    while True:
        worst, group = 0.0, None
        for width in range(1, MISDETECTED_ROWS_MAX + 1):
            found = _worst_group(time_s[kept], unwrapped[kept], width)
            if found is not None and found[0] > worst:
                worst, group = found[0], kept[found[1] : found[1] + width]
        if group is None:
            return wrong
        wrong[group] = True
        kept = kept[~wrong[kept]]


def _worst_group(time_s: Float64, pose: Float64, width: int) -> tuple[float, int] | None:
    """(distance in units of noise, first row) of the worst group of ``width`` rows; distance 0: none.

    Groups are ranked by distance, not by excess over the limit: a good frame beside a wrong group is off by
    half the distance, but its limit is narrower.
    """
    count = len(time_s) - width - 1
    if count < 1:
        return None
    first = np.arange(1, count + 1)
    before, after = first - 1, first + width
    span = time_s[after] - time_s[before]
    step = pose[after] - pose[before]
    returns = (np.hypot(step[:, 0], step[:, 1]) <= SPEED_MAX_MPS * span + NOISE_POSITION_M) & (
        np.abs(step[:, 2]) <= TURN_MAX_RADPS * span + NOISE_HEADING_RAD
    )
    excess, size = np.full(count, np.inf), np.full(count, np.inf)
    for offset in range(width):
        row = first + offset
        ahead, behind = time_s[row] - time_s[before], time_s[after] - time_s[row]
        off = pose[row] - pose[before] - step * (ahead / span)[:, None]
        bend = 0.5 * ahead * behind
        position, heading = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
        beyond = np.maximum(
            position / (NOISE_POSITION_M + ACCELERATION_MPS2 * bend),
            heading / (NOISE_HEADING_RAD + ACCELERATION_RADPS2 * bend),
        )
        excess = np.minimum(excess, beyond)
        size = np.minimum(size, np.maximum(position / NOISE_POSITION_M, heading / NOISE_HEADING_RAD))
    size[~returns | (excess <= 1.0)] = 0.0
    worst = int(size.argmax())
    return float(size[worst]), int(first[worst])


def jumps(time_s: Float64, pose: Float64, usable: Bool) -> Bool:
    """(n,) usable rows farther from the usable row before than the robot can go."""
    rows = np.flatnonzero(usable)
    span = np.diff(time_s[rows])
    step = np.diff(np.column_stack([pose[rows, :2], np.unwrap(pose[rows, 2])]), axis=0)
    far = (np.hypot(step[:, 0], step[:, 1]) > SPEED_MAX_MPS * span + NOISE_POSITION_M) | (
        np.abs(step[:, 2]) > TURN_MAX_RADPS * span + NOISE_HEADING_RAD
    )
    marked = np.zeros(len(time_s), dtype=bool)
    marked[rows[1:][far]] = True
    return marked


def check_units(name: str, pose: Float64, flags: Int64) -> None:
    """Refuse a run whose frames cannot be those of a robot in the units of the file.

    Args:
        name: of the file, for the error.
        pose: (n, 3) x m, y m, theta rad, as recorded.
        flags: (n,) FixFlag bits of ``mark_frames``.

    Raises:
        InputError: no frame has a usable time, or too many are farther from others than the robot can go.
    """
    trusted = (flags & int(FixFlag.UNTRUSTED_TIME | FixFlag.DUPLICATE)) == 0
    if not trusted.any():
        raise InputError(
            f"recorded run {name!r}: no frame has a usable time, as all stamps are less than "
            f"{1e3 * SPACING_MIN_S:.0f} ms apart: give times in ms since midnight, and the whole run"
        )
    impossible = trusted & ((flags & int(FixFlag.MISDETECTION | FixFlag.JUMP)) != 0)
    if impossible.sum() > max(IMPOSSIBLE_SHARE * trusted.sum(), IMPOSSIBLE_MOST):
        x, y, theta = np.ptp(pose[trusted], axis=0)
        raise InputError(
            f"recorded run {name!r}: {impossible.sum()} of {trusted.sum()} frames are farther from others "
            f"than the robot can swim or turn (x spans {x:.4g}, y {y:.4g}, theta {theta:.4g}): give x and y "
            "in m, theta in rad"
        )


def mark_frames(time_s: Float64, pose: Float64, carried: Bool) -> tuple[Int64, Int64]:
    """Quality (n,) and FixFlag bits (n,) of each row, without AT_REST."""
    repeat = np.concatenate([[False], (np.diff(pose, axis=0) == 0.0).all(axis=1)])
    # The stamp of a repeated row does not count against its neighbours.
    twice = repeat & np.concatenate([[False], np.diff(time_s) < SPACING_MIN_S])
    untrusted = np.zeros(len(time_s), dtype=bool)
    untrusted[~twice] = untrusted_times(time_s[~twice])
    wrong = misdetections(time_s, pose, ~untrusted & ~repeat)
    jumped = jumps(time_s, pose, ~untrusted & ~repeat & ~wrong)
    # No frame after it can confirm a jump in the last row.
    unconfirmed = jumped & (np.arange(len(time_s)) == len(time_s) - 1)
    gap = np.concatenate([[False], np.diff(time_s) > GAP_S])
    flags = np.zeros(len(time_s), dtype=np.int64)
    for rows, flag in (
        (untrusted, FixFlag.UNTRUSTED_TIME),
        (gap, FixFlag.AFTER_GAP),
        (wrong, FixFlag.MISDETECTION),
        (jumped, FixFlag.JUMP),
        (repeat, FixFlag.DUPLICATE),
        (carried, FixFlag.REPAIRED_STAMP),
    ):
        flags[rows] |= int(flag)
    quality = np.where(wrong | repeat | unconfirmed, 0, 1)
    return quality, flags
