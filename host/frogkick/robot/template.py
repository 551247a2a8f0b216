"""A template of a robot file: complete, with a comment on each key, made from a built-in robot."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from frogkick.core.errors import InputError
from frogkick.robot.model import Robot
from frogkick.robot.schema import ABOUT, RobotFile
from frogkick.robot.toml_text import to_toml


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
