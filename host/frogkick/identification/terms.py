"""Candidate effects: the catalogue, with free parameters and the values that a search starts from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.effects import BUILT_IN, Effect, Law, Parameter
from frogkick.effects.base import call_hook
from frogkick.effects.registry import effect_classes, make_effect
from frogkick.effects.water import OUTWARD
from frogkick.robot import Robot


@dataclass(frozen=True)
class Interval:
    """A number that was estimated: value, interval (95 %), unit."""

    name: str
    value: float
    low: float
    high: float
    unit: str

    @property
    def interval(self) -> tuple[float, float]:
        """Low and high."""
        return self.low, self.high

    def contains(self, value: float, times: float = 1.0) -> bool:
        """Whether the interval contains a value, or one ``times`` as wide does."""
        more = 0.5 * (times - 1.0) * (self.high - self.low)
        return self.low - more <= value <= self.high + more

    def reaching(self, low: float, high: float) -> Interval:
        """The interval extended to contain two more values."""
        return replace(self, low=min(self.low, low), high=max(self.high, high))

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} {self.value:.4g} [{self.low:.4g}, {self.high:.4g}]{unit}"


@dataclass(frozen=True)
class Term:
    """An effect with values for its parameters."""

    table: tuple[tuple[str, Any], ...]  # of its TOML without parameters: name, or file and class; options
    folder: Path  # of its file
    parameters: tuple[Parameter, ...]  # as the effect declares them
    values: tuple[float, ...]

    @property
    def title(self) -> str:
        """Its name with its options: ``limb_wear rear_left``."""
        keys = dict(self.table)
        if self.name == "law":
            return " ".join(str(keys[key]) for key in ("title", "limb") if key in keys)
        options = (value for key, value in keys.items() if key not in ("name", "file", "class"))
        return " ".join([self.name, *map(str, options)])

    @property
    def name(self) -> str:
        """Name of the effect, without options."""
        keys = dict(self.table)
        return str(keys.get("name") or keys.get("class"))

    @property
    def own(self) -> bool:
        """Whether it is an effect of a user's file."""
        return "file" in dict(self.table)

    @property
    def options(self) -> dict[str, Any]:
        """What it acts on, as ``{"limb": "rear_left"}``; of a law its formulas as well, under ``law``."""
        if self.name != "law":
            return {key: value for key, value in self.table if key not in ("name", "class")}
        keys = {key: value for key, value in self.table if key not in ("name", "title", "limb", "parameters")}
        limb = {key: value for key, value in self.table if key == "limb"}
        return {"title": self.title, **limb, "law": keys}

    @property
    def toml(self) -> dict[str, Any]:
        """Its TOML with the values of its parameters."""
        values = {p.name: float(v) for p, v in zip(self.parameters, self.values, strict=True)}
        return {**dict(self.table), **values}

    def effect(self) -> Effect:
        """The effect itself."""
        return make_effect(self.toml, self.folder)

    def at(self, values: Sequence[float] | Float64) -> Term:
        """The same with other values, clipped to their bounds."""
        inside = [
            min(max(float(value), p.low), p.high) for value, p in zip(values, self.parameters, strict=True)
        ]
        return replace(self, values=tuple(inside))


@dataclass(frozen=True)
class FoundEffect:
    """An effect that explains the runs.

    Attributes:
        name: name in the catalogue, or of the user's own class.
        options: the part that it acts on, such as ``{"limb": "rear_left"}``.
        parameters: name -> value, interval (low, high; 95 %) and unit.
        confounded_with: effects that these runs cannot distinguish from it.
        stability: share of bootstrap samples of the training runs in which it was accepted, 0 to 1.
    """

    name: str
    options: dict[str, Any]
    parameters: dict[str, Interval]
    confounded_with: tuple[str, ...]
    stability: float

    def as_json(self) -> dict[str, Any]:
        """One of ``effects`` of the command ``identify``."""
        return {
            "name": self.name,
            **self.options,
            "parameters": {
                name: {"value": each.value, "interval": list(each.interval), "unit": each.unit}
                for name, each in self.parameters.items()
            },
            "not_told_from": list(self.confounded_with),
            "stability": self.stability,
        }


def catalogue(robot: Robot, own: Path | None = None) -> list[Term]:
    """The built-in effects that are searched for one by one, with each of their options, and a user's own.

    Effects that are fitted jointly only (``Effect.joint_only``) are not among them, nor are those of
    ``unfittable``.

    Raises:
        InputError: the user's file has no effect, or one that cannot be made from its parameters.
    """
    terms = []
    for name, kind in BUILT_IN.items():
        if kind.joint_only or not kind.parameters:
            continue  # see frogkick.identification.calibrated; a law has what its formulas name
        for options in _options(kind, robot):
            if name != "group_gain" or not _is_limb_wear(robot, options["group"]):
                terms.append(_term({"name": name, **options}, Path(), kind))
    if own is not None:
        kinds = effect_classes(own)
        if not kinds:
            raise InputError(f"effect file {str(own)!r} defines no effect: derive a class from Effect")
        for kind in kinds:
            choices = _options(kind, robot)
            for options in choices if _declared(kind) else []:
                table = {"file": own.name, "class": kind.__name__, **options}
                term = _term(table, own.resolve().parent, kind)
                call_hook(term.effect(), "check", robot)
                terms.append(term)
    return terms


def unfittable(own: Path | None) -> tuple[str, ...]:
    """A sentence for each effect of a user's file that is not searched for, as it has no parameters."""
    names = [kind.__name__ for kind in effect_classes(own) if not _declared(kind)] if own else []
    why = "has no parameters and is not tried: declare one, with a nominal value at which the effect vanishes"
    return tuple(f"effect {name!r} {why}" for name in names)


def _declared(kind: type) -> tuple[Parameter, ...]:
    given = getattr(kind, "parameters", ())
    if not isinstance(given, tuple | list) or not all(isinstance(each, Parameter) for each in given):
        raise InputError(f"effect {kind.__name__!r}: parameters are {given!r}: give a tuple of Parameter")
    return tuple(given)


def _term(table: Mapping[str, Any], folder: Path, kind: type) -> Term:
    given = _declared(kind)
    return Term(tuple(table.items()), folder, given, tuple(p.nominal for p in given))


def law_term(
    title: str, table: Mapping[str, str], parameters: Mapping[str, Any], values: Sequence[float]
) -> Term:
    """The term of a law: ``on``, ``limb`` and the formulas, declared parameters and their values."""
    given: dict[str, Any] = {"title": title, **table, "parameters": parameters}
    declared = Law(**given).parameters
    return Term((("name", "law"), *given.items()), Path(), declared, tuple(float(v) for v in values))


def _is_limb_wear(robot: Robot, group: str) -> bool:
    """Return whether a group of limbs is one limb or all of them, whose gain is that of ``limb_wear``."""
    members = sum(group in limb.name.split("_") for limb in robot.limbs)
    return members in (1, len(robot.limbs))


def _options(kind: type, robot: Robot) -> list[dict[str, Any]]:
    """Option values to try: each limb and, of several, the default; words of limb names; sides of a pool."""
    options: object = getattr(kind, "options", {})
    if not isinstance(options, Mapping):
        raise InputError(f"effect {kind.__name__!r}: options are {options!r}: give {{'limb': 'all'}} or such")
    if "limb" in options:
        names = [limb.name for limb in robot.limbs]
        default = [options["limb"]] if options["limb"] is not None and len(names) > 1 else []
        return [{"limb": name} for name in [*names, *default]]
    if "side" in options:
        return [{"side": side} for side in OUTWARD]
    if "group" in options:
        words = sorted({word for limb in robot.limbs for word in limb.name.split("_")})
        return [{"group": word} for word in words]
    return [{}]
