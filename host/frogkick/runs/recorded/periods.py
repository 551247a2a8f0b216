"""Searches the periods of a stroke clock by its labels and the motion together, with slips.

The score in nats has three parts: labels as von Mises about the clock, log(period) for each of them (a
shorter period would have allowed more changes), and the speed's fundamental as a sinusoid of known size in
white noise. A slip, from which labels and speed have another phase, costs ``SLIP`` nats.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from frogkick.core.arrays import Bool, Float64

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
    resultant: float  # see Clock
    # (first time, last time, phase) of each, s, with the events at its ends
    pieces: tuple[tuple[float, float, float], ...]


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
