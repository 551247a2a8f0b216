"""What a robot's log tells, decided again by the core and by the twin: the same records, bit for bit."""

from __future__ import annotations

import random
from functools import cache
from pathlib import Path

import pytest
from tests.conftest import count, from_ci, some
from tests.core.core import ACTION, COVERAGE_DIR, FFI, Robot, cases, core, image, mutated, source_files
from tests.core.core import library as core_library
from tests.core.log_rig import RING_BYTES, Log, fetched, robot_with_log
from tests.core.store_rig import NEW, OLD, crc_of, robot_with_store
from tests.core.test_core_table_commands import begin_values, send

from frogkick.link.layout import Value, link_layout, supervisor
from frogkick.link.log import HEAD_BYTES, ChipLog, Record, Stretch, check_of, records_of
from frogkick.runs.chip_log import LATE, TOO_LATE, LogReplay, replay_log
from frogkick.tables.image import open_image
from frogkick_codegen.native import build_shared

STATUS = link_layout().status


@cache
def library() -> Path:
    if COVERAGE_DIR:
        return Path(COVERAGE_DIR) / "core.so"
    return build_shared("fk_core", source_files())


def replayed(log: ChipLog) -> LogReplay:
    core()
    return replay_log(log, library(), [open_image(image())])


def live(robot: Robot, until_us: int, dice: random.Random, every_us: int = 66_000) -> None:
    """Fixes of a robot that drifts along, late, doubled and wild at times."""
    while robot.now_us < until_us:
        robot.run_until(min(until_us, robot.now_us + every_us))
        x_m = 0.01 * (robot.now_us - 1_000_000) * 1e-6 + dice.gauss(0.0, 2e-4)
        if dice.random() < 0.03:
            x_m += 0.3
        robot._fixes += dice.random() > 0.05
        values: dict[str, Value] = {
            "fix_sequence": robot._fixes & 0xFFFF, "quality": 1, "capture_age_us": dice.randint(0, 150_000),
            "x_m": x_m, "y_m": dice.gauss(0.0, 2e-4), "heading_rad": dice.gauss(0.0, 3e-3),
        }  # fmt: skip
        for _ in range(1 + (dice.random() < 0.05)):
            robot.post("FIX", values)
        robot.take()


def run(seed: int, seconds: float = 20.0, path_points: int = 20) -> Robot:
    """A robot that has swum for a while; what was logged before ARM is not enough to begin from."""
    return swim(robot_with_log()[0], seed, seconds, path_points)


def swim(robot: Robot, seed: int, seconds: float, path_points: int = 20) -> Robot:
    """The same, of this robot."""
    dice = random.Random(seed)
    robot.tick()
    robot.fix()
    robot.path(path_points)
    robot.status("PARAM", {"parameter": 1, "value": 2.0})
    robot.status("ARM")
    live(robot, robot.now_us + 700_000, dice)
    assert robot.start(dice.randint(0, 300_000)) == "OK"
    live(robot, robot.now_us + round(seconds * 1e6), dice)
    return robot


def decisions_of(log: ChipLog) -> int:
    return sum(record.name == "DECISION" for records in log.records() for record in records)


@pytest.mark.parametrize("seed", range(cases(3, 30)))
def test_a_run_is_decided_again(seed: int) -> None:
    log = fetched(run(seed))
    reported = replayed(log)
    assert reported.mismatches == []
    assert len(reported.decisions) == decisions_of(log) >= 8
    assert any(decision.status == 0 for decision in reported.decisions)
    assert reported.segments == 1
    assert reported.records - reported.replayed < 12, "BOOT to ARM"


def test_a_ring_that_has_lost_its_begin_is_decided_again_from_its_first_snapshot() -> None:
    log = fetched(run(1, 60.0))
    assert log.lost > 100
    reported = replayed(log)
    assert reported.mismatches == []
    assert reported.segments == 1
    assert 8 < len(reported.decisions) <= decisions_of(log)
    assert reported.replayed > 0.5 * reported.records


DOINGS = (
    "ARM", "ARM", "PATH", "START", "START", "STOP", "DISARM", "PARAM", "STROKE", "STROKE", "FIX", "wait",
)  # fmt: skip


def test_everything_a_host_can_do() -> None:
    """Commands of all kinds at all times; also what is refused, ended, lost, stopped, armed again."""
    for seed in range(cases(6, 60)):
        dice = random.Random(seed)
        robot, _ = robot_with_log()
        robot.tick()
        for _ in range(60):
            what = dice.choice(DOINGS)
            if what == "PATH":
                total = dice.choice((2, 20, 37))
                rows = [(index / total, 0.0, dice.choice((0.0, 0.1, 9.0, 0.0))) for index in range(total)]
                for first in range(0, total, 18):
                    part = rows[first : first + 18]
                    robot.post("PATH", {"first": first, "total": total, "count": len(part)}, part)
                robot.take()
            elif what == "START":
                live(robot, robot.now_us + 300_000, dice)
                robot.start(dice.randint(0, 200_000))
            elif what == "PARAM":
                value = dice.choice((0.0, 1.0, 2.0, 3.0, 700_000.0, 2e6, -1.0, 1e7))
                robot.status("PARAM", {"parameter": dice.randint(1, 20), "value": value})
            elif what == "STROKE":
                robot.status("STROKE", {"action": dice.randint(0, len(ACTION))})
            elif what == "FIX":
                live(robot, robot.now_us + dice.randint(1, 3_000_000), dice)
            elif what == "wait":
                robot.run_until(robot.now_us + dice.choice((1, 1000, 90_000, 600_000, 3_000_000, 12_000_000)))
            else:
                robot.status(what)
            if dice.random() < 0.5:
                robot.tick()
        reported = replayed(fetched(robot))
        assert reported.mismatches == [], f"seed {seed}"
        assert reported.segments >= 1, f"seed {seed}"


def changed(log: ChipLog, chosen: Record, content: bytes, fitting: bool) -> ChipLog:
    """Another content of one record; with a check that fits or as it was."""
    stretches = []
    for stretch in log.stretches:
        raw = bytearray(stretch.content)
        for record in records_of(stretch):
            if record.offset == chosen.offset:
                at = record.offset - stretch.offset
                raw[at + HEAD_BYTES : at + HEAD_BYTES + len(content)] = content
                if fitting:
                    whole = bytes(raw[at : at + HEAD_BYTES + len(content)])
                    raw[at + 2 : at + 4] = check_of(whole).to_bytes(2, "little")
        stretches.append(Stretch(stretch.offset, bytes(raw)))
    return ChipLog(tuple(stretches), log.lost)


@from_ci
def test_every_wrong_bit_is_a_mismatch() -> None:
    """Whether the record's check tells it, or somebody made that fit again."""
    log = fetched(run(2, 8.0))
    records = [record for found in log.records() for record in found]
    first = next(i for i, record in enumerate(records) if record.name == "SNAPSHOT")
    seen = {}
    for record in records[first:]:
        if record.name in ("DECISION", "STROKE", "BEGUN", "PULSE", "STATE") and record.name not in seen:
            seen[record.name] = record
        elif record.command == "FIX" and record.values["status"] == STATUS["OK"]:
            seen.setdefault("FIX", record)
    assert len(seen) == 6
    dice = random.Random(1)
    for name, record in seen.items():
        size = 8 * len(record.content)
        for bit in dice.sample(range(size), min(size, cases(4, 2000))):
            content = bytearray(record.content)
            content[bit // 8] ^= 1 << bit % 8
            reported = replayed(changed(log, record, bytes(content), fitting=False))
            assert [m.place for m in reported.mismatches] == ["log"], f"{name}, bit {bit}"
            if name == "FIX" and 8 <= bit < 56:
                continue  # its number, quality and age, which need not matter
            reported = replayed(changed(log, record, bytes(content), fitting=True))
            assert reported.mismatches != [], f"{name}, bit {bit}"


def test_a_wrong_bit_of_a_snapshot_is_a_mismatch() -> None:
    log = fetched(run(3, 30.0))
    records = [record for found in log.records() for record in found]
    parts = [record for record in records if record.name == "SNAPSHOT"]
    dice = random.Random(2)
    assert len(parts) > 15
    whole = len([record for record in parts if record.values["last"]])
    for record in parts[:: count(1, 1, 4)]:
        content = bytearray(record.content)
        content[dice.randrange(7, len(content))] ^= 1 << dice.randrange(8)
        reported = replayed(changed(log, record, bytes(content), fitting=False))
        assert [(m.place, m.offset) for m in reported.mismatches] == [("log", record.offset)]
        assert 1 <= reported.segments < whole


def test_a_fetch_with_a_gap_goes_on_at_the_next_snapshot() -> None:
    robot = run(4, 10.0)
    known = fetched(robot)
    live(robot, robot.now_us + 60_000_000, random.Random(5))
    log = fetched(robot, known)
    assert len(log.stretches) == 2
    reported = replayed(log)
    assert (reported.mismatches, reported.segments) == ([], 2)


def test_fixes_that_were_not_logged_begin_anew() -> None:
    robot = run(5, 5.0)
    robot.status("DISARM")
    robot.fix(0.11)
    robot.path()
    robot.status("ARM")
    robot.status("STROKE", {"action": ACTION["B"]})
    robot.run_until(robot.now_us + 1_000_000)
    log = fetched(robot)
    reported = replayed(log)
    assert (reported.mismatches, reported.segments) == ([], 2)
    assert reported.replayed < reported.records


def test_a_port_that_fails_is_lived_through_too() -> None:
    robot = run(6, 3.0)
    robot.core.fk_robot_note_pulse_failed(robot.memory, -7)
    robot.tick()
    reported = replayed(fetched(robot))
    assert reported.mismatches == []
    assert [r.name for r in fetched(robot).records()[0]][-3:] == ["FAULT", "STATE", "OFF"]


def test_a_port_that_is_late_is_lived_through_too() -> None:
    robot = run(6, 3.0)
    robot.status("STOP")
    robot.now_us += 1_000_000
    for _ in range(2):
        robot.status("STROKE", {"action": ACTION["B"]})
        assert robot.tick().limb_mask
        robot.core.fk_robot_note_pulse_failed(robot.memory, LATE)
        robot.run_until(robot.now_us + 1_000_000)
    log = fetched(robot)
    reported = replayed(log)
    assert reported.mismatches == []
    pulses = [record.values["allowed"] for record in log.records()[0] if record.name == "PULSE"]
    assert pulses[-4:] == [1, TOO_LATE, 1, TOO_LATE]


@pytest.mark.parametrize("way", ["silence", "the connection ended"])
def test_a_link_that_was_lost_is_lived_through_too(way: str) -> None:
    """The log has not every frame that was heard: a replay cannot tell of silence by itself."""
    robot = run(6, 3.0)
    robot.status("STOP")
    for _ in range(3):
        robot.run_until(robot.now_us + 3_000_000)
        assert robot.state() == "ARMED"  # STATUS is heard, not logged
    if way == "silence":
        robot.run_until(robot.now_us + 6_000_000)
    else:
        robot.core.fk_robot_note_link_lost(robot.memory)
        robot.tick()
    assert robot.state() == "DISARMED"
    log = fetched(robot)
    assert replayed(log).mismatches == []
    assert [record.name for record in log.records()[0]][-2:] == ["STATE", "OFF"]


@pytest.mark.parametrize("running", [True, False])
def test_a_supply_that_fell_is_lived_through_too(running: bool) -> None:
    """Also that ARM was refused meanwhile, and that it is well again, which no record says."""
    robot = run(8, 3.0)
    if not running:
        robot.status("STOP")
    robot.core.fk_robot_note_supply(robot.memory, 1)
    robot.tick()
    assert robot.status("ARM") == "SUPPLY"
    robot.now_us += 1000
    robot.core.fk_robot_note_supply(robot.memory, 0)
    assert robot.status("ARM") == "OK"
    robot.status("STROKE", {"action": ACTION["B"]})
    robot.run_until(robot.now_us + 1_000_000)
    log = fetched(robot)
    reported = replayed(log)
    assert reported.mismatches == []
    records = log.records()[0]
    events = [record.values["event"] for record in records if record.name == "STATE"]
    assert events[-2:] == [supervisor().number("SUPPLY_LOW"), supervisor().number("ARM")]
    ends = [link_layout().status_name(int(r.values["status"])) for r in records if r.name == "ENDED"]
    assert ends[-1:] == (["SUPPLY"] if running else [])


def test_a_reset_in_between() -> None:
    """The log goes on; what stands before the reset is decided again, and what comes after it."""
    robot = run(7, 5.0)
    log: Log = robot._log
    again = Robot()
    again._log = log
    again.core.fk_robot_use_log(again.memory, log.memory)
    again.begin("RUNNING")
    again.run_until(again.now_us + 3_000_000)
    reported = replayed(fetched(again))
    assert (reported.mismatches, reported.segments) == ([], 2)
    boots = [r for r in fetched(again).records()[0] if r.name == "BOOT"]
    assert [boot.values["continued"] for boot in boots] == [0, 1]


def test_an_update_of_the_table_in_between() -> None:
    """What was done by a table is decided again by that table; nothing is while it changes."""
    robot, flash = robot_with_store()
    log = Log()
    log.memory.magic = 0
    robot.core.fk_robot_use_log(robot.memory, log.memory)
    swim_a_little(robot)
    robot.status("DISARM")
    robot.run_until(robot.now_us + 1_000_000)
    answer = robot.ask("TABLE_BEGIN", begin_values(NEW))
    assert (answer["status"], robot.status("ARM")) == (0, "STATE")
    robot.fix(0.1)
    send(robot, NEW)
    assert robot.status("ARM") == "STATE"
    assert robot.status("TABLE_COMMIT") == "OK"
    swim_a_little(robot)
    robot.status("DISARM")
    robot.run_until(robot.now_us + 1_000_000)
    assert robot.status("TABLE_ROLLBACK", {"table_crc": crc_of(OLD)}) == "OK"
    swim_a_little(robot)
    fetch = fetched(robot)
    both = [open_image(OLD), open_image(NEW)]
    again = replay_log(fetch, library(), both)
    assert (again.mismatches, again.segments) == ([], 3)
    assert len(again.decisions) == decisions_of(fetch) >= 6
    for one in both:
        assert replay_log(fetch, library(), [one]).mismatches == []
    assert replay_log(fetch, library(), both[1:]).segments == 1
    assert flash.sim.refused == 0


def swim_a_little(robot: Robot) -> None:
    robot.path()
    assert robot.status("ARM") == "OK"
    robot.fix(0.1)
    assert robot.start(0) == "OK"
    for number in range(40):
        robot.run_until(robot.now_us + 80_000)
        robot.take()
        robot.fix(0.1 + 0.001 * number)


DECIDES_OTHERWISE = {
    "a later decision": (
        "fk_robot.c", "robot->next_decision_us += robot->period_us;",
        "robot->next_decision_us += robot->period_us + 1u;", "core twin",
    ),
    "another estimate": (
        "fk_estimator.c", "fix.pose[2] = fk_wrap_angle(fix.pose[2]);",
        "fix.pose[2] = fk_wrap_angle(fix.pose[2] + 1e-4f);", "core twin",
    ),
    "another cost": (
        "fk_robot.c", "event->cost = plan.cost;", "event->cost = plan.cost * 1.0001f;", "core twin",
    ),
    "a shorter rest": ("fk_robot_config.h", "FK_REST_MIN_US 500000u", "FK_REST_MIN_US 1500000u", "core"),
    "a pulse that is not logged": (
        "fk_robot.c", "        fk_robot_log_pulse(robot, limb_mask, FK_PULSE_ASKED);\n", "", "core",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", some(DECIDES_OTHERWISE, 2))
def test_a_firmware_that_was_changed_is_found(name: str) -> None:
    """Its log, decided again by the core and the twin as they are."""
    file, old, new, places = DECIDES_OTHERWISE[name]
    robot, _ = robot_with_log(made=core_library(mutated(file, old, new)))
    reported = replayed(fetched(swim(robot, 1, 8.0)))
    found = {mismatch.place for mismatch in reported.mismatches}
    assert found >= set(places.split()), reported.mismatches[:3]
    unchanged = replayed(fetched(run(1, 8.0)))
    assert unchanged.mismatches == []


def test_a_command_that_hung_is_the_end_of_a_segment() -> None:
    """The core never came back from it: what it did is not known. After another command that cannot be."""
    log = fetched(run(8, 4.0))
    records = log.records()[0]
    place = max(i for i, record in enumerate(records) if record.command == "FIX")
    hung = records[place]
    reported = replayed(changed(log, hung, hung.content[:-1] + b"\x80", fitting=True))
    assert (reported.mismatches, reported.segments) == ([], 1)
    earlier = next(r for r in records[place // 2 :] if r.command == "FIX")
    reported = replayed(changed(log, earlier, earlier.content[:-1] + b"\x80", fitting=True))
    assert [m.what for m in reported.mismatches] == ["the command before it is unfinished"]


def test_another_table_is_not_decided_by_this_one() -> None:
    reported = replay_log(fetched(run(8, 3.0)), library(), [])
    assert (reported.segments, reported.replayed, reported.mismatches) == (0, 0, [])
    assert reported.records > 0


def test_the_ring_is_as_long_as_it_says() -> None:
    assert FFI.sizeof("fk_log_t") == RING_BYTES + 20
