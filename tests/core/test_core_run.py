"""The robot in time: decisions, strokes, ends of runs, and what it sends in which order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.core.core import (
    ACTION,
    DELAY_US,
    GAP_US,
    LATE_US,
    NEVER_US,
    PERIOD_US,
    PULSE_US,
    RESTING,
    SILENT_US,
    Robot,
    cases,
    image,
)

from frogkick.link.frames import Frame
from frogkick.link.layout import link_layout
from frogkick.paths import Path
from frogkick.planner.plan import config_of
from frogkick.pool.monitor import Pulse, violations
from frogkick.robot import load_robot
from frogkick.runs.decision import DecisionTwin, decision_of_event, events_of_frame
from frogkick.tables.image import open_image

SECOND_US = DELAY_US + GAP_US
DEFAULTS = config_of(load_robot("frog2022").planner)  # what the core is built with
STALE = link_layout().status["STALE"]
PARAMETER = link_layout().parameter
OTHER_CLOCKS_US = [600_000, 2**32 - 700_000, 2**32 - 1, 2**40, 2**52]


def events(robot: Robot) -> list[Frame]:
    return [frame for frame in robot.take() if frame.kind == "event"]


@pytest.mark.parametrize("now_us", OTHER_CLOCKS_US)
def test_a_stroke_fires_its_second_limbs_after_the_first(now_us: int) -> None:
    robot = Robot(now_us=now_us).begin("ARMED")
    answer = robot.ask("STROKE", {"action": ACTION["B"]})
    assert answer == {"status": 0, "stroke_us": now_us}
    out = robot.tick(now_us)
    assert (out.limb_mask, out.pulse_us, out.next_tick_us) == (0b0011, PULSE_US, now_us + SECOND_US)
    out = robot.tick(now_us + SECOND_US - 1)
    assert (out.limb_mask, out.next_tick_us) == (0, now_us + SECOND_US)
    out = robot.tick(now_us + SECOND_US)
    assert (out.limb_mask, out.pulse_us, out.next_tick_us) == (0b1100, PULSE_US, now_us + SILENT_US)
    assert robot.run_until(now_us + 10_000_000) == []


@pytest.mark.parametrize(
    ("name", "pulses"),
    [("A", [(0, 3)]), ("S", [(SECOND_US, 1)]), ("I", []), ("C", [(0, 2), (SECOND_US, 12)])],
)
def test_strokes_with_one_group_or_none(name: str, pulses: list[tuple[int, int]]) -> None:
    robot = Robot().begin("ARMED")
    begin_us = robot.now_us
    assert robot.stroke(name) == "OK"
    assert robot.run_until(begin_us + 4_000_000) == [(begin_us + at_us, mask) for at_us, mask in pulses]
    assert robot.stroke("B") == "OK"


def test_a_stroke_while_another_has_limbs_left_is_refused() -> None:
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    assert robot.stroke("I") == "STATE", "asked for, not begun"
    assert robot.tick().limb_mask == 0b0011
    assert robot.stroke("I") == "STATE", "begun, second limbs to come"
    assert robot.run_until(robot.now_us + SECOND_US) == [(robot.now_us, 0b1100)]
    assert robot.stroke("I") == "OK"


def test_strokes_out_of_the_table_are_refused() -> None:
    robot = Robot().begin("ARMED")
    for action in (7, 31, 255):
        assert robot.status("STROKE", {"action": action}) == "VALUE"
    assert robot.tick().next_tick_us == robot.now_us + SILENT_US


def test_one_pulse_at_a_time() -> None:
    """The port has one pulse timer: a pulse waiting there would not be on when it is booked."""
    robot = Robot().begin("ARMED")
    begin_us = robot.now_us
    assert robot.stroke("A") == "OK"
    robot.tick()
    robot.now_us += 30_000
    answer = robot.ask("STROKE", {"action": ACTION["R"]})
    assert answer == {"status": 0, "stroke_us": begin_us + PULSE_US + GAP_US}
    assert robot.tick().next_tick_us == begin_us + PULSE_US + GAP_US
    assert robot.run_until(begin_us + 10**6) == [(begin_us + PULSE_US + GAP_US, 0b1100)]


@pytest.mark.parametrize("delay_us", [0, 40_000, 79_999, 80_000, 300_000])
def test_second_limbs_wait_until_the_first_are_off(delay_us: int) -> None:
    robot = Robot(image(second_delay_us=delay_us)).begin("ARMED")
    begin_us = robot.now_us
    assert robot.stroke("B") == "OK"
    second_us = begin_us + max(delay_us, PULSE_US) + GAP_US
    assert robot.run_until(begin_us + 10**6) == [(begin_us, 0b0011), (second_us, 0b1100)]


def test_a_stroke_whose_first_limbs_are_refused_does_not_fire_the_second() -> None:
    robot = Robot().begin("ARMED")
    assert robot.stroke("A") == "OK"
    robot.run_until(robot.now_us + 300_000)
    assert robot.stroke("B") == "OK"
    assert robot.run_until(robot.now_us + 300_000) == []
    assert robot.ask("STATUS")["pulses_refused"] == 1


@pytest.mark.parametrize("command", ["STOP", "DISARM"])
@pytest.mark.parametrize("wait_us", [0, 40_000, 80_500])
def test_stop_and_disarm_in_the_middle_of_a_stroke(command: str, wait_us: int) -> None:
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    assert robot.tick().limb_mask == 0b0011
    robot.now_us += wait_us
    assert robot.status(command) == "OK"
    out = robot.tick()
    disarmed = command == "DISARM"
    due_us = NEVER_US if disarmed else robot.now_us + SILENT_US
    assert (out.all_off, out.limb_mask, out.next_tick_us) == (int(disarmed), 0, due_us)
    assert robot.run_until(robot.now_us + 4_000_000) == []
    assert robot.state() == ("ARMED" if command == "STOP" else "DISARMED")


@pytest.mark.parametrize("command", ["STOP", "DISARM"])
def test_stop_and_disarm_before_a_stroke_has_begun(command: str) -> None:
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    assert robot.status(command) == "OK"
    assert robot.run_until(robot.now_us + 5_000_000) == []


def test_a_stroke_right_after_disarm_and_arm() -> None:
    """All off comes first; the limbs that were cut rest, others may fire at once."""
    robot = Robot().begin("ARMED")
    assert robot.stroke("A") == "OK"
    robot.tick()
    robot.now_us += 40_000
    assert robot.status("DISARM") == robot.status("ARM") == "OK"
    assert robot.stroke("R") == "OK"
    out = robot.tick()
    assert (out.all_off, out.limb_mask) == (1, 0b1100)
    robot.now_us += LATE_US + 499_999
    assert robot.stroke("A") == "OK"
    assert robot.tick().limb_mask == 0
    robot.now_us += 1
    assert robot.stroke("A") == "OK"
    assert robot.tick().limb_mask == 0b0011


@pytest.mark.parametrize("now_us", OTHER_CLOCKS_US)
def test_decisions_come_at_exact_times(now_us: int) -> None:
    robot = Robot(now_us=now_us).begin("ARMED")
    robot.path()
    assert robot.fix() == "OK"
    first_us = robot.ask("START", {"delay_us": 250_000})["first_decision_us"]
    assert first_us == now_us + 250_000
    seen, at_us = [], int(first_us)
    for index in range(5):
        out = robot.tick(robot.now_us)
        assert out.next_tick_us == at_us and out.limb_mask == 0
        robot.now_us = at_us - 1
        assert robot.fix(x_m=0.1 + 0.01 * index) == "OK"
        assert robot.tick(at_us - 1).limb_mask == 0
        # The decision computes in its own tick, and the stroke begins with the time of the next one.
        out = robot.tick(at_us)
        assert (out.limb_mask, out.next_tick_us) == (0, at_us)
        seen += [frame.values for frame in events(robot)]
        pulses = robot.run_until(at_us + 400_000)
        action = int(seen[-1]["action"])
        table = {0: 3, 1: 3, 2: 2, 3: 1, 4: 12, 5: 0, 6: 0}
        assert [mask for t, mask in pulses if t == at_us] == [table[action]] * (table[action] > 0)
        at_us += PERIOD_US
    assert [values["scheduled_us"] for values in seen] == [int(first_us) + k * PERIOD_US for k in range(5)]
    assert [values["decision"] for values in seen] == list(range(5))
    assert all(values["status"] == 0 for values in seen)
    assert robot.ask("STATUS")["decisions"] == 5


def test_the_host_makes_the_same_decisions() -> None:
    """All that the twin needs is in what the robot sends, in its order."""
    rng = np.random.default_rng(4)
    decided = refused = 0
    rows = [(index / 19, 0.05 * np.sin(index / 3), 0.1) for index in range(18)]
    path = Path(*(np.array(column, dtype=np.float32) for column in zip(*rows, strict=True)), name="test")
    for _ in range(cases(100, 2000, 25)):
        robot = Robot(now_us=int(rng.integers(500_000, 2**34))).begin("ARMED")
        assert robot.status("PATH", {"first": 0, "total": 18, "count": 18}, rows) == "OK"
        depth = int(rng.integers(1, 4))
        assert robot.status("PARAM", {"parameter": 1, "value": depth}) == "OK"
        robot.keep = True
        twin = DecisionTwin(open_image(robot.image), path, replace(DEFAULTS, depth=depth))
        delay_us = int(rng.integers(200_000, 400_000))
        pose = np.array([0.2, 0.0, rng.uniform(-3, 3)])
        poses: dict[int, np.ndarray] = {}
        while len(poses) <= 80:
            robot.run_until(robot.now_us + int(rng.integers(20_000, 200_000)))
            pose = pose + rng.normal(0, [0.004, 0.004, 0.05])
            fix = pose.astype(np.float32)
            values = {
                "fix_sequence": len(poses), "quality": 1, "capture_age_us": int(rng.integers(0, 400_000)),
                **dict(zip(("x_m", "y_m", "heading_rad"), map(float, fix), strict=True)),
            }  # fmt: skip
            poses[len(poses)] = fix
            robot.post("FIX", values)
            if len(poses) == 1:
                robot.post("START", {"delay_us": delay_us})
        robot.run_until(robot.now_us + 5_000_000)
        for frame in robot.take_all():
            if frame.name == "FIX":
                answer, number = frame.values, int(frame.values["fix_sequence"])
                assert twin.add_fix(int(answer["capture_us"]), poses[number], number) == answer["status"]
                refused += answer["status"] != 0
            for event in events_of_frame(frame, {}) if frame.kind == "event" else ():
                decision = twin.apply(event)
                if decision is not None:
                    decided += 1
                    assert not decision_of_event(frame.values).differences(decision)
    assert decided > 2 * cases(100, 2000, 25) and refused > 0


def test_no_pulse_breaks_a_limit_whatever_is_commanded() -> None:
    """Commands at random, ports that tick late: the pulses on the pins keep every limit."""
    robot_limits = load_robot("frog2022")
    pulses_seen = 0
    names = list(ACTION)
    for seed in range(cases(400, 8000, 80)):
        rng = np.random.default_rng(seed)
        delay_us = int(rng.choice([0, 1000, 80_000, 80_000, 400_000]))
        robot = Robot(image(second_delay_us=delay_us), now_us=int(rng.choice([0, 10**6, 2**32 - 10**6])))
        pulses: list[list[int]] = []
        due_us = robot.tick().next_tick_us
        robot.path()
        for _ in range(60):
            choice = rng.random()
            if choice < 0.35:
                robot.stroke(str(rng.choice(names)))
            elif choice < 0.55:
                robot.post(str(rng.choice(["ARM", "ARM", "ARM", "STOP", "DISARM"])))
            elif choice < 0.7:
                robot.start(int(rng.integers(0, 100_000)))
            else:
                robot.post("FIX", {
                    "fix_sequence": 1, "quality": 1, "capture_age_us": 0,
                    "x_m": 0.3, "y_m": 0.0, "heading_rad": float(rng.normal()),
                })  # fmt: skip
            until_us = robot.now_us + int(rng.choice([0, 1, 20_000, 100_000, 500_000, 1_500_000]))
            due_us = robot.now_us
            while due_us <= until_us:
                out = robot.tick(due_us)
                if out.all_off:
                    for pulse in pulses:
                        pulse[2] = min(pulse[2], robot.now_us)
                for limb in range(4):
                    if out.limb_mask >> limb & 1:
                        pulses.append([limb, robot.now_us, robot.now_us + out.pulse_us])
                assert not out.limb_mask or sum(p[1] <= robot.now_us < p[2] for p in pulses) == (
                    out.limb_mask.bit_count()
                ), f"two pulses at a time, seed {seed}"
                due_us = max(robot.now_us, out.next_tick_us) + int(rng.choice([0, 0, 0, 15, 30_000]))
            robot.now_us = until_us
            robot.take()
        seen = [Pulse(limb, start * 1e-6, end * 1e-6) for limb, start, end in pulses if end > start]
        pulses_seen += len(seen)
        assert not violations(robot_limits, seen), f"seed {seed}"
    assert pulses_seen > 5 * cases(400, 8000, 80)


def test_start_without_any_fix_is_refused() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.start(100_000) == "STALE"
    assert robot.run_until(robot.now_us + 3_000_000) == [] == events(robot)
    assert robot.fix() == "OK"
    robot.now_us += 2_000_001
    assert robot.start() == "STALE", "the fix is too old by now"
    assert robot.state() == "ARMED"


def test_a_start_whose_fixes_never_come_ends_stale_and_disarmed() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.fix(capture_age_us=900_000) == "OK"
    assert robot.start(3_000_000) == "OK"
    begin_us = robot.now_us
    out = robot.tick()
    assert out.next_tick_us == begin_us + 1_100_001, "when the fix is lost, not when the decision is due"
    assert robot.run_until(begin_us + 3_000_000) == []
    (ended,) = events(robot)
    assert (ended.name, ended.values) == ("ENDED", {"status": STALE, "state": 0, "decisions": 0})
    assert robot.state() == "DISARMED"


def test_start_limits() -> None:
    robot = Robot().begin("ARMED")
    assert robot.start() == "NO_PATH"
    robot.path()
    assert robot.fix() == "OK"
    assert robot.start(10_000_001) == "VALUE"
    assert robot.start(0xFFFFFFFF) == "VALUE"
    assert robot.start(10_000_000) == "OK"


def test_without_fixes_no_stroke_then_disarmed() -> None:
    robot = Robot().begin("RUNNING")
    first_us = robot.now_us + 1_000_000
    capture_us = robot.now_us - 1000
    for _ in range(10):
        if robot.now_us < first_us:
            robot.now_us += 100_000
            capture_us = robot.now_us
            assert robot.fix(capture_age_us=0) == "OK"
    while robot.state() == "RUNNING":
        robot.keep = True
        ended_us = robot.tick(robot.tick().next_tick_us) and robot.now_us
    robot.keep = False
    robot.run_until(first_us + 4 * PERIOD_US)
    frames = [frame for frame in robot.take_all() if frame.kind == "event"]
    assert [frame.name for frame in frames] == ["DECISION", "DECISION", "ENDED"]
    assert [frame.values["status"] for frame in frames] == [0, STALE, STALE]
    assert frames[1].values["action"] == RESTING and frames[1].values["fixes_in_estimate"] == 0
    assert frames[2].values["decisions"] == 2
    assert first_us + 2 * PERIOD_US - capture_us > 2_000_000 >= first_us + PERIOD_US - capture_us
    assert ended_us == capture_us + 2_000_001, "then, not at the next decision"
    assert robot.state() == "DISARMED"
    assert robot.tick().all_off == 0, "that tick is over"


@pytest.mark.parametrize(("age_us", "state"), [(2_000_000, "RUNNING"), (2_000_001, "DISARMED")])
def test_two_seconds_without_a_fix_to_the_microsecond(age_us: int, state: str) -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.fix() == "OK"
    assert robot.start(age_us) == "OK"
    out = robot.tick(robot.now_us + age_us)
    assert robot.state() == state
    assert out.all_off == (state == "DISARMED") and out.limb_mask == 0


def test_a_tick_that_switches_limbs_off_does_not_decide_first() -> None:
    """A decision may take half a second; the guard allows for 200 us until the pins are low."""
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.fix() == robot.stroke("A") == "OK"
    assert robot.tick().limb_mask == 0b0011
    assert robot.status("DISARM") == robot.status("ARM") == robot.start() == "OK"
    out = robot.tick()
    assert out.all_off and out.next_tick_us <= robot.now_us
    assert robot.ask("STATUS")["decisions"] == 0
    assert not robot.tick().all_off
    assert robot.ask("STATUS")["decisions"] == 1
