"""Trajectories of one robot: a sequence of actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import ConvergenceError, InputError
from frogkick.core.poses import wrap_angle
from frogkick.der.strokes import LaneEffects, program_of, simulate_many
from frogkick.der.swimmer import STEP_S, Rods, prepare
from frogkick.robot import Action, Robot
from frogkick.robot.model import STANDARD_GRAVITY_MPS2

SAMPLE_S = 0.01  # spacing of trajectories


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """The motion of a simulated robot's body.

    Attributes:
        time_s: (n,) s, from 0 on.
        pose_world: (n, 3) x, y (m), heading (rad, in (-pi, pi]), world frame.
        velocity_body: (n, 3) forward, left (m/s), turn rate (rad/s), body frame.
        speed_mps: mean forward speed of a gait; of actions, the straight distance over the time.
        distance_m: straight distance from start to end.
        cost_of_transport: electrical energy over weight and distance, dimensionless; infinite without forward
            motion.
    """

    time_s: Float64
    pose_world: Float64
    velocity_body: Float64
    speed_mps: float
    distance_m: float
    cost_of_transport: float

    def __repr__(self) -> str:
        return (
            f"Trajectory({len(self.time_s)} samples, {float(self.time_s[-1]):.2f} s, "
            f"distance {1e3 * self.distance_m:.1f} mm, speed {1e3 * self.speed_mps:.2f} mm/s)"
        )


def trajectory_of(
    time_s: Float64,
    pose_world: Float64,
    velocity_body: Float64,
    speed_mps: float,
    energy_j: float,
    robot: Robot,
) -> Trajectory:
    """Put a trajectory together; the cost of transport is mean power over weight and speed.

    Args:
        time_s: (n,); pose_world: (n, 3), heading continuous; velocity_body: (n, 3).
    """
    x_m, y_m, heading = pose_world.T
    power_w = energy_j / float(time_s[-1])
    cost = power_w / (robot.mass_kg * STANDARD_GRAVITY_MPS2 * speed_mps) if speed_mps > 0.0 else math.inf
    distance = math.hypot(x_m[-1] - x_m[0], y_m[-1] - y_m[0])
    poses = np.column_stack([x_m, y_m, wrap_angle(heading)])
    return Trajectory(time_s, poses, velocity_body, speed_mps, distance, cost)


def sample_times(period_s: float, periods: int) -> Float64:
    """Times from 0 to the end of all periods, near SAMPLE_S apart, that hold every period's end."""
    samples = max(1, round(period_s / SAMPLE_S))
    return np.concatenate(
        [
            [0.0],
            *((period + np.arange(1, samples + 1) / samples) * period_s for period in range(periods)),
        ]
    )


def simulate_actions(
    robot: Robot,
    actions: Sequence[Action | str],
    velocity_body: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    step_s: float = STEP_S,
    rods: Rods | None = None,
    acts: Callable[[int], LaneEffects] | None = None,
) -> Trajectory:
    """Simulate a sequence of actions, one each Robot.period_s, heading along world x at the start.

    Args:
        actions: its actions, or their names.
        velocity_body: forward, left (m/s), turn rate (rad/s) at the start.
        step_s: finest time step.
        rods: its rods if effects change the body; None: prepare(robot).
        acts: makes the effects of a number of lanes; None: no effects.

    Raises:
        InputError: no action, or an unknown one.
        ConvergenceError: the simulation failed; the text gives the state.
    """
    if not actions:
        raise InputError("no action to simulate: give at least one")
    chosen = [robot.action(a) if isinstance(a, str) else a for a in actions]
    program = [
        stroke
        for index, action in enumerate(chosen)
        for stroke in program_of(robot, action, index * robot.period_s)
    ]
    time_s = sample_times(robot.period_s, len(chosen))
    motions = simulate_many(
        prepare(robot) if rods is None else rods,
        np.array([velocity_body], dtype=np.float64),
        [program],
        time_s[1:],
        step_s=step_s,
        width=1,
        acts=acts,
    )
    if motions.failures:
        raise ConvergenceError(f"rods of {robot.id!r} {motions.failures[0]}")
    pose = np.concatenate([np.zeros((1, 3)), motions.pose_world[0]])
    velocity = np.concatenate([np.array([velocity_body], dtype=np.float64), motions.velocity_body[0]])
    straight = math.hypot(*pose[-1, :2])
    pulses = sum(mask.bit_count() for _, mask in program)
    speed_mps = straight / float(time_s[-1])
    return trajectory_of(time_s, pose, velocity, speed_mps, pulses * robot.pulse_energy_j, robot)
