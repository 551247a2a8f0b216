"""Rollouts of many runs: on all processors, or in batches that several identifications share.

A lane's result depends on no other lane, to the last bit. So a request of more lanes than a batch is wide is
cut in parts, one for each processor. Idle lanes of a batch cost as much as busy ones, so identifications or
fits that do not need each other run concurrently, each in its own thread. When all of them wait for a
simulation, their requests are rolled out together. A thread may run others itself.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TypeVar, cast

from frogkick import der
from frogkick.core.chunks import Job, forks, run_chunks
from frogkick.identification import predict
from frogkick.identification.predict import Lane, Rollout

Result = TypeVar("Result")

THREADS_MAX = 8  # threads: with more, batches are hardly fuller


@dataclass(eq=False)
class Budget:
    """How many periods a search may simulate, and how many it has.

    Simulations are counted and not seconds, so that a result depends on the runs alone.
    """

    most: float
    spent: int = 0
    ended_search: bool = False  # a search would have gone on with more
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def spend(self, lanes: Sequence[Lane]) -> None:
        """Count the periods of some lanes."""
        with self._lock:
            self.spent += sum(len(lane.swim.start_s) for lane in lanes)


@contextmanager
def limited(periods: float) -> Iterator[Budget]:
    """Count what is simulated within, in this thread and those that it waits for; see ``spent_up``."""
    budget = Budget(periods)
    token = _BUDGET.set(budget)
    try:
        yield budget
    finally:
        _BUDGET.reset(token)


def spent_up() -> bool:
    """Whether a search has to end with what it has. Call it between steps, not in concurrent pieces."""
    budget = _BUDGET.get()
    if budget is None or budget.spent < budget.most:
        return False
    budget.ended_search = True
    return True


def roll_out(lanes: Sequence[Lane]) -> list[Rollout]:
    """Roll out runs as ``predict.roll_out`` does, with those of other threads or on all processors."""
    if (budget := _BUDGET.get()) is not None:
        budget.spend(lanes)
    return _roll_out(lanes)


def _roll_out(lanes: Sequence[Lane]) -> list[Rollout]:
    rendezvous = _RENDEZVOUS.get()
    if rendezvous is not None:
        return rendezvous.roll_out(lanes)
    parts = _parts(lanes, _processors())
    if len(parts) < 2:
        return predict.roll_out(lanes)
    # The processes are forks, which have the lanes already: a formula could not be sent to them.
    job = Job(lambda given: given, (lanes,), _rolled_out, lambda _lanes: None)
    rollouts: dict[int, Rollout] = {}
    for part, some in run_chunks(job, parts, len(parts)):
        rollouts.update(zip(parts[part], some, strict=True))
    return [rollouts[index] for index in range(len(lanes))]


def _processors() -> int:
    """Processors that may be used; one in a worker process, and where processes cannot be forked."""
    if not forks() or multiprocessing.parent_process() is not None:
        return 1
    return len(os.sched_getaffinity(0))


def _parts(lanes: Sequence[Lane], count: int) -> list[list[int]]:
    """Indices of lanes in at most ``count`` parts that take about equally long."""
    if count < 2 or len(lanes) <= der.WIDTH:
        return [list(range(len(lanes)))]
    pieces: list[tuple[float, list[int]]] = []
    for indices, _ in predict.lanes_by_body(lanes):
        indices.sort(key=lambda index: -len(lanes[index].swim.start_s))
        cuts = count if len(indices) > der.WIDTH else 1  # part of a batch takes as long as a full one
        for piece in (indices[first::cuts] for first in range(cuts)):
            batches = -(-len(piece) // der.WIDTH)
            pieces.append((batches * len(lanes[piece[0]].swim.start_s), piece))
    parts: list[list[int]] = [[] for _ in range(count)]
    times = [0.0] * count
    for periods, piece in sorted(pieces, key=lambda each: -each[0]):
        part = times.index(min(times))
        times[part] += periods
        parts[part] += piece
    return [part for part in parts if part]


def _rolled_out(lanes: Sequence[Lane], part: Sequence[int]) -> list[Rollout]:
    """Roll out those of the lanes with these indices."""
    return predict.roll_out([lanes[index] for index in part])


def cpu_s() -> float:
    """Processor time of the calling thread, with its share of joint simulations."""
    request = _REQUEST.get()
    return time.thread_time() + (0.0 if request is None else request.shared_s)


def all_of(work: Sequence[Callable[[], Result]]) -> list[Result]:
    """Results of pieces of work that ran concurrently, in their order."""
    if len(work) < 2:
        return [piece() for piece in work]
    done = dict(run_concurrently(work))
    return [done[index] for index in range(len(work))]


def run_concurrently(
    work: Sequence[Callable[[], Result]], threads_max: int = THREADS_MAX
) -> Iterator[tuple[int, Result]]:
    """Run pieces of work concurrently; yield (index, result) as they end.

    An exception in one of them is raised here; the others are then abandoned.
    """
    rendezvous = _Rendezvous(list(enumerate(work)), _BUDGET.get())
    threads = [
        threading.Thread(target=rendezvous.run, daemon=True) for _ in range(min(threads_max, len(work)))
    ]
    rendezvous.busy = len(threads)
    for thread in threads:
        thread.start()
    try:
        yield from cast(Iterator[tuple[int, Result]], rendezvous.serve())
    finally:
        rendezvous.end()
        for thread in threads:
            thread.join()
        if (request := _REQUEST.get()) is not None:
            request.shared_s += rendezvous.own_s


class _Ended(BaseException):
    """Raised in threads whose work was abandoned."""


@dataclass(eq=False)
class _Request:
    """Request of one thread."""

    lanes: Sequence[Lane] = ()
    rollouts: list[Rollout] | None = None
    error: BaseException | None = None
    shared_s: float = 0.0


@dataclass(eq=False)
class _Rendezvous:
    """Where threads wait until all of them have a request."""

    work: list[tuple[int, Callable[[], object]]]  # that is not begun
    budget: Budget | None = None  # of the identification that the work is part of
    busy: int = 0  # threads that neither wait nor have ended
    own_s: float = 0.0  # processor time of the threads that have ended, without simulations
    _waiting: list[_Request] = field(default_factory=list)
    _done: list[tuple[int, object]] = field(default_factory=list)
    _error: BaseException | None = None
    _ended: bool = False
    _change: threading.Condition = field(default_factory=threading.Condition)

    def run(self) -> None:
        """In a thread: run piece after piece."""
        _RENDEZVOUS.set(self)
        _REQUEST.set(_Request())
        _BUDGET.set(self.budget)
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
        except BaseException as error:  # raised again by ``serve``
            self._error = error
        finally:
            with self._change:
                self.own_s += time.thread_time()
                self.busy -= 1
                self._change.notify_all()

    def roll_out(self, lanes: Sequence[Lane]) -> list[Rollout]:
        """In a thread: wait until its lanes are rolled out."""
        request = _REQUEST.get()
        assert request is not None
        request.lanes, request.rollouts, request.error = lanes, None, None
        with self._change:
            self._waiting.append(request)
            self.busy -= 1
            self._change.notify_all()
            while request.rollouts is None and request.error is None and not self._ended:
                self._change.wait()
        if request.error is not None:
            raise request.error
        if request.rollouts is None:
            raise _Ended
        return request.rollouts

    def serve(self) -> Iterator[tuple[int, object]]:
        """Roll out the requests whenever all threads wait, until all work is done."""
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
                self._roll_out_all(waiting)
            elif not done and not self.busy:
                return

    def _roll_out_all(self, waiting: Sequence[_Request]) -> None:
        lanes = [lane for request in waiting for lane in request.lanes]
        begun_s = cpu_s()
        try:
            rollouts = _roll_out(lanes)
            first = 0
            for request in waiting:
                request.rollouts = rollouts[first : first + len(request.lanes)]
                first += len(request.lanes)
        except Exception:  # rolling out each request alone shows whose fault it was
            for request in waiting:
                try:
                    request.rollouts = _roll_out(request.lanes)
                except Exception as error:
                    request.error = error
        spent_s = cpu_s() - begun_s
        for request in waiting:
            request.shared_s += spent_s * len(request.lanes) / max(len(lanes), 1)
        with self._change:
            self._waiting = []
            self.busy += len(waiting)
            self._change.notify_all()

    def end(self) -> None:
        """End the threads that still wait."""
        with self._change:
            self._ended = True
            self._change.notify_all()


_RENDEZVOUS: ContextVar[_Rendezvous | None] = ContextVar("rendezvous", default=None)
_REQUEST: ContextVar[_Request | None] = ContextVar("request", default=None)
_BUDGET: ContextVar[Budget | None] = ContextVar("budget", default=None)
