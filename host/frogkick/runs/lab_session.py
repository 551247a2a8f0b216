"""Talking with a real robot: answers in real time, drops that heal, and what to say where they do not."""

from __future__ import annotations

import math
import secrets
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from frogkick.link.frames import hello
from frogkick.link.layout import Value
from frogkick.link.wire import RobotPort, Wire
from frogkick.runs.lab_port import LabPort
from frogkick.runs.real_time import real_time_guard
from frogkick.runs.session import ANSWER_TIMEOUT_S, STEP_S, Arrival, Asked, LinkError, Session
from frogkick.tables.image import Tables

ANSWER_S = 2.0
"""The least that an answer is waited for: a busy host is late by itself."""
HELLO_TIMES = 2
CLOCK_ASKED = 5
SAFE_S = 5.0
CLOCK_BACK_S = 0.01
"""No monotonic clock does so; one that does leaves a robot armed that nobody looks after."""
CLOCK_AHEAD_S = 0.2
"""So far beyond the robot's own this computer's clock may be: by no more is a fix that looks fresh older."""
CLOCK_DRIFT = 1e-3
"""And by such a part of the time besides: a robot without a crystal is off by half of it."""
PAUSE_S = 1.0
"""Between two steps: either this program was held up for so long, or its clock was set."""


def _new_conversation() -> int:
    """Another one than the last: 0 and a robot's first are left to simulated ones."""
    return 1 + secrets.randbelow(65_535)


class RealPort(RobotPort, Protocol):
    """A port in real time: a ``LabPort``, or a ``TextRobot``, which looks the same."""

    wire: Wire

    @property
    def now_s(self) -> float:
        """Time since the port began."""

    @property
    def bad(self) -> int:
        """Frames that came damaged so far."""

    @property
    def gaps(self) -> int:
        """How often frames from the robot may have been lost so far."""

    def forget(self, sequence: int) -> None:
        """Wait no longer for the answer to a command."""


@dataclass
class LabSession(Session):
    """A ``Session`` in real time.

    Attributes:
        patience_s: how long a wire may be down while an answer is waited for; that time does not count as
            waiting.
    """

    port: RealPort
    conversation: int = field(default_factory=_new_conversation)
    patience_s: float = math.inf
    _connections: int = 1
    _was_told: bool = False
    _offset_us: int | None = None
    _robot_us: int = 0

    def step(self, until_s: float) -> None:
        """Wait until a time, or until something comes; ``time_s`` is the real one then."""
        self._forward_s()  # set back since the last step, it would be waited for
        self.port.advance(until_s)
        self._inbox += [Arrival(time_s, frame) for time_s, frame in self.port.frames()]
        now_s = self._forward_s()
        paused_s, self.time_s = now_s - self.time_s, now_s
        edges = self.port.edges()
        self.edges += edges
        self.on_step(self.time_s, edges)
        if paused_s > PAUSE_S:
            self._compare_clocks()

    def _forward_s(self) -> float:
        """The time, which is no earlier than before.

        Raises:
            LinkError: it is.
        """
        now_s = self.port.now_s
        if now_s < self.time_s - CLOCK_BACK_S and not self._was_told:
            self._was_told = True  # what disarms the robot afterwards takes the clock as it is
            raise LinkError(
                f"this computer's clock went back by {self.time_s - now_s:.1f} s while the robot ran: "
                "run again, and let nothing set it meanwhile"
            )
        return now_s

    def check_clock_sync(self, capture_s: float, capture_us: int) -> None:
        """Check that this computer's clock and the robot's give a fix the same capture time.

        Raises:
            LinkError: this computer's clock went ahead, or the robot was switched off and on.
        """
        if self._ahead_s(capture_s, capture_us) > self._ahead_most_s:
            self._compare_clocks()
        else:
            self._robot_us = max(self._robot_us, capture_us)

    @property
    def _ahead_most_s(self) -> float:
        return CLOCK_AHEAD_S + CLOCK_DRIFT * self.time_s

    def _ahead_s(self, here_s: float, robot_us: int) -> float:
        """By how much a time of this computer's clock is beyond the same on the robot's."""
        return 0.0 if self._offset_us is None else here_s - (robot_us - self._offset_us) * 1e-6

    def _compare_clocks(self) -> None:
        """Ask the robot what time it is: it was not held up, and nobody sets its clock."""
        if self._was_told or self._offset_us is None or self.port.wire.connections != self._connections:
            return
        self._was_told = True  # nor is it asked while it is asked
        told_us = int(self.request("STATUS")["now_us"])
        ahead_s = self._ahead_s(self.port.now_s, told_us)
        if told_us < self._robot_us:
            raise LinkError(
                "the robot was switched off and on while it ran, or its firmware began anew: charge it, look "
                "at its plugs, and at what 'frogkick log fetch' tells"
            )
        if ahead_s > self._ahead_most_s:
            raise LinkError(
                f"this computer's clock went ahead by {ahead_s:.1f} s while the robot ran, so that ages of "
                "position fixes cannot be trusted, and the run was ended: run again, and let nothing set it "
                "meanwhile"
            )
        self._was_told = False

    @property
    def window(self) -> int:
        """Commands that may be asked at once."""
        return self.port.wire.window

    def ask_all(
        self, name: str, many: Sequence[Asked], timeout_s: float = ANSWER_TIMEOUT_S
    ) -> list[dict[str, Value]]:
        """Ask several times the same at once, and wait for all answers.

        Raises:
            LinkError: one is missing, though the wire was up.
            WireError: the robot is gone.
        """
        sequences = [self.post(name, values, rows) for values, rows in many]
        told: dict[int, dict[str, Value]] = {}
        timeout_s, waited_s, down_s = max(timeout_s, ANSWER_S), 0.0, 0.0
        try:
            while waited_s < timeout_s and down_s < self.patience_s:
                before_s, was_up = self.port.now_s, self.port.wire.is_up
                self.step(before_s + STEP_S)
                if self._answered(name, sequences, told):
                    return [told[sequence] for sequence in sequences]
                if was_up:
                    waited_s += self.port.now_s - before_s
                else:
                    down_s += self.port.now_s - before_s
        finally:
            for sequence in sequences:
                self.port.forget(sequence)
        raise LinkError(f"no answer to {name} within {timeout_s:g} s: bring the robot nearer, charge it")

    def handshake(self, tables: Tables) -> dict[str, Value]:
        """HELLO, and refuse a robot with other tables than ours, or whose owner this host is not."""
        told = super().handshake(tables)
        self.authenticate()
        return told

    def make_safe(self) -> bool:
        """DISARM; a wire that is down is not waited for as long as otherwise."""
        self.patience_s = SAFE_S
        return super().make_safe()

    def reconnected(self) -> bool:
        """The wire has dropped and come back since this was asked last: events may be missing."""
        before, self._connections = self._connections, self.port.wire.connections
        return self._connections != before

    def real_time_guard(self) -> AbstractContextManager[None]:
        """Nothing in this program holds the run up for long meanwhile."""
        return real_time_guard()

    @property
    def gaps(self) -> int:
        """How often something that the robot said may have been lost."""
        return self.port.gaps

    def robot_clock_offset_us(self) -> int:
        """Robot time minus this session's, from the quickest of some answers to STATUS.

        Raises:
            LinkError: no answer.
        """
        quickest_s, offset_us = float("inf"), 0
        for _ in range(CLOCK_ASKED):
            before_s = self.port.now_s
            told_us = int(self.request("STATUS")["now_us"])
            trip_s = self.port.now_s - before_s
            if trip_s < quickest_s:
                quickest_s, offset_us = trip_s, told_us - round((before_s + trip_s / 2.0) * 1e6)
        self._offset_us = offset_us
        return offset_us

    def _hello(self) -> dict[str, Value]:
        for _ in range(HELLO_TIMES):
            try:
                return self.ask("HELLO", hello(self.conversation))
            except LinkError:
                continue
        damaged = f", {self.port.bad} damaged frames came" if self.port.bad else ""
        raise LinkError(
            f"{self.port.wire.name} is connected and does not answer HELLO{damaged}: it runs other firmware "
            "or at another speed; flash it ('frogkick firmware flash'), or for the authors' own give "
            "--dialect frog2022"
        )


def lab_session(wire: Wire, key_file: Path | None = None) -> LabSession:
    """A session with a robot that speaks this project's link, over a wire; ``key_file`` as of ``Session``."""
    return LabSession(LabPort(wire), key_file=key_file)


@contextmanager
def stops_are_interrupts() -> Iterator[None]:
    """Let SIGTERM and a closed terminal interrupt as Ctrl-C does, so that a robot is disarmed first."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before: list[Any] = [signal.signal(number, interrupt) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
