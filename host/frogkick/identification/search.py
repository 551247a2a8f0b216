"""Which effects a model lacks: forward selection by likelihood, checked on held-out parts of the runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError
from frogkick.identification.bootstrap import gain_by_chance
from frogkick.identification.columns import Column, sensitivities
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    Fitted,
    Model,
    begun_at,
    fit_many,
    fit_on,
    renoised,
    room_of,
    told,
    tracks_of,
)
from frogkick.identification.polish import (
    HOLD,
    NEAR,
    REFINING_LEG_S,
    ROUNDS,
    Polisher,
    best_noise,
    fine_leg_s,
)
from frogkick.identification.revise import in_place, revised, same_named
from frogkick.identification.segments import Segments, replicate_count
from frogkick.identification.steps import cross_fitted, promised
from frogkick.identification.terms import Term
from frogkick.identification.worth import ALIKE, BASE_GAIN, GAIN_EACH, price
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

REFINED = 3
"""Candidates that are fitted by simulation at each turn; the others are judged by their derivatives."""

RIVAL = 0.25
"""A candidate whose promise is less than the best one's by this share is not fitted."""

MOST = 4
"""Effects taken at most."""

HOPELESS = 0.7
"""Share of the misses that the first of few effects may leave."""

PLAIN_GAIN = 60.0
"""A gain beyond doubt: held-out periods need not agree in it as well."""

SEEN_LEAST = 1.0
"""By how much twice the log density of a held-out period (9 numbers) must rise: less is below the noise."""

FOLDS_LEAST = 4

HELD_SHARE = 0.05
"""Or less than this share of what all of its effect's parameters gain, as long as that is only promised."""

REFINING_ROUNDS, REFINED_CLOSE = 5, 4.0
"""Steps of the fits of the best candidates at most, and the fall of the cost that ends them: after two steps
a rival that fits as well may seem much worse."""


@dataclass(frozen=True)
class Tried:
    """A candidate at one turn of the search.

    Attributes:
        title: of the effect.
        gain: by how much minus twice the log likelihood fell.
        held_out: by how much twice the log density of held-out periods rose, for each period.
        refined: by simulation, not by derivatives alone.
        chosen: it was taken.
    """

    title: str
    gain: float
    held_out: float
    refined: bool
    chosen: bool = False


@dataclass(frozen=True, eq=False)
class Found:
    """What a search ended with.

    Attributes:
        nominal: the model without effects, its noise fitted.
        fitted: with the effects chosen.
        turns: what was tried at each turn.
        rows: periods that counted.
        alike: for each effect chosen, others that did as well within what the data can tell.
        rivals: these others themselves, fitted.
        stability: of each effect; see ``revise.stability``.
    """

    nominal: Fitted
    fitted: Fitted
    turns: list[list[Tried]]
    rows: NDArray[np.bool_]
    alike: list[list[str]]
    sensitivities: list[Column] = field(default_factory=list)
    rivals: list[list[Term]] = field(default_factory=list)
    stability: list[float] = field(default_factory=list)


Begun = tuple[Model, NDArray[np.bool_], Fitted]
"""What ``countable`` gives."""


def countable(swims: Sequence[Segments], robot: Robot) -> Begun:
    """The nominal model with its noise fitted, the periods that can be judged, and how it fits.

    Raises:
        InputError: nothing can be judged.
    """
    model = Model(robot, (), Noise())
    (tracks,) = tracks_of([model], swims)
    rows = np.isfinite(np.concatenate([track.missed for track in tracks])).all(axis=1)
    if not rows.any():
        raise InputError(
            "no period of the runs has fixes all along: record runs with position fixes, times in seconds"
        )
    fitted = best_noise(renoised(model, tracks, swims), swims, rows)
    return fitted.model, rows, fitted


def folds_of(swims: Sequence[Segments], rows: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) which part each counted period is held out with: a run, or a stretch of one where runs are few."""
    parts = -(-FOLDS_LEAST // max(len(swims), 1))
    labels: list[int] = []
    for index, swim in enumerate(swims):
        count = len(swim.start_s)
        labels += [index * parts + (parts * k) // max(count, 1) for k in range(count)]
    return np.array(labels, dtype=np.int64)[rows]


def search(
    swims: Sequence[Segments],
    robot: Robot,
    candidates: Sequence[Term],
    progress: Callable[[str, int, int], None] = lambda _what, _done, _whole: None,
    begun: Begun | None = None,
    most: int = MOST,
) -> Found:
    """Find what a robot's model lacks.

    Args:
        swims: the runs.
        robot: nominal.
        candidates: what is tried.
        progress: told of each stage.
        begun: what ``countable`` gave for these runs, where that is known.
        most: effects; where fewer than MOST the search ends as well when the first leaves most of the error.

    Raises:
        InputError: the runs hold nothing to judge by.
    """
    model, rows, nominal = begun or countable(swims, robot)
    columns = sensitivities(model, candidates, swims, rows, lambda d, n: progress("candidates", d, n))
    hunt = _Hunt(swims, rows, folds_of(swims, rows), columns, replicate_count(swims))
    polisher = Polisher(swims, rows, hunt.replicates)
    current, turns = nominal, list[list[Tried]]()
    equals, passed_over, alone = list[list[Term]](), list[list[Fitted]](), list[Fitted]()
    for turn in range(most):
        progress("effects", turn, most)
        taken, tried, rivals, fits = hunt.turn(current)
        alone = alone or fits
        if taken is not None:
            polished = polisher.polished(taken)
            current, others = hunt.settled(polished, rivals)
            if current is not polished:
                current = polisher.polished(current)
            title = current.model.terms[-1].title
            tried = [replace(each, chosen=each.title == title) for each in tried]
            equals.append(others)
            passed_over.append([taken, *rivals])
        turns.append(tried)
        if taken is None or (most < MOST and _left(nominal, current) > HOPELESS):
            break
    if len(current.model.terms) > 1:
        current, equals = revised(polisher, current, equals, passed_over, alone)
    current, equals = same_named(polisher, current, equals, candidates)
    (current,) = told([current], swims, rows)  # what is held has an interval as well
    progress("effects", most, most)
    alike = [[term.title for term in others] for others in equals]
    return Found(nominal, current, turns, rows, alike, columns, equals)


def _left(nominal: Fitted, fitted: Fitted) -> float:
    """Share of the misses at periods' ends that a model leaves: the lesser of place's and heading's."""
    after, before = (np.sqrt((each.missed[:, -3:] ** 2).mean(axis=0)) for each in (fitted, nominal))
    return float(min(np.hypot(*after[:2]) / np.hypot(*before[:2]), after[2] / before[2]))


@dataclass(frozen=True, eq=False)
class _Offer:
    """A candidate about one start: what its derivatives promise.

    Attributes:
        gain: by how much minus twice the log likelihood would fall.
        score: the same less what its free parameters cost.
        values: of all its parameters.
        held: which of them stay where the effect vanishes.
    """

    column: Column
    gain: float
    score: float
    values: FloatArray
    held: frozenset[int]


@dataclass(frozen=True, eq=False)
class _Hunt:
    swims: Sequence[Segments]
    rows: NDArray[np.bool_]
    folds: NDArray[np.int64]
    columns: Sequence[Column]
    replicates: int
    """Of the same noise: a gain counts once."""

    def turn(self, current: Fitted) -> tuple[Fitted | None, list[Tried], list[Fitted], list[Fitted]]:
        """One more effect, or none; all that were tried; others that do nearly as well; all fitted ones."""
        offers = self.offers(current)
        least = max(BASE_GAIN, self.by_chance(current))
        picked: list[_Offer] = []
        for offer in offers:
            if len(picked) == REFINED or offer.score < BASE_GAIN / 2.0:
                break
            if picked and offer.score < (1.0 - RIVAL) * picked[0].score - BASE_GAIN:
                break
            if all(offer.column.term.title != other.column.term.title for other in picked):
                picked.append(offer)
        known = len(current.model.values)
        starts = []
        for offer in picked:
            held = current.model.held | {known + k for k in offer.held}
            terms = (*current.model.terms, offer.column.term.at(offer.values))
            starts.append(replace(current.model, terms=terms, leg_s=REFINING_LEG_S, held=held))
        fits = (
            fit_many(starts, self.swims, self.rows, REFINING_ROUNDS, current.jacobian, REFINED_CLOSE)
            if starts
            else []
        )
        tried: list[Tried] = []
        scored: list[tuple[float, Fitted]] = []
        for offer, fitted in zip(picked, fits, strict=True):
            gain = current.cost - fitted.cost
            fall = _fall(current, fitted, self.folds, known)
            score = gain / self.replicates - GAIN_EACH * (len(offer.values) - len(offer.held))
            # What shows in few periods varies much from period to period: a limb that seldom fires.
            sure = 1.0 if score > PLAIN_GAIN else 2.0
            good = score > least and fall[0] > max(SEEN_LEAST, sure * fall[1])
            tried.append(Tried(offer.column.term.title, gain, fall[0], True))
            if good:
                scored.append((score, fitted))
        scored.sort(key=lambda row: -row[0])
        names = {each.title for each in tried}
        tried += [
            Tried(offer.column.term.title, offer.gain, float("nan"), False)
            for offer in offers
            if offer.column.term.title not in names
        ]
        if not scored:
            return None, tried, [], fits
        best = scored[0][0]
        rivals = [fitted for score, fitted in scored[1:] if score > best - max(NEAR, RIVAL * best)]
        return scored[0][1], tried, rivals, fits

    def by_chance(self, current: Fitted) -> float:
        """What the best candidate would gain if none were true."""
        runs = np.repeat(np.arange(len(self.swims)), [len(swim.start_s) for swim in self.swims])[self.rows]
        candidates = [column.jacobian for column in self.columns]
        return gain_by_chance(current.missed, current.jacobian, candidates, runs, GAIN_EACH)

    def settled(self, taken: Fitted, rivals: Sequence[Fitted]) -> tuple[Fitted, list[Term]]:
        """The best of a polished model and its rivals at its noise, and what cannot be told from that.

        Of those that cannot be told apart it is the one with the fewest parameters.
        """
        if not rivals:
            return taken, []
        starts = [
            replace(each.model, noise=taken.model.noise, leg_s=fine_leg_s(each.model)) for each in rivals
        ]
        begun = begun_at(starts, [each.jacobian for each in rivals], self.swims, self.rows)
        # As many steps as a polish has: after two a rival that does as well may seem 20 worse. And from the
        # other terms as they are polished, too: its own may have settled in a dip.
        beside = [in_place(taken.model, -1, each.model.terms[-1]) for each in rivals]
        own = fit_on(begun, self.swims, self.rows, ROUNDS)
        near = fit_many(beside, self.swims, self.rows, ROUNDS)
        every = [taken, *(min(pair, key=price) for pair in zip(own, near, strict=True))]
        every.sort(key=price)
        equals = [each for each in every if price(each) < price(every[0]) + ALIKE * self.replicates]
        equals.sort(key=lambda each: len(each.model.values))
        return equals[0], [each.model.terms[-1] for each in equals[1:]]

    def offers(self, current: Fitted) -> list[_Offer]:
        """Candidates by what their derivatives promise, best first."""
        taken = {term.title for term in current.model.terms}
        found = [self.offer(current, each) for each in self.columns if each.term.title not in taken]
        found.sort(key=lambda offer: offer.column.term.title)
        found.sort(key=lambda offer: -offer.score)
        return found

    def offer(self, current: Fitted, column: Column) -> _Offer:
        """What one promises, with as few of its parameters as do nearly as well."""
        term, known = column.term, current.jacobian.shape[2]
        start = np.array(term.values)
        low = np.array([p.low for p in term.parameters]) - start
        high = np.array([p.high for p in term.parameters]) - start
        down, up = room_of(current.model)
        both = np.concatenate([current.jacobian, column.jacobian], axis=2)
        damping = np.append(np.full(known, 1e-12), 1e-6 * current.missed.size / (high - low) ** 2)

        def solve(held: frozenset[int]) -> tuple[FloatArray, float]:
            free = np.array([k not in held for k in range(len(start))])
            lows, highs = np.append(down, low * free), np.append(up, high * free)
            return promised(current.missed, both, lows, highs, damping)

        dead = [k for k in range(len(start)) if not column.jacobian[:, :, k].any()]
        held = frozenset(k for k in dead if start[k] == term.parameters[k].nominal)
        step, cost = solve(held)
        for _ in range(len(start) - len(held) - 1):
            fewer = [held | {k} for k in range(len(start)) if k not in held and k not in dead]
            if len(fewer) < 2:
                break
            solved = [(*solve(each), each) for each in fewer]
            lighter, dearer, chosen = min(solved, key=lambda row: row[1])
            # Where much is gained derivatives err by more than HOLD; what is held too soon is freed later.
            if dearer > cost + max(HOLD, HELD_SHARE * (current.cost - cost)):
                break
            step, cost, held = lighter, dearer, chosen
        gain = current.cost - cost
        score = gain / self.replicates - GAIN_EACH * (len(start) - len(held))
        return _Offer(column, gain, score, start + step[known:], held)


def _fall(current: Fitted, fitted: Fitted, folds: NDArray[np.int64], known: int) -> tuple[float, float]:
    """Gain of a fitted candidate over the model before it on a held-out period, and its standard error.

    By twice the log density, each model cross-fitted: neither its parameters nor its scale saw the fold.
    """
    low, high = room_of(fitted.model)
    scores = [
        cross_fitted(one.missed, one.jacobian, lows, highs, np.full(len(lows), 1e-9), folds)
        for one, lows, highs in ((current, low[:known], high[:known]), (fitted, low, high))
    ]
    falls = 2.0 * (scores[1] - scores[0])
    return float(falls.mean()), float(falls.std() / np.sqrt(len(falls)))
