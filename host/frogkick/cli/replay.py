"""``frogkick replay``: recorded fixes once more through the planner."""

from __future__ import annotations

import enum
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from frogkick.cli.common import JsonOption, show
from frogkick.cli.options import DepthOption, PlannerName, TablesOption
from frogkick.errors import InputError
from frogkick.progress import progress_bar


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
    tables: TablesOption = None,
    planner: Annotated[
        PlannerName | None,
        typer.Option(
            help="Whose weights and depth; default: the run's own where its log has them, else paper."
        ),
    ] = None,
    depth: DepthOption = None,
    robot: Annotated[
        str, typer.Option(help="virtual: the chip; pool: the C core on this computer.")
    ] = "virtual",
    model: Annotated[str | None, typer.Option(help="Robot TOML or name; default: the run's robot.")] = None,
    json: JsonOption = False,
) -> None:
    """Give a run's fixes to the planner again and compare every decision. Exit 1 on a mismatch."""
    from frogkick.front.places import (
        plan_config,
        require_period,
        require_simulated,
        require_simulator,
        robot_of_table,
        simulated_robot,
        table_image,
    )
    from frogkick.loop.recorded import load_run
    from frogkick.loop.replay import replay as replay_run
    from frogkick.loop.replay import require_replayable
    from frogkick.planner.image import read_image

    (require_simulated if plan is PlanWhere.host else require_simulator)(robot)
    recorded = load_run(run)
    require_replayable(recorded)
    image = table_image(tables, recorded.robot_id)
    described = robot_of_table(image, recorded.robot_id if model is None else model)
    opened = read_image(image)
    if recorded.robot_id != described.id:
        raise InputError(f"run {recorded.source!r} is of robot {recorded.robot_id!r}, not {described.id!r}")
    require_period(opened, recorded)
    config = plan_config(described, planner and planner.value, depth, recorded)
    chip = nullcontext() if plan is PlanWhere.host else simulated_robot(robot, image, described)
    with chip as port, progress_bar("decisions") as progress:
        result = replay_run(
            recorded,
            opened,
            config,
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
        "depth": config.depth,
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
