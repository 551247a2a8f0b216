"""Several identifications at once in one process, so that their simulations share batches.

An identification mostly follows a few runs at a time, and the lanes of a batch that these leave idle cost as
much as busy ones. So several go at once, each in a thread of its own: when all of them wait for a simulation,
what they ask for is followed together. What a lane does depends on no other lane, to the last bit, so each
ends with what it would end with alone.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TypeVar, cast

from frogkick.identification import predict
from frogkick.identification.predict import Lane, Track

Result = TypeVar("Result")

AT_ONCE = 8
"""Pieces of work at once: with more, batches are hardly fuller."""


def follow(lanes: Sequence[Lane]) -> list[Track]:
    """Follow runs as ``predict.follow`` does, with those of other work that goes at once."""
    meeting = _MEETING.get()
    return predict.follow(lanes) if meeting is None else meeting.follow(lanes)


def cpu_s() -> float:
    """Processor time that the calling thread has taken, with its share of what was simulated for several."""
    asked = _ASKED.get()
    return time.thread_time() + (0.0 if asked is None else asked.shared_s)


def all_at_once(work: Sequence[Callable[[], Result]], at_once: int = AT_ONCE) -> Iterator[tuple[int, Result]]:
    """Do pieces of work, some at once; yield (index, result) as they end.

    What one raises is raised here; the others are then not gone on with.

    Args:
        work: each calls ``follow`` as often as it likes.
        at_once: how many threads.
    """
    meeting = _Meeting(list(enumerate(work)))
    threads = [threading.Thread(target=meeting.run, daemon=True) for _ in range(min(at_once, len(work)))]
    meeting.busy = len(threads)
    for thread in threads:
        thread.start()
    try:
        yield from cast(Iterator[tuple[int, Result]], meeting.attend())
    finally:
        meeting.end()
        for thread in threads:
            thread.join()


class _Ended(BaseException):
    """Raised in threads whose work nobody waits for any longer."""


@dataclass(eq=False)
class _Asked:
    """What one thread waits for."""

    lanes: Sequence[Lane] = ()
    tracks: list[Track] | None = None
    error: BaseException | None = None
    shared_s: float = 0.0


@dataclass(eq=False)
class _Meeting:
    """Where threads wait for each other.

    Attributes:
        work: what is still to be done.
        busy: threads that neither wait nor have ended.
    """

    work: list[tuple[int, Callable[[], object]]]
    busy: int = 0
    _waiting: list[_Asked] = field(default_factory=list)
    _done: list[tuple[int, object]] = field(default_factory=list)
    _error: BaseException | None = None
    _ended: bool = False
    _change: threading.Condition = field(default_factory=threading.Condition)

    def run(self) -> None:
        """In a thread: piece after piece."""
        _MEETING.set(self)
        _ASKED.set(_Asked())
        try:
            while True:
                with self._change:
                    if not self.work or self._ended:
                        return
                    index, piece = self.work.pop(0)
                result = piece()
                with self._change:
                    self._done.append((index, result))
                    self._change.notify_all()
        except _Ended:
            pass
        except BaseException as error:  # handed to whoever attends
            self._error = error
        finally:
            with self._change:
                self.busy -= 1
                self._change.notify_all()

    def follow(self, lanes: Sequence[Lane]) -> list[Track]:
        """In a thread: wait until what it asks for is followed."""
        asked = _ASKED.get()
        assert asked is not None
        asked.lanes, asked.tracks, asked.error = lanes, None, None
        with self._change:
            self._waiting.append(asked)
            self.busy -= 1
            self._change.notify_all()
            while asked.tracks is None and asked.error is None and not self._ended:
                self._change.wait()
        if asked.error is not None:
            raise asked.error
        if asked.tracks is None:
            raise _Ended
        return asked.tracks

    def attend(self) -> Iterator[tuple[int, object]]:
        """Follow what threads ask for whenever all of them wait, until all work is done."""
        while True:
            with self._change:
                while self.busy and not self._done and self._error is None:
                    self._change.wait()
                done, self._done = self._done, []
                waiting = self._waiting if not self.busy else []
            yield from done
            if self._error is not None:
                raise self._error
            if waiting:
                self._follow_all(waiting)
            elif not done and not self.busy:
                return

    def _follow_all(self, waiting: Sequence[_Asked]) -> None:
        lanes = [lane for asked in waiting for lane in asked.lanes]
        begun_s = time.thread_time()
        try:
            tracks = predict.follow(lanes)
            first = 0
            for asked in waiting:
                asked.tracks = tracks[first : first + len(asked.lanes)]
                first += len(asked.lanes)
        except Exception:  # whose fault it was shows where each is followed alone
            for asked in waiting:
                try:
                    asked.tracks = predict.follow(asked.lanes)
                except Exception as error:
                    asked.error = error
        spent_s = time.thread_time() - begun_s
        for asked in waiting:
            asked.shared_s += spent_s * len(asked.lanes) / max(len(lanes), 1)
        with self._change:
            self._waiting = []
            self.busy += len(waiting)
            self._change.notify_all()

    def end(self) -> None:
        """Let threads that still wait come to an end."""
        with self._change:
            self._ended = True
            self._change.notify_all()


_MEETING: ContextVar[_Meeting | None] = ContextVar("meeting", default=None)
_ASKED: ContextVar[_Asked | None] = ContextVar("asked", default=None)
