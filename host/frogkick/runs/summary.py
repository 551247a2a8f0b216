"""Numbers of a run from its log: path following, errors of predictions, wear; the comparison of two runs.

A run without decisions or poses raises ``InputError``; see ``track_of``.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError, body_from_world, wrap_angle
from frogkick.estimator.estimator import OUTLIERS_AGREE_M, OUTLIERS_AGREE_MPS
from frogkick.link.layout import link_layout
from frogkick.paths import Path
from frogkick.runs.decision import NOTHING_LOST
from frogkick.runs.path_change import spans_of
from frogkick.runs.runlog import RunLog, Tracking
from frogkick.tables.layout import LIMB_GONE, LOST_MAX

BATTERY_V = "battery_v"
"""Key of ``RunLog.measured``: lowest battery voltage, measured by a person before the run."""

LEARN, LOST = "learn", "lost_"
"""Key in ``RunLog.made`` of a run that estimated wear: its limbs. Prefix in ``measured``: of their shares."""

LOST_FOR = 5
"""Number of a limb's strokes in a row after which it must be estimated as lost, so that it is named so."""

BELIEVED_AGAIN = 0.5
"""Lost share below which a limb that was named as lost works again."""


@dataclass(frozen=True)
class Summary:
    """A run in numbers; None if the log does not contain a number."""

    # robot, source, path, period_s: as in ``RunLog``; the path's name
    robot: str
    source: str
    path: str | None
    then: tuple[str, ...]  # names of the paths that took over
    duration_s: float  # from the first decision to the end of the last one's period
    # decisions, actions: number of decisions; action name -> how often it was chosen
    decisions: int
    actions: dict[str, int]
    fixes: int  # usable fixes
    fixes_lost: int  # fixes flagged as missing, misdetected or duplicate, or refused by the robot
    measured_by: str  # source of the distances: ``truth`` of a simulated pool, or ``fixes``
    # mean_distance_m, p95_distance_m: to the path, from the first decision on
    mean_distance_m: float | None
    p95_distance_m: float | None
    progress_mps: float | None  # along the path
    # position_rmse_m, heading_rmse_rad: errors of the planner's prediction one period ahead
    position_rmse_m: float | None
    heading_rmse_rad: float | None
    battery_v: float | None  # lowest battery voltage, measured by a person before the run
    period_s: float
    # of a run of the paper: evidence for its stroke clock; see frogkick.runs.recorded
    clock: dict[str, float]
    notes: str  # how it ended
    made: dict[str, str]  # ``RunLog.made`` without the robot's TOML

    def as_json(self) -> dict[str, Any]:
        """All fields."""
        return asdict(self)


def true_poses_at(run: RunLog, time_s: ArrayLike) -> Float64:
    """(n, 3) true poses of a simulated run, interpolated; headings not wrapped."""
    if run.truth is None or len(run.truth) < 2:
        raise InputError(f"run {run.source!r} has no true poses: only a simulated run has them")
    poses = np.array(run.truth.pose_world)
    poses[:, 2] = np.unwrap(poses[:, 2])
    at = np.asarray(time_s, dtype=np.float64)
    return np.column_stack([np.interp(at, run.truth.time_s, poses[:, k]) for k in range(3)])


def residual(run: RunLog) -> tuple[Float64, Float64]:
    """Compare each prediction of a simulated run with the true pose a period later.

    Returns:
        (n,) times of the decisions with a prediction and a true end, s, and (n, 3) true minus predicted pose:
        forward, left (m) in the body frame at the decision, and heading (rad), wrapped.

    Raises:
        InputError: the run has no predictions, no truth or no complete period.
    """
    decisions = run.decisions
    if decisions.predicted is None or decisions.estimate is None:
        raise InputError(f"run {run.source!r} holds no predictions: log one with 'frogkick run'")
    end_s = decisions.time_s + run.period_s
    last_s = run.truth.time_s[-1] if run.truth is not None and len(run.truth) else -np.inf
    rows = np.flatnonzero(np.isfinite(decisions.predicted[:, 0]) & (end_s <= last_s))
    if rows.size == 0:
        raise InputError(f"run {run.source!r} has no complete period with a prediction: let it run longer")
    true_poses = true_poses_at(run, end_s[rows])
    gap = body_from_world(decisions.estimate[rows, 2], true_poses - decisions.predicted[rows, :3])
    gap[:, 2] = wrap_angle(gap[:, 2])
    return np.array(decisions.time_s[rows]), gap


def _seen(run: RunLog) -> tuple[Float64, Float64]:
    """Capture times and poses of the usable fixes, in order of these times."""
    rows = np.flatnonzero(run.fixes.usable)
    order = rows[np.argsort(run.fixes.capture_time_s[rows], kind="stable")]
    return run.fixes.capture_time_s[order], run.fixes.pose_world[order]


def track_of(run: RunLog) -> tuple[Float64, Float64, str]:
    """Track of a run's robot from the first decision on.

    Returns:
        (n,) times, (n, 3) poses, and their source: ``truth`` of a simulated pool, else the usable ``fixes``
        at their capture times.

    Raises:
        InputError: the run has no decisions, or fewer than two poses after the first one.
    """
    if not len(run.decisions):
        raise InputError(f"run {run.source!r} has no decisions: record one that swims")
    if run.truth is not None and len(run.truth):
        time_s, poses, of = run.truth.time_s, run.truth.pose_world, "truth"
    else:
        (time_s, poses), of = _seen(run), "fixes"
    last_s = run.decisions.time_s[-1] + run.period_s
    during = (time_s >= run.decisions.time_s[0]) & (time_s <= last_s)
    if during.sum() < 2:
        raise InputError(f"run {run.source!r} has no poses from its first decision on: record one with fixes")
    return np.asarray(time_s[during]), np.asarray(poses[during], dtype=np.float64), of


def along_paths(
    paths: Sequence[tuple[float, Path]],
    time_s: np.ndarray,
    poses_world: np.ndarray,
    until_s: float = math.inf,
) -> tuple[float, float, float]:
    """Mean and 95th percentile of the distance to the followed paths (m), and the progress along them (m/s).

    Args:
        paths: in order, each with the time from which on it is followed; -inf for the first.
        time_s: (n,) of the poses; fewer than two give zeros.
        poses_world: (n, 3) or (n, 2).
        until_s: end of the progress, because a robot that holds at the end of a path makes none.
    """
    if len(time_s) < 2:
        return 0.0, 0.0, 0.0
    distance_m = distances_m(paths, time_s, poses_world)
    advance_m = 0.0
    under_way_s = time_s[: max(2, int(np.searchsorted(time_s, until_s)))]
    for path, rows in _followed(paths, under_way_s):
        first, last = path.along_m[path.nearest_index(poses_world[[rows[0], rows[-1]], :2])]
        advance_m = advance_m + (last - first)
    progress_mps = advance_m / (under_way_s[-1] - under_way_s[0])
    return float(distance_m.mean()), float(np.percentile(distance_m, 95)), float(progress_mps)


def distances_m(
    paths: Sequence[tuple[float, Path]], time_s: np.ndarray, poses_world: np.ndarray
) -> np.ndarray:
    """(n,) distance of each pose to the path that was followed then, m; arguments as for ``along_paths``."""
    distance_m = np.zeros(len(time_s))
    for path, rows in _followed(paths, time_s):
        distance_m[rows] = path.distance_m(poses_world[rows, :2])
    return distance_m


def _followed(paths: Sequence[tuple[float, Path]], time_s: np.ndarray) -> Iterator[tuple[Path, np.ndarray]]:
    """Each path that was followed, in order, and the rows of the times at which it was."""
    newest = np.searchsorted([from_s for from_s, _ in paths], time_s, side="right") - 1
    for index, (_, path) in enumerate(paths):
        rows = np.flatnonzero(newest == index)
        if len(rows):
            yield path, rows


@dataclass(frozen=True)
class Bends:
    """The curvature of a path compared with the turns of the robot on it."""

    step_m: float  # distance along the path in one period
    asked_rad: float  # largest change of the path's direction over that distance
    turned_rad: float  # largest turn of the robot in a period

    @property
    def too_tight(self) -> bool:
        """Whether no choice of actions can stay on the path where it bends most."""
        return self.asked_rad > 1.1 * self.turned_rad


def bends_of(run: RunLog, progress_mps: float) -> Bends | None:
    """Compare a path's bends with the robot's turns; None if the log has no path, several, or too few poses.

    Args:
        run: the log.
        progress_mps: progress along the path.
    """
    if run.path is None or run.then or len(run.decisions) < 2:
        return None
    at_s = run.decisions.time_s
    if run.truth is not None and len(run.truth) > 1:
        headings_rad = true_poses_at(run, at_s)[:, 2]
    else:
        seen_s, poses = _seen(run)
        if len(seen_s) < 2:
            return None
        headings_rad = np.interp(at_s, seen_s, np.unwrap(poses[:, 2]))
    along_m = run.path.along_m
    tangent_rad = np.unwrap(run.path.tangent_rad)
    step_m = progress_mps * run.period_s
    starts_m = np.linspace(0.0, max(0.0, along_m[-1] - step_m), 400)
    before_rad, after_rad = (np.interp(at_m, along_m, tangent_rad) for at_m in (starts_m, starts_m + step_m))
    asked_rad = float(np.abs(after_rad - before_rad).max())
    return Bends(step_m, asked_rad, float(np.abs(np.diff(headings_rad)).max()))


def summary(run: RunLog) -> Summary:
    """The numbers of a run."""
    time_s, poses, of = track_of(run)
    names = ("mean_distance_m", "p95_distance_m", "progress_mps")
    numbers: dict[str, float | None] = dict.fromkeys((*names, "position_rmse_m", "heading_rmse_rad"))
    if run.path is not None:
        spans = spans_of(run)
        found = along_paths(run.paths, time_s, poses, spans[0][0] if spans else math.inf)
        # A run's own numbers end with the run, and its log has the true poses of some moments more.
        numbers |= {name: run.measured.get(name, value) for name, value in zip(names, found, strict=True)}
    if run.decisions.predicted is not None and run.truth is not None:
        numbers |= PredictionError.of(residual(run)[1]).as_json()
    usable = run.fixes.usable
    answered = run.fixes.extra.get("robot_status")
    lost = ~usable if answered is None else ~usable | (answered != 0)
    return Summary(
        robot=run.robot_id,
        source=run.source,
        path=None if run.path is None else run.path.name,
        then=tuple(change.path.name for change in run.then),
        duration_s=float(run.decisions.time_s[-1] + run.period_s - run.decisions.time_s[0]),
        decisions=len(run.decisions),
        actions=dict(sorted(Counter(run.decided()).items())),
        fixes=int(usable.sum()),
        fixes_lost=int(lost.sum()),
        measured_by=of,
        **numbers,
        battery_v=run.measured.get(BATTERY_V),
        period_s=run.period_s,
        clock={name: value for name, value in run.measured.items() if name.startswith(("clock_", "period_"))},
        notes=run.notes,
        made={name: text for name, text in run.made.items() if name != "robot_toml"},
    )


def tracking_of_log(run: RunLog) -> Tracking:
    """How well a run followed its path: as measured during the run, or from its log or its track.

    An unknown number is NaN, an unknown number of limit violations None.
    """
    if run.tracked is not None:
        return run.tracked
    computed, held = asdict(summary(run)), run.measured

    def number(name: str) -> float:
        value = held.get(name, computed.get(name))
        return math.nan if value is None else float(value)

    return Tracking(
        mean_distance_m=number("mean_distance_m"),
        p95_distance_m=number("p95_distance_m"),
        progress_mps=number("progress_mps"),
        completed=bool(held.get("completed", 0.0)),
        decisions=computed["decisions"],
        fixes_lost=int(number("fixes_lost")),
        limit_violations=int(held["limit_violations"]) if "limit_violations" in held else None,
        plan_ms_p99=held.get("plan_ms_p99"),
    )


def learned_limbs(run: RunLog) -> list[str]:
    """Limbs of a run that estimated wear, in the order of the column ``lost`` of its decisions."""
    return run.made[LEARN].split(", ") if LEARN in run.made else []


def lost_at_start(run: RunLog) -> tuple[int, ...]:
    """(8,) estimated share of each limb's contribution lost at the start of the run, 0 to 32767."""
    learned = run.decisions.extra.get("lost")
    return NOTHING_LOST if learned is None or not len(learned) else tuple(int(code) for code in learned[0])


def lost_of(run: RunLog) -> dict[str, float] | None:
    """Limb -> estimated share of its contribution lost at the end of the run; None without an estimate."""
    learned = run.decisions.extra.get("lost")
    if learned is None or not len(learned):
        return None
    return dict(zip(learned_limbs(run), (learned[-1] / LOST_MAX).tolist(), strict=False))


def limb_events(run: RunLog) -> list[dict[str, Any]] | None:
    """When a limb was named as worn or lost, and when it worked again; None: the run did not estimate wear.

    Returns:
        In order of time, each with ``time_s`` of the decision, ``limb``, ``event`` and the lost ``share``.
        Events: ``worn``: a share above 0; ``lost``: at least 0.8 of its contribution, which LOST_FOR of
        its strokes in a row have shown: that is rare for a limb that misfires; ``works``: less than 0.5 after
        it was lost, or 0 after it was worn.
    """
    if "lost" not in run.decisions.extra:
        return None
    limbs = learned_limbs(run)
    codes = np.asarray(run.decisions.extra["lost"])[:, : len(limbs)]
    named, seems_lost = dict.fromkeys(limbs, "works"), dict.fromkeys(limbs, 0)
    events: list[dict[str, Any]] = []
    for time_s, row, mask in zip(run.decisions.time_s, codes, _fired_before(run), strict=True):
        for index, (limb, code) in enumerate(zip(limbs, row, strict=True)):
            share = float(code) / LOST_MAX
            shown = mask >> index & 1
            seems_lost[limb] = seems_lost[limb] + shown if code >= LIMB_GONE else 0
            if seems_lost[limb] >= LOST_FOR:
                event = "lost"
            elif named[limb] == "lost" and share >= BELIEVED_AGAIN:
                continue
            else:
                event = "worn" if share and named[limb] != "lost" else "works"
            if event != named[limb]:
                named[limb] = event
                events.append({"time_s": float(time_s), "limb": limb, "event": event, "share": share})
    return events


def _fired_before(run: RunLog) -> list[int]:
    """Mask of the limbs whose pulses ended between each decision and the one before it."""
    masks = [0] * len(run.decisions)
    ends_s = run.strokes.time_s + run.strokes.pulse_s
    until = np.searchsorted(run.decisions.time_s, ends_s, side="right").tolist()
    for decision, mask in zip(until, run.strokes.limb_mask.tolist(), strict=True):
        if decision < len(masks):
            masks[decision] |= mask
    return masks


NO_ANSWER = 1
"""In ``robot_status`` of a fix: the robot gave no answer."""

REFUSED = {
    "OUTLIER": "they are too far from where the robot can be, and from one another by more than "
    f"{1e3 * OUTLIERS_AGREE_M:g} mm and {OUTLIERS_AGREE_MPS:g} m/s: the fixes are of something else, or "
    "something carries the robot away",
    "RANGE": "a number in them is not finite, or beyond 1000 m or rad: check the tracker's units",
    "OLD": "they are older than what the robot keeps: check the ages that the camera or the tracker gives",
    "DOUBLE": "it had them before: check that the tracker sends new ones",
}
"""Status of a refused fix -> why the robot refuses it, and what to check."""


def refused_fixes(run: RunLog) -> str:
    """Return why the robot refused the last fixes that it answered; "" if it accepted the last one."""
    answered = run.fixes.extra.get("robot_status")
    status = [] if answered is None else [int(one) for one in answered if one != NO_ANSWER]
    accepted = [row for row, one in enumerate(status) if one == 0]
    last = status[accepted[-1] + 1 if accepted else 0 :]
    if not last:
        return ""
    name, count = Counter(map(link_layout().status_name, last)).most_common(1)[0]
    why = REFUSED.get(name, "see the reference of the link")
    return f"the robot refused its last {len(last)} position fixes, {count} as {name}: {why}"


def no_fresh_fix(run: RunLog, at_s: float, limit_s: float) -> str:
    """Return why the robot has no fix of the last ``limit_s`` at a time of the session; what to check."""
    if refused := refused_fixes(run):
        return refused
    check = "check the camera and the light, or the tracker"
    if run.truth is not None:
        check = "check the effects of --world that change, delay or drop fixes"
    limit = f"one of the last {limit_s:g} s is needed: {check}"
    if not len(run.fixes):
        return f"no position fix came, and {limit}"
    age_s = at_s - float(run.fixes.capture_time_s.max())
    return f"its newest position fix is {age_s:.2f} s old, and {limit}"


@dataclass(frozen=True)
class Comparison:
    """Two runs side by side."""

    a: Summary
    b: Summary
    # same_robot, same_table, same_path: None if a log does not say
    same_robot: bool
    same_table: bool | None
    same_path: bool | None
    same_decisions: int  # number of decisions, from the first on, that chose the same action in both
    # mean distance between the robots at equal times since the first decision, until one run ended; None if
    # the paths differ
    apart_m: float | None

    def as_json(self) -> dict[str, Any]:
        """All fields, and the difference of each number as ``b_minus_a``."""
        both = asdict(self)
        a, b = both.pop("a"), both.pop("b")
        numbers = [key for key in a if isinstance(a[key], int | float) and isinstance(b[key], int | float)]
        return {"a": a, "b": b, "b_minus_a": {key: b[key] - a[key] for key in numbers}, **both}


def compare_runs(a: RunLog, b: RunLog) -> Comparison:
    """Compare two runs from each one's first decision on."""
    both = list(zip(a.decided(), b.decided(), strict=False))
    same = next((k for k, (first, second) in enumerate(both) if first != second), len(both))
    same_path = None
    if a.path is not None and b.path is not None:
        points = [[path.points_m for _, path in run.paths] for run in (a, b)]
        same_path = len(points[0]) == len(points[1]) and all(map(np.array_equal, *points))
    known = a.table_crc is not None and b.table_crc is not None
    return Comparison(
        summary(a),
        summary(b),
        same_robot=a.robot_id == b.robot_id,
        same_table=a.table_crc == b.table_crc if known else None,
        same_path=same_path,
        same_decisions=same,
        apart_m=_apart_m(a, b) if same_path else None,
    )


def _apart_m(a: RunLog, b: RunLog) -> float:
    (time_a, poses_a, _), (time_b, poses_b, _) = track_of(a), track_of(b)
    time_a, time_b = time_a - a.decisions.time_s[0], time_b - b.decisions.time_s[0]
    at = time_a[time_a <= time_b[-1]]
    other = np.column_stack([np.interp(at, time_b, poses_b[:, k]) for k in range(2)])
    return float(np.hypot(*(poses_a[: len(at), :2] - other).T).mean())
