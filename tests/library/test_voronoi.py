"""The division into cells: exact where the system is linear, finer where it bends."""

from __future__ import annotations

import numpy as np
import pytest
from tests.conftest import count as cases

from frogkick.library.voronoi import VoronoiCells, VoronoiRegression

RNG = np.random.default_rng(7)
CODES = RNG.uniform(-2000.0, 2000.0, (cases(16_000, 16_000, 9000), 3))
WEIGHT = np.array([1.0, 2.0])


def from_nearest(cells: VoronoiCells, codes: np.ndarray) -> np.ndarray:
    """What the nearest state says, by brute force."""
    label = ((codes[:, None, :] - cells.codes[None]) ** 2).sum(axis=2).argmin(axis=1)
    offset = codes - cells.codes[label]
    return np.asarray(cells.base[label] + np.einsum("mx,mxc->mc", offset, cells.slope[label]))


def test_a_linear_system_is_exact_in_any_number_of_cells() -> None:
    values = np.array([3.0, -1.0]) + CODES @ RNG.uniform(-1e-3, 1e-3, (3, 2))
    regression = VoronoiRegression(CODES, values, WEIGHT, linear=True)
    for count in (1, 2, 17):
        assert from_nearest(regression.cells(count), CODES[:500]) == pytest.approx(values[:500], abs=1e-9)


def bent(codes: np.ndarray) -> np.ndarray:
    """A bend at forward velocities above 1000 codes, and a plain curve."""
    sharp = np.where(codes[:, 0] > 1000.0, ((codes[:, 0] - 1000.0) / 300.0) ** 2, 0.0)
    return np.stack([sharp, (codes**2).sum(axis=1) * 1e-7], axis=1)


@pytest.mark.parametrize(("linear", "least"), [(True, 2.5), (False, 1.4)])
def test_more_cells_err_less_and_their_errors_are_what_they_say(linear: bool, least: float) -> None:
    values = bent(CODES)
    regression = VoronoiRegression(CODES, values, WEIGHT, linear=linear)
    sums = []
    for count in (8, 64, 300):
        cells = regression.cells(count)
        assert len(cells.codes) == count
        assert np.array_equal(cells.codes, np.round(cells.codes))
        again = (((from_nearest(cells, CODES) - values) / WEIGHT) ** 2).sum(axis=1)
        assert cells.error == pytest.approx(again, rel=1e-6, abs=1e-9)
        offset = CODES - cells.codes[cells.label]
        assert cells.reach == pytest.approx(np.abs(offset).max(axis=0))
        sums.append(float(np.sqrt(cells.error.mean())))
        assert linear or not cells.slope.any()
    assert sums[0] > least * sums[1] > least**2 * sums[2]
    unseen = RNG.uniform(-1900.0, 1900.0, (1000, 3))
    missed = (((from_nearest(cells, unseen) - bent(unseen)) / WEIGHT) ** 2).sum(axis=1)
    assert np.sqrt(missed.mean()) < 2.0 * sums[2]


def test_states_are_where_the_system_bends() -> None:
    """Their share is half as large again as that of the velocities there."""
    cells = VoronoiRegression(CODES, bent(CODES), WEIGHT, linear=True).cells(60)
    share = (CODES[:, 0] > 900.0).mean()
    assert (cells.codes[:, 0] > 900.0).mean() > 1.5 * share > 0.3


def test_states_are_where_samples_are() -> None:
    """Nine tenths of the samples in an eighth of the box: the rest is not left without a state."""
    crowd = np.concatenate([CODES[:1600], np.abs(CODES[1600:])])
    cells = VoronoiRegression(crowd, bent(crowd), WEIGHT, linear=True).cells(60)
    inside = (cells.codes > 0.0).all(axis=1)
    assert 0.4 < inside.mean() < 1.0


def test_a_count_gives_the_same_cells_whatever_was_asked_before() -> None:
    values = bent(CODES)
    one, other = (VoronoiRegression(CODES, values, WEIGHT, linear=True) for _ in range(2))
    for count in (100, 9, 31):
        one.cells(count)
    assert np.array_equal(one.cells(40).codes, other.cells(40).codes)
    assert np.array_equal(one.cells(40).base, other.cells(40).base)


def test_no_more_cells_than_different_samples() -> None:
    few = np.repeat(CODES[:5], 20, axis=0)
    cells = VoronoiRegression(few, bent(few), WEIGHT, linear=True).cells(50)
    assert len(cells.codes) <= 5
    assert from_nearest(cells, few) == pytest.approx(bent(few), abs=1e-2)


@pytest.mark.parametrize(
    "spread", [[[0.0] * 3], [[3.0, 1.0, -2.0]], [[1e3, 0.0, 2.0], [0.0, 5.0, 0.1]], [[1e-170] * 3]]
)
@pytest.mark.parametrize("linear", [True, False])
def test_velocities_in_a_point_a_line_or_a_plane(spread: list[list[float]], linear: bool) -> None:
    codes = RNG.normal(size=(500, len(spread))) @ np.array(spread)
    values = np.stack([codes.sum(axis=1) * 1e-3, RNG.normal(size=500)], axis=1)
    regression = VoronoiRegression(codes, values, WEIGHT, linear=linear)
    with np.errstate(all="raise", under="ignore"):
        found = regression.cells(20)
    assert np.isfinite(found.base).all() and np.abs(found.slope).max(initial=0.0) < 10.0
    assert found.error.sum() <= (((values - values.mean(axis=0)) / WEIGHT) ** 2).sum() * (1.0 + 1e-9)
