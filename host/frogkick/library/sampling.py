"""Which initial velocities a library starts from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frogkick.der import STEP_S, WIDTH, prepare, program_of
from frogkick.der.swimmer import batch_of
from frogkick.errors import ConvergenceError, InputError, nearest_name
from frogkick.library.planned import planned_swims
from frogkick.robot import Action, Robot, mirror_of

FloatArray = NDArray[np.float64]

STATES_MAX = 65535  # a table image counts its states in 16 bits
SAMPLINGS = ("box", "visited", "planned")

_SWIM_STROKES = 12  # from rest to cruising takes about six
_PLANNED_BATCHES_MAX = 1000
_HOLD_STROKES_MAX = 4  # an action is held for 1 to this many strokes: turns build up over several


def sample_velocities(robot: Robot, states: int, seed: int, sampling: str = "box") -> FloatArray:
    """Draw the initial velocities of a library.

    Args:
        robot: whose box, or whose swimming.
        states: how many, 1 to 65535.
        seed: of the drawing.
        sampling: "box" draws uniformly from the robot's library box, as the paper does. "visited" takes the
            velocities at which the strokes of a randomly steered, simulated robot begin: a run needs the
            states that swimming leads to, and they fill a small part of the box. "planned" lets the planner
            steer along random paths instead; a quarter of its states are visited ones. Each velocity is
            followed by its mirror image, for a robot that has one: simulating one of them serves both.

    Returns:
        (states, 3) forward, left (m/s) and turn rate (rad/s), body frame.

    Raises:
        InputError: states outside of 1 to 65535, a negative seed, or an unknown sampling.
        ConvergenceError: a steered swim could not be simulated.
    """
    if not 1 <= states <= STATES_MAX:
        raise InputError(f"states is {states}: give 1 to {STATES_MAX}")
    if seed < 0:
        raise InputError(f"seed is {seed}: give 0 or more")
    if sampling == "visited":
        return _visited(robot, states, seed)
    if sampling == "planned":
        return _planned(robot, states, seed)
    if sampling != "box":
        raise InputError(
            f"sampling is {sampling!r}{nearest_name(sampling, SAMPLINGS)}: give {', '.join(SAMPLINGS)}"
        )
    box = robot.library_box
    low, high = np.array([box.forward_mps, box.left_mps, box.omega_rad_s]).T
    drawn = np.random.default_rng(seed).uniform(low, high, size=(states, 3))
    return _with_mirror_images(robot, drawn)[:states]


def _with_mirror_images(robot: Robot, velocities: FloatArray) -> FloatArray:
    """Each velocity, followed by its mirror image if the robot has one and it is another velocity."""
    if mirror_of(robot) is None:
        return velocities
    pairs = np.stack([velocities, velocities * [1.0, -1.0, -1.0]], axis=1) + 0.0
    kept = np.ones((len(velocities), 2), dtype=bool)
    kept[:, 1] = (velocities[:, 1:] != 0.0).any(axis=1)
    return pairs[kept]


def _visited(robot: Robot, states: int, seed: int) -> FloatArray:
    """Velocities of simulated swims, several side by side, each steered by a generator of its own."""
    rods = prepare(robot)
    found: dict[tuple[float, ...], None] = {}  # in order, and each velocity once: many swims begin alike
    swims = 0
    while len(found) < states:
        still = np.zeros((WIDTH, 3))
        batch = batch_of([rods] * WIDTH, still, still, 0.0, STEP_S, WIDTH)
        steered = [_steered(robot, np.random.default_rng([seed, swims + lane])) for lane in range(WIDTH)]
        swims += WIDTH
        begun: list[FloatArray] = []
        for stroke in range(_SWIM_STROKES):
            begun.append(np.round(batch.velocity_body(), 9) + 0.0)
            for lane, actions in enumerate(steered):
                for start, mask in program_of(robot, actions[stroke], stroke * robot.period_s):
                    for limb in range(len(robot.limbs)):
                        if mask >> limb & 1:
                            batch.fire(lane, limb, start)
            batch.advance((stroke + 1) * robot.period_s)
        if batch.failures:
            lane, failure = next(iter(batch.failures.items()))
            raise ConvergenceError(f"a steered swim of {robot.id!r} {failure} (lane {lane})")
        for row in _with_mirror_images(robot, np.concatenate(np.stack(begun, axis=1))).tolist():
            found[tuple(row)] = None
    return np.array(list(found)[:states], dtype=np.float64)


def _steered(robot: Robot, rng: np.random.Generator) -> list[Action]:
    """Random actions of one swim, each held for a few strokes."""
    actions: list[Action] = []
    while len(actions) < _SWIM_STROKES:
        action = robot.actions[rng.integers(len(robot.actions))]
        actions += [action] * int(rng.integers(1, _HOLD_STROKES_MAX + 1))
    return actions


def _planned(robot: Robot, states: int, seed: int) -> FloatArray:
    """A quarter of visited velocities, then those at the decisions of planned swims."""
    first = _visited(robot, max(states, 4), seed)
    found: dict[tuple[float, ...], None] = dict.fromkeys(map(tuple, first[: states // 4].tolist()))
    for number, met in enumerate(planned_swims(robot, seed, first)):
        found |= dict.fromkeys(map(tuple, _with_mirror_images(robot, np.round(met, 9) + 0.0).tolist()))
        if len(found) >= states:
            break
        if number == _PLANNED_BATCHES_MAX:
            raise InputError(
                f"planned swims of {robot.id!r} met {len(found)} different states, asked for are {states}: "
                "give fewer --states, or --sampling visited"
            )
    return np.array(list(found)[:states], dtype=np.float64)
