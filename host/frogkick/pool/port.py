"""What every robot looks like from the host: frames go in and out, limbs switch on and off."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Protocol

from frogkick.link.frames import Frame

UART_BITS_PER_S = 115_200
BYTE_S = 10 / UART_BITS_PER_S
_COLD = bytes(4 * 8)  # FK_LIMBS_MAX
COLD_LIMBS = _COLD + struct.pack("<I", zlib.crc32(_COLD) ^ 0x6472_6147)
"""RAM that outlives resets (``fk_guard_persistent_t``), of a robot whose limbs are known to be cold."""


@dataclass(frozen=True)
class Edge:
    """A limb's pin changed: robot time, limb's index, new level."""

    time_s: float
    limb: int
    level: bool


class RobotPort(Protocol):
    """A robot in simulated time. Its clock starts at 0 with the port."""

    def send(self, encoded: bytes, at_s: float) -> None:
        """Put bytes on the wire at a time, not before the robot's own."""

    def advance(self, until_s: float) -> None:
        """Let the robot live until a time."""

    def frames(self) -> list[tuple[float, Frame]]:
        """Frames that came from the robot since the last call, with their times."""

    def edges(self) -> list[Edge]:
        """Pin edges since the last call, in order."""
