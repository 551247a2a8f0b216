"""The file of a new robot: the keys of another, with as many limbs as wanted, and a comment on each."""

from __future__ import annotations

import math
import re
import tomllib
from typing import Any

from frogkick.core.errors import InputError
from frogkick.robot.model import Robot
from frogkick.robot.schema import ABOUT, LIMBS_MAX, RobotFile
from frogkick.robot.toml_text import to_toml

ROWS_APART = 1.7
"""Least distance of two rows of limbs over a limb's length, with which stretched limbs stay apart."""
WIDE = 2.5
"""Least width of a new hull over a limb's length, with which curled limbs of a row stay apart."""
ENDS = 2.0 / 3.0
"""Width of a new hull at its ends, over that at its middle; a tail between the rear limbs needs all of it."""
ON_AXIS = 1e-9  # m


def new_robot_text(base: Robot, name: str, limbs: int | None = None) -> str:
    """TOML of a new robot with the values of another, all keys, and a comment on each.

    Args:
        base: the other robot.
        name: the new robot's id.
        limbs: number of limbs, which are laid out in mirrored pairs, an odd one as a tail; None, or the
            number of the base: its own, with its actions.

    Raises:
        InputError: ``limbs`` is not 1 to LIMBS_MAX.
    """
    table = RobotFile.model_validate(tomllib.loads(base.toml)).model_dump(mode="json", exclude_none=True)
    del table["effect"], table["found_from"]  # measured on another robot, as the energy of a pulse
    table["pulse_energy_j"] = table.get("pulse_energy_j", 0.0)
    if limbs is not None and not 1 <= limbs <= LIMBS_MAX:
        raise InputError(f"--limbs is {limbs}: give 1 to {LIMBS_MAX}, which a table has room for")
    if limbs is not None and limbs != len(table["limb"]):
        _lay_out(table, limbs, base.actuation().drop_per_m)
    table["id"], table["title"] = name, f"{name}, based on {base.id}"
    alloys = {table["egain_percent"], *(limb.get("egain_percent") for limb in table["limb"])}
    table["profile"] = [profile for profile in table["profile"] if profile["egain_percent"] in alloys]
    intro = [
        f"# A robot file of frogkick, based on {base.id}. Units are in the names of keys. Look at it with",
        "# 'frogkick robot show FILE --out robot.png'; the documentation has the rest: A robot of your own.",
        "",
    ]
    lines = _commented(to_toml(table))
    return "\n".join([*intro, *(re.sub(r"^(pulse_energy_j) = .*", r"# \1 = ", line) for line in lines)])


def _lay_out(table: dict[str, Any], count: int, drop_per_m: float) -> None:
    """Give a robot's tables another number of limbs: rows of a right and a left limb, and a tail if odd.

    The frame stays if it has so many pairs; the rows are then spread over its own. Otherwise it becomes a
    hull that is wide and long enough.
    """
    frame, rows = table["frame"], _pairs(table)
    wanted = count // 2
    tail = next((limb for limb in table["limb"] if _is_tail(limb, frame)), None)
    if wanted > len(rows):
        tail = tail and {**tail, "corner": -1}
        kind = rows[0][0] if rows else _right(table["limb"][0], frame)
        rows = _hull(frame, kind, wanted, 1.0 if count % 2 else ENDS)
    spread = (len(rows) - 1) / (wanted - 1) if wanted > 1 else 0.0
    rows = [rows[round(index * spread)] for index in range(wanted)]
    names = _row_names(wanted)
    for row, name in zip(rows, names, strict=True):
        for limb, side in zip(row, ("right", "left"), strict=True):
            limb["name"] = f"{name}_{side}"
    if count % 2:
        limbs = [limb for row in rows for limb in row]
        if tail is None or tail["corner"] < 0:
            tail = _tail(frame, limbs, tail or next(iter(limbs), table["limb"][0]), drop_per_m)
        rows = [*rows, [{**tail, "name": "tail"}]]
    table["limb"] = sorted((limb for row in rows for limb in row), key=lambda limb: int(limb["corner"]))
    before = max(1, (wanted + 1) // 2)
    first, second = (
        [limb["name"] for row in part for limb in row] for part in (rows[:before], rows[before:])
    )
    table["action"] = _actions(first, second)
    table["gait"] = {"lead": first, "lag": second}
    together = sum if table["second_delay_s"] < table["pulse_s"] else max
    table["guard"]["limbs_at_once_max"] = max(
        together(len(action[group]) for group in GROUPS) for action in table["action"]
    )
    if "battery" in table:
        table["battery"]["count"] = count
        table["battery"]["inputs"] = table["battery"]["inputs"][:count]


def _pairs(table: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """The (right, left) limbs that are each other's mirror image, from the front to the rear."""
    corners, found = table["frame"]["corners_m"], []
    for right in table["limb"]:
        x, y = corners[right["corner"]]
        for left in table["limb"]:
            u, v = corners[left["corner"]]
            if y < -ON_AXIS and math.hypot(u - x, v + y) <= ON_AXIS and {**left, **_mirrored(right)} == left:
                found.append((x, [dict(right), dict(left)]))
    return [row for _, row in sorted(found, key=lambda each: -each[0])]


def _mirrored(limb: dict[str, Any]) -> dict[str, Any]:
    """The keys of a limb that its mirror image has otherwise, but for its name and corner."""
    return {
        "clamp": "next" if limb["clamp"] == "previous" else "previous",
        "direction_deg": -limb["direction_deg"],
        "rest_curvature_per_m": -limb["rest_curvature_per_m"],
    }


def _right(limb: dict[str, Any], frame: dict[str, Any]) -> dict[str, Any]:
    """A limb, or its mirror image if it is a left one."""
    return {**limb, **_mirrored(limb)} if frame["corners_m"][limb["corner"]][1] > 0.0 else limb


def _hull(frame: dict[str, Any], kind: dict[str, Any], rows: int, ends: float) -> list[list[dict[str, Any]]]:
    """Make a frame for rows of limbs of a kind, as that of a right one, and return the rows.

    ``ends`` is its width at the outer rows of three or more, over that at the others.
    """
    corners, pieces = frame["corners_m"], frame["segments"]
    round_m = sum(math.dist(corner, corners[index - 1]) for index, corner in enumerate(corners))
    piece_m = round_m / sum(pieces)
    long, wide = (max(axis) - min(axis) for axis in zip(*corners, strict=True))
    wide = max(wide, WIDE * kind["length_m"])
    long = max(long, (rows - 1) * ROWS_APART * kind["length_m"])
    left = []
    for row in range(rows):
        share = ends if rows > 2 and row in (0, rows - 1) else 1.0
        x = 0.5 * long - long * row / max(rows - 1, 1)
        left.append([round(x, 6), round(0.5 * wide * share, 6)])
    if rows == 1:
        left.append([-left[0][0], left[0][1]])
    # Counter-clockwise from the front right corner: up the front edge, along the left side, and back.
    ring = [[left[0][0], -left[0][1]], *left, *([x, -y] for x, y in left[:0:-1])]
    frame["corners_m"] = ring
    frame["segments"] = [
        max(2, round(math.dist(corner, ring[(index + 1) % len(ring)]) / piece_m))
        for index, corner in enumerate(ring)
    ]
    found = []
    for row in range(rows):
        clamp = "previous" if row == rows - 1 > 0 else "next"
        right = {**kind, "corner": -row % len(ring), "clamp": clamp}
        found.append([right, {**right, **_mirrored(right), "corner": row + 1}])
    return found


def _is_tail(limb: dict[str, Any], frame: dict[str, Any]) -> bool:
    x, y = frame["corners_m"][limb["corner"]]
    return bool(abs(y) <= ON_AXIS and x < 0.0)


def _tail(
    frame: dict[str, Any], limbs: list[dict[str, Any]], kind: dict[str, Any], drop_per_m: float
) -> dict[str, Any]:
    """A limb of a kind at the rear end of the frame's axis; while straightest it points straight back.

    There may be no corner yet; then the other limbs' corners are counted anew.
    """
    corners = frame["corners_m"]
    rear: list[tuple[float, int, bool]] = []  # x, corner or edge before it, whether it is a corner
    for index, (x, y) in enumerate(corners):
        u, v = corners[(index + 1) % len(corners)]
        if abs(y) <= ON_AXIS:
            rear.append((x, index, True))
        elif y * v < 0.0 and abs(v) > ON_AXIS:
            rear.append((x + (u - x) * y / (y - v), index, False))
    x, at, is_corner = min(rear)
    if not is_corner:
        at += 1
        frame["corners_m"] = [*corners[:at], [x, 0.0], *corners[at:]]
        half = math.ceil(0.5 * frame["segments"][at - 1])
        frame["segments"] = [*frame["segments"][: at - 1], half, half, *frame["segments"][at:]]
        for limb in limbs:
            limb["corner"] += limb["corner"] >= at
    curvature = abs(kind["rest_curvature_per_m"])
    bent_deg = math.degrees(0.5 * (curvature - drop_per_m) * kind["length_m"])
    turned = {"direction_deg": round(180.0 - bent_deg, 3), "rest_curvature_per_m": curvature}
    return {**kind, "corner": at, "clamp": "next", **turned}


def _row_names(rows: int) -> list[str]:
    return {1: ["front"], 2: ["front", "rear"], 3: ["front", "middle", "rear"]}.get(
        rows, ["front", "second", "third", "rear"][:rows]
    )


GROUPS = ("first", "second")


def _actions(first: list[str], second: list[str]) -> list[dict[str, Any]]:
    """The distinct actions of the two halves of the rows: both sides, and either one."""

    def of(limbs: list[str], side: str) -> list[str]:
        return [name for name in limbs if name.endswith(side)]

    every = {
        "A": (first, []),
        "B": (first, second),
        "C": (of(first, "_left"), second),
        "D": (of(first, "_right"), second),
        "E": (of(first, "_left"), of(second, "_left")),
        "F": (of(first, "_right"), of(second, "_right")),
        "G": (of(first, "_left"), []),
        "H": (of(first, "_right"), []),
        "I": ([], []),
        "J": (second, []),
    }
    found: dict[str, tuple[list[str], list[str]]] = {}
    for name, groups in every.items():
        if groups not in found.values() and (groups[0] or name == "I"):
            found[name] = groups
    return [{"name": name, **dict(zip(GROUPS, groups, strict=True))} for name, groups in found.items()]


def _commented(text: str) -> list[str]:
    """Lines of TOML with a comment above each key, once for each kind of table."""
    lines, where, commented = [], "", set()
    for line in text.splitlines():
        if header := re.match(r"\[+([\w.]+)\]+$", line):
            where = f"{header.group(1)}."
        elif key := re.match(r"(\w+) = ", line):
            name = where + key.group(1)
            if name not in commented:
                lines.append(f"# {ABOUT.get(name) or ABOUT[name.removeprefix('limb.')]}")
                commented.add(name)
        lines.append(line)
    return [*lines, ""]
