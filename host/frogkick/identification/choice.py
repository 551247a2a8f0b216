"""Whether effects are searched one by one or taken jointly from a robot that was calibrated before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from frogkick.core.progress import TellStage
from frogkick.identification.backward import stability, superfluous_term
from frogkick.identification.batching import spent_up
from frogkick.identification.calibrated import best_end_deviance, calibrated_starts, end_deviance, refitted
from frogkick.identification.fit import EFFECT_PENALTY, PARAMETER_PENALTY, Fitted, Model, derivatives, fit
from frogkick.identification.jumps import Jumps
from frogkick.identification.laws import Laws
from frogkick.identification.misfires import misfires_of, without_failed
from frogkick.identification.responses import Responses, responses_of
from frogkick.identification.screening import sensitivities
from frogkick.identification.search import Found, nominal_fit, search
from frogkick.identification.segments import Data, Segments, part_of
from frogkick.identification.terms import Term
from frogkick.identification.verdict import FOUND, FOUND_LAW, NOTHING, Scored, intervals, scored, verdict_of
from frogkick.robot import Robot

STABLE = 0.8  # share of resamples of the training runs in which an effect must be selected to be named

SEARCHED_MOST = 200
"""From this many periods on, a calibrated start that explains much is tried before a whole search."""

AT_BOUND = 1e-3  # share of a parameter's range that counts as its bound

PART, PART_EFFECTS = 60, 2
"""Periods and effects of a search beside a calibrated start: more effects are left to the calibrated start,
and a search for them would take many minutes."""

FAR, NEARER = (0.006, 0.07), 0.6
"""A model with errors above FAR (m, rad) lacks more than one or two effects. A calibrated start that leaves
no more than the share NEARER of both errors is then preferred to a search that does not explain
everything."""


def found_in(
    train: Sequence[Segments],
    robot: Robot,
    candidates: Sequence[Term],
    progress: TellStage,
    measured: bool = True,
) -> Found:
    """The result of a search, or the effects of a calibrated robot of the same body, fitted to these runs.

    A search that leaves only noise is accepted, and so is a calibrated start that does. The size of the error
    alone does not decide which of the two to try: a wall in the pool causes errors as large as those of a
    hull that differs from its drawing.
    """
    known = calibrated_starts(robot)
    data, fitted = nominal_fit(train, robot)
    nominal = Found(data, fitted, fitted)
    far = all(value > least for value, least in zip(_scored(nominal).before.pair, FAR, strict=True))
    many = int(data.rows.sum()) > SEARCHED_MOST
    found = None
    if not known or not (far or many):
        found = search(data, fitted, candidates, progress)
        if not known or _verdict(found) in (FOUND, NOTHING):
            return found
    calibrated = _calibrated(nominal, list(known.values()), progress, measured)
    if calibrated is None:
        return found or search(data, fitted, candidates, progress)
    if _verdict(calibrated) == FOUND:
        return calibrated
    if found is None:
        both = _scored(calibrated)
        pairs = zip(both.before.pair, both.after.pair, strict=True)
        if many or all(left <= NEARER * plain for plain, left in pairs):
            found = _search_in_part(nominal, robot, candidates, progress)
            return found if _verdict(found) == FOUND else calibrated
        found = search(data, fitted, candidates, progress)
    dear = PARAMETER_PENALTY * calibrated.fitted.model.free_count
    searched = best_end_deviance(found.fitted, train)
    return calibrated if end_deviance(calibrated.fitted.rollouts, train) + dear < searched else found


def discovered(found: Found, candidates: Sequence[Term], robot: Robot, progress: TellStage) -> Found:
    """Search for limbs that misfire and for laws, if the catalogue leaves more than noise.

    The search is also made if the catalogue explains everything with a parameter at a bound, because a bound
    is seldom the true value. Limbs that misfire come first, because random failures resemble many other
    effects. If they explain more than the catalogue, the rest is searched in the runs without the failed
    strokes. The result with the least penalised deviance is returned."""
    if _verdict(found) in (FOUND, NOTHING) and not _at_bound(found.fitted.model):
        return found
    nominal, data = found.nominal, found.data
    if spent_up():
        return found
    responses = responses_of(nominal, data)
    results = [found]
    misfires = misfires_of(nominal, data, responses.idle)
    if misfires is not None and misfires.patterned(responses.fired):
        misfires = None  # a limb that breaks fails as well, but not by chance
    if misfires is not None and misfires.deviance < _penalised(found):
        fired, baseline = nominal_fit(without_failed(data.swims, misfires), robot)
        if _verdict(Found(fired, baseline, baseline)) == NOTHING:
            return Found(data, nominal, nominal, misfires=misfires, responses=responses)
        beside = search(fired, baseline, candidates, progress)
        if _verdict(beside) not in (FOUND, NOTHING):
            own = responses_of(beside.nominal, beside.data)
            beside = min(beside, _with_laws(beside, own, candidates, robot, progress), key=_penalised)
        (fitted,) = derivatives([beside.fitted.model], data)
        misfires = misfires_of(fitted, data)
        results.append(replace(beside, data=data, nominal=nominal, fitted=fitted, misfires=misfires))
    else:
        results.append(_with_laws(found, responses, candidates, robot, progress))
        best = min(results, key=_penalised)
        if best.fitted.model.terms and _verdict(best) not in (FOUND, FOUND_LAW):
            beside_best = misfires_of(best.fitted, data)
            if beside_best is not None and not beside_best.patterned(responses.fired):
                results.append(replace(best, misfires=beside_best))
    return replace(min(results, key=_penalised), responses=responses)


def _at_bound(model: Model) -> bool:
    """Whether a parameter is at a bound that is not its nominal value."""
    return any(
        value != p.nominal and min(value - p.low, p.high - value) <= AT_BOUND * (p.high - p.low)
        for p, value in zip(model.parameters, model.values.tolist(), strict=True)
    )


def in_all_fixes(found: Found, raw: Sequence[Segments], robot: Robot) -> Found | None:
    """The result in runs with the fixes that seemed to jump; None where more than noise remains there.

    Fixes that are late from time to time seem to jump as well. Effects that explain all fixes make jumps
    superfluous.
    """
    if not found.fitted.model.terms or found.misfires is not None:
        return None
    data, nominal = nominal_fit(raw, robot)
    fitted = _refitted(found.fitted.model, data)
    again = replace(found, data=data, nominal=nominal, fitted=fitted, sensitivities=[])
    if _verdict(again) not in (FOUND, FOUND_LAW):
        return None
    return replace(again, responses=responses_of(nominal, data))


def with_misfires(found: Found) -> Found:
    """The result with laws for the limbs that misfire beside its effects; see ``Effect.likeliest``."""
    if found.misfires is None:
        return found
    misfires = found.misfires
    if found.fitted.model.terms != misfires.base.model.terms:
        again = misfires_of(found.fitted, found.data)
        if again is None:
            return replace(found, misfires=None)
        misfires = again
    model = replace(found.fitted.model, terms=(*found.fitted.model.terms, *misfires.terms))
    (fitted,) = derivatives([model], found.data)
    found = _with_chances(found, fitted, misfires.confounded_with, misfires.stability)
    return replace(found, misfires=misfires)


def with_jumps(found: Found, jumps: Sequence[Jumps], raw: Sequence[Segments], robot: Robot) -> Found:
    """The result with laws of fixes that jump, compared with the nominal model on the runs with all fixes.

    The search was made without the fixes that jumped.
    """
    if not jumps:
        return found
    fitted, terms = found.fitted, [each.term for each in jumps]
    unmoved = np.zeros((*fitted.residuals.shape, sum(len(term.values) for term in terms)))
    fitted = replace(
        fitted,
        model=replace(fitted.model, terms=(*fitted.model.terms, *terms)),
        jacobian=np.concatenate([fitted.jacobian, unmoved], axis=2),
    )
    found = _with_chances(found, fitted, [[] for _ in jumps], [1.0 for _ in jumps])
    return replace(found, nominal=nominal_fit(raw, robot)[1], jumps=tuple(jumps))


def _with_chances(
    found: Found, fitted: Fitted, confounded_with: Sequence[list[str]], stability: Sequence[float]
) -> Found:
    """The result with a fit that has more terms: laws of chance, which no experiment is planned for."""
    rivals = found.rivals or [[] for _ in found.fitted.model.terms]
    return replace(
        found,
        fitted=fitted,
        confounded_with=[*found.confounded_with, *confounded_with],
        rivals=[*rivals, *([] for _ in stability)],
        stability=[*found.stability, *stability],
    )


def _with_laws(
    found: Found, responses: Responses, candidates: Sequence[Term], robot: Robot, progress: TellStage
) -> Found:
    """The result of a search in the catalogue and the grammar of laws."""
    data, nominal, known = found.data, found.nominal, found.sensitivities
    laws = Laws(responses, data.swims, robot, progress)
    if not known:
        known = sensitivities(nominal.model, candidates, data, lambda _done, _whole: None)
    started = [column.term for column in known]
    return search(data, nominal, started, progress, columns=known, laws=laws)


def _penalised(found: Found) -> float:
    """The deviance, penalised by the number of effects and of free parameters."""
    fitted = found.fitted
    plain = fitted.deviance if found.misfires is None else found.misfires.deviance
    return plain + EFFECT_PENALTY * len(fitted.model.terms) + PARAMETER_PENALTY * fitted.model.free_count


def _calibrated(
    nominal: Found, known: Sequence[Sequence[Term]], progress: TellStage, measured: bool = True
) -> Found | None:
    """The calibrated start that fits best; None if all explain too little for their number of effects."""
    data, taken = nominal.data, list[Fitted]()
    for done, terms in enumerate(known):
        progress("measured robots", done, len(known))
        if (fitted := refitted(nominal.fitted, terms, data, measured)) is not None:
            taken.append(fitted)
    best = min(taken, key=lambda fitted: end_deviance(fitted.rollouts, data.swims), default=None)
    if best is None:
        return None
    return replace(nominal, fitted=best, confounded_with=[[] for _ in best.model.terms])


def _search_in_part(nominal: Found, robot: Robot, candidates: Sequence[Term], progress: TellStage) -> Found:
    """A search in a part of the periods, the same share of each run; its result is fitted to all of them."""
    data = nominal.data
    part = nominal_fit(part_of(data.swims, PART), robot)
    found = search(*part, candidates, progress, most=PART_EFFECTS)
    fitted = nominal.fitted
    if found.fitted.model.terms:
        fitted = _refitted(found.fitted.model, data)
    return replace(found, data=data, nominal=nominal.fitted, fitted=fitted, sensitivities=[])


def pruned(found: Found, progress: TellStage) -> Found:
    """The result without effects that are superfluous or unstable in the training runs.

    Backward elimination, one effect at a time; the test runs have no part in it. Effects of a calibrated
    start are one choice and stay together. An effect is superfluous if held-out parts are predicted as well
    without it, and unstable if it is selected in fewer than STABLE of the resamples. A law is also
    superfluous if the intervals of all its strengths contain 0. All this is judged by derivatives; then the
    model without the effect is fitted again by simulation."""
    data = found.data
    if not found.iterations:
        return replace(found, stability=stability(found.fitted, data, False))
    while True:
        stable = stability(found.fitted, data, True)
        place = superfluous_term(found.fitted, data)
        if place is None and stable and min(stable) < STABLE:
            place = stable.index(min(stable))
        if place is None:
            place = _law_of_no_strength(found)
        if place is None:
            return replace(found, stability=stable)
        count = len(found.fitted.model.terms)
        progress("effects held out", count, count + 1)
        less = found.fitted.model.without(place)
        fitted = _refitted(less, data) if less.terms else found.nominal
        kept = [k for k in range(count) if k != place]
        rivals = [found.rivals[k] for k in kept] if found.rivals else []
        found = replace(
            found, fitted=fitted, confounded_with=[found.confounded_with[k] for k in kept], rivals=rivals
        )


def _refitted(model: Model, data: Data) -> Fitted:
    """A model fitted to other runs, or with fewer terms, with derivatives by all its parameters."""
    return derivatives([fit(model, data, steps_max=2).model], data)[0]


def _law_of_no_strength(found: Found) -> int | None:
    """Index of a law whose strengths all have intervals that contain 0; None if there is none."""
    for place, (term, row) in enumerate(
        zip(found.fitted.model.terms, intervals(found.fitted, found.data), strict=True)
    ):
        strengths = [k for k, p in enumerate(term.parameters) if p.nominal == 0.0 and p.low < 0.0]
        if term.name == "law" and strengths and all(row[k].contains(0.0) for k in strengths):
            return place
    return None


def _verdict(found: Found) -> str:
    both = _scored(found)
    return verdict_of(found, both, both)


def _scored(found: Found) -> Scored:
    return scored(found, found.data.swims, found.nominal.rollouts, found.fitted.rollouts)
