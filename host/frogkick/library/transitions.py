"""Simulation of all actions from many states: rigid ones at a velocity, or states in the course of a swim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Bool, Float32, Float64, Int64
from frogkick.core.errors import ConvergenceError
from frogkick.core.poses import relative
from frogkick.der import STEP_S, WIDTH, Batch, Rods, interpolate
from frogkick.effects import Acting, Effect
from frogkick.effects.acting import lane_effects, program_of
from frogkick.robot import Robot

SAMPLE_S = 0.05  # spacing of recorded poses: a cubic between them errs by 0.02 mm
HISTORY = 8
"""Number of earlier actions that are kept with a state: more periods than any measured stroke lasts."""

RESTED = -1
"""Stands for an earlier action if there was none and all limbs rested."""


@dataclass(frozen=True, eq=False)
class Task:
    """The start of transitions: k robots at a velocity, each of which swims s actions, one a period.

    Attributes:
        velocity_body: (k, 3) forward, left (m/s), turn rate (rad/s) of the robots, limbs at rest.
        actions: (k, s) indices of the actions; s may be 0.
        wanted: (k, s + 1) whether transitions start before that action of the swim, or after the last.
    """

    velocity_body: Float64
    actions: Int64
    wanted: Bool


def rigid_task(velocity_body: Float64) -> Task:
    """The task of k robots at (k, 3) velocities, limbs at rest."""
    count = len(velocity_body)
    return Task(velocity_body, np.empty((count, 0), dtype=np.int64), np.ones((count, 1), dtype=bool))


@dataclass(frozen=True)
class Failed:
    """A transition that could not be simulated, and why."""

    state: int
    action: int
    reason: str


@dataclass(frozen=True)
class Transitions:
    """Results of the n wanted states of a task and all a actions.

    Attributes:
        velocity_body: (n, 3) at the start.
        previous: (n, HISTORY) actions started 1, 2, .. periods before the start, then RESTED.
        rows: (n, a, 6) after one period: forward, left (m), turn (rad, continuous) in the body frame at the
            start, then velocity (m/s, m/s, rad/s) in the body frame at the end; NaN if it failed.
        recorded: (n, a, t, 6) the same at ``recorded_times``, float32.
        failed: failed transitions; states counted from 0.
    """

    velocity_body: Float64
    previous: Int64
    rows: Float64
    recorded: Float32
    failed: tuple[Failed, ...]


def recorded_times(robot: Robot, record_s: float) -> Float64:
    """(t,) multiples of SAMPLE_S up to ``record_s``; none up to the period."""
    count = int(record_s / SAMPLE_S + 1e-9) if record_s > robot.period_s else 0
    return np.asarray(SAMPLE_S * np.arange(1, count + 1), dtype=np.float64)


def previous_actions(actions: Int64, stroke: int) -> Int64:
    """(HISTORY,) newest first, the actions before a stroke of a swim, then RESTED."""
    found = np.full(HISTORY, RESTED, dtype=np.int64)
    newest = actions[:stroke][::-1][:HISTORY]
    found[: len(newest)] = newest
    return found


def simulate_task(rods: Rods, task: Task, record_s: float = 0.0, extra: Sequence[Effect] = ()) -> Transitions:
    """Simulate all actions from the wanted states of a task; the bits do not depend on its other states.

    Args:
        rods: of the robot.
        task: the states.
        record_s: time to record of each transition.
        extra: effects beside those of the robot's file.

    Raises:
        ConvergenceError: a swim cannot be simulated on to its next wanted state.
    """
    robot = rods.robot
    places = {(int(k), int(s)): n for n, (k, s) in enumerate(np.argwhere(task.wanted))}
    velocity = np.empty((len(places), 3))
    previous = np.array([previous_actions(task.actions[k], s) for k, s in places], dtype=np.int64)
    previous = previous.reshape(-1, HISTORY)
    times_s = recorded_times(robot, record_s)
    rows = np.full((len(places), len(robot.actions), 6), np.nan)
    recorded = np.full((*rows.shape[:2], len(times_s), 6), np.nan, dtype=np.float32)
    failed: list[Failed] = []
    for first in range(0, len(task.velocity_body), WIDTH):
        some = slice(first, first + WIDTH)
        still = np.zeros_like(task.velocity_body[some])
        batch = Batch([rods] * len(still), still, task.velocity_body[some], 0.0, STEP_S, WIDTH)
        acting = lane_effects(robot, len(still), extra)
        strokes = np.flatnonzero(task.wanted[some].any(axis=0))
        for stroke in range(int(strokes.max(initial=-1)) + 1):
            lanes = np.flatnonzero(task.wanted[some, stroke])
            if len(lanes):
                chosen = [places[first + int(lane), stroke] for lane in lanes]
                # The exact placement of a robot before its first stroke, without its nodes' rounding.
                origin = batch.pose_world() if stroke else still
                velocity[chosen] = (batch.velocity_body() if stroke else task.velocity_body[some])[lanes]
                # Pairs of all robots together, so that few robots fill a batch too.
                pairs = [(int(n), action) for action in range(len(robot.actions)) for n in lanes]
                for begin in range(0, len(pairs), WIDTH):
                    together = pairs[begin : begin + WIDTH]
                    motions = _branch(robot, batch, acting, origin, together, times_s)
                    for (lane, action), motion in zip(together, motions, strict=True):
                        place = places[first + lane, stroke]
                        if isinstance(motion, str):
                            failed.append(Failed(place, action, motion))
                        else:
                            rows[place, action] = motion[0]
                            recorded[place, action] = motion[1]
            if stroke < strokes.max(initial=-1):
                for lane in range(len(still)):
                    done = robot.actions[int(task.actions[first + lane, stroke])]
                    acting.fire_all(batch, lane, program_of(robot, done, stroke * robot.period_s))
                acting.advance(batch, (stroke + 1) * robot.period_s)
                for lane, failure in batch.failures.items():
                    raise ConvergenceError(f"a swim of {robot.id!r} {failure} (lane {lane})")
    return Transitions(
        velocity, previous, rows, recorded, tuple(sorted(failed, key=lambda f: (f.state, f.action)))
    )


def _branch(
    robot: Robot,
    batch: Batch,
    acting: Acting,
    origin: Float64,
    pairs: Sequence[tuple[int, int]],
    times_s: Float64,
) -> list[tuple[Float64, Float64] | str]:
    """Simulate an action in each of at most WIDTH copies of lanes; ``pairs`` are lane and action.

    Returns:
        For each the (6,) row at the period's end and the (t, 6) rows at ``times_s``, or why it failed.
    """
    began_s = float(batch.time_s[pairs[0][0]])
    times = np.union1d(times_s, [robot.period_s])
    at_period, kept = int(np.searchsorted(times, robot.period_s)), np.isin(times, times_s)
    ends = [robot.period_s] if times[-1] == robot.period_s else [robot.period_s, times[-1]]
    of = [lane for lane, _ in pairs]
    twin, twin_acting = batch.pick(of), acting.pick(of)
    for lane, (_, action) in enumerate(pairs):
        twin_acting.fire_all(twin, lane, program_of(robot, robot.actions[action], began_s))
    before = twin.motion_world()
    legs = [twin_acting.advance(twin, began_s + end, trace=True) for end in ends]
    found: list[tuple[Float64, Float64] | str] = []
    for lane, (source, _) in enumerate(pairs):
        if lane in twin.failures:
            found.append(str(twin.failures[lane]))
            continue
        steps = np.concatenate([np.zeros(1), *(leg[lane][0] - began_s for leg in legs)])
        steps[np.cumsum([len(leg[lane][0]) for leg in legs])] = ends  # exactly
        traced = np.concatenate([before[lane : lane + 1], *(leg[lane][1] for leg in legs)])
        pose, speed = interpolate(steps, traced, times)
        moved = relative(origin[source], pose)
        motion = np.concatenate([moved, speed], axis=1)
        found.append((motion[at_period], motion[kept]))
    return found
