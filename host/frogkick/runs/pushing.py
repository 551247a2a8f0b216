"""What a robot at rest is given by the link: another table, the one before, an owner's key."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from frogkick.link.auth import KEY_BYTES, default_key_file, make_key, read_key, words
from frogkick.link.upload import upload
from frogkick.runs.session import LinkError, Session
from frogkick.tables.image import Tables

REST_S = 1.0  # beyond the longest rest that a limb may need after its last pulse


@dataclass(frozen=True)
class Pushed:
    """What came of it.

    Attributes:
        bytes_sent: of the image, without what was there already.
        resumed_at: offset at which an earlier sending was taken up; 0 = all was sent.
        table_crc: CRC-32 of the table that the robot uses now.
        kept_crc: of the one that it keeps to go back to.
        took_s: in the session's time.
    """

    bytes_sent: int
    resumed_at: int
    table_crc: int
    kept_crc: int
    took_s: float

    def as_json(self) -> dict[str, float | int | str]:
        """Keys of the commands; CRCs as hexadecimal text."""
        return {
            "bytes_sent": self.bytes_sent,
            "resumed_at": self.resumed_at,
            "table_crc": f"{self.table_crc:08x}",
            "kept_crc": f"{self.kept_crc:08x}",
            "took_s": self.took_s,
        }


def push(
    session: Session,
    tables: Tables,
    instead_of: Tables | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Pushed:
    """Give a robot a table, which it uses from then on; it is disarmed for it. The one before is kept.

    Args:
        session: with the robot.
        tables: to send.
        instead_of: the table that it must carry now, or the new one already; None: any.
        progress: called with bytes that are there and all bytes.

    Raises:
        LinkError: another protocol or table, or no answer.
        TableError: another robot.
        UploadError: it does not take the table.
    """
    told = session.hello()
    tables.require_robot(str(told["robot_id"]))
    carried = int(told["table_crc"])
    if instead_of is not None and carried not in (instead_of.crc32, tables.crc32):
        raise LinkError(
            f"the robot carries the table with CRC-32 {carried:08x}, the new one was weighed against "
            f"{instead_of.crc32:08x}: give the robot's own with --tables, or send it all the same with "
            "'frogkick push'"
        )
    rest(session)
    session.authenticate()
    begin_s = session.time_s
    done = upload(session, tables.image, progress)
    return _pushed(session, done.bytes_sent, done.resumed_at, begin_s)


def roll_back(session: Session) -> Pushed:
    """Let a robot go back to the table that it used before.

    Raises:
        LinkError: it keeps none, refuses or does not answer.
    """
    session.hello()
    rest(session)
    session.authenticate()
    begin_s = session.time_s
    here = session.request("TABLE_STATUS")
    if here["previous_crc"] == here["running_crc"]:
        raise LinkError(f"the robot keeps no other table than {int(here['running_crc']):08x}: send it one")
    session.request("TABLE_ROLLBACK", {"table_crc": here["previous_crc"]})
    return _pushed(session, 0, 0, begin_s)


def own(session: Session, release: bool = False) -> None:
    """Give a robot the owner's key of ``session.key_file``, or take it away; it is disarmed for it.

    Args:
        session: with the robot.
        release: let anybody command it from then on. Otherwise a key is made where there is none.

    Raises:
        LinkError: it has another key than this host, refuses, or does not answer.
        InputError: the key's file cannot be read or written.
    """
    session.hello()
    rest(session)
    session.authenticate()
    key = bytes(KEY_BYTES)
    if not release:
        file = session.key_file or default_key_file()
        key = read_key(file) if file.exists() else make_key(file)
    session.request("KEY", words("key", key))
    session.authenticate()


def rest(session: Session) -> None:
    """Disarm, and wait until every limb has rested.

    Raises:
        LinkError: it does not answer.
    """
    session.ask("DISARM")  # refused in a fault only, which has the outputs off
    end_s = session.time_s + REST_S
    while session.time_s < end_s:
        session.step(end_s)


def _pushed(session: Session, sent: int, resumed_at: int, begin_s: float) -> Pushed:
    here = session.request("TABLE_STATUS")
    return Pushed(
        sent, resumed_at, int(here["running_crc"]), int(here["previous_crc"]), session.time_s - begin_s
    )
