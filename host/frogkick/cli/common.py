"""Printing that the commands share."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import typer

from frogkick.core.chunks import check_cluster
from frogkick.core.errors import InputError
from frogkick.core.files import UnwritableError, save_result
from frogkick.core.progress import tell_line


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
    tell_line(f"frogkick: {text}")


def say_left_out(rows: Sequence[Mapping[str, str]]) -> None:
    """Report each run that is not used, on one line."""
    for row in rows:
        say(f"run {row['run']!r} is LEFT OUT: {row['reason']}")


undone: list[str] = []
"""Errors that come after the output: results that could not be saved or sent."""


def save(write: Callable[[Path], object], target: Path) -> None:
    """Write a result as ``save_result`` does; a place that cannot be written is an error after the output."""
    try:
        save_result(write, target)
    except UnwritableError as error:
        undone.append(str(error))


@contextmanager
def tells_undone() -> Iterator[None]:
    """Raise InputError at the end, also after a check that failed, if a result could not be saved or sent."""
    undone.clear()
    try:
        yield
    except typer.Exit:
        if not undone:
            raise
    if undone:
        raise InputError("; ".join(undone))


@dataclass(frozen=True)
class Result:
    """What a command has to print, and whether a check has passed; if not, its exit code is 1."""

    values: Mapping[str, Any]  # printed as one JSON object, or as text
    lines: Sequence[str] | None = None  # the text; None: the values, one a line
    passed: bool = True
    remarks: Sequence[str] = ()  # said after it, see ``say``; "" is none


def show(result: Result, as_json: bool, file: TextIO) -> None:
    """Print a result to a file, as one JSON object or as text."""
    lines = text_lines(result.values) if result.lines is None else result.lines
    for line in [json_text(result.values)] if as_json else lines:
        print(line, file=file, flush=True)
    for remark in filter(None, result.remarks):
        say(remark)
    if not result.passed:
        raise typer.Exit(1)


def require_one_place(workers: int, cluster: str | None) -> None:
    """Raise InputError if both --workers and --cluster are given, or the cluster's address is not valid."""
    if cluster is None:
        return
    if workers:
        raise InputError(
            f"--workers {workers} counts processes on this computer, but --cluster has its own workers: "
            "give only one of the two"
        )
    check_cluster(cluster)
