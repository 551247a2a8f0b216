"""The planner's two costs in float32 (numba): the twins of cost.c and route.c.

The paper's cost is Huang et al. 2022, Eq. 19 as its authors' runs logged it. The route cost has progress
along the path as stage cost and course as terminal cost, written from these rules:

- The path is a polyline. A state is projected onto it, and the projection is carried from decision to
  decision in points (2.25 lies a quarter of the way from point 2 to point 3). It is looked for only near the
  last one: a path that crosses or closes on itself is never left for another part of it.
- From the projection a route is laid out: knots at equal steps along the polyline, straight on beyond both of
  its ends. A pose belongs to the nearest of every third knot that one motion can reach, or to a neighbour of
  it, and its deviation from that knot is split along and across the route's direction there.
- A robot that is slow does not choose to rest. At rest that changes nothing, so it would rest for ever; and
  beside a path that it cannot follow any stroke costs more than to stay.
- Stage cost of a motion: the Huber loss of its end's distance from the route (Huber 1964; the quadratic part
  ends at ``soft_distance_m``), and the shortfall of its advance against the table's longest stroke.
- Terminal cost of a branch: how far the robot's course leads away from the route's place a look-ahead further
  on, the target point of pure pursuit (Coulter 1992). The course is the heading before the last motion plus
  ``course_weight_per_m`` times that motion, turned by the motion's turn and ``turn_lead`` times that.
- Besides, how far from the route the place lies to which the robot glides on: ``glide_lead`` times its last
  motion further, turned by as much as it turned in that (a constant-turn motion, Li & Jilkov 2003, for small
  angles). Where there are walls, also how far the branch's end, and the place where the robot would glide to
  rest, lie beyond them.

Every operation is float32 in the order written; ties take the lowest index.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from frogkick.core.arrays import AnyArray
from frogkick.core.compiled import BARE, INNER
from frogkick.core.weights import COSTS
from frogkick.planner.floats import sincos, wrap_angle

COST_PAPER, COST_ROUTE = range(len(COSTS))

STEPS_PER_STROKE = 8
"""Steps between knots in the table's longest stroke."""
AHEAD = 12
"""Knots that one motion may advance: one and a half times the table's longest stroke."""
BEHIND = 2
"""Knots of the route behind where it begins."""
KNOTS_MAX = 80
STROKE_MIN_M = np.float32(1e-4)
SLOW_STEPS = np.float32(3)
"""A robot that moves fewer steps than these in a period is slow, and does not rest."""
WALL_PERIODS = np.float32(4)
"""A robot that is nearer to a wall than this, by its speed, turns and does not rest."""

_F0 = np.float32(0)
_F1 = np.float32(1)
_F2 = np.float32(2)
_HALF = np.float32(0.5)
_AHEAD_STROKES = np.float32(1.5)
_FAR_STROKES = np.float32(2)


@njit(**BARE)
def stroke_scale(stroke_max_m: np.float32) -> Any:
    """Return the length that scales everything here: the table's longest stroke, at least STROKE_MIN_M."""
    return max(stroke_max_m, STROKE_MIN_M)


@njit(**INNER)
def may_rest(settings: Any, state: AnyArray, step: np.float32, period: np.float32) -> bool:
    """Whether a robot in a state (6,) may rest: not if it is slow, and not if it nears a wall.

    Slow is fewer than SLOW_STEPS in a period. Near is WALL_PERIODS by its speed: it would glide into the wall
    without turning.
    """
    slow = SLOW_STEPS * step
    speed2 = state[3] * state[3] + state[4] * state[4]
    if speed2 * (period * period) <= slow * slow:
        return False
    if not settings.wall_weight_per_m > _F0:
        return True
    sine, cosine = sincos(wrap_angle(state[2]))
    ahead = WALL_PERIODS * period
    x = state[0] + ahead * (cosine * state[3] - sine * state[4])
    y = state[1] + ahead * (sine * state[3] + cosine * state[4])
    return bool(
        settings.wall_x_min_m <= x <= settings.wall_x_max_m
        and settings.wall_y_min_m <= y <= settings.wall_y_max_m
    )


@njit(**INNER)
def segment_length(path: AnyArray, segment: int) -> Any:
    dx = path[0, segment + 1] - path[0, segment]
    dy = path[1, segment + 1] - path[1, segment]
    return np.sqrt(dx * dx + dy * dy)


@njit(**INNER)
def distance2_to(path: AnyArray, segment: int, part: np.float32, x: np.float32, y: np.float32) -> Any:
    """Squared distance of a position from a point of a segment, m^2; ``part``: 0 to 1 along the segment."""
    dx = path[0, segment + 1] - path[0, segment]
    dy = path[1, segment + 1] - path[1, segment]
    across_x = (x - path[0, segment]) - part * dx
    across_y = (y - path[1, segment]) - part * dy
    return across_x * across_x + across_y * across_y


@njit(**INNER)
def project_on_segment(path: AnyArray, segment: int, x: np.float32, y: np.float32) -> Any:
    """Project a position onto a segment: how far along it the nearest place lies, 0 to 1."""
    dx = path[0, segment + 1] - path[0, segment]
    dy = path[1, segment + 1] - path[1, segment]
    length2 = dx * dx + dy * dy
    along = (x - path[0, segment]) * dx + (y - path[1, segment]) * dy
    if along <= _F0:
        return _F0
    if along >= length2:
        return _F1
    return along / length2


@njit(**BARE)
def project(path: AnyArray, stroke_max: np.float32, begin: np.float32, x: np.float32, y: np.float32) -> Any:
    """Project a position onto the path, near its last projection.

    Args:
        path: (3, n) float32.
        stroke_max: from ``stroke_scale``.
        begin: the last projection, in points, 0 to n - 1. The search goes from one longest stroke behind it
            to one and a half ahead, in whole segments.

    Returns:
        (segment, fraction of it, squared distance m^2, held): where the nearest place is more than two
        longest strokes away, the robot shall come back to ``begin``, which is then held as its projection.
    """
    last = path.shape[1] - 2
    home = min(int(begin), last)
    home_part = begin - np.float32(home)
    length = segment_length(path, home)
    first = home
    behind = home_part * length
    while first > 0 and behind < stroke_max:
        first -= 1
        behind = behind + segment_length(path, first)
    end = home
    ahead = (_F1 - home_part) * length
    while end < last and ahead < _AHEAD_STROKES * stroke_max:
        end += 1
        ahead = ahead + segment_length(path, end)
    best = np.float32(np.inf)
    segment = home
    part = home_part
    for candidate in range(first, end + 1):
        place = project_on_segment(path, candidate, x, y)
        distance2 = distance2_to(path, candidate, place, x, y)
        if distance2 < best:
            best = distance2
            segment = candidate
            part = place
    far = _FAR_STROKES * stroke_max
    if best > far * far:
        return home, home_part, distance2_to(path, home, home_part, x, y), True
    return segment, part, best, False


@njit(**INNER)
def knot_count(levels: int, look_ahead: np.float32, step: np.float32) -> int:
    """Return how many knots a search needs, at most KNOTS_MAX."""
    reached = BEHIND + AHEAD * levels + 2
    if reached >= KNOTS_MAX:
        return KNOTS_MAX
    room = KNOTS_MAX - reached
    steps = look_ahead / step
    return reached + (room if steps >= np.float32(room) else int(steps))


@njit(**INNER)
def lay_out(path: AnyArray, segment: int, part: np.float32, step: np.float32, knots: AnyArray) -> None:
    """Write the knots (n, 4) float32: x, y, and the unit vector along the route.

    Knot BEHIND stands at the projection. A segment of no length keeps the direction of the one before it.
    """
    last = path.shape[1] - 2
    length = segment_length(path, segment)
    along = part * length - np.float32(BEHIND) * step
    while along < _F0 and segment > 0:
        segment -= 1
        length = segment_length(path, segment)
        along = along + length
    direction_x = _F1
    direction_y = _F0
    fresh = True
    for knot in range(len(knots)):
        while along > length and segment < last:
            along = along - length
            segment += 1
            length = segment_length(path, segment)
            fresh = True
        if fresh and length > _F0:
            per_m = _F1 / length
            direction_x = (path[0, segment + 1] - path[0, segment]) * per_m
            direction_y = (path[1, segment + 1] - path[1, segment]) * per_m
        fresh = False
        knots[knot, 0] = path[0, segment] + along * direction_x
        knots[knot, 1] = path[1, segment] + along * direction_y
        knots[knot, 2] = direction_x
        knots[knot, 3] = direction_y
        along = along + step


@njit(**INNER)
def knot_distance2(knots: AnyArray, knot: int, x: np.float32, y: np.float32) -> Any:
    dx = x - knots[knot, 0]
    dy = y - knots[knot, 1]
    return dx * dx + dy * dy


@njit(**INNER)
def nearest_knot(knots: AnyArray, low: int, high: int, x: np.float32, y: np.float32) -> Any:
    """Find the knot of low, low + 3, ... high that is nearest, or one of its neighbours if that is nearer."""
    knot = low
    for candidate in range(low, high + 1, 3):
        if knot_distance2(knots, candidate, x, y) < knot_distance2(knots, knot, x, y):
            knot = candidate
    middle = knot
    for candidate in (middle - 1, middle, middle + 1):
        if low <= candidate <= high:
            here = knot_distance2(knots, candidate, x, y)
            best = knot_distance2(knots, knot, x, y)
            if here < best or (here == best and candidate < knot):
                knot = candidate
    return knot


@njit(**INNER)
def project_on_knots(
    knots: AnyArray, step: np.float32, low: int, high: int, x: np.float32, y: np.float32
) -> Any:
    """Project a position onto knots low to high: (knot, arc length from knot 0 m, squared distance m^2)."""
    knot = nearest_knot(knots, low, high, x, y)
    along = (x - knots[knot, 0]) * knots[knot, 2] + (y - knots[knot, 1]) * knots[knot, 3]
    moved = max(-step, min(step, along))
    distance2 = knot_distance2(knots, knot, x, y) - moved * (_F2 * along - moved)
    return knot, np.float32(knot) * step + moved, max(_F0, distance2)


@njit(**INNER)
def huber(distance2: np.float32, huber_m: np.float32) -> Any:
    """Return the Huber loss of a distance over its threshold: quadratic within ``huber_m``, linear beyond."""
    if distance2 < huber_m * huber_m:
        return distance2 * (_HALF / huber_m)
    return np.sqrt(distance2) - _HALF * huber_m


@njit(**INNER)
def beyond(at: np.float32, least: np.float32, most: np.float32) -> Any:
    """How far a coordinate lies outside of an interval."""
    return max(_F0, least - at) + max(_F0, at - most)


@njit(**INNER)
def glide_cost(
    settings: Any,
    knots: AnyArray,
    step: Any,
    knot: int,
    place: Any,
    here: AnyArray,
    before: AnyArray,
    turn: Any,
) -> Any:
    """Return the cost of the distance from the route to which a branch's end (``here``, at ``knot``) glides.

    ``place`` is in m from knot 0; ``before`` is where its last motion began, ``turn`` rad what that turned.
    """
    dx, dy = here[0] - before[0], here[1] - before[1]
    glide_x = settings.glide_lead * (dx - turn * dy)
    glide_y = settings.glide_lead * (dy + turn * dx)
    along = glide_x * knots[knot, 2] + glide_y * knots[knot, 3]
    there = int(max(_F0, min(np.float32(len(knots) - 1), (place + along) * (_F1 / step))))
    across = ((here[1] + glide_y) - knots[there, 1]) * knots[there, 2] - (
        (here[0] + glide_x) - knots[there, 0]
    ) * knots[there, 3]
    return settings.glide_weight_per_m * huber(across * across, settings.soft_distance_m)


@njit(**INNER)
def beyond_walls(settings: Any, x: np.float32, y: np.float32) -> Any:
    """How far a point lies beyond the walls, m."""
    beyond_x = beyond(x, settings.wall_x_min_m, settings.wall_x_max_m)
    beyond_y = beyond(y, settings.wall_y_min_m, settings.wall_y_max_m)
    return beyond_x + beyond_y


@njit(**INNER)
def end_angle(
    knots: AnyArray,
    step: np.float32,
    place: np.float32,
    position: AnyArray,
    course_x: Any,
    course_y: Any,
    look_ahead: Any,
) -> Any:
    """Return 2 sin(angle / 2), 0 to 2: between the robot's course and the direction to the route further on.

    ``place`` is the position's, in m from knot 0, ``look_ahead`` m beyond it. The course is a vector of any
    length.
    """
    last = len(knots) - 1
    steps = min((place + look_ahead) * (_F1 / step), np.float32(last))
    steps = max(steps, _F0)
    knot = int(steps)
    beyond = (steps - np.float32(knot)) * step
    dx = (knots[knot, 0] + beyond * knots[knot, 2]) - position[0]
    dy = (knots[knot, 1] + beyond * knots[knot, 3]) - position[1]
    square = (dx * dx + dy * dy) * (course_x * course_x + course_y * course_y)
    if square == _F0:
        return _F0
    aligned = (dx * course_x + dy * course_y) / np.sqrt(square)
    return np.sqrt(max(_F0, _F2 - _F2 * aligned))


@njit(**INNER)
def nearest_point(x_m: AnyArray, y_m: AnyArray, x: np.float32, y: np.float32) -> tuple[int, np.float32]:
    """Return the index of the nearest path point, the lowest on ties, and the squared distance, m^2."""
    index = 0
    best = np.float32(np.inf)
    for point in range(len(x_m)):
        dx = x_m[point] - x
        dy = y_m[point] - y
        distance2 = dx * dx + dy * dy
        if distance2 < best:
            best = distance2
            index = point
    return index, best


@njit(**INNER)
def pose_cost(
    path: AnyArray, distance_w: Any, angle_w: Any, progress_w: Any, x: Any, y: Any, heading: Any
) -> Any:
    """Return the cost of a pose: path (3, n) float32 x, y, tangent; the rest float32."""
    index, distance2 = nearest_point(path[0], path[1], x, y)
    angle = abs(wrap_angle(heading - path[2, index]))
    progress = np.float32(index) / np.float32(path.shape[1] - 1)
    return (distance_w * np.sqrt(distance2) + angle_w * angle) + progress_w * (_F1 - progress)
