"""The log of a run that breaks off: it is kept beside the file that the whole log would have been."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from frogkick.core.progress import tell_line
from frogkick.runs.closed_loop import Recording
from frogkick.runs.live_log import CUT_OFF, part_of
from frogkick.runs.runlog import RunLog
from frogkick.runs.runlog_file import write_run

Keep = Callable[[Recording], None]


@contextmanager
def reports_partial_log(out: Path | None) -> Iterator[None]:
    """If a run breaks off, print where its log is."""
    try:
        yield
    except BaseException:
        if out is not None and part_of(out).exists():
            _report_partial_log(out)
        raise


@contextmanager
def log_so_far(out: Path | None, log_of: Callable[[Recording], RunLog]) -> Iterator[Keep]:
    """If a simulated run breaks off, write its log so far beside ``out``."""
    held: dict[str, Recording] = {}
    try:
        yield lambda recording: held.update(newest=recording)
    except BaseException:
        if out is not None and held:
            write_run(part_of(out), replace(log_of(held["newest"]), notes=CUT_OFF))
            _report_partial_log(out)
        raise


def _report_partial_log(out: Path) -> None:
    tell_line(f"frogkick: the recording so far is in {str(part_of(out))!r}")
