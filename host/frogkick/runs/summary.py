"""What a log says of its run in a few numbers, whoever recorded it; and of two runs side by side."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError
from frogkick.runs.record import BATTERY_V, Tracking, along_path
from frogkick.runs.residual import residual
from frogkick.runs.runlog import RunLog

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Summary:
    """A run in numbers. What a log has nothing to tell from is None.

    Attributes:
        robot: its id.
        source: what made the log.
        path: name.
        duration_s: from the first to the last decision's end.
        decisions: of these.
        actions: name -> how often.
        fixes: usable ones.
        fixes_lost: flagged as missing, misdetected or doubled, or refused by the robot.
        measured_by: ``truth`` of a simulated pool, or ``fixes``: what distances are of.
        mean_distance_m, p95_distance_m: to the path, from the first decision on.
        progress_mps: along the path.
        position_rmse_m, heading_rmse_rad: of the planner's prediction a period ahead.
        battery_v: of the lowest battery, as a person measured it before the run.
        period_s: from one decision to the next.
        clock: of a recorded run, how its period was told; see frogkick.runs.recorded.
        notes: how it ended.
        made: how it came about, as ``RunLog.made`` has it, without the robot's text.
    """

    robot: str
    source: str
    path: str | None
    duration_s: float
    decisions: int
    actions: dict[str, int]
    fixes: int
    fixes_lost: int
    measured_by: str
    mean_distance_m: float | None
    p95_distance_m: float | None
    progress_mps: float | None
    position_rmse_m: float | None
    heading_rmse_rad: float | None
    battery_v: float | None
    period_s: float
    clock: dict[str, float]
    notes: str
    made: dict[str, str]

    def as_json(self) -> dict[str, Any]:
        """All of it."""
        return asdict(self)


def track_of(run: RunLog) -> tuple[FloatArray, FloatArray, str]:
    """(n,) times and (n, 3) poses of a run's robot, from the first decision on, and what they are of.

    The truth of a simulated pool, else the usable fixes at their capture times.

    Raises:
        InputError: the run has no decision, or nobody saw the robot.
    """
    if not len(run.decisions):
        raise InputError(f"run {run.source!r} has no decisions: record one that swims")
    if run.truth is not None and len(run.truth):
        time_s, poses, of = run.truth.time_s, run.truth.pose_world, "truth"
    else:
        rows = np.flatnonzero(run.fixes.usable)
        order = rows[np.argsort(run.fixes.capture_time_s[rows], kind="stable")]
        time_s, of = run.fixes.capture_time_s[order], "fixes"
        poses = np.column_stack([run.fixes.x_m[order], run.fixes.y_m[order], run.fixes.heading_rad[order]])
    last_s = run.decisions.time_s[-1] + run.period_s
    during = (time_s >= run.decisions.time_s[0]) & (time_s <= last_s)
    if during.sum() < 2:
        raise InputError(f"run {run.source!r} shows nothing of the robot from its first decision on")
    return np.asarray(time_s[during]), np.asarray(poses[during], dtype=np.float64), of


def summary(run: RunLog) -> Summary:
    """The numbers of a run.

    Raises:
        InputError: it has no decision, or nobody saw the robot.
    """
    time_s, poses, of = track_of(run)
    distances: tuple[float | None, float | None, float | None] = (None, None, None)
    if run.path is not None:
        distances = along_path(run.path, time_s, poses)
    known = run.decisions.predicted is not None and run.truth is not None
    error = residual(run).error if known else None
    usable = run.fixes.usable
    answered = run.fixes.extra.get("robot_status")
    lost = ~usable if answered is None else ~usable | (answered != 0)
    names = [run.action_names[index] if index >= 0 else "?" for index in run.decisions.action]
    return Summary(
        robot=run.robot_id,
        source=run.source,
        path=None if run.path is None else run.path.name,
        duration_s=float(run.decisions.time_s[-1] + run.period_s - run.decisions.time_s[0]),
        decisions=len(run.decisions),
        actions=dict(sorted(Counter(names).items())),
        fixes=int(usable.sum()),
        fixes_lost=int(lost.sum()),
        measured_by=of,
        mean_distance_m=distances[0],
        p95_distance_m=distances[1],
        progress_mps=distances[2],
        position_rmse_m=None if error is None else error.position_rmse_m,
        heading_rmse_rad=None if error is None else error.heading_rmse_rad,
        battery_v=run.measured.get(BATTERY_V),
        period_s=run.period_s,
        clock={name: value for name, value in run.measured.items() if name.startswith(("clock_", "period_"))},
        notes=run.notes,
        made={name: text for name, text in run.made.items() if name != "robot_toml"},
    )


def tracking_of_log(run: RunLog) -> Tracking:
    """How well a run followed its path, as its log tells.

    What a log of ours holds is given back; of others it is told from the track. A number that nothing shows
    is NaN, limits that nobody watched are None.

    Raises:
        InputError: it has no decision, or nobody saw the robot.
    """
    found, held = summary(run), run.measured
    unknown = float("nan")
    broken = held.get("limit_violations")

    def number(name: str, else_: float | None) -> float:
        return held.get(name, unknown if else_ is None else else_)

    return Tracking(
        mean_distance_m=number("mean_distance_m", found.mean_distance_m),
        p95_distance_m=number("p95_distance_m", found.p95_distance_m),
        progress_mps=number("progress_mps", found.progress_mps),
        completed=bool(held.get("completed", 0.0)),
        decisions=found.decisions,
        fixes_lost=int(number("fixes_lost", found.fixes_lost)),
        limit_violations=None if broken is None else int(broken),
        plan_ms_p99=number("plan_ms_p99", None),
    )


@dataclass(frozen=True)
class Comparison:
    """Two runs side by side.

    Attributes:
        a, b: each.
        same_robot, same_table, same_path: None where a log does not say.
        same_decisions: how many decisions from the first on chose the same action in both.
        apart_m: mean distance between both robots at the same time since the first decision, as long as
            both swam; None where the paths differ.
    """

    a: Summary
    b: Summary
    same_robot: bool
    same_table: bool | None
    same_path: bool | None
    same_decisions: int
    apart_m: float | None

    def as_json(self) -> dict[str, Any]:
        """All of it, and by how much the second differs from the first."""
        told = {"a": self.a.as_json(), "b": self.b.as_json()}
        more = {}
        for key, first in told["a"].items():
            second = told["b"][key]
            if isinstance(first, int | float) and isinstance(second, int | float):
                more[key] = second - first
        rest = {key: getattr(self, key) for key in ("same_robot", "same_table", "same_path")}
        return {
            **told,
            "b_minus_a": more,
            **rest,
            "same_decisions": self.same_decisions,
            "apart_m": self.apart_m,
        }


def compare_runs(a: RunLog, b: RunLog) -> Comparison:
    """Two runs, compared from each one's first decision on.

    Raises:
        InputError: one of them has no decision, or nobody saw its robot.
    """
    one, two = summary(a), summary(b)
    both = list(zip(_actions(a), _actions(b), strict=False))
    same = next((k for k, (first, second) in enumerate(both) if first != second), len(both))
    same_path = None
    if a.path is not None and b.path is not None:
        same_path = np.array_equal(a.path.points_m, b.path.points_m)
    known = a.table_crc is not None and b.table_crc is not None
    return Comparison(
        one,
        two,
        a.robot_id == b.robot_id,
        a.table_crc == b.table_crc if known else None,
        same_path,
        same,
        _apart_m(a, b) if same_path else None,
    )


def _actions(run: RunLog) -> list[str]:
    return [run.action_names[index] if index >= 0 else "?" for index in run.decisions.action]


def _apart_m(a: RunLog, b: RunLog) -> float:
    (time_a, poses_a, _), (time_b, poses_b, _) = track_of(a), track_of(b)
    time_a, time_b = time_a - a.decisions.time_s[0], time_b - b.decisions.time_s[0]
    at = time_a[time_a <= time_b[-1]]
    other = np.column_stack([np.interp(at, time_b, poses_b[:, k]) for k in range(2)])
    return float(np.hypot(*(poses_a[: len(at), :2] - other).T).mean())
