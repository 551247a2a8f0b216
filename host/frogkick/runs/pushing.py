"""Changes to a robot at rest over the link: a new table, the previous table, an owner's key.

A table is sent in chunks, and an interrupted transfer is resumed. All raise a ``LinkError`` if the robot has
another protocol version, refuses, or does not answer.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

from frogkick.core.errors import FrogkickError
from frogkick.link.auth import KEY_BYTES, default_key_file, new_key, note_place, words
from frogkick.link.layout import Arguments, Requester, Value, ask_again, link_layout
from frogkick.runs.session import LinkError, Session
from frogkick.tables.image import Tables

REST_S = 1.0  # shortest wait for limbs to rest
CHUNK_BYTES = 128
REST_MAX_S = 5.0  # longest period of a robot
_LOSSES = 16
_TIMEOUT_S = 2.0  # the first chunk of a page waits for its erase, COMMIT for the check of the table


class UploadError(FrogkickError):
    """The robot did not take the table."""


@dataclass(frozen=True)
class Uploaded:
    """Result of an upload."""

    bytes_sent: int  # of the image, without what the robot had already
    resumed_at: int  # offset of the first chunk sent; 0: nothing was resumed
    table_crc: int  # CRC-32 of the table that the robot uses now


@dataclass(frozen=True)
class Pushed(Uploaded):
    """Result of a push or a rollback."""

    kept_crc: int  # CRC-32 of the previous table, which it keeps
    took_s: float  # session time

    def as_json(self) -> dict[str, float | int | str]:
        """Keys of the commands; CRCs as hexadecimal text."""
        return {key: f"{value:08x}" if key.endswith("_crc") else value for key, value in asdict(self).items()}


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
    # A round brings one chunk at least, but for those after a loss.
    for _ in range(_LOSSES + 2 * len(image) // CHUNK_BYTES):
        if offset >= len(image):
            break
        progress(offset, len(image))
        places = range(offset, min(len(image), offset + link.window * CHUNK_BYTES), CHUNK_BYTES)
        chunks: list[Arguments] = [
            ({"offset": at}, [(byte,) for byte in image[at : at + CHUNK_BYTES]]) for at in places
        ]
        answers = _ask_all(link, "TABLE_CHUNK", chunks, ("OK", "OFFSET"))
        # A chunk that arrived after a lost one is sent again.
        offset = max(int(answer["next_offset"]) for answer in answers)
    if offset != len(image):
        raise UploadError(
            f"the robot wants byte {offset} of {len(image)} next, and the table does not get complete so: "
            "switch it off and on, and send again"
        )
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


def push(
    session: Session,
    tables: Tables,
    instead_of: Tables | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Pushed:
    """Disarm a robot and give it a table, which it uses from then on. It keeps the previous one.

    Args:
        session: with the robot.
        tables: to send.
        instead_of: the table that it must have now, if not the new one already; None: any.
        progress: called with the bytes on the robot and all bytes.

    Raises:
        LinkError: another protocol or table, or no answer.
        TableError: another robot.
        UploadError: it does not take the table.
    """
    answer = session.hello()
    tables.require_robot(str(answer["robot_id"]))
    carried = int(answer["table_crc"])
    if instead_of is not None and carried not in (instead_of.crc32, tables.crc32):
        raise LinkError(
            f"the robot carries the table with CRC-32 {carried:08x}, the new one was compared with "
            f"{instead_of.crc32:08x}: give the robot's own with --tables, or send the new one anyway with "
            "'frogkick push'"
        )
    rest(session, answer)
    begin_s = session.time_s
    done = upload(session, tables.image, progress)
    return _pushed(session, done.bytes_sent, done.resumed_at, begin_s)


def roll_back(session: Session) -> Pushed:
    """Let a robot return to its previous table."""
    rest(session, session.hello())
    begin_s = session.time_s
    here = session.request("TABLE_STATUS")
    if here["previous_crc"] == here["running_crc"]:
        raise LinkError(
            f"the robot keeps no table besides {int(here['running_crc']):08x}: send it one with "
            "'frogkick push'"
        )
    session.request("TABLE_ROLLBACK", {"table_crc": here["previous_crc"]})
    return _pushed(session, 0, 0, begin_s)


def own(session: Session, release: bool = False, again: bool = False) -> None:
    """Disarm a robot and give it an owner's key that no other robot has; a robot of this owner keeps its own.

    The key is added to ``session.key_file``, which is made if missing.

    Args:
        session: with the robot.
        release: remove the robot's key instead, so that every host may command it.
        again: give a key also to a robot that says that it has none, although the file holds one for it.

    Raises:
        LinkError: the robot has another key, has lost its key, refuses, or does not answer.
        InputError: the key's file cannot be read or written.
    """
    _disarm(session, session.hello())
    file, is_open = session.key_file or default_key_file(), session.is_open()
    if is_open and not release:
        if not again:
            session.require_unowned()
        session.request("KEY", words("key", new_key(file).secret))
    owner = None if is_open and release else session.prove()
    if release and owner is not None:
        session.request("KEY", words("key", bytes(KEY_BYTES)))
    if file.exists():
        note_place(file, session.place, None if release else owner)


def rest(session: Session, hello: Mapping[str, Value]) -> None:
    """Disarm, wait until all limbs have rested, and authenticate. ``hello``: the robot's answer to HELLO."""
    _disarm(session, hello)
    session.authenticate()


def _disarm(session: Session, hello: Mapping[str, Value]) -> None:
    """Disarm, and wait until all limbs have rested. A limb that can fire in each period rests within one."""
    session.ask("DISARM")  # refused only in a fault, when the outputs are off
    end_s = session.time_s + min(max(REST_S, 1e-6 * int(hello["period_us"])), REST_MAX_S)
    while session.time_s < end_s:
        session.step(end_s)


def _pushed(session: Session, sent: int, resumed_at: int, begin_s: float) -> Pushed:
    here = session.request("TABLE_STATUS")
    return Pushed(
        sent, resumed_at, int(here["running_crc"]), int(here["previous_crc"]), session.time_s - begin_s
    )
