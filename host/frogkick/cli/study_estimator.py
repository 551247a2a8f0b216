"""``frogkick study estimator``: states from fixes, compared."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, show, write_picture
from frogkick.cli.options import DepthOption, ModelOption, PlannerName, PlannerOption, TablesOption
from frogkick.core.files import require_writable

if TYPE_CHECKING:
    from frogkick_studies.input_studies import Condition, Outcome

_PathsOption = Annotated[
    list[str] | None, typer.Option("--path", help="line, sine, ellipse, or a CSV file as for 'run'.")
]
_RatesOption = Annotated[
    list[float] | None, typer.Option("--rate", help="Fixes per second; may be repeated.")
]


def estimator(
    tables: TablesOption = None,
    model: ModelOption = None,
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
    from frogkick_studies.input_studies import RATES_HZ, study_estimator

    require_writable(out)
    found = study_estimator(
        tables,
        robot=model,
        paths=path or ("line", "ellipse"),
        rates_hz=rate or RATES_HZ,
        planner=planner.value,
        depth=depth,
        seeds=seeds,
        time_limit_s=simulated_time,
        workers=workers or None,
        progress=True,
    )
    if out is not None:
        write_picture(found.plot(), out)
    show(found.as_json(), json, _table(found.outcomes))


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
