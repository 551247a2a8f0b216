"""Where the firmware's sources are: inside this package where a wheel was installed, beside it in a clone."""

from __future__ import annotations

from pathlib import Path

from frogkick.core.errors import InputError

_PACKAGE = Path(__file__).resolve().parent
_PLACES = (_PACKAGE / "firmware_sources", _PACKAGE.parents[1] / "firmware")
_PARTS = ("core", "bench")


def firmware_sources() -> Path:
    """Return the folder that holds the core, the bench image's port and the Zephyr application.

    Raises:
        InputError: it is in neither place.
    """
    for folder in _PLACES:
        if all((folder / part).is_dir() for part in _PARTS):
            return folder
    raise InputError("the firmware's C sources are not with the package that is installed: install it again")
