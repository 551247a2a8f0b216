"""``frogkick log fetch`` and ``log replay``: what a robot wrote down in its RAM, and decided again."""

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
    out: Annotated[Path, typer.Option(help="File (.h5) to write.")],
    json: JsonOption = False,
) -> None:
    """Fetch what a robot wrote down in its RAM; in a run or after it, also after a reset. Changes nothing."""
    from frogkick.front.replaying import fetch_log

    show({**fetch_log(robot, out, progress=True).summary(), "out": str(out)}, json)


def replay(
    file: Annotated[Path, typer.Argument(help="File that 'log fetch' wrote.")],
    tables: TablesOption = None,
    model: ModelOption = None,
    json: JsonOption = False,
) -> None:
    """Decide a robot's log again, by the C core and the Python twin, bit by bit. Exit 1 on a mismatch."""
    from frogkick.front.replaying import replay_log

    found = replay_log(file, tables=tables, model=model, progress=True)
    show(found.as_json(), json)
    if found.result.mismatches:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(fetch)
    app.command()(replay)
