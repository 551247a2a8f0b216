"""How far a simulation is off the fixes, followed in time: offset and rate of x, y and heading.

Each coordinate has a Kalman filter of its own whose state is the error of the simulated trajectory and that
error's rate, both in the world frame. What the model gets wrong enters as white acceleration.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CUT = 5.0
"""Innovations count as they are up to so many standard deviations."""

RATE_STD = (0.02, 0.02, 0.3)
"""What the rate's error may be at first: m/s, m/s, rad/s. A robot that was seen at rest moves less."""

REST_LEAST = (2e-4, 2e-4, 2e-3)
"""And is not known to move less than this."""


@dataclass(frozen=True)
class Noise:
    """What makes fixes and simulation differ. Pairs are for x and y, and for the heading.

    Attributes:
        fix: standard deviation of a fix: m, rad.
        calm: density of the white acceleration at any time: m/s, rad/s for each root of a second.
        kick: what is added to it while limbs straighten.
    """

    fix: tuple[float, float] = (0.3e-3, 0.005)
    calm: tuple[float, float] = (1e-3, 0.03)
    kick: tuple[float, float] = (5e-3, 0.2)

    def per_axis(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(3,) squares of each, for x, y and heading."""
        axes = [0, 0, 1]
        return (
            np.square(np.array(self.fix)[axes]),
            np.square(np.array(self.calm)[axes]),
            np.square(np.array(self.kick)[axes]),
        )


def first_rate_std(rest_rate: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """What the rate's error may be where a run begins.

    Args:
        rest_rate: how fast the robot moved at rest (see Segments.rest_rate), where that is known.
    """
    if rest_rate is None:
        return RATE_STD
    x, y, turn = np.clip(rest_rate, REST_LEAST, RATE_STD).tolist()
    return x, y, turn


@dataclass
class Filter:
    """Error of one lane.

    Attributes:
        actuated_s: (2, k) knots of time and of how long limbs had been straightening by then.
        time_s: of the state.
        rate_std: of the rate at first, (m/s, m/s, rad/s); see ``first_rate_std``.
        error: (3, 2) offset and rate.
        covariance: (3, 3) offset's variance, covariance, rate's variance of each axis.
    """

    noise: Noise
    actuated_s: FloatArray
    time_s: float
    rate_std: tuple[float, float, float] = RATE_STD
    error: FloatArray = field(default_factory=lambda: np.zeros((3, 2)))
    covariance: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self._fix, self._calm, self._kick = self.noise.per_axis()
        self.covariance = np.column_stack([4.0 * self._fix, np.zeros(3), np.square(np.array(self.rate_std))])

    def go_to(self, time_s: float) -> None:
        """Let time pass; never backwards."""
        self.time_s = _go_to(
            self.error, self.covariance, self.time_s, time_s, self.actuated_s, self._calm, self._kick
        )

    def take(self, time_s: float, difference: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take a fix in: (3,) fix minus simulation. Return innovation and its variance, (3,) each."""
        innovation, variance = self.take_all(np.array([time_s]), difference[None, :])
        return innovation[0], variance[0]

    def take_all(self, times_s: FloatArray, differences: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take fixes in, in order: (n,) times, (n, 3) differences; see ``take``."""
        innovations, variances = np.empty_like(differences), np.empty_like(differences)
        self.time_s = _take_all(
            self.error,
            self.covariance,
            self.time_s,
            times_s,
            differences,
            self.actuated_s,
            (self._fix, self._calm, self._kick),
            innovations,
            variances,
        )
        return innovations, variances

    def correct(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Take the error out as of a time: (3,) offset and (3,) rate there, which are zero from now on."""
        offset = self.error[:, 0] + (time_s - self.time_s) * self.error[:, 1]
        rate = self.error[:, 1].copy()
        self.error[:] = 0.0
        return offset, rate


@njit(cache=True)
def _go_to(
    error: FloatArray,
    covariance: FloatArray,
    now_s: float,
    time_s: float,
    actuated_s: FloatArray,
    calm: FloatArray,
    kick: FloatArray,
) -> float:
    dt = time_s - now_s
    if dt <= 0.0:
        return now_s
    busy = np.interp(time_s, actuated_s[0], actuated_s[1]) - np.interp(now_s, actuated_s[0], actuated_s[1])
    for axis in range(3):
        drive = calm[axis] + kick[axis] * busy / dt
        error[axis, 0] += dt * error[axis, 1]
        p = covariance[axis]
        p[0] += dt * (2.0 * p[1] + dt * p[2]) + drive * dt**3 / 3.0
        p[1] += dt * p[2] + drive * dt**2 / 2.0
        p[2] += drive * dt
    return time_s


@njit(cache=True)
def _take_all(
    error: FloatArray,
    covariance: FloatArray,
    now_s: float,
    times_s: FloatArray,
    differences: FloatArray,
    actuated_s: FloatArray,
    noise: tuple[FloatArray, FloatArray, FloatArray],
    innovations: FloatArray,
    variances: FloatArray,
) -> float:
    fix, calm, kick = noise
    for row in range(len(times_s)):
        now_s = _go_to(error, covariance, now_s, times_s[row], actuated_s, calm, kick)
        for axis in range(3):
            p = covariance[axis]
            innovation = differences[row, axis] - error[axis, 0]
            variance = p[0] + fix[axis]
            gain0, gain1 = p[0] / variance, p[1] / variance
            error[axis, 0] += gain0 * innovation
            error[axis, 1] += gain1 * innovation
            p[2] -= gain1 * p[1]
            p[1] *= 1.0 - gain0
            p[0] *= 1.0 - gain0
            innovations[row, axis], variances[row, axis] = innovation, variance
    return now_s


@dataclass(frozen=True, eq=False)
class Series:
    """One coordinate of one lane: fix minus one unbroken simulation.

    Attributes:
        time_s: (n,) not decreasing.
        actuated_s: (n,) how long limbs had been straightening by then.
        difference: (n,).
        rate_std: of the rate at the start.
    """

    time_s: FloatArray
    actuated_s: FloatArray
    difference: FloatArray
    rate_std: float


def surprise(series: Series, fix_std: FloatArray, calm_std: FloatArray, kick_std: FloatArray) -> FloatArray:
    """(k,) minus twice the log likelihood of a series, for k noises at once."""
    dts = np.diff(series.time_s, prepend=series.time_s[:1])
    busy = np.diff(series.actuated_s, prepend=series.actuated_s[:1])
    noises = np.square(np.column_stack([fix_std, calm_std, kick_std]))
    return np.asarray(_surprise(dts, busy, series.difference, series.rate_std**2, noises))


@njit(cache=True)
def _surprise(
    dts: FloatArray, busy: FloatArray, differences: FloatArray, rate: float, noises: FloatArray
) -> FloatArray:
    totals = np.zeros(len(noises))
    for k in range(len(noises)):
        fix, calm, kick = noises[k]
        offset, speed, total = 0.0, 0.0, 0.0
        p0, p1, p2 = 4.0 * fix, 0.0, rate
        for row in range(len(dts)):
            dt = dts[row]
            if dt > 0.0:
                drive = calm + kick * (busy[row] / dt)
                offset += dt * speed
                p0 += dt * (2.0 * p1 + dt * p2) + drive * (dt**3 / 3.0)
                p1 += dt * p2 + drive * (dt**2 / 2.0)
                p2 += drive * dt
            innovation = differences[row] - offset
            variance = p0 + fix
            deviation = np.sqrt(variance)
            size = abs(innovation) / deviation
            total += (size**2 if size < CUT else CUT * (2.0 * size - CUT)) + np.log(variance)
            used = min(max(innovation, -CUT * deviation), CUT * deviation)
            gain0, gain1 = p0 / variance, p1 / variance
            offset, speed = offset + gain0 * used, speed + gain1 * used
            p2 -= gain1 * p1
            p1, p0 = p1 * (1.0 - gain0), p0 * (1.0 - gain0)
        totals[k] = total
    return totals


LIMITS = (
    ((5e-5, 2e-5, 2e-5), (5e-3, 2e-2, 5e-2)),  # x, y: fix, calm, kick at least and at most
    ((5e-4, 5e-4, 5e-4), (5e-2, 1.0, 3.0)),  # heading
)


def likeliest(series: Sequence[Sequence[Series]]) -> Noise:
    """The noise under which differences are likeliest, to about 10 % of each number.

    Args:
        series: of each lane those of x, y and heading.
    """
    found = []
    for group, axes in enumerate(((0, 1), (2,))):
        low, high = np.log(np.array(LIMITS[group]))
        centre, reach = (low + high) / 2.0, (high - low) / 2.0
        for _ in range(5):
            grid = np.array(list(itertools.product((-1.0, -0.5, 0.0, 0.5, 1.0), repeat=3)))
            points = np.clip(centre + grid * reach, low, high)
            total = np.zeros(len(points))
            for lane in series:
                for axis in axes:
                    total += surprise(lane[axis], *np.exp(points).T)
            centre, reach = points[int(total.argmin())], reach * 0.5
        found.append(np.exp(centre))
    pairs = [(float(found[0][k]), float(found[1][k])) for k in range(3)]
    return Noise(*pairs)
