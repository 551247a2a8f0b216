"""Cyclic gaits: two groups of limbs fire in turn, at a frequency and a phase."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.core.errors import InputError
from frogkick.der.batch import WIDTH, Failure
from frogkick.der.strokes import LaneEffects, NoEffects, interpolate
from frogkick.der.swimmer import STEP_S, Rods, batch_of, prepare
from frogkick.der.trajectory import Trajectory, sample_times, trajectory_of
from frogkick.robot import Robot

CYCLES_MAX = 10000


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
        acts: see ``simulate_gait_tracks``.

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
    return [
        track if isinstance(track, Failure) else _trajectory(robot, gait, track, cycles)
        for gait, track in zip(gaits, tracks, strict=True)
    ]


def _trajectory(robot: Robot, gait: Gait, track: GaitTrack, cycles: int) -> Trajectory:
    period_s = 1.0 / gait.frequency_hz
    last = min(cycles, 8)
    counted = min(last, 3)
    mean_m = track.node_mean_m[track.cycle_end]
    speed = float(mean_m[last] - mean_m[last - counted]) / (counted * period_s)
    pulses = cycles * (robot.gait_lead_mask.bit_count() + robot.gait_lag_mask.bit_count())
    time_s = sample_times(period_s, cycles)
    pose, velocity = interpolate(track.time_s, track.motion, time_s)
    return trajectory_of(time_s, pose, velocity, speed, pulses * robot.pulse_energy_j, robot)


@dataclass(frozen=True, eq=False)
class GaitTrack:
    """The motion of a gait, step by step."""

    time_s: Float64  # (n,) 0 and the ends of all time steps
    motion: Float64  # (n, MOTION) rows of frogkick.der.body.body_motion, world frame.
    cycle_end: Int64  # (cycles + 1,) rows at which cycles begin and end

    @property
    def node_mean_m(self) -> Float64:
        """(n,) forward position of the unweighted mean of all nodes."""
        return np.asarray(self.motion[:, 6])


def simulate_gait_tracks(
    rods: Sequence[Rods],
    gaits: Sequence[Gait],
    cycles: int,
    *,
    step_s: float = STEP_S,
    width: int = WIDTH,
    acts: Callable[[int], LaneEffects] | None = None,
) -> list[GaitTrack | Failure]:
    """Simulate gaits from rest, heading along world x, in ``width`` lanes.

    Args:
        rods: one for each gait, of one robot; frequency and phase of the gait give the times of its pulses.
        gaits: phases in [0, 1).
        step_s: finest time step.
        acts: makes the effects of a number of lanes; None: no effects.
    """
    tracks: list[GaitTrack | Failure] = []
    for first in range(0, len(gaits), width):
        some = slice(first, first + width)
        lanes = acts(len(gaits[some])) if acts else NoEffects()
        tracks += _side_by_side(rods[some], gaits[some], cycles, step_s, width, lanes)
    return tracks


def _side_by_side(
    rods: Sequence[Rods], gaits: Sequence[Gait], cycles: int, step_s: float, width: int, acts: LaneEffects
) -> Iterator[GaitTrack | Failure]:
    robot, still = rods[0].robot, np.zeros((len(gaits), 3))
    batch = batch_of(rods, still, still, 0.0, step_s, width)
    period_s = np.array([1.0 / gait.frequency_hz for gait in gaits])
    ends = [[np.zeros(1)] for _ in gaits]
    rows = [[row[None]] for row in batch.motion_world()]
    for cycle in range(cycles):
        for lane, gait in enumerate(gaits):
            for mask, share in ((robot.gait_lead_mask, 0.0), (robot.gait_lag_mask, gait.phase)):
                for limb in range(len(robot.limbs)):
                    if mask >> limb & 1:
                        acts.fire(batch, lane, limb, (cycle + share) * period_s[lane])
        for lane, (times, motion) in enumerate(acts.advance(batch, (cycle + 1) * period_s, trace=True)):
            ends[lane].append(times)
            rows[lane].append(motion)
    for lane in range(len(gaits)):
        if lane in batch.failures:
            yield batch.failures[lane]
            continue
        cycle_end = np.cumsum([len(times) for times in ends[lane]]) - 1
        yield GaitTrack(np.concatenate(ends[lane]), np.concatenate(rows[lane]), cycle_end)
