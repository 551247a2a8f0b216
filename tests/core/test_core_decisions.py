"""Decisions along a path: when they come, what travels with them, and that the host makes the same."""

from __future__ import annotations

import numpy as np
import pytest
from tests.conftest import count
from tests.core.core import (
    ACTION_ROWS,
    DELAY_US,
    GAP_US,
    PERIOD_US,
    RESTING,
    Robot,
)
from tests.planner import synthetic

from frogkick.link.frames import Frame
from frogkick.link.layout import Value, link_layout
from frogkick.paths import Path
from frogkick.planner.plan import config_of
from frogkick.robot import load_robot
from frogkick.runs.decision import LIMB_USE_FIELDS, DecisionTwin, decision_of_event, events_of_frame
from frogkick.tables.image import open_image

STATUS, STATE = link_layout().status, link_layout().state
SECOND_US = DELAY_US + GAP_US
DEFAULTS = config_of(load_robot("frog2022").planner)  # what the core is built with
STALE = link_layout().status["STALE"]
PARAMETER = link_layout().parameter
OTHER_CLOCKS_US = [600_000, 2**32 - 700_000, 2**32 - 1, 2**40, 2**52]


def events(robot: Robot) -> list[Frame]:
    return [frame for frame in robot.take() if frame.kind == "event"]


def test_the_end_of_the_path_ends_the_run() -> None:
    robot = Robot().begin("ARMED")
    assert robot.status("PARAM", {"parameter": PARAMETER["COST"], "value": 0}) == "OK"
    robot.path()
    assert robot.fix(x_m=0.99) == "OK"
    assert robot.start(50_000) == "OK"
    assert robot.run_until(robot.now_us + 4_000_000) == []
    decision, ended = events(robot)
    assert (decision.name, decision.values["path_index"], decision.values["status"]) == ("DECISION", 19, 0)
    assert ended.values == {"status": 0, "state": 1, "decisions": 1}
    assert (decision.sequence, ended.sequence) == (0, 1)
    assert robot.state() == "ARMED"
    assert [robot.fix(x_m=0.1 + 0.001 * k) for k in range(3)] == ["OUTLIER", "OUTLIER", "OK"], "carried back"
    assert robot.start() == "OK", "and another run may follow"
    robot.tick()
    assert [frame.values["decision"] for frame in events(robot)] == [0]


SHORT = [(0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.1, 0.0, 0.0)]  # a path; the table's reach is 0.15 m
ENDS = [(0.1, "OK"), (0.2, "PASSED")]  # beside it by less than a reach and by more


@pytest.mark.parametrize(("y_m", "name"), ENDS)
def test_a_run_ends_at_the_fix_that_crosses_the_path_s_end(y_m: float, name: str) -> None:
    robot = Robot().begin("ARMED")
    assert robot.status("PATH", {"first": 0, "total": 3, "count": 3}, SHORT) == "OK"
    assert robot.fix(0.08, y_m) == robot.start() == "OK"
    robot.tick()
    assert [frame.name for frame in events(robot)] == ["DECISION"]
    for x_m in (0.085, 0.09, 0.095):
        robot.run_until(robot.now_us + 50_000)
        assert robot.fix(x_m, y_m) == "OK"
        assert robot.state() == "RUNNING"
    robot.run_until(robot.now_us + 50_000)
    robot.keep = True
    robot.post("FIX", {
        "fix_sequence": 9, "quality": 1, "capture_age_us": 0, "x_m": 0.101, "y_m": y_m, "heading_rad": 0.0,
    })  # fmt: skip
    (ended,) = [frame for frame in robot.take_all() if frame.name == "ENDED"]
    assert ended.values == {"status": STATUS[name], "state": STATE["ARMED"], "decisions": 1}
    assert robot.state() == "ARMED"


def test_no_fix_ends_a_run_before_its_first_decision_or_with_the_paper_s_cost() -> None:
    for cost, delay_us in (("ROUTE", 500_000), ("PAPER", 0)):
        robot = Robot().begin("ARMED")
        number = {"PAPER": 0, "ROUTE": 1}[cost]
        assert robot.status("PARAM", {"parameter": PARAMETER["COST"], "value": number}) == "OK"
        assert robot.status("PATH", {"first": 0, "total": 3, "count": 3}, SHORT) == "OK"
        assert robot.fix(0.06, 0.1) == robot.start(delay_us) == "OK"
        for x_m in (0.07, 0.08, 0.09, 0.1, 0.11):
            robot.run_until(robot.now_us + 50_000)
            assert robot.fix(x_m, 0.1) == "OK"
        assert robot.state() == "RUNNING"


@pytest.mark.parametrize(("y_m", "name"), ENDS)
def test_a_run_that_begins_beyond_the_path_s_end_is_over(y_m: float, name: str) -> None:
    robot = Robot().begin("ARMED")
    assert robot.status("PATH", {"first": 0, "total": 3, "count": 3}, SHORT) == "OK"
    assert robot.fix(0.12, y_m) == robot.start() == "OK"
    robot.tick()
    decision, ended = events(robot)
    assert (decision.name, ended.name, ended.values["status"]) == ("DECISION", "ENDED", STATUS[name])


def test_a_run_without_progress_ends_and_says_so() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    robot.keep = True
    assert robot.fix() == robot.start() == "OK"
    reported: list[Frame] = []
    while not any(frame.name == "ENDED" for frame in reported):
        robot.run_until(robot.now_us + 200_000)
        reported += robot.take_all()
        assert robot.now_us < 100 * PERIOD_US
        robot.fix()
    assert reported[-1].values["status"] == STATUS["STALLED"]
    assert reported[-1].values["decisions"] == 41


def test_events_stand_before_the_answers_to_later_commands() -> None:
    robot = Robot().begin("RUNNING")
    robot.now_us += 990_000
    robot.post("HELLO")
    robot.run_until(robot.now_us + 20_000)
    robot.post("STATUS")
    robot.post("DISARM")
    assert [frame.name for frame in robot.take()] == ["START", "HELLO", "DECISION", "STATUS", "DISARM"][1:]


def test_decisions_that_nobody_takes_are_counted_as_dropped() -> None:
    robot = Robot().begin("RUNNING")
    until_us, fixes = robot.now_us + 12 * PERIOD_US, 0
    while robot.now_us < until_us:
        robot.run_until(min(robot.now_us + 50_000, until_us))
        robot.post("FIX", {
            "fix_sequence": (fixes := fixes + 1), "quality": 1, "capture_age_us": 0,
            "x_m": 0.1, "y_m": 0.0, "heading_rad": 0.0,
        })  # fmt: skip
    delivered = robot.take()
    status = robot.ask("STATUS")
    decisions = [frame for frame in delivered if frame.name == "DECISION"]
    assert 0 < len(decisions) < int(status["decisions"]) == 12
    assert status["answers_dropped"] == 12 + fixes - len(delivered)
    sequences = [frame.sequence for frame in decisions]
    assert sequences == [frame.values["decision"] for frame in decisions], "the gaps show what was lost"


def test_a_decision_not_taken_before_the_next_one_is_not_lost() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.fix() == robot.start() == "OK"
    robot.run_until(robot.now_us + PERIOD_US + 10)
    assert [frame.values["decision"] for frame in events(robot)] == [0, 1]


def test_a_late_port_makes_up_for_decisions_at_their_own_times() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.fix() == robot.start() == "OK"
    first_us = robot.now_us
    robot.now_us += PERIOD_US + 7
    pulses = robot.run_until(robot.now_us + 300_000)
    first, refused, second = events(robot)
    answer = [(frame.values["scheduled_us"], frame.values["status"]) for frame in (first, second)]
    assert answer == [(first_us, 0), (first_us + PERIOD_US, STALE)]
    assert refused.name == "REFUSED" and pulses == [], "the first decision's stroke comes when its fix is old"


def test_a_port_that_is_a_little_late_begins_the_stroke_late() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.fix() == robot.start() == "OK"
    robot.now_us += 300_000
    begin_us = robot.now_us
    pulses = robot.run_until(robot.now_us + 300_000)
    assert [at_us for at_us, _ in pulses][:1] == [begin_us]
    assert [frame.name for frame in events(robot)] == ["DECISION"]


def test_a_decision_waits_for_a_stroke_under_way_and_is_for_its_own_time() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.fix() == "OK"
    begin_us = robot.now_us
    assert robot.stroke("B") == "OK"
    assert robot.start(10_000) == "OK"
    pulses = robot.run_until(begin_us + 170_000)
    assert pulses[:2] == [(begin_us, 0b0011), (begin_us + SECOND_US, 0b1100)]
    decision, refused = events(robot)
    assert decision.values["scheduled_us"] == begin_us + 10_000
    assert refused.name == "REFUSED", "the limbs have not rested"
    assert refused.values == {"action": decision.values["action"], "begin_us": begin_us + 10_000}


def test_the_period_is_that_of_param() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    parameter = link_layout().parameter["PERIOD_US"]
    assert robot.status("PARAM", {"parameter": parameter, "value": 700_000}) == "OK"
    assert robot.fix() == "OK"
    first_us = int(robot.ask("START", {"delay_us": 0})["first_decision_us"])
    robot.run_until(first_us + 2_000_000)
    answer = [frame.values["scheduled_us"] for frame in events(robot) if frame.name == "DECISION"]
    assert answer == [first_us, first_us + 700_000, first_us + 1_400_000]


@pytest.mark.parametrize("depth", [1, 2, 3, 4])
def test_the_depth_is_that_of_param(depth: int) -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    assert robot.status("PARAM", {"parameter": 1, "value": depth}) == "OK"
    assert robot.fix(0.2, 0.1, 0.4) == "OK"
    assert robot.start() == "OK"
    robot.tick()
    (decision,) = events(robot)
    values = decision.values
    names = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_rad_s")
    assert robot.status("STOP") == "OK"
    state = {name: values[name] for name in (*names, *LIMB_USE_FIELDS)}
    answer = robot.ask("PLAN", {"depth": depth, **state, "along_points": 0.0})
    assert (answer["action"], answer["cost"], answer["path_index"]) == (
        values["action"], values["cost"], values["path_index"],
    )  # fmt: skip
    assert [answer[name] for name in names] == [values["predicted_" + name] for name in names]


def test_the_computing_time_travels_in_the_event() -> None:
    robot = Robot().begin("RUNNING")
    robot.core.fk_robot_note_tick(robot.memory, 99)
    robot.tick(robot.now_us + 1_000_000)
    robot.core.fk_robot_note_tick(robot.memory, 12_345)
    robot.tick()
    robot.core.fk_robot_note_tick(robot.memory, 6)
    (decision,) = events(robot)
    assert decision.values["plan_us"] == 12_345


def test_a_state_that_cannot_be_planned_from_rests() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    for step in range(10):
        assert robot.fix(x_m=999.9 + 0.01 * step) == "OK"
        robot.now_us += 50_000
    assert robot.start(100_000) == "OK"  # by then beyond 1000 m, where no fix may be either
    assert robot.run_until(robot.now_us + 100_000) == []
    (decision,) = events(robot)
    assert (decision.values["status"], decision.values["action"]) == (-3, RESTING)


def test_two_hundred_decisions_with_a_bad_camera_are_the_twins() -> None:
    """One robot, five minutes: fixes lost, late, doubled, overtaken, wrong; and carried away by hand."""
    rng = np.random.default_rng(9)
    rows = [(0.05 * index, 0.02 * index, 0.4) for index in range(18)]
    path = Path(*(np.array(column, dtype=np.float32) for column in zip(*rows, strict=True)), name="test")
    robot = Robot(synthetic.affine_image(60, len(ACTION_ROWS), action_rows=ACTION_ROWS), now_us=2**32 - 10**7)
    robot.begin("ARMED").keep = True
    assert robot.status("PATH", {"first": 0, "total": 18, "count": 18}, rows) == "OK"
    twin = DecisionTwin(open_image(robot.image), path, DEFAULTS)
    pose, poses, ways = np.array([0.0, 0.0, 0.4]), {}, []
    decided, statuses, uses, number, running = 0, set(), set(), 0, False
    while decided < count(220, 2000, 60):
        robot.run_until(robot.now_us + int(rng.integers(10_000, 60_000)))
        pose = pose + rng.normal(0, [0.001, 0.001, 0.01]) + (rng.random() < 0.001) * rng.normal(0, 0.5, 3)
        fix = (pose + (rng.random() < 0.05) * rng.uniform(-0.5, 0.5, 3)).astype(np.float32)
        age_us = int(rng.choice([20_000, 80_000, 400_000]))
        number += 1
        for _ in range(1 + (rng.random() < 0.1) if rng.random() > 0.2 else 0):
            ways.append((robot.now_us + int(rng.integers(0, 300_000)), age_us, fix, number))
        for way in [way for way in ways if way[0] <= robot.now_us]:
            ways.remove(way)
            values: dict[str, Value] = {"fix_sequence": way[3], "quality": 1, "capture_age_us": way[1]}
            values |= dict(zip(("x_m", "y_m", "heading_rad"), map(float, way[2]), strict=True))
            poses[robot.post("FIX", values)] = way[2]
        if not running:
            robot.post("ARM")
            robot.post("START", {"delay_us": 100_000})
        for frame in robot.take_all():
            running = running and frame.name != "ENDED"
            running = running or (frame.name == "START" and frame.values["status"] == 0)
            statuses |= {frame.values["status"]} if frame.name == "FIX" else set()
            for event in events_of_frame(frame, poses):
                decision = twin.apply(event)
                if decision is not None:
                    decided += 1
                    uses.add(decision.limb_use)
                    assert decision_of_event(frame.values).differences(decision) == []
    assert {0, *(link_layout().status[name] for name in ("DOUBLE", "OUTLIER"))} <= statuses
    assert len(uses) > 20


@pytest.mark.parametrize("command", ["STOP", "DISARM"])
def test_a_stroke_that_does_not_begin_is_no_use_of_its_limbs(command: str) -> None:
    robot = Robot(synthetic.affine_image(60, len(ACTION_ROWS), action_rows=ACTION_ROWS)).begin("ARMED")
    robot.path()
    reported = []
    for take_back in (False, True):
        assert robot.stroke("A") == "OK"
        if take_back:
            assert robot.status(command) == robot.status("ARM") == "OK"
        robot.run_until(robot.now_us + PERIOD_US)
        for k in range(3):
            assert robot.fix(0.3 + 0.001 * k) in ("OK", "OUTLIER")
            robot.now_us += 20_000
        assert robot.start(1000) == "OK"
        robot.run_until(robot.now_us + 2000)
        (decision, *_) = events(robot)
        reported.append([decision.values[name] for name in LIMB_USE_FIELDS])
        assert robot.status("DISARM") == "OK"
        robot.run_until(robot.now_us + 30 * PERIOD_US)
        assert robot.status("ARM") == "OK"
    assert max(reported[0]) > 0 and max(reported[1]) == 0


@pytest.mark.parametrize(("plan_us", "transitions"), [(1, 7), (0, 7 + 56), (500_000, 7 + 56)])
def test_a_plan_keeps_to_its_time_but_finishes_its_first_level(plan_us: int, transitions: int) -> None:
    """The table has seven actions: level one, and then both again."""
    robot = Robot().begin("ARMED")
    robot.path()
    for name, value in (("DEPTH", 2), ("PLAN_TIME_US", plan_us)):
        assert robot.status("PARAM", {"parameter": PARAMETER[name], "value": value}) == "OK"
    assert robot.fix(0.2, 0.1, 0.4) == robot.start() == "OK"
    robot.tick()
    (decision,) = events(robot)
    assert decision.values["transitions"] <= transitions
    assert decision.values["depth_reached"] == (1 if plan_us == 1 else 2)
