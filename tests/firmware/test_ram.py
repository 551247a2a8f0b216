"""The core's RAM on the chip, held to a budget, so that growth is seen and weighed against 64 KB."""

from __future__ import annotations

import random
import re

import pytest
from tests.conftest import REPOSITORY, count
from tests.core.log_rig import fetched, robot_with_log
from tests.core.test_core_log_replay import live
from tests.runs import rig

from frogkick.link.log import HEAD_BYTES, ChipLog
from frogkick.pool.chip.image import Layouts
from frogkick.pool.chip.stack import StackAnalysis

STRUCTURE_BYTES = {
    "fk_robot_t": 7600,
    "fk_frame_collector_t": 244,
    "fk_store_t": 320,
    "fk_guard_persistent_t": 36,
    "fk_wear_persistent_t": 44,
}
"""A port has one of each, and the log."""
STACK_BYTES = {
    "fk_robot_on_frame": 4352,  # PLAN, with a beam search
    "fk_robot_tick": 4096,  # a decision, likewise
    "fk_robot_log_command": 1024,  # a snapshot
    "fk_robot_take_tx": 640,
    "fk_robot_init": 1664,
    "fk_store_boot": 640,
}
"""The most that a call of the core can use of a thread's stack, all that it calls included."""
REPLAYED_S = 3.5
"""The least that a log on Zephyr holds of a run from its first whole snapshot on."""


def zephyr_option(file: str, pattern: str) -> int:
    found = re.search(pattern, (REPOSITORY / "firmware" / "robot" / file).read_text())
    assert found is not None, f"{file} has no {pattern!r}"
    return int(found[1])


@pytest.mark.parametrize("name", STRUCTURE_BYTES)
def test_a_structure_keeps_to_its_budget(name: str) -> None:
    used = Layouts(rig.firmware("bench").image)[name].itemsize
    print(f"{name}: {used} of {STRUCTURE_BYTES[name]} bytes")
    assert 0.8 * STRUCTURE_BYTES[name] < used <= STRUCTURE_BYTES[name], (
        "a budget far above its use hides growth"
    )


@pytest.mark.parametrize("name", STACK_BYTES)
def test_a_call_keeps_to_its_budget_of_stack(name: str) -> None:
    bound = StackAnalysis(rig.firmware("bench").image).bound(name)
    print(f"{name}: {bound.total_bytes} of {STACK_BYTES[name]} bytes: {bound.chain}")
    assert 0.7 * STACK_BYTES[name] < bound.total_bytes <= STACK_BYTES[name]


def test_zephyr_s_main_stack_has_room_for_the_core() -> None:
    """A fifth above the core's deepest call is for the loop around it, interrupts, and another compiler."""
    size = zephyr_option("prj.conf", r"CONFIG_MAIN_STACK_SIZE=(\d+)")
    assert max(STACK_BYTES.values()) <= 0.8 * size


def test_the_bench_leaves_eight_kilobytes() -> None:
    assert rig.firmware("bench").ram_bytes <= 56 * 1024


def spans_of(log: ChipLog, ring_bytes: int) -> list[float]:
    """At each record, once a ring of that size is full: seconds from its first whole snapshot on."""
    snapshots: list[tuple[int, int]] = []  # where each begins, and its time
    spans, end, first = [], 0, 0
    (records,) = log.records()
    for record in records:
        if record.name == "SNAPSHOT" and record.values["part"] == 0:
            first = end
        end += HEAD_BYTES + len(record.content)
        if record.name == "SNAPSHOT" and record.values["last"]:
            snapshots.append((first, record.time_us))
        if end > ring_bytes:
            begun_us = min(
                (time_us for begin, time_us in snapshots if begin >= end - ring_bytes), default=None
            )
            assert begun_us is not None, "there is always a whole snapshot"
            spans.append((record.time_us - begun_us) * 1e-6)
    return spans


def test_zephyr_s_log_holds_enough_of_a_run_to_replay() -> None:
    """Of one with 15 fixes a second along a path of 100 points."""
    ring_bytes = zephyr_option("Kconfig", r"range \d+ \d+\n\tdefault (\d{5,})")
    robot, _ = robot_with_log()
    robot.tick()
    robot.path(100)
    assert robot.status("ARM") == "OK"
    dice, known = random.Random(1), None
    live(robot, robot.now_us + 700_000, dice)
    assert robot.start() == "OK"
    for _ in range(count(30, 60)):
        live(robot, robot.now_us + 2_000_000, dice)
        known = fetched(robot, known)
    assert known is not None and robot.state() == "RUNNING"
    spans = spans_of(known, ring_bytes)
    print(f"{ring_bytes} bytes: {min(spans):.1f} to {max(spans):.1f} s, mean {sum(spans) / len(spans):.1f} s")
    assert min(spans) > REPLAYED_S
