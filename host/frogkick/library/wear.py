"""The wear curve of each limb: what transitions lose while it wears, simulated by the rods.

A limb is weakened step by step until nothing of its stroke is left. Contributions of limbs are nearly
additive, so one curve for each limb, a mean over states and over the actions that fire it, serves them all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from frogkick.core.arrays import Float64, dot
from frogkick.der import Rods
from frogkick.effects.limbs import WeakenedLimb
from frogkick.library.surface import noise_of
from frogkick.library.transitions import rigid_task, simulate_task
from frogkick.tables.layout import WEAR_KNOTS

GAINS = (0.9, 0.8, 0.65, 0.5, 0.3, 0.0)
"""Shares of the measured stroke that are simulated."""

_LEAST = 1.0  # of a lost limb, in units of the measurement's noise: below it no wear can be seen


def no_curves() -> Float64:
    """The curves of a library that has none."""
    return np.zeros((0, WEAR_KNOTS, 6))


def wear_curves(rods: Rods, velocity_body: Float64) -> Float64:
    """The wear curve of each limb.

    Args:
        rods: of the robot.
        velocity_body: (n, 3) velocities of the library's states. Strokes are simulated from rest, from their
            mean, and from turns to both sides, a standard deviation away.

    Returns:
        (l, WEAR_KNOTS, 6) what the six values of a transition change (m, m, rad, m/s, m/s, rad/s) where a
        limb has lost 1, 2, .. of WEAR_KNOTS parts of its contribution; the last one: all of it. Zeros for a
        limb whose loss cannot be seen. No curves where a stroke could not be simulated.
    """
    robot = rods.robot
    mean, aside = velocity_body.mean(axis=0), velocity_body.std(axis=0) * [0.0, 1.0, 1.0]
    starts = np.stack([np.zeros(3), mean, mean + aside, mean - aside])
    task = rigid_task(starts)
    sound = simulate_task(rods, task).rows
    found = np.zeros((len(robot.limbs), WEAR_KNOTS, 6))
    for limb in range(len(robot.limbs)):
        fires = [bool((action.first_mask | action.second_mask) >> limb & 1) for action in robot.actions]
        if not any(fires):
            continue
        firing = tuple(action for action, fired in zip(robot.actions, fires, strict=True) if fired)
        some = replace(rods, robot=replace(robot, actions=firing))  # no other action's transitions change
        worn = np.full((len(GAINS), *sound.shape), np.nan)
        for rows, gain in zip(worn, GAINS, strict=True):
            rows[:, fires] = simulate_task(some, task, extra=(WeakenedLimb(limb, gain),)).rows
        change = np.array([(rows - sound)[:, fires].mean(axis=(0, 1)) for rows in worn])
        if not np.isfinite(change).all():
            return no_curves()
        found[limb] = _by_loss(change / noise_of(robot)) * noise_of(robot)
    return found


def _by_loss(change: Float64) -> Float64:
    """(WEAR_KNOTS, 6) changes (g, 6) of weaker and weaker strokes by the share of the last one that is lost.

    A share is the projection on what a lost limb changes: it grows evenly, so an estimate of it converges,
    where the stroke's gain loses nearly everything within its first third.
    """
    lost = change[-1]
    size2 = dot(lost, lost)
    if size2 < _LEAST**2:
        return np.zeros((WEAR_KNOTS, 6))
    share = np.maximum.accumulate(
        np.clip(np.concatenate([[0.0], np.einsum("gc,c->g", change, lost) / size2]), 0.0, 1.0)
    )
    known = np.concatenate([np.zeros((1, 6)), change])
    knots = np.arange(1, WEAR_KNOTS + 1) / WEAR_KNOTS
    return np.stack([np.interp(knots, share, column) for column in known.T], axis=1)
