"""A wire to a live robot in this thread, on a clock that only waiting moves: its seconds take no time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.core.log_rig import Log
from tests.link.live_robot import LiveRobot

from frogkick.link.frames import Frame, unpack_frame
from frogkick.link.wire import Delivery, Wire
from frogkick.runs.lab_session import LabPort, LabSession

_STEP_S = 0.005


@dataclass
class Clock:
    """Stands still until somebody waits."""

    now_s: float = 1000.0

    def __call__(self) -> float:
        return self.now_s


def _with_log() -> LiveRobot:
    robot, log = LiveRobot(clock=Clock()), Log()
    robot.core._log = log  # lives as long
    robot.core.core.fk_robot_use_log(robot.core.memory, log.memory)
    return robot


@dataclass
class Inline(Wire):
    """A wire on which frames can get lost.

    Attributes:
        robot: at the other end.
        window: number of commands that may wait for their answers at the same time.
        drops: whether a frame from the robot is lost.
        sent: frames from the host, with their times.
    """

    robot: LiveRobot = field(default_factory=_with_log)
    window: int = 1
    drops: Callable[[Frame], bool] = lambda _frame: False
    sent: list[tuple[float, Frame]] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self.name = "serial:inline"
        assert isinstance(self.robot.clock, Clock)
        self.clock = self.robot.clock
        self._up_again_s = math.inf
        self.connected()

    def session(self) -> LabSession:
        """A session with the robot."""
        return LabSession(LabPort(self, self.clock))

    def names(self) -> list[str]:
        """Names of the frames from the host."""
        return [frame.name for _, frame in self.sent]

    def go_down(self, seconds: float) -> None:
        """Lose the connection, which comes back after a time."""
        self.lost()
        self._up_again_s = self.clock() + seconds

    def send(self, encoded: bytes, how: Delivery) -> None:
        self.sent.append((self.clock(), unpack_frame(encoded[:-1])))
        if self.is_up:
            self._answer(self.robot.feed(encoded))

    def receive(self, timeout_s: float) -> list[tuple[float, bytes]]:
        until_s = self.clock.now_s + max(timeout_s, 1e-6)  # as any clock moves meanwhile
        while not self._arrived and self._error is None and self.clock.now_s < until_s:
            self.clock.now_s = min(until_s, self.clock.now_s + _STEP_S)
            if self.clock() >= self._up_again_s:
                self._up_again_s = math.inf
                self.connected()
            self._answer(self.robot.tick())
        return super().receive(0.0)

    def wait(self, session: LabSession, seconds: float) -> None:
        """Let a session take what comes in a time."""
        until_s = session.port.now_s + seconds
        while session.port.now_s < until_s:
            session.step(until_s)

    def close(self) -> None:
        pass

    def _answer(self, stream: bytes) -> None:
        for encoded in stream.split(b"\0")[:-1]:
            if self.is_up and not self.drops(unpack_frame(encoded)):
                self._arrived.append((self.clock(), encoded + b"\0"))
