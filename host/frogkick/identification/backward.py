"""Effects that were taken one by one, revised together: swaps, backward elimination, stability selection.

The first effect that a search takes may stand for several that it finds later.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.identification.batching import spent_up
from frogkick.identification.bootstrap import drawn_periods, mean_interval
from frogkick.identification.fit import (
    CONFOUNDED_MARGIN,
    EFFECT_PENALTY,
    PARAMETER_PENALTY,
    Fitted,
    Model,
    fit_many,
    step_bounds,
)
from frogkick.identification.refine import STEPS_MAX, from_grids, refined, simpler_model, with_fewer_free
from frogkick.identification.segments import Data
from frogkick.identification.steps import cross_fitted, linearised_optimum
from frogkick.identification.terms import Term

DRAWS = 50  # resamples of the runs' periods for the stability selection

EQUIVALENT = ("limb_wear all", "fix_latency")
"""All limbs late and all fixes late give the same run, but for its first stroke. The second is simpler."""

EQUIVALENT_MARGIN = 4.0 * CONFOUNDED_MARGIN
"""Those two may differ by more: by 22 in world 20010 of ``study verdicts``, under the noise of one of
them."""

FAR_OFF = 300.0
"""A term is not superfluous if the deviance rises by more than this without it, before a refit."""


def revise(
    data: Data,
    current: Fitted,
    confounded: Sequence[list[Term]],
    runners_up: Sequence[Sequence[Fitted]],
    single_effect_fits: Sequence[Fitted] = (),
) -> tuple[Fitted, list[list[Term]]]:
    """Revise a model of several terms: swap each for a better runner-up, eliminate what is superfluous.

    Where more than two terms remain, two of the best single effects replace them if they do as well. Returned
    with the model are the terms that are now confounded with each of its own.

    Args:
        confounded: for each term those that were confounded with it when it was taken.
        runners_up: for each term the models that were nearly as good then, with the one that was taken.
        single_effect_fits: models of one term each, the best of the first iteration.
    """
    found = [list(others) for others in confounded]
    for place in range(len(found) - 1):  # the last term was chosen beside all others
        if spent_up():
            break
        near = [each.model.terms[-1] for each in runners_up[place]]
        current, found[place] = swap_step(data, current, place, near)
    current, kept = backward_elimination(data, current)
    current = with_fewer_free(current, data, whole=True)
    found = [found[place] for place in kept]
    if len(kept) > 2 and not spent_up() and (pair := _pair(data, current, single_effect_fits)) is not None:
        current, kept = backward_elimination(data, pair[0])
        current, found = with_fewer_free(current, data, whole=True), [pair[1][place] for place in kept]
    return from_grids(current, data), found


def _pair(
    data: Data, current: Fitted, single_effect_fits: Sequence[Fitted]
) -> tuple[Fitted, list[list[Term]]] | None:
    """Two of the best single effects that do as well as a model's several terms; None if no two do.

    Terms that were taken one by one may together imitate a single effect that was not the best at first: a
    delay of each limb imitates late fixes. The terms that are confounded with each of the two are returned as
    well."""
    model, starts = current.model, list[Model]()
    for one, other in combinations((each.model for each in single_effect_fits), 2):
        fixed = one.fixed | {len(one.values) + k for k in other.fixed}
        both = replace(model, terms=(*one.terms, *other.terms), fixed=frozenset(fixed))
        both = replace(both, leg_s=both.fine_leg_s)
        # Alone, the delay of a worn limb takes up the influence of the other effect.
        starts += [both] if (plain := _with_grid_at_nominal(both)) is both else [both, plain]
    fits = fit_many(starts, data, STEPS_MAX) if starts else []
    good = [each for each in equally_good(fits, data) if each.deviance < current.deviance + FAR_OFF]
    if not good:
        return None
    first, *rest = good
    best = refined(first, data)
    if _total_penalised_deviance(data, best) >= _total_penalised_deviance(data, current):
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


def equally_good(fits: Sequence[Fitted], data: Data, margin: float = CONFOUNDED_MARGIN) -> list[Fitted]:
    """Those of several fits at one noise that are confounded with the best one, the simplest first."""
    bound = min((each.penalised_deviance for each in fits), default=0.0) + margin * data.replicate_count
    equal = [each for each in fits if each.penalised_deviance < bound]
    return sorted(equal, key=lambda each: (len(each.model.values), each.penalised_deviance))


def _with_grid_at_nominal(model: Model) -> Model:
    """The model with all grid parameters fixed at nominal, where their terms have other free ones."""
    values, back = model.values, set[int]()
    for place in range(len(model.terms)):
        free = set(model.indices(place)) - model.fixed
        tried = {k for k in free if model.parameters[k].grid}
        if tried < free:
            back |= tried
            for k in tried:
                values[k] = model.parameters[k].nominal
    return replace(model.with_values(values), fixed=model.fixed | back) if back else model


def _total_penalised_deviance(data: Data, fitted: Fitted) -> float:
    """Deviance plus the penalties of effects and free parameters."""
    effects = EFFECT_PENALTY * len(fitted.model.terms)
    return fitted.deviance + data.replicate_count * (effects + PARAMETER_PENALTY * fitted.model.free_count)


def resolve_equivalent(
    data: Data, current: Fitted, confounded: Sequence[list[Term]], candidates: Sequence[Term]
) -> tuple[Fitted, list[list[Term]]]:
    """The model with the simpler of two equivalent effects (EQUIVALENT), where it has either.

    A law that amounts to the wear of a limb is replaced by it. Also what is confounded with each term, the
    other of the two included. ``candidates`` is the catalogue.
    """
    known, found = {term.title: term for term in candidates}, [list(others) for others in confounded]
    for place, term in enumerate(current.model.terms):
        if (worn := _as_wear(term, known)) is not None:
            (plain,) = fit_many([current.model.with_term_at(place, worn)], data, STEPS_MAX)
            if (
                plain.penalised_deviance
                < current.penalised_deviance + CONFOUNDED_MARGIN * data.replicate_count
            ):
                current = refined(plain, data)
                found[place] = [each for each in found[place] if _as_wear(each, known) is None]
    for place, term in enumerate(current.model.terms):
        if term.title not in EQUIVALENT or not set(EQUIVALENT) <= known.keys():
            continue
        other = known[EQUIVALENT[1 - EQUIVALENT.index(term.title)]]
        if other.title in [each.title for each in found[place]]:
            continue
        late_s = term.values[[p.name for p in term.parameters].index("delay_s")]
        values = [late_s if p.name == "delay_s" else p.nominal for p in other.parameters]
        current, rivals = swap_step(data, current, place, [other.at(values)], EQUIVALENT_MARGIN)
        found[place] += rivals
    return current, found


def _as_wear(law: Term, known: Mapping[str, Term]) -> Term | None:
    """The wear of a limb that a law on its strokes amounts to; None if it does more than change the gain.

    Of a limb that is weaker at all times, a law by heading or in rhythm is chosen where its further strengths
    take up what an effect does that is found later. Beside that one they vanish.
    """
    table, values = dict(law.table), dict(zip((p.name for p in law.parameters), law.values, strict=True))
    worn = known.get(f"limb_wear {table.get('limb')}")
    if law.name != "law" or table["on"] != "stroke" or "here" not in values or worn is None:
        return None
    strengths = {p.name for p in law.parameters if p.nominal == 0.0} - {"here"}
    if worn.name != "limb_wear" or any(values[name] for name in strengths):
        return None
    gain = 1.0 + values["here"]
    at = worn.at([gain if p.name == "gain" else p.nominal for p in worn.parameters])
    return at if gain in at.values else None


def swap_step(
    data: Data, current: Fitted, place: int, rivals: Sequence[Term], margin: float = CONFOUNDED_MARGIN
) -> tuple[Fitted, list[Term]]:
    """Swap step: the best of some terms in one place, and those that are confounded with it."""
    taken = {term.title for term in current.model.terms}
    others = {term.title: term for term in rivals if term.title not in taken}
    if not others:
        return current, []
    starts = [current.model.with_term_at(place, term) for term in others.values()]
    fits = fit_many(starts, data, STEPS_MAX)
    first, *rest = equally_good([current, *fits], data, margin)
    return (first if first is current else refined(first, data), [each.model.terms[place] for each in rest])


def backward_elimination(data: Data, fitted: Fitted) -> tuple[Fitted, list[int]]:
    """Backward elimination: the model without superfluous terms, and which ones remain.

    A law at intervals beside a constant may stand for the constant in all other times: without the constant
    its complement is tried as well.
    """
    kept = list(range(len(fitted.model.terms)))
    while len(kept) > 1 and not spent_up():
        places, tries, saved = list[int](), list[tuple[Model, Float64]](), list[float]()
        for place, term in enumerate(fitted.model.terms):
            less = fitted.model.without(place)
            jacobian = np.delete(fitted.jacobian, fitted.model.indices(place), axis=2)
            for each in [(less, jacobian), *_complements(less, jacobian, place, term)]:
                freed = fitted.model.free_count - each[0].free_count
                places.append(place)
                tries.append(each)
                saved.append(data.replicate_count * (EFFECT_PENALTY + PARAMETER_PENALTY * freed))
        simpler = simpler_model(fitted, tries, saved, FAR_OFF, data)
        if simpler is None:
            break
        kept.pop(places[simpler[1]])
        fitted = refined(simpler[0], data)
    return fitted, kept


def _complements(model: Model, jacobian: Float64, before: int, gone: Term) -> list[tuple[Model, Float64]]:
    """The model with each of its laws at intervals replaced by its complement.

    The complement acts with the opposite sign in the remaining part of each cycle. ``gone`` is the term that
    was removed at ``before``: a delay of the fixes before a law on fixes shifts the times at which that acts.
    """
    found = []
    known = dict(zip((p.name for p in gone.parameters), gone.values, strict=True))
    later_s = known["delay_s"] if gone.name == "fix_latency" else 0.0
    for place, term in enumerate(model.terms):
        names = [parameter.name for parameter in term.parameters]
        if not {"cycle", "middle", "share"} <= set(names):
            continue
        values, moved, first = np.array(term.values), jacobian.copy(), model.indices(place).start
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


def superfluous_term(fitted: Fitted, data: Data) -> int | None:
    """Which of several terms does not improve the prediction of held-out parts of the training runs.

    By the cross-validated log density of the ends of periods (``steps.cross_fitted``), with and without each:
    the term with the least gain, if the interval of that gain reaches zero. None if every term is needed, or
    the runs have one fold. The fit has derivatives by all its parameters.
    """
    model, folds = fitted.model, data.folds
    if len(model.terms) < 2 or len(np.unique(folds)) < 2:
        return None
    residuals, jacobian = fitted.residuals[:, -3:], fitted.jacobian[:, -3:, :]
    damping = 1e-6 * residuals.size / model.reach**2
    whole = cross_fitted(residuals, jacobian, *step_bounds(model), damping, folds)
    wider, gains = np.sqrt(data.replicate_count), list[tuple[float, float]]()
    for place in range(len(model.terms)):
        back, less = _term_to_nominal(model, place)
        scores = cross_fitted(residuals + jacobian @ back, jacobian, *step_bounds(less), damping, folds)
        each = [(whole - scores)[folds == label] for label in np.unique(folds)]
        low, _ = mean_interval(each, np.random.default_rng(0))
        value = float((whole - scores).mean())
        gains.append((value, value - wider * (value - low)))
    place = min(range(len(gains)), key=lambda k: gains[k][0])
    return place if gains[place][1] <= 0.0 else None


def stability(fitted: Fitted, data: Data, searched: bool) -> list[float]:
    """Stability selection: the share of resamples of the runs in which each term would have been taken.

    Blocks of periods of each run are drawn with replacement, and the linearised model is fitted to each
    resample with and without the term. The term is taken where the deviance falls by its penalty. Source:
    Meinshausen, Buehlmann 2010.

    Args:
        searched: its terms were taken one by one; else jointly, and they share the penalty of one effect.
    """
    model = fitted.model
    damping = 1e-6 * fitted.residuals.size / model.reach**2
    base = EFFECT_PENALTY / (1 if searched else max(len(model.terms), 1))
    owed = [
        base + PARAMETER_PENALTY * len(set(model.indices(place)) - model.fixed)
        for place in range(len(model.terms))
    ]
    taken = np.zeros(len(model.terms))
    rng = np.random.default_rng(0)
    for _ in range(DRAWS):
        drawn = drawn_periods(data.run, rng)
        residuals, jacobian = fitted.residuals[drawn], fitted.jacobian[drawn]
        _, whole = linearised_optimum(residuals, jacobian, *step_bounds(model), damping)
        for place in range(len(model.terms)):
            back, less = _term_to_nominal(model, place)
            _, deviance = linearised_optimum(
                residuals + jacobian @ back, jacobian, *step_bounds(less), damping
            )
            taken[place] += deviance - whole > data.replicate_count * owed[place]
    return [float(share) for share in taken / DRAWS]


def _term_to_nominal(model: Model, place: int) -> tuple[Float64, Model]:
    """The step that takes a term's parameters to nominal, and the model with them fixed."""
    gone = model.indices(place)
    back = np.zeros(len(model.values))
    for k, parameter in zip(gone, model.terms[place].parameters, strict=True):
        back[k] = parameter.nominal - model.values[k]
    return back, replace(model, fixed=model.fixed | frozenset(gone))
