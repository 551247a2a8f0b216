"""Trajectories of one robot: a sequence of actions, or cyclic gaits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import ConvergenceError, InputError
from frogkick.core.poses import wrap_angle
from frogkick.der.batch import WIDTH, Failure
from frogkick.der.mesh import Rods, prepare
from frogkick.der.schedule import STEP_S
from frogkick.der.strokes import (
    LaneEffects,
    Program,
    Track,
    interpolate,
    program_of,
    simulate_many,
    simulate_stages,
)
from frogkick.robot import Action, Robot
from frogkick.robot.model import STANDARD_GRAVITY_MPS2

SAMPLE_S = 0.01  # spacing of trajectories
CYCLES_MAX = 10000


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
        [[0.0], *((period + np.arange(1, samples + 1) / samples) * period_s for period in range(periods))]
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


@dataclass(frozen=True)
class Gait:
    """EGaIn fraction and frequency of the limb profile, and the lag of the second group as a share of the
    cycle."""

    egain_percent: float
    frequency_hz: float
    phase: float


def simulate_gaits(
    robot: Robot,
    gaits: Sequence[Gait],
    cycles: int,
    *,
    step_s: float = STEP_S,
    width: int = WIDTH,
    rods: Rods | None = None,
    acts: Callable[[int], LaneEffects] | None = None,
) -> list[Trajectory | Failure]:
    """Simulate cyclic gaits from rest, side by side, heading along world x.

    The leading limbs fire at the start of each cycle, the lagging limbs ``phase / frequency_hz`` later. The
    speed is defined as the authors': forward motion of the unweighted mean of all nodes over cycles 5 to 8,
    or over the last three of fewer cycles. The cost of transport counts Robot.pulse_energy_j for each pulse
    of each limb, and the weight in air. A result's bits do not depend on the width.

    Args:
        robot: the robot, with its profiles and its groups of limbs.
        gaits: phases in [0, 1).
        step_s: finest time step.
        rods: its rods if effects change the body; None: prepare(robot).
        acts: makes the effects of a number of lanes; None: no effects.

    Returns:
        For each gait its trajectory, or the failure.

    Raises:
        InputError: a phase outside [0, 1), no cycle, or a profile outside the measured range; nothing is
            simulated then.
    """
    for gait in gaits:
        if not 0.0 <= gait.phase < 1.0:
            raise InputError(f"phase is {gait.phase}: give a share of the cycle, 0 <= phase < 1")
    if not 1 <= cycles <= CYCLES_MAX:
        raise InputError(f"cycles is {cycles}: give 1 to {CYCLES_MAX}")
    body = prepare(robot) if rods is None else rods
    some = [replace(body, actuation=robot.actuation(gait.egain_percent, gait.frequency_hz)) for gait in gaits]
    tracks = simulate_gait_tracks(some, gaits, cycles, step_s=step_s, width=width, acts=acts)
    last = min(cycles, 8)
    counted = min(last, 3)
    pulses = cycles * (robot.gait_lead_mask.bit_count() + robot.gait_lag_mask.bit_count())
    found: list[Trajectory | Failure] = []
    for gait, track in zip(gaits, tracks, strict=True):
        if isinstance(track, Failure):
            found.append(track)
            continue
        period_s = 1.0 / gait.frequency_hz
        mean_m = track.node_mean_m[track.stage_end]
        speed = float(mean_m[last] - mean_m[last - counted]) / (counted * period_s)
        time_s = sample_times(period_s, cycles)
        pose, velocity = interpolate(track.time_s, track.motion, time_s)
        found.append(trajectory_of(time_s, pose, velocity, speed, pulses * robot.pulse_energy_j, robot))
    return found


def simulate_gait_tracks(
    rods: Sequence[Rods],
    gaits: Sequence[Gait],
    cycles: int,
    *,
    step_s: float = STEP_S,
    width: int = WIDTH,
    acts: Callable[[int], LaneEffects] | None = None,
) -> list[Track | Failure]:
    """Simulate gaits with phases in [0, 1) from rest, heading along world x; each cycle is a stage.

    Args:
        rods: one for each gait, of one robot; frequency and phase of the gait give the times of its pulses.
        step_s, width, acts: see ``simulate_stages``.
    """
    if not gaits:
        return []
    robot, period_s = rods[0].robot, np.array([1.0 / gait.frequency_hz for gait in gaits])
    groups = [((robot.gait_lead_mask, 0.0), (robot.gait_lag_mask, gait.phase)) for gait in gaits]

    def fired(cycle: int) -> list[Program]:
        return [
            [((cycle + share) * period, mask) for mask, share in group]
            for group, period in zip(groups, period_s, strict=True)
        ]

    stages = [(fired(cycle), (cycle + 1) * period_s) for cycle in range(cycles)]
    still = np.zeros((len(gaits), 3))
    return simulate_stages(rods, still, stages, step_s=step_s, width=width, acts=acts)
