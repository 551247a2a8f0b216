"""What is looked at before a real robot is armed: is it seen well, in the pool, is its path; its batteries.

No pin of the robot measures these: a person does (the documentation's first day in the lab), and
where nobody did, that is said.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.paths import Path
from frogkick.robot import Robot
from frogkick.runs.closed_loop import FixSource

LOOK_S = 1.0
FIXES_LEAST = 2
"""In that time: the guard fires no limb on an older fix than half a second."""

APART_MOST_M = 0.02
"""Between two fixes in a row: a robot at rest does not move so far, so one of them is of something else."""

START_MOST_M = 0.3
"""From the robot to its path: farther off the planner swims to the path for many strokes."""

WALL_M = 0.05
"""A path keeps so far from the walls: half a robot."""

OVER_FULL = 1.1
"""A battery with so many times the voltage of a full one is another's, or the number has a slip."""


def check_battery(robot: Robot, measured_v: float | None) -> str:
    """Refuse to begin with batteries that are low.

    Args:
        robot: its file may say which it has.
        measured_v: by a person, of the lowest of them; None: nobody did.

    Returns:
        What is known of them, in a line.

    Raises:
        InputError: they are low, they are no such batteries, or the robot's file says nothing of any.
    """
    battery = robot.battery
    limits = "" if battery is None else f"{battery.low_v:g} V is low, {battery.full_v:g} V full"
    if measured_v is None:
        if battery is not None and battery.inputs:
            seen = f"{len(battery.inputs)} of {battery.count}"
            return f"battery: the robot sees {seen} itself, and is not armed below {battery.low_v:g} V"
        if battery is None:
            return f"battery: unknown, nobody measured it, and {robot.id} has no [battery] in its file"
        return (
            f"battery: unknown, not measured by this robot: do so {battery.measure} ({battery.count} of "
            f"them, {limits}), give the lowest, as --battery-v {battery.nominal_v:g}"
        )
    if battery is None:
        raise InputError(
            f"--battery-v is {measured_v:g}, and {robot.id} does not say which voltage is low: add [battery] "
            "to its file, or leave it out"
        )
    if not (math.isfinite(measured_v) and 0.0 < measured_v <= OVER_FULL * battery.full_v):
        raise InputError(
            f"--battery-v is {measured_v:g}, a full battery of {robot.id} has {battery.full_v:g} V: measure "
            f"again, {battery.measure}"
        )
    if measured_v < battery.low_v:
        raise InputError(
            f"the battery has {measured_v:g} V, {battery.low_v:g} V is the least for {robot.id}: charge "
            f"{'it' if battery.count == 1 else f'all {battery.count} together'}, to {battery.full_v:g} V"
        )
    return f"battery: {measured_v:g} V, measured by hand ({limits})"


def look(source: FixSource, clock: Callable[[], float], wait: Callable[[float], None]) -> list[Fix]:
    """Fixes of a second or so, before anything moves."""
    seen: list[Fix] = []
    begin_s = clock()
    while clock() - begin_s < LOOK_S:
        seen += source.advance(clock())
        wait(0.01)
    return seen


def check_start(fixes: Sequence[Fix], path: Path, pool_m: tuple[float, float] | None) -> list[str]:
    """Refuse to begin where a run can only fail.

    Args:
        fixes: of about a second, the robot at rest.
        path: to swim, in the fixes' frame.
        pool_m: length and width, origin in a corner; None where nobody knows them.

    Returns:
        What was looked at, a line each, with what was not.

    Raises:
        InputError: too few fixes, fixes that jump, a path outside the pool, a robot far from its path.
    """
    if len(fixes) < FIXES_LEAST:
        raise InputError(
            f"{len(fixes)} position fixes came in {LOOK_S:g} s, {FIXES_LEAST} are needed: light the pool, "
            "look at 'frogkick camera check'"
        )
    places = np.array([fix.pose_world[:2] for fix in fixes], dtype=np.float64)
    apart_m = np.hypot(*np.diff(places, axis=0).T)
    if apart_m.max() > APART_MOST_M:
        raise InputError(
            f"position fixes jump by {1e3 * apart_m.max():.0f} mm while the robot rests, "
            f"{1e3 * APART_MOST_M:.0f} are allowed: is another tag in the picture, or a hand?"
        )
    if pool_m is not None:
        low, high = path.points_m.min(axis=0), path.points_m.max(axis=0)
        if (low < WALL_M).any() or (high > np.array(pool_m) - WALL_M).any():
            raise InputError(
                f"the path reaches from ({low[0]:.2f}, {low[1]:.2f}) to ({high[0]:.2f}, {high[1]:.2f}) m, "
                f"the pool is {pool_m[0]:g} x {pool_m[1]:g} m and {WALL_M:g} m from its walls are kept free: "
                "give --begin X,Y,DEG or --begin here, or a shorter path"
            )
    far_m = float(path.distance_m(places[-1:])[0])
    if far_m > START_MOST_M:
        raise InputError(
            f"the robot is {far_m:.2f} m from its path, {START_MOST_M:g} are allowed: put it there, or give "
            "--begin here"
        )
    inside = "not looked at, the pool's size is not known" if pool_m is None else "inside the pool"
    return [
        f"position fixes: {len(fixes)} in {LOOK_S:g} s, at most {1e3 * apart_m.max():.1f} mm apart",
        f"path: {inside}, {1e3 * far_m:.0f} mm from the robot",
    ]
