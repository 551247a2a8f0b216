"""The host's frames: every message packed and unpacked, named errors, damaged streams."""

from __future__ import annotations

import re
import struct
import zlib
from contextlib import suppress

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.conftest import REPOSITORY, count

from frogkick.core.errors import InputError
from frogkick.link.frames import (
    ENCODED_MAX,
    PATH_POINTS_MAX,
    FrameCollector,
    FrameError,
    pack_frame,
    path_frames,
    unpack_frame,
)
from frogkick.link.layout import Field, Value, link_layout

MESSAGES = link_layout().messages
KINDS = [
    (name, kind)
    for name, message in MESSAGES.items()
    for kind in ("command", "answer", "event")
    if getattr(message, kind)
]
LIMITS = {
    "u8": (0, 2**8 - 1),
    "i8": (-128, 127),
    "u16": (0, 2**16 - 1),
    "u32": (0, 2**32 - 1),
    "u64": (0, 2**64 - 1),
}
TEXT = st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=16)


def value_of(field: Field) -> st.SearchStrategy[Value]:
    if field.type == "f32":
        return st.floats(width=32, allow_nan=False)
    low, high = LIMITS.get(field.type, (0, 0))
    return TEXT if field.type == "char16" else st.integers(low, min(high, 2**53 - 1))


@pytest.mark.parametrize(("name", "kind"), KINDS)
@settings(max_examples=count(50, 1000, 15), deadline=None)
@given(data=st.data())
def test_every_message_there_and_back(name: str, kind: str, data: st.DataObject) -> None:
    payload = getattr(MESSAGES[name], kind)
    values = {field.name: data.draw(value_of(field)) for field in payload.fields}
    rows = data.draw(
        st.lists(st.tuples(*(value_of(field) for field in payload.repeat)), max_size=payload.repeat_max)
    )
    if kind == "answer" and payload.repeat:  # bytes, as one value
        values[payload.repeat[0].name] = "".join(chr(row[0]) for row in rows)
        rows = []
    sequence = data.draw(st.integers(0, 255))
    encoded = pack_frame(name, kind, sequence, values, rows)
    assert encoded[-1] == 0 and 0 not in encoded[:-1] and len(encoded) <= ENCODED_MAX + 1
    frame = unpack_frame(encoded[:-1])
    assert (frame.name, frame.kind, frame.sequence) == (name, kind, sequence)
    assert frame.values == values and list(frame.rows) == rows


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_every_value_out_of_its_type_is_an_input_error(name: str, kind: str) -> None:
    payload = getattr(MESSAGES[name], kind)
    good: dict[str, Value] = {field.name: "ab" if field.type == "char16" else 1 for field in payload.fields}
    pack_frame(name, kind, 1, good)
    for field in payload.fields:
        if field.type == "f32":
            bad: list[Value] = [1e39, "x"]
        elif field.type == "char16":
            bad = ["x" * 17, "größe", 3]
        else:
            low, high = LIMITS[field.type]
            bad = [low - 1, high + 1, 0.5, "x"]
        for value in bad:
            with pytest.raises(InputError, match=name):
                pack_frame(name, kind, 1, good | {field.name: value})
        without = {key: value for key, value in good.items() if key != field.name}
        with pytest.raises(InputError, match=field.name):
            pack_frame(name, kind, 1, without)
    with pytest.raises(InputError, match="extra"):
        pack_frame(name, kind, 1, good | {"extra": 1})
    with pytest.raises(InputError, match="rows"):
        pack_frame(name, kind, 1, good, [(1.0, 2.0, 3.0)] * (payload.repeat_max + 1))


def test_what_is_not_a_frame_of_the_link_is_an_input_error() -> None:
    with pytest.raises(InputError, match="did you mean 'STATUS'"):
        pack_frame("STATSU", "command", 1)
    with pytest.raises(InputError, match="choose command"):
        pack_frame("HELLO", "question", 1)
    with pytest.raises(InputError, match="HELLO has no event"):
        pack_frame("HELLO", "event", 1)
    for sequence in (-1, 256):
        with pytest.raises(InputError, match="0 to 255"):
            pack_frame("STATUS", "command", sequence)
    with pytest.raises(InputError, match="fit"):
        pack_frame("PATH", "command", 1, {"first": 0, "total": 2, "count": 1}, [(1.0, 2.0)])


def encoded_of(raw: bytes) -> bytes:
    return bytes(cobs.encode(raw + struct.pack("<I", zlib.crc32(raw))))


def test_a_hello_is_refused_by_another_protocol_s_layout() -> None:
    """Of every protocol from 2 on these two fields are the same; only a refusal may have another length."""
    for rest in (b"", bytes(32), bytes(34), bytes(60)):
        frame = unpack_frame(encoded_of(b"\x81\1\xb5\6" + rest))
        assert frame.values["status"] == link_layout().status["VERSION"]
        assert frame.values["protocol_version"] == 6
        with pytest.raises(FrameError, match="layout"):
            unpack_frame(encoded_of(b"\x81\1\0\6" + rest))


def test_what_does_not_fit_the_layout_is_a_frame_error() -> None:
    for encoded in (b"", b"\x05ab", b"\0", encoded_of(b"")[:-1], encoded_of(b"\x01")):
        with pytest.raises(FrameError):
            unpack_frame(encoded)
    for raw in (b"\x34\1", b"\xb4\1\0", b"\xe0\1" + bytes(MESSAGES["DECISION"].event.bytes), b"\xe1\1\0"):
        with pytest.raises(FrameError, match="unknown"):
            unpack_frame(encoded_of(raw))
    for raw in (
        b"\x01\1\0\0",
        b"\x04\1" + bytes(18),
        b"\x60\1\0",
        b"\x05\1" + bytes(4),
        b"\x05\1" + bytes(3 + 19 * 12),
    ):
        with pytest.raises(FrameError, match="layout"):
            unpack_frame(encoded_of(raw))


@pytest.mark.parametrize("name", [name for name, kind in KINDS if kind == "answer"])
def test_a_refusal_may_be_its_status_alone_and_nothing_else_may(name: str) -> None:
    number, payload = MESSAGES[name].id | 0x80, MESSAGES[name].answer
    values = unpack_frame(encoded_of(bytes([number, 1, 0xBF]))).values
    names = [field.name for field in (*payload.fields, *payload.repeat)]
    assert values["status"] == -65 and list(values) == names
    assert not any(value for key, value in values.items() if key != "status")
    for size in {0, 1, 2, payload.bytes - 1, payload.bytes + 1 + payload.repeat_max} - {payload.bytes}:
        with pytest.raises(FrameError, match="layout"):
            unpack_frame(encoded_of(bytes([number, 1]) + bytes(size)))


def test_a_time_that_no_clock_reaches_is_a_frame_error() -> None:
    for time_us in (2**53, 2**63, 2**64 - 1):
        encoded = pack_frame("STROKE", "answer", 1, {"status": 0, "stroke_us": time_us})
        with pytest.raises(FrameError, match=f"a time of {time_us} us"):
            unpack_frame(encoded[:-1])


def test_a_text_of_a_device_does_not_command_a_terminal() -> None:
    values: dict[str, Value] = {field.name: 1 for field in MESSAGES["HELLO"].answer.fields}
    encoded = pack_frame("HELLO", "answer", 1, values | {"robot_id": "\x1b]0;x\x07\r\nfrog"})
    assert unpack_frame(encoded[:-1]).values["robot_id"] == r"\x1b]0;x\x07\r\nfrog"


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_every_flip_of_one_bit_is_refused(name: str, kind: str) -> None:
    payload = getattr(MESSAGES[name], kind)
    values: dict[str, Value] = {field.name: "ab" if field.type == "char16" else 1 for field in payload.fields}
    encoded = pack_frame(name, kind, 1, values)[:-1]
    for position in range(8 * len(encoded)):
        damaged = bytearray(encoded)
        damaged[position // 8] ^= 1 << position % 8
        with pytest.raises(FrameError):
            unpack_frame(bytes(damaged))


@settings(max_examples=count(500, 5000, 100), deadline=None)
@given(st.binary(max_size=400))
def test_any_bytes_raise_nothing_else(stream: bytes) -> None:
    with suppress(FrameError):
        unpack_frame(stream)
    FrameCollector().feed(stream)


def test_a_collector_gives_the_same_frames_however_a_stream_is_cut() -> None:
    rng = np.random.default_rng(2)
    good = [pack_frame("STROKE", "command", index % 256, {"action": index % 9}) for index in range(300)]
    stream = b""
    for encoded in good:
        stream += encoded + [b"", b"\0", b"\0\0", b"\x03abc\0", rng.bytes(30) + b"\0"][int(rng.integers(5))]
    whole = FrameCollector()
    frames = whole.feed(stream)
    assert [frame.values["action"] for frame in frames] == [index % 9 for index in range(300)]
    cut, found, at = FrameCollector(), [], 0
    while at < len(stream):
        size = int(rng.integers(1, 20))
        found += cut.feed(stream[at : at + size])
        at += size
    assert found == frames and cut.bad == whole.bad > 0


def test_a_stream_without_frames_is_looked_at_once() -> None:
    """Of each byte at most a few copies: no part of a stream is copied again for each frame in it."""

    class Counted(bytes):
        copied = 0

        def split(self, *separators: object) -> list[bytes]:  # type: ignore[override]
            Counted.copied += len(self)
            return super().split(*separators)  # type: ignore[arg-type]

        def __radd__(self, before: bytes) -> Counted:
            return Counted(bytes(before) + bytes(self))

    collector = FrameCollector()
    assert collector.feed(Counted(bytes(2**18))) == [] and Counted.copied == 2**18


def test_a_frame_that_never_ends_is_one_bad_frame_and_no_memory() -> None:
    collector = FrameCollector()
    for _ in range(1000):
        assert collector.feed(b"\x07" * 100) == []
    assert collector.bad == 0 and len(collector._bytes) <= ENCODED_MAX + 100
    good = pack_frame("STATUS", "command", 9)
    assert [frame.sequence for frame in collector.feed(b"\0" + good)] == [9]
    assert collector.bad == 1
    largest = b"\xff" + b"\x07" * (ENCODED_MAX - 1)
    assert collector.feed(largest) == [] and collector.feed(b"\0" + good)[0].name == "STATUS"
    assert collector.bad == 2


@pytest.mark.parametrize("points", [2, 18, 19, 36, 37, 100])
def test_paths_are_cut_into_frames(points: int) -> None:
    rows = [(float(index), 0.0, 0.5) for index in range(points)]
    joined: list[object] = []
    for values, part in path_frames(rows):
        assert values == {"first": len(joined), "total": points, "count": len(part)}
        frame = unpack_frame(pack_frame("PATH", "command", 1, values, part)[:-1])
        joined += frame.rows
    assert joined == rows


@pytest.mark.parametrize("points", [0, 1, 101, 300])
def test_a_path_that_the_link_cannot_carry_is_an_input_error(points: int) -> None:
    with pytest.raises(InputError, match=f"path has {points} points"):
        path_frames([(0.0, 0.0, 0.0)] * points)


def test_the_path_limit_is_the_planner_s() -> None:
    header = REPOSITORY / "codegen" / "frogkick_codegen" / "planner" / "fk_planner.h"
    found = re.search(r"#define FK_PATH_POINTS_MAX (\d+)U", header.read_text(encoding="utf-8"))
    assert found and int(found[1]) == PATH_POINTS_MAX


def test_the_layout_is_sound() -> None:
    layout = link_layout()
    ids = [message.id for message in MESSAGES.values()]
    assert len(ids) == len(set(ids)) and all(0 < number < 0x80 for number in ids)
    for name, kind in KINDS:
        payload = getattr(MESSAGES[name], kind)
        assert payload.bytes + payload.repeat_max * payload.repeat_bytes <= layout.payload_bytes_max
        names = [field.name for field in payload.fields]
        assert len(names) == len(set(names))
        if kind == "answer":
            assert payload.fields[0].name == "status", "a refusal may be the status alone"
    for numbers in (layout.status, layout.state, layout.parameter):
        assert len(set(numbers.values())) == len(numbers)
    assert layout.status_name(-64) == "STATE" and layout.status_name(-127) == "-127"
