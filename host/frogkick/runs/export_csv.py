"""Export of a run as CSV, one file for each group of columns, and as JSON for the rest."""

from __future__ import annotations

import csv
import io
import json
import math
import pathlib
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np

from frogkick.core.arrays import AnyArray
from frogkick.core.files import atomic_path
from frogkick.paths import Path
from frogkick.runs.runlog import RunLog


def export_csv(run: RunLog, folder: pathlib.Path) -> list[str]:
    """Write fixes.csv, decisions.csv, strokes.csv, run.json, and path.csv and truth.csv if a run has them.

    A column's name ends with its unit; a dataset of several numbers gives several columns
    (``estimate_vx_mps``). Missing values are empty. The folder is made if it does not exist.

    Returns:
        Names of the files.

    Raises:
        InputError: the folder cannot be written to.
    """
    files = {}
    for name, columns in columns_of(run):
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([_cell(value) for value in row])
        files[f"{name}.csv"] = text.getvalue()
    about = {
        "robot_id": run.robot_id,
        "source": run.source,
        "period_s": run.period_s,
        "pulse_s": run.pulse_s,
        "actions": list(run.action_names),
        "path": None if run.path is None else run.path.name,
        "then": [change.path.name for change in run.then],
        "table_crc": run.table_crc,
        "seed": run.seed,
        "notes": run.notes,
        "measured": dict(run.measured),
        "planner": dict(run.planner),
        "made": dict(run.made),
    }
    files["run.json"] = json.dumps(about, indent=2) + "\n"
    with ExitStack() as stack:  # all files or none
        for name, content in files.items():
            stack.enter_context(atomic_path(folder / name)).write_bytes(content.encode())
    return list(files)


_STATE = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_radps")
_PARTS = {"estimate": _STATE, "predicted": _STATE, "pose_world": _STATE[:3], "velocity_body": _STATE[3:]}


def columns_of(run: RunLog) -> Iterator[tuple[str, dict[str, AnyArray]]]:
    """Each group of a log with its columns, one-dimensional, by name."""
    for group in (run.fixes, run.decisions, run.strokes, run.truth):
        if group is None:
            continue
        columns: dict[str, AnyArray] = {}
        for name, values in group.all_columns().items():
            if values.ndim == 1:
                columns[name] = values
                continue
            parts = _PARTS.get(name, range(values.shape[1]))  # one column for each number of a row
            columns |= {f"{name}_{part}": values[:, k] for k, part in enumerate(parts)}
        if group is run.decisions:
            columns["action_name"] = np.array(run.decided(unseen=""), dtype=object)
        yield group.NAME, columns
    if run.path is not None:
        yield "path", _points(run.path)
    for number, change in enumerate(run.then, start=1):
        yield (
            f"then_{number}",
            {"decision": np.full(len(change.path), change.decision), **_points(change.path)},
        )


def _points(path: Path) -> dict[str, AnyArray]:
    return {"x_m": path.x_m, "y_m": path.y_m, "tangent_rad": path.tangent_rad}


def _cell(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    # repr: the shortest text that gives the same number again.
    return ("" if math.isnan(value) else repr(value)) if isinstance(value, float) else value
