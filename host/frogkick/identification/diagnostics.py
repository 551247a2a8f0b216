"""What is left of the runs after a fit: in words, and in physical quantities.

The missing wrench in each third of a period is a hidden state on which the residuals depend linearly. It is
estimated from all residuals of a run at once, as an Ornstein-Uhlenbeck process whose size and correlation are
maximum-likelihood estimates; mean and covariance are those of a Kalman smoother.

Source: Rauch, Tung, Striebel 1965 (smoother); Hartikainen, Sarkka 2010 (the same as Gaussian regression).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.core.poses import world_from_body
from frogkick.identification.filter import Noise
from frogkick.identification.fit import Fitted
from frogkick.identification.predict import PHASES, Rollout
from frogkick.identification.responses import THIRDS, Responses
from frogkick.identification.segments import Data, Segments
from frogkick.identification.steps import log_density, scale_of
from frogkick.robot import Robot

PERIODOGRAM_PERIODS, PERIODOGRAM_COUNT_MIN = 24, 16
"""Periods of the periodogram of the residuals, and the residuals that it needs at least."""


def residual_diagnostics(fitted: Fitted, data: Data) -> dict[str, Any]:
    """Shares of the squared residuals at the ends of periods that each explanatory variable accounts for.

    ``shares``: variable -> share (adjusted for degrees of freedom); ``strongest``: the one with the most;
    ``by_action``: mean forward, left (m), heading (rad) of each action; ``text``: in words.
    """
    residuals = fitted.residuals[:, -3:]
    names, order = data.swims[0].action_names, data.order
    action = data.used(swim.action for swim in data.swims)
    previous = data.used(np.append([-1], swim.action[:-1]) for swim in data.swims)
    start = data.used(rollout.start for rollout in fitted.rollouts)
    clock = data.used(swim.start_s for swim in data.swims)
    world = world_from_body(start[:, 2], residuals)
    one = np.ones((len(residuals), 1))
    views = {
        "constant, body frame": (residuals, one),
        "constant, world frame": (world, one),
        "action": (residuals, _dummies(action)),
        "previous action": (residuals, np.column_stack([one, _dummies(previous)[:, 1:]])),
        "heading": (residuals, np.column_stack([one, np.cos(start[:, 2]), np.sin(start[:, 2])])),
        "velocity at the start": (residuals, np.column_stack([one, start[:, 3:6]])),
        "place": (world, _place(start[:, :2])),
        "time in the run": (residuals, np.column_stack([one, order, np.exp(-order / 2.0)])),
        "clock": (world, np.column_stack([one, clock - clock.mean()])),
        "run": (residuals, _dummies(data.run)),
    }
    shares = {name: _share(values, design) for name, (values, design) in views.items()}
    shares["rhythm"], cycle_s = _periodogram(residuals, clock)
    by_action = {
        str(names[a]) if a >= 0 else "unknown": {
            "periods": int((action == a).sum()),
            "forward_m": float(residuals[action == a, 0].mean()),
            "left_m": float(residuals[action == a, 1].mean()),
            "heading_rad": float(residuals[action == a, 2].mean()),
        }
        for a in np.unique(action)
    }
    strongest = max(shares, key=lambda name: shares[name])
    size = np.sqrt((residuals**2).mean(axis=0))
    rhythm = f", with a period of {cycle_s:.0f} s" if strongest == "rhythm" else ""
    pattern = (
        f"; best explained by {strongest} ({100 * shares[strongest]:.0f} % of the sum of squares){rhythm}"
        if shares[strongest] > 0.05
        else ", without a pattern"
    )
    text = (
        f"residuals at the end of a period: {1e3 * float(size[0]):.2f} mm forward, "
        f"{1e3 * float(size[1]):.2f} mm left, {np.degrees(float(size[2])):.2f} deg RMS{pattern}"
    )
    return {"shares": shares, "strongest": strongest, "by_action": by_action, "text": text}


def _place(xy_m: Float64) -> Float64:
    """(n, 6) polynomial of second degree in the position."""
    x, y = (xy_m - xy_m.mean(axis=0)).T
    return np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])


def _periodogram(values: Float64, clock_s: Float64) -> tuple[float, float]:
    """Largest share of a least-squares periodogram (Lomb 1976), less that by chance, and its period, s."""
    if len(values) < PERIODOGRAM_COUNT_MIN:
        return 0.0, 0.0
    beat_s = float(np.median(np.diff(np.unique(clock_s))))
    found = []
    for period_s in np.geomspace(3.0 * beat_s, max(np.ptp(clock_s), 4.0 * beat_s), PERIODOGRAM_PERIODS):
        angle = math.tau * clock_s / period_s
        design = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
        # The best of many periods explains a part of pure noise, which is subtracted.
        share = _share(values, design) - 2.0 * math.log(PERIODOGRAM_PERIODS) / len(values)
        found.append((max(share, 0.0), float(period_s)))
    return max(found)


def _dummies(labels: Int64) -> Float64:
    return np.asarray((labels[:, None] == np.unique(labels)[None, :]).astype(np.float64))


def _share(values: Float64, design: Float64) -> float:
    """Share of the sum of squares of three scaled columns that a design explains: adjusted R^2."""
    count, freedom = len(values), int(np.linalg.matrix_rank(design))
    if count <= freedom + 1:
        return 0.0
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    kept = (left**2).sum(axis=0) / (count - freedom) / np.maximum((values**2).mean(axis=0), 1e-30)
    return float(np.clip(1.0 - kept.mean(), 0.0, 1.0))


SIZES_N, ARMS_M, MEMORIES = (0.0, *np.geomspace(3e-5, 1e-2, 8)), (0.005, 0.02, 0.06), (0.0, 0.6, 0.9, 0.98)
"""Values that are tried: size of the wrench, its torque over its force, and its correlation from third to
third."""

STRETCH = 40  # number of periods that are estimated together; longer runs are cut
CLEAR = 0.25  # a failed stroke clearly explains a residual if less than this share of its square remains
OUTLIER_SIGMA = 3.0  # a fix is an outlier if its innovation exceeds this many standard deviations


@dataclass(frozen=True, eq=False)
class Missing:
    """The wrench that a model misses in k thirds of periods."""

    run: Int64  # (k,) index of the run
    time_s: Float64  # (k,) middle of each third
    heading: Float64  # (k,) of the robot at that time, rad
    wrench: Float64  # (k, 3) missing force forward, left (N) and torque (N m); body frame
    covariance: Float64  # (k, 3, 3) of the wrench

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


def missing_wrench(fitted: Fitted, responses: Responses, data: Data) -> Missing:
    """Estimate the wrench that a model misses in each third of each period, from its residuals."""
    runs, order = data.run, data.order
    noise = data.used(_noise_of(fitted.model.noise, swim) for swim in data.swims)
    at_s, heading = np.asarray(responses.bodies["time_s"]), np.asarray(responses.bodies["heading_rad"])
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
    fix = noise.per_axis()[0]
    found = np.zeros((len(swim.start_s), 9, 9))
    for period, (time_s, p) in enumerate(swim.states_at_starts(noise)):
        start_s, end_s = swim.start_s[period], swim.end_s[period]
        ahead = float(start_s) - time_s
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
    fitted: Fitted, responses: Responses, data: Data, limbs: Sequence[str]
) -> list[dict[str, Any]]:
    """Log likelihood ratio of fired to not fired for each stroke, with all others as commanded."""
    times = data.used(swim.fired_s(len(limbs)) for swim in data.swims)
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
        for run, time_s, value in zip(data.run, times[:, limb], ratio.tolist(), strict=True):
            if math.isfinite(time_s):
                where = {"run": data.swims[run].name, "time_s": round(float(time_s), 4), "limb": name}
                found.append({**where, "log_ratio": round(value, 2)})
    return found


def fix_innovations(fitted: Fitted, swims: Sequence[Segments]) -> dict[str, Any]:
    """Innovations of the fixes in units of their robust standard deviation, and how heavy their tails are."""
    parts, names, times = [], [], []
    for rollout, swim in zip(fitted.rollouts, swims, strict=True):
        known = np.isfinite(rollout.innovation).all(axis=1)
        parts.append(rollout.innovation[known])
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


RANDOM_WALKS = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Candidates for the variance that an offset gains in a period, relative to that of the residuals."""

INITIAL_VARIANCE = 0.05  # variance of an offset at a run's start, likewise relative
HUBER_SIGMAS = (2.0, 4.0)  # innovations are clipped at these multiples of the size of the residuals
GAIN_MIN = 3.0  # minimum fall of the deviance of the training runs


@dataclass(frozen=True)
class Drift:
    """Drift of limbs while the robot swims: random-walk offsets beside the model, tracked by a Kalman filter.

    Each limb has an offset of the pose at the end of a period in which it fires: forward (m), left (m),
    heading (rad), as in all entries here. State: the offsets of all limbs. F: identity, the offsets are
    random walks. Q: their variance gain per period. H: the limbs that fire in the period. R: the variance of
    the residuals. The variance gain is chosen on the training runs. Where tracking gains next to nothing
    there, it is left out.
    """

    size: tuple[float, ...]  # (3,) size of the residuals without it: m, m, rad
    # (3,) variance gained in a period, in squares of that size; 0 = no drift on this axis
    random_walk: tuple[float, ...]
    huber_sigma: tuple[float, ...]  # (3,) clipping threshold of innovations, in that size

    def as_json(self) -> dict[str, list[float]]:
        """The key ``drift`` of the command ``identify``."""
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
        huber_sigma: innovations are clipped at this many times the residuals' size.
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
