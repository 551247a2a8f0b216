"""How sure a mean over periods is, and a parameter: bootstrap over runs, or over blocks of periods."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from frogkick.identification.steps import DOF, whitener

FloatArray = NDArray[np.float64]

CONFIDENCE = 0.95

BLOCK, RESAMPLES, RUNS_ENOUGH = 4, 2000, 8
"""Bootstrap: periods in a row that stay together, resamples; of so many runs whole ones are drawn instead."""

FLIPS = 400
"""How often the signs of blocks are drawn anew."""


def mean_interval(runs: Sequence[FloatArray], rng: np.random.Generator) -> tuple[float, float]:
    """Interval of the mean of all values of runs, by bootstrap over runs or over blocks of each.

    A bootstrap of few blocks is too narrow by the bias of a variance and by the tails of Student's t; its
    distances from the mean are widened by both.
    """
    from scipy import stats

    value = float(np.concatenate(runs).mean())
    drawn = _resampled(runs, rng)
    ends = np.quantile(drawn, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    many = len(runs) >= RUNS_ENOUGH
    count = max(len(runs) if many else sum(-(-len(run) // BLOCK) for run in runs), 2)
    tails = stats.t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1) / stats.norm.ppf(0.5 + 0.5 * CONFIDENCE)
    wider = float(tails) * math.sqrt(count / (count - 1))
    low, high = (value + wider * (ends - value)).tolist()
    return min(low, value), max(high, value)


def _resampled(runs: Sequence[FloatArray], rng: np.random.Generator) -> FloatArray:
    """(RESAMPLES,) means of values of runs by bootstrap: over runs where these are many, else over blocks.

    Source: Kuensch 1989; Politis, Romano 1992 (circular blocks).
    """
    if len(runs) >= RUNS_ENOUGH:
        sums, counts = np.array([run.sum() for run in runs]), np.array([len(run) for run in runs])
        drawn = rng.integers(len(runs), size=(RESAMPLES, len(runs)))
        return np.asarray(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1))
    totals, whole = np.zeros(RESAMPLES), 0
    for run in runs:
        size = min(BLOCK, len(run))
        blocks = np.convolve(np.concatenate([run, run[: size - 1]]), np.ones(size), mode="valid")
        count = -(-len(run) // size)
        # As many values as the run has: the last block counts in part.
        totals += blocks[rng.integers(len(run), size=(RESAMPLES, count))].mean(axis=1) * len(run) / size
        whole += len(run)
    return totals / whole


def drawn_periods(runs: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """(n,) rows of as many periods, drawn anew with replacement as circular blocks of BLOCK of each run.

    Args:
        runs: (n,) the run that each period is of; the periods of one are in their order.
        rng: draws.

    Source: Politis, Romano 1992.
    """
    drawn = []
    for run in np.unique(runs):
        own = np.flatnonzero(runs == run)
        starts = rng.integers(len(own), size=-(-len(own) // BLOCK))
        drawn.append(own[(starts[:, None] + np.arange(BLOCK)).ravel()[: len(own)] % len(own)])
    return np.concatenate(drawn)


def deviations(
    missed: FloatArray, jacobian: FloatArray, scale: FloatArray, runs: NDArray[np.int64]
) -> FloatArray:
    """(p,) standard deviations of parameters at the maximum of the Student-t likelihood.

    Each is the larger of two: by the curvature of the log likelihood, and by the bootstrap over BLOCK periods
    in a row of a run, in closed form for misses that are linear in the parameters: what neighbours share, as
    a fix that ends one period and begins the next, is counted.

    Both are told by a scale matrix that the same periods gave: with n of them and d misses each, its inverse
    is too large by n / (n - d - 1), and what is weighted by it scatters more by (n - 1) / (n - d).

    Args:
        missed: (n, d) what periods missed.
        jacobian: (n, d, p) of these by the parameters.
        scale: (p,) typical sizes of the parameters.
        runs: (n,) the run that each period is of; the periods of one are in their order.

    Source: Kuensch 1989 (block bootstrap); Lange, Little, Taylor 1989 (Student-t likelihood); Rao 1967 (least
    squares with an estimated dispersion matrix).
    """
    count, wide, width = jacobian.shape
    size = np.maximum(scale, 1e-12)
    white = whitener(missed)
    misses, columns = missed @ white, np.einsum("nip,ij->njp", jacobian, white) * size
    weight, inverse = _at_best(misses, columns)
    slope = np.einsum("njp,nj->np", columns, misses)
    score, scatter = weight[:, None] * slope, np.zeros((width, width))
    for run in np.unique(runs):
        own = score[runs == run]
        scatter += own.T @ own
        block = min(BLOCK, len(own))
        for ahead in range(1, block):
            beside = own.T @ np.roll(own, -ahead, axis=0)
            scatter += (1.0 - ahead / block) * (beside + beside.T)
    variance = np.maximum(np.diag(inverse), np.diag(inverse @ scatter @ inverse))
    estimated = count / max(count - wide - 1, 1) * (count - 1) / max(count - wide, 1)
    return np.asarray(np.sqrt(variance * estimated) * size)


def _at_best(misses: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) weights of whitened misses, and (p, p) the inverse of the log likelihood's curvature.

    Args:
        misses: (n, d) whitened.
        columns: (n, d, p) of these by the parameters, in typical sizes.
    """
    wide, width = columns.shape[1:]
    weight = (DOF + wide) / (DOF + (misses**2).sum(axis=1))
    slope = np.einsum("njp,nj->np", columns, misses)
    squares = np.einsum("njp,njq->npq", columns, columns)
    bent = np.einsum("n,np,nq->pq", 2.0 * weight**2 / (DOF + wide), slope, slope)
    curvature = np.einsum("n,npq->pq", weight, squares) - bent
    values = np.linalg.eigvalsh(curvature)
    if values[0] < 1e-6 * values[-1]:  # of few periods: the one that is expected
        curvature = squares.sum(axis=0) * (DOF + wide) / (DOF + wide + 2.0)
    return weight, np.linalg.pinv(curvature + 1e-9 * misses.size * np.eye(width))


def moved_by(change: FloatArray, missed: FloatArray, jacobian: FloatArray, scale: FloatArray) -> FloatArray:
    """(p,) how far a change of what periods missed moves the parameters that fit best, to first order.

    Args:
        change: (n, d) of ``missed``.
        missed, jacobian, scale: see ``deviations``.
    """
    size = np.maximum(scale, 1e-12)
    white = whitener(missed)
    columns = np.einsum("nip,ij->njp", jacobian, white) * size
    misses, moved = missed @ white, change @ white
    weight, inverse = _at_best(misses, columns)
    along = np.einsum("n,nj,nj->n", 2.0 * weight**2 / (DOF + missed.shape[1]), misses, moved)
    pull = weight[:, None] * moved - along[:, None] * misses  # periods that get wilder count less
    return np.asarray(-inverse @ np.einsum("njp,nj->p", columns, pull) * size)


def gain_by_chance(
    missed: FloatArray,
    jacobian: FloatArray,
    candidates: Sequence[FloatArray],
    runs: NDArray[np.int64],
    price: float,
) -> float:
    """What the best of many effects promises where none is true, in 1 - CONFIDENCE of all cases.

    The signs of what BLOCK periods in a row missed are drawn anew, and each candidate promises the fall of
    minus twice the log likelihood by its derivatives, less its price: dependence between neighbours, wild
    periods and the number of candidates are those of the runs themselves.

    Args:
        missed: (n, d) what a model left that explains what there is.
        jacobian: (n, d, q) of these by its own parameters, which stay free.
        candidates: (n, d, p) of these by each candidate's parameters.
        runs: (n,) the run that each period is of; the periods of one are in their order.
        price: of each parameter.

    Source: Freedman, Lane 1983 (residuals under the model that is held against); Wu 1986 (drawn signs);
    Bartlett 1938 (the likelihood of few rows).
    """
    white = whitener(missed)
    rows = missed @ white
    weight = np.sqrt((DOF + rows.shape[1]) / (DOF + (rows**2).sum(axis=1)))
    first = np.searchsorted(runs, runs)  # of each period's run
    block = np.unique(np.stack([runs, (np.arange(len(runs)) - first) // BLOCK]), axis=1, return_inverse=True)[
        1
    ]

    def weighed(columns: FloatArray) -> FloatArray:
        whole = np.einsum("nip,ij->njp", columns, white) * weight[:, None, None]
        return np.asarray(whole.reshape(missed.size, -1))

    # A likelihood whose weights and scale are fitted as well falls further than its quadratic form.
    count, wide = missed.shape
    further = (
        (DOF + wide + 2.0) / (DOF + wide) * count / max(count - 0.5 * (wide + 1) - jacobian.shape[2], 1.0)
    )
    own = np.linalg.qr(weighed(jacobian))[0]
    left, label = (rows * weight[:, None]).ravel(), np.repeat(block.ravel(), missed.shape[1])
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (FLIPS, int(label.max()) + 1))
    best = np.zeros(FLIPS)
    for candidate in candidates:
        columns = weighed(candidate)
        columns = columns - own @ (own.T @ columns)
        basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        basis = basis[:, sizes > 1e-6 * max(sizes[0], 1e-300)]
        slopes = np.stack([np.bincount(label, basis[:, k] * left) for k in range(basis.shape[1])], axis=1)
        best = np.maximum(best, further * ((signs @ slopes) ** 2).sum(axis=1) - price * basis.shape[1])
    return float(np.quantile(best, CONFIDENCE))
