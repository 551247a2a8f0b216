"""A serial port that leads to a robot in this program: a pseudo-terminal, whose cable can be pulled.

A name that cannot be used, or a system without pseudo-terminals, is an ``InputError``.
"""

from __future__ import annotations

import os
import select
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Protocol, Self

from frogkick.core.errors import InputError


class Listener(Protocol):
    """The robot behind a transport."""

    def feed(self, data: bytes) -> bytes: ...  # takes bytes from the host, returns those to send at once
    def tick(self) -> bytes: ...  # lets the robot's time pass, returns the bytes to send
    @property
    def sleep_s(self) -> float: ...  # until the next tick


def require_pseudo_terminals() -> None:
    """Check that the operating system has pseudo-terminals.

    Raises:
        InputError: it is Windows.
    """
    if sys.platform == "win32":
        raise InputError(
            "Windows has no pseudo-terminals, which a simulated robot's serial port is: use Linux, macOS or "
            "WSL, or run without a port: 'frogkick run --robot pool'"
        )


class PtyLine:
    """A serial port with a robot behind it, in a thread, as long as the context lives."""

    def __init__(self, link: Path | None, robot: Listener) -> None:
        """``link`` names the port, always the same; None: the pseudo-terminal's own name is the port's."""
        self.robot = robot
        self.received = 0  # bytes that came from the host so far
        self.error: Exception | None = None  # what ended the robot's thread
        self._link = link
        self._name = ""
        self._lock = threading.Lock()
        self._ends: tuple[int, int] | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._live, name="pty line", daemon=True)

    def __enter__(self) -> Self:
        self.plug_in()
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._closing.set()
        self._thread.join()
        self.pull_out()

    @property
    def path(self) -> Path:
        """The port; with a ``link`` it has the same name after the cable was plugged in again."""
        return self._link or Path(self._name)

    @property
    def is_plugged_in(self) -> bool:
        """Whether the port exists."""
        return self._ends is not None

    def plug_in(self) -> None:
        """Make a new pseudo-terminal, under the old name if it has one of its own.

        Raises:
            InputError: the name is taken, or the link to the port cannot be made.
        """
        import tty  # not on Windows

        if self._link is not None and self._link.exists() and not self._link.is_symlink():
            raise InputError(f"{str(self._link)!r} is there already, and no link to a port: choose another")
        near, far = os.openpty()
        tty.setraw(far)
        os.set_blocking(near, False)
        self._name = os.ttyname(far)
        try:
            if self._link is not None:
                new = self._link.with_name(f".{self._link.name}.new")
                new.unlink(missing_ok=True)
                new.symlink_to(self._name)
                new.replace(self._link)
        except OSError as error:
            os.close(near)
            os.close(far)
            raise InputError(f"cannot make the link {str(self._link)!r}: {error.strerror}") from error
        with self._lock:
            self._ends = (near, far)

    def pull_out(self) -> None:
        """The port goes away, and what was on its way with it."""
        with self._lock:
            ends, self._ends = self._ends, None
            if self._link is not None and ends is not None:
                self._link.unlink(missing_ok=True)
            for end in ends or ():
                os.close(end)

    def drop(self) -> None:
        """Pull the cable out and plug it in again."""
        self.pull_out()
        self.plug_in()

    def _live(self) -> None:
        try:
            while not self._closing.is_set():
                if not self._turn():
                    time.sleep(0.0005)  # another thread that waits for the lock gets it
        except Exception as error:  # for the owner of the line, who looks at it
            self.error = error

    def _turn(self) -> bool:
        """Let the robot run for a moment; return whether bytes came from the host."""
        with self._lock:
            if self._ends is None:
                self.robot.tick()
                return False
            near = self._ends[0]
            waiting = bool(select.select([near], [], [], self.robot.sleep_s)[0])
            data = os.read(near, 4096) if waiting else b""
            self.received += len(data)
            answers = self.robot.feed(data) + self.robot.tick()
            if answers:
                with suppress(BlockingIOError):  # no reader: what a full line does not take is lost
                    os.write(near, answers)
            return waiting
