"""Robots of the same body that were measured before: where a fit of many effects at once may start.

What a hull takes along, how it resists, how limbs stand and tire: these can only be told apart together, and
a search that takes one effect after another from a plain drawing does not get there. A robot's file of the
same id and body with ``[[effect]]`` tables gives values to start from; all of them are fitted to the runs at
hand, by the poses at the ends of periods.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frogkick.effects import Effect
from frogkick.effects.registry import effects_of
from frogkick.identification.filter import Noise
from frogkick.identification.fit import (
    LOST,
    Fitted,
    Model,
    coarse,
    derivatives,
    misses,
    renoised,
    tracks_of,
)
from frogkick.identification.predict import Track
from frogkick.identification.segments import Segments, part_of
from frogkick.identification.steps import bounded_step, cost_of, whiten, whitener
from frogkick.identification.terms import Term
from frogkick.identification.worth import BASE_GAIN, GAIN_EACH
from frogkick.paths import wrap_angle
from frogkick.robot import Robot, built_in_robots, load_robot

FloatArray = NDArray[np.float64]

ROUNDS = 5
"""Steps of the fit at most."""

PART, PART_ROUNDS, WHOLE_ROUNDS = 60, 12, 2
"""From nominal values: so many periods, the first of each run, are fitted in so many steps, then all."""

LEG_S = 0.05
"""How often wrenches are asked: a glide changes slowly."""

START_GAIN = 10.0
"""What each effect of a relative must explain as its file has it, before anything is fitted to the runs.

By the fall of minus twice the log likelihood, each side at its best noise: of 100 asked of ten effects, the
recorded robot explains 218 in three short runs and 196 from rough values; a simulated one whose limb
misfires explains -1090.
"""

DAMPINGS = (1e-5, 1e-3, 1e-2, 0.1, 1.0, 10.0)
"""Of a step, all tried side by side; a share of what a step of a whole range would gain."""

NOISES = tuple(
    Noise((fix, 14.0 * fix), (calm, 30.0 * calm), (0.02, 0.6))
    for fix, calm in ((2e-4, 1e-3), (3e-4, 1e-3), (4e-4, 2e-3), (8e-4, 3e-3))
)
"""Of fixes and of what drives a glide: (m, rad), tried one after another."""


def relatives(robot: Robot) -> dict[str, tuple[Term, ...]]:
    """Built-in robots that are this one with effects: name -> these, with their values.

    How either plans does not matter.
    """
    found = {}
    for name in built_in_robots():
        other = load_robot(name)
        plain = replace(
            other,
            title=robot.title,
            planner=robot.planner,
            effects=robot.effects,
            toml=robot.toml,
            sha256=robot.sha256,
            folder=robot.folder,
        )
        if other.effects != robot.effects and plain == robot:
            found[name] = tuple(
                _term(dict(table), effect)
                for table, effect in zip(other.effects, effects_of(other), strict=True)
            )
    return found


def _term(table: dict[str, object], effect: Effect) -> Term:
    names = {parameter.name for parameter in effect.parameters}
    kept = tuple((key, value) for key, value in table.items() if key not in names)
    values = tuple(effect.value(parameter.name) for parameter in effect.parameters)
    return Term(kept, Path(), tuple(effect.parameters), values)


def refitted(
    nominal: Fitted,
    terms: Sequence[Term],
    swims: Sequence[Segments],
    rows: NDArray[np.bool_],
    measured: bool = True,
) -> Fitted | None:
    """All effects of a relative fitted to runs at once; None where they explain too little for their number.

    Parameters that are nominal in the relative's file stay so.

    Args:
        nominal: the model without them.
        terms: where to start.
        swims: the runs.
        rows: periods that count for the derivatives of what is returned.
        measured: start from the relative's values; else from nominal ones, so that which effects it has, and
            which of their parameters, is all that is taken from the runs it was fitted to.
    """
    flat = [
        (value, p.nominal) for term in terms for value, p in zip(term.values, term.parameters, strict=True)
    ]
    held = frozenset(k for k, (value, plain) in enumerate(flat) if value == plain)
    if not measured:
        terms = [term.at([p.nominal for p in term.parameters]) for term in terms]
    start = Model(coarse(nominal.model.robot), tuple(terms), NOISES[0], LEG_S, held=held)
    free = len(flat) - len(held)
    # Its effects come all at once: that is one choice, however many they are.
    plain, dear = best_end_cost(nominal, swims), GAIN_EACH * free + BASE_GAIN
    models = [replace(start, noise=noise) for noise in NOISES]
    costs = [end_cost(tracks, swims) for tracks in tracks_of(models, swims)]
    if measured and min(costs) > plain - START_GAIN * len(terms):
        return None  # another robot than that one
    model, rounds = models[int(np.argmin(costs))], ROUNDS
    if not measured:
        model, rounds = _Descent(model, part_of(swims, PART)).run(PART_ROUNDS), WHOLE_ROUNDS
    fitted = descended(model, swims, rows, nominal.model.robot, rounds)
    return fitted if end_cost(fitted.tracks, swims) < plain - dear else None


def descended(
    begin: Model, swims: Sequence[Segments], rows: NDArray[np.bool_], robot: Robot, rounds: int = WHOLE_ROUNDS
) -> Fitted:
    """A model of many effects fitted by periods' ends, with a coarse frame and then with the robot's own."""
    model = _Descent(replace(begin, robot=coarse(begin.robot)), swims).run(rounds)
    rough = derivatives([model], swims, rows)[0]
    fine = replace(model, robot=robot)
    (tracks,) = tracks_of([fine], swims)
    # Once more at the noise that it leaves: the one it was tried at first is a round number.
    again = replace(renoised(fine, tracks, swims), held=fine.held)
    (other,) = tracks_of([again], swims)
    if end_cost(other, swims) < end_cost(tracks, swims):
        fine, tracks = again, other
    missed = misses(tracks, rows)
    return Fitted(fine, tracks, missed, rough.jacobian, cost_of(missed), fresh=False)


def best_end_cost(fitted: Fitted, swims: Sequence[Segments]) -> float:
    """The lowest ``end_cost`` of a model, at its own noise or at those that relatives are tried and end at.

    What a model is held against must not gain by its noise alone: that of a robot at a wall, as few strong
    misses have it, makes its ends worse than any of NOISES does, by four times what a relative must gain.
    """
    models = [replace(fitted.model, noise=noise) for noise in NOISES]
    models.append(renoised(fitted.model, fitted.tracks, swims))
    return min(end_cost(tracks, swims) for tracks in [fitted.tracks, *tracks_of(models, swims)])


def end_cost(tracks: Sequence[Track], swims: Sequence[Segments]) -> float:
    """Minus twice the log likelihood of what predictions miss at periods' ends; see ``steps.cost_of``."""
    return cost_of(ends_missed(tracks, swims))


def ends_missed(tracks: Sequence[Track], swims: Sequence[Segments]) -> FloatArray:
    """(n, 3) measured minus predicted pose at the ends of all periods: forward, left (m), heading (rad).

    Periods that nobody saw end, or that cannot be predicted by any model, are left out; those of a run that
    could not be simulated count as LOST.
    """
    rows = []
    for track, swim in zip(tracks, swims, strict=True):
        ends = end_gaps(track, swim)
        rows.append(ends[np.isfinite(ends).all(axis=1)])
    return np.concatenate(rows)


def end_gaps(track: Track, swim: Segments) -> FloatArray:
    """(m, 3) the same of one run's every period, by the pose at its start; NaN where one is not known."""
    gap = swim.measured - track.predicted
    c, s = np.cos(track.start[:, 2]), np.sin(track.start[:, 2])
    ends = np.column_stack(
        [c * gap[:, 0] + s * gap[:, 1], c * gap[:, 1] - s * gap[:, 0], wrap_angle(gap[:, 2])]
    )
    if track.failed:
        seen = np.asarray(np.isfinite(swim.measured).all(axis=1))
        ends[:] = np.where(seen[:, None], LOST[:3], np.nan)
    return ends


@dataclass(eq=False)
class _Descent:
    """Damped Gauss-Newton on the ends of periods; factors are stepped by their logarithms."""

    model: Model
    swims: Sequence[Segments]

    def __post_init__(self) -> None:
        parameters = [p for term in self.model.terms for p in term.parameters]
        self.low, self.high = self.model.bounds
        self.is_factor = np.array([p.low > 0.0 and p.nominal == 1.0 for p in parameters])
        self.reach = np.where(self.is_factor, 0.5, 0.25 * (self.high - self.low))
        self.free = np.array([k not in self.model.held for k in range(len(parameters))], dtype=np.float64)

    def _scaled(self, values: FloatArray) -> FloatArray:
        logs = np.log(np.where(self.is_factor, values, 1.0))
        return np.where(self.is_factor, logs, values) / self.reach

    def _values(self, scaled: FloatArray) -> FloatArray:
        plain = scaled * self.reach
        return np.where(self.is_factor, np.exp(np.where(self.is_factor, plain, 0.0)), plain)

    def run(self, rounds: int) -> Model:
        """The model with the values found, in so many steps at most."""
        cost = math.inf
        for _ in range(rounds):
            at = self._scaled(self.model.values)
            low, high = self._scaled(np.maximum(self.low, -1e9)), self._scaled(self.high)
            step = np.where(at + 0.16 > high, -0.16, 0.16)
            chosen = [k for k in range(len(at)) if self.free[k]]
            moved = [at, *(at + step[k] * np.eye(len(at))[k] for k in chosen)]
            every = tracks_of([self.model.with_values(self._values(each)) for each in moved], self.swims)
            base = ends_missed(every[0], self.swims)
            cost = min(cost, end_cost(every[0], self.swims))
            columns = np.zeros((*base.shape, len(at)))
            for k, tracks in zip(chosen, every[1:], strict=True):
                columns[:, :, k] = (ends_missed(tracks, self.swims) - base) / step[k]
            left, rows = whiten(whitener(base), base, columns)
            tries = []
            for damping in DAMPINGS:
                shy = np.full(len(at), damping * 0.05 * len(left))
                down = np.maximum(low - at, -2.0) * self.free
                up = np.minimum(high - at, 2.0) * self.free
                tries.append(self._values(at + bounded_step(rows, left, shy, down, up)))
            models = [self.model.with_values(values) for values in tries]
            costs = [end_cost(tracks, self.swims) for tracks in tracks_of(models, self.swims)]
            best = int(np.argmin(costs))
            if costs[best] >= cost - 0.5:
                break
            self.model, cost = models[best], costs[best]
        return self.model
