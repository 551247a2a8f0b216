"""Inverse planning: the motions that the paper's planner assumed, from the choices that recorded runs show.

The authors' own library of turning strokes was not published. Their runs show what their planner assumed: for
each decision the pose, the path, and the action that it found the cheapest are known. The estimated motions
make these choices likely. The likelihood is a softmax over the cost, with a share of random choices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from frogkick.core.arrays import Float32, Float64, Int64
from frogkick.core.errors import InputError
from frogkick.library.store import table_metadata
from frogkick.planner.costs import pose_cost
from frogkick.planner.plan import PlanConfig, path_rows
from frogkick.robot import Robot, mirror_of
from frogkick.runs.runlog import RunLog
from frogkick.tables.packing import pack_nearest

DECISIONS_MIN = 60
"""Fewer choices cannot determine some thirty numbers."""

_TRIES = 3000
_TEMPERATURE = np.float32(3.0)
"""Scale of the softmax, in cost: a few mm or degrees of error in the planner's pose."""
_SLIP = 0.1  # share of random choices
_SIZES = (0.05, 0.2)  # relative size of a random step of the search
_MOVED = 0.3  # share of the numbers that a step changes


@dataclass(frozen=True, eq=False)
class Choices:
    """Decisions of a run: (n, 3) poses, world frame, by the newest fix before each, (n,) actions chosen."""

    path: Float32
    poses_world: Float32
    actions: Int64


@dataclass(frozen=True, eq=False)
class AssumedMotions:
    """Motions that a planner assumed.

    Attributes:
        motion: (a, 3) forward, left (m) and turn (rad), body frame at the action's start, at any velocity.
        agreement: share of the choices that these motions explain.
        held_out_agreement: the same for each run, with the motions that were estimated from the others.
        nominal_agreement: the same with the initial motions of the search.
    """

    motion: Float64
    agreement: float
    held_out_agreement: float
    nominal_agreement: float
    decisions: int


def choices_of(run: RunLog) -> Choices:
    """Return a recorded run's decisions whose action is known."""
    if run.path is None:
        raise InputError(f"run {run.source!r} has no path: give the one that was followed")
    fixes, known = run.fixes, run.decisions.action >= 0
    newest = np.searchsorted(fixes.time_s, run.decisions.time_s[known], side="left") - 1
    poses = fixes.pose_world[np.maximum(newest, 0)]
    return Choices(path_rows(run.path), poses.astype(np.float32), run.decisions.action[known])


def assumed_motions(runs: Sequence[Choices], robot: Robot, nominal: Float64) -> AssumedMotions:
    """Find the motions that make choices of the paper's planner at depth 1 likely.

    Mirrored actions of a symmetric robot have mirrored motions.

    Args:
        runs: at least two, of the same robot, with DECISIONS_MIN decisions together.
        nominal: (a, 3) initial motions; each number is scaled, so zeros stay zero.
    """
    count = sum(len(run.actions) for run in runs)
    if len(runs) < 2 or count < DECISIONS_MIN:
        raise InputError(
            f"{len(runs)} runs with {count} decisions do not determine the motions that their planner "
            f"assumed: give 2 runs or more with {DECISIONS_MIN} decisions or more"
        )
    begin = _mirrored(robot, nominal)
    motion = _search(runs, robot, begin)
    right = 0
    for left_out in runs:
        others = _search([run for run in runs if run is not left_out], robot, begin)
        right += _right(left_out, others)
    return AssumedMotions(
        motion,
        sum(_right(run, motion) for run in runs) / count,
        right / count,
        sum(_right(run, begin) for run in runs) / count,
        count,
    )


def image_of_motions(robot: Robot, motion: Float64) -> bytes:
    """Return a table image of kind nearest in which each action has one motion at any velocity.

    Args:
        motion: (a, 3) forward, left (m), turn (rad).
    """
    at_rest = np.zeros((1, 3))
    ends = np.zeros((1, *motion.shape))
    about = table_metadata(robot, np.asarray(motion, "<f8").tobytes()[:32])
    return pack_nearest(about, velocities=at_rest, displacements=motion[None], velocities_end=ends)


def _mirrored(robot: Robot, motion: Float64) -> Float64:
    """Return motions that are averaged with their mirror images."""
    mirror = mirror_of(robot)
    if mirror is None:
        return motion
    return np.asarray(0.5 * (motion + motion[list(mirror.actions)] * [1.0, -1.0, -1.0]))


def _search(runs: Sequence[Choices], robot: Robot, begin: Float64) -> Float64:
    rng, mirror = np.random.default_rng(0), mirror_of(robot)
    twins = np.arange(len(begin)) if mirror is None else np.array(mirror.actions)
    best, most = begin, _likelihood(runs, begin)
    for _ in range(_TRIES):
        steps = rng.choice(_SIZES) * rng.standard_normal(begin.shape) * (rng.random(begin.shape) < _MOVED)
        steps = np.where((twins < np.arange(len(twins)))[:, None], steps[twins], steps)
        tried = best * np.exp(steps)
        likely = _likelihood(runs, tried)
        if likely > most:
            best, most = tried, likely
    return best


def _likelihood(runs: Sequence[Choices], motion: Float64) -> float:
    total = 0.0
    for run in runs:
        costs = _costs(run, motion)
        apart = (costs - costs.min(axis=1, keepdims=True)) / _TEMPERATURE
        chances = np.exp(-apart.astype(np.float64))
        chosen = chances[np.arange(len(chances)), run.actions] / chances.sum(axis=1)
        total += float(np.log((1.0 - _SLIP) * chosen + _SLIP / chances.shape[1]).sum())
    return total


def _right(run: Choices, motion: Float64) -> int:
    return int((_costs(run, motion).argmin(axis=1) == run.actions).sum())


def _costs(run: Choices, motion: Float64) -> Any:
    config = PlanConfig()
    weights = np.array(
        [config.distance_weight_per_m, config.angle_weight_per_rad, config.progress_weight], np.float32
    )
    return _all_costs(run.path, weights, run.poses_world, motion.astype(np.float32))


@njit(error_model="numpy")
def _all_costs(path: Any, weights: Any, poses: Any, motion: Any) -> Any:
    """Return the paper's cost (n, a) after each action from each pose."""
    costs = np.empty((len(poses), len(motion)), dtype=np.float32)
    for row in range(len(poses)):
        cosine, sine = np.cos(poses[row, 2]), np.sin(poses[row, 2])
        for action in range(len(motion)):
            forward, left, turn = motion[action]
            x = poses[row, 0] + cosine * forward - sine * left
            y = poses[row, 1] + sine * forward + cosine * left
            heading = poses[row, 2] + turn
            costs[row, action] = pose_cost(path, weights[0], weights[1], weights[2], x, y, heading)
    return costs
