"""A ``RobotPort`` over a wire in real time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from frogkick.link.frames import Frame, FrameCollector, unpack_frame
from frogkick.link.wire import Delivery, Edge, Wire

RESEND_S = 0.25
LOOK_S = 0.1
"""Longest wait: a clock that was set back during it is noticed only afterwards."""
TIMED = ("FIX", "STROKE")
"""Commands that are useless later: they are never sent again."""


@dataclass
class _Command:
    name: str
    sequence: int
    encoded: bytes
    sent_s: float = -1.0
    connection: int = 0


class LabPort:
    """A ``RobotPort`` over a wire. Its clock is this computer's, from 0 at the port's start.

    At most ``window`` commands wait for answers; a command without an answer is sent again, and the robot
    acts on it once. Position fixes overtake commands and are never sent again. Pin edges are not seen.

    Attributes:
        wire: the wire.
        resent: number of commands that were sent again.
    """

    def __init__(self, wire: Wire, clock: Callable[[], float] = time.monotonic) -> None:
        """Use a wire, which the caller closes."""
        self.wire = wire
        self.resent = 0
        self._clock = clock
        self._begin_s = clock()
        self._collector = FrameCollector()
        self._first_connection = wire.connections
        self._commands: list[_Command] = []
        self._frames: list[tuple[float, Frame]] = []

    @property
    def now_s(self) -> float:
        """Time since the port's start."""
        return self._clock() - self._begin_s

    @property
    def bad(self) -> int:
        """Number of damaged frames."""
        return self._collector.bad

    @property
    def gaps(self) -> int:
        """Number of damaged frames and of lost connections."""
        return self.bad + self.wire.connections - self._first_connection

    def send(self, encoded: bytes, at_s: float) -> None:
        """Send a frame now; ``at_s`` only matters in simulated time."""
        frame = unpack_frame(encoded[:-1])
        if frame.name == "FIX":
            self.wire.send(encoded, Delivery.NEWEST)
            return
        self._commands.append(_Command(frame.name, frame.sequence, encoded))
        self._fill_window()

    def forget(self, sequence: int) -> None:
        """Stop waiting for the answer to a command."""
        self._commands = [command for command in self._commands if command.sequence != sequence]
        self._fill_window()

    def advance(self, until_s: float) -> None:
        """Wait until a time, a frame, or a step back of the clock.

        Raises:
            WireError: the robot is gone.
        """
        before_s = self.now_s
        while True:
            now_s = self.now_s
            if now_s < before_s:
                return  # the time may be far ahead now
            before_s = now_s
            self._send_again(now_s)
            resend_s = [command.sent_s + RESEND_S for command in self._commands if command.sent_s >= 0.0]
            wake_s = min([until_s, *resend_s])
            for arrival_s, data in self.wire.receive(min(LOOK_S, max(0.0, wake_s - now_s))):
                self._take(arrival_s - self._begin_s, data)
            if self._frames or self.now_s >= until_s:
                return

    def frames(self) -> list[tuple[float, Frame]]:
        """Frames since the last call, with their arrival times."""
        taken, self._frames = self._frames, []
        return taken

    def edges(self) -> list[Edge]:
        """No edges: a host does not see the pins."""
        return []

    def _take(self, arrival_s: float, data: bytes) -> None:
        for frame in self._collector.feed(data):
            self._frames.append((arrival_s, frame))
            if frame.kind == "answer":
                self.forget(frame.sequence)

    def _fill_window(self) -> None:
        unanswered = sum(command.sent_s >= 0.0 for command in self._commands)
        for command in self._commands:
            if unanswered >= self.wire.window or not self.wire.is_up:
                return
            if command.sent_s < 0.0:
                self._put(command)
                unanswered += 1

    def _send_again(self, now_s: float) -> None:
        self._fill_window()
        if not self.wire.is_up:
            return
        for command in list(self._commands):
            is_late = now_s - command.sent_s >= RESEND_S or command.connection != self.wire.connections
            if command.sent_s < 0.0 or not is_late:
                continue
            if command.name in TIMED:
                self.forget(command.sequence)
            else:
                self.resent += 1
                self._put(command)

    def _put(self, command: _Command) -> None:
        command.sent_s, command.connection = self.now_s, self.wire.connections
        # Acknowledged, each of a table's many chunks would take a connection interval.
        how = Delivery.ANSWERED if command.name == "TABLE_CHUNK" else Delivery.ACKNOWLEDGED
        self.wire.send(command.encoded, how)
