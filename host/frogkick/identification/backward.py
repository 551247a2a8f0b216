"""Effects that were taken one by one, revised together: swap steps, backward elimination, stability
selection.

The first effect that is taken stands in for those that have not come yet. In the end it may be superfluous,
or another one may do better in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.identification.bootstrap import drawn_periods, mean_interval
from frogkick.identification.fit import Fitted, Model, evaluate, fit_many, fit_on, step_bounds
from frogkick.identification.penalty import (
    CONFOUNDED_MARGIN,
    EFFECT_PENALTY,
    EQUIVALENT,
    EQUIVALENT_MARGIN,
    PARAMETER_PENALTY,
    free_count,
    penalised_deviance,
)
from frogkick.identification.refine import STEPS_MAX, Refiner, fine_leg_s
from frogkick.identification.segments import Segments, replicate_count
from frogkick.identification.steps import cross_fitted, linearised_optimum
from frogkick.identification.terms import Term

DRAWS = 50
"""Resamples of the runs' periods for the stability selection."""

FAR_OFF = 300.0
"""A term is not superfluous if the deviance rises by more than this without it, before a refit."""


def revise(
    refiner: Refiner,
    current: Fitted,
    confounded: Sequence[list[Term]],
    runners_up: Sequence[Sequence[Fitted]],
    single_effect_fits: Sequence[Fitted] = (),
) -> tuple[Fitted, list[list[Term]]]:
    """Revise a model of several terms: swap each for a better runner-up, eliminate what is superfluous.

    Where more than two terms remain, two of the best single effects replace them if they do as well.

    Args:
        refiner: refines models of the runs.
        current: result of the forward selection.
        confounded: for each term those that were confounded with it when it was taken.
        runners_up: for each term the models that were nearly as good then, with the one that was taken.
        single_effect_fits: models of one term each, the best of the first iteration.

    Returns:
        The model, and the terms that are now confounded with each.
    """
    found = [list(others) for others in confounded]
    for place in range(len(found) - 1):  # the last term was chosen beside all others
        near = [each.model.terms[-1] for each in runners_up[place]]
        current, found[place] = swap_step(refiner, current, place, near)
    current, kept = backward_elimination(refiner, current)
    current = refiner.pruned(current, whole=True)
    found = [found[place] for place in kept]
    if len(kept) > 2 and (pair := _pair(refiner, current, single_effect_fits)) is not None:
        current, kept = backward_elimination(refiner, pair[0])
        current, found = refiner.pruned(current, whole=True), [pair[1][place] for place in kept]
    return current, found


def _pair(
    refiner: Refiner, current: Fitted, single_effect_fits: Sequence[Fitted]
) -> tuple[Fitted, list[list[Term]]] | None:
    """Two of the best single effects that do as well as a model's several terms; None if no two do.

    Terms that were taken one by one may together imitate a single effect that was not the best at first: a
    delay of each limb imitates late fixes. The terms that are confounded with each of the two are returned as
    well."""
    model, starts = current.model, list[Model]()
    for one, other in combinations((each.model for each in single_effect_fits), 2):
        fixed = one.fixed | {len(one.values) + k for k in other.fixed}
        both = replace(model, terms=(*one.terms, *other.terms), fixed=frozenset(fixed))
        both = replace(both, leg_s=fine_leg_s(both))
        # Alone, the delay of a worn limb takes up the influence of the other effect.
        starts += [both] if (plain := _with_grid_at_nominal(both)) is both else [both, plain]
    fits = fit_many(starts, refiner.swims, refiner.rows, STEPS_MAX) if starts else []
    bound = (
        min((penalised_deviance(each) for each in fits), default=0.0)
        + CONFOUNDED_MARGIN * refiner.replicate_count
    )  # all of one noise
    equal = [
        each
        for each in fits
        if penalised_deviance(each) < bound and each.deviance < current.deviance + FAR_OFF
    ]
    if not equal:
        return None
    first, *rest = sorted(equal, key=lambda each: (len(each.model.values), penalised_deviance(each)))
    best = refiner.refined(first)
    if _total_penalised_deviance(refiner, best) >= _total_penalised_deviance(refiner, current):
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


def _with_grid_at_nominal(model: Model) -> Model:
    """The model with all grid parameters fixed at nominal, where their terms have other free ones."""
    values, back, first = model.values, set[int](), 0
    for term in model.terms:
        free = {first + k for k in range(len(term.values))} - model.fixed
        tried = {first + k for k, parameter in enumerate(term.parameters) if parameter.grid} & free
        if tried < free:
            back |= tried
            for k in tried:
                values[k] = term.parameters[k - first].nominal
        first += len(term.values)
    return replace(model.with_values(values), fixed=model.fixed | back) if back else model


def _total_penalised_deviance(refiner: Refiner, fitted: Fitted) -> float:
    """Deviance plus the penalties of effects and free parameters."""
    effects = EFFECT_PENALTY * len(fitted.model.terms)
    return fitted.deviance + refiner.replicate_count * (effects + PARAMETER_PENALTY * free_count(fitted))


def resolve_equivalent(
    refiner: Refiner, current: Fitted, confounded: Sequence[list[Term]], candidates: Sequence[Term]
) -> tuple[Fitted, list[list[Term]]]:
    """The model with the simpler of two equivalent effects (EQUIVALENT), where it has either.

    Args:
        refiner: refines models of the runs.
        current: result of the forward selection.
        confounded: for each term those confounded with it.
        candidates: the catalogue.

    Returns:
        The model, and what is confounded with each term, the other of the two included.
    """
    known, found = {term.title: term for term in candidates}, [list(others) for others in confounded]
    for place, term in enumerate(current.model.terms):
        if term.title not in EQUIVALENT or not set(EQUIVALENT) <= known.keys():
            continue
        other = known[EQUIVALENT[1 - EQUIVALENT.index(term.title)]]
        if other.title in [each.title for each in found[place]]:
            continue
        late_s = term.values[[p.name for p in term.parameters].index("delay_s")]
        values = [late_s if p.name == "delay_s" else p.nominal for p in other.parameters]
        current, rivals = swap_step(refiner, current, place, [other.at(values)], EQUIVALENT_MARGIN)
        found[place] += rivals
    return current, found


def swap_step(
    refiner: Refiner, current: Fitted, place: int, rivals: Sequence[Term], margin: float = CONFOUNDED_MARGIN
) -> tuple[Fitted, list[Term]]:
    """Swap step: the best of some terms in one place, and those that are confounded with it."""
    title = current.model.terms[place].title
    others = {term.title: term for term in rivals}
    others.pop(title, None)
    for term in current.model.terms:
        others.pop(term.title, None)
    if not others:
        return current, []
    starts = [with_term_at(current.model, place, term) for term in others.values()]
    fits = fit_many(starts, refiner.swims, refiner.rows, STEPS_MAX)
    every = [current, *fits]  # of one noise
    bound = min(penalised_deviance(each) for each in every) + margin * refiner.replicate_count
    equal = [each for each in every if penalised_deviance(each) < bound]
    first, *rest = sorted(equal, key=lambda each: (len(each.model.values), penalised_deviance(each)))
    return (first if first is current else refiner.refined(first), [each.model.terms[place] for each in rest])


def with_term_at(model: Model, place: int, term: Term) -> Model:
    """Put a term in a place (-1: the last); its parameters are free unless they are nominal."""
    place %= len(model.terms)
    left, fixed = _terms_without(model, place)
    first = sum(len(each.values) for each in left[:place])
    count = len(term.values)
    there = frozenset(
        first + k
        for k, (value, parameter) in enumerate(zip(term.values, term.parameters, strict=True))
        if value == parameter.nominal
    )
    moved = frozenset(k if k < first else k + count for k in fixed)
    changed = replace(model, terms=(*left[:place], term, *left[place:]), fixed=moved | there)
    return replace(changed, leg_s=fine_leg_s(changed))


def backward_elimination(refiner: Refiner, fitted: Fitted) -> tuple[Fitted, list[int]]:
    """Backward elimination: the model without superfluous terms, and which ones remain.

    A law at intervals beside a constant may stand for the constant in all other times: without the constant
    its complement is tried as well.
    """
    kept = list(range(len(fitted.model.terms)))
    while len(kept) > 1:
        places, models, jacobians = [], [], []
        for place in range(len(kept)):
            terms, fixed = _terms_without(fitted.model, place)
            less = replace(fitted.model, terms=terms, fixed=fixed)
            jacobian = np.delete(fitted.jacobian, _values_of(fitted.model, place), axis=2)
            complements = _complements(less, jacobian, place, fitted.model.terms[place])
            for model, derivative in [(less, jacobian), *complements]:
                places.append(place)
                models.append(model)
                jacobians.append(derivative)
        start_fits = evaluate(models, jacobians, refiner.swims, refiner.rows)
        near = [k for k, each in enumerate(start_fits) if each.deviance < fitted.deviance + FAR_OFF]
        fits = fit_on([start_fits[k] for k in near], refiner.swims, refiner.rows, 2)
        dearer = [
            each.deviance
            - fitted.deviance
            - refiner.replicate_count
            * (EFFECT_PENALTY + PARAMETER_PENALTY * (free_count(fitted) - free_count(each)))
            for each in fits
        ]
        if min(dearer, default=0.0) >= 0.0:
            break
        best = int(np.argmin(dearer))
        kept.pop(places[near[best]])
        fitted = refiner.refined(fits[best])
    return fitted, kept


def _complements(model: Model, jacobian: Float64, before: int, gone: Term) -> list[tuple[Model, Float64]]:
    """The model with each of its laws at intervals replaced by its complement.

    The complement acts with the opposite sign in the remaining part of each cycle.

    Args:
        model: the model without a term.
        jacobian: derivatives by its parameters.
        before, gone: index of the removed term, and the term. A constant delay of the fixes before a law on
            fixes shifts the times at which that law acts.
    """
    found = []
    known = dict(zip((p.name for p in gone.parameters), gone.values, strict=True))
    later_s = known["delay_s"] if gone.name == "fix_latency" else 0.0
    for place, term in enumerate(model.terms):
        names = [parameter.name for parameter in term.parameters]
        if not {"cycle", "middle", "share"} <= set(names):
            continue
        values, moved, first = np.array(term.values), jacobian.copy(), _values_of(model, place).start
        cycle, middle, share = (names.index(name) for name in ("cycle", "middle", "share"))
        turned = [k for k in range(len(names)) if k not in (cycle, middle)]
        values[turned] *= -1.0
        values[share] += 1.0
        values[middle] += 0.5 * values[cycle]
        if dict(term.table)["on"] == "fix" and place >= before:
            values[middle] -= later_s
        moved[:, :, [first + k for k in turned]] *= -1.0
        moved[:, :, first + cycle] -= 0.5 * moved[:, :, first + middle]
        terms = (*model.terms[:place], term.at(values), *model.terms[place + 1 :])
        found.append((replace(model, terms=terms), moved))
    return found


def superfluous_term(fitted: Fitted, folds: Int64, swims: Sequence[Segments]) -> int | None:
    """Which of several terms does not improve the prediction of held-out parts of the training runs.

    By the cross-validated log density of the ends of periods (``steps.cross_fitted``), with and without each:
    the term with the least gain, if the interval of that gain reaches zero. None if every term is needed.

    Args:
        fitted: with derivatives by all its parameters.
        folds: (n,) of the periods that are used; see ``search.folds_of``.
        swims: the training runs.
    """
    model = fitted.model
    if len(model.terms) < 2:
        return None
    residuals, jacobian = fitted.residuals[:, -3:], fitted.jacobian[:, -3:, :]
    damping = 1e-6 * residuals.size / model.range**2
    whole = cross_fitted(residuals, jacobian, *step_bounds(model), damping, folds)
    wider, gains = np.sqrt(replicate_count(swims)), list[tuple[float, float]]()
    for place in range(len(model.terms)):
        back, less = _term_to_nominal(model, place)
        scores = cross_fitted(residuals + jacobian @ back, jacobian, *step_bounds(less), damping, folds)
        each = [(whole - scores)[folds == label] for label in np.unique(folds)]
        low, _ = mean_interval(each, np.random.default_rng(0))
        value = float((whole - scores).mean())
        gains.append((value, value - wider * (value - low)))
    place = min(range(len(gains)), key=lambda k: gains[k][0])
    return place if gains[place][1] <= 0.0 else None


def stability(fitted: Fitted, rows: Bool, swims: Sequence[Segments], searched: bool) -> list[float]:
    """Stability selection: the share of resamples of the runs in which each term would have been taken.

    Blocks of periods of each run are drawn with replacement, and the linearised model is fitted to each
    resample with and without the term. The term is taken where the deviance falls by its penalty. Source:
    Meinshausen, Buehlmann 2010.

    Args:
        fitted: with derivatives by all its parameters.
        rows: which periods of the runs ``fitted.residuals`` has.
        swims: the training runs.
        searched: its terms were taken one by one; else jointly, and they share the penalty of one effect.
    """
    model = fitted.model
    damping = 1e-6 * fitted.residuals.size / model.range**2
    runs = np.repeat(np.arange(len(swims)), [len(swim.start_s) for swim in swims])[rows]
    base = EFFECT_PENALTY / (1 if searched else max(len(model.terms), 1))
    owed = [
        base + PARAMETER_PENALTY * len(set(_values_of(model, place)) - model.fixed)
        for place in range(len(model.terms))
    ]
    taken = np.zeros(len(model.terms))
    rng = np.random.default_rng(0)
    for _ in range(DRAWS):
        drawn = drawn_periods(runs, rng)
        residuals, jacobian = fitted.residuals[drawn], fitted.jacobian[drawn]
        _, whole = linearised_optimum(residuals, jacobian, *step_bounds(model), damping)
        for place in range(len(model.terms)):
            back, less = _term_to_nominal(model, place)
            _, deviance = linearised_optimum(
                residuals + jacobian @ back, jacobian, *step_bounds(less), damping
            )
            taken[place] += deviance - whole > replicate_count(swims) * owed[place]
    return [float(share) for share in taken / DRAWS]


def _term_to_nominal(model: Model, place: int) -> tuple[Float64, Model]:
    """The step that takes a term's parameters to nominal, and the model with them fixed."""
    gone = _values_of(model, place)
    back = np.zeros(len(model.values))
    for k, parameter in zip(gone, model.terms[place].parameters, strict=True):
        back[k] = parameter.nominal - model.values[k]
    return back, replace(model, fixed=model.fixed | frozenset(gone))


def without(model: Model, place: int) -> Model:
    """The model without one of its terms."""
    terms, fixed = _terms_without(model, place)
    return replace(model, terms=terms, fixed=fixed)


def _values_of(model: Model, place: int) -> range:
    """Indices of a term's values in ``Model.values``."""
    first = sum(len(term.values) for term in model.terms[:place])
    return range(first, first + len(model.terms[place].values))


def _terms_without(model: Model, place: int) -> tuple[tuple[Term, ...], frozenset[int]]:
    """A model's other terms, and which of their values are fixed."""
    gone = _values_of(model, place)
    fixed = frozenset(k if k < gone.start else k - len(gone) for k in model.fixed if k not in gone)
    return model.terms[:place] + model.terms[place + 1 :], fixed
