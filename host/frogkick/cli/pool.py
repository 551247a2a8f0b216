"""``frogkick pool``: a simulated robot at a serial port, with a camera over it."""

from __future__ import annotations

import os
import select
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frogkick.cli.common import JsonOption, ModelOption, SeedOption, TablesOption, say, show
from frogkick.cli.run import WorldOption
from frogkick.core.errors import InputError

if TYPE_CHECKING:
    from frogkick.front.serving import ServedPool

LOOK_S = 0.1


class Lines:
    """Lines of standard input as they come; none of a terminal in whose background this program runs."""

    def __init__(self) -> None:
        self._number = sys.stdin.fileno()
        self._is_open, self._rest = True, b""

    def wait(self, timeout_s: float) -> list[str]:
        """Return whole lines, after this time at the latest."""
        if not self._is_open or not self._is_mine():
            time.sleep(timeout_s)
            return []
        if not select.select([self._number], [], [], timeout_s)[0]:
            return []
        read = os.read(self._number, 4096)
        self._is_open = bool(read)
        *lines, self._rest = (self._rest + read).split(b"\n")
        return [line.decode("utf-8", "replace") for line in lines if line.strip()]

    def _is_mine(self) -> bool:
        return not os.isatty(self._number) or os.tcgetpgrp(self._number) == os.getpgrp()


def command(
    tables: TablesOption = None,
    model: ModelOption = None,
    virtual: Annotated[
        bool,
        typer.Option(
            "--virtual",
            help="Run the robot's firmware on the virtual chip, instead of its C core on this computer.",
        ),
    ] = False,
    world: WorldOption = None,
    camera: Annotated[
        Path | None,
        typer.Option(
            help="Calibration (.toml) whose camera, pool and tag are rendered; default: 640 x 480 px of a "
            "pool of 1.2 x 0.9 m, 1.35 m above the water, tag36h11 number 0 of 47 mm, 12 mm above the water."
        ),
    ] = None,
    begin: Annotated[
        str | None,
        typer.Option(
            help="Where the robot lies at first: X,Y,DEG (m, degrees); default: on the left, along x."
        ),
    ] = None,
    flash: Annotated[
        Path | None,
        typer.Option(
            help="File that keeps the robot's flash: tables and owner's key. It is read first if it is there."
        ),
    ] = None,
    line: Annotated[
        Path | None,
        typer.Option(help="Name for the serial port, made as a link; default: the system's name."),
    ] = None,
    port: Annotated[int, typer.Option(help="TCP port of the camera's pictures; 0: a free one.")] = 0,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Serve a simulated robot in real time: a serial port for --robot, and a camera's pictures for --source.

    It stands in for a robot in water in all commands that talk with one, until Ctrl-C. The pictures show the
    pool with the robot's tag; they are rendered only while somebody looks. Lines on standard input change
    what happens: put [X,Y,DEG], hide, show, mirror, unplug, plug, restart. Windows has no pseudo-terminals,
    which the serial port needs.
    """
    from frogkick.front.serving import served_pool

    began_s = time.monotonic()
    with (
        served_pool(
            tables,
            model=model,
            robot="virtual" if virtual else "pool",
            world=world,
            camera=camera,
            begin=begin,
            flash=flash,
            line=line,
            port=port,
            seed=seed,
        ) as pool,
        suppress(KeyboardInterrupt),
    ):
        show(pool.as_json(), json)
        sys.stdout.flush()
        _serve(pool)
    kept = "" if flash is None else f", and the robot's flash is in {flash}"
    say(f"the pool is closed after {time.monotonic() - began_s:.0f} s{kept}")


def _serve(pool: ServedPool) -> None:
    lines = Lines()
    while True:
        for text in lines.wait(LOOK_S):
            try:
                say(pool.act(text))
            except InputError as error:
                say(str(error))
        pool.look_after()
