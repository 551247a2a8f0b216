"""The robot's core in real time, for tests of transports: bytes in, bytes out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.core.core import Robot
from tests.core.store_rig import PAGE, Flash
from tests.runs import rig

from frogkick.link.frames import Frame, FrameError, unpack_frame


class PatientClock:
    """A clock that counts a pause of the process as 0.02 s.

    A busy machine lets no process run now and then, and a robot in real time would lose its fixes by that.
    """

    MOMENT_S = 0.02

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._time_s, self._looked_s = 0.0, time.monotonic()

    def __call__(self) -> float:
        with self._lock:
            now_s = time.monotonic()
            self._time_s += min(now_s - self._looked_s, self.MOMENT_S)
            self._looked_s = now_s
            return self._time_s


@dataclass
class LiveRobot:
    """A robot just switched on: the C core with its table store, on a flash that outlives a restart.

    Attributes:
        built_in: the table in its firmware.
        clock: real time, s.
        on_for_s: time since it was switched on, when it begins.
        pulses: (clock s, limb mask, length us) of each pulse that began.
        heard: the undamaged frames that it received, with their times.
        mute: whether it takes frames and never answers.
        deaf_to: whether a frame is lost before it arrives.
    """

    built_in: bytes = field(default_factory=lambda: rig.small_table().read_bytes())
    clock: Callable[[], float] = time.monotonic
    on_for_s: float = 0.7
    pulses: list[tuple[float, int, int]] = field(default_factory=list)
    heard: list[tuple[float, Frame]] = field(default_factory=list)
    off_at: list[float] = field(default_factory=list)
    mute: bool = False
    deaf_to: Callable[[Frame], bool] = lambda _frame: False

    def __post_init__(self) -> None:
        self._one_at_a_time = threading.RLock()  # a test restarts it while its line's thread gives it turns
        self.flash = Flash(slot_bytes=16 * PAGE, built_in=self.built_in)
        self.restart()

    def restart(self) -> None:
        """Power off and on: disarmed, no path, a clock from 0, and the table that its flash selects."""
        with self._one_at_a_time:
            self.flash.boot()
            self.core = Robot(self.flash.image, 0)
            assert self.core.error == 0
            self.core.use_store(self.flash)
            self._begin_s = self.clock() - self.on_for_s
            self._received = b""
            self._next_tick_us = 0

    @property
    def now_us(self) -> int:
        return int((self.clock() - self._begin_s) * 1e6)

    @property
    def sleep_s(self) -> float:
        """Time until its next tick, at most 0.02 s."""
        return min(0.02, max(0.0, (self._next_tick_us - self.now_us) * 1e-6))

    def feed(self, data: bytes) -> bytes:
        with self._one_at_a_time:
            self._received += data
            stream = b""
            while (end := self._received.find(b"\0")) >= 0:
                encoded, self._received = self._received[:end], self._received[end + 1 :]
                try:
                    frame = unpack_frame(encoded)
                except FrameError:
                    frame = None
                if encoded and (frame is None or not self.deaf_to(frame)):
                    if frame is not None:
                        self.heard.append((self.clock(), frame))
                    stream += self._turn(encoded)
            return stream

    def tick(self) -> bytes:
        with self._one_at_a_time:
            return self._turn(b"") if self.now_us >= self._next_tick_us else b""

    def names(self) -> list[str]:
        """Names of the frames received."""
        return [frame.name for _, frame in self.heard]

    def left_alone(self) -> bool:
        """Whether the last commands were DISARM and queries, besides fixes that were on their way."""
        *_, rest = " ".join(self.names()).rpartition("DISARM")
        return "DISARM" in self.names() and set(rest.split()) <= {"STATUS", "FIX"}

    def _turn(self, encoded: bytes) -> bytes:
        now_us = self.now_us
        self.core.now_us = now_us
        if encoded:
            self.core.raw(encoded)
        out = self.core.tick(now_us)
        self._next_tick_us = out.next_tick_us
        if out.all_off:
            self.off_at.append(self.clock())
        if out.limb_mask:
            self.pulses.append((self._begin_s + now_us * 1e-6, out.limb_mask, out.pulse_us))
        stream = self.core.take_bytes()
        return b"" if self.mute else stream
