"""``frogkick robot``: which robots there are, and what one looks like."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show
from frogkick.files import require_writable

if TYPE_CHECKING:
    from frogkick.der import Rods
    from frogkick.robot import Robot

app = typer.Typer(help="Which robots there are, and what one looks like.", no_args_is_help=True)


@app.command("list")
def list_robots(json: JsonOption = False) -> None:
    """List the built-in robots."""
    from frogkick.robot import built_in_robots, load_robot

    robots = [load_robot(name) for name in built_in_robots()]
    rows = [
        {
            "name": name,
            "title": robot.title,
            "limbs": len(robot.limbs),
            "actions": len(robot.actions),
            "period_s": robot.period_s,
        }
        for name, robot in zip(built_in_robots(), robots, strict=True)
    ]
    lines = [
        f"{row['name']}: {row['title']}; {row['limbs']} limbs, {row['actions']} actions, {row['period_s']} s"
        for row in rows
    ]
    show({"robots": rows}, json, "\n".join(lines))


@app.command("show")
def show_robot(
    robot: Annotated[str, typer.Argument(help="TOML file or built-in name.")] = "frog2022",
    out: Annotated[Path | None, typer.Option(help="Picture to write (.png, .svg or .pdf).")] = None,
    json: JsonOption = False,
) -> None:
    """Say what a robot is and draw it as it is simulated: nodes, frame, limbs at rest and active.

    Lengths are those at rest. Doubts about its geometry or its limits are warnings.
    """
    from frogkick.der import prepare
    from frogkick.robot import load_robot, robot_warnings

    require_writable(out)
    described = load_robot(robot)
    rods = prepare(described)
    if out is not None:
        from frogkick.report.robot_figure import write_robot_figure

        write_robot_figure(described, out)
    warnings = robot_warnings(described)
    facts = {**_facts(described, rods), "warnings": list(warnings), "out": None if out is None else str(out)}
    for warning in warnings:
        print(f"frogkick: warning: {warning}", file=sys.stderr)
    show(facts, json, _text(described, rods))


@app.command("frames")
def draw_frames(
    out: Annotated[Path, typer.Option(help="Picture to write (.png, .svg or .pdf).")],
    json: JsonOption = False,
) -> None:
    """Draw the frames and units that files, options and logs speak in: pool, robot, tag, heights."""
    require_writable(out)
    from frogkick.report.frames_figure import UNITS, write_frames_figure

    write_frames_figure(out)
    show({"out": str(out), "units": {what: unit for what, unit, _ in UNITS}}, json)


def _limb_names(robot: Robot, mask: int) -> list[str]:
    return [limb.name for i, limb in enumerate(robot.limbs) if mask >> i & 1]


def _facts(robot: Robot, rods: Rods) -> dict[str, Any]:
    import numpy as np

    mesh = rods.mesh
    corners = np.array(robot.frame.corners_m)
    guard = robot.guard
    return {
        "id": robot.id,
        "title": robot.title,
        "sha256": robot.sha256.hex(),
        "limbs": [
            {
                "index": i,
                "name": limb.name,
                "corner": limb.corner,
                "root_m": list(robot.frame.corners_m[limb.corner]),
                "direction_rad": limb.direction_rad,
                "length_m": limb.length_m,
                "rest_curvature_per_m": limb.rest_curvature_per_m,
                "actions": [a.name for a in robot.actions if (a.first_mask | a.second_mask) >> i & 1],
            }
            for i, limb in enumerate(robot.limbs)
        ],
        "actions": [
            {
                "name": a.name,
                "first": _limb_names(robot, a.first_mask),
                "second": _limb_names(robot, a.second_mask),
            }
            for a in robot.actions
        ],
        "nodes": len(mesh.rest_m),
        "mass_kg": robot.mass_kg,
        "sizes": {
            "length_m": float(np.ptp(mesh.rest_m[:, 0])),
            "width_m": float(np.ptp(mesh.rest_m[:, 1])),
            "frame_length_m": float(np.ptp(corners[:, 0])),
            "frame_width_m": float(np.ptp(corners[:, 1])),
            "segment_min_m": float(mesh.edge_length_m.min()),
            "segment_max_m": float(mesh.edge_length_m.max()),
            "mass_with_water_kg": float(mesh.mass_kg.sum()),
            "centre_m": (corners[0] - mesh.rest_m[0]).tolist(),
        },
        "limits": {
            "pulse_max_s": guard.pulse_max_s,
            "rest_min_s": guard.rest_min_s,
            "duty_max": guard.duty_max,
            "duty_window_s": guard.duty_window_s,
            "limbs_at_once_max": guard.limbs_at_once_max,
        },
        "period_s": robot.period_s,
        "pulse_s": robot.pulse_s,
    }


def _text(robot: Robot, rods: Rods) -> str:
    facts = _facts(robot, rods)
    sizes, guard = facts["sizes"], robot.guard
    lines = [
        f"{robot.id}: {robot.title}",
        f"{facts['nodes']} nodes, segments {1e3 * sizes['segment_min_m']:.2f} to "
        f"{1e3 * sizes['segment_max_m']:.2f} mm",
        f"{1e3 * robot.mass_kg:.0f} g; {1e3 * sizes['length_m']:.0f} mm long, "
        f"{1e3 * sizes['width_m']:.0f} mm wide at rest",
        f"a stroke each {robot.period_s:g} s, pulses of {1e3 * robot.pulse_s:g} ms",
        f"guard: pulses up to {1e3 * guard.pulse_max_s:g} ms, then {guard.rest_min_s:g} s of rest; "
        f"on for up to {100 * guard.duty_max:g} % of {guard.duty_window_s:g} s; "
        f"{guard.limbs_at_once_max} limbs at once",
    ]
    for limb in facts["limbs"]:
        x, y = (1e3 * value for value in limb["root_m"])
        place = f"corner {limb['corner']} at ({x:g}, {y:g}) mm"
        fired = "".join(limb["actions"]) or "none"
        lines.append(f"limb {limb['index']} {limb['name']}: {place}, actions {fired}")
    for action in facts["actions"]:
        first, second = (" ".join(action[group]) or "none" for group in ("first", "second"))
        lines.append(f"action {action['name']}: {first}; then {second}")
    return "\n".join(lines)
