"""Robots to talk with: ``pool`` serves a simulated one; ``scan``, ``push`` and ``own`` are for real ones."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import frogkick as fk
from frogkick.cli import options as opt
from frogkick.cli.common import Result, say
from frogkick.core.errors import InputError

if TYPE_CHECKING:
    from frogkick.front.robots import Pushed
    from frogkick.front.serving import ServedPool

LOOK_S = 0.1


def _lines() -> Iterator[list[str]]:
    """Yield the lines that came on standard input, after LOOK_S at the latest.

    None are read from a terminal in whose background this program runs.
    """
    number, is_open, rest = sys.stdin.fileno(), True, b""
    while True:
        if not is_open or (os.isatty(number) and os.tcgetpgrp(number) != os.getpgrp()):
            time.sleep(LOOK_S)
            yield []
        elif not select.select([number], [], [], LOOK_S)[0]:
            yield []
        else:
            read = os.read(number, 4096)
            is_open = bool(read)
            *lines, rest = (rest + read).split(b"\n")
            yield [line.decode("utf-8", "replace") for line in lines if line.strip()]


def serve_pool(
    tables: opt.Tables = None,
    model: Annotated[opt.Swimmer, opt.With(names=opt.FILE)] = None,
    virtual: Annotated[
        bool, "Run the robot's firmware on the virtual chip, instead of its C core on this computer."
    ] = False,
    world: opt.World = None,
    camera: Annotated[
        Path | None,
        "Calibration (.toml) whose camera, pool and tag are rendered; default: 640 x 480 px of a pool of "
        "1.2 x 0.9 m, 1.35 m above the water, tag36h11 number 0 of 47 mm, 12 mm above the water.",
    ] = None,
    begin: Annotated[
        str | None, "Where the robot lies at first: X,Y,DEG (m, degrees); default: on the left, along x."
    ] = None,
    flash: Annotated[
        Path | None,
        "File of the robot's flash: tables and owner's key. It is read first if it exists.",
    ] = None,
    line: Annotated[
        Path | None, "Name for the serial port, made as a link; default: the system's name."
    ] = None,
    port: Annotated[int, "TCP port of the camera's pictures; 0: a free one."] = 0,
    seed: opt.Seed = 0,
) -> Iterator[Result]:
    """Serve a simulated robot in real time: a serial port for --robot, and a camera's pictures for --source.

    It stands in for a robot in water in all commands that talk with one, until Ctrl-C. The pictures show the
    pool with the robot's tag; they are rendered only while they are watched. Lines on standard input change
    what happens: put [X,Y,DEG], hide, show, mirror, unplug, plug, restart. Windows has no pseudo-terminals,
    which the serial port needs.
    """
    from frogkick.front.serving import served_pool

    began_s = time.monotonic()
    served = opt.call(served_pool, locals(), table=tables, robot="virtual" if virtual else "pool")
    with served as pool, suppress(KeyboardInterrupt):
        yield Result(pool.as_json())
        _serve(pool)
    kept = "" if flash is None else f", and the robot's flash is in {flash}"
    say(f"the pool is closed after {time.monotonic() - began_s:.0f} s{kept}")


def _serve(pool: ServedPool) -> None:
    for lines in _lines():
        for text in lines:
            try:
                say(pool.act(text))
            except InputError as error:
                say(str(error))
        pool.look_after()


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


def push(
    robot: opt.Target,
    tables: Annotated[Path | None, typer.Argument(help="Table image (.fkt).")] = None,
    rollback: Annotated[bool, "Return to the previous table instead."] = False,
    key: opt.Key = None,
) -> Result:
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
    return Result(pushed.as_json(), [text_of(pushed, robot)])


def own(
    robot: opt.Target,
    key: Annotated[
        Path | None, "Key file, which is made if it does not exist; default: the user's owner.key."
    ] = None,
    release: Annotated[bool, "Let anybody command the robot again."] = False,
    again: Annotated[
        bool, "Give a new key to a robot that says that it has none, although the file holds one for it."
    ] = False,
) -> Result:
    """Restrict a robot to the commands of its owner, who has a key. DISARM and STOP never need the key.

    The key is made on this computer, for this robot alone, and added to the key file. Keep a copy of the
    file: without the key the chip must be erased and flashed. The key is sent unencrypted, so use a serial
    line or a paired radio link.
    """
    from frogkick.front.robots import connect, default_key_file, require_target

    require_target(robot)
    if release and again:
        raise InputError("own takes either --release or --again: give one of the two")
    with connect(robot, key) as bot:
        bot.own(release, again)
    file = key or default_key_file()
    text = (
        f"{robot} accepts commands from anybody"
        if release
        else f"{robot} accepts commands only with the key in {file}: keep a copy of it"
    )
    return Result({"robot": robot, "owned": not release, "key": None if release else str(file)}, [text])


def scan(seconds: Annotated[float, "Time to listen, 0.5 to 60."] = 4.0) -> Result:
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
    none = (
        f"no robot advertises within {seconds:g} s: switch it on, charge it, bring it nearer, and "
        "disconnect other hosts from it"
    )
    return Result({"robots": [one.as_json() for one in found]}, lines, bool(found), [] if found else [none])
