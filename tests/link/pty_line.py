"""A robot at the other end of a real pseudo-terminal, whose cable can be pulled."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.link.live_robot import Listener


class PtyLine:
    """Serial port ``path`` with a robot behind it, in a thread.

    Attributes:
        path: the port; the same name after a cable was plugged in again.
        received: bytes that came from the host so far.
    """

    def __init__(self, folder: Path, robot: Listener) -> None:
        self.path = folder / "robot"
        self.robot = robot
        self.received = 0
        self._lock = threading.Lock()
        self._ends: tuple[int, int] | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)

    def __enter__(self) -> Self:
        self.plug_in()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._thread.join()
        self.pull_out()

    def plug_in(self) -> None:
        """A new pseudo-terminal under the old name."""
        near, far = os.openpty()
        tty.setraw(far)
        os.set_blocking(near, False)
        new = self.path.with_name("new")
        new.symlink_to(os.ttyname(far))
        new.replace(self.path)
        with self._lock:
            self._ends = (near, far)

    def pull_out(self) -> None:
        """The port goes away, and what was on its way with it."""
        with self._lock:
            ends, self._ends = self._ends, None
            self.path.unlink(missing_ok=True)
            for end in ends or ():
                os.close(end)

    def drop(self, for_s: float = 0.0) -> None:
        """Pull the cable and plug it in again."""
        self.pull_out()
        time.sleep(for_s)
        self.plug_in()

    def _live(self) -> None:
        while not self._closing.is_set():
            with self._lock:
                if self._ends is None:
                    self.robot.tick()
                    waiting = False
                else:
                    waiting = bool(select.select([self._ends[0]], [], [], self.robot.sleep_s)[0])
                    data = os.read(self._ends[0], 4096) if waiting else b""
                    self.received += len(data)
                    answers = self.robot.feed(data) + self.robot.tick()
                    if answers:
                        os.write(self._ends[0], answers)
            if not waiting:
                time.sleep(0.0005)  # whoever wants the lock gets it
