"""From what a user calls a robot to a wire that leads to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from frogkick.core.extras import require
from frogkick.link.frames import DELIMITER
from frogkick.link.wire import Target, Wire


def require_wire(target: Target) -> None:
    """Refuse a robot that cannot be talked to for want of a package.

    Raises:
        InputError: the package for that kind of wire is not installed.
    """
    require(f"{target.kind}:", *({"ble": ("bleak",), "serial": ("serial",)}[target.kind]))


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
    require_wire(target)
    wire: Wire
    if target.kind == "ble":
        from frogkick.link.ble import BleWire

        wire = BleWire(target.place, greeting=greeting)
    else:
        from frogkick.link.serial import SerialWire

        wire = SerialWire(target.place, target.baud, greeting=greeting)
    try:
        yield wire
    finally:
        wire.close()
