"""Fixes that jump by chance, recognised by their neighbours alone, without a model.

Each fix is compared with the cubic through the two fixes before and the two after it, and with the line
through the two on either side: at a step, where the camera was moved, a fix agrees with one side. The
farthest fix is removed first, then the others are compared again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.identification.segments import Segments
from frogkick.identification.terms import Interval, Term, law_term

FAR_SIGMA = 6.0  # a fix is far off if its distance is more than this many robust standard deviations

FIXES_LEAST, SHARE_LEAST = 5, 0.004
"""Smallest number of jumps, and their smallest share of the fixes: a single jump is an accident."""

APART_S = 0.6  # neighbours that span more time are not compared


@dataclass(frozen=True, eq=False)
class Jumps:
    """How often fixes jump and how far."""

    chance: Interval  # probability that a fix jumps
    size: Interval  # root mean square distance

    @property
    def term(self) -> Term:
        """The law."""
        turn = "6.283185307 * chance / jumping"
        declared = {
            "jumping": {"unit": "1", "low": 1e-4, "high": 1.0, "nominal": 1e-4, "step": 0.1},
            "size": {"unit": "m", "low": 0.0, "high": 1.0, "nominal": 0.0, "step": 1e-3},
        }
        table = {
            "on": "fix",
            "x_m": f"size * (chance < jumping) * cos({turn})",
            "y_m": f"size * (chance < jumping) * sin({turn})",
        }
        return law_term("fixes that jump", table, declared, (self.chance.value, self.size.value))


def jumps_of(swims: Sequence[Segments]) -> Jumps | None:
    """How often the fixes of runs jump; None if they do not."""
    from scipy import stats

    found = [jumped(swim) for swim in swims]
    sizes = np.concatenate([size for _, size in found])
    count = sum(len(swim.time_s) for swim in swims)
    if len(sizes) < max(FIXES_LEAST, SHARE_LEAST * count):
        return None
    low, high = stats.beta.interval(0.95, len(sizes) + 0.5, count - len(sizes) + 0.5)
    squares = sizes**2
    size = float(np.sqrt(squares.mean()))
    spread = float(1.96 * squares.std() / np.sqrt(len(sizes)) / (2.0 * size)) + 2e-4
    return Jumps(
        Interval("jumping", len(sizes) / count, float(low), float(high), "1"),
        Interval("size", size, max(size - spread, 0.0), size + spread, "m"),
    )


def without_jumps(swims: Sequence[Segments]) -> list[Segments]:
    """The runs without the fixes that jumped."""
    kept = []
    for swim in swims:
        stays = np.ones(len(swim.time_s), dtype=bool)
        stays[jumped(swim)[0]] = False
        kept.append(swim.with_fixes(stays))
    return kept


def jumped(swim: Segments) -> tuple[Int64, Float64]:
    """(k,) indices of the fixes of a run that jumped, and (k,) their distances, m."""
    times, places = swim.time_s, swim.pose[:, :2]
    kept, out = np.arange(len(times)), list[int]()
    while len(kept) > 8:
        off = _off(times[kept], places[kept])
        sigma = 1.4826 * np.median(np.abs(off), axis=0) + 1e-6
        far = np.hypot(*(off / sigma).T)
        beside = np.lib.stride_tricks.sliding_window_view(np.pad(far, 3), 7).max(axis=1)
        farthest = (far > FAR_SIGMA) & (far >= beside)
        if not farthest.any():
            break
        out += kept[farthest].tolist()
        kept = kept[~farthest]
    found, sizes = [], []
    for index in sorted(out):
        place = int(np.searchsorted(kept, index))
        if not 2 <= place <= len(kept) - 2:
            found.append(index)  # at an end of the run there is only one side
            sizes.append(float(np.hypot(*(places[index] - places[kept[min(place, len(kept) - 1)]]))))
        else:
            near = kept[place - 2 : place + 2]
            arrived = swim.arrival_s[[*near[:2], index, *near[2:]]]
            if (np.diff(arrived) <= 0.0).any():
                continue  # a clock that steps mixes up the order of the fixes
            about = _weights(times[near] - times[index]) @ places[near]
            size = float(np.hypot(*(places[index] - about)))
            sides = [_weights(times[pair] - times[index]) @ places[pair] for pair in (near[:2], near[2:])]
            if min(float(np.hypot(*(places[index] - side))) for side in sides) > 0.5 * size:
                found.append(index)
                sizes.append(size)
    return np.array(found, dtype=np.int64), np.array(sizes)


def _off(times: Float64, places: Float64) -> Float64:
    """(n, 2) distances from the curve through the neighbours, scaled to the noise of a single fix."""
    found = np.zeros(places.shape)
    middle = np.arange(2, len(times) - 2)
    near = middle[:, None] + np.array([-2, -1, 1, 2])
    weights = _weights(times[near] - times[middle, None])
    gap = places[middle] - np.einsum("nk,nkc->nc", weights, places[near])
    close = times[near[:, 3]] - times[near[:, 0]] < APART_S
    found[middle] = gap / np.sqrt(1.0 + (weights**2).sum(axis=1))[:, None] * close[:, None]
    last = len(times) - 1
    for index, near_end in (
        (0, [1, 2]),
        (1, [0, 2]),
        (last - 1, [last - 2, last]),
        (last, [last - 2, last - 1]),
    ):
        line = _weights(times[near_end] - times[index])
        if np.ptp(times[[index, *near_end]]) < APART_S:
            found[index] = (places[index] - line @ places[near_end]) / np.sqrt(1.0 + (line**2).sum())
    return found


def _weights(since_s: Float64) -> Float64:
    """(..., k) weights of values at k times that give the interpolating polynomial at time 0 (Lagrange)."""
    apart = since_s[..., :, None] - since_s[..., None, :]
    same = np.eye(since_s.shape[-1], dtype=bool)
    apart = np.where(same, 1.0, np.where(np.abs(apart) < 1e-6, 1e-6, apart))
    return np.asarray(np.where(same, 1.0, -since_s[..., None, :] / apart).prod(axis=-1))
