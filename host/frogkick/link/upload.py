"""Sends a table to a robot at rest: in chunks, from where an earlier sending was cut off; then commits it."""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from frogkick.core.errors import FrogkickError
from frogkick.link.layout import Value, link_layout

CHUNK_BYTES = 128
_TRIES = 5
_TIMEOUT_S = 2.0  # a chunk at a page's begin waits for its erase, COMMIT for the check of the whole table


class UploadError(FrogkickError):
    """The robot did not take the table."""


class Conversation(Protocol):
    """What of a session is needed here.

    Attributes:
        window: commands that may be asked at once.
    """

    @property
    def window(self) -> int: ...

    def ask_all(
        self,
        name: str,
        many: Sequence[tuple[dict[str, Value] | None, Sequence[Sequence[Value]]]],
        timeout_s: float = 1.0,
    ) -> list[dict[str, Value]]:
        """Send a command several times and wait for all answers; FrogkickError where one does not come."""


_Asked = tuple[dict[str, Value] | None, Sequence[Sequence[Value]]]


@dataclass(frozen=True)
class Uploaded:
    """What an upload did.

    Attributes:
        bytes_sent: of the image, without what was there already.
        resumed_at: offset of the first chunk sent.
        table_crc: CRC-32 of the table that the robot uses now.
    """

    bytes_sent: int
    resumed_at: int
    table_crc: int


def upload(
    link: Conversation, image: bytes, progress: Callable[[int, int], None] = lambda _done, _all: None
) -> Uploaded:
    """Give a robot another table, which it uses from then on. It must be disarmed and its limbs rested.

    A robot with one slot that holds the table in use goes back to its built-in table first.

    Args:
        link: the conversation.
        image: table image, whole.
        progress: called with bytes that are there and all bytes.

    Raises:
        UploadError: the table does not fit, the robot refuses it, or does not answer.
    """
    here = _ask(link, "TABLE_STATUS")
    if len(image) > int(here["slot_bytes"]):
        raise UploadError(
            f"the table has {len(image)} bytes, the robot has room for {here['slot_bytes']}: make a smaller "
            "one (tables build --budget-kib), or build its firmware anew with this one"
        )
    crc = zlib.crc32(image[16:])
    if int(here["running_crc"]) == crc:
        return Uploaded(0, len(image), crc)
    begin: dict[str, Value] = {"length": len(image)}
    digest = struct.unpack(">8I", hashlib.sha256(image).digest())
    begin |= {f"hash_{place}": word for place, word in enumerate(digest)}
    told = _ask(link, "TABLE_BEGIN", begin, allowed=("OK", "SLOT"))
    if int(told["status"]) == link_layout().status["SLOT"]:
        _ask(link, "TABLE_ROLLBACK", {"table_crc": here["built_in_crc"]})
        told = _ask(link, "TABLE_BEGIN", begin)
    first = offset = int(told["next_offset"])
    while offset < len(image):
        progress(offset, len(image))
        places = range(offset, min(len(image), offset + link.window * CHUNK_BYTES), CHUNK_BYTES)
        chunks: list[_Asked] = [
            ({"offset": at}, [(byte,) for byte in image[at : at + CHUNK_BYTES]]) for at in places
        ]
        answers = _ask_all(link, "TABLE_CHUNK", chunks, ("OK", "OFFSET"))
        # One that came out of turn, after another was lost, comes again.
        offset = max(int(told["next_offset"]) for told in answers)
    told = _ask(link, "TABLE_COMMIT")
    if int(told["table_crc"]) != crc:
        raise UploadError(
            f"the robot says that it uses the table with CRC-32 {int(told['table_crc']):08x}, sent was "
            f"{crc:08x}: send it again"
        )
    progress(len(image), len(image))
    return Uploaded(len(image) - first, first, crc)


def _ask(
    link: Conversation,
    name: str,
    values: dict[str, Value] | None = None,
    rows: Sequence[Sequence[Value]] = (),
    allowed: tuple[str, ...] = ("OK",),
) -> dict[str, Value]:
    return _ask_all(link, name, [(values, rows)], allowed)[0]


def _ask_all(
    link: Conversation, name: str, many: Sequence[_Asked], allowed: tuple[str, ...]
) -> list[dict[str, Value]]:
    """Ask, some times where no answer comes: asking twice does no harm with any of these commands."""
    lost: FrogkickError | None = None
    for _ in range(_TRIES):
        try:
            answers = link.ask_all(name, many, timeout_s=_TIMEOUT_S)
        except FrogkickError as error:
            lost = error
            continue
        names = [(link_layout().status_name(int(told["status"])), told) for told in answers]
        refused = [(status, told) for status, told in names if status not in allowed]
        if not refused:
            return answers
        status, told = refused[0]
        why = f" (fk_error_t {told['error']})" if told.get("error") else ""
        raise UploadError(
            f"the robot refuses {name} with {status}{why}: "
            + {
                "STATE": "disarm it and let its limbs rest, then send again",
                "TABLE": "make the table for this robot and this firmware",
                "WORN": "its flash is worn out; build its firmware with this table",
                "UNKNOWN": "its firmware takes no tables by radio; flash it with this table",
            }.get(status, "send again")
        )
    raise UploadError(
        f"no answer to {name}, asked {_TRIES} times ({lost}): bring the robot nearer, send again"
    )
