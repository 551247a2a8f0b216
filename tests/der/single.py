"""One simulation at a time, for tests: a gait, or an action."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from frogkick.core.errors import ConvergenceError
from frogkick.der import (
    STEP_S,
    Failure,
    Gait,
    Rods,
    Trajectory,
    prepare,
    program_of,
    simulate_gaits,
    simulate_many,
)
from frogkick.robot import Action, Robot


def simulate_gait(
    robot: Robot,
    egain_percent: float,
    frequency_hz: float,
    phase: float,
    cycles: int,
    *,
    step_s: float = STEP_S,
) -> Trajectory:
    """Simulate the robot's cyclic gait from rest, heading along world x.

    The leading limbs fire at the start of each cycle, the lagging limbs ``phase / frequency_hz`` later. The
    speed is defined as the authors': forward motion of the unweighted mean of all nodes over cycles 5 to 8,
    or over the last three of fewer cycles. The cost of transport counts Robot.pulse_energy_j for each pulse
    of each limb, and the weight in air.

    Raises:
        InputError: a phase outside [0, 1), no cycle, or a profile outside the measured range.
        ConvergenceError: the simulation failed; the text gives the state.
    """
    (result,) = simulate_gaits(
        robot, [Gait(egain_percent, frequency_hz, phase)], cycles, step_s=step_s, width=1
    )
    if isinstance(result, Failure):
        raise ConvergenceError(f"rods of {robot.id!r} {result}")
    return result


def simulate_action(
    robot: Robot,
    velocity_body: Sequence[float],
    action: Action | str,
    duration_s: float,
    *,
    step_s: float = STEP_S,
    rods: Rods | None = None,
) -> tuple[float, float, float, float, float, float]:
    """Simulate one action from a velocity, limbs at rest.

    Args:
        robot: the robot.
        velocity_body: forward, left (m/s), turn rate (rad/s) at the start.
        action: the action or its name.
        duration_s: duration, s.
        step_s: finest time step.
        rods: its rods if effects change the body; None: prepare(robot).

    Returns:
        Displacement (m, m, rad) in the body frame at the start, then velocity (m/s, m/s, rad/s) in the body
        frame at the end.

    Raises:
        InputError: an unknown action, or values that are not finite.
        ConvergenceError: the simulation failed; the text gives the state.
    """
    chosen = robot.action(action) if isinstance(action, str) else action
    motions = simulate_many(
        prepare(robot) if rods is None else rods,
        np.array([velocity_body], dtype=np.float64),
        [program_of(robot, chosen)],
        [duration_s],
        step_s=step_s,
        width=1,
    )
    if motions.failures:
        raise ConvergenceError(f"rods of {robot.id!r} {motions.failures[0]}")
    dx, dy, dheading = motions.pose_world[0, -1].tolist()
    vx, vy, omega = motions.velocity_body[0, -1].tolist()
    return dx, dy, dheading, vx, vy, omega
