"""Cyclic gaits: the two groups of limbs fire in turn, at a frequency and a phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.der.batch import WIDTH, Failure
from frogkick.der.strokes import between
from frogkick.der.swimmer import STEP_S, Rods, batch_of, prepare
from frogkick.der.trajectory import Trajectory, sample_times, trajectory_of
from frogkick.errors import ConvergenceError, InputError
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

CYCLES_MAX = 10000


@dataclass(frozen=True)
class Gait:
    """Which profile the limbs follow, how often they fire, and the lagging group's share of the cycle."""

    egain_percent: float
    frequency_hz: float
    phase: float


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
        ConvergenceError: the simulation failed; the text gives the state.
    """
    (result,) = simulate_gaits(
        robot, [Gait(egain_percent, frequency_hz, phase)], cycles, step_s=step_s, width=1
    )
    if isinstance(result, Failure):
        raise ConvergenceError(f"rods of {robot.id!r} {result}")
    return result


def simulate_gaits(
    robot: Robot, gaits: Sequence[Gait], cycles: int, *, step_s: float = STEP_S, width: int = WIDTH
) -> list[Trajectory | Failure]:
    """Simulate gaits side by side, each as ``simulate_gait`` does and to the same bits.

    Returns:
        For each gait its trajectory, or why and where it stopped.

    Raises:
        InputError: see simulate_gait; nothing is simulated then.
    """
    for gait in gaits:
        if not 0.0 <= gait.phase < 1.0:
            raise InputError(f"phase is {gait.phase}: give a share of the cycle, 0 <= phase < 1")
    if not 1 <= cycles <= CYCLES_MAX:
        raise InputError(f"cycles is {cycles}: give 1 to {CYCLES_MAX}")
    rods = [prepare(robot, gait.egain_percent, gait.frequency_hz) for gait in gaits]
    results: list[Trajectory | Failure] = []
    for first in range(0, len(gaits), width):
        some = slice(first, first + width)
        results += _side_by_side(robot, gaits[some], rods[some], cycles, step_s, width)
    return results


def _side_by_side(
    robot: Robot, gaits: Sequence[Gait], rods: Sequence[Rods], cycles: int, step_s: float, width: int
) -> list[Trajectory | Failure]:
    still = np.zeros((len(gaits), 3))
    batch = batch_of(rods, still, still, 0.0, step_s, width)
    period_s = np.array([1.0 / gait.frequency_hz for gait in gaits])
    ends = [[np.zeros(1)] for _ in gaits]
    rows = [[row[None]] for row in batch.motion_world()]
    mean_m = [[row[0][0, 6]] for row in rows]  # forward position of the plain node mean after each cycle
    for cycle in range(cycles):
        for lane, gait in enumerate(gaits):
            for mask, share in ((robot.gait_lead_mask, 0.0), (robot.gait_lag_mask, gait.phase)):
                for limb in range(len(robot.limbs)):
                    if mask >> limb & 1:
                        batch.fire(lane, limb, (cycle + share) * period_s[lane])
        for lane, (times, motion) in enumerate(batch.advance((cycle + 1) * period_s, trace=True)):
            ends[lane].append(times)
            rows[lane].append(motion)
            if len(motion):
                mean_m[lane].append(motion[-1, 6])
    last = min(cycles, 8)
    counted = min(last, 3)
    pulses = cycles * (robot.gait_lead_mask.bit_count() + robot.gait_lag_mask.bit_count())
    results: list[Trajectory | Failure] = []
    for lane in range(len(gaits)):
        if lane in batch.failures:
            results.append(batch.failures[lane])
            continue
        speed = float(mean_m[lane][last] - mean_m[lane][last - counted]) / (counted * float(period_s[lane]))
        time_s = sample_times(float(period_s[lane]), cycles)
        pose, _ = between(np.concatenate(ends[lane]), np.concatenate(rows[lane]), time_s)
        results.append(trajectory_of(time_s, pose, speed, pulses * robot.pulse_energy_j, robot))
    return results
