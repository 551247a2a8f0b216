"""Path files: CSV with x, y and optionally dx, dy (the paper's form) or tangent_rad."""

from __future__ import annotations

import csv
import math
import pathlib
from collections.abc import Callable

import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.files import existing_file
from frogkick.core.poses import wrap_angle
from frogkick.paths.path import POINTS_MAX, Path
from frogkick.paths.shapes import from_waypoints

# Header names that are taken, and what they mean.
_NAMES = {
    "x": "x", "x_m": "x", "y": "y", "y_m": "y", "dx": "dx", "dx/ds": "dx", "dy": "dy", "dy/ds": "dy",
    "tangent_rad": "tangent_rad",
}  # fmt: skip


@typed
def from_csv(file: pathlib.Path | str, tell: Callable[[str], None] = lambda _line: None) -> Path:
    """Read a path from CSV.

    Without header: columns x, y or x, y, dx, dy (the paper's ``linep1.csv``). With header: x, y and
    optionally dx, dy or tangent_rad in any order. Up to 100 points with tangents are kept, so that the
    paper's path index keeps its meaning; any other file is resampled to 100 points by arc length, straight
    between the points.

    Args:
        file: the CSV file; metres, world frame.
        tell: gets a line where more than 100 points are resampled, with the largest deviation.

    Raises:
        InputError: missing or empty file, not text, unknown or missing columns, a cell that is not a finite
            number, a tangent without length, one point, no length, or a length that is likely in mm.
    """
    path, points_m = _read(file)
    if len(points_m) > POINTS_MAX:
        off_mm = 1e3 * float(path.distance_m(points_m).max())
        tell(
            f"path file {pathlib.Path(file).name!r}: {len(points_m)} points are resampled to {POINTS_MAX}, "
            f"the robot's limit; the given points are at most {off_mm:.2g} mm off the new path"
        )
    return path


def _read(file: pathlib.Path | str) -> tuple[Path, Float64]:
    """The path, and the points (n, 2) of the file."""
    source = existing_file(file, "path file")
    name = source.name
    try:
        text = source.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"path file {name!r} is not text (byte {error.start}): give a CSV file") from error
    if "\0" in text:
        raise InputError(f"path file {name!r} is not text (NUL bytes): give a CSV file")
    reader = csv.reader(text.splitlines())
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"path file {name!r} line {reader.line_num} is not CSV: {error}") from error
    if not rows:
        raise InputError(f"path file {name!r} holds no rows: give at least 2 points")
    wrong = [mark for mark in ";\t" if any(mark in cell for cell in rows[0][1])]
    if wrong:
        raise InputError(
            f"path file {name!r}: the columns are separated by {wrong[0]!r}: write commas between them, and "
            "numbers with a decimal point"
        )
    columns = _header(rows[0][1], name)
    if columns is None:
        width = len(rows[0][1])
        if width not in (2, 4):
            raise InputError(
                f"path file {name!r} has {width} columns and no header: give x, y or x, y, dx, dy"
            )
        columns = ["x", "y", "dx", "dy"][:width]
    else:
        rows = rows[1:]
    values = _numbers(rows, columns, name)
    points = np.column_stack([values["x"], values["y"]])
    if not {"tangent_rad", "dx"} & values.keys() or len(points) > POINTS_MAX:
        return from_waypoints(points, smooth=False, name=source.stem), points
    if "dx" in values:
        still = np.flatnonzero((values["dx"] == 0.0) & (values["dy"] == 0.0))
        if still.size:
            raise InputError(
                f"path file {name!r} row {rows[still[0]][0]}: the tangent dx, dy is 0, 0: give a direction"
            )
        tangent = np.arctan2(values["dy"], values["dx"])
    else:
        tangent = values["tangent_rad"]
        _check_radians(points, tangent, name)
    return Path.from_arrays(points[:, 0], points[:, 1], tangent, source.stem), points


def _check_radians(points_m: Float64, tangent: Float64, name: str) -> None:
    """Refuse tangents that fit the points as degrees but not as radians."""
    if len(points_m) < 2:
        return
    largest = float(np.abs(tangent).max())
    along = np.diff(points_m, axis=0)
    course = np.arctan2(along[:, 1], along[:, 0])
    off = [np.abs(wrap_angle(each[:-1] - course)).mean() for each in (tangent, np.radians(tangent))]
    if largest > 2.0 * math.pi and off[1] < off[0]:
        raise InputError(
            f"path file {name!r}: tangent_rad is up to {largest:.4g}, {math.degrees(off[0]):.0f} degrees off "
            f"the points' own direction and {math.degrees(off[1]):.0f} if in degrees: give radians"
        )


def _header(cells: list[str], name: str) -> list[str] | None:
    """Canonical column names, or None if the first row already holds numbers."""
    names = [cell.strip().lower() for cell in cells]
    # A row with any number in it is data (perhaps bad data), not a header: 'x,y' never parses.
    if any(_is_number(cell) for cell in names):
        return None
    columns = []
    for cell in names:
        if cell not in _NAMES:
            raise InputError(
                f"path file {name!r}: unknown column {cell!r}{nearest_name(cell, _NAMES)}: "
                "use x, y and optionally dx, dy or tangent_rad"
            )
        columns.append(_NAMES[cell])
    twice = [column for column in columns if columns.count(column) > 1]
    if twice:
        raise InputError(f"path file {name!r}: column {twice[0]!r} stands twice: keep one")
    if "tangent_rad" in columns and {"dx", "dy"} & {*columns}:
        raise InputError(f"path file {name!r}: tangent_rad and dx, dy are both given: keep one of them")
    for needed, when in (("x", True), ("y", True), ("dx", "dy" in columns), ("dy", "dx" in columns)):
        if when and needed not in columns:
            raise InputError(f"path file {name!r}: column {needed!r} is missing: add it")
    return columns


def _numbers(rows: list[tuple[int, list[str]]], columns: list[str], name: str) -> dict[str, Float64]:
    values = np.empty((len(rows), len(columns)))
    for index, (number, row) in enumerate(rows):
        if len(row) != len(columns):
            raise InputError(
                f"path file {name!r} row {number} has {len(row)} columns, expected {len(columns)} "
                f"({', '.join(columns)}): repair that row"
            )
        for column, cell in enumerate(row):
            if not _is_number(cell) or not math.isfinite(float(cell)):
                raise InputError(
                    f"path file {name!r} row {number} column {columns[column]!r} is {cell.strip()!r}: "
                    "give a finite number"
                )
            values[index, column] = float(cell)
    return {column: values[:, index] for index, column in enumerate(columns)}


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
