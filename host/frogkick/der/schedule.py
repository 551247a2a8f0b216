"""When the steps are, and how active the limbs are in them: fine while a limb straightens, coarse after.

Nearly all of a stroke's error is made while its limb straightens. Steps therefore start at the default length
at each stroke, keep it until the stroke's activation has peaked, and then grow to COARSEST times that. They
land on the starts of strokes, where the activation has a kink that would cost the order otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from frogkick.robot import Actuation

FloatArray = NDArray[np.float64]

COARSEST = 8.0  # longest step over the finest; at 16 the drift after a stroke begins to show
GROWTH_PER_S = 50.0  # of the step over the finest, per second after the limb is straight
STRAIGHT = 0.99  # share of the full activation that counts as straight


def straight_s(actuation: Actuation) -> float:
    """Time from a stroke's start until its limb is straight."""
    return float(np.argmax(actuation.activation >= STRAIGHT)) * actuation.step_s


def step_times(
    time_s: float, until_s: float, starts_s: Sequence[float], fine_s: float, step_s: float
) -> FloatArray:
    """Times (k,) from ``time_s`` to ``until_s``, both included: the ends of all steps.

    Args:
        time_s: now.
        until_s: where the last step ends; after ``time_s``.
        starts_s: when strokes start or have started, in any order.
        fine_s: how long after each the finest steps last.
        step_s: the finest step.
    """
    ordered = sorted(starts_s)
    past = [start for start in ordered if start <= time_s]
    latest = past[-1] if past else -math.inf
    stops = [start for start in ordered if time_s < start < until_s] + [until_s]
    times = [time_s]
    now = time_s
    for stop in stops:
        while now < stop:
            since = now - latest - fine_s
            step = step_s * min(COARSEST, 1.0 + GROWTH_PER_S * max(0.0, since))
            left = (stop - now) / step
            # Two steps share what is left rather than that a sliver remains.
            now = stop if left <= 1.0 + 1e-9 else now + (step if left >= 2.0 else 0.5 * (stop - now))
            times.append(now)
        latest = stop
    return np.array(times)


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
