"""Sampling of the states at the start of a library's transitions: from a box, or visited by swims."""

from __future__ import annotations

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError, nearest_name
from frogkick.library.planned import planned_swims
from frogkick.library.starts import Starts, VisitedStates, random_swims, rigid_starts
from frogkick.robot import Robot, mirror_of

STATES_MAX = 65535  # a table image counts its states in 16 bits
SAMPLINGS = ("box", "visited", "planned")

_PLANNED_BATCHES_MAX = 1000


def sample_starts(
    robot: Robot,
    states: int,
    seed: int,
    sampling: str = "box",
    workers: int = 1,
    cluster: str | None = None,
) -> Starts:
    """Draw the states of a library.

    Args:
        robot: the robot.
        states: number of states, 1 to 65535.
        seed: of the sampling.
        sampling: "box" draws velocities uniformly from the robot's library box with all limbs at rest, as the
            paper does. "visited" takes the states at the start of the strokes of random swims, which fill a
            small part of the box and contain the limbs' last strokes. "planned" lets the planner steer along
            random paths; a quarter of its states are visited ones. Each state is followed by its mirror
            image if the robot is symmetric. A smaller number of visited states gives the first of them.
        workers, cluster: for planned swims; see frogkick.core.chunks. They do not change the states.

    Raises:
        InputError: states outside of 1 to 65535, a negative seed, an unknown sampling, or planned swims with
            too few states.
        ConvergenceError: a planned swim could not be simulated.
    """
    if not isinstance(states, int | np.integer) or not 1 <= states <= STATES_MAX:
        raise InputError(f"states is {states!r}: give 1 to {STATES_MAX}, a whole number")
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed is {seed!r}: give 0 or more, a whole number")
    if sampling == "box":
        return rigid_starts(robot, box_velocities(robot, states, seed))
    visited = VisitedStates(robot)
    if sampling == "visited":
        visited.add(random_swims(robot, seed), states)
        return visited.starts()
    if sampling == "planned":
        visited.add(random_swims(robot, seed), max(1, states // 4))
        for number, swims in enumerate(planned_swims(robot, seed, workers, cluster)):
            visited.add(swims, states)
            if len(visited) == states:
                return visited.starts()
            if number == _PLANNED_BATCHES_MAX:
                raise InputError(
                    f"planned swims of {robot.id!r} visited {len(visited)} different states, wanted are "
                    f"{states}: give fewer --states, or --sampling visited"
                )
    raise InputError(
        f"sampling is {sampling!r}{nearest_name(sampling, SAMPLINGS)}: give {', '.join(SAMPLINGS)}"
    )


def box_velocities(robot: Robot, states: int, seed: int) -> Float64:
    """(states, 3) forward, left (m/s) and turn rate (rad/s), uniform in the library box, in mirror pairs."""
    box = robot.library_box
    low, high = np.array([box.forward_mps, box.left_mps, box.omega_rad_s]).T
    drawn = np.random.default_rng(seed).uniform(low, high, size=(states, 3))
    if mirror_of(robot) is None:
        return drawn
    pairs = np.stack([drawn, drawn * [1.0, -1.0, -1.0]], axis=1) + 0.0
    kept = np.ones((len(drawn), 2), dtype=bool)
    kept[:, 1] = (drawn[:, 1:] != 0.0).any(axis=1)
    return np.asarray(pairs[kept][:states])
