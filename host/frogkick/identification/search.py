"""Which effects a model lacks: forward selection by penalised likelihood, cross-validated on parts of the
runs.

Each iteration screens all candidates by their derivatives, fits the best few by simulation, and takes the one
that gains most, if its gain exceeds its penalty, what the best candidate would gain by chance, and its
standard error on held-out parts (Efroymson 1960, forward selection).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError
from frogkick.core.progress import TellStage, silent
from frogkick.identification.backward import resolve_equivalent, revise, with_term_at, without
from frogkick.identification.bootstrap import gain_by_chance
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    Fitted,
    Model,
    evaluate,
    fit,
    fit_many,
    fit_on,
    reestimated_noise,
    refresh_jacobian,
    rollouts_of,
    step_bounds,
)
from frogkick.identification.held_out import bent_gain, held_out_gain
from frogkick.identification.laws import Laws
from frogkick.identification.penalty import (
    CONFOUNDED_MARGIN,
    EFFECT_PENALTY,
    PARAMETER_PENALTY,
    penalised_deviance,
)
from frogkick.identification.refine import (
    NOISE_OF_MISFIT,
    REFINING_LEG_S,
    REFIT_MARGIN,
    RELEASE_PENALTY,
    STEPS_MAX,
    Refiner,
    best_noise,
    fine_leg_s,
)
from frogkick.identification.screening import Column, sensitivities
from frogkick.identification.segments import Segments, replicate_count
from frogkick.identification.steps import linearised_optimum
from frogkick.identification.terms import Term
from frogkick.robot import Robot

if TYPE_CHECKING:
    from frogkick.identification.answers import Answers
    from frogkick.identification.jumps import Jumps
    from frogkick.identification.misfires import Misfires

FloatArray = NDArray[np.float64]

REFINED = 3
"""Candidates that are fitted by simulation in each iteration; the others are judged by their derivatives."""

RIVAL_SHARE = 0.25
"""A candidate whose predicted gain is less than the best one's by this share is not fitted."""

LAWS = 12
"""Best kinds of laws that are screened beside the catalogue in each iteration."""

MOST = 4
"""Effects at most."""

UNEXPLAINED_MAX = 0.7
"""Maximum share of the error that the first effect of a short search may leave unexplained."""

DECISIVE_GAIN = 60.0
"""A decisive gain: held-out periods need not agree in it as well."""

HELD_OUT_GAIN_MIN = 1.0
"""Minimum rise of twice the log density of a held-out period (9 numbers): less is below the noise."""

FOLDS_MIN = 4

FIXED_SHARE = 0.05
"""A parameter is fixed if it gains less than this share of its effect's predicted gain."""

REFINING_STEPS_MAX, REFINING_CONVERGED = 5, 4.0
"""Steps of the fits of the best candidates at most, and the fall of the deviance that ends them: after two
steps a rival that fits as well may seem much worse."""


@dataclass(frozen=True)
class CandidateScore:
    """Score of a candidate in one iteration of the search.

    Attributes:
        title: of the effect.
        gain: fall of the deviance.
        held_out: mean rise of twice the log density of a held-out period.
        refined: fitted by simulation, not only screened.
        chosen: it was taken into the model.
    """

    title: str
    gain: float
    held_out: float
    refined: bool
    chosen: bool = False


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search.

    Attributes:
        nominal: the model without effects, its noise fitted.
        fitted: with the effects chosen.
        iterations: scores of the candidates in each iteration.
        rows: periods that were used.
        confounded_with: for each effect chosen, the titles of others that the data cannot tell from it.
        rivals: these others, fitted.
        stability: of each effect; see ``backward.stability``.
        misfires: limbs that do nothing by chance, whose laws are the last terms but those of jumps.
        answers: of the runs to pushes, where laws were looked for.
        jumps: fixes that jump by chance, whose law is the last term; they were taken out of the runs.
    """

    nominal: Fitted
    fitted: Fitted
    iterations: list[list[CandidateScore]]
    rows: NDArray[np.bool_]
    confounded_with: list[list[str]]
    sensitivities: list[Column] = field(default_factory=list)
    rivals: list[list[Term]] = field(default_factory=list)
    stability: list[float] = field(default_factory=list)
    misfires: Misfires | None = None
    jumps: Jumps | None = None
    answers: Answers | None = None


Baseline = tuple[Model, NDArray[np.bool_], Fitted]
"""Result of ``nominal_fit``."""


def nominal_fit(swims: Sequence[Segments], robot: Robot) -> Baseline:
    """The nominal model with its noise fitted, the periods that can be used, and its fit.

    Raises:
        InputError: no period can be used.
    """
    model = Model(robot, (), Noise())
    (rollouts,) = rollouts_of([model], swims)
    rows = np.isfinite(np.concatenate([rollout.residuals for rollout in rollouts])).all(axis=1)
    if not rows.any():
        raise InputError(
            "no period of the runs has fixes all along: record runs with position fixes, times in seconds"
        )
    fitted = best_noise(reestimated_noise(model, rollouts, swims), swims, rows)
    return fitted.model, rows, fitted


def folds_of(swims: Sequence[Segments], rows: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) cross-validation fold of each used period: a run, or a stretch of one where runs are few."""
    parts = -(-FOLDS_MIN // max(len(swims), 1))
    labels: list[int] = []
    for index, swim in enumerate(swims):
        count = len(swim.start_s)
        labels += [index * parts + (parts * k) // max(count, 1) for k in range(count)]
    return np.array(labels, dtype=np.int64)[rows]


def search(
    swims: Sequence[Segments],
    robot: Robot,
    candidates: Sequence[Term],
    progress: TellStage = silent,
    baseline: Baseline | None = None,
    most: int = MOST,
    columns: Sequence[Column] | None = None,
    laws: Laws | None = None,
) -> Found:
    """Find the effects that a robot's model lacks.

    Args:
        swims: the runs.
        robot: nominal.
        candidates: the catalogue.
        progress: called with each stage, steps done and to do.
        baseline: ``nominal_fit`` of these runs, where it is known.
        columns: sensitivities of the candidates, where they are known.
        laws: screened beside the candidates, anew in each iteration.
        most: effects at most; a search for fewer than MOST also ends when the first leaves most of the error.

    Raises:
        InputError: no period can be used.
    """
    model, rows, nominal = baseline or nominal_fit(swims, robot)
    if columns is None:
        columns = sensitivities(model, candidates, swims, rows, lambda d, n: progress("candidates", d, n))
    folds, replicates = folds_of(swims, rows), replicate_count(swims)
    selection = _ForwardSelection(swims, rows, folds, columns, replicates, laws)
    refiner = Refiner(swims, rows, selection.replicate_count)
    current, iterations = nominal, list[list[CandidateScore]]()
    confounded, runners_up, single_effect_fits = list[list[Term]](), list[list[Fitted]](), list[Fitted]()
    for iteration in range(most):
        tell = partial(progress, "effects", iteration, most)
        taken, tried, rivals, fits = selection.iterate(current, tell)
        single_effect_fits = single_effect_fits or fits
        if taken is not None:
            tell(f"refining {taken.model.terms[-1].title}")
            refined = refiner.refined(taken)
            current, others = selection.simplest_of(refined, rivals)
            if current is not refined:
                current = refiner.refined(current)
            current = selection.relocated(current, refiner, tell)
            title = current.model.terms[-1].title
            tried = [replace(each, chosen=each.title == title) for each in tried]
            confounded.append(others)
            runners_up.append([taken, *rivals])
        iterations.append(tried)
        if taken is None or (most < MOST and _left(nominal, current) > UNEXPLAINED_MAX):
            break
    if len(current.model.terms) > 1:
        current, confounded = revise(refiner, current, confounded, runners_up, single_effect_fits)
    current, confounded = resolve_equivalent(refiner, current, confounded, candidates)
    (current,) = refresh_jacobian([current], swims, rows)  # fixed parameters have an interval as well
    progress("effects", most, most)
    confounded_with = [[term.title for term in others] for others in confounded]
    return Found(nominal, current, iterations, rows, confounded_with, list(columns), confounded)


def _left(nominal: Fitted, fitted: Fitted) -> float:
    """Share of the error at periods' ends that a model leaves: the lesser of position's and heading's."""
    after, before = (np.sqrt((each.residuals[:, -3:] ** 2).mean(axis=0)) for each in (fitted, nominal))
    return float(min(np.hypot(*after[:2]) / np.hypot(*before[:2]), after[2] / before[2]))


@dataclass(frozen=True, eq=False)
class _Screened:
    """A screened candidate at one start: the gain that its derivatives predict.

    Attributes:
        gain: predicted fall of the deviance.
        score: gain minus the penalty of the free parameters.
        values: of all its parameters.
        fixed: which of them stay at the values where the effect vanishes.
    """

    column: Column
    gain: float
    score: float
    values: FloatArray
    fixed: frozenset[int]


@dataclass(frozen=True, eq=False)
class _ForwardSelection:
    swims: Sequence[Segments]
    rows: NDArray[np.bool_]
    folds: NDArray[np.int64]
    columns: Sequence[Column]
    replicate_count: int
    """Runs that are replicates with the same noise: their gain counts once."""
    laws: Laws | None = None

    def iterate(
        self, current: Fitted, tell: Callable[[str], None]
    ) -> tuple[Fitted | None, list[CandidateScore], list[Fitted], list[Fitted]]:
        """The model with one more effect, or None; all scores; models nearly as good; all fitted models."""
        screened = self.screen_all(current)
        least = max(EFFECT_PENALTY, self.chance_gain(current))
        picked: list[_Screened] = []
        for candidate in screened:
            if len(picked) == REFINED or candidate.score < EFFECT_PENALTY / 2.0:
                break
            if picked and candidate.score < (1.0 - RIVAL_SHARE) * picked[0].score - EFFECT_PENALTY:
                break
            if all(candidate.column.term.title != other.column.term.title for other in picked):
                picked.append(candidate)
        tell(f"trying {', '.join(each.column.term.title for each in picked) or 'none'}")
        known = len(current.model.values)
        starts = []
        for candidate in picked:
            fixed = current.model.fixed | {known + k for k in candidate.fixed}
            terms = (*current.model.terms, candidate.column.term.at(candidate.values))
            starts.append(replace(current.model, terms=terms, leg_s=REFINING_LEG_S, fixed=fixed))
        fits = (
            fit_many(starts, self.swims, self.rows, REFINING_STEPS_MAX, current.jacobian, REFINING_CONVERGED)
            if starts
            else []
        )
        tried: list[CandidateScore] = []
        scored: list[tuple[float, Fitted]] = []
        for candidate, fitted in zip(picked, fits, strict=True):
            gain = current.deviance - fitted.deviance
            fall = held_out_gain(current, fitted, self.folds, known)
            score = gain / self.replicate_count - PARAMETER_PENALTY * (
                len(candidate.values) - len(candidate.fixed)
            )
            # The gain of what acts in few periods varies from period to period, as of a limb that seldom
            # fires.
            sure = 1.0 if score > DECISIVE_GAIN else 2.0
            law = candidate.column.term.name == "law"
            if law and score > max(least, DECISIVE_GAIN) and fall[0] <= max(HELD_OUT_GAIN_MIN, fall[1]):
                fitted, fall = bent_gain(current, fitted, self.swims, self.rows, self.folds, known)
                gain = current.deviance - fitted.deviance
            good = score > least and fall[0] > max(HELD_OUT_GAIN_MIN, sure * fall[1])
            tried.append(CandidateScore(candidate.column.term.title, gain, fall[0], True))
            if good:
                scored.append((score, fitted))
        scored.sort(key=lambda row: -row[0])
        names = {each.title for each in tried}
        tried += [
            CandidateScore(candidate.column.term.title, candidate.gain, float("nan"), False)
            for candidate in screened
            if candidate.column.term.title not in names
        ]
        if not scored:
            return None, tried, [], fits
        best = scored[0][0]
        rivals = [
            fitted for score, fitted in scored[1:] if score > best - max(REFIT_MARGIN, RIVAL_SHARE * best)
        ]
        return scored[0][1], tried, rivals, fits

    def chance_gain(self, current: Fitted) -> float:
        """What the best candidate would gain by chance, if none were true."""
        runs = np.repeat(np.arange(len(self.swims)), [len(swim.start_s) for swim in self.swims])[self.rows]
        candidates = [*(column.jacobian for column in self.columns), *(self.laws.every if self.laws else ())]
        return gain_by_chance(current.residuals, current.jacobian, candidates, runs, PARAMETER_PENALTY)

    def simplest_of(self, taken: Fitted, rivals: Sequence[Fitted]) -> tuple[Fitted, list[Term]]:
        """The simplest of a refined model and the rivals confounded with it, and the others of these.

        The simplest is of the catalogue where one is, and has the fewest parameters.
        """
        if not rivals:
            return taken, []
        starts = [
            replace(each.model, noise=taken.model.noise, leg_s=fine_leg_s(each.model)) for each in rivals
        ]
        baseline = evaluate(starts, [each.jacobian for each in rivals], self.swims, self.rows)
        # As many steps as a refinement has: after two a rival that does as well may seem 20 worse. A second
        # start has the other terms as they are refined: the rival's own may be in a local minimum.
        beside = [with_term_at(taken.model, -1, each.model.terms[-1]) for each in rivals]
        own = fit_on(baseline, self.swims, self.rows, STEPS_MAX)
        near = fit_many(beside, self.swims, self.rows, STEPS_MAX)
        every = [taken, *(min(pair, key=penalised_deviance) for pair in zip(own, near, strict=True))]
        every.sort(key=penalised_deviance)
        confounded = [
            each
            for each in every
            if penalised_deviance(each)
            < penalised_deviance(every[0]) + CONFOUNDED_MARGIN * self.replicate_count
        ]
        confounded.sort(key=lambda each: (each.model.terms[-1].name == "law", len(each.model.values)))
        return confounded[0], [each.model.terms[-1] for each in confounded[1:]]

    def relocated(self, current: Fitted, refiner: Refiner, tell: Callable[[str], None]) -> Fitted:
        """The model with each earlier law where it is best beside the effects that came later.

        The first law was placed while the others were missing, and a fit does not leave a local minimum.
        """
        noise = zip(
            (*current.model.noise.idle, *current.model.noise.actuated), 2 * NOISE_OF_MISFIT, strict=True
        )
        if self.laws is None or all(own < misfit for own, misfit in noise):
            return current
        for place in range(len(current.model.terms) - 1):
            term = current.model.terms[place]
            if term.name != "law":
                continue
            tell(f"moving {term.title}")
            less = fit(without(current.model, place), self.swims, self.rows, steps_max=2)
            for column in self.laws.best(less, term.title):
                moved = term.at(self.screen(less, column).values)
                start = with_term_at(current.model, place, moved)
                fitted = fit(start, self.swims, self.rows, STEPS_MAX)
                if penalised_deviance(fitted) < penalised_deviance(current) - CONFOUNDED_MARGIN:
                    current = refiner.refined(fitted)
        return current

    def screen_all(self, current: Fitted) -> list[_Screened]:
        """Screen all candidates, best first."""
        taken = {term.title for term in current.model.terms}
        columns = [*self.columns, *(self.laws.best(current)[:LAWS] if self.laws else ())]
        found = [self.screen(current, each) for each in columns if each.term.title not in taken]
        found.sort(key=lambda candidate: candidate.column.term.title)
        found.sort(key=lambda candidate: -candidate.score)
        return found

    def screen(self, current: Fitted, column: Column) -> _Screened:
        """Screen one candidate, with as few free parameters as do nearly as well."""
        term, known = column.term, current.jacobian.shape[2]
        start = np.array(term.values)
        low = np.array([p.low for p in term.parameters]) - start
        high = np.array([p.high for p in term.parameters]) - start
        down, up = step_bounds(current.model)
        both = np.concatenate([current.jacobian, column.jacobian], axis=2)
        damping = np.append(np.full(known, 1e-12), 1e-6 * current.residuals.size / (high - low) ** 2)

        def solve(fixed: frozenset[int]) -> tuple[FloatArray, float]:
            free = np.array([k not in fixed for k in range(len(start))])
            lows, highs = np.append(down, low * free), np.append(up, high * free)
            return linearised_optimum(current.residuals, both, lows, highs, damping)

        insensitive = [k for k in range(len(start)) if not column.jacobian[:, :, k].any()]
        fixed = frozenset(k for k in insensitive if start[k] == term.parameters[k].nominal)
        step, deviance = solve(fixed)
        for _ in range(len(start) - len(fixed) - 1):
            fewer = [fixed | {k} for k in range(len(start)) if k not in fixed and k not in insensitive]
            if len(fewer) < 2:
                break
            solved = [(*solve(each), each) for each in fewer]
            lighter, dearer, chosen = min(solved, key=lambda row: row[1])
            # Where much is gained, derivatives err by more than RELEASE_PENALTY; what is fixed too soon is
            # released later.
            if dearer > deviance + max(RELEASE_PENALTY, FIXED_SHARE * (current.deviance - deviance)):
                break
            step, deviance, fixed = lighter, dearer, chosen
        gain = current.deviance - deviance
        score = gain / self.replicate_count - PARAMETER_PENALTY * (len(start) - len(fixed))
        return _Screened(column, gain, score, start + step[known:], fixed)
