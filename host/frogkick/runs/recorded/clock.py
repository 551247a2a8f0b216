"""Estimates the stroke clock of a recorded run: the constant period of its strokes, which is not recorded.

Each row has the label of the action at that time. A label that first occurs in row i was set between rows
i-1 and i, so each change of label bounds phase + k * period by two time stamps. Half the period fits these
bounds too, and sometimes twice the period. The robot's speed resolves this: it has its fundamental at
1 / period and nothing below.

The search covers all periods that the robot allows, with slips (see ``periods``). The labels' bounds leave a
small polygon of (period, phases): its centroid is the estimate and its spread the uncertainty (uniform).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.core.poses import body_from_world
from frogkick.runs.recorded.periods import DETREND_S, SAME, WINDOW_S, Evidence, Fit, search

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
    """Stroke clock: decision k is at phase_s + k * period_s, until it slips."""

    # period_s, phase_s: s; the phase is that of the first label that fires
    period_s: float
    phase_s: float
    # period_std_s, phase_std_s: standard uncertainty, s
    period_std_s: float
    phase_std_s: float
    # largest range of the phases within the labels' bounds, s; negative: size of the contradiction
    slack_s: float
    resultant: float  # mean resultant length of the changes of label about the clock, 0 to 1
    labels: int  # number of these changes
    motion_power: float  # power of the speed's fundamental at this period over its noise; about 1 without one
    # other_period_s, other_resultant: the next best period; NaN if there is none
    other_period_s: float
    other_resultant: float
    margin: float  # nats by which the period is better than that one; infinite if there is none
    slips: tuple[Slip, ...] = ()  # in order
    # (m,) s, of all decisions until the end of the run
    starts_s: Float64 = field(default_factory=lambda: np.empty(0))
    problem: str = ""  # why the clock is not usable, or ""


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
        motion: (k,) times, s, and (k,) forward speeds, m/s, between frames; see ``forward_speed``.
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
    margin = best.score - rival.score if rival is not None else np.inf
    starts, slips = _starts(seen, best, period, phases)
    voting = int(seen.votes.sum())
    return Clock(
        period_s=period,
        phase_s=float(starts[0]),
        period_std_s=std,
        phase_std_s=phase_std,
        slack_s=slack,
        resultant=best.resultant,
        labels=voting,
        motion_power=power,
        other_period_s=rival.period_s if rival is not None else np.nan,
        other_resultant=rival.resultant if rival is not None else np.nan,
        margin=float(margin),
        slips=slips,
        starts_s=starts,
        problem=_problem(seen, best, rival, power, float(margin), off, slack),
    )


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


def forward_speed(time_s: Float64, pose: Float64, usable: Bool) -> tuple[Float64, Float64, Float64]:
    """Start and end (s) of all pairs of successive usable frames, and (k,) speed along the heading, m/s."""
    rows = np.flatnonzero(usable)
    start, end = time_s[rows[:-1]], time_s[rows[1:]]
    step = np.diff(pose[rows], axis=0)
    along = body_from_world(pose[rows[1:], 2], step)[:, 0]
    return start, end, along / np.maximum(end - start, 1e-3)


def motion_lag(time_s: Float64, pose: Float64, usable: Bool, fired_s: Float64) -> float | None:
    """Time from a label to the onset of forward motion, s; None with too few frames.

    The forward speed around all strokes is fitted by a line (the glide) plus a ramp from the onset on,
    averaged over the interval of each pair of frames. The result is uncertain: other windows and glide models
    gave 0.05 to 0.12 s for the same run. Stroke times come from the labels alone.

    Args:
        time_s, pose, usable: the frames, (n,), (n, 3), (n,).
        fired_s: (k,) s, start of the actions that fire.
    """
    if usable.sum() < 2 or not fired_s.size:
        return None
    start, end, speed = forward_speed(time_s, pose, usable)
    nearest = fired_s[np.abs(0.5 * (start + end)[:, None] - fired_s[None, :]).argmin(axis=1)]
    a, b = start - nearest, end - nearest
    used = (a > -0.25) & (b < 0.20) & (b - a < 0.15)
    if used.sum() < 20:
        return None
    a, b, speed = a[used], b[used], speed[used]
    candidates = np.arange(-0.05, 0.15, 0.002)
    errors = []
    for onset in candidates:
        ramp = (np.maximum(b - onset, 0.0) ** 2 - np.maximum(a - onset, 0.0) ** 2) / (2.0 * (b - a))
        design = np.column_stack([np.ones_like(ramp), 0.5 * (a + b), ramp])
        errors.append(float(((design @ np.linalg.lstsq(design, speed, rcond=None)[0] - speed) ** 2).sum()))
    return float(candidates[int(np.argmin(errors))])
