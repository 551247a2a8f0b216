"""What one action does, and what a gait or a row of actions does: the questions asked of the rods."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.der.swimmer import STEP_S, Rods, Swimmer, prepare
from frogkick.errors import InputError
from frogkick.robot import Action, Robot
from frogkick.robot.model import STANDARD_GRAVITY_MPS2

FloatArray = NDArray[np.float64]

SAMPLE_S = 0.01  # spacing of trajectories


@dataclass(frozen=True)
class Trajectory:
    """Where the body went: (n,) arrays, world frame (heading in (-pi, pi]), and what it came to.

    Attributes:
        speed_mps: mean forward speed; see the function that made it.
        distance_m: straight from start to end.
        cost_of_transport: electrical energy over weight and distance, dimensionless; infinite without
            forward motion.
    """

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    speed_mps: float
    distance_m: float
    cost_of_transport: float


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
        velocity_body: forward, left (m/s), turn rate (rad/s) at the start.
        action: which limbs fire.
        duration_s: how long to follow it, s.

    Returns:
        Displacement (m, m, rad) in the body frame at the start, then velocity (m/s, m/s, rad/s) in the body
        frame at the end.

    Raises:
        InputError, ConvergenceError: see Swimmer.
    """
    chosen = robot.action(action) if isinstance(action, str) else action
    swimmer = Swimmer(robot, velocity_body=velocity_body, step_s=step_s, rods=rods)
    swimmer.fire_mask(chosen.first_mask, 0.0)
    swimmer.fire_mask(chosen.second_mask, robot.second_delay_s)
    swimmer.advance(duration_s)
    dx, dy, dheading = swimmer.pose_world()
    vx, vy, omega = swimmer.velocity_body()
    return float(dx), float(dy), float(dheading), float(vx), float(vy), float(omega)


def _follow(swimmer: Swimmer, period_s: float, periods: int) -> tuple[list[FloatArray], FloatArray]:
    """Advance by periods; return rows (time, x, y, heading) and the plain node mean after each period."""
    samples = max(1, round(period_s / SAMPLE_S))
    rows = [np.append(swimmer.time_s, swimmer.pose_world())]
    means = [swimmer.nodes_world().mean(axis=0)]
    for period in range(periods):
        for sample in range(1, samples + 1):
            swimmer.advance((period + sample / samples) * period_s)
            rows.append(np.append(swimmer.time_s, swimmer.pose_world()))
        means.append(swimmer.nodes_world().mean(axis=0))
    return rows, np.array(means)


def _trajectory(rows: list[FloatArray], speed_mps: float, energy_j: float, robot: Robot) -> Trajectory:
    """The cost of transport is mean power over weight and speed."""
    time_s, x_m, y_m, heading_rad = np.array(rows).T
    power_w = energy_j / float(time_s[-1])
    cost = power_w / (robot.mass_kg * STANDARD_GRAVITY_MPS2 * speed_mps) if speed_mps > 0.0 else math.inf
    distance = math.hypot(x_m[-1] - x_m[0], y_m[-1] - y_m[0])
    return Trajectory(time_s, x_m, y_m, heading_rad, speed_mps, distance, cost)


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

    The leading limbs fire at the start of every cycle, the lagging ones ``phase / frequency_hz`` later.
    The speed is the authors': forward motion of the plain mean of all nodes over cycles 5 to 8, or over the
    last three of fewer cycles. The cost of transport takes the same energy, Robot.pulse_energy_j, for each
    pulse of each limb at any frequency, and the weight in air.

    Raises:
        InputError: a phase outside of [0, 1), no cycle, or a profile outside of what was measured.
        ConvergenceError: see Swimmer.
    """
    if not 0.0 <= phase < 1.0:
        raise InputError(f"phase is {phase}: give a share of the cycle, 0 <= phase < 1")
    if not 1 <= cycles <= 10000:
        raise InputError(f"cycles is {cycles}: give 1 to 10000")
    rods = prepare(robot, egain_percent, frequency_hz)
    swimmer = Swimmer(robot, step_s=step_s, rods=rods)
    period = 1.0 / frequency_hz
    for cycle in range(cycles):
        swimmer.fire_mask(robot.gait_lead_mask, cycle * period)
        swimmer.fire_mask(robot.gait_lag_mask, (cycle + phase) * period)
    rows, means = _follow(swimmer, period, cycles)
    last = min(cycles, 8)
    first = max(0, last - 3)
    speed = float(means[last, 0] - means[first, 0]) / ((last - first) * period)
    pulses = cycles * (robot.gait_lead_mask.bit_count() + robot.gait_lag_mask.bit_count())
    return _trajectory(rows, speed, pulses * robot.pulse_energy_j, robot)


def simulate_actions(
    robot: Robot,
    actions: Sequence[Action | str],
    velocity_body: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    step_s: float = STEP_S,
) -> Trajectory:
    """Simulate actions one after another, one each Robot.period_s, heading along world x at the start.

    The speed is the straight distance over the time.

    Raises:
        InputError: no action, or an unknown one.
        ConvergenceError: see Swimmer.
    """
    if not actions:
        raise InputError("no action to simulate: give at least one")
    swimmer = Swimmer(robot, velocity_body=velocity_body, step_s=step_s)
    chosen = [robot.action(a) if isinstance(a, str) else a for a in actions]
    pulses = 0
    for index, action in enumerate(chosen):
        swimmer.fire_mask(action.first_mask, index * robot.period_s)
        swimmer.fire_mask(action.second_mask, index * robot.period_s + robot.second_delay_s)
        pulses += action.first_mask.bit_count() + action.second_mask.bit_count()
    rows, _ = _follow(swimmer, robot.period_s, len(chosen))
    straight = math.hypot(*(rows[-1][1:3] - rows[0][1:3]))
    return _trajectory(rows, straight / float(rows[-1][0]), pulses * robot.pulse_energy_j, robot)
