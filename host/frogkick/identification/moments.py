"""The moment of a law on strokes, which no derivative tells: any moment between two strokes fits as well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from frogkick.effects.limbs import ALL
from frogkick.identification.backward import with_term_at
from frogkick.identification.fit import Fitted, Model, residuals_of, rollouts_of
from frogkick.identification.segments import Segments
from frogkick.identification.steps import deviance_of
from frogkick.identification.terms import Term

FloatArray = NDArray[np.float64]

MOMENT = "at"
"""Name of a law's moment."""

WORSE = 3.84
"""What the deviance rises by at the ends of an interval of 95 % (chi-square, one degree of freedom)."""

SAME = 0.04
"""What the deviance may rise by where two moments fit as well."""

NEIGHBOURS = 6
"""Gaps between strokes that are tried on each side of the one that a moment is in."""


def centred(fitted: Fitted, swims: Sequence[Segments], rows: NDArray[np.bool_]) -> Fitted:
    """The model with each such moment (s) in the middle of those that fit as well.

    These reach from stroke to stroke, and farther where a stroke's period does not count.

    Args:
        fitted: a model at its best.
        swims: the runs that it was fitted to.
        rows: periods that count.
    """
    model = fitted.model
    for place, term in enumerate(model.terms):
        borders = _borders(term, fitted.model, swims)
        if borders is not None:
            low, high = _alike(fitted, place, borders, swims, rows, SAME)
            model = _with_moment(model, place, 0.5 * (low + high))
    if model is fitted.model:
        return fitted
    (rollouts,) = rollouts_of([model], swims)
    residuals = residuals_of(rollouts, rows)
    deviance = deviance_of(residuals)
    if deviance > fitted.deviance + SAME:
        return fitted  # its strokes on the fixes' clock are not those of the simulation
    return Fitted(model, rollouts, residuals, fitted.jacobian, deviance, fresh=False)


def moment_intervals(
    fitted: Fitted, swims: Sequence[Segments], rows: NDArray[np.bool_]
) -> dict[int, tuple[float, float]]:
    """The interval (s) of each such moment by its likelihood; the key is the law's place in the model.

    It reaches from stroke to stroke, as far as the deviance, simulated with all other parameters as they are,
    rises by less than WORSE.
    """
    borders = [_borders(term, fitted.model, swims) for term in fitted.model.terms]
    return {
        place: _alike(fitted, place, those, swims, rows, WORSE)
        for place, those in enumerate(borders)
        if those is not None
    }


def _alike(
    fitted: Fitted,
    place: int,
    borders: FloatArray,
    swims: Sequence[Segments],
    rows: NDArray[np.bool_],
    worse: float,
) -> tuple[float, float]:
    """The moments about a law's own (s) whose deviance is higher by less than this, from border to border."""
    k = _gap(borders, fitted.model.terms[place])
    tried = np.arange(max(k - NEIGHBOURS, 0), min(k + NEIGHBOURS + 1, len(borders) - 1))
    models = [_with_moment(fitted.model, place, float(borders[each : each + 2].mean())) for each in tried]
    good = {
        each
        for each, rollouts in zip(tried.tolist(), rollouts_of(models, swims), strict=True)
        if deviance_of(residuals_of(rollouts, rows)) < fitted.deviance + worse
    }
    first = last = k
    while first - 1 in good:
        first -= 1
    while last + 1 in good:
        last += 1
    return float(borders[first]), float(borders[last + 1])


def _borders(term: Term, model: Model, swims: Sequence[Segments]) -> FloatArray | None:
    """(k,) ascending: the bounds of a law's moment (s), and the strokes between them that it acts on.

    None for a law that has no moment, or does not act on strokes.
    """
    table, number = dict(term.table), _number(term)
    if number is None or table.get("on") != "stroke":
        return None
    limbs = {k for k, limb in enumerate(model.robot.limbs) if table.get("limb", ALL) in (ALL, limb.name)}
    low, high = term.parameters[number].low, term.parameters[number].high
    strokes = {at for swim in swims for at, limb in swim.strokes if limb in limbs and low < at < high}
    return np.array([low, *sorted(strokes), high])


def _number(term: Term) -> int | None:
    """Which parameter of a law is its moment."""
    names = [parameter.name for parameter in term.parameters]
    return names.index(MOMENT) if term.name == "law" and MOMENT in names else None


def _gap(borders: FloatArray, term: Term) -> int:
    """Which gap between borders a law's moment is in."""
    at = term.values[_number(term) or 0]
    return int(np.clip(np.searchsorted(borders, at) - 1, 0, len(borders) - 2))


def _with_moment(model: Model, place: int, at_s: float) -> Model:
    values = list(model.terms[place].values)
    values[_number(model.terms[place]) or 0] = at_s
    return with_term_at(model, place, model.terms[place].at(values))
