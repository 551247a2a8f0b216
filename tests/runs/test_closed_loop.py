"""Closed loops in the pool: chip, core on this computer and host decide alike; ends, losses, limits."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.link.wire import Edge
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.pool.monitor import pulses_of
from frogkick.runs.closed_loop import require_time
from frogkick.runs.decision import Decision, DecisionTwin, RobotEvent
from frogkick.runs.record import Recording, RunOptions, SentFix, config_of_log
from frogkick.runs.replay import compare, replay_on_host

SHORT_S = 9.0


@functools.cache
def sine_run(place: str, onboard: bool = True) -> Recording:
    return rig.swim(place, "sine", SHORT_S, onboard=onboard)


def test_chip_and_core_on_this_computer_decide_alike() -> None:
    chip, core = sine_run("virtual"), sine_run("pool")
    assert len(chip.decisions) >= 6
    assert [d.action for d in chip.decisions] == [d.action for d in core.decisions]
    assert [d.path_index for d in chip.decisions] == [d.path_index for d in core.decisions]
    assert len({d.action for d in chip.decisions}) > 1, "one action only would compare little"
    assert min(d.plan_us for d in chip.decisions) > 0
    assert max(d.plan_us for d in core.decisions) == 0  # computing takes no simulated time there


def test_host_planner_steers_the_same_pool() -> None:
    recording = sine_run("pool", onboard=False)
    assert [d.action for d in recording.decisions[:3]] == [d.action for d in sine_run("pool").decisions[:3]]
    assert recording.ended == "time limit"
    log = recording.log()
    assert log.decisions.plan_s is None  # a host's own clock would make each log another one
    assert "plan_ms_p99" not in log.measured
    assert len(pulses_of(recording.edges, recording.end_s)) > 0


@pytest.mark.parametrize("place", ["virtual", "pool"])
def test_every_decision_on_board_is_the_twins(place: str) -> None:
    recording = sine_run(place)
    again = replay_on_host(
        recording.events, DecisionTwin(rig.tables(), shape("sine"), recording.options.config)
    )
    assert compare(recording.decisions, again) == []
    assert len(again) == len(recording.decisions) > 0


def test_another_twin_is_found_out() -> None:
    recording = sine_run("pool")
    heavier = PlanConfig(distance_weight_per_m=501.0)
    again = replay_on_host(recording.events, DecisionTwin(rig.tables(), shape("sine"), heavier))
    assert "cost" in {field for _, fields in compare(recording.decisions, again) for field in fields}
    # One fix off by the last bit of its position.
    events = list(recording.events)
    last = max(index for index, event in enumerate(events) if event.pose_world is None)
    row = max(index for index, event in enumerate(events[:last]) if event.pose_world is not None)
    pose = np.array(events[row].pose_world)
    pose[0] = np.nextafter(pose[0], np.float32(9.0))
    events[row] = RobotEvent(events[row].time_us, pose, events[row].sequence)
    twin = DecisionTwin(rig.tables(), shape("sine"), PlanConfig())
    assert compare(recording.decisions, replay_on_host(events, twin)) != []
    assert compare(recording.decisions, again[:-1])[-1][1] == ["missing"]


def test_the_same_seed_gives_the_same_run_another_one_another() -> None:
    first = sine_run("pool")
    again = rig.swim("pool", "sine", 3.0)
    assert all(a.differences(b) == [] for a, b in zip(again.decisions, first.decisions, strict=False))
    other = rig.swim("pool", "sine", 3.0, pool=rig.new_pool("sine", seed=1))
    assert other.decisions[0].differences(first.decisions[0])


@pytest.mark.parametrize("onboard", [True, False])
def test_the_end_of_the_path_ends_the_run(onboard: bool) -> None:
    pool = rig.new_pool("line", start_at=85)
    seen: list[int] = []
    recording = rig.swim(
        "pool", "line", 30.0, onboard=onboard, pool=pool, progress=lambda _t, index: seen.append(index)
    )
    assert recording.completed
    assert recording.ended == "completed"
    assert recording.decisions[-1].path_index == 99
    assert all(d.path_index < 99 for d in recording.decisions[:-1])
    assert seen == [d.path_index for d in recording.decisions]
    assert recording.end_s < 25.0


def test_the_time_limit_ends_the_run_with_the_limbs_off() -> None:
    recording = sine_run("virtual")
    assert not recording.completed
    assert recording.ended == "time limit"
    assert recording.end_s == pytest.approx(recording.first_decision_s + SHORT_S, abs=0.06)
    assert all(edge.time_s <= recording.end_s + 0.01 for edge in recording.edges)
    tracked = recording.tracking()
    assert tracked.limit_violations == 0
    assert tracked.fixes_lost == 0
    assert tracked.decisions == len(recording.decisions)
    log = recording.log()
    assert config_of_log(log) == recording.options.config
    assert log.notes == "time limit"


@pytest.mark.parametrize("onboard", [True, False])
def test_lost_fixes_end_the_run(onboard: bool) -> None:
    pool = rig.new_pool("sine")
    pool.last_fix_s = 3.0
    recording = rig.swim("pool", "sine", 30.0, onboard=onboard, pool=pool)
    assert recording.ended == "position fixes lost"
    assert not recording.completed
    assert 3.0 < recording.end_s < 10.0
    last_s = max(edge.time_s for edge in recording.edges)
    assert last_s <= recording.end_s
    assert recording.fixes[-1].capture_s <= 3.0


def test_a_lost_robot_is_disarmed() -> None:
    from frogkick.link.layout import link_layout
    from frogkick.runs.session import Session

    session = Session(rig.port("pool"))
    session.handshake(rig.tables())
    session.send_path(shape("line"))
    session.request("ARM")
    for number in range(5):
        session.post_fix(Fix(session.time_s, 0.0, 0.0, 0.0, 0.0, sequence=number), session.time_s)
        session.step(session.time_s + 0.07)
    session.request("START", {"delay_us": 0})
    assert int(session.request("STATUS")["state"]) == link_layout().state["RUNNING"]
    session.step(session.time_s + 8.0)
    ended = session.take("ENDED")
    assert [link_layout().status_name(int(a.frame.values["status"])) for a in ended] == ["STALE"]
    assert int(session.request("STATUS")["state"]) == link_layout().state["DISARMED"]


def test_broken_limits_are_counted_from_the_pins() -> None:
    recording = sine_run("pool")
    guard = rig.robot().guard
    quiet_s = recording.end_s + 10.0

    def broken(extra: list[Edge]) -> int:
        altered = Recording(**{**recording.__dict__, "edges": [*recording.edges, *extra]})
        altered.end_s = quiet_s + 20.0
        return altered.tracking().limit_violations

    def pulse(limb: int, start_s: float, length_s: float) -> list[Edge]:
        return [Edge(start_s, limb, True), Edge(start_s + length_s, limb, False)]

    assert broken([]) == 0
    assert broken(pulse(0, quiet_s, 0.08)) == 0
    assert broken(pulse(0, quiet_s, guard.pulse_max_s + 0.001)) == 1
    soon_s = quiet_s + 0.08 + guard.rest_min_s - 0.01
    assert broken(pulse(1, quiet_s, 0.08) + pulse(1, soon_s, 0.08)) == 1
    assert broken([edge for limb in range(3) for edge in pulse(limb, quiet_s, 0.08)]) >= 1
    often = [edge for n in range(8) for edge in pulse(2, quiet_s + 0.6 * n, 0.08)]
    assert broken(often) >= 1


@pytest.mark.parametrize("limit_s", [0.0, -1.0, float("nan"), float("inf")])
def test_a_time_limit_that_ends_nothing_is_refused(limit_s: float) -> None:
    with pytest.raises(InputError, match="simulated time"):
        require_time(limit_s)
    with pytest.raises(InputError, match="simulated time"):
        rig.swim("pool", "line", limit_s)


def test_the_robots_own_planner_is_what_its_toml_says() -> None:
    planner = rig.robot().planner
    config = config_of(rig.robot().planner)
    assert config.depth == planner.depth
    assert config.distance_weight_per_m == planner.distance_weight_per_m
    assert config.level_weight == planner.level_weight


def test_a_decision_names_its_fix_also_after_their_numbers_began_anew() -> None:
    """Numbers have 16 bits, which last 73 minutes at 15 Hz. Of a fix that came twice it is the first row.

    Pictures without a fix have a number too, and the robot's clock may drift by 3 s in that time.
    """
    recording = rig.recording(shape("line"), RunOptions(PlanConfig(depth=1)))
    numbers = [*range(100), 99, *range(100, 1000), *range(1000, 140_000, 2)]
    recording.fixes += [
        SentFix(n / 15, 0.08, 0.0, 0.0, 0.0, sent_s=n / 15 + 0.08, sequence=n & 0xFFFF) for n in numbers
    ]
    rows = [3, 99, 30_000, 40_000, 66_500, 70_400]
    for drift in (0.0, -8e-4, 8e-4):
        recording.decisions = [
            Decision(0, 0, round(1e6 * (1.0 + drift) * fix.sent_s) + 2000, fix.sequence, fixes=3)
            for fix in (recording.fixes[row] for row in rows)
        ]
        assert recording.decision_columns().fix_sequence.tolist() == rows, drift
    assert recording.decision_columns(3).fix_sequence.tolist() == rows[3:], "of a log in progress"
