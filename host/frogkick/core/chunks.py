"""Chunks of long work: in this process, in a pool of processes, or on a Dask cluster.

A chunk's result depends only on its arguments, so it is the same on every machine, and a chunk may run twice.
A cluster's scheduler distributes the chunks, and distributes them again if a worker dies.
"""

from __future__ import annotations

import asyncio
import functools
import hashlib
import importlib
import logging
import multiprocessing
import os
import pickle
import platform
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from importlib import metadata, resources
from types import FrameType, ModuleType
from typing import Any, Generic, TypeVar

from frogkick.core.errors import FrogkickError, InputError, require
from frogkick.core.interrupts import STOPS, ctrl_c_waits, handled_by

Ready = TypeVar("Ready")
Task = TypeVar("Task")
Result = TypeVar("Result")

WORKERS_MAX = 256
CONNECT_S = 30
"""Longest time for a scheduler to answer."""
WORKERS_S = 30
"""Longest time until the scheduler has a first worker."""

_RETRIES = 2  # of a chunk that raised, as where it lost a connection; a worker's death is not counted here
_ADDRESS = re.compile(r"(?:(?:tcp|tls)://)?(?:\[[0-9A-Fa-f:.]+\]|[^\s/:\[\]@]+):(\d{1,5})")


@dataclass(frozen=True)
class Job(Generic[Ready, Task, Result]):
    """The part that all chunks of one piece of work share."""

    # function of a module that prepares the work from ``given``, once in each process
    start: Callable[..., Ready]
    given: tuple[Any, ...]  # its arguments. They and the tasks are pickled.
    run: Callable[[Ready, Task], Result]  # function of a module that runs one chunk
    # compiles the functions of a chunk. It is called here before a pool starts: forked workers inherit the
    # result, others find it in numba's cache.
    warm: Callable[[Ready], object]


def run_chunks(
    job: Job[Ready, Task, Result], tasks: Sequence[Task], workers: int, cluster: str | None = None
) -> Iterator[tuple[int, Result]]:
    """Run one chunk for each task, and yield (index of the task, its result) as they finish.

    If the caller stops early, chunks that have begun on the pool are ended and dropped; a cluster drops
    those that wait.

    A user's script needs no guard (``if __name__ == "__main__"``): where processes are not forked, they do
    not run it. Work that only the script itself describes, such as an effect whose class is there, is done in
    this process.

    Args:
        tasks: one for each chunk.
        workers: number of processes, 1 to 256; 1: this one. Ignored with a cluster.
        cluster: address of a Dask scheduler, such as "tcp://host:8786"; None: this machine.

    Raises:
        InputError: workers out of range, or no cluster at the address.
        FrogkickError: a worker process died, or the cluster failed.
    """
    if not 1 <= workers <= WORKERS_MAX:
        raise InputError(f"workers is {workers}: give 1 to {WORKERS_MAX}")
    if not tasks:
        return
    if cluster is not None:
        yield from _on_cluster(job, tasks, cluster)
        return
    with _interrupts() as check:
        if workers == 1 or len(tasks) == 1 or not (forks() or _can_be_sent(job, tasks)):
            ready = job.start(*job.given)
            for index, task in enumerate(tasks):
                check()
                yield index, job.run(ready, task)
        else:
            yield from _on_pool(job, tasks, workers, check)


@contextmanager
def _interrupts() -> Iterator[Callable[[], None]]:
    """Yield a function that raises a Ctrl-C again which other code swallowed, such as a compiler's
    callbacks."""
    seen: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        signal.default_int_handler(number, frame)

    def check() -> None:
        if seen:
            raise KeyboardInterrupt

    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with handled_by(note, signal.SIGINT) if ours else nullcontext():
        yield check


# Set in each worker process by _start_worker, so that a task carries its own numbers only.
_worker: tuple[Callable[[Any, Any], Any], Any] | None = None


def _start_worker(start: Callable[..., Any], given: tuple[Any, ...], run: Callable[[Any, Any], Any]) -> None:
    global _worker
    for number in (signal.SIGINT, *STOPS):  # a stop is the parent's business: it ends the workers
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    sys.stdout = sys.stderr  # an effect of a user's own file may print, and stdout is the parent's alone
    _worker = (run, start(*given))


def _end_with_parent() -> None:
    """End this worker if its parent was killed; it would wait for ever for its next chunk."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_in_worker(task: Any) -> Any:
    if _worker is None:
        raise FrogkickError("a worker process was not started: run chunks through run_chunks")
    run, ready = _worker
    return run(ready, task)


def forks() -> bool:
    """Whether worker processes are forks of this one: on Linux, unless the user chose another start
    method."""
    return sys.platform == "linux" and multiprocessing.get_start_method(allow_none=True) in (None, "fork")


def _can_be_sent(job: Job[Any, Any, Any], tasks: Sequence[Any]) -> bool:
    """Whether a new interpreter can read the work without running the user's script again."""
    try:
        return b"__main__" not in pickle.dumps((job.start, job.given, job.run, tasks))
    except Exception:  # as of a user's own function: pickle raises errors of many kinds
        return False


@contextmanager
def _without_main() -> Iterator[None]:
    """Hide the user's script from processes that are started meanwhile, which would run it from its top."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _on_pool(
    job: Job[Ready, Task, Result], tasks: Sequence[Task], workers: int, check: Callable[[], None]
) -> Iterator[tuple[int, Result]]:
    job.warm(job.start(*job.given))
    check()
    # Forked before this process has threads, which a fork would copy with their locks held.
    method = "fork" if forks() else "spawn"
    executor = ProcessPoolExecutor(
        min(workers, len(tasks)),
        mp_context=multiprocessing.get_context(method),
        initializer=_start_worker,
        initargs=(job.start, job.given, job.run),
    )
    pending: dict[Future[Any], int] = {}
    try:
        with ctrl_c_waits(), nullcontext() if forks() else _without_main():
            pending |= {executor.submit(_run_in_worker, task): index for index, task in enumerate(tasks)}
        for future in as_completed(pending):
            check()
            yield pending.pop(future), future.result()
    except BrokenProcessPool as error:
        raise FrogkickError(
            "a worker process ended unexpectedly (killed, or out of memory): use fewer --workers"
        ) from error
    finally:
        if pending:  # nobody waits for what still runs, which may take long
            for process in [*(executor._processes or {}).values()]:
                process.kill()
        executor.shutdown(wait=True, cancel_futures=True)


def check_cluster(address: str) -> None:
    """Raise InputError, without connecting, if an address is invalid or ``distributed`` is not installed."""
    match = _ADDRESS.fullmatch(address)
    if match is None or not 1 <= int(match[1]) <= 65535:
        raise InputError(
            f"cluster address {address!r} is not HOST:PORT: give the scheduler's, as tcp://127.0.0.1:8786"
        )
    require("--cluster", "distributed")


def _on_cluster(
    job: Job[Ready, Task, Result], tasks: Sequence[Task], address: str
) -> Iterator[tuple[int, Result]]:
    check_cluster(address)
    distributed: Any = importlib.import_module("distributed")  # a second of loading, only when asked for
    try:
        # A look first, with a deadline: a client waits for ever where what listens is mute. In a thread, to
        # have an event loop of its own where the caller runs in one.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(lambda: asyncio.run(_say_hello(address))).result()
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except Exception as error:
        raise InputError(
            f"no Dask scheduler answers at {address!r} within {CONNECT_S} s: start one with 'dask scheduler' "
            "or give its address"
        ) from error
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL)  # its messages are raised as well, and reported below in one line
    try:
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError as error:
            raise InputError(
                f"the Dask scheduler at {address!r} has no workers: start some with 'dask worker {address}'"
            ) from error
        # A task that hands the bytes on, and no scattered data: a scheduler can make it again.
        shared = client.submit(bytes, pickle.dumps((job.start, job.given, job.run)), pure=False)
        code = code_stamp()
        pending = {
            client.submit(
                _run_for_cluster, shared, pickle.dumps(task), code, pure=False, retries=_RETRIES
            ): index
            for index, task in enumerate(tasks)
        }
        with client.as_current():
            finished = distributed.as_completed(list(pending))
        for future in finished:
            result: Result = future.result()
            yield pending.pop(future), result  # forgotten here, a result leaves the cluster's memory too
    except FrogkickError:
        raise
    except (Exception, asyncio.CancelledError) as error:
        raise FrogkickError(
            f"the Dask cluster at {address!r} failed ({type(error).__name__}: {_short(error)}): see its "
            "logs; scheduler and workers need this frogkick installed"
        ) from error
    finally:
        client.close()  # and with it what of ours still waits there
        log.setLevel(level)


async def _say_hello(address: str) -> None:
    comm: Any = importlib.import_module("distributed.comm")
    security: Any = importlib.import_module("distributed.security").Security()
    hello = comm.connect(address, timeout=CONNECT_S, **security.get_connection_args("client"))
    (await asyncio.wait_for(hello, CONNECT_S)).abort()


def _short(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= 160 else text[:160] + "..."


@functools.lru_cache(maxsize=4)  # once in a worker, whose chunks mostly are of one job
def _started(shared: bytes) -> tuple[Callable[[Any, Any], Any], Any]:
    start, given, run = pickle.loads(shared)
    return run, start(*given)


def _run_for_cluster(shared: bytes, task: bytes, code: str) -> Any:
    if code_stamp() != code:
        raise FrogkickError(
            f"the cluster's worker on {platform.node()!r} has another frogkick or other package versions, "
            "which may give other numbers: install the same there"
        )
    run, ready = _started(shared)
    return run(ready, pickle.loads(task))


@functools.lru_cache(maxsize=1)
def code_stamp(*more: str) -> str:
    """Return a hash (SHA-256, hexadecimal) of frogkick's source, the versions of its numerical packages, and
    the source of further packages of the project."""
    digest = hashlib.sha256(f"{platform.python_version()}{numerical_versions()}".encode("ascii"))
    for package in ("frogkick", *more):
        _add_folder(digest, resources.files(package))
    return digest.hexdigest()


def numerical_versions() -> str:
    """Return the versions of the packages whose rounding decides the last bits of a result, one a line."""
    return "".join(
        f"{package} {metadata.version(package)}\n" for package in ("numpy", "numba", "llvmlite", "scipy")
    )


def _add_folder(digest: Any, folder: Any) -> None:
    for entry in sorted(folder.iterdir(), key=lambda e: str(e.name)):
        if entry.is_dir():
            _add_folder(digest, entry)
        elif entry.name.endswith((".py", ".toml")):
            digest.update(entry.name.encode("utf-8") + b"\0" + entry.read_bytes())
