"""Progress on stderr, in commands and in notebooks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Protocol

Progress = bool | Callable[[int, int], None]
"""True: a bar on stderr; False: no output; or a function of (done, all)."""


def tell_line(text: str) -> None:
    """Print a line on stderr in a single write, which Ctrl-C cannot cut between text and line end."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


class Tell(Protocol):
    """A function that shows progress, with a note."""

    def __call__(self, done: int, whole: int, /, note: str = "") -> None: ...


Stage = Callable[[str], AbstractContextManager[Tell]]
"""Begins a stage of the work by its title."""


class TellStage(Protocol):
    """What shows the progress of work in several stages."""

    def __call__(self, stage: str, done: int, whole: int, /, note: str = "") -> None: ...


def silent(_stage: str, _done: int, _whole: int, /, note: str = "") -> None:
    """Show nothing."""


@contextmanager
def progress_bar(title: str) -> Iterator[Tell]:
    """Yield a function that updates a bar on stderr. Without a terminal it prints a line at each tenth."""
    if not sys.stderr.isatty():
        last_tenth = -1

        def tell(done: int, whole: int, /, note: str = "") -> None:
            nonlocal last_tenth
            tenth = 10 * done // max(whole, 1)
            if tenth > last_tenth:
                last_tenth = tenth
                tell_line(f"{title}: {done}/{whole}{note and f', {note}'}")

        yield tell
        return
    from rich import console, progress

    columns = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=console.Console(stderr=True), transient=False) as bar:
        task = bar.add_task(title, total=None)

        def update(done: int, whole: int, /, note: str = "") -> None:
            bar.update(task, completed=done, total=whole, description=f"{title}{note and f', {note}'}")

        yield update


@contextmanager
def shown(progress: Progress, title: str) -> Iterator[Tell]:
    """Yield a function of (done, all): it updates a bar, does nothing, or is the caller's own."""
    if progress is True:
        with progress_bar(title) as tell:
            yield tell
        return

    def hand_on(done: int, whole: int, /, note: str = "") -> None:
        if progress is not False:
            progress(done, whole)

    yield hand_on


@contextmanager
def in_stages(stage: Stage, title: str) -> Iterator[TellStage]:
    """Yield a function that begins a stage of ``stage`` with each new name."""
    with ExitStack() as begun:
        current: dict[str, Tell] = {}

        def tell(name: str, done: int, whole: int, /, note: str = "") -> None:
            if name not in current:
                begun.close()
                current.clear()
                current[name] = begun.enter_context(stage(f"{title}: {name}"))
            current[name](done, whole, note)

        yield tell
