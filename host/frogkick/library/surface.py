"""A library as smooth functions of velocity: what any action does from any state, with local regression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from frogkick.errors import InputError
from frogkick.library.history import History, fit_history
from frogkick.library.transitions import IntArray
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

NEIGHBOURS = 40
"""States that a value is fitted to: four for each coefficient of a quadratic."""

STATES_MIN = NEIGHBOURS + 1

_AT_ONCE = 1024
_RIDGE = 1e-9  # for neighbours in a plane or on a line; relative to their number, in units of their reach


def noise_of(robot: Robot) -> FloatArray:
    """(6,) what errors of a transition's values are counted in: the position measurement's noise.

    0.2 mm and 0.2 degrees at the period's end, and for velocities what moves the robot as far in a period.
    """
    position_m, heading_rad = 2e-4, np.deg2rad(0.2)
    period = robot.period_s
    return np.array(
        [position_m, position_m, heading_rad] + [position_m / period] * 2 + [heading_rad / period]
    )


@dataclass(frozen=True, eq=False)
class Surface:
    """Transitions of rested limbs anywhere between a library's states, and what earlier use adds.

    Around each point a quadratic of the velocity is fitted to the nearest states, the nearer the heavier.

    Attributes:
        robot: whose.
        codes: (n, 3) velocities of the states, in the robot's velocity resolution.
        values: (n, a * 6) transitions without what earlier use added.
        history: what that was.
        tree: finds neighbours.
    """

    robot: Robot
    codes: FloatArray
    values: FloatArray
    history: History
    tree: Any

    def at(self, codes: FloatArray) -> FloatArray:
        """(m, a, 6) transitions from (m, 3) velocities in codes, limbs rested."""
        found = _local(self.tree, self.codes, self.values, codes, skip=0)
        return found.reshape(len(codes), -1, 6)

    def predicted(self, codes: FloatArray, previous: IntArray) -> FloatArray:
        """(m, a, 6) transitions from (m, 3) velocities in codes after (m, s) earlier actions."""
        return self.at(codes) + self.history.added(self.robot, previous)


def fit_surface(robot: Robot, velocities: FloatArray, rows: FloatArray, previous: IntArray) -> Surface:
    """Fit a library's whole states.

    Args:
        robot: the library's.
        velocities: (n, 3) forward, left (m/s), turn rate (rad/s).
        rows: (n, a, 6) transitions.
        previous: (n, s) earlier actions.

    Raises:
        InputError: too few states.
    """
    if len(velocities) < STATES_MIN:
        raise InputError(
            f"the library has {len(velocities)} whole states to fit, a local regression needs {STATES_MIN}: "
            "build it with more --states"
        )
    codes = velocities / np.array(robot.velocity_resolution)
    tree = cKDTree(codes)
    history = fit_history(
        robot, rows, previous, noise_of(robot), lambda values: _local(tree, codes, values, codes, skip=1)
    )
    rested = rows - history.added(robot, previous)
    return Surface(robot, codes, rested.reshape(len(rows), -1), history, tree)


def _local(tree: Any, codes: FloatArray, values: FloatArray, at: FloatArray, skip: int) -> FloatArray:
    """(m, c) quadratics through the NEIGHBOURS nearest states of (m, 3) points, but for the ``skip`` nearest.

    Weights are tricubes of the distance (Cleveland 1979, J. Am. Stat. Assoc. 74, 829-836).
    """
    found = np.empty((len(at), values.shape[1]))
    first, second = np.triu_indices(3)
    for begin in range(0, len(at), _AT_ONCE):
        some = at[begin : begin + _AT_ONCE]
        apart, near = tree.query(some, NEIGHBOURS + skip)
        apart, near = apart[:, skip:], near[:, skip:]
        reach = 1.05 * apart[:, -1:] + 1e-9
        weight = (1.0 - (apart / reach) ** 3) ** 3
        offset = (codes[near] - some[:, None]) / reach[:, :, None]
        squares = offset[..., first] * offset[..., second]
        terms = np.concatenate([np.ones((*near.shape, 1)), offset, squares], axis=2)
        weighted = np.swapaxes(terms * weight[:, :, None], 1, 2)
        normal = weighted @ terms
        normal[:, np.arange(1, 10), np.arange(1, 10)] += _RIDGE * NEIGHBOURS
        found[begin : begin + _AT_ONCE] = np.linalg.solve(normal, weighted @ values[near])[:, 0]
    return found
