"""The log in RAM: whole records, the oldest overwritten, read from any offset, kept over a reset."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest
from tests.conftest import from_ci
from tests.core.core import FFI, Robot, cases, core
from tests.core.log_rig import RING_BYTES, Asking, Log, content_of, fetched, names, robot_with_log

from frogkick.link.layout import link_layout
from frogkick.link.log import HEAD_BYTES, LogError, Record, Stretch, check_of, fetch_log, records_of
from frogkick.runs.session import LinkError


def test_ram_as_found_is_an_empty_log() -> None:
    log = Log()
    assert log.kept == 0
    assert log.read() == (0, b"")
    assert log.raw[20:] == Log().raw[20:], "clearing it takes no time"


def test_records_come_back_as_they_were_written() -> None:
    log = Log()
    offset = log.write(content_of(1, 5), 0xABCD_1234_5678)
    assert offset == 0
    assert log.write(content_of(2, 248), 7) == HEAD_BYTES + 12
    first, second = log.records()
    assert (first.name, first.time_us, first.content) == ("SNAPSHOT", 0xABCD_1234_5678, content_of(1, 5))
    assert (second.offset, second.time_us, second.content) == (22, 7, content_of(2, 248))


def test_the_ring_keeps_the_newest_whole_records() -> None:
    log, random_lengths, written = Log(), random.Random(3), []
    for number in range(cases(3000, 100_000)):
        content = content_of(number, random_lengths.randint(1, 248))
        written.append((log.write(content, number), content))
    records = log.records()
    held = sum(HEAD_BYTES + len(record.content) for record in records)
    assert RING_BYTES - 265 < held <= RING_BYTES or len(records) == len(written)
    assert [(r.offset, r.content) for r in records] == written[-len(records) :]
    assert [r.time_us for r in records] == list(range(len(written) - len(records), len(written)))
    assert log.word(4) == len(written) - len(records), "lost"


def test_exactly_full() -> None:
    log = Log()
    for number in range(96):
        log.write(content_of(number, 239))  # 256 bytes each
    assert (len(log.records()), log.word(4)) == (96, 0)
    log.write(content_of(96, 239))
    assert (len(log.records()), log.word(4)) == (96, 1)


def test_read_from_any_offset() -> None:
    log = Log()
    for number in range(200):
        log.write(content_of(number, 239))
    begin, content = log.read()
    assert (begin, len(content)) == (104 * 256, RING_BYTES)
    for offset in (0, 1, begin - 1, begin + RING_BYTES + 1, 2**32 - 1):
        assert log.read(offset, 100) == (begin, content[:100])
    for offset in (begin, begin + 1, begin + 300, begin + RING_BYTES - 100):
        assert log.read(offset, 100) == (offset, content[offset - begin :][:100])
    assert log.read(begin + RING_BYTES - 5, 100) == (begin + RING_BYTES - 5, content[-5:])
    assert log.read(begin + RING_BYTES, 100) == (begin + RING_BYTES, b"")


def test_offsets_go_round_after_four_gigabytes() -> None:
    log = Log()
    size = HEAD_BYTES + 8
    log.words[1] = log.words[2] = 2**32 - size
    log.write(content_of(1, 1))
    log.write(content_of(2, 1))
    offset, content = log.read(2**32 - size)
    assert [record.offset for record in records_of(Stretch(offset, content))] == [2**32 - size, 0]
    assert core().fk_log_open(log.memory) == 1
    assert log.read(0) == (0, content[size:])
    assert log.read(size + 1) == (offset, content)


def test_the_last_byte_of_a_record_is_changed_with_its_check() -> None:
    for value in (0, 1, 128, 255):
        log = Log()
        for number in range(200):  # so that it lies across the end of the ring at times
            offset = log.write(content_of(number, 250 - HEAD_BYTES - number % 7))
            log.write(content_of(number, 3))
            core().fk_log_finish(log.memory, offset, value)
        changed = [record for record in log.records() if len(record.content) > 10]
        assert all(record.name == "SNAPSHOT" and record.content[-1] == value for record in changed)
        assert core().fk_log_open(log.memory) == 1


def test_a_log_goes_on_over_a_reset_where_all_of_it_is_whole() -> None:
    log = Log()
    for number in range(300):
        log.write(content_of(number, 100 + number % 50))
    before = log.records()
    assert core().fk_log_open(log.memory) == 1
    assert log.records() == before
    log.write(content_of(300, 5))
    assert log.records()[-2:-1] == before[-1:]


@from_ci
def test_every_wrong_bit_is_found() -> None:
    log = Log()
    for number in range(20):
        log.write(content_of(number, 30))
    used = sum(HEAD_BYTES + len(record.content) for record in log.records())
    begin = 20  # the ring's first byte
    for bit in range(0, 8 * used, 1 if cases(2, 2) == 2 else 17):
        place = begin + bit // 8
        log.raw[place] = bytes([log.raw[place][0] ^ 1 << bit % 8])
        is_seen = any(record.name == "DAMAGED" for record in log.records()) or len(log.records()) != 20
        assert is_seen, f"bit {bit} is not seen on the host"
        saved = bytes(log.raw)
        assert core().fk_log_open(log.memory) == 0, f"bit {bit}"
        log.raw[:] = saved
        log.raw[place] = bytes([log.raw[place][0] ^ 1 << bit % 8])
    assert core().fk_log_open(log.memory) == 1


@pytest.mark.parametrize(("place", "value"), [(0, 1), (2, 2**31), (3, RING_BYTES), (1, 5)])
def test_a_head_that_cannot_be(place: int, value: int) -> None:
    log = Log()
    for number in range(20):
        log.write(content_of(number, 30))
    log.words[place] = value
    assert core().fk_log_open(log.memory) == 0
    assert log.read() == (0, b"")


def test_a_run_tells_what_was_lived_through() -> None:
    robot, _ = robot_with_log()
    robot.begin("RUNNING")
    robot.run_until(robot.now_us + 1_200_000)
    reported = names(fetched(robot))
    snapshot = reported.count("SNAPSHOT")
    assert reported[:2] == ["BOOT", "OFF"]
    assert [name for name in reported[2:] if name != "SNAPSHOT"] == [
        "ARM", "STATE", "PATH", "PATH", "FIX", "START", "STATE",
        "DECISION", "STROKE", "BEGUN",
        *(["PULSE"] if "PULSE" in reported else []), *(["REFUSED"] if "REFUSED" in reported else []),
        *(["PULSE"] if reported.count("PULSE") == 2 else []),
    ]  # fmt: skip
    assert snapshot > 0
    boot = fetched(robot).records()[0][0].values
    assert (boot["continued"], boot["reset"]) == (0, link_layout().reset["UNKNOWN"])
    assert boot["table_crc"] == int.from_bytes(robot.image[12:16], "little")


def test_what_is_not_logged() -> None:
    """A camera that goes on does not overwrite the run that ended, nor what led to a fault."""
    robot, _ = robot_with_log()
    robot.tick()
    before = names(fetched(robot))
    robot.fix()
    for name in ("HELLO", "STATUS", "TABLE_STATUS"):
        robot.ask(name)
    assert names(fetched(robot)) == before
    robot.status("ARM")
    robot.core.fk_robot_note_pulse_failed(robot.memory, -1)
    robot.tick()
    before = names(fetched(robot))
    assert before[-3:] == ["FAULT", "STATE", "OFF"]
    robot.fix()
    robot.status("ARM")
    assert names(fetched(robot)) == before


def test_a_fetch_goes_on_where_the_last_one_ended() -> None:
    robot, _ = robot_with_log()
    robot.begin("ARMED")
    known = fetched(robot)
    asking = Asking(robot)
    assert fetch_log(asking, known) == known
    assert asking.asked == 1
    robot.fix()
    robot.path()
    later = fetched(robot, known)
    assert later == fetched(robot)
    assert names(later)[len(names(known)) :] == ["FIX", "PATH", "PATH"]


def test_a_log_that_began_anew_does_not_go_on_with_what_was_known() -> None:
    robot, _ = robot_with_log()
    robot.begin("ARMED")
    known = fetched(robot)
    anew, _ = robot_with_log()
    assert fetched(anew).end < known.end
    assert fetched(anew, known) == fetched(anew)


def test_a_first_fetch_begins_at_a_record_also_where_offsets_go_round() -> None:
    robot, log = robot_with_log()
    shift = 2**32 - 20  # offset 0 is in the middle of a record
    log.words[1], log.words[2] = shift, (shift + log.word(2)) % 2**32
    robot.begin("ARMED")
    reported = fetched(robot)
    assert (reported.stretches[0].offset, len(reported.stretches)) == (shift, 1)
    assert names(reported)[:3] == ["BOOT", "OFF", "SNAPSHOT"]
    assert fetched(robot, reported) == reported


def test_a_command_has_its_status_wherever_its_record_begins() -> None:
    """The last offset stood for a command that is not logged: ARM there was never finished."""

    def armed(shift: int) -> Record:
        robot, log = robot_with_log()
        log.words[1], log.words[2] = shift, (shift + log.word(2)) % 2**32
        robot.begin("ARMED")
        return next(record for record in fetched(robot).records()[0] if record.command == "ARM")

    shift = 2**32 - 1 - armed(0).offset
    last = armed(shift)
    assert (last.offset, last.values["status"]) == (2**32 - 1, 0)


def test_what_is_overwritten_during_a_fetch_leaves_a_gap() -> None:
    robot, log = robot_with_log()
    robot.begin("ARMED")
    robot.path()
    asking = Asking(robot)

    def flood() -> None:
        if asking.asked == 3:
            for _ in range(120):
                robot.path(18)

    asking.between = flood
    reported = fetch_log(asking)
    assert len(reported.stretches) == 2
    assert reported.lost == log.word(4) > 0
    assert all(record.name != "DAMAGED" for records in reported.records() for record in records)
    first, second = reported.stretches
    assert second.offset > first.offset + len(first.content)


def test_there_is_always_a_whole_snapshot() -> None:
    robot, _ = robot_with_log()
    robot.begin("ARMED")
    robot.path(100)
    for _ in range(30 + cases(10, 370)):
        for _ in range(5):
            robot.now_us += 20_000
            robot.fix()
        robot.path(100)
        parts = [r for records in fetched(robot).records() for r in records if r.name == "SNAPSHOT"]
        assert any(r.values["last"] for r in parts)
    assert 2000 < largest(parts) < 2400


def largest(parts: Iterable[Record]) -> int:
    """Bytes of the largest snapshot, with its records' heads."""
    sizes = [0]
    for record in parts:
        sizes.append((0 if record.values["part"] == 0 else sizes[-1]) + HEAD_BYTES + len(record.content))
    return max(sizes)


def test_a_snapshot_of_two_whole_paths_fits_too() -> None:
    """One is followed, the other waits for the next decision; FK_LOG_SNAPSHOT_MAX_BYTES is above all."""
    robot, _ = robot_with_log()
    robot.begin("ARMED")
    learn = {"parameter": link_layout().parameter["LEARN"], "value": 1.0}
    assert robot.status("PARAM", learn) == "OK"
    robot.path(100)
    assert robot.fix() == "OK" and robot.start(9_000_000) == "OK"
    robot.path(100)
    sizes = []
    for x_m in (0.1, 0.5, 0.9) * 60:
        robot.now_us += 20_000
        robot.fix(x_m)
        records = [r for records in fetched(robot).records() for r in records]
        sizes.append(largest(r for r in records if r.name == "SNAPSHOT"))
    assert robot.state() == "RUNNING"
    assert 3500 < max(sizes) <= 5888, "FK_LOG_SNAPSHOT_MAX_BYTES"


def test_nothing_of_the_memory_as_found_is_in_a_snapshot() -> None:
    def logged(found: int) -> list[Record]:
        robot, log = Robot(), Log()
        FFI.memmove(robot.memory, bytes([found]) * FFI.sizeof("fk_robot_t"), FFI.sizeof("fk_robot_t"))
        image_at = FFI.cast("uint8_t *", robot._image)
        assert core().fk_robot_init(robot.memory, image_at, len(robot.image)) == 0
        log.memory.magic = 0
        core().fk_robot_use_log(robot.memory, log.memory)
        robot.begin("RUNNING")
        robot.run_until(robot.now_us + 1_500_000)
        return [record for records in fetched(robot).records() for record in records]

    assert logged(0) == logged(0xA5)


def test_no_snapshot_while_a_pulse_of_a_stroke_is_due() -> None:
    """On the chip it takes 2 ms, by which the pulse would be late."""
    robot, _ = robot_with_log(now_us=2_000_000)
    robot.begin("ARMED")

    def flooded() -> int:
        for _ in range(15):
            robot.path(18)
        return sum(bool(r.values.get("last")) for records in fetched(robot).records() for r in records)

    assert robot.stroke("B") == "OK"
    assert flooded() == 1, "that of ARM"
    assert robot.tick().limb_mask == 0b0011
    assert flooded() == 1
    assert robot.run_until(robot.now_us + 200_000) == [(robot.now_us - 200_000 + 81_000, 0b1100)]
    assert flooded() == 2


def test_a_command_that_comes_again_is_logged_once() -> None:
    robot, _ = robot_with_log()
    robot.tick()
    robot.status("ARM")
    robot._sequence -= 1
    assert robot.status("ARM") == "OK"
    assert robot.ask("STATUS")["repeats"] == 1
    assert names(fetched(robot)).count("ARM") == 1


def test_a_start_with_a_fault_says_so() -> None:
    robot, log = Robot(table=b"\0" * 400), Log()
    assert robot.error != 0
    robot.core.fk_robot_use_log(robot.memory, log.memory)
    assert [record.name for record in log.records()] == ["BOOT", "FAULT"]
    assert log.records()[1].values == {"fault": link_layout().fault["TABLE"], "detail": robot.error}


def test_an_answer_that_is_lost_is_asked_for_again() -> None:
    robot, _ = robot_with_log()
    robot.begin("ARMED")
    robot.path()

    class Lossy(Asking):
        def ask(self, *words: object, **more: object) -> dict:
            answer = super().ask(*words, **more)
            if self.asked % 3:
                raise LinkError("lost")
            return answer

    assert fetch_log(Lossy(robot)) == fetched(robot)

    class Dead(Asking):
        def ask(self, *words: object, **more: object) -> dict:
            raise LinkError("no answer")

    with pytest.raises(LogError, match=r"no answer to LOG, asked 5 times \(no answer\): check the cable"):
        fetch_log(Dead(robot))
    with pytest.raises(LogError, match="answers LOG with UNKNOWN: its firmware keeps no log"):
        fetched(Robot())


def test_without_a_log() -> None:
    assert Robot().status("LOG", {"offset": 0}) == "UNKNOWN"


def test_the_check() -> None:
    assert check_of(bytes([1, 2, 0, 0, 3])) == 6 | 10 << 8
