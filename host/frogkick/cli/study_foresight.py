"""``frogkick study foresight``: what a path leaves any plan to win."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.options import TablesOption
from frogkick.errors import InputError
from frogkick.files import require_writable
from frogkick.progress import progress_bar


def foresight(
    path: Annotated[str, typer.Option(help="A shape's name or a path file.")] = "sine",
    tables: TablesOption = None,
    at_least: Annotated[
        float | None, typer.Option(help="Progress that a plan has to make, m/s: tells the nearest such one.")
    ] = None,
    breadth: Annotated[int, typer.Option(min=1, max=5000, help="Plans kept for each part of it.")] = 300,
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    json: JsonOption = False,
) -> None:
    """How near to a path any plan could stay, and how fast: the whole run planned at once, by the table.

    No noise, no delay, no limit of time or memory. A planner on the robot stays further off; by how much
    more tells what it misses, and the rest is what the path asks of the robot.
    """
    from frogkick.front.places import start_pose, swim_path, table_image
    from frogkick.planner.image import read_image
    from frogkick.report.foresight_figure import foresight_figure
    from frogkick.study.foresight import foresee, nearest_at

    require_writable(out)
    if at_least is not None and not (math.isfinite(at_least) and at_least >= 0.0):
        raise InputError(f"--at-least {at_least} m/s: give a speed from 0 on")
    course = swim_path(path)
    opened = read_image(table_image(tables, None))
    with progress_bar("decisions ahead") as progress:
        plans = foresee(opened, course, start_pose(course), breadth, progress)
    if out is not None:
        write_picture(foresight_figure(course, plans), out)
    rows = [
        {
            "decisions": len(plan.actions),
            "mean_distance_m": plan.mean_distance_m,
            "progress_mps": plan.progress_mps,
            "actions": [opened.actions[action].name for action in plan.actions],
        }
        for plan in plans
    ]
    values: dict[str, Any] = {"path": path, "plans": rows}
    if at_least is not None:
        values |= {"at_least_mps": at_least, "nearest_m": nearest_at(plans, at_least)}
    show(values, json, _text(values))


def _text(values: dict[str, Any]) -> str:
    lines = [
        f"{row['decisions']:3d} decisions: {1e3 * row['mean_distance_m']:6.2f} mm, "
        f"{1e3 * row['progress_mps']:5.1f} mm/s, {' '.join(row['actions'])}"
        for row in values["plans"]
    ]
    if "nearest_m" in values:
        nearest_m, speed = values["nearest_m"], 1e3 * values["at_least_mps"]
        told = f"{1e3 * nearest_m:.2f} mm" if nearest_m is not None else "no plan is so fast"
        lines.append(f"at {speed:.1f} mm/s or more: {told}")
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(foresight)
