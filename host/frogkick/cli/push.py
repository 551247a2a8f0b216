"""``frogkick scan``: lists robots; ``push``: sends one a table; ``own``: sets who may command it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import frogkick as fk
from frogkick.cli.common import JsonOption, KeyOption, TargetOption, say, show
from frogkick.core.errors import InputError

if TYPE_CHECKING:
    from frogkick.front.robots import Pushed


def text_of(pushed: Pushed, target: str) -> str:
    """Return the result as text for people."""
    if not pushed.bytes_sent:
        return (
            f"{target} uses table {pushed.table_crc:08x}, which it already had, and keeps "
            f"{pushed.kept_crc:08x}"
        )
    return (
        f"{target} received {pushed.bytes_sent} bytes in {pushed.took_s:.1f} s and uses table "
        f"{pushed.table_crc:08x}; it keeps the previous table {pushed.kept_crc:08x}; to return to it: "
        f"'frogkick push --rollback --robot {target}'"
    )


def command(
    robot: TargetOption,
    tables: Annotated[Path | None, typer.Argument(help="Table image (.fkt).")] = None,
    rollback: Annotated[
        bool, typer.Option("--rollback", help="Return to the previous table instead.")
    ] = False,
    key: KeyOption = None,
    json: JsonOption = False,
) -> None:
    """Send a robot another table by Bluetooth or serial line. It is disarmed and keeps the previous table."""
    from frogkick.front.robots import connect, push_table, require_target

    require_target(robot)
    if rollback is (tables is not None):
        raise InputError("push takes either a table image or --rollback: give one of the two")
    if tables is not None:
        pushed = push_table(robot, tables, progress=True, key=key)
    else:
        with connect(robot, key) as bot:
            pushed = bot.roll_back()
    show(pushed.as_json(), json, text_of(pushed, robot))


def own(
    robot: TargetOption,
    key: Annotated[
        Path | None,
        typer.Option(help="Key file, which is made if it does not exist; default: the user's owner.key."),
    ] = None,
    release: Annotated[bool, typer.Option("--release", help="Let anybody command the robot again.")] = False,
    json: JsonOption = False,
) -> None:
    """Restrict a robot to the commands of its owner, who has a key. DISARM and STOP never need the key.

    The key is made on this computer. Keep a copy of it: without the key the chip must be erased and flashed.
    The key is sent unencrypted, so use a serial line or a paired radio link.
    """
    from frogkick.front.robots import connect, default_key_file, require_target

    require_target(robot)
    with connect(robot, key) as bot:
        bot.own(release)
    file = key or default_key_file()
    text = (
        f"{robot} accepts commands from anybody"
        if release
        else f"{robot} accepts commands only with the key in {file}: keep a copy of it"
    )
    show({"robot": robot, "owned": not release, "key": None if release else str(file)}, json, text)


def scan(
    seconds: Annotated[float, typer.Option(help="Time to listen, 0.5 to 60.")] = 4.0,
    json: JsonOption = False,
) -> None:
    """List the robots in Bluetooth range with signal, table and state, the strongest signal first.

    Each robot is connected to for a moment. None is armed, disarmed or moved. The exit code is 1 if no robot
    is found.
    """
    found = fk.scan(seconds)
    lines = []
    for one in found:
        state = one.error or (
            f"{one.robot}, table {one.table_crc:08x}, {one.state}{', has an owner' if one.owned else ''}"
        )
        lines.append(f"{one.target}  {one.signal_dbm} dBm  {state}")
    if found or json:
        show({"robots": [one.as_json() for one in found]}, json, "\n".join(lines))
    if not found:
        say(
            f"no robot advertises within {seconds:g} s: switch it on, charge it, bring it nearer, and "
            "disconnect other hosts from it"
        )
        raise typer.Exit(1)
