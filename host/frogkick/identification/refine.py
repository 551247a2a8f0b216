"""Refine a model after an effect was taken: re-estimate the noise, release and fix parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Bool, Float64
from frogkick.effects import Effect
from frogkick.effects.acting import LEG_S
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    Fitted,
    Model,
    evaluate,
    fit,
    fit_on,
    reestimated_noise,
    refresh_jacobian,
    residuals_of,
    rollouts_of,
    step_bounds,
)
from frogkick.identification.segments import Segments
from frogkick.identification.steps import deviance_of, linearised_optimum

RELEASE_PENALTY = 8.0
"""Penalty of a release: a parameter stays at its nominal value unless it gains more than this."""

GRID_PENALTY = 8.0
"""And by this more for a parameter with a grid: the best of many local minima gains as much by chance."""

FEW_PERIODS_MAX = 3.0
"""Gains of few periods are overestimated, at most by this factor."""

NOISE_OF_MISFIT = (5e-5, 2e-3)
"""Process noise while limbs straighten (see Noise.actuated) beyond which a model still misfits."""

REFIT_MARGIN = 60.0
"""A model that is worse by more than this before its fit is not fitted."""

STEPS_MAX = 6
"""Steps of a fit at most; most converge after two."""

REFINING_LEG_S = 0.06
"""How often flows and wrenches are evaluated while effects are fitted."""

WRENCH_LEG_S = 0.03
"""The same for effects in the model that act on the body, which lags by half of it."""


def best_noise(model: Model, swims: Sequence[Segments], rows: Bool) -> Fitted:
    """The model with its process noise scaled for the best one-period predictions, without derivatives."""
    given, models = model.noise, []
    for idle, actuated in ((1.0, 1.0), (1.0, 0.4), (0.3, 0.4), (0.1, 0.4)):
        noise = Noise(
            given.fix,
            (given.idle[0] * idle, given.idle[1] * idle),
            (given.actuated[0] * actuated, given.actuated[1] * actuated),
        )
        models.append(replace(model, noise=noise))
    every = rollouts_of(models, swims)
    residuals = [residuals_of(rollouts, rows) for rollouts in every]
    deviances = [deviance_of(each) for each in residuals]
    k = int(np.argmin(deviances))
    return Fitted(models[k], every[k], residuals[k], np.empty((*residuals[k].shape, 0)), deviances[k])


@dataclass(frozen=True, eq=False)
class Refiner:
    """Refines models of the same runs.

    Attributes:
        swims: the runs.
        rows: periods that count.
        replicate_count: runs that are replicates with the same noise: their gain counts once.
    """

    swims: Sequence[Segments]
    rows: Bool
    replicate_count: int

    def refined(self, taken: Fitted) -> Fitted:
        """A model fitted finely, at its own noise, with no more free parameters than help."""
        leg_s = fine_leg_s(taken.model)
        if leg_s != taken.model.leg_s:
            rough = replace(taken.model, leg_s=leg_s)
            (taken,) = evaluate([rough], [taken.jacobian], self.swims, self.rows)
        (fitted,) = fit_on([taken], self.swims, self.rows, STEPS_MAX)
        # Only now are the residuals more noise than misfit.
        fitted = self.noise_reestimated(fitted)
        while (wider := self.with_free_parameter(fitted)) is not None:
            fitted = self.noise_reestimated(wider)
        return self.pruned(fitted)

    def noise_reestimated(self, fitted: Fitted) -> Fitted:
        """Re-estimate the noise of a model and fit it once more."""
        model = replace(fitted.model, leg_s=fine_leg_s(fitted.model))
        quiet = best_noise(reestimated_noise(model, fitted.rollouts, self.swims), self.swims, self.rows)
        quiet = replace(quiet, jacobian=fitted.jacobian, fresh=False)
        flat = [parameter for term in quiet.model.terms for parameter in term.parameters]
        if any(each.grid for k, each in enumerate(flat) if k not in quiet.model.fixed):
            (quiet,) = refresh_jacobian([quiet], self.swims, self.rows, fixed=False)  # minima are narrow
        return fit_on([quiet], self.swims, self.rows, STEPS_MAX)[0]

    def with_free_parameter(self, fitted: Fitted) -> Fitted | None:
        """The model with one more free parameter; None where none helps."""
        (whole,) = refresh_jacobian([fitted], self.swims, self.rows)
        model, tries = whole.model, list[tuple[float, Model]]()
        for k in sorted(model.fixed):
            with_free_parameter = replace(model, fixed=model.fixed - {k})
            step, deviance = linearised_optimum(
                whole.residuals, whole.jacobian, *step_bounds(with_free_parameter), _damping(whole)
            )
            tries.append(
                (
                    deviance + self.release_penalty(whole, k),
                    with_free_parameter.with_values(model.values + step),
                )
            )
        tries += self.far(whole)
        if not tries:
            return None
        deviance, model = min(tries, key=lambda row: row[0])
        if deviance > fitted.deviance:
            return None
        wider = fit(model, self.swims, self.rows, steps_max=2)
        release_penalty = max(
            (self.release_penalty(wider, k) for k in whole.model.fixed - model.fixed), default=0.0
        )
        return wider if wider.deviance < fitted.deviance - release_penalty else None

    def release_penalty(self, fitted: Fitted, k: int) -> float:
        """By how much the deviance must fall to release a parameter: more where periods are few."""
        count, known = fitted.residuals.shape
        few = count / max(count - known - len(fitted.model.values), 1)
        parameter = [p for term in fitted.model.terms for p in term.parameters][k]
        hold = RELEASE_PENALTY + (GRID_PENALTY if parameter.grid else 0.0)
        return float(self.replicate_count * min(few, FEW_PERIODS_MAX) * hold)

    def far(self, fitted: Fitted) -> list[tuple[float, Model]]:
        """Deviances of the grid values of parameters, simulated, while the model still misfits."""
        model, tries, release_penalty, first = fitted.model, list[Model](), list[float](), 0
        if all(
            actuated < misfit for actuated, misfit in zip(model.noise.actuated, NOISE_OF_MISFIT, strict=True)
        ):
            return []
        for term in model.terms:
            for k, parameter in enumerate(term.parameters, first):
                with_free_parameter = replace(model, fixed=model.fixed - {k})
                for value in parameter.grid:
                    there = model.values
                    there[k] = value
                    tries.append(with_free_parameter.with_values(there))
                    release_penalty.append(self.release_penalty(fitted, k) if k in model.fixed else 0.0)
            first += len(term.values)
        every = rollouts_of(tries, self.swims)
        deviances = [deviance_of(residuals_of(rollouts, self.rows)) for rollouts in every]
        return [
            (deviance + more, tried)
            for deviance, more, tried in zip(deviances, release_penalty, tries, strict=True)
        ]

    def pruned(self, fitted: Fitted, whole: bool = False) -> Fitted:
        """Prune free parameters of the last term, or of all: fix them at nominal if that is no worse.

        It is simulated and not judged by derivatives: the influence of a stroke's delay ripples with the
        frame's oscillation. Such a parameter (one with a grid) is tried in every term: the next effect would
        take up what its local minimum leaves.
        """
        while True:
            model, tries, release_penalty, first = fitted.model, list[Model](), list[float](), 0
            for number, term in enumerate(model.terms, 1):
                free = [k for k in range(len(term.values)) if first + k not in model.fixed]
                if len(free) > 1:
                    every_one = whole or number == len(model.terms)
                    back = [k for k in free if every_one or term.parameters[k].grid]
                    tries += [with_nominal(fitted, first + k) for k in back]
                    release_penalty += [self.release_penalty(fitted, first + k) for k in back]
                first += len(term.values)
            if not tries:
                return fitted
            every = rollouts_of(tries, self.swims)
            residuals = [residuals_of(rollouts, self.rows) for rollouts in every]
            deviances = [deviance_of(each) for each in residuals]
            near = [k for k, deviance in enumerate(deviances) if deviance < fitted.deviance + REFIT_MARGIN]
            start_fits = [
                Fitted(tries[k], every[k], residuals[k], fitted.jacobian, deviances[k], fresh=False)
                for k in near
            ]
            fits = fit_on(start_fits, self.swims, self.rows, 2)
            dearer = [
                each.deviance - fitted.deviance - release_penalty[k]
                for k, each in zip(near, fits, strict=True)
            ]
            if min(dearer, default=0.0) >= 0.0:
                return fitted
            fitted = fits[int(np.argmin(dearer))]


def fine_leg_s(model: Model) -> float:
    """How often flows and wrenches are evaluated for a refined model."""
    effects = [term.effect() for term in model.terms]
    if any(effect.stiff for effect in effects):
        return LEG_S
    pushes = any(type(effect).wrench is not Effect.wrench for effect in effects)
    return WRENCH_LEG_S if pushes else REFINING_LEG_S


def _damping(fitted: Fitted) -> Float64:
    return np.asarray(1e-6 * fitted.residuals.size / fitted.model.range**2)


def with_nominal(fitted: Fitted, k: int) -> Model:
    """The model with one parameter fixed at its nominal value; see ``fixed_at``.

    The others stay as they are where that parameter has a grid: its derivative is one of the local minimum
    that it is in.
    """
    model = fitted.model
    parameter = [p for term in model.terms for p in term.parameters][k]
    if not parameter.grid:
        return fixed_at(fitted, k, parameter.nominal)
    values = model.values
    values[k] = parameter.nominal
    return replace(model.with_values(values), fixed=model.fixed | {k})


def fixed_at(fitted: Fitted, k: int, value: float) -> Model:
    """The model with one parameter fixed at a value, the others at their linearised optimum."""
    model = fitted.model
    back = np.zeros(len(model.values))
    back[k] = value - model.values[k]
    there = replace(model.with_values(model.values + back), fixed=model.fixed | {k})
    step, _ = linearised_optimum(
        fitted.residuals + fitted.jacobian @ back, fitted.jacobian, *step_bounds(there), _damping(fitted)
    )
    return there.with_values(there.values + step)
