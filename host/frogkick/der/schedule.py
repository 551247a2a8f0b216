"""When the steps are, and how active the limbs are in them: fine while a limb straightens, coarse after.

Nearly all of a stroke's error is made while its limb straightens. Steps therefore start at the default length
at each stroke, keep it until the stroke's activation has peaked, and then grow to COARSEST times that, or
COARSEST_AT_REST times when all strokes are over. They land on the starts of strokes, where the activation
has a kink that would cost the order otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from frogkick.robot import Actuation

FloatArray = NDArray[np.float64]

COARSEST = 8.0  # longest step over the finest; limbs that curl back need more corrections beyond, not fewer
COARSEST_AT_REST = 12.0  # the same while no stroke lasts
GROWTH_PER_S = 50.0  # of the step over the finest, per second after the limb is straight
STRAIGHT = 0.99  # share of the full activation that counts as straight


def straight_s(actuation: Actuation) -> float:
    """Time from a stroke's start until its limb is straight."""
    return float(np.argmax(actuation.activation >= STRAIGHT)) * actuation.step_s


def step_times(
    time_s: float,
    until_s: float,
    starts_s: Sequence[float],
    fine_s: float,
    duration_s: float,
    step_s: float,
) -> FloatArray:
    """Times (k,) from ``time_s`` to ``until_s``, both included: the ends of all steps.

    Args:
        time_s: now.
        until_s: where the last step ends; after ``time_s``.
        starts_s: when strokes start or have started, in any order.
        fine_s: how long after each the finest steps last.
        duration_s: how long after each it is over.
        step_s: the finest step.
    """
    starts = np.array(sorted(starts_s), dtype=np.float64)
    return np.asarray(_step_times(time_s, until_s, starts, fine_s, duration_s, step_s))


@njit(cache=True, error_model="numpy")
def _step_times(
    time_s: float,
    until_s: float,
    starts_s: FloatArray,
    fine_s: float,
    duration_s: float,
    step_s: float,
) -> FloatArray:
    ends = np.empty(3 + 2 * len(starts_s) + int((until_s - time_s) / step_s))
    ends[0] = time_s
    count, coming, latest = 1, 0, -np.inf
    now = time_s
    while now < until_s:
        while coming < len(starts_s) and starts_s[coming] <= now:
            latest = starts_s[coming]
            coming += 1
        stop = until_s
        if coming < len(starts_s) and starts_s[coming] < until_s:
            stop = starts_s[coming]
        coarsest = COARSEST if now < latest + duration_s else COARSEST_AT_REST
        step = step_s * min(coarsest, 1.0 + GROWTH_PER_S * max(0.0, now - latest - fine_s))
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
def stroke_activation(
    times_s: FloatArray, starts_s: FloatArray, table: FloatArray, table_step_s: float
) -> FloatArray:
    """Activation (k, limbs) at times (k,): the largest of each limb's strokes, 0 before and after them.

    Args:
        times_s: (k,) when.
        starts_s: (limbs, m) when strokes began; NaN where there is none.
        table: activation every table_step_s since the start of a stroke.
    """
    active = np.zeros((times_s.shape[0], starts_s.shape[0]))
    for k in range(times_s.shape[0]):
        for limb in range(starts_s.shape[0]):
            for stroke in range(starts_s.shape[1]):
                place = (times_s[k] - starts_s[limb, stroke]) / table_step_s
                if place > 0.0 and place < table.shape[0] - 1:  # false for NaN
                    index = int(place)
                    share = place - index
                    now = (1.0 - share) * table[index] + share * table[index + 1]
                    active[k, limb] = max(active[k, limb], now)
    return active
