"""From runs to effects: states from fixes, predictions a period ahead, choice, verdict, files."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made import WORN, make_run, make_swim, robot, term
from tests.conftest import from_ci

from frogkick.cli.identify import _identified, spread
from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError
from frogkick.effects.acting import LEG_S
from frogkick.front.identifying import logs_of, require_held_out
from frogkick.front.logs import load_run
from frogkick.identification import outcome as outcome_module
from frogkick.identification.filter import Filter, Noise, Series, deviances, maximum_likelihood_noise
from frogkick.identification.fit import Model, fit_many, rollouts_of
from frogkick.identification.horizons import horizons_of
from frogkick.identification.outcome import identify, too_little
from frogkick.identification.search import nominal_fit, search
from frogkick.identification.segments import Data, Segments, replicate_count, segments_of
from frogkick.identification.steps import bounded_step
from frogkick.identification.terms import catalogue
from frogkick.identification.verdict import (
    FOUND,
    NOTHING,
    TOO_LITTLE,
    discretisation_shift,
    fix_noise,
    intervals,
    noise_floor,
    prediction_errors,
    scored,
    verdict_of,
)
from frogkick.robot import load_robot
from frogkick.runs.runlog import FixFlag, RunLog
from frogkick.runs.runlog_file import write_run


def test_filter_is_bayes_rule() -> None:
    """Against the joint normal distribution of all fixes, written out."""
    rng = np.random.default_rng(0)
    time_s = np.cumsum(rng.uniform(0.02, 0.2, 12))
    value = rng.normal(0.0, 1e-3, 12)
    noise = Noise((3e-4, 5e-3), (2e-3, 0.1), (1e-12, 1e-12))
    actuation = np.array([[-1e3, 1e6], [0.0, 0.0]])
    state = Filter(noise, actuation, float(time_s[0]))
    total = 0.0
    for at_s, here in zip(time_s, value, strict=True):
        innovation, variance = state.update(float(at_s), np.array([here, 0.0, 0.0]))
        total += innovation[0] ** 2 / variance[0] + np.log(variance[0])
    t = time_s - time_s[0]
    first = np.minimum.outer(t, t)
    drive = 4e-6 * (first**2 / 2.0 * np.maximum.outer(t, t) - first**3 / 6.0)
    covariance = 4.0 * 9e-8 + 0.02**2 * np.outer(t, t) + drive + 9e-8 * np.eye(12)
    joint = value @ np.linalg.solve(covariance, value) + np.linalg.slogdet(covariance)[1]
    assert total == pytest.approx(joint, abs=1e-6)
    series = Series(time_s, np.zeros(12), value, 0.02)
    alone = deviances(series, np.array([3e-4]), np.array([2e-3]), np.array([1e-12]))
    assert alone[0] == pytest.approx(joint, abs=1e-6)


def test_likeliest_noise_is_the_one_that_made_the_series() -> None:
    rng = np.random.default_rng(1)
    time_s = np.arange(400) / 15.0

    def walk(fix: float, idle: float) -> Series:
        rate = np.cumsum(rng.normal(0.0, idle * np.sqrt(1.0 / 15.0), 400))
        value = np.cumsum(rate) / 15.0 + rng.normal(0.0, fix, 400)
        return Series(time_s, np.zeros(400), value, 0.02)

    noise = maximum_likelihood_noise([(walk(4e-4, 3e-3), walk(4e-4, 3e-3), walk(4e-3, 0.1))])
    assert noise.fix == pytest.approx((4e-4, 4e-3), rel=0.3)
    assert noise.idle == pytest.approx((3e-3, 0.1), rel=0.5)


def test_predictions_meet_the_truth(whole: list[Segments]) -> None:
    _, fitted = nominal_fit(whole, robot())
    before = PredictionError.of(prediction_errors(fitted.rollouts, whole))
    fix = fix_noise(whole)
    assert fix is not None
    floor = noise_floor(whole, fix)
    assert before.position_rmse_m < 0.5e-3 and before.heading_rmse_rad < np.deg2rad(0.4)
    assert 0.6 < before.position_rmse_m / floor.position_rmse_m < 1.35
    truth = make_run([], 3, 14).truth
    assert truth is not None
    swim, rollout = whole[0], fitted.rollouts[0]
    for period in range(2, 14):
        true = np.array([np.interp(swim.end_s[period], truth.time_s, truth.pose_world[:, k]) for k in (0, 1)])
        assert np.hypot(*(rollout.predicted[period, :2] - true)) < 1.2e-3


def test_predictions_look_at_no_later_fix(whole: list[Segments]) -> None:
    """Fixes after a period's start, however wrong, change nothing in its prediction."""
    swim = whole[0]
    model = Model(robot(), (), Noise())
    cut_s = float(swim.start_s[6])
    pose = swim.pose.copy()
    pose[swim.arrival_s > cut_s] += 0.5
    spoiled = replace(swim, pose=pose)
    (true,), (false,) = rollouts_of([model], [swim])[0], rollouts_of([model], [spoiled])[0]
    assert np.array_equal(true.predicted[:7], false.predicted[:7])
    assert not np.allclose(true.predicted[8], false.predicted[8])


def test_the_floor_knows_how_well_an_end_is_measured(whole: list[Segments]) -> None:
    """Over a thousand draws of noise the measured ends of a run scatter by the variance that is stated."""
    swim, rng = whole[0], np.random.default_rng(11)
    kept = np.isfinite(swim.end_noise)
    assert kept.sum() > 5
    assert np.array_equal(kept, np.isfinite(swim.measured).all(axis=1))
    ends = []
    for _ in range(1000):
        noisy = replace(swim, pose=swim.pose + rng.normal(0.0, 1.0, swim.pose.shape))
        ends.append(noisy.measured[kept] - swim.measured[kept])
    scatter = np.square(ends).mean(axis=(0, 2))
    assert scatter == pytest.approx(swim.end_noise[kept], rel=0.12)


@from_ci
def test_planted_wear_is_found_among_others(worn: list[Segments]) -> None:
    rivals = [term(name) for name in ("limb_wear rear_left", "limb_wear rear_right", "mass_scale", "warm_up")]
    found = search(*nominal_fit(worn, robot()), rivals)
    assert [each.title for each in found.fitted.model.terms] == ["limb_wear rear_left"]
    left = discretisation_shift(found.fitted, found.data)
    (fine,) = fit_many([replace(found.fitted.model, step_s=8e-4, leg_s=LEG_S)], found.data, 8)
    assert fine.model.values[0] - found.fitted.model.values[0] == pytest.approx(left[0], rel=0.4)
    assert 0.0 < np.abs(left).max() < 0.02
    (row,) = intervals(found.fitted, found.data, left)
    for each, true in zip(row, (0.7, 0.0, 1.0), strict=True):
        # One 95 % interval in twenty misses the true value, so each of these three is made twice as wide.
        assert abs(true - each.value) <= each.high - each.low
    assert row[0].low <= 0.7 <= row[0].high
    assert row[0].high - row[0].low < 0.1
    judged = scored(found, worn, found.nominal.rollouts, found.fitted.rollouts)
    assert judged.after.position_rmse_m < 0.3 * judged.before.position_rmse_m
    assert judged.gain is not None and judged.gain.low > 1.0
    assert verdict_of(found, judged, judged) == FOUND


def test_nothing_is_found_where_nothing_is_missing(whole: list[Segments]) -> None:
    found = search(
        *nominal_fit(whole, robot()), [term("limb_wear rear_left"), term("drag_scale"), term("tag_offset")]
    )
    judged = scored(found, whole, found.nominal.rollouts, found.fitted.rollouts)
    assert not found.fitted.model.terms and judged.gain is None
    assert verdict_of(found, judged, judged) == NOTHING


def test_effects_of_the_camera_act_on_what_is_shown() -> None:
    """A run with a latency and a scale has no more than noise left by a model with both."""
    planted = [{"name": "fix_latency", "delay_s": 0.1}, {"name": "camera_scale", "scale": 1.1}]
    swims = [make_swim(planted, 5, 10, "BCBDBEBFBC")]
    terms = (term("fix_latency").at((0.1,)), term("camera_scale").at((1.1,)))
    noise = Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3))
    with_both, without = rollouts_of([Model(robot(), terms, noise), Model(robot(), (), noise)], swims)
    assert PredictionError.of(prediction_errors(with_both, swims)).position_rmse_m < 0.6e-3
    assert PredictionError.of(prediction_errors(without, swims)).position_rmse_m > 2e-3


@pytest.mark.parametrize("drift", [0.012, -0.012])
def test_a_camera_clock_that_drifts_is_followed_to_the_end_of_a_run(drift: float) -> None:
    """Both a fast and a slow clock. By a slow one, fixes stated for a period's end show the next stroke."""
    swims = [make_swim([{"name": "clock_drift", "drift": drift}], 5, 20)]
    noise = Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3))
    models = [Model(robot(), terms, noise) for terms in ((term("clock_drift", drift),), ())]
    known, without = (
        PredictionError.of(prediction_errors(each, swims)) for each in rollouts_of(models, swims)
    )
    assert known.count >= 19
    assert known.position_rmse_m < 0.6e-3 and known.heading_rmse_rad < 6e-3
    assert without.position_rmse_m > 1e-3
    for each in horizons_of(models[1], models[0], swims):
        assert each.after.position_rmse_m < 0.5 * each.before.position_rmse_m


@from_ci
def test_a_camera_clock_that_drifts_is_found_among_late_and_weak_ones() -> None:
    swims = [make_swim([{"name": "clock_drift", "drift": -0.004}], seed, 16) for seed in (5, 6)]
    rivals = [
        term(name) for name in ("clock_drift", "fix_latency", "limb_wear all", "battery_sag", "warm_up")
    ]
    found = search(*nominal_fit(swims, robot()), rivals)
    assert [each.title for each in found.fitted.model.terms] == ["clock_drift"]
    ((drift,),) = intervals(found.fitted, found.data, discretisation_shift(found.fitted, found.data))
    assert drift.contains(-0.004) and drift.high - drift.low < 0.0015


@from_ci
def test_fit_needs_no_luck_with_its_start(worn: list[Segments]) -> None:
    noise = Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3))
    (rollouts,) = rollouts_of([Model(robot(), (), noise)], worn)
    data = Data(worn, np.isfinite(np.concatenate([rollout.residuals for rollout in rollouts])).all(axis=1))
    starts = [term("limb_wear rear_left").at(values) for values in ((1.0, 0.0, 1.0), (0.5, 0.05, 1.3))]
    models = [Model(robot(), (start,), noise) for start in starts]
    for fitted in fit_many(models, data, steps_max=8):
        assert fitted.model.values[0] == pytest.approx(0.7, abs=0.05)


def test_bounded_step_holds_its_bounds() -> None:
    jacobian, residual = np.diag([1.0, 2.0, 4.0]), np.array([-3.0, -2.0, -1.0])
    step = bounded_step(jacobian, residual, np.zeros(3), np.full(3, -9.0), np.array([1.0, 9.0, 9.0]))
    assert step == pytest.approx([1.0, 1.0, 0.25])


@from_ci
def test_a_search_ends_by_its_bound_and_says_so(
    worn: list[Segments], whole: list[Segments], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a count of simulations, so that a result does not depend on the machine."""
    monkeypatch.setattr(outcome_module, "EVALUATIONS_MOST", 40)
    ended = [identify(worn, worn[:1], robot()) for _ in range(2)]
    assert all(each.ended_early and each.evaluations > 40 for each in ended)
    assert ended[0].evaluations == ended[1].evaluations
    assert ended[0].effects_as_json() == ended[1].effects_as_json()
    assert ended[0].as_json()["search"] == {"evaluations": ended[0].evaluations, "ended_early": True}
    assert "bound" in _identified(ended[0])
    monkeypatch.setattr(outcome_module, "EVALUATIONS_MOST", 400)
    plain = identify(whole, whole[:1], robot())
    assert not plain.ended_early and 0 < plain.evaluations < 400


def test_too_little_is_said(whole: list[Segments]) -> None:
    assert too_little(whole) == ""
    assert "8 periods more" in too_little([replace_periods(whole[0], 12)])
    still = [replace(swim, pose=np.tile(swim.pose[:1], (len(swim.pose), 1))) for swim in whole]
    assert "moved 0.0 mm" in too_little(still)
    same = [replace(swim, action=np.zeros_like(swim.action)) for swim in whole]
    assert "only one action" in too_little(same)


def test_runs_of_one_seed_are_known_by_their_noise(whole: list[Segments]) -> None:
    assert replicate_count(whole) == 1
    moved = replace(whole[0], pose=whole[0].pose + np.array([0.3, -0.2, 0.0]))
    assert replicate_count([*whole, moved]) == 2


def test_bad_logs_are_one_clear_line_each(whole: list[Segments]) -> None:
    run = make_run([], 6, 3)

    def with_fixes(**columns: np.ndarray) -> RunLog:
        return replace(run, fixes=replace(run.fixes, **columns))

    heading_deg = np.degrees(run.fixes.heading_rad) + 100.0
    x_mm, y_mm = 1e3 * run.fixes.x_m, 1e3 * run.fixes.y_m
    with pytest.raises(InputError, match="headings are radians"):
        segments_of(with_fixes(heading_rad=heading_deg), "x.h5", robot())
    with pytest.raises(InputError, match="positions are metres"):
        segments_of(with_fixes(x_m=x_mm, y_m=y_mm), "x.h5", robot())
    with pytest.raises(InputError, match="fixes/x_m row 4 is nan"):
        with_fixes(x_m=np.where(np.arange(len(x_mm)) == 4, np.nan, run.fixes.x_m))
    with pytest.raises(InputError, match="time_s row 7 goes back"):
        with_fixes(time_s=np.where(np.arange(len(x_mm)) == 7, 0.0, run.fixes.time_s))
    jumped = run.fixes.capture_time_s - np.where(np.arange(len(x_mm)) > 60, 5.0, 0.0)
    with pytest.raises(InputError, match=r"clock jumps by 5\.0 s"):
        segments_of(with_fixes(capture_time_s=jumped), "x.h5", robot())
    for off_s in (60.0, 1.7e9):  # nothing is compared, so there is no verdict
        times = {name: getattr(run.fixes, name) + off_s for name in ("time_s", "capture_time_s")}
        with pytest.raises(InputError, match=r"none of its 3 strokes has position fixes .* on one clock"):
            segments_of(with_fixes(**times), "x.h5", robot())
    with pytest.raises(InputError, match="no test run has a whole period"):
        identify(whole, [replace_periods(whole[0], 0)], robot())


def test_an_empty_run_among_others_is_left_out(whole: list[Segments]) -> None:
    outcome = identify([replace_periods(whole[0], 0), whole[1]], whole[:1], robot())
    assert outcome.verdict == TOO_LITTLE and "6 periods more" in outcome.reason
    assert len(outcome.train) == 1 and outcome.tested.before.position_rmse_m < 1e-3


def replace_periods(swim: Segments, count: int) -> Segments:
    return replace(swim, start_s=swim.start_s[:count], end_s=swim.end_s[:count], action=swim.action[:count])


@pytest.mark.parametrize("flag", [0, int(FixFlag.JUMP)])
def test_positions_in_another_unit_are_refused(flag: int) -> None:
    """Also if the import took all of them for jumps."""
    run = make_run([], 0, 4)
    known, flags = run.fixes, np.full(len(run.fixes.x_m), flag, dtype=np.uint16)
    centimetres = replace(known, x_m=100.0 * known.x_m, y_m=100.0 * known.y_m, flags=flags)
    segments_of(replace(run, fixes=replace(known, flags=flags)), "metres", robot())
    with pytest.raises(InputError, match=r"'cm' moves faster than 1 m/s .* convert them"):
        segments_of(replace(run, fixes=centimetres), "cm", robot())


def test_another_robots_run_is_refused() -> None:
    run = replace(make_run([], 6, 3), robot_id="other")
    with pytest.raises(InputError, match="'other'"):
        segments_of(run, "x.h5", robot())


def test_no_two_runs_have_one_name(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a/line.h5", "b/line.h5", "sine.h5")]
    for file in files:
        file.parent.mkdir(exist_ok=True)
        write_run(file, make_run([], 1, 1))
    made = [load_run(files[0])] * 2
    names = [name for _run, name in logs_of([*files, *made])]
    assert names == [str(files[0]), str(files[1]), "sine.h5", "made (1)", "made (2)"]


def test_a_run_is_given_once_also_if_it_was_written_anew() -> None:
    run, other = (segments_of(make_run([], seed, 4), f"{seed}.h5") for seed in (1, 2))
    rounded = replace(run, pose=np.add(run.pose.round(5), (0.0, 0.0, math.tau)))
    later = replace(run, time_s=run.time_s + 3.0)
    cut = run.with_fixes(run.time_s < np.median(run.time_s))
    for again in (run, rounded, later, cut):
        with pytest.raises(InputError, match=r"test run '1.h5' is training run '1.h5' once more"):
            require_held_out([other, run], [again])
        with pytest.raises(InputError, match=r"run '1.h5' is run '1.h5' once more: it would count twice"):
            require_held_out([run, again], [other])
    require_held_out([run], [other])
    require_held_out(
        [run, replace(run, problem="its clock jumps")], [other, replace(other, pose=run.pose[:0])]
    )


def test_several_runs_follow_one_option() -> None:
    given = ["--train", "a", "b", "--test", "c", "--out", "d", "--json"]
    assert spread(given) == ["--train", "a", "--train", "b", "--test", "c", "--out", "d", "--json"]


def test_users_effects_are_candidates(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        "from frogkick.effects import Effect, Parameter\n\n\n"
        "class Whirl(Effect):\n"
        '    parameters = (Parameter("turns_per_s", "1/s", 0.0, 0.2, 0.0),)\n\n'
        "    def flow(self, time_s, position_world_m):\n"
        "        x, y = position_world_m\n"
        "        return -y * self.turns_per_s, x * self.turns_per_s\n"
    )
    (whirl,) = [each for each in catalogue(robot(), own) if each.title == "Whirl"]
    assert whirl.at((0.05,)).effect().flow(0.0, np.array([1.0, 2.0])) == pytest.approx((-0.1, 0.05))


def test_command_writes_predictions_and_a_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = []
    for seed in (7, 8, 9):
        names.append(str(tmp_path / f"run{seed}.h5"))
        write_run(names[-1], make_run([WORN], seed, 6))
    out, table = tmp_path / "robot.toml", tmp_path / "p.csv"
    status = run_command(
        [
            "identify",
            "--train",
            *names[:2],
            "--test",
            names[2],
            "--out",
            str(out),
            "--predictions",
            str(table),
            "--json",
        ]
    )
    assert status == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "not enough data"  # 12 periods
    assert load_robot(out).sha256 == load_robot("frog2022").sha256
    with table.open() as file:
        assert next(csv.reader(file))[:3] == ["run", "time_s", "horizon_s"]
