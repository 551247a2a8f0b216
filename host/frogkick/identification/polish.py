"""A model with an effect that was taken: at the noise that it leaves, with the parameters that it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frogkick.effects import Effect
from frogkick.effects.acting import LEG_S
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    Fitted,
    Model,
    begun_at,
    fit,
    fit_on,
    misses,
    renoised,
    room_of,
    told,
    tracks_of,
)
from frogkick.identification.segments import Segments
from frogkick.identification.steps import cost_of, promised

FloatArray = NDArray[np.float64]

HOLD = 8.0
"""A parameter stays where its effect vanishes unless it gains more than this."""

HOLD_TRIED = 8.0
"""And by this more where values far apart are tried: the best of so many dips gains as much of pure noise."""

FEW_MOST = 3.0
"""Gains of few periods seem larger than they are, at most by this factor."""

MISFIT = (5e-5, 2e-3)
"""Accelerations while limbs straighten (see Noise.kick) beyond which a fitted model is not yet right."""

NEAR = 60.0
"""A value put back that costs more than this at first is not worth another fit."""

ROUNDS = 6
"""Steps of a fit at most; most have arrived after two."""

REFINING_LEG_S = 0.06
"""How often flows and wrenches are asked while effects are fitted."""

WRENCH_LEG_S = 0.03
"""The same for what was taken, where it pushes or turns the body, which lags by half of it."""


def best_noise(model: Model, swims: Sequence[Segments], rows: NDArray[np.bool_]) -> Fitted:
    """The model with its noise scaled to what predicts a period ahead best, without derivatives."""
    given, models = model.noise, []
    for calm, kick in ((1.0, 1.0), (1.0, 0.4), (0.3, 0.4), (0.1, 0.4)):
        noise = Noise(
            given.fix,
            (given.calm[0] * calm, given.calm[1] * calm),
            (given.kick[0] * kick, given.kick[1] * kick),
        )
        models.append(replace(model, noise=noise))
    every = tracks_of(models, swims)
    missed = [misses(tracks, rows) for tracks in every]
    costs = [cost_of(each) for each in missed]
    k = int(np.argmin(costs))
    return Fitted(models[k], every[k], missed[k], np.empty((*missed[k].shape, 0)), costs[k])


@dataclass(frozen=True, eq=False)
class Polisher:
    """Polishes models of the same runs.

    Attributes:
        swims: the runs.
        rows: periods that count.
        replicates: how many runs are of the same noise: a gain counts once.
    """

    swims: Sequence[Segments]
    rows: NDArray[np.bool_]
    replicates: int

    def polished(self, taken: Fitted) -> Fitted:
        """A model with what was taken, fitted as finely as can be, with no more free parameters than help."""
        leg_s = fine_leg_s(taken.model)
        if leg_s != taken.model.leg_s:
            rough = replace(taken.model, leg_s=leg_s)
            (taken,) = begun_at([rough], [taken.jacobian], self.swims, self.rows)
        (fitted,) = fit_on([taken], self.swims, self.rows, ROUNDS)
        # Only now is what is left more noise than misfit.
        fitted = self.quietened(fitted)
        while (freer := self.freed(fitted)) is not None:
            fitted = self.quietened(freer)
        return self.sparer(fitted)

    def quietened(self, fitted: Fitted) -> Fitted:
        """A model fitted once more, under the noise that it leaves."""
        model = replace(fitted.model, leg_s=fine_leg_s(fitted.model))
        quiet = best_noise(renoised(model, fitted.tracks, self.swims), self.swims, self.rows)
        quiet = replace(quiet, jacobian=fitted.jacobian, fresh=False)
        flat = [parameter for term in quiet.model.terms for parameter in term.parameters]
        if any(each.tried for k, each in enumerate(flat) if k not in quiet.model.held):
            (quiet,) = told([quiet], self.swims, self.rows, held=False)  # dips are narrow
        return fit_on([quiet], self.swims, self.rows, ROUNDS)[0]

    def freed(self, fitted: Fitted) -> Fitted | None:
        """The model with one more free parameter, where one helps."""
        (whole,) = told([fitted], self.swims, self.rows)
        model, tries = whole.model, list[tuple[float, Model]]()
        for k in sorted(model.held):
            freed = replace(model, held=model.held - {k})
            step, cost = promised(whole.missed, whole.jacobian, *room_of(freed), _shy(whole))
            tries.append((cost + self.worth(whole, k), freed.with_values(model.values + step)))
        tries += self.far(whole)
        if not tries:
            return None
        cost, model = min(tries, key=lambda row: row[0])
        if cost > fitted.cost:
            return None
        wider = fit(model, self.swims, self.rows, rounds=2)
        worth = max((self.worth(wider, k) for k in whole.model.held - model.held), default=0.0)
        return wider if wider.cost < fitted.cost - worth else None

    def worth(self, fitted: Fitted, k: int) -> float:
        """By how much the cost must fall for a parameter to be free: more where periods are few."""
        count, known = fitted.missed.shape
        few = count / max(count - known - len(fitted.model.values), 1)
        parameter = [p for term in fitted.model.terms for p in term.parameters][k]
        hold = HOLD + (HOLD_TRIED if parameter.tried else 0.0)
        return float(self.replicates * min(few, FEW_MOST) * hold)

    def far(self, fitted: Fitted) -> list[tuple[float, Model]]:
        """Costs of values that derivatives do not tell of, simulated, while something is left to explain."""
        model, tries, worth, first = fitted.model, list[Model](), list[float](), 0
        if all(kick < misfit for kick, misfit in zip(model.noise.kick, MISFIT, strict=True)):
            return []
        for term in model.terms:
            for k, parameter in enumerate(term.parameters, first):
                freed = replace(model, held=model.held - {k})
                for value in parameter.tried:
                    there = model.values
                    there[k] = value
                    tries.append(freed.with_values(there))
                    worth.append(self.worth(fitted, k) if k in model.held else 0.0)
            first += len(term.values)
        every = tracks_of(tries, self.swims)
        costs = [cost_of(misses(tracks, self.rows)) for tracks in every]
        return [(cost + more, tried) for cost, more, tried in zip(costs, worth, tries, strict=True)]

    def sparer(self, fitted: Fitted, whole: bool = False) -> Fitted:
        """The same with parameters of its last term, or of all, put back to nominal if that does no worse.

        Simulated and not judged by derivatives: how a stroke's delay acts ripples with the frame's swing.
        Such a parameter is put back in every term: what comes next would take up what its dip leaves.
        """
        while True:
            model, tries, worth, first = fitted.model, list[Model](), list[float](), 0
            for number, term in enumerate(model.terms, 1):
                free = [k for k in range(len(term.values)) if first + k not in model.held]
                if len(free) > 1:
                    every_one = whole or number == len(model.terms)
                    back = [k for k in free if every_one or term.parameters[k].tried]
                    tries += [put_back(fitted, first + k) for k in back]
                    worth += [self.worth(fitted, first + k) for k in back]
                first += len(term.values)
            if not tries:
                return fitted
            every = tracks_of(tries, self.swims)
            missed = [misses(tracks, self.rows) for tracks in every]
            costs = [cost_of(each) for each in missed]
            near = [k for k, cost in enumerate(costs) if cost < fitted.cost + NEAR]
            begun = [
                Fitted(tries[k], every[k], missed[k], fitted.jacobian, costs[k], fresh=False) for k in near
            ]
            fits = fit_on(begun, self.swims, self.rows, 2)
            dearer = [each.cost - fitted.cost - worth[k] for k, each in zip(near, fits, strict=True)]
            if min(dearer, default=0.0) >= 0.0:
                return fitted
            fitted = fits[int(np.argmin(dearer))]


def fine_leg_s(model: Model) -> float:
    """How often flows and wrenches are asked for a model at last."""
    effects = [term.effect() for term in model.terms]
    if any(effect.stiff for effect in effects):
        return LEG_S
    pushes = any(type(effect).wrench is not Effect.wrench for effect in effects)
    return WRENCH_LEG_S if pushes else REFINING_LEG_S


def _shy(fitted: Fitted) -> FloatArray:
    return np.asarray(1e-6 * fitted.missed.size / fitted.model.range**2)


def put_back(fitted: Fitted, k: int) -> Model:
    """The model with one value held where it is nominal; see ``held_at``.

    The others stay as they are where that value is one of those that are tried far apart: its derivative is
    one of the dip that it is in.
    """
    model = fitted.model
    parameter = [p for term in model.terms for p in term.parameters][k]
    if not parameter.tried:
        return held_at(fitted, k, parameter.nominal)
    values = model.values
    values[k] = parameter.nominal
    return replace(model.with_values(values), held=model.held | {k})


def held_at(fitted: Fitted, k: int, value: float) -> Model:
    """The model with one value held where it is told, the others as derivatives say they then are."""
    model = fitted.model
    back = np.zeros(len(model.values))
    back[k] = value - model.values[k]
    there = replace(model.with_values(model.values + back), held=model.held | {k})
    step, _ = promised(fitted.missed + fitted.jacobian @ back, fitted.jacobian, *room_of(there), _shy(fitted))
    return there.with_values(there.values + step)
