"""Steps of a fit where misses are taken as linear in parameters: their likelihood, weights, bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frogkick.identify.predict import PARTS, WILD

FloatArray = NDArray[np.float64]

CLOSE = 0.2
"""A fall of the cost that ends a fit."""

WEIGHED = 20
"""Times that misses are weighed anew at most, for one step."""


_LEAST = np.tile([2e-5, 2e-5, 2e-4], len(PARTS))


def spread_of(missed: FloatArray) -> FloatArray:
    """(9, 9) second moments, never quite singular."""
    return np.asarray(missed.T @ missed / max(len(missed), 1) + np.diag(_LEAST**2))


def cost_of(missed: FloatArray) -> float:
    """Minus twice the log likelihood of misses that are normal with their own second moments."""
    return float(len(missed) * np.linalg.slogdet(spread_of(missed))[1])


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
        # From where it stands: what was wild at first and is explained by now is not cut.
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


def whitener(missed: FloatArray) -> FloatArray:
    """(9, 9) that makes misses uncorrelated and of size one: rows times it."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(spread_of(missed))).T)


def whiten(white: FloatArray, missed: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(9 n,) misses and (9 n, p) derivatives, whitened; wild ones are cut."""
    flat = np.clip(missed @ white, -WILD, WILD).ravel()
    columns = np.einsum("nip,ij->njp", jacobian, white)
    return flat, columns.reshape(missed.size, jacobian.shape[2])


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
