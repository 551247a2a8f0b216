"""From a recording to the run's log, and from a log to the numbers people ask for."""

from __future__ import annotations

import hashlib
import pathlib
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.poses import wrap_angle
from frogkick.core.version import VERSION
from frogkick.core.weights import WEIGHTS
from frogkick.paths import Path
from frogkick.planner.plan import PlanConfig
from frogkick.pool.monitor import pulses_of, violations
from frogkick.pool.pool import Pool
from frogkick.robot import Robot
from frogkick.runs.closed_loop import Recording, RunOptions
from frogkick.runs.decision import Decision
from frogkick.runs.runlog import DecisionFlag, Decisions, Fixes, RunLog, Strokes, Truth
from frogkick.tables.image import Tables

BATTERY_V = "battery_v"
"""In a log's ``measured``: what a person measured before the run."""

_FIELDS = tuple(entry.name for entry in fields(PlanConfig))
_FIRST_FIELDS = (*list(WEIGHTS)[:4], "depth")  # older logs know no others: those keep their defaults
_WHOLE = {"depth": (1, 4), "cost": (0, 1), "transitions_max": (0, 1e7)}


STOOD_DECISIONS, STOOD_MPS = 10, 1e-4


@dataclass(frozen=True)
class Tracking:
    """How well a run followed its path, from the first decision to the end.

    Distances are of the true pose (simulated runs) or of the fixes to the path's polyline.
    ``limit_violations`` is None where nobody saw the pins.
    """

    mean_distance_m: float
    p95_distance_m: float
    progress_mps: float
    completed: bool
    decisions: int
    fixes_lost: int
    limit_violations: int | None
    plan_ms_p99: float

    @property
    def stood(self) -> bool:
        """Many decisions, and it is no farther along its path than before: 0.1 mm/s at most."""
        return not self.completed and self.decisions >= STOOD_DECISIONS and self.progress_mps < STOOD_MPS

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``run``."""
        return asdict(self)


def decision_columns(
    decisions: Sequence[Decision], fix_rows: dict[int, int], clock_offset_us: int = 0
) -> Decisions:
    """Decisions as log columns.

    Args:
        decisions: in order.
        fix_rows: row in ``fixes`` of each fix sequence number.
        clock_offset_us: robot time minus the log's.
    """
    failed = np.array([d.status != 0 for d in decisions], dtype=bool)
    not_planned = np.where(failed, np.nan, 1.0)
    return Decisions(
        time_s=np.array([(d.scheduled_us - clock_offset_us) * 1e-6 for d in decisions]),
        action=np.array([d.action for d in decisions], dtype=np.int64),
        fix_sequence=np.array([fix_rows.get(d.fix_sequence, -1) if d.fixes else -1 for d in decisions]),
        flags=np.where(failed, int(DecisionFlag.NO_PLAN), 0),
        cost=np.array([float(d.cost) for d in decisions]) * not_planned,
        estimate=np.array([d.estimate for d in decisions], dtype=np.float64).reshape(-1, 6)
        * not_planned[:, None],
        predicted=np.array([d.predicted for d in decisions], dtype=np.float64).reshape(-1, 6)
        * not_planned[:, None],
        plan_s=np.array([d.plan_us * 1e-6 for d in decisions]) * not_planned,
        extra={
            "status": np.array([d.status for d in decisions], dtype=np.int64),
            "path_index": np.array([d.path_index for d in decisions], dtype=np.int64),
            "scheduled_us": np.array([d.scheduled_us for d in decisions], dtype=np.int64),
            "limb_use": np.array([d.limb_use for d in decisions], dtype=np.int64).reshape(-1, 8),
        },
    )


def fix_columns(recording: Recording, first: int = 0) -> Fixes:
    """Fixes as log columns, from a row on."""
    fixes = recording.fixes[first:]
    poses = np.array([fix.pose_world for fix in fixes], dtype=np.float64).reshape(-1, 3)
    count = len(fixes)
    return Fixes(
        time_s=np.array(recording.sent_s[first:]),
        capture_time_s=np.array([fix.capture_s for fix in fixes]),
        x_m=poses[:, 0],
        y_m=poses[:, 1],
        heading_rad=wrap_angle(poses[:, 2]),
        quality=np.ones(count, dtype=np.uint8),
        flags=np.zeros(count, dtype=np.uint16),
        extra={
            "sequence": np.array([fix.sequence for fix in fixes], dtype=np.int64),
            # On the robot's clock; -1 where the robot took none.
            "robot_capture_us": np.array(
                [-1 if us is None else us for us in recording.capture_us[first:]], dtype=np.int64
            ),
            # What the robot answered to it; 1 where no answer came.
            "robot_status": np.array(
                [1 if status is None else status for status in recording.fix_status[first:]], dtype=np.int64
            ),
        },
    )


def run_log(
    recording: Recording,
    pool: Pool | None,
    robot: Robot,
    tables: Tables,
    path: Path,
    options: RunOptions,
    seed: int | None,
    source: str,
    known: Mapping[str, float] | None = None,
    made: Mapping[str, str] | None = None,
) -> RunLog:
    """The log of a run.

    Args:
        recording: of ``run_session`` or ``run_session``.
        pool: the simulated one where it swam, which gives the truth; None: a real one.
        robot, tables, path, options: as in the run.
        seed: of the camera's noise, where that was simulated.
        source: what made the log, without folders.
        known: numbers about the run from elsewhere, for ``RunLog.measured``.
        made: how it came about, for ``RunLog.made``.
    """
    fixes = recording.fixes
    pulses = pulses_of(recording.edges, recording.end_s)
    starts = sorted({(pulse.start_s, pulse.end_s) for pulse in pulses})
    masks = [sum(1 << p.limb for p in pulses if (p.start_s, p.end_s) == start) for start in starts]
    tracked = tracking_of_recording(recording, pool, robot, path).as_json()
    rows = {fix.sequence: row for row, fix in reversed(list(enumerate(fixes)))}  # of a doubled one the first
    # The host decides on its own clock.
    offset_us = recording.clock_offset_us if options.onboard else 0
    decisions = decision_columns(recording.decisions, rows, offset_us)
    if not options.onboard:
        # Measured on this computer's clock, not the robot's: the same seed shall give the same log.
        decisions = replace(decisions, plan_s=None)
        del tracked["plan_ms_p99"]
    return RunLog(
        robot_id=robot.id,
        source=source,
        period_s=tables.period_us * 1e-6,
        pulse_s=tables.pulse_us * 1e-6,
        action_names=tuple(action.name for action in robot.actions),
        fixes=fix_columns(recording),
        decisions=decisions,
        strokes=Strokes(
            time_s=np.array([start for start, _ in starts]),
            limb_mask=np.array(masks, dtype=np.int64),
            pulse_s=np.array([end - start for start, end in starts]),
        ),
        path=path,
        truth=None if pool is None else _truth(pool),
        table_crc=tables.crc32,
        seed=seed,
        notes=recording.ended,
        measured={
            **{
                key: float(value)
                for key, value in tracked.items()
                if value is not None and np.isfinite(value)
            },
            **(known or {}),
        },
        planner={key: float(value) for key, value in asdict(options.config).items()},
        made=made or {},
    )


def made_of(robot: Robot, tables: Tables, began_unix_s: float) -> dict[str, str]:
    """How a run came about, for ``RunLog.made``.

    Args:
        robot, tables: as in the run.
        began_unix_s: the wall clock at time 0 of the run, s since 1970.
    """
    program = pathlib.Path(sys.argv[0] if sys.argv else "")
    is_ours = program.stem == "frogkick" or program.parts[-3:] == ("frogkick", "cli", "main.py")
    return {
        "began_at": datetime.fromtimestamp(began_unix_s, UTC).isoformat(timespec="microseconds"),
        "frogkick": VERSION,
        "robot_toml": robot.toml,
        "robot_sha256": robot.sha256.hex(),
        "table_sha256": hashlib.sha256(tables.image).hexdigest(),
        **({"command": shlex.join(["frogkick", *sys.argv[1:]])} if is_ours else {}),
    }


def _truth(pool: Pool) -> Truth:
    return Truth(
        time_s=np.array(pool.truth.time_s),
        pose_world=np.array(pool.truth.pose_world).reshape(-1, 3),
        velocity_body=np.array(pool.truth.velocity_body).reshape(-1, 3),
    )


def config_of_log(run: RunLog) -> PlanConfig:
    """The planner configuration that a log holds.

    Raises:
        InputError: it holds none, or not a whole one.
    """
    missing = [name for name in _FIRST_FIELDS if name not in run.planner]
    if missing:
        raise InputError(
            f"run {run.source!r} does not say the planner's {missing[0]}: choose --planner paper or robot"
        )
    values = {name: run.planner[name] for name in _FIELDS if name in run.planner}
    for name, value in values.items():
        limits = _WHOLE[name] if name in _WHOLE else (0.0, WEIGHTS[name].most)
        if not limits[0] <= value <= limits[1] or (name in _WHOLE and value != int(value)):
            raise InputError(
                f"run {run.source!r}: planner {name} is {value:g}, allowed is {limits[0]:g} to "
                f"{limits[1]:g}: choose --planner paper or robot"
            )
    whole = {name: int(value) for name, value in values.items() if name in _WHOLE}
    weights = {name: value for name, value in values.items() if name not in _WHOLE}
    return PlanConfig(**{**weights, **whole})  # type: ignore[arg-type]


def tracking_of_recording(recording: Recording, pool: Pool | None, robot: Robot, path: Path) -> Tracking:
    """Numbers of a run: distances of the true poses, or where there is no simulated pool of the fixes."""
    if pool is None:
        taken = [f for f, status in zip(recording.fixes, recording.fix_status, strict=True) if status == 0]
        time_s = np.array([fix.capture_s for fix in taken])
        seen = np.array([fix.pose_world for fix in taken], dtype=np.float64).reshape(-1, 3)
    else:
        time_s, seen = np.array(pool.truth.time_s), np.array(pool.truth.pose_world).reshape(-1, 3)
    during = (time_s >= recording.first_decision_s) & (time_s <= recording.end_s)
    poses = seen[during]
    plan_ms = [d.plan_us * 1e-3 for d in recording.decisions if d.status == 0]
    pulses = pulses_of(recording.edges, recording.end_s)
    mean_m, p95_m, progress_mps = along_path(path, time_s[during], poses)
    return Tracking(
        mean_distance_m=mean_m,
        p95_distance_m=p95_m,
        progress_mps=progress_mps,
        completed=recording.completed,
        decisions=len(recording.decisions),
        fixes_lost=recording.fixes_refused,
        limit_violations=None if pool is None and not pulses else len(violations(robot, pulses)),
        plan_ms_p99=float(np.percentile(plan_ms, 99)) if plan_ms else 0.0,
    )


def along_path(path: Path, time_s: np.ndarray, poses_world: np.ndarray) -> tuple[float, float, float]:
    """Mean and 95th percentile of the distance to a path (m), and the progress along it (m/s).

    Args:
        path: the path.
        time_s: (n,) times of the poses.
        poses_world: (n, 3) or (n, 2) poses; without any, three zeros come back.
    """
    if len(time_s) < 2:
        return 0.0, 0.0, 0.0
    distance_m = path.distance_m(poses_world[:, :2])
    arc_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.points_m, axis=0).T))])
    reached = path.nearest_index(poses_world[[0, -1], :2])
    progress_mps = (arc_m[reached[1]] - arc_m[reached[0]]) / (time_s[-1] - time_s[0])
    return float(distance_m.mean()), float(np.percentile(distance_m, 95)), float(progress_mps)
