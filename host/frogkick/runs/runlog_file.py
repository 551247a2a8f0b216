"""The run log's HDF5 layout.

Root attributes: format, format_version, robot_id, source, period_s, pulse_s, notes, and optionally table_crc
and seed. Groups: `fixes`, `decisions`, `strokes`, and optionally `path`, `then` (paths that took over, each
in a group by its number, and in `decision` the first row of `decisions` that follows each), `truth`
(simulated runs), `measured` and `planner` (numbers as attributes) and `made` (texts as datasets). Every
column has the attribute `unit`.

A log that frogkick wrote has further columns, from which a replay repeats the decisions exactly. They hold
what the planner, on robot or host, had received:

- `fixes/heard_us`: the capture time of a fix on the clock of `decisions/scheduled_us` (-1: not received);
- `fixes/heard_after`: the number of decisions before it;
- `decisions/rested_us`: the time from which the robot rested, because its guard refused the stroke
  (-1: it was fired);
- `decisions/rested_after`: the number of rows of `fixes` after which this was known.

Older logs lack these.
"""

from __future__ import annotations

import pathlib
from dataclasses import fields
from typing import Any

import h5py
import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.core.hdf5 import hdf5_to_read, hdf5_to_write
from frogkick.paths import POINTS_MAX, Path
from frogkick.runs.runlog import DecisionFlag, Decisions, Fixes, FixFlag, PathChange, RunLog, Strokes, Truth

FORMAT = "frogkick run"
FORMAT_VERSION = 1

# Unit of an extra column by the end of its name, longest first.
_SUFFIX_UNITS = {
    "_mps": "m/s",
    "_radps": "rad/s",
    "_rad_s": "rad/s",
    "_rad": "rad",
    "_m": "m",
    "_us": "us",
    "_s": "s",
}


def write_run(target: pathlib.Path | str, run: RunLog) -> None:
    """Write a run to HDF5, completely or not at all; the same run gives the same bytes.

    Raises:
        InputError: the folder cannot be written to.
    """
    with hdf5_to_write(target) as file:
        fill(file, run)


def fill(file: h5py.File, run: RunLog, chunk_rows: int = 0) -> None:
    """Write a run into an open file; with ``chunk_rows`` its columns can grow."""
    file.attrs["format"] = FORMAT
    file.attrs["format_version"] = FORMAT_VERSION
    for name in ("robot_id", "source", "period_s", "pulse_s", "notes"):
        file.attrs[name] = getattr(run, name)
    if run.table_crc is not None:
        file.attrs["table_crc"] = np.uint32(run.table_crc)
    if run.seed is not None:
        file.attrs["seed"] = np.int64(run.seed)
    for group in (run.fixes, run.decisions, run.strokes, run.truth):
        if group is not None:
            _write_group(file, group, chunk_rows)
    for name, flag in (("fixes", FixFlag), ("decisions", DecisionFlag)):
        file[f"{name}/flags"].attrs["bits"] = [f"{bit.name.lower()}={int(bit)}" for bit in flag if bit.name]
    file["decisions/action"].attrs["names"] = list(run.action_names) or h5py.Empty("S1")
    if run.path is not None:
        _write_path(file.create_group("path"), run.path)
    if run.then:
        group = file.create_group("then")
        group.create_dataset("decision", data=np.array([change.decision for change in run.then]))
        if any(change.hold for change in run.then):
            holds = [change.hold or (np.nan,) * 3 for change in run.then]
            group.create_dataset("hold", data=np.array(holds, dtype=np.float64))
        for number, change in enumerate(run.then):
            _write_path(group.create_group(str(number)), change.path, bool(chunk_rows))
    for title, numbers in (("measured", run.measured), ("planner", run.planner)):
        if numbers:
            group = file.create_group(title)
            for name in sorted(numbers):
                group.attrs[name] = float(numbers[name])
    if run.made:
        # As datasets: a robot's TOML is too long for an attribute.
        group = file.create_group("made")
        for name in sorted(run.made):
            group[name] = run.made[name]


def read_run(source: pathlib.Path | str) -> RunLog:
    """Read a run from HDF5.

    Raises:
        InputError: missing, empty, foreign, truncated or newer file; a missing group or column; NaN in a row
            that is not flagged as missing.
    """
    file_path = existing_file(source, "run log")
    name = file_path.name
    try:
        with hdf5_to_read(file_path) as file:
            return _read(file)
    except InputError as error:
        raise InputError(f"run log {name!r}: {str(error).removeprefix('run: ')}") from error
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"run log {name!r} is not HDF5, is truncated or is damaged ({reason}): record or import it again"
        ) from error


def _read(file: h5py.File) -> RunLog:
    if file.attrs.get("format") != FORMAT:
        found = file.attrs.get("format", "no format")
        raise InputError(f"run: this is another kind of file ({found!r}), expected {FORMAT!r}: give a run")
    version = int(file.attrs["format_version"])
    if version != FORMAT_VERSION:
        raise InputError(
            f"run: format version {version}, this frogkick reads {FORMAT_VERSION}: use a matching frogkick"
        )
    path = _read_path(file["path"]) if "path" in file else None
    names = file["decisions/action"].attrs["names"]
    fixes = Fixes(**_read_group(file, Fixes))
    decisions = Decisions(**_read_group(file, Decisions, len(fixes)))
    # After the decisions: a log that grows has a path before the decisions that follow it.
    changed = file["then/decision"][:].tolist() if "then" in file else []
    if file.attrs.get("live", False):
        changed = [decision if decision < len(decisions) else -1 for decision in changed]
    holds = file["then/hold"][:] if "then/hold" in file else np.full((len(changed), 3), np.nan)
    return RunLog(
        robot_id=str(file.attrs["robot_id"]),
        source=str(file.attrs["source"]),
        period_s=float(file.attrs["period_s"]),
        pulse_s=float(file.attrs["pulse_s"]),
        action_names=() if isinstance(names, h5py.Empty) else tuple(str(action) for action in names),
        fixes=fixes,
        decisions=decisions,
        strokes=Strokes(**_read_group(file, Strokes)),
        path=path,
        # -1: the run of this log has not reached it yet
        then=tuple(
            PathChange(decision, _read_path(file[f"then/{number}"]), _hold_of(holds[number]))
            for number, decision in enumerate(changed)
            if decision >= 0
        ),
        truth=Truth(**_read_group(file, Truth)) if "truth" in file else None,
        table_crc=int(file.attrs["table_crc"]) if "table_crc" in file.attrs else None,
        seed=int(file.attrs["seed"]) if "seed" in file.attrs else None,
        notes=str(file.attrs["notes"]),
        measured=_numbers(file, "measured"),
        planner=_numbers(file, "planner"),
        made={name: text.asstr()[()] for name, text in file["made"].items()} if "made" in file else {},
    )


def _write_path(group: h5py.Group, path: Path, grows: bool = False) -> None:
    group.attrs["name"] = path.name
    how: dict[str, Any] = {"maxshape": (POINTS_MAX,), "chunks": (POINTS_MAX,)} if grows else {}
    for name, unit in (("x_m", "m"), ("y_m", "m"), ("tangent_rad", "rad")):
        group.create_dataset(name, data=getattr(path, name), **how).attrs["unit"] = unit


def _read_path(group: h5py.Group) -> Path:
    return Path(group["x_m"][:], group["y_m"][:], group["tangent_rad"][:], str(group.attrs["name"]))


def _hold_of(row: Any) -> tuple[float, float, int] | None:
    return None if np.isnan(row[0]) else (float(row[0]), float(row[1]), int(row[2]))


def _numbers(file: h5py.File, title: str) -> dict[str, float]:
    return {name: float(value) for name, value in file[title].attrs.items()} if title in file else {}


def _write_group(file: h5py.File, group: Fixes | Decisions | Strokes | Truth, chunk_rows: int) -> None:
    target = file.create_group(group.NAME)
    for name, values in group.all_columns().items():
        if name in group.columns():
            unit = group.columns()[name].unit
        else:
            unit = next((unit for end, unit in _SUFFIX_UNITS.items() if name.endswith(end)), "1")
        grows: dict[str, Any] = {}
        if chunk_rows:
            grows = {"maxshape": (None, *values.shape[1:]), "chunks": (chunk_rows, *values.shape[1:])}
        target.create_dataset(name, data=values, **grows).attrs["unit"] = unit


def _read_group(
    file: h5py.File, kind: type[Fixes | Decisions | Strokes | Truth], fixes: int = 0
) -> dict[str, Any]:
    """The columns of a group; ``fixes``: number of its rows that were read before, for a log that grows."""
    if kind.NAME not in file:
        raise InputError(f"run: group {kind.NAME!r} is missing: record or import it again")
    group = file[kind.NAME]
    columns: dict[str, Any] = {}
    for name, column in kind.columns().items():
        if name in group:
            columns[name] = group[name][:]
        elif not column.optional:
            raise InputError(f"run: column {kind.NAME}/{name} is missing: record or import it again")
    known = {entry.name for entry in fields(kind)}
    columns["extra"] = {name: group[name][:] for name in group if name not in known}
    if file.attrs.get("live", False):
        _cut(columns, fixes)
    return columns


def _cut(columns: dict[str, Any], fixes: int) -> None:
    """Cut the columns of an unfinished log to the rows that all of them have."""
    extra = columns.pop("extra")
    rows = min(len(values) for values in [*columns.values(), *extra.values()])
    for part in (columns, extra):
        part.update({name: values[:rows] for name, values in part.items()})
    columns["extra"] = extra
    if "fix_sequence" in columns:
        columns["fix_sequence"] = np.where(columns["fix_sequence"] < fixes, columns["fix_sequence"], -1)
