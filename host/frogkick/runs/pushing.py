"""Changes to a robot at rest over the link: a new table, the previous table, an owner's key.

All raise a ``LinkError`` if the robot has another protocol version, refuses, or does not answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

from frogkick.link.auth import KEY_BYTES, default_key_file, make_key, read_key, words
from frogkick.link.layout import Value
from frogkick.link.upload import upload
from frogkick.runs.session import LinkError, Session
from frogkick.tables.image import Tables

REST_S = 1.0  # shortest wait for limbs to rest


@dataclass(frozen=True)
class Pushed:
    """Result of a push or a rollback."""

    bytes_sent: int  # of the image, without what the robot had already
    resumed_at: int  # offset at which an earlier transfer was resumed; 0: none
    table_crc: int  # CRC-32 of the table that the robot uses now
    kept_crc: int  # CRC-32 of the previous table, which it keeps
    took_s: float  # session time

    def as_json(self) -> dict[str, float | int | str]:
        """Keys of the commands; CRCs as hexadecimal text."""
        return {key: f"{value:08x}" if key.endswith("_crc") else value for key, value in asdict(self).items()}


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


def own(session: Session, release: bool = False) -> None:
    """Disarm a robot and give it the owner's key of ``session.key_file``, which is made if missing.

    Args:
        session: with the robot.
        release: remove the robot's key instead, so that every host may command it.

    Raises:
        LinkError: the robot has another key, refuses, or does not answer.
        InputError: the key's file cannot be read or written.
    """
    rest(session, session.hello())
    key = bytes(KEY_BYTES)
    if not release:
        file = session.key_file or default_key_file()
        key = read_key(file) if file.exists() else make_key(file)
    session.request("KEY", words("key", key))
    session.authenticate()


def rest(session: Session, hello: Mapping[str, Value]) -> None:
    """Disarm, wait until all limbs have rested, and authenticate.

    ``hello``: the robot's answer to HELLO. A limb that can fire in each period rests within one.
    """
    session.ask("DISARM")  # refused only in a fault, when the outputs are off
    end_s = session.time_s + max(REST_S, 1e-6 * int(hello["period_us"]))
    while session.time_s < end_s:
        session.step(end_s)
    session.authenticate()


def _pushed(session: Session, sent: int, resumed_at: int, begin_s: float) -> Pushed:
    here = session.request("TABLE_STATUS")
    return Pushed(
        sent, resumed_at, int(here["running_crc"]), int(here["previous_crc"]), session.time_s - begin_s
    )
