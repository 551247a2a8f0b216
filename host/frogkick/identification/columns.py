"""What each candidate would change in the misses: derivatives by its parameters, simulated side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frogkick.identification.fit import Model, coarse, misses, steps_of, tracks_of
from frogkick.identification.probe import Probes, Sums, changes, probes_of, spread_first
from frogkick.identification.segments import Segments
from frogkick.identification.terms import Term
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

COARSE_LEG_S, COARSE_STEP_S = 0.18, 2.4e-3
"""How often flows and wrenches are asked while candidates are only ranked, and the finest step then."""


@dataclass(frozen=True, eq=False)
class Column:
    """What a candidate's parameters do to the misses, about one start.

    Attributes:
        term: at the start.
        jacobian: (n, 9, p).
    """

    term: Term
    jacobian: FloatArray


def sensitivities(
    model: Model,
    candidates: Sequence[Term],
    swims: Sequence[Segments],
    rows: NDArray[np.bool_],
    progress: Callable[[int, int], None],
) -> list[Column]:
    """Derivatives by each candidate's parameters; one that does nothing at first is tried where it does.

    Coarser in time and in the frame than a fit, all side by side so that lanes are full, and none simulated
    that is a sum of others. A start differs from the bare model only by values that do nothing alone.
    """
    bare = replace(model, robot=coarse(model.robot), terms=(), leg_s=COARSE_LEG_S, step_s=COARSE_STEP_S)
    probes = probes_of(model.robot)
    starts: list[Term] = []
    wanted: list[tuple[FloatArray | None, tuple[int, int]]] = []
    for term in candidates:
        own = _own_starts(term, model.robot, swims)
        for start, placed in own:
            wanted += [
                (None, (len(starts), k)) for k, p in enumerate(term.parameters) if p.name not in placed
            ]
            starts.append(start)
        if own:
            continue
        told = _changes(probes, bare, term)
        dead = np.array([change is not None and not change.any() for change in told])
        if dead.all():
            continue
        for start in _starts(term, dead, swims) if dead.any() else [term]:
            for k, change in enumerate(told if start is term else _changes(probes, bare, start)):
                if not dead[k]:
                    wanted.append((change, (len(starts), k)))
            starts.append(start)
    sums, simulated = Sums(), []
    made: dict[tuple[int, int], FloatArray] = {}
    places: list[tuple[int, int]] = []
    bodies: list[tuple[int, int]] = []
    for index in spread_first(wanted):
        change, place = wanted[index]
        if change is None:
            bodies.append(place)
            continue
        weights = sums.weights(change)
        if weights is None:
            sums.add(change)
            places.append(place)
        else:
            made[place] = weights
    for index, k in [*places, *bodies]:
        at = replace(bare, terms=(starts[index],))
        moved = at.values
        moved[k] += _steps(at)[k]
        simulated.append(at.with_values(moved))
    progress(0, 1)
    every = tracks_of([bare, *simulated], swims)
    progress(1, 1)
    base = misses(every[0], rows)
    jacobians = [np.zeros((*base.shape, len(start.values))) for start in starts]
    columns = []
    for (index, k), tracks in zip([*places, *bodies], every[1:], strict=True):
        step = _steps(replace(bare, terms=(starts[index],)))[k]
        jacobians[index][:, :, k] = (misses(tracks, rows) - base) / step
        columns.append(jacobians[index][:, :, k])
    for (index, k), weights in made.items():
        jacobians[index][:, :, k] = np.tensordot(weights, np.array(columns[: len(weights)]), axes=1)
    return [Column(term, jacobian) for term, jacobian in zip(starts, jacobians, strict=True)]


def _steps(model: Model) -> FloatArray:
    """As a fit takes them; a long one where small ones tell little of what is farther off."""
    given = [p.tried[len(p.tried) // 4] if p.tried else 0.0 for term in model.terms for p in term.parameters]
    return np.where(given, given, steps_of(model))


def _changes(probes: Probes, bare: Model, term: Term) -> list[FloatArray | None]:
    return changes(probes, term, steps_of(replace(bare, terms=(term,))))


def _own_starts(term: Term, robot: Robot, swims: Sequence[Segments]) -> list[tuple[Term, set[str]]]:
    """Starts that an effect asks for by itself, and which parameters say where it is there.

    Probes are here and there, such an effect is in one place: all its other parameters are simulated.
    """
    effect = term.effect()
    effect.check(robot)
    reached = np.concatenate([swim.pose[:, :2] for swim in swims])
    found = []
    for given in effect.starts(reached.min(axis=0), reached.max(axis=0)):
        values = dict(zip((p.name for p in term.parameters), term.values, strict=True))
        found.append((term.at(list({**values, **given}.values())), set(given)))
    return found


def _starts(term: Term, dead: NDArray[np.bool_], swims: Sequence[Segments]) -> list[Term]:
    """Starts spread over parameters that say nothing where the effect vanishes; places where runs went."""
    starts = [term]
    primes = (2, 3, 5, 7)
    reached = np.concatenate([swim.pose[:, :2] for swim in swims])
    ends = zip(reached.min(axis=0), reached.max(axis=0), strict=True)
    ranges = dict(zip(("x_m", "y_m"), ends, strict=True))
    for n in range(1, 2 + int(dead.sum())):
        values = list(term.values)
        for order, k in enumerate(np.flatnonzero(dead)):
            p = term.parameters[k]
            low, high = ranges.get(p.name, (p.low, p.high))
            share = _halton(n, primes[order % len(primes)])
            # Times and sizes are spread by factors.
            even = p.low <= 0.0 or p.name in ranges
            values[k] = low + share * (high - low) if even else low * (high / low) ** share
        starts.append(term.at(values))
    return starts


def _halton(index: int, base: int) -> float:
    share, digit = 0.0, 1.0
    while index:
        digit /= base
        share += digit * (index % base)
        index //= base
    return share
