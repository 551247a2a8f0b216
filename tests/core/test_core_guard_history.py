"""The guard's history of pulses: where it is damaged, lost or was never written, no pulse is allowed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tests.conftest import some
from tests.core.core import FFI, LATE_US, Robot, cases, core, kept_of, library, mutated
from tests.core.log_rig import Log, robot_with_log
from tests.core.test_core_guard import ON_MAX_US, PULSE_MAX_US, REST_US, WINDOW_US, Guard
from tests.core.test_core_supervisor import LATE, state_and_fault

from frogkick.link.layout import link_layout
from frogkick.pool.native_robot import COLD_LIMBS

RESET = link_layout().reset
UNKNOWN_REST_US = WINDOW_US + LATE_US
"""FK_UNKNOWN_HEAT_REST_US"""


def test_simulated_robots_begin_with_what_the_core_keeps_of_cold_limbs() -> None:
    assert bytes(FFI.buffer(Guard().keep())) == COLD_LIMBS


def flipped(content: bytes, bit: int) -> bytes:
    """The same with one bit flipped."""
    return content[: bit // 8] + bytes([content[bit // 8] ^ 1 << bit % 8]) + content[bit // 8 + 1 :]


def assert_fully_used(guard: Guard) -> None:
    """As if all the heat that is allowed had gone into each limb just before time 0; none after the rest."""
    for at_us in (0, REST_US, WINDOW_US // 2, WINDOW_US - PULSE_MAX_US):
        assert not any(guard.allow(1 << limb, 1, at_us) for limb in range(8))
    for pulse_us in (1, PULSE_MAX_US // 2, PULSE_MAX_US):
        assert not any(guard.allow(1 << limb, pulse_us, UNKNOWN_REST_US - 1) for limb in range(8)), pulse_us
    assert guard.allow(0b0011, PULSE_MAX_US, UNKNOWN_REST_US)
    assert guard.allow(0b1100, PULSE_MAX_US, UNKNOWN_REST_US + PULSE_MAX_US + LATE_US)


def test_unknown_heat_is_heat() -> None:
    """After a time without supply, or at the first power-on, RAM holds anything."""
    rng = np.random.default_rng(5)
    for content in (bytes(36), b"\xff" * 36, b"\xa5" * 36, rng.bytes(36), rng.bytes(36)):
        kept = FFI.new("fk_guard_persistent_t *")
        FFI.buffer(kept)[:] = content
        guard = Guard(kept=kept)
        assert not guard.known
        assert_fully_used(guard)


def test_one_flipped_bit_in_what_is_kept_is_unknown_heat() -> None:
    before = Guard()
    assert before.allow(0b01, PULSE_MAX_US, 10**7)
    whole = bytes(FFI.buffer(before.keep()))
    for bit in range(8 * len(whole)):
        kept = FFI.new("fk_guard_persistent_t *")
        FFI.buffer(kept)[:] = flipped(whole, bit)
        guard = Guard(kept=kept)
        assert not guard.known
        assert not any(guard.allow(1 << limb, 1, WINDOW_US - PULSE_MAX_US) for limb in range(8)), bit
        assert guard.allow(0b11, PULSE_MAX_US, UNKNOWN_REST_US)


NOW_US = 10**7 + 20_000
BEFORE_THE_NEXT: dict[str, Callable[[Guard], None]] = {
    "nothing": lambda guard: None,
    "all off": lambda guard: guard.cut(NOW_US),
    "not begun": lambda guard: guard.not_begun(0b01),
    "a fix": lambda guard: guard.note_fix(NOW_US),
    "a run": lambda guard: guard.closed_loop(True),
}
"""What may be written to a damaged history: it must not make the history pass."""


@pytest.mark.parametrize("name", BEFORE_THE_NEXT)
def test_one_flipped_bit_in_the_history_allows_nothing_ever(name: str) -> None:
    """It allowed a second pulse 1 ms after the first, for three bits of one limb."""
    guard = Guard()
    assert guard.allow(0b01, 80_000, 10**7)
    whole = bytes(guard.bytes)
    assert len(whole) == 8 * 160 + 16, "no bytes between that nothing looks at"
    for bit in range(8 * len(whole)):
        guard.bytes[:] = flipped(whole, bit)
        BEFORE_THE_NEXT[name](guard)
        assert not guard.is_sound()
        for at_us in (NOW_US, 10**7 + 81_000, 10**8, 2**63):
            assert guard.answer(0b01, 80_000, at_us) == guard.answer(0b10, 80_000, at_us) == -1, bit
    guard.bytes[:] = whole
    assert guard.allow(0b01, 80_000, 10**7 + 80_000 + LATE_US + REST_US)


def test_the_history_of_one_limb_does_not_pass_for_that_of_another() -> None:
    guard = Guard()
    assert guard.allow(0b01, 80_000, 10**7)
    guard.bytes[:160] = guard.bytes[160:320]
    assert guard.answer(0b01, 80_000, 10**7 + 81_000) == -1


def test_memory_of_equal_bytes_is_no_history() -> None:
    for byte in (b"\x00", b"\xff", b"\xa5"):
        guard = Guard()
        guard.bytes[:] = byte * len(guard.bytes)
        assert guard.answer(0b01, 80_000, 10**8) == -1


@pytest.mark.parametrize("between", some(["nothing", "DISARM", "STOP", "FIX", "START", "late"], 3))
def test_a_damaged_history_of_the_guard(between: str) -> None:
    """Whatever is written into them meanwhile: one flipped bit, and nothing fires until a reset."""
    bits = 8 * FFI.sizeof("fk_guard_t")
    mine = [
        *range(0, 8 * 160),
        *range(8 * 8 * 160, bits),
    ]  # of the limb that fires, and what is for all limbs
    others = range(8 * 160, 8 * 8 * 160, 997)
    for bit in [*mine[:: 1 if cases(1, 2) == 2 else 53], *others]:
        robot = Robot().begin("ARMED")
        robot.path()
        assert robot.fix() == "OK" and robot.stroke("A") == "OK"
        assert robot.tick().limb_mask == 0b0011
        core().fk_test_spoil_guard(robot.memory, bit)
        if between == "late":
            core().fk_robot_note_pulse_failed(robot.memory, LATE)
        elif between == "FIX":
            robot.fix()
        elif between == "START":
            robot.start(3_000_000)
            robot.status("STOP")
        elif between != "nothing":
            robot.status(between)
        robot.now_us += 81_000
        robot.status("ARM")
        for _ in range(3):
            robot.stroke("A")
            assert robot.run_until(robot.now_us + 1_000_000) == [], bit
        assert state_and_fault(robot) == ("FAULT", "GUARD", 0)
        again = Robot(now_us=0, heat_known=False)
        core().fk_robot_note_reset(again.memory, RESET["SOFTWARE"], robot.kept)
        assert again.ask("STATUS")["rest_us"] == UNKNOWN_REST_US


def test_a_snapshot_writes_nothing_to_the_robot() -> None:
    """It gave the guard's numbers back as it had written them, without the bits that had flipped."""
    robot, _ = robot_with_log()
    assert robot.begin("ARMED").stroke("A") == "OK"
    assert robot.tick().limb_mask == 0b0011
    guard, all_of_it = FFI.buffer(FFI.addressof(robot.memory, "guard")), FFI.buffer(robot.memory)
    whole = bytes(guard)
    for bit in range(8 * len(whole)):
        guard[:] = flipped(whole, bit)
        before = bytes(all_of_it)
        core().fk_robot_log_snapshot(robot.memory)
        assert bytes(all_of_it) == before, bit


def test_a_history_that_is_damaged_before_arm_allows_nothing_with_a_log_either() -> None:
    """ARM's snapshot healed 139 bits: of one limb's next entry, of whether it was cut, of the loop."""
    ends = [8 * (160 * limb + at) for limb in range(4) for at in range(152, 160)]
    loop = range(8 * 8 * 160, 8 * FFI.sizeof("fk_guard_t"), 8)
    every = 1 if cases(1, 2) == 2 else 97
    bits = {at + bit for at in (*ends, *loop) for bit in range(8)} | set(range(0, 8 * 8 * 160, every))
    for bit in sorted(bits):
        robot, _ = robot_with_log()
        robot.tick()
        core().fk_test_spoil_guard(robot.memory, bit)
        robot.status("ARM")
        robot.tick()
        robot.stroke("A")
        assert robot.run_until(robot.now_us + 300_000) == [], bit
        assert state_and_fault(robot) == ("FAULT", "GUARD", 0)


@pytest.mark.parametrize("content", ["never told", "lost", "damaged", "whole"])
def test_a_start_that_does_not_know_how_hot_its_limbs_are(content: str) -> None:
    """It says how long they rest, fires nothing meanwhile, and what it may at once afterwards."""
    robot, log = Robot(now_us=0, heat_known=False), Log()
    if content != "never told":
        robot.kept = kept_of([100_000] if content == "damaged" else [])
        robot.kept.crc ^= {"lost": 0xFFFFFFFF, "damaged": 4, "whole": 0}[content]
        core().fk_robot_note_reset(robot.memory, RESET["POWER"], robot.kept)
    rest_us = 0 if content == "whole" else UNKNOWN_REST_US
    core().fk_robot_use_log(robot.memory, log.memory)
    assert log.records()[0].values["rest_us"] == rest_us
    robot.tick()
    for at_us in (0, 500_000, 3_000_000, 4_900_000):
        robot.tick(at_us)
        robot.status("ARM")
        assert robot.ask("STATUS")["rest_us"] == max(0, rest_us - at_us)
        assert robot.stroke("A") == "OK"
        assert robot.run_until(at_us + 1000) == ([(at_us, 0b0011)] if not rest_us and at_us else [])
    robot.tick(UNKNOWN_REST_US)
    assert robot.ask("STATUS")["rest_us"] == 0
    assert robot.status("ARM") == "OK" and robot.stroke("R") == "OK"
    assert robot.run_until(robot.now_us + 1000) == [(UNKNOWN_REST_US, 0b1100)]


def test_a_reset_before_limbs_of_unknown_heat_have_rested_begins_their_rest_again() -> None:
    first = Robot(now_us=0, heat_known=False)
    lost = kept_of()
    lost.crc ^= 1
    core().fk_robot_note_reset(first.memory, RESET["POWER"], lost)
    again = Robot(now_us=0, heat_known=False)
    core().fk_robot_note_reset(again.memory, RESET["WATCHDOG"], lost)
    again.begin("ARMED")
    again.now_us = UNKNOWN_REST_US - 1
    assert again.status("ARM") == again.stroke("A") == "OK"
    assert again.ask("STATUS")["rest_us"] == 1
    assert again.run_until(again.now_us) == []
    again.now_us = UNKNOWN_REST_US
    assert again.stroke("A") == "OK"
    assert len(again.run_until(again.now_us + 1000)) == 1
    third = Robot(now_us=0, heat_known=False)
    core().fk_robot_note_reset(third.memory, RESET["WATCHDOG"], lost)
    assert third.ask("STATUS")["rest_us"] == 0, "kept from the first pulse on"


def test_heat_that_firmware_with_longer_pulses_has_kept_is_all_counted() -> None:
    """It was flashed anew, for pulses of 10 ms: of 400 ms of heat its history held 110."""
    short = library(mutated("fk_robot_config.h", "FK_PULSE_MAX_US 100000u", "FK_PULSE_MAX_US 10000u"))
    guard = Guard(short, kept_of([400_000, 389_999]))
    for at_us in range(REST_US, WINDOW_US, REST_US):
        assert not guard.allow(0b01, 10_000, at_us)
    assert Guard(short, kept_of([400_000, 390_000])).allow(0b10, 10_000, REST_US)
    assert not Guard(short, kept_of([400_000, 390_001])).allow(0b10, 10_000, REST_US)
    assert Guard(short, kept_of([0xFFFFFFFF])).allow(0b01, 10_000, 2 * WINDOW_US)


@pytest.mark.parametrize("heat_us", [0, 36_000, 200_000, 380_000, 399_999])
def test_kept_heat_counts_until_it_leaves_the_window_however_many_pulses_follow(heat_us: int) -> None:
    """Of 380 ms eight short pulses overwrote 290 ms while they still counted: 470 ms in 5 s."""
    short = library(mutated("fk_robot_config.h", "FK_PULSE_MAX_US 100000u", "FK_PULSE_MAX_US 10000u"))
    guard = Guard(short, kept_of([heat_us]))
    pulses = 0
    for at_us in range(REST_US, WINDOW_US - 10_000, REST_US + 10_000 + LATE_US):
        pulses += guard.allow(0b01, 10_000, at_us)
    assert heat_us + pulses * 10_000 <= ON_MAX_US
    assert pulses == 9 or heat_us > 0
    assert all(guard.allow(0b01, 10_000, 10**7 + k * (REST_US + 10_000 + LATE_US)) for k in range(100))
