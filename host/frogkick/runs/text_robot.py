"""A robot that fires limbs on lines of text; the project's core runs on the host in its place.

The core is the firmware's C with its guard, so pulses, rests, heat and simultaneous limbs have the same
limits as on the robot. The guard does not know the transmission delay of a line.

The lines are those of the authors' firmware, of which two are known: ``p 80`` sets the pulse's length in ms,
``h 0 1`` fires limbs together (front left 0, front right 1, rear left 2, rear right 3). Assumed: a line ends
with a newline, answers are ignored, and a pulse cannot be ended early. Source: Huang, Patterson et al. 2022.
What the dialect cannot say is an ``InputError``.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from frogkick.core.errors import InputError, nearest_name
from frogkick.core.interrupts import Bell
from frogkick.link.frames import Frame, FrameCollector
from frogkick.link.wire import Delivery, Edge, Wire
from frogkick.pool.native_robot import NativeRobot
from frogkick.robot import Robot

DIALECTS = ("frogkick", "frog2022")
LIMBS = ("front_left", "front_right", "rear_left", "rear_right")
"""By their numbers in a line."""

_SLEEP_S = 0.02


def require_dialect(name: str) -> None:
    """Check the name of a dialect.

    Raises:
        InputError: it is none of DIALECTS.
    """
    if name not in DIALECTS:
        raise InputError(
            f"--dialect is {name!r}{nearest_name(name, DIALECTS)}: choose frogkick (this project's firmware) "
            "or frog2022 (the authors')"
        )


def limb_numbers(names: Sequence[str]) -> tuple[int, ...]:
    """The dialect's number of each limb, by the limbs' names.

    Raises:
        InputError: the dialect does not have a limb.
    """
    unknown = [name for name in names if name not in LIMBS]
    if unknown:
        raise InputError(
            f"dialect frog2022 knows the limbs {', '.join(LIMBS)}, not {unknown[0]!r}: give the authors' "
            "robot, or flash this project's firmware"
        )
    return tuple(LIMBS.index(name) for name in names)


def pulse_line(pulse_us: int) -> bytes:
    """The command that sets the length of pulses.

    Raises:
        InputError: the length is not in whole ms.
    """
    if pulse_us % 1000:
        raise InputError(
            f"the table's pulse is {pulse_us} us, dialect frog2022 takes whole ms: build it with another"
        )
    return b"p %d\n" % (pulse_us // 1000)


def fire_line(limbs: Sequence[int]) -> bytes:
    """The command that fires limbs, by their numbers."""
    return b"h " + b" ".join(b"%d" % limb for limb in sorted(limbs)) + b"\n"


class TextRobot:
    """A port (see ``LabPort``) whose frames go to a core on the host, and whose pulses go out as text.

    Attributes:
        wire: to the robot.
        lost: number of pulses whose line could not be sent because the wire was down.
        bad, gaps: 0, as no frame of the core gets lost.
    """

    bad = 0
    gaps = 0

    def __init__(
        self, wire: Wire, core: NativeRobot, robot: Robot, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start the core, a new one with the planner's table.

        The wire's greeting is the line that sets the pulse's length, so that each connection sets it.

        Raises:
            InputError: the dialect does not know a limb.
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
        self._bell = Bell()
        self._frames: list[tuple[float, Frame]] = []
        self._edges: list[Edge] = []
        self._next_tick_us = 0
        self._closing = False
        self._thread = threading.Thread(target=self._live, name="core", daemon=True)
        self._thread.start()

    @property
    def now_s(self) -> float:
        """Time since the core's start."""
        return self._clock() - self._begin_s

    def close(self) -> None:
        """Stop the core: no more lines are sent."""
        with self._lock:
            self._closing = True
            self._condition.notify_all()
        self._thread.join()

    def send(self, encoded: bytes, at_s: float) -> None:
        """Give the core a frame now; ``at_s`` only matters in simulated time."""
        with self._lock:
            self._turn(encoded[:-1])
            self._condition.notify_all()

    def forget(self, sequence: int) -> None:
        """No effect: nothing is sent again."""

    def advance(self, until_s: float) -> None:
        """Wait until a time or a frame of the core. WireError: the robot is gone."""
        self.wire.receive(0.0)
        self._bell.wait_for(lambda: self._frames, max(0.0, until_s - self.now_s))

    def frames(self) -> list[tuple[float, Frame]]:
        """Frames of the core since the last call, with their times."""
        with self._lock:
            taken, self._frames = self._frames, []
        return taken

    def edges(self) -> list[Edge]:
        """Past starts and ends of pulses, by the core."""
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
        self._frames += [(now_s, frame_out) for frame_out in self._collector.feed(call.stream)]
        self._bell.ring()
