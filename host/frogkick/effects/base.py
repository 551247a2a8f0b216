"""The base class of effects: terms that the nominal model lacks, with named parameters, bounds and units.

The same class serves a robot's file, a world's file and identification. Your own effect overrides the methods
of what it acts on:

    class Whirl(Effect):
        turns_per_s = parameter("1/s", 0.0, 0.2, 0.0)

        def flow(self, time_s, position_world_m):
            x, y = position_world_m
            return -y * self.turns_per_s, x * self.turns_per_s
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import GeneratorType
from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.poses import Fix
from frogkick.robot import Robot

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Attributes:
        name: name in TOML files, with its unit as a suffix if it has one.
        unit: SI unit; "1" for a ratio.
        low, high: bounds, inclusive.
        nominal: value at which the effect vanishes, or is as in the nominal model.
        about: its meaning, in half a line.
        step: finite-difference step, within which its influence is linear; 0: a twentieth of its range.
        grid: increasing further starting values of a fit, because descent may end in a local minimum.
        tolerance: discretisation tolerance, half the width within which simulations cannot distinguish
            values; most parameters have none.
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

    def checked(self, value: object, whose: str) -> float:
        """Return a value for it; ``whose`` begins the error's text.

        Raises:
            InputError: no number, or not within the bounds.
        """
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{whose} {self.name} is {value!r}, needed is a number of unit {self.unit}")
        if not self.low <= value <= self.high:  # false for NaN
            raise InputError(
                f"{whose} {self.name} is {value:g}, allowed is {self.low:g} to "
                + f"{self.high:g} {self.unit}".removesuffix(" 1")
            )
        return float(value)


def parameter(unit: str, low: float, high: float, nominal: float, about: str = "", **more: Any) -> float:
    """Declare a parameter as an attribute of an effect's class, which gives it its name; see Parameter."""
    return cast(float, Parameter("", unit, low, high, nominal, about, **more))


@dataclass(frozen=True)
class Body:
    """State of the robot's body: pose in the world (m, m, rad), velocity in the body frame (m/s, m/s,
    rad/s)."""

    time_s: float
    pose_world: tuple[float, float, float]
    velocity_body: tuple[float, float, float]


@dataclass(slots=True)
class Stroke:
    """A stroke of a limb, of which an effect may change gain, delay and duration.

    Attributes:
        limb: name of the limb; not to be changed.
        index: index of the limb; not to be changed.
        time_s: start of its pulse; not to be changed.
        gain: share of the measured stroke, 0 to 2.
        delay_s: delay of the stroke after its pulse, 0 or more.
        duration_scale: duration of the limb's return over the measured one, 0.1 to 10.
        body: state of the robot when the pulse starts; None if it is not known.
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
    """Earlier strokes, oldest first: (time_s, limb index)."""

    strokes: list[tuple[float, int]] = field(default_factory=list)

    @property
    def pulses(self) -> int:
        """Number of distinct times at which limbs fired."""
        return len({time_s for time_s, _ in self.strokes})

    def since_s(self, index: int, time_s: float) -> float:
        """Return the time since a limb's last stroke; infinite if it has not fired."""
        return min((time_s - then for then, limb in self.strokes if limb == index), default=math.inf)


IN_BODY = ("robot", "stroke", "wrench")
"""Methods that effects on the body override; other effects act on the water or the camera."""


class Effect:
    """A term that the nominal model lacks; override the methods of what it acts on.

    Attributes:
        name: name in TOML files.
        parameters: its parameters; those declared by ``parameter`` are appended, or replace inherited ones of
            the same name.
        options: further keys in TOML files with their defaults (None: the key is required).
        about: the physics, in one line.
        shown_by: data that could show it, in one line.
        joint_only: it can only be identified jointly with other such effects, from many runs.
        uniform: its flow is the same everywhere; it is then evaluated at one place only.
        asks_body: strokes depend on the robot's pose and velocity, so that ``Stroke.body`` is needed.
        stiff: its wrench changes considerably within tens of milliseconds.
    """

    name: ClassVar[str] = ""
    parameters: tuple[Parameter, ...] = ()
    options: ClassVar[dict[str, Any]] = {}
    about: ClassVar[str] = ""
    shown_by: ClassVar[str] = ""
    joint_only: ClassVar[bool] = False
    uniform = asks_body = stiff = False

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        # A Parameter that has a name already is one that the class lists in ``parameters`` itself.
        own = {name: value for name, value in vars(cls).items() if isinstance(value, Parameter)}
        declared = {name: replace(value, name=name) for name, value in own.items() if not value.name}
        if declared:
            cls.parameters = tuple(({each.name: each for each in cls.parameters} | declared).values())

    def __init__(self, **values: Any) -> None:
        """Set parameters and options as attributes.

        Raises:
            InputError: an unknown key, a value outside its bounds, or a missing option.
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
            setattr(self, parameter.name, parameter.checked(value, f"effect {self.title!r}:"))
        for option, default in self.options.items():
            value = values.get(option, default)
            if value is None:
                raise InputError(f"effect {self.title!r} needs {option!r}: give it")
            setattr(self, option, value)

    @property
    def title(self) -> str:
        """Its name, or the name of its class."""
        return self.name or type(self).__name__

    def value(self, parameter: str) -> float:
        """Return the value of a parameter."""
        return float(getattr(self, parameter))

    def check(self, robot: Robot) -> None:
        """Raise an error if this effect does not fit a robot, for example if the robot lacks its limb.

        Raises:
            InputError: it does not fit.
        """

    def starts(self, low_m: Float64, high_m: Float64) -> Sequence[Mapping[str, float]]:
        """Return starting values of a search for this effect, instead of ones that the search spreads.

        Args:
            low_m, high_m: (2,) corners of the area of the runs, world frame.

        Returns:
            For each start the values of the parameters that place the effect, but not of its strength; empty
                if any values will do.
        """
        return ()

    @property
    def in_tables(self) -> bool:
        """Whether a table of transitions can hold it: it acts on the body, and depends on velocities and
        strokes but not on place, heading or time."""
        return any(self.overrides(hook) for hook in IN_BODY)

    def overrides(self, hook: str) -> bool:
        """Return whether it has its own method of a name, such as "flow"."""
        return getattr(type(self), hook) is not getattr(Effect, hook)

    def likeliest(self) -> Effect:
        """Return the effect without randomness, as it most likely acts; predictions use it."""
        return self

    def robot(self, robot: Robot) -> Robot:
        """Return the robot with the body that this effect changes."""
        return robot

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke | None:
        """Change a stroke and return it; None stands for the stroke that was given. A gain of 0 drops it."""
        return stroke

    def flow(self, time_s: float, position_world_m: Float64) -> Sequence[float] | Float64:
        """Return the velocity of the water at a position (2,), world frame, m/s."""
        return (0.0, 0.0)

    def wrench(self, time_s: float, body: Body) -> Sequence[float] | Float64:
        """Return the force (N) forward and left and the torque (N m, counter-clockwise) on the body, body
        frame."""
        return (0.0, 0.0, 0.0)

    def fix(self, fix: Fix, rng: np.random.Generator) -> Fix | None:
        """Change a position fix and return it, or return None to drop it.

        A prediction of a recorded fix keeps it in either case.
        """
        return fix

    def __repr__(self) -> str:
        given = [f"{p.name}={self.value(p.name):g}" for p in self.parameters]
        given += [f"{option}={getattr(self, option)!r}" for option in self.options]
        return f"{self.title}({', '.join(given)})"


def limb_index(robot: Robot, effect: Effect, limb: str) -> int:
    """Return the index of a limb.

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


def call_hook(effect: Effect, hook: str, *given: Any) -> Any:
    """Return what a method of an effect gives.

    Raises:
        InputError: the method is a user's own and fails.
    """
    try:
        found = getattr(effect, hook)(*given)
        return list(found) if isinstance(found, GeneratorType) else found
    except (Exception, SystemExit) as error:
        if isinstance(error, InputError) or type(effect).__module__.startswith("frogkick."):
            raise
        raise InputError(
            f"effect {effect.title!r}: {hook} fails: {type(error).__name__}: {error}; correct its file"
        ) from error


def _of_kind(kind: type[Kind], effect: Effect, hook: str, *given: Any) -> Kind | None:
    found = call_hook(effect, hook, *given)
    if found is None or isinstance(found, kind):
        return found
    raise InputError(f"effect {effect.title!r}: {hook} gave {found!r}, needed is a {kind.__name__} or None")


def robot_by(effect: Effect, robot: Robot) -> Robot:
    """Return the robot as an effect changes it; InputError as by ``call_hook``, or for anything else."""
    return _of_kind(Robot, effect, "robot", robot) or robot


def stroke_by(effect: Effect, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
    """Return a stroke as an effect changes it; InputError as by ``call_hook``, or for anything else."""
    return _of_kind(Stroke, effect, "stroke", stroke, history, rng) or stroke


def fix_by(effect: Effect, fix: Fix, rng: np.random.Generator) -> Fix | None:
    """Return a fix as an effect changes it; InputError as by ``call_hook``, or for anything else."""
    return _of_kind(Fix, effect, "fix", fix, rng)


def starts_by(effect: Effect, low_m: Float64, high_m: Float64) -> list[dict[str, float]]:
    """Return an effect's starting values of a search.

    Raises:
        InputError: see ``call_hook``; or they are not finite values of its parameters.
    """
    found, known = call_hook(effect, "starts", low_m, high_m), [p.name for p in effect.parameters]
    example = known[0] if known else "x_m"
    if not isinstance(found, Sequence) or not all(isinstance(start, Mapping) for start in found):
        raise InputError(
            f"effect {effect.title!r}: starts gave {found!r}, needed is a list of values by parameter, as "
            f"[{{{example!r}: 0.1}}]"
        )
    for name, value in [(name, start[name]) for start in found for name in start]:
        if name not in known:
            raise InputError(
                f"effect {effect.title!r}: starts gave a value of {name!r}{nearest_name(str(name), known)}: "
                f"its parameters are {', '.join(known) or 'none'}"
            )
        if not isinstance(value, int | float) or not abs(float(value)) < math.inf:
            raise InputError(f"effect {effect.title!r}: starts gave {name} = {value!r}, needed is a number")
    return [{name: float(value) for name, value in start.items()} for start in found]


def numbers_by(effect: Effect, hook: str, count: int, *given: Any) -> Sequence[float]:
    """Return the numbers of a flow or a wrench; (fx, fy, torque) and ((fx, fy), torque) are equal.

    Raises:
        InputError: see ``call_hook``; or they are not ``count`` finite numbers.
    """
    found = call_hook(effect, hook, *given)
    if isinstance(found, tuple | list) and len(found) == count:
        plain: Sequence[float] = found
        if all(type(value) is float and math.isfinite(value) for value in plain):
            return plain
    try:
        flat = np.concatenate([np.ravel(np.asarray(part, dtype=np.float64)) for part in found])
    except (TypeError, ValueError):
        flat = np.empty(0)
    if flat.shape != (count,) or not np.isfinite(flat).all():
        raise InputError(f"effect {effect.title!r}: {hook} gave {found!r}, needed are {count} finite numbers")
    numbers: list[float] = flat.tolist()
    return numbers
