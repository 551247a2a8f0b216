"""The second clock: strokes run on their own constant period, seen through the labels of the frames.

A label that first stands in row i was given after row i-1 was logged and not after row i. So every change
of label bounds phase + k * period by two stamps, and all changes together leave a small polygon of (period,
phase). Its centroid is the estimate, its spread the uncertainty (uniform within the polygon).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

# Nominal 1.5 s; a run of another period than this window fits no constant clock of this robot.
PERIOD_MIN_S, PERIOD_MAX_S, PERIOD_STEP_S = 1.30, 1.60, 1e-4
# Where a run has too few changes of label to tell: what the published runs show, and their spread.
PERIOD_ASSUMED_S, PERIOD_ASSUMED_STD_S = 1.425, 0.0015
CHANGES_MIN = 3


@dataclass(frozen=True)
class Clock:
    """Stroke clock: decision k falls at phase_s + k * period_s.

    Args:
        period_s, phase_s: s; the phase is that of the first label that fires.
        period_std_s, phase_std_s: standard uncertainty, s.
        slack_s: widest room that the labels leave for the phase, s; negative: by how much they contradict a
            constant clock.
        assumed: the run shows too few changes of label, so the period is that of the published runs.
    """

    period_s: float
    phase_s: float
    period_std_s: float
    phase_std_s: float
    slack_s: float
    assumed: bool


def estimate_clock(
    time_s: Float64, action: NDArray[np.int64], trusted: NDArray[np.bool_], rest: int
) -> Clock | None:
    """Period and phase from the label changes, or None where no label fires.

    Args:
        time_s: (n,) s.
        action: (n,) label of each row.
        trusted: (n,) rows whose stamp is credible.
        rest: the label of the action that fires nothing.
    """
    change = np.flatnonzero(np.diff(action) != 0) + 1
    firing = np.flatnonzero(action != rest)
    if not firing.size:
        return None
    if firing[0] == 0:
        change = np.concatenate([[0], change])
    latest = time_s[change]
    # A stamp of the backlog is no bound: the label is then only known not to be later than its row.
    before = np.maximum(change - 1, 0)
    earliest = np.where(trusted[before] & (change > 0), time_s[before], -np.inf)
    if np.isneginf(earliest).all():
        earliest[0] = latest[0] - 0.1
    known = np.isfinite(earliest)
    assumed = known.sum() < CHANGES_MIN
    periods = np.arange(PERIOD_MIN_S, PERIOD_MAX_S, PERIOD_STEP_S)
    if assumed:
        periods = PERIOD_ASSUMED_S + PERIOD_ASSUMED_STD_S * np.sqrt(3.0) * np.linspace(-1.0, 1.0, 31)
    anchor = np.where(known, 0.5 * (earliest + latest), latest)
    count = np.round((anchor - anchor[0])[None, :] / periods[:, None])
    high = (latest - count * periods[:, None]).min(axis=1)
    low = (earliest - count * periods[:, None]).max(axis=1)
    room = high - low
    if room.max() <= 0.0:
        # No constant clock fits: take the one that contradicts the labels least, and say by how much.
        best = int(room.argmax())
        misfit = float(-room[best])
        return Clock(
            float(periods[best]), float(0.5 * (high[best] + low[best])), misfit, misfit, -misfit, False
        )
    weight = np.where(_largest_piece(room), np.maximum(room, 0.0), 0.0)
    weight /= weight.sum()
    middle = 0.5 * (high + low)
    period, phase = float(weight @ periods), float(weight @ middle)
    # Within the polygon the phase is uniform at each period: its variance is room^2 / 12 there.
    spread = weight @ ((middle - phase) ** 2 + np.maximum(room, 0.0) ** 2 / 12.0)
    return Clock(
        period_s=period,
        phase_s=phase,
        period_std_s=float(np.sqrt(weight @ (periods - period) ** 2)),
        phase_std_s=float(np.sqrt(spread)),
        slack_s=float(room.max()),
        assumed=bool(assumed),
    )


def _largest_piece(room: Float64) -> NDArray[np.bool_]:
    """The contiguous range of periods with the largest area of room."""
    inside = room > 0.0
    piece = np.cumsum(np.concatenate([[False], np.diff(inside.astype(int)) != 0]))
    area = np.bincount(piece, weights=np.where(inside, room, 0.0))
    return np.asarray(piece == area.argmax())


def motion_lag(time_s: Float64, pose: Float64, usable: NDArray[np.bool_], fired_s: Float64) -> float | None:
    """Time from a label to the onset of forward motion, s; None where too few frames show it.

    The forward speed around all firings is fitted by a line (the glide) plus a ramp from the onset on; each
    pair of frames counts with the mean of that over its own interval, so that their spacing does
    not smear the onset.

    A weak figure: of eight windows and glide models tried on the published runs, the answers for one run
    spread over 0.05 to 0.12 s, and this one was kept because its onsets agree best between runs. Do not
    place strokes by it; their times come from the labels alone.

    Args:
        time_s, pose, usable: the frames, (n,), (n,3), (n,).
        fired_s: (k,) s, when an action that fires began.
    """
    rows = np.flatnonzero(usable)
    if rows.size < 2 or not fired_s.size:
        return None
    start, end = time_s[rows[:-1]], time_s[rows[1:]]
    step = np.diff(pose[rows], axis=0)
    heading = pose[rows[1:], 2]
    speed = (step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)) / (end - start)
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
