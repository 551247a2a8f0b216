"""How far a simulation is off the fixes, followed in time: offset and rate of x, y and heading.

Each coordinate has a Kalman filter of its own whose state is the error of the simulated trajectory and that
error's rate, both in the world frame. What the model gets wrong enters as white acceleration.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CUT = 5.0
"""Innovations count as they are up to so many standard deviations."""

RATE_STD = (0.02, 0.02, 0.3)
"""What the rate's error may be at first: m/s, m/s, rad/s."""


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


@dataclass
class Filter:
    """Error of one lane.

    Attributes:
        busy_s: (2, k) knots of time and of how long limbs had been straightening by then.
        time_s: of the state.
        error: (3, 2) offset and rate.
        covariance: (3, 3) offset's variance, covariance, rate's variance of each axis.
    """

    noise: Noise
    busy_s: FloatArray
    time_s: float
    error: FloatArray = field(default_factory=lambda: np.zeros((3, 2)))
    covariance: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self._fix, self._calm, self._kick = self.noise.per_axis()
        self.covariance = np.column_stack([4.0 * self._fix, np.zeros(3), np.square(np.array(RATE_STD))])

    def go_to(self, time_s: float) -> None:
        """Let time pass; never backwards."""
        dt = time_s - self.time_s
        if dt <= 0.0:
            return
        busy = np.interp((self.time_s, time_s), self.busy_s[0], self.busy_s[1])
        drive = self._calm + self._kick * (busy[1] - busy[0]) / dt
        self.time_s = time_s
        self.error[:, 0] += dt * self.error[:, 1]
        p = self.covariance
        p[:, 0] += dt * (2.0 * p[:, 1] + dt * p[:, 2]) + drive * dt**3 / 3.0
        p[:, 1] += dt * p[:, 2] + drive * dt**2 / 2.0
        p[:, 2] += drive * dt

    def take(self, time_s: float, difference: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take a fix in: (3,) fix minus simulation. Return innovation and its variance, (3,) each."""
        self.go_to(time_s)
        p = self.covariance
        innovation = difference - self.error[:, 0]
        variance = p[:, 0] + self._fix
        gain0, gain1 = p[:, 0] / variance, p[:, 1] / variance
        self.error[:, 0] += gain0 * innovation
        self.error[:, 1] += gain1 * innovation
        p[:, 2] -= gain1 * p[:, 1]
        p[:, 1] *= 1.0 - gain0
        p[:, 0] *= 1.0 - gain0
        return innovation, variance

    def correct(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Take the error out as of a time: (3,) offset and (3,) rate there, which are zero from now on."""
        offset = self.error[:, 0] + (time_s - self.time_s) * self.error[:, 1]
        rate = self.error[:, 1].copy()
        self.error[:] = 0.0
        return offset, rate


def cost_of(size: FloatArray) -> FloatArray:
    """Squares of innovations over their deviations; of wild ones no more than in proportion."""
    size = np.abs(size)
    return np.where(size < CUT, size**2, CUT * (2.0 * size - CUT))


@dataclass(frozen=True, eq=False)
class Series:
    """One coordinate of one lane: fix minus one unbroken simulation.

    Attributes:
        time_s: (n,) not decreasing.
        busy_s: (n,) how long limbs had been straightening by then.
        difference: (n,).
        rate_std: of the rate at the start.
    """

    time_s: FloatArray
    busy_s: FloatArray
    difference: FloatArray
    rate_std: float


def surprise(series: Series, fix_std: FloatArray, calm_std: FloatArray, kick_std: FloatArray) -> FloatArray:
    """(k,) minus twice the log likelihood of a series, for k noises at once."""
    fix, calm, kick = np.square(fix_std), np.square(calm_std), np.square(kick_std)
    offset, rate, total = np.zeros_like(fix), np.zeros_like(fix), np.zeros_like(fix)
    p0, p1, p2 = 4.0 * fix, np.zeros_like(fix), np.full_like(fix, series.rate_std**2)
    dts = np.diff(series.time_s, prepend=series.time_s[:1])
    busy = np.diff(series.busy_s, prepend=series.busy_s[:1])
    for dt, share, value in zip(dts.tolist(), busy.tolist(), series.difference.tolist(), strict=True):
        if dt > 0.0:
            drive = calm + kick * (share / dt)
            offset = offset + dt * rate
            p0 = p0 + dt * (2.0 * p1 + dt * p2) + drive * (dt**3 / 3.0)
            p1 = p1 + dt * p2 + drive * (dt**2 / 2.0)
            p2 = p2 + drive * dt
        innovation = value - offset
        variance = p0 + fix
        deviation = np.sqrt(variance)
        size = innovation / deviation
        total += cost_of(size) + np.log(variance)
        used = np.minimum(np.maximum(size, -CUT), CUT) * deviation
        gain0, gain1 = p0 / variance, p1 / variance
        offset, rate = offset + gain0 * used, rate + gain1 * used
        p2 = p2 - gain1 * p1
        p1, p0 = p1 * (1.0 - gain0), p0 * (1.0 - gain0)
    return total


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
