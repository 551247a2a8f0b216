"""Measured swims with one drag of the water for all robots, while alloys and builds differ.

A speed is V(water, amplitude and time scale of its alloy's profile) times its build's offset, plus noise. The
water's numbers are shared. Each alloy has an amplitude and a time scale, because a profile is the mean of
four samples that was taken under the water's load. Each series of swims has an offset: it is another build.
These have priors, so an alloy or a build of which no swim is known is integrated over. A fit is the most
likely point by Gauss-Newton, and its intervals are those of the linearised model.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Bool, Float64
from frogkick.core.errors import InputError
from frogkick.effects.swims import Gait
from frogkick.validation.validate import root_mean_square
from frogkick_studies.steady import Free, Simulation, Table, tables_of

AMPLITUDE = Free("limb_wear", "gain", 0.15)
TIME_SCALE = Free("limb_wear", "duration_scale", 0.25)
"""Of an alloy's profile. The recorded robot's four limbs, of one alloy, scatter by 0.15 in their gain."""

OFFSET_SD = 0.1
"""Of the logarithm of a build's offset: the mean of four limbs that scatter so, and its hull."""

NOISE_MPS = 0.004
"""Standard deviation of one measured speed: neighbouring frequencies of one series scatter so."""

STEP = 0.15  # of a finite difference, in widths: limbs that ring make speeds rough over less
STEPS, HALVINGS = 3, 3  # of Gauss-Newton
Z90 = 1.645


@dataclass(frozen=True)
class Estimate:
    """Most likely values, in widths from nominal, and their covariance."""

    at: Float64
    covariance: Float64


class Speeds:
    """Speeds of swims over a vector of unknowns, in widths of their priors.

    The vector holds the shared numbers of the water, two numbers of each alloy (AMPLITUDE, TIME_SCALE), and
    the offset of each build.
    """

    def __init__(
        self,
        simulation: Simulation,
        water: tuple[Sequence[Free], Sequence[Table]],
        gaits: Sequence[Gait],
        builds: Sequence[str],
    ) -> None:
        (self.shared, self.given), self.simulation, self.gaits = water, simulation, list(gaits)
        self.alloys = sorted({gait.egain_percent for gait in gaits})
        self.builds = sorted(set(builds))
        self.alloy = np.array([self.alloys.index(gait.egain_percent) for gait in gaits])
        self.build = np.array([self.builds.index(build) for build in builds])
        self.first_build = len(self.shared) + 2 * len(self.alloys)
        self.size = self.first_build + len(self.builds)
        self.expected = np.zeros(self.size)
        self.expected[: len(self.shared)] = [free.expected for free in self.shared]
        frees = [*self.shared, *[AMPLITUDE, TIME_SCALE] * len(self.alloys)]
        reach = [free.bounds for free in frees] + [(-3.0, 3.0)] * len(self.builds)
        self.low, self.high = np.array(reach).T

    def only(self, chosen: Bool) -> Speeds:
        """Return the same of some swims: with the same columns."""
        other = copy.copy(self)
        other.gaits = [gait for gait, own in zip(self.gaits, chosen, strict=True) if own]
        other.alloy, other.build = self.alloy[chosen], self.build[chosen]
        return other

    def tables(self, at: Float64, alloy: int) -> tuple[Table, ...]:
        """Return the effects of swims of one alloy."""
        first = len(self.shared) + 2 * alloy
        frees = [*self.shared, AMPLITUDE, TIME_SCALE]
        widths = [*at[: len(self.shared)], *at[first : first + 2]]
        return (*self.given, *tables_of({f: f.value(float(w)) for f, w in zip(frees, widths, strict=True)}))

    def of(self, points: Sequence[Float64]) -> Float64:
        """Return (points, swims) speeds, m/s."""
        found = np.empty((len(points), len(self.gaits)))
        for alloy in range(len(self.alloys)):
            own = np.flatnonzero(self.alloy == alloy)
            if not len(own):
                continue
            effects = [self.tables(at, alloy) for at in points]
            found[:, own] = self.simulation.speeds(effects, [self.gaits[k] for k in own])
        if not np.isfinite(found).all():
            raise InputError("a measured swim cannot be simulated with some drag of its prior")
        offsets = np.array([at[self.first_build :][self.build] for at in points])
        return np.asarray(found * np.exp(OFFSET_SD * offsets))

    def linearised(self, at: Float64) -> tuple[Float64, Float64]:
        """Return (swims,) speeds and their (swims, size) derivatives by widths."""
        moves = []
        for k in range(self.size):
            move = np.zeros(self.size)
            move[k] = STEP if at[k] + STEP <= self.high[k] else -STEP
            moves.append(move)
        base, *moved = self.of([at, *(at + move for move in moves)])
        columns = [(m - base) / move.sum() for m, move in zip(moved, moves, strict=True)]
        return base, np.column_stack(columns)

    def posterior(
        self, base: Float64, columns: Float64, at: Float64, measured: Float64, also: Estimate | None
    ) -> Estimate:
        """Return the most likely point if speeds were linear, within bounds, and its covariance.

        Args:
            base, columns, at: (swims,) speeds, derivatives and the point of linearisation; of some swims.
            measured: (swims,) m/s.
            also: what else is known of the shared numbers.
        """
        precision, pull = np.eye(self.size), self.expected.copy()
        if also is not None:
            known, own = np.linalg.inv(also.covariance), slice(0, len(self.shared))
            precision[own, own] += known
            pull[own] += known @ also.at
        normal = columns.T @ columns / NOISE_MPS**2 + precision
        right = columns.T @ (measured - base + columns @ at) / NOISE_MPS**2 + pull
        found = np.clip(np.linalg.solve(normal, right), self.low, self.high)
        return Estimate(found, np.asarray(np.linalg.inv(normal), dtype=np.float64))

    def cost(self, at: Float64, speeds: Float64, measured: Float64, also: Estimate | None) -> float:
        """Return minus twice the log of the posterior density, but for a constant."""
        away, errors = at - self.expected, (speeds - measured) / NOISE_MPS
        found = float(away @ away + errors @ errors)
        if also is not None:
            gap = at[: len(self.shared)] - also.at
            found += float(gap @ np.linalg.solve(also.covariance, gap))
        return found

    def fitted(
        self, measured: Float64, also: Estimate | None = None, begin: Float64 | None = None
    ) -> tuple[Estimate, Float64, Float64]:
        """Fit to all swims, from what is expected by default; return also speeds and derivatives there."""
        at = np.clip(self.expected if begin is None else begin, self.low, self.high)
        base, columns = self.linearised(at)
        for _ in range(STEPS):
            aim = self.posterior(base, columns, at, measured, also).at
            now = self.cost(at, base, measured, also)
            for k in range(HALVINGS):
                tried = at + 0.5**k * (aim - at)
                (speeds,) = self.of([tried])
                if (gain := now - self.cost(tried, speeds, measured, also)) > 0.0:
                    at = tried
                    base, columns = self.linearised(at)
                    break
            if gain < 1.0:
                break
        covariance = self.posterior(base, columns, at, measured, also).covariance
        return Estimate(at, covariance), base, columns

    def integrated(
        self, estimate: Estimate, columns: Float64, unknown: bool = True
    ) -> tuple[Float64, Float64]:
        """Return (swims,) mean speeds over the estimate's uncertainty, m/s, and standard deviations.

        Amplitude and time scale of an unknown alloy change speeds by curves: their means are taken over three
        points of each (Gauss and Hermite). The rest is linear.

        Args:
            unknown: whether no swim of the alloys is known.
        """
        at, reach = estimate.at, math.sqrt(3.0)
        (base,) = self.of([at])
        mean = base.copy()
        for kind in range(2) if unknown else ():
            ends = []
            for sign in (1.0, -1.0):
                moved = at.copy()
                for alloy in range(len(self.alloys)):
                    k = len(self.shared) + 2 * alloy + kind
                    moved[k] += sign * reach * math.sqrt(estimate.covariance[k, k])
                ends.append(moved)
            mean += (self.of(ends).sum(axis=0) - 2.0 * base) / 6.0
        variance = np.einsum("nk,kl,nl->n", columns, estimate.covariance, columns)
        return mean, np.sqrt(np.maximum(variance, 0.0))


@dataclass(frozen=True)
class LeftOut:
    """Groups that the fit did not know, for one way of grouping."""

    rmse_mps: float
    inside: float  # share of these swims within the interval of 90 %
    by_group: Mapping[str, float]  # RMSE of each group, m/s


@dataclass(frozen=True)
class Interval:
    """Speed of a gait of an alloy of which no swim is known, with the interval of 90 % of one swim."""

    egain_percent: float
    frequency_hz: float
    mean_mps: float
    low_mps: float
    high_mps: float


@dataclass(frozen=True)
class SwimsFit:
    """One drag fitted to all swims.

    Attributes:
        values: number -> value, low and high end of its interval of 90 %.
        rmse_mps: of all swims by the fit to all.
        left_out: way of grouping -> what the fits to the others predict.
    """

    values: Mapping[str, tuple[float, float, float]]
    rmse_mps: float
    left_out: Mapping[str, LeftOut]


def fit_swims(
    speeds: Speeds,
    measured: Float64,
    ways: Mapping[str, Sequence[str]],
    also: Estimate | None = None,
    begin: Float64 | None = None,
) -> tuple[SwimsFit, Estimate]:
    """Fit one drag to all swims, and to all but each group, one Gauss-Newton step away.

    Args:
        speeds: of all swims.
        measured: (swims,) m/s.
        ways: way of grouping -> group of each swim.
        also: what else is known of the shared numbers.
        begin: where to start.
    """
    estimate, base, columns = speeds.fitted(measured, also, begin)
    left = {}
    for way, label in ways.items():
        groups, means, sds = np.array(label), np.empty(len(measured)), np.empty(len(measured))
        for group in sorted(set(label)):
            out = groups == group
            without = speeds.posterior(base[~out], columns[~out], estimate.at, measured[~out], also)
            own = speeds.only(out)
            gone = not set(own.alloy.tolist()) <= set(speeds.alloy[~out].tolist())
            means[out], sd = own.integrated(without, columns[out], gone)
            sds[out] = np.hypot(sd, NOISE_MPS)
        errors = means - measured
        left[way] = LeftOut(
            root_mean_square(errors.tolist()),
            float((np.abs(errors) < Z90 * sds).mean()),
            {group: root_mean_square(errors[groups == group].tolist()) for group in sorted(set(label))},
        )
    values = {}
    sd = np.sqrt(np.diag(estimate.covariance))
    named = [(free.name, free) for free in speeds.shared]
    named += [
        (f"{alloy:g} % EGaIn {free.parameter}", free)
        for alloy in speeds.alloys
        for free in (AMPLITUDE, TIME_SCALE)
    ]
    for k, (name, free) in enumerate(named):
        at = float(estimate.at[k])
        ends = (at, at - Z90 * float(sd[k]), at + Z90 * float(sd[k]))
        values[name] = (free.value(ends[0]), free.value(ends[1]), free.value(ends[2]))
    for k, build in enumerate(speeds.builds, speeds.first_build):
        at, wide = float(estimate.at[k]), Z90 * float(sd[k])
        low, mid, high = (math.exp(OFFSET_SD * x) for x in (at - wide, at, at + wide))
        values[f"{build} offset"] = (mid, low, high)
    return SwimsFit(values, root_mean_square((base - measured).tolist()), left), estimate


def unseen(speeds: Speeds, estimate: Estimate, gaits: Sequence[Gait]) -> list[Interval]:
    """Predict gaits of alloys and builds of which no swim is known."""
    shared = len(speeds.shared)
    other = Speeds(
        speeds.simulation,
        (speeds.shared, speeds.given),
        gaits,
        [f"of {gait.egain_percent:g} %" for gait in gaits],
    )
    covariance = np.eye(other.size)
    covariance[:shared, :shared] = estimate.covariance[:shared, :shared]
    at = np.zeros(other.size)
    at[:shared] = estimate.at[:shared]
    _, columns = other.linearised(at)
    mean, sd = other.integrated(Estimate(at, covariance), columns)
    wide = Z90 * np.hypot(sd, NOISE_MPS)
    return [
        Interval(g.egain_percent, g.frequency_hz, float(m), float(m - w), float(m + w))
        for g, m, w in zip(gaits, mean, wide, strict=True)
    ]
