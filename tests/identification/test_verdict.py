"""What verdicts depend on: noise of the fixes, repeatability of strokes, log score of held-out runs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import START_S, WORN, make_run, make_swim, robot, term
from scipy.stats import t as student
from tests.conftest import count, from_ci

from frogkick.cli.identify import _identified
from frogkick.core.poses import PredictionError
from frogkick.identification import choice as choice_module
from frogkick.identification import outcome as outcome_module
from frogkick.identification.bootstrap import gain_by_chance, mean_interval, moved_by, standard_errors
from frogkick.identification.filter import Noise
from frogkick.identification.fit import Model, rollouts_of
from frogkick.identification.outcome import identify
from frogkick.identification.search import Found, nominal_fit
from frogkick.identification.segments import Segments, read_segments, segments_of
from frogkick.identification.steps import DOF, deviance_of, linearised_optimum
from frogkick.identification.terms import Interval
from frogkick.identification.verdict import (
    FOUND,
    NEAR_FLOOR,
    PARTLY,
    UNEXPLAINED,
    Scored,
    fix_noise,
    noise_floor,
    scored,
    verdict_of,
)
from frogkick.runs.runlog import Fixes, FixFlag
from frogkick_studies.synthetic_laws import LAWS_TEXT


def test_the_noise_of_fixes_is_told_by_fixes_alone(whole: list[Segments], worn: list[Segments]) -> None:
    """The camera's own 0.2 mm and 0.2 degrees, whatever limbs do; a few outliers do not count."""
    strays = []
    for swim in worn:
        pose = swim.pose.copy()
        pose[::17] += (8e-3, -5e-3, 0.1)
        strays.append(replace(swim, pose=pose))
    for swims in (whole, worn, strays):
        fix = fix_noise(swims)
        assert fix is not None
        assert fix[0] == pytest.approx(0.2e-3, rel=0.12) and fix[1] == pytest.approx(
            np.deg2rad(0.2), rel=0.15
        )
    noisy = fix_noise([replace(swim, pose=swim.pose + drawn(swim, 0.4e-3)) for swim in whole])
    assert noisy is not None and noisy[0] == pytest.approx(np.hypot(0.2e-3, 0.4e-3), rel=0.12)
    assert fix_noise([replace_fixes(whole[0], 10)]) is None


def drawn(swim: Segments, size_m: float) -> np.ndarray:
    return np.random.default_rng(9).normal(0.0, size_m, swim.pose.shape) * (1.0, 1.0, 0.0)


def replace_fixes(swim: Segments, count: int) -> Segments:
    return replace(swim, time_s=swim.time_s[:count], pose=swim.pose[:count])


def test_what_strokes_do_differently_is_no_noise_of_the_fixes(whole: list[Segments], tmp_path: Path) -> None:
    """A limb that misfires in 4 strokes of 10 does not raise the noise floor, but the repeatability."""
    (tmp_path / "mine.py").write_text(LAWS_TEXT)
    table = {"file": str(tmp_path / "mine.py"), "class": "Misfire", "limb": "front_left", "share": 0.4}
    judged = []
    for swims in (whole, [make_swim([table], seed, 14) for seed in (3, 4)]):
        data, fitted = nominal_fit(swims, robot())
        both = scored(Found(data, fitted, fitted), swims, fitted.rollouts, fitted.rollouts)
        judged.append(both)
    alike, apart = judged
    assert apart.noise_floor.position_rmse_m == pytest.approx(alike.noise_floor.position_rmse_m, rel=0.15)
    assert alike.repeatability.position_rmse_m < 0.5e-3
    assert apart.repeatability.position_rmse_m > 1e-3 and apart.repeatability.count > 15
    assert apart.after.position_rmse_m > 4.0 * apart.noise_floor.position_rmse_m and not apart.quiet


@given(
    *[st.tuples(st.floats(1e-4, 1e-2), st.floats(1e-3, 1e-1)) for _ in range(3)],
    st.floats(-3.0, 3.0),
    st.booleans(),
)
def test_effects_that_make_predictions_worse_are_never_found(
    before: tuple[float, float],
    after: tuple[float, float],
    floor: tuple[float, float],
    low: float,
    quiet: bool,
) -> None:
    tested = Scored(
        PredictionError(*before, 40),
        PredictionError(*after, 40),
        PredictionError(*floor),
        Interval("log score gain", low + 1.0, low, low + 2.0, "nats per period"),
    )
    trained = Scored(
        PredictionError(*before, 40),
        PredictionError(*floor, 40) if quiet else PredictionError(1.0, 1.0, 40),
        PredictionError(*floor),
    )
    model = SimpleNamespace(terms=(SimpleNamespace(name="one"),))
    found: Any = SimpleNamespace(fitted=SimpleNamespace(model=model))
    verdict = verdict_of(found, trained, tested)
    worse = any(
        now > then and now > NEAR_FLOOR * noise for then, now, noise in zip(before, after, floor, strict=True)
    )
    if low <= 0.0 or worse:
        assert verdict == UNEXPLAINED
    else:
        assert verdict == (FOUND if trained.quiet and tested.quiet else PARTLY)


def test_blocks_of_periods_tell_how_sure_a_mean_is() -> None:
    """Intervals of correlated values contain the true mean about as often as they should."""
    rng, inside, apart = np.random.default_rng(4), 0, 0
    for _ in range(300):
        value = np.convolve(rng.normal(0.0, 1.0, 41), np.ones(2) / 2.0, mode="valid")
        low, high = mean_interval([value[:20], value[20:]], rng)
        inside += low < 0.0 < high
        apart += abs(value.mean()) < 1.96 * value.std() / np.sqrt(len(value))  # as if independent
    assert 0.9 * 300 <= inside <= 0.98 * 300 and apart < 0.88 * 300
    runs = [rng.normal(each, 0.1, 5) for each in rng.normal(1.0, 2.0, 12)]
    low, high = mean_interval(runs, rng)
    assert high - low == pytest.approx(2.0 * 2.2 * 2.0 / np.sqrt(12.0), rel=0.5)


@from_ci
@pytest.mark.parametrize("periods", [12, 20, 40])
def test_intervals_of_parameters_hold_as_often_as_they_say(periods: int) -> None:
    """Two runs of heavy-tailed residuals, nine in a period, and two parameters."""
    rng, runs = np.random.default_rng(periods), np.repeat([0, 1], periods)
    draws = count(100, 150)
    far = np.full(2, 10.0)

    def inside(shared: bool) -> float:
        """Share of values in their intervals; ``shared``: neighbours have half of a residual in common."""
        fixed = 0
        for _ in range(draws):
            wild = np.sqrt(DOF / rng.chisquare(DOF, (2, periods + 1, 1)))
            alone = wild * rng.standard_normal((2, periods + 1, 9))
            residuals = (alone[:, 1:] + (alone[:, :-1] if shared else 0.0)).reshape(2 * periods, 9)
            jacobian = 0.5 * rng.standard_normal((1, 9, 2)) + 0.3 * rng.standard_normal((2 * periods, 9, 2))
            step, _ = linearised_optimum(residuals, jacobian, -far, far, np.full(2, 1e-9))
            deviation = standard_errors(residuals + jacobian @ step, jacobian, np.ones(2), runs)
            fixed += int((np.abs(step) < student.ppf(0.975, 2 * periods - 2) * deviation).sum())
        return fixed / (2 * draws)

    assert 0.9 <= inside(False) <= 0.98
    assert 0.8 <= inside(True) <= 0.98


def test_few_periods_do_not_make_a_mean_sure() -> None:
    """All blocks of a run of no more than a block had one mean, so that any gain was beyond chance."""
    rng = np.random.default_rng(5)
    assert mean_interval([np.array([4.6])], rng) == (-math.inf, math.inf)
    for lengths in ((2,), (3,), (4,), (4, 4, 4), (1, 1, 1), (1, 3)):
        inside = 0
        for _ in range(100):
            low, high = mean_interval([rng.normal(0.0, 1.0, length) for length in lengths], rng)
            inside += low < 0.0 < high
        assert inside >= 90, (lengths, inside)


@from_ci
def test_what_chance_gains_is_known_from_the_signs_of_blocks() -> None:
    """The best of 20 false candidates gains more than ``gain_by_chance`` in about 5 % of all cases.

    The share is larger if neighbours have half of a residual in common, which blocks of four separate.
    """
    rng, runs, price = np.random.default_rng(5), np.repeat([0, 1], 24), 4.0
    draws = count(60, 120)

    def best(residuals: np.ndarray, candidates: list[np.ndarray]) -> float:
        far = np.full(2, 10.0)
        plain = deviance_of(residuals)
        deviances = [
            linearised_optimum(residuals, each, -far, far, np.full(2, 1e-9))[1] for each in candidates
        ]
        return plain - min(deviances) - 2.0 * price

    for shared in (False, True):
        above = 0
        for _ in range(draws):
            wild = np.sqrt(DOF / rng.chisquare(DOF, (2, 25, 1)))
            alone = wild * rng.standard_normal((2, 25, 9))
            residuals = (alone[:, 1:] + (alone[:, :-1] if shared else 0.0)).reshape(48, 9)
            candidates = [rng.standard_normal((1, 9, 2)) * np.ones((48, 1, 1)) for _ in range(20)]
            bound = gain_by_chance(residuals, np.zeros((48, 9, 0)), candidates, runs, price)
            above += best(residuals, candidates) > max(bound, 0.0)
        assert above <= (0.25 if shared else 0.1) * draws


def test_a_candidate_that_changes_nothing_gains_nothing_by_chance() -> None:
    rng, runs = np.random.default_rng(1), np.repeat([0, 1], 12)
    residuals, nothing = rng.standard_normal((24, 9)), np.zeros((24, 9, 2))
    some = rng.standard_normal((24, 9, 1))
    alone = gain_by_chance(residuals, np.zeros((24, 9, 0)), [some], runs, 4.0)
    assert gain_by_chance(residuals, np.zeros((24, 9, 0)), [nothing, some], runs, 4.0) == alone
    assert gain_by_chance(residuals, np.zeros((24, 9, 0)), [nothing], runs, 4.0) == 0.0


@from_ci
def test_what_does_not_help_on_runs_kept_out_is_left_out(
    whole: list[Segments], worn: list[Segments], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A limb is worn in the training runs and new in the test run: the nominal model is returned."""
    monkeypatch.setattr(outcome_module, "catalogue", lambda *_args: [term("limb_wear rear_left")])
    monkeypatch.setattr(choice_module, "calibrated_starts", lambda _robot: {})
    outcome = identify(worn, whole[:1], robot())
    assert outcome.verdict == UNEXPLAINED and outcome.dropped == ("limb_wear rear_left",)
    assert not outcome.terms and outcome.tested.after == outcome.tested.before
    assert outcome.as_json()["dropped"] == ["limb_wear rear_left"]
    assert "the test runs have only 14 periods" in _identified(outcome)
    long = replace(outcome, tested=replace(outcome.tested, after=replace(outcome.tested.after, count=32)))
    assert long.few_tested == "", "a long test run needs no such advice"
    helped = identify(worn[:1] + worn[1:], [make_swim([WORN], 9, 10)], robot())
    reported = helped.as_json()
    assert helped.verdict == FOUND and not helped.dropped
    assert reported["test"]["log_score_gain"]["interval"][0] > 0.0
    left = reported["residuals"]
    assert left["wrench"] is None and left["strokes"] is None and len(left["fixes"]["x"]) > 100
    assert reported["test"]["repeatability"].keys() == {"position_rmse_m", "heading_rmse_rad"}


def test_a_short_test_run_is_judged_by_its_whole_gain() -> None:
    """Eight of nine periods gain three nats each and one loses four, so the mean's interval contains zero."""
    gain = Interval("log score gain", 2.28, -1.47, 5.64, "nats per period")
    before, after = PredictionError(1.3e-3, 4.7e-3, 9), PredictionError(0.55e-3, 3.5e-3, 9)
    short = Scored(before, after, PredictionError(0.33e-3, 4.1e-3), gain)
    assert short.helped
    assert not replace(short, gain=replace(gain, value=1.2)).helped, "chance gives as much"
    assert not replace(short, after=replace(after, position_rmse_m=1.4e-3)).helped, "an error has grown"
    many = replace(short, after=replace(after, count=40))
    assert not many.helped, "in many periods the interval tells"
    assert replace(many, gain=replace(gain, low=0.1)).helped


def rested(seed: int, frames: int) -> Segments:
    """A run whose frames before the first stroke have wrong times, except the last; the robot is at rest."""
    run, rng = make_run([], seed, 6), np.random.default_rng(seed)
    first = int(np.searchsorted(run.fixes.capture_time_s, START_S)) - 1
    pose = run.fixes.pose_world
    still = pose[0] + rng.normal(0.0, 1.0, (frames, 3)) * (2e-4, 2e-4, 3.5e-3)
    reported = np.concatenate([still, pose[first:]])
    arrival_s = np.concatenate([np.linspace(0.0, 0.05, frames), run.fixes.time_s[first:]])
    flags = np.zeros(len(reported), dtype=np.uint16)
    flags[:frames] = int(FixFlag.UNTRUSTED_TIME | FixFlag.AT_REST)
    fixes = Fixes(
        time_s=arrival_s,
        capture_time_s=np.concatenate([np.full(frames, np.nan), run.fixes.capture_time_s[first:]]),
        x_m=reported[:, 0],
        y_m=reported[:, 1],
        heading_rad=reported[:, 2],
        quality=np.ones(len(reported), dtype=np.uint8),
        flags=flags,
    )
    return segments_of(replace(run, fixes=fixes), "rested", robot())


def test_a_robot_seen_at_rest_is_known_to_rest() -> None:
    """Frames with wrong times before the first stroke still show that the robot did not move."""
    known = rested(3, 60)
    unknown = replace(known, rest_rate=None)
    assert known.rest_rate is not None and max(known.rest_rate[:2]) < 1e-3
    floor, blind = (noise_floor([swim], (2e-4, 3.5e-3)).position_rmse_m for swim in (known, unknown))
    assert floor < 0.5e-3 and blind > 5e-3
    model = Model(robot(), (), Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3)))
    ((sure,),) = rollouts_of([model], [known])
    assert np.hypot(*(known.measured[0] - sure.predicted[0])[:2]) < 1.5e-3
    assert rested(3, 20).rest_rate is None, "a second of it is needed twice"


def test_recorded_runs_that_begin_with_hardly_a_fix_have_the_floor_of_the_others(frog2022_dir: Path) -> None:
    for name in ("ellipse6", "line1"):
        swim = read_segments(frog2022_dir / "control" / f"{name}.csv", robot())
        fix = fix_noise([swim])
        assert fix is not None and noise_floor([swim], fix).position_rmse_m < 1.5e-3


@from_ci
def test_a_limb_that_misfires_at_random_is_not_found_elsewhere(frog2022_dir: Path) -> None:
    """Five logs of the simulated pool in which a front limb does nothing in 3 strokes of 10."""
    folder = frog2022_dir.parent / "misfire"
    if not folder.is_dir():
        pytest.skip("no logs of misfires beside the recorded runs")
    names = ("line", "eight", "sine", "ellipse")[:: count(2, 1)]
    train = [read_segments(folder / f"{name}.h5", robot()) for name in names]
    outcome = identify(train, [read_segments(folder / "bends.h5", robot())], robot())
    tested = outcome.tested
    assert outcome.verdict in (UNEXPLAINED, PARTLY)
    assert tested.after.position_rmse_m <= tested.before.position_rmse_m
    assert tested.after.heading_rmse_rad <= tested.before.heading_rmse_rad
    assert tested.noise_floor.position_rmse_m < 0.4e-3 and tested.repeatability.position_rmse_m > 1e-3


def test_what_moves_the_misses_moves_the_parameters() -> None:
    """A change of the residuals moves the parameter that explains it by as much, and no other one."""
    rng = np.random.default_rng(4)
    jacobian = rng.normal(size=(200, 9, 2))
    residuals = 1e-3 * rng.normal(size=(200, 9))
    scale = np.array([1.0, 10.0])
    for change in ((0.0, 3e-4), (2e-4, -1e-4)):
        moved = moved_by(jacobian @ np.array(change), residuals, jacobian, scale)
        assert moved == pytest.approx(-np.array(change), rel=0.1, abs=2e-6)
    aside = 1e-4 * rng.normal(size=(200, 9))
    assert np.abs(moved_by(aside, residuals, jacobian, scale)).max() < 1.5e-5


def test_a_number_without_a_unit_is_written_without_one() -> None:
    assert str(Interval("gain", 0.7, 0.69, 0.71, "1")) == "gain 0.7 [0.69, 0.71]"
    assert str(Interval("drag", 0.04, 0.039, 0.041, "N s/m")) == "drag 0.04 [0.039, 0.041] N s/m"
