"""Predictions several periods ahead from the start of a period, with the run's strokes and no later fix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made import make_run, make_swim, robot

from frogkick.identification.filter import Noise
from frogkick.identification.fit import Model, rollouts_of
from frogkick.identification.horizons import horizons_of, roll_out_ahead
from frogkick.identification.segments import Segments
from frogkick.identification.terms import catalogue

WORN = {"name": "limb_wear", "limb": "rear_left", "gain": 0.7}
SLOW = {"name": "fix_latency", "delay_s": 0.1}
NOISE = Noise((2e-4, 3.5e-3), (1e-4, 1e-3), (1e-4, 1e-3))
PERIODS = 8


def model(**values: tuple[float, ...]) -> Model:
    """The robot with effects of the catalogue at these values."""
    terms = {each.title.replace(" ", "_"): each for each in catalogue(robot())}
    return Model(robot(), tuple(terms[title].at(value) for title, value in values.items()), NOISE)


@pytest.fixture(scope="module")
def swim() -> Segments:
    return make_swim([WORN, SLOW], 21, PERIODS)


RIGHT = model(limb_wear_rear_left=(0.7, 0.0, 1.0), fix_latency=(0.1,))
PLAIN = model()


def test_one_period_ahead_is_the_prediction_of_that_period(swim: Segments) -> None:
    other = make_swim([WORN, SLOW], 22, 5)
    swims = [swim, other]
    found = roll_out_ahead([RIGHT.lane(each) for each in swims], (1, 3))
    for (one, three), rollout, each in zip(found, rollouts_of([RIGHT], swims)[0], swims, strict=True):
        assert np.array_equal(one, rollout.predicted)
        assert np.isfinite(three).all(axis=1).tolist() == [
            k < len(each.start_s) - 2 for k in range(len(three))
        ]


def test_a_right_model_meets_the_truth_far_ahead(swim: Segments) -> None:
    truth = make_run([WORN, SLOW], 21, PERIODS).truth
    assert truth is not None
    ((five,),) = roll_out_ahead([replace(RIGHT, noise=NOISE).lane(swim)], (5,))
    for start in range(1, PERIODS - 4):
        at_s = swim.end_s[start + 4] - 0.1  # of a fix whose capture time does not include its delay
        true = [np.interp(at_s, truth.time_s, truth.pose_world[:, k]) for k in (0, 1)]
        assert np.hypot(*(five[start, :2] - true)) < 4e-3
    by_periods = {each.periods: each for each in horizons_of(PLAIN, RIGHT, [swim], (1, 2, 5))}
    assert [each.before.count for each in by_periods.values()] == [PERIODS, PERIODS - 1, PERIODS - 4]
    assert by_periods[5].after.position_rmse_m < 0.2 * by_periods[5].before.position_rmse_m
    assert by_periods[5].before.position_rmse_m > 2.0 * by_periods[1].before.position_rmse_m


def test_no_fix_after_the_start_is_looked_at(swim: Segments) -> None:
    pose = swim.pose.copy()
    pose[swim.arrival_s > swim.start_s[3]] += 0.5
    (true,), (false,) = (
        roll_out_ahead([RIGHT.lane(each)], (3,))[0] for each in (swim, replace(swim, pose=pose))
    )
    assert np.array_equal(true[:4], false[:4])
    assert not np.allclose(true[5], false[5], atol=0.1)


def test_nothing_is_predicted_across_a_pause_or_from_starts_left_out(swim: Segments) -> None:
    late = np.where(np.arange(PERIODS) >= 4, 0.3 * swim.period_s, 0.0)
    paused = replace(swim, start_s=swim.start_s + late, end_s=swim.end_s + late)
    ((two,),) = roll_out_ahead([PLAIN.lane(paused)], (2,))
    assert np.isfinite(two).all(axis=1).tolist() == [True, True, True, False, True, True, True, False]
    ((one,),) = roll_out_ahead([PLAIN.lane(swim)], (1,), every=3)
    assert np.flatnonzero(np.isfinite(one).all(axis=1)).tolist() == [0, 3, 6]


def test_a_short_run_has_near_horizons_alone(swim: Segments) -> None:
    short = replace(swim, start_s=swim.start_s[:2], end_s=swim.end_s[:2], action=swim.action[:2])
    assert [each.periods for each in horizons_of(PLAIN, RIGHT, [short])] == [1, 2]
    (first, _) = horizons_of(PLAIN, RIGHT, [short])
    assert first.as_json()["count"] == 2
    assert first.as_json()["before"]["position_rmse_m"] == first.before.position_rmse_m
