"""What an effect is: a term that the nominal model lacks, with parameters that have names, bounds and units.

The same class serves three uses: a robot's file adds it to the model, a world's file adds it to the simulated
pool, and identification takes it as a candidate. A user writes one by overriding what it acts on:

    class Whirl(Effect):
        parameters = (Parameter("turns_per_s", "1/s", 0.0, 0.2, 0.0),)

        def flow(self, time_s, position_world_m):
            x, y = position_world_m
            return -y * self.turns_per_s, x * self.turns_per_s
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError, nearest_name
from frogkick.core.poses import Fix
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Attributes:
        name: as in the TOML, with its unit as suffix where it has one.
        unit: SI; "1" for a share.
        low, high: bounds, inclusive.
        nominal: value at which the effect vanishes, or is as in the nominal model.
        about: what it means, in half a line.
        step: finite-difference step, within which its influence is linear; 0: a twentieth of its range.
        grid: increasing values that a fit starts from as well: descent may end in a local minimum.
        tolerance: discretisation tolerance, half the width within which simulations cannot tell values apart;
            most have none.
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float
    about: str = ""
    step: float = 0.0
    grid: tuple[float, ...] = ()
    tolerance: float = 0.0


@dataclass(frozen=True)
class Body:
    """The robot's body: pose in the world (m, m, rad), velocity in its own frame (m/s, m/s, rad/s)."""

    time_s: float
    pose_world: tuple[float, float, float]
    velocity_body: tuple[float, float, float]


@dataclass
class Stroke:
    """A limb fires: what an effect may change.

    Attributes:
        limb: name of the limb.
        index: its bit.
        time_s: when its pulse starts.
        gain: share of the measured stroke, 0 to 2.
        delay_s: how much later than its pulse it starts, 0 or more.
        duration_scale: how many times as long as measured it takes to curl back, 0.1 to 10.
        body: the robot when it was told to fire; None where that is not known.
    """

    limb: str
    index: int
    time_s: float
    gain: float = 1.0
    delay_s: float = 0.0
    duration_scale: float = 1.0
    body: Body | None = None


@dataclass
class History:
    """The strokes before this one, oldest first: (time_s, limb index)."""

    strokes: list[tuple[float, int]] = field(default_factory=list)

    @property
    def pulses(self) -> int:
        """Different times at which limbs were fired."""
        return len({time_s for time_s, _ in self.strokes})

    def since_s(self, index: int, time_s: float) -> float:
        """How long ago a limb fired last; infinite where it did not."""
        return min((time_s - then for then, limb in self.strokes if limb == index), default=math.inf)


class Effect:
    """A term that the nominal model lacks; override what it acts on.

    Attributes:
        name: what a TOML calls it.
        parameters: its numbers.
        options: other keys that a TOML may or must give, with their default (None: must be given).
        about: the physics, in a line.
        shown_by: which data could show it, in a line.
        joint_only: it can only be identified jointly with others of its kind, from many runs.
    """

    name: ClassVar[str] = ""
    parameters: tuple[Parameter, ...] = ()
    options: ClassVar[dict[str, Any]] = {}
    about: ClassVar[str] = ""
    shown_by: ClassVar[str] = ""
    joint_only: ClassVar[bool] = False

    def __init__(self, **values: Any) -> None:
        """Set parameters and options as attributes.

        Raises:
            InputError: an unknown key, a value out of its bounds, an option that must be given.
        """
        known = {parameter.name for parameter in self.parameters} | set(self.options)
        for key in values:
            if key not in known:
                raise InputError(
                    f"effect {self.title!r} has no parameter {key!r}{nearest_name(key, known)}: "
                    f"it has {', '.join(sorted(known)) or 'none'}"
                )
        for parameter in self.parameters:
            value = values.get(parameter.name, parameter.nominal)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(
                    f"effect {self.title!r}: {parameter.name} is {value!r}, needed is a number of unit "
                    f"{parameter.unit}"
                )
            if not parameter.low <= value <= parameter.high:  # false for NaN
                raise InputError(
                    f"effect {self.title!r}: {parameter.name} is {value:g}, allowed is {parameter.low:g} to "
                    + f"{parameter.high:g} {parameter.unit}".removesuffix(" 1")
                )
            setattr(self, parameter.name, float(value))
        for option, default in self.options.items():
            value = values.get(option, default)
            if value is None:
                raise InputError(f"effect {self.title!r} needs {option!r}: give it")
            setattr(self, option, value)

    @property
    def asks_body(self) -> bool:
        """Whether strokes depend on the robot's pose and velocity: ``Stroke.body`` is then
        given."""
        return False

    @property
    def stiff(self) -> bool:
        """Whether its wrench changes much within tens of milliseconds."""
        return False

    @property
    def title(self) -> str:
        """Its name, or its class's where it has none."""
        return self.name or type(self).__name__

    def value(self, parameter: str) -> float:
        """A parameter's value."""
        return float(getattr(self, parameter))

    def check(self, robot: Robot) -> None:
        """Refuse a robot that this effect cannot be on (no such limb).

        Raises:
            InputError: it names the right ones.
        """

    def starts(self, low_m: FloatArray, high_m: FloatArray) -> Sequence[Mapping[str, float]]:
        """Values at which a search for this effect starts, instead of ones spread by the search.

        Args:
            low_m, high_m: (2,) corners of the area of the runs, world frame.

        Returns:
            For each start the values of the parameters that place the effect (not of its strength); empty
            where any values do.
        """
        return ()

    def on_average(self) -> Effect:
        """The effect without its chance: what it does on average. Predictions are made with it."""
        return self

    def robot(self, robot: Robot) -> Robot:
        """The robot changed by this effect: another body, not another force."""
        return robot

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke | None:
        """A limb fires: change ``stroke`` and return it."""
        return stroke

    def flow(self, time_s: float, position_world_m: FloatArray) -> Sequence[float] | FloatArray:
        """Velocity of the water at a place (2,), world frame, m/s."""
        return (0.0, 0.0)

    def wrench(self, time_s: float, body: Body) -> Sequence[float] | FloatArray:
        """Extra force (N) forward and left and torque (N m, counter-clockwise) on the body, body frame."""
        return (0.0, 0.0, 0.0)

    def fix(self, fix: Fix, rng: np.random.Generator) -> Fix | None:
        """A position fix: change it and return it, or return None to drop it."""
        return fix

    def __repr__(self) -> str:
        given = [f"{p.name}={self.value(p.name):g}" for p in self.parameters]
        given += [f"{option}={getattr(self, option)!r}" for option in self.options]
        return f"{self.title}({', '.join(given)})"


def limb_index(robot: Robot, effect: Effect, limb: str) -> int:
    """The bit of a limb.

    Raises:
        InputError: the robot has no such limb.
    """
    names = [each.name for each in robot.limbs]
    if limb not in names:
        raise InputError(
            f"effect {effect.title!r}: robot {robot.id!r} has no limb {limb!r}"
            f"{nearest_name(str(limb), names)}: it has {', '.join(names)}"
        )
    return names.index(limb)
