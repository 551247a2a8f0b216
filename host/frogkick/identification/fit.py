"""Fit effects' parameters to runs: damped Gauss-Newton (Levenberg 1944, Marquardt 1963) on whitened
residuals.

Derivatives are finite differences, simulated in batches. Only steps are simulated each time; a Jacobian is
refreshed where its prediction was wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Bool, Float64
from frogkick.effects.acting import LEG_S
from frogkick.effects.registry import effects_of
from frogkick.identification.batching import roll_out
from frogkick.identification.filter import Noise, maximum_likelihood_noise
from frogkick.identification.predict import PHASES, STEP_S, Lane, Rollout
from frogkick.identification.segments import Segments
from frogkick.identification.steps import CONVERGED, deviance_of, linearised_optimum
from frogkick.identification.terms import Term
from frogkick.robot import Robot

STEP_SHARE = 0.05
"""Share of a parameter's range: the step of its finite difference, where it names none."""


SEGMENTS = 6
"""Segments of a coarsened frame's edge: turns are off by 0.2 degrees, at twice the speed."""


@dataclass(frozen=True, eq=False)
class Model:
    """A robot with effects and noise.

    Attributes:
        robot: nominal; the effects in its own file act too.
        terms: the effects added to it.
        noise: measurement and process noise.
        leg_s: how often flows and wrenches are evaluated.
        step_s: finest time step.
        fixed: indices into ``values``: parameters that a fit does not change.
    """

    robot: Robot
    terms: tuple[Term, ...]
    noise: Noise
    leg_s: float = LEG_S
    step_s: float = STEP_S
    fixed: frozenset[int] = frozenset()

    def lane(self, swim: Segments) -> Lane:
        """This model on a run, with the strokes that its limbs have at the run's own period."""
        every = (*effects_of(self.robot), *(term.effect() for term in self.terms))
        effects = tuple(effect.likeliest() for effect in every)
        return Lane(swim, self.robot.at_period(swim.period_s), effects, self.noise, self.leg_s, self.step_s)

    def with_values(self, values: Float64) -> Model:
        """The same with other values of all terms, concatenated."""
        terms, first = [], 0
        for term in self.terms:
            terms.append(term.at(values[first : first + len(term.values)]))
            first += len(term.values)
        return replace(self, terms=tuple(terms))

    @property
    def values(self) -> Float64:
        """Parameters of all terms, concatenated."""
        return np.array([value for term in self.terms for value in term.values], dtype=np.float64)

    @property
    def bounds(self) -> tuple[Float64, Float64]:
        """Lower and upper bounds of the values."""
        parameters = [p for term in self.terms for p in term.parameters]
        return np.array([p.low for p in parameters]), np.array([p.high for p in parameters])

    @property
    def range(self) -> Float64:
        """High minus low of each."""
        low, high = self.bounds
        return np.asarray(high - low, dtype=np.float64)


def coarsened(robot: Robot) -> Robot:
    """The robot with a frame of fewer segments: for derivatives, not for residuals."""
    frame = robot.frame
    segments = tuple(min(count, SEGMENTS) for count in frame.segments)
    return replace(robot, frame=replace(frame, segments=segments))


def rollouts_of(models: Sequence[Model], swims: Sequence[Segments]) -> list[list[Rollout]]:
    """Roll out all models on all runs: a list of rollouts for each model."""
    rollouts = roll_out([model.lane(swim) for model in models for swim in swims])
    return [rollouts[i : i + len(swims)] for i in range(0, len(rollouts), max(len(swims), 1))]


def residuals_of(rollouts: Sequence[Rollout], rows: Bool | None = None) -> Float64:
    """(n, 9) residuals of all periods; see Rollout.residuals.

    Args:
        rollouts: of all runs.
        rows: which of all their periods; by default those with fixes in every phase.
    """
    every = np.concatenate(
        [
            np.full_like(rollout.residuals, np.nan) if rollout.failed else rollout.residuals
            for rollout in rollouts
        ]
    )
    if rows is None:
        return np.asarray(every[np.isfinite(every).all(axis=1)])
    return np.where(np.isfinite(every[rows]), every[rows], DIVERGED[None, :])


DIVERGED = np.tile([0.1, 0.1, 1.0], len(PHASES))
"""Residual of a simulation that diverged: m, m, rad."""


def reestimated_noise(model: Model, rollouts: Sequence[Rollout], swims: Sequence[Segments]) -> Model:
    """The same with the maximum-likelihood noise of these rollouts."""
    series = [
        rollout.series(swim) for rollout, swim in zip(rollouts, swims, strict=True) if not rollout.failed
    ]
    return replace(model, noise=maximum_likelihood_noise(series)) if series else model


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model fitted to runs.

    Attributes:
        model: at the fitted values.
        rollouts: of the runs.
        residuals: (n, 9) of the periods that are used.
        jacobian: (n, 9, p) derivatives of the residuals by the parameters.
        deviance: minus twice the log likelihood of the residuals.
        fresh: the Jacobian is of these values and this noise; else it is of an earlier point.
    """

    model: Model
    rollouts: list[Rollout]
    residuals: Float64
    jacobian: Float64
    deviance: float
    fresh: bool = True

    def first(self, count: int) -> Fitted:
        """The same with the first so many terms, where the others change no prediction."""
        terms = self.model.terms[:count]
        width = sum(len(term.values) for term in terms)
        model = replace(self.model, terms=terms, fixed=frozenset(k for k in self.model.fixed if k < width))
        return replace(self, model=model, jacobian=self.jacobian[:, :, :width])


def difference_steps(model: Model) -> Float64:
    """(p,) steps of finite differences, reversed where they would leave the bounds.

    A parameter may declare a long step. It is for the point where its effect vanishes; elsewhere it would
    step over what a fit is about to find.
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
    rows: Bool,
    known: Float64 | None = None,
    fixed: bool = True,
) -> list[Fitted]:
    """Evaluate models with their Jacobians, all simulated in one batch.

    Args:
        models: at the values to evaluate.
        swims, rows: see ``fit``.
        known: (n, 9, q) derivatives by the first q parameters of every model, which are not simulated again.
        fixed: also differentiate by fixed parameters; a fit does not need these, and they are zero without.
    """
    skipped = 0 if known is None else known.shape[2]
    lanes, steps = [], []
    for model in models:
        step = difference_steps(model)
        steps.append(step)
        lanes.append(model)
        for k in _differentiated(model, skipped, fixed):
            moved = model.values
            moved[k] += step[k]
            lanes.append(model.with_values(moved))
    every = iter(rollouts_of(lanes, swims))
    found = []
    for model, step in zip(models, steps, strict=True):
        rollouts = next(every)
        base = residuals_of(rollouts, rows)
        new = np.zeros((*base.shape, len(step) - skipped))
        for k in _differentiated(model, skipped, fixed):
            new[:, :, k - skipped] = (residuals_of(next(every), rows) - base) / step[k]
        jacobian = new if known is None else np.concatenate([known, new], axis=2)
        found.append(Fitted(model, rollouts, base, jacobian, deviance_of(base)))
    return found


def _differentiated(model: Model, skipped: int, fixed: bool) -> list[int]:
    """Indices of the parameters whose derivatives are simulated."""
    return [k for k in range(skipped, len(model.values)) if fixed or k not in model.fixed]


DAMPINGS, STEP_SHARES = (1e-6, 1e-1, 30.0), (1.0, 0.4, 0.1)
"""For a step that failed k times: damping in units of a parameter's range, for what the runs hardly
determine; and the share of the step that is taken, for what acts strongly and unevenly, such as the push of a
wall."""

MISPREDICTION_MAX = 0.2
"""The Jacobian is refreshed where a step's gain differs by more than this share from the predicted one."""

STALE_GAIN = 4.0
"""Or where a step by the Jacobian of an earlier point still gains this much: with a good one the step before
had been the last."""

SMALL_SHARE = 0.25
"""A step is not simulated if it is predicted to gain less than this share of the fall that ends a fit."""


def evaluate(
    models: Sequence[Model], jacobians: Sequence[Float64], swims: Sequence[Segments], rows: Bool
) -> list[Fitted]:
    """Evaluate models by simulation; their Jacobians are those of a nearby point."""
    found = []
    for model, jacobian, rollouts in zip(models, jacobians, rollouts_of(models, swims), strict=True):
        residuals = residuals_of(rollouts, rows)
        found.append(Fitted(model, rollouts, residuals, jacobian, deviance_of(residuals), fresh=False))
    return found


def refresh_jacobian(
    fits: Sequence[Fitted], swims: Sequence[Segments], rows: Bool, skipped: int = 0, fixed: bool = True
) -> list[Fitted]:
    """Refresh Jacobians at the present values; columns that are up to date are not simulated again.

    Args:
        fits: the fits to refresh.
        swims, rows: see ``fit``.
        skipped: the first so many parameters keep their derivatives.
        fixed: see ``derivatives``.
    """
    lanes, wanted = [], []
    for fitted in fits:
        step = difference_steps(fitted.model)
        some = [
            k
            for k in _differentiated(fitted.model, skipped, fixed)
            if not fitted.fresh or not fitted.jacobian[:, :, k].any()
        ]
        wanted.append([(k, float(step[k])) for k in some])
        for k in some:
            moved = fitted.model.values
            moved[k] += step[k]
            lanes.append(fitted.model.with_values(moved))
    every, found = iter(rollouts_of(lanes, swims)), []
    for fitted, columns in zip(fits, wanted, strict=True):
        jacobian = fitted.jacobian.copy()
        for k, step_k in columns:
            jacobian[:, :, k] = (residuals_of(next(every), rows) - fitted.residuals) / step_k
        found.append(replace(fitted, jacobian=jacobian, fresh=True))
    return found


def fit(
    model: Model, swims: Sequence[Segments], rows: Bool, steps_max: int = 6, tolerance: float = CONVERGED
) -> Fitted:
    """Fit all free parameters of a model's terms to runs, at its noise.

    Args:
        model: where to start.
        swims: the runs.
        rows: periods that are used.
        steps_max: steps at most.
        tolerance: a fall of the deviance that ends a fit.
    """
    return fit_many([model], swims, rows, steps_max, tolerance=tolerance)[0]


def fit_many(
    models: Sequence[Model],
    swims: Sequence[Segments],
    rows: Bool,
    steps_max: int,
    known: Float64 | None = None,
    tolerance: float = CONVERGED,
) -> list[Fitted]:
    """Fit several models in one batch; see ``fit`` and ``derivatives``, here without fixed parameters."""
    start_fits = derivatives(models, swims, rows, known, fixed=False)
    return fit_on(start_fits, swims, rows, steps_max, 0 if known is None else known.shape[2], tolerance)


def fit_on(
    start_fits: Sequence[Fitted],
    swims: Sequence[Segments],
    rows: Bool,
    steps_max: int,
    skipped: int = 0,
    tolerance: float = CONVERGED,
) -> list[Fitted]:
    """Fit several models in one batch from evaluated starts with the Jacobians that they have.

    Only steps are simulated. A Jacobian is refreshed where it mispredicted: a step gained much less or more
    than the linearised optimum, or lost; or it was of an earlier point and the step still gained much.

    Args:
        start_fits: where to start.
        swims, rows, steps_max: see ``fit``.
        skipped: the first so many parameters keep their derivatives.
        tolerance: a fall of the deviance that ends a fit.
    """
    best = list(start_fits)
    failed = [0 if len(each.model.values) else len(DAMPINGS) for each in best]
    for turn in range(steps_max):
        tries = {k: _damped_step(each, failed[k]) for k, each in enumerate(best) if failed[k] < len(DAMPINGS)}
        for k, (_, deviance) in list(tries.items()):
            if best[k].fresh and best[k].deviance - deviance < SMALL_SHARE * tolerance:
                failed[k] = len(DAMPINGS)  # converged
                del tries[k]
        if not tries:
            break
        jacobians = [best[k].jacobian for k in tries]
        stale = []
        ends = evaluate([model for model, _ in tries.values()], jacobians, swims, rows)
        for (k, (_, deviance)), tried in zip(tries.items(), ends, strict=True):
            gain, predicted, fresh = (
                best[k].deviance - tried.deviance,
                best[k].deviance - deviance,
                best[k].fresh,
            )
            mispredicted = abs(gain - predicted) > max(MISPREDICTION_MAX * predicted, tolerance)
            if gain > 0.0:
                best[k] = tried
            if not fresh and (mispredicted or gain > STALE_GAIN):
                stale.append(k)
            elif abs(gain) < tolerance:
                failed[k] = len(DAMPINGS)  # converged
            elif gain > 0.0:
                failed[k] = 0
                if mispredicted:
                    stale.append(k)
            else:
                failed[k] += 1  # the step was too long
        if stale and turn + 1 < steps_max:
            fits = refresh_jacobian([best[k] for k in stale], swims, rows, skipped, fixed=False)
            best = [dict(zip(stale, fits, strict=True)).get(k, each) for k, each in enumerate(best)]
    return best


def _damped_step(fitted: Fitted, failed: int) -> tuple[Model, float]:
    """The model one damped Gauss-Newton step further, and the deviance that is predicted for it."""
    model = fitted.model
    damping = DAMPINGS[failed] * fitted.residuals.size / model.range**2
    step, deviance = linearised_optimum(fitted.residuals, fitted.jacobian, *step_bounds(model), damping)
    if STEP_SHARES[failed] < 1.0:
        step = STEP_SHARES[failed] * step
        deviance = deviance_of(fitted.residuals + fitted.jacobian @ step)
    return model.with_values(model.values + step), deviance


def step_bounds(model: Model) -> tuple[Float64, Float64]:
    """(p,) bounds of a step, down and up: zero for fixed parameters."""
    low, high = model.bounds
    free = np.array([k not in model.fixed for k in range(len(low))], dtype=np.float64)
    return (low - model.values) * free, (high - model.values) * free
