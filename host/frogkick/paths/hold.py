"""A path that holds a robot near another path's end: a join that bends aside, and laps about the end.

A robot that must keep swimming to steer cannot stop at a point, so it circles the point. It arrives faster
than it can turn on the circle: an arc leads it from the path to a line that passes the end on one side, and
a spiral from there to the circle takes its speed.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.paths.path import POINTS_MAX, Path

LAP_POINTS = 24
"""Points of a lap: the polygon's sides lie within 0.9 % of the radius of the circle."""
ARC = 2.15
"""Radius of the arc that leaves the path, in radii of the circle."""
STRAIGHT = 1.6
"""Length of the line from that arc to the spiral, in radii of the circle."""
SPIRAL, SPIRAL_POINTS = 1.55, 22
"""Radius at which the spiral begins, in radii of the circle, and number of steps of a lap that it takes."""
LEAD = 2.0
"""Length of the path that is repeated before the arc, in radii of the circle."""
LEAD_POINTS = 12
BEYOND_POINTS = 24
AHEAD, LINE = 0.5, 0.5
"""Least length of the straight way on and of the line from arc to spiral, in radii of the circle, for a
robot that begins anew from where it is."""
_TRIED = 2000


@dataclass(frozen=True, eq=False)
class Hold:
    """How a robot holds at a path's end."""

    end_m: tuple[float, float]  # x, y of the end, world, m: the circle's centre
    leave_m: float  # length of the path after which the join begins, m; beyond the path's own: straight on
    entry: Path  # the path's last part, the join, and laps
    circle_point: int  # index of the entry's first point on the circle
    laps: Path  # laps alone, from the same point of the circle


def hold_at_end(path: Path, radius_m: float) -> Hold:
    """Return how to hold at a path's end, on a circle of this radius.

    The join begins at the last place of the path from which there is one. Where the path is too short for
    it, the robot swims straight on past the end, and comes back.

    Raises:
        InputError: the radius is not a finite number above 0.
    """
    if not 0.0 < radius_m < math.inf:
        raise InputError(f"hold: radius {radius_m} m: give a finite radius above 0 m")
    side, sweep_rad, leave_m = _leave(path, ARC * radius_m, SPIRAL * radius_m)
    is_beyond = leave_m > path.along_m[-1]
    begin_m = 0.0 if is_beyond else max(0.0, leave_m - LEAD * radius_m)
    lead = path.poses_at(np.linspace(begin_m, leave_m, BEYOND_POINTS if is_beyond else LEAD_POINTS))
    name = f"hold at the end of {path.name}"
    return _hold(lead, side, -side, sweep_rad, path.points_m[-1], radius_m, leave_m, name)


def hold_from_pose(hold: Hold, radius_m: float, pose: Float64, area_m: Float64) -> Hold | None:
    """Return the shortest way from a pose to the same hold: straight on, an arc, a line and a spiral.

    The arc and the laps may each bend to the left or to the right (a Dubins path with two radii).

    Args:
        hold: the hold that the robot should be on, from whose entry it is too far away.
        radius_m: radius of the circle, m.
        pose: (3,) x and y (m) and course (rad) of the robot, world.
        area_m: (2, 2) least and largest x and y of the robot's centre, world, m.

    Returns:
        The way, or None if each leads out of the area. Its ``leave_m`` is 0.
    """
    arc_m, first_m = ARC * radius_m, SPIRAL * radius_m
    end = np.array(hold.end_m)
    ways: list[tuple[float, int, int, float, Float64]] = []
    for on_m in np.arange(AHEAD, AHEAD + 8.0, 0.25) * radius_m:
        here = pose + np.array([on_m * math.cos(pose[2]), on_m * math.sin(pose[2]), 0.0])
        for side, laps_side in itertools.product((1, -1), (1, -1)):
            x, y = end - (here[:2] + side * arc_m * np.array([-math.sin(here[2]), math.cos(here[2])]))
            beside_m = laps_side * first_m - side * arc_m
            line_m = math.sqrt(max(0.0, x * x + y * y - beside_m * beside_m))
            if line_m >= LINE * radius_m:
                course = math.atan2(y, x) - math.atan2(beside_m, line_m)
                sweep_rad = (side * (course - here[2])) % (2.0 * math.pi)
                length_m = float(on_m) + arc_m * sweep_rad + line_m
                ways.append((length_m, side, laps_side, side * sweep_rad, here))
    for _, side, laps_side, sweep_rad, here in sorted(ways, key=lambda way: way[:3]):
        lead = np.linspace(pose, here, LEAD_POINTS)
        found = _hold(lead, side, laps_side, sweep_rad, end, radius_m, 0.0, hold.entry.name)
        places = found.entry.points_m[: found.circle_point]
        if (places >= area_m[0]).all() and (places <= area_m[1]).all():
            return found
    return None


def _hold(
    lead: Float64, side: int, laps_side: int, sweep_rad: float, end: Float64, radius_m: float,
    leave_m: float, name: str,
) -> Hold:  # fmt: skip
    """A hold that is entered by a lead (n, 3), an arc from its last pose by a sweep, a line, and laps."""
    arc_m, first_m = ARC * radius_m, SPIRAL * radius_m
    here = lead[-1]
    centre = here[:2] + side * arc_m * np.array([-math.sin(here[2]), math.cos(here[2])])
    from_rad = here[2] - side * 0.5 * math.pi
    steps = max(1, math.ceil(abs(sweep_rad) * LAP_POINTS / (2.0 * math.pi)))
    arc = _round(centre, np.full(steps, arc_m), from_rad + sweep_rad * np.arange(1, steps + 1) / steps, side)
    before = len(lead) + len(arc)
    touches = here[2] + sweep_rad - laps_side * 0.5 * math.pi  # where the line touches the spiral

    def laps(spiral: int, points: int) -> Float64:
        number = np.arange(points)
        angle = touches + laps_side * (number + SPIRAL_POINTS - spiral) * 2.0 * math.pi / LAP_POINTS
        # A polygon lies inside of its circle: this one as far outside at its corners as inside between.
        fit = 2.0 * radius_m / (1.0 + math.cos(math.pi / LAP_POINTS))
        wider = np.maximum(0.0, 1.0 - number / spiral) if spiral else np.zeros(points)
        return _round(end, fit + (first_m - radius_m) * wider, angle, laps_side)

    whole = np.vstack([lead, arc, laps(SPIRAL_POINTS, POINTS_MAX - before)])
    both = (whole, laps(0, POINTS_MAX))
    entry, circle = (Path.from_arrays(rows[:, 0], rows[:, 1], rows[:, 2], name) for rows in both)
    return Hold((float(end[0]), float(end[1])), leave_m, entry, before + SPIRAL_POINTS, circle)


def _leave(path: Path, arc_m: float, first_m: float) -> tuple[int, float, float]:
    """Where the arc begins, to which side it bends (1: left, -1: right), and how far round, rad.

    It is the last place of the path, or else the first one straight on beyond, from which arc, line and
    spiral touch each other, and the arc is less than half a circle on the path. The left side comes first.

    Returns:
        Side, sweep, and the length of the path before the place.
    """
    line_m = STRAIGHT * first_m / SPIRAL
    reach_m = math.hypot(first_m + arc_m, line_m)
    end, length_m = path.points_m[-1], float(path.along_m[-1])
    on_m, beyond_m = np.linspace(0.0, length_m, _TRIED), length_m + np.linspace(0.0, 2.0 * reach_m, _TRIED)
    found: list[tuple[bool, float, int, float]] = []
    for at_m, is_on in ((on_m, True), (beyond_m, False)):
        poses = path.poses_at(at_m)
        for side in (1, -1):
            x = end[0] - (poses[:, 0] - side * arc_m * np.sin(poses[:, 2]))
            y = end[1] - (poses[:, 1] + side * arc_m * np.cos(poses[:, 2]))
            away = np.hypot(x, y) >= reach_m
            # Where the line leaves the arc, seen from the arc's centre.
            leaves = np.arctan2(y, x) - side * math.acos((first_m + arc_m) / reach_m)
            sweep = np.mod(side * leaves - (side * poses[:, 2] - 0.5 * math.pi), 2.0 * math.pi)
            crossed = np.flatnonzero((away[:-1] != away[1:]) & ((sweep[:-1] < math.pi) | (not is_on)))
            found += [(is_on, float(at_m[k]), side, float(sweep[k])) for k in crossed]
    nearest = max(found, key=lambda row: (row[0], row[1] if row[0] else -row[1], row[2]))
    _, leave_m, side, sweep_rad = nearest
    return side, side * sweep_rad, leave_m


def _round(centre: Float64, radius_m: Float64, angle_rad: Float64, side: int) -> Float64:
    """(n, 3) poses about a centre, at angles, to the left (1) or right (-1)."""
    unit = np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])
    return np.column_stack([centre + radius_m[:, None] * unit, angle_rad + side * 0.5 * math.pi])
