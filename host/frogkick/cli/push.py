"""``frogkick push``: a table to a robot by the link, and back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, show
from frogkick.errors import InputError

if TYPE_CHECKING:
    from frogkick.front.robots import Pushed


def text_of(pushed: Pushed, target: str) -> str:
    """For people."""
    if not pushed.bytes_sent:
        return f"{target} uses table {pushed.table_crc:08x}, which it had; keeps {pushed.kept_crc:08x}"
    return (
        f"{target} took {pushed.bytes_sent} bytes in {pushed.took_s:.1f} s and uses table "
        f"{pushed.table_crc:08x}; it keeps {pushed.kept_crc:08x}, to go back to: 'frogkick push --rollback "
        f"--robot {target}'"
    )


def command(
    robot: Annotated[
        str, typer.Option(metavar="TARGET", help="ble:NAME, ble:ADDRESS or serial:PORT[:BAUD].")
    ],
    tables: Annotated[Path | None, typer.Argument(help="Table image (.fkt).")] = None,
    rollback: Annotated[bool, typer.Option("--rollback", help="Back to the table before, instead.")] = False,
    json: JsonOption = False,
) -> None:
    """Give a robot another table, by radio or line. It is disarmed for it, and keeps the table before."""
    from frogkick.front.robots import connect, push_table, require_target

    require_target(robot)
    if rollback is (tables is not None):
        raise InputError("push takes a table image or --rollback: give one of them")
    if tables is not None:
        pushed = push_table(robot, tables, progress=True)
    else:
        with connect(robot) as bot:
            pushed = bot.roll_back()
    show(pushed.as_json(), json, text_of(pushed, robot))


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(name="push")(command)
