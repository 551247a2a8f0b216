"""How sure a mean over periods is: bootstrap over runs, or over blocks of periods where runs are few."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CONFIDENCE = 0.95

BLOCK, RESAMPLES, RUNS_ENOUGH = 4, 2000, 8
"""Bootstrap: periods in a row that stay together, resamples; of so many runs whole ones are drawn instead."""


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
