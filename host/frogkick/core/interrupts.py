"""Ctrl-C and its like: delayed while an interruption would do harm, and received while a thread waits."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from types import FrameType
from typing import Any

STOPS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end a program from outside: of ``kill`` and of a terminal that is closed."""


class Bell:
    """A signal between threads; a Ctrl-C may interrupt the main thread that waits for it at any moment.

    ``threading.Condition`` takes and releases its lock in Python, so a Ctrl-C inside it can leave the lock
    held or release it twice. This class has a single lock, which C code takes or does not take.
    """

    def __init__(self) -> None:
        self._quiet = threading.Lock()
        self._quiet.acquire()

    def ring(self) -> None:
        """Wake the waiting thread, or the next one that waits."""
        with suppress(RuntimeError):  # it rings already
            self._quiet.release()

    def wait_for(self, there: Callable[[], object], timeout_s: float | None = None) -> None:
        """Wait until ``there()`` is true or the time is over. Only one thread may wait.

        Args:
            there: called now and after each ring; it must hold no lock.
            timeout_s: longest time to wait; None: unlimited.
        """
        until_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not there():
            left_s = -1.0 if until_s is None else until_s - time.monotonic()
            if until_s is not None and left_s <= 0.0:
                return
            self._quiet.acquire(timeout=left_s)


def interrupt_on_stops() -> None:
    """Let STOPS interrupt the program like a Ctrl-C, so that it cleans up.

    Those that it was told to ignore stay ignored, such as SIGHUP by ``nohup``.
    """
    for number in STOPS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _as_ctrl_c)


def _as_ctrl_c(_number: int, frame: FrameType | None) -> None:
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(signal.SIGINT, frame)
    else:  # Ctrl-C alone is ignored, as by a job in the background
        raise KeyboardInterrupt


@contextmanager
def handled_by(handler: Any, *numbers: int) -> Iterator[None]:
    """Let another handler have some signals in the context; no effect in other threads than the main one."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = [(number, signal.signal(number, handler)) for number in numbers]
    try:
        yield
    finally:
        for number, earlier in before:
            signal.signal(number, signal.SIG_DFL if earlier is None else earlier)


def stops_are_interrupts() -> AbstractContextManager[None]:
    """Let STOPS, also ignored ones, interrupt like Ctrl-C in the context, so that a robot is disarmed."""
    return handled_by(_as_ctrl_c, *STOPS)


def uninterrupted() -> AbstractContextManager[None]:
    """Ignore Ctrl-C and STOPS meanwhile."""
    return handled_by(signal.SIG_IGN, signal.SIGINT, *STOPS)


@contextmanager
def ctrl_c_waits() -> Iterator[None]:
    """Block SIGINT and STOPS in this thread, and in processes and threads that it starts, meanwhile.

    Functions that run around a fork cannot pass KeyboardInterrupt on, a new process would end with a
    traceback, and a C library that is interrupted while it initialises may crash.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *STOPS})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def ctrl_c_comes_after() -> Iterator[None]:
    """Deliver a Ctrl-C at the end of the context, for C code that calls back into Python.

    Python runs the handler in the next Python code of the main thread. In a callback its exception is lost.
    Blocking the signal does not help, because another thread may receive it.
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
