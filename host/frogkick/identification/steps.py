"""The likelihood of residuals, one for all of identification, and Gauss-Newton steps on it.

Residuals are Student-t distributed with DOF degrees of freedom. The scale matrix is always the one of maximum
likelihood, so a fit cannot gain by making a large residual larger, however precise most predictions are.
"Deviance" is minus twice the log likelihood throughout.

Source: Lange, Little, Taylor 1989, Robust statistical modeling using the t distribution; the scale is
iterated by Liu, Rubin, Wu 1998, Parameter expansion to accelerate EM.
"""

from __future__ import annotations

import math

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.core.compiled import cached_njit

DOF = 4.0  # degrees of freedom of the density of residuals: strokes have heavier tails than a normal density
CONVERGED = 0.2  # a fit has converged where the deviance falls by less

REWEIGHTINGS_MAX = 20
"""Reweightings of the residuals (iteratively reweighted least squares) at most, for one step."""

_SCALE_MIN = (2e-5, 2e-5, 2e-4)
"""Scales (m, m, rad) below which residuals are discretisation error: no scale matrix becomes singular."""

_EM_TOLERANCE = 1e-7  # a change of the deviance that ends the iteration of the scale


def scale_of(residuals: Float64) -> Float64:
    """(d, d) maximum-likelihood scale matrix of the Student-t density of (n, d) residuals, never singular."""
    return _maximum_likelihood_scale(residuals)[0]


def deviance_of(residuals: Float64) -> float:
    """Deviance of (n, d) residuals, Student-t distributed with their maximum-likelihood scale."""
    return _maximum_likelihood_scale(residuals)[1]


def log_density(residuals: Float64, scale: Float64) -> Float64:
    """(n,) log density of (n, d) residuals under the Student-t density of a (d, d) scale matrix.

    Source: Lange, Little, Taylor 1989, equation 1.
    """
    width = residuals.shape[1]
    root = np.linalg.cholesky(scale)
    distance = (np.linalg.solve(root, residuals.T) ** 2).sum(axis=0)
    log_det = 2.0 * float(np.log(np.diag(root)).sum())
    return np.asarray(
        -0.5 * (log_det + (DOF + width) * np.log1p(distance / DOF) + _constant(width)), dtype=np.float64
    )


def _constant(width: int) -> float:
    """Minus twice the log of the density's normalisation, without its scale."""
    return 2.0 * (math.lgamma(0.5 * DOF) - math.lgamma(0.5 * (DOF + width))) + width * math.log(DOF * math.pi)


def _maximum_likelihood_scale(residuals: Float64) -> tuple[Float64, float]:
    """The maximum-likelihood scale matrix, and the deviance with it."""
    count, width = residuals.shape
    least = np.square(np.resize(np.array(_SCALE_MIN), width))
    if not count:
        return np.diag(least), 0.0
    rows = np.ascontiguousarray(residuals, dtype=np.float64)
    scale, deviance = _em_scale(rows, least, DOF, _EM_TOLERANCE)
    return scale, float(deviance + count * _constant(width))


@cached_njit()
def _em_scale(residuals: Float64, least: Float64, dof: float, exact: float) -> tuple[Float64, float]:
    """Scale matrix of least deviance by parameter-expanded EM, regularised, and that deviance."""
    count, width = residuals.shape
    scale = np.diag(least)
    for row in range(count):
        for i in range(width):
            for j in range(width):
                scale[i, j] += residuals[row, i] * residuals[row, j] / count
    before, best, best_scale = np.inf, np.inf, scale
    for _ in range(200):
        inverse = np.linalg.inv(np.linalg.cholesky(scale))
        deviance, penalty = 0.0, 0.0
        for i in range(width):
            deviance -= 2.0 * count * np.log(inverse[i, i])
            for j in range(i + 1):
                penalty += inverse[i, j] ** 2 * least[j]
        total, moment = 0.0, np.diag(count * least)
        for row in range(count):
            distance = 0.0
            for i in range(width):
                part = 0.0
                for j in range(i + 1):
                    part += inverse[i, j] * residuals[row, j]
                distance += part * part
            deviance += (dof + width) * np.log1p(distance / dof)
            weight = (dof + width) / (dof + distance)
            total += weight
            for i in range(width):
                for j in range(width):
                    moment[i, j] += weight * residuals[row, i] * residuals[row, j]
        deviance += count * penalty
        if deviance < best:
            best, best_scale = deviance, scale
        if abs(before - deviance) < exact:
            break
        before = deviance
        scale = moment * ((1.0 + penalty / dof) / total)
    return best_scale, best


def linearised_optimum(
    residuals: Float64, jacobian: Float64, low: Float64, high: Float64, damping: Float64
) -> tuple[Float64, float]:
    """(p,) optimum within bounds if residuals were linear in the parameters, and the deviance there.

    Iteratively reweighted least squares: the remaining residuals set the weights, so the step is repeated.
    What few periods show has little weight until the step explains it.
    """
    found = np.zeros(jacobian.shape[2])
    after = residuals
    scale, best = _maximum_likelihood_scale(residuals)
    for _ in range(REWEIGHTINGS_MAX):
        # From the present point: an outlier that the step explains has full weight again.
        flat, columns = whiten(_whitener_of(scale), after, jacobian)
        flat = np.concatenate([flat, np.sqrt(damping) * found])
        columns = np.concatenate([columns, np.diag(np.sqrt(damping))])
        move = bounded_step(columns, flat, np.zeros(len(found)), low - found, high - found)
        gain, step = 0.0, found + move
        while (tried := _maximum_likelihood_scale(residuals + jacobian @ step))[1] < best:
            gain, found = gain + best - tried[1], step
            scale, best = tried
            # Each reweighting goes a little farther in the same direction: doubling the step saves some.
            move = 2.0 * move
            step = np.clip(found + move, low, high)
        if gain < CONVERGED / 4.0:
            break
        after = residuals + jacobian @ found
    return found, best


def cross_fitted(
    residuals: Float64, jacobian: Float64, low: Float64, high: Float64, damping: Float64, folds: Int64
) -> Float64:
    """(n,) cross-validated log density of each period: its own fold had no part in parameters and scale.

    Residuals are taken as linear in the parameters. From the point of linearisation all parameters may move
    within their bounds, so what they learned from the fold itself is lost. NaN where there is a single fold.

    Args:
        residuals, jacobian, low, high, damping: see ``linearised_optimum``.
        folds: (n,) the fold of each period.
    """
    scores = np.zeros(len(residuals))
    for label in np.unique(folds):
        test = folds == label
        if test.all():
            return np.full(len(residuals), np.nan)
        step, _ = linearised_optimum(residuals[~test], jacobian[~test], low, high, damping)
        scores[test] = held_out_density(residuals + jacobian @ step, test)
    return scores


def held_out_density(residuals: Float64, test: Bool) -> Float64:
    """(k,) log density of the k of n periods that are held out, by the scale of the others."""
    scale = _shrunk(scale_of(residuals[~test]), int((~test).sum()))
    return log_density(residuals[test], scale)


def _shrunk(scale: Float64, count: int) -> Float64:
    """A scale matrix of few periods with its correlations shrunk, as if d more periods had shown none."""
    width = len(scale)
    return np.asarray((count * scale + width * np.diag(np.diag(scale))) / (count + width))


def whitener(residuals: Float64) -> Float64:
    """(d, d) whitening matrix: (n, d) residuals times it are uncorrelated and of scale one."""
    return _whitener_of(scale_of(residuals))


def _whitener_of(scale: Float64) -> Float64:
    return np.asarray(np.linalg.inv(np.linalg.cholesky(scale)).T)


def whiten(white: Float64, residuals: Float64, jacobian: Float64) -> tuple[Float64, Float64]:
    """(d n,) residuals and (d n, p) derivatives, whitened and times the root of each period's Student-t
    weight.

    Half the gradient of ``deviance_of`` is the second transposed times the first: a least-squares step on
    them is a step of expectation maximisation, whose fixed point is the least deviance.
    """
    rows, width = residuals @ white, residuals.shape[1]
    weight = np.sqrt((DOF + width) / (DOF + (rows**2).sum(axis=1)))
    columns = np.einsum("nip,ij->njp", jacobian, white) * weight[:, None, None]
    return (rows * weight[:, None]).ravel(), columns.reshape(residuals.size, jacobian.shape[2])


def bounded_step(
    jacobian: Float64, residual: Float64, damping: Float64, low: Float64, high: Float64
) -> Float64:
    """(p,) damped least-squares step within bounds (active set): what reaches a bound is fixed there."""
    normal = jacobian.T @ jacobian + np.diag(damping)
    right = -jacobian.T @ residual
    step = np.zeros(len(right))
    free = np.ones(len(right), dtype=bool)
    for _ in range(len(right) + 1):
        if not free.any():
            break
        rhs = right[free] - normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.lstsq(normal[np.ix_(free, free)], rhs, rcond=1e-12)[0]
        out = free & ((step < low) | (step > high))
        step = np.clip(step, low, high)
        if not out.any():
            break
        free &= ~out
    return step
