"""With an upper bound of the steps, robots swim as without it, in more steps."""

from __future__ import annotations

import numpy as np
import pytest

from frogkick.der import WIDTH, Batch, prepare
from frogkick.robot import load_robot

LONGEST_S = 8e-3
POSES = np.array([[0.0, 0.0, 0.3], [0.4, -0.2, -2.0], [-0.1, 0.1, 1.0]])
UNTIL_S = ((0.05, 0.2, 0.05), (0.9, 0.9, 0.05), (1.3, 1.4, 1.2))
"""Of each lane; one stands still for a while."""


def both(step_s: float) -> list[Batch]:
    rods, still = prepare(load_robot("frog2022")), np.zeros_like(POSES)
    longest = (LONGEST_S, np.inf)
    return [Batch([rods] * len(POSES), POSES, still, 0.0, step_s, WIDTH, each) for each in longest]


def fire(batch: Batch, number: int) -> None:
    batch.fire(0, number, 0.02 + 0.4 * number, gain=0.8)
    batch.fire(0, (number + 1) % 4, 0.02 + 0.4 * number, duration_scale=1.7)
    batch.fire(1, 2, 0.1 + 0.45 * number)


def test_lanes_swim_as_a_batch_has_them() -> None:
    """The bound is longer than every step, so the bits are the same."""
    mine, theirs = both(6e-4)
    for number, until_s in enumerate(UNTIL_S):
        fire(mine, number)
        fire(theirs, number)
        for (times, rows), (known, right) in zip(
            mine.advance(np.array(until_s), trace=True),
            theirs.advance(np.array(until_s), trace=True),
            strict=True,
        ):
            assert np.array_equal(times, known) and np.array_equal(rows, right)
    assert np.array_equal(mine.motion_world(), theirs.motion_world())
    assert np.array_equal(mine.time_s, theirs.time_s)


def test_no_step_is_too_long_and_no_stroke_is_lost() -> None:
    mine, theirs = both(2.4e-3)
    longest = 0.0
    for number, until_s in enumerate(UNTIL_S):
        fire(mine, number)
        fire(theirs, number)
        before = mine.time_s.copy()
        for lane, (times, _) in enumerate(mine.advance(np.array(until_s), trace=True)):
            if len(times):
                assert times[-1] == until_s[lane]
                assert np.diff(times, prepend=before[lane]).max() <= LONGEST_S + 1e-12
        reported = theirs.advance(np.array(until_s), trace=True)
        longest = max([longest, *(np.diff(times).max() for times, _ in reported if len(times) > 1)])
    assert longest > LONGEST_S, "a batch would take longer ones here"
    assert mine.pose_world()[0] == pytest.approx(theirs.pose_world()[0], abs=5e-3)
    assert np.abs(mine.pose_world()[0] - POSES[0]).max() > 0.01
