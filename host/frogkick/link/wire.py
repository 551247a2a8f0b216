"""Bytes to and from a real robot over a wire that may drop and reconnects by itself.

A robot that cannot be reached is a ``WireError``, an address that cannot be used an ``InputError``.
"""

from __future__ import annotations

import enum
import threading
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from frogkick.core.errors import FrogkickError, InputError, nearest_name
from frogkick.core.interrupts import Bell
from frogkick.link.frames import Frame

BAUD = 115_200
BYTE_S = 10 / BAUD  # a start bit, 8 data bits, a stop bit
BAUD_MAX = 4_000_000
ARRIVED_MAX = 1 << 18  # bytes that wait to be taken
KINDS, FORMS = ("ble", "serial"), ("ble:NAME", "serial:PORT")
"""The kinds of wire, and what a user types for each."""


@dataclass(frozen=True)
class Edge:
    """A change of a limb's pin: robot time, index of the limb, new level."""

    time_s: float
    limb: int
    level: bool


class RobotPort(Protocol):
    """A robot in simulated time. Its clock starts at 0 with the port."""

    def send(self, encoded: bytes, at_s: float) -> None: ...  # at a time not before the robot's own
    def advance(self, until_s: float) -> None: ...
    def frames(self) -> list[tuple[float, Frame]]: ...  # since the last call, with their arrival times
    def edges(self) -> list[Edge]: ...  # of the pins since the last call, in order


class WireError(FrogkickError):
    """The robot cannot be reached, or no longer."""


class Delivery(enum.Enum):
    """How a radio sends a frame; no difference on a serial line."""

    ACKNOWLEDGED = enum.auto()
    """The radio acknowledges the frame before it sends the next one."""
    ANSWERED = enum.auto()
    """Without acknowledgement: the robot's answers pace the sender."""
    NEWEST = enum.auto()
    """Without acknowledgement and before other frames; dropped for a newer one."""
    URGENT = enum.auto()
    """Without acknowledgement and at once, also within another frame, instead of all that wait."""


class Wire(ABC):
    """Bytes to and from a robot. A thread of the wire reads and reconnects; ``receive`` takes what came."""

    name: str  # as the user gave it
    window: int  # number of commands that may wait for their answers at the same time
    reconnect_s = 20.0  # longest time that it may be down before it is given up

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._bell = Bell()
        self._arrived: list[tuple[float, bytes]] = []
        self._waiting = 0  # bytes in it
        self._error: FrogkickError | None = None
        self.connections = 0  # so far
        self.is_up = False  # whether it is connected now

    @property
    def place(self) -> str:
        """Where the robot is, which stays the same as long as this is the same robot."""
        return self.name

    @abstractmethod
    def send(self, encoded: bytes, how: Delivery) -> None:
        """Send a frame with its delimiter; the frame is lost while the wire is down."""

    @abstractmethod
    def close(self) -> None: ...

    def receive(self, timeout_s: float) -> list[tuple[float, bytes]]:
        """Wait for bytes, and return them with their arrival times (monotonic)."""
        self._bell.wait_for(lambda: self._arrived or self._error is not None, timeout_s)
        with self._lock:
            taken, self._arrived, self._waiting = self._arrived, [], 0
            if not taken and self._error is not None:
                raise self._error
            return taken

    def wait_up(self, timeout_s: float) -> bool:
        """Wait for the wire to be up; False if it is not in time."""
        self._bell.wait_for(lambda: self.is_up or self._error is not None, timeout_s)
        with self._lock:
            if self._error is not None:
                raise self._error
            return self.is_up

    # For the thread of the wire

    def put(self, data: bytes) -> None:
        """Hand over bytes that have arrived; those beyond ``ARRIVED_MAX`` are lost."""
        with self._lock:
            if self._waiting + len(data) <= ARRIVED_MAX:
                self._waiting += len(data)
                self._arrived.append((time.monotonic(), data))
        self._bell.ring()

    def connected(self) -> None:
        """Report that the wire is up."""
        with self._lock:
            self.is_up, self.connections = True, self.connections + 1
        self._bell.ring()

    def lost(self, error: FrogkickError | None = None) -> None:
        """Report that the wire is down, or that it stays down by an error."""
        with self._lock:
            self.is_up, self._error = False, error or self._error
        self._bell.ring()


@dataclass(frozen=True)
class Target:
    """Address of a robot: "ble" and its name or address, or "serial" and its port and speed."""

    kind: str
    place: str
    baud: int = BAUD


def is_target(text: str) -> bool:
    """Whether a text begins with ``ble:`` or ``serial:``."""
    return str(text).partition(":")[0] in KINDS


def parse_target(text: str) -> Target:
    """Read ``ble:NAME``, ``ble:ADDRESS`` or ``serial:PORT[:BAUD]``.

    Raises:
        InputError: the text is neither, or the speed is not allowed.
    """
    kind, _, place = text.partition(":")
    if kind not in KINDS or not place:
        hint = "" if kind in KINDS else nearest_name(kind, KINDS)
        raise InputError(
            f"robot {text!r}{hint} is neither ble:NAME nor serial:PORT[:BAUD]: give one "
            "of them, as ble:frogkick or serial:/dev/ttyACM0"
        )
    if kind == "ble":
        return Target(kind, place)
    port, colon, speed = place.rpartition(":")
    if colon and speed[:1].isdigit() and not speed.isdigit() and ("/" not in port or Path(port).exists()):
        raise InputError(
            f"robot {text!r} has the speed {speed!r}: give a whole number, as serial:{port}:115200"
        )
    if not colon or not speed.isdigit():
        return Target(kind, place)
    if not port:
        raise InputError(f"robot {text!r} names no port: give it, as serial:/dev/ttyACM0:{speed}")
    baud = int(speed)
    if not 1200 <= baud <= BAUD_MAX:
        raise InputError(f"robot {text!r} has {baud} bits/s, allowed is 1200 to {BAUD_MAX}: leave it out")
    return Target(kind, port, baud)
