"""``frogkick push``: a table to a robot by the link, and back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from frogkick.cli.common import JsonOption, progress_bar, show
from frogkick.cli.places import robot_of_table, simulated_robot
from frogkick.errors import InputError, nearest_name
from frogkick.link.opening import opened
from frogkick.link.wire import is_target, parse_target
from frogkick.loop.lab_session import lab_session
from frogkick.loop.pushing import Pushed, push, roll_back
from frogkick.loop.session import Session
from frogkick.planner.image import read_image

VIRTUAL = "virtual"


def require_target(target: str, others: tuple[str, ...] = ()) -> None:
    """Refuse a place where no robot takes tables.

    Args:
        target: where the robot is.
        others: what is possible besides ``ble:NAME`` and ``serial:PORT``.

    Raises:
        InputError: none of these.
    """
    if target in others:
        return
    if not is_target(target):
        raise InputError(
            f"robot {target!r}{nearest_name(target, ('ble', 'serial', *others))} takes no tables: "
            f"choose {', '.join(('ble:NAME', 'serial:PORT', *others))}"
        )
    parse_target(target)


@contextmanager
def session_at(target: str, carried: Path | None) -> Iterator[Session]:
    """A session with a robot.

    Args:
        target: as of ``require_target``.
        carried: table that a virtual robot is switched on with; others know their own.

    Raises:
        WireError: it cannot be reached.
    """
    if target != VIRTUAL:
        with opened(parse_target(target)) as wire:
            yield lab_session(wire)
        return
    assert carried is not None
    with simulated_robot(VIRTUAL, carried, robot_of_table(carried, None)) as port:
        yield Session(port)


def push_tables(target: str, tables: Path, carried: Path | None = None) -> Pushed:
    """Send a table image to a robot.

    Args:
        target: where the robot is.
        tables: to send.
        carried: what it must carry now, if that matters; a virtual robot is switched on with it.
    """
    image = read_image(tables)
    before = None if carried is None else read_image(carried)
    with session_at(target, carried) as session, progress_bar("bytes sent") as progress:
        return push(session, image, before, progress)


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
    require_target(robot)
    if rollback is (tables is not None):
        raise InputError("push takes a table image or --rollback: give one of them")
    if tables is not None:
        pushed = push_tables(robot, tables)
    else:
        with session_at(robot, None) as session:
            pushed = roll_back(session)
    show(pushed.as_json(), json, text_of(pushed, robot))


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(name="push")(command)
