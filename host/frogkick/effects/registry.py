"""Effects by name, from tables of a TOML file, from a user's own Python file; and worlds, which hold them."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from frogkick.core.arguments import typed
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.files import existing_file
from frogkick.effects import body, camera, law, limbs, water
from frogkick.effects.base import Effect, call_hook
from frogkick.robot import Robot


def _built_in() -> dict[str, type[Effect]]:
    found = {}
    for module in (limbs, body, water, camera, law):
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if issubclass(kind, Effect) and vars(kind).get("name"):
                found[kind.name] = kind
    return dict(sorted(found.items()))


BUILT_IN: Mapping[str, type[Effect]] = _built_in()
"""All built-in effects by name."""


@typed
def make_effect(table: Mapping[str, Any], folder: Path) -> Effect:
    """Make an effect from an ``[[effect]]`` table.

    Args:
        table: ``name`` of a built-in effect, or ``file`` (relative to ``folder``) and ``class`` of a user's
            own; the other keys are its parameters and options.
        folder: folder of the TOML file.

    Raises:
        InputError: no such effect, file or class, a file that does not run, or wrong parameters.
    """
    values = {key: value for key, value in table.items() if key not in ("name", "file", "class")}
    _require_floats(values)
    if "file" in table:
        return _own(folder / str(table["file"]), table.get("class"), values)
    name = str(table.get("name"))
    if name not in BUILT_IN:
        raise InputError(
            f"no effect {name!r}{nearest_name(name, BUILT_IN)}: give a name of {', '.join(BUILT_IN)}; "
            "or file and class of your own"
        )
    return BUILT_IN[name](**values)


def _require_floats(values: Mapping[str, Any]) -> None:
    """Raise InputError for a whole number that no float holds: TOML has them of any length."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            _require_floats(value)
        elif isinstance(value, int) and abs(value) >= 2**63:
            raise InputError(f"{key} of an effect is {str(value)[:10]}..., a number beyond 2^63: correct it")


@typed
def make_effects(tables: Sequence[Mapping[str, Any]], folder: Path) -> tuple[Effect, ...]:
    """Make effects from tables, in order; see make_effect."""
    return tuple(make_effect(table, folder) for table in tables)


@typed
def effects_of(robot: Robot) -> tuple[Effect, ...]:
    """Return the effects of a robot's file.

    Raises:
        InputError: see make_effect; or an effect in a user's file, and a robot whose folder is not known.
    """
    for table in robot.effects:
        if "file" in table and robot.folder is None:
            raise InputError(
                f"robot {robot.id!r} has an effect of its own in {table['file']!r}, whose folder is not "
                "known: name the robot's TOML file"
            )
    try:
        effects = make_effects(robot.effects, robot.folder or Path())
    except InputError as error:
        raise InputError(f"robot {robot.id!r}: {error}") from None
    for effect in effects:
        call_hook(effect, "check", robot)
    return effects


def own_code(robot: Robot) -> bytes:
    """Return the content of the Python files in which a user wrote effects of a robot's file.

    Raises:
        InputError: see effects_of.
    """
    names = [str(table["file"]) for table in robot.effects if "file" in table]
    if names:
        effects_of(robot)
    return b"\0".join(((robot.folder or Path()) / name).read_bytes() for name in names)


def effect_classes(path: Path) -> list[type]:
    """Return all effects that a Python file defines: its own classes with a method of Effect.

    Raises:
        InputError: no such file, or it does not run; the text gives its error.
    """
    file = existing_file(path, "effect file")
    name = "frogkick_effect_" + hashlib.sha256(str(file.resolve()).encode()).hexdigest()[:12]
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise InputError(f"effect file {str(path)!r} is no Python file: name a .py file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise InputError(
            f"effect file {str(path)!r} does not run: {type(error).__name__}: {error}; correct it"
        ) from None
    hooks = ("robot", "stroke", "flow", "wrench", "fix")
    return [
        kind
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if kind.__module__ == name and any(callable(getattr(kind, hook, None)) for hook in hooks)
    ]


def _own(path: Path, name: object, values: dict[str, Any]) -> Effect:
    """Make an effect of a user's file; without a name, its only one.

    A class that does not inherit from Effect is combined with it.
    """
    kinds = {kind.__name__: kind for kind in effect_classes(path)}
    if name is None and len(kinds) == 1:
        (name,) = kinds
    if name not in kinds:
        raise InputError(
            f"effect file {str(path)!r} has no effect class {name!r}{nearest_name(str(name), kinds)}: "
            f"it has {', '.join(kinds) or 'none'}; give 'class'"
        )
    kind = kinds[str(name)]
    if not issubclass(kind, Effect):
        own = {"__init__": kind.__init__, "__module__": kind.__module__}
        kind = type(kind.__name__, (kind, Effect), own)
    try:
        made: Effect = kind(**values)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(
            f"effect {kind.__name__!r} cannot be made with {values}: {type(error).__name__}: {error}"
        ) from None
    return made


@typed
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


@typed
def read_world(path: World | Path | str, robot: Robot | None = None) -> World:
    """Read a world's TOML file; a world is returned unchanged.

    Args:
        path: the file; a world.
        robot: the robot that is to swim in it.

    Raises:
        InputError: no such file, not TOML, a key that is not ``effect``, or an effect that is invalid or does
            not fit the robot.
    """
    if isinstance(path, World):
        if robot is not None:
            _require_fit(path, robot)
        return path
    if not isinstance(path, Path | str):
        raise InputError(
            f"world is given as {type(path).__name__}: give fk.World([...]) of effects, or a TOML file"
        )
    file = existing_file(path, "world file")
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(
            f"world file {str(path)!r} is not UTF-8 text (byte {error.start}): name a TOML file of effects"
        ) from None
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"world file {str(path)!r} cannot be read as TOML: {error}") from None
    wrong = sorted(set(content) - {"effect"})
    tables = content.get("effect", [])
    if wrong or not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise InputError(
            f"world file {str(path)!r} has {', '.join(wrong) or 'an effect that is no table'}: "
            "a world has [[effect]] tables and nothing else"
        )
    try:
        world = World(make_effects(tables, file.parent))
        if robot is not None:
            _require_fit(world, robot)
        return world
    except InputError as error:
        raise InputError(f"world file {str(path)!r}: {error}") from None


def _require_fit(world: World, robot: Robot) -> None:
    for effect in world.effects:
        call_hook(effect, "check", robot)
