"""The simulation of a robot alone: a sequence of actions, or a cyclic gait."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path

import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.errors import ConvergenceError, InputError
from frogkick.der import Failure
from frogkick.effects.swims import Gait, Trajectory, simulate_actions, simulate_gaits
from frogkick.robot import Action, Robot, load_robot

SPEED_MAX_MPS = 10.0
"""No small swimmer is faster: a greater number is of another unit."""

_UNORDERED = (Set, Mapping)


@typed
def simulate(
    robot: Robot | Path | str,
    actions: str | Sequence[str] | None = None,
    *,
    velocity_body: Sequence[float] = (0.0, 0.0, 0.0),
    egain_percent: float | None = None,
    frequency_hz: float | None = None,
    phase: float = 0.5,
    cycles: int = 8,
) -> Trajectory:
    """Simulate a sequence of actions, one each period, or without actions the cyclic gait.

    The robot starts at the world's origin, heading along +x. Effects of the robot's file act on its strokes
    and its body, as in a library. Flows of the water do not act, because the position in them is unknown.

    Args:
        robot: the robot, its name or its TOML file.
        actions: names, such as ``"BBC"``, ``"B,B,C"`` or a sequence; None: the gait.
        velocity_body: forward, left (m/s), turn rate (rad/s) at the start of the actions.
        egain_percent: EGaIn fraction of the profile of a gait, %; None: the robot's own.
        frequency_hz: strokes per second of a gait; None: the robot's own.
        phase: lag of the rear limbs as a fraction of the cycle of a gait, 0 <= phase < 1.
        cycles: number of cycles of a gait.

    Raises:
        InputError: an unknown action, a profile outside the measured range, or a value that is no number.
        ConvergenceError: the simulation failed; the text gives the state.
    """
    robot = load_robot(robot)
    for name, value in (("egain_percent", egain_percent), ("frequency_hz", frequency_hz), ("phase", phase)):
        if not isinstance(value, int | float | np.number) and (value is not None or name == "phase"):
            raise InputError(f"{name} is {value!r}: give a number")
    if not isinstance(cycles, int | np.integer) or cycles < 1:
        raise InputError(f"cycles is {cycles!r}: give 1 or more, a whole number")
    if actions is None:
        gait = Gait(
            robot.egain_percent if egain_percent is None else egain_percent,
            robot.profile_frequency_hz if frequency_hz is None else frequency_hz,
            phase,
        )
        (swum,) = simulate_gaits(robot, [gait], cycles, width=1)
        if isinstance(swum, Failure):
            raise ConvergenceError(f"rods of {robot.id!r} {swum}")
        return swum
    if egain_percent is not None or frequency_hz is not None:
        raise InputError(
            "actions use the robot's own profile: leave egain_percent and frequency_hz out, or the actions"
        )
    start = _velocity(velocity_body)
    return simulate_actions(robot, actions_of(robot, actions), start)


def _velocity(given: Sequence[float]) -> list[float]:
    """Velocity at the start."""
    try:
        forward, left, turn = (float(number) for number in ([] if isinstance(given, _UNORDERED) else given))
    except (TypeError, ValueError):
        forward = left = turn = math.nan
    if not (max(abs(forward), abs(left)) <= SPEED_MAX_MPS and math.isfinite(turn)):
        raise InputError(
            f"velocity at the start is {given!r}: give forward and left in m/s, up to {SPEED_MAX_MPS:g}, "
            "and the turn rate in rad/s"
        )
    return [forward, left, turn]


def actions_of(robot: Robot, actions: str | Sequence[str]) -> list[Action]:
    """Return actions by their names: in one text with commas (single letters need none), or a sequence."""
    if isinstance(actions, str):
        names = [name.strip() for name in actions.split(",")]
        known = {action.name.upper() for action in robot.actions}
        letters = {name for name in known if len(name) == 1}
        if (
            len(names) == 1
            and names[0].upper() not in known
            and (letters == known or letters.issuperset(names[0].upper()))
        ):
            names = list(names[0])
    elif isinstance(actions, Iterable) and not isinstance(actions, _UNORDERED):
        names = list(actions)
    else:
        raise InputError(f"actions is {actions!r}: give names, as 'B,B,C' or ['B', 'B', 'C']")
    names = [name for name in names if name]
    if not names:
        raise InputError("actions is empty: name at least one action, such as B,B,C")
    return [robot.action(name) for name in names]
