"""A session with a real robot: in real time, with lost connections, and clocks that are set or reset."""

from __future__ import annotations

import gc
import secrets
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from frogkick.link.frames import Frame, FrameCollector, hello, unpack_frame
from frogkick.link.layout import Arguments, Value
from frogkick.link.wire import Delivery, Edge, Wire
from frogkick.runs.session import STEP_S, LinkError, Session
from frogkick.runs.text_robot import TextRobot
from frogkick.tables.image import Tables

RESEND_S = 0.25
LOOK_S = 0.1
"""Longest wait. If the clock is set back during a wait, this is noticed only afterwards."""
ANSWER_S = 2.0
"""Shortest timeout of an answer, because a busy host may itself be late."""
HELLO_TRIES = 2
CLOCK_SAMPLES = 5
SAFE_S = 5.0
CLOCK_BACK_S = 0.01
"""Largest allowed step back of this computer's clock: the host would wait longer, with the robot armed."""
CLOCK_AHEAD_S = 0.2
"""Largest allowed advance of this computer's clock over the robot's; a fix may be older by as much."""
CLOCK_DRIFT = 1e-3
"""Additional allowance, as a share of the elapsed time: twice the drift of a robot without a crystal."""
PAUSE_S = 1.0
"""A longer time between two steps means that the program was held up or its clock was set."""
SWITCH_OFF = ("DISARM", "STOP")
"""Commands that wait for none. Those before them that have no answer are not sent any more: a robot that was
switched off must not get an older ARM."""
RESEND_NUMBERS = 15
"""A command is not sent again when more sequence numbers were used since: the robot keeps 16 answers."""
SWITCH_S = 0.002
"""Longest time that a computing thread keeps others waiting; Python's 5 ms are a quarter of a fix period."""


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
    acts on it once. DISARM and STOP are sent at once, instead of all commands before them. Position fixes
    overtake commands. They and STROKE, useless later, are never sent again. Pin edges cannot be observed.

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
        frame = unpack_frame(encoded[:-1])  # a port gets bytes alone, as the robot does
        if frame.name == "FIX":
            self.wire.send(encoded, Delivery.NEWEST)
            return
        self._commands = [
            command
            for command in self._commands
            if frame.name not in SWITCH_OFF and (frame.sequence - command.sequence) & 0xFF <= RESEND_NUMBERS
        ]
        self._commands.append(_Command(frame.name, frame.sequence, encoded))
        self._fill_window()

    def forget(self, sequence: int) -> None:
        """Stop waiting for the answer to a command."""
        self._commands = [command for command in self._commands if command.sequence != sequence]
        self._fill_window()

    def advance(self, until_s: float) -> None:
        """Wait until a time, a frame, or a step back of the clock. WireError: the robot is gone."""
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
            if frame.kind == "answer" and frame.name != "FIX":  # which has numbers of its own
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
            if command.name == "STROKE":  # useless later
                self.forget(command.sequence)
            else:
                self.resent += 1
                self._put(command)

    def _put(self, command: _Command) -> None:
        command.sent_s, command.connection = self.now_s, self.wire.connections
        # Acknowledged, each of a table's many chunks would take a connection interval.
        how = Delivery.ANSWERED if command.name == "TABLE_CHUNK" else Delivery.ACKNOWLEDGED
        self.wire.send(command.encoded, Delivery.URGENT if command.name in SWITCH_OFF else how)


@dataclass
class LabSession(Session):
    """A ``Session`` in real time."""

    port: LabPort | TextRobot
    # longest time that the wire may be down during a request; it does not count as waiting
    patience_s: float = 60.0
    # Random: an answer that an earlier session no longer waited for may still come.
    _apart: int = field(default_factory=lambda: secrets.randbelow(64))
    _down_s: float = 0.0
    _connections: int = 1
    _clock_failed: bool = False
    _offset_us: int | None = None
    _robot_us: int = 0

    def step(self, until_s: float) -> None:
        """Wait until a time or until a frame comes; ``time_s`` is the real time afterwards."""
        self._forward_s()  # a clock that was set back would make this wait long
        was_up = self.port.wire.is_up
        self.port.advance(until_s)
        self._receive()
        now_s = self._forward_s()
        paused_s, self.time_s = now_s - self.time_s, now_s
        self._down_s += 0.0 if was_up else paused_s
        edges = self.port.edges()
        self.edges += edges
        self.on_step(self.time_s, edges)
        if paused_s > PAUSE_S:
            self._compare_clocks()

    def _forward_s(self) -> float:
        """The current time. LinkError: it is before that of the last step."""
        now_s = self.port.now_s
        if now_s < self.time_s - CLOCK_BACK_S and not self._clock_failed:
            self._clock_failed = True  # so that disarming the robot does not raise again
            raise LinkError(
                f"this computer's clock went back by {self.time_s - now_s:.1f} s while the robot ran: "
                "run again, and let nothing set it meanwhile"
            )
        return now_s

    def check_clock_sync(self, capture_s: float, capture_us: int) -> None:
        """Check that session clock and robot clock agree on a capture time.

        Raises:
            LinkError: this computer's clock was set ahead, or the robot has restarted.
        """
        if self._ahead_s(capture_s, capture_us) > self._ahead_most_s:
            self._compare_clocks()
        else:
            self._robot_us = max(self._robot_us, capture_us)

    @property
    def _ahead_most_s(self) -> float:
        return CLOCK_AHEAD_S + CLOCK_DRIFT * self.time_s

    def _ahead_s(self, here_s: float, robot_us: int) -> float:
        """How far a session time is ahead of the same moment on the robot's clock."""
        return 0.0 if self._offset_us is None else here_s - (robot_us - self._offset_us) * 1e-6

    def _compare_clocks(self) -> None:
        """Compare this computer's clock with the robot's, which is never set."""
        if self._clock_failed or self._offset_us is None or self.port.wire.connections != self._connections:
            return
        self._clock_failed = True  # no check during the request
        robot_us = int(self.request("STATUS")["now_us"])
        ahead_s = self._ahead_s(self.port.now_s, robot_us)
        if robot_us < self._robot_us:
            raise LinkError(
                "the robot or its firmware restarted during the run: charge it, check its plugs, and see its "
                "log ('frogkick log fetch')"
            )
        if ahead_s > self._ahead_most_s:
            raise LinkError(
                f"this computer's clock went ahead by {ahead_s:.1f} s while the robot ran, so that the ages "
                "of position fixes were wrong and the run was ended: run again, and let nothing set it "
                "meanwhile"
            )
        self._clock_failed = False

    @property
    def place(self) -> str:
        return self.port.wire.place if isinstance(self.port, LabPort) else ""

    @property
    def window(self) -> int:
        return self.port.wire.window

    def _ask_all(self, name: str, many: Sequence[Arguments], timeout_s: float) -> list[dict[str, Value]]:
        sequences = [self.post(name, values, rows) for values, rows in many]
        answers: dict[int, dict[str, Value]] = {}
        timeout_s, waited_s, down_s = max(timeout_s, ANSWER_S), 0.0, 0.0
        try:
            while waited_s < timeout_s and down_s < self.patience_s:
                before_s, was_up = self.port.now_s, self.port.wire.is_up
                self.step(before_s + STEP_S)
                if self._answered(name, sequences, answers):
                    return [answers[sequence] for sequence in sequences]
                if was_up:
                    waited_s += self.port.now_s - before_s
                else:
                    down_s += self.port.now_s - before_s
        finally:
            for sequence in sequences:
                self.port.forget(sequence)
        raise LinkError(f"no answer to {name} within {timeout_s:g} s: bring the robot nearer, charge it")

    def handshake(self, tables: Tables) -> dict[str, Value]:
        """Answer to HELLO of a robot with these tables, after authentication."""
        answer = super().handshake(tables)
        self.authenticate()
        return answer

    def make_safe(self) -> bool:
        """Send DISARM; wait at most ``SAFE_S`` for a wire that is down."""
        self.patience_s = SAFE_S
        return super().make_safe()

    @property
    def link_s(self) -> float:
        return self.time_s - self._down_s

    def forget(self, sequence: int) -> None:
        self.port.forget(sequence)

    def reconnected(self) -> bool:
        """Whether the connection was lost and restored since the last call: events may be missing."""
        before, self._connections = self._connections, self.port.wire.connections
        return self._connections != before

    @staticmethod
    @contextmanager
    def real_time_guard() -> Iterator[None]:
        """Switch threads sooner, and exclude existing objects from garbage collection.

        A full collection visits all objects of numba, OpenCV and other packages, which takes 0.1 s and more.
        """
        before_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_S)
        gc.freeze()
        try:
            yield
        finally:
            gc.unfreeze()
            sys.setswitchinterval(before_s)

    @property
    def gaps(self) -> int:
        return self.port.gaps

    def robot_clock_offset_us(self) -> int:
        """Robot time minus session time, from the quickest of some answers to STATUS."""
        quickest_s, offset_us = float("inf"), 0
        for _ in range(CLOCK_SAMPLES):
            before_s = self.port.now_s
            robot_us = int(self.request("STATUS")["now_us"])
            trip_s = self.port.now_s - before_s
            if trip_s < quickest_s:
                quickest_s, offset_us = trip_s, robot_us - round((before_s + trip_s / 2.0) * 1e6)
        self._offset_us = offset_us
        return offset_us

    def _hello(self) -> dict[str, Value]:
        for _ in range(HELLO_TRIES):
            try:
                return self.ask("HELLO", hello())
            except LinkError:
                continue
        damaged = f" ({self.port.bad} damaged frames came)" if self.port.bad else ""
        raise LinkError(
            f"{self.port.wire.name} is connected and does not answer HELLO{damaged}: it has other firmware "
            "or another speed; flash it ('frogkick firmware flash'), or give --dialect frog2022 for the "
            "authors' firmware"
        )


def lab_session(wire: Wire, key_file: Path | None = None) -> LabSession:
    """A session over a wire with a robot that speaks this project's link."""
    return LabSession(LabPort(wire), key_file=key_file)
