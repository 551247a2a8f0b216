"""Ctrl-C that waits while something is done that cannot be left half done, or comes while one waits."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType


class Bell:
    """What the main thread waits for and others ring, where a Ctrl-C may come at any moment.

    One that comes inside ``threading.Condition`` now and then leaves its lock held for ever or gives it up
    twice, as both are taken and given up in Python. Here it is one lock, taken in C or not.
    """

    def __init__(self) -> None:
        self._quiet = threading.Lock()
        self._quiet.acquire()

    def ring(self) -> None:
        """Let who waits look again, or who waits next."""
        with suppress(RuntimeError):  # it rings already
            self._quiet.release()

    def wait_for(self, there: Callable[[], object], timeout_s: float | None = None) -> None:
        """Wait until ``there()`` is true, or for so long. Only one thread may wait.

        Args:
            there: asked now and after each ring; it holds no lock.
            timeout_s: None: for ever.
        """
        until_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not there():
            left_s = -1.0 if until_s is None else until_s - time.monotonic()
            if until_s is not None and left_s <= 0.0:
                return
            self._quiet.acquire(timeout=left_s)


@contextmanager
def ctrl_c_waits() -> Iterator[None]:
    """Hold Ctrl-C back in this thread, and in the processes and threads that it starts, until the end.

    A fork runs functions of its own before and after, which cannot hand Ctrl-C on; a process that is not yet
    told to ignore it would end with a traceback; a library in C that is interrupted while it sets itself up
    may crash.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def ctrl_c_comes_after() -> Iterator[None]:
    """Let a Ctrl-C that comes until the end act there: for C that calls back into Python.

    Python's handler runs in whatever Python the main thread comes to next, and in a callback its error is
    lost. Blocking the signal does not help, as another thread may take it.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    came: list[FrameType | None] = []
    signal.signal(signal.SIGINT, lambda _number, frame: came.append(frame))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            before(signal.SIGINT, came[0])
