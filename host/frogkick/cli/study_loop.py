"""``frogkick study loop``: planners compared in the simulated pool."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.errors import InputError
from frogkick.files import require_writable, write_bytes
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.library import Library
    from frogkick.robot import Robot
    from frogkick.study.loop import Summary, Verdict

PAPER_STATES = 8503
ROBOT_BYTES = 64 * 1024


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
    robot: Annotated[str, typer.Option(help="TOML file or built-in name.")] = "frog2022",
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
    from frogkick.library import quantise
    from frogkick.report.loop_figure import loop_figure
    from frogkick.robot import load_robot
    from frogkick.study.kept import Case
    from frogkick.study.loop import (
        HIDDEN,
        NOMINAL,
        PAPER,
        ROBOT,
        judge,
        planners_of,
        run_cases,
        settings_of,
        summaries,
    )
    from frogkick_codegen.firmware import require_tools

    described = load_robot(robot)
    settings = settings_of(world or [NOMINAL.name, HIDDEN.name], described)
    paths = shape_names(path)
    require_tools("native")
    require_writable(out, folder=True)
    processes = workers or os.cpu_count() or 1
    images = {PAPER: out / "paper.fkt", ROBOT: out / "robot.fkt" if tables is None else tables}
    read = library_of(described, library, out / "library.h5", processes)
    write_bytes(images[PAPER], quantise(read))
    if tables is None:
        fit_own_table(read, images[ROBOT])
    planners = planners_of(described)
    cases = [
        Case(setting.name, name, planner.name, seed)
        for setting in settings
        for name in paths
        for planner in planners
        for seed in range(seeds)
    ]
    with progress_bar("runs") as progress:
        outcomes = run_cases(described, images, planners, settings, cases, out, processes, progress)
    worlds = [setting.name for setting in settings]
    figure = out / "loop.png"
    write_picture(loop_figure(outcomes, worlds, paths, [planner.name for planner in planners]), figure)
    rows = summaries(outcomes)
    verdicts = [judge(rows, name, planners, described.planner.depth) for name in worlds]
    values = {
        "rows": [dataclasses.asdict(row) for row in rows],
        "over_paths": {
            verdict.world: {**dataclasses.asdict(verdict), "passed": verdict.passed} for verdict in verdicts
        },
        "seeds": seeds,
        "table_bytes": {name: image.stat().st_size for name, image in images.items()},
        "figure": str(figure),
    }
    show(values, json, _text(rows, verdicts))
    if not all(verdict.passed for verdict in verdicts):
        raise typer.Exit(1)


def shape_names(given: list[str] | None) -> list[str]:
    """Names of shapes, each once, the paper's where none is given.

    Raises:
        InputError: no such shape.
    """
    from frogkick.paths import SHAPES, shape

    names = given or list(SHAPES)
    for name in names:
        shape(name)
    return list(dict.fromkeys(names))


def library_of(
    robot: Robot,
    given: Path | None,
    made: Path,
    workers: int,
    states: int = PAPER_STATES,
    sampling: str = "box",
) -> Library:
    """Read a library of a robot, or one made once.

    Args:
        robot: whose it has to be.
        given: its file, None for ``made``.
        made: written where it is not there yet, of ``states`` and ``sampling`` as for ``build_library``.
        workers: processes.

    Raises:
        InputError: it is of another robot, or of another version of it.
    """
    from frogkick.library import build_library, read_library

    source = made if given is None else given
    if given is None and not made.exists():
        with progress_bar(f"library {made.name}") as progress:
            build_library(robot, states, 0, workers, made, progress, sampling, record_s=0.0)
    read = read_library(source)
    if _swimmer(read.robot()) != _swimmer(robot):
        raise InputError(f"library {source.name!r} is not of {robot.title!r} as it is now: build it again")
    return read


def fit_own_table(library: Library, image: Path) -> None:
    """Write the affine table of 64 KiB of a library.

    Raises:
        InputError: it has too few states.
    """
    from frogkick.library import fit_table

    with progress_bar("robot's table") as progress:
        write_bytes(image, fit_table(library, "affine", ROBOT_BYTES, progress).image)


def _swimmer(robot: Robot) -> Robot:
    """A robot without its planner, which changes nothing in a library."""
    return dataclasses.replace(robot, planner=None, toml="", sha256=b"")  # type: ignore[arg-type]


def table_of_rows(rows: list[Summary]) -> list[str]:
    """A line of text for each."""
    wide = [max(len(getattr(row, name)) for row in rows) for name in ("world", "path", "planner")]
    return [
        f"{row.world:{wide[0]}s}  {row.path:{wide[1]}s}  {row.planner:{wide[2]}s}  "
        f"{1e3 * row.mean_distance_m:6.2f} +- {1e3 * row.deviation_m:5.2f} mm, "
        f"{1e3 * row.progress_mps:5.1f} mm/s, {100 * row.completed:3.0f} % completed"
        for row in rows
    ]


def _text(rows: list[Summary], verdicts: list[Verdict]) -> str:
    lines = table_of_rows(rows)
    wide = max(len(row.planner) for row in rows)
    for verdict in verdicts:
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
