"""How far a simulation is off the fixes, over time: an error-state Kalman filter.

Each coordinate (x, y, heading; world frame) has a filter of its own:

- state: the error of the simulated trajectory and the rate of that error;
- F: the error grows by its rate (constant velocity);
- Q: white acceleration, of one density at any time and of a further one while limbs straighten;
- H: a fix minus the simulated pose measures the error;
- R: the variance of a fix.

The noise is fitted to runs by maximum likelihood, with the Huber loss in place of the square (Huber 1964).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.compiled import cached_njit

HUBER_SIGMA = 5.0  # threshold of the Huber loss of innovations, in standard deviations

INITIAL_RATE_STD = (0.02, 0.02, 0.3)
"""Initial standard deviation of the rate's error: m/s, m/s, rad/s. It is less for a robot that was seen at
rest."""

INITIAL_RATE_STD_MIN = (2e-4, 2e-4, 2e-3)  # its lower bound


@dataclass(frozen=True)
class Noise:
    """Measurement noise and process noise. Pairs are for x and y, and for the heading."""

    fix: tuple[float, float] = (0.3e-3, 0.005)  # standard deviation of a fix: m, rad
    # root of the density of the white acceleration at any time: m/s, rad/s per root second
    idle: tuple[float, float] = (1e-3, 0.03)
    actuated: tuple[float, float] = (5e-3, 0.2)  # the same, in addition, while limbs straighten

    def per_axis(self) -> tuple[Float64, Float64, Float64]:
        """(3,) squares of each, for x, y and heading."""
        # Each is contiguous: numba compiles again for strided arrays.
        fix, idle, actuated = (np.square(pair)[[0, 0, 1]] for pair in (self.fix, self.idle, self.actuated))
        return fix, idle, actuated


def initial_rate_std(rest_rate: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """Initial standard deviation of the rate's error of a run; see ``Segments.rest_rate``."""
    if rest_rate is None:
        return INITIAL_RATE_STD
    x, y, turn = np.clip(rest_rate, INITIAL_RATE_STD_MIN, INITIAL_RATE_STD).tolist()
    return x, y, turn


@dataclass
class Filter:
    """Error-state Kalman filter of one lane."""

    noise: Noise
    actuated_s: Float64  # (2, k) knots: time, and cumulative actuation time by then
    time_s: float  # of the state
    # initial, of the rate (m/s, m/s, rad/s); see ``initial_rate_std``
    rate_std: tuple[float, float, float] = INITIAL_RATE_STD
    error: Float64 = field(default_factory=lambda: np.zeros((3, 2)))  # (3, 2) offset and rate
    # (3, 3) offset's variance, covariance, rate's variance of each axis
    covariance: Float64 = field(init=False)

    def __post_init__(self) -> None:
        self._fix, self._idle, self._actuated = self.noise.per_axis()
        self.covariance = np.column_stack([4.0 * self._fix, np.zeros(3), np.square(np.array(self.rate_std))])

    def update(self, time_s: float, difference: Float64) -> tuple[Float64, Float64]:
        """Update by a fix: (3,) fix minus simulation. Return innovation and its variance, (3,) each."""
        innovation, variance = self.update_all(np.array([time_s]), difference[None, :])
        return innovation[0], variance[0]

    def update_all(self, times_s: Float64, differences: Float64) -> tuple[Float64, Float64]:
        """Update by fixes in order: (n,) times, (n, 3) differences; see ``update``."""
        innovations, variances = np.empty_like(differences), np.empty_like(differences)
        self.time_s = _update_all(
            self.error,
            self.covariance,
            self.time_s,
            times_s,
            differences,
            self.actuated_s,
            (self._fix, self._idle, self._actuated),
            innovations,
            variances,
        )
        return innovations, variances

    def reset(self, time_s: float) -> tuple[Float64, Float64]:
        """Return the error at a time, (3,) offset and (3,) rate, and reset it to zero."""
        offset = self.error[:, 0] + (time_s - self.time_s) * self.error[:, 1]
        rate = self.error[:, 1].copy()
        self.error[:] = 0.0
        return offset, rate


@cached_njit()
def _predict_to(
    error: Float64,
    covariance: Float64,
    now_s: float,
    time_s: float,
    actuated_s: Float64,
    idle: Float64,
    actuated: Float64,
) -> float:
    dt = time_s - now_s
    if dt <= 0.0:
        return now_s
    actuation = np.interp(time_s, actuated_s[0], actuated_s[1]) - np.interp(
        now_s, actuated_s[0], actuated_s[1]
    )
    for axis in range(3):
        drive = idle[axis] + actuated[axis] * actuation / dt
        error[axis, 0] += dt * error[axis, 1]
        p = covariance[axis]
        p[0] += dt * (2.0 * p[1] + dt * p[2]) + drive * dt**3 / 3.0
        p[1] += dt * p[2] + drive * dt**2 / 2.0
        p[2] += drive * dt
    return time_s


@cached_njit()
def _update_all(
    error: Float64,
    covariance: Float64,
    now_s: float,
    times_s: Float64,
    differences: Float64,
    actuated_s: Float64,
    noise: tuple[Float64, Float64, Float64],
    innovations: Float64,
    variances: Float64,
) -> float:
    fix, idle, actuated = noise
    for row in range(len(times_s)):
        now_s = _predict_to(error, covariance, now_s, times_s[row], actuated_s, idle, actuated)
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
    """One coordinate of one lane: fix minus a simulation that was never corrected."""

    time_s: Float64  # (n,) not decreasing
    actuated_s: Float64  # (n,) cumulative actuation time by then
    difference: Float64  # (n,)
    rate_std: float  # initial, of the rate


def deviances(series: Series, fix_std: Float64, idle_std: Float64, actuated_std: Float64) -> Float64:
    """(k,) deviance (minus twice the log likelihood, Huber loss) of a series, for k noises at once."""
    dts = np.diff(series.time_s, prepend=series.time_s[:1])
    actuation = np.diff(series.actuated_s, prepend=series.actuated_s[:1])
    noises = np.square(np.column_stack([fix_std, idle_std, actuated_std]))
    return np.asarray(_deviances(dts, actuation, series.difference, series.rate_std**2, noises))


@cached_njit()
def _deviances(
    dts: Float64, actuation: Float64, differences: Float64, rate: float, noises: Float64
) -> Float64:
    totals = np.zeros(len(noises))
    for k in range(len(noises)):
        fix, idle, actuated = noises[k]
        offset, speed, total = 0.0, 0.0, 0.0
        p0, p1, p2 = 4.0 * fix, 0.0, rate
        for row in range(len(dts)):
            dt = dts[row]
            if dt > 0.0:
                drive = idle + actuated * (actuation[row] / dt)
                offset += dt * speed
                p0 += dt * (2.0 * p1 + dt * p2) + drive * (dt**3 / 3.0)
                p1 += dt * p2 + drive * (dt**2 / 2.0)
                p2 += drive * dt
            innovation = differences[row] - offset
            variance = p0 + fix
            deviation = np.sqrt(variance)
            size = abs(innovation) / deviation
            total += (size**2 if size < HUBER_SIGMA else HUBER_SIGMA * (2.0 * size - HUBER_SIGMA)) + np.log(
                variance
            )
            used = min(max(innovation, -HUBER_SIGMA * deviation), HUBER_SIGMA * deviation)
            gain0, gain1 = p0 / variance, p1 / variance
            offset, speed = offset + gain0 * used, speed + gain1 * used
            p2 -= gain1 * p1
            p1, p0 = p1 * (1.0 - gain0), p0 * (1.0 - gain0)
        totals[k] = total
    return totals


NOISE_BOUNDS = (
    ((5e-5, 2e-5, 2e-5), (5e-3, 2e-2, 5e-2)),  # x, y: least and largest of fix, idle, actuated
    ((5e-4, 5e-4, 5e-4), (5e-2, 1.0, 3.0)),  # heading
)


def maximum_likelihood_noise(series: Sequence[Sequence[Series]]) -> Noise:
    """Maximum-likelihood noise, to about 10 % of each number, by a grid that shrinks.

    ``series`` are those of x, y and heading of each lane.
    """
    found = []
    for group, axes in enumerate(((0, 1), (2,))):
        low, high = np.log(np.array(NOISE_BOUNDS[group]))
        centre, reach = (low + high) / 2.0, (high - low) / 2.0
        for _ in range(5):
            grid = np.array(list(itertools.product((-1.0, -0.5, 0.0, 0.5, 1.0), repeat=3)))
            points = np.clip(centre + grid * reach, low, high)
            total = np.zeros(len(points))
            for lane in series:
                for axis in axes:
                    total += deviances(lane[axis], *np.exp(points).T)
            centre, reach = points[int(total.argmin())], reach * 0.5
        found.append(np.exp(centre))
    pairs = [(float(found[0][k]), float(found[1][k])) for k in range(3)]
    return Noise(*pairs)
