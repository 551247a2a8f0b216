"""``frogkick study loop``: planners compared in the simulated pool."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, progress_bar, require_writable, show
from frogkick.errors import InputError
from frogkick.files import atomic_path, write_bytes
from frogkick.library import build_library, fit_table, quantise, read_library
from frogkick.paths import OTHER_SHAPES, SHAPES
from frogkick.report.loop_figure import loop_figure
from frogkick.robot import Robot, load_robot
from frogkick.study.loop import (
    PAPER,
    ROBOT,
    WORLDS,
    Case,
    Summary,
    over_paths,
    planners_of,
    run_cases,
    summaries,
)

PAPER_STATES = 8503
ROBOT_BYTES = 64 * 1024


def loop(
    out: Annotated[Path, typer.Option(help="Folder for tables, results and figure; resumes there.")],
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Runs of each, by the camera's noise.")] = 20,
    more: Annotated[bool, typer.Option("--more", help="Circle, bends and eight besides.")] = False,
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

    Exit 1 where the robot's planner is not at most half as far off as the paper's at no less progress, over
    the paper's three paths, or looking ahead does not pay.
    """
    described = load_robot(robot)
    require_writable(out, folder=True)
    processes = workers or os.cpu_count() or 1
    images = {PAPER: out / "paper.fkt", ROBOT: out / "robot.fkt" if tables is None else tables}
    _make_tables(described, out, library, tables, images, processes)
    planners = planners_of(described)
    paths = [*SHAPES, *(OTHER_SHAPES if more else ())]
    cases = [
        Case(world, path, planner.name, seed)
        for world in WORLDS
        for path in paths
        for planner in planners
        for seed in range(seeds)
    ]
    with progress_bar("runs") as progress:
        outcomes = run_cases(described, images, planners, cases, out, processes, progress)
    names = [planner.name for planner in planners]
    figure = out / "loop.png"
    with atomic_path(figure) as temporary:
        loop_figure(outcomes, list(WORLDS), paths, names).savefig(temporary, format="png", dpi=120)
    rows = summaries(outcomes)
    verdicts = {world: _verdict(rows, world, names) for world in WORLDS}
    values = {
        "rows": [_row(row) for row in rows],
        "over_three_paths": verdicts,
        "seeds": seeds,
        "table_bytes": {name: image.stat().st_size for name, image in images.items()},
        "figure": str(figure),
    }
    show(values, json, _text(rows, verdicts))
    if not all(verdict["passed"] for verdict in verdicts.values()):
        raise typer.Exit(1)


def _make_tables(
    robot: Robot, out: Path, library: Path | None, tables: Path | None, images: dict[str, Path], workers: int
) -> None:
    source = out / "library.h5" if library is None else library
    if library is None and not source.exists():
        with progress_bar("library") as progress:
            build_library(robot, PAPER_STATES, 0, workers, source, progress, record_s=0.0)
    read = read_library(source)
    if _swimmer(read.robot()) != _swimmer(robot):
        raise InputError(f"library {source.name!r} is not of robot {robot.id!r} as it is now: build it again")
    write_bytes(images[PAPER], quantise(read))
    if tables is None:
        with progress_bar("robot's table") as progress:
            write_bytes(images[ROBOT], fit_table(read, "affine", ROBOT_BYTES, progress).image)


def _swimmer(robot: Robot) -> Robot:
    """A robot without its planner, which changes nothing in a library."""
    return dataclasses.replace(robot, planner=None, toml="", sha256=b"")  # type: ignore[arg-type]


def _verdict(rows: list[Summary], world: str, names: list[str]) -> dict[str, Any]:
    paths = list(SHAPES)
    distance, progress = {}, {}
    for name in names:
        distance[name], progress[name] = over_paths(rows, world, name, paths)
    robot = names[2:]
    ratio = {name: distance[name] / distance["paper"] for name in names}
    ahead = min(distance[name] for name in robot[1:])
    return {
        "mean_distance_m": distance,
        "progress_mps": progress,
        "ratio_to_paper": ratio,
        "passed": ratio[robot[-1]] <= 0.5
        and progress[robot[-1]] >= progress["paper"]
        and ahead <= distance[robot[0]],
    }


def _row(row: Summary) -> dict[str, Any]:
    return {
        "world": row.world,
        "path": row.path,
        "planner": row.planner,
        "mean_distance_m": row.mean_distance_m,
        "deviation_m": row.deviation_m,
        "progress_mps": row.progress_mps,
        "completed": row.completed,
    }


def _text(rows: list[Summary], verdicts: dict[str, dict[str, Any]]) -> str:
    lines = [
        f"{row.world:8s} {row.path:8s} {row.planner:15s} {1e3 * row.mean_distance_m:6.1f} "
        f"+- {1e3 * row.deviation_m:4.1f} mm, {1e3 * row.progress_mps:5.1f} mm/s, "
        f"{100 * row.completed:3.0f} % completed"
        for row in rows
    ]
    for world, verdict in verdicts.items():
        ratios = ", ".join(f"{name} {ratio:.2f}" for name, ratio in verdict["ratio_to_paper"].items())
        passed = "passed" if verdict["passed"] else "not passed"
        lines.append(f"{world}: over three paths {ratios} of the paper's distance: {passed}")
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(loop)
