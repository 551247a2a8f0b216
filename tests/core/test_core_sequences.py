"""Random command sequences to the core and a late port: an onlooker judges the pins, without a tolerance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from tests.conftest import some
from tests.core.core import COVERAGE_DIR, FFI, cases, core, image, library, source_files
from tests.core.onlooker import ARM, DISARM, HIGH, LOW, POWER_ON, SEEN, STARTED, Limits, broken, judge

from frogkick.robot import load_robot

LIMITS = Limits.of(load_robot("frog2022"))
COMMANDS = 24
ROWS = [
    ("U", 0b0001, 0),
    ("A", 0b0011, 0),
    ("B", 0b0011, 0b1100),
    ("C", 0b0001, 0b0001),
    ("T", 0b0111, 0),
    ("S", 0, 0b0100),
    ("I", 0, 0),
]
"""One limb, two, two groups, one limb in both groups, three limbs, the second group only, none."""
TIMES: list[dict[str, object]] = [
    {},
    {"second_delay_us": 0},
    {"second_delay_us": 400_000},
    {"pulse_us": 100_000, "second_delay_us": 0},
]
AT_ONCE = 500
CAPACITY = AT_ONCE * 400


def play(made: Any, sequences: int, first: int = 0, **times: object) -> Iterator[npt.NDArray[Any]]:
    """What an onlooker sees of these sequences, some hundreds at a time."""
    table = image(action_rows=ROWS, **times)
    aligned = FFI.new("uint64_t[]", (len(table) + 7) // 8)
    FFI.memmove(aligned, table, len(table))
    seen, busy = np.zeros(CAPACITY, SEEN), FFI.new("uint32_t *")
    for begin in range(0, sequences, AT_ONCE):
        many = made.fk_play(
            FFI.cast("uint8_t *", aligned), len(table), first + begin, min(AT_ONCE, sequences - begin),
            COMMANDS, FFI.from_buffer("seen_t[]", seen), CAPACITY, busy,
        )  # fmt: skip
        assert many <= CAPACITY, "not all was written down"
        assert busy[0] == 0, "two pulses at a time"
        yield seen[:many]


def test_no_sequence_breaks_a_limit() -> None:
    found: Counter[str] = Counter()
    sequences = cases(100_000, 10_000_000, 6000)
    for index, times in enumerate(TIMES):
        for seen in play(core(), sequences // len(TIMES), 10**9 * index, **times):
            counts = judge(LIMITS, seen)
            assert not broken(counts), (index, broken(counts))
            found.update(counts)
    print(f"{sequences} sequences of {COMMANDS} commands: {dict(found)}")
    if COVERAGE_DIR:
        return  # so few say nothing of how often
    # The sequences come to where the limits are.
    assert found["pulses"] > 2 * sequences and found["pulses in a run"] > 0.1 * sequences
    assert found["runs lost"] > 0.1 * sequences
    assert found["at the rest"] > 0.02 * sequences and found["at the duty"] > 0.1 * sequences


def test_a_sequence_is_the_same_alone_and_among_others() -> None:
    (many,) = play(core(), 20, 7)
    many = many.copy()
    (last,) = play(core(), 1, 26)
    begins = np.flatnonzero(many["kind"] == POWER_ON)
    assert len(begins) == 20
    assert (many[begins[-1] :] == last).all()


CONFIG = {
    "pulse": ("FK_PULSE_MAX_US 100000u", "FK_PULSE_MAX_US 100001u"),
    "rest": ("FK_REST_MIN_US 500000u", "FK_REST_MIN_US 499700u"),
    "duty": ("FK_DUTY_ON_MAX_US 400000u", "FK_DUTY_ON_MAX_US 401000u"),
    "duty window": ("FK_DUTY_WINDOW_US 5000000u", "FK_DUTY_WINDOW_US 4990000u"),
    "together": ("FK_LIMBS_AT_ONCE_MAX 2u", "FK_LIMBS_AT_ONCE_MAX 3u"),
    "fresh": ("FK_FIX_FRESH_US 500000u", "FK_FIX_FRESH_US 500300u"),
    "lost": ("FK_FIX_LOST_US 2000000u", "FK_FIX_LOST_US 2000300u"),
}
"""Each limit of the robot's file, a little too far."""
CEILINGS = {
    "pulse": ("FK_PULSE_CEILING_US 100000u", "FK_PULSE_CEILING_US 100001u"),
    "fresh": ("FK_FIX_FRESH_CEILING_US 500000u", "FK_FIX_FRESH_CEILING_US 500300u"),
    "lost": ("FK_FIX_LOST_CEILING_US 2000000u", "FK_FIX_LOST_CEILING_US 2000300u"),
}
CODE = {
    "no rest": ("fk_guard.c", "now_us < limb->off_us + FK_REST_MIN_US", "0", "rest"),
    "no rest for a late port": (
        "fk_guard.c", "limb->off_us = end_us + FK_PORT_LATE_US;", "limb->off_us = end_us;", "rest",
    ),
    "no duty": ("fk_guard.c", "on_time_us(limb, end_us) + pulse_us > FK_DUTY_ON_MAX_US", "0", "duty"),
    "any limbs together": (
        "fk_guard.c", "limbs_on > FK_LIMBS_AT_ONCE_MAX", "limbs_on > 99u", "together",
    ),
    "no fresh fix": ("fk_guard.c", "guard->closed_loop != 0u && (", "0 && (", "fresh"),
    "no fresh fix for a late port": (
        "fk_guard.c", "now_us + FK_PORT_LATE_US > guard->fix_us", "now_us > guard->fix_us", "fresh",
    ),
    "never lost": (
        "fk_robot_watch.c",
        "robot->state == FK_STATE_RUNNING && now_us >= fk_guard_lost_us(&robot->guard)", "0",
        "lost",
    ),
    "boots armed": (
        "fk_robot.c", "robot->state = FK_STATE_DISARMED;", "robot->state = FK_STATE_ARMED;", "armed lost",
    ),
    "what switches off is answered from memory": (
        "fk_link.c", " && type != FK_FRAME_DISARM && type != FK_FRAME_STOP", "", "armed",
    ),
    "repetitions act": ("fk_link.c", "if (before != 0) {", "if (0) {", "armed lost told"),
    "damaged frames act": (
        "fk_frames.c", "if (crc != fk_get_u32(raw + checked)) {", "if (0) {", "armed told",
    ),
    "an error changes nothing": (
        "fk_robot_state.c", "    (void)fk_robot_supervise(robot, FK_EVENT_ERROR);", "", "latched",
    ),
    "all off forgotten": (
        "fk_robot.c", "(robot->all_off != 0u || robot->off_again != 0u) ? 1u : 0u;", "0u;", "off",
    ),
    "a reset forgets": ("fk_guard.c", "limb, persistent->on_us[limb]);", "limb, 0u);", "duty"),
    "unknown heat is none": ("fk_guard.c", "limb->on_us[0] = FK_DUTY_ON_MAX_US;", "", "duty"),
    "what is damaged counts": (
        "fk_guard.c", "if (persistent->crc != crc_of(persistent)) {", "if (0) {", "duty",
    ),
    "nothing is kept": ("fk_robot.c", "if (robot->persistent != 0) {", "if (0) {", "duty"),
    "no rest after a reset": (
        "fk_guard.c", "now_us < limb->off_us + FK_REST_MIN_US",
        "limb->off_us != 0u && now_us < limb->off_us + FK_REST_MIN_US", "rest",
    ),
}  # fmt: skip
"""What is taken out of the core: file, text, what stands there instead, and which limit that breaks."""


def complaints(files: dict[str, bytes], most: int, **times: object) -> Counter[str]:
    """What the onlooker has to say, up to the first sequences that it complains of."""
    found: Counter[str] = Counter()
    for seen in play(library(files), most, **times):
        found.update(broken(judge(LIMITS, seen)))
        if found:
            break
    return found


def changed(files: dict[str, bytes], name: str, old: str, new: str) -> None:
    text = files[name].decode()
    assert text.count(old) == 1, f"{name} holds {old!r} {text.count(old)} times: correct the mutation"
    files[name] = text.replace(old, new).encode()


@pytest.mark.parametrize("name", some(CONFIG, 1))
def test_a_limit_that_is_a_little_too_far_is_seen_by_the_monitor(name: str) -> None:
    files = source_files()
    changed(files, "fk_robot_config.h", *CONFIG[name])
    if name in CEILINGS:
        changed(files, "fk_guard.h", *CEILINGS[name])
    times = {"pulse_us": 100_001, "second_delay_us": 0} if name == "pulse" else {}
    found = complaints(files, 50_000, **times)
    assert set(found) & {name.split()[0], "armed"}, dict(found)


@pytest.mark.parametrize("name", some(CODE, 6))
def test_a_core_without_a_limit_is_seen_by_the_monitor(name: str) -> None:
    files = source_files()
    file, old, new, limit = CODE[name]
    changed(files, file, old, new)
    found = complaints(files, 50_000)
    assert set(limit.split()) & set(found), dict(found)


@pytest.mark.parametrize("pulse_us", [100_001, 130_000])
def test_a_table_with_longer_pulses_fires_none(pulse_us: int) -> None:
    for seen in play(core(), 500, pulse_us=pulse_us, second_delay_us=0):
        assert POWER_ON in seen["kind"] and HIGH not in seen["kind"]


def test_the_onlooker_knows_the_limits_to_the_microsecond() -> None:
    def seen(*rows: tuple[int, int, int]) -> npt.NDArray[Any]:
        return np.array([(0, POWER_ON, 0), (1, ARM, 0), *rows], dtype=SEEN)

    def pulse(limb: int, at_us: int, length_us: int) -> list[tuple[int, int, int]]:
        return [(at_us, HIGH, limb), (at_us + length_us, LOW, limb)]

    def broken_limits(*rows: tuple[int, int, int]) -> list[str]:
        return list(broken(judge(LIMITS, seen(*rows))))

    assert broken_limits(*pulse(0, 10, 100_000)) == []
    assert broken_limits(*pulse(0, 10, 100_001)) == ["pulse"]
    assert broken_limits(*pulse(0, 10, 10), *pulse(0, 500_020, 10)) == []
    assert broken_limits(*pulse(0, 10, 10), *pulse(0, 500_019, 10)) == ["rest"]
    often = [row for k in range(5) for row in pulse(0, 1000 + k * 600_000, 80_000)]
    assert broken_limits(*often) == []
    assert broken_limits(*often, *pulse(0, 1000 + 4_999_999 + 80_000 - 80_000, 80_000)) == ["duty"]
    assert broken_limits(*often, *pulse(0, 1000 + 5_000_000, 80_000)) == []
    both = [(10, HIGH, 0), (10, HIGH, 1)]
    assert broken_limits(*both) == []
    assert broken_limits(*both, (11, HIGH, 2)) == ["together"]
    assert broken_limits((5, DISARM, 0), *pulse(0, 10, 10)) == ["armed"]
    assert broken_limits((5, HIGH, 0), (10, DISARM, 0), (210, LOW, 0)) == []
    assert broken_limits((5, HIGH, 0), (10, DISARM, 0), (211, LOW, 0)) == ["off"]
    run = [(10, 7, 0), (20, STARTED, 0)]
    assert broken_limits(*run, *pulse(0, 500_010, 10)) == []
    assert broken_limits(*run, *pulse(0, 500_011, 10)) == ["fresh"]
    assert broken_limits(*run, *pulse(0, 2_000_011, 10)) == ["armed"]
    assert broken_limits(*run, (2_000_010, 10, 2)) == []
    assert broken_limits(*run, (2_000_011, 10, 2)) == ["lost", "told"]
    assert broken_limits((10, 11, 0), (20, ARM, 0), *pulse(0, 30, 10)) == ["armed", "latched"]
    assert broken_limits((10, 1, 0), (20, 10, 1)) == ["lost"], "armed after a reset"
