"""``frogkick robot``: lists and shows robots, and writes the file of a new one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, RobotArgument, WholeLines, show
from frogkick.core.files import require_writable
from frogkick.report.style import write_picture

app = typer.Typer(
    cls=WholeLines,
    help="List and show robots, and write the file of a new one.",
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
    out: Annotated[Path, typer.Argument(help="TOML file to write; its file name becomes the robot's id.")],
    base: Annotated[
        str, typer.Option("--from", help="Built-in name or TOML file to start from.")
    ] = "frog2022",
    limbs: Annotated[
        int | None, typer.Option(help="Number of limbs to keep, from the first; default: all.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Write a complete robot file to start from, with a comment on every key."""
    from frogkick.front.describing import write_new_robot

    robot = write_new_robot(out, base, limbs)
    facts = {"id": robot.id, "limbs": len(robot.limbs), "actions": len(robot.actions), "out": str(out)}
    show(facts, json)


@app.command("fit-stroke")
def fit_stroke(
    strokes: Annotated[
        list[Path],
        typer.Argument(
            help="CSV files, each of one cycle that starts with the pulse. Columns: time_s,curvature_per_m "
            "or time_s,tip_x_m,tip_y_m (position of the tip from the root, x along the limb at the root)."
        ),
    ],
    out: Annotated[Path, typer.Option(help="TOML file to write, for the key profiles_file of a robot.")],
    egain_percent: Annotated[
        float, typer.Option(min=0.0, max=100.0, help="EGaIn fraction of the limb's alloy, %.")
    ] = 0.0,
    frequency_hz: Annotated[
        float | None, typer.Option(help="Strokes per second; default: one over the last time of each file.")
    ] = None,
    length_m: Annotated[
        float | None, typer.Option(help="Length of the limb, needed if its tip was tracked.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="PNG to write, of the measured strokes and the fits.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Fit limb profiles to measured strokes: how the curvature falls and recovers."""
    from frogkick.front.describing import fit_strokes

    require_writable(out)
    require_writable(picture)
    found = fit_strokes(strokes, egain_percent=egain_percent, frequency_hz=frequency_hz, length_m=length_m)
    found.save(out)
    if picture is not None:
        write_picture(found.plot(), picture, ".png")
    show({**found.as_json(), "out": str(out), "picture": picture and str(picture)}, json)


@app.command("show")
def show_robot(
    robot: RobotArgument = "frog2022",
    out: Annotated[Path | None, typer.Option(help="Picture to write (.png, .svg or .pdf).")] = None,
    json: JsonOption = False,
) -> None:
    """Show a robot in numbers, and draw it as it is simulated: nodes, frame, limbs at rest and active.

    All lengths are those at rest. Doubtful geometry and doubtful limits are reported as warnings.
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
    values = {**facts, "warnings": list(described.warnings), "out": picture}
    show(values, json, _text(described.robot, facts))


@app.command("frames")
def draw_frames(
    out: Annotated[Path, typer.Option(help="Picture to write (.png, .svg or .pdf).")],
    json: JsonOption = False,
) -> None:
    """Draw the frames and units that files, options and logs use: pool, robot, tag and heights."""
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
        f"one stroke every {robot.period_s:g} s, pulses of {1e3 * robot.pulse_s:g} ms",
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
