"""``frogkick study twin``: planners in the pool of a robot that was fitted to recorded runs."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.study_loop import PAPER_STATES, fit_own_table, library_of, shape_names, table_of_rows
from frogkick.files import require_writable, write_bytes
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.robot import Robot
    from frogkick.study.believed import Believed
    from frogkick.study.loop import Summary
    from frogkick.study.twin import Mean, Recorded

TWIN_STATES, TWIN_SAMPLING = 1000, "planned"
"""Of the library that is made of the fitted robot: in it limbs have a history, which its effects act by. A
table of as many rested ones is ten times further off where runs go."""


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
    from frogkick.library import quantise
    from frogkick.report.loop_figure import loop_figure
    from frogkick.robot import load_robot
    from frogkick.study.believed import believed_motions, image_of_motions
    from frogkick.study.kept import Case
    from frogkick.study.loop import PAPER, ROBOT, run_cases, summaries
    from frogkick.study.twin import (
        BELIEVED,
        DISTANCE_MOST_M,
        FULL,
        TWIN,
        body_of,
        mean_over,
        planners_of_twin,
        read_runs,
        require_related,
        world_of,
    )
    from frogkick_codegen.firmware import require_tools

    described, nominal = load_robot(robot), load_robot(model)
    setting = world_of(described)
    require_related(described, nominal)
    shapes = shape_names(path)
    recorded = [] if runs is None else read_runs(runs)
    require_tools("native")
    require_writable(out, folder=True)
    out.mkdir(parents=True, exist_ok=True)
    processes = workers or os.cpu_count() or 1
    images = {name: out / f"{name}.fkt" for name in (PAPER, FULL, ROBOT)}
    told = library_of(nominal, model_library, out / "model.h5", processes, PAPER_STATES)
    write_bytes(images[PAPER], quantise(told))
    own = library_of(described, library, out / "robot.h5", processes, TWIN_STATES, TWIN_SAMPLING)
    write_bytes(images[FULL], quantise(own))
    fit_own_table(own, images[ROBOT])
    believed = None
    if recorded:
        begin = told.displacement_body[told.whole_states()].mean(axis=0)
        believed = believed_motions([one.choices for one in recorded], nominal, begin)
        images[BELIEVED] = out / f"{BELIEVED}.fkt"
        write_bytes(images[BELIEVED], image_of_motions(nominal, believed.motion))
    planners = planners_of_twin(described, believed is not None)
    names = [planner.name for planner in planners]
    courses = [one.course for one in recorded]
    paths = [*shapes, *(course.name for course in courses)]
    cases = [Case(TWIN, one, name, seed) for one in paths for name in names for seed in range(seeds)]
    with progress_bar("runs") as progress:
        outcomes = run_cases(
            body_of(described), images, planners, [setting], cases, out, processes, progress, courses
        )
    rows = summaries(outcomes)
    marks = {one.course.name: (one.mean_distance_m, one.progress_mps) for one in recorded}
    figure = out / "twin.png"
    write_picture(loop_figure(outcomes, [TWIN], paths, names, marks), figure)
    groups = {"shapes": shapes, "recorded_paths": [course.name for course in courses]}
    over = {
        group: [mean_over(outcomes, name, some) for name in names] for group, some in groups.items() if some
    }
    distance_m = {group: means[-1].mean_distance_m for group, means in over.items()}
    passed = all(one <= DISTANCE_MOST_M for one in distance_m.values())
    values: dict[str, Any] = {
        "rows": [dataclasses.asdict(row) for row in rows],
        "over_paths": {group: [dataclasses.asdict(mean) for mean in means] for group, means in over.items()},
        "recorded": {name: dict(zip(_MEASURES, mark, strict=True)) for name, mark in marks.items()},
        "recorded_mean_distance_m": _mean_recorded(recorded),
        "believed": None if believed is None else _told(believed, nominal),
        "mean_distance_m": distance_m["shapes"],
        "limit_m": DISTANCE_MOST_M,
        "passed": passed,
        "seeds": seeds,
        "table_bytes": {name: image.stat().st_size for name, image in images.items()},
        "figure": str(figure),
    }
    text = _text(rows, over, recorded)
    text += [] if believed is None else _text_of(believed, nominal)
    text.append(f"the robot's planner {'is within' if passed else 'misses'} {1e3 * DISTANCE_MOST_M:g} mm")
    show(values, json, "\n".join(text))
    if not passed:
        raise typer.Exit(1)


_MEASURES = ("mean_distance_m", "progress_mps")


def _mean_recorded(recorded: Sequence[Recorded]) -> float | None:
    import numpy as np

    return float(np.mean([one.mean_distance_m for one in recorded])) if recorded else None


def _told(believed: Believed, robot: Robot) -> dict[str, Any]:
    motions = zip(robot.actions, believed.motion.tolist(), strict=True)
    return {
        "motion": {action.name: dict(zip(_MOTION, motion, strict=True)) for action, motion in motions},
        **{name: value for name, value in dataclasses.asdict(believed).items() if name != "motion"},
    }


_MOTION = ("forward_m", "left_m", "turn_rad")


def _text(rows: list[Summary], over: dict[str, list[Mean]], recorded: Sequence[Recorded]) -> list[str]:
    lines = table_of_rows(rows)
    lines += [
        f"{one.course.name}: recorded {1e3 * one.mean_distance_m:.1f} mm, {1e3 * one.progress_mps:.1f} mm/s"
        for one in recorded
    ]
    wide = max(len(row.planner) for row in rows)
    for group, means in over.items():
        lines.append(f"{group.replace('_', ' ')}, which weigh alike:")
        lines += [
            f"  {mean.planner:{wide}s}  {1e3 * mean.mean_distance_m:6.2f} mm, "
            f"{1e3 * mean.progress_mps:5.1f} mm/s, {100 * mean.completed:3.0f} % completed"
            + (f", {100 * mean.skipped:.0f} % from start to end at once" if mean.skipped else "")
            for mean in means
        ]
    mean_m = _mean_recorded(recorded)
    return lines if mean_m is None else [*lines, f"  {'recorded':{wide}s}  {1e3 * mean_m:6.2f} mm"]


def _text_of(believed: Believed, robot: Robot) -> list[str]:
    return [
        f"of {believed.decisions} recorded decisions the paper's planner makes "
        f"{100 * believed.agreement:.0f} % ({100 * believed.held_out_agreement:.0f} % in runs left out; "
        f"{100 * believed.nominal_agreement:.0f} % with the model's mean motions) where it believes:",
        *(
            f"  {action.name}: {100 * forward:5.2f} cm forward, {100 * left:5.2f} cm left, "
            f"{math.degrees(turn):6.1f} deg"
            for action, (forward, left, turn) in zip(robot.actions, believed.motion, strict=True)
        ),
    ]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(twin)
