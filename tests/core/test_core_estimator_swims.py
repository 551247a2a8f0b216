"""Errors of the estimator on simulated swims: fixes with noise, late, duplicate, wrong, or missing."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from tests.core.core import ACTION_ROWS, PERIOD_US, RESTING, STATUS, image
from tests.core.estimator_rig import IMAGES, WILD, CEstimator, Twin, follow, on_time, rms, swim, table

from frogkick.estimator.estimator import STALE_US
from frogkick.estimator.track import COAST_US


def test_without_noise_it_finds_the_truth() -> None:
    """The remaining error is from the prior's weight and the 80 ms after the last fix."""
    for seed in range(5):
        given = swim(seed, rate_hz=30.0, noisy=False)
        position, heading, velocity = rms(follow(given, on_time(given)))
        assert position < 4e-4 and heading < 3e-3 and velocity < 1.5e-3


@pytest.mark.parametrize(("rate_hz", "limits"), [(3, (1.2e-3, 6e-3, 3.5e-3)), (15, (3e-4, 3e-3, 1e-3))])
def test_it_is_better_than_the_fixes(rate_hz: float, limits: tuple[float, ...]) -> None:
    """A fix has an error of 0.28 mm (two axes) and 0.2 degrees, and is 80 ms old or more."""
    found = np.array(
        [rms(follow(given, on_time(given))) for given in (swim(s, 30, rate_hz) for s in range(8))]
    )
    assert (np.sqrt((found**2).mean(axis=0)) < limits).all(), found.mean(axis=0)


def test_the_order_of_arrival_hardly_counts_and_doubles_not_at_all() -> None:
    rng = np.random.default_rng(2)
    for seed in range(10):
        given = swim(seed)
        usual = on_time(given, 60_000)
        plain = follow(given, usual)
        arrivals = np.array([row[0] for row in usual])
        decisions = np.searchsorted(given.starts_us, arrivals)
        # Among those that come before one decision, by up to three places.
        places = np.lexsort((arrivals + rng.uniform(0, 200_000, len(usual)), decisions))
        mixed = [(usual[place][0], *row[1:]) for place, row in zip(places, usual, strict=True)]
        assert np.abs(follow(given, mixed) - plain)[2:, :2].max() < 2e-4
        doubled = usual + [(row[0] + 30_000, row[1] + 30_000, *row[2:]) for row in usual[::3]]
        assert (follow(given, doubled) == plain).all()


def test_plainly_wrong_fixes_leave_no_trace() -> None:
    for seed in range(10):
        given, rng = swim(seed), np.random.default_rng(seed)
        usual = on_time(given)
        wrong = []
        for arrival_us, capture_us, pose, number in usual[8::9]:
            off = np.array([*rng.uniform(0.05, 0.5, 2), 0]) if number % 2 else np.array([0, 0, np.pi])
            wrong.append((arrival_us + 1, capture_us + 1, (pose + off).astype(np.float32), 1000 + number))
        assert (follow(given, usual + wrong) == follow(given, usual)).all()


def test_fixes_from_before_the_last_stroke_correct_what_followed() -> None:
    """Fixes of an earlier period improve the prediction over the strokes that are known since."""
    errors = []
    for seed in range(30):
        given = swim(seed, 8)
        estimator = CEstimator()
        blind_us = given.starts_us[5]
        numbered = list(enumerate(given.fixes))
        for start_us, action in zip(given.starts_us[:7], given.actions, strict=False):
            for number, (time_us, pose) in numbered:
                if start_us - PERIOD_US <= time_us < min(start_us, blind_us):
                    estimator.add(time_us, pose, number)
            estimator.act(start_us, action)
        before = estimator.newest()
        for number, (time_us, pose) in numbered:
            if blind_us <= time_us < blind_us + PERIOD_US:
                assert estimator.add(time_us, pose, number) == 0
        errors.append([np.hypot(*(found - given.truth[7, :2])) for found in (before, estimator.newest())])
    before_m, after_m = np.sqrt(np.square(errors).mean(axis=0))
    assert after_m < 0.75 * before_m


def test_moved_by_hand_it_starts_again_from_the_third_fix() -> None:
    given = swim(1)
    estimator = CEstimator()
    follow(given, on_time(given, 0), estimator)
    now_us = given.starts_us[-1] + 400_000
    here = np.array([0.0, 0.5, 1.0], dtype=np.float32) + given.fixes[-1][1]
    said = [estimator.add(now_us + k * 66_000, here + np.float32(1e-4 * k), 5000 + k) for k in range(4)]
    assert said == [STATUS["OUTLIER"], STATUS["OUTLIER"], 0, 0]
    state = estimator.state(now_us + 3 * 66_000)
    assert np.hypot(*(state[:2] - here[:2])) < 2e-3
    assert estimator.inside()[1][1:] == (4, 1)


def test_fixes_astray_that_do_not_agree_are_never_believed() -> None:
    estimator = CEstimator()
    for k in range(20):
        assert estimator.add(10**6 + k * 50_000, np.array([0.1, 0, 0], np.float32), k) == 0
    rng = np.random.default_rng(3)
    for k in range(200):
        wild = rng.uniform(-5, 5, 3).astype(np.float32)
        assert estimator.add(2 * 10**6 + k * 500, wild, 100 + k) == STATUS["OUTLIER"]
    assert estimator.inside()[1][2] == 0


def test_a_first_fix_that_was_wrong_is_forgotten() -> None:
    estimator = CEstimator()
    assert estimator.add(10**6, np.array([0.5, 0.5, 2.0], np.float32), 0) == 0
    said = [
        estimator.add(10**6 + k * 66_000, np.array([0.1, 0.001 * k, 0.0], np.float32), k) for k in range(1, 6)
    ]
    assert said == [STATUS["OUTLIER"], STATUS["OUTLIER"], 0, 0, 0]


def test_while_nothing_is_seen_it_goes_on_predicting() -> None:
    """The guard counts fixes; the estimator keeps its prediction, and gates the next fix by it."""
    given = swim(4, 12)
    gap = slice(90, 90 + 45)  # three seconds, two strokes
    seen = on_time(given)
    estimator, said = CEstimator(), []
    del seen[gap]
    waiting = list(seen)
    for index, start_us in enumerate(given.starts_us):
        while waiting and waiting[0][0] <= start_us:
            _, capture_us, pose, number = waiting.pop(0)
            if number == 135:
                wild = (pose + np.array([0.2, 0.1, 0.0])).astype(np.float32)
                assert estimator.add(capture_us - 1, wild, 4000) == STATUS["OUTLIER"]
            assert estimator.add(capture_us, pose, number) == 0
        said.append(estimator.at(start_us) is not None)
        estimator.act(start_us, given.actions[index])
    assert not all(said[5:]) and said[-1]
    assert estimator.inside()[1][2] == 0


def test_unseen_for_ten_seconds_it_believes_the_next_fix_and_remembers_the_actions() -> None:
    for silence_us, status in ((10_000_000, STATUS["OUTLIER"]), (10_000_001, 0)):
        estimator = CEstimator("affine")
        for k in range(10):
            assert estimator.add(10**6 + k * 66_000, np.array([0.1, 0, 0], np.float32), k) == 0
        last_us = 10**6 + 9 * 66_000
        for period in range(8):
            estimator.act(last_us + period * PERIOD_US, 1)
        there = np.array([50, 50, 2], np.float32)
        assert estimator.add(last_us + silence_us, there, 50) == status
        if status == 0:
            found = estimator.at(last_us + silence_us)
            assert found is not None and max(found[1][2:]) > 0


def test_after_a_long_silence_it_begins_anew() -> None:
    estimator = CEstimator()
    for k in range(10):
        assert estimator.add(10**6 + k * 66_000, np.array([0.1, 0, 0], np.float32), k) == 0
    there = np.array([3, 3, 3], np.float32)
    rest_us = 8 * PERIOD_US + COAST_US
    assert estimator.add(10**6 + 9 * 66_000 + PERIOD_US + rest_us + 1, there, 50) == 0
    assert estimator.inside()[1] == (2, 1, 0)


def test_old_and_out_of_range_fixes_change_nothing() -> None:
    given = swim(5, 10)
    estimator = CEstimator()
    follow(given, on_time(given), estimator)
    before = estimator.inside()
    for pose in WILD[:7]:
        fix = np.array([pose, 0, 0], np.float32)
        if not abs(pose) <= 1000:
            assert estimator.add(given.starts_us[-1], fix, 60_000) == STATUS["RANGE"]
    assert estimator.add(given.starts_us[-4], given.fixes[0][1], 60_001) == STATUS["OLD"]
    number = max(k for arrival_us, _, _, k in on_time(given) if arrival_us <= given.starts_us[-1])
    capture_us, pose = given.fixes[number]
    assert estimator.add(capture_us + 5, pose, number) == STATUS["DOUBLE"]
    assert estimator.inside() == before


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e20])
@pytest.mark.parametrize("speed", [0, 1])
def test_a_state_that_is_no_number_is_given_up(value: float, speed: int) -> None:
    """If a state is not finite, fixes are outliers until three of them reset it; nothing here makes one."""
    reported = []
    for made in (CEstimator(), Twin()):
        for k in range(3):
            assert made.add(10**6 + k * 66_000, np.array([0.1, 0, 0], np.float32), k) == 0
        made.spoil(speed, value)
        made.act(10**6 + PERIOD_US, 1)
        said = [
            made.add(10**6 + PERIOD_US + k * 66_000, np.array([0.1, 0, 0.001 * k], np.float32), 10 + k)
            for k in range(8)
        ]
        found = made.at(10**6 + PERIOD_US + 500_000)
        assert said[-1] == 0 and found is not None
        assert np.isfinite(np.frombuffer(found[0], np.float32)).all()
        reported.append((said, found))
    assert reported[0] == reported[1]


def test_the_limbs_use_is_counted_with_and_without_fixes() -> None:
    content, tables = table("affine")
    assert content and tables.use_gain > 0
    fires = [first | second for _, first, second in ACTION_ROWS]
    for seen in (False, True):
        estimator, use = CEstimator("affine"), np.zeros(8, dtype=np.int64)
        rng = np.random.default_rng(1)
        for k in range(30):
            at_us = 10**6 + k * PERIOD_US
            if seen or k > 25:
                assert estimator.add(at_us - 1000, np.array([0.1 * k, 0, 0], np.float32), k) in (
                    0,
                    STATUS["OUTLIER"],
                )
            found = estimator.at(at_us)
            if found is not None:
                assert list(found[1][2:]) == use.tolist()
            action = int(rng.integers(0, len(ACTION_ROWS)))
            estimator.act(at_us, (action + 1) % len(ACTION_ROWS))
            estimator.act(at_us, action)  # that one was refused
            fired = (fires[action] >> np.arange(8)) & 1
            use = np.where(
                np.arange(8) < 4,
                np.minimum(use * tables.use_decay // 32768 + fired * tables.use_gain, 32767),
                0,
            )
        assert use.any()


def test_one_fix_knows_no_velocity_and_a_pose_at_its_own_time() -> None:
    estimator = CEstimator()
    assert estimator.at(0) is None
    assert estimator.add(1000, np.array([1, 2, 7], np.float32), 65_535) == 0
    found = estimator.at(1000)
    assert found is not None and found[1][:2] == (65_535, 1)
    state = np.frombuffer(found[0], dtype=np.float32)
    assert state[:2].tolist() == [1.0, 2.0] and not state[3:].any()
    assert state[2] == pytest.approx(7 - 2 * np.pi, abs=1e-6)
    assert estimator.at(999) is None, "the track begins with the first fix"
    assert estimator.at(1000 + STALE_US) is not None and estimator.at(1001 + STALE_US) is None


def test_fixes_are_counted_to_255() -> None:
    estimator = CEstimator()
    for k in range(300):
        assert estimator.add(10**6 + k * 4000, np.array([0.1, 1e-4 * k, 0], np.float32), k) == 0
    found = estimator.at(10**6 + 300 * 4000)
    assert found is not None and found[1][:2] == (299, 255)


@pytest.mark.parametrize(
    ("kick", "low", "high"), [(0.0, 0.29e-3, 0.31e-3), (1.0, 0.8e-3, 6e-3), (8.0, 8e-3, 0.04)]
)
def test_how_large_kicks_are_is_learned(kick: float, low: float, high: float) -> None:
    """Speeds differ from the table by 0, 2 or 16 mm/s after each stroke; the first estimate is 10 mm/s."""
    found = []
    for seed in range(4):
        given, estimator = swim(seed, 45, noisy=False, kick=kick), CEstimator()
        follow(given, on_time(given), estimator)
        found.append(np.sqrt(np.frombuffer(estimator.inside()[0], np.float32)[-2]))
    assert low < np.median(found) < high, found


@pytest.mark.parametrize("period_us", [20_000, 2**32 - 1])
def test_tables_of_strange_periods(period_us: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A gap contains more periods than are predicted in a row; and one that is stretched leaves 32 bits."""
    name = str(period_us)
    strange = partial(image, period_us=period_us, pulse_us=9000, second_delay_us=9000)
    monkeypatch.setitem(IMAGES, name, strange)
    reported: list[list[object]] = []
    for made in (CEstimator(name), Twin(name)):
        said: list[object] = [
            made.add(10**6 + k * 30_000, np.array([0.1, 0, 0], np.float32), k) for k in range(9)
        ]
        last_us = 10**6 + 8 * 30_000
        said += [made.at(last_us + lead_us) for lead_us in (0, 440_000)]
        made.act(last_us + 1, 1)
        made.act(last_us + 1 + period_us + COAST_US, 2)
        said += [
            made.add(last_us + 5000 + k, np.array([0.1, 0, k * 1e-3], np.float32), 10 + k) for k in range(9)
        ]
        said += [made.at(last_us + 6000), made.inside()]
        reported.append(said)
    assert reported[0] == reported[1]
    assert (reported[0][10] is None) == (period_us == 20_000)


def test_across_pi_the_heading_turns_the_short_way_for_any_number_of_turns() -> None:
    estimator = CEstimator()
    omega, said = 0.9, []
    for k in range(4000):  # 38 turns
        heading = np.angle(np.exp(1j * omega * k * 0.066))
        time_us = 10**6 + k * 66_000
        said.append(estimator.add(time_us, np.array([0.1, 0, heading], np.float32), k))
        if k % 22 == 21:
            estimator.act(time_us, RESTING)
    assert set(said) == {0}
    state = estimator.state(time_us)
    assert abs(np.angle(np.exp(1j * (state[2] - heading)))) < 0.01
