"""The robot's log: fetched from its RAM with LOG, and split into the records of ``frames.toml``.

A robot that keeps no log, or does not answer, is a ``LogError``.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from frogkick.core.errors import FrogkickError
from frogkick.link.layout import RecordType, Requester, Value, ask_again, link_layout

HEAD_BYTES = 10
LOG_BYTES_MAX = 1 << 20
"""More than any robot keeps: its log is in RAM."""
UNFINISHED = -128
"""Status of a command that the robot did not finish."""
DAMAGED = "DAMAGED"
"""Name of a record with a wrong check or an unknown number."""
_SPAN = 1 << 32  # offsets count modulo this
_LOG = link_layout().messages["LOG"].answer
_PART_BYTES = _LOG.repeat_max if _LOG else 0  # in an answer, unless the log ends there
_TYPES = {record.id: record for record in link_layout().records.values()}
_COMMANDS = {message.id: message for message in link_layout().messages.values() if message.command}


class LogError(FrogkickError):
    """The robot has no log, does not answer, or its answers are not those of a log."""


@dataclass(frozen=True)
class Stretch:
    """Contiguous bytes of a log from the start of a record on; ``offset`` is that of the first byte."""

    offset: int
    content: bytes


@dataclass(frozen=True)
class ChipLog:
    """What was fetched of a robot's log."""

    # in order; the records between two of them were overwritten before they were fetched
    stretches: tuple[Stretch, ...] = ()
    lost: int = 0  # number of records that the robot has overwritten since its log began

    @property
    def end(self) -> int:
        """Offset at which the next fetch continues."""
        if not self.stretches:
            return 0
        last = self.stretches[-1]
        return (last.offset + len(last.content)) % _SPAN

    def records(self) -> list[list[Record]]:
        """The records of each stretch."""
        return [records_of(stretch) for stretch in self.stretches]


@dataclass(frozen=True)
class Record:
    """A record of the log."""

    offset: int  # of its first byte
    name: str  # in ``frames.toml``, or DAMAGED
    time_us: int  # the robot's clock
    content: bytes  # fields and what follows them

    @property
    def type(self) -> RecordType:
        """Its layout; a damaged record has none."""
        return link_layout().records[self.name]

    @cached_property
    def values(self) -> dict[str, Value]:
        """Its fields by name, with ``status`` for a COMMAND; empty for a damaged record."""
        if self.name == DAMAGED:
            return {}
        values = self.type.payload.values_of(self.content)
        if self.name == "COMMAND":
            values["status"] = struct.unpack("b", self.content[-1:])[0]
        return values

    @property
    def rest(self) -> bytes:
        """Bytes after the fields: a command's payload, a snapshot's bytes."""
        rest = self.content[self.type.payload.bytes :]
        return rest[:-1] if self.name == "COMMAND" else rest

    @property
    def command(self) -> str:
        """Name of a COMMAND's command; "" for other records."""
        return _COMMANDS[int(self.values["type"])].name if self.name == "COMMAND" else ""

    @property
    def asked(self) -> dict[str, Value]:
        """The fields of that command; empty where it is shorter than its layout."""
        payload = link_layout().messages[self.command].command
        assert payload is not None
        return payload.values_of(self.rest) if len(self.rest) >= payload.bytes else {}


def check_of(raw: bytes) -> int:
    """The check of a record's bytes (Fletcher), which leaves out the two bytes of the check itself."""
    total = totals = 0
    for byte in raw[:2] + raw[4:]:
        total = (total + byte) & 0xFF
        totals = (totals + total) & 0xFF
    return total | totals << 8


def records_of(stretch: Stretch) -> list[Record]:
    """The records of a stretch of the log, in order; one that is cut off at the end is left out."""
    records, at = [], 0
    while at + HEAD_BYTES <= len(stretch.content):
        length, number, check, low, high = struct.unpack_from("<BBHIH", stretch.content, at)
        raw = stretch.content[at : at + HEAD_BYTES + length]
        if len(raw) < HEAD_BYTES + length:
            break
        name = _TYPES[number].name if number in _TYPES else DAMAGED
        if check != check_of(raw) or not _fits(name, raw[HEAD_BYTES:]):
            name = DAMAGED
        records.append(Record((stretch.offset + at) % _SPAN, name, low | high << 32, bytes(raw[HEAD_BYTES:])))
        at += len(raw)
    return records


def _fits(name: str, content: bytes) -> bool:
    """Whether content is as its record type has it."""
    if name == DAMAGED:
        return False
    record = link_layout().records[name]
    size = record.payload.bytes
    if len(content) < size + (name == "COMMAND") or (len(content) > size and not record.rest):
        return False
    try:
        record.payload.values_of(content)
    except ValueError:
        return False
    return name != "COMMAND" or content[0] in _COMMANDS


def fetch_log(
    link: Requester,
    known: ChipLog | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> ChipLog:
    """Fetch a robot's log, during a run or at rest. The robot does not change.

    Args:
        known: an earlier fetch from the same robot, which the result continues: in another stretch if records
            in between were overwritten. A robot that was without supply since has begun another log, which
            is the result alone as long as it is shorter than what is known; give None if it may be longer.
        progress: called with bytes fetched and all bytes.
    """
    stretches = list(known.stretches) if known is not None else []
    offset = known.end if known is not None else 0
    if not stretches:  # offset 0 may be in the middle, as the offsets wrap
        offset = int(_ask(link, 0)["begin"])
    first: int | None = None
    goal = 0
    # Twice what the largest log takes, as records may be overwritten meanwhile.
    for _ in range(2 * LOG_BYTES_MAX // _PART_BYTES):
        answer = _ask(link, offset)
        at, content = int(answer["offset"]), str(answer["byte"]).encode("latin-1")
        if first is None:
            first, goal = at, (int(answer["end"]) - at) % _SPAN
        if stretches and (at - offset) % _SPAN >= _SPAN // 2:  # before what is known: another log
            stretches.clear()
        if at != offset or not stretches:
            stretches.append(Stretch(at, b""))
        last = stretches[-1]
        stretches[-1] = Stretch(last.offset, last.content + content)
        offset = (at + len(content)) % _SPAN
        done = (offset - first) % _SPAN
        progress(min(done, goal), goal)
        if done >= goal or not content:  # records since the first answer are for the next fetch
            return ChipLog(tuple(stretches), int(answer["lost"]))
    raise LogError("the robot's log does not end: switch the robot off and on")


def _ask(link: Requester, offset: int) -> dict[str, Value]:
    (answer,) = ask_again(link, "LOG", [({"offset": offset}, ())], LogError, "fetch again")
    status = link_layout().status_name(int(answer["status"]))
    if status != "OK":
        raise LogError(f"the robot answers LOG with {status}: its firmware keeps no log; flash a newer one")
    at, begin, end = (int(answer[name]) for name in ("offset", "begin", "end"))
    held, rest = (end - begin) % _SPAN, (end - at) % _SPAN
    if (
        not rest <= held <= LOG_BYTES_MAX
        or at not in (offset, begin)
        or len(str(answer["byte"])) != min(_PART_BYTES, rest)
    ):
        raise LogError(
            f"the robot's answer about a log from byte {begin} to {end} has {len(str(answer['byte']))} bytes "
            f"from {at} on, which no log has: switch the robot off and on, and fetch again"
        )
    return answer
