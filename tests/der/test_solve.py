"""The direct solver against numpy, one system and eight at once."""

from __future__ import annotations

import numpy as np
import pytest
from tests.der.rig import dense, numbers

from frogkick.der import prepare
from frogkick.der.lanes import lane_floats, lane_zeros
from frogkick.der.solve import factor, factor_mixed, factorise_symbolically, solve, solve_mixed
from frogkick.robot import load_robot


@pytest.mark.parametrize("which", ["frog2022", "hexapod"])
@pytest.mark.parametrize("width", [1, 8])
def test_the_direct_solver_agrees_with_numpy(which: str, width: int) -> None:
    symbolic = prepare(load_robot(which)).symbolic
    n, rng = len(symbolic.order), np.random.default_rng(5)
    shape = (lambda *s: s) if width == 1 else (lambda *s: (*s, width))
    diagonal = rng.normal(size=shape(n, 3)) + np.array([40.0, 0.0, 40.0]).reshape(
        (1, 3) if width == 1 else (1, 3, 1)
    )
    pair, right = rng.normal(size=shape(len(symbolic.neighbour), 4)), rng.normal(size=shape(n, 2))
    d, p, r = (numbers(values, width) for values in (diagonal, pair, right))
    factor(symbolic, d, p, lane_zeros((symbolic.widest, 4), width))
    solve(symbolic, d, p, r)
    for lane in range(width):
        one = [values if width == 1 else values[..., lane] for values in (diagonal, pair, right)]
        expected = np.linalg.solve(dense(symbolic, one[0], one[1]), one[2].ravel())
        assert lane_floats(r)[..., lane].ravel() == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("width", [1, 8])
def test_rows_of_limbs_may_be_unsymmetric(width: int) -> None:
    """Of what they leave to the frame's rows the symmetric part counts; all else is solved exactly."""
    rods = prepare(load_robot("frog2022"))
    symbolic, frame = rods.symbolic, rods.mesh.frame_nodes
    n, rng = len(symbolic.order), np.random.default_rng(7)
    steps = n - frame
    inner = int(symbolic.start[steps])
    add, shape = (40.0, 0.0, 40.0, 0.0), (lambda *s: (*s, width))
    diagonal = rng.normal(size=shape(n, 4)) + np.array(add)[:, None]
    pair, lower = rng.normal(size=shape(len(symbolic.neighbour), 4)), rng.normal(size=shape(inner, 4))
    right = rng.normal(size=shape(n, 2))
    d, p, b, r = (
        numbers(values if width > 1 else values[..., 0], width) for values in (diagonal, pair, lower, right)
    )
    factor_mixed(symbolic, steps, d, p, b, lane_zeros((symbolic.widest, 4), width))
    solve_mixed(symbolic, steps, d, p, b, r)
    for lane in range(width):
        matrix = dense(symbolic, *(each[..., lane] for each in (diagonal, pair, lower)))
        cut = 2 * frame
        left = matrix[:cut, :cut] - matrix[:cut, cut:] @ np.linalg.solve(
            matrix[cut:, cut:], matrix[cut:, :cut]
        )
        matrix[:cut, :cut] -= 0.5 * (left - left.T)
        expected = np.linalg.solve(matrix, right[..., lane].ravel())
        assert lane_floats(r)[..., lane].ravel() == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_the_order_decides_the_fill_but_not_the_solution() -> None:
    edges = np.array([[i, (i + 1) % 7] for i in range(7)], dtype=np.int32)  # a ring
    bends = np.array([[i, (i + 1) % 7, (i + 2) % 7] for i in range(7)], dtype=np.int32)
    rng = np.random.default_rng(2)
    full = rng.normal(size=(14, 14))
    full = full + full.T + 30.0 * np.eye(14)
    for i in range(7):
        for j in range(7):
            if (i - j) % 7 in (3, 4):  # not coupled
                full[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = 0.0
    expected = np.linalg.solve(full, np.arange(14.0)).reshape(7, 2)
    for order in (list(range(7)), [3, 0, 6, 1, 5, 2, 4]):
        symbolic = factorise_symbolically(7, edges, bends, order)
        diagonal, pair = np.zeros((7, 3)), np.zeros((len(symbolic.neighbour), 4))
        for i in range(7):
            diagonal[i] = full[2 * i, 2 * i], full[2 * i, 2 * i + 1], full[2 * i + 1, 2 * i + 1]
        for k, node in enumerate(order):
            for p in range(symbolic.start[k], symbolic.start[k + 1]):
                other = symbolic.neighbour[p]
                pair[p] = full[2 * node : 2 * node + 2, 2 * other : 2 * other + 2].ravel()
        right = np.arange(14.0).reshape(7, 2)
        factor(symbolic, diagonal, pair, np.zeros((symbolic.widest, 4)))
        solve(symbolic, diagonal, pair, right)
        assert right == pytest.approx(expected, rel=1e-11)


def test_a_singular_pivot_shows_in_its_lane_only() -> None:
    symbolic = prepare(load_robot("frog2022")).symbolic
    n = len(symbolic.order)
    diagonal = np.tile(np.array([2.0, 0.0, 3.0])[:, None], (n, 1, 8))
    diagonal[17, :, 3] = 0.0
    right = np.ones((n, 2, 8))
    d, p, r = numbers(diagonal, 8), lane_zeros((len(symbolic.neighbour), 4), 8), numbers(right, 8)
    factor(symbolic, d, p, lane_zeros((symbolic.widest, 4), 8))
    solve(symbolic, d, p, r)
    finite = np.isfinite(lane_floats(r)).all(axis=(0, 1))
    assert finite.tolist() == [True, True, True, False, True, True, True, True]
