"""What a model still misses, in physical quantities: a wrench, strokes that failed, fixes that are off.

The missing wrench in each third of a period is a hidden state on which the residuals depend linearly. It is
estimated from all residuals of a run at once, as an Ornstein-Uhlenbeck process (a Gauss-Markov state; the
mean and covariance are those of a Kalman smoother). Its size and correlation are maximum-likelihood
estimates.

Source: Rauch, Tung, Striebel 1965 (smoother); Hartikainen, Sarkka 2010 (the same as Gaussian regression).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.core.poses import world_from_body
from frogkick.identification.filter import Filter, Noise, initial_rate_std
from frogkick.identification.fit import Fitted
from frogkick.identification.predict import PHASES
from frogkick.identification.responses import THIRDS, Responses, fired_strokes
from frogkick.identification.segments import Segments
from frogkick.identification.steps import log_density, scale_of

SIZES_N, ARMS_M, MEMORIES = (0.0, *np.geomspace(3e-5, 1e-2, 8)), (0.005, 0.02, 0.06), (0.0, 0.6, 0.9, 0.98)
"""Values that are tried: size of the wrench, its torque over its force, and its correlation from third to
third."""

STRETCH = 40
"""Number of periods that are estimated together; longer runs are cut."""

CLEAR = 0.25
"""A failed stroke clearly explains a residual if less than this share of its square remains."""

OUTLIER_SIGMA = 3.0
"""A fix is an outlier if its innovation exceeds this many standard deviations."""


@dataclass(frozen=True, eq=False)
class Missing:
    """The wrench that a model misses in k thirds of periods.

    Attributes:
        run: (k,) index of the run.
        time_s: (k,) middle of each third.
        heading: (k,) heading of the robot at that time, rad.
        wrench: (k, 3) missing force forward, left (N) and torque (N m); body frame.
        covariance: (k, 3, 3) covariance of the wrench.
    """

    run: Int64
    time_s: Float64
    heading: Float64
    wrench: Float64
    covariance: Float64

    def as_json(self, names: Sequence[str]) -> dict[str, Any]:
        """Wrench and covariance in the body frame, and the force in the pool's frame as well."""
        world = world_from_body(self.heading, self.wrench)
        return {
            "run": [names[k] for k in self.run.tolist()],
            "time_s": np.round(self.time_s, 4).tolist(),
            "forward_n": _short(self.wrench[:, 0]),
            "left_n": _short(self.wrench[:, 1]),
            "torque_nm": _short(self.wrench[:, 2]),
            "x_n": _short(world[:, 0]),
            "y_n": _short(world[:, 1]),
            "covariance": [_short(each) for each in self.covariance.reshape(-1, 9)],
        }


def _short(values: Float64) -> list[float]:
    return [float(f"{value:.4g}") for value in values]


def missing_wrench(fitted: Fitted, responses: Responses, swims: Sequence[Segments], rows: Bool) -> Missing:
    """Estimate the wrench that a model misses in each third of each period.

    Args:
        fitted: the model, with its residuals.
        responses: responses of the runs to a wrench.
        swims, rows: the runs, and which of their periods are used.
    """
    runs = np.repeat(np.arange(len(swims)), [len(swim.start_s) for swim in swims])[rows]
    noise = np.concatenate([_noise_of(fitted.model.noise, swim) for swim in swims])[rows]
    at_s, heading = np.asarray(responses.bodies["time_s"]), np.asarray(responses.bodies["heading_rad"])
    order = np.concatenate([np.arange(len(swim.start_s)) for swim in swims])[rows]
    parts = []
    stretch = np.unique(np.stack([runs, order // STRETCH]), axis=1, return_inverse=True)[1].ravel()
    for label in np.unique(stretch):
        mine = np.flatnonzero(stretch == label)
        thirds = (THIRDS * order[mine][:, None] + np.arange(THIRDS)).ravel()
        # A residual is fix minus prediction: what the missing wrench would add to the prediction.
        design = np.zeros((9 * len(mine), 9 * len(mine)))
        spread = np.zeros_like(design)
        for k, row in enumerate(mine):
            here = slice(9 * k, 9 * k + 9)
            design[here, here] = -responses.wrench[row].reshape(9, 9)
            spread[here, here] = noise[row]
        parts.append((design, spread, fitted.residuals[mine].ravel(), np.abs(thirds[:, None] - thirds)))

    def prior(gap: Float64, size: float, arm: float, memory: float) -> Float64:
        correlation = memory**gap if memory else (gap == 0).astype(np.float64)
        return np.kron(correlation, np.diag([size**2, size**2, (arm * size) ** 2]))

    best, shape = math.inf, (0.0, ARMS_M[0], 0.0)
    for tried in itertools.product(SIZES_N, ARMS_M, MEMORIES):
        total = 0.0
        for design, spread, left, gap in parts:
            root = np.linalg.cholesky(design @ prior(gap, *tried) @ design.T + spread)
            total += float((np.linalg.solve(root, left) ** 2).sum() + 2.0 * np.log(np.diag(root)).sum())
        if total < best:
            best, shape = total, tried
    wrenches, covariances = [], []
    for design, spread, left, gap in parts:
        before = prior(gap, *shape)
        gain = np.linalg.solve(design @ before @ design.T + spread, design @ before).T
        after = before - gain @ design @ before
        wrenches.append((gain @ left).reshape(-1, 3))
        own = [slice(3 * k, 3 * k + 3) for k in range(len(after) // 3)]
        covariances.append(np.array([after[each, each] for each in own]))
    every = np.concatenate(wrenches), np.concatenate(covariances)
    return Missing(np.repeat(runs, THIRDS), at_s.ravel(), heading.ravel(), *every)


def _noise_of(noise: Noise, swim: Segments) -> Float64:
    """(m, 9, 9) covariance of a run's residuals if no wrench is missing: from the fixes and each start."""
    state = Filter(noise, swim.actuated_s, swim.begin_s, initial_rate_std(swim.rest_rate))
    fix = noise.per_axis()[0]
    order, following = np.argsort(swim.arrival_s, kind="stable"), 0
    found = np.zeros((len(swim.start_s), 9, 9))
    for period, (start_s, end_s) in enumerate(zip(swim.start_s, swim.end_s, strict=True)):
        while following < len(order) and swim.arrival_s[order[following]] <= start_s:
            state.update(float(swim.time_s[order[following]]), np.zeros(3))
            following += 1
        ahead = float(start_s) - state.time_s
        p = state.covariance
        share = (swim.time_s - start_s) / (end_s - start_s)
        inside = [(low <= share) & (share < high) for low, high in PHASES]
        counts = [max(int(each.sum()), 1) for each in inside]
        middle = [float(end_s - start_s) * 0.5 * (low + high) + ahead for low, high in PHASES]
        for axis in range(3):
            for one, other in itertools.product(range(3), range(3)):
                value = p[axis, 0] + (middle[one] + middle[other]) * p[axis, 1]
                value += middle[one] * middle[other] * p[axis, 2]
                found[period, 3 * one + axis, 3 * other + axis] = value + fix[axis] / counts[one] * (
                    one == other
                )
    return found


def stroke_ratios(
    fitted: Fitted, responses: Responses, swims: Sequence[Segments], rows: Bool, limbs: Sequence[str]
) -> list[dict[str, Any]]:
    """Log likelihood ratio of fired to not fired for each stroke, with all others as commanded."""
    runs = np.repeat(np.arange(len(swims)), [len(swim.start_s) for swim in swims])[rows]
    times = np.concatenate([fired_strokes(swim, len(limbs)) for swim in swims])[rows]
    # The scale is estimated from the residuals of the hypothesis that is clearly better, if one is.
    plain = fitted.residuals[:, :, None]
    every = np.concatenate([plain, plain + responses.idle], axis=2)
    far = ((every / np.median(np.abs(fitted.residuals), axis=0)[:, None]) ** 2).sum(axis=1)
    best = np.where(far.min(axis=1) < CLEAR * far[:, 0], far.argmin(axis=1), 0)
    scale = scale_of(every[np.arange(len(best)), :, best])
    fires = log_density(fitted.residuals, scale)
    found = []
    for limb, name in enumerate(limbs):
        ratio = fires - log_density(fitted.residuals + responses.idle[:, :, limb], scale)
        for run, time_s, value in zip(runs, times[:, limb], ratio.tolist(), strict=True):
            if math.isfinite(time_s):
                where = {"run": swims[run].name, "time_s": round(float(time_s), 4), "limb": name}
                found.append({**where, "log_ratio": round(value, 2)})
    return found


def fix_innovations(fitted: Fitted, swims: Sequence[Segments]) -> dict[str, Any]:
    """Innovations of the fixes in units of their robust standard deviation, and how heavy their tails are."""
    parts, names, times = [], [], []
    for rollout, swim in zip(fitted.rollouts, swims, strict=True):
        size = rollout.innovation / np.sqrt(rollout.variance)
        known = np.isfinite(size).all(axis=1)
        parts.append(size[known])
        names += [swim.name] * int(known.sum())
        times.append(rollout.time_s[known])
    every = np.concatenate(parts)
    spread = 1.4826 * np.median(np.abs(every), axis=0) if len(every) else np.ones(3)
    scaled = every / np.maximum(spread, 1e-9)
    return {
        "run": names,
        "time_s": np.round(np.concatenate(times), 4).tolist(),
        **{name: np.round(scaled[:, k], 2).tolist() for k, name in enumerate(("x", "y", "heading"))},
        "sigma": _short(spread),
        "outliers": _short((np.abs(scaled) > OUTLIER_SIGMA).mean(axis=0)),
    }
