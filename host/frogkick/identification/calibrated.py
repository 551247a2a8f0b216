"""Calibrated starting models: robots of the same body that were measured before.

A robot's file of the same id and body with ``[[effect]]`` tables gives starting values; all its effects are
fitted jointly to the runs at hand, by the poses at the ends of periods: a forward selection from a plain
drawing does not get there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.effects import Effect
from frogkick.effects.registry import effects_of
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    DIVERGED,
    EFFECT_PENALTY,
    PARAMETER_PENALTY,
    Fitted,
    Model,
    coarsened,
    derivatives,
    reestimated_noise,
    rollouts_of,
)
from frogkick.identification.predict import Rollout
from frogkick.identification.segments import Data, Segments, part_of
from frogkick.identification.steps import bounded_step, deviance_of, whiten, whitener
from frogkick.identification.terms import Term
from frogkick.robot import Robot, built_in_robots, load_robot

STEPS_MAX = 5  # steps of the fit at most

PART, PART_STEPS_MAX = 60, 12
"""From nominal values: PART periods, a share of each run, are fitted in PART_STEPS_MAX steps, then all."""

LEG_S = 0.05  # how often wrenches are evaluated: a glide changes slowly

START_GAIN = 10.0
"""Gain that each effect of a calibrated start must have at its file's values, before anything is fitted.

In units of the deviance, each model at its best noise. Ten effects must gain 100: on the recorded robot they
gain 218 in three short runs and 196 from rough values, on a simulated one whose limb misfires -1090.
"""

DAMPINGS = (1e-5, 1e-3, 1e-2, 0.1, 1.0, 10.0)  # dampings of a step, all tried in one batch

NOISES = tuple(
    Noise((fix, 14.0 * fix), (idle, 30.0 * idle), (0.02, 0.6))
    for fix, idle in ((2e-4, 1e-3), (3e-4, 1e-3), (4e-4, 2e-3), (8e-4, 3e-3))
)
"""Noise levels that are tried, (m, rad): of fixes, and of the white acceleration."""


def calibrated_starts(robot: Robot) -> dict[str, tuple[Term, ...]]:
    """Built-in robots that are this one with effects: name -> the effects, with their values.

    Their planners may differ.
    """
    found = {}
    apart = ("title", "planner", "effects", "folder")
    for name in built_in_robots():
        other = load_robot(name)
        plain = replace(other, **{key: getattr(robot, key) for key in apart})
        if other.effects != robot.effects and plain == robot:
            found[name] = tuple(
                term_of(dict(table), effect)
                for table, effect in zip(other.effects, effects_of(other), strict=True)
            )
    return found


def term_of(table: dict[str, object], effect: Effect) -> Term:
    """The term of an effect's table, with the values that it has there."""
    names = {parameter.name for parameter in effect.parameters}
    kept = tuple((key, value) for key, value in table.items() if key not in names)
    values = tuple(effect.value(parameter.name) for parameter in effect.parameters)
    return Term(kept, Path(), tuple(effect.parameters), values)


def refitted(nominal: Fitted, terms: Sequence[Term], data: Data, measured: bool = True) -> Fitted | None:
    """Fit all effects of a calibrated start jointly; None if they explain too little for their number.

    Parameters that are nominal in its file stay so. The fit starts from the measured values, or else from
    nominal ones, so that only the choice of effects and of their free parameters comes from the runs that the
    start was calibrated with.
    """
    swims = data.swims
    flat = [
        (value, p.nominal) for term in terms for value, p in zip(term.values, term.parameters, strict=True)
    ]
    fixed = frozenset(k for k, (value, plain) in enumerate(flat) if value == plain)
    if not measured:
        terms = [term.at([p.nominal for p in term.parameters]) for term in terms]
    start = Model(coarsened(nominal.model.robot), tuple(terms), NOISES[0], LEG_S, fixed=fixed)
    free = len(flat) - len(fixed)
    # All effects come jointly: that is one choice, however many they are.
    plain, dear = best_end_deviance(nominal, swims), PARAMETER_PENALTY * free + EFFECT_PENALTY
    model, deviance = at_best_noise(start, swims)
    if measured and deviance > plain - START_GAIN * len(terms):
        return None  # a different robot
    if not measured:
        model = GaussNewton(model, part_of(swims, PART)).run(PART_STEPS_MAX)
        # The noise that is best at nominal values need not be so at these.
        model, _ = at_best_noise(model, swims)
    fitted = fitted_to_ends(model, data, nominal.model.robot)
    return fitted if end_deviance(fitted.rollouts, swims) < plain - dear else None


def at_best_noise(model: Model, swims: Sequence[Segments]) -> tuple[Model, float]:
    """The model at the one of NOISES with the lowest ``end_deviance``, and that deviance."""
    models = [replace(model, noise=noise) for noise in NOISES]
    deviances = [end_deviance(rollouts, swims) for rollouts in rollouts_of(models, swims)]
    best = int(np.argmin(deviances))
    return models[best], deviances[best]


def fitted_to_ends(begin: Model, data: Data, robot: Robot) -> Fitted:
    """Fit a model to the ends of periods, with a coarsened frame and then with the robot's own."""
    swims = data.swims
    model = GaussNewton(replace(begin, robot=coarsened(begin.robot)), swims).run(STEPS_MAX)
    rough = derivatives([model], data)[0]
    fine = replace(model, robot=robot)
    (rollouts,) = rollouts_of([fine], swims)
    # Once more at its re-estimated noise: the first one is a round number.
    again = replace(reestimated_noise(fine, rollouts, swims), fixed=fine.fixed)
    (other,) = rollouts_of([again], swims)
    if end_deviance(other, swims) < end_deviance(rollouts, swims):
        fine, rollouts = again, other
    return Fitted.of(fine, rollouts, data, rough.jacobian)


def best_end_deviance(fitted: Fitted, swims: Sequence[Segments]) -> float:
    """The lowest ``end_deviance`` of a model, at its own noise or at those that calibrated starts are tried
    with.

    A calibrated start must not win by its noise alone: the noise of a robot at a wall, estimated from a few
    large residuals, makes its ends worse than any of NOISES does, by four times what a calibrated start must
    gain.
    """
    models = [replace(fitted.model, noise=noise) for noise in NOISES]
    models.append(reestimated_noise(fitted.model, fitted.rollouts, swims))
    return min(end_deviance(rollouts, swims) for rollouts in [fitted.rollouts, *rollouts_of(models, swims)])


def end_deviance(rollouts: Sequence[Rollout], swims: Sequence[Segments]) -> float:
    """Deviance of the residuals at periods' ends; see ``steps.deviance_of``."""
    return deviance_of(end_residuals(rollouts, swims))


def end_residuals(rollouts: Sequence[Rollout], swims: Sequence[Segments]) -> Float64:
    """(n, 3) residuals at the ends of all periods: forward, left (m), heading (rad).

    Periods without a measured end, or that no model can predict, are left out; those of a run whose
    simulation failed count as DIVERGED.
    """
    rows = []
    for rollout, swim in zip(rollouts, swims, strict=True):
        ends = end_errors(rollout, swim)
        rows.append(ends[np.isfinite(ends).all(axis=1)])
    return np.concatenate(rows)


def end_errors(rollout: Rollout, swim: Segments) -> Float64:
    """(m, 3) residuals at the ends of a run's periods, by the pose at their starts; NaN if unknown."""
    ends = rollout.end_errors(swim)
    if rollout.failed:
        seen = np.asarray(np.isfinite(swim.measured).all(axis=1))
        ends[:] = np.where(seen[:, None], DIVERGED[:3], np.nan)
    return ends


@dataclass(eq=False)
class GaussNewton:
    """Damped Gauss-Newton on the ends of periods; factors are stepped in their logarithm."""

    model: Model
    swims: Sequence[Segments]

    def __post_init__(self) -> None:
        parameters = self.model.parameters
        self.low, self.high = self.model.bounds
        self.is_factor = np.array([p.low > 0.0 and p.nominal == 1.0 for p in parameters])
        self.reach = np.where(self.is_factor, 0.5, 0.25 * (self.high - self.low))
        self.free = np.array([k not in self.model.fixed for k in range(len(parameters))], dtype=np.float64)

    def _scaled(self, values: Float64) -> Float64:
        logs = np.log(np.where(self.is_factor, values, 1.0))
        return np.where(self.is_factor, logs, values) / self.reach

    def _values(self, scaled: Float64) -> Float64:
        plain = scaled * self.reach
        return np.where(self.is_factor, np.exp(np.where(self.is_factor, plain, 0.0)), plain)

    def linearised(self) -> tuple[Float64, list[Float64], list[Float64], float]:
        """Scaled values (p,); of each run residuals (n, 3) and their derivatives (n, 3, p); the deviance."""
        at = self._scaled(self.model.values)
        high = self._scaled(self.high)
        step = np.where(at + 0.16 > high, -0.16, 0.16)
        chosen = [k for k in range(len(at)) if self.free[k]]
        moved = [at, *(at + step[k] * np.eye(len(at))[k] for k in chosen)]
        every = rollouts_of([self.model.with_values(self._values(each)) for each in moved], self.swims)
        residuals, derivatives = [], []
        for run, swim in enumerate(self.swims):
            base, *others = (end_residuals([rollouts[run]], [swim]) for rollouts in every)
            columns = np.zeros((*base.shape, len(at)))
            for k, other in zip(chosen, others, strict=True):
                columns[:, :, k] = (other - base) / step[k]
            residuals.append(base)
            derivatives.append(columns)
        return at, residuals, derivatives, deviance_of(np.concatenate(residuals))

    def stepped(self, at: Float64, residuals: Float64, derivatives: Float64, damping: float) -> Model:
        """The model one damped step further from a linearisation."""
        low, high = self._scaled(np.maximum(self.low, -1e9)), self._scaled(self.high)
        left, rows = whiten(whitener(residuals), residuals, derivatives)
        down = np.maximum(low - at, -2.0) * self.free
        up = np.minimum(high - at, 2.0) * self.free
        step = bounded_step(rows, left, np.full(len(at), damping * 0.05 * len(left)), down, up)
        return self.model.with_values(self._values(at + step))

    def run(self, steps_max: int) -> Model:
        """The fitted model, after ``steps_max`` steps at most."""
        deviance = math.inf
        for _ in range(steps_max):
            at, residuals, derivatives, now = self.linearised()
            deviance = min(deviance, now)
            base, columns = np.concatenate(residuals), np.concatenate(derivatives)
            models = [self.stepped(at, base, columns, share) for share in DAMPINGS]
            deviances = [end_deviance(rollouts, self.swims) for rollouts in rollouts_of(models, self.swims)]
            best = int(np.argmin(deviances))
            if deviances[best] >= deviance - 0.5:
                break
            self.model, deviance = models[best], deviances[best]
        return self.model
