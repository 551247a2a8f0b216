"""A template of a robot file: complete, with a comment on each key, made from a built-in robot."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from frogkick.core.errors import InputError
from frogkick.core.weights import WEIGHTS
from frogkick.robot.model import Robot
from frogkick.robot.schema import RobotFile
from frogkick.robot.toml_text import to_toml

ABOUT = {
    "id": "1 to 15 letters, digits, - or _; tables, firmware and logs carry it",
    "title": "for people",
    "period_s": "s from one action to the next; a stroke is to end within it",
    "pulse_s": "s that a limb is heated for a stroke",
    "second_delay_s": "s from the action's first limbs to its second ones",
    "pulse_energy_j": "J, electrical, of one pulse on one limb; only costs of transport need it",
    "egain_percent": "the limbs' alloy, as in [[profile]]",
    "profile_frequency_hz": "Hz of the [[profile]] that strokes are taken from, near 1 / period_s",
    "velocity_resolution": "m/s, m/s, rad/s: one step of a table's velocities",
    "water.density_kg_per_m3": "kg/m^3",
    "frame.corners_m": "m, x forward, y left, counter-clockwise; the origin is anywhere",
    "frame.segments": "pieces of each edge; edge i runs from corner i to corner i + 1",
    "frame.mass_per_length_kg_per_m": "kg for each m of the outline",
    "frame.added_mass_per_length_kg_per_m": "kg of water that moves with each m of it",
    "frame.stretching_stiffness_n": "N, Young's modulus times section",
    "frame.bending_stiffness_n_m2": "N m^2, Young's modulus times second moment of area",
    "frame.drag_width_m": "m across the flow, the depth of the frame in water",
    "frame.drag_normal": "drag coefficient across an edge",
    "frame.drag_tangential": "drag coefficient along it",
    "frame.centre_mass_share": "share of that mass that sits at the centre of the corners, 0 to 0.95",
    "limb.name": "letters, digits, - or _",
    "limb.corner": "where it begins, counted from 0 in frame.corners_m",
    "limb.clamp": "the edge at that corner that its root bends against: previous or next",
    "limb.direction_deg": "degrees from forward, counter-clockwise, of its tangent at the root",
    "limb.length_m": "m along the limb",
    "limb.segments": "pieces",
    "limb.rest_curvature_per_m": "1/m at rest, positive where it curls counter-clockwise towards its tip",
    "limb.modulus_rest_pa": "Pa, Young's modulus at rest",
    "limb.modulus_active_pa": "Pa, while it is straightest",
    "limb.second_moment_m4": "m^4, second moment of area",
    "limb.section_m2": "m^2",
    "limb.root_stiffness_ratio": "how much stiffer the clamp is than the limb",
    "limb.mass_per_length_kg_per_m": "kg for each m",
    "limb.added_mass_per_length_kg_per_m": "kg of water that moves with each m of it",
    "limb.drag_width_m": "m across the flow",
    "limb.drag_normal": "drag coefficient across the limb",
    "limb.drag_tangential": "drag coefficient along it",
    "action.name": "a letter, or a word of up to 20 letters, digits, - and _; up to 32 actions",
    "action.first": "limbs that fire at the action's start",
    "action.second": "limbs that fire second_delay_s later",
    "gait.lead": "of a steady gait: limbs that fire first",
    "gait.lag": "and those that fire a phase later",
    "library.forward_mps": "m/s, lowest and highest speed at an action's start that tables are made for",
    "library.left_mps": "m/s, the same to the left",
    "library.omega_deg_s": "degrees/s, the same of the turn rate",
    "guard.pulse_max_s": "s that no pulse is longer than, whatever is asked",
    "guard.rest_min_s": "s that a limb rests after a pulse",
    "guard.duty_max": "share of the time that a limb is on, at most",
    "guard.duty_window_s": "s that this share is counted over",
    "guard.limbs_at_once_max": "limbs that are on at a time, at most",
    "guard.fix_fresh_s": "s that a position fix is used for decisions",
    "guard.fix_lost_s": "s without a fix after which a run ends, disarmed",
    "planner.cost": "route: progress along the path; paper: the published cost",
    **{f"planner.{name}": weight.about for name, weight in WEIGHTS.items()},
    "planner.depth": "levels to look ahead, 1 to 4",
    "planner.plan_time_s": "s that a decision may take on the robot; 0: no limit",
    "battery.count": "how many",
    "battery.nominal_v": "V of each",
    "battery.low_v": "V at rest below which nothing is armed",
    "battery.full_v": "V at rest when full",
    "battery.measure": "where a person measures it",
    "battery.inputs": "AIN0 to AIN7 of the chip, one for each battery that is wired to one",
    "battery.divider": "V of the battery for 1 V at the input",
    "profile.egain_percent": "the alloy that was measured",
    "profile.frequency_hz": "strokes a second at which it was measured",
    "profile.duration_s": "s of the measurement, one stroke",
    "profile.rest_curvature_per_m": "1/m, size of the curvature at rest",
    "profile.amplitude_per_m": "1/m of each term: amplitude / (1 + exp(-(t - centre) / width))",
    "profile.centre_s": "s of each term",
    "profile.width_s": "s of each term",
    "profile.rms_per_m": "1/m that the terms miss the measurement by, root mean square",
}
"""Key with its table -> description with unit."""


def new_robot_text(base: Robot, name: str, limbs: int | None = None) -> str:
    """TOML of a new robot with the values of another, all keys, and a comment on each.

    Args:
        base: the other robot.
        name: the new robot's id.
        limbs: number of the base's limbs, with the actions of these; None: all.

    Raises:
        InputError: the base has fewer limbs.
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
