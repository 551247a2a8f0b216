"""``frogkick scan``: robots in range; ``push``: a table to one, and back; ``own``: who may command it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, say, show
from frogkick.cli.options import KeyOption
from frogkick.core.errors import InputError

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
    key: KeyOption = None,
    json: JsonOption = False,
) -> None:
    """Give a robot another table, by radio or line. It is disarmed for it, and keeps the table before."""
    from frogkick.front.robots import connect, push_table, require_target

    require_target(robot)
    if rollback is (tables is not None):
        raise InputError("push takes a table image or --rollback: give one of them")
    if tables is not None:
        pushed = push_table(robot, tables, progress=True, key=key)
    else:
        with connect(robot, key) as bot:
            pushed = bot.roll_back()
    show(pushed.as_json(), json, text_of(pushed, robot))


def own(
    robot: Annotated[
        str, typer.Option(metavar="TARGET", help="ble:NAME, ble:ADDRESS or serial:PORT[:BAUD].")
    ],
    key: Annotated[
        Path | None,
        typer.Option(help="File of the key, made where it is not there; default: owner.key of the user."),
    ] = None,
    release: Annotated[
        bool, typer.Option("--release", help="Instead, let anybody command the robot again.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Let a robot take commands from its owner alone: from who has a key. DISARM and STOP never need it.

    The key is made on this computer. Keep a copy: without it the chip is to be erased and flashed. It goes
    to the robot as it is, so give it over a line, or a radio link that is paired.
    """
    from frogkick.front.robots import connect, default_key_file, require_target

    require_target(robot)
    with connect(robot, key) as bot:
        bot.own(release)
    file = key or default_key_file()
    text = (
        f"{robot} takes commands from anybody"
        if release
        else f"{robot} takes commands from who has the key in {file}: keep a copy of it"
    )
    show({"robot": robot, "owned": not release, "key": None if release else str(file)}, json, text)


def scan(
    seconds: Annotated[float, typer.Option(help="How long to listen, 0.5 to 60.")] = 4.0,
    json: JsonOption = False,
) -> None:
    """Robots in range by Bluetooth, the strongest first: signal, table, state. Exit 1 where there is none.

    Each is connected to for a moment, and none is armed, disarmed or moved.
    """
    found = fk.scan(seconds)
    lines = []
    for one in found:
        told = one.error or (
            f"{one.robot}, table {one.table_crc:08x}, {one.state}{', has an owner' if one.owned else ''}"
        )
        lines.append(f"{one.target}  {one.signal_dbm} dBm  {told}")
    if found or json:
        show({"robots": [one.as_json() for one in found]}, json, "\n".join(lines))
    if not found:
        say(
            f"no robot advertises within {seconds:g} s: switch it on, charge it, bring it nearer, and "
            "disconnect other hosts from it"
        )
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(name="scan")(scan)
    app.command(name="push")(command)
    app.command(name="own")(own)
