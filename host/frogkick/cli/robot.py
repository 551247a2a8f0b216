"""``frogkick robot``: which robots there are, what one looks like, and a file for a new one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, WholeLines, show, write_picture
from frogkick.core.files import require_writable

app = typer.Typer(
    cls=WholeLines,
    help="Which robots there are, what one looks like, and a file for a new one.",
    no_args_is_help=True,
)


@app.command("list")
def list_robots(json: JsonOption = False) -> None:
    """List the built-in robots."""
    names = fk.built_in_robots()
    robots = [fk.load_robot(name) for name in names]
    rows = [
        {
            "name": name,
            "title": robot.title,
            "limbs": len(robot.limbs),
            "actions": len(robot.actions),
            "period_s": robot.period_s,
        }
        for name, robot in zip(names, robots, strict=True)
    ]
    lines = [
        f"{row['name']}: {row['title']}; {row['limbs']} limbs, {row['actions']} actions, {row['period_s']} s"
        for row in rows
    ]
    show({"robots": rows}, json, "\n".join(lines))


@app.command("new")
def new(
    out: Annotated[Path, typer.Argument(help="TOML file to write; its name is the robot's id.")],
    base: Annotated[
        str, typer.Option("--from", help="Built-in name or TOML file to begin from.")
    ] = "frog2022",
    limbs: Annotated[int | None, typer.Option(help="The first so many of its limbs; default: all.")] = None,
    json: JsonOption = False,
) -> None:
    """Write a robot file to begin with: complete, with a comment on every key."""
    from frogkick.front.describing import write_new_robot

    robot = write_new_robot(out, base, limbs)
    told = {"id": robot.id, "limbs": len(robot.limbs), "actions": len(robot.actions), "out": str(out)}
    show(told, json)


@app.command("fit-stroke")
def fit_stroke(
    strokes: Annotated[
        list[Path],
        typer.Argument(
            help="CSV of one cycle each, from the pulse on: time_s,curvature_per_m or time_s,tip_x_m,tip_y_m "
            "(the tip seen from the root, x along the limb there)."
        ),
    ],
    out: Annotated[Path, typer.Option(help="TOML to write; a robot's profiles_file names it.")],
    egain_percent: Annotated[float, typer.Option(min=0.0, max=100.0, help="Of the limb's alloy.")] = 0.0,
    frequency_hz: Annotated[
        float | None, typer.Option(help="Strokes a second; default: one over each file's last time.")
    ] = None,
    length_m: Annotated[float | None, typer.Option(help="Of the limb, where its tip was tracked.")] = None,
    picture: Annotated[Path | None, typer.Option(help="PNG to write: strokes as measured, and fits.")] = None,
    json: JsonOption = False,
) -> None:
    """Fit limb profiles to measured strokes: how the curvature falls and comes back."""
    from frogkick.front.describing import fit_strokes

    require_writable(out)
    require_writable(picture)
    found = fit_strokes(strokes, egain_percent=egain_percent, frequency_hz=frequency_hz, length_m=length_m)
    found.save(out)
    if picture is not None:
        write_picture(found.plot(), picture)
    show({**found.as_json(), "out": str(out), "picture": picture and str(picture)}, json)


@app.command("show")
def show_robot(
    robot: Annotated[str, typer.Argument(help="TOML file or built-in name.")] = "frog2022",
    out: Annotated[Path | None, typer.Option(help="Picture to write (.png, .svg or .pdf).")] = None,
    json: JsonOption = False,
) -> None:
    """Say what a robot is and draw it as it is simulated: nodes, frame, limbs at rest and active.

    Lengths are those at rest. Doubts about its geometry or its limits are warnings.
    """
    from frogkick.front.describing import describe

    require_writable(out)
    described = describe(robot)
    if out is not None:
        from frogkick.report.robot_figure import write_robot_figure

        write_robot_figure(described.robot, out)
    for warning in described.warnings:
        print(f"frogkick: warning: {warning}", file=sys.stderr)
    facts, picture = described.as_json(), None if out is None else str(out)
    told = {**facts, "warnings": list(described.warnings), "out": picture}
    show(told, json, _text(described.robot, facts))


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


def _text(robot: fk.Robot, facts: dict[str, Any]) -> str:
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
        fired = " ".join(limb["actions"]) or "none"
        lines.append(f"limb {limb['index']} {limb['name']}: {place}, actions {fired}")
    for action in facts["actions"]:
        first, second = (" ".join(action[group]) or "none" for group in ("first", "second"))
        lines.append(f"action {action['name']}: {first}; then {second}")
    return "\n".join(lines)
