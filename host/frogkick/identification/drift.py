"""Limbs that drift while the robot swims: what their strokes have lately done beside the model.

No two strokes of shape-memory wire are the same, and what one leaves out the next mostly leaves out as well.
The robot's own estimator learns what its strokes do beside the table; a prediction here likewise takes into
account what the run has shown so far. Each limb has an offset for the end of a period in which it fires,
forward, left and in heading, that wanders from period to period and is followed by a Kalman filter through
what the fixes known by then have shown. How fast offsets wander is chosen on the training runs; where
following them gains next to nothing there they are left out, so a robot that swims as modelled is predicted
by the model alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frogkick.identification.predict import Track
from frogkick.identification.segments import Segments
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

WANDERS = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Variance that an offset gains in a period, over that of what a period misses by chance."""

FIRST = 0.05
"""Variance of an offset at a run's start, likewise."""

CUT = (2.0, 4.0)
"""What a period shows counts up to so many times the size of misses."""

GAIN_LEAST = 3.0
"""Gain of twice the log likelihood of the training runs' misses: of fewer periods a larger share must go."""


@dataclass(frozen=True)
class Drift:
    """How offsets wander. Rows are forward (m), left (m), heading (rad).

    Attributes:
        size: (3,) of misses without it: m, m, rad.
        wander: (3,) variance gained in a period, in squares of that size; 0 = this axis is left alone.
        cut: (3,) how much a period may show at most, in that size.
    """

    size: tuple[float, float, float]
    wander: tuple[float, float, float]
    cut: tuple[float, float, float]

    def as_json(self) -> dict[str, list[float]]:
        """The key ``drift`` of the command."""
        return {"size": list(self.size), "wander": list(self.wander), "cut": list(self.cut)}

    def followed(self, tracks: Sequence[Track], swims: Sequence[Segments], robot: Robot) -> list[Track]:
        """Tracks whose predictions take into account what each run had shown by each period's start."""
        return [
            replace(track, predicted=_moved(track, self._offsets(track, swim, robot)))
            for track, swim in zip(tracks, swims, strict=True)
        ]

    def _offsets(self, track: Track, swim: Segments, robot: Robot) -> FloatArray:
        """(m, 3) what is expected beside the model at the end of each period, by the pose at its start."""
        firing, shown = firing_of(swim, robot), track.missed[:, -3:]
        return np.column_stack(
            [
                follow_offsets(shown[:, axis] / self.size[axis], firing, self.wander[axis], self.cut[axis])
                * self.size[axis]
                for axis in range(3)
            ]
        )


def firing_of(swim: Segments, robot: Robot) -> FloatArray:
    """(m, limbs) 1 where a limb fires in a period."""
    found = np.zeros((len(swim.start_s), len(robot.limbs)))
    for time_s, limb in swim.strokes:
        found[(swim.start_s - 1e-6 <= time_s) & (time_s < swim.end_s - 1e-6), limb] = 1.0
    return found


def follow_offsets(shown: FloatArray, firing: FloatArray, wander: float, cut: float) -> FloatArray:
    """(m,) what is expected of each period from those before it.

    Args:
        shown: (m,) what each period missed, in units of the misses' size; NaN where nobody saw.
        firing: (m, limbs).
        wander: variance that each limb's offset gains in a period; 0 = offsets stay at 0.
        cut: how much of an innovation counts at most.
    """
    expected = np.zeros(len(shown))
    if not wander:
        return expected
    limbs = firing.shape[1]
    offset, covariance = np.zeros(limbs), FIRST * np.eye(limbs)
    for period, (seen, fires) in enumerate(zip(shown, firing, strict=True)):
        covariance += wander * np.eye(limbs)
        expected[period] = fires @ offset
        if not np.isfinite(seen):
            continue
        gain = covariance @ fires / (fires @ covariance @ fires + 1.0)
        offset = offset + gain * np.clip(seen - expected[period], -cut, cut)
        covariance = covariance - np.outer(gain, fires @ covariance)
    return expected


def _moved(track: Track, offsets: FloatArray) -> FloatArray:
    """(m, 3) predictions with offsets given by the pose at each period's start."""
    c, s = np.cos(track.start[:, 2]), np.sin(track.start[:, 2])
    forward, left, turn = offsets.T
    moved = np.column_stack([c * forward - s * left, s * forward + c * left, turn])
    return np.asarray(track.predicted + moved)


def drift_of(tracks: Sequence[Track], swims: Sequence[Segments], robot: Robot) -> Drift | None:
    """How limbs drift in the training runs; None where following that gains next to nothing there."""
    missed = [_end_misses(track, swim) for track, swim in zip(tracks, swims, strict=True)]
    shown = [track.missed[:, -3:] for track in tracks]
    firing = [firing_of(swim, robot) for swim in swims]
    every = np.concatenate(missed)
    known = np.isfinite(every).all(axis=1)
    if not known.any():
        return None
    size = np.sqrt((every[known] ** 2).mean(axis=0))
    wander, cuts = [0.0, 0.0, 0.0], [CUT[-1]] * 3
    for axis in range(3):
        plain = _square(missed, axis, [np.zeros(len(each)) for each in missed])
        best = plain * float(np.exp(-GAIN_LEAST / known.sum()))
        for way in WANDERS:
            for cut in CUT:
                expected = [
                    size[axis] * follow_offsets(seen[:, axis] / size[axis], fires, way, cut)
                    for seen, fires in zip(shown, firing, strict=True)
                ]
                left = _square(missed, axis, expected)
                if left < best:
                    wander[axis], cuts[axis], best = way, cut, left
    if not any(wander):
        return None
    sizes = (float(size[0]), float(size[1]), float(size[2]))
    return Drift(sizes, (wander[0], wander[1], wander[2]), (cuts[0], cuts[1], cuts[2]))


def _square(missed: Sequence[FloatArray], axis: int, expected: Sequence[FloatArray]) -> float:
    gaps = [each[:, axis] - told for each, told in zip(missed, expected, strict=True)]
    return float(np.nansum(np.concatenate(gaps) ** 2))


def _end_misses(track: Track, swim: Segments) -> FloatArray:
    """(m, 3) measured minus predicted pose at each period's end: forward, left (m), heading (rad)."""
    gap = swim.measured - track.predicted
    c, s = np.cos(track.start[:, 2]), np.sin(track.start[:, 2])
    turn = np.arctan2(np.sin(gap[:, 2]), np.cos(gap[:, 2]))
    ends = [c * gap[:, 0] + s * gap[:, 1], c * gap[:, 1] - s * gap[:, 0], turn]
    return np.asarray(np.column_stack(ends), dtype=np.float64)
