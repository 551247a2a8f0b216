"""``frogkick study loop``: planners compared in the simulated pool."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.options import RobotFileOption

if TYPE_CHECKING:
    from frogkick_studies.planner_studies import PlannersCompared, Summary


def loop(
    out: Annotated[Path, typer.Option(help="Folder for tables, results and figure; resumes there.")],
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Runs of each, by the camera's noise.")] = 20,
    path: Annotated[
        list[str] | None,
        typer.Option(
            help="line, sine, ellipse, circle, bends or eight; again for more. Default: the first 3."
        ),
    ] = None,
    world: Annotated[
        list[str] | None,
        typer.Option(
            help="nominal: the plain pool; hidden: with a few effects that no model knows; or a TOML of such "
            "effects, as for 'run'. Again for more. Default: nominal and hidden."
        ),
    ] = None,
    robot: RobotFileOption = "frog2022",
    library: Annotated[
        Path | None, typer.Option(help="Library for both tables; default: one of 8503 states, made once.")
    ] = None,
    tables: Annotated[
        Path | None, typer.Option(help="Robot's own table; default: affine, 64 KiB, of that library.")
    ] = None,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0: one for each core.")] = 0,
    json: JsonOption = False,
) -> None:
    """Distance to the path and progress: the paper's planner against the robot's, depth 1 to 3.

    Exit 1 where, in a world and over all paths, the robot's planner is not at most half as far off as the
    paper's at no less progress, or depth 2 and 3 are both further off than depth 1.
    """
    from frogkick_studies.planner_studies import compare_planners

    found = compare_planners(
        out,
        robot=robot,
        paths=path,
        worlds=world,
        seeds=seeds,
        library=library,
        tables=tables,
        workers=workers or None,
        progress=True,
    )
    figure = out / "loop.png"
    write_picture(found.plot(), figure)
    show({**found.as_json(), "figure": str(figure)}, json, _text(found))
    if not found.passed:
        raise typer.Exit(1)


def table_of_rows(rows: Sequence[Summary]) -> list[str]:
    """A line of text for each."""
    wide = [max(len(getattr(row, name)) for row in rows) for name in ("world", "path", "planner")]
    return [
        f"{row.world:{wide[0]}s}  {row.path:{wide[1]}s}  {row.planner:{wide[2]}s}  "
        f"{1e3 * row.mean_distance_m:6.2f} +- {1e3 * row.deviation_m:5.2f} mm, "
        f"{1e3 * row.progress_mps:5.1f} mm/s, {100 * row.completed:3.0f} % completed"
        for row in rows
    ]


def _text(found: PlannersCompared) -> str:
    lines = table_of_rows(found.rows)
    wide = max(len(row.planner) for row in found.rows)
    for verdict in found.verdicts:
        lines.append(f"{verdict.world}, over all paths:")
        lines += [
            f"  {name:{wide}s}  {1e3 * distance_m:6.2f} mm ({verdict.ratio_to_paper[name]:.2f} of the "
            f"paper's), {1e3 * verdict.progress_mps[name]:5.1f} mm/s"
            for name, distance_m in verdict.mean_distance_m.items()
        ]
        lines += [f"  missed: {text}" for text in verdict.missed] or ["  all that was asked is so"]
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(loop)
