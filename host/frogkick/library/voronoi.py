"""Piecewise regression on Voronoi cells: chooses a table's states and fits values in each cell.

The states of a table divide velocity space into Voronoi cells of the velocities nearest to them. From one
cell on, the cells with the largest sum of squared errors are split repeatedly, and each state moves to the
mean of its cell (Lloyd 1982). Cells become small where transitions are curved and where robots often are. At
the optimum all cells have the same error (Gersho 1979, IEEE Trans. Inf. Theory 25, 373-380).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64, Int64, matmul, solve_positive

_SPLIT_SHARE = 0.25  # of the cells at once, while there are few
_MOVES = 2  # to the means after each split
_SQUARINGS = 6  # the 64th power of a matrix
_RIDGE = 1e-3  # of a cell's variance: slopes across velocities on a line become those of the global trend


@dataclass(frozen=True, eq=False)
class VoronoiCells:
    """Voronoi cells with the regression in each.

    Attributes:
        codes: (n, 3) velocities of the states, in whole codes.
        base: (n, c) values at these.
        slope: (n, 3, c) derivatives by the velocity, per code; zeros where no slope is fitted.
        error: (m,) sum of squared errors of each sample, weighted.
        label: (m,) the cell of each sample.
        reach: (3,) largest distance of a sample from its state, in codes.
    """

    codes: Float64
    base: Float64
    slope: Float64
    error: Float64
    label: Int64
    reach: Float64


class VoronoiRegression:
    """Regression of some values over velocity, on a given number of Voronoi cells."""

    def __init__(self, codes: Float64, values: Float64, weight: Float64, linear: bool) -> None:
        """Take samples.

        Args:
            codes: (m, 3) velocities in codes, with the density of a robot's states.
            values: (m, c) at these.
            weight: (c,) scale of the errors of the values.
            linear: fit a linear correction in each cell; else the mean.
        """
        self._codes = codes
        self._weight = weight
        self._linear = linear
        middle = codes.mean(axis=0)
        self._trend = np.zeros((4, values.shape[1]))
        if linear:
            terms = np.concatenate([np.ones((len(codes), 1)), codes - middle], axis=1)
            normal = matmul(terms.T, terms)
            normal[np.arange(4), np.arange(4)] += 1e-12 * normal.trace()  # velocities may lie in a plane
            self._trend = solve_positive(normal, matmul(terms.T, values))
        else:
            self._trend[0] = values.mean(axis=0)
        self._middle = middle
        self._rest = values - self._trend_at(codes)
        self._grown = [middle[None]]

    def _trend_at(self, codes: Float64) -> Float64:
        return np.asarray(self._trend[0] + matmul(codes - self._middle, self._trend[1:]))

    def cells(self, count: int) -> VoronoiCells:
        """Divide into ``count`` cells, or as many as the samples allow."""
        states = max((grown for grown in self._grown if len(grown) <= count), key=len)
        while len(states) < count:
            more = min(count - len(states), max(1, int(_SPLIT_SHARE * len(states))))
            found = self._split(states, more)
            if len(found) == len(states):
                break
            whole_step = more == max(1, int(_SPLIT_SHARE * len(states)))
            states = found
            if whole_step and len(states) > len(self._grown[-1]):
                self._grown.append(states)
        return self._fitted(np.unique(np.round(states), axis=0))

    def _split(self, states: Float64, more: int) -> Float64:
        """Split the ``more`` cells with the largest error, then move all states towards their means."""
        from scipy.spatial import cKDTree

        fitted = self._fitted(states)
        total = np.bincount(fitted.label, fitted.error, minlength=len(states))
        divided, new = states.copy(), []
        for cell in np.argsort(-total, kind="stable")[:more].tolist():
            inside = self._codes[fitted.label == cell]
            centred = inside - inside.mean(axis=0) if len(inside) else inside
            spread = matmul(centred.T, centred)
            if not (spread.trace() > 0.0 and total[cell] > 0.0):
                continue
            for _ in range(_SQUARINGS):  # its powers approach the projection on the longest axis
                spread = spread / spread.trace()
                spread = matmul(spread, spread)
            longest = spread[:, spread.diagonal().argmax()]
            side = matmul(centred, longest[:, None])[:, 0] > 0.0
            if side.all() or not side.any():  # they differ by rounding alone
                continue
            divided[cell] = inside[side].mean(axis=0)
            new.append(inside[~side].mean(axis=0))
        divided = np.concatenate([divided, np.reshape(new, (-1, 3))])
        for _ in range(_MOVES):
            label = cKDTree(divided).query(self._codes)[1]
            count = np.bincount(label, minlength=len(divided))
            sums = [np.bincount(label, column, minlength=len(divided)) for column in self._codes.T]
            means = np.stack(sums, axis=1) / np.maximum(count, 1)[:, None]
            divided = np.where(count[:, None] > 0, means, divided)
        return divided

    def _fitted(self, states: Float64) -> VoronoiCells:
        """Least squares in each cell; empty cells have the global trend."""
        from scipy.spatial import cKDTree

        label = cKDTree(states).query(self._codes)[1]
        offset = self._codes - states[label]
        reach = np.abs(offset).max(axis=0)
        if not self._linear:
            offset = np.zeros((len(offset), 0))
        terms = np.concatenate([np.ones((len(offset), 1)), offset], axis=1)
        size = terms.shape[1]
        order = np.argsort(label, kind="stable")
        count = np.bincount(label, minlength=len(states))
        filled = np.flatnonzero(count)
        first = np.concatenate([[0], np.cumsum(count[filled])[:-1]])
        sorted_terms, sorted_rest = terms[order], self._rest[order]
        normal = np.add.reduceat(sorted_terms[:, :, None] * sorted_terms[:, None, :], first)
        right = np.stack(
            [np.add.reduceat(sorted_terms[:, i : i + 1] * sorted_rest, first) for i in range(size)], axis=1
        )
        slopes = np.arange(1, size)
        if self._linear:
            least = (offset**2).mean() + 1e-9  # as of one more sample, for cells that have a single one
            normal[:, slopes, slopes] += _RIDGE * (normal[:, slopes, slopes].mean(axis=1) + least)[:, None]
        solved = np.zeros((len(states), 4, self._rest.shape[1]))
        solved[filled, :size] = solve_positive(normal, right)
        fitted = np.einsum("mi,mic->mc", sorted_terms, solved[label[order], :size])
        errors = np.empty(len(label))
        errors[order] = (((fitted - sorted_rest) / self._weight) ** 2).sum(axis=1)
        base = solved[:, 0] + self._trend_at(states)
        slope = solved[:, 1:] + self._trend[1:]
        return VoronoiCells(states, base, slope, errors, label, reach)
