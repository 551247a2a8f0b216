"""Fixes that jump by chance, recognised by their neighbours alone, without a model.

The place of each fix is compared with the cubic through the two fixes before and the two after it, and with
the line through the two on either side: at a step, where the camera was moved, a fix agrees with one side.
The farthest fix is removed first, then the others are compared again.

A heading changes too fast at a stroke for that, but a robot seldom turns and turns back within a few frames:
the headings of up to BURST_MOST successive fixes jumped if all are beyond those of the two fixes before and
the two after them, on one side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.core.poses import wrap_angle
from frogkick.identification.segments import Segments
from frogkick.identification.terms import Interval, Term, law_term

FAR_SIGMA = 6.0  # a fix is far off if its distance is more than this many robust standard deviations

FIXES_LEAST, SHARE_LEAST = 5, 0.004
"""Smallest number of jumps, and their smallest share of the fixes: a single jump is an accident."""

APART_S = 0.6  # neighbours that span more time are not compared

BURST_MOST = 5  # successive fixes whose headings jump together
BEYOND = 0.3  # share of the range of its neighbours' headings by which a heading that jumped is beyond it


@dataclass(frozen=True, eq=False)
class Jumps:
    """How often fixes jump and how far: in place (m), or in heading (rad)."""

    chance: Interval  # probability that a fix jumps
    size: Interval  # root mean square distance, or turn

    @property
    def of_heading(self) -> bool:
        """Whether it is the heading that jumps."""
        return self.size.unit == "rad"

    @property
    def term(self) -> Term:
        """The law."""
        if self.of_heading:
            declared = {
                "jumping": {"unit": "1", "low": 1e-4, "high": 1.0, "nominal": 1e-4, "step": 0.1},
                "size": {"unit": "rad", "low": 0.0, "high": math.pi, "nominal": 0.0, "step": 1e-2},
            }
            way = "(1 - 2 * (chance < 0.5 * jumping))"
            table = {"on": "fix", "heading_rad": f"size * (chance < jumping) * {way}"}
            return law_term("headings that jump", table, declared, (self.chance.value, self.size.value))
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
    """How often the places of the runs' fixes jump; None if they do not."""
    return _jumps([jumped(swim)[1] for swim in swims], swims, "m", 2e-4)


def turns_of(swims: Sequence[Segments]) -> Jumps | None:
    """How often the headings of the runs' fixes jump; None if they do not."""
    return _jumps([turned(swim)[1] for swim in swims], swims, "rad", 4e-3)


def _jumps(found: Sequence[Float64], swims: Sequence[Segments], unit: str, least: float) -> Jumps | None:
    """The jumps whose sizes were found in each run; ``least`` is half the width of an interval of a size."""
    from scipy import stats

    sizes = np.concatenate(found)
    count = sum(len(swim.time_s) for swim in swims)
    if len(sizes) < max(FIXES_LEAST, SHARE_LEAST * count):
        return None
    low, high = stats.beta.interval(0.95, len(sizes) + 0.5, count - len(sizes) + 0.5)
    squares = sizes**2
    size = float(np.sqrt(squares.mean()))
    spread = float(1.96 * squares.std() / np.sqrt(len(sizes)) / (2.0 * size)) + least
    return Jumps(
        Interval("jumping", len(sizes) / count, float(low), float(high), "1"),
        Interval("size", size, max(size - spread, 0.0), size + spread, unit),
    )


def without_jumps(swims: Sequence[Segments], of_heading: bool = False) -> list[Segments]:
    """The runs without the fixes that jumped in place, or in heading."""
    kept = []
    for swim in swims:
        stays = np.ones(len(swim.time_s), dtype=bool)
        stays[(turned if of_heading else jumped)(swim)[0]] = False
        left = swim.with_fixes(stays)
        if of_heading and not stays.all():
            left = replace(left, pose=np.column_stack([left.pose[:, :2], np.unwrap(left.pose[:, 2])]))
        kept.append(left)
    return kept


def turned(swim: Segments) -> tuple[Int64, Float64]:
    """(k,) indices of the fixes of a run whose headings jumped, and (k,) by how much, rad."""
    times, headings = swim.time_s, swim.pose[:, 2]
    kept, sizes = np.arange(len(times)), dict[int, float]()
    if len(kept) <= 8:
        return np.array([], dtype=np.int64), np.array([])
    scatter = np.diff(headings, 3) / math.sqrt(20.0)
    least = FAR_SIGMA * 1.4826 * float(np.median(np.abs(scatter))) + 1e-6
    for length in range(1, BURST_MOST + 1):
        first = 2
        while first + length + 2 <= len(kept):
            window = kept[first - 2 : first + length + 2]
            # Of a tag that is taken for one turned by half, nobody knows which way it turned and back.
            turns = wrap_angle(headings[window] - headings[window[1]])
            burst, near = turns[2:-2], turns[[0, 1, -2, -1]]
            beyond = max(float((burst - near.max()).min()), float((near.min() - burst).min()))
            if beyond > max(least, BEYOND * float(np.ptp(near))) and np.ptp(times[window]) < APART_S:
                about = np.interp(times[window[2:-2]], times[window[[1, -2]]], turns[[1, -2]])
                sizes |= zip(window[2:-2].tolist(), np.abs(burst - about).tolist(), strict=True)
                kept = np.delete(kept, np.arange(first, first + length))
            else:
                first += 1
    return np.array(sorted(sizes), dtype=np.int64), np.array([sizes[k] for k in sorted(sizes)])


def jumped(swim: Segments) -> tuple[Int64, Float64]:
    """(k,) indices of the fixes of a run whose places jumped, and (k,) their distances, m."""
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
