"""A bad radio before a robot: frames are lost, doubled, overtaken and damaged."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable
from dataclasses import dataclass

from frogkick.link.frames import Frame
from frogkick.link.wire import BYTE_S, Edge, RobotPort


@dataclass(frozen=True)
class Faults:
    """How bad the radio is.

    Attributes:
        lost, doubled, held, damaged: part of the frames to the robot that this happens to; of its answers as
            many are lost and doubled.
        held_s: such a frame comes up to this later, so that others overtake it.
        again_s: the second one of a doubled frame comes up to this later.
    """

    lost: float = 0.02
    doubled: float = 0.05
    held: float = 0.05
    damaged: float = 0.02
    held_s: float = 0.08
    again_s: float = 0.2


class Radio:
    """A ``RobotPort`` around another one.

    Attributes:
        last: the frame that was sent last, as the host sent it.
        lost, doubled, held, damaged: frames that it happened to so far.
    """

    def __init__(self, robot: RobotPort, dice: random.Random, faults: Faults) -> None:
        self.robot = robot
        self.last = b""
        self.lost = self.doubled = self.held = self.damaged = 0
        self._dice = dice
        self._faults = faults
        self._silent_s = (0.0, 0.0)
        self._waiting: list[tuple[float, int, bytes | Callable[[], None]]] = []
        self._count = 0
        self._now_s = 0.0

    def at(self, time_s: float, act: Callable[[], None]) -> None:
        """Let something happen to the robot at a time, whatever the host does meanwhile."""
        self._count += 1
        heapq.heappush(self._waiting, (time_s, self._count, act))

    def be_silent(self, from_s: float, to_s: float) -> None:
        """No frame gets through, either way."""
        self._silent_s = (from_s, to_s)

    def _is_silent(self, time_s: float) -> bool:
        return self._silent_s[0] <= time_s < self._silent_s[1]

    def send(self, encoded: bytes, at_s: float) -> None:
        self.last = encoded
        dice, faults = self._dice.random, self._faults
        if self._is_silent(at_s) or dice() < faults.lost:
            self.lost += 1
            return
        if dice() < faults.held:
            self.held += 1
            at_s += faults.held_s * dice()
        if dice() < faults.doubled:
            self.doubled += 1
            self._put(encoded, at_s + faults.again_s * dice())
        if dice() < faults.damaged:
            self.damaged += 1
            place = self._dice.randrange(len(encoded) - 1)
            encoded = (
                encoded[:place]
                + bytes([encoded[place] ^ 1 << self._dice.randrange(8)])
                + encoded[place + 1 :]
            )
        self._put(encoded, at_s)

    def noise(self, count: int, at_s: float) -> float:
        """Bytes of no meaning on the wire; when the last one is through."""
        self._put(self._dice.randbytes(count) + b"\0", at_s)
        return at_s + (count + 1) * BYTE_S

    def _put(self, encoded: bytes, at_s: float) -> None:
        self._count += 1
        heapq.heappush(self._waiting, (at_s, self._count, encoded))

    def advance(self, until_s: float) -> None:
        while self._waiting and self._waiting[0][0] <= until_s:
            time_s, _, what = heapq.heappop(self._waiting)
            if isinstance(what, bytes):
                self.robot.send(what, time_s)
            else:
                self.robot.advance(max(time_s, self._now_s))
                what()
        self.robot.advance(until_s)
        self._now_s = until_s

    def frames(self) -> list[tuple[float, Frame]]:
        came = []
        for time_s, frame in self.robot.frames():
            if self._is_silent(time_s) or self._dice.random() < self._faults.lost:
                continue
            came.append((time_s, frame))
            if self._dice.random() < self._faults.doubled:
                came.append((time_s, frame))
        return came

    def edges(self) -> list[Edge]:
        return self.robot.edges()
