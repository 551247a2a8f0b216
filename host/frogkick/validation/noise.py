"""Noise of measured swimming speeds: a model's error below it cannot be distinguished from noise.

Three estimates, none of which uses the model:

- **neighbours**: along a sweep of frequency or phase, the second difference a - 2 b + c of three evenly
  spaced speeds has six times the variance of one, if the true speeds lie on a line. They nearly do over
  0.1 Hz or a tenth of a cycle; where they bend, the estimate is too high. Phase is cyclic: 0.9 and 0.0 are
  neighbours.
- **repeats**: swims of one gait that were measured twice.
- **within a swim**: scatter between the cycles of one swim, over the root of their number. It does not
  contain the differences between two swims (start of the robot, state of its actuators), so it is too low.

The reported floor is the first: the second has one or two pairs, and the third misses most of the noise.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from frogkick.der import Gait
from frogkick.validation.validate import ExperimentResult, by_group

_SAME = 1e-6
_SAME_SPEED_MPS = 1e-9


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a measured speed, m/s, by group of experiments.

    Attributes:
        neighbours, within_swim: of each group that allows an estimate.
        triples: number of second differences of ``neighbours``.
        repeats: of all gaits that were measured more than once; NaN without any.
        repeated: number of further swims of these gaits.
    """

    neighbours: dict[str, float]
    triples: dict[str, int]
    within_swim: dict[str, float]
    repeats: float
    repeated: int


def second_differences(places: Sequence[float], speeds: Sequence[float], cycle: float | None) -> list[float]:
    """Return (a - 2 b + c) / sqrt(6) of each three evenly spaced neighbours; ``cycle`` is the period of
    places."""
    rows = sorted(zip(places, speeds, strict=True))
    if cycle is not None:
        rows += [(place + cycle, speed) for place, speed in rows[:2]]
    found: list[float] = []
    for (x0, a), (x1, b), (x2, c) in zip(rows, rows[1:], rows[2:], strict=False):
        if abs((x2 - x1) - (x1 - x0)) < _SAME and 0.0 < x1 - x0 < 0.15:
            found.append((a - 2.0 * b + c) / math.sqrt(6.0))
    return found


def _distinct(results: Iterable[ExperimentResult]) -> dict[Gait, list[float]]:
    """Return the measured speeds of each gait; a swim that belongs to two sweeps counts once."""
    speeds: dict[Gait, list[float]] = {}
    for result in results:
        known = speeds.setdefault(result.case.gait, [])
        if all(abs(result.reference.speed_mps - speed) > _SAME_SPEED_MPS for speed in known):
            known.append(result.reference.speed_mps)
    return speeds


def noise_of(experiments: Sequence[ExperimentResult]) -> Noise:
    """Estimate the noise of measured speeds from the measurements alone."""
    bends: list[tuple[str, float]] = []
    for group, members in itertools.groupby(
        sorted(experiments, key=lambda r: r.case.group), key=lambda r: r.case.group
    ):
        rows = list(members)
        by_phase = "/phase/" in group
        if not by_phase and "/freq/" not in group:
            continue
        places = [r.case.gait.phase if by_phase else r.case.gait.frequency_hz for r in rows]
        speeds = [r.reference.speed_mps for r in rows]
        bends += [(group, bend) for bend in second_differences(places, speeds, 1.0 if by_phase else None)]
    within = [(r.case.group, r.reference.sd_mps) for r in experiments]
    several = [speeds for speeds in _distinct(experiments).values() if len(speeds) > 1]
    spare = sum(len(speeds) - 1 for speeds in several)
    scatter = sum(sum((s - sum(row) / len(row)) ** 2 for s in row) for row in several)
    neighbours = by_group(bends)
    return Noise(
        neighbours,
        {name: sum(g == name or g.startswith(name + "/") for g, _ in bends) for name in neighbours},
        by_group((group, sd) for group, sd in within if sd is not None),
        math.sqrt(scatter / spare) if spare else math.nan,
        spare,
    )
