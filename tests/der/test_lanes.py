"""Numbers side by side: each lane computes what numpy does, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from tests.der.rig import numbers

from frogkick.der.lanes import (
    absolute,
    add,
    any_above,
    get,
    lane_dtype,
    lane_floats,
    lane_zeros,
    put,
    sqrt,
    where_above,
)

WIDTHS = (1, 2, 4, 8, 16)


@njit(error_model="numpy")
def _formula(a, out):
    total = 0.0 * get(a, 0, 0)
    for i in range(a.shape[0]):
        x, y = get(a, i, 0), get(a, i, 1)
        length = sqrt(x * x + y * y)
        z = -(x / length) + 2.0 * y - 1.0 / x
        total += z
        z *= 3.0
        z -= x
        put(out, i, 0, where_above(z, 0.5, z, absolute(z) - 7.0))
        add(out, i, 1, 1.5)
        add(out, i, 1, z)
    return any_above(total, 1e9)


def wide(values: np.ndarray) -> np.ndarray:
    return values[..., 0] if values.shape[-1] == 1 else values


@pytest.mark.parametrize("width", WIDTHS)
def test_every_lane_computes_what_numpy_does(width: int) -> None:
    values = np.random.default_rng(width).normal(size=(50, 2, width))
    out = lane_zeros((50, 2), width)
    assert not _formula(numbers(wide(values), width), out)
    x, y = values[:, 0], values[:, 1]
    z = (-(x / np.sqrt(x * x + y * y)) + 2.0 * y - 1.0 / x) * 3.0 - x
    assert np.array_equal(lane_floats(out)[:, 0], np.where(z > 0.5, z, np.abs(z) - 7.0))
    assert np.array_equal(lane_floats(out)[:, 1], 1.5 + z)


@pytest.mark.parametrize("width", WIDTHS)
def test_nan_counts_as_above_in_its_lane(width: int) -> None:
    values = np.ones((3, 2, width))
    values[1, 1, width - 1] = np.nan
    out = lane_zeros((3, 2), width)
    assert _formula(numbers(wide(values), width), out)
    chosen = np.isnan(lane_floats(out)[1, 0])
    assert chosen.tolist() == [False] * (width - 1) + [True]


@pytest.mark.parametrize("width", WIDTHS)
def test_arrays_start_on_a_cache_line(width: int) -> None:
    for shape in ((1, 1), (7, 3), (0, 2)):
        array = lane_zeros(shape, width)
        assert array.shape == shape
        assert array.dtype == lane_dtype(width)
        assert array.ctypes.data % 64 == 0 or array.size == 0
        assert not lane_floats(array).any()
        assert lane_floats(array).shape == (*shape, width)
