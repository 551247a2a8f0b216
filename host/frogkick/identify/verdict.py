"""What a search means: errors beside the noise floor, a verdict, intervals, and the signature of the rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from frogkick.identify.filter import Filter, Noise
from frogkick.identify.fit import Fitted
from frogkick.identify.predict import Track
from frogkick.identify.search import Found
from frogkick.identify.steps import whiten, whitener
from frogkick.identify.swim import Swim
from frogkick.paths import wrap_angle

FloatArray = NDArray[np.float64]

NOTHING, FOUND, UNEXPLAINED, TOO_LITTLE = "nothing missing", "found", "unexplained", "not enough data"

NEAR_FLOOR = 1.35
"""Errors up to so many times the noise floor are noise."""

CHANCE = 5.0
"""The same by how many standard deviations a mean square of few periods may lie above its expectation."""

INEXACT = 0.03
"""Of the error before, what an effect leaves that is the right one: simulations are as coarse as that."""

CONFIDENCE = 0.95

LEFT_OPEN = 0.005
"""Of the distance of a parameter's bounds: what time steps leave open, where it does not say so itself."""

WIDER = 1.3
"""Intervals over those of independent periods and straight derivatives: by that planted values are inside."""


RHYTHMS, RHYTHM_LEAST = 24, 16
"""Periods of time that are tried on what is left, and misses that this needs."""


@dataclass(frozen=True)
class Error:
    """How far predictions a period ahead are off, root mean square over ``count`` periods."""

    position_rmse_m: float
    heading_rmse_rad: float
    count: int = 0

    def as_json(self) -> dict[str, float]:
        """The keys of the command."""
        return {"position_rmse_m": self.position_rmse_m, "heading_rmse_rad": self.heading_rmse_rad}


def gaps(tracks: Sequence[Track], swims: Sequence[Swim]) -> FloatArray:
    """(n, 3) measured minus predicted pose at the ends of all periods; NaN rows where one is not known."""
    every = [swim.measured - track.predicted for track, swim in zip(tracks, swims, strict=True)]
    gap = np.concatenate(every) if every else np.empty((0, 3))
    gap[:, 2] = wrap_angle(gap[:, 2])
    return gap


def error_of(gap: FloatArray) -> Error:
    """Root mean squares over the rows that are known."""
    known = gap[np.isfinite(gap).all(axis=1)]
    if not len(known):
        return Error(math.nan, math.nan)
    return Error(
        float(np.sqrt((known[:, :2] ** 2).sum(axis=1).mean())),
        float(np.sqrt((known[:, 2] ** 2).mean())),
        len(known),
    )


def noise_floor(swims: Sequence[Swim], noise: Noise) -> Error:
    """What a right model would miss: the pose and rate at the start as fixes tell them, and the end's pose.

    Args:
        swims: the runs.
        noise: as fitted to them; what drives a glide blurs the rate at a start, what limbs do differently
            from stroke to stroke is no fault of the fixes and does not count.
    """
    sums, count = np.zeros(3), 0
    for swim in swims:
        state = Filter(noise, swim.busy_s, swim.begin_s)
        fix = noise.per_axis()[0]
        order, next_fix = np.argsort(swim.arrival_s, kind="stable"), 0
        for start_s, end_s, share in zip(swim.start_s, swim.end_s, swim.end_noise, strict=True):
            while next_fix < len(order) and swim.arrival_s[order[next_fix]] <= start_s:
                state.take(float(swim.time_s[order[next_fix]]), np.zeros(3))
                next_fix += 1
            if not np.isfinite(share):
                continue
            ahead = end_s - state.time_s
            p = state.covariance
            sums += p[:, 0] + 2.0 * ahead * p[:, 1] + ahead**2 * p[:, 2] + share * fix
            count += 1
    variance = sums / max(count, 1)
    return Error(float(np.sqrt(variance[0] + variance[1])), float(np.sqrt(variance[2])))


@dataclass(frozen=True)
class Interval:
    """A parameter: value, interval, unit."""

    name: str
    value: float
    low: float
    high: float
    unit: str


def intervals(fitted: Fitted) -> list[list[Interval]]:
    """Of each term's parameters: together they hold the true values with CONFIDENCE.

    The covariance is Gauss and Newton's, or the one that scatter from period to period gives where that is
    wider; periods are taken as independent.
    """
    white = whitener(fitted.missed)
    flat, columns = whiten(white, fitted.missed, fitted.jacobian)
    count, width = len(fitted.missed), columns.shape[1]
    if not width:
        return []
    scale = np.maximum(fitted.model.range, 1e-12)
    scaled = columns * scale
    inverse = np.linalg.pinv(scaled.T @ scaled + 1e-9 * len(flat) * np.eye(width))
    scores = np.einsum("nip,ni->np", scaled.reshape(count, -1, width), flat.reshape(count, -1))
    sandwich = inverse @ (scores.T @ scores) @ inverse * count / max(count - width, 1)
    deviation = np.sqrt(np.maximum(np.diag(inverse), np.diag(sandwich))) * scale
    found, first = [], 0
    for term in fitted.model.terms:
        wide = stats.t.ppf(0.5 + 0.5 * (1.0 - (1.0 - CONFIDENCE) / len(term.values)), max(count - width, 1))
        row = []
        for k, (parameter, value) in enumerate(zip(term.parameters, term.values, strict=True)):
            # Simulations with coarser steps here than in the pool.
            left_open = parameter.open or LEFT_OPEN * (parameter.high - parameter.low)
            reach = float(np.hypot(WIDER * wide * deviation[first + k], left_open))
            row.append(
                Interval(
                    parameter.name,
                    value,
                    max(parameter.low, value - reach),
                    min(parameter.high, value + reach),
                    parameter.unit,
                )
            )
        first += len(term.values)
        found.append(row)
    return found


def near(error: Error, floor: Error, before: Error) -> bool:
    """An error is no more than noise, and what is inexact where a large one was explained."""
    over = max(NEAR_FLOOR, math.sqrt(1.0 + CHANCE * math.sqrt(2.0 / max(error.count, 1))))
    return error.position_rmse_m <= math.hypot(
        over * floor.position_rmse_m, INEXACT * before.position_rmse_m
    ) and error.heading_rmse_rad <= math.hypot(
        over * floor.heading_rmse_rad, INEXACT * before.heading_rmse_rad
    )


def verdict_of(found: Found, *judged: tuple[Error, Error, Error]) -> str:
    """One of the verdicts: what is left must be noise on all runs, those kept out of the search too.

    Args:
        found: by the search.
        judged: of each set of runs errors before and after, and their noise floor.
    """
    if not all(near(after, floor, before) for before, after, floor in judged if after.count):
        return UNEXPLAINED
    return FOUND if found.fitted.model.terms else NOTHING


def signature(fitted: Fitted, rows: NDArray[np.bool_], swims: Sequence[Swim]) -> dict[str, Any]:
    """Where the misses at the end of periods come from: shares of their squares that each view explains.

    Returns:
        ``shares``: view -> share (adjusted for its freedom); ``strongest``: the view with the most;
        ``by_action``: mean forward, left (m), heading (rad) of each action; ``text``: in words.
    """
    missed = fitted.missed[:, -3:]
    names = swims[0].action_names
    action = np.concatenate([swim.action for swim in swims])[rows]
    previous = np.concatenate([np.append([-1], swim.action[:-1]) for swim in swims])[rows]
    run = np.concatenate([np.full(len(swim.action), k) for k, swim in enumerate(swims)])[rows]
    order = np.concatenate([np.arange(len(swim.action)) for swim in swims])[rows]
    start = np.concatenate([track.start for track in fitted.tracks])[rows]
    clock = np.concatenate([swim.start_s for swim in swims])[rows]
    c, s = np.cos(start[:, 2]), np.sin(start[:, 2])
    world = np.column_stack(
        [c * missed[:, 0] - s * missed[:, 1], s * missed[:, 0] + c * missed[:, 1], missed[:, 2]]
    )
    one = np.ones((len(missed), 1))
    views = {
        "constant, body frame": (missed, one),
        "constant, world frame": (world, one),
        "action": (missed, _dummies(action)),
        "previous action": (missed, np.column_stack([one, _dummies(previous)[:, 1:]])),
        "heading": (missed, np.column_stack([one, np.cos(start[:, 2]), np.sin(start[:, 2])])),
        "velocity at the start": (missed, np.column_stack([one, start[:, 3:6]])),
        "place": (world, _place(start[:, :2])),
        "time in the run": (missed, np.column_stack([one, order, np.exp(-order / 2.0)])),
        "clock": (world, np.column_stack([one, clock - clock.mean()])),
        "run": (missed, _dummies(run)),
    }
    shares = {name: _share(values, design) for name, (values, design) in views.items()}
    shares["rhythm"], rhythm_s = _rhythm(missed, clock)
    by_action = {
        str(names[a]) if a >= 0 else "unknown": {
            "periods": int((action == a).sum()),
            "forward_m": float(missed[action == a, 0].mean()),
            "left_m": float(missed[action == a, 1].mean()),
            "heading_rad": float(missed[action == a, 2].mean()),
        }
        for a in np.unique(action)
    }
    strongest = max(shares, key=lambda name: shares[name])
    size = np.sqrt((missed**2).mean(axis=0))
    text = (
        f"what is left at the end of a period: {1e3 * float(size[0]):.2f} mm forward, "
        f"{1e3 * float(size[1]):.2f} mm left, {np.degrees(float(size[2])):.2f} deg RMS; "
        f"best told by {strongest} ({100 * shares[strongest]:.0f} % of its squares)"
        + (f", of {rhythm_s:.0f} s" if strongest == "rhythm" else "")
        if shares[strongest] > 0.05
        else f"what is left at the end of a period: {1e3 * float(size[0]):.2f} mm forward, "
        f"{1e3 * float(size[1]):.2f} mm left, {np.degrees(float(size[2])):.2f} deg RMS, without a pattern"
    )
    return {"shares": shares, "strongest": strongest, "by_action": by_action, "text": text}


def _place(xy_m: FloatArray) -> FloatArray:
    """(n, 6) polynomial of second degree in a place."""
    x, y = (xy_m - xy_m.mean(axis=0)).T
    return np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])


def _rhythm(values: FloatArray, clock_s: FloatArray) -> tuple[float, float]:
    """Share of what a swing of one period in time explains, and that period in s; the best of many."""
    if len(values) < RHYTHM_LEAST:
        return 0.0, 0.0
    beat_s = float(np.median(np.diff(np.unique(clock_s))))
    found = []
    for period_s in np.geomspace(3.0 * beat_s, max(np.ptp(clock_s), 4.0 * beat_s), RHYTHMS):
        angle = math.tau * clock_s / period_s
        design = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
        # The best of many explains something of pure noise: what that is, is taken off.
        share = _share(values, design) - 2.0 * math.log(RHYTHMS) / len(values)
        found.append((max(share, 0.0), float(period_s)))
    return max(found)


def _dummies(labels: NDArray[np.int64]) -> FloatArray:
    return np.asarray((labels[:, None] == np.unique(labels)[None, :]).astype(np.float64))


def _share(values: FloatArray, design: FloatArray) -> float:
    """Of the squares of three columns, each by its own size, that a design explains; adjusted."""
    count, freedom = len(values), int(np.linalg.matrix_rank(design))
    if count <= freedom + 1:
        return 0.0
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    kept = (left**2).sum(axis=0) / (count - freedom) / np.maximum((values**2).mean(axis=0), 1e-30)
    return float(np.clip(1.0 - kept.mean(), 0.0, 1.0))
