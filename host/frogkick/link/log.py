"""The robot's log: fetched from its RAM with LOG, and cut into the records of ``frames.toml``."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from frogkick.core.errors import FrogkickError
from frogkick.link.layout import Field, RecordType, Value, link_layout

HEAD_BYTES = 10
UNFINISHED = -128
"""Status of a command that the robot never got to the end of."""
DAMAGED = "DAMAGED"
"""Name of a record whose check does not fit, or whose number is none."""
_TRIES = 5
_SPAN = 1 << 32  # offsets count modulo this
_TYPES = {record.id: record for record in link_layout().records.values()}
_COMMANDS = {message.id: message for message in link_layout().messages.values() if message.command}


class LogError(FrogkickError):
    """The robot has no log, or does not answer."""


class Conversation(Protocol):
    """What of a session is needed here."""

    def ask(self, name: str, values: dict[str, Value] | None = None) -> dict[str, Value]:
        """Send a command and wait for its answer; FrogkickError where none comes in time."""


@dataclass(frozen=True)
class Stretch:
    """Bytes of a log without a hole, from a record's begin on; ``offset`` is that of the first."""

    offset: int
    content: bytes


@dataclass(frozen=True)
class ChipLog:
    """What was fetched.

    Attributes:
        stretches: in their order; between two something was overwritten before it was fetched.
        lost: records that the robot has overwritten since its log began, fetched or not.
    """

    stretches: tuple[Stretch, ...] = ()
    lost: int = 0

    @property
    def end(self) -> int:
        """Offset at which the next fetch goes on."""
        if not self.stretches:
            return 0
        last = self.stretches[-1]
        return (last.offset + len(last.content)) % _SPAN

    def records(self) -> list[list[Record]]:
        """The records of each stretch; one that has not wholly come is left out."""
        return [records_of(stretch) for stretch in self.stretches]


@dataclass(frozen=True)
class Record:
    """One record.

    Attributes:
        offset: of its first byte.
        name: by ``frames.toml``; DAMAGED where nothing of it can be believed.
        time_us: when, on the robot's clock.
        content: as it came.
    """

    offset: int
    name: str
    time_us: int
    content: bytes

    @property
    def type(self) -> RecordType:
        """What the layout says of it; not of a damaged one."""
        return link_layout().records[self.name]

    @cached_property
    def values(self) -> dict[str, Value]:
        """Its fields by name; of a COMMAND also ``status``; none of a damaged one."""
        if self.name == DAMAGED:
            return {}
        payload = self.type.payload
        values = _unpacked(payload.fields, payload.format, self.content[: payload.bytes])
        if self.name == "COMMAND":
            values["status"] = struct.unpack("b", self.content[-1:])[0]
        return values

    @property
    def rest(self) -> bytes:
        """What follows the fields: a command's payload, a snapshot's bytes."""
        rest = self.content[self.type.payload.bytes :]
        return rest[:-1] if self.name == "COMMAND" else rest

    @property
    def command(self) -> str:
        """Name of the command that a COMMAND tells of; "" of other records."""
        return _COMMANDS[int(self.values["type"])].name if self.name == "COMMAND" else ""

    @property
    def asked(self) -> dict[str, Value]:
        """The fields of that command; none where its length was not the layout's."""
        payload = link_layout().messages[self.command].command
        assert payload is not None
        if len(self.rest) < payload.bytes:
            return {}
        return _unpacked(payload.fields, payload.format, self.rest[: payload.bytes])


def _unpacked(fields: tuple[Field, ...], form: str, content: bytes) -> dict[str, Value]:
    return {field.name: value for field, value in zip(fields, struct.unpack(form, content), strict=True)}


def check_of(raw: bytes) -> int:
    """The check that a record should have; ``raw``: all of it, also where its check stands."""
    total = totals = 0
    for byte in raw[:2] + raw[4:]:
        total = (total + byte) & 0xFF
        totals = (totals + total) & 0xFF
    return total | totals << 8


def records_of(stretch: Stretch) -> list[Record]:
    """Cut a stretch into records."""
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
    """Whether content is as long as its record says."""
    if name == DAMAGED:
        return False
    record = link_layout().records[name]
    if name == "COMMAND":
        return len(content) > record.payload.bytes and content[0] in _COMMANDS
    return len(content) == record.payload.bytes or (bool(record.rest) and len(content) > record.payload.bytes)


def fetch_log(
    link: Conversation,
    known: ChipLog | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> ChipLog:
    """Fetch what a robot's log holds now; in a run or at rest, changing nothing.

    Args:
        link: the conversation.
        known: what an earlier fetch from the same robot gave: only what came since is fetched. A robot that
            was without supply in between has begun another log: give None then.
        progress: called with bytes fetched and to fetch.

    Returns:
        What was known and what is new; another stretch where something was overwritten in between.

    Raises:
        LogError: the robot keeps no log, or does not answer.
    """
    stretches = list(known.stretches) if known is not None else []
    offset = known.end if known is not None else 0
    first: int | None = None
    goal = 0
    while True:
        told = _ask(link, offset)
        at, content = int(told["offset"]), str(told["byte"]).encode("latin-1")
        if not stretches and at != int(told["begin"]):  # the offsets have gone round
            offset = int(told["begin"])
            continue
        if first is None:
            first, goal = at, (int(told["end"]) - at) % _SPAN
        if at != offset or not stretches:
            stretches.append(Stretch(at, b""))
        last = stretches[-1]
        stretches[-1] = Stretch(last.offset, last.content + content)
        offset = (at + len(content)) % _SPAN
        done = (offset - first) % _SPAN
        progress(min(done, goal), goal)
        if done >= goal or not content:  # what came since the first answer is for the next fetch
            return ChipLog(tuple(stretches), int(told["lost"]))


def _ask(link: Conversation, offset: int) -> dict[str, Value]:
    lost: FrogkickError | None = None
    for _ in range(_TRIES):
        try:
            told = link.ask("LOG", {"offset": offset})
        except FrogkickError as error:
            lost = error
            continue
        status = link_layout().status_name(int(told["status"]))
        if status != "OK":
            raise LogError(
                f"the robot answers LOG with {status}: its firmware keeps no log; flash a newer one"
            )
        return told
    raise LogError(f"no answer to LOG, asked {_TRIES} times ({lost}): bring the robot nearer, fetch again")
