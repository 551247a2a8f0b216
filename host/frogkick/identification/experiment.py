"""What to record next: a short row of actions after which two models that do as well so far no longer do.

Two models answer the runs at hand alike: the one found with another effect in its place, or with a parameter
at either end of its interval, all others as the runs then have them. From rest both swim side by side, every
action is tried after every row kept, and the rows are kept whose periods the two predict most apart, in units
of what periods are missed by anyway. As with runs, the second one is put where the first one is when a period
begins, so that each period counts by itself. What is told of the best row is then measured as identification
would see it: the first model's fixes, followed by both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frogkick.identification.fit import Model, misses, tracks_of
from frogkick.identification.polish import held_at
from frogkick.identification.predict import WILD
from frogkick.identification.search import Found
from frogkick.identification.segments import Segments
from frogkick.identification.side_by_side import Row, Side, grow, segments_of_row
from frogkick.identification.steps import whitener
from frogkick.identification.terms import Term
from frogkick.identification.verdict import Interval
from frogkick.identification.worth import ALIKE
from frogkick.robot import in_a_row

FloatArray = NDArray[np.float64]

PERIODS = 10
"""Of a planned row."""

KEPT = 3
"""Rows that are gone on with."""

WIDE = 0.5
"""An interval that covers so much of a parameter's bounds asks for an experiment."""

QUESTIONS = 2
"""That are planned for at most, of those that there are: each costs some seconds."""

TELLS_SIGMA = math.sqrt(ALIKE) + 1.0
"""From so far apart, one row decides: a search takes models for alike up to ALIKE."""

POOL_M = 0.6
"""Side of the square that a row stays in, about the middle of the runs, where these went no further."""


@dataclass(frozen=True, eq=False)
class Question:
    """Two models that the runs do not tell apart, and what to call them."""

    between: tuple[str, str]
    models: tuple[Model, Model]


@dataclass(frozen=True, eq=False)
class Experiment:
    """A row of actions from rest.

    Attributes:
        between: what it tells apart.
        actions: their names.
        start: pose (world: m, m, rad) that it was planned from.
        separation_sigma: how far apart both predict its periods, whitened: root of the sum of squares.
    """

    between: tuple[str, str]
    actions: tuple[str, ...]
    start: tuple[float, float, float]
    separation_sigma: float

    @property
    def tells(self) -> bool:
        """Recorded once, it decides."""
        return self.separation_sigma >= TELLS_SIGMA

    @property
    def row(self) -> str:
        """Its actions in a row."""
        return in_a_row(self.actions)

    @property
    def text(self) -> str:
        """What to do, in words."""
        one, other = self.between
        apart = f"{len(self.actions)} periods, {self.separation_sigma:.1f} sigma apart"
        if self.tells:
            return f"to tell {one} from {other}, record from rest: {self.row} ({apart})"
        times = math.ceil((TELLS_SIGMA / max(self.separation_sigma, 1e-3)) ** 2)
        if times <= PERIODS:
            return f"to tell {one} from {other}, record {times} times from rest: {self.row} ({apart} each)"
        return f"no row of these actions from rest tells {one} from {other} (at best {self.row}: {apart})"

    def as_json(self) -> dict[str, Any]:
        """The key of the command."""
        return {
            "between": list(self.between),
            "actions": self.row,
            "periods": len(self.actions),
            "separation_sigma": self.separation_sigma,
            "tells": self.tells,
            "text": self.text,
        }


def experiment_of(
    found: Found, parameters: Sequence[Sequence[Interval]], swims: Sequence[Segments], periods: int = PERIODS
) -> Experiment | None:
    """The experiment that settles most of what a search left open; None where nothing is open.

    Args:
        found: by the search.
        parameters: intervals of its effects' parameters.
        swims: the runs; a row starts where the first of them did and stays where they went.
        periods: see ``plan``.
    """
    white = whitener(found.fitted.missed)
    first = swims[0]
    start = first.pose[np.searchsorted(first.time_s, first.begin_s)]
    pool = pool_of(swims)
    best: Experiment | None = None
    for question in questions(found, parameters)[:QUESTIONS]:
        told = plan(question, white, start, pool, periods)
        if best is None or told.separation_sigma > best.separation_sigma:
            best = told
        if best.tells:
            break
    return best


def questions(found: Found, parameters: Sequence[Sequence[Interval]]) -> list[Question]:
    """What is open: effects that others do as well as, then parameters, the least known first."""
    model, open_ones = found.fitted.model, list[Question]()
    for place, others in enumerate(found.rivals):
        for other in others:
            terms = (*model.terms[:place], other, *model.terms[place + 1 :])
            names = (model.terms[place].title, other.title)
            open_ones.append(Question(names, (model, replace(model, terms=terms, held=frozenset()))))
    wide: list[tuple[float, Question]] = []
    first = 0
    for term, row in zip(model.terms, parameters, strict=True):
        for k, (parameter, interval) in enumerate(zip(term.parameters, row, strict=True)):
            share = (interval.high - interval.low) / (parameter.high - parameter.low)
            if share >= WIDE:
                wide.append((share, _ends(found, term, first + k, interval)))
        first += len(term.values)
    wide.sort(key=lambda each: -each[0])
    return open_ones + [question for _, question in wide]


def _ends(found: Found, term: Term, k: int, interval: Interval) -> Question:
    """A parameter at either end of its interval, the others as the runs then have them."""
    low, high = (held_at(found.fitted, k, end) for end in (interval.low, interval.high))
    names = [f"{term.title} {interval.name} {end:.3g}" for end in (interval.low, interval.high)]
    return Question((names[0], names[1]), (low, high))


def pool_of(swims: Sequence[Segments]) -> FloatArray:
    """(2, 2) low and high corner of where a row may go: a square about where runs went."""
    every = np.concatenate([swim.pose[:, :2] for swim in swims])
    low, high = every.min(axis=0), every.max(axis=0)
    half = max(POOL_M, float((high - low).max())) / 2.0
    return np.array([(low + high) / 2.0 - half, (low + high) / 2.0 + half])


def plan(
    question: Question, white: FloatArray, start: FloatArray, pool: FloatArray, periods: int = PERIODS
) -> Experiment:
    """The row of actions that tells two models apart best, as far as a search that keeps KEPT rows sees.

    Args:
        question: the models.
        white: (9, 9) that makes what a period is missed by (Track.missed) of size one.
        start: (3,) pose, as a camera shows it, at which the robot rests.
        pool: (2, 2) see ``pool_of``.
        periods: how many actions at most; fewer where all others leave the pool.
    """
    robot = question.models[0].robot
    sides = [Side(model) for model in question.models]
    rows = [Row((), 0.0, tuple(side.at_rest(start) for side in sides), ())]
    for _ in range(periods):
        reached = [row for row in grow(rows, sides, white, robot) if _is_inside(row.told[-1], pool)]
        if not reached:
            break
        rows = sorted(reached, key=lambda row: -row.square)[:KEPT]
    best = rows[0]
    names = tuple(robot.actions[index].name for index in best.actions)
    at = (float(start[0]), float(start[1]), float(start[2]))
    return Experiment(
        question.between, names, at, _separation(question, white, segments_of_row(robot, best, start))
    )


def separation(question: Question, white: FloatArray, start: FloatArray, actions: Sequence[int]) -> float:
    """How far apart two models predict the periods of a given row; see Experiment.separation_sigma."""
    robot = question.models[0].robot
    sides = [Side(model) for model in question.models]
    row = Row((), 0.0, tuple(side.at_rest(start) for side in sides), ())
    for action in actions:
        (row,) = grow([row], sides, white, robot, [action])
    return _separation(question, white, segments_of_row(robot, row, start))


def _is_inside(shown: FloatArray, pool: FloatArray) -> bool:
    return bool(((shown[:, :2] >= pool[0]) & (shown[:, :2] <= pool[1])).all())


def _separation(question: Question, white: FloatArray, swim: Segments) -> float:
    if not len(swim.start_s):
        return 0.0
    one, other = (
        misses(tracks, np.ones(len(swim.start_s), dtype=bool))
        for tracks in tracks_of(question.models, [swim])
    )
    apart = np.clip((other - one) @ white, -WILD, WILD)
    return float(np.sqrt((apart**2).sum()))
