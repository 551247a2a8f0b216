"""Recent use of each limb, and its effect on the next stroke, in which the last stroke has not ended yet.

A limb's use is at most 1. Each period leaves a part of it, ``decay``, and firing adds ``gain``. With a gain
of 1 the use depends on the time since the last stroke, with 1 - decay on the frequency of strokes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.library.transitions import RESTED
from frogkick.robot import Robot

DECAYS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)


@dataclass(frozen=True, eq=False)
class History:
    """Effect of recent use.

    Attributes:
        effect: (a, limbs, 6) what a fully used limb adds to an action's motion (m, m, rad) and end velocity
            (m/s, m/s, rad/s), at any velocity at the start.
        decay: part of a use that remains a period later.
        gain: what firing adds to a use.
    """

    effect: Float64
    decay: float
    gain: float

    def added(self, robot: Robot, previous: Int64) -> Float64:
        """(n, a, 6) what earlier actions, (n, s) newest first, add to each action."""
        used = limb_use(robot, previous, self.decay, self.gain)
        return np.asarray(np.einsum("nl,alv->nav", used, self.effect))


def no_history(robot: Robot) -> History:
    """History of limbs that rest before each stroke."""
    return History(np.zeros((len(robot.actions), len(robot.limbs), 6)), 0.0, 0.0)


def limb_use(robot: Robot, previous: Int64, decay: float, gain: float) -> Float64:
    """(n, limbs) use of each limb, 0 to 1, after (n, s) earlier actions, newest first."""
    masks = [action.first_mask | action.second_mask for action in robot.actions]
    fires = np.array([[mask >> limb & 1 for limb in range(len(robot.limbs))] for mask in [*masks, 0]])
    use = np.zeros((len(previous), len(robot.limbs)))
    for place in range(previous.shape[1] - 1, -1, -1):
        use = np.minimum(decay * use + gain * fires[previous[:, place]], 1.0)  # RESTED is the last row
    return use


def fit_history(
    robot: Robot,
    rows: Float64,
    previous: Int64,
    weight: Float64,
    smoothed: Callable[[Float64], Float64],
) -> History:
    """Estimate the effect of use by partial regression, with the effect of velocity removed.

    The predictions of neighbours in velocity are subtracted from transitions and uses; the residuals of the
    first are regressed on those of the second, for each decay and gain, and the best fit is taken (Speckman
    1988, J. R. Stat. Soc. B 50, 413-436).

    Args:
        robot: with the actions.
        rows: (n, a, 6) transitions.
        previous: (n, s) earlier actions.
        weight: (6,) scale of the errors of the six values.
        smoothed: (n, c) values at the states -> the predictions of each state's neighbours without itself.
    """
    if (previous == RESTED).all():
        return no_history(robot)
    left = (rows - smoothed(rows.reshape(len(rows), -1)).reshape(rows.shape)) / weight
    flat = left.reshape(len(rows), -1)
    best, least = no_history(robot), float((flat**2).sum())
    for decay in DECAYS:
        for gain in (1.0, 1.0 - decay) if decay else (1.0,):
            use = limb_use(robot, previous, decay, gain)
            other = use - smoothed(use)
            effect, *_ = np.linalg.lstsq(other, flat, rcond=1e-6)
            rest = float(((flat - other @ effect) ** 2).sum())
            if rest < least * (1.0 - 1e-9):
                shaped = effect.reshape(len(robot.limbs), len(robot.actions), 6).transpose(1, 0, 2)
                best, least = History(shaped * weight, decay, gain), rest
    return best
