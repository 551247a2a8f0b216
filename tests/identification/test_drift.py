"""Limbs that drift: the offset of a period depends on earlier periods only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made import robot
from numpy.typing import NDArray

from frogkick.identification.diagnostics import Drift, drift_of, filter_offsets
from frogkick.identification.predict import Rollout
from frogkick.identification.segments import Segments

PERIOD_S = 1.4
SIZE = np.array([2e-3, 2e-3, 0.04])


def made_run(
    seed: int, random_walk: float, periods: int = 40, heading_rad: float = 0.0
) -> tuple[Segments, Rollout, NDArray[np.float64]]:
    """A run of random strokes, predictions that are all zero, and the residuals of its periods by limbs."""
    rng = np.random.default_rng(seed)
    start_s = PERIOD_S * np.arange(periods)
    fires = rng.random((periods, 4)) < 0.5
    strokes = [(start_s[k] + 0.2 * limb, limb) for k, limb in zip(*np.nonzero(fires), strict=True)]
    offsets = np.cumsum(rng.normal(0.0, np.sqrt(random_walk), (periods, 4, 3)), axis=0)
    body = SIZE * (np.einsum("kl,kla->ka", fires, offsets) + rng.normal(0.0, 1.0, (periods, 3)))
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    world = np.column_stack([c * body[:, 0] - s * body[:, 1], s * body[:, 0] + c * body[:, 1], body[:, 2]])
    start = np.zeros((periods, 6))
    start[:, 2] = heading_rad
    swim = Segments(
        "made", "frog2022", ("A",), start_s, start_s, np.zeros((periods, 3)), tuple(sorted(strokes)), start_s,
        np.zeros(periods, dtype=np.int64), start_s + PERIOD_S, PERIOD_S, 0.0,
    )  # fmt: skip
    swim.__dict__["measured"] = world  # as from the fixes around each end
    nothing = np.zeros((periods, 3))
    residuals = np.column_stack([np.zeros((periods, 6)), body])
    rollout = Rollout(start_s, nothing, nothing, nothing, start, residuals, False)
    return swim, rollout, body


def rms(rollout: Rollout, swim: Segments) -> NDArray[np.float64]:
    gap = swim.measured - rollout.predicted
    return np.sqrt((gap**2).mean(axis=0) / SIZE**2)


def test_what_limbs_lately_did_is_followed() -> None:
    train = [made_run(seed, 0.1) for seed in range(5)]
    swims, rollouts = [run[0] for run in train], [run[1] for run in train]
    drift = drift_of(rollouts, swims, robot())
    assert drift is not None and min(drift.random_walk) > 0.0
    swim, rollout, _ = made_run(99, 0.1, 200, heading_rad=2.0)
    followed = drift.followed([rollout], [swim], robot())[0]
    assert (rms(followed, swim) < 0.75 * rms(rollout, swim)).all()


@pytest.mark.parametrize("seed", range(5))
def test_chance_is_no_drift(seed: int) -> None:
    train = [made_run(10 * seed + k, 0.0) for k in range(3)]
    assert drift_of([run[1] for run in train], [run[0] for run in train], robot()) is None


def test_an_offset_is_the_limb_s_own() -> None:
    """One limb does more; a period in which it does not fire has no offset."""
    fires = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0]] * 10)
    observed = 3.0 * fires[:, 0]
    expected = filter_offsets(observed, fires, 0.1, 99.0)
    assert expected[-1] == pytest.approx(3.0, abs=0.3)
    assert np.abs(expected[fires[:, 0] == 0.0]).max() < 1e-12


def test_nothing_is_known_before_it_was_seen() -> None:
    swim, rollout, body = made_run(3, 0.1)
    drift = Drift((2e-3, 2e-3, 0.04), (0.1, 0.1, 0.1), (4.0, 4.0, 4.0))
    before = drift.followed([rollout], [swim], robot())[0].predicted
    assert not before[0].any()
    for period in (5, 20):
        residuals = rollout.residuals.copy()
        residuals[period:] = 7.0
        other = drift.followed([replace(rollout, residuals=residuals)], [swim], robot())[0].predicted
        assert np.array_equal(other[: period + 1], before[: period + 1])
        assert not np.array_equal(other[period + 1 :], before[period + 1 :])
    assert np.isfinite(body).all()


def test_a_period_that_nobody_saw_teaches_nothing() -> None:
    fires = np.ones((6, 1))
    observed = np.array([1.0, np.nan, np.nan, np.nan, np.nan, np.nan])
    expected = filter_offsets(observed, fires, 0.1, 4.0)
    assert expected[0] == 0.0 and (expected[1:] == expected[1]).all() and 0.0 < expected[1] < 1.0


def test_one_wild_period_counts_only_so_much() -> None:
    fires, observed = np.ones((3, 1)), np.array([1e6, 0.0, 0.0])
    assert filter_offsets(observed, fires, 0.1, 2.0)[1] < 2.0


def test_strokes_count_where_they_fire() -> None:
    swim, _, _ = made_run(1, 0.0, 10)
    firing = np.isfinite(swim.fired_s(len(robot().limbs)))
    reported = {(round((time_s - 0.2 * limb) / PERIOD_S), int(limb)) for time_s, limb in swim.strokes}
    assert reported == {(int(k), int(limb)) for k, limb in zip(*np.nonzero(firing), strict=True)}
