"""``frogkick replay``: the recorded fixes of a run, given to the planner again."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, show
from frogkick.cli.options import DepthOption, PlannerName, TablesOption


class PlanWhere(enum.StrEnum):
    """The place where decisions are made."""

    onboard = "onboard"
    host = "host"
    both = "both"


def replay(
    run: Annotated[
        Path,
        typer.Argument(help="Log of frogkick (.h5), or a recorded run of the paper (such as line1.csv)."),
    ],
    plan: Annotated[
        PlanWhere, typer.Option(help="Who decides: the virtual chip, its twin on the host, or both.")
    ] = PlanWhere.both,
    tables: TablesOption = None,
    planner: Annotated[
        PlannerName | None,
        typer.Option(
            help="Planner whose weights and depth are used; default: the run's own if its log has them, "
            "else paper."
        ),
    ] = None,
    depth: DepthOption = None,
    robot: Annotated[
        str, typer.Option(help="virtual: the chip; pool: the C core on this computer.")
    ] = "virtual",
    model: Annotated[
        str | None, typer.Option(help="Robot TOML file or built-in name; default: the run's robot.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Give a run's fixes to the planner again and compare every decision.

    The exit code is 1 if a decision differs.
    """
    from frogkick.front.replaying import replay as replay_run

    replayed = replay_run(
        run,
        plan=plan.value,
        table=tables,
        planner=planner and planner.value,
        depth=depth,
        robot=robot,
        model=model,
        progress=True,
    )
    show(replayed.as_json(), json)
    if replayed.mismatches:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(replay)
