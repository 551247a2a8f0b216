"""The one base class of every error that a user can cause."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class FrogkickError(Exception):
    """An error with one clear line: what is wrong, which value, which limit, what to do next.

    The command line prints it and exits with 2. Modules derive their own classes from it.
    """


class CheckError(FrogkickError):
    """A check that failed while a command ran; the command line exits with 1."""


class InputError(FrogkickError):
    """A file, option or value that cannot be used as given."""


class ConvergenceError(FrogkickError):
    """A numerical step that did not converge or became non-finite; carries the state in its text."""


def nearest_name(given: str, known: Iterable[str]) -> str:
    """Return ' (did you mean NAME?)' for the closest known name, or '' where none is close."""
    close = difflib.get_close_matches(given, list(known), n=1, cutoff=0.5)
    return f" (did you mean {close[0]!r}?)" if close else ""
