"""An image into a development kit's flash, through its debug probe (pyOCD)."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from frogkick.core.errors import FrogkickError, InputError, printable, require
from frogkick_codegen.firmware import CHIPS

TARGET = "nrf52832"
FLASH_BYTES = CHIPS["bench"].flash_bytes
PART_ADDRESS, PART = 0x10000100, 0x52832
"""FICR's INFO.PART, and what an nRF52832 says there (product specification, 13.1)."""


class ProbeError(FrogkickError):
    """The probe or the chip behind it did not do as asked."""


def check_image(image: Path) -> int:
    """Length in bytes of an Intel HEX that fits the chip; InputError for any other file."""
    require("an Intel HEX", "intelhex")
    from intelhex import HexReaderError, IntelHex

    try:
        content = IntelHex(str(image))
    except (OSError, UnicodeDecodeError, HexReaderError) as error:
        raise InputError(
            f"image {image.name!r} is no Intel HEX ({error}): give one of firmware build"
        ) from error
    segments = content.segments()
    if not segments:
        raise InputError(f"image {image.name!r} is empty: build it again")
    low, high = segments[0][0], segments[-1][1]
    if high > FLASH_BYTES:
        raise InputError(
            f"image {image.name!r} has bytes at 0x{high - 1:x}, the chip's flash ends at 0x{FLASH_BYTES:x}: "
            "build it for this chip"
        )
    return int(high - low)


def flash(
    image: Path,
    unique_id: str | None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    connect: Callable[[str | None], Any] | None = None,
) -> str:
    """Write an image, only the pages that it has; the chip then starts it. Tables sent by radio stay.

    Args:
        image: Intel HEX of ``frogkick firmware build``.
        unique_id: of the probe, or the beginning of it; None = the only one.
        progress: called with parts done and all parts.
        connect: gives an open session with a probe; by default pyOCD's own.

    Returns:
        The probe's name.

    Raises:
        InputError: no such image, no package, no probe, or more than one.
        ProbeError: another chip, a locked one, or flashing failed.
    """
    check_image(image)
    session = (connect or _connect)(unique_id)
    try:
        with session:
            part = session.target.read32(PART_ADDRESS)
            if part != PART:
                raise ProbeError(
                    f"the probe is on a chip that says it is an nRF{part:x}, the image is for the "
                    f"nRF{PART:x}: choose the probe with --probe"
                )
            _programmer(session, progress).program(str(image), file_format="hex")
            session.target.reset()
            return printable(str(session.probe.description))
    except FrogkickError:
        raise
    except Exception as error:
        raise ProbeError(
            f"flashing failed ({type(error).__name__}: {error}): check cable and power; a locked chip is "
            "opened by 'pyocd erase --chip -t nrf52832', which deletes what is on it"
        ) from error


def _programmer(session: Any, progress: Callable[[int, int], None]) -> Any:
    programmer = importlib.import_module("pyocd.flash.file_programmer").FileProgrammer
    return programmer(session, progress=lambda share: progress(round(100 * share), 100), chip_erase="sector")


def probes(unique_id: str | None = None) -> list[Any]:
    """pyOCD's probes that are plugged in; with ``unique_id`` those whose number begins so."""
    require("flashing", "pyocd")
    logging.getLogger("pyocd").setLevel(logging.CRITICAL)  # what matters of it is in the errors
    helpers = importlib.import_module("pyocd.core.helpers").ConnectHelper
    return list(
        helpers.get_all_connected_probes(blocking=False, unique_id=unique_id, print_wait_message=False)
    )


def _connect(unique_id: str | None) -> Any:
    found = probes(unique_id)
    if not found:
        which = "" if unique_id is None else f" whose number begins with {unique_id!r}"
        raise InputError(
            f"no debug probe{which} is plugged in: plug in the kit's USB cable, switch the kit on"
        )
    if len(found) > 1:
        names = ", ".join(f"{probe.unique_id} ({probe.description})" for probe in found)
        raise InputError(f"{len(found)} debug probes are plugged in, {names}: choose one with --probe")
    session = importlib.import_module("pyocd.core.session").Session
    return session(found[0], auto_open=True, options={"target_override": TARGET})
