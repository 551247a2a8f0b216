"""What to record next: optimal experiment design for the discrimination of two models.

Two models explain the runs equally well: the one found, and the one with a confounded effect in its place, or
with a parameter at either end of its interval and all others refitted. From rest both are simulated side by
side. A beam search over sequences of actions keeps the sequences whose periods the two models predict
farthest apart, in units of the residuals' scale (the T-optimality of Atkinson, Fedorov 1975). As with runs,
the second robot is put to the first one's pose when a period begins, so that each period counts by itself.
The separation that is reported for the best sequence is then computed as identification would see it: both
models are rolled out on the first one's fixes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.effects import Law
from frogkick.identification.fit import CONFOUNDED_MARGIN, Model, residuals_of, rollouts_of
from frogkick.identification.paired import ActionSequence, Side, extend, segments_of_sequence
from frogkick.identification.predict import CLIP_SIGMA
from frogkick.identification.refine import fixed_at
from frogkick.identification.search import Found
from frogkick.identification.segments import Segments
from frogkick.identification.steps import whitener
from frogkick.identification.terms import Term
from frogkick.identification.verdict import Interval
from frogkick.robot import in_a_row

PERIODS = 10
"""Periods of a planned sequence."""

BEAM_WIDTH = 3
"""Width of the beam: sequences that are extended."""

WIDE = 0.5
"""An interval that covers this share of a parameter's bounds calls for an experiment."""

PAIRS_MAX = 2
"""Pairs that are planned for at most: each costs some seconds."""

DECISIVE_SIGMA = math.sqrt(CONFOUNDED_MARGIN) + 1.0
"""From this separation on, one recording is decisive: models are confounded up to CONFOUNDED_MARGIN."""

POOL_M = 0.6
"""Side of the square that a sequence stays in, about the middle of the runs, unless these went further."""


@dataclass(frozen=True, eq=False)
class ModelPair:
    """Two models that the runs do not discriminate, and their names."""

    between: tuple[str, str]
    models: tuple[Model, Model]


@dataclass(frozen=True, eq=False)
class Experiment:
    """A sequence of actions from rest.

    Attributes:
        between: names of the two models.
        actions: their names.
        start: pose (world: m, m, rad) that it starts from.
        separation_sigma: distance between both predictions of its periods: norm of the whitened difference.
    """

    between: tuple[str, str]
    actions: tuple[str, ...]
    start: tuple[float, float, float]
    separation_sigma: float

    @property
    def decisive(self) -> bool:
        """Whether one recording discriminates the two models."""
        return self.separation_sigma >= DECISIVE_SIGMA

    @property
    def sequence(self) -> str:
        """Its actions as text."""
        return in_a_row(self.actions)

    @property
    def text(self) -> str:
        """What to record, in words."""
        one, other = self.between
        apart = f"{len(self.actions)} periods, {self.separation_sigma:.1f} sigma apart"
        if self.decisive:
            return f"to distinguish {one} from {other}, record from rest: {self.sequence} ({apart})"
        times = math.ceil((DECISIVE_SIGMA / max(self.separation_sigma, 1e-3)) ** 2)
        if times <= PERIODS:
            return (
                f"to distinguish {one} from {other}, record {times} times from rest: {self.sequence} "
                f"({apart} each)"
            )
        return (
            f"no sequence of these actions from rest distinguishes {one} from {other} "
            f"(the best one is {self.sequence}: {apart})"
        )

    def as_json(self) -> dict[str, Any]:
        """The key of the command."""
        return {
            "between": list(self.between),
            "actions": self.sequence,
            "periods": len(self.actions),
            "separation_sigma": self.separation_sigma,
            "tells": self.decisive,
            "text": self.text,
        }


def experiment_of(
    found: Found, parameters: Sequence[Sequence[Interval]], swims: Sequence[Segments], periods: int = PERIODS
) -> Experiment | None:
    """The experiment that discriminates best what a search left open; None if nothing is open.

    Args:
        found: result of the search.
        parameters: intervals of its effects' parameters.
        swims: the runs; a sequence starts where the first of them did and stays where they went.
        periods: see ``plan``.
    """
    return _best(open_pairs(found, parameters), found, swims, periods)


def law_test(found: Found, swims: Sequence[Segments], periods: int = PERIODS) -> Experiment | None:
    """The experiment that distinguishes a model best from itself without one of its laws; None without laws.

    A formula that was chosen among many is worth a test, even if nothing else is open.

    Args:
        found: result of the search.
        swims: the runs.
        periods: see ``plan``.
    """
    model, pairs = found.fitted.model, []
    for place, term in enumerate(model.terms):
        effect = term.effect()
        if isinstance(effect, Law) and not effect.by_chance:
            terms = (*model.terms[:place], *model.terms[place + 1 :])
            without = replace(model, terms=terms, fixed=frozenset())
            pairs.append(ModelPair((term.title, f"no {term.title}"), (model, without)))
    return _best(pairs, found, swims, periods)


def _best(
    pairs: Sequence[ModelPair], found: Found, swims: Sequence[Segments], periods: int
) -> Experiment | None:
    """The experiment that discriminates one of the pairs best; None without pairs."""
    white = whitener(found.fitted.residuals)
    first = swims[0]
    start = first.pose[np.searchsorted(first.time_s, first.begin_s)]
    pool = pool_of(swims)
    best: Experiment | None = None
    for pair in pairs[:PAIRS_MAX]:
        planned = plan(pair, white, start, pool, periods)
        if best is None or planned.separation_sigma > best.separation_sigma:
            best = planned
        if best.decisive:
            break
    return best


def open_pairs(found: Found, parameters: Sequence[Sequence[Interval]]) -> list[ModelPair]:
    """Pairs of models to discriminate: confounded effects, then parameters, the widest interval first."""
    model, pairs = found.fitted.model, list[ModelPair]()
    for place, others in enumerate(found.rivals):
        for other in others:
            terms = (*model.terms[:place], other, *model.terms[place + 1 :])
            names = (model.terms[place].title, other.title)
            pairs.append(ModelPair(names, (model, replace(model, terms=terms, fixed=frozenset()))))
    wide: list[tuple[float, ModelPair]] = []
    first = 0
    for term, sequence in zip(model.terms, parameters, strict=True):
        for k, (parameter, interval) in enumerate(zip(term.parameters, sequence, strict=True)):
            share = (interval.high - interval.low) / (parameter.high - parameter.low)
            if share >= WIDE:
                wide.append((share, _ends(found, term, first + k, interval)))
        first += len(term.values)
    wide.sort(key=lambda each: -each[0])
    return pairs + [pair for _, pair in wide]


def _ends(found: Found, term: Term, k: int, interval: Interval) -> ModelPair:
    """A parameter at either end of its interval, the others refitted."""
    low, high = (fixed_at(found.fitted, k, end) for end in (interval.low, interval.high))
    names = [f"{term.title} {interval.name} {end:.3g}" for end in (interval.low, interval.high)]
    return ModelPair((names[0], names[1]), (low, high))


def pool_of(swims: Sequence[Segments]) -> Float64:
    """(2, 2) low and high corner of the square that a sequence must stay in."""
    every = np.concatenate([swim.pose[:, :2] for swim in swims])
    low, high = every.min(axis=0), every.max(axis=0)
    half = max(POOL_M, float((high - low).max())) / 2.0
    return np.array([(low + high) / 2.0 - half, (low + high) / 2.0 + half])


def plan(
    pair: ModelPair, white: Float64, start: Float64, pool: Float64, periods: int = PERIODS
) -> Experiment:
    """The sequence of actions that discriminates two models best, by beam search.

    Args:
        pair: the models.
        white: (9, 9) whitening matrix of residuals (Rollout.residuals).
        start: (3,) pose of the robot at rest, as the camera shows it.
        pool: (2, 2) see ``pool_of``.
        periods: actions at most; fewer where all further ones leave the pool.
    """
    robot = pair.models[0].robot
    sides = [Side(model) for model in pair.models]
    sequences = [ActionSequence((), 0.0, tuple(side.at_rest(start) for side in sides), ())]
    for _ in range(periods):
        reached = [
            sequence
            for sequence in extend(sequences, sides, white, robot)
            if _is_inside(sequence.shown[-1], pool)
        ]
        if not reached:
            break
        sequences = sorted(reached, key=lambda sequence: -sequence.distance2)[:BEAM_WIDTH]
    best = sequences[0]
    names = tuple(robot.actions[index].name for index in best.actions)
    at = (float(start[0]), float(start[1]), float(start[2]))
    return Experiment(
        pair.between, names, at, separation(pair, white, segments_of_sequence(robot, best, start))
    )


def _is_inside(shown: Float64, pool: Float64) -> bool:
    return bool(((shown[:, :2] >= pool[0]) & (shown[:, :2] <= pool[1])).all())


def separation(pair: ModelPair, white: Float64, swim: Segments) -> float:
    """Separation of two models on a sequence of the first one; see ``Experiment.separation_sigma``."""
    if not len(swim.start_s):
        return 0.0
    one, other = (
        residuals_of(rollouts, np.ones(len(swim.start_s), dtype=bool))
        for rollouts in rollouts_of(pair.models, [swim])
    )
    apart = np.clip((other - one) @ white, -CLIP_SIGMA, CLIP_SIGMA)
    return float(np.sqrt((apart**2).sum()))
