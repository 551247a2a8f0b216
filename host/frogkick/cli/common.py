"""What commands share: options, progress on stderr, one JSON object on stdout."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Protocol

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

from frogkick.chunks import check_cluster
from frogkick.errors import InputError
from frogkick.files import atomic_path

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Makes the run repeatable.")]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster", metavar="ADDRESS", help="Run on the Dask scheduler there, as tcp://host:8786, not here."
    ),
]

stderr = Console(stderr=True)


def _plain(value: Any) -> Any:
    """What JSON can say: NaN and infinity, which it cannot, become null."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def json_text(values: Mapping[str, Any]) -> str:
    """One JSON object as text."""
    return json.dumps(_plain(values), allow_nan=False)


def say(text: str) -> None:
    """Print one line to stderr, where it does not disturb what is piped on."""
    stderr.print(f"frogkick: {text}", markup=False, highlight=False, soft_wrap=True)


def say_left_out(rows: Sequence[Mapping[str, str]]) -> None:
    """Tell of runs that are not used, a line each."""
    for row in rows:
        say(f"run {row['run']!r} is LEFT OUT: {row['reason']}")


def show(values: Mapping[str, Any], as_json: bool, text: str = "") -> None:
    """Print a result: as one JSON object, or as text (by default the values, one a line)."""
    if as_json:
        print(json_text(values))
        return
    print(text or "\n".join(f"{key}: {value}" for key, value in values.items()))


def write_picture(figure: Any, out: Path) -> None:
    """Write a matplotlib figure as a PNG, the same bytes every time."""
    with atomic_path(out) as temporary:
        figure.savefig(temporary, format="png", dpi=120, metadata={"Software": None})


def require_writable(out: Path | None, folder: bool = False) -> None:
    """Refuse an --out that cannot be written, before the work and not after it. Writes nothing.

    Raises:
        InputError: a folder where a file is to be written (or the other way), or no place for it.
    """
    if out is None:
        return
    if folder and out.exists() and not out.is_dir():
        raise InputError(f"--out {str(out)!r} is a file: name a folder")
    if not folder and out.is_dir():
        raise InputError(f"--out {str(out)!r} is a folder: name a file in it")
    place = out if folder else out.parent
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        raise InputError(f"cannot write {str(out)!r} in {str(place)!r}: choose another --out")


def share_out(workers: int, cluster: str | None) -> int:
    """Return how many processes to start here, from --workers (0: one for each core) and --cluster.

    Raises:
        InputError: both are given, or the cluster's address can be none.
    """
    if cluster is not None:
        if workers:
            raise InputError(
                f"--workers {workers} counts processes here, --cluster has its own: give one of them"
            )
        check_cluster(cluster)
        return 1
    return workers or os.cpu_count() or 1


class Tell(Protocol):
    """What shows progress."""

    def __call__(self, done: int, whole: int, /, note: str = "") -> None:
        """So much is done, and a word on how it goes."""


@contextmanager
def progress_bar(title: str) -> Iterator[Tell]:
    """A bar on stderr; yields a function of (done, all). Without a terminal: a line at each tenth."""
    if not sys.stderr.isatty():
        told = -1

        def tell(done: int, whole: int, /, note: str = "") -> None:
            nonlocal told
            tenth = 10 * done // max(whole, 1)
            if tenth > told:
                told = tenth
                print(f"{title}: {done}/{whole}{note and f', {note}'}", file=sys.stderr, flush=True)

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

        def update(done: int, whole: int, /, note: str = "") -> None:
            bar.update(task, completed=done, total=whole, description=f"{title}{note and f', {note}'}")

        yield update
