"""``frogkick replay``: a run's fixes planned again; ``log fetch`` and ``log replay``: a robot's own log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import (
    DepthOption,
    JsonOption,
    ModelOption,
    PlannerName,
    PlanWhere,
    TablesOption,
    TargetOption,
    show,
)


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


def fetch(
    robot: TargetOption,
    out: Annotated[Path, typer.Option(help="Log file to write (.h5).")],
    json: JsonOption = False,
) -> None:
    """Fetch the log that a robot keeps in its RAM.

    It can be fetched during a run, after it, and after a reset of the robot. Fetching changes nothing on the
    robot.
    """
    from frogkick.front.replaying import fetch_log

    show({**fetch_log(robot, out, progress=True).summary(), "out": str(out)}, json)


def replay_fetched(
    file: Annotated[Path, typer.Argument(help="Log file that 'log fetch' wrote.")],
    tables: TablesOption = None,
    model: ModelOption = None,
    json: JsonOption = False,
) -> None:
    """Repeat the decisions of a robot's log by the C core and by the Python twin, bit by bit.

    The exit code is 1 if a decision differs.
    """
    from frogkick.front.replaying import replay_log

    found = replay_log(file, tables=tables, model=model, progress=True)
    show(found.as_json(), json)
    if found.result.mismatches:
        raise typer.Exit(1)
