"""``frogkick log fetch`` and ``log replay``: a robot's own log, and its decisions repeated."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, show
from frogkick.cli.options import ModelOption, TablesOption


def fetch(
    robot: Annotated[
        str, typer.Option(metavar="TARGET", help="ble:NAME, ble:ADDRESS or serial:PORT[:BAUD].")
    ],
    out: Annotated[Path, typer.Option(help="Log file to write (.h5).")],
    json: JsonOption = False,
) -> None:
    """Fetch the log that a robot keeps in its RAM.

    It can be fetched during a run, after it, and after a reset of the robot. Fetching changes nothing on the
    robot.
    """
    from frogkick.front.replaying import fetch_log

    show({**fetch_log(robot, out, progress=True).summary(), "out": str(out)}, json)


def replay(
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


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(fetch)
    app.command()(replay)
