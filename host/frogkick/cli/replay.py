"""``frogkick replay``: recorded fixes once more through the planner."""

from __future__ import annotations

import enum
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, progress_bar, show
from frogkick.cli.default_tables import default_tables
from frogkick.cli.places import (
    DepthOption,
    PlannerName,
    PlannerOption,
    plan_config,
    require_period,
    robot_of_table,
    simulated_robot,
)
from frogkick.loop.recorded import load_run
from frogkick.loop.replay import replay as replay_run
from frogkick.planner.image import read_image


class PlanWhere(enum.StrEnum):
    """Who decides."""

    onboard = "onboard"
    host = "host"
    both = "both"


def replay(
    run: Annotated[
        Path, typer.Argument(help="Log of ours (.h5) or a recorded run of the paper (line1.csv).")
    ],
    plan: Annotated[
        PlanWhere, typer.Option(help="The virtual chip, the twin on the host, or both.")
    ] = PlanWhere.both,
    tables: Annotated[
        Path | None, typer.Option(help="Table image (.fkt); default: one made from a small library.")
    ] = None,
    planner: PlannerOption = PlannerName.paper,
    depth: DepthOption = None,
    robot: Annotated[
        str, typer.Option(help="virtual: the chip; pool: the C core on this computer.")
    ] = "virtual",
    json: JsonOption = False,
) -> None:
    """Give a run's fixes to the planner again and compare every decision. Exit 1 on a mismatch."""
    recorded = load_run(run)
    image = tables if tables is not None else default_tables(recorded.robot_id)
    described = robot_of_table(image, recorded.robot_id)
    opened = read_image(image)
    require_period(opened, recorded)
    chip = nullcontext() if plan is PlanWhere.host else simulated_robot(robot, image, described)
    with chip as port, progress_bar("decisions") as progress:
        result = replay_run(
            recorded,
            opened,
            plan_config(described, planner, depth),
            port,
            plan is not PlanWhere.onboard,
            progress,
        )
    values: dict[str, Any] = {
        "decisions": len(result.actions),
        "actions": "".join(result.actions),
        "mismatches": len(result.differences),
        "recorded_actions": "".join(name or "?" for name in result.recorded),
        "agreement_with_recorded": result.agreement,
        "places": [place for place, made in (("onboard", result.onboard), ("host", result.host)) if made],
    }
    if result.differences:
        values["first_mismatch"] = {"decision": result.differences[0][0], "fields": result.differences[0][1]}
    show(values, json)
    if result.differences:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(replay)
