"""Fit effects' parameters to runs: damped Gauss-Newton on whitened innovations, derivatives by batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frogkick.effects.acting import LEG_S
from frogkick.effects.registry import effects_of
from frogkick.identification.filter import Noise, likeliest
from frogkick.identification.predict import PARTS, STEP_S, Lane, Track
from frogkick.identification.segments import Segments
from frogkick.identification.steps import CLOSE, cost_of, promised
from frogkick.identification.terms import Term
from frogkick.identification.together import follow
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

STEP_SHARE = 0.05
"""Of a parameter's range: the step of its finite difference, where it names none."""


SEGMENTS = 6
"""Of a frame's edge where it is coarse: its robot turns 0.2 degrees off, at twice the speed."""


@dataclass(frozen=True, eq=False)
class Model:
    """A robot with effects, and what else moves it.

    Attributes:
        robot: nominal; effects of its own file act too.
        terms: what it lacks.
        noise: of the fixes and of what is not modelled.
        leg_s: how often flows and wrenches are asked.
        step_s: finest time step.
        held: which of the values, counted in a row, a fit leaves as they are.
    """

    robot: Robot
    terms: tuple[Term, ...]
    noise: Noise
    leg_s: float = LEG_S
    step_s: float = STEP_S
    held: frozenset[int] = frozenset()

    def lane(self, swim: Segments) -> Lane:
        """This model on a run, its limbs' strokes as they are at the run's own period."""
        effects = (*effects_of(self.robot), *(term.effect() for term in self.terms))
        return Lane(swim, self.robot.at_period(swim.period_s), effects, self.noise, self.leg_s, self.step_s)

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


def coarse(robot: Robot) -> Robot:
    """The robot with a frame of fewer pieces: for what changes with parameters, not for how well it fits."""
    frame = robot.frame
    segments = tuple(min(count, SEGMENTS) for count in frame.segments)
    return replace(robot, frame=replace(frame, segments=segments))


def tracks_of(models: Sequence[Model], swims: Sequence[Segments]) -> list[list[Track]]:
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


def renoised(model: Model, tracks: Sequence[Track], swims: Sequence[Segments]) -> Model:
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
        fresh: the derivatives are of these values and this noise; else of some that are not far.
    """

    model: Model
    tracks: list[Track]
    missed: FloatArray
    jacobian: FloatArray
    cost: float
    fresh: bool = True


def steps_of(model: Model) -> FloatArray:
    """(p,) steps for finite differences, turned around where they would leave the bounds.

    The long step that a parameter may ask for is for where its effect vanishes; elsewhere it would pass over
    what a fit is about to find.
    """
    low, high = model.bounds
    flat = [p for term in model.terms for p in term.parameters]
    given = np.array([p.step for p in flat])
    usual = STEP_SHARE * (high - low)
    away = model.values != np.array([p.nominal for p in flat])
    step = np.where(given > 0.0, np.where(away, np.minimum(given, usual), given), usual)
    return np.where(model.values + step > high, -step, step)


def derivatives(
    models: Sequence[Model],
    swims: Sequence[Segments],
    rows: NDArray[np.bool_],
    known: FloatArray | None = None,
    held: bool = True,
) -> list[Fitted]:
    """Models as they are, with derivatives by their parameters; all are simulated side by side.

    Args:
        models: at their values.
        swims, rows: see ``fit``.
        known: (n, 9, q) derivatives by the first q parameters of every model, which are taken as they are.
        held: also by those that are held: a fit has no need of these, and they are nought without.
    """
    skipped = 0 if known is None else known.shape[2]
    lanes, steps = [], []
    for model in models:
        step = steps_of(model)
        steps.append(step)
        lanes.append(model)
        for k in _told(model, skipped, held):
            moved = model.values
            moved[k] += step[k]
            lanes.append(model.with_values(moved))
    every = iter(tracks_of(lanes, swims))
    found = []
    for model, step in zip(models, steps, strict=True):
        tracks = next(every)
        base = misses(tracks, rows)
        new = np.zeros((*base.shape, len(step) - skipped))
        for k in _told(model, skipped, held):
            new[:, :, k - skipped] = (misses(next(every), rows) - base) / step[k]
        jacobian = new if known is None else np.concatenate([known, new], axis=2)
        found.append(Fitted(model, tracks, base, jacobian, cost_of(base)))
    return found


def _told(model: Model, skipped: int, held: bool) -> list[int]:
    """Parameters of a model whose derivatives are simulated."""
    return [k for k in range(skipped, len(model.values)) if held or k not in model.held]


DAMPINGS, SHARES = (1e-6, 1e-1, 30.0), (1.0, 0.4, 0.1)
"""Of a step that has failed so many times: damping in units of a parameter's range, for what the runs hardly
show; and a part of the step, for what they show sharply and unevenly, such as the push of a wall."""

SURPRISE = 0.2
"""Derivatives are simulated anew where a step gains another share more or less than they promised."""

STALE_GAIN = 4.0
"""Or where a step by those of an earlier point still gains as much: had they held, the step before had been
the last."""


def begun_at(
    models: Sequence[Model],
    jacobians: Sequence[FloatArray],
    swims: Sequence[Segments],
    rows: NDArray[np.bool_],
) -> list[Fitted]:
    """Models simulated as they are; derivatives are taken from where those of others are near."""
    found = []
    for model, jacobian, tracks in zip(models, jacobians, tracks_of(models, swims), strict=True):
        missed = misses(tracks, rows)
        found.append(Fitted(model, tracks, missed, jacobian, cost_of(missed), fresh=False))
    return found


def told(
    fits: Sequence[Fitted],
    swims: Sequence[Segments],
    rows: NDArray[np.bool_],
    skipped: int = 0,
    held: bool = True,
) -> list[Fitted]:
    """The same with derivatives of their values, where they are simulated already only those that lack.

    Args:
        fits: as they are.
        swims, rows: see ``fit``.
        skipped: so many first parameters keep their derivatives.
        held: see ``derivatives``.
    """
    lanes, wanted = [], []
    for fitted in fits:
        step = steps_of(fitted.model)
        some = [
            k
            for k in _told(fitted.model, skipped, held)
            if not fitted.fresh or not fitted.jacobian[:, :, k].any()
        ]
        wanted.append([(k, float(step[k])) for k in some])
        for k in some:
            moved = fitted.model.values
            moved[k] += step[k]
            lanes.append(fitted.model.with_values(moved))
    every, found = iter(tracks_of(lanes, swims)), []
    for fitted, columns in zip(fits, wanted, strict=True):
        jacobian = fitted.jacobian.copy()
        for k, step_k in columns:
            jacobian[:, :, k] = (misses(next(every), rows) - fitted.missed) / step_k
        found.append(replace(fitted, jacobian=jacobian, fresh=True))
    return found


def fit(model: Model, swims: Sequence[Segments], rows: NDArray[np.bool_], rounds: int = 6) -> Fitted:
    """Fit all parameters of a model's terms to runs, at its noise.

    Args:
        model: where to start.
        swims: the runs.
        rows: periods that count.
        rounds: steps tried at most.
    """
    return fit_many([model], swims, rows, rounds)[0]


def fit_many(
    models: Sequence[Model],
    swims: Sequence[Segments],
    rows: NDArray[np.bool_],
    rounds: int,
    known: FloatArray | None = None,
    close: float = CLOSE,
) -> list[Fitted]:
    """Fit several models side by side; see ``fit`` and ``derivatives``, here without those held."""
    begun = derivatives(models, swims, rows, known, held=False)
    return fit_on(begun, swims, rows, rounds, 0 if known is None else known.shape[2], close)


def fit_on(
    begun: Sequence[Fitted],
    swims: Sequence[Segments],
    rows: NDArray[np.bool_],
    rounds: int,
    skipped: int = 0,
    close: float = CLOSE,
) -> list[Fitted]:
    """Fit several models side by side from where they stand with the derivatives that they have.

    Only steps are simulated, side by side; derivatives are again where they have misled: a step gained much
    less or more than they promised, or lost; or they were of an earlier point and it still gained much.

    Args:
        begun: where to start.
        swims, rows, rounds: see ``fit``.
        skipped: so many first parameters keep their derivatives.
        close: a fall of the cost that ends a fit.
    """
    best = list(begun)
    failed = [0 if len(each.model.values) else len(DAMPINGS) for each in best]
    for turn in range(rounds):
        going = [k for k in range(len(best)) if failed[k] < len(DAMPINGS)]
        if not going:
            break
        tries = [_stepped(best[k], failed[k]) for k in going]
        jacobians = [best[k].jacobian for k in going]
        misled = []
        ends = begun_at([model for model, _ in tries], jacobians, swims, rows)
        for k, (_, cost), tried in zip(going, tries, ends, strict=True):
            gain, promise, fresh = best[k].cost - tried.cost, best[k].cost - cost, best[k].fresh
            let_down = abs(gain - promise) > max(SURPRISE * promise, close)
            if gain > 0.0:
                best[k] = tried
            if not fresh and (let_down or gain > STALE_GAIN):
                misled.append(k)
            elif abs(gain) < close:
                failed[k] = len(DAMPINGS)  # a step that changes next to nothing has arrived
            elif gain > 0.0:
                failed[k] = 0
                if let_down:
                    misled.append(k)
            else:
                failed[k] += 1  # it was too long
        if misled and turn + 1 < rounds:
            fits = told([best[k] for k in misled], swims, rows, skipped, held=False)
            best = [dict(zip(misled, fits, strict=True)).get(k, each) for k, each in enumerate(best)]
    return best


def _stepped(fitted: Fitted, failed: int) -> tuple[Model, float]:
    """The model one Gauss-Newton step further, a shyer one after failures, and the cost that is promised."""
    model = fitted.model
    shy = DAMPINGS[failed] * fitted.missed.size / model.range**2
    step, cost = promised(fitted.missed, fitted.jacobian, *room_of(model), shy)
    if SHARES[failed] < 1.0:
        step = SHARES[failed] * step
        cost = cost_of(fitted.missed + fitted.jacobian @ step)
    return model.with_values(model.values + step), cost


def room_of(model: Model) -> tuple[FloatArray, FloatArray]:
    """(p,) how far values may move down and up: not at all where they are held."""
    low, high = model.bounds
    free = np.array([k not in model.held for k in range(len(low))], dtype=np.float64)
    return (low - model.values) * free, (high - model.values) * free
