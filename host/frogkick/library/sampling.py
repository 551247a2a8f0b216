"""Which initial velocities a library starts from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frogkick.der import Swimmer, prepare
from frogkick.errors import InputError, nearest_name
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

STATES_MAX = 65535  # a table image counts its states in 16 bits
SAMPLINGS = ("box", "visited")

_SWIM_STROKES = 12  # from rest to cruising takes about six
_HOLD_STROKES_MAX = 4  # an action is held for 1 to this many strokes: turns build up over several


def sample_velocities(robot: Robot, states: int, seed: int, sampling: str = "box") -> FloatArray:
    """Draw the initial velocities of a library.

    Args:
        robot: whose box, or whose swimming.
        states: how many, 1 to 65535.
        seed: of the drawing.
        sampling: "box" draws uniformly from the robot's library box, as the paper does. "visited" takes the
            velocities at which the strokes of a randomly steered, simulated robot begin: a run needs the
            states that swimming leads to, and they fill a small part of the box.

    Returns:
        (states, 3) forward, left (m/s) and turn rate (rad/s), body frame.

    Raises:
        InputError: states outside of 1 to 65535, a negative seed, or an unknown sampling.
    """
    if not 1 <= states <= STATES_MAX:
        raise InputError(f"states is {states}: give 1 to {STATES_MAX}")
    if seed < 0:
        raise InputError(f"seed is {seed}: give 0 or more")
    rng = np.random.default_rng(seed)
    if sampling == "visited":
        return _visited(robot, states, rng)
    if sampling != "box":
        raise InputError(
            f"sampling is {sampling!r}{nearest_name(sampling, SAMPLINGS)}: give {' or '.join(SAMPLINGS)}"
        )
    box = robot.library_box
    low, high = np.array([box.forward_mps, box.left_mps, box.omega_rad_s]).T
    return rng.uniform(low, high, size=(states, 3))


def _visited(robot: Robot, states: int, rng: np.random.Generator) -> FloatArray:
    rods = prepare(robot)
    found: dict[tuple[float, ...], None] = {}  # in order, and each velocity once: many swims begin alike
    while len(found) < states:
        swimmer = Swimmer(robot, rods=rods)
        held = 0
        for _ in range(_SWIM_STROKES):
            found[tuple(np.round(swimmer.velocity_body(), 9) + 0.0)] = None
            if held == 0:
                action = robot.actions[rng.integers(len(robot.actions))]
                held = int(rng.integers(1, _HOLD_STROKES_MAX + 1))
            held -= 1
            start_s = swimmer.time_s
            swimmer.fire_mask(action.first_mask, start_s)
            swimmer.fire_mask(action.second_mask, start_s + robot.second_delay_s)
            swimmer.advance(start_s + robot.period_s)
    return np.array(list(found)[:states], dtype=np.float64)
