"""The study of states from fixes: simple ways by hand, the robot's own better, command and picture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.conftest import from_ci
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.estimator.estimator import STALE_US
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick_studies import bad_fixes as study
from frogkick_studies.bad_fixes import (
    METHODS,
    Condition,
    FromLastFixes,
    Outcome,
    compare_estimators,
    conditions,
    last_difference,
    line_through,
)
from frogkick_studies.estimator import EstimatorStudy

Outcomes = dict[Condition, dict[str, Outcome]]


def pose(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float32)


def test_the_difference_of_two_fixes_by_hand() -> None:
    method = FromLastFixes(last_difference)
    assert method.newest_capture_us is None and method.at(0) is None
    assert method.add(1_000_000, pose(0.10, 0.2, 3.1), 1) == 0
    found = method.at(1_000_000)
    assert found is not None and not found.state[3:].any()
    assert method.add(1_100_000, pose(0.10, 0.21, -3.0831853), 2) == 0
    assert (
        method.add(1_100_000, pose(0.3, 0.21, 3.0), 3) < 0
        and method.add(1_200_000, pose(np.nan, 0, 0), 4) < 0
    )
    found = method.at(1_150_000)
    assert found is not None and (found.fix_sequence, method.newest_capture_us) == (2, 1_100_000)
    assert found.state[:3] == pytest.approx([0.10, 0.21, -3.0831853], abs=1e-6), "the fix itself"
    # 0.1 m/s along world y is to the right of a robot that looks along -x; 0.1 rad in 0.1 s, the short way.
    assert found.state[3:] == pytest.approx([-0.1 * np.sin(0.0584), -0.1 * np.cos(0.0584), 1.0], abs=1e-4)
    assert method.at(1_100_000 + STALE_US + 1) is None


def test_the_line_by_hand() -> None:
    method = FromLastFixes(line_through)
    for index, x in enumerate((5.0, 0.0, 0.001, 0.003)):  # the first is older than a quarter second
        assert method.add(1_000_000 + (0, 300_000, 400_000, 500_000)[index], pose(x, 0.0, 0.0), index) == 0
    found = method.at(1_600_000)
    assert found is not None
    slope, intercept = np.polyfit([0.3, 0.4, 0.5], [0.0, 0.001, 0.003], 1)
    assert found.state[0] == pytest.approx(intercept + slope * 0.6, abs=1e-6)
    assert found.state[3] == pytest.approx(slope, abs=1e-5)


def test_conditions_are_every_rate_twice_and_each_fault_once() -> None:
    found = conditions()
    assert len(found) == len(set(found)) == 2 * 6 + 7
    assert {c.rate_hz for c in found if c.fault == "all"} == {2, 5, 10, 15, 30, 60}
    assert Condition(15.0, "outliers") in found
    assert {c.rate_hz for c in conditions([5.0])} == {5.0}
    assert Condition(5.0, "world").world().effects and not Condition(5.0, "all").world().effects
    assert Condition(5.0, "lost").camera().lost == 0.2


@pytest.fixture(scope="module")
def outcomes() -> Outcomes:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "FAULTS", {name: study.FAULTS[name] for name in ("none", "outliers", "all")})
        paths = [shape("ellipse")]
        image = rig.small_table().read_bytes()
        return compare_estimators(rig.robot(), image, paths, PlanConfig(), 1, 14.0, [15.0])


@from_ci
def test_the_robots_own_way_is_the_best_under_every_condition(outcomes: Outcomes) -> None:
    assert [c.fault for c in outcomes] == ["none", "all", "outliers"]
    for condition, methods in outcomes.items():
        assert list(methods) == list(METHODS)
        track = methods["track"]
        assert track.decisions >= 6 and track.unknown == 0
        for other in (methods["difference"], methods["line"]):
            assert track.position_m < 0.75 * other.position_m, condition
            assert track.velocity_mps < 0.75 * other.velocity_mps, condition
            assert track.omega_rad_s < 0.75 * other.omega_rad_s, condition
        assert track.position_m < 6e-4 and track.heading_rad < np.deg2rad(0.5)
        assert 0.0 <= track.median_position_m <= 2 * track.position_m
        assert set(track.distance_m) == {"ellipse"} and 0.0 < track.distance_m["ellipse"] < 0.1
    wrong = outcomes[Condition(15.0, "outliers")]
    assert wrong["line"].position_m > 10 * wrong["track"].position_m


def test_errors_are_those_of_the_states_at_decision_time() -> None:
    """RMS over decisions from the third on, counted by hand from one run's rows."""
    setting = study._start(rig.robot(), rig.small_table().read_bytes(), (shape("line"),), PlanConfig(), 9.0)
    swim = study._run(setting, study._Task(Condition(15.0, "none"), "track", 0, 0))
    rows = np.array(swim.errors["track"])[2:]
    found = study._outcome([swim.errors["track"]], {"line": [swim]})
    assert found.position_m == pytest.approx(np.sqrt((rows[:, :2] ** 2).sum(axis=1).mean()))
    assert found.velocity_mps == pytest.approx(np.sqrt((rows[:, 3:5] ** 2).sum(axis=1).mean()))
    assert (found.decisions, found.distance_m) == (len(rows), {"line": swim.distance_m})
    gaps = [*swim.errors["track"][:3], np.full(6, np.nan)]
    assert study._outcome([gaps], {"line": [swim]}).unknown == 1


def test_a_run_begins_when_the_robot_knows_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a fix for five seconds it waits, and is measured from its first decision; else not at all."""
    setting = study._start(rig.robot(), rig.small_table().read_bytes(), (shape("line"),), PlanConfig(), 12.0)
    task = study._Task(Condition(15.0, "none"), "track", 0, 0)
    whole = study._run(setting, task)
    advance = study.Pool.advance
    monkeypatch.setattr(
        study.Pool, "advance",
        lambda pool, until_s: [fix for fix in advance(pool, until_s) if fix.capture_s > 5.0],
    )  # fmt: skip
    late = study._run(setting, task)
    assert 0 < len(late.errors["track"]) < len(whole.errors["track"])
    assert np.isfinite(late.distance_m)
    monkeypatch.setattr(study.Pool, "advance", lambda pool, until_s: advance(pool, until_s) and [])
    never = study._run(setting, task)
    assert not never.errors["track"]
    assert np.isnan(study._outcome([[]], {"line": [never]}).distance_m["line"])
    assert study._outcome([[]], {"line": [never, late]}).distance_m["line"] == late.distance_m


def test_the_picture_shows_every_method(outcomes: Outcomes) -> None:
    figure = EstimatorStudy(outcomes, 1).plot()
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert "Position at decision time" in titles and "Closed loop: ellipse" in titles
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(words) == len(METHODS) + 2 and "all faults together" in words
    assert figure.axes[4].get_ylim()[0] == 0.0, "a distance is drawn from nothing on"
    position = figure.axes[0]
    drawn = sorted(float(line.get_ydata()[0]) for line in position.lines)
    reported = [
        1e3 * methods[name].position_m
        for condition, methods in outcomes.items()
        for name in METHODS
        if condition.fault in ("none", "all")
    ]
    assert drawn == pytest.approx(sorted(reported))
    assert "(mm)" in position.get_ylabel() and position.get_xlabel() == "fixes per second"


@from_ci
def test_the_command_says_it_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "FAULTS", {name: study.FAULTS[name] for name in ("none", "lost", "all")})
    words = ["study", "estimator", "--tables", str(rig.small_table()), "--seeds", "1", "--rate", "10"]
    words += ["--simulated-time", "6", "--path", "line"]
    assert run_command([*words, "--out", str(tmp_path / "x.png"), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert [(row["fault"], row["method"]) for row in output["outcomes"][:4]] == [
        ("none", "difference"), ("none", "line"), ("none", "track"), ("all", "difference")
    ]  # fmt: skip
    assert all(row["rate_hz"] == 10.0 and set(row["distance_m"]) == {"line"} for row in output["outcomes"])
    with Image.open(tmp_path / "x.png") as picture:
        assert picture.width > 1000
    assert run_command(words) == 0
    assert "track" in capsys.readouterr().out
    assert run_command([*words, "--rate", "0.5"]) == 2
    assert "rate_hz" in capsys.readouterr().err
