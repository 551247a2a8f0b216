"""Gain of a candidate on held-out periods: estimated by derivatives, or by fits that are simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.identification.batching import all_of
from frogkick.identification.fit import Fitted, fit_on, residuals_of, step_bounds
from frogkick.identification.refine import STEPS_MAX
from frogkick.identification.segments import Segments
from frogkick.identification.steps import cross_fitted, deviance_of, held_out_density


def held_out_gain(current: Fitted, fitted: Fitted, folds: Int64, known: int) -> tuple[float, float]:
    """Mean gain of a fitted candidate on a held-out period over the model without it, and its standard error.

    The gain is twice the difference of the log densities, cross-validated: the fold of a period takes no part
    in the estimates of parameters and scale."""
    low, high = step_bounds(fitted.model)
    scores = [
        cross_fitted(one.residuals, one.jacobian, lows, highs, np.full(len(lows), 1e-9), folds)
        for one, lows, highs in ((current, low[:known], high[:known]), (fitted, low, high))
    ]
    falls = 2.0 * (scores[1] - scores[0])
    return float(falls.mean()), float(falls.std() / np.sqrt(len(falls)))


def bent_gain(
    current: Fitted, fitted: Fitted, swims: Sequence[Segments], rows: Bool, folds: Int64, known: int
) -> tuple[Fitted, tuple[float, float]]:
    """A candidate fitted further, and its ``held_out_gain`` with the fit without each fold simulated.

    This is for laws with a sharp edge, such as a cable that becomes taut or the end of a patch: derivatives
    do not predict how the edge moves in a fit without a fold.

    Args:
        current, fitted, folds, known: see ``held_out_gain``.
        swims, rows: the runs, and which of their periods are used.
    """
    (fitted,) = fit_on([fitted], swims, rows, STEPS_MAX, known)
    numbers, falls, labels = np.flatnonzero(rows), np.zeros(len(folds)), np.unique(folds)
    low, high = step_bounds(current.model)
    plain = cross_fitted(current.residuals, current.jacobian, low, high, np.full(len(low), 1e-9), folds)

    def residuals_without(label: int) -> Float64:
        kept, some = folds != label, rows.copy()
        some[numbers[~kept]] = False
        left, seen = fitted.residuals[kept], fitted.jacobian[kept]
        start = replace(fitted, residuals=left, jacobian=seen, deviance=deviance_of(left))
        (less,) = fit_on([start], swims, some, 2, known)
        return residuals_of(less.rollouts, rows)

    for label, every in zip(labels, all_of([partial(residuals_without, k) for k in labels]), strict=True):
        test = folds == label
        falls[test] = 2.0 * (held_out_density(every, test) - plain[test])
    return fitted, (float(falls.mean()), float(falls.std() / np.sqrt(len(falls))))
