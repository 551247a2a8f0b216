"""Fit effects' parameters to runs: damped Gauss-Newton (Levenberg 1944, Marquardt 1963) on whitened
residuals.

Derivatives are finite differences, simulated in batches. Only steps are simulated each time; a Jacobian is
refreshed where its prediction was wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Bool, Float64
from frogkick.effects import Effect, Parameter
from frogkick.effects.acting import LEG_S
from frogkick.effects.registry import effects_of
from frogkick.identification.batching import roll_out
from frogkick.identification.filter import Noise, maximum_likelihood_noise
from frogkick.identification.predict import PHASES, STEP_S, Lane, Rollout
from frogkick.identification.segments import Data, Segments
from frogkick.identification.steps import CONVERGED, deviance_of, linearised_optimum
from frogkick.identification.terms import Term
from frogkick.robot import Robot

STEP_SHARE = 0.05  # share of a parameter's range: the step of its finite difference, where it names none
SEGMENTS = 6  # segments of a coarsened frame's edge: turns are off by 0.2 degrees, at twice the speed

EFFECT_PENALTY, PARAMETER_PENALTY = 20.0, 4.0
"""What each effect, and each free parameter, must gain to be taken, in units of the deviance.

It differs from the Bayesian information criterion (Schwarz 1978), whose penalty is ln(n) for each parameter:
here the penalty of a parameter does not grow with the number n of periods (4 is BIC's at 55 periods), and an
effect has a penalty of its own, because it is the best of many candidates.
"""

CONFOUNDED_MARGIN = 15.0
"""Effects whose penalised deviances differ by less are confounded: the data cannot tell them apart."""

REFINING_LEG_S = 0.06  # time between evaluations of flows and wrenches while effects are fitted
WRENCH_LEG_S = 0.03  # the same while a model with wrenches is refined: they lag by half of it


@dataclass(frozen=True, eq=False)
class Model:
    """A robot with effects and noise."""

    robot: Robot  # nominal; the effects in its own file act too
    terms: tuple[Term, ...]  # the effects added to it
    noise: Noise  # measurement and process noise
    leg_s: float = LEG_S  # how often flows and wrenches are evaluated
    step_s: float = STEP_S  # finest time step
    fixed: frozenset[int] = frozenset()  # indices into ``values``: parameters that a fit does not change

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All effects, those of the robot's own file first, as a prediction takes them."""
        every = (*effects_of(self.robot), *(term.effect() for term in self.terms))
        return tuple(effect.likeliest() for effect in every)

    def lane(self, swim: Segments) -> Lane:
        """This model on a run, with the strokes that its limbs have at the run's own period."""
        robot = self.robot.at_period(swim.period_s)
        return Lane(swim, robot, self.effects, self.noise, self.leg_s, self.step_s)

    def with_values(self, values: Float64) -> Model:
        """The same with other values of all terms, concatenated."""
        places = [self.indices(place) for place in range(len(self.terms))]
        terms = (term.at(values[own]) for term, own in zip(self.terms, places, strict=True))
        return replace(self, terms=tuple(terms))

    @property
    def values(self) -> Float64:
        """Parameters of all terms, concatenated."""
        return np.array([value for term in self.terms for value in term.values], dtype=np.float64)

    @property
    def free_count(self) -> int:
        """Number of free parameters."""
        return len(self.values) - len(self.fixed)

    @property
    def parameters(self) -> list[Parameter]:
        """Declarations of the parameters, in the order of ``values``."""
        return [parameter for term in self.terms for parameter in term.parameters]

    @property
    def bounds(self) -> tuple[Float64, Float64]:
        """Lower and upper bounds of the values."""
        return np.array([p.low for p in self.parameters]), np.array([p.high for p in self.parameters])

    @property
    def reach(self) -> Float64:
        """(p,) upper bounds minus lower bounds."""
        low, high = self.bounds
        return np.asarray(high - low, dtype=np.float64)

    def indices(self, place: int) -> range:
        """Indices into ``values`` of a term's parameters."""
        first = sum(len(term.values) for term in self.terms[:place])
        return range(first, first + len(self.terms[place].values))

    def without(self, place: int) -> Model:
        """The model without one of its terms."""
        gone = self.indices(place)
        fixed = frozenset(k if k < gone.start else k - len(gone) for k in self.fixed if k not in gone)
        return replace(self, terms=self.terms[:place] + self.terms[place + 1 :], fixed=fixed)

    def with_term_at(self, place: int, term: Term) -> Model:
        """Put a term in a place (-1: the last); its parameters are free unless they are nominal."""
        place %= len(self.terms)
        left = self.without(place)
        first, count = self.indices(place).start, len(term.values)
        pairs = zip(term.values, term.parameters, strict=True)
        there = {first + k for k, (value, parameter) in enumerate(pairs) if value == parameter.nominal}
        fixed = {k if k < first else k + count for k in left.fixed} | there
        terms = (*left.terms[:place], term, *left.terms[place:])
        changed = replace(left, terms=terms, fixed=frozenset(fixed))
        return replace(changed, leg_s=changed.fine_leg_s)

    @property
    def fine_leg_s(self) -> float:
        """How often flows and wrenches are evaluated where the model is refined."""
        effects = [term.effect() for term in self.terms]
        if any(effect.stiff for effect in effects):
            return LEG_S
        pushes = any(effect.overrides("wrench") for effect in effects)
        return WRENCH_LEG_S if pushes else REFINING_LEG_S


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
    """(n, 9) residuals of some periods, by default those with fixes in every phase; see Rollout.residuals."""
    every = np.concatenate(
        [
            np.full_like(rollout.residuals, np.nan) if rollout.failed else rollout.residuals
            for rollout in rollouts
        ]
    )
    if rows is None:
        return np.asarray(every[np.isfinite(every).all(axis=1)])
    return np.where(np.isfinite(every[rows]), every[rows], DIVERGED[None, :])


DIVERGED = np.tile([0.1, 0.1, 1.0], len(PHASES))  # residual of a simulation that diverged: m, m, rad


def reestimated_noise(model: Model, rollouts: Sequence[Rollout], swims: Sequence[Segments]) -> Model:
    """The same with the maximum-likelihood noise of these rollouts."""
    series = [
        rollout.series(swim) for rollout, swim in zip(rollouts, swims, strict=True) if not rollout.failed
    ]
    return replace(model, noise=maximum_likelihood_noise(series)) if series else model


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model fitted to runs."""

    model: Model  # at the fitted values
    rollouts: list[Rollout]  # of the runs
    residuals: Float64  # (n, 9) of the periods that are used
    jacobian: Float64  # (n, 9, p) derivatives of the residuals by the parameters
    deviance: float  # minus twice the log likelihood of the residuals
    fresh: bool = True  # the Jacobian is of these values and this noise; else it is of an earlier point

    @classmethod
    def of(cls, model: Model, rollouts: list[Rollout], data: Data, jacobian: Float64 | None = None) -> Fitted:
        """A model as simulated, with the Jacobian of a nearby point; without one it has no derivatives."""
        residuals = residuals_of(rollouts, data.rows)
        known = np.empty((*residuals.shape, 0)) if jacobian is None else jacobian
        return cls(model, rollouts, residuals, known, deviance_of(residuals), fresh=jacobian is None)

    @property
    def penalised_deviance(self) -> float:
        """Deviance plus the penalty of the free parameters, without that of the effects."""
        return self.deviance + PARAMETER_PENALTY * self.model.free_count

    def first(self, count: int) -> Fitted:
        """The same with the first ``count`` terms, where the others change no prediction."""
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
    given = np.array([p.step for p in model.parameters])
    usual = STEP_SHARE * (high - low)
    away = model.values != np.array([p.nominal for p in model.parameters])
    step = np.where(given > 0.0, np.where(away, np.minimum(given, usual), given), usual)
    return np.where(model.values + step > high, -step, step)


def derivatives(
    models: Sequence[Model], data: Data, known: Float64 | None = None, fixed: bool = True
) -> list[Fitted]:
    """Evaluate models with their Jacobians, all simulated in one batch.

    Args:
        known: (n, 9, q) derivatives by the first q parameters of every model, which are not simulated again.
        fixed: also differentiate by fixed parameters; a fit does not need these, and they are zero without.
    """
    skipped = 0 if known is None else known.shape[2]
    columns = [_differentiated(model, skipped, fixed) for model in models]
    pairs = list(zip(models, columns, strict=True))
    every = iter(rollouts_of([lane for pair in pairs for lane in (pair[0], *_moved(*pair))], data.swims))
    found = []
    for model, some in pairs:
        plain = Fitted.of(model, next(every), data)
        jacobian = np.zeros((*plain.residuals.shape, len(model.values)))
        if known is not None:
            jacobian[:, :, :skipped] = known
        found.append(_with_columns(replace(plain, jacobian=jacobian), some, every, data))
    return found


def _differentiated(model: Model, skipped: int, fixed: bool) -> list[int]:
    """Indices of the parameters whose derivatives are simulated."""
    return [k for k in range(skipped, len(model.values)) if fixed or k not in model.fixed]


def _moved(model: Model, columns: Sequence[int]) -> list[Model]:
    """The model with each of some parameters one step of a finite difference further."""
    step = np.diag(difference_steps(model))
    return [model.with_values(model.values + step[k]) for k in columns]


def _with_columns(
    fitted: Fitted, columns: Sequence[int], moved: Iterator[list[Rollout]], data: Data
) -> Fitted:
    """The fit with derivatives by some parameters from the rollouts of the moved models."""
    step, jacobian = difference_steps(fitted.model), fitted.jacobian.copy()
    for k in columns:
        jacobian[:, :, k] = (residuals_of(next(moved), data.rows) - fitted.residuals) / step[k]
    return replace(fitted, jacobian=jacobian, fresh=True)


def deviances_of(models: Sequence[Model], data: Data) -> list[float]:
    """Deviance of each model as simulated."""
    every = rollouts_of(models, data.swims)
    return [deviance_of(residuals_of(rollouts, data.rows)) for rollouts in every]


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


def evaluate(models: Sequence[Model], jacobians: Sequence[Float64], data: Data) -> list[Fitted]:
    """Evaluate models by simulation; their Jacobians are those of a nearby point."""
    every = zip(models, rollouts_of(models, data.swims), jacobians, strict=True)
    return [Fitted.of(model, rollouts, data, jacobian) for model, rollouts, jacobian in every]


def refresh_jacobian(
    fits: Sequence[Fitted], data: Data, skipped: int = 0, fixed: bool = True
) -> list[Fitted]:
    """Refresh Jacobians at the present values; columns that are up to date are not simulated again.

    The first ``skipped`` parameters keep their derivatives; for ``fixed`` see
    ``derivatives``.
    """
    wanted = [
        [
            k
            for k in _differentiated(each.model, skipped, fixed)
            if not each.fresh or not each.jacobian[:, :, k].any()
        ]
        for each in fits
    ]
    pairs = list(zip(fits, wanted, strict=True))
    every = iter(rollouts_of([lane for each, some in pairs for lane in _moved(each.model, some)], data.swims))
    return [_with_columns(each, some, every, data) for each, some in pairs]


def fit(model: Model, data: Data, steps_max: int = 6, tolerance: float = CONVERGED) -> Fitted:
    """Fit all free parameters of a model's terms to runs, at its noise, from the values that it has."""
    return fit_many([model], data, steps_max, tolerance=tolerance)[0]


def fit_many(
    models: Sequence[Model],
    data: Data,
    steps_max: int,
    known: Float64 | None = None,
    tolerance: float = CONVERGED,
) -> list[Fitted]:
    """Fit several models in one batch; see ``fit`` and ``derivatives``, here without fixed parameters."""
    start_fits = derivatives(models, data, known, fixed=False)
    return fit_on(start_fits, data, steps_max, 0 if known is None else known.shape[2], tolerance)


def fit_on(
    start_fits: Sequence[Fitted], data: Data, steps_max: int, skipped: int = 0, tolerance: float = CONVERGED
) -> list[Fitted]:
    """Fit several models in one batch from evaluated starts with the Jacobians that they have.

    Only steps are simulated. A Jacobian is refreshed where it mispredicted: a step gained much less or more
    than the linearised optimum, or lost; or it was of an earlier point and the step still gained much.

    Args:
        skipped: number of parameters, from the first, that keep their derivatives.
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
        ends = evaluate([model for model, _ in tries.values()], jacobians, data)
        for (k, (_, deviance)), tried in zip(tries.items(), ends, strict=True):
            gain, predicted = best[k].deviance - tried.deviance, best[k].deviance - deviance
            fresh = best[k].fresh
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
            fits = refresh_jacobian([best[k] for k in stale], data, skipped, fixed=False)
            best = [dict(zip(stale, fits, strict=True)).get(k, each) for k, each in enumerate(best)]
    return best


def _damped_step(fitted: Fitted, failed: int) -> tuple[Model, float]:
    """The model one damped Gauss-Newton step further, and the deviance that is predicted for it."""
    model = fitted.model
    damping = DAMPINGS[failed] * fitted.residuals.size / model.reach**2
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
