"""Walls that a run keeps away from: the pool's, as the planner's settings, and how near the robot came."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from frogkick.core.errors import InputError
from frogkick.front.tables import Table
from frogkick.planner.plan import Cost, PlanConfig
from frogkick.runs.runlog import RunLog
from frogkick.runs.summary import track_of
from frogkick.vision.calibration_file import read_calibration

WALL_WEIGHT_PER_M = 50_000.0
"""Cost of each m beyond a wall: some 50 times that of a m beside the path of the built-in robot."""

WALL_GLIDE = 2.0
"""How many times as far as in its last stroke a robot is taken to glide on towards a wall.

It glides further until it rests, but it has to turn away before that.
"""

MARGIN_M = 0.005
"""Further away from a wall than the robot reaches: what the soft cost and the fixes leave open."""


def walled(
    config: PlanConfig, inside: str | Sequence[float] | None, table: Table, fixes: str | None = None
) -> PlanConfig:
    """Return a planner's configuration that keeps the robot between walls.

    Args:
        config: without them.
        inside: x and y of a corner of the pool and of the opposite one, m, world; "pool": of the camera's
            calibration; None: there are no walls.
        table: of the robot, whose reach keeps its distance from each wall.
        fixes: the calibration's file.

    Raises:
        InputError: no such rectangle, one in which the robot has no room, or the published cost.
    """
    if inside is None:
        return config
    if config.cost != Cost.ROUTE:
        raise InputError("walls are kept with the cost 'route' alone: leave out --inside or --planner paper")
    x_0, y_0, x_1, y_1 = _rectangle(inside, fixes)
    reach_m = table.robot.reach_m
    away_m = reach_m + MARGIN_M
    if min(x_1 - x_0, y_1 - y_0) <= 2.0 * away_m:
        raise InputError(
            f"between walls {x_1 - x_0:g} m x {y_1 - y_0:g} m apart the robot has no room, as it reaches "
            f"{reach_m:.3f} m from its middle: give its pool's own walls"
        )
    return dataclasses.replace(
        config,
        wall_weight_per_m=WALL_WEIGHT_PER_M,
        wall_glide=WALL_GLIDE,
        course_weight_per_m=0.0,  # with it one of 200 runs swung out over a wall after a bend
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
    """Least distance between the robot's reach and a wall, by true poses or fixes; below 0 beyond it.

    None of a run without walls, or without decisions.
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
