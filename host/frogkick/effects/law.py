"""A law: an effect that is a formula, written by hand or found by identification.

    [[effect]]
    name = "law"
    on = "wrench"
    x_n = "-stiffness * max(0, x_m - slack_x)"
    [effect.parameters]
    stiffness = { value = 0.05, unit = "N/m", low = 0.0, high = 1.0 }
    slack_x = { value = 0.3, unit = "m" }

``formula`` describes the language, CHANNELS the results of formulas, and NAMES the variables that they use.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.poses import Fix, rotate
from frogkick.effects.base import Body, Effect, History, Parameter, Stroke, limb_index
from frogkick.effects.formula import Formula, Unit, parse, unit_of
from frogkick.effects.limbs import ALL
from frogkick.robot import Robot

CHANNELS: Mapping[str, Mapping[str, str]] = {
    "wrench": {"forward_n": "N", "left_n": "N", "x_n": "N", "y_n": "N", "torque_nm": "N m"},
    "flow": {"x_mps": "m/s", "y_mps": "m/s"},
    "stroke": {"gain": "1", "delay_s": "s", "duration_scale": "1"},
    "fix": {"x_m": "m", "y_m": "m", "heading_rad": "rad", "delay_s": "s"},
}
"""What a law acts on -> the keys that may hold a formula, and the units of their results.

``wrench``: a force on the body, along its own axes or the pool's, and a torque. ``flow``: the water's
velocity at a position. ``stroke``: a factor on the stroke, its delay, a factor on its duration. ``fix``:
additions to a position fix, and its age beyond the capture time."""

_PLACE = {"time_s": "s", "x_m": "m", "y_m": "m"}
_POSE = {**_PLACE, "heading_rad": "rad"}
_BODY = {**_POSE, "forward_mps": "m/s", "left_mps": "m/s", "turn_radps": "rad/s"}
NAMES: Mapping[str, Mapping[str, str]] = {
    "wrench": _BODY,
    "flow": _PLACE,
    "stroke": {**_BODY, "strokes": "1", "since_s": "s", "chance": "1"},
    "fix": {**_POSE, "chance": "1"},
}
"""What a law acts on -> the names that its formulas may use besides its parameters, and their units.

``time_s`` counts from the start of the run. ``chance`` is a random number from 0 to 1, drawn for each stroke
or fix. For a stroke, ``strokes`` is the number of earlier pulses, ``since_s`` the time since the last stroke
of the same limb, and ``since_LIMB_s`` the time since the last stroke of another limb."""

NOT_IN_TABLES = (*_POSE, "strokes")
"""Names that no table of transitions contains: a law that uses one of them is left out of libraries."""

LONG_AGO_S = 1e3
"""Time since the last stroke of a limb that has not fired yet."""

_KEYS = ("value", "unit", "low", "high", "nominal", "about", "step", "tolerance")


class Law(Effect):
    """An effect that is a formula.

    Attributes:
        formulas: text of each formula, by the names of CHANNELS.
        names: the variables and parameters that the formulas use.
        by_chance: whether the formulas depend on chance.
    """

    name = "law"
    about = "a formula for a force, a flow, a stroke or a fix"
    shown_by = "whatever its formula depends on: record runs in which that varies"

    def __init__(
        self,
        on: str = "wrench",
        limb: str = ALL,
        title: str = "law",
        parameters: Mapping[str, Mapping[str, Any]] | None = None,
        **values: Any,
    ) -> None:
        """Make a law.

        Args:
            on: a key of CHANNELS.
            limb: limb whose strokes it changes, if it acts on strokes.
            title: name in reports.
            parameters: name -> ``value``, ``unit``, and for a fit ``low``, ``high``, ``nominal`` (where the
                law vanishes; default 0 if that is within the bounds).
            values: formulas by the keys of CHANNELS; and values of parameters, instead of those above.

        Raises:
            InputError: an unknown key or name, an invalid formula, or a unit that does not fit.
        """
        if not isinstance(on, str) or on not in CHANNELS:
            raise InputError(f"a law on {on!r}{nearest_name(str(on), CHANNELS)}: give {', '.join(CHANNELS)}")
        self.on, self.limb, self._title = on, limb, str(title)
        declared = {} if parameters is None else parameters
        if not isinstance(declared, Mapping) or not all(isinstance(p, Mapping) for p in declared.values()):
            raise InputError(
                f"a law's parameters are {declared!r}: give each a value and a unit, as "
                "{ drag = { value = 0.04, unit = 'N s/m' } }"
            )
        self.parameters = tuple(_parameter(name, given) for name, given in declared.items())
        units = {p.name: unit_of(p.unit) for p in self.parameters}
        known = {name: unit_of(unit) for name, unit in NAMES[on].items()}
        clash = sorted(set(units) & {*known, *CHANNELS[on], "on", "limb", "title", "parameters", "name"})
        if clash:
            raise InputError(f"a law's parameter {clash[0]!r} is a name that is taken: choose another")
        formulas = {key: values.pop(key) for key in CHANNELS[on] if key in values}
        for key in values:
            if key not in units:
                allowed = [*CHANNELS[on], *units]
                raise InputError(
                    f"a law on {on!r} has no {key!r}{nearest_name(key, allowed)}: it has {', '.join(allowed)}"
                )
        if not formulas:
            raise InputError(f"a law on {on!r} has no formula: give one of {', '.join(CHANNELS[on])}")
        for parameter in self.parameters:
            value = values.get(parameter.name, declared[parameter.name].get("value", parameter.nominal))
            setattr(self, parameter.name, parameter.checked(value, "a law's"))
        self.formulas = {key: str(text) for key, text in formulas.items()}
        known |= units
        self._formulas = {
            key: _parsed(key, text, dict(known), unit_of(CHANNELS[on][key]))
            for key, text in self.formulas.items()
        }
        self.names = frozenset().union(*(formula.names for formula in self._formulas.values()))
        self._others = sorted(self.names - set(known))
        self.uniform = not self.names & {"x_m", "y_m"}
        self.asks_body = on == "stroke" and bool(self.names & (set(_BODY) - {"time_s"}))
        self.by_chance = "chance" in self.names
        self._given = {p.name: self.value(p.name) for p in self.parameters}
        self._limbs: dict[str, int] = {}
        self._drawn = True

    @property
    def title(self) -> str:
        """Its name in reports."""
        return self._title

    @property
    def table(self) -> dict[str, Any]:
        """Its keys as an ``[[effect]]`` table, with values and bounds of its parameters."""
        bounds = {p.name: {"unit": p.unit, "low": p.low, "high": p.high} for p in self.parameters}
        declared = {name: {"value": self.value(name), **each} for name, each in bounds.items()}
        limb = {"limb": self.limb} if self.on == "stroke" else {}
        named = {"title": self._title} if self._title != "law" else {}
        return {"name": "law", **named, "on": self.on, **limb, **self.formulas, "parameters": declared}

    @property
    def in_tables(self) -> bool:
        return self.on in ("wrench", "stroke") and not self.names & set(NOT_IN_TABLES)

    def overrides(self, hook: str) -> bool:
        return hook == self.on if hook in CHANNELS else super().overrides(hook)

    def likeliest(self) -> Effect:
        if not self.by_chance:
            return self
        twin = copy.copy(self)
        twin._drawn = False
        return twin

    def check(self, robot: Robot) -> None:
        if self.on == "stroke" and self.limb != ALL:
            limb_index(robot, self, self.limb)
        self._limbs = {f"since_{limb.name}_s": k for k, limb in enumerate(robot.limbs)}
        for name in self._others:
            if name not in self._limbs:
                limb_index(robot, self, name.removeprefix("since_").removesuffix("_s"))

    def _all(self, values: Mapping[str, float], keys: Sequence[str]) -> list[float]:
        """Return the values of the formulas of these keys, 0 for those without one."""
        return [self._formulas[key](values) if key in self._formulas else 0.0 for key in keys]

    def _chance(self, rng: np.random.Generator) -> float:
        """Return a random number from 0 to 1; of ``likeliest`` always the median."""
        return float(rng.random()) if self.by_chance and self._drawn else 0.5

    def over(self, values: Mapping[str, Float64 | float]) -> dict[str, Float64]:
        """Return the results of the formulas for arrays of the names that they use, and of parameters if
        given."""
        given = {**self._given, **values}
        return {key: formula.over(given) for key, formula in self._formulas.items()}

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        given = {**self._given, **_seen(body), "time_s": time_s}
        forward, left, x, y, torque = self._all(given, ("forward_n", "left_n", "x_n", "y_n", "torque_nm"))
        along, aside = rotate(-body.pose_world[2], x, y)
        return (forward + along, left + aside, torque)

    def flow(self, time_s: float, position_world_m: Float64) -> Sequence[float]:
        x, y = float(position_world_m[0]), float(position_world_m[1])
        return self._all({**self._given, "time_s": time_s, "x_m": x, "y_m": y}, ("x_mps", "y_mps"))

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if self.on != "stroke" or self.limb not in (ALL, stroke.limb):
            return stroke
        body = stroke.body or Body(stroke.time_s, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        values = {
            **self._given, **_seen(body), "time_s": stroke.time_s, "strokes": float(history.pulses),
            "since_s": min(history.since_s(stroke.index, stroke.time_s), LONG_AGO_S),
            "chance": self._chance(rng),
        }  # fmt: skip
        for name in self._others:
            if name not in self._limbs:
                raise InputError(
                    f"law {self.title!r} does not know which limb {name!r} means: check(robot) first"
                )
            values[name] = min(history.since_s(self._limbs[name], stroke.time_s), LONG_AGO_S)
        given = dict(zip(self._formulas, self._all(values, list(self._formulas)), strict=True))
        stroke.gain *= given.get("gain", 1.0)
        stroke.delay_s += given.get("delay_s", 0.0)
        stroke.duration_scale *= given.get("duration_scale", 1.0)
        return stroke

    def fix(self, fix: Fix, rng: np.random.Generator) -> Fix:
        if self.on != "fix":
            return fix
        values = {
            **self._given, "time_s": fix.capture_s, "x_m": fix.x_m, "y_m": fix.y_m,
            "heading_rad": fix.heading_rad, "chance": self._chance(rng),
        }  # fmt: skip
        x, y, heading, delay = self._all(values, ("x_m", "y_m", "heading_rad", "delay_s"))
        fix.x_m += x
        fix.y_m += y
        fix.heading_rad += heading
        fix.capture_s += delay
        fix.delay_s -= delay
        return fix

    def __repr__(self) -> str:
        formulas = [f"{key}={text!r}" for key, text in self.formulas.items()]
        return f"Law({self.on}: {', '.join([*formulas, *(f'{k}={v:g}' for k, v in self._given.items())])})"


def _seen(body: Body) -> dict[str, float]:
    x, y, heading = body.pose_world
    forward, left, turn = body.velocity_body
    return {
        "x_m": x, "y_m": y, "heading_rad": heading,
        "forward_mps": forward, "left_mps": left, "turn_radps": turn,
    }  # fmt: skip


def _parsed(key: str, text: str, units: dict[str, Unit], wanted: Unit) -> Formula:
    """Return a checked formula; names ``since_LIMB_s`` are known for strokes of any robot."""
    if "since_s" in units:
        for name in re.findall(r"\bsince_\w+_s\b", text):
            units.setdefault(name, unit_of("s"))
    try:
        return parse(text, units, wanted)
    except InputError as error:
        raise InputError(f"a law's {key}: {error}") from None


def _parameter(name: str, given: Mapping[str, Any]) -> Parameter:
    """Return a declared parameter.

    Raises:
        InputError: an unknown key, no unit, no value, or invalid bounds.
    """
    if not name.isidentifier():
        raise InputError(f"a law's parameter {name!r} is no name: use letters, digits and _")
    wrong = sorted(set(given) - set(_KEYS))
    if wrong or "unit" not in given:
        raise InputError(
            f"a law's parameter {name!r} "
            + (f"has {wrong[0]!r}{nearest_name(wrong[0], _KEYS)}" if wrong else "has no unit")
            + f": give {', '.join(_KEYS)}"
        )
    numbers = {key: given[key] for key in _KEYS if key in given and key not in ("unit", "about")}
    for key, number in numbers.items():
        if isinstance(number, bool) or not isinstance(number, int | float) or not np.isfinite(number):
            raise InputError(f"a law's parameter {name!r}: {key} is {number!r}, needed is a finite number")
    value = float(numbers.get("value", numbers.get("nominal", 0.0)))
    reach = 10.0 * abs(value) or 1.0
    low, high = float(numbers.get("low", value - reach)), float(numbers.get("high", value + reach))
    nominal = float(numbers.get("nominal", min(max(0.0, low), high)))
    if not low < high or not low <= nominal <= high:
        raise InputError(
            f"a law's parameter {name!r}: {low:g} to {high:g} with nominal {nominal:g} are no bounds"
        )
    step, tolerance = (float(numbers.get(key, 0.0)) for key in ("step", "tolerance"))
    about = str(given.get("about", ""))
    return Parameter(name, str(given["unit"]), low, high, nominal, about, step, tolerance=tolerance)
