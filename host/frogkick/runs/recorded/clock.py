"""Estimates the stroke clock of a recorded run: the constant period of its strokes, which is not recorded.

Each row has the label of the action at that time. A label that first occurs in row i was set between rows
i-1 and i, so each change of label bounds phase + k * period by two time stamps. Half the period fits these
bounds too, and sometimes twice the period. The robot's speed resolves this: it has its fundamental at
1 / period and nothing below.

The search covers all periods that the robot allows, by labels and motion together. The score in nats has
three parts: labels as von Mises about the clock, log(period) for each of them (a shorter period would have
allowed more changes), and the speed's fundamental as a sinusoid of known size in white noise. A slip, from
which labels and speed have another phase, costs ``SLIP`` nats. The labels' bounds leave a small polygon of
(period, phases): its centroid is the estimate and its spread the uncertainty (uniform).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from frogkick.core.arrays import Bool, Float64, Int64

Complex = NDArray[np.complex128]

LABEL, MOTION, SLIP = 30.0, 8.0, 12.0
"""Concentration of a label about the clock; the fundamental's share of the speed's standard deviation (0.4 of
1 on the published runs) times the frames of a window (20); nats that a slip must be worth."""

LABEL_ROOM_S = 0.25
"""Labels with wider bounds limit the clock but do not count in the score."""

WINDOW_S, WINDOWS_MOST, DETREND_S = 1.5, 80, 3.0
BLOCK_S = (8.0, 30.0)
"""Shortest and longest piece of a run with a constant clock in the first search."""

CANDIDATES, SAME = 5, 0.03
"""Number of periods in the second search, and relative difference up to which two periods are the same."""

RESULTANT_LEAST, SLACK_LEAST_S, NATS_LEAST, POWER_LEAST, OFF_S, OFF_SHARE = 0.9, -0.03, 5.0, 8.0, 0.1, 0.2
"""Limits of a usable clock: mean resultant length, slack of its labels (s), nats over the next best period,
power of the fundamental over noise if there are few labels; and a label is off beyond OFF_S (s), of which
there may be a share of OFF_SHARE."""

SLIP_EVERY_S = 15.0
"""Shortest mean time between slips of a usable clock."""


@dataclass(frozen=True)
class Slip:
    """A change of the clock's phase."""

    time_s: float  # the last decision before it
    until_s: float  # the first decision after it
    jump_s: float  # change of the phase, within half a period; positive: later


@dataclass(frozen=True)
class Clock:
    """Stroke clock: decisions are a period apart from the first label that fires on, until it slips."""

    period_s: float
    starts_s: Float64  # (m,) s, of all decisions until the end of the run
    slips: tuple[Slip, ...]  # in order
    problem: str  # why the clock is not usable, or ""
    evidence: dict[str, float]  # for ``RunLog.measured``, without unknown values


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence for a clock: bounds of the labels, and speed without its slow part."""

    # earliest, latest: (n,) s, bounds of the changes of label; earliest may be -inf
    earliest: Float64
    latest: Float64
    # time_s, speed: (k,) of pairs of frames, speed over its standard deviation; empty without motion
    time_s: Float64
    speed: Float64
    end_s: float  # s, of the run

    @property
    def votes(self) -> Bool:
        """(n,) changes with narrow bounds, which count in the score."""
        return np.asarray(self.latest - self.earliest <= LABEL_ROOM_S)

    @property
    def anchor(self) -> Float64:
        """(v,) s, centres of the bounds of these changes."""
        return np.asarray(0.5 * (self.earliest + self.latest)[self.votes])

    @property
    def start_s(self) -> float:
        """Time of the first row that has the first label that fires, s."""
        return float(self.latest[0])


@dataclass(frozen=True, eq=False)
class Fit:
    """A period with the pieces between its slips."""

    period_s: float
    score: float  # nats
    resultant: float  # mean resultant length, 0 to 1
    # (first time, last time, phase) of each, s, with the events at its ends
    pieces: tuple[tuple[float, float, float], ...]


def estimate_clock(
    time_s: Float64,
    action: Int64,
    trusted: Bool,
    rest: int,
    limits_s: tuple[float, float],
    motion: tuple[Float64, Float64] | None = None,
) -> Clock | None:
    """Estimate the clock; None if no label fires.

    Args:
        time_s: (n,) s.
        action: (n,) label of each row.
        trusted: (n,) rows with a credible time stamp.
        rest: label of the action that fires nothing.
        limits_s: shortest and longest period that the robot allows.
        motion: (k,) times, s, and (k,) forward speeds, m/s, between frames.
    """
    firing = np.flatnonzero(action != rest)
    if not firing.size:
        return None
    seen = _evidence(time_s, action, trusted, int(firing[0]), motion)
    fits = search(seen, limits_s)
    best = fits[0]
    rival = next((fit for fit in fits if abs(fit.period_s / best.period_s - 1.0) > SAME), None)
    power = _power(seen, best)
    period, std, phases, phase_std, slack, off = _polygon(seen, best, limits_s)
    margin = float(best.score - rival.score) if rival is not None else np.inf
    starts, slips = _starts(seen, best, period, phases)
    problem = _problem(seen, best, rival, power, margin, off, slack)
    evidence = {
        "period_std_s": std,  # standard uncertainty, also of the phase
        "phase_s": starts[0],  # of the first label that fires
        "phase_std_s": phase_std,
        # largest range of the phases within the labels' bounds; negative: size of the contradiction
        "clock_slack_s": slack,
        "clock_resultant": best.resultant,  # mean resultant length of the changes of label about the clock
        "clock_labels": seen.votes.sum(),  # number of these changes
        # power of the speed's fundamental at this period over its noise; about 1 without one
        "clock_motion_power": power,
        # of the next best period, and nats by which the period is better
        "clock_other_period_s": rival.period_s if rival is not None else np.nan,
        "clock_other_resultant": rival.resultant if rival is not None else np.nan,
        "clock_margin_nats": margin,
        "clock_slips": len(slips),
        "clock_unusable": bool(problem),
    }
    known = {name: float(value) for name, value in evidence.items() if np.isfinite(value)}
    return Clock(period, starts, slips, problem, known)


def _evidence(
    time_s: Float64,
    action: Int64,
    trusted: Bool,
    firing: int,
    motion: tuple[Float64, Float64] | None,
) -> Evidence:
    change = np.flatnonzero(np.diff(action) != 0) + 1
    change = change[change >= firing]
    if firing == 0:
        change = np.concatenate([[0], change])
    latest = time_s[change]
    # A time stamp of the backlog is no lower bound.
    before = np.maximum(change - 1, 0)
    earliest = np.where(trusted[before] & (change > 0), time_s[before], -np.inf)
    if np.isneginf(earliest).all():
        earliest[0] = latest[0] - 0.1
    clock_s, speed = np.empty(0), np.empty(0)
    if motion is not None and (used := motion[0] >= latest[0] - 0.2).sum() > 10:
        between_s, fast = motion[0][used], motion[1][used]
        slow = np.array([fast[np.abs(between_s - at) < 0.5 * DETREND_S].mean() for at in between_s])
        fast = np.clip(fast - slow, -0.2, 0.2)
        size = float(fast.std())
        if size > 2e-3:  # without strokes the speed hardly changes
            clock_s, speed = between_s, fast / size
    return Evidence(earliest, latest, clock_s, speed, float(time_s[-1]))


def _power(seen: Evidence, fit: Fit) -> float:
    """Power of the speed's fundamental at a period over that of white noise of the same size."""
    if not len(seen.speed):
        return 0.0
    phase_s = np.select(
        [seen.time_s <= last for _, last, _ in fit.pieces],
        [np.full(len(seen.time_s), phase) for *_, phase in fit.pieces],
        fit.pieces[-1][2],
    )
    turn = np.exp(-2j * np.pi * (seen.time_s - phase_s) / fit.period_s)
    return float(np.abs(turn @ seen.speed) ** 2 / len(seen.speed))


def _polygon(
    seen: Evidence, fit: Fit, limits_s: tuple[float, float]
) -> tuple[float, float, list[float], float, float, int]:
    """Period and its std, phase of each piece, std of the first phase, slack (all s); labels that are off."""
    length_s = max(seen.end_s - seen.start_s, 1.0)
    phases = [phase for *_, phase in fit.pieces]
    sigma = np.sqrt(6.0 / max(_power(seen, fit), 0.1)) / (2.0 * np.pi * length_s) * fit.period_s**2
    if len(seen.anchor) < 3:
        return fit.period_s, float(sigma), phases, 0.05, 0.0, 0
    half = max(0.3 * fit.period_s**2 / length_s, 5e-3)
    step = min(1e-4, 2e-3 * fit.period_s**2 / length_s)
    periods = fit.period_s + step * np.arange(-round(half / step), round(half / step) + 1)
    periods = periods[(periods >= limits_s[0] - step) & (periods <= limits_s[1] + step)]
    rooms, middles, off = [], [], 0
    earliest, latest = seen.earliest[seen.votes], seen.latest[seen.votes]
    for index, (first, last, phase) in enumerate(fit.pieces):
        count = np.round((seen.anchor - phase) / fit.period_s)
        at = phase + count * fit.period_s
        here = (seen.anchor >= first) & (seen.anchor <= last)
        away = here & ((at < earliest - OFF_S) | (at > latest + OFF_S))
        off += int(away.sum())
        here &= ~away
        if here.any():
            high = (latest[here] - count[here] * periods[:, None]).min(axis=1)
            low = (earliest[here] - count[here] * periods[:, None]).max(axis=1)
            rooms.append(high - low)
            middles.append((index, 0.5 * (high + low)))
    if not rooms:
        return fit.period_s, float(sigma), phases, 0.05, -OFF_S, off
    room = np.min(rooms, axis=0)
    if room.max() <= 0.0:
        # No constant clock fits: take the one with the smallest contradiction.
        weight = np.zeros(len(room))
        weight[int(room.argmax())] = 1.0
        least = float(-room.max())
    else:
        weight = np.where(_largest_piece(room), np.prod(np.maximum(rooms, 0.0), axis=0), 0.0)
        weight /= weight.sum()
        least = 0.0
    period = float(weight @ periods)
    for index, middle in middles:
        phases[index] = float(weight @ middle)
    # Within the polygon the phase is uniform at each period: its variance is room^2 / 12 there.
    first_middle = middles[0][1]
    spread = weight @ ((first_middle - weight @ first_middle) ** 2 + np.maximum(rooms[0], 0.0) ** 2 / 12.0)
    std = float(np.sqrt(weight @ (periods - period) ** 2))
    return period, max(std, least), phases, max(float(np.sqrt(spread)), least), float(room.max()), off


def _largest_piece(room: Float64) -> Bool:
    """The contiguous range of periods with the largest area of room."""
    inside = room > 0.0
    piece = np.cumsum(np.concatenate([[False], np.diff(inside.astype(int)) != 0]))
    area = np.bincount(piece, weights=np.where(inside, room, 0.0))
    return np.asarray(piece == area.argmax())


def _starts(seen: Evidence, fit: Fit, period: float, phases: list[float]) -> tuple[Float64, tuple[Slip, ...]]:
    """(m,) s, all decisions; and the slips between pieces."""
    first_s = float(seen.anchor[0]) if len(seen.anchor) and seen.votes[0] else None
    if first_s is not None:
        begin = phases[0] + period * np.round((first_s - phases[0]) / period)
    else:
        begin = phases[0] + period * np.floor((seen.start_s - phases[0]) / period + 0.05)
    starts, slips = [], []
    now = float(begin)
    for index in range(len(fit.pieces) - 1):
        before, after = phases[index], phases[index + 1]
        last, first = _switch(seen, fit, index, period, phases, now)
        starts.append(now + period * np.arange(round((last - now) / period) + 1))
        jump = (after - before + 0.5 * period) % period - 0.5 * period
        slips.append(Slip(last, first, float(jump)))
        now = first
    starts.append(now + period * np.arange(max(int(np.floor((seen.end_s - now) / period)), 0) + 1))
    return np.concatenate(starts), tuple(slips)


def _switch(
    seen: Evidence, fit: Fit, index: int, period: float, phases: list[float], now: float
) -> tuple[float, float]:
    """Last decision of a piece and first decision of the next, where the change fits the speed best."""
    (_, last, _), (first, _, _) = fit.pieces[index : index + 2]
    before, after = phases[index], phases[index + 1]
    reach = max(WINDOW_S, period)
    known = seen.anchor[seen.anchor <= last]
    low = max(last - reach, float(known[-1]) - 0.3 * period if known.size else now)
    known = seen.anchor[seen.anchor >= first]
    high = min(first + reach, float(known[0]) + 0.3 * period if known.size else np.inf)
    counts = np.arange(np.ceil((low - now) / period), np.floor((high - now) / period) + 1)
    candidates: list[tuple[float, float]] = []
    for at in now + period * np.maximum(counts if counts.size else np.zeros(1), 0.0):
        follows = after + period * np.ceil((at + 0.5 * period - after) / period)
        if follows <= high or not candidates:
            candidates.append((float(at), float(follows)))
    far = np.all([np.abs(seen.time_s - end) > 2.0 * period for _, end, _ in fit.pieces[:-1]], axis=0)
    if not far.sum() > 50 or len(candidates) == 1:
        return candidates[len(candidates) // 2]
    own = np.select(
        [seen.time_s <= end for _, end, _ in fit.pieces[:-1]],
        [np.full(len(seen.time_s), phase) for phase in phases[:-1]],
        phases[-1],
    )
    bins = 12
    phase = ((seen.time_s[far] - own[far]) / period % 1.0 * bins).astype(int)
    counted = np.maximum(np.bincount(phase, minlength=bins), 1)
    surge = np.bincount(phase, weights=seen.speed[far], minlength=bins) / counted
    near = (seen.time_s >= low - period) & (seen.time_s <= high + period)
    misses = []
    for _, follows in candidates:
        base = np.where(seen.time_s[near] < follows, before, after)
        shown = surge[((seen.time_s[near] - base) / period % 1.0 * bins).astype(int) % bins]
        misses.append(float(((seen.speed[near] - shown) ** 2).sum()))
    return candidates[int(np.argmin(misses))]


def _problem(
    seen: Evidence, fit: Fit, rival: Fit | None, power: float, margin: float, off: int, slack: float
) -> str:
    """Why a clock is not usable, or ""."""
    votes, slips = len(seen.anchor), len(fit.pieces) - 1
    if votes - slips < 3 and power < POWER_LEAST:
        return f"{votes} changes of action without a rhythm of the motion do not determine the period"
    if votes - slips >= 3 and fit.resultant < RESULTANT_LEAST:
        return (
            f"no constant period fits its labels: the best, {fit.period_s:.3f} s, has a mean resultant "
            f"length of {fit.resultant:.2f} over {votes} changes of action, {RESULTANT_LEAST:g} is needed"
        )
    if slack < SLACK_LEAST_S:
        return (
            f"its labels contradict every constant clock near {fit.period_s:.3f} s by {-slack:.3f} s or more"
        )
    if off > OFF_SHARE * votes:
        return f"{off} of {votes} changes of action are off the clock of {fit.period_s:.3f} s"
    if slips > max(seen.end_s - seen.start_s, SLIP_EVERY_S) / SLIP_EVERY_S:
        return f"the clock of {fit.period_s:.3f} s would slip {slips} times in {seen.end_s:.0f} s"
    if rival is not None and margin < NATS_LEAST:
        return (
            f"a period of {fit.period_s:.3f} s and one of {rival.period_s:.3f} s fit labels and motion alike"
        )
    return ""


def search(seen: Evidence, limits_s: tuple[float, float]) -> list[Fit]:
    """Candidate periods, best first."""
    length_s = max(seen.end_s - seen.start_s, 1.0)
    block_s = float(np.clip(length_s / 4.0, *BLOCK_S))
    high, low = 1.0 / limits_s[0], 1.0 / limits_s[1]
    rates = np.arange(low, high, 0.1 / block_s)
    rough = np.zeros(len(rates))
    edges = np.arange(seen.start_s - 1.0, seen.end_s + block_s, block_s)
    for first, last in pairwise(edges):
        labels, speed = _phasors(seen, rates, [first, last])
        rough += LABEL * np.abs(labels[:, 0]) + MOTION * np.abs(speed[:, 0])
    rough -= len(seen.anchor) * np.log(rates)
    # Also coherent over the complete run, for few labels in many blocks.
    labels, speed = _phasors(seen, rates, [-np.inf, np.inf])
    whole = LABEL * np.abs(labels[:, 0]) + MOTION * np.abs(speed[:, 0]) - len(seen.anchor) * np.log(rates)
    tops = {place for score in (rough, whole) for place in _peaks(score)[:CANDIDATES]}
    fits = []
    for place in tops:
        near = rates[place] + np.arange(-0.4 / block_s, 0.4 / block_s, 0.05 / length_s)
        near = near[(near >= low) & (near <= high)]
        if len(near):
            fits.append(_piecewise(seen, near))
    return sorted(fits, key=lambda fit: -fit.score)


def _peaks(score: Float64) -> list[int]:
    padded = np.concatenate([[-np.inf], score, [-np.inf]])
    inside = padded[1:-1]
    top = np.flatnonzero((inside >= padded[:-2]) & (inside > padded[2:]))
    return [int(place) for place in top[np.argsort(-score[top])]]


def _phasors(seen: Evidence, rates: Float64, edges: list[float] | Float64) -> tuple[Complex, Complex]:
    """(r, pieces) sums of the labels' unit phasors, and of the speed's, whose windows are at most about 1."""
    sums = np.zeros((2, len(rates), len(edges) - 1), dtype=np.complex128)
    window = np.searchsorted(seen.time_s, edges)
    per_window = max(len(seen.time_s) * WINDOW_S / max(seen.end_s - seen.start_s, 1.0), 4.0)
    for piece, (first, last) in enumerate(pairwise(edges)):
        anchor = seen.anchor[(seen.anchor >= first) & (seen.anchor < last)]
        sums[0, :, piece] = np.exp(-2j * np.pi * np.outer(rates, anchor)).sum(axis=1)
        rows = slice(window[piece], window[piece + 1])
        turned = np.exp(-2j * np.pi * np.outer(rates, seen.time_s[rows]))
        sums[1, :, piece] = turned @ seen.speed[rows] * (np.sqrt(2.0) / per_window)
    return sums[0], sums[1]


def _piecewise(seen: Evidence, rates: Float64) -> Fit:
    """The best of some rates, each with its best slips, by dynamic programming over events."""
    window_s = max(WINDOW_S, (seen.end_s - seen.start_s) / WINDOWS_MOST)
    edges = np.arange(seen.start_s - 1.0, seen.end_s + window_s, window_s)
    _, speed = _phasors(seen, rates, edges)
    middle = 0.5 * (edges[:-1] + edges[1:])
    labels = np.exp(-2j * np.pi * np.outer(rates, seen.anchor))
    order = np.argsort(np.concatenate([seen.anchor, middle]), kind="stable")
    times = np.concatenate([seen.anchor, middle])[order]
    is_label = (np.arange(len(order)) < len(seen.anchor))[order]
    # The lag of the motion after the labels is unknown, and the same in all pieces.
    lags = np.exp(2j * np.pi * np.arange(12) / 12)
    if not len(seen.speed):
        lags = lags[:1]
    labels_sum = np.concatenate([LABEL * labels, np.zeros_like(speed)], axis=1)[:, order]
    speed_sum = np.concatenate([np.zeros_like(labels), MOTION * speed], axis=1)[:, order]
    total = labels_sum[:, None, :] + lags[None, :, None] * speed_sum[:, None, :]
    sums = np.concatenate([np.zeros((*total.shape[:2], 1)), np.cumsum(total, axis=2)], axis=2)
    count = len(order)
    best = np.full((count + 1, *total.shape[:2]), -np.inf)
    best[0] = SLIP
    back = np.zeros((count + 1, *total.shape[:2]), dtype=np.int64)
    for last in range(1, count + 1):
        for first in range(last):
            value = best[first] - SLIP + np.abs(sums[:, :, last] - sums[:, :, first])
            better = value > best[last]
            best[last] = np.where(better, value, best[last])
            back[last] = np.where(better, first, back[last])
    score = best[count] - len(seen.anchor) * np.log(rates)[:, None]
    rate, lag = np.unravel_index(int(score.argmax()), score.shape)
    period = float(1.0 / rates[rate])
    pieces, resultant, last = [], 0.0, count
    while last > 0:
        first = int(back[last, rate, lag])
        turn = sums[rate, lag, last] - sums[rate, lag, first]
        pieces.append((times[first], times[last - 1], float(-np.angle(turn) * period / (2.0 * np.pi))))
        inside = is_label[first:last]
        resultant += abs(labels_sum[rate, first:last][inside].sum()) / LABEL
        last = first
    votes = len(seen.anchor)
    return Fit(period, float(score.max()), resultant / votes if votes else 0.0, tuple(pieces[::-1]))
