"""From what a user calls a robot to a wire that leads to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import util

from frogkick.errors import InputError
from frogkick.link.frames import DELIMITER
from frogkick.link.wire import Target, Wire


@contextmanager
def opened(target: Target, greeting: bytes = DELIMITER) -> Iterator[Wire]:
    """A wire to a robot, let go of at the end.

    Args:
        target: where it is.
        greeting: what to send at each connect; another one where the robot's dialect is not this link's.

    Raises:
        WireError: it cannot be reached; the text says why.
        InputError: the package for that is not installed.
    """
    wire: Wire
    if target.kind == "ble":
        if util.find_spec("bleak") is None:
            raise InputError("ble: needs the package 'bleak', not installed: pip install 'frogkick[link]'")
        from frogkick.link.ble import BleWire

        wire = BleWire(target.place, greeting=greeting)
    else:
        from frogkick.link.serial import SerialWire

        wire = SerialWire(target.place, target.baud, greeting=greeting)
    try:
        yield wire
    finally:
        wire.close()
