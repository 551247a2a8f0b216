"""Keys of the terminal while a real robot swims: Enter arms, any key stops."""

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
    """Where keys are pressed: standard input, or where that brings something else the terminal itself.

    None: there is none, or this program is in its background, where it may not read.
    """
    if not stdin_is_taken:
        yield sys.stdin
        return
    if sys.platform == "win32":
        yield sys.stdin  # no terminal: nothing is asked
        return
    try:
        number = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY)
    except OSError:
        yield None
        return
    with os.fdopen(number, closefd=True) as stream:
        yield stream if os.tcgetpgrp(number) == os.getpgrp() else None


class Keys:
    """What is pressed, without waiting and without Enter, while this is entered; Ctrl-C stays what it is.

    Where ``stream`` is no terminal nothing is asked, and nothing is ever pressed.
    """

    def __init__(self, stream: TextIO | None, ask: bool = True) -> None:
        """``stream``: where keys come from; None: nowhere. ``ask``: for Enter, before a robot is armed."""
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
        """Ask for Enter, and wait for it; what was pressed before does not count."""
        if not (self.is_terminal and self._ask):
            return
        while self._read():
            pass
        stderr.print("press Enter to arm, Ctrl-C to leave; any key stops the run", highlight=False)
        while not {b"\r", b"\n"} & set(self._read(wait=True)):
            pass

    def pressed(self) -> bool:
        """Whether a key has been pressed since this was asked last."""
        return self.is_terminal and bool(self._read())

    def _read(self, wait: bool = False) -> list[bytes]:
        """The bytes that are there; at least one where it is waited for."""
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
    """The keys beside a real robot.

    Args:
        stdin_is_taken: standard input brings fixes.
        ask: for Enter, before the robot is armed.
    """
    with terminal(stdin_is_taken) as stream, Keys(stream, ask) as keys:
        yield keys
