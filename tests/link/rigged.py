"""A robot behind each transport, for tests that hold for all transports."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.link.air import Peripheral, breathe

from frogkick.link.opening import opened
from frogkick.link.pty_line import Listener, PtyLine
from frogkick.link.wire import Target, Wire

TRANSPORTS = ("serial", "ble")


@dataclass
class Rigged:
    """A wire to a robot.

    Attributes:
        target: the address that a user gives for it.
        drop: cuts the connection, which can be made again at once.
        away: cuts the connection for good.
    """

    wire: Wire
    target: str
    drop: Callable[[], None]
    away: Callable[[], None]


@contextmanager
def rigged(
    transport: str, robot: Listener, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Rigged]:
    """A transport with a robot behind it."""
    if transport == "serial":
        with PtyLine(folder / "robot", robot) as line, opened(Target("serial", str(line.path))) as wire:
            yield Rigged(wire, f"serial:{line.path}", line.drop, line.pull_out)
        return
    peripheral = Peripheral(robot)
    air = breathe(monkeypatch, peripheral)

    async def vanish() -> None:
        peripheral.device.auto_restart_advertising = False
        await peripheral.device.stop_advertising()
        await peripheral.drop()
        await peripheral.device.stop_advertising()

    with opened(Target("ble", peripheral.address)) as wire:
        yield Rigged(
            wire, f"ble:{peripheral.address}", lambda: air.call(peripheral.drop), lambda: air.call(vanish)
        )
