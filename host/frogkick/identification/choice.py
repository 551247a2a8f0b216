"""Whether effects are searched one by one or taken jointly from a robot that was calibrated before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from frogkick.core.poses import PredictionError
from frogkick.core.progress import TellStage
from frogkick.identification.backward import stability, superfluous_term, without
from frogkick.identification.calibrated import best_end_deviance, calibrated_starts, end_deviance, refitted
from frogkick.identification.fit import Model, derivatives, fit
from frogkick.identification.jumps import Jumps
from frogkick.identification.laws import Laws
from frogkick.identification.misfires import misfires_of, without_failed
from frogkick.identification.penalty import EFFECT_PENALTY, PARAMETER_PENALTY
from frogkick.identification.responses import Responses, responses_of
from frogkick.identification.screening import sensitivities
from frogkick.identification.search import Baseline, Found, folds_of, nominal_fit, search
from frogkick.identification.segments import Segments, part_of
from frogkick.identification.terms import Term, catalogue
from frogkick.identification.verdict import FOUND, FOUND_LAW, NOTHING, Scored, intervals, scored, verdict_of
from frogkick.robot import Robot

STABLE = 0.8
"""Share of resamples of the training runs in which an effect must be selected to be named."""

SEARCHED_MOST = 200
"""From this many periods on, a calibrated start that explains much is tried before a whole search."""

AT_BOUND = 1e-3
"""Share of a parameter's range that counts as its bound."""

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

    Raises:
        InputError: no period can be used.
    """
    known = calibrated_starts(robot)
    baseline = nominal_fit(train, robot)
    nominal = Found(baseline[2], baseline[2], [], baseline[1], [])
    far = all(value > least for value, least in zip(_pair(_scored(nominal, train).before), FAR, strict=True))
    many = int(baseline[1].sum()) > SEARCHED_MOST
    found = None
    if not known or not (far or many):
        found = search(train, robot, candidates, progress, baseline)
        if not known or _verdict(found, train) in (FOUND, NOTHING):
            return found
    relative = _relative(baseline, list(known.values()), train, progress, measured)
    if relative is None:
        return found or search(train, robot, candidates, progress, baseline)
    if _verdict(relative, train) == FOUND:
        return relative
    if found is None:
        both = _scored(relative, train)
        pairs = zip(_pair(both.before), _pair(both.after), strict=True)
        if many or all(left <= NEARER * plain for plain, left in pairs):
            found = _search_in_part(baseline, train, robot, candidates, progress)
            return found if _verdict(found, train) == FOUND else relative
        found = search(train, robot, candidates, progress, baseline)
    model = relative.fitted.model
    dear = PARAMETER_PENALTY * (len(model.values) - len(model.fixed))
    searched = best_end_deviance(found.fitted, train)
    return relative if end_deviance(relative.fitted.rollouts, train) + dear < searched else found


def discovered(found: Found, train: Sequence[Segments], robot: Robot, progress: TellStage) -> Found:
    """Search for limbs that misfire and for laws, if the catalogue leaves more than noise.

    The search is also made if the catalogue explains everything with a parameter at a bound, because a bound
    is seldom the true value. Limbs that misfire come first, because random failures resemble many other
    effects. If they explain more than the catalogue, the rest is searched in the runs without the failed
    strokes. The result with the least penalised deviance is returned."""
    if _verdict(found, train) in (FOUND, NOTHING) and not _at_bound(found.fitted.model):
        return found
    nominal, rows = found.nominal, found.rows
    responses = responses_of(nominal, train, rows)
    results = [found]
    misfires = misfires_of(nominal, train, rows, responses.idle)
    if misfires is not None and misfires.patterned(responses.fired):
        misfires = None  # a limb that breaks fails as well, but not by chance
    if misfires is not None and misfires.deviance < _penalised(found):
        fired = without_failed(train, misfires)
        baseline = nominal_fit(fired, robot)
        plain = Found(baseline[2], baseline[2], [], baseline[1], [])
        if _verdict(plain, fired) == NOTHING:
            return Found(nominal, nominal, [], rows, [], misfires=misfires, responses=responses)
        beside = search(fired, robot, catalogue(robot), progress, baseline)
        if _verdict(beside, fired) not in (FOUND, NOTHING):
            own = responses_of(beside.nominal, fired, beside.rows)
            beside = min(beside, _with_laws(beside, own, fired, robot, progress), key=_penalised)
        (fitted,) = derivatives([beside.fitted.model], train, rows)
        misfires = misfires_of(fitted, train, rows)
        results.append(replace(beside, nominal=nominal, fitted=fitted, rows=rows, misfires=misfires))
    else:
        results.append(_with_laws(found, responses, train, robot, progress))
        best = min(results, key=_penalised)
        if best.fitted.model.terms and _verdict(best, train) not in (FOUND, FOUND_LAW):
            beside_best = misfires_of(best.fitted, train, rows)
            if beside_best is not None and not beside_best.patterned(responses.fired):
                results.append(replace(best, misfires=beside_best))
    return replace(min(results, key=_penalised), responses=responses)


def _at_bound(model: Model) -> bool:
    """Whether a parameter is at a bound that is not its nominal value."""
    every = [pair for term in model.terms for pair in zip(term.parameters, term.values, strict=True)]
    return any(
        value != p.nominal and min(value - p.low, p.high - value) <= AT_BOUND * (p.high - p.low)
        for p, value in every
    )


def in_all_fixes(found: Found, raw: Sequence[Segments], robot: Robot) -> Found | None:
    """The result in runs with the fixes that seemed to jump; None where more than noise remains there.

    Fixes that are late from time to time seem to jump as well. Effects that explain all fixes make jumps
    superfluous.

    Args:
        found: the result in the runs without the fixes that jumped.
        raw: the runs with all fixes.
        robot: the nominal robot.
    """
    if not found.fitted.model.terms or found.misfires is not None:
        return None
    _, rows, nominal = nominal_fit(raw, robot)
    (fitted,) = derivatives([fit(found.fitted.model, raw, rows, steps_max=2).model], raw, rows)
    again = replace(found, nominal=nominal, fitted=fitted, rows=rows, sensitivities=[])
    if _verdict(again, raw) not in (FOUND, FOUND_LAW):
        return None
    return replace(again, responses=responses_of(nominal, raw, rows))


def with_misfires(found: Found, train: Sequence[Segments]) -> Found:
    """The result with laws for the limbs that misfire beside its effects; see ``Effect.likeliest``."""
    if found.misfires is None:
        return found
    misfires = found.misfires
    if found.fitted.model.terms != misfires.base.model.terms:
        again = misfires_of(found.fitted, train, found.rows)
        if again is None:
            return replace(found, misfires=None)
        misfires = again
    model = replace(found.fitted.model, terms=(*found.fitted.model.terms, *misfires.terms))
    return replace(
        found,
        fitted=derivatives([model], train, found.rows)[0],
        confounded_with=[*found.confounded_with, *misfires.confounded_with],
        rivals=[*(found.rivals or [[] for _ in found.fitted.model.terms]), *([] for _ in misfires.limbs)],
        stability=[*found.stability, *misfires.stability],
        misfires=misfires,
    )


def with_jumps(found: Found, jumps: Jumps | None, raw: Sequence[Segments], robot: Robot) -> Found:
    """The result with the law of fixes that jump, compared with the nominal model on the runs with all fixes.

    Args:
        found: the result in the runs without the fixes that jumped.
        jumps: the jumps of these fixes; None: no fix jumped.
        raw: the runs with all fixes.
        robot: the nominal robot.
    """
    if jumps is None:
        return found
    fitted = found.fitted
    unmoved = np.zeros((*fitted.residuals.shape, len(jumps.term.values)))
    return replace(
        found,
        nominal=nominal_fit(raw, robot)[2],
        fitted=replace(
            fitted,
            model=replace(fitted.model, terms=(*fitted.model.terms, jumps.term)),
            jacobian=np.concatenate([fitted.jacobian, unmoved], axis=2),
        ),
        confounded_with=[*found.confounded_with, []],
        rivals=[*(found.rivals or [[] for _ in fitted.model.terms]), []],
        stability=[*found.stability, 1.0],
        jumps=jumps,
    )


def _with_laws(
    found: Found, responses: Responses, train: Sequence[Segments], robot: Robot, progress: TellStage
) -> Found:
    """The result of a search in the catalogue and the grammar of laws."""
    nominal, rows = found.nominal, found.rows
    laws = Laws(responses, train, robot, progress)
    known = found.sensitivities
    if not known:
        known = sensitivities(nominal.model, catalogue(robot), train, rows, lambda _done, _whole: None)
    candidates = [column.term for column in known]
    baseline = nominal.model, rows, nominal
    return search(train, robot, candidates, progress, baseline, columns=known, laws=laws)


def _penalised(found: Found) -> float:
    """The deviance, penalised by the number of effects and of free parameters."""
    model = found.fitted.model
    plain = found.fitted.deviance if found.misfires is None else found.misfires.deviance
    return (
        plain + EFFECT_PENALTY * len(model.terms) + PARAMETER_PENALTY * (len(model.values) - len(model.fixed))
    )


def _relative(
    baseline: Baseline,
    known: Sequence[Sequence[Term]],
    train: Sequence[Segments],
    progress: TellStage,
    measured: bool = True,
) -> Found | None:
    """The calibrated start that fits best; None if all explain too little for their number of effects."""
    _, rows, nominal = baseline
    fits = []
    for done, terms in enumerate(known):
        progress("measured robots", done, len(known))
        fits.append(refitted(nominal, terms, train, rows, measured))
    taken = [each for each in fits if each is not None]
    best = min(taken, key=lambda fitted: end_deviance(fitted.rollouts, train), default=None)
    return None if best is None else Found(nominal, best, [], rows, [[] for _ in best.model.terms])


def _search_in_part(
    baseline: Baseline,
    train: Sequence[Segments],
    robot: Robot,
    candidates: Sequence[Term],
    progress: TellStage,
) -> Found:
    """A search in a part of the periods, the same share of each run; its result is fitted to all of them."""
    _, rows, nominal = baseline
    found = search(part_of(train, PART), robot, candidates, progress, most=PART_EFFECTS)
    fitted = found.fitted
    if not fitted.model.terms:
        return Found(nominal, nominal, found.iterations, rows, [])
    fitted = derivatives([fit(fitted.model, train, rows, steps_max=2).model], train, rows)[0]
    return Found(nominal, fitted, found.iterations, rows, found.confounded_with, rivals=found.rivals)


def pruned(found: Found, train: Sequence[Segments], progress: TellStage) -> Found:
    """The result without effects that are superfluous or unstable in the training runs.

    Backward elimination, one effect at a time; the test runs have no part in it. Effects of a calibrated
    start are one choice and stay together. An effect is superfluous if held-out parts are predicted as well
    without it, and unstable if it is selected in fewer than STABLE of the resamples. A law is also
    superfluous if the intervals of all its strengths contain 0. All this is judged by derivatives; then the
    model without the effect is fitted again by simulation."""
    folds = folds_of(train, found.rows)
    if not found.iterations:
        return replace(found, stability=stability(found.fitted, found.rows, train, False))
    while True:
        stable = stability(found.fitted, found.rows, train, True)
        place = superfluous_term(found.fitted, folds, train) if len(np.unique(folds)) > 1 else None
        if place is None and stable and min(stable) < STABLE:
            place = stable.index(min(stable))
        if place is None:
            place = _law_of_no_strength(found)
        if place is None:
            return replace(found, stability=stable)
        count = len(found.fitted.model.terms)
        progress("effects held out", count, count + 1)
        less = without(found.fitted.model, place)
        if not less.terms:
            fitted = found.nominal
        else:
            fitted = derivatives([fit(less, train, found.rows, steps_max=2).model], train, found.rows)[0]
        kept = [k for k in range(count) if k != place]
        rivals = [found.rivals[k] for k in kept] if found.rivals else []
        found = replace(
            found, fitted=fitted, confounded_with=[found.confounded_with[k] for k in kept], rivals=rivals
        )


def _law_of_no_strength(found: Found) -> int | None:
    """Index of a law whose strengths all have intervals that contain 0; None if there is none."""
    for place, (term, row) in enumerate(
        zip(found.fitted.model.terms, intervals(found.fitted, found.rows), strict=True)
    ):
        strengths = [k for k, p in enumerate(term.parameters) if p.nominal == 0.0 and p.low < 0.0]
        if term.name == "law" and strengths and all(row[k].contains(0.0) for k in strengths):
            return place
    return None


def _verdict(found: Found, swims: Sequence[Segments]) -> str:
    both = _scored(found, swims)
    return verdict_of(found, both, both)


def _scored(found: Found, swims: Sequence[Segments]) -> Scored:
    return scored(found, swims, swims, found.nominal.rollouts, found.fitted.rollouts)


def _pair(error: PredictionError) -> tuple[float, float]:
    return error.position_rmse_m, error.heading_rmse_rad
