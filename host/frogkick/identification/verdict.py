"""What a search means: errors beside the noise floor, a verdict, intervals.

Three measures stand beside each other and none takes another's place. The *noise floor* is what a perfect
model would miss because fixes are noisy: the scatter of fixes about glides, carried through the filter. The
*repeatability* is what strokes do differently from one another at like states; it is told from pairs of like
periods, in whose difference a misfit of the model cancels, and it never raises the floor. The *log score
gain* is by how much the effects make runs likelier that were kept out of learning. A robot whose strokes vary
cannot reach the floor with any effect: it is partly explained at best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frogkick import der
from frogkick.core.poses import PredictionError
from frogkick.effects.acting import LEG_S
from frogkick.identification.bootstrap import CONFIDENCE, deviations, mean_interval, moved_by
from frogkick.identification.filter import Filter, Noise, first_rate_std
from frogkick.identification.fit import LOST, Fitted, misses, tracks_of
from frogkick.identification.predict import Track
from frogkick.identification.relatives import end_gaps, ends_missed
from frogkick.identification.search import Found
from frogkick.identification.segments import KICK_S, Segments, replicate_count
from frogkick.identification.steps import log_density, scale_of
from frogkick.paths import wrap_angle

FloatArray = NDArray[np.float64]

NOTHING, FOUND, PARTLY = "nothing missing", "found", "partly explained"
UNEXPLAINED, TOO_LITTLE = "unexplained", "not enough data"

NEAR_FLOOR = 1.35
"""Errors up to so many times the noise floor are noise."""

STILL_S = 1.5 * KICK_S
"""No limb moves where none has been fired for so long."""

WINDOW_S, WINDOWS_LEAST = 0.45, 12
"""Four fixes of a glide within so long are held against a parabola; so many such windows tell the noise."""

BEYOND = 3.0
"""Fixes off by more standard deviations are misdetections and no noise; of a normal one they are 0.3 %."""

CHANCE = 5.0
"""The same by how many standard deviations a mean square of few periods may lie above its expectation."""

INEXACT = 0.03
"""Of the error before, what an effect leaves that is the right one: simulations are as coarse as that."""

FAR = 2.0
"""Times its interval's half width: a true value farther off is no chance, one in 10,000."""


def gaps(tracks: Sequence[Track], swims: Sequence[Segments]) -> FloatArray:
    """(n, 3) measured minus predicted pose at the ends of all periods; NaN rows where one is not known."""
    every = [swim.measured - track.predicted for track, swim in zip(tracks, swims, strict=True)]
    gap = np.concatenate(every) if every else np.empty((0, 3))
    gap[:, 2] = wrap_angle(gap[:, 2])
    return gap


def fix_noise(swims: Sequence[Segments]) -> tuple[float, float] | None:
    """Standard deviation of a fix (m, rad) by fixes alone: their scatter about glides, where no limb moves.

    Four fixes in a row are held against the parabola nearest to them, so what is smooth in a glide, and with
    it every model, falls out; noise is taken as white. None where too few glides were seen.
    """
    parts: list[FloatArray] = []
    for swim in swims:
        fired = np.array([time_s for time_s, _ in swim.strokes])
        times = np.lib.stride_tricks.sliding_window_view(swim.time_s, 4) if len(swim.time_s) > 3 else None
        if times is None:
            continue
        since = times[:, 0] - STILL_S
        moved = np.searchsorted(fired, times[:, -1]) > np.searchsorted(fired, since)
        apart = np.diff(times, axis=1).min(axis=1) > 1e-3
        rows = np.flatnonzero(~moved & apart & (times[:, -1] - times[:, 0] < WINDOW_S))
        if not len(rows):
            continue
        gaps_s = times[rows][:, :, None] - times[rows][:, None, :]
        gaps_s[:, range(4), range(4)] = 1.0
        weight = 1.0 / gaps_s.prod(axis=2)  # a divided difference of third order
        weight /= np.sqrt((weight**2).sum(axis=1))[:, None]
        parts.append(np.einsum("nk,nkc->nc", weight, swim.pose[rows[:, None] + np.arange(4)]))
    every = np.concatenate(parts) if parts else np.empty((0, 3))
    if len(every) < WINDOWS_LEAST:
        return None
    return _scatter(every[:, :2].ravel()), _scatter(every[:, 2])


def _scatter(values: FloatArray) -> float:
    """Standard deviation of normal values about zero, without those that are wild."""
    from scipy import stats

    bound = BEYOND * 1.4826 * float(np.median(np.abs(values)))
    kept = values[np.abs(values) <= bound] if bound else values
    inside = 1.0 - 2.0 * BEYOND * stats.norm.pdf(BEYOND) / (1.0 - 2.0 * stats.norm.sf(BEYOND))
    return float(np.sqrt((kept**2).mean() / inside))


def noise_floor(swims: Sequence[Segments], fix: tuple[float, float]) -> PredictionError:
    """What a perfect model would miss: the pose and rate at the start as fixes tell them, and the end's pose.

    A perfect model needs no process noise. What limbs do differently from stroke to stroke is no fault of the
    fixes and does not count; see ``repeatability``.

    Args:
        swims: the runs.
        fix: standard deviation of a fix (m, rad); see ``fix_noise``.
    """
    noise = Noise(fix, (0.0, 0.0), (0.0, 0.0))
    sums, count = np.zeros(3), 0
    for swim in swims:
        state = Filter(noise, swim.actuated_s, swim.begin_s, first_rate_std(swim.rest_rate))
        variances = noise.per_axis()[0]
        order, next_fix = np.argsort(swim.arrival_s, kind="stable"), 0
        for start_s, end_s, share in zip(swim.start_s, swim.end_s, swim.end_noise, strict=True):
            while next_fix < len(order) and swim.arrival_s[order[next_fix]] <= start_s:
                state.take(float(swim.time_s[order[next_fix]]), np.zeros(3))
                next_fix += 1
            if not np.isfinite(share):
                continue
            ahead = end_s - state.time_s
            p = state.covariance
            sums += p[:, 0] + 2.0 * ahead * p[:, 1] + ahead**2 * p[:, 2] + share * variances
            count += 1
    variance = sums / max(count, 1)
    return PredictionError(float(np.sqrt(variance[0] + variance[1])), float(np.sqrt(variance[2])))


def repeatability(
    tracks: Sequence[Track], swims: Sequence[Segments], floor: PredictionError
) -> PredictionError:
    """What strokes do differently from one another at like states, root mean square; ``count`` pairs.

    Of each period the one of the same action whose start is most like it, in velocity and in the action
    before, is its replicate. Half the squared difference of what two replicates miss is variance: a misfit of
    the model at their state is in both and cancels. What noise of the fixes makes is taken off.

    Source: Rice 1984, Bandwidth choice for nonparametric regression (variance by differences of neighbours).
    """
    gap = np.concatenate([end_gaps(track, swim) for track, swim in zip(tracks, swims, strict=True)])
    action = np.concatenate([swim.action for swim in swims])
    previous = np.concatenate([np.append([-1], swim.action[:-1]) for swim in swims])
    start = np.concatenate([track.start[:, 3:6] for track in tracks])
    known = np.isfinite(gap).all(axis=1) & np.isfinite(start).all(axis=1) & (action >= 0)
    gap, action, previous, start = gap[known], action[known], previous[known], start[known]
    if len(gap) < 2:
        return PredictionError()
    start = start / np.maximum(start.std(axis=0), 1e-9)
    apart = ((start[:, None, :] - start[None, :, :]) ** 2).sum(axis=2) + 1e3 * (
        previous[:, None] != previous[None, :]
    )
    apart[action[:, None] != action[None, :]] = np.inf
    np.fill_diagonal(apart, np.inf)
    nearest = apart.argmin(axis=1)
    paired = np.isfinite(apart[np.arange(len(gap)), nearest])
    if not paired.any():
        return PredictionError()
    half = 0.5 * ((gap - gap[nearest])[paired] ** 2).mean(axis=0)
    return PredictionError(
        math.sqrt(max(float(half[0] + half[1]) - floor.position_rmse_m**2, 0.0)),
        math.sqrt(max(float(half[2]) - floor.heading_rmse_rad**2, 0.0)),
        int(paired.sum()),
    )


@dataclass(frozen=True)
class Gain:
    """By how much effects raise the log score of runs, the mean log predictive density of a period.

    Attributes:
        value: with minus without the effects, nats a period.
        low, high: interval of 95 % by block bootstrap.
    """

    value: float
    low: float
    high: float

    def as_json(self) -> dict[str, Any]:
        """The key ``log_score_gain`` of the command."""
        return {"value": self.value, "interval": [self.low, self.high]}


def log_score_gain(
    scales: tuple[FloatArray, FloatArray],
    before: Sequence[Track],
    after: Sequence[Track],
    swims: Sequence[Segments],
) -> Gain:
    """How much likelier effects make the measured ends of periods, paired by period.

    Args:
        scales: (3, 3) of the Student-t densities without and with effects, by the training runs: a model is
            judged by the spread that it claims as well.
        before, after: of the runs, without and with effects.
        swims: the runs.
    """
    runs = []
    for one, other, swim in zip(before, after, swims, strict=True):
        ends = [end_gaps(track, swim) for track in (one, other)]
        rows = np.isfinite(ends[0]).all(axis=1) & np.isfinite(ends[1]).all(axis=1)
        if rows.any():
            scores = [log_density(each[rows], scale) for each, scale in zip(ends, scales, strict=True)]
            runs.append(scores[1] - scores[0])
    if not runs:
        return Gain(math.nan, math.nan, math.nan)
    value = float(np.concatenate(runs).mean())
    low, high = mean_interval(runs, np.random.default_rng(0))
    wider = math.sqrt(replicate_count(swims))  # what runs of one noise agree in counts once
    return Gain(value, value - wider * (value - low), value + wider * (high - value))


@dataclass(frozen=True)
class Interval:
    """A parameter: value, interval, unit."""

    name: str
    value: float
    low: float
    high: float
    unit: str

    @property
    def interval(self) -> tuple[float, float]:
        """Low and high."""
        return self.low, self.high

    def holds(self, value: float, times: float = 1.0) -> bool:
        """Whether a value is inside, or inside of an interval so many times as wide."""
        more = 0.5 * (times - 1.0) * (self.high - self.low)
        return self.low - more <= value <= self.high + more


def left_by_steps(fitted: Fitted, swims: Sequence[Segments], rows: NDArray[np.bool_]) -> FloatArray:
    """(p,) how far parameters would move, were the runs followed with steps as short as a simulated pool's.

    Args:
        fitted: a model at its best, with derivatives by all its parameters.
        swims: what it was fitted to.
        rows: which of all their periods ``fitted.missed`` has.
    """
    if not fitted.jacobian.shape[2]:
        return np.empty(0)
    fine = replace(fitted.model, step_s=der.STEP_S, leg_s=LEG_S)
    change = misses(tracks_of([fine], swims)[0], rows) - fitted.missed
    change[(np.abs(change) > 0.5 * LOST).any(axis=1)] = 0.0  # it failed with one of both
    return moved_by(change, fitted.missed, fitted.jacobian, fitted.model.range)


def intervals(
    fitted: Fitted, rows: NDArray[np.bool_] | None = None, left_open: FloatArray | None = None
) -> list[list[Interval]]:
    """Of each term's parameters: together they hold the true values with CONFIDENCE.

    Args:
        fitted: a model at its best, with derivatives by all its parameters.
        rows: which periods of all runs ``fitted.missed`` has; None: all of them.
        left_open: (p,) what is open besides chance, see ``left_by_steps``; None: nothing.
    """
    from scipy import stats

    width = fitted.jacobian.shape[2]
    if not width:
        return []
    deviation = deviations(fitted.missed, fitted.jacobian, fitted.model.range, _runs_of(fitted, rows))
    freedom = max(len(fitted.missed) - width, 1)
    found, first = [], 0
    for term in fitted.model.terms:
        wide = stats.t.ppf(0.5 + 0.5 * (1.0 - (1.0 - CONFIDENCE) / len(term.values)), freedom)
        row = []
        for k, (parameter, value) in enumerate(zip(term.parameters, term.values, strict=True)):
            steps = 0.0 if left_open is None else left_open[first + k]
            reach = math.hypot(wide * deviation[first + k], steps, parameter.open)
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


def _runs_of(fitted: Fitted, rows: NDArray[np.bool_] | None) -> NDArray[np.int64]:
    """(n,) the run that each period of ``fitted.missed`` is of."""
    labels = np.repeat(np.arange(len(fitted.tracks)), [len(track.start) for track in fitted.tracks])
    return labels if rows is None else labels[rows]


def near(error: PredictionError, floor: PredictionError, before: PredictionError) -> bool:
    """An error is no more than noise, and what is inexact where a large one was explained."""
    over = max(NEAR_FLOOR, math.sqrt(1.0 + CHANCE * math.sqrt(2.0 / max(error.count, 1))))
    return error.position_rmse_m <= math.hypot(
        over * floor.position_rmse_m, INEXACT * before.position_rmse_m
    ) and error.heading_rmse_rad <= math.hypot(
        over * floor.heading_rmse_rad, INEXACT * before.heading_rmse_rad
    )


@dataclass(frozen=True, eq=False)
class Scored:
    """Errors of some runs by two models.

    Attributes:
        before, after: without and with effects, by the models alone.
        noise_floor: see ``noise_floor``.
        gain: of the log score; None where nothing was learned.
        repeatability: see ``repeatability``.
    """

    before: PredictionError
    after: PredictionError
    noise_floor: PredictionError
    gain: Gain | None = None
    repeatability: PredictionError = PredictionError()  # noqa: RUF009 - frozen

    @property
    def quiet(self) -> bool:
        """What is left is no more than noise of the fixes."""
        return not self.after.count or near(self.after, self.noise_floor, self.before)

    @property
    def helped(self) -> bool:
        """Effects make the runs likelier beyond chance, and no error grows but within noise of the fixes."""
        if self.gain is None or not self.gain.low > 0.0:
            return False
        pairs = (
            (each.position_rmse_m, each.heading_rmse_rad)
            for each in (self.before, self.after, self.noise_floor)
        )
        return all(
            after <= max(before, NEAR_FLOOR * floor) for before, after, floor in zip(*pairs, strict=True)
        )

    def as_json(self) -> dict[str, Any]:
        """The keys of the command."""
        return {
            "before": self.before.as_json(),
            "after": self.after.as_json(),
            "noise_floor": self.noise_floor.as_json(),
            "log_score_gain": None if self.gain is None else self.gain.as_json(),
            "repeatability": self.repeatability.as_json(),
        }


def scored(
    found: Found,
    train: Sequence[Segments],
    swims: Sequence[Segments],
    before: Sequence[Track],
    after: Sequence[Track],
) -> Scored:
    """Errors of runs without and with what was found; runs of one noise count once.

    Args:
        found: by the search.
        train: what it was found in: noise of fixes and spread of predictions are told from there.
        swims: the runs to judge.
        before, after: of these, by the models without and with effects.
    """
    errors = [PredictionError.of(gaps(tracks, swims)) for tracks in (before, after)]
    one_noise = replicate_count(swims)
    first, second = (replace(error, count=error.count // one_noise) for error in errors)
    floor = noise_floor(swims, fix_noise([*train]) or fix_noise(swims) or found.fitted.model.noise.fix)
    gain = None
    if found.fitted.model.terms:
        models = (found.nominal, found.fitted)
        one, other = (scale_of(ends_missed(each.tracks, train)) for each in models)
        gain = log_score_gain((one, other), before, after, swims)
    return Scored(first, second, floor, gain, repeatability(after, swims, floor))


def verdict_of(found: Found, trained: Scored, tested: Scored) -> str:
    """One of the verdicts: effects must help on runs that were kept out, and what is left decides the rest.

    ``found``: the log score gain has an interval above zero on the runs kept out, and what is left there and
    on the training runs is noise of the fixes. ``partly explained``: that gain, and more than noise is left.
    ``nothing missing``: no effects, and no more than noise. ``unexplained``: else.
    """
    quiet = trained.quiet and tested.quiet
    if not found.fitted.model.terms:
        return NOTHING if quiet else UNEXPLAINED
    if not tested.helped:
        return UNEXPLAINED
    return FOUND if quiet else PARTLY
