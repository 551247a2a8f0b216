"""Optional packages, and the error that says which extra of frogkick installs a missing one."""

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
