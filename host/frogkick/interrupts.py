"""Ctrl-C that waits while something is done that cannot be left half done."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager


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
