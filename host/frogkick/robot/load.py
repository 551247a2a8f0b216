"""Reads a robot file: TOML text to a checked Robot."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from frogkick.core.arguments import typed
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.files import existing_file
from frogkick.robot.geometry import require_geometry
from frogkick.robot.model import Action, Loaded, Robot
from frogkick.robot.profile import HalvesProfile, Profile
from frogkick.robot.rewriting import rewritten
from frogkick.robot.schema import (
    ABOUT,
    ACTION_NAME_MAX,
    ACTIONS_MAX,
    Battery,
    BatteryTable,
    Frame,
    FrameTable,
    Guard,
    LibraryTable,
    Limb,
    LimbTable,
    PlannerDefaults,
    ProfileTable,
    RobotFile,
    VelocityBox,
    keys_of,
    table_in,
)  # fmt: skip
from frogkick.robot.toml_text import to_toml

_Part = TypeVar("_Part")

PIN_MOST_V = 3.0
"""Largest voltage at an analogue input, with the supply of Nordic's kit."""

LIKELY: dict[str, tuple[float, float, str]] = {
    **dict.fromkeys(("corners_m", "length_m", "drag_width_m"), (0.0, 2.0, "mm")),
    "section_m2": (0.0, 1e-2, "mm^2"),
    "second_moment_m4": (0.0, 1e-6, "mm^4"),
    **dict.fromkeys(("modulus_rest_pa", "modulus_active_pa"), (1e3, 1e13, "MPa")),
    "mass_per_length_kg_per_m": (0.0, 100.0, "g/m"),
    "added_mass_per_length_kg_per_m": (0.0, 100.0, "g/m"),
    "density_kg_per_m3": (100.0, 3000.0, "g/cm^3"),
    "period_s": (0.02, 120.0, "ms"),
    **dict.fromkeys(("pulse_s", "pulse_max_s"), (0.0, 10.0, "ms")),
    **dict.fromkeys(("second_delay_s", "fix_fresh_s"), (0.0, 60.0, "ms")),
    **dict.fromkeys(("rest_min_s", "fix_lost_s", "duration_s", "centre_s", "width_s"), (0.0, 120.0, "ms")),
    **dict.fromkeys(("forward_mps", "left_mps"), (0.0, 10.0, "mm/s")),
}
"""Key -> plausible limits for a swimmer of 5 mm to 2 m, in the key's unit, and the likely unit of a number
outside of them."""

SAME = [name for name, at in RobotFile.model_fields.items() if name != "effect" and table_in(at) is None]
"""Keys of a robot's file that ``Robot`` has as they are: all values but the effects."""

PULSED = {"limb", "limb_default", "pulse_s", "egain_percent"}
"""Keys and tables on which the energy of a pulse depends: with one of its own, a file has that of no base."""

BUILT_IN = Path(__file__).resolve().parent / "robots"


@typed
def built_in_robots() -> tuple[str, ...]:
    """Names of the built-in robots."""
    return tuple(sorted(p.stem for p in BUILT_IN.glob("*.toml") if not p.stem.endswith(".profiles")))


@typed
def load_robot(name_or_path: Robot | str | Path) -> Robot:
    """Read a built-in robot ("frog2022") or a TOML file; a ``Robot`` is returned as it is.

    One whose values were replaced (``dataclasses.replace``) is read anew from its text, and so checked.

    Raises:
        InputError: no such robot, not TOML, an unknown key, a value out of its range, or parts that do not
            fit together.
    """
    if isinstance(name_or_path, Robot):
        robot = name_or_path
        return parse_robot(robot.toml, f"robot {robot.id!r}", robot.folder) if robot.changed else robot
    text = str(name_or_path)
    if text in built_in_robots():
        path = BUILT_IN / f"{text}.toml"
    elif "/" not in text and not text.endswith(".toml") and not os.path.exists(text):
        known = ", ".join(built_in_robots())
        raise InputError(
            f"no robot {text!r}{nearest_name(text, built_in_robots())}: name a TOML file or one of {known}"
        )
    else:
        path = existing_file(text, "robot file")
    content = _text_of(path, f"robot file {text!r}", "a robot's TOML file")
    return parse_robot(content, source=text, folder=path.parent)


def _text_of(path: Path, what: str, wanted: str) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{what} cannot be read: {error.strerror}; check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{what} is not UTF-8 text (byte {error.start}): name {wanted}") from error


def parse_robot(content: str, source: str, folder: Path | None = None) -> Robot:
    """Make a Robot from TOML text.

    Args:
        content: TOML.
        source: its name in errors.
        folder: where ``base``, ``profiles_file`` and files of effects are; None if the text names none.

    Raises:
        InputError: the text is no TOML, or a key is missing, unknown or out of its range.
    """
    table = _whole(content, source, folder)
    default = table.pop("limb_default", {})
    limbs = table.get("limb")
    if not isinstance(default, Mapping):
        raise InputError(f"{source}: limb_default is a value; write a [limb_default] table")
    if isinstance(limbs, list):
        table["limb"] = [{**default, **limb} if isinstance(limb, Mapping) else limb for limb in limbs]
    try:
        file_model = RobotFile.model_validate(table)
        _require_likely(file_model.model_dump())
        return _robot(file_model, folder)
    except ValidationError as error:
        raise InputError(f"{source}: {_first_error(error)}") from None
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _require_likely(table: Mapping[str, Any], where: str = "") -> None:
    """Raise InputError for a number outside of LIKELY."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            _require_likely(value, f"{where}{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping) and key != "effect":
            for index, row in enumerate(value):
                _require_likely(row, f"{where}{key}.{row.get('name', index)}.")
        elif key in LIKELY:
            least, most, other = LIKELY[key]
            size = float(np.abs(np.ravel(value)).max(initial=0.0))
            if least <= size <= most:
                continue
            limit = f"above {most:g}" if size > most else f"below {least:g}"
            raise InputError(
                f"{where}{key} is {size:g}, {limit}, which no small swimmer has: "
                f"its unit is in its name, is the number in {other}?"
            )


def _whole(content: str, source: str, folder: Path | None, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """A file's keys with its strokes, merged into those of its ``base``, which may have a base itself.

    Args:
        content, source, folder: those of ``parse_robot``.
        above: the files that are based on this one, and this one.
    """
    table = _parse_toml(content, source)
    limbs = table.get("limb")
    for each in (table, *(limbs if isinstance(limbs, list) else ())):
        if not isinstance(each, dict) or (name := each.pop("profiles_file", None)) is None:
            continue
        if not isinstance(name, str) or folder is None or "profile" in each:
            raise InputError(f"{source}: profiles_file needs a file name, a folder and no [[profile]]")
        file = existing_file(folder / name, "profiles file")
        content = _text_of(file, f"profiles file {name!r}", "a TOML file of [[profile]] tables")
        each["profile"] = _parse_toml(content, name).get("profile", [])
    base = table.pop("base", None)
    if base is None:
        return table
    known = built_in_robots()
    if base in known:
        path = BUILT_IN / f"{base}.toml"
    elif not isinstance(base, str) or folder is None or not (base.endswith(".toml") or "/" in base):
        hint = nearest_name(str(base), known)
        raise InputError(
            f"{source}: base is {base!r}{hint}: give one of {', '.join(known)}, or a robot's TOML file"
        )
    else:
        path = existing_file(folder / base, f"{source}: base")
    if path.resolve() in above:
        raise InputError(f"{source}: base {base!r} is based on this file itself: take one of the two away")
    content = _text_of(path, f"{source}: base {base!r}", "a robot's TOML file")
    below = _whole(content, f"{source}: base {base!r}", path.parent, (*above, path.resolve()))
    for row in below.get("effect", ()) if folder is not None else ():
        if isinstance(row, dict) and isinstance(row.get("file"), str):
            row["file"] = os.path.relpath(path.parent / row["file"], folder)
    if table.keys() & PULSED:
        below.pop("pulse_energy_j", None)
    return _merged(below, table)


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of both; tables are merged by key, other values and lists of tables are those of ``above``."""
    found = {**below, **above}
    for key, value in above.items():
        if isinstance(value, Mapping) and isinstance(below.get(key), Mapping):
            found[key] = _merged(below[key], value)
    return found


def _parse_toml(content: str, source: str) -> dict[str, Any]:
    try:
        return tomllib.loads(content)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{source} is not TOML: {error}") from error


def _table_at(location: tuple[int | str, ...]) -> type[BaseModel]:
    """The schema's table that holds the key at ``location``."""
    table: type[BaseModel] = RobotFile
    for part in location[:-1]:
        field = table.model_fields.get(str(part))
        table = (field and table_in(field)) or table
    return table


def _first_error(error: ValidationError) -> str:
    """The first error in one line; unknown keys come first, because a misspelt key is missing too."""
    problems = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = problems[0]
    location = first["loc"]
    where = ".".join(str(part) for part in location)
    more = f" ({len(problems) - 1} more)" if len(problems) > 1 else ""
    if first["type"] == "extra_forbidden":
        key = str(location[-1])
        hint = nearest_name(key, _table_at(location).model_fields) or " (not a key of this table)"
        return f"unknown key {where!r}{hint}: correct or remove it{more}"
    missing = [".".join(map(str, problem["loc"])) for problem in problems if problem["type"] == "missing"]
    if first["type"] == "missing" and len(missing) == len(problems) > 1:
        return f"keys {', '.join(map(repr, missing))} are missing: add them"
    if first["type"] == "missing":
        return f"key {where!r} is missing: add it{more}"
    if location[0] == "action" and location[-1] == "name":
        return (
            f"{where} is {str(first['input'])[:60]!r}: give a letter, or a word of up to {ACTION_NAME_MAX} "
            f"letters, digits, - and _ that begins with a letter{more}"
        )
    if location == ("action",) and first["type"] == "too_long":
        return f"there are {len(first['input'])} actions: a table has room for {ACTIONS_MAX}, leave some out"
    given = f"{where} is {str(first['input'])[:60]!r}"
    if first["type"].startswith("string_") and (about := ABOUT.get(".".join(map(str, location[::2])))):
        return f"{given}: give {about.split(';')[0]}{more}"
    if first["type"] in ("model_type", "dict_type", "model_attributes_type"):
        table = f"[[{location[0]}]]" if len(location) > 1 else f"[{where}]"
        return f"{given}: it is a table, so write {table} and its keys below{more}"
    return f"{given}: {first['msg'][0].lower()}{first['msg'][1:]}{more}"


def _mask(names: list[str], limbs: list[str], where: str) -> int:
    mask = 0
    for name in names:
        if name not in limbs:
            raise InputError(f"{where} fires {name!r}, which is not a limb{nearest_name(name, limbs)}")
        if mask >> limbs.index(name) & 1:
            raise InputError(f"{where} names {name!r} twice: once is enough")
        mask |= 1 << limbs.index(name)
    return mask


def _part(kind: Callable[..., _Part], table: BaseModel) -> _Part:
    """A part of a robot from its table: lists are tuples, degrees are radians."""
    values = {}
    for name, key in keys_of(kind).items():
        value = getattr(table, key)
        if name != key:
            value = math.radians(value) if isinstance(value, float) else [math.radians(v) for v in value]
        values[name] = tuple(value) if isinstance(value, list) else value
    return kind(**values)


def _frame(table: FrameTable) -> Frame:
    corners = table.corners_m
    n = len(corners)
    if len(table.segments) != n:
        raise InputError(f"frame.segments has {len(table.segments)} entries for {n} edges: give each one")
    area = 0.5 * sum(
        corners[i][0] * corners[(i + 1) % n][1] - corners[(i + 1) % n][0] * corners[i][1] for i in range(n)
    )
    shortest = min(math.dist(corners[i], corners[(i + 1) % n]) for i in range(n))
    if not area > 1e-8 or not shortest > 1e-4:
        raise InputError(
            f"frame.corners_m encloses {area:.3g} m^2 with a shortest edge of {shortest:.3g} m: "
            "list distinct corners counter-clockwise"
        )
    return _part(Frame, table)


def _limb(table: LimbTable, corners: int) -> Limb:
    if table.corner >= corners:
        raise InputError(f"limb {table.name!r} sits at corner {table.corner}: the last one is {corners - 1}")
    _distinct([(p.egain_percent, p.frequency_hz) for p in table.profile], f"profiles of limb {table.name!r}")
    return replace(_part(Limb, table), profiles=tuple(_profile(profile) for profile in table.profile))


def _profile(table: ProfileTable) -> Profile:
    values = table.model_dump()
    lists = ("amplitude_per_m", "centre_s", "width_s")
    if len({len(values[key]) for key in lists}) != 1 or not table.amplitude_per_m:
        raise InputError(
            f"profile at {table.egain_percent:g} %, {table.frequency_hz:g} Hz has lists of "
            "different lengths: give each term an amplitude, a centre and a width"
        )
    values |= {key: tuple(values[key]) for key in lists}
    start, straightest = (values.pop(key) for key in ("start_per_m", "straightest_s"))
    if start == straightest == 0.0:
        return Profile(**values)
    if len(table.amplitude_per_m) != 2 or not 0.0 < straightest < table.duration_s or start == 0.0:
        raise InputError(
            f"profile at {table.egain_percent:g} %, {table.frequency_hz:g} Hz has "
            f"{len(table.amplitude_per_m)} terms, start_per_m {start:g} and straightest_s {straightest:g}: "
            "give two terms, a start above 0 and a time within duration_s, or neither of the two keys"
        )
    return HalvesProfile(**values, start_per_m=start, straightest_s=straightest)


def _box(table: LibraryTable) -> VelocityBox:
    for axis, (low, high) in table.model_dump().items():
        if not low < high:
            raise InputError(f"library.{axis} is [{low}, {high}]: write the lower end first")
    return _part(VelocityBox, table)


def _battery(table: BatteryTable | None) -> Battery | None:
    if table is None:
        return None
    if not table.low_v < table.full_v:
        raise InputError(
            f"battery.low_v is {table.low_v:g} V and battery.full_v {table.full_v:g} V: "
            "a full one has more than one that is low"
        )
    pin_v = table.full_v / table.divider
    if table.inputs and pin_v > PIN_MOST_V:
        raise InputError(
            f"battery.full_v {table.full_v:g} V with battery.divider {table.divider:g} is "
            f"{pin_v:.3g} V at an input of the chip, which takes {PIN_MOST_V:g} V: give the divider's ratio, "
            "battery over input"
        )
    if len(set(table.inputs)) != len(table.inputs) or len(table.inputs) > table.count:
        raise InputError(
            f"battery.inputs are {table.inputs}, battery.count is {table.count}: give one input "
            "for each battery that is seen"
        )
    return _part(Battery, table)


def _distinct(names: list[Any], what: str) -> None:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(f"two {what} are called {name!r}: give each its own")


def _robot(file: RobotFile, folder: Path | None) -> Robot:
    limb_names = [limb.name for limb in file.limb]
    _distinct(limb_names, "limbs")
    _distinct([limb.corner for limb in file.limb], "limbs' corners")
    _distinct([action.name.upper() for action in file.action], "actions")
    _distinct([(p.egain_percent, p.frequency_hz) for p in file.profile], "profiles")
    frame = _frame(file.frame)
    limbs = tuple(_limb(limb, len(frame.corners_m)) for limb in file.limb)
    require_geometry(frame, limbs)
    text = to_toml(file.model_dump(mode="json", exclude_defaults=True))
    robot = Robot(
        **{name: getattr(file, name) for name in SAME},
        water_density_kg_per_m3=file.water.density_kg_per_m3,
        gait_lead_mask=_mask(file.gait.lead, limb_names, "gait.lead"),
        gait_lag_mask=_mask(file.gait.lag, limb_names, "gait.lag"),
        frame=frame,
        limbs=limbs,
        actions=tuple(
            Action(
                a.name,
                _mask(a.first, limb_names, f"action {a.name}"),
                _mask(a.second, limb_names, f"action {a.name}"),
            )
            for a in file.action
        ),
        profiles=tuple(_profile(p) for p in file.profile),
        library_box=_box(file.library),
        guard=_part(Guard, file.guard),
        planner=PlannerDefaults(**file.planner.model_dump()),
        battery=_battery(file.battery),
        effects=tuple(dict(table) for table in file.effect),
        folder=folder,
        loaded=Loaded(text, _rewritten),
    )
    robot.strokes()  # raises if a profile of the actions is missing
    return robot


def _rewritten(robot: Robot) -> str:
    """The canonical text of a robot whose values were replaced."""
    source = f"robot {robot.id!r} with replaced values"
    return parse_robot(rewritten(robot, source), source, robot.folder).toml
