"""Layout of the time steps of all lanes of a batch: times, lengths and activations for the rods, in one call.

The numbers are bit for bit those that ``frogkick.der.batch`` lays out lane by lane; most of the time between
two calls of the rods was spent there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from frogkick.core.compiled import stamp_of
from frogkick.der.schedule import _step_times, stroke_activation

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@njit(error_model="numpy")
def _lane_times(
    now_s: FloatArray,
    until_s: FloatArray,
    going: NDArray[np.bool_],
    starts_s: FloatArray,
    scales: FloatArray,
    pace: tuple[FloatArray, float, float, float],
    step_s: float,
    longest_s: float,
) -> tuple[FloatArray, IntArray]:
    """When the steps of each lane end.

    Args:
        now_s, until_s: (lanes,).
        going: (lanes,) which of them step.
        starts_s, scales: (lanes, m) of strokes, in order, then infinity and 1.
        pace: coarseness, every_s, over_s, peak_s of frogkick.der.schedule.Pace.
        step_s: the finest step; longest_s: steps longer than this are cut evenly.

    Returns:
        (lanes, k) times, the present one first, and (lanes,) how many of these are used; none where a lane
        does not step.
    """
    coarseness, every_s, over_s, peak_s = pace
    most = 0.0
    for lane in range(len(now_s)):
        if going[lane]:
            most = max(most, until_s[lane] - now_s[lane])
    room = 4 + 4 * starts_s.shape[1] + int(most / step_s) + int(2.0 * most / longest_s)
    times, counts = np.zeros((len(now_s), room)), np.zeros(len(now_s), dtype=np.int64)
    for lane in range(len(now_s)):
        if not going[lane]:
            continue
        ends = _step_times(
            now_s[lane],
            until_s[lane],
            starts_s[lane],
            scales[lane],
            coarseness,
            every_s,
            over_s,
            peak_s,
            step_s,
        )
        count = 0
        for k in range(len(ends) - 1):
            length = ends[k + 1] - ends[k]
            parts = max(int(np.ceil(length / longest_s - 1e-9)), 1)
            for place in range(parts):
                times[lane, count] = ends[k] + length / parts * place
                count += 1
        times[lane, count] = ends[-1]
        counts[lane] = count + 1
    return times, counts


@njit(error_model="numpy")
def _lay_out(
    times: FloatArray,
    counts: IntArray,
    strokes: FloatArray,
    activation: tuple[FloatArray, float, float],
    drop_per_m: float,
    share: float,
    lengths: FloatArray,
    active: FloatArray,
) -> None:
    """Set the steps' lengths, and each limb's activation and fall of its natural curvature in them.

    Args:
        times, counts: see ``_lane_times``.
        strokes: (lanes, limbs, m, 3) fields of frogkick.der.schedule.Stroke; NaN where there is none.
        activation: table, its step and the time of its peak: see frogkick.der.schedule.stroke_activation.
        share: of a step, where forces are taken.
        lengths: (k, 1, width), zeros; active: (k, 2 * limbs + 2, width), zeros: set where steps are.
    """
    table, table_step_s, peak_s = activation
    for lane in range(len(counts)):
        steps = counts[lane] - 1
        if steps < 1:
            continue
        at = np.empty(steps)
        for k in range(steps):
            length = times[lane, k + 1] - times[lane, k]
            lengths[k, 0, lane] = length
            at[k] = times[lane, k] + share * length
        found = stroke_activation(at, strokes[lane], table, table_step_s, peak_s)
        for k in range(steps):
            for limb in range(strokes.shape[1]):
                active[k, 2 * limb, lane] = found[k, limb]
                active[k, 2 * limb + 1, lane] = drop_per_m * found[k, limb]


def _compiled(stamp: int) -> tuple[Any, Any]:
    @njit(cache=True, error_model="numpy")
    def lane_times(now_s, until_s, going, starts_s, scales, pace, step_s, longest_s):  # type: ignore[no-untyped-def]
        times, counts = _lane_times(now_s, until_s, going, starts_s, scales, pace, step_s, longest_s)
        return times, counts + stamp * 0

    @njit(cache=True, error_model="numpy")
    def lay_out(times, counts, strokes, activation, drop_per_m, share, lengths, active):  # type: ignore[no-untyped-def]
        _lay_out(times, counts, strokes, activation, drop_per_m, share, lengths, active)
        return stamp

    return lane_times, lay_out


lane_times, lay_out = _compiled(stamp_of("frogkick.der"))
