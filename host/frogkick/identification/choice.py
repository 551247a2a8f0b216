"""Whether effects are searched one by one or taken together from a robot that was measured before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from frogkick.core.poses import PredictionError
from frogkick.identification.fit import derivatives, fit
from frogkick.identification.relatives import best_end_cost, descended, end_cost, refitted, relatives
from frogkick.identification.revise import needless, stability, without
from frogkick.identification.search import Begun, Found, countable, folds_of, search
from frogkick.identification.segments import Segments, part_of
from frogkick.identification.terms import Term
from frogkick.identification.verdict import FOUND, NOTHING, Scored, scored, verdict_of
from frogkick.identification.worth import GAIN_EACH
from frogkick.robot import Robot

Progress = Callable[[str, int, int], None]

STABLE = 0.8
"""Share of other draws of the training runs that an effect must be taken in to be named."""

SEARCHED_MOST = 200
"""Periods from which on a measured relative that explains much is tried before a whole search."""

PART, PART_EFFECTS = 60, 2
"""Periods and effects of a search beside a relative: more effects are for the relative, and a search
for them would take many minutes."""

FAR, NEARER = (0.006, 0.07), 0.6
"""A model off by more than so much (m, rad) lacks more than an effect or two; a relative that leaves no more
than this share of both errors is then taken where a search does not explain all."""


def found_in(
    train: Sequence[Segments],
    robot: Robot,
    candidates: Sequence[Term],
    progress: Progress,
    measured: bool = True,
) -> Found:
    """What a search finds; or effects of a robot of the same body, fitted to these runs.

    A search that leaves no more than noise is taken as it is, a relative that does so likewise. A robot at a
    wall is as far off its model as a hull from its drawing: how far alone does not tell which it is.

    Raises:
        InputError: the runs hold nothing to judge by.
    """
    known = relatives(robot)
    begun = countable(train, robot)
    nominal = Found(begun[2], begun[2], [], begun[1], [])
    far = all(value > least for value, least in zip(_pair(_scored(nominal, train).before), FAR, strict=True))
    many = int(begun[1].sum()) > SEARCHED_MOST
    found = None
    if not known or not (far or many):
        found = search(train, robot, candidates, progress, begun)
        if not known or _verdict(found, train) in (FOUND, NOTHING):
            return found
    relative = _relative(begun, list(known.values()), train, progress, measured)
    if relative is None:
        return found or search(train, robot, candidates, progress, begun)
    if _verdict(relative, train) == FOUND:
        return relative
    if found is None:
        both = _scored(relative, train)
        pairs = zip(_pair(both.before), _pair(both.after), strict=True)
        if many or all(left <= NEARER * plain for plain, left in pairs):
            found = _searched_in_part(begun, train, robot, candidates, progress)
            return found if _verdict(found, train) == FOUND else relative
        found = search(train, robot, candidates, progress, begun)
    model = relative.fitted.model
    dear = GAIN_EACH * (len(model.values) - len(model.held))
    searched = best_end_cost(found.fitted, train)
    return relative if end_cost(relative.fitted.tracks, train) + dear < searched else found


def _relative(
    begun: Begun,
    known: Sequence[Sequence[Term]],
    train: Sequence[Segments],
    progress: Progress,
    measured: bool = True,
) -> Found | None:
    """The relative that fits best; None where all explain too little for their number of effects."""
    _, rows, nominal = begun
    fits = []
    for done, terms in enumerate(known):
        progress("measured robots", done, len(known))
        fits.append(refitted(nominal, terms, train, rows, measured))
    taken = [each for each in fits if each is not None]
    best = min(taken, key=lambda fitted: end_cost(fitted.tracks, train), default=None)
    return None if best is None else Found(nominal, best, [], rows, [[] for _ in best.model.terms])


def _searched_in_part(
    begun: Begun, train: Sequence[Segments], robot: Robot, candidates: Sequence[Term], progress: Progress
) -> Found:
    """What a search finds in some of the periods, the same share of each run, fitted to all of them."""
    _, rows, nominal = begun
    found = search(part_of(train, PART), robot, candidates, progress, most=PART_EFFECTS)
    fitted = found.fitted
    if not fitted.model.terms:
        return Found(nominal, nominal, found.turns, rows, [])
    fitted = derivatives([fit(fitted.model, train, rows, rounds=2).model], train, rows)[0]
    return Found(nominal, fitted, found.turns, rows, found.alike, rivals=found.rivals)


def pruned(found: Found, train: Sequence[Segments], progress: Progress) -> Found:
    """What was found without effects that are needless or unstable in the training runs.

    Backward elimination, one effect at a time; the test runs have no part in it. Needless is what costs
    nothing on held-out parts when it goes, unstable what fewer than STABLE of other draws of the runs would
    have taken. Both are told by derivatives, and the model without the effect is fitted again by simulation.
    """
    folds = folds_of(train, found.rows)
    searched = bool(found.turns)
    while True:
        stable = stability(found.fitted, found.rows, train, searched)
        place = needless(found.fitted, folds, train) if len(np.unique(folds)) > 1 else None
        if place is None and stable and min(stable) < STABLE:
            place = stable.index(min(stable))
        if place is None:
            return replace(found, stability=stable)
        count = len(found.fitted.model.terms)
        progress("effects held out", count, count + 1)
        less = without(found.fitted.model, place)
        if not less.terms:
            fitted = found.nominal
        elif searched:
            fitted = derivatives([fit(less, train, found.rows, rounds=2).model], train, found.rows)[0]
        else:
            fitted = descended(less, train, found.rows, found.nominal.model.robot)
        kept = [k for k in range(count) if k != place]
        rivals = [found.rivals[k] for k in kept] if found.rivals else []
        found = replace(found, fitted=fitted, alike=[found.alike[k] for k in kept], rivals=rivals)


def _verdict(found: Found, swims: Sequence[Segments]) -> str:
    both = _scored(found, swims)
    return verdict_of(found, both, both)


def _scored(found: Found, swims: Sequence[Segments]) -> Scored:
    return scored(found, swims, swims, found.nominal.tracks, found.fitted.tracks)


def _pair(error: PredictionError) -> tuple[float, float]:
    return error.position_rmse_m, error.heading_rmse_rad
