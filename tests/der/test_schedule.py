"""When the steps are: they land on strokes, are fine while a limb straightens, and never run over."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from frogkick.der.schedule import COARSEST, COARSEST_AT_REST, step_times, straight_s, stroke_activation
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
FINE_S, LASTS_S, STEP_S = 0.06, 0.9, 0.001

times = st.floats(0.0, 3.0)


@settings(max_examples=300, deadline=None)
@given(now=times, length=st.floats(1e-6, 3.0), starts=st.lists(times, max_size=6))
def test_steps_fill_the_time_and_land_on_strokes(now: float, length: float, starts: list[float]) -> None:
    until = now + length
    ends = step_times(now, until, starts, FINE_S, LASTS_S, STEP_S)
    steps = np.diff(ends)
    assert ends[0] == now
    assert ends[-1] == until
    assert np.all(steps > 0.0)
    assert np.all(steps <= COARSEST_AT_REST * STEP_S * (1.0 + 1e-6))
    for start in starts:
        if now < start < until:
            assert start in ends
    for begin, step in zip(ends[:-1], steps, strict=True):
        if any(0.0 <= begin - start <= FINE_S for start in starts):
            assert step <= STEP_S * (1.0 + 1e-6)
        if any(0.0 <= begin - start < LASTS_S for start in starts):
            assert step <= COARSEST * STEP_S * (1.0 + 1e-6)


def test_steps_are_coarse_long_after_a_stroke_and_shared_out_before_the_next() -> None:
    ends = step_times(0.0, 1.0, [0.0, 0.5005], FINE_S, LASTS_S, STEP_S)
    steps = np.diff(ends)
    assert np.allclose(steps[:60], STEP_S)
    assert np.isclose(steps.max(), COARSEST * STEP_S)
    before = steps[ends[1:] <= 0.5005][-2:]
    assert before[0] == before[1] or np.isclose(before[0], before[1])
    assert len(steps) < 320


def test_no_stroke_is_coarse_at_once() -> None:
    for coming in ([], [5.0]):
        ends = step_times(0.0, 0.84, coming, FINE_S, LASTS_S, STEP_S)
        assert np.allclose(np.diff(ends), COARSEST_AT_REST * STEP_S)


def test_a_limb_is_straight_before_its_stroke_is_over() -> None:
    for egain, frequency in ((0.0, 0.4), (10.0, 0.7), (30.0, 1.4)):
        stroke = ROBOT.actuation(egain, frequency)
        assert 0.03 < straight_s(stroke) < 0.15
        assert straight_s(stroke) < 0.3 * stroke.duration_s


def test_activation_is_the_largest_of_a_limb_s_strokes() -> None:
    stroke = ROBOT.actuation()
    at = np.linspace(-0.1, 2.5, 400)
    starts = np.array([[0.0, 0.3], [0.5, np.nan], [np.nan, np.nan]])
    active = stroke_activation(at, starts, stroke.activation, stroke.step_s)
    table_s = np.arange(len(stroke.activation)) * stroke.step_s
    one, two, three = (np.interp(at - s, table_s, stroke.activation, 0.0, 0.0) for s in (0.0, 0.3, 0.5))
    assert np.allclose(active[:, 0], np.maximum(one, two), atol=1e-12)
    assert np.allclose(active[:, 1], three, atol=1e-12)
    assert not active[:, 2].any()
