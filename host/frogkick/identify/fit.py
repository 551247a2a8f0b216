"""Fit effects' parameters to runs: damped Gauss-Newton on whitened innovations, derivatives by batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frogkick.effects.acting import LEG_S
from frogkick.effects.registry import effects_of
from frogkick.identify.filter import Noise, likeliest
from frogkick.identify.predict import PARTS, WILD, Lane, Track, follow
from frogkick.identify.swim import Swim
from frogkick.identify.terms import Term
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

STEP_SHARE = 0.05
"""Of a parameter's range: the step of its finite difference."""


@dataclass(frozen=True, eq=False)
class Model:
    """A robot with effects, and what else moves it.

    Attributes:
        robot: nominal; effects of its own file act too.
        terms: what it lacks.
        noise: of the fixes and of what is not modelled.
        leg_s: how often flows and wrenches are asked.
    """

    robot: Robot
    terms: tuple[Term, ...]
    noise: Noise
    leg_s: float = LEG_S

    def lane(self, swim: Swim) -> Lane:
        """This model on a run."""
        effects = (*effects_of(self.robot), *(term.effect() for term in self.terms))
        return Lane(swim, self.robot, effects, self.noise, self.leg_s)

    def with_values(self, values: FloatArray) -> Model:
        """The same with other values of all terms, in a row."""
        terms, first = [], 0
        for term in self.terms:
            terms.append(term.at(values[first : first + len(term.values)]))
            first += len(term.values)
        return replace(self, terms=tuple(terms))

    @property
    def values(self) -> FloatArray:
        """Of all terms, in a row."""
        return np.array([value for term in self.terms for value in term.values], dtype=np.float64)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Of these."""
        parameters = [p for term in self.terms for p in term.parameters]
        return np.array([p.low for p in parameters]), np.array([p.high for p in parameters])

    @property
    def range(self) -> FloatArray:
        """High minus low of each."""
        low, high = self.bounds
        return np.asarray(high - low, dtype=np.float64)


def tracks_of(models: Sequence[Model], swims: Sequence[Swim]) -> list[list[Track]]:
    """Follow all runs with all models: a list of tracks for each model."""
    tracks = follow([model.lane(swim) for model in models for swim in swims])
    return [tracks[i : i + len(swims)] for i in range(0, len(tracks), max(len(swims), 1))]


def misses(tracks: Sequence[Track], rows: NDArray[np.bool_] | None = None) -> FloatArray:
    """(n, 9) what the predictions of all periods missed; see Track.missed.

    Args:
        tracks: of all runs.
        rows: which of all their periods; by default those whose parts all have fixes.
    """
    every = np.concatenate(
        [np.full_like(track.missed, np.nan) if track.failed else track.missed for track in tracks]
    )
    if rows is None:
        return np.asarray(every[np.isfinite(every).all(axis=1)])
    return np.where(np.isfinite(every[rows]), every[rows], LOST[None, :])


LOST = np.tile([0.1, 0.1, 1.0], len(PARTS))
"""Counted as missed where a simulation failed: m, m, rad."""

_LEAST = np.tile([2e-5, 2e-5, 2e-4], len(PARTS))


def spread_of(missed: FloatArray) -> FloatArray:
    """(9, 9) second moments, never quite singular."""
    return np.asarray(missed.T @ missed / max(len(missed), 1) + np.diag(_LEAST**2))


def cost_of(missed: FloatArray) -> float:
    """Minus twice the log likelihood of misses that are normal with their own second moments."""
    return float(len(missed) * np.linalg.slogdet(spread_of(missed))[1])


def renoised(model: Model, tracks: Sequence[Track], swims: Sequence[Swim]) -> Model:
    """The same with the noise under which these tracks are likeliest."""
    series = [track.series(swim) for track, swim in zip(tracks, swims, strict=True) if not track.failed]
    return replace(model, noise=likeliest(series)) if series else model


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model fitted to runs.

    Attributes:
        model: with the values found.
        tracks: of the runs.
        missed: (n, 9) of the periods that count.
        jacobian: (n, 9, p) of these by the parameters.
        cost: minus twice the log likelihood.
    """

    model: Model
    tracks: list[Track]
    missed: FloatArray
    jacobian: FloatArray
    cost: float


def steps_of(model: Model) -> FloatArray:
    """(p,) steps for finite differences, turned around where they would leave the bounds."""
    low, high = model.bounds
    step = STEP_SHARE * (high - low)
    return np.where(model.values + step > high, -step, step)


def derivatives(
    model: Model, swims: Sequence[Swim], rows: NDArray[np.bool_]
) -> tuple[list[Track], FloatArray, FloatArray]:
    """Tracks at a model, its misses (n, 9), and their (n, 9, p) derivatives by the parameters."""
    values, step = model.values, steps_of(model)
    models = [model]
    for k in range(len(values)):
        moved = values.copy()
        moved[k] += step[k]
        models.append(model.with_values(moved))
    every = tracks_of(models, swims)
    base = misses(every[0], rows)
    columns = [(misses(tracks, rows) - base) / step[k] for k, tracks in enumerate(every[1:])]
    return every[0], base, np.stack(columns, axis=2) if columns else np.empty((*base.shape, 0))


DAMPINGS = (1e-6, 1e-3, 1e-1, 10.0)


def fit(model: Model, swims: Sequence[Swim], rows: NDArray[np.bool_], rounds: int = 6) -> Fitted:
    """Fit all parameters of a model's terms to runs, at its noise.

    Args:
        model: where to start.
        swims: the runs.
        rows: periods that count.
        rounds: steps taken at most.
    """
    tracks, missed, jacobian = derivatives(model, swims, rows)
    cost = cost_of(missed)
    for _ in range(rounds if len(model.values) else 0):
        low, high = model.bounds
        white = whitener(missed)
        flat, columns = whiten(white, missed, jacobian)
        tries = []
        for damping in DAMPINGS:
            delta = bounded_step(
                columns, flat, damping * len(flat) / model.range**2, low - model.values, high - model.values
            )
            tries.append(model.with_values(model.values + delta))
        costs = [cost_of(misses(each, rows)) for each in tracks_of(tries, swims)]
        best = int(np.argmin(costs))
        gain = cost - costs[best]
        if not gain > 0.0:
            break
        model = tries[best]
        tracks, missed, jacobian = derivatives(model, swims, rows)
        cost = cost_of(missed)
        if gain < 0.2:
            break
    return Fitted(model, tracks, missed, jacobian, cost)


def whitener(missed: FloatArray) -> FloatArray:
    """(9, 9) that makes misses uncorrelated and of size one: rows times it."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(spread_of(missed))).T)


def whiten(white: FloatArray, missed: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(9 n,) misses and (9 n, p) derivatives, whitened; wild ones are cut."""
    flat = np.clip(missed @ white, -WILD, WILD).ravel()
    columns = np.einsum("nip,ij->njp", jacobian, white)
    return flat, columns.reshape(missed.size, jacobian.shape[2])


def bounded_step(
    jacobian: FloatArray, residual: FloatArray, damping: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """(p,) step that makes residual + jacobian step smallest within bounds, by fixing what hits them."""
    normal = jacobian.T @ jacobian + np.diag(damping)
    right = -jacobian.T @ residual
    step = np.zeros(len(right))
    free = np.ones(len(right), dtype=bool)
    for _ in range(len(right) + 1):
        if not free.any():
            break
        held = right[free] - normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.lstsq(normal[np.ix_(free, free)], held, rcond=1e-12)[0]
        out = free & ((step < low) | (step > high))
        step = np.clip(step, low, high)
        if not out.any():
            break
        free &= ~out
    return step
