"""Keys of the terminal while a real robot swims: Enter arms it, and any key stops the run."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import TextIO

if sys.platform == "win32":
    import msvcrt
else:
    import select
    import termios
    import tty

from frogkick.cli.common import stderr


@contextmanager
def terminal(stdin_is_taken: bool) -> Iterator[TextIO | None]:
    """Yield the stream that keys come from: standard input, or the terminal itself if input is piped.

    The stream is None if there is no terminal, or if this program runs in its background and may not read.
    """
    if not stdin_is_taken:
        yield sys.stdin
        return
    if sys.platform == "win32":
        yield sys.stdin  # it is no terminal, so nothing is asked
        return
    try:
        number = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY)
    except OSError:
        yield None
        return
    with os.fdopen(number, closefd=True) as stream:
        yield stream if os.tcgetpgrp(number) == os.getpgrp() else None


class Keys:
    """A context in which single keys are read without waiting and without Enter; Ctrl-C still interrupts.

    If ``stream`` is no terminal, nothing is asked and no key is ever pressed.
    """

    def __init__(self, stream: TextIO | None, ask: bool = True) -> None:
        """``stream`` is where keys come from, or None. ``ask``: ask for Enter before a robot is armed."""
        self._stream = stream
        self._ask = ask
        self.is_terminal = stream is not None and stream.isatty()

    def __enter__(self) -> Keys:
        if self._stream is not None and self.is_terminal and sys.platform != "win32":
            self._number = self._stream.fileno()
            self._before = termios.tcgetattr(self._number)
            tty.setcbreak(self._number)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.is_terminal and sys.platform != "win32":
            termios.tcsetattr(self._number, termios.TCSADRAIN, self._before)

    def wait_to_arm(self) -> None:
        """Ask for Enter and wait for it; keys that were pressed before do not count."""
        if not (self.is_terminal and self._ask):
            return
        while self._read():
            pass
        stderr.print(
            "press Enter to arm the robot or Ctrl-C to leave; any key stops the run", highlight=False
        )
        while not {b"\r", b"\n"} & set(self._read(wait=True)):
            pass

    def pressed(self) -> bool:
        """Return whether a key has been pressed since the last call."""
        return self.is_terminal and bool(self._read())

    def _read(self, wait: bool = False) -> list[bytes]:
        """Return the bytes that are waiting; with ``wait``, at least one."""
        if sys.platform == "win32":
            found = [msvcrt.getch()] if wait else []
            while msvcrt.kbhit():
                found.append(msvcrt.getch())
            return found
        if not select.select([self._number], [], [], None if wait else 0.0)[0]:
            return []
        read = os.read(self._number, 64)
        if not read:
            raise KeyboardInterrupt  # the terminal is closed
        return [bytes([one]) for one in read]


@contextmanager
def keys_of(stdin_is_taken: bool, ask: bool) -> Iterator[Keys]:
    """Yield the keys of the operator of a real robot.

    Args:
        stdin_is_taken: standard input carries the fixes.
        ask: ask for Enter before the robot is armed.
    """
    with terminal(stdin_is_taken) as stream, Keys(stream, ask) as keys:
        yield keys
