"""Simulate cyclic gaits from rest as the paper does, many at a time, for validation and sweep."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.chunks import Job, run_chunks
from frogkick.core.errors import InputError
from frogkick.der import Batch, Failure, Rods
from frogkick.effects import rods_of
from frogkick.effects.swims import Gait, gait_rods, simulate_gait_traces
from frogkick.robot import Actuation, Profile, Robot
from frogkick.robot.profile import actuation

CYCLES = 8
FIRST_CYCLE = 5
"""The authors' speed is the mean from the end of cycle 5 to the end of cycle 8."""


@dataclass(frozen=True)
class GaitSwim:
    """Cycles of a gait from rest, eight by default."""

    gait: Gait
    time_s: Float64  # (n,) ends of the time steps, from 0 to the end of the last cycle
    forward_m: Float64  # (n,) forward position of the mean of all nodes, which the authors exported
    speed_mps: float  # mean over cycles 5 to 8
    cost_of_transport: (
        float  # electrical energy over weight in air and distance; infinite without motion, NaN if unknown
    )


def speed_over_cycles(time_s: Float64, forward_m: Float64, frequency_hz: float) -> float:
    """Return the mean speed (m/s) over cycles 5 to 8: (y(8/f) - y(5/f)) / (3/f), linearly interpolated."""
    start, end = FIRST_CYCLE / frequency_hz, CYCLES / frequency_hz
    at = np.interp([start, end], time_s, forward_m)
    return float(at[1] - at[0]) / (end - start)


def cost_of_transport(robot: Robot, frequency_hz: float, speed_mps: float) -> float:
    """Return the mean electrical power over weight in air and speed: P / (m g v).

    Each limb of the gait is pulsed once a cycle, for Robot.pulse_energy_j each.
    """
    pulses = robot.gait_lead_mask.bit_count() + robot.gait_lag_mask.bit_count()
    return robot.cost_of_transport(pulses * frequency_hz, 1.0, speed_mps)


Swum = list[GaitSwim | str]
"""For each gait its swim, or the reason of its failure in one line."""


def swim_gaits(rods: Rods, profiles: Sequence[Profile], gaits: Sequence[Gait], cycles: int = CYCLES) -> Swum:
    """Swim gaits from rest, heading forward, several of them side by side.

    The effects of the robot's file act on its strokes and its body; flows of the water do not act. Strokes
    are interpolated between the profiles; that of ``rods`` (frogkick.effects.rods_of) is not used.

    Returns:
        For each gait its swim, or the reason of its failure: a gait outside the profiles, a phase outside
        [0, 1), or a simulation that did not converge, with its state.
    """
    strokes = [_stroke(profiles, gait) for gait in gaits]
    swum: Swum = [stroke if isinstance(stroke, str) else "" for stroke in strokes]
    ready = [(k, gaits[k], stroke) for k, stroke in enumerate(strokes) if not isinstance(stroke, str)]
    ready.sort(key=lambda row: row[1].frequency_hz)  # lanes that last equally long keep each other busy
    some = [gait for _, gait, _ in ready]
    lanes = gait_rods(rods, some, [stroke for _, _, stroke in ready])
    traces = simulate_gait_traces(lanes, some, cycles)
    for (place, gait, _), lane, trace in zip(ready, lanes, traces, strict=True):
        if isinstance(trace, Failure):
            swum[place] = f"rods of {lane.robot.id!r} {trace}"
            continue
        speed_mps = speed_over_cycles(trace.time_s, trace.node_mean_m, gait.frequency_hz)
        cost = cost_of_transport(lane.robot, gait.frequency_hz, speed_mps)
        swum[place] = GaitSwim(gait, trace.time_s, trace.node_mean_m, speed_mps, cost)
    return swum


def _stroke(profiles: Sequence[Profile], gait: Gait) -> Actuation | str:
    if not 0.0 <= gait.phase < 1.0:
        return f"phase is {gait.phase:g}: give a share of the cycle, 0 <= phase < 1"
    try:
        return actuation(profiles, gait.egain_percent, gait.frequency_hz)
    except InputError as error:
        return str(error)


_Ready = tuple[Rods, tuple[Profile, ...]]


def _start(robot: Robot, profiles: tuple[Profile, ...]) -> _Ready:
    return rods_of(robot), profiles


def _swim_chunk(ready: _Ready, gaits: Sequence[Gait]) -> Swum:
    return swim_gaits(*ready, gaits)


def _warm(ready: _Ready) -> None:
    still = np.zeros((1, 3))
    Batch([ready[0]], still, still).advance(0.001)


def swim_chunks(
    robot: Robot,
    profiles: Sequence[Profile],
    chunks: Sequence[Sequence[Gait]],
    workers: int,
    cluster: str | None = None,
) -> Iterator[tuple[int, Swum]]:
    """Swim chunks of gaits in several processes; yield (index of the chunk, its results) as they finish.

    A result depends only on robot, profiles and gait. Errors: see ``frogkick.core.chunks.run_chunks``.
    """
    return run_chunks(Job(_start, (robot, tuple(profiles)), _swim_chunk, _warm), chunks, workers, cluster)
