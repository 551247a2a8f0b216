"""``frogkick study foresight``: what a path leaves any plan to win."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.options import TablesOption
from frogkick.core.files import require_writable


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
    from frogkick_studies.input_studies import study_foresight

    require_writable(out)
    found = study_foresight(path, tables=tables, at_least_mps=at_least, breadth=breadth, progress=True)
    if out is not None:
        write_picture(found.plot(), out)
    values = found.as_json()
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
