"""When the steps are: they land on strokes, are fine while a limb straightens, and never pass the end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from frogkick.der.schedule import (
    BEHIND_S,
    COARSEST,
    COARSEST_AT_REST,
    COARSEST_WHILE_IT_RINGS,
    RINGS_S,
    SLIVER,
    ScheduledStroke,
    lane_times,
    lay_out,
    profiles_of,
    step_profile_of,
    step_times,
    stroke_activation,
)
from frogkick.der.stepping import SCHEMES
from frogkick.robot import Actuation, load_robot

ROBOT = load_robot("frog2022")
SHARE = SCHEMES[ROBOT.integrator].share
STROKE, STEP_S = ROBOT.actuation(), 0.001
STEP_PROFILE = step_profile_of(STROKE)
ROOM = 1.0 + 1e-6

times = st.floats(0.0, 3.0)


def ends_of(
    now: float, until: float, strokes: Sequence[ScheduledStroke], stroke: Actuation = STROKE
) -> np.ndarray:
    known = sorted(strokes)
    starts, scales = (
        np.array([each.start_s for each in known]),
        np.array([each.duration_scale for each in known]),
    )
    kinds = np.zeros(len(known), dtype=np.int64)
    return np.asarray(step_times(now, until, starts, scales, kinds, profiles_of([[stroke]]), STEP_S))


@example(now=0.8, length=1.0, starts=[1e-05])
@settings(max_examples=300, deadline=None)
@given(now=times, length=st.floats(1e-6, 3.0), starts=st.lists(times, max_size=6))
def test_steps_fill_the_time_and_land_on_strokes(now: float, length: float, starts: list[float]) -> None:
    until = now + length
    ends = ends_of(now, until, [ScheduledStroke(start) for start in starts])
    steps = np.diff(ends)
    assert ends[0] == now
    assert ends[-1] == until
    assert np.all(steps > 0.0)
    assert np.all(steps <= COARSEST_AT_REST * STEP_S * ROOM)
    for start in starts:
        for kink in (start, start + STEP_PROFILE.over_s):
            if now < kink < until:
                assert np.abs(ends - kink).min() <= SLIVER * STEP_S * ROOM
    if length > SLIVER * STEP_S:
        assert steps.min() > 0.4 * SLIVER * STEP_S
    for begin, step in zip(ends[:-1], steps, strict=True):
        if any(SLIVER * STEP_S <= begin - start < 0.05 for start in starts):
            assert step <= STEP_S * ROOM
        if any(SLIVER * STEP_S <= begin - start < RINGS_S - 1e-9 for start in starts):
            assert step <= COARSEST_WHILE_IT_RINGS * STEP_S * ROOM
        if any(SLIVER * STEP_S <= begin - start < STEP_PROFILE.over_s - 1e-9 for start in starts):
            assert step <= COARSEST * STEP_S * ROOM


def test_no_sliver_is_left_behind_a_stroke_that_begins_where_steps_end() -> None:
    for start in (np.nextafter(0.1, 0.0), 0.1 - 0.5 * SLIVER * STEP_S):
        steps = np.diff(ends_of(0.0, 0.1, [ScheduledStroke(float(start))]))
        assert steps.min() > 0.4 * SLIVER * STEP_S


@settings(max_examples=300, deadline=None)
@given(late=st.floats(0.0, 100.0), second_ms=st.integers(1, 400), length_ms=st.integers(500, 3000))
def test_a_stroke_s_own_time_chooses_no_other_steps(late: float, second_ms: int, length_ms: int) -> None:
    """The rounding of its start must not change the steps, however late it is."""
    first, ends = (
        ends_of(at, at + 1e-3 * length_ms, [ScheduledStroke(at), ScheduledStroke(at + 1e-3 * second_ms)])
        for at in (0.0, late)
    )
    assert len(ends) == len(first)
    assert np.abs(ends - late - first).max() < 1e-11


def test_steps_are_coarse_long_after_a_stroke_and_shared_out_before_the_next() -> None:
    ends = ends_of(0.0, 3.0, [ScheduledStroke(0.0), ScheduledStroke(2.5005)])
    steps = np.diff(ends)
    assert np.allclose(steps[:50], STEP_S)
    assert np.isclose(steps.max(), COARSEST_AT_REST * STEP_S)
    before = steps[ends[1:] <= 2.5005][-2:]
    assert np.isclose(before[0], before[1])
    assert len(steps) < 1100


def test_no_stroke_is_coarse_at_once() -> None:
    for coming in ([], [ScheduledStroke(5.0)]):
        ends = ends_of(0.0, 0.84, coming)
        assert np.allclose(np.diff(ends), COARSEST_AT_REST * STEP_S)


def test_steps_are_finest_where_each_stroke_bends_and_lengthen_where_it_does_not() -> None:
    for profile in ROBOT.profiles:
        stroke = ROBOT.actuation(profile.egain_percent, profile.frequency_hz)
        step_profile = step_profile_of(stroke)
        assert np.all((step_profile.coarseness >= 1.0) & (step_profile.coarseness <= COARSEST))
        half = int(np.argmax(stroke.activation > 0.5))
        assert np.all(step_profile.coarseness[: half + int(BEHIND_S / step_profile.every_s)] < 1.5)
        assert np.all(stroke.activation[round(step_profile.over_s / step_profile.every_s) :] <= 1e-12)
        assert step_profile.coarseness.max() >= COARSEST_WHILE_IT_RINGS


def test_activation_is_the_largest_of_a_limb_s_strokes() -> None:
    stroke = ROBOT.actuation()
    at = np.linspace(-0.1, 2.5, 400)
    strokes = np.full((3, 2, 3), np.nan)
    strokes[0], strokes[1, 0] = [ScheduledStroke(0.0), ScheduledStroke(0.3)], ScheduledStroke(0.5)
    shape = (stroke.activation, stroke.step_s, STEP_PROFILE.peak_s)
    active = np.column_stack([stroke_activation(at, of_limb, *shape) for of_limb in strokes])
    table_s = np.arange(len(stroke.activation)) * stroke.step_s
    one, two, three = (np.interp(at - s, table_s, stroke.activation, 0.0, 0.0) for s in (0.0, 0.3, 0.5))
    assert np.allclose(active[:, 0], np.maximum(one, two), atol=1e-12)
    assert np.allclose(active[:, 1], three, atol=1e-12)
    assert not active[:, 2].any()


def test_a_weak_slow_stroke_is_the_measured_one_with_less_height_and_a_longer_tail() -> None:
    stroke = ROBOT.actuation()
    at = np.linspace(0.0, 4.0, 900)
    peak_s = STEP_PROFILE.peak_s
    strokes = np.array([ScheduledStroke(0.0, 0.7, 2.0)])
    active = stroke_activation(at, strokes, stroke.activation, stroke.step_s, peak_s)
    then = np.where(at <= peak_s, at, peak_s + (at - peak_s) / 2.0)
    table_s = np.arange(len(stroke.activation)) * stroke.step_s
    assert np.allclose(active, 0.7 * np.interp(then, table_s, stroke.activation, 0.0, 0.0), atol=1e-12)
    ends = ends_of(0.0, 3.0, [ScheduledStroke(0.0, 0.7, 2.0)])
    over_s = peak_s + 2.0 * (STEP_PROFILE.over_s - peak_s)
    assert over_s < 3.0
    assert np.abs(ends - over_s).min() < 1e-12


def test_lanes_laid_out_in_one_go_are_those_laid_out_one_by_one() -> None:
    """To the last bit, whatever the strokes of other lanes are like and however many they have."""
    actuations = [ROBOT.actuation(each.egain_percent, each.frequency_hz) for each in ROBOT.profiles[:3]]
    fired = [[ScheduledStroke(0.02, 0.8), ScheduledStroke(0.42, 1.0, 1.7)], [], [ScheduledStroke(0.1)]]
    starts, scales = np.full((3, 2), np.inf), np.ones((3, 2))
    strokes = np.full((3, 1, 2, 3), np.nan)
    for lane, known in enumerate(fired):
        for place, stroke in enumerate(known):
            starts[lane, place], scales[lane, place] = stroke.start_s, stroke.duration_scale
            strokes[lane, 0, place] = stroke
    now, until = np.array([0.0, 0.1, 0.05]), np.array([0.9, 0.2, 0.05])
    profiles = profiles_of([[each] for each in actuations])
    kinds = np.repeat(profiles.kind, 2, axis=1)
    found, counts = lane_times(now, until, until > now, starts, scales, kinds, profiles, STEP_S, np.inf)
    lengths, active = np.zeros((counts.max() - 1, 1, 4)), np.zeros((counts.max() - 1, 4, 4))
    lay_out(found, counts, strokes, profiles, SHARE, lengths, active)
    assert counts[2] == 0 and not lengths[:, :, 2:].any() and not active[:, :, 2:].any()
    for lane, actuation in enumerate(actuations[:2]):
        ends, step_profile, steps = found[lane, : counts[lane]], step_profile_of(actuation), counts[lane] - 1
        assert np.array_equal(ends, ends_of(now[lane], until[lane], fired[lane], actuation))
        assert np.array_equal(lengths[:steps, 0, lane], np.diff(ends)) and not lengths[steps:, 0, lane].any()
        at = ends[:-1] + SHARE * np.diff(ends)
        table = (actuation.activation, actuation.step_s, step_profile.peak_s)
        one = stroke_activation(at, strokes[lane, 0], *table)
        assert np.array_equal(active[:steps, 0, lane], one)
        assert np.array_equal(active[:steps, 1, lane], actuation.drop_per_m * one)
