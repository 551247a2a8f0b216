"""The link's layout, read from ``frames.toml``: the fields of each frame."""

from __future__ import annotations

import struct
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Protocol

_FORMATS = {"u8": "B", "i8": "b", "u16": "H", "u32": "I", "u64": "Q", "f32": "f", "char16": "16s"}

Value = int | float | str
Arguments = tuple[dict[str, Value] | None, Sequence[Sequence[Value]]]
"""Values and rows of a command."""


class Requester(Protocol):
    """The part of a session that sends commands.

    Attributes:
        window: number of commands that may wait for their answers at the same time.
    """

    @property
    def window(self) -> int: ...

    def ask_all(self, name: str, many: Sequence[Arguments], timeout_s: float = 1.0) -> list[dict[str, Value]]:
        """Send a command several times and wait for all answers; FrogkickError where one is missing."""


@dataclass(frozen=True)
class Field:
    """One field of a payload: its name, wire type, unit and meaning."""

    name: str
    type: str
    unit: str
    doc: str

    @property
    def format(self) -> str:
        """Letter(s) of the ``struct`` module for this field."""
        return _FORMATS[self.type]

    @property
    def bytes(self) -> int:
        """Size on the wire."""
        return struct.calcsize("<" + self.format)


@dataclass(frozen=True)
class Payload:
    """A payload's fixed fields, and the fields repeated after them (PATH's points, LOG's bytes)."""

    fields: tuple[Field, ...]
    repeat: tuple[Field, ...] = ()
    repeat_max: int = 0

    @property
    def format(self) -> str:
        """``struct`` format of the fixed part, little-endian, unpadded."""
        return "<" + "".join(field.format for field in self.fields)

    @property
    def bytes(self) -> int:
        """Size of the fixed part on the wire."""
        return struct.calcsize(self.format)

    @property
    def repeat_format(self) -> str:
        """``struct`` format of one repeated row."""
        return "<" + "".join(field.format for field in self.repeat)

    @property
    def repeat_bytes(self) -> int:
        """Size of one repeated row on the wire."""
        return struct.calcsize(self.repeat_format) if self.repeat else 0


@dataclass(frozen=True)
class Message:
    """A type of frame: a command with its answer, or an event.

    Attributes:
        needs_code: a robot with an owner's key takes it only with an authentication code.
    """

    name: str
    id: int
    doc: str
    command: Payload | None
    answer: Payload | None
    event: Payload | None
    needs_code: bool = False


@dataclass(frozen=True)
class RecordType:
    """A type of record of the robot's log.

    Attributes:
        payload: its fields.
        rest: what follows the fields; "": nothing.
        like: event or record with the same fields; "": none.
    """

    name: str
    id: int
    doc: str
    payload: Payload
    rest: str
    like: str


@dataclass(frozen=True)
class Layout:
    """The link: messages and log records by name, and the named numbers of their fields."""

    protocol_version: int
    payload_bytes_max: int
    status: dict[str, int]
    state: dict[str, int]
    fault: dict[str, int]
    reset: dict[str, int]
    supply: dict[str, int]
    owner: dict[str, int]
    parameter: dict[str, int]
    learn: dict[str, int]
    messages: dict[str, Message]
    records: dict[str, RecordType]

    def status_name(self, value: int) -> str:
        """Name of a status value; its number where this host does not know it."""
        return next((name for name, number in self.status.items() if number == value), str(value))

    def fault_name(self, value: int) -> str:
        """Name of an internal error; its number where this host does not know it."""
        return next((name for name, number in self.fault.items() if number == value), str(value))


ANSWER_BIT = 0x80
EVENT_BIT = 0x40
AUTH_BIT = 0x20
"""Set in the type of a command that carries an authentication code."""


def _payload(table: dict[str, object], key: str) -> Payload | None:
    if key not in table:
        return None
    prefix = {"command": "", "answer": "answer_", "event": "event_"}[key]
    repeat = _fields(table.get(f"{prefix}repeat", []))
    repeat_max = table.get(f"{prefix}repeat_max", 0)
    assert isinstance(repeat_max, int)
    return Payload(_fields(table[key]), repeat, repeat_max)


def _fields(rows: object) -> tuple[Field, ...]:
    assert isinstance(rows, list)
    return tuple(Field(*row) for row in rows)


def _record(name: str, tables: dict[str, dict[str, Any]], messages: dict[str, Message]) -> RecordType:
    table = tables[name]
    payload = messages[table["event"]].event if "event" in table else None
    if payload is None:
        payload = Payload(_fields(tables[table.get("like", name)]["fields"]))
    like = table.get("event", table.get("like", ""))
    return RecordType(name, table["id"], table["doc"], payload, table.get("rest", ""), like)


@cache
def link_layout() -> Layout:
    """The layout of ``frames.toml``, read once."""
    text = resources.files("frogkick.link").joinpath("frames.toml").read_text(encoding="utf-8")
    raw = tomllib.loads(text)
    messages = {
        name: Message(
            name,
            table["id"],
            table["doc"],
            _payload(table, "command"),
            _payload(table, "answer"),
            _payload(table, "event"),
            table.get("needs_code", False),
        )
        for name, table in raw["message"].items()
    }
    return Layout(
        raw["protocol_version"],
        raw["payload_bytes_max"],
        raw["status"],
        raw["state"],
        raw["fault"],
        raw["reset"],
        raw["supply"],
        raw["owner"],
        raw["parameter"],
        raw["learn"],
        messages,
        {name: _record(name, raw["record"], messages) for name in raw["record"]},
    )
