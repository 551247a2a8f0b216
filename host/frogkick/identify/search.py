"""Which effects a model lacks: forward selection by likelihood, checked on held-out parts of the runs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from frogkick.errors import InputError
from frogkick.identify.filter import Noise
from frogkick.identify.fit import (
    Fitted,
    Model,
    bounded_step,
    cost_of,
    fit,
    misses,
    renoised,
    steps_of,
    tracks_of,
    whiten,
    whitener,
)
from frogkick.identify.swim import Swim
from frogkick.identify.terms import Term
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

REFINED = 3
"""Candidates that are fitted by simulation at each turn; the others are judged by their derivatives."""

MOST = 5
"""Effects taken at most."""

BASE_GAIN, GAIN_EACH = 20.0, 4.0
"""By how much minus twice the log likelihood must fall for an effect, and more for each parameter."""

SEEN_LEAST = 1.0
"""By how much the whitened squares of a held-out period (9 numbers) must fall: less is below the noise."""

FOLDS_LEAST = 4

COARSE_LEG_S = 0.08
"""How often flows and wrenches are asked while candidates are only ranked."""


@dataclass(frozen=True)
class Tried:
    """A candidate at one turn of the search.

    Attributes:
        title: of the effect.
        gain: by how much minus twice the log likelihood fell.
        held_out: by how much the whitened squares of held-out periods fell, for each period.
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
    """

    nominal: Fitted
    fitted: Fitted
    turns: list[list[Tried]]
    rows: NDArray[np.bool_]
    alike: list[list[str]]
    sensitivities: list[Column] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Column:
    """What a candidate's parameters do to the misses, about one start.

    Attributes:
        term: at the start.
        jacobian: (n, 9, p).
    """

    term: Term
    jacobian: FloatArray


def countable(swims: Sequence[Swim], robot: Robot) -> tuple[Model, NDArray[np.bool_], Fitted]:
    """The nominal model with its noise fitted, the periods that can be judged, and how it fits.

    Raises:
        InputError: nothing can be judged.
    """
    model = Model(robot, (), Noise())
    for _ in range(2):
        (tracks,) = tracks_of([model], swims)
        model = renoised(model, tracks, swims)
    (tracks,) = tracks_of([model], swims)
    every = np.concatenate([track.missed for track in tracks])
    rows = np.isfinite(every).all(axis=1)
    if not rows.any():
        raise InputError("no period of the runs has fixes all along: record longer runs with position fixes")
    model = best_noise(model, swims, rows)
    return model, rows, fit(model, swims, rows)


def best_noise(model: Model, swims: Sequence[Swim], rows: NDArray[np.bool_]) -> Model:
    """The model with its noise scaled to what predicts a period ahead best."""
    noises = []
    for fix, calm, kick in itertools.product((1.0,), (1.0, 0.3, 0.1), (1.0, 0.4)):
        given = model.noise
        noises.append(
            Noise(
                (given.fix[0] * fix, given.fix[1] * fix),
                (given.calm[0] * calm, given.calm[1] * calm),
                (given.kick[0] * kick, given.kick[1] * kick),
            )
        )
    models = [replace(model, noise=noise) for noise in noises]
    costs = [cost_of(misses(tracks, rows)) for tracks in tracks_of(models, swims)]
    return models[int(np.argmin(costs))]


def sensitivities(
    model: Model,
    candidates: Sequence[Term],
    swims: Sequence[Swim],
    rows: NDArray[np.bool_],
    progress: Callable[[int, int], None],
) -> list[Column]:
    """Derivatives by each candidate's parameters; one that does nothing at first is tried where it does."""
    bare = replace(model, terms=(), leg_s=COARSE_LEG_S)
    first = _columns(
        bare, [(term, np.ones(len(term.values), dtype=bool)) for term in candidates], swims, rows
    )
    progress(1, 2)
    columns: list[Column] = []
    again: list[tuple[Term, NDArray[np.bool_]]] = []
    for column in first:
        width = np.array([p.high - p.low for p in column.term.parameters])
        dead = np.abs(column.jacobian).max(axis=(0, 1), initial=0.0) * width < 1e-6
        if dead.any() and not dead.all():
            again += [(start, ~dead) for start in _starts(column.term, dead)]
        elif not dead.all():
            columns.append(column)
    columns += _columns(bare, again, swims, rows)
    progress(2, 2)
    return columns


def _columns(
    bare: Model,
    starts: Sequence[tuple[Term, NDArray[np.bool_]]],
    swims: Sequence[Swim],
    rows: NDArray[np.bool_],
) -> list[Column]:
    """Derivatives about each start by those of its parameters that are marked; zeros for the others.

    All are simulated at once, so that lanes are full. A start differs from the bare model only by values that
    do nothing alone.
    """
    models, places = [bare], []
    for index, (term, live) in enumerate(starts):
        at = replace(bare, terms=(term,))
        step = steps_of(at)
        for k in np.flatnonzero(live).tolist():
            moved = at.values
            moved[k] += step[k]
            models.append(at.with_values(moved))
            places.append((index, k, float(step[k])))
    every = tracks_of(models, swims)
    base = misses(every[0], rows)
    jacobians = [np.zeros((*base.shape, len(term.values))) for term, _ in starts]
    for (index, k, step_k), tracks in zip(places, every[1:], strict=True):
        jacobians[index][:, :, k] = (misses(tracks, rows) - base) / step_k
    return [Column(term, jacobian) for (term, _), jacobian in zip(starts, jacobians, strict=True)]


def _starts(term: Term, dead: NDArray[np.bool_]) -> list[Term]:
    """Starts spread over the parameters that say nothing where the effect vanishes."""
    count = 1 + 2 * int(dead.sum())
    starts = [term]
    primes = (2, 3, 5, 7)
    for n in range(1, count):
        values = list(term.values)
        for order, k in enumerate(np.flatnonzero(dead)):
            p = term.parameters[k]
            share = _halton(n, primes[order % len(primes)])
            values[k] = p.low + share * (p.high - p.low)
        starts.append(term.at(values))
    return starts


def _halton(index: int, base: int) -> float:
    share, digit = 0.0, 1.0
    while index:
        digit /= base
        share += digit * (index % base)
        index //= base
    return share


def folds_of(swims: Sequence[Swim], rows: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) which part each counted period is held out with: a run, or a stretch of one where runs are few."""
    parts = -(-FOLDS_LEAST // max(len(swims), 1))
    labels: list[int] = []
    for index, swim in enumerate(swims):
        count = len(swim.start_s)
        labels += [index * parts + (parts * k) // max(count, 1) for k in range(count)]
    return np.array(labels, dtype=np.int64)[rows]


def search(
    swims: Sequence[Swim],
    robot: Robot,
    candidates: Sequence[Term],
    progress: Callable[[str, int, int], None] = lambda _what, _done, _whole: None,
) -> Found:
    """Find what a robot's model lacks.

    Raises:
        InputError: the runs hold nothing to judge by.
    """
    model, rows, nominal = countable(swims, robot)
    folds = folds_of(swims, rows)
    columns = sensitivities(model, candidates, swims, rows, lambda d, n: progress("candidates", d, n))
    current, turns, alike = nominal, [], []
    for turn in range(MOST):
        progress("effects", turn, MOST)
        ranked = _ranked(current, columns)
        refined: list[tuple[float, Fitted, Column]] = []
        for gain, column, values in ranked:
            if len(refined) == REFINED or gain < BASE_GAIN / 2.0:
                break
            if any(column.term.title == other.term.title for _, _, other in refined[:2]):
                continue
            start = replace(current.model, terms=(*current.model.terms, column.term.at(values)))
            fitted = fit(start, swims, rows, rounds=3)
            refined.append((current.cost - fitted.cost, fitted, column))
        tried, best = [], None
        for gain, fitted, column in refined:
            known = len(current.model.values)
            low, high = fitted.model.bounds
            room = np.column_stack([low - fitted.model.values, high - fitted.model.values])
            # Without the effect means at its nominal values: the step back to them is part of the base.
            fall = _fall(current, fitted, folds, known, room)
            score = gain - GAIN_EACH * len(column.term.values)
            tried.append(Tried(column.term.title, gain, fall[0], True))
            good = score > BASE_GAIN and fall[0] > max(SEEN_LEAST, 2.0 * fall[1])
            if good and (best is None or score > best[0]):
                best = (score, fitted, column)
        names = {each.title for each in tried}
        tried += [
            Tried(column.term.title, gain, float("nan"), False)
            for gain, column, _ in ranked
            if column.term.title not in names
        ]
        turns.append(tried)
        if best is None:
            break
        score, current, chosen = best
        turns[-1] = [replace(t, chosen=t.title == chosen.term.title and t.refined) for t in tried]
        alike.append(
            [
                c.term.title
                for gain, _, c in refined
                if c.term.title != chosen.term.title and gain - GAIN_EACH * len(c.term.values) > score - 6.0
            ]
        )
        again = renoised(current.model, current.tracks, swims)
        again = best_noise(again, swims, rows)
        polished = fit(again, swims, rows, rounds=8)
        current = polished if polished.cost < current.cost + 1.0 else current
    progress("effects", MOST, MOST)
    return Found(nominal, current, turns, rows, alike, columns)


def _fall(
    current: Fitted, fitted: Fitted, folds: NDArray[np.int64], known: int, room: FloatArray
) -> tuple[float, float]:
    """Held-out gain of a fitted candidate over the model before it, each refitted without that part."""
    white = whitener(fitted.missed)
    falls = np.zeros(len(folds))
    for label in np.unique(folds):
        test = folds == label
        squares = []
        for one, limits in ((current, None), (fitted, room)):
            flat, wide = whiten(white, one.missed[~test], one.jacobian[~test])
            width = wide.shape[1]
            low = np.full(width, -np.inf) if limits is None else limits[:, 0]
            high = np.full(width, np.inf) if limits is None else limits[:, 1]
            step = bounded_step(wide, flat, np.full(width, 1e-9), low, high)
            left = (one.missed[test] + one.jacobian[test] @ step) @ white
            squares.append((np.clip(left, -8.0, 8.0) ** 2).sum(axis=1))
        falls[test] = squares[0] - squares[1]
    return float(falls.mean()), float(falls.std() / np.sqrt(len(falls)))


def _ranked(current: Fitted, columns: Sequence[Column]) -> list[tuple[float, Column, FloatArray]]:
    """Candidates by what their derivatives promise, with the values that would give it."""
    taken = {term.title for term in current.model.terms}
    white = whitener(current.missed)
    ranked = []
    for column in columns:
        if column.term.title in taken:
            continue
        term = column.term
        low = np.array([p.low for p in term.parameters]) - np.array(term.values)
        high = np.array([p.high for p in term.parameters]) - np.array(term.values)
        known = current.jacobian.shape[2]
        both = np.concatenate([current.jacobian, column.jacobian], axis=2)
        flat, wide = whiten(white, current.missed, both)
        damping = np.concatenate([np.zeros(known), 1e-6 * len(flat) / (high - low) ** 2]) + 1e-12
        step = bounded_step(
            wide,
            flat,
            damping,
            np.append(np.full(known, -np.inf), low),
            np.append(np.full(known, np.inf), high),
        )
        after = current.missed + both @ step
        gain = current.cost - cost_of(after)
        ranked.append((gain, column, np.array(term.values) + step[known:]))
    ranked.sort(key=lambda row: row[1].term.title)
    ranked.sort(key=lambda row: -(row[0] - GAIN_EACH * len(row[2])))
    return ranked
