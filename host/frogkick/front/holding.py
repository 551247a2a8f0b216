"""``run --hold``: how tightly a robot circles the end of its path, and how near to it a run stayed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.paths import Path
from frogkick.paths.hold import LAP_POINTS, hold_at_end
from frogkick.planner.lookup import DYNAMICS, TableArrays, arrays_of, dynamics_after, find_row, motion_of
from frogkick.planner.plan import PlanConfig
from frogkick.runs.holding import HOLD_LIMIT_M, spans_of
from frogkick.runs.runlog import RunLog
from frogkick.runs.summary import track_of
from frogkick.tables.image import Tables

RADIUS_M = 0.075
ROOM = 1.2
"""Radius of a circle that a robot can follow, in radii of its tightest turn."""
PERIODS = 40
TURN_MIN_RAD = 0.01


def turn_radius_m(tables: Tables, robot_id: str) -> float:
    """Radius of the tightest turn that a robot can do to both sides, m, by its table's own word.

    It is the circle of one action that is done again and again.

    Raises:
        InputError: no action turns the robot to one of the sides.
    """
    arrays = arrays_of(tables)
    turns = [_turning(arrays, action) for action in range(len(tables.actions))]
    radii = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        there = [m / (2.0 * math.sin(0.5 * abs(rad))) for m, rad in turns if sign * rad > TURN_MIN_RAD]
        if not there:
            raise InputError(
                f"--hold: no action turns the robot {robot_id!r} to the {side}, so it cannot circle the end "
                "of its path: leave out --hold"
            )
        radii.append(min(there))
    return max(radii)


def _turning(arrays: TableArrays, action: int) -> tuple[float, float]:
    """How far an action moves (m) and turns (rad) the robot in a period, when it has been repeated long."""
    dynamics, after = np.zeros(DYNAMICS, dtype=np.int64), np.zeros(DYNAMICS, dtype=np.int64)
    motion = np.zeros(3, dtype=np.float32)
    for _ in range(PERIODS):
        row = find_row(arrays, dynamics)
        motion_of(arrays, row, dynamics, action, motion)
        dynamics_after(arrays, row, dynamics, action, after)
        dynamics[:] = after
    return math.hypot(motion[0], motion[1]), float(motion[2])


def hold_radius_m(tables: Tables, robot_id: str) -> float:
    """Radius of the circle about a path's end, m: three quarters of the limit, more if the robot needs it.

    Raises:
        InputError: the robot cannot turn to one of the sides.
    """
    return max(RADIUS_M, ROOM * turn_radius_m(tables, robot_id))


def require_room(path: Path, radius_m: float, config: PlanConfig) -> None:
    """Raise InputError where walls leave no room for the way onto the circle."""
    if not config.wall_weight_per_m:
        return
    entry = hold_at_end(path, radius_m).entry.points_m
    low = np.array([config.wall_x_min_m, config.wall_y_min_m])
    high = np.array([config.wall_x_max_m, config.wall_y_max_m])
    beyond_m = float(np.max(np.maximum(low - entry, entry - high)))
    if beyond_m > 0.0:
        raise InputError(
            f"--hold: the robot circles the end of {path.name!r} at {1e3 * radius_m:.0f} mm, and its way "
            f"there leads up to {1e3 * beyond_m:.0f} mm too near to a wall of --inside: "
            "end the path further inside"
        )


def hold_json(run: RunLog) -> dict[str, float] | None:
    """How near to the ends of its paths a run held, by true poses or fixes; None: it never came to hold.

    Returns:
        ``from_s``, when it came to the first circle, since the first decision; ``worst_m`` and ``mean_m``,
        the distance from the end from then on; ``within_m``, the radius of the circle; ``limit_m``.
    """
    spans = spans_of(run)
    if not spans:
        return None
    time_s, poses, _ = track_of(run)
    parts = []
    for from_s, until_s, end_m in spans:
        during = (time_s >= from_s) & (time_s < until_s)
        parts.append(np.hypot(poses[during, 0] - end_m[0], poses[during, 1] - end_m[1]))
    away_m = np.concatenate(parts)
    if not len(away_m):
        return None
    circle = [change for change in run.then if change.hold][-1]
    assert circle.hold is not None
    lap_m = circle.path.points_m[circle.hold[2] :][:LAP_POINTS]
    radii_m = np.hypot(*(lap_m - lap_m.mean(axis=0)).T)
    return {
        "from_s": round(spans[0][0] - float(run.decisions.time_s[0]), 6),
        "worst_m": float(away_m.max()),
        "mean_m": float(away_m.mean()),
        "within_m": round(float(radii_m.mean()), 3),
        "limit_m": HOLD_LIMIT_M,
    }


def held(found: dict[str, Any] | None, asked: bool) -> str:
    """A sentence on how near to the end a run held; "" where nobody asked it to."""
    if found is None:
        missed = "the robot did not come to the circle on which it holds: give a longer --simulated-time"
        return missed if asked else ""
    worst, limit = 1e3 * found["worst_m"], 1e3 * found["limit_m"]
    said = (
        f"the robot held within {worst:.0f} mm of its path's end, {1e3 * found['mean_m']:.0f} mm on average"
    )
    if worst <= limit:
        return said
    circle = 1e3 * found["within_m"]
    why = (
        f"the tightest circle that it can follow has a radius of {circle:.0f} mm"
        if circle > 1e3 * RADIUS_M + 0.5
        else f"the water or worn limbs carried it away from its circle of {circle:.0f} mm"
    )
    return f"{said}, which is more than {limit:.0f} mm: {why}"
