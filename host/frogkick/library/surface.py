"""A library as smooth functions: of velocity, and of how recently each limb was used.

Of velocity it is a local quadratic regression (LOESS). A limb's use is at most 1: each period leaves a part
of it, ``decay``, and firing adds ``gain``. With a gain of 1 the use depends on the time since the last
stroke, which has not ended yet when the next one begins; with 1 - decay on the frequency of strokes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64, Int64, matmul, solve_positive
from frogkick.core.errors import InputError
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
            normal = matmul(other.T, other)
            diagonal = np.arange(len(normal))
            normal[diagonal, diagonal] += _USE_RIDGE * normal.trace() + 1e-12
            effect = solve_positive(normal, matmul(other.T, flat))
            rest = float(((flat - matmul(other, effect)) ** 2).sum())
            if rest < least * (1.0 - 1e-9):
                shaped = effect.reshape(len(robot.limbs), len(robot.actions), 6).transpose(1, 0, 2)
                best, least = History(shaped * weight, decay, gain), rest
    return best


NEIGHBOURS = 40
"""Neighbours in a local regression: four for each coefficient of a quadratic."""

STATES_MIN = NEIGHBOURS + 1

_AT_ONCE = 1024
_USE_RIDGE = 1e-10  # of the sum of squares: limbs that always fire together share their effect
RIDGES = (1e-3, 1e-9)
"""Ridge penalties, relative to the number of neighbours, in units of their reach. The small one suits rods,
which are smooth. The large one suppresses slopes out of the plane of the neighbours, which would fit noise
where strokes depend on more than the table's variables."""

_WORSE_MOST = 1.1  # the larger ridge is taken up to this factor on squared leave-one-out errors


def noise_of(robot: Robot) -> Float64:
    """(6,) units of the errors of a transition's values: the noise of the position measurement.

    0.2 mm and 0.2 degrees at the period's end, and for velocities what moves the robot as far in a period.
    """
    position_m, heading_rad = 2e-4, np.deg2rad(0.2)
    period = robot.period_s
    return np.array(
        [position_m, position_m, heading_rad] + [position_m / period] * 2 + [heading_rad / period]
    )


@dataclass(frozen=True, eq=False)
class Surface:
    """Transitions of rested limbs at any velocity, and the effect of earlier use.

    A quadratic of the velocity is fitted to the nearest states of each point.

    Attributes:
        codes: (n, 3) velocities of the states, in the robot's velocity resolution.
        values: (n, a * 6) transitions without the effect of earlier use.
        history: effect of earlier use.
        tree: finds neighbours.
        ridge: the one of RIDGES that was chosen.
    """

    codes: Float64
    values: Float64
    history: History
    tree: Any
    ridge: float

    def at(self, codes: Float64) -> Float64:
        """(m, a, 6) transitions from (m, 3) velocities in codes, limbs rested."""
        found = _local(self.tree, self.codes, self.values, codes, self.ridge, skip=0)
        return found.reshape(len(codes), -1, 6)


def fit_surface(robot: Robot, velocities: Float64, rows: Float64, previous: Int64) -> Surface:
    """Fit a library's complete states.

    Args:
        robot: the library's.
        velocities: (n, 3) forward, left (m/s), turn rate (rad/s).
        rows: (n, a, 6) transitions.
        previous: (n, s) earlier actions.

    Raises:
        InputError: the library has fewer than STATES_MIN complete states.
    """
    from scipy.spatial import cKDTree

    if len(velocities) < STATES_MIN:
        raise InputError(
            f"the library has {len(velocities)} complete states to fit, a local regression needs "
            f"{STATES_MIN}: build it with more --states"
        )
    codes = velocities / np.array(robot.velocity_resolution)
    tree, noise = cKDTree(codes), noise_of(robot)
    tried: list[tuple[float, Surface]] = []
    for ridge in RIDGES:

        def smoothed(values: Float64, ridge: float = ridge) -> Float64:
            return _local(tree, codes, values, codes, ridge, skip=1)

        history = fit_history(robot, rows, previous, noise, smoothed)
        rested = (rows - history.added(robot, previous)).reshape(len(rows), -1)
        missed = float((((rested - smoothed(rested)) / np.tile(noise, rows.shape[1])) ** 2).mean())
        tried.append((missed, Surface(codes, rested, history, tree, ridge)))
    least = min(missed for missed, _ in tried)
    return next(surface for missed, surface in tried if missed <= _WORSE_MOST * least)


def _local(tree: Any, codes: Float64, values: Float64, at: Float64, ridge: float, skip: int) -> Float64:
    """(m, c) local quadratics at (m, 3) points from their NEIGHBOURS nearest states, without the ``skip``
    nearest.

    Weights are tricubes of the distance (Cleveland 1979, J. Am. Stat. Assoc. 74, 829-836).
    """
    found = np.empty((len(at), values.shape[1]))
    first, second = np.triu_indices(3)
    for begin in range(0, len(at), _AT_ONCE):
        some = at[begin : begin + _AT_ONCE]
        apart, near = tree.query(some, NEIGHBOURS + skip)
        apart, near = apart[:, skip:], near[:, skip:]
        reach = 1.05 * apart[:, -1:] + 1e-9
        ratio = apart / reach
        near_one = 1.0 - ratio * ratio * ratio
        weight = near_one * near_one * near_one
        offset = (codes[near] - some[:, None]) / reach[:, :, None]
        squares = offset[..., first] * offset[..., second]
        terms = np.concatenate([np.ones((*near.shape, 1)), offset, squares], axis=2)
        weighted = np.swapaxes(terms * weight[:, :, None], 1, 2)
        normal = matmul(weighted, terms)
        normal[:, np.arange(1, 10), np.arange(1, 10)] += ridge * NEIGHBOURS
        found[begin : begin + _AT_ONCE] = solve_positive(normal, matmul(weighted, values[near]))[:, 0]
    return found
