"""Opens the wire to a robot, apart from ``wire.py``, which the kinds of wire import."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

from frogkick.core.errors import require
from frogkick.link.frames import DELIMITER
from frogkick.link.wire import Target, Wire


def require_wire(target: Target) -> None:
    """Raise InputError unless the package for a kind of wire is installed."""
    require(f"{target.kind}:", {"ble": "bleak", "serial": "serial"}[target.kind])


@contextmanager
def opened(target: Target, greeting: bytes = DELIMITER) -> Iterator[Wire]:
    """Open a wire to a robot, and close it at the end. ``greeting`` is sent at each connection."""
    require_wire(target)
    wire: Wire
    if target.kind == "ble":
        from frogkick.link.ble import BleWire

        wire = BleWire(target.place, greeting=greeting)
    else:
        from frogkick.link.serial import SerialWire

        wire = SerialWire(target.place, target.baud, greeting=greeting)
    with closing(wire):
        yield wire
