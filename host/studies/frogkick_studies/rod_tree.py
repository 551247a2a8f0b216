"""The rods asked what every sequence of actions does, and their answers as a table that a planner reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import ConvergenceError
from frogkick.core.poses import relative
from frogkick.der import WIDTH, Batch
from frogkick.der.strokes import between
from frogkick.effects import ActingLanes
from frogkick.library.transitions import fire_action
from frogkick.robot import Robot
from frogkick.tables.image import Tables

FloatArray = NDArray[np.float64]

_APART = 100  # velocity codes between the names of a tree's nodes


def swim_a_period(
    robot: Robot, batch: Batch, acting: ActingLanes, actions: Mapping[int, int]
) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Some lanes do an action each for a period; (k,) times and (k, MOTION) rows of each, the start first.

    Raises:
        ConvergenceError: the rods failed.
    """
    start_s, before, until = batch.time_s.copy(), batch.motion_world(), batch.time_s.copy()
    for lane, action in actions.items():
        fire_action(robot, batch, acting, lane, action, float(start_s[lane]))
        until[lane] += robot.period_s
    told = acting.advance(batch, until, trace=True)
    for lane, failure in batch.failures.items():
        raise ConvergenceError(f"a swim of {robot.id!r} {failure} (lane {lane})")
    return {
        lane: (
            np.concatenate([start_s[lane : lane + 1], told[lane][0]]),
            np.concatenate([before[lane : lane + 1], told[lane][1]]),
        )
        for lane in actions
    }


def motion_of(times_s: FloatArray, rows: FloatArray) -> FloatArray:
    """(3,) from the first row to the last one, in the body frame of the first."""
    pose = between(times_s, rows, times_s[[0, -1]])[0]
    return relative(pose[0], pose[1])


def ask_rods(robot: Robot, batch: Batch, acting: ActingLanes, depth: int) -> FloatArray:
    """Let copies of swimming robots try every sequence of actions.

    Args:
        robot: whose actions.
        batch, acting: at a decision; they are left as they are.
        depth: actions in a row.

    Returns:
        (lanes, nodes, a, 3) motions over a period, forward, left (m), turn (rad), body frame at its start,
        from each node of the tree: the present, then where action 0, 1, .. leads, then the sequences (0, 0),
        (0, 1), ...

    Raises:
        ConvergenceError: the rods failed.
    """
    lanes, actions, nodes = batch.lanes, len(robot.actions), 1
    told: list[FloatArray] = []
    level = [(batch, acting, [(lane, 0) for lane in range(lanes)])]  # and whose robots, at which node
    while len(told) < depth:
        motions, following = np.empty((lanes, nodes, actions, 3)), []
        for before, acted, who in level:
            tries = [(place, action) for action in range(actions) for place in range(len(who))]
            for first in range(0, len(tries), WIDTH):
                some = tries[first : first + WIDTH]
                of = [place for place, _ in some]
                twin, twin_acting = before.pick(of), acted.pick(of)
                done = {to: action for to, (_, action) in enumerate(some)}
                swum = swim_a_period(robot, twin, twin_acting, done)
                ends = []
                for to, (place, action) in enumerate(some):
                    lane, node = who[place]
                    motions[lane, node, action] = motion_of(*swum[to])
                    ends.append((lane, node * actions + action))
                if len(told) < depth - 1:
                    following.append((twin, twin_acting, ends))
        told.append(motions)
        level, nodes = following, nodes * actions
    return np.concatenate(told, axis=1)


def table_of_motions(motions: FloatArray, like: Tables) -> Tables:
    """A table in which the planner finds the motions of a tree instead of those of velocities.

    What an action's end is called there, in place of its velocity, is the next node; the present has the
    velocity 0. The planner's costs look at poses alone, so it searches as it does in any table.

    Args:
        motions: (nodes, a, 3) as ``ask_rods`` gives them for a lane.
        like: whose actions, scales and reach the table has; the reach grows where a motion is beyond it.
    """
    nodes, actions = motions.shape[:2]
    name = np.zeros((nodes * actions + 1, 3), dtype=np.int64)
    name[:nodes, 0], name[:nodes, 1] = np.arange(nodes) % _APART, np.arange(nodes) // _APART
    name *= _APART
    leads_to = 1 + np.arange(nodes * actions).reshape(nodes, actions)
    codes = np.rint(motions / like.motion_scale.astype(np.float64)).astype(np.int64)
    arrays = {
        "states": name[:nodes].astype(np.int16),
        "transitions": np.concatenate([codes, name[leads_to]], axis=2).astype(np.int32),
        "derivatives": np.empty((0, actions, 6, 3), dtype=np.int32),
        "motion_limit": np.maximum(like.motion_limit, np.abs(codes).max(axis=(0, 1))),
    }
    for array in arrays.values():
        array.setflags(write=False)  # as an opened image's: else numba compiles the planner once more
    return replace(like, image=b"", kind="nearest", **arrays)  # the image is nowhere but here
