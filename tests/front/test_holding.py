"""``run --hold``: the robot stays by its path's end, a later path ends that, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import from_ci
from tests.runs import rig

import frogkick as fk
from frogkick.core.errors import InputError
from frogkick.front.mission import hold_json, hold_radius_m, hold_report, require_room, turn_radius_m
from frogkick.paths import line
from frogkick.paths.hold import LAP_POINTS
from frogkick.planner.plan import PlanConfig
from frogkick.runs.decision import Decision
from frogkick.runs.live_log import SPEED_MAX_MPS, logged
from frogkick.runs.path_change import AGAIN_POINTS, ANEW_AFTER, SHIFT_GAIN, SHIFT_MAX_M, Holding
from frogkick.runs.record import RunOptions
from frogkick.runs.runlog_file import read_run

HOLD_S = 80.0
EVERYWHERE = PlanConfig().area_m


@pytest.fixture(scope="module")
def swum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("hold") / "hold.h5"
    run = fk.run(
        None,
        "line",
        model="frog2022",
        robot="pool",
        plan="both",
        hold=True,
        seed=1,
        time_limit_s=HOLD_S,
        out=file,
    )
    assert run.checked["mismatches"] == 0
    return file


@from_ci
def test_it_holds_until_the_time_is_over(swum: Path) -> None:
    run = fk.load_run(swum)
    found = run.as_json()
    hold = found["hold"]
    assert found["completed"] and run.ended == "time limit" and found["then"] == []
    assert hold["from_s"] < 50.0 and hold["worst_m"] < hold["limit_m"] == 0.1
    assert run.truth is not None and run.path is not None
    since = run.truth.time_s >= run.decisions.time_s[0] + hold["from_s"]
    end_m = run.path.points_m[-1]
    away_m = np.hypot(*(run.truth.pose_world[since, :2] - end_m).T)
    assert hold["worst_m"] == pytest.approx(away_m.max(), abs=1e-4)
    assert run.tracking.progress_mps > 0.0
    assert run.summary().progress_mps == pytest.approx(run.tracking.progress_mps, rel=0.02)


def test_its_log_is_decided_again_and_drawn(swum: Path) -> None:
    run, replayed = fk.load_run(swum), fk.replay(swum, plan="both", robot="pool")
    again = replayed.result
    assert replayed.mismatches == 0 and again.agreement == 1.0
    assert run.decisions.cost is not None
    assert [one.cost for one in again.onboard] == run.decisions.cost.tolist()
    axes = run.plot().axes[0]
    assert "within 100 mm of the end" in [text.get_text() for text in axes.get_legend().get_texts()]


@from_ci
def test_a_later_path_ends_the_hold_and_is_held_at_its_own_end() -> None:
    run = fk.run(
        None,
        "line",
        model="frog2022",
        robot="pool",
        plan="host",
        hold=True,
        then=("line", 50.0, "here"),
        time_limit_s=62.0,
    )
    kinds = [change.hold is None for change in run.then]
    assert kinds[0] is False and kinds.count(True) == 1
    assert [one["path"] for one in run.as_json()["then"]] == ["line"]
    assert hold_json(run) is not None


def test_laps_are_moved_against_what_carries_the_robot_away() -> None:
    """A robot that keeps 20 mm beside wherever its path leads: its circle comes to lie about the end."""
    path, drift_m = line(), np.array([0.02, -0.01])
    holding = Holding(path, 0.075, EVERYWHERE)
    sent = holding.due([Decision(0, 0, 0, path_index=len(path) - 1)])
    assert sent is not None
    off_m = []
    for _ in range(6):
        reported = holding.followed(sent)
        assert reported is not None
        end_m, begin = np.array(reported[:2]), reported[2]
        assert np.allclose(end_m, path.points_m[-1])
        places = sent.points_m[begin : begin + LAP_POINTS] + drift_m
        off_m.append(float(np.hypot(*(places.mean(axis=0) - end_m))))
        for index in range(begin, begin + LAP_POINTS + AGAIN_POINTS + 1):
            estimate = np.zeros(6, dtype=np.float32)
            estimate[:2] = sent.points_m[index] + drift_m
            along = np.float32(index)
            decision = Decision(0, 0, 0, path_index=index, along_points=along, estimate=estimate)
            holding.decided(decision)
            again = holding.due([decision])
            assert (again is not None) is (index == begin + LAP_POINTS + AGAIN_POINTS)
        assert again is not None
        sent = again
    assert off_m[0] == pytest.approx(np.hypot(*drift_m), abs=1e-6)
    assert off_m[1] == pytest.approx((1.0 - SHIFT_GAIN) * off_m[0], rel=0.02) and off_m[-1] < 1e-3
    # However far it is carried away, the centre stays near.
    holding.followed(sent)
    carried = replace(decision, path_index=LAP_POINTS + AGAIN_POINTS, estimate=estimate + np.float32(1.0))
    holding.decided(carried)
    far = holding.due([carried])
    assert far is not None
    centre_m = far.points_m[:LAP_POINTS].mean(axis=0)
    assert np.hypot(*(centre_m - path.points_m[-1])) == pytest.approx(SHIFT_MAX_M, abs=1e-6)


def test_a_robot_far_from_the_approach_gets_another_one_from_where_it_is() -> None:
    path = line()
    holding = Holding(path, 0.075, EVERYWHERE)
    sent = holding.due([Decision(0, 0, 0, path_index=len(path) - 1)])
    assert sent is not None
    for entry in range(2):
        assert holding.followed(sent) is not None
        state = np.zeros(6, dtype=np.float32)
        state[:5] = *(sent.points_m[5] + [0.0, -0.05]), 1.0, 0.03, 0.01
        decision = Decision(
            0, 0, 0, path_index=5, along_points=np.float32(5), estimate=state, predicted=state
        )
        for since in range(ANEW_AFTER):
            holding.decided(decision)
            anew = holding.due([decision])
            assert (anew is not None) is (since == ANEW_AFTER - 1 and entry == 0)
        assert holding.due([decision]) is None, "one at a time"
        assert not holding.began
        if anew is not None:
            assert np.allclose(anew.points_m[0], state[:2], atol=1e-6)
            sent = anew
    assert sent.tangent_rad[0] == pytest.approx(1.0 + np.arctan2(0.01, 0.03), abs=1e-6), "its course"


@from_ci
def test_in_a_current_it_holds_all_the_same() -> None:
    """After the sine the robot is beside its path; without another approach this run swung out to 124 mm."""
    world = fk.World([fk.effects.SteadyCurrent(x_mps=5e-3 * np.cos(np.pi / 6), y_mps=2.5e-3)])
    run = fk.run(
        None, "sine", model="frog2022", robot="pool", world=world, hold=True, seed=0, time_limit_s=120.0
    )
    hold = run.as_json()["hold"]
    assert hold["worst_m"] < hold["limit_m"], hold


def test_without_it_a_run_says_nothing_of_it() -> None:
    run = fk.run(None, "line", model="frog2022", robot="pool", plan="host", time_limit_s=3.0)
    assert run.as_json()["hold"] is None
    assert hold_report(None, False) == ""
    assert "give a longer --simulated-time" in hold_report(None, True)


def test_what_is_said_of_it() -> None:
    found = {"from_s": 1.0, "worst_m": 0.08, "mean_m": 0.07, "within_m": 0.07, "limit_m": 0.1}
    assert hold_report(found, True) == "the robot held within 80 mm of its path's end, 70 mm on average"
    assert "the water or worn limbs carried it away" in hold_report({**found, "worst_m": 0.12}, True)
    wide = {**found, "worst_m": 0.2, "within_m": 0.18}
    assert "100 mm: the tightest circle that it can follow has a radius of 180 mm" in hold_report(wide, True)


def test_a_robot_that_cannot_turn_is_refused() -> None:
    tables = rig.tables()
    radius_m = turn_radius_m(tables, "rig")
    assert hold_radius_m(tables, "rig") == max(0.07, 1.2 * radius_m)
    straight = tables.transitions.copy()
    straight[:, :, 2] = 0
    still = replace(tables, transitions=straight, derivatives=tables.derivatives[:0])
    with pytest.raises(InputError, match="no action turns the robot 'rig' to the left"):
        hold_radius_m(still, "rig")


def test_walls_too_near_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    walls = PlanConfig(
        wall_weight_per_m=1.0, wall_x_min_m=-0.1, wall_x_max_m=0.5, wall_y_min_m=-1.0, wall_y_max_m=1.0
    )
    with pytest.raises(InputError, match=r"leads up to 45 mm too near to a wall of --inside") as refused:
        require_room(line(), 0.07, walls)
    assert "\n" not in str(refused.value)
    require_room(line(), 0.07, replace(walls, wall_x_max_m=0.55))
    require_room(line(), 0.07, PlanConfig())
    done = frogkick(capsys, "run", "--robot", "pool", "--hold", "--inside", "-0.2,-0.3,0.55,0.3")
    assert done.code == 2 and "--hold: the robot circles the end of 'line'" in done.stderr


def test_a_log_in_progress_has_room_for_its_paths(tmp_path: Path, swum: Path) -> None:
    whole = read_run(swum)
    options = RunOptions(PlanConfig(), time_limit_s=HOLD_S, hold_m=0.075)
    assert whole.path is not None
    with logged(tmp_path / "a.h5", rig.recording(whole.path, options)):
        assert read_run(tmp_path / "a.h5.part").then == ()
        with h5py.File(tmp_path / "a.h5.part", "r", swmr=True) as file:
            room = sum(name.isdigit() for name in file["then"])
    lap_s = 2.0 * np.pi * 0.075 / SPEED_MAX_MPS
    assert room > HOLD_S / lap_s > len(whole.then) > 1, "laps are sent again after each"
