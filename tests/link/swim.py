"""A tracker over a simulated pool in real time; and a robot that obeys lines of text."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from tests.runs import rig

from frogkick.core.poses import Fix
from frogkick.runs.text_robot import LIMBS

PATH = "line"


class LivePool:
    """A ``FixSource``: a pool in real time, in which the robot swims by the pulses that it really began.

    Args:
        pulses: of the live robot: (clock s, limb mask, length us).
        clock: the robot's.
    """

    def __init__(
        self, pulses: Sequence[tuple[float, int, int]], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.pool = rig.new_pool(PATH)
        self._pulses, self._taken = pulses, 0
        self._clock = clock
        self._begin_s = clock()
        self._looked_s = 0.0
        self._lock = threading.Lock()

    @property
    def next_event_s(self) -> float:
        return self._looked_s + 0.002

    def swim(self) -> list[Fix]:
        """Advance to the present; return the fixes that arrived, with times of this pool."""
        with self._lock:
            for at_s, limb_mask, _pulse_us in list(self._pulses[self._taken :]):
                self._taken += 1
                for limb in range(4):
                    if limb_mask >> limb & 1:
                        self.pool.actuate(limb, max(self.pool.time_s, at_s - self._begin_s))
            return self.pool.advance(self._clock() - self._begin_s)

    def advance(self, until_s: float) -> list[Fix]:
        self._looked_s = until_s
        shift_s = until_s - (self._clock() - self._begin_s)
        return [
            replace(fix, capture_s=fix.capture_s + shift_s, delay_s=until_s - fix.capture_s - shift_s)
            for fix in self.swim()
        ]

    def actuate(self, limb: int, start_s: float) -> None:
        pass

    def lines(self, write: Callable[[str], object], stop: threading.Event) -> None:
        """Write fixes as the lines of a tracker, until ``stop``."""
        while not stop.wait(0.005):
            for fix in self.swim():
                x_m, y_m, heading_rad = fix.pose_world
                age_s = self._clock() - self._begin_s - fix.capture_s
                write(f"{x_m:.6f} {y_m:.6f} {heading_rad:.6f} {age_s:.4f}\n")


@dataclass
class TextFrog:
    """A robot with the authors' firmware: it fires the limbs that a line names, at any time and rate.

    Attributes:
        lines: the lines received, with their times.
        pulses: (clock s, limb mask in the robot's own order, length us) of each pulse that began.
    """

    clock: Callable[[], float] = time.monotonic
    lines: list[tuple[float, str]] = field(default_factory=list)
    pulses: list[tuple[float, int, int]] = field(default_factory=list)
    pulse_us: int = 0
    sleep_s: float = 0.02
    _rest: bytes = b""

    def feed(self, data: bytes) -> bytes:
        *lines, self._rest = (self._rest + data).split(b"\n")
        order = [limb.name for limb in rig.robot().limbs]
        for line in lines:
            now_s = self.clock()
            words = line.decode("ascii").split()
            self.lines.append((now_s, line.decode("ascii")))
            if words[0] == "p":
                (self.pulse_us,) = (1000 * int(word) for word in words[1:])
            else:
                assert words[0] == "h" and self.pulse_us, words
                mask = sum(1 << order.index(LIMBS[int(word)]) for word in words[1:])
                self.pulses.append((now_s, mask, self.pulse_us))
        return b""

    def tick(self) -> bytes:
        return b""
