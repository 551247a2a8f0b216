"""Step-size control, and the activation of limbs in each step.

The local error of a step grows with the square of its length and with the second derivative of the
activation. So steps have the finest length while a limb straightens. They lengthen as the square root of that
derivative falls, up to COARSEST times, or COARSEST_AT_REST times when all strokes are over. After a stroke
the frame oscillates at some 40 Hz, and the thrust of the next stroke depends on the phase of this
oscillation. Steps stay short enough to resolve it. They end at the starts and ends of strokes, because a kink
of the activation inside a step would reduce the order of convergence.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.core.compiled import cached_njit
from frogkick.der.lanes import SimdArray, lane_floats, lane_zeros
from frogkick.robot import Actuation

STEP_S = 0.0008
"""Finest time step, while a limb straightens."""
EULER_STEP_S = 0.001
"""Longest time step of backward Euler, that of the published simulations."""
COARSEST = 8.0  # longest step over the finest; beyond it, limbs that curl back need more corrections per step
COARSEST_AT_REST = 12.0  # the same while no stroke lasts
SHARP_PER_S2 = 600.0  # second derivative of the activation from which on steps are the finest
ROUNDING = 1e-6  # samples of a stroke: a step that ends with it is evaluated at its last one
SLIVER = 0.1  # of the finest step: kinks that are closer together count as one
RINGS_S = 0.8  # the frame oscillates so long after a stroke starts; with 0.6, 2 of 192 gaits err by 0.2 %
COARSEST_WHILE_IT_RINGS = 2.0  # longest step over the finest within RINGS_S; with 3, four gaits err as much
COARSEST_OF_PLATES = 6.0  # the same with plates, which ring at 20 Hz: Newton's method diverges beyond
AHEAD_S, BEHIND_S = 0.008, 0.016  # steps are fine so long before and after a large second derivative


class ScheduledStroke(NamedTuple):
    """A limb's stroke: its start, its gain, and the scale of its duration, over the measured stroke.

    The time until the limb is straight is the measured one; the rest is scaled by ``duration_scale``.
    """

    start_s: float
    gain: float = 1.0
    duration_scale: float = 1.0


@dataclass(frozen=True, eq=False)
class StepProfile:
    """Step-size profile: the longest steps during a stroke."""

    coarseness: Float64  # (n,) longest step over the finest, at each ``every_s`` since the stroke's start
    every_s: float  # spacing of the coarseness: ``Actuation.step_s``
    over_s: float  # time at which the limb is back at rest
    peak_s: float  # time at which it is straightest


def step_profile_of(actuation: Actuation) -> StepProfile:
    """Return the step-size profile of a stroke."""
    active, every_s = actuation.activation, actuation.step_s
    last = min(int(np.flatnonzero(active > 0.0)[-1]) + 1, len(active) - 1)
    rings = math.ceil(RINGS_S / every_s)
    bend = np.zeros(last + 1)
    bend[1:-1] = np.abs(np.diff(active[: last + 1], 2)) / every_s**2
    bend[0], bend[-1] = SHARP_PER_S2, bend[-2]
    ahead, behind = int(AHEAD_S / every_s), int(BEHIND_S / every_s)
    # scipy.ndimage has this filter, but takes a sixth of a second to load in each process.
    before = (ahead + behind + 1) // 2 + (behind - ahead) // 2
    padded = np.pad(bend, (before, ahead + behind - before), mode="edge")
    sharpest = sliding_window_view(padded, ahead + behind + 1).max(axis=1)
    coarseness = np.sqrt(SHARP_PER_S2 / np.maximum(sharpest, SHARP_PER_S2 / COARSEST**2))
    coarseness = np.concatenate([coarseness, np.full(max(0, rings - last), COARSEST)])
    coarseness[:rings] = np.minimum(coarseness[:rings], COARSEST_WHILE_IT_RINGS)
    return StepProfile(np.maximum(coarseness, 1.0), every_s, last * every_s, int(np.argmax(active)) * every_s)


class Profiles(NamedTuple):
    """Strokes of several lanes: fields of ``StepProfile`` and ``Actuation``, a row for each kind."""

    kind: Int64  # (lanes, limbs) row of each limb
    # coarseness, activation: (kinds, n) padded rows; the first ``coarse`` and ``active`` values are valid
    coarseness: Float64
    coarse: Int64
    over_s: Float64
    peak_s: Float64
    duration_s: Float64
    activation: Float64
    active: Int64
    step_s: Float64  # spacing of activation and of coarseness
    drop_per_m: Float64

    def of(self, lanes: Sequence[int]) -> Profiles:
        """Return the profiles of some lanes."""
        return self._replace(kind=self.kind[lanes])


class Schedule:
    """Strokes of several lanes, and the time steps that resolve them.

    Args:
        actuations: (lanes, limbs) the effect of each limb's strokes.
        share: share of a step at which forces are evaluated.
        step_s: the finest step.
        longest_s: upper bound of the steps, in addition to the step-size profile. If it is at most step_s,
            all steps have that length, but for those that end at the starts and ends of strokes.
    """

    def __init__(
        self, actuations: Sequence[Sequence[Actuation]], share: float, step_s: float, longest_s: float
    ) -> None:
        self._profiles, self._share = profiles_of(actuations), share
        if longest_s <= step_s:
            self._profiles = self._profiles._replace(coarseness=np.ones_like(self._profiles.coarseness))
        self._step_s, self._longest_s = float(step_s), float(longest_s)
        self._strokes: list[list[list[ScheduledStroke]]] = [[[] for _ in limbs] for limbs in actuations]
        self._changed = set(range(len(actuations)))
        self._tables = _Tables(
            np.empty((0, 0)), np.empty((0, 0)), np.empty((0, 0), dtype=np.int64), np.empty((0, 0, 0, 3))
        )

    def fire(self, lane: int, limb: int, stroke: ScheduledStroke) -> None:
        """Add a stroke of a lane's limb."""
        self._strokes[lane][limb].append(stroke)
        self._changed.add(lane)

    def strokes(self, lane: int) -> tuple[tuple[ScheduledStroke, ...], ...]:
        """Return the current strokes of each limb of a lane."""
        return tuple(tuple(of_limb) for of_limb in self._strokes[lane])

    def put(self, lane: int, strokes: Sequence[Sequence[ScheduledStroke]]) -> None:
        """Replace the strokes of a lane."""
        self._strokes[lane] = [list(of_limb) for of_limb in strokes]
        self._changed.add(lane)

    def pick(self, lanes: Sequence[int]) -> Schedule:
        """Return an independent copy of some lanes."""
        twin = copy.copy(self)
        twin._profiles = self._profiles.of(lanes)
        twin._strokes = [[list(of_limb) for of_limb in self._strokes[lane]] for lane in lanes]
        twin._changed = set(range(len(twin._strokes)))
        return twin

    def times(self, now_s: Float64, until_s: Float64, going: Bool) -> tuple[Float64, Int64]:
        """Return the ends of the steps of each lane; see ``lane_times``."""
        for lane in self._changed:  # forget strokes that are over and no longer ring
            durations_s = self._profiles.duration_s[self._profiles.kind[lane]].tolist()
            for of_limb, duration_s in zip(self._strokes[lane], durations_s, strict=True):
                of_limb[:] = [
                    each
                    for each in of_limb
                    if each.start_s + max(RINGS_S, duration_s * max(1.0, each.duration_scale)) > now_s[lane]
                ]
        if self._changed:
            self._set_tables()
            self._changed.clear()
        steps = lane_times(
            now_s, until_s, going, *self._tables[:3], self._profiles, self._step_s, self._longest_s
        )
        return steps[0], steps[1]

    def laid(
        self, times: Float64, counts: Int64, width: int, lane: int | None = None
    ) -> tuple[SimdArray, SimdArray]:
        """Return the lengths of the steps of all lanes or of one, and the activations; see ``lay_out``."""
        strokes, profiles, longest = self._tables.strokes, self._profiles, int(counts.max()) - 1
        if lane is not None:
            strokes, profiles = strokes[[lane]], profiles.of([lane])
        lengths = lane_zeros((longest, 1), width)
        active = lane_zeros((longest, 2 * strokes.shape[1] + 2), width)
        lay_out(times, counts, strokes, profiles, self._share, lane_floats(lengths), lane_floats(active))
        return lengths, active

    def _set_tables(self) -> None:
        """Set the strokes of all lanes as arrays."""
        lanes, limbs = len(self._strokes), len(self._strokes[0])
        most = max([1, *(len(of_limb) for of_lane in self._strokes for of_limb in of_lane)])
        starts_s, scales = np.full((lanes, limbs * most), np.inf), np.ones((lanes, limbs * most))
        kinds = np.zeros((lanes, limbs * most), dtype=np.int64)
        strokes = np.full((lanes, limbs, most, 3), np.nan)
        for lane, of_lane in enumerate(self._strokes):
            of_kind = zip(of_lane, self._profiles.kind[lane].tolist(), strict=True)
            known = sorted((stroke, kind) for of_limb, kind in of_kind for stroke in of_limb)
            for place, (stroke, kind) in enumerate(known):
                starts_s[lane, place], scales[lane, place] = stroke.start_s, stroke.duration_scale
                kinds[lane, place] = kind
            for limb, of_limb in enumerate(of_lane):
                for place, stroke in enumerate(of_limb):
                    strokes[lane, limb, place] = stroke
        self._tables = _Tables(starts_s, scales, kinds, strokes)


class _Tables(NamedTuple):
    """Strokes of all lanes as arrays."""

    # (lanes, m) of each lane's strokes, sorted by their start
    starts_s: Float64
    scales: Float64
    kinds: Int64  # row in ``Profiles``
    strokes: Float64  # (lanes, limbs, m, 3) fields of ``ScheduledStroke``; NaN for none


def profiles_of(of_lanes: Sequence[Sequence[Actuation]]) -> Profiles:
    """Return the profiles of lanes whose limbs have these strokes."""
    known = {id(each): each for limbs in of_lanes for each in limbs}
    rows = {key: row for row, key in enumerate(known)}
    actuations = list(known.values())
    steps = [step_profile_of(each) for each in actuations]
    return Profiles(
        np.array([[rows[id(each)] for each in limbs] for limbs in of_lanes], dtype=np.int64),
        *_side_by_side([each.coarseness for each in steps]),
        np.array([each.over_s for each in steps]),
        np.array([each.peak_s for each in steps]),
        np.array([each.duration_s for each in actuations]),
        *_side_by_side([each.activation for each in actuations]),
        np.array([each.step_s for each in actuations]),
        np.array([each.drop_per_m for each in actuations]),
    )


def _side_by_side(rows: Sequence[Float64]) -> tuple[Float64, Int64]:
    sizes = np.array([len(row) for row in rows], dtype=np.int64)
    every = np.zeros((len(rows), int(sizes.max())))
    for place, row in enumerate(rows):
        every[place, : len(row)] = row
    return every, sizes


@cached_njit(error_model="numpy")
def lane_times(
    now_s: Float64,
    until_s: Float64,
    going: Bool,
    starts_s: Float64,
    scales: Float64,
    kinds: Int64,
    profiles: Profiles,
    step_s: float,
    longest_s: float,
) -> tuple[Float64, Int64]:
    """Return the ends of the steps of each lane.

    Args:
        now_s, until_s: (lanes,).
        going: (lanes,) whether a lane takes steps.
        starts_s, scales, kinds: (lanes, m) current and later strokes in order, then infinity, 1 and 0.
        profiles: of the lanes.
        step_s: the finest step.
        longest_s: longer steps are divided evenly.

    Returns:
        (lanes, k) times, the current one first, and (lanes,) how many are valid; 0 in a lane without steps.
    """
    most = 0.0
    for lane in range(len(now_s)):
        if going[lane]:
            most = max(most, until_s[lane] - now_s[lane])
    room = 4 + 4 * starts_s.shape[1] + int(most / step_s) + int(2.0 * most / longest_s)
    times, counts = np.zeros((len(now_s), room)), np.zeros(len(now_s), dtype=np.int64)
    for lane in range(len(now_s)):
        if not going[lane]:
            continue
        ends = step_times(
            now_s[lane],
            until_s[lane],
            starts_s[lane],
            scales[lane],
            kinds[lane],
            profiles,
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


@cached_njit(error_model="numpy")
def lay_out(
    times: Float64,
    counts: Int64,
    strokes: Float64,
    profiles: Profiles,
    share: float,
    lengths: Float64,
    active: Float64,
) -> None:
    """Set the lengths of the steps, and in each step the activation and the curvature decrease of each limb.

    Args:
        times, counts: see ``lane_times``.
        strokes: (lanes, limbs, m, 3) fields of ``ScheduledStroke``; NaN for none.
        profiles: of the lanes.
        share: share of a step at which forces are evaluated.
        lengths: (k, 1, width), zeros; set where steps are.
        active: (k, 2 * limbs + 2, width), zeros; set where steps are.
    """
    for lane in range(len(counts)):
        steps = counts[lane] - 1
        if steps < 1:
            continue
        at = np.empty(steps)
        for k in range(steps):
            length = times[lane, k + 1] - times[lane, k]
            lengths[k, 0, lane] = length
            at[k] = times[lane, k] + share * length
        for limb in range(strokes.shape[1]):
            kind = profiles.kind[lane, limb]
            table = profiles.activation[kind, : profiles.active[kind]]
            own = strokes[lane, limb]
            found = stroke_activation(at, own, table, profiles.step_s[kind], profiles.peak_s[kind])
            for k in range(steps):
                active[k, 2 * limb, lane] = found[k]
                active[k, 2 * limb + 1, lane] = profiles.drop_per_m[kind] * found[k]


@cached_njit(error_model="numpy")
def step_times(
    time_s: float,
    until_s: float,
    starts_s: Float64,
    scales: Float64,
    kinds: Int64,
    profiles: Profiles,
    step_s: float,
) -> Float64:
    """Return times (k,) from ``time_s`` to ``until_s``, both included: the ends of all steps of one lane."""
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
            kind = kinds[k]
            since_s = _measured_s(now - starts_s[k], scales[k], profiles.peak_s[kind])
            place = int(since_s / profiles.step_s[kind])
            if place < profiles.coarse[kind]:
                longest = min(longest, profiles.coarseness[kind, max(0, place)])
        landing = stop
        for k in range(len(starts_s)):
            over_s, peak_s = profiles.over_s[kinds[k]], profiles.peak_s[kinds[k]]
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


@cached_njit(error_model="numpy")
def _measured_s(since_s: float, scale: float, peak_s: float) -> float:
    """Return the time in the measured stroke that corresponds to a time in a stroke of another duration."""
    if scale == 1.0 or since_s <= peak_s:
        return since_s
    return peak_s + (since_s - peak_s) / scale


@cached_njit(error_model="numpy")
def stroke_activation(
    times_s: Float64, strokes: Float64, table: Float64, table_step_s: float, peak_s: float
) -> Float64:
    """Return activations (k,) of a limb at times (k,): the largest of its strokes, otherwise 0.

    Args:
        times_s: (k,) times.
        strokes: (m, 3) fields of ``ScheduledStroke``; NaN for none.
        table: activation at each table_step_s since the start of a measured stroke.
        table_step_s: spacing of the table.
        peak_s: time of its largest value.
    """
    active = np.zeros(times_s.shape[0])
    for k in range(times_s.shape[0]):
        for stroke in range(strokes.shape[0]):
            start, gain, scale = strokes[stroke]
            place = _measured_s(times_s[k] - start, scale, peak_s) / table_step_s
            if place > 0.0 and place < table.shape[0] - 1 + ROUNDING:  # false for NaN
                index = min(int(place), table.shape[0] - 2)
                share = place - index
                now = (1.0 - share) * table[index] + share * table[index + 1]
                active[k] = max(active[k], gain * now)
    return active
