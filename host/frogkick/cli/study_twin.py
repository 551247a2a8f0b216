"""``frogkick study twin``: planners in the pool of a robot that was fitted to recorded runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.study_loop import table_of_rows

if TYPE_CHECKING:
    from frogkick_studies.planner_studies import TwinStudy


def twin(
    out: Annotated[Path, typer.Option(help="Folder for libraries, tables, results, figure; resumes there.")],
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Runs of each, by the camera's noise.")] = 6,
    path: Annotated[
        list[str] | None, typer.Option(help="line, sine, ellipse, ...; again for more. Default: these 3.")
    ] = None,
    runs: Annotated[
        Path | None,
        typer.Option(help="Folder of the paper's recorded runs: their paths too, from where they began."),
    ] = None,
    robot: Annotated[
        str, typer.Option(help="TOML file or built-in name; its effects are true in the pool.")
    ] = "frog2022-measured",
    model: Annotated[str, typer.Option(help="What the paper's planner takes it for.")] = "frog2022",
    library: Annotated[
        Path | None,
        typer.Option(help="Library of the robot; default: one of 1000 planned states, made once."),
    ] = None,
    model_library: Annotated[
        Path | None, typer.Option(help="Library of the model; default: one of 8503 states, made once.")
    ] = None,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0: one for each core.")] = 0,
    json: JsonOption = False,
) -> None:
    """The paper's planner and the robot's in the pool of a robot as its recorded runs show it.

    Exit 1 where the robot's planner, with its own table, is more than 10 mm off on average: over the shapes,
    or over the recorded runs' paths. With --runs the paper's planner also swims with what it believed of
    each action, as its recorded decisions show.
    """
    from frogkick_studies.planner_studies import compare_in_twin

    found = compare_in_twin(
        out,
        robot=robot,
        model=model,
        paths=path,
        runs=runs,
        seeds=seeds,
        library=library,
        model_library=model_library,
        workers=workers or None,
        progress=True,
    )
    figure = out / "twin.png"
    write_picture(found.plot(), figure)
    text = [*_text(found), *_text_of_believed(found)]
    text.append(f"the robot's planner {'is within' if found.passed else 'misses'} {1e3 * found.limit_m:g} mm")
    show({**found.as_json(), "figure": str(figure)}, json, "\n".join(text))
    if not found.passed:
        raise typer.Exit(1)


def _text(found: TwinStudy) -> list[str]:
    lines = table_of_rows(found.rows)
    lines += [
        f"{one.course.name}: recorded {1e3 * one.mean_distance_m:.1f} mm, {1e3 * one.progress_mps:.1f} mm/s"
        for one in found.recorded
    ]
    wide = max(len(row.planner) for row in found.rows)
    for group, means in found.over.items():
        lines.append(f"{group.replace('_', ' ')}, which weigh alike:")
        lines += [
            f"  {mean.planner:{wide}s}  {1e3 * mean.mean_distance_m:6.2f} mm, "
            f"{1e3 * mean.progress_mps:5.1f} mm/s, {100 * mean.completed:3.0f} % completed"
            + (f", {100 * mean.skipped:.0f} % from start to end at once" if mean.skipped else "")
            for mean in means
        ]
    mean_m = found.recorded_mean_distance_m
    return lines if mean_m is None else [*lines, f"  {'recorded':{wide}s}  {1e3 * mean_m:6.2f} mm"]


def _text_of_believed(found: TwinStudy) -> list[str]:
    believed = found.believed
    if believed is None:
        return []
    return [
        f"of {believed.decisions} recorded decisions the paper's planner makes "
        f"{100 * believed.agreement:.0f} % ({100 * believed.held_out_agreement:.0f} % in runs left out; "
        f"{100 * believed.nominal_agreement:.0f} % with the model's mean motions) where it believes:",
        *(
            f"  {action.name}: {100 * forward:5.2f} cm forward, {100 * left:5.2f} cm left, "
            f"{math.degrees(turn):6.1f} deg"
            for action, (forward, left, turn) in zip(found.nominal.actions, believed.motion, strict=True)
        ),
    ]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(twin)
