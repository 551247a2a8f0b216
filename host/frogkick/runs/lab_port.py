"""A real robot behind the same face as the simulated ones: frames in and out in real time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from frogkick.link.frames import Frame, FrameCollector, unpack_frame
from frogkick.link.wire import Delivery, Edge, Wire

RESEND_S = 0.25
LOOK_S = 0.1
"""No wait is longer: whether the clock went back in it is seen only afterwards."""
TIMED = ("FIX", "STROKE")
"""Commands that are worth nothing later: never sent again."""


@dataclass
class _Command:
    name: str
    sequence: int
    encoded: bytes
    sent_s: float = -1.0
    connection: int = 0


class LabPort:
    """A ``RobotPort`` over a wire. Its clock is this computer's, from 0 with the port.

    Commands go out at most ``window`` at a time, and again where no answer comes: a robot acts on each once.
    Position fixes overtake them and are never sent again. What limbs do is not seen from here.

    Attributes:
        wire: the bytes' way.
        resent: commands that were sent again so far.
        bad: frames that came damaged so far.
    """

    def __init__(self, wire: Wire, clock: Callable[[], float] = time.monotonic) -> None:
        """Talk over a wire, which stays the caller's to close."""
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
        """Time since the port began."""
        return self._clock() - self._begin_s

    @property
    def bad(self) -> int:
        """Frames that came damaged so far."""
        return self._collector.bad

    @property
    def gaps(self) -> int:
        """Frames that came damaged, and drops of the connection, so far."""
        return self.bad + self.wire.connections - self._first_connection

    def send(self, encoded: bytes, at_s: float) -> None:
        """Send a frame now; ``at_s`` is for robots in simulated time."""
        frame = unpack_frame(encoded[:-1])
        if frame.name == "FIX":
            self.wire.send(encoded, Delivery.NEWEST)
            return
        self._commands.append(_Command(frame.name, frame.sequence, encoded))
        self._fill_window()

    def forget(self, sequence: int) -> None:
        """Wait no longer for the answer to a command."""
        self._commands = [one for one in self._commands if one.sequence != sequence]
        self._fill_window()

    def advance(self, until_s: float) -> None:
        """Wait until a time, or until a frame comes, or the clock goes back.

        Raises:
            WireError: the robot is gone.
        """
        before_s = self.now_s
        while True:
            now_s = self.now_s
            if now_s < before_s:
                return  # that time may be far ahead now
            before_s = now_s
            self._send_again(now_s)
            waiting = [one.sent_s + RESEND_S for one in self._commands if one.sent_s >= 0.0]
            wake_s = min([until_s, *waiting])
            for arrival_s, data in self.wire.receive(min(LOOK_S, max(0.0, wake_s - now_s))):
                self._take(arrival_s - self._begin_s, data)
            if self._frames or self.now_s >= until_s:
                return

    def frames(self) -> list[tuple[float, Frame]]:
        """Frames that came since the last call, with their times."""
        taken, self._frames = self._frames, []
        return taken

    def edges(self) -> list[Edge]:
        """None: a host does not see the pins."""
        return []

    def _take(self, arrival_s: float, data: bytes) -> None:
        for frame in self._collector.feed(data):
            self._frames.append((arrival_s, frame))
            if frame.kind == "answer":
                self.forget(frame.sequence)

    def _fill_window(self) -> None:
        under_way = sum(one.sent_s >= 0.0 for one in self._commands)
        for one in self._commands:
            if under_way >= self.wire.window or not self.wire.is_up:
                return
            if one.sent_s < 0.0:
                self._put(one)
                under_way += 1

    def _send_again(self, now_s: float) -> None:
        self._fill_window()
        if not self.wire.is_up:
            return
        for one in list(self._commands):
            late = one.sent_s >= 0.0 and now_s - one.sent_s >= RESEND_S
            if not (late or (one.sent_s >= 0.0 and one.connection != self.wire.connections)):
                continue
            if one.name in TIMED:
                self.forget(one.sequence)
            else:
                self.resent += 1
                self._put(one)

    def _put(self, one: _Command) -> None:
        one.sent_s, one.connection = self.now_s, self.wire.connections
        # The many chunks of a table would wait a connection interval each for the radio to acknowledge them.
        how = Delivery.ANSWERED if one.name == "TABLE_CHUNK" else Delivery.ACKNOWLEDGED
        self.wire.send(one.encoded, how)
