"""A robot that only fires limbs when a line of text says so: this project's core thinks for it on the host.

The core is the firmware's own C, with its guard, so pulses, rests, heat and limbs at once keep the limits
that they keep on board; and the robot looks from outside like any other. What a line takes on its way is
not in its books.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from frogkick.core.interrupts import Bell
from frogkick.link.frames import Frame, FrameCollector
from frogkick.link.text_dialect import fire_line, limb_numbers
from frogkick.link.wire import Delivery, Edge, Wire
from frogkick.pool.native_robot import NativeRobot
from frogkick.robot import Robot

_SLEEP_S = 0.02


class TextRobot:
    """A port (see ``LabPort``) whose frames go to the core here, and whose pulses go out as text.

    Attributes:
        wire: to the robot.
        lost: pulses whose line could not be sent, because the wire was down.
    """

    bad = 0
    gaps = 0
    """The core runs here: nothing that it says is lost."""

    def __init__(
        self, wire: Wire, core: NativeRobot, robot: Robot, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Switch the core on.

        Args:
            wire: its greeting is the line that sets the pulse's length, so that each connect does.
            core: just made; with the table to plan by.
            robot: whose limbs they are.
            clock: in s.

        Raises:
            InputError: a limb that the dialect does not know.
        """
        self.wire = wire
        self.lost = 0
        self._numbers = limb_numbers([limb.name for limb in robot.limbs])
        self._core = core
        self._clock = clock
        self._begin_s = clock()
        self._collector = FrameCollector()
        self._lock = threading.Lock()
        self._condition = threading.Condition(self._lock)
        self._said = Bell()
        self._frames: list[tuple[float, Frame]] = []
        self._edges: list[Edge] = []
        self._next_tick_us = 0
        self._closing = False
        self._thread = threading.Thread(target=self._live, name="core", daemon=True)
        self._thread.start()

    @property
    def now_s(self) -> float:
        """Time since the core was switched on."""
        return self._clock() - self._begin_s

    def close(self) -> None:
        """Switch the core off: no line goes out any more."""
        with self._lock:
            self._closing = True
            self._condition.notify_all()
        self._thread.join()

    def send(self, encoded: bytes, at_s: float) -> None:
        """Give the core a frame now; ``at_s`` is for robots in simulated time."""
        with self._lock:
            self._turn(encoded[:-1])
            self._condition.notify_all()

    def forget(self, sequence: int) -> None:
        """Nothing is sent again here."""

    def advance(self, until_s: float) -> None:
        """Wait until a time, or until the core has something to say.

        Raises:
            WireError: the robot is gone.
        """
        self.wire.receive(0.0)
        self._said.wait_for(lambda: self._frames, max(0.0, until_s - self.now_s))

    def frames(self) -> list[tuple[float, Frame]]:
        """Frames from the core since the last call."""
        with self._lock:
            taken, self._frames = self._frames, []
        return taken

    def edges(self) -> list[Edge]:
        """Beginnings and ends of pulses, by the core's books, that lie behind."""
        with self._lock:
            now_s = self.now_s
            taken = sorted((edge for edge in self._edges if edge.time_s <= now_s), key=lambda e: e.time_s)
            self._edges = [edge for edge in self._edges if edge.time_s > now_s]
        return taken

    def _live(self) -> None:
        with self._lock:
            while not self._closing:
                until_tick_s = self._next_tick_us * 1e-6 - self.now_s
                if until_tick_s <= 0.0:
                    self._turn(b"")
                else:
                    self._condition.wait(min(until_tick_s, _SLEEP_S))

    def _turn(self, frame: bytes) -> None:
        now_s = self.now_s
        call = self._core.turn(int(now_s * 1e6), frame)
        limb_mask, _all_off, pulse_us, self._next_tick_us = call.outputs
        limbs = [limb for limb in range(len(self._numbers)) if limb_mask >> limb & 1]
        if limbs and not self._closing:
            if self.wire.is_up:
                self.wire.send(fire_line([self._numbers[limb] for limb in limbs]), Delivery.ACKNOWLEDGED)
            else:
                self.lost += 1
            self._edges += [Edge(now_s, limb, True) for limb in limbs]
            self._edges += [Edge(now_s + pulse_us * 1e-6, limb, False) for limb in limbs]
        self._frames += [(now_s, one) for one in self._collector.feed(call.stream)]
        self._said.ring()
