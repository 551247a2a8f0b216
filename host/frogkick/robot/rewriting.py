"""The text of a robot that differs from its file: by replaced values, or by effects that were found."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Hashable
from dataclasses import fields, is_dataclass
from typing import Any, cast

from frogkick.core.errors import InputError
from frogkick.robot.model import Robot
from frogkick.robot.profile import Profile
from frogkick.robot.schema import ID_MAX, PlannerDefaults, keys_of
from frogkick.robot.toml_text import to_toml

_FOUND = "-found"
"""Ends the id of a robot with identified effects: neither it nor its tables pass for the nominal one."""


def own_id(robot: Robot) -> dict[str, str]:
    """The keys ``id`` and ``found_from`` of a robot with effects that were found beside those of another."""
    earlier = re.fullmatch(rf".*{_FOUND}(\d*)", robot.id)
    ending = f"{_FOUND}{int(earlier[1] or 1) + 1}" if earlier else _FOUND
    first = robot.found_from or robot.id
    return {"id": first[: ID_MAX - len(ending)] + ending, "found_from": first}


_KEYS = {"limbs": "limb", "profiles": "profile", "library_box": "library", "effects": "effect"}
"""Keys of a robot's parts in its file, where they are not the attributes' names."""


def rewritten(robot: Robot, source: str) -> str:
    """TOML of a robot with its values, which are not checked; what was not replaced keeps its text.

    ``source`` is for errors.
    """
    table, limbs = tomllib.loads(robot.loaded.text), [limb.name for limb in robot.limbs]

    def named(mask: int) -> list[str]:
        return [name for limb, name in enumerate(limbs) if mask >> limb & 1]

    for name in robot.changed:
        now, was = getattr(robot, name), robot.loaded.values[name]
        if name == "actions":
            table["action"] = [
                {"name": each.name, "first": named(each.first_mask), "second": named(each.second_mask)}
                for each in now
            ]
        elif name == "water_density_kg_per_m3":
            table["water"]["density_kg_per_m3"] = now
        elif name in ("gait_lead_mask", "gait_lag_mask"):
            table["gait"][name.split("_")[1]] = named(now)
        else:
            key = _KEYS.get(name, name)
            table[key] = _in_file(now, was, table.get(key), f"{source}: {name}")
    return to_toml({key: value for key, value in table.items() if value is not None})


def _in_file(now: Any, was: Any, written: Any, where: str) -> Any:
    """A value as a robot's file has it; ``was`` is the loaded one and ``written`` its form in the file."""
    if now == was:
        return written
    if isinstance(now, tuple) and now and is_dataclass(now[0]):
        alike = was is not None and len(was) == len(now)
        before, rows = (was, written) if alike else ([None] * len(now),) * 2
        return [_in_file(*each, where) for each in zip(now, before, rows, strict=True)]
    if not is_dataclass(now):
        return now
    plain = isinstance(now, Profile | PlannerDefaults)  # whose attributes are the keys
    keys: dict[str, str] = {} if plain else keys_of(cast(Hashable, type(now)))
    table: dict[str, Any] = {}
    for at in fields(now):
        value, old = getattr(now, at.name), getattr(was, at.name, None)
        key = at.name if plain else keys.get(at.name, "profile" if at.name == "profiles" else None)
        if key is None:
            if value != at.default:
                raise InputError(f"{where}.{at.name} is {value}: no file holds it, an effect sets it")
        elif was is not None and value == old:
            table |= {key: written[key]} if key in written else {}
        elif keys.get(at.name, at.name) != at.name:  # an angle
            table[key] = math.degrees(value) if isinstance(value, float) else [math.degrees(v) for v in value]
        elif value is not None and value != ():
            table[key] = _in_file(value, old, (written or {}).get(key), where)
    return table
