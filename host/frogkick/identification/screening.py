"""Candidate effects judged beside a model: to first order (score test, Rao 1948), and on held-out periods.

To first order a robot responds linearly to what is done to its strokes, its water, its body and its fixes. So
effects are first probed without a simulation. A parameter that changes none of these where the effect
vanishes is insensitive there and needs no simulation. One whose change is a linear combination of others'
changes needs none of its own: its derivative is the same combination.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.effects import Body, Effect, Fix, History, Stroke
from frogkick.effects.base import call_hook, fix_by, numbers_by, robot_by, starts_by, stroke_by
from frogkick.identification.batching import all_of
from frogkick.identification.fit import (
    PARAMETER_PENALTY,
    Fitted,
    Model,
    coarsened,
    difference_steps,
    fit_on,
    residuals_of,
    rollouts_of,
    step_bounds,
)
from frogkick.identification.refine import RELEASE_PENALTY, STEPS_MAX
from frogkick.identification.segments import Data, Segments
from frogkick.identification.steps import cross_fitted, deviance_of, held_out_density, linearised_optimum
from frogkick.identification.terms import Term
from frogkick.robot import Robot

COARSE_LEG_S, COARSE_STEP_S = 0.18, 2.4e-3
"""How often flows and wrenches are evaluated while candidates are only ranked, and the finest step then."""

_PROBES = 60
_SUM_ERROR = 1e-6  # share of a change that a linear combination of others may leave
FIXED_SHARE = 0.05  # a parameter is fixed if it gains less than this share of its effect's predicted gain


@dataclass(frozen=True, eq=False)
class Column:
    """(n, 9, p) Jacobian of the residuals by a candidate's parameters, at one start."""

    term: Term
    jacobian: Float64


def sensitivities(
    model: Model, candidates: Sequence[Term], data: Data, progress: Callable[[int, int], None]
) -> list[Column]:
    """Jacobians of all candidates; where a parameter has no influence at the start, further starts are tried.

    Simulations are coarser in time and in the frame than those of a fit. They share batches, and a parameter
    whose influence is a linear combination of others is not simulated. A start differs from the bare model
    only by values that have no influence alone.
    """
    bare = replace(model, robot=coarsened(model.robot), terms=(), leg_s=COARSE_LEG_S, step_s=COARSE_STEP_S)
    probes, swims = probes_of(model.robot), data.swims
    starts: list[Term] = []
    wanted: list[tuple[Float64 | None, tuple[int, int]]] = []
    for term in candidates:
        own = _own_starts(term, model.robot, swims)
        for start, placed in own:
            wanted += [
                (None, (len(starts), k)) for k, p in enumerate(term.parameters) if p.name not in placed
            ]
            starts.append(start)
        if own:
            continue
        responses = _changes(probes, bare, term)
        insensitive = np.array([change is not None and not change.any() for change in responses])
        if insensitive.all():
            if term.own:  # it may act where no probe is: late in a run, far off, or by the state of the body
                wanted += [(None, (len(starts), k)) for k in range(len(term.parameters))]
                starts.append(term)
            continue
        for start in _starts(term, insensitive, swims) if insensitive.any() else [term]:
            for k, change in enumerate(responses if start is term else _changes(probes, bare, start)):
                if not insensitive[k]:
                    wanted.append((change, (len(starts), k)))
            starts.append(start)
    span, simulated = LinearSpan(), []
    combined: dict[tuple[int, int], Float64] = {}
    places: list[tuple[int, int]] = []
    bodies: list[tuple[int, int]] = []
    # Changes in few situations come first, so that combinations are of simple ones.
    for change, place in sorted(
        wanted, key=lambda row: 0 if row[0] is None else int(np.count_nonzero(row[0]))
    ):
        if change is None:
            bodies.append(place)
            continue
        weights = span.weights(change)
        if weights is None:
            span.add(change)
            places.append(place)
        else:
            combined[place] = weights
    for index, k in [*places, *bodies]:
        at = replace(bare, terms=(starts[index],))
        moved = at.values
        moved[k] += _steps(at)[k]
        simulated.append(at.with_values(moved))
    progress(0, 1)
    every = rollouts_of([bare, *simulated], swims)
    progress(1, 1)
    base = residuals_of(every[0], data.rows)
    jacobians = [np.zeros((*base.shape, len(start.values))) for start in starts]
    columns = []
    for (index, k), rollouts in zip([*places, *bodies], every[1:], strict=True):
        step = _steps(replace(bare, terms=(starts[index],)))[k]
        jacobians[index][:, :, k] = (residuals_of(rollouts, data.rows) - base) / step
        columns.append(jacobians[index][:, :, k])
    for (index, k), weights in combined.items():
        jacobians[index][:, :, k] = np.tensordot(weights, np.array(columns[: len(weights)]), axes=1)
    return [Column(term, jacobian) for term, jacobian in zip(starts, jacobians, strict=True)]


def _steps(model: Model) -> Float64:
    """The steps of a fit; a long one where a parameter's influence far off is not that of a small step."""
    given = [p.grid[len(p.grid) // 4] if p.grid else 0.0 for p in model.parameters]
    return np.where(given, given, difference_steps(model))


def _changes(probes: Probes, bare: Model, term: Term) -> list[Float64 | None]:
    return changes(probes, term, difference_steps(replace(bare, terms=(term,))))


def _own_starts(term: Term, robot: Robot, swims: Sequence[Segments]) -> list[tuple[Term, set[str]]]:
    """Starts that an effect declares, and which parameters place it there.

    Probes are spread out and such an effect is in one place, so all its other parameters are simulated.
    """
    effect = term.effect()
    call_hook(effect, "check", robot)
    reached = np.concatenate([swim.pose[:, :2] for swim in swims])
    found = []
    for given in starts_by(effect, reached.min(axis=0), reached.max(axis=0)):
        values = dict(zip((p.name for p in term.parameters), term.values, strict=True))
        found.append((term.at(list({**values, **given}.values())), set(given)))
    return found


def _starts(term: Term, insensitive: Bool, swims: Sequence[Segments]) -> list[Term]:
    """Starts spread over the insensitive parameters (Halton sequence), within the area of the runs."""
    from scipy.stats import qmc

    starts = [term]
    reached = np.concatenate([swim.pose[:, :2] for swim in swims])
    ends = zip(reached.min(axis=0), reached.max(axis=0), strict=True)
    ranges = dict(zip(("x_m", "y_m"), ends, strict=True))
    free = np.flatnonzero(insensitive)
    for shares in qmc.Halton(max(1, len(free)), scramble=False).random(2 + len(free))[1:].tolist():
        values = list(term.values)
        for k, share in zip(free, shares, strict=False):
            p = term.parameters[k]
            low, high = ranges.get(p.name, (p.low, p.high))
            # Times and sizes are spread evenly in their logarithm.
            even = p.low <= 0.0 or p.name in ranges
            values[k] = low + share * (high - low) if even else low * (high / low) ** share
        starts.append(term.at(values))
    return starts


@dataclass(frozen=True, eq=False)
class Screened:
    """A screened candidate at one start: the gain that its derivatives predict."""

    column: Column
    gain: float  # predicted fall of the deviance
    score: float  # gain minus the penalty of the free parameters
    values: Float64  # of all its parameters
    fixed: frozenset[int]  # which of them stay at the values where the effect vanishes


def screened(current: Fitted, column: Column, data: Data) -> Screened:
    """Screen one candidate beside a model, with as few free parameters as do nearly as well."""
    term, known = column.term, current.jacobian.shape[2]
    start = np.array(term.values)
    low = np.array([p.low for p in term.parameters]) - start
    high = np.array([p.high for p in term.parameters]) - start
    down, up = step_bounds(current.model)
    both = np.concatenate([current.jacobian, column.jacobian], axis=2)
    damping = np.append(np.full(known, 1e-12), 1e-6 * current.residuals.size / (high - low) ** 2)

    def solve(fixed: frozenset[int]) -> tuple[Float64, float]:
        free = np.array([k not in fixed for k in range(len(start))])
        lows, highs = np.append(down, low * free), np.append(up, high * free)
        return linearised_optimum(current.residuals, both, lows, highs, damping)

    insensitive = [k for k in range(len(start)) if not column.jacobian[:, :, k].any()]
    fixed = frozenset(k for k in insensitive if start[k] == term.parameters[k].nominal)
    step, deviance = solve(fixed)
    for _ in range(len(start) - len(fixed) - 1):
        fewer = [fixed | {k} for k in range(len(start)) if k not in fixed and k not in insensitive]
        if len(fewer) < 2:
            break
        solved = [(*solve(each), each) for each in fewer]
        lighter, dearer, chosen = min(solved, key=lambda row: row[1])
        # Where much is gained, derivatives err by more than RELEASE_PENALTY; what is fixed too soon is
        # released later.
        if dearer > deviance + max(RELEASE_PENALTY, FIXED_SHARE * (current.deviance - deviance)):
            break
        step, deviance, fixed = lighter, dearer, chosen
    gain = current.deviance - deviance
    score = gain / data.replicate_count - PARAMETER_PENALTY * (len(start) - len(fixed))
    return Screened(column, gain, score, start + step[known:], fixed)


def held_out_gain(current: Fitted, fitted: Fitted, folds: Int64) -> tuple[float, float]:
    """Mean gain of a fitted candidate on a held-out period over the model without it, and its standard error.

    The gain is twice the difference of the log densities, cross-validated: the fold of a period takes no part
    in the estimates of parameters and scale."""
    (low, high), known = step_bounds(fitted.model), len(current.model.values)
    scores = [
        cross_fitted(one.residuals, one.jacobian, lows, highs, np.full(len(lows), 1e-9), folds)
        for one, lows, highs in ((current, low[:known], high[:known]), (fitted, low, high))
    ]
    falls = 2.0 * (scores[1] - scores[0])
    return float(falls.mean()), float(falls.std() / np.sqrt(len(falls)))


def bent_gain(current: Fitted, fitted: Fitted, data: Data) -> tuple[Fitted, tuple[float, float]]:
    """A candidate fitted further, and its ``held_out_gain`` with the fit without each fold simulated.

    This is for laws with a sharp edge, such as a cable that becomes taut or the end of a patch: derivatives
    do not predict how the edge moves in a fit without a fold.
    """
    known, folds = len(current.model.values), data.folds
    (fitted,) = fit_on([fitted], data, STEPS_MAX, known)
    numbers, falls, labels = np.flatnonzero(data.rows), np.zeros(len(folds)), np.unique(folds)
    low, high = step_bounds(current.model)
    plain = cross_fitted(current.residuals, current.jacobian, low, high, np.full(len(low), 1e-9), folds)

    def residuals_without(label: int) -> Float64:
        kept, some = folds != label, data.rows.copy()
        some[numbers[~kept]] = False
        left, seen = fitted.residuals[kept], fitted.jacobian[kept]
        start = replace(fitted, residuals=left, jacobian=seen, deviance=deviance_of(left))
        (less,) = fit_on([start], replace(data, rows=some), 2, known)
        return residuals_of(less.rollouts, data.rows)

    for label, every in zip(labels, all_of([partial(residuals_without, k) for k in labels]), strict=True):
        test = folds == label
        falls[test] = 2.0 * (held_out_density(every, test) - plain[test])
    return fitted, (float(falls.mean()), float(falls.std() / np.sqrt(len(falls))))


@dataclass(frozen=True, eq=False)
class Probes:
    """Situations in which effects are evaluated, the same for all."""

    robot: Robot
    # limb, time and earlier strokes (time_s, limb) of each stroke
    strokes: tuple[tuple[int, float, tuple[tuple[float, int], ...]], ...]
    bodies: tuple[Body, ...]

    def responses(self, effect: Effect) -> Float64:
        """(k,) all that an effect does, concatenated."""
        names = [limb.name for limb in self.robot.limbs]
        responses: list[float] = []
        for limb, time_s, before in self.strokes:
            given = Stroke(names[limb], limb, time_s)
            stroke = stroke_by(effect, given, History(list(before)), np.random.default_rng(0))
            responses += [stroke.gain, stroke.delay_s, stroke.duration_scale]
        for body in self.bodies:
            responses += numbers_by(effect, "flow", 2, body.time_s, np.array(body.pose_world[:2]))
            responses += numbers_by(effect, "wrench", 3, body.time_s, body)
            given_fix = Fix(body.time_s, 0.08, *body.pose_world)
            fix = fix_by(effect, given_fix, np.random.default_rng(0)) or given_fix
            responses += [fix.capture_s, fix.x_m, fix.y_m, fix.heading_rad]
        return np.array(responses, dtype=np.float64)


def probes_of(robot: Robot) -> Probes:
    """Situations for a robot's effects: strokes after other strokes, bodies at random poses."""
    rng = np.random.default_rng(0)
    strokes, bodies = [], []
    for _ in range(_PROBES):
        before: list[tuple[float, int]] = []
        now_s = float(rng.uniform(0.5, 2.0))
        for _ in range(int(rng.integers(0, 12))):
            fired = rng.permutation(len(robot.limbs))[: int(rng.integers(1, len(robot.limbs) + 1))]
            late_s = np.where(rng.random(len(fired)) < 0.5, robot.second_delay_s, 0.0)
            before += sorted(zip((now_s + late_s).tolist(), fired.tolist(), strict=True))
            now_s += robot.period_s
        if before and rng.random() < 0.5:
            now_s = before[-1][0] + robot.second_delay_s
        strokes.append((int(rng.integers(len(robot.limbs))), now_s, tuple(before)))
        pose, velocity = rng.uniform([-1.0, -1.0, -3.0], [1.0, 1.0, 3.0]), rng.normal(0.0, [0.04, 0.01, 0.3])
        bodies.append(Body(now_s, tuple(pose.tolist()), tuple(velocity.tolist())))
    return Probes(robot, tuple(strokes), tuple(bodies))


def changes(probes: Probes, term: Term, step: Float64) -> list[Float64 | None]:
    """Derivative of the responses by each parameter; None if the parameter changes the body."""
    base_effect = term.effect()
    base, base_robot = probes.responses(base_effect), robot_by(base_effect, probes.robot)
    found: list[Float64 | None] = []
    for k in range(len(term.values)):
        moved = term.at(np.array(term.values) + np.diag(step)[k]).effect()
        same = robot_by(moved, probes.robot) == base_robot
        found.append((probes.responses(moved) - base) / float(step[k]) if same else None)
    return found


class LinearSpan:
    """Span of the changes that are simulated."""

    def __init__(self) -> None:
        self._rows: list[Float64] = []

    def weights(self, change: Float64) -> Float64 | None:
        """(rows,) weights of the linear combination that a change is; None if it is none.

        Delays are excluded: moving one stroke beside another is not the same as moving both.
        """
        if not self._rows or change[1 : 3 * _PROBES : 3].any():
            return None
        table = np.array(self._rows).T
        sizes = np.linalg.norm(table, axis=0)
        weights = np.linalg.lstsq(table / sizes, change, rcond=1e-9)[0]
        left = change - table / sizes @ weights
        if np.linalg.norm(left) > _SUM_ERROR * np.linalg.norm(change):
            return None
        return np.asarray(weights / sizes)

    def add(self, change: Float64) -> None:
        """Add a change that is not in the span."""
        self._rows.append(change)
