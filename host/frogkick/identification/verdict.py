"""What a search means: errors beside noise floor and repeatability, log score gain, verdict, intervals.

See host/docs/pages/explanation/identification.md. A robot whose strokes vary cannot reach the floor with any
effect: it is partly explained at best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from frogkick import der
from frogkick.core.arrays import Float64
from frogkick.core.poses import PredictionError, wrap_angle
from frogkick.effects.acting import LEG_S
from frogkick.identification.bootstrap import CONFIDENCE, mean_interval, moved_by, standard_errors
from frogkick.identification.calibrated import end_errors, end_residuals
from frogkick.identification.filter import Noise
from frogkick.identification.fit import DIVERGED, Fitted, evaluate, residuals_of, rollouts_of, step_bounds
from frogkick.identification.laws import WORSE
from frogkick.identification.predict import Rollout
from frogkick.identification.refine import at_grid
from frogkick.identification.search import Found
from frogkick.identification.segments import ACTUATION_S, Data, Segments, replicate_count
from frogkick.identification.steps import linearised_optimum, log_density, scale_of
from frogkick.identification.terms import Interval

NOTHING, FOUND, PARTLY = "nothing missing", "found", "partly explained"
FOUND_LAW = "found: law"
UNEXPLAINED, TOO_LITTLE = "unexplained", "not enough data"

NEAR_FLOOR = 1.35  # errors up to this multiple of the noise floor are noise
STILL_S = 1.5 * ACTUATION_S  # no limb moves if none has fired for this time

WINDOW_S, WINDOWS_LEAST = 0.45, 12
"""Four fixes of a glide within this time are compared with a parabola; the noise is estimated from at least
WINDOWS_LEAST such windows."""

OUTLIER_SIGMA = 3.0
"""Residuals of fixes beyond this many standard deviations are outliers: 0.3 % of a normal density."""

CHANCE = 5.0  # a mean square of few periods may exceed its expectation by this many standard deviations

SURE_NATS, FEW_PERIODS = 12.0, 32
"""In fewer than FEW_PERIODS test periods, fewer than eight blocks, the interval of a mean is wide: one period
that gains nothing lets it reach zero. It is also wide if strokes fail by chance, as a test run has few
failures of about ten nats each. The gain of all periods is a likelihood ratio, which chance makes this large
once in 10^5 times (Ville 1939)."""

INEXACT = 0.03
"""Share of the error before that the right effect may leave: the discretisation error of the simulation."""

FAR = 2.0  # multiple of an interval's half width: a true value beyond that is no chance (one in 10,000)


def prediction_errors(rollouts: Sequence[Rollout], swims: Sequence[Segments]) -> Float64:
    """(n, 3) measured minus predicted pose at the ends of all periods; NaN if unknown."""
    every = [swim.measured - rollout.predicted for rollout, swim in zip(rollouts, swims, strict=True)]
    gap = np.concatenate(every) if every else np.empty((0, 3))
    gap[:, 2] = wrap_angle(gap[:, 2])
    return gap


def fix_noise(swims: Sequence[Segments]) -> tuple[float, float] | None:
    """Standard deviation of a fix (m, rad) from fixes alone: their scatter in glides, where no limb moves.

    Four consecutive fixes are compared with the parabola that fits them best, so whatever is smooth in a
    glide cancels, and no model is needed; noise is taken as white. None if there are too few glides.
    """
    parts: list[Float64] = []
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


def _scatter(values: Float64) -> float:
    """Standard deviation of normal values about zero, outliers excluded (a truncated estimate)."""
    from scipy import stats

    bound = OUTLIER_SIGMA * 1.4826 * float(np.median(np.abs(values)))
    kept = values[np.abs(values) <= bound] if bound else values
    inside = 1.0 - 2.0 * OUTLIER_SIGMA * stats.norm.pdf(OUTLIER_SIGMA) / (
        1.0 - 2.0 * stats.norm.sf(OUTLIER_SIGMA)
    )
    return float(np.sqrt((kept**2).mean() / inside))


def noise_floor(swims: Sequence[Segments], fix: tuple[float, float]) -> PredictionError:
    """Error of a perfect model: the uncertainty of the start's pose and rate, and of the end's pose.

    A perfect model needs no process noise, and the variation from stroke to stroke is no fault of the fixes.
    ``fix`` is the standard deviation of a fix (m, rad); see ``fix_noise``.
    """
    noise = Noise(fix, (0.0, 0.0), (0.0, 0.0))
    sums, count = np.zeros(3), 0
    variances = noise.per_axis()[0]
    for swim in swims:
        states = swim.states_at_starts(noise)
        for end_s, share, (time_s, p) in zip(swim.end_s, swim.end_noise, states, strict=True):
            if not np.isfinite(share):
                continue
            ahead = end_s - time_s
            sums += p[:, 0] + 2.0 * ahead * p[:, 1] + ahead**2 * p[:, 2] + share * variances
            count += 1
    variance = sums / max(count, 1)
    return PredictionError(float(np.sqrt(variance[0] + variance[1])), float(np.sqrt(variance[2])))


def repeatability(
    rollouts: Sequence[Rollout], swims: Sequence[Segments], floor: PredictionError
) -> PredictionError:
    """Variation between strokes in like states, root mean square; ``count`` pairs.

    The replicate of a period is the one of the same action with the most similar start, in velocity and in
    the action before. Half the squared difference of the residuals of two replicates is variance: a misfit of
    the model at their state is in both and cancels. The noise floor is subtracted.

    Source: Rice 1984, Bandwidth choice for nonparametric regression (variance by differences of neighbours).
    """
    gap = np.concatenate([end_errors(rollout, swim) for rollout, swim in zip(rollouts, swims, strict=True)])
    action = np.concatenate([swim.action for swim in swims])
    previous = np.concatenate([np.append([-1], swim.action[:-1]) for swim in swims])
    start = np.concatenate([rollout.start[:, 3:6] for rollout in rollouts])
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


def log_score_gain(
    found: Found,
    swims: Sequence[Segments],
    before: Sequence[Rollout],
    after: Sequence[Rollout],
    raw: tuple[Sequence[Segments], Sequence[Segments]],
) -> Interval:
    """Gain of the log score by effects: with minus without, paired by the measured ends of periods.

    For the arguments see ``scored``.

    The scales of the Student-t densities without and with effects are estimated from the training runs: a
    model is also judged by the spread that it predicts. Where limbs misfire the density is a mixture.
    """
    models = ((found.nominal, raw[0]), (found.fitted, found.data.swims))
    scales = [scale_of(end_residuals(each.rollouts, runs)) for each, runs in models]
    pairs = [
        [end_errors(one, plain), end_errors(other, swim)]
        for one, other, plain, swim in zip(before, after, raw[1], swims, strict=True)
    ]
    rows = [np.asarray(np.isfinite(np.concatenate(ends, axis=1)).all(axis=1)) for ends in pairs]
    scores = [
        [log_density(each[row], scale) for each, scale in zip(ends, scales, strict=True)]
        for ends, row in zip(pairs, rows, strict=True)
    ]
    if found.misfires is not None:
        mixed = found.misfires.scores(swims, rows)
        scores = [[plain, mixture] for (plain, _), mixture in zip(scores, mixed, strict=True)]
    runs = [with_effects - without for without, with_effects in scores if len(without)]
    value = low = high = math.nan
    if runs:
        value = float(np.concatenate(runs).mean())
        low, high = mean_interval(runs, np.random.default_rng(0))
    wider = math.sqrt(replicate_count(swims))  # replicates with the same noise count once
    ends = value - wider * (value - low), value + wider * (high - value)
    return Interval("log score gain", value, *ends, "nats per period")


def discretisation_shift(fitted: Fitted, data: Data) -> Float64:
    """(p,) shift of the parameters if runs were simulated with steps as short as the simulated pool's."""
    if not fitted.jacobian.shape[2]:
        return np.empty(0)
    fine = replace(fitted.model, step_s=der.STEP_S, leg_s=LEG_S)
    change = residuals_of(rollouts_of([fine], data.swims)[0], data.rows) - fitted.residuals
    change[(np.abs(change) > 0.5 * DIVERGED).any(axis=1)] = 0.0  # one of both simulations failed
    return moved_by(change, fitted.residuals, fitted.jacobian, fitted.model.reach)


def intervals(fitted: Fitted, data: Data, bias: Float64 | None = None) -> list[list[Interval]]:
    """Intervals of each term's parameters: each contains its true value with probability CONFIDENCE.

    The fit is at its optimum and has derivatives by all its parameters. ``bias`` (p,) and a parameter's
    tolerance are deviations not by chance, which are added as the root of the sum of squares.
    """
    from scipy import stats

    model, width = fitted.model, fitted.jacobian.shape[2]
    if not width:
        return []
    deviation = standard_errors(fitted.residuals, fitted.jacobian, model.reach, data.run)
    wide = stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(len(fitted.residuals) - width, 1))

    def interval(k: int) -> Interval:
        parameter, value = model.parameters[k], float(model.values[k])
        half_width = math.hypot(wide * deviation[k], 0.0 if bias is None else bias[k], parameter.tolerance)
        low, high = max(parameter.low, value - half_width), min(parameter.high, value + half_width)
        return Interval(parameter.name, value, low, high, parameter.unit)

    return [[interval(k) for k in model.indices(place)] for place in range(len(model.terms))]


def grid_intervals(fitted: Fitted, data: Data) -> dict[int, tuple[float, float]]:
    """Ends of the grid values that fit as well, by the index of each parameter that has a grid.

    Such a parameter has local minima, and derivatives tell only of its own. A value fits as well if the
    deviance, simulated there with the others at their linearised optimum, rises by less than WORSE. It stands
    for what is nearer to it than to the grid's other values.
    """
    model, found = fitted.model, dict[int, tuple[float, float]]()
    worst = fitted.deviance + WORSE * data.replicate_count
    for k, parameter in enumerate(model.parameters):
        if not parameter.grid:
            continue
        models = at_grid(model, k)
        tries = evaluate(models, [fitted.jacobian] * len(models), data)
        damping = 1e-6 * fitted.residuals.size / model.reach**2
        alike = []
        for each in tries:
            held = step_bounds(replace(each.model, fixed=model.fixed | {k}))
            alike.append(linearised_optimum(each.residuals, each.jacobian, *held, damping)[1] < worst)
        grid = np.array([parameter.low, *parameter.grid, parameter.high])
        ends = 0.5 * (grid[1:] + grid[:-1])
        if any(alike):
            low, high = np.flatnonzero(alike)[[0, -1]]
            found[k] = float(ends[low]), float(ends[high + 1])
    return found


@dataclass(frozen=True, eq=False)
class Scored:
    """Evaluation of two models on some runs.

    Attributes:
        before, after: without and with effects, predicted by the models alone.
        noise_floor: see ``noise_floor``.
        gain: gain of the log score, see ``log_score_gain``; None without effects.
        repeatability: see ``repeatability``.
        by_chance: whether strokes fail by chance; errors may then remain as large as the repeatability.
    """

    before: PredictionError
    after: PredictionError
    noise_floor: PredictionError
    gain: Interval | None = None
    repeatability: PredictionError = field(default_factory=PredictionError)
    by_chance: bool = False

    @property
    def quiet(self) -> bool:
        """Whether the remaining error is within the noise of the fixes and the discretisation error."""
        count = self.after.count
        over = max(NEAR_FLOOR, math.sqrt(1.0 + CHANCE * math.sqrt(2.0 / max(count, 1))))
        pairs = zip(self.after.pair, self.noise_floor.pair, self.before.pair, strict=True)
        return not count or all(
            left <= math.hypot(over * noise, INEXACT * plain) for left, noise, plain in pairs
        )

    @property
    def helped(self) -> bool:
        """Whether the log score gain is beyond chance and no error grows beyond the noise of the fixes."""
        if self.gain is None:
            return False
        few = self.by_chance or self.after.count < FEW_PERIODS
        sure = few and self.gain.value * self.after.count > SURE_NATS
        if not (self.gain.low > 0.0 or sure):
            return False
        varying = self.repeatability if self.by_chance else PredictionError(0.0, 0.0)
        pairs = (each.pair for each in (self.before, self.after, self.noise_floor, varying))
        return all(
            after <= max(before, NEAR_FLOOR * math.hypot(floor, spread))
            for before, after, floor, spread in zip(*pairs, strict=True)
        )

    def as_json(self) -> dict[str, Any]:
        """The key ``train`` of the command ``identify``; the key ``test`` has more."""
        gain = self.gain
        return {
            "before": self.before.as_json(),
            "after": self.after.as_json(),
            "noise_floor": self.noise_floor.as_json(),
            "log_score_gain": gain and {"value": gain.value, "interval": list(gain.interval)},
            "repeatability": self.repeatability.as_json(),
        }


def scored(
    found: Found,
    swims: Sequence[Segments],
    before: Sequence[Rollout],
    after: Sequence[Rollout],
    raw: tuple[Sequence[Segments], Sequence[Segments]] | None = None,
) -> Scored:
    """Evaluate both models on runs by their rollouts; replicates with the same noise count once.

    Args:
        raw: the training runs and ``swims`` with all their fixes, where those that jumped were taken out;
            ``before`` is compared with these. None if no fix was taken out.
    """
    train = found.data.swims
    raw = raw or (train, swims)
    errors = [PredictionError.of(prediction_errors(*pair)) for pair in ((before, raw[1]), (after, swims))]
    one_noise = replicate_count(swims)
    first, second = (replace(error, count=error.count // one_noise) for error in errors)
    floor = noise_floor(swims, fix_noise([*train]) or fix_noise(swims) or found.fitted.model.noise.fix)
    gain = None
    if found.fitted.model.terms:
        gain = log_score_gain(found, swims, before, after, raw)
    chance = found.misfires is not None
    return Scored(first, second, floor, gain, repeatability(after, swims, floor), chance)


def verdict_of(found: Found, trained: Scored, tested: Scored) -> str:
    """The verdict: effects must help on held-out runs; the error that remains, also on the training runs,
    decides the rest. Limbs that misfire by chance are partly explained at best.
    """
    quiet = trained.quiet and tested.quiet
    if not found.fitted.model.terms:
        return NOTHING if quiet else UNEXPLAINED
    if not tested.helped:
        return UNEXPLAINED
    if not quiet or tested.by_chance:
        return PARTLY
    return FOUND_LAW if any(term.name == "law" for term in found.fitted.model.terms) else FOUND
