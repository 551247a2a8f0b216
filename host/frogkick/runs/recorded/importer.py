"""Imports the paper's runs as run logs."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.core.hdf5 import is_hdf5
from frogkick.core.poses import body_from_world, wrap_angle
from frogkick.paths import from_csv
from frogkick.robot import Robot, load_robot
from frogkick.runs.recorded.clock import Clock, estimate_clock
from frogkick.runs.recorded.table import ACTION_NAMES, Table, check_units, mark_frames, read_table
from frogkick.runs.runlog import DecisionFlag, Decisions, Fixes, FixFlag, RunLog, Strokes
from frogkick.runs.runlog_file import read_run, write_run

ROBOT_ID = "frog2022"
PULSE_S = 0.080
REST = ACTION_NAMES.index("I")
# Limbs in the order front right, front left, rear left, rear right; bit i of a mask is limb i.
_LIMBS = {
    "A": "1100", "B": "1111", "C": "0111", "D": "1011", "E": "0110", "F": "1001", "G": "0100", "H": "1000",
    "I": "0000",
}  # fmt: skip
FRONT_MASK = 0b0011
ACTION_MASKS = tuple(
    sum(1 << limb for limb, on in enumerate(_LIMBS[name]) if on == "1") for name in ACTION_NAMES
)
COST_NAMES = ("cost_total", "cost_distance", "cost_angle", "cost_progress")
LABEL_MARGIN_S = 0.15
"""Frames this close to the ends of a period may have the label of the neighbouring period."""
SPEED_OVER_S = 0.2
"""Frames farther apart do not resolve the speed within a stroke."""
CLOCK_UNUSABLE, CLOCK_SLIPS = "stroke clock not usable: ", "stroke clock slips by "
CLOCK_NOTES = (CLOCK_UNUSABLE, CLOCK_SLIPS, "labels contradict")
RUN_NAME = re.compile(r"(line|sin|ellipse)(\d+)\.csv")


def path_file(run_file: pathlib.Path) -> pathlib.Path:
    """The path beside a run: line1.csv -> linep1.csv."""
    match = RUN_NAME.fullmatch(run_file.name)
    if match is None:
        raise InputError(
            f"recorded run {run_file.name!r}: no path file belongs to this name: call it lineN.csv, sinN.csv "
            "or ellipseN.csv with its path linepN.csv, sinpN.csv or ellipsepN.csv beside it"
        )
    return run_file.with_name(f"{match[1]}p{match[2]}.csv")


def read_recorded(file: pathlib.Path | str) -> RunLog:
    """A run of the paper as a run log.

    The frame is that of the file: x, y of the pool, theta from +x counter-clockwise along the robot's forward
    direction, wrapped to (-pi, pi]. `time_s` is the logger's time stamp from the first row; `capture_time_s`
    is the same (the record lacks the camera's delay), NaN for frames of the backlog at the start. Decision
    times come from the stroke clock. Front limbs count as fired at the decision, rear limbs one pulse later;
    motion follows `measured["motion_lag_s"]` after the label. `cost_*` are the authors' costs of the state in
    the row; a decision has those of the newest fix before it. The `logged_v*` columns are differences over
    one camera frame, with a noise of 4 to 24 mm/s and 0.2 to 0.4 rad/s at rest (slope 0.75 to 1.24 against
    positions): they show what the authors' planner used, and do not suit identification.

    Raises:
        InputError: not a recorded run, no path beside it, a bad cell, or other units.
    """
    source = existing_file(file, "recorded run")
    table = read_table(source)
    beside = path_file(source)
    if not beside.exists():
        raise InputError(
            f"recorded run {source.name!r}: its path file {beside.name!r} is not beside it: add it"
        )
    path = from_csv(beside)
    heading = wrap_angle(table.pose_world[:, 2])
    pose = np.column_stack([table.pose_world[:, :2], heading])
    quality, flags = mark_frames(table.time_s, pose, table.carried)
    check_units(source.name, table.pose_world, flags)
    untrusted = (flags & int(FixFlag.UNTRUSTED_TIME)) != 0
    usable = (quality == 1) & ~untrusted
    start_s, end_s, speed = forward_speed(table.time_s, pose, usable)
    near = (end_s - start_s < SPEED_OVER_S) & (end_s > start_s)
    motion = (0.5 * (start_s + end_s)[near], speed[near])
    limits_s = period_limits(load_robot(ROBOT_ID))
    clock = estimate_clock(table.time_s, table.action, ~untrusted, REST, limits_s, motion)
    decisions, strokes = _decisions(table, clock)
    first_s = decisions.time_s[0] if len(decisions) else np.inf
    flags[table.time_s < first_s] |= int(FixFlag.AT_REST)
    measured: dict[str, float] = {}
    notes = [f"imported from a run of Huang 2022, recorded {table.started}"]
    if clock is None:
        notes.append("no action fires in it")
    else:
        measured = dict(clock.evidence)
        notes += [
            f"{CLOCK_SLIPS}{slip.jump_s:+.3f} s between {slip.time_s:.2f} and {slip.until_s:.2f} s"
            for slip in clock.slips
        ]
        if clock.problem:
            notes.append(f"{CLOCK_UNUSABLE}{clock.problem}")
        if (slack_s := clock.evidence["clock_slack_s"]) < 0.0:
            notes.append(f"labels contradict a constant stroke clock by {-slack_s:.3f} s")
        lag = motion_lag(table.time_s, pose, usable, decisions.time_s[decisions.action != REST])
        if lag is not None:
            measured["motion_lag_s"] = lag
    extra = {
        "logged_vx_world_mps": table.velocity_world[:, 0],
        "logged_vy_world_mps": table.velocity_world[:, 1],
        "logged_omega_radps": table.velocity_world[:, 2],
        "logged_action": table.action,
        **dict(zip(COST_NAMES, table.cost.T, strict=True)),
    }
    fixes = Fixes(
        time_s=table.time_s,
        capture_time_s=np.where(untrusted, np.nan, table.time_s),
        x_m=pose[:, 0],
        y_m=pose[:, 1],
        heading_rad=pose[:, 2],
        quality=quality,
        flags=flags,
        extra=extra,
    )
    return RunLog(
        robot_id=ROBOT_ID,
        source=source.name,
        period_s=clock.period_s if clock else load_robot(ROBOT_ID).period_s,
        pulse_s=PULSE_S,
        action_names=ACTION_NAMES,
        fixes=fixes,
        decisions=decisions,
        strokes=strokes,
        path=path,
        notes="; ".join(notes),
        measured=measured,
    )


def forward_speed(time_s: Float64, pose: Float64, usable: Bool) -> tuple[Float64, Float64, Float64]:
    """Start and end (s) of all pairs of successive usable frames, and (k,) speed along the heading, m/s."""
    rows = np.flatnonzero(usable)
    start, end = time_s[rows[:-1]], time_s[rows[1:]]
    step = np.diff(pose[rows], axis=0)
    along = body_from_world(pose[rows[1:], 2], step)[:, 0]
    return start, end, along / np.maximum(end - start, 1e-3)


def motion_lag(time_s: Float64, pose: Float64, usable: Bool, fired_s: Float64) -> float | None:
    """Time from a label to the onset of forward motion, s; None with too few frames.

    The forward speed around all strokes is fitted by a line (the glide) plus a ramp from the onset on,
    averaged over the interval of each pair of frames. The result is uncertain: other windows and glide models
    gave 0.05 to 0.12 s for the same run. Stroke times come from the labels alone.

    Args:
        time_s, pose, usable: the frames, (n,), (n, 3), (n,).
        fired_s: (k,) s, start of the actions that fire.
    """
    if usable.sum() < 2 or not fired_s.size:
        return None
    start, end, speed = forward_speed(time_s, pose, usable)
    nearest = fired_s[np.abs(0.5 * (start + end)[:, None] - fired_s[None, :]).argmin(axis=1)]
    a, b = start - nearest, end - nearest
    used = (a > -0.25) & (b < 0.20) & (b - a < 0.15)
    if used.sum() < 20:
        return None
    a, b, speed = a[used], b[used], speed[used]
    candidates = np.arange(-0.05, 0.15, 0.002)
    errors = []
    for onset in candidates:
        ramp = (np.maximum(b - onset, 0.0) ** 2 - np.maximum(a - onset, 0.0) ** 2) / (2.0 * (b - a))
        design = np.column_stack([np.ones_like(ramp), 0.5 * (a + b), ramp])
        errors.append(float(((design @ np.linalg.lstsq(design, speed, rcond=None)[0] - speed) ** 2).sum()))
    return float(candidates[int(np.argmin(errors))])


def period_limits(robot: Robot) -> tuple[float, float]:
    """Shortest and longest period of a robot, s, by its pulse, rest, delay and measured frequencies."""
    measured = [p.frequency_hz for p in robot.profiles if p.egain_percent == robot.egain_percent]
    shortest = robot.pulse_s + max(robot.guard.rest_min_s, robot.second_delay_s)
    if not measured:
        return shortest, 2.0 * robot.period_s
    return max(shortest, 1.0 / max(measured)), 1.0 / min(measured)


def clock_problem(run: RunLog) -> str:
    """Why a run's stroke clock is not usable; "" if it is, or for our own logs."""
    if not run.measured.get("clock_unusable"):
        return ""
    return next(
        (part[len(CLOCK_UNUSABLE) :] for part in run.notes.split("; ") if part.startswith(CLOCK_UNUSABLE)),
        "its import could not determine the period",
    )


def _decisions(table: Table, clock: Clock | None) -> tuple[Decisions, Strokes]:
    """One decision per period from the first label that fires on, and their strokes."""
    if clock is None:
        return (
            Decisions(time_s=[], action=[], fix_sequence=[], flags=[]),  # type: ignore[arg-type]
            Strokes(time_s=[], limb_mask=[], pulse_s=[]),  # type: ignore[arg-type]
        )
    firing = int(np.flatnonzero(table.action != REST)[0])
    time_s = clock.starts_s
    ends = np.minimum(np.append(time_s[1:], np.inf), time_s + clock.period_s)
    action = np.empty(len(time_s), dtype=np.int64)
    for index, (start, end) in enumerate(zip(time_s, ends, strict=True)):
        within = (table.time_s >= start) & (table.time_s < end)
        if index == 0:
            within[:firing] = False
        core = within & (table.time_s >= start + LABEL_MARGIN_S) & (table.time_s < end - LABEL_MARGIN_S)
        labels = table.action[core if core.any() else within]
        action[index] = np.bincount(labels).argmax() if labels.size else -1
    newest = np.searchsorted(table.time_s, time_s, side="left") - 1
    # An action first seen in row 0 was decided before any row was logged.
    cost = table.cost[np.maximum(newest, 0)]
    flags = np.where(action < 0, int(DecisionFlag.UNSEEN), 0) | np.where(
        newest < 0, int(DecisionFlag.NO_PLAN), 0
    )
    cost = np.where((newest < 0)[:, None], np.nan, cost)
    decisions = Decisions(
        time_s=time_s,
        action=action,
        fix_sequence=newest,
        flags=flags,
        cost=cost[:, 0],
        extra=dict(zip(COST_NAMES[1:], cost.T[1:], strict=True)),
    )
    fired: list[tuple[float, int]] = []
    for start, label in zip(time_s.tolist(), action.tolist(), strict=True):
        mask = ACTION_MASKS[label] if label >= 0 else 0
        groups = ((start, mask & FRONT_MASK), (start + PULSE_S, mask & ~FRONT_MASK))
        fired += [(time, limbs) for time, limbs in groups if limbs]
    return decisions, Strokes(
        time_s=np.array([time for time, _ in fired]),
        limb_mask=np.array([limbs for _, limbs in fired]),
        pulse_s=np.full(len(fired), PULSE_S),
    )


def cost_mismatch(run: RunLog) -> float:
    """Largest difference of the four logged costs from 500 d + 50 |angle| + 300 (1 - i/(n-1)).

    d is in m to the nearest path point i, the angle in rad to its tangent. The path in float32 contributes up
    to about 1e-4.
    """
    fixes, path = run.fixes, run.path
    if path is None or COST_NAMES[0] not in fixes.extra:
        raise InputError(
            f"run {run.source!r} has no path or no logged costs: give a recorded run of the paper"
        )
    points = np.column_stack([fixes.x_m, fixes.y_m])
    index = path.nearest_index(points)
    distance = 500.0 * np.hypot(*(points - path.points_m[index]).T)
    angle = 50.0 * np.abs(wrap_angle(fixes.heading_rad - path.tangent_rad[index]))
    progress = 300.0 * (1.0 - index / (len(path) - 1))
    cost = np.column_stack([distance + angle + progress, distance, angle, progress])
    logged = np.column_stack([fixes.extra[name] for name in COST_NAMES])
    return float(np.abs(cost - logged).max())


def summarise(run: RunLog) -> dict[str, Any]:
    """Figures of a run, for people and --json: counts, clock, noise at rest, distance to the path.

    The noise is 1.4826 times the median absolute difference of successive frames at rest, over sqrt 2,
    without slow drift. Distances are from the path's segments to good fixes from the first decision on.
    """
    fixes = run.fixes
    flag = fixes.flags.astype(np.int64)
    good = fixes.quality == 1
    rest = np.flatnonzero(good & ((flag & int(FixFlag.AT_REST)) != 0))
    moving = fixes.usable & ((flag & int(FixFlag.AT_REST)) == 0)
    summary: dict[str, Any] = {
        "run": run.source,
        "rows": len(fixes),
        "rest_rows": len(rest),
        "untrusted_time_rows": _count(flag, FixFlag.UNTRUSTED_TIME),
        "gaps": _count(flag, FixFlag.AFTER_GAP),
        "longest_gap_s": float(np.diff(fixes.time_s).max()) if len(fixes) > 1 else 0.0,
        "misdetections": _count(flag, FixFlag.MISDETECTION),
        "jumps": _count(flag, FixFlag.JUMP),
        "duplicates": _count(flag, FixFlag.DUPLICATE),
        "duration_s": float(fixes.time_s[-1] - fixes.time_s[0]) if len(fixes) else 0.0,
        "period_s": run.period_s,
        "decisions": len(run.decisions),
        "strokes": len(run.strokes),
        **{name: float(value) for name, value in run.measured.items()},
        "clock_notes": [part for part in run.notes.split("; ") if part.startswith(CLOCK_NOTES)],
    }
    if len(rest) > 3:
        steps = np.diff(np.column_stack([fixes.x_m[rest], fixes.y_m[rest]]), axis=0)
        turn = wrap_angle(np.diff(fixes.heading_rad[rest]))
        summary["rest_noise_m"] = float(np.hypot(_spread(steps[:, 0]), _spread(steps[:, 1])) / np.sqrt(2.0))
        summary["rest_noise_rad"] = _spread(turn)
    if run.path is not None and moving.any():
        distance = run.path.distance_m(np.column_stack([fixes.x_m, fixes.y_m])[moving])
        summary["mean_distance_m"] = float(distance.mean())
        summary["p95_distance_m"] = float(np.percentile(distance, 95))
    if COST_NAMES[0] in fixes.extra and run.path is not None:
        summary["cost_mismatch"] = cost_mismatch(run)
    return summary


def load_run(file: pathlib.Path | str) -> RunLog:
    """Read a run from our HDF5 log or from a recorded run of the paper, by the file's content.

    Raises:
        InputError: neither of them, or a damaged file.
    """
    source = existing_file(file, "run")
    if is_hdf5(source) or source.suffix in (".h5", ".hdf5"):
        return read_run(source)
    return read_recorded(source)


def import_recorded(
    data_dir: pathlib.Path | str,
    out_dir: pathlib.Path | str,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[dict[str, Any]]:
    """Convert the runs of a folder that have a path beside them, to OUT_DIR/NAME.h5.

    All runs are checked before the first file is written.

    Args:
        data_dir: folder with lineN.csv, sinN.csv, ellipseN.csv and their paths, or with `control` in it.
        out_dir: folder to write to, made if it is missing.
        progress: called with runs done and all runs.

    Returns:
        A summary of each run, in order of name and number, with "file"; a run without a path has only "run"
        and "skipped".

    Raises:
        InputError: no such folder, no run in it, or a run that cannot be read.
    """
    folder = pathlib.Path(data_dir)
    if not folder.is_dir():
        raise InputError(
            f"data folder {str(data_dir)!r} is not a folder: give one with lineN.csv and linepN.csv"
        )
    if not _run_files(folder) and (folder / "control").is_dir():
        folder = folder / "control"
    files = _run_files(folder)
    ready = [file for file in files if path_file(file).exists()]
    if not ready:
        raise InputError(
            f"data folder {str(data_dir)!r} holds {len(files)} recorded runs and none with its "
            "path beside it: "
            "give one with lineN.csv and linepN.csv (or sin, ellipse)"
        )
    runs = []
    for done, file in enumerate(ready):
        progress(done, len(ready))
        runs.append((file, read_recorded(file)))
    summaries: dict[str, dict[str, Any]] = {}
    for file, run in runs:
        write_run(pathlib.Path(out_dir) / f"{file.stem}.h5", run)
        summaries[file.name] = {**summarise(run), "file": f"{file.stem}.h5"}
    progress(len(ready), len(ready))
    return [
        summaries.get(
            file.name, {"run": file.name, "skipped": f"path file {path_file(file).name!r} is missing"}
        )
        for file in files
    ]


def _run_files(folder: pathlib.Path) -> list[pathlib.Path]:
    found = [(match, file) for file in folder.iterdir() if (match := RUN_NAME.fullmatch(file.name))]
    order = {"line": 0, "sin": 1, "ellipse": 2}
    return [
        file for match, file in sorted(found, key=lambda item: (order[item[0][1]], int(item[0][2]), item[1]))
    ]


def _count(flags: Int64, flag: FixFlag) -> int:
    return int(((flags & int(flag)) != 0).sum())


def _spread(differences: Float64) -> float:
    return float(1.4826 * np.median(np.abs(differences - np.median(differences))) / np.sqrt(2.0))
