"""``frogkick study estimator``: states from fixes, compared."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.options import DepthOption, PlannerName, PlannerOption, TablesOption
from frogkick.files import require_writable
from frogkick.progress import progress_bar

if TYPE_CHECKING:
    from frogkick.study.estimator import Condition, Outcome

_PathsOption = Annotated[list[str] | None, typer.Option("--path", help="line, sine, ellipse, or a CSV file.")]
_RatesOption = Annotated[
    list[float] | None, typer.Option("--rate", help="Fixes per second; may be repeated.")
]


def estimator(
    tables: TablesOption = None,
    model: Annotated[str | None, typer.Option(help="Robot TOML or name; default: the table's robot.")] = None,
    path: _PathsOption = None,
    rate: _RatesOption = None,
    planner: PlannerOption = PlannerName.robot,
    depth: DepthOption = None,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Runs along each path.")] = 3,
    simulated_time: Annotated[float, typer.Option(help="Longest pool time of a run, s.")] = 60.0,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0: one for each core.")] = 1,
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    json: JsonOption = False,
) -> None:
    """States from late, lost, doubled and wrong fixes in the pool: the robot's way, a line, the paper's."""
    from frogkick.front.places import plan_config, robot_of_table, swim_path, table_image
    from frogkick.loop.closed_loop import require_time
    from frogkick.report.estimator_figure import estimator_figure
    from frogkick.study.estimator import RATES_HZ, compare_estimators

    require_writable(out)
    require_time(simulated_time)
    image = table_image(tables, model)
    described = robot_of_table(image, model)
    paths = [swim_path(name) for name in path or ("line", "ellipse")]
    config = plan_config(described, planner.value, depth)
    processes = workers or os.cpu_count() or 1
    with progress_bar("runs") as progress:
        outcomes = compare_estimators(
            described,
            image.read_bytes(),
            paths,
            config,
            seeds,
            simulated_time,
            rate or RATES_HZ,
            processes,
            progress,
        )
    if out is not None:
        write_picture(estimator_figure(outcomes), out)
    rows = [
        {"rate_hz": condition.rate_hz, "fault": condition.fault, "method": method, **dataclasses.asdict(one)}
        for condition, methods in outcomes.items()
        for method, one in methods.items()
    ]
    show({"outcomes": rows, "seeds": seeds}, json, _table(outcomes))


def _table(outcomes: Mapping[Condition, Mapping[str, Outcome]]) -> str:
    lines = ["fixes/s fault    method        mm  degrees     mm/s  unknown  mm from each path"]
    for condition, methods in outcomes.items():
        for method, one in methods.items():
            numbers = (one.position_m * 1e3, math.degrees(one.heading_rad), one.velocity_mps * 1e3)
            away = " ".join(f"{name} {1e3 * far:.1f}" for name, far in one.distance_m.items())
            lines.append(
                f"{condition.rate_hz:7g} {condition.fault:8} {method:10}"
                + "".join(f"{number:9.2f}" for number in numbers)
                + f"{one.unknown:5d}/{one.decisions}  {away}"
            )
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(estimator)
