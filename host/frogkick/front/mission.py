"""The mission of a run beyond one path: later paths, holding at the end, and walls.

Arguments that do not fit the run, the robot or the walls raise an ``InputError``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.front.places import swim_path
from frogkick.front.tables import Table
from frogkick.paths import Path as SwimPath
from frogkick.paths.hold import LAP_POINTS, hold_at_end
from frogkick.planner.lookup import DYNAMICS, TableArrays, arrays_of, dynamics_after, find_row, motion_of
from frogkick.planner.plan import Cost, PlanConfig
from frogkick.runs.path_change import HOLD_LIMIT_M, NextPath, spans_of
from frogkick.runs.runlog import RunLog
from frogkick.runs.summary import track_of
from frogkick.tables.image import Tables
from frogkick.vision.calibration import read_calibration

HERE = "here"
Then = str | tuple[Any, ...]
"""A path that takes over: ``PATH@SECONDS[@here]``, (path, s) or (path, s, "here")."""

HOLD_RADIUS_M = 0.07
ROOM = 1.2
"""Radius of a circle that a robot can follow, in radii of its tightest turn."""
PERIODS = 40
"""Periods after which the motion of an action that is repeated no longer changes."""
TURN_MIN_RAD = 0.01
"""Smallest turn in a period by which an action counts as turning."""

WALL_WEIGHT_PER_M = 50_000.0
"""Cost of each m beyond a wall: some 50 times that of a m beside the path of the built-in robot."""
WALL_GLIDE = 2.0
"""A robot is assumed to glide on towards a wall by this many times the distance of its last stroke.

It glides further until it rests, but it has to turn away before that.
"""
MARGIN_M = 0.005
"""Additional distance of the robot's reach from a wall, for the soft cost and the noise of the fixes."""


def next_paths(then: Then | Sequence[Then], time_limit_s: float) -> tuple[NextPath, ...]:
    """Return the paths that take over during a run, one or several given, in the order of their times."""
    is_many = isinstance(then, tuple) and all(isinstance(one, tuple) or "@" in str(one) for one in then)
    asked = [then] if isinstance(then, str | tuple) and not is_many else list(then)
    found: list[NextPath] = []
    for one in asked:
        following = _next_path(one)
        if following.at_s >= time_limit_s:
            raise InputError(
                f"--then {_text(one)}: the run ends after {time_limit_s:g} s: give an earlier time, or a "
                "longer --simulated-time"
            )
        if found and following.at_s <= found[-1].at_s:
            raise InputError(
                f"--then {_text(one)}: the path before it takes over at {found[-1].at_s:g} s: give later "
                "times in turn"
            )
        found.append(following)
    return tuple(found)


def _next_path(one: Any) -> NextPath:
    parts: list[Any] = []
    if isinstance(one, str):
        text = one.removesuffix(f"@{HERE}")
        parts = [*text.rpartition("@")[::2], *([HERE] if text != one else [])]
    elif isinstance(one, Sequence):
        parts = list(one)
    if len(parts) not in (2, 3) or parts[0] == "" or (len(parts) == 3 and parts[2] != HERE):
        raise InputError(
            f"--then is {_text(one)}: give PATH@SECONDS, and @here behind it for a path that begins "
            "where the robot then is"
        )
    try:
        at_s = float(parts[1])
    except (TypeError, ValueError):
        at_s = math.nan
    if not 0.0 <= at_s < math.inf:
        raise InputError(
            f"--then {_text(one)}: {parts[1]!r} is no time: give PATH@SECONDS, seconds since the first "
            "decision"
        )
    return NextPath(swim_path(parts[0]), at_s, len(parts) == 3)


def _text(one: Any) -> str:
    if isinstance(one, tuple):
        return "@".join(part.name if isinstance(part, SwimPath) else str(part) for part in one)
    return repr(one)


def then_json(run: RunLog) -> list[dict[str, Any]]:
    """The paths that took over, each with its first decision's time since the run's first decision.

    Those that hold at an end are left out: the host makes them.
    """
    times_s = run.decisions.time_s
    return [
        {"path": change.path.name, "from_s": round(float(times_s[change.decision] - times_s[0]), 6)}
        for change in run.then
        if change.hold is None
    ]


def missed_paths_report(planned: int, run: RunLog) -> str:
    """A sentence on later paths that the run ended too early for; "" if there are none."""
    made = len(then_json(run))
    if planned <= made:
        return ""
    reached = f"{made} of {planned} paths of --then took over"
    return f"{reached}: the run had ended before the others ({run.notes}); give earlier times"


def turn_radius_m(tables: Tables, robot_id: str) -> float:
    """Radius of the tightest turn that a robot can make to both sides by its table, m.

    It is the circle of one action that is repeated.
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
    """How far an action that is repeated moves (m) and turns (rad) the robot in a period, in steady state."""
    dynamics, after = np.zeros(DYNAMICS, dtype=np.int64), np.zeros(DYNAMICS, dtype=np.int64)
    motion = np.zeros(3, dtype=np.float32)
    for _ in range(PERIODS):
        row = find_row(arrays, dynamics)
        motion_of(arrays, row, dynamics, action, motion)
        dynamics_after(arrays, row, dynamics, action, after)
        dynamics[:] = after
    return math.hypot(motion[0], motion[1]), float(motion[2])


def hold_radius_m(tables: Tables, robot_id: str) -> float:
    """Radius of the circle around a path's end, m: 0.7 of the limit, or more if the robot needs it."""
    return max(HOLD_RADIUS_M, ROOM * turn_radius_m(tables, robot_id))


def require_room(path: SwimPath, radius_m: float, config: PlanConfig) -> None:
    """Raise InputError if walls leave no room for the approach to the circle."""
    entry = hold_at_end(path, radius_m).entry.points_m
    low, high = config.area_m
    beyond_m = float(np.max(np.maximum(low - entry, entry - high)))
    if beyond_m > 0.0:
        raise InputError(
            f"--hold: the robot circles the end of {path.name!r} at {1e3 * radius_m:.0f} mm, and its way "
            f"there leads up to {1e3 * beyond_m:.0f} mm too near to a wall of --inside: "
            "end the path further inside"
        )


def hold_json(run: RunLog) -> dict[str, float] | None:
    """How close to the ends of its paths a run held, by true poses or fixes; None: it never reached a circle.

    Returns: ``from_s``, when it reached the first circle, since the first decision; ``worst_m`` and
        ``mean_m``, the distance from the end from then on; ``within_m``, the radius of the circle;
        ``limit_m``.
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


def hold_report(found: dict[str, Any] | None, asked: bool) -> str:
    """A sentence on how close to the end a run held; "" without --hold."""
    if found is None:
        missed = "the robot did not reach the circle on which it holds: give a longer --simulated-time"
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
        if circle > 1e3 * HOLD_RADIUS_M + 0.5
        else f"the water or worn limbs carried it away from its circle of {circle:.0f} mm"
    )
    return f"{said}, which is more than {limit:.0f} mm: {why}"


def with_walls(
    config: PlanConfig, inside: str | Sequence[float] | None, table: Table, fixes: str | None = None
) -> PlanConfig:
    """Return a planner's configuration that keeps the robot between walls.

    ``inside`` is x and y of a corner of the pool and of the opposite one (m, world), "pool" for those of the
    calibration's file ``fixes``, or None for no walls. The robot's reach keeps its distance from each wall.
    """
    if inside is None:
        return config
    if config.cost != Cost.ROUTE:
        raise InputError(
            "only the cost 'route' keeps the robot off walls: leave out --inside or --planner paper"
        )
    x_0, y_0, x_1, y_1 = _rectangle(inside, fixes)
    reach_m = table.robot.reach_m
    away_m = reach_m + MARGIN_M
    if min(x_1 - x_0, y_1 - y_0) <= 2.0 * away_m:
        raise InputError(
            f"between walls {x_1 - x_0:g} m x {y_1 - y_0:g} m apart the robot has no room, as it reaches "
            f"{reach_m:.3f} m from its centre: give its pool's own walls"
        )
    return dataclasses.replace(
        config,
        wall_weight_per_m=WALL_WEIGHT_PER_M,
        wall_glide=WALL_GLIDE,
        course_weight_per_m=0.0,  # with the course, one of 200 runs swung out over a wall after a bend
        wall_x_min_m=x_0 + away_m,
        wall_x_max_m=x_1 - away_m,
        wall_y_min_m=y_0 + away_m,
        wall_y_max_m=y_1 - away_m,
    )


def _rectangle(inside: str | Sequence[float], fixes: str | None) -> tuple[float, float, float, float]:
    if inside == "pool":
        if fixes is None or not fixes.endswith(".toml"):
            raise InputError(
                "--inside pool takes the walls of a calibration: give --fixes camera.toml, or X,Y,X,Y"
            )
        return (0.0, 0.0, *read_calibration(Path(fixes)).pool_m)
    try:
        x_0, y_0, x_1, y_1 = map(float, inside.split(",") if isinstance(inside, str) else inside)
    except (TypeError, ValueError):
        x_0 = y_0 = x_1 = y_1 = math.nan
    if not (-1000.0 <= x_0 < x_1 <= 1000.0 and -1000.0 <= y_0 < y_1 <= 1000.0):
        raise InputError(
            f"inside is {inside!r}: give X,Y,X,Y in m, a corner of the pool and the opposite one, the lower "
            "numbers first, or pool"
        )
    return x_0, y_0, x_1, y_1


def clearance_m(run: RunLog) -> float | None:
    """Smallest distance of the robot's reach from a wall, by true poses or fixes; negative beyond it.

    None for a run without walls, or without decisions.
    """
    known = run.planner
    if not known.get("wall_weight_per_m") or not len(run.decisions):
        return None
    _, poses, _ = track_of(run)
    room = [
        poses[:, 0] - known["wall_x_min_m"],
        known["wall_x_max_m"] - poses[:, 0],
        poses[:, 1] - known["wall_y_min_m"],
        known["wall_y_max_m"] - poses[:, 1],
    ]
    return float(np.min(room)) + MARGIN_M
