"""The moment from which a law on strokes acts. All moments between two strokes fit equally well, so it has no
derivative and is found by trying each gap between strokes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from frogkick.core.arrays import Bool, Float64
from frogkick.effects.limbs import ALL
from frogkick.identification.backward import with_term_at
from frogkick.identification.fit import Fitted, Model, residuals_of, rollouts_of
from frogkick.identification.segments import Segments
from frogkick.identification.steps import deviance_of
from frogkick.identification.terms import Term

MOMENT = "at"
"""Name of the parameter that is a law's moment."""

WORSE = 3.84
"""Rise of the deviance at the ends of a 95 % interval (chi-square with one degree of freedom)."""

SAME = 0.04
"""Two moments fit equally well if their deviances differ by less."""

NEIGHBOURS = 6
"""Gaps between strokes that are tried on each side of the moment's own gap."""


def centred(fitted: Fitted, swims: Sequence[Segments], rows: Bool) -> Fitted:
    """Move each such moment (s) to the middle of the moments that fit equally well.

    These moments reach from one stroke to the next, and farther if the period of a stroke is not used.

    Args:
        fitted: a fitted model.
        swims: the runs that it was fitted to.
        rows: which of their periods are used.
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


def moment_intervals(fitted: Fitted, swims: Sequence[Segments], rows: Bool) -> dict[int, tuple[float, float]]:
    """Likelihood interval (s) of each such moment; the key is the index of the law among the model's terms.

    It extends from stroke to stroke while the deviance, simulated with all other parameters unchanged, rises
    by less than WORSE."""
    borders = [_borders(term, fitted.model, swims) for term in fitted.model.terms]
    return {
        place: _alike(fitted, place, those, swims, rows, WORSE)
        for place, those in enumerate(borders)
        if those is not None
    }


def _alike(
    fitted: Fitted, place: int, borders: Float64, swims: Sequence[Segments], rows: Bool, worse: float
) -> tuple[float, float]:
    """Ends (s) of the moments around a law's own at which the deviance is higher by less than ``worse``."""
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


def _borders(term: Term, model: Model, swims: Sequence[Segments]) -> Float64 | None:
    """(k,) ascending times (s): the bounds of a law's moment, and the strokes between that the law acts on.

    None for a law without a moment, or one that does not act on strokes.
    """
    table, number = dict(term.table), _number(term)
    if number is None or table.get("on") != "stroke":
        return None
    limbs = {k for k, limb in enumerate(model.robot.limbs) if table.get("limb", ALL) in (ALL, limb.name)}
    low, high = term.parameters[number].low, term.parameters[number].high
    strokes = {at for swim in swims for at, limb in swim.strokes if limb in limbs and low < at < high}
    return np.array([low, *sorted(strokes), high])


def _number(term: Term) -> int | None:
    """Index of the parameter that is a law's moment; None without one."""
    names = [parameter.name for parameter in term.parameters]
    return names.index(MOMENT) if term.name == "law" and MOMENT in names else None


def _gap(borders: Float64, term: Term) -> int:
    """Index of the gap between borders that contains a law's moment."""
    at = term.values[_number(term) or 0]
    return int(np.clip(np.searchsorted(borders, at) - 1, 0, len(borders) - 2))


def _with_moment(model: Model, place: int, at_s: float) -> Model:
    values = list(model.terms[place].values)
    values[_number(model.terms[place]) or 0] = at_s
    return with_term_at(model, place, model.terms[place].at(values))
