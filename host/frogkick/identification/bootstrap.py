"""Block bootstrap: how certain a mean over periods is, and a parameter; and what a search gains by chance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.identification.steps import DOF, whiten, whitener

CONFIDENCE = 0.95

BLOCK, RESAMPLES, RUNS_ENOUGH = 4, 2000, 8
"""Consecutive periods in a block, resamples; from RUNS_ENOUGH runs on, whole runs are drawn instead."""

FLIPS = 400  # random sign changes of blocks


def mean_interval(runs: Sequence[Float64], rng: np.random.Generator) -> tuple[float, float]:
    """Interval of the mean of all values of runs, by bootstrap over runs or over blocks of each run.

    A bootstrap of few blocks is too narrow: its variance is biased and it lacks the tails of Student's t. Its
    distances from the mean are widened by both. A single value has no interval: it is infinite.
    """
    from scipy import stats

    value = float(np.concatenate(runs).mean())
    if sum(map(len, runs)) < 2:
        return -math.inf, math.inf
    drawn = _resampled(runs, rng)
    ends = np.quantile(drawn, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    many = len(runs) >= RUNS_ENOUGH
    count = max(len(runs) if many else sum(-(-len(run) // BLOCK) for run in runs), 2)
    tails = stats.t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1) / stats.norm.ppf(0.5 + 0.5 * CONFIDENCE)
    wider = float(tails) * math.sqrt(count / (count - 1))
    low, high = (value + wider * (ends - value)).tolist()
    return min(low, value), max(high, value)


def _resampled(runs: Sequence[Float64], rng: np.random.Generator) -> Float64:
    """(RESAMPLES,) bootstrap means: over runs where these are many, else over circular blocks.

    Source: Kuensch 1989; Politis, Romano 1992 (circular blocks).
    """
    if len(runs) >= RUNS_ENOUGH:
        sums, counts = np.array([run.sum() for run in runs]), np.array([len(run) for run in runs])
        drawn = rng.integers(len(runs), size=(RESAMPLES, len(runs)))
        return np.asarray(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1))
    totals, whole = np.zeros(RESAMPLES), 0
    single = [run for run in runs if len(run) == 1]
    for run in [*(run for run in runs if len(run) > 1), *([np.concatenate(single)] if single else [])]:
        # All blocks as long as their run would have one mean.
        size = BLOCK if len(run) > BLOCK else max(len(run) // 2, 1)
        blocks = np.convolve(np.concatenate([run, run[: size - 1]]), np.ones(size), mode="valid")
        count = -(-len(run) // size)
        # As many values as the run has: the last block counts partly.
        totals += blocks[rng.integers(len(run), size=(RESAMPLES, count))].mean(axis=1) * len(run) / size
        whole += len(run)
    return totals / whole


def drawn_periods(runs: Int64, rng: np.random.Generator) -> Int64:
    """(n,) rows of a resample of periods: circular blocks of BLOCK of each run, drawn with replacement.

    The periods of a run are in order. Source: Politis, Romano 1992.
    """
    drawn = []
    for run in np.unique(runs):
        own = np.flatnonzero(runs == run)
        starts = rng.integers(len(own), size=-(-len(own) // BLOCK))
        drawn.append(own[(starts[:, None] + np.arange(BLOCK)).ravel()[: len(own)] % len(own)])
    return np.concatenate(drawn)


def standard_errors(residuals: Float64, jacobian: Float64, scale: Float64, runs: Int64) -> Float64:
    """(p,) standard errors of parameters at the maximum of the Student-t likelihood.

    Each is the larger of two estimates: by the curvature of the log likelihood, and by the block bootstrap
    over BLOCK consecutive periods, in closed form (sandwich estimator) for residuals that are linear in the
    parameters. The latter counts what neighbours share, as a fix that ends one period and begins the next.

    Both use a scale matrix estimated from the same periods: with n of them and d residuals each, its inverse
    is too large by n / (n - d - 1), and what is weighted by it scatters more by (n - 1) / (n - d).

    Args:
        residuals, jacobian: (n, d) of periods, and (n, d, p) their derivatives by the parameters.
        scale: (p,) typical sizes of the parameters.
        runs: (n,) the run that each period belongs to; the periods of a run are in order.

    Source: Kuensch 1989 (block bootstrap); Lange, Little, Taylor 1989 (Student-t likelihood); Rao 1967 (least
    squares with an estimated dispersion matrix).
    """
    count, dimensions, width = jacobian.shape
    size = np.maximum(scale, 1e-12)
    white = whitener(residuals)
    whitened, columns = residuals @ white, np.einsum("nip,ij->njp", jacobian, white) * size
    weight, inverse = _at_best(whitened, columns)
    slope = np.einsum("njp,nj->np", columns, whitened)
    score, scatter = weight[:, None] * slope, np.zeros((width, width))
    for run in np.unique(runs):
        own = score[runs == run]
        scatter += own.T @ own
        block = min(BLOCK, len(own))
        for ahead in range(1, block):
            beside = own.T @ np.roll(own, -ahead, axis=0)
            scatter += (1.0 - ahead / block) * (beside + beside.T)
    variance = np.maximum(np.diag(inverse), np.diag(inverse @ scatter @ inverse))
    estimated = count / max(count - dimensions - 1, 1) * (count - 1) / max(count - dimensions, 1)
    return np.asarray(np.sqrt(variance * estimated) * size)


def _at_best(whitened: Float64, columns: Float64) -> tuple[Float64, Float64]:
    """(n,) weights of (n, d) whitened residuals, and (p, p) the inverse of the log likelihood's curvature.

    ``columns`` (n, d, p) are their derivatives by the parameters, in typical sizes.
    """
    dimensions, width = columns.shape[1:]
    weight = (DOF + dimensions) / (DOF + (whitened**2).sum(axis=1))
    slope = np.einsum("njp,nj->np", columns, whitened)
    squares = np.einsum("njp,njq->npq", columns, columns)
    bent = np.einsum("n,np,nq->pq", 2.0 * weight**2 / (DOF + dimensions), slope, slope)
    curvature = np.einsum("n,npq->pq", weight, squares) - bent
    values = np.linalg.eigvalsh(curvature)
    if values[0] < 1e-6 * values[-1]:  # of few periods: the expected information
        curvature = squares.sum(axis=0) * (DOF + dimensions) / (DOF + dimensions + 2.0)
    return weight, np.linalg.pinv(curvature + 1e-9 * whitened.size * np.eye(width))


def moved_by(change: Float64, residuals: Float64, jacobian: Float64, scale: Float64) -> Float64:
    """(p,) shift of the fitted parameters by a change of the residuals, to first order (influence function).

    For the arguments see ``standard_errors``.
    """
    size = np.maximum(scale, 1e-12)
    white = whitener(residuals)
    columns = np.einsum("nip,ij->njp", jacobian, white) * size
    whitened, moved = residuals @ white, change @ white
    weight, inverse = _at_best(whitened, columns)
    along = np.einsum("n,nj,nj->n", 2.0 * weight**2 / (DOF + residuals.shape[1]), whitened, moved)
    pull = weight[:, None] * moved - along[:, None] * whitened  # weights fall as residuals grow
    return np.asarray(-inverse @ np.einsum("njp,nj->p", columns, pull) * size)


def gain_by_chance(
    residuals: Float64, jacobian: Float64, candidates: Sequence[Float64], runs: Int64, penalty: float
) -> float:
    """Predicted gain of the best of many candidates if none is true: the CONFIDENCE quantile.

    The signs of the residuals of BLOCK consecutive periods are drawn at random, and each candidate's gain is
    predicted by its derivatives, less its penalty (wild bootstrap). Dependence between neighbours, outliers
    and the number of candidates are those of the runs themselves.

    Args:
        residuals, jacobian: (n, d) of the model that is compared with, and (n, d, q) their derivatives by its
            own parameters, which stay free.
        candidates: (n, d, p) derivatives of these by each candidate's parameters.
        runs: (n,) see ``standard_errors``.
        penalty: of each parameter.

    Source: Freedman, Lane 1983 (residuals under the reduced model); Wu 1986 (wild bootstrap); Bartlett 1938
    (correction for few rows).
    """
    white = whitener(residuals)
    left, own = whiten(white, residuals, jacobian)
    first = np.searchsorted(runs, runs)  # of each period's run
    block = np.unique(np.stack([runs, (np.arange(len(runs)) - first) // BLOCK]), axis=1, return_inverse=True)[
        1
    ]

    # The deviance falls further than its quadratic form where weights and scale are fitted as well.
    count, dimensions = residuals.shape
    further = (
        (DOF + dimensions + 2.0)
        / (DOF + dimensions)
        * count
        / max(count - 0.5 * (dimensions + 1) - jacobian.shape[2], 1.0)
    )
    own = np.linalg.qr(own)[0]
    label = np.repeat(block.ravel(), dimensions)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (FLIPS, int(label.max()) + 1))
    best = np.zeros(FLIPS)
    for candidate in candidates:
        _, columns = whiten(white, residuals, candidate)
        columns = columns - own @ (own.T @ columns)
        basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        basis = basis[:, sizes > 1e-6 * max(sizes[0], 1e-300)]
        if not basis.shape[1]:
            continue  # it changes nothing that the model's own parameters do not
        slopes = np.stack([np.bincount(label, basis[:, k] * left) for k in range(basis.shape[1])], axis=1)
        best = np.maximum(best, further * ((signs @ slopes) ** 2).sum(axis=1) - penalty * basis.shape[1])
    return float(np.quantile(best, CONFIDENCE))
