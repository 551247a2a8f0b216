"""Score-test screening of candidate effects: how each would change the residuals, to first order.

A candidate is not fitted to be ranked. The derivatives of the residuals by its parameters, at values where
the effect vanishes, predict the gain of its optimum (an analogue of the score test, Rao 1948).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Bool, Float64
from frogkick.identification.fit import (
    Fitted,
    Model,
    coarsened,
    difference_steps,
    residuals_of,
    rollouts_of,
    step_bounds,
)
from frogkick.identification.penalty import PARAMETER_PENALTY
from frogkick.identification.probe import LinearSpan, Probes, changes, probes_of, spread_first
from frogkick.identification.refine import RELEASE_PENALTY
from frogkick.identification.segments import Segments
from frogkick.identification.steps import linearised_optimum
from frogkick.identification.terms import Term
from frogkick.robot import Robot

COARSE_LEG_S, COARSE_STEP_S = 0.18, 2.4e-3
"""How often flows and wrenches are evaluated while candidates are only ranked, and the finest step then."""

FIXED_SHARE = 0.05
"""A parameter is fixed if it gains less than this share of its effect's predicted gain."""


@dataclass(frozen=True, eq=False)
class Column:
    """Jacobian of the residuals by a candidate's parameters, at one start.

    Attributes:
        term: at the start.
        jacobian: (n, 9, p).
    """

    term: Term
    jacobian: Float64


def sensitivities(
    model: Model,
    candidates: Sequence[Term],
    swims: Sequence[Segments],
    rows: Bool,
    progress: Callable[[int, int], None],
) -> list[Column]:
    """Jacobians of all candidates; where a parameter has no influence at the start, further starts are tried.

    Simulations are coarser in time and in the frame than those of a fit. They share batches, and a parameter
    whose influence is a linear combination of others is not simulated. A start differs from the bare model
    only by values that have no influence alone.
    """
    bare = replace(model, robot=coarsened(model.robot), terms=(), leg_s=COARSE_LEG_S, step_s=COARSE_STEP_S)
    probes = probes_of(model.robot)
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
    for index in spread_first(wanted):
        change, place = wanted[index]
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
    base = residuals_of(every[0], rows)
    jacobians = [np.zeros((*base.shape, len(start.values))) for start in starts]
    columns = []
    for (index, k), rollouts in zip([*places, *bodies], every[1:], strict=True):
        step = _steps(replace(bare, terms=(starts[index],)))[k]
        jacobians[index][:, :, k] = (residuals_of(rollouts, rows) - base) / step
        columns.append(jacobians[index][:, :, k])
    for (index, k), weights in combined.items():
        jacobians[index][:, :, k] = np.tensordot(weights, np.array(columns[: len(weights)]), axes=1)
    return [Column(term, jacobian) for term, jacobian in zip(starts, jacobians, strict=True)]


def _steps(model: Model) -> Float64:
    """The steps of a fit; a long one where a parameter's influence far off is not that of a small step."""
    given = [p.grid[len(p.grid) // 4] if p.grid else 0.0 for term in model.terms for p in term.parameters]
    return np.where(given, given, difference_steps(model))


def _changes(probes: Probes, bare: Model, term: Term) -> list[Float64 | None]:
    return changes(probes, term, difference_steps(replace(bare, terms=(term,))))


def _own_starts(term: Term, robot: Robot, swims: Sequence[Segments]) -> list[tuple[Term, set[str]]]:
    """Starts that an effect declares, and which parameters place it there.

    Probes are spread out and such an effect is in one place, so all its other parameters are simulated.
    """
    effect = term.effect()
    effect.check(robot)
    reached = np.concatenate([swim.pose[:, :2] for swim in swims])
    found = []
    for given in effect.starts(reached.min(axis=0), reached.max(axis=0)):
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
    """A screened candidate at one start: the gain that its derivatives predict.

    Attributes:
        gain: predicted fall of the deviance.
        score: gain minus the penalty of the free parameters.
        values: of all its parameters.
        fixed: which of them stay at the values where the effect vanishes.
    """

    column: Column
    gain: float
    score: float
    values: Float64
    fixed: frozenset[int]


def screened(current: Fitted, column: Column, replicate_count: int) -> Screened:
    """Screen one candidate beside a model, with as few free parameters as do nearly as well.

    Args:
        current: the model.
        column: the candidate, with its derivatives.
        replicate_count: runs that are replicates with the same noise: their gain counts once.
    """
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
    score = gain / replicate_count - PARAMETER_PENALTY * (len(start) - len(fixed))
    return Screened(column, gain, score, start + step[known:], fixed)
