"""A world: the effects in the simulated pool, which no model contains. A TOML file of ``[[effect]]``
tables."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.effects.base import Effect
from frogkick.effects.registry import make_effects


@dataclass(frozen=True)
class World:
    """The effects in the simulated pool, which no model contains.

    Attributes:
        effects: a sequence of effects, in order.

    Raises:
        InputError: not a sequence of effects.
    """

    effects: Sequence[Effect] = ()

    def __post_init__(self) -> None:
        given = self.effects
        if not isinstance(given, Iterable) or not all(isinstance(effect, Effect) for effect in given):
            raise InputError(
                f"effects of a world are {given!r}: give a list, as [fk.effects.LimbWear(limb='rear_left')]"
            )
        object.__setattr__(self, "effects", tuple(given))


def read_world(path: World | Path | str) -> World:
    """Read a world's TOML file; a world is returned unchanged.

    Raises:
        InputError: no such file, not TOML, a key that is not ``effect``, or an invalid effect.
    """
    if isinstance(path, World):
        return path
    if not isinstance(path, Path | str):
        raise InputError(f"world is a {type(path).__name__}: give fk.World([...]) of effects, or a TOML file")
    file = existing_file(path, "world file")
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"world file {str(path)!r} cannot be read as TOML: {error}") from None
    wrong = sorted(set(content) - {"effect"})
    tables = content.get("effect", [])
    if wrong or not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise InputError(
            f"world file {str(path)!r} has {', '.join(wrong) or 'an effect that is no table'}: "
            "a world has [[effect]] tables and nothing else"
        )
    return World(make_effects(tables, file.parent))
