"""A search's branches in float32 (numba): one action more, and what it costs. The twin of fk_search.h.

The numbers of a branch stand in rows of a ``Search``: what is expanded in one row, what becomes of it in the
next.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from frogkick.core.arrays import AnyArray
from frogkick.core.compiled import INNER
from frogkick.planner import costs
from frogkick.planner.floats import sincos, wrap_angle
from frogkick.planner.lookup import TableArrays

_F0 = np.float32(0)
_F1 = np.float32(1)
PER_STEP = np.float32(1.0 / costs.STEPS_PER_STROKE)


class Search(NamedTuple):
    """What a search works on; a row of each array for a level."""

    table: TableArrays
    path: AnyArray
    settings: Any
    knots: AnyArray
    step: np.float32
    held: bool  # the robot is far off, and its projection is the last one
    poses: AnyArray
    dynamics: AnyArray
    rows: AnyArray
    knot: AnyArray
    place: AnyArray  # arc length along the route, from its first knot
    sums: AnyArray
    best: AnyArray  # (2,) int64: first action (-1: none), transitions so far
    best_cost: AnyArray  # (1,) float32
    motion: AnyArray  # (3,) float32, of the action under way


@njit(**INNER)
def step(pose: AnyArray, motion: AnyArray, after: AnyArray) -> None:
    """Write the pose after an action: (x, y, wrapped heading) float32; motion (3,) float32, body frame."""
    sine, cosine = sincos(pose[2])
    after[0] = pose[0] + (cosine * motion[0] - sine * motion[1])
    after[1] = pose[1] + (sine * motion[0] + cosine * motion[1])
    after[2] = wrap_angle(pose[2] + motion[2])


@njit(**INNER)
def motion_cost(search: Search, level: int, depth: int) -> Any:
    """Return the stage cost: what the motion from a level to the next one costs."""
    settings = search.settings
    after = search.poses[level + 1]
    if settings.cost == costs.COST_PAPER:
        factor = _F1 + settings.level_weight * np.float32(depth - 1 - level)
        weights = (settings.distance_weight_per_m, settings.angle_weight_per_rad, settings.progress_weight)
        return costs.pose_cost(search.path, *weights, after[0], after[1], after[2]) * factor
    low = max(0, search.knot[level] - 1)
    ahead = 0 if search.held else costs.AHEAD
    high = min(max(search.knot[level], costs.BEHIND if search.held else 0) + ahead, len(search.knots) - 1)
    knot, place, distance2 = costs.project_on_knots(search.knots, search.step, low, high, after[0], after[1])
    search.knot[level + 1] = knot
    search.place[level + 1] = place
    stroke_max = search.step / PER_STEP
    shortfall = stroke_max - min(place - search.place[level], stroke_max)
    deviation = costs.huber(distance2, settings.soft_distance_m)
    cost = settings.distance_weight_per_m * deviation + settings.progress_weight_per_m * shortfall
    if settings.wall_weight_per_m > _F0:
        cost = cost + settings.wall_weight_per_m * costs.beyond_walls(settings, after[0], after[1])
    return cost


@njit(**INNER)
def course_cost(search: Search, level: int) -> Any:
    """Return the cost of a course that leads off the route, for a branch that ends at a level.

    ``search.motion`` is the branch's last motion.
    """
    settings, motion = search.settings, search.motion
    ahead = _F1 + settings.course_weight_per_m * motion[0]
    aside = settings.course_weight_per_m * motion[1]
    sine, cosine = sincos(search.poses[level - 1, 2])
    turned_sine, turned_cosine = sincos(wrap_angle(motion[2]) + settings.turn_lead * motion[2])
    end_cosine = cosine * turned_cosine - sine * turned_sine
    end_sine = sine * turned_cosine + cosine * turned_sine
    angle = costs.end_angle(
        search.knots,
        search.step,
        search.place[level],
        search.poses[level],
        end_cosine * ahead - end_sine * aside,
        end_sine * ahead + end_cosine * aside,
        settings.look_ahead_m,
    )
    return settings.angle_weight_per_rad * angle


@njit(**INNER)
def ended_cost(search: Search, level: int, cost: Any, is_last: bool) -> Any:
    """Return the cost of a branch that ends at a level: its cost so far and the terminal cost.

    ``search.motion`` is its last motion. Before the search's last level, gliding beyond a wall costs as much
    as being that far from the route.
    """
    settings = search.settings
    if settings.cost == costs.COST_PAPER:
        return cost
    here, before = search.poses[level], search.poses[level - 1]
    knot, place, turn = search.knot[level], search.place[level], search.motion[2]
    cost = cost + course_cost(search, level)
    cost = cost + costs.glide_cost(settings, search.knots, search.step, knot, place, here, before, turn)
    if settings.wall_weight_per_m > _F0:
        weight = settings.wall_weight_per_m if is_last else settings.distance_weight_per_m
        x = here[0] + settings.wall_glide * (here[0] - before[0])
        y = here[1] + settings.wall_glide * (here[1] - before[1])
        cost = cost + weight * costs.beyond_walls(settings, x, y)
    return cost


@njit(**INNER)
def is_candidate(search: Search, moves: bool, action: int) -> bool:
    """Whether an action may be the first: resting may not, from rest, unless there is nothing else."""
    if moves or search.settings.cost != costs.COST_ROUTE or not np.any(search.table.fires):
        return True
    return bool(np.any(search.table.fires[action]))
