"""Sends a table to a robot at rest in chunks, resumes an interrupted transfer, and commits the table."""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from frogkick.core.errors import FrogkickError
from frogkick.link.layout import Arguments, Requester, Value, ask_again, link_layout

CHUNK_BYTES = 128
_TIMEOUT_S = 2.0  # the first chunk of a page waits for its erase, COMMIT for the check of the table


class UploadError(FrogkickError):
    """The robot did not take the table."""


@dataclass(frozen=True)
class Uploaded:
    """Result of an upload."""

    bytes_sent: int  # of the image, without what the robot had already
    resumed_at: int  # offset of the first chunk sent
    table_crc: int  # CRC-32 of the table that the robot uses now


def upload(
    link: Requester, image: bytes, progress: Callable[[int, int], None] = lambda _done, _all: None
) -> Uploaded:
    """Give a robot a table, which it uses from then on. The robot must be disarmed and its limbs rested.

    A robot with one slot that holds the table in use returns to its built-in table first. ``progress`` is
    called with the bytes on the robot and all bytes.

    Raises:
        UploadError: the table is too large, or the robot refuses it.
    """
    here = _ask(link, "TABLE_STATUS")
    if len(image) > int(here["slot_bytes"]):
        raise UploadError(
            f"the table has {len(image)} bytes, the robot has room for {here['slot_bytes']}: make a smaller "
            "one (tables build --budget-kib), or build firmware with this one"
        )
    crc = zlib.crc32(image[16:])  # as in the image's header, whose first 16 bytes it leaves out
    if int(here["running_crc"]) == crc:
        return Uploaded(0, len(image), crc)
    begin: dict[str, Value] = {"length": len(image)}
    digest = struct.unpack(">8I", hashlib.sha256(image).digest())
    begin |= {f"hash_{place}": word for place, word in enumerate(digest)}
    answer = _ask(link, "TABLE_BEGIN", begin, allowed=("OK", "SLOT"))
    if int(answer["status"]) == link_layout().status["SLOT"]:
        _ask(link, "TABLE_ROLLBACK", {"table_crc": here["built_in_crc"]})
        answer = _ask(link, "TABLE_BEGIN", begin)
    first = offset = int(answer["next_offset"])
    while offset < len(image):
        progress(offset, len(image))
        places = range(offset, min(len(image), offset + link.window * CHUNK_BYTES), CHUNK_BYTES)
        chunks: list[Arguments] = [
            ({"offset": at}, [(byte,) for byte in image[at : at + CHUNK_BYTES]]) for at in places
        ]
        answers = _ask_all(link, "TABLE_CHUNK", chunks, ("OK", "OFFSET"))
        # A chunk that arrived after a lost one is sent again.
        offset = max(int(answer["next_offset"]) for answer in answers)
    used_crc = int(_ask(link, "TABLE_COMMIT")["table_crc"])
    if used_crc != crc:
        raise UploadError(
            f"the robot reports that it uses the table with CRC-32 {used_crc:08x}, sent was {crc:08x}: send "
            "it again"
        )
    progress(len(image), len(image))
    return Uploaded(len(image) - first, first, crc)


def _ask(
    link: Requester,
    name: str,
    values: dict[str, Value] | None = None,
    allowed: tuple[str, ...] = ("OK",),
) -> dict[str, Value]:
    return _ask_all(link, name, [(values, ())], allowed)[0]


def _ask_all(
    link: Requester, name: str, many: Sequence[Arguments], allowed: tuple[str, ...]
) -> list[dict[str, Value]]:
    """The answers to commands, which it is harmless to repeat."""
    answers = ask_again(link, name, many, UploadError, "send again", _TIMEOUT_S)
    for answer in answers:
        status = link_layout().status_name(int(answer["status"]))
        if status in allowed:
            continue
        why = f" (fk_error_t {answer['error']})" if answer.get("error") else ""
        raise UploadError(
            f"the robot refuses {name} with {status}{why}: "
            + {
                "STATE": "disarm it and let its limbs rest, then send again",
                "TABLE": "make the table for this robot and this firmware",
                "WORN": "its flash is worn out; build its firmware with this table",
                "UNKNOWN": "its firmware takes no tables by radio; flash it with this table",
            }.get(status, "send again")
        )
    return answers
