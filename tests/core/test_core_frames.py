"""The C's frames against the cobs package and zlib, under every kind of damage, and that come again."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.core.core import ACTION, FFI, Robot, cases, collect, core, decode, encode, strings

from frogkick.link.frames import hello, pack_frame
from frogkick.link.layout import AUTH_BIT, Value, link_layout

PAYLOAD_MAX = link_layout().payload_bytes_max
PAYLOADS = st.binary(max_size=PAYLOAD_MAX) | st.integers(0, PAYLOAD_MAX).map(bytes)
BYTE = st.integers(0, 255)


def python_frame(kind: int, sequence: int, payload: bytes) -> bytes:
    """A frame as the reference makes it, without delimiter."""
    raw = bytes([kind, sequence]) + payload
    return bytes(cobs.encode(raw + struct.pack("<I", zlib.crc32(raw))))


@settings(max_examples=cases(1000, 20_000), deadline=None)
@given(BYTE, BYTE, PAYLOADS)
def test_both_ways(kind: int, sequence: int, payload: bytes) -> None:
    assert encode(kind, sequence, payload) == python_frame(kind, sequence, payload) + b"\0"
    assert decode(python_frame(kind, sequence, payload)) == (kind, sequence, payload)


@settings(max_examples=cases(1000, 20_000), deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_are_a_frame_to_both_or_to_none(encoded: bytes) -> None:
    found = decode(encoded)
    try:
        raw = bytes(cobs.decode(encoded))
    except cobs.DecodeError:
        assert found is None
        return
    good = 6 <= len(raw) <= PAYLOAD_MAX + 6 and struct.pack("<I", zlib.crc32(raw[:-4])) == raw[-4:]
    assert found == ((raw[0], raw[1], raw[2:-4]) if good else None)


@pytest.mark.parametrize("size", [0, 1, 19, 100, PAYLOAD_MAX])
def test_every_flip_of_one_bit_is_refused(size: int) -> None:
    payload = np.random.default_rng(size).integers(0, 256, size, dtype=np.uint8).tobytes()
    for filling in (payload, bytes(size), b"\xff" * size):
        encoded = python_frame(0x04, 9, filling)
        for position in range(8 * len(encoded)):
            damaged = bytearray(encoded)
            damaged[position // 8] ^= 1 << position % 8
            assert decode(bytes(damaged)) is None, f"bit {position}"


@pytest.mark.parametrize("size", [0, 5, PAYLOAD_MAX])
def test_every_truncation_is_refused(size: int) -> None:
    encoded = python_frame(0x04, 9, bytes(range(1, size + 1)))
    for length in range(len(encoded)):
        assert decode(encoded[:length]) is None
        assert decode(encoded[length + 1 :]) is None
    assert decode(encoded + b"\x01") is None


def test_a_raw_frame_beyond_the_payload_limit_is_refused() -> None:
    assert decode(python_frame(1, 1, bytes(PAYLOAD_MAX + 1))) is None
    assert decode(python_frame(1, 1, b"\x05" * (PAYLOAD_MAX + 1))) is None
    # A block of 254 bytes: COBS, but more than any frame here holds.
    assert decode(b"\xff" + b"\x07" * 254) is None
    assert decode(b"\x01" * 255) is None


def test_encode_writes_nothing_where_it_does_not_fit() -> None:
    whole = encode(3, 4, b"12345")
    assert len(whole) == 13
    for capacity in range(20):
        assert encode(3, 4, b"12345", capacity) == (whole if capacity >= 13 else b"")
    assert encode(1, 1, bytes(PAYLOAD_MAX + 1)) == b""
    # The largest frame and its delimiter fill what the collector and an EasyDMA buffer hold.
    assert len(encode(1, 1, bytes(PAYLOAD_MAX))) == core().fk_test_encoded_max() == PAYLOAD_MAX + 8 <= 255


def test_garbage_before_a_frame_costs_that_frame_only() -> None:
    good = python_frame(4, 1, b"abc")
    stream = b"\x93\x11\x05" + good + b"\0" + good + b"\0"
    found = collect(stream)
    assert [decode(part) for part in found] == [None, (4, 1, b"abc")]
    # A sender that cannot know what stood on the wire before sends a delimiter first.
    assert [decode(part) for part in collect(b"\x93\x11\x05\0" + good + b"\0")] == [None, (4, 1, b"abc")]


def test_empty_frames_are_nothing() -> None:
    assert collect(bytes(1000)) == []
    good = python_frame(4, 1, b"abc")
    assert collect(b"\0\0" + good + b"\0\0\0" + good + b"\0") == [good, good]


@pytest.mark.parametrize("extra", [-1, 0, 1, 2, 1000, 70_000])
def test_a_frame_that_is_too_long_is_one_bad_frame(extra: int) -> None:
    limit = core().fk_test_encoded_max()
    good = python_frame(4, 1, b"abc")
    found = collect(b"\x07" * (limit + extra) + b"\0" + good + b"\0")
    assert len(found) == 2
    assert len(found[0]) == (limit + extra if extra <= 0 else 1)
    assert decode(found[0]) is None
    assert decode(found[1]) == (4, 1, b"abc")


def test_resynchronisation_after_any_cut() -> None:
    frames = [python_frame(kind, kind, bytes([kind] * 20)) + b"\0" for kind in range(1, 9)]
    stream = b"".join(frames)
    for cut in range(len(frames[0]), 5 * len(frames[0])):
        damaged = stream[:cut] + stream[cut + 3 :]
        kinds = [found[0] for part in collect(damaged) if (found := decode(part))]
        assert len(kinds) >= 6
        assert kinds == sorted(set(kinds)), "a frame came twice or out of order"


def test_random_bytes_change_nothing() -> None:
    many = cases(100_000, 1_000_000)
    rng = np.random.default_rng(11)
    robot = Robot().begin("RUNNING")
    for begin in range(0, many, 10_000):
        lengths = rng.integers(0, 260, min(10_000, many - begin))
        parts = [rng.bytes(int(length)) for length in lengths]
        joined, sizes = strings(parts)
        assert core().fk_test_count_frames(joined, sizes, len(parts)) == 0
        assert core().fk_test_on_frames(robot.memory, joined, sizes, len(parts), robot.now_us) == 0
    assert robot.ask("STATUS")["frames_bad"] == many


def test_commands_with_random_payloads_never_tear_an_answer() -> None:
    """Frames that are whole, with contents that are not: answered, or counted."""
    rng = np.random.default_rng(12)
    robot = Robot().begin("ARMED")
    answered = commands = 0
    for _ in range(cases(20_000, 400_000)):
        kind = int(rng.integers(0, 14)) if rng.random() < 0.9 else int(rng.integers(0, 256))
        payload = rng.bytes(int(rng.choice([0, 1, 4, 5, 19, 25, 15, 27, rng.integers(0, PAYLOAD_MAX + 1)])))
        robot.raw(python_frame(kind, 1, payload))
        robot.tick(robot.now_us + int(rng.integers(0, 30_000)))
        answer = robot.take_bytes()
        parts = [decode(part) for part in collect(answer)]
        assert all(part is not None for part in parts)
        answered += sum(part[0] == kind | 0x80 for part in parts if part)
        commands += kind < AUTH_BIT  # above: with a code, an event, an answer
    assert answered == commands > 0.8 * cases(20_000, 400_000), "each of them"


def test_the_frames_of_both_languages_are_the_same_bytes() -> None:
    encoded = pack_frame("STROKE", "command", 200, {"action": 3})
    assert encode(0x0A, 200, b"\x03") == encoded


def test_floats_keep_their_bits() -> None:
    special = [0x00000000, 0x80000000, 0x00000001, 0x7F7FFFFF, 0x7F800000, 0xFF800000, 0x7FC00000, 0xFFC12345]
    values = np.array(special + np.random.default_rng(1).integers(0, 2**32, 1000).tolist(), dtype=np.uint32)
    data = FFI.new("uint8_t[]", 4 * len(values))
    back = np.zeros_like(values)
    core().fk_test_floats(
        FFI.from_buffer("uint32_t[]", values), len(values), data, FFI.from_buffer("uint32_t[]", back)
    )
    assert bytes(FFI.buffer(data)) == values.astype("<u4").tobytes()
    # x87 could quiet a signalling NaN on its way; nothing else may change a bit.
    signalling = (
        ((values & 0x7F800000) == 0x7F800000) & ((values & 0x003FFFFF) != 0) & ((values >> 22) & 1 == 0)
    )
    assert (back == values)[~signalling].all()


# Commands that come again

MATTER = {
    "ARM": ({}, ()),
    "START": ({"delay_us": 0}, ()),
    "PARAM": ({"parameter": 1, "value": 2.0}, ()),
    "STROKE": ({"action": ACTION["B"]}, ()),
    "PATH": ({"first": 0, "total": 2, "count": 2}, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]),
}


@pytest.mark.parametrize("name", MATTER)
def test_a_command_that_comes_again_acts_once(name: str) -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.fix() == "OK"
    frame = pack_frame(name, "command", 200, *MATTER[name])[:-1]
    robot.raw(frame)
    first = robot.take_bytes()
    robot.now_us += 5_000
    # Between: something that the repetition would undo or do again.
    undone = {"ARM": "DISARM", "START": "STOP", "STROKE": "STOP"}.get(name)
    if undone is not None:
        assert robot.status(undone) == "OK"
    if name == "PARAM":
        assert robot.status("PARAM", {"parameter": 1, "value": 4.0}) == "OK"
    before, seen = robot.state(), robot.ask("STATUS")
    for _ in range(3):
        robot.raw(frame)
        assert robot.take_bytes() == first, "the same answer"
    after = robot.ask("STATUS")
    assert robot.state() == before
    assert after == seen | {"repeats": 3}
    if name == "STROKE":
        assert robot.run_until(robot.now_us + 10**6) == []


def test_whole_frames_are_taken() -> None:
    """A port that sends them one by one never gets half of one; what finds no room waits."""
    robot = Robot()
    for _ in range(4):
        robot.post("STATUS")
    taken = []
    for capacity in (encoded_max := core().fk_test_encoded_max(), encoded_max - 1, 0, 1, encoded_max, 1024):
        part = robot.take_bytes(capacity)
        assert len(part) <= capacity and part[-1:] in (b"", b"\0")
        taken.append(part)
    assert taken[0] and taken[2:4] == [b"", b""]
    whole = Robot()
    for _ in range(4):
        whole.post("STATUS")
    assert b"".join(taken) == whole.take_bytes()


@pytest.mark.parametrize("name", ["DISARM", "STOP"])
def test_what_switches_off_always_acts(name: str) -> None:
    """A second sender may repeat an earlier sender's number: the robot must not say it is off from memory."""
    robot = Robot()
    frame = pack_frame(name, "command", 200, {})[:-1]
    robot.raw(frame)
    robot.take_bytes()
    robot.begin("RUNNING")
    robot.raw(frame)
    (answered,) = (each for each in robot.take() if each.name == name)
    off = "DISARMED" if name == "DISARM" else "ARMED"
    assert (answered.values["status"], answered.values["state"]) == (0, link_layout().state[off])
    assert robot.state() == off
    assert robot.ask("STATUS")["repeats"] == 0
    assert robot.run_until(robot.now_us + 10**7) == [], "no pulse begins any more"


def heard(robot: Robot, name: str, sequence: int, values: dict[str, Value] | None = None) -> str:
    """The status of a command with this number."""
    robot.raw(pack_frame(name, "command", sequence & 0xFF, values or {})[:-1])
    return link_layout().status_name(int(robot.take()[-1].values["status"]))


@pytest.mark.parametrize("late", [1, 15, 16, 63, 64])
def test_a_command_that_comes_again_late(late: int) -> None:
    """Its number is among the newest 64, its answer among the newest 16."""
    robot = Robot()
    assert heard(robot, "ARM", 100) == "OK" and heard(robot, "DISARM", 101) == "OK"
    for sequence in range(102, 101 + late):
        heard(robot, "PARAM", sequence, {"parameter": 1, "value": 2.0})
    assert heard(robot, "ARM", 100) == ("OK" if late < 16 or late > 63 else "DOUBLE")
    assert (robot.memory.state == link_layout().state["ARMED"]) == (late > 63)


@pytest.mark.parametrize("newest", [0, 1, 77, 255])
def test_a_command_acts_once_whatever_its_number(newest: int) -> None:
    """Also where it is just as far ahead of the newest one as behind it."""
    for sequence in range(256):
        robot = Robot()
        heard(robot, "STATUS", newest)
        assert heard(robot, "ARM", newest + sequence) == heard(robot, "DISARM", newest + sequence + 1) == "OK"
        assert heard(robot, "ARM", newest + sequence) in ("OK", "DOUBLE")
        assert robot.memory.state == link_layout().state["DISARMED"], sequence


@pytest.mark.parametrize("lost", [0, 1, 62, 63, 128, 190])
def test_a_number_that_comes_round_again_after_frames_were_lost(lost: int) -> None:
    robot = Robot()
    assert heard(robot, "ARM", 200) == heard(robot, "DISARM", 201) == "OK"
    for sequence in range(202, 200 + 256 - lost):
        heard(robot, "STATUS", sequence)
    assert heard(robot, "ARM", 200) == "OK"
    assert robot.memory.state == link_layout().state["ARMED"], "it was answered, and not done"


def test_nothing_is_a_repetition_after_a_long_silence() -> None:
    """A host that loses as many frames as there are numbers gives them up one after the other."""
    for silent_s, state in ((79, "DISARMED"), (80, "ARMED")):
        robot = Robot()
        assert heard(robot, "ARM", 200) == heard(robot, "DISARM", 201) == "OK"
        robot.tick(robot.now_us + silent_s * 1_000_000)
        assert heard(robot, "ARM", 200) == "OK"
        assert robot.memory.state == link_layout().state[state]


@pytest.mark.parametrize("name", ["FIX", "HELLO"])
def test_numbers_of_fixes_and_of_hellos_do_not_count(name: str) -> None:
    """Neither a fast camera nor another host makes a command act again."""
    robot = Robot()
    assert heard(robot, "ARM", 9) == heard(robot, "DISARM", 10) == "OK"
    for number in range(300):
        fix = {"quality": 1, "capture_age_us": 0, "x_m": 0.1, "y_m": 0.0, "heading_rad": 0.0}
        values = hello() if name == "HELLO" else fix | {"fix_sequence": number}
        robot.now_us += 10_000
        assert heard(robot, name, number, values) == "OK"
        assert heard(robot, "ARM", 9) == "OK" and robot.memory.state == link_layout().state["DISARMED"]
    assert robot.ask("HELLO")["newest"] == 10


def test_hosts_that_follow_each_other_count_on() -> None:
    robot = Robot()
    for host in range(100):
        number = int(robot.ask("HELLO")["newest"])
        assert heard(robot, "ARM", number + 1) == heard(robot, "DISARM", number + 2) == "OK", host
        assert heard(robot, "ARM", number + 3) == "OK", host
        assert robot.memory.state == link_layout().state["ARMED"], host
        assert heard(robot, "DISARM", number + 4) == "OK", host


def test_the_same_number_with_other_contents_is_another_command() -> None:
    robot = Robot()
    robot.raw(pack_frame("PARAM", "command", 7, {"parameter": 1, "value": 2.0})[:-1])
    robot.raw(pack_frame("ARM", "command", 7, {})[:-1])
    robot.take_bytes()
    assert robot.state() == "ARMED"
