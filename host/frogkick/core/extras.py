"""Packages that come with an extra of ours, and the one line that names the extra where one is missing."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import util

from frogkick.core.errors import FrogkickError, InputError

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
"""Extra of pyproject.toml -> the name that a package is imported by -> the name that it is installed by."""


def installed(package: str) -> bool:
    """Whether a package can be imported; it is not imported, which may take a second."""
    return util.find_spec(package) is not None


def install_command(package: str) -> str:
    """How to install what a package comes with: its extra, or frogkick itself.

    Args:
        package: the name that it is imported by.
    """
    extra = next((name for name, packages in EXTRAS.items() if package in packages), None)
    return "pip install frogkick" if extra is None else f"pip install 'frogkick[{extra}]'"


def require(purpose: str, *packages: str, error: type[FrogkickError] = InputError) -> None:
    """Refuse what needs a package that is not installed, before anything is done.

    Args:
        purpose: what needs it, as a sentence begins.
        packages: the names that they are imported by, of ``EXTRAS``.
        error: class of the error.

    Raises:
        FrogkickError: of that class: the first package that is missing, and how to install it.
    """
    names = {each: name for packages in EXTRAS.values() for each, name in packages.items()}
    for package in packages:
        if not installed(package):
            raise error(
                f"{purpose} needs the package {names[package]!r}, which is not installed: "
                f"{install_command(package)}"
            )
