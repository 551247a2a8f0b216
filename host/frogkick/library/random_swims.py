"""Swims from rest with random actions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from frogkick.robot import Robot

SWIM_STROKES = 12  # from rest to cruising takes about six
_HOLD_STROKES_MAX = 4  # an action is held for 1 to this many strokes: turns build up over several


def random_swims(robot: Robot, seed: int) -> Iterator[list[int]]:
    """The actions of one swim after another, without end; each action is held for a few strokes."""
    swim = 0
    while True:
        rng = np.random.default_rng([seed, swim])
        actions: list[int] = []
        while len(actions) < SWIM_STROKES:
            action = int(rng.integers(len(robot.actions)))
            actions += [action] * int(rng.integers(1, _HOLD_STROKES_MAX + 1))
        yield actions[:SWIM_STROKES]
        swim += 1
