"""When the steps are, and how active the limbs are in them: fine where a stroke turns sharply, coarse after.

Most of a stroke's error is made where its activation bends: the error of a step grows with its square and
with the second derivative of what drives it. Steps therefore take the default length while a limb straightens
and lengthen as the square root of that derivative falls, up to COARSEST times, or COARSEST_AT_REST times
when all strokes are over. Until a stroke's ringing has died they stay short enough to follow the frame, which
bends at some 40 Hz: a next stroke's thrust depends on where in that swing it falls. They land on the starts
and the ends of strokes, where the activation has kinks that would cost the order otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from frogkick.robot import Actuation

FloatArray = NDArray[np.float64]

COARSEST = 8.0  # longest step over the finest; limbs that curl back need more corrections beyond, not fewer
COARSEST_AT_REST = 12.0  # the same while no stroke lasts
SHARP_PER_S2 = 600.0  # second derivative of the activation that wants the finest steps
SLIVER = 0.1  # of the finest step: kinks closer together than that are one
RINGS_S = 0.8  # how long the frame swings after a stroke starts; with 0.6 two of 192 gaits err by over 0.2 %
COARSEST_WHILE_IT_RINGS = 2.0  # with 3 four gaits do
AHEAD_S, BEHIND_S = 0.008, 0.016  # how long before and after a bend its steps are fine


class Stroke(NamedTuple):
    """A limb's stroke: when it starts, its share of the measured one, and how slowly it is over.

    The time until the limb is straight is the measured one, the rest takes ``duration_scale`` times as long.
    """

    start_s: float
    gain: float = 1.0
    duration_scale: float = 1.0

    @property
    def longest(self) -> float:
        """At most so many times the measured duration."""
        return max(1.0, self.duration_scale)


@dataclass(frozen=True, eq=False)
class Pace:
    """How long steps may be during a stroke.

    Attributes:
        coarseness: (n,) longest step over the finest, every ``every_s`` since the stroke's start.
        every_s: spacing of the coarseness.
        over_s: when the limb is back at rest.
        peak_s: when it is straightest.
    """

    coarseness: FloatArray
    every_s: float
    over_s: float
    peak_s: float


def pace_of(actuation: Actuation) -> Pace:
    """How long steps may be during this stroke."""
    from scipy.ndimage import maximum_filter1d

    active, every_s = actuation.activation, actuation.step_s
    last = int(np.flatnonzero(active > 0.0)[-1]) + 1
    rings = math.ceil(RINGS_S / every_s)
    bend = np.zeros(last + 1)
    bend[1:-1] = np.abs(np.diff(active[: last + 1], 2)) / every_s**2
    bend[0], bend[-1] = SHARP_PER_S2, bend[-2]
    ahead, behind = int(AHEAD_S / every_s), int(BEHIND_S / every_s)
    sharpest = maximum_filter1d(bend, ahead + behind + 1, mode="nearest", origin=(behind - ahead) // 2)
    coarseness = np.sqrt(SHARP_PER_S2 / np.maximum(sharpest, SHARP_PER_S2 / COARSEST**2))
    coarseness = np.concatenate([coarseness, np.full(max(0, rings - last), COARSEST)])
    coarseness[:rings] = np.minimum(coarseness[:rings], COARSEST_WHILE_IT_RINGS)
    return Pace(np.maximum(coarseness, 1.0), every_s, last * every_s, int(np.argmax(active)) * every_s)


def step_times(
    time_s: float,
    until_s: float,
    strokes: Sequence[Stroke],
    pace: Pace,
    step_s: float,
) -> FloatArray:
    """Times (k,) from ``time_s`` to ``until_s``, both included: the ends of all steps.

    Args:
        time_s: now.
        until_s: where the last step ends; after ``time_s``.
        strokes: that last or are to come, in any order.
        pace: of these strokes.
        step_s: the finest step.
    """
    known = sorted(strokes)
    starts = np.array([stroke.start_s for stroke in known], dtype=np.float64)
    scales = np.array([stroke.duration_scale for stroke in known], dtype=np.float64)
    shape = (pace.coarseness, pace.every_s, pace.over_s, pace.peak_s)
    return np.asarray(_step_times(time_s, until_s, starts, scales, *shape, step_s))


@njit(cache=True, error_model="numpy")
def _step_times(
    time_s: float,
    until_s: float,
    starts_s: FloatArray,
    scales: FloatArray,
    coarseness: FloatArray,
    every_s: float,
    over_s: float,
    peak_s: float,
    step_s: float,
) -> FloatArray:
    ends = np.empty(3 + 4 * len(starts_s) + int((until_s - time_s) / step_s))
    ends[0] = time_s
    count, now = 1, time_s
    while now < until_s:
        stop, longest = until_s, COARSEST_AT_REST
        for k in range(len(starts_s)):
            if starts_s[k] > now + SLIVER * step_s:
                if starts_s[k] < until_s - SLIVER * step_s:
                    stop = starts_s[k]
                break
            place = int(_measured_s(now - starts_s[k], scales[k], peak_s) / every_s)
            if place < len(coarseness):
                longest = min(longest, coarseness[max(0, place)])
        landing = stop
        for k in range(len(starts_s)):
            over = starts_s[k] + peak_s + (over_s - peak_s) * scales[k]
            if over > now + SLIVER * step_s and over < landing - SLIVER * step_s:
                stop = min(stop, over)
        step = step_s * longest
        left = (stop - now) / step
        if left <= 1.0 + 1e-9:
            now = stop
        elif left < 2.0:  # two steps share what is left rather than that a sliver remains
            now += 0.5 * (stop - now)
        else:
            now += step
        ends[count] = now
        count += 1
    return ends[:count].copy()


@njit(cache=True, error_model="numpy")
def _measured_s(since_s: float, scale: float, peak_s: float) -> float:
    """When the measured stroke was where one that is over more slowly is at a time since its start."""
    if scale == 1.0 or since_s <= peak_s:
        return since_s
    return peak_s + (since_s - peak_s) / scale


@njit(cache=True, error_model="numpy")
def stroke_activation(
    times_s: FloatArray, strokes: FloatArray, table: FloatArray, table_step_s: float, peak_s: float
) -> FloatArray:
    """Activation (k, limbs) at times (k,): the largest of each limb's strokes, 0 before and after them.

    Args:
        times_s: (k,) when.
        strokes: (limbs, m, 3) fields of ``Stroke``; NaN where there is none.
        table: activation every table_step_s since the start of a measured stroke.
        peak_s: when that is largest.
    """
    active = np.zeros((times_s.shape[0], strokes.shape[0]))
    for k in range(times_s.shape[0]):
        for limb in range(strokes.shape[0]):
            for stroke in range(strokes.shape[1]):
                start, gain, scale = strokes[limb, stroke]
                place = _measured_s(times_s[k] - start, scale, peak_s) / table_step_s
                if place > 0.0 and place < table.shape[0] - 1:  # false for NaN
                    index = int(place)
                    share = place - index
                    now = (1.0 - share) * table[index] + share * table[index + 1]
                    active[k, limb] = max(active[k, limb], gain * now)
    return active
