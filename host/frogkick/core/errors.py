"""The classes of all errors that a user can cause."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class FrogkickError(Exception):
    """An error whose text is one line: what is wrong, which value, which limit, what to do next.

    The command line prints the text and exits with code 2. Other packages derive their own classes from it.
    """


class CheckError(FrogkickError):
    """A check failed while a command ran; the command line exits with code 1."""


class InputError(FrogkickError):
    """A file, an option or a value cannot be used as given."""


class ConvergenceError(FrogkickError):
    """A numerical step did not converge or became non-finite; the text gives the state."""


def nearest_name(given: object, known: Iterable[str]) -> str:
    """Return ' (did you mean NAME?)' for the most similar known name, or '' if none is similar."""
    close = difflib.get_close_matches(str(given), list(known), n=1, cutoff=0.5)
    return f" (did you mean {close[0]!r}?)" if close else ""
