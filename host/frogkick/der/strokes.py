"""Simulations of strokes, many in batches, and their motion between time steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.core.errors import InputError
from frogkick.core.poses import body_from_world
from frogkick.der.batch import WIDTH, Batch, Failure
from frogkick.der.mesh import Rods
from frogkick.der.schedule import STEP_S
from frogkick.robot import Action, Robot

Program = Sequence[tuple[float, int]]
"""Strokes of one simulation: (time_s, limb_mask), bit i = limb i."""


Stage = tuple[Sequence[Program], Float64]
"""Strokes of k simulations that are fired together, and the times (k,) to which they are then advanced."""


class LaneEffects(Protocol):
    """Effects that act on several lanes; see frogkick.effects.ActingLanes."""

    def fire(self, batch: Batch, lane: int, limb: int, time_s: float) -> None:
        """Fire a limb of a lane's robot."""

    def advance(
        self, batch: Batch, until_s: float | Float64, trace: bool = False
    ) -> list[tuple[Float64, Float64]]:
        """Advance all lanes; see Batch.advance."""


class NoEffects:
    """No effects: limbs fire as commanded, and nothing else acts."""

    def fire(self, batch: Batch, lane: int, limb: int, time_s: float) -> None:
        batch.fire(lane, limb, time_s)

    def advance(
        self, batch: Batch, until_s: float | Float64, trace: bool = False
    ) -> list[tuple[Float64, Float64]]:
        return batch.advance(until_s, trace)


def program_of(robot: Robot, action: Action, start_s: float = 0.0) -> list[tuple[float, int]]:
    """Return the strokes of an action that starts at ``start_s``."""
    strokes = [(start_s, action.first_mask), (start_s + robot.second_delay_s, action.second_mask)]
    return [(time, mask) for time, mask in strokes if mask]


@dataclass(frozen=True, eq=False)
class Track:
    """The motion of a simulation from its first to its last stage, step by step."""

    time_s: Float64  # (n,) 0 and the ends of all time steps
    motion: Float64  # (n, MOTION) rows of frogkick.der.body.body_motion, world frame
    stage_end: Int64  # (stages + 1,) rows at which stages begin and end

    @property
    def node_mean_m(self) -> Float64:
        """(n,) forward position of the unweighted mean of all nodes."""
        return np.asarray(self.motion[:, 6])


def simulate_stages(
    rods: Sequence[Rods],
    velocity_body: Float64,
    stages: Sequence[Stage],
    *,
    step_s: float = STEP_S,
    width: int = WIDTH,
    acts: Callable[[int], LaneEffects] | None = None,
) -> list[Track | Failure]:
    """Simulate robots from the world's origin, limbs at rest, ``width`` at a time, through all stages.

    Args:
        rods: one for each simulation, of one mesh.
        velocity_body: (k, 3) forward, left (m/s), turn rate (rad/s) at the start.
        step_s: finest time step.
        acts: makes the effects of a number of lanes; None: no effects.
    """
    found: list[Track | Failure] = []
    for first in range(0, len(rods), width):
        some = slice(first, first + width)
        velocity = velocity_body[some]
        batch = Batch(rods[some], np.zeros_like(velocity), velocity, 0.0, step_s, width)
        lanes = acts(batch.lanes) if acts else NoEffects()
        ends = [[np.zeros(1)] for _ in velocity]
        rows = [[row[None]] for row in batch.motion_world()]
        limbs = range(batch.limbs)
        for programs, until_s in stages:
            for lane, program in enumerate(programs[some]):
                for start, mask in program:
                    for limb in limbs:
                        if mask >> limb & 1:
                            lanes.fire(batch, lane, limb, start)
            for lane, (times, motion) in enumerate(lanes.advance(batch, until_s[some], trace=True)):
                ends[lane].append(times)
                rows[lane].append(motion)
        for lane in range(batch.lanes):
            stage_end = np.cumsum([len(times) for times in ends[lane]]) - 1
            track = Track(np.concatenate(ends[lane]), np.concatenate(rows[lane]), stage_end)
            found.append(batch.failures.get(lane, track))
    return found


@dataclass(frozen=True)
class Motions:
    """Motions of k robots from the world's origin, heading along world x."""

    time_s: Float64  # (s,) times
    pose_world: Float64  # (k, s, 3) x, y (m), heading (rad, continuous: not wrapped); NaN after a failure
    velocity_body: Float64  # (k, s, 3) forward, left (m/s), turn rate (rad/s); NaN likewise
    failures: dict[int, Failure]  # simulation -> its failure


def simulate_many(
    rods: Rods | Sequence[Rods],
    velocity_body: Float64,
    programs: Sequence[Program],
    time_s: Sequence[float] | Float64,
    *,
    step_s: float = STEP_S,
    width: int = WIDTH,
    acts: Callable[[int], LaneEffects] | None = None,
) -> Motions:
    """Simulate robots of one mesh from rest poses, limbs at rest, ``width`` at a time.

    Each result has the same bits, whatever else is simulated with it. Lanes with the same strokes share most
    of their steps.

    Args:
        rods: of all simulations, or one for each; these may differ only in actuation.
        velocity_body: (k, 3) forward, left (m/s), turn rate (rad/s) at the start.
        programs: (k) strokes of each.
        time_s: (s,) increasing, after 0: times of the results. A step ends at the last of them; the others
            are interpolated between steps (cubic Hermite).
        step_s: finest time step.
        width: lanes of a batch.
        acts: makes the effects of a number of lanes; None: no effects.

    Raises:
        InputError: shapes that do not fit, values that are not finite, or times that do not increase.
    """
    velocity = np.asarray(velocity_body, dtype=np.float64)
    times = np.asarray(time_s, dtype=np.float64)
    if velocity.ndim != 2 or velocity.shape[1] != 3 or len(velocity) != len(programs):
        raise InputError(
            f"velocities have shape {velocity.shape} for {len(programs)} programs: give (k, 3) for k programs"
        )
    if not np.isfinite(velocity).all():
        raise InputError("initial velocities must be finite: one is not")
    if times.ndim != 1 or not len(times) or not (np.diff(times, prepend=0.0) > 0.0).all():
        raise InputError(f"times {times.tolist()} do not increase from 0: give increasing seconds after 0")
    if not (np.isfinite(times[-1]) and np.isfinite(step_s) and step_s > 0.0 and width > 0):
        raise InputError(f"last time {times[-1]} s, step {step_s} s, width {width}: give positive ones")
    each = [rods] * len(programs) if isinstance(rods, Rods) else rods
    pose = np.full((len(programs), len(times), 3), np.nan)
    speed = np.full_like(pose, np.nan)
    failures: dict[int, Failure] = {}
    stage = programs, np.full(len(programs), times[-1])
    tracks = simulate_stages(each, velocity, [stage], step_s=step_s, width=width, acts=acts)
    for k, track in enumerate(tracks):
        if isinstance(track, Failure):
            failures[k] = track
        else:
            pose[k], speed[k] = interpolate(track.time_s, track.motion, times)
    return Motions(times, pose, speed, failures)


def cubic(
    p: Float64, q: Float64, v: Float64, w: Float64, length_s: Float64, share: Float64
) -> tuple[Float64, Float64]:
    """Return value and slope of the cubic Hermite interpolant from p with slope v to q with slope w.

    Args:
        p, q: (k, d) values at both ends; v, w: (k, d) slopes there, per second.
        length_s: (k, 1) time between the ends; share: (k, 1) place in between, 0 to 1.
    """
    bend = 3.0 * (q - p) - length_s * (2.0 * v + w)
    twist = length_s * (v + w) - 2.0 * (q - p)
    value = p + share * (length_s * v + share * (bend + share * twist))
    return value, v + share * (2.0 * bend + share * (3.0 * twist)) / length_s


def interpolate(ends_s: Float64, rows: Float64, time_s: Float64) -> tuple[Float64, Float64]:
    """Interpolate poses and body velocities between the ends of steps (cubic Hermite).

    Args:
        ends_s: (k,) increasing times.
        rows: (k, MOTION) of frogkick.der.body.body_motion at these.
        time_s: (s,) times within.

    Returns:
        (s, 3) poses, heading continuous, and (s, 3) velocities, body frame. At the end of a step they are
            exactly those of its row.
    """
    pose = rows[:, :3].copy()
    pose[:, 2] = np.unwrap(pose[:, 2])
    rate = body_from_world(-pose[:, 2], rows[:, 3:6])
    left = np.clip(np.searchsorted(ends_s, time_s, side="right") - 1, 0, len(ends_s) - 2)
    length = (ends_s[left + 1] - ends_s[left])[:, None]
    u = (time_s[:, None] - ends_s[left, None]) / length
    at, slope = cubic(pose[left], pose[left + 1], rate[left], rate[left + 1], length, u)
    velocity = body_from_world(at[:, 2], slope)
    for end, row in ((u[:, 0] == 0.0, left), (u[:, 0] == 1.0, left + 1)):
        at[end], velocity[end] = pose[row[end]], rows[row[end], 3:6]
    return at, velocity
