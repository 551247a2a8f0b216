"""Effects that were taken one by one, looked at once more beside each other.

The first that is taken stands in for what has not come yet: it may be needless in the end, or another may do
better in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from frogkick.identification.bootstrap import drawn_periods, mean_interval
from frogkick.identification.fit import Fitted, Model, begun_at, fit_many, fit_on, room_of
from frogkick.identification.polish import ROUNDS, Polisher, fine_leg_s
from frogkick.identification.segments import Segments, replicate_count
from frogkick.identification.steps import cross_fitted, promised
from frogkick.identification.terms import Term
from frogkick.identification.worth import ALIKE, BASE_GAIN, GAIN_EACH, SAME, SAME_ALIKE, free_count, price

FloatArray = NDArray[np.float64]

DRAWS = 50
"""Of the runs' periods, that say how stable a choice is."""

FAR_OFF = 300.0
"""A term that costs more than this at first when it is left out is not needless."""


def revised(
    polisher: Polisher,
    current: Fitted,
    equals: Sequence[list[Term]],
    passed_over: Sequence[Sequence[Fitted]],
    alone: Sequence[Fitted] = (),
) -> tuple[Fitted, list[list[Term]]]:
    """A model of several terms with the best of those that were near in the place of each, and none needless.

    Where there are more than two, two of those that did best alone stand for all of them if they do as well.

    Args:
        polisher: of the runs.
        current: as the search ended.
        equals: for each term those that could not be told from it when it was taken.
        passed_over: for each term the models that were near then, with what was taken itself.
        alone: models of one term each, the best of the first turn.

    Returns:
        The model, and what now cannot be told from each term.
    """
    found = [list(others) for others in equals]
    for place in range(len(found) - 1):  # beside the last one all others were there
        near = [each.model.terms[-1] for each in passed_over[place]]
        current, found[place] = _exchanged(polisher, current, place, near)
    current, kept = _fewer(polisher, current)
    current = polisher.sparer(current, whole=True)
    found = [found[place] for place in kept]
    if len(kept) > 2 and (pair := _pair(polisher, current, alone)) is not None:
        current, kept = _fewer(polisher, pair[0])
        current, found = polisher.sparer(current, whole=True), [pair[1][place] for place in kept]
    return current, found


def _pair(
    polisher: Polisher, current: Fitted, alone: Sequence[Fitted]
) -> tuple[Fitted, list[list[Term]]] | None:
    """Two terms that do as well as the several of a model; None where no two of those that did best alone do.

    Terms taken one by one may imitate one that came second at first: a delay of each limb all late fixes.
    For each of the two comes what cannot be told from it beside the other.
    """
    model, starts = current.model, list[Model]()
    for one, other in combinations((each.model for each in alone), 2):
        held = one.held | {len(one.values) + k for k in other.held}
        both = replace(model, terms=(*one.terms, *other.terms), held=frozenset(held))
        both = replace(both, leg_s=fine_leg_s(both))
        # Alone, a limb that is worn takes up with its delay what comes from the other.
        starts += [both] if (plain := _undelayed(both)) is both else [both, plain]
    fits = fit_many(starts, polisher.swims, polisher.rows, ROUNDS) if starts else []
    bound = min((price(each) for each in fits), default=0.0) + ALIKE * polisher.replicates  # all of one noise
    equal = [each for each in fits if price(each) < bound and each.cost < current.cost + FAR_OFF]
    if not equal:
        return None
    first, *rest = sorted(equal, key=lambda each: (len(each.model.values), price(each)))
    best = polisher.polished(first)
    if _whole_price(polisher, best) >= _whole_price(polisher, current):
        return None
    mine = [term.title for term in best.model.terms]
    others = [{term.title: term for term in each.model.terms} for each in rest]
    return best, [
        [
            term
            for pair in others
            if mine[1 - place] in pair
            for name, term in pair.items()
            if name not in mine
        ]
        for place in range(2)
    ]


def _undelayed(model: Model) -> Model:
    """The model with all values put back that are tried far apart, where their terms have others."""
    values, back, first = model.values, set[int](), 0
    for term in model.terms:
        free = {first + k for k in range(len(term.values))} - model.held
        tried = {first + k for k, parameter in enumerate(term.parameters) if parameter.tried} & free
        if tried < free:
            back |= tried
            for k in tried:
                values[k] = term.parameters[k - first].nominal
        first += len(term.values)
    return replace(model.with_values(values), held=model.held | back) if back else model


def _whole_price(polisher: Polisher, fitted: Fitted) -> float:
    """Cost, and what effects and their free parameters cost together."""
    effects = BASE_GAIN * len(fitted.model.terms)
    return fitted.cost + polisher.replicates * (effects + GAIN_EACH * free_count(fitted))


def same_named(
    polisher: Polisher, current: Fitted, equals: Sequence[list[Term]], candidates: Sequence[Term]
) -> tuple[Fitted, list[list[Term]]]:
    """The model with the simpler of two effects that are one swim (SAME), where it has either.

    Args:
        polisher: of the runs.
        current: as the search ended.
        equals: for each term those that cannot be told from it.
        candidates: of the search.

    Returns:
        The model, and the same with the other of the two where it does as well.
    """
    known, found = {term.title: term for term in candidates}, [list(others) for others in equals]
    for place, term in enumerate(current.model.terms):
        if term.title not in SAME or not set(SAME) <= known.keys():
            continue
        other = known[SAME[1 - SAME.index(term.title)]]
        if other.title in [each.title for each in found[place]]:
            continue
        late_s = term.values[[p.name for p in term.parameters].index("delay_s")]
        values = [late_s if p.name == "delay_s" else p.nominal for p in other.parameters]
        current, alike = _exchanged(polisher, current, place, [other.at(values)], SAME_ALIKE)
        found[place] += alike
    return current, found


def _exchanged(
    polisher: Polisher, current: Fitted, place: int, rivals: Sequence[Term], alike: float = ALIKE
) -> tuple[Fitted, list[Term]]:
    """The model with the best of some terms in one place, and those that cost less than ``alike`` more."""
    title = current.model.terms[place].title
    others = {term.title: term for term in rivals}
    others.pop(title, None)
    for term in current.model.terms:
        others.pop(term.title, None)
    if not others:
        return current, []
    starts = [in_place(current.model, place, term) for term in others.values()]
    fits = fit_many(starts, polisher.swims, polisher.rows, ROUNDS)
    every = [current, *fits]  # of one noise
    bound = min(price(each) for each in every) + alike * polisher.replicates
    equal = [each for each in every if price(each) < bound]
    first, *rest = sorted(equal, key=lambda each: (len(each.model.values), price(each)))
    return (
        first if first is current else polisher.polished(first),
        [each.model.terms[place] for each in rest],
    )


def in_place(model: Model, place: int, term: Term) -> Model:
    """Another term in a place (-1: the last), its parameters free but for those where it vanishes."""
    place %= len(model.terms)
    left, held = _left_out(model, place)
    first = sum(len(each.values) for each in left[:place])
    count = len(term.values)
    there = frozenset(
        first + k
        for k, (value, parameter) in enumerate(zip(term.values, term.parameters, strict=True))
        if value == parameter.nominal
    )
    moved = frozenset(k if k < first else k + count for k in held)
    changed = replace(model, terms=(*left[:place], term, *left[place:]), held=moved | there)
    return replace(changed, leg_s=fine_leg_s(changed))


def _fewer(polisher: Polisher, fitted: Fitted) -> tuple[Fitted, list[int]]:
    """The model without terms that are needless beside its others, and which of them stay."""
    kept = list(range(len(fitted.model.terms)))
    while len(kept) > 1:
        models, jacobians = [], []
        for place in range(len(kept)):
            terms, held = _left_out(fitted.model, place)
            models.append(replace(fitted.model, terms=terms, held=held))
            jacobians.append(np.delete(fitted.jacobian, _values_of(fitted.model, place), axis=2))
        begun = begun_at(models, jacobians, polisher.swims, polisher.rows)
        near = [place for place, each in enumerate(begun) if each.cost < fitted.cost + FAR_OFF]
        fits = fit_on([begun[place] for place in near], polisher.swims, polisher.rows, 2)
        dearer = [
            each.cost
            - fitted.cost
            - polisher.replicates * (BASE_GAIN + GAIN_EACH * (free_count(fitted) - free_count(each)))
            for each in fits
        ]
        if min(dearer, default=0.0) >= 0.0:
            break
        best = int(np.argmin(dearer))
        kept.pop(near[best])
        fitted = polisher.polished(fits[best])
    return fitted, kept


def needless(fitted: Fitted, folds: NDArray[np.int64], swims: Sequence[Segments]) -> int | None:
    """Which of several terms costs nothing on held-out parts of the training runs when it is left out.

    At the ends of periods, by the log density that ``steps.cross_fitted`` gives with and without it: the one
    with the least gain, where that gain's interval reaches zero. None where every term is needed.

    Args:
        fitted: with derivatives by all its parameters.
        folds: (n,) of the periods that count; see ``search.folds_of``.
        swims: the training runs.
    """
    model = fitted.model
    if len(model.terms) < 2:
        return None
    missed, jacobian = fitted.missed[:, -3:], fitted.jacobian[:, -3:, :]
    shy = 1e-6 * missed.size / model.range**2
    whole = cross_fitted(missed, jacobian, *room_of(model), shy, folds)
    wider, gains = np.sqrt(replicate_count(swims)), list[tuple[float, float]]()
    for place in range(len(model.terms)):
        back, less = _put_back(model, place)
        scores = cross_fitted(missed + jacobian @ back, jacobian, *room_of(less), shy, folds)
        each = [(whole - scores)[folds == label] for label in np.unique(folds)]
        low, _ = mean_interval(each, np.random.default_rng(0))
        value = float((whole - scores).mean())
        gains.append((value, value - wider * (value - low)))
    place = min(range(len(gains)), key=lambda k: gains[k][0])
    return place if gains[place][1] <= 0.0 else None


def stability(
    fitted: Fitted, rows: NDArray[np.bool_], swims: Sequence[Segments], searched: bool
) -> list[float]:
    """In what share of other draws of the same runs each term would have been taken beside the others.

    Blocks of periods are drawn anew from each run, with replacement, and the model is fitted to each draw
    with and without the term, by derivatives. The term is taken where minus twice the log likelihood falls by
    what the search asks of it. Source: Meinshausen, Buehlmann 2010 (stability selection).

    Args:
        fitted: with derivatives by all its parameters.
        rows: periods of the runs that count, in ``fitted.missed``.
        swims: the training runs.
        searched: its terms were taken one by one; else together, and share what one of them owes.
    """
    model = fitted.model
    shy = 1e-6 * fitted.missed.size / model.range**2
    runs = np.repeat(np.arange(len(swims)), [len(swim.start_s) for swim in swims])[rows]
    base = BASE_GAIN / (1 if searched else max(len(model.terms), 1))
    owed = [
        base + GAIN_EACH * len(set(_values_of(model, place)) - model.held)
        for place in range(len(model.terms))
    ]
    taken = np.zeros(len(model.terms))
    rng = np.random.default_rng(0)
    for _ in range(DRAWS):
        drawn = drawn_periods(runs, rng)
        missed, jacobian = fitted.missed[drawn], fitted.jacobian[drawn]
        _, whole = promised(missed, jacobian, *room_of(model), shy)
        for place in range(len(model.terms)):
            back, less = _put_back(model, place)
            _, cost = promised(missed + jacobian @ back, jacobian, *room_of(less), shy)
            taken[place] += cost - whole > replicate_count(swims) * owed[place]
    return [float(share) for share in taken / DRAWS]


def _put_back(model: Model, place: int) -> tuple[FloatArray, Model]:
    """The step that takes a term's parameters to where its effect vanishes, and the model that holds them."""
    gone = _values_of(model, place)
    back = np.zeros(len(model.values))
    for k, parameter in zip(gone, model.terms[place].parameters, strict=True):
        back[k] = parameter.nominal - model.values[k]
    return back, replace(model, held=model.held | frozenset(gone))


def without(model: Model, place: int) -> Model:
    """A model without one of its terms."""
    terms, held = _left_out(model, place)
    return replace(model, terms=terms, held=held)


def _values_of(model: Model, place: int) -> range:
    """Which values in a row are those of a term."""
    first = sum(len(term.values) for term in model.terms[:place])
    return range(first, first + len(model.terms[place].values))


def _left_out(model: Model, place: int) -> tuple[tuple[Term, ...], frozenset[int]]:
    """A model's other terms, and which of their values are held."""
    gone = _values_of(model, place)
    held = frozenset(k if k < gone.start else k - len(gone) for k in model.held if k not in gone)
    return model.terms[:place] + model.terms[place + 1 :], held
