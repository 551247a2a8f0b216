"""Checks before a real robot is armed: its fixes, its path in the pool, and its batteries."""

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
"""Smallest number of fixes in that time: the guard fires no limb without a fix of the last half second."""

APART_MOST_M = 0.02
"""Largest distance between successive fixes of a robot at rest; beyond it, one is of something else."""

START_MOST_M = 0.3
"""Largest distance from the robot to its path."""

WALL_M = 0.05
"""Smallest distance from a path to the walls: half a robot."""

OVER_FULL = 1.1
"""Highest plausible voltage over that of a full battery."""


def check_battery(robot: Robot, measured_v: float | None) -> str:
    """Check the lowest voltage of a robot's batteries, if a person has measured it; return the result.

    Raises:
        InputError: the voltage is low, implausible, or without limits in the robot's file.
    """
    battery = robot.battery
    limits = "" if battery is None else f"{battery.low_v:g} V is low, {battery.full_v:g} V full"
    if measured_v is None:
        if battery is not None and battery.inputs:
            count = f"{len(battery.inputs)} of {battery.count}"
            return (
                f"battery: the robot measures {count} itself, and cannot be armed below {battery.low_v:g} V"
            )
        if battery is None:
            return f"battery: unknown, not measured, and {robot.id} has no [battery] in its file"
        return (
            f"battery: unknown, not measured by this robot: measure it {battery.measure} ({battery.count} of "
            f"them, {limits}) and give the lowest voltage, as --battery-v {battery.nominal_v:g}"
        )
    if battery is None:
        raise InputError(
            f"--battery-v is {measured_v:g}, and {robot.id} has no limit for it: add [battery] to its file, "
            "or omit --battery-v"
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
    """Collect the fixes of ``LOOK_S``."""
    fixes: list[Fix] = []
    begin_s = clock()
    while clock() - begin_s < LOOK_S:
        fixes += source.advance(clock())
        wait(0.01)
    return fixes


def check_start(
    fixes: Sequence[Fix], path: Path, pool_m: tuple[float, float] | None, then: Sequence[Path] = ()
) -> list[str]:
    """Check fixes of a robot at rest and its path before a run; return the results, one line each.

    Args:
        fixes: during ``LOOK_S``.
        path, then: to swim, in the fixes' frame, and paths that take over later.
        pool_m: length and width of the pool, whose origin is a corner; None: unknown.

    Raises:
        InputError: too few fixes, fixes that jump, a path outside the pool, a robot far from its path.
    """
    if len(fixes) < FIXES_LEAST:
        raise InputError(
            f"{len(fixes)} position fixes came in {LOOK_S:g} s, {FIXES_LEAST} are needed: light the pool, "
            "and try 'frogkick camera check'"
        )
    places = np.array([fix.pose_world[:2] for fix in fixes], dtype=np.float64)
    apart_m = np.hypot(*np.diff(places, axis=0).T)
    if apart_m.max() > APART_MOST_M:
        raise InputError(
            f"position fixes jump by {1e3 * apart_m.max():.0f} mm while the robot rests, "
            f"{1e3 * APART_MOST_M:.0f} are allowed: remove other tags, reflections and hands from the picture"
        )
    for swum in (path, *then) if pool_m is not None else ():
        low, high = swum.points_m.min(axis=0), swum.points_m.max(axis=0)
        assert pool_m is not None
        if (low < WALL_M).any() or (high > np.array(pool_m) - WALL_M).any():
            raise InputError(
                f"the path reaches from ({low[0]:.2f}, {low[1]:.2f}) to ({high[0]:.2f}, {high[1]:.2f}) m, "
                f"the pool is {pool_m[0]:g} x {pool_m[1]:g} m and {WALL_M:g} m from its walls are kept free: "
                "put the robot elsewhere and give --begin here, or give --begin X,Y,DEG or a shorter path"
            )
    far_m = float(path.distance_m(places[-1:])[0])
    if far_m > START_MOST_M:
        raise InputError(
            f"the robot is {far_m:.2f} m from its path, {START_MOST_M:g} are allowed: put it there, or give "
            "--begin here"
        )
    inside = "not compared with the pool, whose size is not known" if pool_m is None else "inside the pool"
    return [
        f"position fixes: {len(fixes)} in {LOOK_S:g} s, at most {1e3 * apart_m.max():.1f} mm apart",
        f"path: {inside}; the robot is {1e3 * far_m:.0f} mm from it",
    ]
