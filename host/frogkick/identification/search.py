"""Which effects a model lacks: forward selection by penalised likelihood (Efroymson 1960), cross-validated.

Each iteration screens all candidates by their derivatives, fits the best few by simulation, and takes the one
that gains most, if its gain exceeds its penalty, what the best candidate would gain by chance, and its
standard error on held-out parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.progress import TellStage, silent
from frogkick.identification.backward import EQUIVALENT, equally_good, resolve_equivalent, revise
from frogkick.identification.batching import all_of, spent_up
from frogkick.identification.bootstrap import gain_by_chance
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    CONFOUNDED_MARGIN,
    EFFECT_PENALTY,
    PARAMETER_PENALTY,
    REFINING_LEG_S,
    Fitted,
    Model,
    deviances_of,
    evaluate,
    fit,
    fit_many,
    fit_on,
    reestimated_noise,
    refresh_jacobian,
    rollouts_of,
)
from frogkick.identification.laws import Laws, centred
from frogkick.identification.refine import NOISE_OF_MISFIT, REFIT_MARGIN, STEPS_MAX, best_noise, refined
from frogkick.identification.screening import (
    Column,
    Screened,
    bent_gain,
    held_out_gain,
    screened,
    sensitivities,
)
from frogkick.identification.segments import Data, Segments
from frogkick.identification.terms import Term
from frogkick.robot import Robot

if TYPE_CHECKING:
    from frogkick.identification.jumps import Jumps
    from frogkick.identification.misfires import Misfires
    from frogkick.identification.responses import Responses


REFINED = 3
"""Candidates that are fitted by simulation in each iteration; the others are judged by their derivatives."""

RIVAL_SHARE = 0.25  # a candidate whose predicted gain is less than the best one's by this share is not fitted
LAWS = 12  # best kinds of laws that are screened beside the catalogue in each iteration
MOST = 4  # effects at most

UNEXPLAINED_MAX = 0.7
"""Maximum share of the error that the first effect of a short search may leave unexplained."""

DECISIVE_GAIN = 60.0  # a decisive gain: held-out periods need not agree in it as well

HELD_OUT_GAIN_MIN = 1.0
"""Minimum rise of twice the log density of a held-out period (9 numbers): less is below the noise."""

REFINING_STEPS_MAX, REFINING_CONVERGED = 5, 4.0
"""Steps of the fits of the best candidates at most, and the fall of the deviance that ends them: after two
steps a rival that fits as well may seem much worse."""

SHIFTS = {
    "clock_drift": ({"drift": -0.006}, {"drift": -0.002}, {"drift": 0.002}, {"drift": 0.006}),
    "fix_latency": ({"delay_s": 0.04}, {"delay_s": 0.1}, {"delay_s": 0.18}),
}
"""Effects that shift the times of all fixes, and where a fit of each begins beside another such shift.

One of them alone is fitted to a mixture of both, and there derivatives do not show the other: the frame
rings, so a delay has local minima."""

COMPARED = 2.0
"""The fall of the deviance that ends fits which are compared by CONFOUNDED_MARGIN, and refined later."""


@dataclass(frozen=True)
class CandidateScore:
    """Score of a candidate in one iteration of the search."""

    title: str
    gain: float  # fall of the deviance
    held_out: float  # mean rise of twice the log density of a held-out period
    refined: bool  # fitted by simulation, not only screened
    chosen: bool = False


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search."""

    data: Data  # the runs that were searched
    nominal: Fitted  # the model without effects, its noise fitted
    fitted: Fitted  # with the effects chosen
    # scores of the candidates in each iteration
    iterations: list[list[CandidateScore]] = field(default_factory=list)
    # for each effect chosen, the titles of others that the data cannot tell from it
    confounded_with: list[list[str]] = field(default_factory=list)
    sensitivities: list[Column] = field(default_factory=list)  # of the candidates
    rivals: list[list[Term]] = field(default_factory=list)  # those of ``confounded_with``, fitted
    stability: list[float] = field(default_factory=list)  # of each effect; see ``backward.stability``
    # limbs that do nothing by chance, whose laws are the last terms but those of jumps
    misfires: Misfires | None = None
    # fixes that jump by chance, whose laws are the last terms; they were taken out of the runs
    jumps: tuple[Jumps, ...] = ()
    responses: Responses | None = None  # of the runs to forces, flows and strokes, if laws were searched for


def nominal_fit(swims: Sequence[Segments], robot: Robot) -> tuple[Data, Fitted]:
    """The periods of runs that can be used, and the nominal model with its noise fitted to them.

    Raises:
        InputError: no period has fixes all along.
    """
    model = Model(robot, (), Noise())
    (rollouts,) = rollouts_of([model], swims)
    rows = np.isfinite(np.concatenate([rollout.residuals for rollout in rollouts])).all(axis=1)
    if not rows.any():
        raise InputError(
            "no period of the runs has fixes all along: record runs with position fixes, times in seconds"
        )
    data = Data(swims, rows)
    return data, best_noise(reestimated_noise(model, rollouts, swims), data)


def search(
    data: Data,
    nominal: Fitted,
    candidates: Sequence[Term],
    progress: TellStage = silent,
    most: int = MOST,
    columns: Sequence[Column] | None = None,
    laws: Laws | None = None,
) -> Found:
    """Find the effects that a robot's model lacks; for ``data`` and ``nominal`` see ``nominal_fit``.

    Args:
        most: effects at most; a search for fewer than MOST also ends when the first leaves most of the error.
        columns: sensitivities of the candidates, where they are known.
        laws: screened beside the candidates, anew in each iteration.
    """
    if columns is None:
        columns = sensitivities(nominal.model, candidates, data, partial(progress, "candidates"))
    selection = _ForwardSelection(data, columns, laws)
    current, iterations = nominal, list[list[CandidateScore]]()
    confounded, runners_up, single_effect_fits = list[list[Term]](), list[list[Fitted]](), list[Fitted]()
    for iteration in range(most):
        if iteration and spent_up():
            break
        tell = partial(progress, "effects", iteration, most)
        taken, tried, rivals, fits = selection.iterate(current, tell)
        single_effect_fits = single_effect_fits or fits
        if taken is not None:
            tell(f"refining {taken.model.terms[-1].title}")
            fine = refined(taken, data)
            current, others = selection.simplest_of(fine, rivals)
            if current is not fine:
                current = refined(current, data)
            current = selection.relocated(current, tell)
            title = current.model.terms[-1].title
            tried = [replace(each, chosen=each.title == title) for each in tried]
            confounded.append(others)
            runners_up.append([taken, *rivals])
        iterations.append(tried)
        if taken is None or (most < MOST and _left(nominal, current) > UNEXPLAINED_MAX):
            break
    if len(current.model.terms) > 1:
        current, confounded = revise(data, current, confounded, runners_up, single_effect_fits)
    current, confounded = resolve_equivalent(data, current, confounded, candidates)
    (current,) = refresh_jacobian([centred(current, data)], data)  # with all parameters
    progress("effects", most, most)
    confounded_with = [[term.title for term in others] for others in confounded]
    return Found(data, nominal, current, iterations, confounded_with, list(columns), confounded)


def _left(nominal: Fitted, fitted: Fitted) -> float:
    """Share of the error at periods' ends that a model leaves: the lesser of position's and heading's."""
    after, before = (np.sqrt((each.residuals[:, -3:] ** 2).mean(axis=0)) for each in (fitted, nominal))
    return float(min(np.hypot(*after[:2]) / np.hypot(*before[:2]), after[2] / before[2]))


def _misfits(fitted: Fitted) -> bool:
    """Whether the process noise of a model says that it lacks something."""
    noise = fitted.model.noise
    pairs = zip((*noise.idle, *noise.actuated), 2 * NOISE_OF_MISFIT, strict=True)
    return any(own >= misfit for own, misfit in pairs)


@dataclass(frozen=True, eq=False)
class _ForwardSelection:
    """Iterations of a search: from a model to one with one more effect."""

    data: Data
    columns: Sequence[Column]
    laws: Laws | None = None

    def iterate(
        self, current: Fitted, tell: Callable[[str], None]
    ) -> tuple[Fitted | None, list[CandidateScore], list[Fitted], list[Fitted]]:
        """The model with one more effect, or None; all scores; models nearly as good; all fitted models."""
        candidates = self.screen_all(current)
        known = [*(column.jacobian for column in self.columns), *(self.laws.every if self.laws else ())]
        # What the best candidate would gain by chance, if none were true.
        by_chance = gain_by_chance(
            current.residuals, current.jacobian, known, self.data.run, PARAMETER_PENALTY
        )
        least = max(EFFECT_PENALTY, by_chance)
        picked: list[Screened] = []
        for candidate in candidates:
            if len(picked) == REFINED or candidate.score < EFFECT_PENALTY / 2.0:
                break
            if picked and candidate.score < (1.0 - RIVAL_SHARE) * picked[0].score - EFFECT_PENALTY:
                break
            if all(candidate.column.term.title != other.column.term.title for other in picked):
                picked.append(candidate)
        named = ", ".join(each.column.term.title for each in picked)
        tell(f"trying {named}" if named else "no further effect gains enough to be tried")
        count = len(current.model.values)
        starts = []
        for candidate in picked:
            fixed = current.model.fixed | {count + k for k in candidate.fixed}
            terms = (*current.model.terms, candidate.column.term.at(candidate.values))
            starts.append(replace(current.model, terms=terms, leg_s=REFINING_LEG_S, fixed=fixed))
        steps, small = REFINING_STEPS_MAX, REFINING_CONVERGED
        fits = fit_many(starts, self.data, steps, current.jacobian, small) if starts else []
        shift = self.shifted(current, candidates)
        if shift is not None:
            picked, fits = [*picked, shift[0]], [*fits, shift[1]]
        judge = partial(self.judged, current, least)
        judged = all_of([partial(judge, *pair) for pair in zip(picked, fits, strict=True)])
        tried = [tried for _, _, tried in judged]
        scored = [(score, fitted) for score, fitted, _ in judged if score > -np.inf]
        scored.sort(key=lambda row: -row[0])
        names = {each.title for each in tried}
        tried += [
            CandidateScore(each.column.term.title, each.gain, float("nan"), False)
            for each in candidates
            if each.column.term.title not in names
        ]
        if not scored:
            return None, tried, [], fits
        best = scored[0][0]
        rivals = [
            fitted for score, fitted in scored[1:] if score > best - max(REFIT_MARGIN, RIVAL_SHARE * best)
        ]
        return scored[0][1], tried, rivals, fits

    def shifted(self, current: Fitted, candidates: Sequence[Screened]) -> tuple[Screened, Fitted] | None:
        """The other shift of the fixes' times beside the one that the model has, fitted; see SHIFTS."""
        taken = {term.title for term in current.model.terms}
        late, drifts = not taken.isdisjoint(EQUIVALENT), "clock_drift" in taken
        if late == drifts or not _misfits(current):
            return None
        wanted = "fix_latency" if drifts else "clock_drift"
        other = next((each for each in candidates if each.column.term.title == wanted), None)
        if other is None:
            return None
        term = other.column.term
        places = [term.at([start[p.name] for p in term.parameters]) for start in SHIFTS[wanted]]
        starts = [
            replace(current.model, terms=(*current.model.terms, place), leg_s=REFINING_LEG_S)
            for place in places
        ]
        best = min(fit_many(starts, self.data, STEPS_MAX, tolerance=COMPARED), key=lambda each: each.deviance)
        return replace(other, fixed=frozenset()), best

    def judged(
        self, current: Fitted, least: float, candidate: Screened, fitted: Fitted
    ) -> tuple[float, Fitted, CandidateScore]:
        """Score of a fitted candidate (-inf if it is not good enough), its fit, and its entry in reports."""
        penalty = PARAMETER_PENALTY * (len(candidate.values) - len(candidate.fixed))
        fall = held_out_gain(current, fitted, self.data.folds)
        score = (current.deviance - fitted.deviance) / self.data.replicate_count - penalty
        law = candidate.column.term.name == "law"
        if law and score > max(least, DECISIVE_GAIN) and fall[0] <= max(HELD_OUT_GAIN_MIN, fall[1]):
            fitted, fall = bent_gain(current, fitted, self.data)
            score = (current.deviance - fitted.deviance) / self.data.replicate_count - penalty
        # The gain of what acts in few periods varies from period to period, as of a limb that seldom fires.
        sure = 1.0 if score > DECISIVE_GAIN else 2.0
        good = score > least and fall[0] > max(HELD_OUT_GAIN_MIN, sure * fall[1])
        tried = CandidateScore(candidate.column.term.title, current.deviance - fitted.deviance, fall[0], True)
        return (score if good else -np.inf), fitted, tried

    def simplest_of(self, taken: Fitted, rivals: Sequence[Fitted]) -> tuple[Fitted, list[Term]]:
        """The simplest of a refined model and the rivals confounded with it, and the others of these.

        The simplest is of the catalogue where one is, and has the fewest parameters.
        """
        if not rivals:
            return taken, []
        starts = [
            replace(each.model, noise=taken.model.noise, leg_s=each.model.fine_leg_s) for each in rivals
        ]
        baseline = evaluate(starts, [each.jacobian for each in rivals], self.data)
        # As many steps as a refinement has: after two a rival that does as well may seem 20 worse. A second
        # start has the other terms as they are refined: the rival's own may be in a local minimum.
        beside = [taken.model.with_term_at(-1, each.model.terms[-1]) for each in rivals]
        own, near = all_of(
            [
                partial(fit_on, baseline, self.data, STEPS_MAX, tolerance=COMPARED),
                partial(fit_many, beside, self.data, STEPS_MAX, tolerance=COMPARED),
            ]
        )
        pairs = zip(own, near, strict=True)
        better = [min(pair, key=lambda each: each.penalised_deviance) for pair in pairs]
        first, *rest = sorted(
            equally_good([taken, *better], self.data), key=lambda each: each.model.terms[-1].name == "law"
        )
        return first, [each.model.terms[-1] for each in rest]

    def relocated(self, current: Fitted, tell: Callable[[str], None]) -> Fitted:
        """The model with each earlier law where it is best beside the effects that came later.

        The first law was placed while the others were missing, and a fit does not leave a local minimum.
        """
        if self.laws is None or not _misfits(current):
            return current
        last, resting = len(current.model.terms) - 1, -1
        for turn in range(2 * MOST):
            if spent_up():
                break
            places = [
                place
                for place, term in enumerate(current.model.terms)
                if term.name == "law"
                and place != resting
                and (turn or place < last or self.laws.moments(term.title))
            ]
            if places:
                tell(f"moving {', '.join(current.model.terms[place].title for place in places)}")
            starts = [
                (place, start)
                for place, some in zip(
                    places, all_of([partial(self.elsewhere, current, place) for place in places]), strict=True
                )
                for start in some
            ]
            fits = all_of([partial(fit, start, self.data, STEPS_MAX, COMPARED) for _, start in starts])
            least = current.penalised_deviance - CONFOUNDED_MARGIN
            better = [
                (fitted.penalised_deviance, place, fitted)
                for (place, _), fitted in zip(starts, fits, strict=True)
                if fitted.penalised_deviance < least
            ]
            if not better:
                break
            # The others were placed beside a law that stood elsewhere.
            _, resting, fitted = min(better, key=lambda row: row[0])
            current = refined(fitted, self.data)
        return current

    def elsewhere(self, current: Fitted, place: int) -> list[Model]:
        """The model with the law in one place where it seems best beside the others."""
        assert self.laws is not None
        term = current.model.terms[place]
        less = fit(current.model.without(place), self.data, steps_max=2)
        places = [screened(less, each, self.data).values for each in self.laws.best(less, term.title)]
        moved = [current.model.with_term_at(place, term.at(values)) for values in places]
        # Derivatives cannot choose the moment of a law where another law took up what the strokes between two
        # moments lack.
        own = dict(zip((p.name for p in term.parameters), term.values, strict=True))
        begun = [
            current.model.with_term_at(place, term.at([*{**own, "at": at}.values()]))
            for at in self.laws.moments(term.title)
        ]
        return moved + ([begun[int(np.argmin(deviances_of(begun, self.data)))]] if begun else [])

    def screen_all(self, current: Fitted) -> list[Screened]:
        """Screen all candidates, best first."""
        taken = {term.title for term in current.model.terms}
        columns = [*self.columns, *(self.laws.best(current)[:LAWS] if self.laws else ())]
        found = [screened(current, each, self.data) for each in columns if each.term.title not in taken]
        found.sort(key=lambda candidate: candidate.column.term.title)
        found.sort(key=lambda candidate: -candidate.score)
        return found
