"""What commands share: options, progress on stderr, one JSON object on stdout."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Makes the run repeatable.")]

stderr = Console(stderr=True)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} does not go into JSON")


def show(values: Mapping[str, Any], as_json: bool, text: str = "") -> None:
    """Print a result: as one JSON object, or as text (by default the values, one a line)."""
    if as_json:
        print(json.dumps(dict(values), default=_plain))
        return
    print(text or "\n".join(f"{key}: {value}" for key, value in values.items()))


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr; yields a function of (done, all). Without a terminal: a line at each tenth."""
    if not sys.stderr.isatty():
        told = -1

        def tell(done: int, whole: int) -> None:
            nonlocal told
            tenth = 10 * done // max(whole, 1)
            if tenth > told:
                told = tenth
                print(f"{title}: {done}/{whole}", file=sys.stderr, flush=True)

        yield tell
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=stderr, transient=False) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, whole: bar.update(task, completed=done, total=whole)
