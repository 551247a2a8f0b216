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
from frogkick.identify.filter import Noise
from frogkick.identify.fit import (
    Fitted,
    Model,
    coarse,
    derivatives,
    misses,
    tracks_of,
)
from frogkick.identify.predict import Track
from frogkick.identify.steps import bounded_step, cost_of
from frogkick.identify.swim import Swim, part_of
from frogkick.identify.terms import Term
from frogkick.identify.worth import BASE_GAIN, GAIN_EACH
from frogkick.paths import wrap_angle
from frogkick.robot import Robot, built_in_robots, load_robot

FloatArray = NDArray[np.float64]

ROUNDS = 5
"""Steps of the fit at most."""

PART, PART_ROUNDS, WHOLE_ROUNDS = 60, 12, 2
"""From nominal values: so many periods, the first of each run, are fitted in so many steps, then all."""

LEG_S = 0.05
"""How often wrenches are asked: a glide changes slowly."""

WILD = 2.5
"""Misses count by their squares up to so many times their size, beyond in proportion."""

START_SHARE = 0.5
"""Of what a relative's effects must explain for their number once they are fitted, so much before.

As a file has them nothing is fitted to the runs at hand, so less is owed for their number. Each side at the
best of its noises: of 256 asked of the fitted effects, the recorded robot explains 231 in three short runs,
and 212 from rough values; simulated robots that are none explain -915 with nothing planted, -567 to -405 with
a current, a vortex, drag, an off-centre mass or a worn limb with yaw drag, and -254 and 49 at a wall.
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
    swims: Sequence[Swim],
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
    plain, dear = end_cost(nominal.tracks, swims), GAIN_EACH * free + BASE_GAIN * len(terms)
    models = [replace(start, noise=noise) for noise in NOISES]
    costs = [end_cost(tracks, swims) for tracks in tracks_of(models, swims)]
    if measured and min(costs) > best_end_cost(nominal, swims) - START_SHARE * dear:
        return None  # another robot than that one
    model = models[int(np.argmin(costs))]
    if measured:
        model = _Descent(model, swims).run(ROUNDS)
    else:
        model = _Descent(model, part_of(swims, PART)).run(PART_ROUNDS)
        model = _Descent(model, swims).run(WHOLE_ROUNDS)
    rough = derivatives([model], swims, rows)[0]
    fine = replace(model, robot=nominal.model.robot)
    (tracks,) = tracks_of([fine], swims)
    missed = misses(tracks, rows)
    fitted = Fitted(fine, tracks, missed, rough.jacobian, cost_of(missed))
    return fitted if end_cost(fitted.tracks, swims) < plain - dear else None


def best_end_cost(fitted: Fitted, swims: Sequence[Swim]) -> float:
    """The lowest ``end_cost`` of a model, at its own noise or at those that relatives are tried at.

    What a model is held against must not gain by its noise alone: that of a robot at a wall, as few strong
    misses have it, makes its ends worse than any of NOISES does, by four times what a relative must gain.
    """
    models = [replace(fitted.model, noise=noise) for noise in NOISES]
    return min(end_cost(tracks, swims) for tracks in [fitted.tracks, *tracks_of(models, swims)])


def end_cost(tracks: Sequence[Track], swims: Sequence[Swim]) -> float:
    """Minus twice the log likelihood of what predictions miss at periods' ends, each axis by its size."""
    ends = _ends(tracks, swims)
    size = np.abs(ends) / _size(ends)
    cut = np.where(size < WILD, size**2, WILD * (2.0 * size - WILD))
    return float(len(ends) * (2.0 * np.log(_size(ends)) + cut.mean(axis=0)).sum())


def _ends(tracks: Sequence[Track], swims: Sequence[Swim]) -> FloatArray:
    """(n, 3) measured minus predicted pose at the ends of all periods: forward, left (m), heading (rad)."""
    rows = []
    for track, swim in zip(tracks, swims, strict=True):
        gap = swim.measured - track.predicted
        c, s = np.cos(track.start[:, 2]), np.sin(track.start[:, 2])
        ends = np.column_stack(
            [c * gap[:, 0] + s * gap[:, 1], c * gap[:, 1] - s * gap[:, 0], wrap_angle(gap[:, 2])]
        )
        rows.append(ends[np.isfinite(swim.measured).all(axis=1)])
    every = np.concatenate(rows)
    known = np.asarray(np.isfinite(every).all(axis=1))
    return np.where(known[:, None], every, 0.0) if known.mean() > 0.8 else np.full_like(every, 1.0)


def _size(ends: FloatArray) -> FloatArray:
    """(3,) size of misses, little moved by wild ones."""
    return np.maximum(1.4826 * np.median(np.abs(ends), axis=0), (1e-4, 1e-4, 1e-3))


@dataclass(eq=False)
class _Descent:
    """Damped Gauss-Newton on the ends of periods; factors are stepped by their logarithms."""

    model: Model
    swims: Sequence[Swim]

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
            base = _ends(every[0], self.swims)
            cost = min(cost, end_cost(every[0], self.swims))
            size = _size(base)
            columns = np.zeros((base.size, len(at)))
            for k, tracks in zip(chosen, every[1:], strict=True):
                columns[:, k] = ((_ends(tracks, self.swims) - base) / size / step[k]).ravel()
            flat = (base / size).ravel()
            weight = np.sqrt(np.minimum(1.0, WILD / np.maximum(np.abs(flat), 1e-9)))
            rows, left = columns * weight[:, None], flat * weight
            tries = []
            for damping in DAMPINGS:
                shy = np.full(len(at), damping * 0.05 * len(flat))
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
