"""Robot files as text: the canonical form, whose hash identifies a robot, and a new robot's file to edit."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from frogkick.core.errors import InputError
from frogkick.robot.schema import ABOUT, RobotFile

if TYPE_CHECKING:
    from frogkick.robot.model import Robot


def _scalar(value: object, where: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise InputError(f"{where} is {value}: only finite numbers can be written")
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=True)
    if isinstance(value, Sequence):
        return "[" + ", ".join(_scalar(item, where) for item in value) + "]"
    raise InputError(f"{where} is a {type(value).__name__}: TOML has no such value here")


def _is_table_array(value: object) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(v, Mapping) for v in value)


def _write(table: Mapping[str, Any], prefix: str, lines: list[str]) -> None:
    nested = {k: v for k, v in table.items() if isinstance(v, Mapping) or _is_table_array(v)}
    for key, value in table.items():
        if key not in nested:
            lines.append(f"{key} = {_scalar(value, prefix + key)}")
    for key, value in nested.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{prefix}{key}]"]
            _write(value, f"{prefix}{key}.", lines)
        else:
            for item in value:
                lines += ["", f"[[{prefix}{key}]]"]
                _write(item, f"{prefix}{key}.", lines)


def to_toml(table: Mapping[str, Any]) -> str:
    """Return ``table`` as TOML text, keys in their order, floats in their shortest exact form.

    Args:
        table: str -> scalar, list of scalars, dict, or list of dicts; keys are bare TOML keys.
    """
    lines: list[str] = []
    _write(table, "", lines)
    return "\n".join(lines).lstrip("\n") + "\n"


def new_robot_text(base: Robot, name: str, limbs: int | None = None) -> str:
    """TOML of a new robot with the values of another, all keys, and a comment on each.

    Args:
        base: the other robot.
        name: the new robot's id.
        limbs: number of the base's limbs, with the actions of these; None: all.

    Raises:
        InputError: ``limbs`` is not 1 to the number of limbs of the base.
    """
    table = RobotFile.model_validate(tomllib.loads(base.toml)).model_dump(mode="json", exclude_none=True)
    del table["effect"]  # measured on another robot
    known = [limb["name"] for limb in table["limb"]]
    if limbs is not None and not 1 <= limbs <= len(known):
        raise InputError(
            f"--limbs is {limbs}, robot {base.id!r} has {len(known)}: give 1 to {len(known)}, "
            "or another robot to begin from"
        )
    kept = set(known[:limbs])
    table["id"], table["title"] = name, f"{name}, based on {base.id}"
    table["limb"] = [limb for limb in table["limb"] if limb["name"] in kept]
    table["action"] = _actions(table["action"], kept)
    table["gait"] = {key: [limb for limb in names if limb in kept] for key, names in table["gait"].items()}
    table["guard"]["limbs_at_once_max"] = min(table["guard"]["limbs_at_once_max"], len(kept))
    alloy = table["egain_percent"]
    table["profile"] = [profile for profile in table["profile"] if profile["egain_percent"] == alloy]
    intro = [
        f"# A robot file of frogkick, based on {base.id}. Units are in the names of keys. Look at it with",
        "# 'frogkick robot show FILE --out robot.png'; the documentation has the rest: A robot of your own.",
        "",
    ]
    return "\n".join([*intro, *_commented(to_toml(table))])


def _actions(actions: list[dict[str, Any]], kept: set[str]) -> list[dict[str, Any]]:
    """The distinct actions of the kept limbs, each with the first name."""
    found: list[dict[str, Any]] = []
    for action in actions:
        groups = [[limb for limb in action[key] if limb in kept] for key in ("first", "second")]
        # Without first limbs the second ones become the first.
        first, second = groups if groups[0] else (groups[1], [])
        if not any((row["first"], row["second"]) == (first, second) for row in found):
            found.append({"name": action["name"], "first": first, "second": second})
    return found


def _commented(text: str) -> list[str]:
    """Lines of TOML with a comment above each key, once for each kind of table."""
    lines, where, commented = [], "", set()
    for line in text.splitlines():
        if header := re.match(r"\[+([\w.]+)\]+$", line):
            where = f"{header.group(1)}."
        elif key := re.match(r"(\w+) = ", line):
            name = where + key.group(1)
            if name not in commented:
                lines.append(f"# {ABOUT[name]}")
                commented.add(name)
        lines.append(line)
    return [*lines, ""]
