"""Frames: payloads with CRC-32 in COBS, packed, unpacked, and collected from a byte stream.

What does not fit its frame is an ``InputError``; bytes that are no frame are a ``FrameError``.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

from cobs import cobs

from frogkick.core.errors import FrogkickError, InputError, nearest_name
from frogkick.link.auth import TRAILER_BYTES, CommandCodes
from frogkick.link.layout import ANSWER_BIT, AUTH_BIT, EVENT_BIT, Arguments, Payload, Value, link_layout

DELIMITER = b"\x00"
# COBS code byte, type, sequence, payload, CRC-32.
ENCODED_MAX = 1 + 2 + link_layout().payload_bytes_max + 4
PATH_POINTS_MAX = 100
_BY_ID = {message.id: message for message in link_layout().messages.values()}


class FrameError(FrogkickError):
    """Bytes that are not a frame of this link."""


@dataclass(frozen=True)
class Frame:
    """A decoded frame, which has all values of its layout.

    The bytes at the end of an answer are a value too, a string in Latin-1. A refusal that came as its status
    alone has zeros for what follows.
    """

    name: str
    kind: str  # "command", "answer" or "event"
    sequence: int
    values: dict[str, Value]
    rows: tuple[tuple[Value, ...], ...] = ()


def pack_frame(
    name: str,
    kind: str,
    sequence: int,
    values: dict[str, Value] | None = None,
    rows: Sequence[Sequence[Value]] = (),
    auth: CommandCodes | None = None,
) -> bytes:
    """Bytes of a frame of ``frames.toml`` on the wire, with delimiter.

    Args:
        kind: "command", "answer" or "event".
        sequence: 0 to 255.
        values: value of each fixed field, and of the bytes at an answer's end, if any.
        rows: repeated rows of a command, in the field order of the layout.
        auth: authentication codes, for a robot that has an owner's key.

    Raises:
        InputError: the layout has no such frame, or a value is missing or out of its range.
    """
    messages = link_layout().messages
    if name not in messages:
        raise InputError(f"frame {name!r} is not in frames.toml{nearest_name(name, messages)}: use its names")
    if kind not in ("command", "answer", "event"):
        raise InputError(f"kind is {kind!r}: choose command, answer or event")
    if not 0 <= sequence <= 255:
        raise InputError(f"sequence is {sequence}, allowed is 0 to 255: count modulo 256")
    message = messages[name]
    payload: Payload | None = getattr(message, kind)
    if payload is None:
        raise InputError(f"{name} has no {kind}: see frames.toml")
    given = values or {}
    tail = payload.repeat[0].name if kind == "answer" and payload.repeat else ""
    wanted = [field.name for field in payload.fields]
    if sorted(given.keys() - {tail}) != sorted(wanted):
        raise InputError(f"{name} takes the fields {wanted}, got {sorted(given)}: give exactly these")
    if len(rows) > payload.repeat_max:
        raise InputError(f"{name} carries at most {payload.repeat_max} rows, got {len(rows)}: split them")
    try:
        ordered = [_wire_value(given[field.name], field.bytes) for field in payload.fields]
        body = struct.pack(payload.format, *ordered)
        body += b"".join(struct.pack(payload.repeat_format, *row) for row in rows)
        body += str(given.get(tail, "")).encode("latin-1") if tail else b""
    except (struct.error, OverflowError, UnicodeEncodeError) as error:
        raise InputError(f"{name} {given} does not fit its fields: {error}") from error
    number = message.id | (ANSWER_BIT if kind == "answer" else 0)
    if auth is not None and kind == "command" and message.needs_code:
        number |= AUTH_BIT
        body += auth.code(number, sequence, body)
    return pack_raw(number, sequence, body)


def pack_raw(number: int, sequence: int, body: bytes) -> bytes:
    """Bytes of a frame of any type and payload on the wire, with delimiter."""
    head = struct.pack("<BB", number, sequence)
    crc = struct.pack("<I", zlib.crc32(head + body))
    return bytes(cobs.encode(head + body + crc)) + DELIMITER


def _wire_value(value: Value, room: int) -> int | float | bytes:
    if not isinstance(value, str):
        return value
    text = value.encode("ascii")
    if len(text) > room:  # struct would truncate it silently
        raise struct.error(f"{value!r} has {len(text)} characters, room is for {room}")
    return text


def unpack_frame(encoded: bytes) -> Frame:
    """Decode one frame (without its delimiter): the one place where what a device sends is checked.

    Raises:
        FrameError: the bytes are no frame of this protocol, or damaged.
    """
    try:
        raw = bytes(cobs.decode(encoded))
    except cobs.DecodeError as error:
        raise FrameError(f"{len(encoded)} bytes are not COBS: {error}") from error
    if len(raw) < 6 or zlib.crc32(raw[:-4]) != struct.unpack("<I", raw[-4:])[0]:
        raise FrameError(f"frame of {len(raw)} bytes fails its CRC-32: dropped")
    number, body = raw[0], raw[2:-4]
    if number & (ANSWER_BIT | EVENT_BIT | AUTH_BIT) == AUTH_BIT:  # a command; only robots check its code
        number, body = number & ~AUTH_BIT, body[:-TRAILER_BYTES]
    message = _BY_ID.get(number & ~ANSWER_BIT)
    is_answer = bool(number & ANSWER_BIT)
    kind = "answer" if is_answer else "event" if message and message.event else "command"
    payload: Payload | None = getattr(message, kind, None)
    if message is None or payload is None:
        raise FrameError(f"frame type 0x{raw[0]:02x} is unknown to protocol {link_layout().protocol_version}")
    if is_answer and body >= b"\x80" and (len(body) == 1 or message.name == "HELLO"):
        # A refusal, whose status is negative. That of HELLO may come in another protocol's length.
        body = body[: payload.bytes].ljust(payload.bytes, b"\0")
    extra = len(body) - payload.bytes
    per_row = payload.repeat_bytes
    if extra < 0 or (extra and (not per_row or extra % per_row or extra > per_row * payload.repeat_max)):
        raise FrameError(f"{message.name} {kind} of {len(body)} bytes, the layout says {payload.bytes}")
    try:
        values = payload.values_of(body)
    except ValueError as error:
        raise FrameError(f"{message.name} {kind} has {error}: dropped") from error
    if kind == "answer" and per_row:  # an answer repeats bytes only
        values[payload.repeat[0].name] = body[payload.bytes :].decode("latin-1")
        return Frame(message.name, kind, raw[1], values)
    rows = tuple(struct.iter_unpack(payload.repeat_format, body[payload.bytes :])) if extra else ()
    return Frame(message.name, kind, raw[1], values, rows)


class FrameCollector:
    """Splits a stream of bytes into frames; ``bad`` counts what is not a frame."""

    def __init__(self) -> None:
        self._bytes = b""
        self._too_long = False
        self.bad = 0

    def feed(self, stream: bytes) -> list[Frame]:
        """Add bytes; return the frames that they complete."""
        frames = []
        *whole, self._bytes = (self._bytes + stream).split(DELIMITER)
        for encoded in whole:
            if self._too_long:  # discarded up to here
                self._too_long = False
                self.bad += 1
                continue
            if not encoded:
                continue
            try:
                frames.append(unpack_frame(encoded))
            except FrameError:
                self.bad += 1
        if len(self._bytes) > ENCODED_MAX:  # noise must not fill the memory
            self._bytes = b""
            self._too_long = True
        return frames


def hello() -> dict[str, Value]:
    """Values of a HELLO."""
    return {"protocol_version": link_layout().protocol_version}


def path_frames(points: Sequence[Sequence[float]]) -> list[Arguments]:
    """Split a path of 2 to 100 points (x_m, y_m, tangent_rad), world frame, into PATH commands.

    Raises:
        InputError: it has fewer or more points.
    """
    payload = link_layout().messages["PATH"].command
    assert payload is not None
    if not 2 <= len(points) <= PATH_POINTS_MAX:
        raise InputError(
            f"path has {len(points)} points, the link carries 2 to {PATH_POINTS_MAX}: resample it"
        )
    most, total = payload.repeat_max, len(points)
    parts = [(first, points[first : first + most]) for first in range(0, total, most)]
    return [({"first": first, "total": total, "count": len(part)}, part) for first, part in parts]
