"""The bench firmware's log on the virtual chip: fetched in a run, after it, over a reset; decided again."""

from __future__ import annotations

import random
from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
import unicorn
from tests.conftest import count, from_ci
from tests.core.core import core
from tests.core.log_rig import SNAPSHOT, Log, content_of
from tests.runs import rig

from frogkick.link.layout import link_layout
from frogkick.link.log import HEAD_BYTES, ChipLog, Record, Stretch, check_of, fetch_log, records_of
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.pool.chip.uncounted import UncountedCalls
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.runs.chip_log import LogReplay, replay_log
from frogkick.runs.closed_loop import run_session
from frogkick.runs.record import Recording, RunOptions
from frogkick.runs.session import Session
from frogkick_codegen.firmware import CHIPS

RESET = link_layout().reset


@cache
def swum() -> tuple[VirtualRobot, Session, Recording]:
    """A closed-loop run, the robot after it, and a new session with it."""
    port = rig.port("virtual")
    assert isinstance(port, VirtualRobot)
    seconds = count(14.0, 60.0)
    recording = run_session(
        Session(port),
        rig.new_pool("sine"),
        rig.recording(shape("sine"), RunOptions(PlanConfig(depth=2), True, seconds)),
    )
    session = Session(port, time_s=recording.end_s + 1.0)
    session.handshake(rig.tables())
    return port, session, recording


@cache
def log_of_run() -> ChipLog:
    return fetch_log(swum()[1])


def replayed(log: ChipLog) -> LogReplay:
    return replay_log(log, rig.firmware("native").image, [rig.tables()])


def flat(log: ChipLog) -> list[Record]:
    return [record for records in log.records() for record in records]


def test_sizes_with_the_log() -> None:
    built = rig.firmware("bench")
    print(f"flash {built.flash_bytes}, RAM {built.ram_bytes} bytes")
    assert built.flash_bytes <= 0.9 * CHIPS["bench"].flash_bytes
    assert built.ram_bytes <= 0.75 * CHIPS["bench"].ram_bytes, "with the stack's whole reserve"


def test_a_closed_loop_run_is_decided_again_from_the_chip_s_log() -> None:
    _, _, recording = swum()
    reported = replayed(log_of_run())
    assert reported.mismatches == []
    assert reported.segments >= 1 and reported.replayed > 0.5 * reported.records
    # The same decisions as the events told while it swam, to the bit.
    made = {decision.scheduled_us: decision for decision in recording.decisions}
    assert len(reported.decisions) >= min(len(made), 10)
    for decision in reported.decisions:
        assert decision.differences(made[decision.scheduled_us]) == []


def test_the_log_tells_the_pins() -> None:
    """Each pulse of the log is one on the pins, within what a port may take."""
    _, _, recording = swum()
    highs = sorted((edge.time_s * 1e6, edge.limb) for edge in recording.edges if edge.level)
    records = flat(log_of_run())
    answer = [
        (record.time_us, limb)
        for record in records
        if record.name == "PULSE" and record.values["allowed"]
        for limb in range(8)
        if int(record.values["limb_mask"]) >> limb & 1
    ]
    assert len(answer) >= 10
    assert [limb for _, limb in answer] == [limb for _, limb in highs[-len(answer) :]]
    late_us = [
        seen_us - told_us for (told_us, _), (seen_us, _) in zip(answer, highs[-len(answer) :], strict=True)
    ]
    # The robot's clock begins at the end of its start-up, which all of them have in common.
    assert 0.0 < min(late_us) < 2000.0
    assert max(late_us) - min(late_us) <= 200.0


@pytest.mark.parametrize("name", ["DECISION", "FIX", "PULSE"])
def test_a_wrong_bit_is_a_mismatch(name: str) -> None:
    log = log_of_run()
    stretch = log.stretches[0]
    records = [record for record in records_of(stretch) if name in (record.name, record.command)]
    dice = random.Random(name)
    for _ in range(count(1, 20)):
        record = dice.choice(records[len(records) // 2 :])
        at = record.offset - stretch.offset
        raw = bytearray(stretch.content)
        # Of a fix: its place; else anything.
        place = dice.randrange(8, 16) if name == "FIX" else dice.randrange(len(record.content))
        raw[at + HEAD_BYTES + place] ^= 1 << dice.randrange(8)
        reported = replayed(ChipLog((Stretch(stretch.offset, bytes(raw)),), log.lost))
        assert ("log", record.offset) in [(m.place, m.offset) for m in reported.mismatches]
        whole = bytes(raw[at : at + HEAD_BYTES + len(record.content)])
        raw[at + 2 : at + 4] = check_of(whole).to_bytes(2, "little")
        reported = replayed(ChipLog((Stretch(stretch.offset, bytes(raw)),), log.lost))
        assert reported.mismatches != [], f"place {place}"


@from_ci
def test_fetching_in_a_run_changes_nothing_and_goes_on_where_it_ended() -> None:
    port = rig.port("virtual")
    session, path = Session(port), shape("line")
    session.handshake(rig.tables())
    session.send_path(path)
    session.request("ARM")
    log: ChipLog | None = None

    def live(until_s: float) -> None:
        while session.time_s < until_s:
            session.step(session.time_s + 0.07)
            x_m = float(path.x_m[0]) + 0.02 * session.time_s
            values = {
                "fix_sequence": round(session.time_s * 1e3) & 0xFFFF,
                "quality": 1,
                "capture_age_us": 5000,
            }
            session.request("FIX", {**values, "x_m": x_m, "y_m": float(path.y_m[0]), "heading_rad": 0.0})

    live(1.0)
    session.request("START", {"delay_us": 100_000})
    for _ in range(3):
        live(session.time_s + 2.0)
        log = fetch_log(session, log)
    assert log is not None
    assert session.request("STATUS")["state"] == link_layout().state["RUNNING"]
    assert len(log.stretches) == 1 and log.lost == 0
    at_once = fetch_log(session).stretches[0].content  # and what happened since
    assert at_once.startswith(log.stretches[0].content)
    reported = replayed(log)
    assert reported.mismatches == []
    assert len(reported.decisions) >= 4


def test_what_led_to_a_hang_is_fetched_after_the_reset() -> None:
    port = rig.port("virtual")
    assert isinstance(port, VirtualRobot)
    session = Session(port)
    session.handshake(rig.tables())
    session.request("ARM")
    session.step(max(session.time_s, 0.6))
    action = next(i for i, row in enumerate(rig.tables().actions) if row.first_mask and row.second_mask)
    session.request("STROKE", {"action": action})
    session.step(session.time_s + 0.03)
    before = fetch_log(session)
    port.chip.hang()
    session.step(session.time_s + 1.1)
    again = Session(port, time_s=session.time_s)
    again.handshake(rig.tables())
    log = fetch_log(again)
    assert log.stretches[0].content.startswith(before.stretches[0].content)
    names = [record.command or record.name for record in flat(log)]
    boots = [record for record in flat(log) if record.name == "BOOT"]
    assert [(boot.values["continued"], boot.values["reset"]) for boot in boots] == [
        (0, RESET["POWER"]), (1, RESET["WATCHDOG"])
    ]  # fmt: skip
    assert names[names.index("STROKE") :][:4] == ["STROKE", "STROKE", "BEGUN", "PULSE"]
    reported = replayed(log)
    assert (reported.mismatches, reported.segments) == ([], 1)


def cuts(alone: UncountedCalls, at: int, size: int, function: str, *arguments: int) -> Iterator[bytes]:
    """Memory as a reset between any two of a function's stores there leaves it; last, as it returns."""
    seen = []

    def before_a_store(_uc: Any, _access: int, _address: int, _size: int, _value: int, _data: Any) -> None:
        seen.append(alone.ram_read(at, size))

    hook = alone._uc.hook_add(unicorn.UC_HOOK_MEM_WRITE, before_a_store, begin=at, end=at + size - 1)
    alone.call(function, *arguments)
    alone._uc.hook_del(hook)
    yield from seen
    yield alone.ram_read(at, size)


@pytest.mark.parametrize("length", [11, 54, 118, 239, 248, 0])
def test_a_reset_between_any_two_stores_leaves_whole_records_or_no_log(length: int) -> None:
    """Records of one length let the oldest be dropped by half: the log went on without its newest record.

    Of length 0: of random lengths.
    """
    port, _, _ = swum()
    alone, dice = UncountedCalls(port.chip), random.Random(length)
    address, content_at = port.chip.symbol("history"), port.chip.symbol("fk_stack_bottom")
    for written in range(100, 4000, count(900, 130)):
        log = Log(written)
        lengths = [length or dice.randint(8, 248) for _ in range(written + 1)]
        for number in range(written):
            log.write(content_of(number, lengths[number] - 7))
        before = log.records()
        content = content_of(written, lengths[-1] - 7)
        alone.ram_write(address, bytes(log.raw))
        alone.ram_write(content_at, content)
        called = (address, SNAPSHOT, 0, 0, content_at, len(content))
        states = list(dict.fromkeys(cuts(alone, address, len(log.raw), "fk_log_write", *called)))
        assert len(states) > len(content)
        *torn, log.raw[:] = states
        assert core().fk_log_open(log.memory) == 1
        after = log.records()
        assert after[-1].content == content and after[:-1] == before[1 - len(after) :]
        kept = 0
        for log.raw[:] in torn:
            if core().fk_log_open(log.memory):
                found = log.records()
                assert found == before[-len(found) :] and len(found) >= len(after) - 1
                kept += 1
        assert kept > 0.8 * len(content), "all but the few in which the oldest is dropped"
