"""Drift of limbs while the robot swims: random-walk offsets beside the model, tracked by a Kalman filter.

Each limb has an offset of the pose at the end of a period in which it fires (forward, left, heading). State:
the offsets of all limbs. F: identity, the offsets are random walks. Q: their variance gain per period. H: the
limbs that fire in the period. R: the variance of the residuals. The variance gain is chosen on the training
runs. Where tracking gains next to nothing there, it is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Bool, Float64
from frogkick.core.poses import world_from_body
from frogkick.identification.predict import Rollout
from frogkick.identification.segments import Segments
from frogkick.robot import Robot

RANDOM_WALKS = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Candidates for the variance that an offset gains in a period, relative to that of the residuals."""

INITIAL_VARIANCE = 0.05  # variance of an offset at a run's start, likewise relative
HUBER_SIGMAS = (2.0, 4.0)  # innovations are clipped at these multiples of the size of the residuals
GAIN_MIN = 3.0  # minimum fall of the deviance of the training runs


@dataclass(frozen=True)
class Drift:
    """Random walk of the offsets. Entries are forward (m), left (m), heading (rad)."""

    size: tuple[float, ...]  # (3,) size of the residuals without it: m, m, rad
    # (3,) variance gained in a period, in squares of that size; 0 = no drift on this axis
    random_walk: tuple[float, ...]
    huber_sigma: tuple[float, ...]  # (3,) clipping threshold of innovations, in that size

    def as_json(self) -> dict[str, list[float]]:
        """The key ``drift`` of the command."""
        return {"size": list(self.size), "wander": list(self.random_walk), "cut": list(self.huber_sigma)}

    def followed(self, rollouts: Sequence[Rollout], swims: Sequence[Segments], robot: Robot) -> list[Rollout]:
        """Rollouts whose predictions add the offsets that are known at each period's start."""
        return [
            replace(
                rollout,
                predicted=rollout.predicted
                + world_from_body(rollout.start[:, 2], self._offsets(rollout, swim, robot)),
            )
            for rollout, swim in zip(rollouts, swims, strict=True)
        ]

    def _offsets(self, rollout: Rollout, swim: Segments, robot: Robot) -> Float64:
        """(m, 3) predicted offset at the end of each period, by the pose at its start."""
        firing, columns = np.isfinite(swim.fired_s(len(robot.limbs))), []
        numbers = zip(rollout.residuals[:, -3:].T, self.size, self.random_walk, self.huber_sigma, strict=True)
        for observed, size, walk, huber_sigma in numbers:
            columns.append(filter_offsets(observed / size, firing, walk, huber_sigma) * size)
        return np.column_stack(columns)


def filter_offsets(observed: Float64, firing: Bool, random_walk: float, huber_sigma: float) -> Float64:
    """(m,) predicted offset of each period from those before it (Kalman filter).

    Args:
        observed: (m,) residual of each period, in units of the residuals' size; NaN if unknown.
        firing: (m, limbs) whether a limb fires in a period.
        random_walk: variance that each limb's offset gains in a period; 0: offsets stay at 0.
    """
    expected = np.zeros(len(observed))
    if not random_walk:
        return expected
    limbs = firing.shape[1]
    offset, covariance = np.zeros(limbs), INITIAL_VARIANCE * np.eye(limbs)
    for period, (observation, fires) in enumerate(zip(observed, firing.astype(np.float64), strict=True)):
        covariance += random_walk * np.eye(limbs)
        expected[period] = fires @ offset
        if not np.isfinite(observation):
            continue
        gain = covariance @ fires / (fires @ covariance @ fires + 1.0)
        offset = offset + gain * np.clip(observation - expected[period], -huber_sigma, huber_sigma)
        covariance = covariance - np.outer(gain, fires @ covariance)
    return expected


def drift_of(rollouts: Sequence[Rollout], swims: Sequence[Segments], robot: Robot) -> Drift | None:
    """Drift of the limbs in the training runs; None if tracking it gains next to nothing there."""
    residuals = [rollout.end_errors(swim) for rollout, swim in zip(rollouts, swims, strict=True)]
    observed = [rollout.residuals[:, -3:] for rollout in rollouts]
    firing = [np.isfinite(swim.fired_s(len(robot.limbs))) for swim in swims]
    every = np.concatenate(residuals)
    known = np.isfinite(every).all(axis=1)
    if not known.any():
        return None
    size = np.sqrt((every[known] ** 2).mean(axis=0))
    random_walk, huber_sigmas = [0.0, 0.0, 0.0], [HUBER_SIGMAS[-1]] * 3
    for axis in range(3):
        plain = _square(residuals, axis, [np.zeros(len(each)) for each in residuals])
        best = plain * float(np.exp(-GAIN_MIN / known.sum()))
        for walk in RANDOM_WALKS:
            for huber_sigma in HUBER_SIGMAS:
                expected = [
                    size[axis] * filter_offsets(observation[:, axis] / size[axis], fires, walk, huber_sigma)
                    for observation, fires in zip(observed, firing, strict=True)
                ]
                left = _square(residuals, axis, expected)
                if left < best:
                    random_walk[axis], huber_sigmas[axis], best = walk, huber_sigma, left
    if not any(random_walk):
        return None
    return Drift(tuple(size.tolist()), tuple(random_walk), tuple(huber_sigmas))


def _square(residuals: Sequence[Float64], axis: int, expected: Sequence[Float64]) -> float:
    errors = [each[:, axis] - offset for each, offset in zip(residuals, expected, strict=True)]
    return float(np.nansum(np.concatenate(errors) ** 2))
