"""The classes of all errors that a user can cause; optional packages, and the error if one is missing."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from importlib import util


def printable(text: str) -> str:
    """The text with an escape for each character that a terminal may obey instead of showing it."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


class FrogkickError(Exception):
    """An error whose text is one line: what is wrong, which value, which limit, what to do next.

    The command line prints the text and exits with code 2. Other packages derive their own classes from it.
    """

    def __str__(self) -> str:
        # A value such as an array may have several lines, and a device or a file may have chosen it.
        return printable(" ".join(super().__str__().split("\n")))


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


EXTRAS: Mapping[str, Mapping[str, str]] = {
    "firmware": {
        "ziglang": "ziglang",
        "elftools": "pyelftools",
        "intelhex": "intelhex",
        "unicorn": "unicorn",
        "capstone": "capstone",
    },
    "flash": {"pyocd": "pyocd"},
    "link": {"serial": "pyserial", "bleak": "bleak"},
    "cluster": {"distributed": "distributed"},
    "mcap": {
        "mcap": "mcap",
        "mcap_protobuf": "mcap-protobuf-support",
        "foxglove_schemas_protobuf": "foxglove-schemas-protobuf",
    },
    "pandas": {"pandas": "pandas"},
    "apriltag": {"pupil_apriltags": "pupil-apriltags"},
}
"""Extra of pyproject.toml -> import name of a package -> name that it is installed by."""


def installed(package: str) -> bool:
    """Return whether a package can be imported, without importing it."""
    return util.find_spec(package) is not None


def install_command(package: str) -> str:
    """Return the command that installs a package: its extra, or frogkick itself."""
    extra = next((name for name, packages in EXTRAS.items() if package in packages), None)
    return "pip install frogkick" if extra is None else f"pip install 'frogkick[{extra}]'"


def require(purpose: str, *packages: str, error: type[FrogkickError] = InputError) -> None:
    """Raise an error if a package of ``EXTRAS`` is not installed; ``purpose`` begins its text."""
    names = {each: name for packages in EXTRAS.values() for each, name in packages.items()}
    for package in packages:
        if not installed(package):
            raise error(
                f"{purpose} needs the package {names[package]!r}, which is not installed: "
                f"{install_command(package)}"
            )
