"""The likelihood of misses, one for all of identification, and steps of a fit where they are linear.

Misses are taken as Student-t distributed with DOF degrees of freedom and the scale matrix under which they
are likeliest. The gate of a relative, its descent, the search, every refit and the score on runs that were
kept out all use this one density. Its scale is always the likeliest one, so a miss that grows in its own
direction never makes the whole likelier, however small the core of good predictions is.

Source: Lange, Little, Taylor 1989, Robust statistical modeling using the t distribution; the scale is
iterated by Liu, Rubin, Wu 1998, Parameter expansion to accelerate EM.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DOF = 4.0
"""Degrees of freedom of the density of misses: now and then strokes differ more than normal ones would."""

CLOSE = 0.2
"""A fall of the cost that ends a fit."""

WEIGHED = 20
"""Times that misses are weighed anew at most, for one step."""

_LEAST = (2e-5, 2e-5, 2e-4)
"""Scales (m, m, rad) below which misses are inexact simulation: no scale matrix becomes singular."""

_EXACT = 1e-7
"""A change of the cost that ends the iteration of the scale."""


def scale_of(missed: FloatArray) -> FloatArray:
    """(d, d) scale matrix of the Student-t density by which (n, d) misses are likeliest, never singular."""
    return _maximised(missed)[0]


def cost_of(missed: FloatArray) -> float:
    """Minus twice the log likelihood of (n, d) misses, Student-t distributed with their likeliest scale."""
    return _maximised(missed)[1]


def log_density(missed: FloatArray, scale: FloatArray) -> FloatArray:
    """(n,) log density of (n, d) misses under the Student-t density of a (d, d) scale matrix.

    Source: Lange, Little, Taylor 1989, equation 1.
    """
    width = missed.shape[1]
    root = np.linalg.cholesky(scale)
    distance = (np.linalg.solve(root, missed.T) ** 2).sum(axis=0)
    log_det = 2.0 * float(np.log(np.diag(root)).sum())
    return np.asarray(
        -0.5 * (log_det + (DOF + width) * np.log1p(distance / DOF) + _constant(width)), dtype=np.float64
    )


def _constant(width: int) -> float:
    """Minus twice the log of what makes the density's integral one, but for its scale."""
    return 2.0 * (math.lgamma(0.5 * DOF) - math.lgamma(0.5 * (DOF + width))) + width * math.log(DOF * math.pi)


def _maximised(missed: FloatArray) -> tuple[FloatArray, float]:
    """The likeliest scale matrix, and minus twice the log likelihood with it."""
    count, width = missed.shape
    least = np.square(np.resize(np.array(_LEAST), width))
    if not count:
        return np.diag(least), 0.0
    rows = np.ascontiguousarray(missed, dtype=np.float64)
    scale, cost = _iterated(rows, least, DOF, _EXACT)
    return scale, float(cost + count * _constant(width))


@njit(cache=True)
def _iterated(missed: FloatArray, least: FloatArray, dof: float, exact: float) -> tuple[FloatArray, float]:
    """The scale matrix of least cost, with a penalty of n tr(scale^-1 diag(least)), and that cost."""
    count, width = missed.shape
    scale = np.diag(least)
    for row in range(count):
        for i in range(width):
            for j in range(width):
                scale[i, j] += missed[row, i] * missed[row, j] / count
    before, best, best_scale = np.inf, np.inf, scale
    for _ in range(200):
        inverse = np.linalg.inv(np.linalg.cholesky(scale))
        cost, penalty = 0.0, 0.0
        for i in range(width):
            cost -= 2.0 * count * np.log(inverse[i, i])
            for j in range(i + 1):
                penalty += inverse[i, j] ** 2 * least[j]
        total, moment = 0.0, np.diag(count * least)
        for row in range(count):
            distance = 0.0
            for i in range(width):
                part = 0.0
                for j in range(i + 1):
                    part += inverse[i, j] * missed[row, j]
                distance += part * part
            cost += (dof + width) * np.log1p(distance / dof)
            weight = (dof + width) / (dof + distance)
            total += weight
            for i in range(width):
                for j in range(width):
                    moment[i, j] += weight * missed[row, i] * missed[row, j]
        cost += count * penalty
        if cost < best:
            best, best_scale = cost, scale
        if abs(before - cost) < exact:
            break
        before = cost
        scale = moment * ((1.0 + penalty / dof) / total)
    return best_scale, best


def promised(
    missed: FloatArray, jacobian: FloatArray, low: FloatArray, high: FloatArray, damping: FloatArray
) -> tuple[FloatArray, float]:
    """(p,) step within bounds that makes misses likeliest if they were linear, and the cost they would have.

    What is left decides how misses weigh, so the step is made over and over: what few periods show counts
    little until the step explains it.
    """
    found = np.zeros(jacobian.shape[2])
    after, best = missed, cost_of(missed)
    for _ in range(WEIGHED):
        # From where it stands: what was wild at first and is explained by now counts in full.
        flat, columns = whiten(whitener(after), after, jacobian)
        flat = np.concatenate([flat, np.sqrt(damping) * found])
        columns = np.concatenate([columns, np.diag(np.sqrt(damping))])
        move = bounded_step(columns, flat, np.zeros(len(found)), low - found, high - found)
        gain, step = 0.0, found + move
        while (cost := cost_of(missed + jacobian @ step)) < best:
            gain, best, found = gain + best - cost, cost, step
            # Each weighing goes the same way a little farther: twice as far saves some.
            move = 2.0 * move
            step = np.clip(found + move, low, high)
        if gain < CLOSE / 4.0:
            break
        after = missed + jacobian @ found
    return found, best


def cross_fitted(
    missed: FloatArray,
    jacobian: FloatArray,
    low: FloatArray,
    high: FloatArray,
    damping: FloatArray,
    folds: NDArray[np.int64],
) -> FloatArray:
    """(n,) log density of each period by parameters and a scale matrix that its own fold had no part in.

    Misses are taken as linear in the parameters; from where they were linearised all parameters are free to
    go back within their bounds, so what the fold itself taught them is given up. NaN where one fold is all.

    Args:
        missed, jacobian, low, high, damping: see ``promised``.
        folds: (n,) the part that each period is held out with.
    """
    scores = np.zeros(len(missed))
    for label in np.unique(folds):
        test = folds == label
        if test.all():
            return np.full(len(missed), np.nan)
        step, _ = promised(missed[~test], jacobian[~test], low, high, damping)
        scale = _shrunk(scale_of(missed[~test] + jacobian[~test] @ step), int((~test).sum()))
        scores[test] = log_density(missed[test] + jacobian[test] @ step, scale)
    return scores


def _shrunk(scale: FloatArray, count: int) -> FloatArray:
    """A scale matrix of few periods, its correlations less sure: as if the width's worth showed none."""
    width = len(scale)
    return np.asarray((count * scale + width * np.diag(np.diag(scale))) / (count + width))


def whitener(missed: FloatArray) -> FloatArray:
    """(d, d) that makes (n, d) misses uncorrelated and of scale one: rows times it."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(scale_of(missed))).T)


def whiten(white: FloatArray, missed: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(d n,) misses and (d n, p) derivatives, whitened; each period by the root of its Student-t weight.

    Half the gradient of ``cost_of`` by the parameters is the second transposed times the first: a step of
    least squares on them is one of expectation maximisation, and stays where the cost is least.
    """
    rows, width = missed @ white, missed.shape[1]
    weight = np.sqrt((DOF + width) / (DOF + (rows**2).sum(axis=1)))
    columns = np.einsum("nip,ij->njp", jacobian, white) * weight[:, None, None]
    return (rows * weight[:, None]).ravel(), columns.reshape(missed.size, jacobian.shape[2])


def bounded_step(
    jacobian: FloatArray, residual: FloatArray, damping: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """(p,) step that makes residual + jacobian step smallest within bounds, by fixing what hits them."""
    normal = jacobian.T @ jacobian + np.diag(damping)
    right = -jacobian.T @ residual
    step = np.zeros(len(right))
    free = np.ones(len(right), dtype=bool)
    for _ in range(len(right) + 1):
        if not free.any():
            break
        held = right[free] - normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.lstsq(normal[np.ix_(free, free)], held, rcond=1e-12)[0]
        out = free & ((step < low) | (step > high))
        step = np.clip(step, low, high)
        if not out.any():
            break
        free &= ~out
    return step
