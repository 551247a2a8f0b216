"""Refine a model after an effect was taken: re-estimate the noise, release and fix parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.identification.batching import spent_up
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    Fitted,
    Model,
    deviances_of,
    evaluate,
    fit,
    fit_many,
    fit_on,
    reestimated_noise,
    refresh_jacobian,
    rollouts_of,
    step_bounds,
)
from frogkick.identification.segments import Data
from frogkick.identification.steps import linearised_optimum

RELEASE_PENALTY = 8.0
"""Penalty of a release: a parameter stays at its nominal value unless it gains more than this."""

GRID_PENALTY = 8.0
"""And by this more for a parameter with a grid: the best of many local minima gains as much by chance."""

GRID_STARTS = 3
"""Number of grid values, the best as simulated, that a fit starts from."""

FEW_PERIODS_MAX = 3.0  # gains of few periods are overestimated, at most by this factor

NOISE_OF_MISFIT = (5e-5, 2e-3)
"""Process noise, as in ``Noise.idle`` and ``Noise.actuated``, beyond which a model still misfits."""

REFIT_MARGIN = 60.0  # a model that is worse by more than this before its fit is not fitted
STEPS_MAX = 6  # steps of a fit at most; most converge after two


def best_noise(model: Model, data: Data) -> Fitted:
    """The model with its process noise scaled for the best one-period predictions, without derivatives."""
    given, models = model.noise, []
    for idle, actuated in ((1.0, 1.0), (1.0, 0.4), (0.3, 0.4), (0.1, 0.4)):
        noise = Noise(
            given.fix,
            (given.idle[0] * idle, given.idle[1] * idle),
            (given.actuated[0] * actuated, given.actuated[1] * actuated),
        )
        models.append(replace(model, noise=noise))
    pairs = zip(models, rollouts_of(models, data.swims), strict=True)
    return min((Fitted.of(*pair, data) for pair in pairs), key=lambda each: each.deviance)


def refined(taken: Fitted, data: Data) -> Fitted:
    """A model fitted finely, at its own noise, with no more free parameters than help."""
    leg_s = taken.model.fine_leg_s
    if leg_s != taken.model.leg_s:
        (taken,) = evaluate([replace(taken.model, leg_s=leg_s)], [taken.jacobian], data)
    (fitted,) = fit_on([taken], data, STEPS_MAX)
    # Only now are the residuals more noise than misfit.
    fitted = noise_reestimated(fitted, data)
    while not spent_up() and (wider := with_free_parameter(fitted, data)) is not None:
        fitted = noise_reestimated(wider, data)
    return with_fewer_free(fitted, data)


def noise_reestimated(fitted: Fitted, data: Data) -> Fitted:
    """Re-estimate the noise of a model and fit it once more."""
    model = replace(fitted.model, leg_s=fitted.model.fine_leg_s)
    quiet = best_noise(reestimated_noise(model, fitted.rollouts, data.swims), data)
    quiet = replace(quiet, jacobian=fitted.jacobian, fresh=False)
    if any(each.grid for k, each in enumerate(model.parameters) if k not in model.fixed):
        (quiet,) = refresh_jacobian([quiet], data, fixed=False)  # minima are narrow
    return fit_on([quiet], data, STEPS_MAX)[0]


def with_free_parameter(fitted: Fitted, data: Data) -> Fitted | None:
    """The model with one more free parameter; None where none helps."""
    (whole,) = refresh_jacobian([fitted], data)
    model, tries = whole.model, list[tuple[float, Model]]()
    for k in sorted(model.fixed):
        freed = replace(model, fixed=model.fixed - {k})
        step, deviance = linearised_optimum(
            whole.residuals, whole.jacobian, *step_bounds(freed), _damping(whole)
        )
        tries.append((deviance + release_penalty(whole, k, data), freed.with_values(model.values + step)))
    tries += far(whole, data)
    if not tries:
        return None
    deviance, model = min(tries, key=lambda row: row[0])
    if deviance > fitted.deviance:
        return None
    wider = fit(model, data, steps_max=2)
    released = whole.model.fixed - model.fixed
    penalty = max((release_penalty(wider, k, data) for k in released), default=0.0)
    return wider if wider.deviance < fitted.deviance - penalty else None


def release_penalty(fitted: Fitted, k: int, data: Data) -> float:
    """By how much the deviance must fall to release a parameter: more where periods are few."""
    count, known = fitted.residuals.shape
    few = count / max(count - known - len(fitted.model.values), 1)
    hold = RELEASE_PENALTY + (GRID_PENALTY if fitted.model.parameters[k].grid else 0.0)
    return float(data.replicate_count * min(few, FEW_PERIODS_MAX) * hold)


def far(fitted: Fitted, data: Data) -> list[tuple[float, Model]]:
    """Deviances of grid values, simulated: of fixed parameters, and of all while the model still misfits.

    Where such a parameter is fixed its derivative tells only of the nearest of its local minima.
    """
    model, tries, penalties = fitted.model, list[Model](), list[float]()
    misfits = any(own >= most for own, most in zip(model.noise.actuated, NOISE_OF_MISFIT, strict=True))
    for k in range(len(model.parameters)) if misfits else sorted(model.fixed):
        there = at_grid(model, k)
        tries += there
        penalties += [release_penalty(fitted, k, data) if k in model.fixed else 0.0] * len(there)
    deviances = deviances_of(tries, data)
    return [(own + more, each) for own, more, each in zip(deviances, penalties, tries, strict=True)]


def at_grid(model: Model, k: int) -> list[Model]:
    """The model with one parameter free, at each of its grid values; none without a grid."""
    freed, tries = replace(model, fixed=model.fixed - {k}), list[Model]()
    for value in model.parameters[k].grid:
        there = model.values
        there[k] = value
        tries.append(freed.with_values(there))
    return tries


def from_grids(fitted: Fitted, data: Data) -> Fitted:
    """The model fitted from the best grid value of each free parameter that has a grid, where that is better.

    Such a parameter has local minima. It entered one before the later effects were there, and descent from it
    gives an interval around the wrong value.
    """
    for k, parameter in enumerate(fitted.model.parameters):
        if k in fitted.model.fixed or not parameter.grid:
            continue
        tries = at_grid(fitted.model, k)
        best = np.argsort(deviances_of(tries, data))[:GRID_STARTS]
        other = min(fit_many([tries[i] for i in best], data, STEPS_MAX), key=lambda each: each.deviance)
        if other.deviance < fitted.deviance - 1.0:
            fitted = noise_reestimated(other, data)
    return fitted


def with_fewer_free(fitted: Fitted, data: Data, whole: bool = False) -> Fitted:
    """Prune free parameters of the last term, or of all: fix them at nominal if that is no worse.

    It is simulated and not judged by derivatives: the influence of a stroke's delay ripples with the
    frame's oscillation. Such a parameter (one with a grid) is tried in every term: the next effect would
    take up what its local minimum leaves.
    """
    while True:
        model, back = fitted.model, list[int]()
        for place in range(len(model.terms)):
            free = [k for k in model.indices(place) if k not in model.fixed]
            if len(free) > 1:
                every_one = whole or place == len(model.terms) - 1
                back += [k for k in free if every_one or model.parameters[k].grid]
        if not back:
            return fitted
        tries = [(with_nominal(fitted, k), fitted.jacobian) for k in back]
        saved = [release_penalty(fitted, k, data) for k in back]
        simpler = simpler_model(fitted, tries, saved, REFIT_MARGIN, data)
        if simpler is None:
            return fitted
        fitted, _ = simpler


def simpler_model(
    fitted: Fitted, tries: Sequence[tuple[Model, Float64]], saved: Sequence[float], margin: float, data: Data
) -> tuple[Fitted, int] | None:
    """The best of some simpler models, fitted, and its index; None if all lose more than they save.

    Args:
        tries: the models, with Jacobians of a nearby point.
        saved: penalties that each saves.
        margin: a model that is worse by more before its fit is not fitted.
    """
    starts = evaluate([model for model, _ in tries], [jacobian for _, jacobian in tries], data)
    near = [k for k, each in enumerate(starts) if each.deviance < fitted.deviance + margin]
    fits = fit_on([starts[k] for k in near], data, 2)
    dearer = [each.deviance - fitted.deviance - saved[k] for k, each in zip(near, fits, strict=True)]
    if min(dearer, default=0.0) >= 0.0:
        return None
    best = int(np.argmin(dearer))
    return fits[best], near[best]


def _damping(fitted: Fitted) -> Float64:
    return np.asarray(1e-6 * fitted.residuals.size / fitted.model.reach**2)


def with_nominal(fitted: Fitted, k: int) -> Model:
    """The model with one parameter fixed at its nominal value; see ``fixed_at``.

    The others stay as they are where that parameter has a grid: its derivative is one of the local minimum
    that it is in.
    """
    model = fitted.model
    parameter = model.parameters[k]
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
