"""Printing that the commands share."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any, TextIO

import typer
from rich.console import Console

from frogkick.core.chunks import check_cluster
from frogkick.core.errors import InputError
from frogkick.core.files import UnwritableError, save_result

stderr = Console(stderr=True)


def _plain(value: Any) -> Any:
    """Return the value as JSON can hold it: NaN and infinity become null."""
    if hasattr(value, "tolist"):  # of numpy
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


def short(value: Any) -> str:
    """Return a value as text for people: four digits, yes or no, and "-" for an unknown value."""
    value = _plain(value)
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(short, value)) or "-"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {short(each)}" for key, each in value.items()) or "-"
    return str(value)


def text_lines(values: Mapping[str, Any], indent: str = "") -> list[str]:
    """Return values as lines for people: a table below its name, a row of a list on one line."""
    lines = []
    for key, value in values.items():
        rows = isinstance(value, list | tuple) and any(isinstance(each, Mapping) for each in value)
        if isinstance(value, Mapping) and value:
            lines += [f"{indent}{key}:", *text_lines(value, f"{indent}  ")]
        elif rows:
            lines += [f"{indent}{key}:", *(f"{indent}  {short(each)}" for each in value)]
        else:
            lines.append(f"{indent}{key}: {short(value)}")
    return lines


def say(text: str) -> None:
    """Print one line to stderr, so that stdout can be piped."""
    stderr.print(f"frogkick: {text}", markup=False, highlight=False, soft_wrap=True)


def say_left_out(rows: Sequence[Mapping[str, str]]) -> None:
    """Report each run that is not used, on one line."""
    for row in rows:
        say(f"run {row['run']!r} is LEFT OUT: {row['reason']}")


_results: list[TextIO] = []
"""The last is where results are printed; without one it is stdout."""


@contextmanager
def results_alone() -> Iterator[None]:
    """Print only results to stdout; what a user's own file prints, such as an effect, goes to stderr."""
    _results.append(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _results.pop()


_unsaved: list[str] = []


def save(write: Callable[[Path], object], target: Path) -> None:
    """Write a result as ``save_result`` does; a place that cannot be written is an error after the output."""
    try:
        save_result(write, target)
    except UnwritableError as error:
        _unsaved.append(str(error))


@contextmanager
def tells_unsaved() -> Iterator[None]:
    """Raise InputError at the end, also after a check that failed, if ``save`` could not write a result."""
    _unsaved.clear()
    try:
        yield
    except typer.Exit:
        if not _unsaved:
            raise
    if _unsaved:
        raise InputError("; ".join(_unsaved))


def show(values: Mapping[str, Any], as_json: bool, text: str = "", passed: bool = True) -> None:
    """Print a result: as one JSON object, or as text (by default the values, one a line).

    If it has not ``passed``, the command ends with exit code 1.
    """
    written = json_text(values) if as_json else text or "\n".join(text_lines(values))
    print(written, file=_results[-1] if _results else sys.stdout)
    if not passed:
        raise typer.Exit(1)


def require_one_place(workers: int, cluster: str | None) -> None:
    """Check that a command computes either in processes of this computer or on a cluster.

    Raises:
        InputError: --workers and --cluster are given, or the cluster's address is not valid.
    """
    if cluster is None:
        return
    if workers:
        raise InputError(
            f"--workers {workers} counts processes on this computer, but --cluster has its own workers: "
            "give only one of the two"
        )
    check_cluster(cluster)
