"""The fields of each frame (``frames.toml``); what each event does in each state (``supervisor.toml``)."""

from __future__ import annotations

import builtins
import struct
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Protocol

from frogkick.core.errors import FrogkickError, printable

_FORMATS = {"u8": "B", "i8": "b", "u16": "H", "u32": "I", "u64": "Q", "f32": "f", "char16": "16s"}

_TRIES = 5  # of a command
_CLOCK_MAX_US = 2**53 - 1  # 285 years, which floats hold exactly

Value = int | float | str
Arguments = tuple[dict[str, Value] | None, Sequence[Sequence[Value]]]
"""Values and rows of a command."""


class Requester(Protocol):
    """The part of a session that sends commands."""

    @property
    def window(self) -> int: ...  # commands that may wait for their answers at the same time
    def ask_all(
        self, name: str, many: Sequence[Arguments], timeout_s: float = 1.0
    ) -> list[dict[str, Value]]: ...  # FrogkickError where an answer is missing


def ask_again(
    link: Requester,
    name: str,
    many: Sequence[Arguments],
    failure: type[FrogkickError],
    then: str,
    timeout_s: float = 1.0,
) -> list[dict[str, Value]]:
    """Send commands that are safe to repeat, up to five times until all are answered; return the answers.

    Raises:
        FrogkickError: an answer never came. It is a ``failure``, whose text ends with ``then``.
    """
    lost: FrogkickError | None = None
    for _ in range(_TRIES):
        try:
            return link.ask_all(name, many, timeout_s=timeout_s)
        except FrogkickError as error:
            lost = error
    raise failure(
        f"no answer to {name}, asked {_TRIES} times ({lost}): "
        f"check the cable or bring the robot nearer, and {then}"
    )


@dataclass(frozen=True)
class Field:
    """A field of a payload: name, type (a key of ``_FORMATS``), unit and meaning."""

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
        return struct.calcsize(self.format)

    def values_of(self, content: builtins.bytes) -> dict[str, Value]:
        """The fixed fields' values, from the start of a payload's bytes. Texts are printable.

        Raises:
            ValueError: a time (u64) is later than any clock of a robot.
        """
        values = struct.unpack_from(self.format, content)
        if late := [value for value in values if isinstance(value, int) and value > _CLOCK_MAX_US]:
            raise ValueError(f"a time of {late[0]} us")
        return {
            field.name: printable(value.rstrip(b"\x00").decode("ascii", "replace"))
            if isinstance(value, builtins.bytes)
            else value
            for field, value in zip(self.fields, values, strict=True)
        }

    @property
    def repeat_format(self) -> str:
        return "<" + "".join(field.format for field in self.repeat)

    @property
    def repeat_bytes(self) -> int:
        return struct.calcsize(self.repeat_format)


@dataclass(frozen=True)
class Message:
    """A type of frame: a command with its answer, or an event."""

    name: str
    id: int
    doc: str
    command: Payload | None
    answer: Payload | None
    event: Payload | None
    needs_code: bool = False  # a robot with an owner's key takes it only with an authentication code


@dataclass(frozen=True)
class RecordType:
    """A type of record of the robot's log."""

    name: str
    id: int
    doc: str
    payload: Payload  # its fields
    rest: str  # what follows the fields; "": nothing
    like: str  # event or record with the same fields; "": none


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
        return _name_of(self.status, value)

    def fault_name(self, value: int) -> str:
        """Name of a fault; its number where this host does not know it."""
        return _name_of(self.fault, value)


def _name_of(numbers: dict[str, int], value: int) -> str:
    return next((name for name, number in numbers.items() if number == value), str(value))


ANSWER_BIT = 0x80  # added to a command's type to give its answer's
EVENT_BIT = 0x40  # in the type of every event
AUTH_BIT = 0x20
"""Set in the type of a command that carries an authentication code."""


def _payload(table: dict[str, Any], kind: str) -> Payload | None:
    if kind not in table:
        return None
    prefix = "" if kind == "command" else f"{kind}_"
    repeat = _fields(table.get(f"{prefix}repeat", []))
    return Payload(_fields(table[kind]), repeat, table.get(f"{prefix}repeat_max", 0))


def _fields(rows: list[list[str]]) -> tuple[Field, ...]:
    return tuple(Field(*row) for row in rows)


def _record(name: str, tables: dict[str, dict[str, Any]], messages: dict[str, Message]) -> RecordType:
    table = tables[name]
    payload = messages[table["event"]].event if "event" in table else None
    if payload is None:
        payload = Payload(_fields(tables[table.get("like", name)]["fields"]))
    like = table.get("event", table.get("like", ""))
    return RecordType(name, table["id"], table["doc"], payload, table.get("rest", ""), like)


def _toml(name: str) -> dict[str, Any]:
    text = resources.files("frogkick.link").joinpath(name).read_text(encoding="utf-8")
    return tomllib.loads(text)


@cache
def link_layout() -> Layout:
    """The layout of ``frames.toml``, read once."""
    raw = _toml("frames.toml")
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
        for name, table in raw.pop("message").items()
    }
    tables = raw.pop("record")
    records = {name: _record(name, tables, messages) for name in tables}
    return Layout(**raw, messages=messages, records=records)


@dataclass(frozen=True)
class Rule:
    """A cell of the table: next state, action and status of the answer, by name."""

    next_state: str
    action: str
    status: str


@dataclass(frozen=True)
class Supervisor:
    """What each event does in each of the robot's states."""

    actions: dict[str, str]  # name -> description, in the order of their numbers
    docs: dict[str, str]  # event -> description: commands, then others, in the order of their numbers
    rules: dict[tuple[str, str], Rule]  # cell of each event and state

    def number(self, event: str) -> int:
        """Number of an event; a command's is its frame's id."""
        return 1 + list(self.docs).index(event)


@cache
def supervisor() -> Supervisor:
    """The table of ``supervisor.toml``, read once."""
    raw, layout = _toml("supervisor.toml"), link_layout()
    docs = {name: cells["doc"] for name, cells in raw["event"].items()}
    rules = {
        (name, state): Rule(*cells[state]) for name, cells in raw["event"].items() for state in layout.state
    }
    commands = [(message.id, name) for name, message in layout.messages.items() if message.command]
    assert commands == [(1 + place, name) for place, name in enumerate(list(docs)[: len(commands)])]
    for rule in rules.values():
        assert rule.next_state in layout.state and rule.action in raw["action"]
        assert rule.status in layout.status
    return Supervisor(raw["action"], docs, rules)
