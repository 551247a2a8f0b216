"""The Python twin against the formulas themselves, in float64 and without its code."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.conftest import count
from tests.planner import synthetic

from frogkick.core.errors import InputError
from frogkick.planner import costs, floats, kernel
from frogkick.planner.plan import PlanConfig, PlanError, plan, plan_batch
from frogkick.tables.image import Tables, open_image

TABLES = open_image(synthetic.image())
PATH = synthetic.wave_path()


def reference_cost(config: PlanConfig, x: float, y: float, heading: float) -> float:
    """Eq. 19 as its authors ran it, in float64."""
    distance = np.hypot(PATH.x_m.astype(float) - x, PATH.y_m.astype(float) - y)
    index = int(np.argmin(distance))
    angle = math.remainder(heading - float(PATH.tangent_rad[index]), 2 * math.pi)
    return float(
        config.distance_weight_per_m * distance[index]
        + config.angle_weight_per_rad * abs(angle)
        + config.progress_weight * (1 - index / (len(PATH.x_m) - 1))
    )


def reference_row(tables: Tables, codes: np.ndarray) -> int:
    """The nearest row; beyond all rows a velocity counts as the one at their edge."""
    states = tables.states.astype(np.int64)
    distance2 = ((states - np.clip(codes, states.min(axis=0), states.max(axis=0))) ** 2).sum(axis=1)
    return int(np.argmin(distance2))


def reference_plan(tables: Tables, config: PlanConfig, state: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """Every sequence of actions, one by one, in float64."""
    scale = tables.velocity_scale.astype(float)
    first = reference_row(tables, np.round(state[3:] / scale).astype(np.int64))
    best = (math.inf, ())
    for sequence in itertools.product(range(tables.transitions.shape[1]), repeat=config.depth):
        x, y, heading = state[:3]
        row, total = first, 0.0
        for level, action in enumerate(sequence):
            entry = tables.transitions[row, action]
            forward, left, turn = entry[:3] * tables.motion_scale.astype(float)
            x, y = (
                x + math.cos(heading) * forward - math.sin(heading) * left,
                y + math.sin(heading) * forward + math.cos(heading) * left,
            )
            heading += turn
            factor = 1 + config.level_weight * (config.depth - 1 - level)
            total += factor * reference_cost(config, x, y, heading)
            row = reference_row(tables, entry[3:].astype(np.int64))
        best = min(best, (total, sequence))
    return best


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_decisions_are_those_of_the_formulas(depth: int) -> None:
    tables = open_image(synthetic.image(60, 4, 2))
    config = PlanConfig(depth=depth)
    rng = np.random.default_rng(depth)
    for _ in range(count(40, 400)):
        state = rng.uniform([-0.1, -0.3, -3.1, 0, -0.03, -0.5], [1.1, 0.3, 3.1, 0.04, 0.03, 0.5])
        state = state.astype(np.float32).astype(float)
        cost, sequence = reference_plan(tables, config, state)
        found = plan(tables, PATH, config, state)
        assert float(found.cost) == pytest.approx(cost, rel=2e-5)
        assert found.action == sequence[0]
        distance = np.hypot(PATH.x_m - state[0], PATH.y_m - state[1])
        assert found.path_index == int(np.argmin(distance))


def test_the_prediction_is_the_table_s_entry_turned_into_the_world() -> None:
    state = np.array([0.2, 0.1, 2.0, 0.011, -0.002, 0.1], dtype=np.float32)
    found = plan(TABLES, PATH, PlanConfig(), state)
    entry = TABLES.transitions[found.nearest_state, found.action]
    forward, left, turn = entry[:3] * TABLES.motion_scale.astype(float)
    cosine, sine = math.cos(2.0), math.sin(2.0)
    wanted = [0.2 + cosine * forward - sine * left, 0.1 + sine * forward + cosine * left, 2.0 + turn]
    np.testing.assert_allclose(found.predicted[:3], wanted, atol=1e-6)
    np.testing.assert_array_equal(found.predicted[3:], entry[3:].astype(np.float32) * TABLES.velocity_scale)


def test_the_nearest_state_is_exact_and_ties_take_the_lowest_row() -> None:
    tables = synthetic.grid_tables()
    rng = np.random.default_rng(4)
    low, high = tables.states.min(axis=0) - 900, tables.states.max(axis=0) + 900
    codes = rng.integers(low, high, (count(3000, 30000), 3))
    codes[::2] = codes[::2] // 400 * 400  # half way between grid points
    states = np.zeros((len(codes), 6))
    states[:, 3:] = codes * tables.velocity_scale.astype(float)
    rows = plan_batch(tables, PATH, PlanConfig(), states)
    edge = np.clip(
        codes, tables.states.min(axis=0), tables.states.max(axis=0)
    )  # a velocity beyond counts as there
    distance2 = ((tables.states.astype(np.int64)[None] - edge[:, None]) ** 2).sum(axis=2)
    ties = (distance2 == distance2.min(axis=1, keepdims=True)).sum(axis=1)
    assert (ties > 1).sum() > 100
    np.testing.assert_array_equal(rows["nearest_state"], distance2.argmin(axis=1))


def test_equal_branches_take_the_lowest_action() -> None:
    config = PlanConfig(0.0, 0.0, 0.0, 0.0, depth=2)
    found = plan(TABLES, PATH, config, np.zeros(6))
    assert found.action == 0
    assert found.cost == 0.0


@pytest.mark.parametrize(
    ("state", "status"),
    [
        ([np.nan, 0, 0, 0, 0, 0], kernel.ERROR_NOT_FINITE),
        ([0, 0, 0, 0, 0, -np.inf], kernel.ERROR_NOT_FINITE),
        ([0, 0, 0, 1e39, 0, 0], kernel.ERROR_NOT_FINITE),  # infinite in float32
        ([1000.1, 0, 0, 0, 0, 0], kernel.ERROR_RANGE),
        ([0, -1000.1, 0, 0, 0, 0], kernel.ERROR_RANGE),
        ([0, 0, 1000.1, 0, 0, 0], kernel.ERROR_RANGE),
    ],
)
def test_a_state_without_a_plan_says_why(state: list[float], status: int) -> None:
    with pytest.raises(PlanError, match="check the position fixes") as caught:
        plan(TABLES, PATH, PlanConfig(), state)
    assert caught.value.status == status
    assert "\n" not in str(caught.value)
    row = plan_batch(TABLES, PATH, PlanConfig(), [state])[0]
    assert row["status"] == status
    assert row["cost"] == 0.0


def test_limits_and_huge_velocities_are_planned() -> None:
    states = [[1000, -1000, 1000, 0, 0, 0], [0, 0, 0, 3e38, -3e38, 3e38], [0, 0, 0, 1e-45, -0.0, 0]]
    rows = plan_batch(TABLES, PATH, PlanConfig(depth=2), states)
    assert not rows["status"].any()
    assert np.isfinite(rows["cost"]).all()


@pytest.mark.parametrize(
    ("config", "status"),
    [
        (PlanConfig(depth=0), kernel.ERROR_DEPTH),
        (PlanConfig(depth=5), kernel.ERROR_DEPTH),
        (PlanConfig(depth=257), kernel.ERROR_DEPTH),
        (PlanConfig(distance_weight_per_m=-1.0), kernel.ERROR_WEIGHT),
        (PlanConfig(angle_weight_per_rad=float("nan")), kernel.ERROR_WEIGHT),
        (PlanConfig(progress_weight=1.1e6), kernel.ERROR_WEIGHT),
        (PlanConfig(level_weight=-0.0), kernel.ERROR_WEIGHT),
    ],
)
def test_an_unusable_configuration_is_refused(config: PlanConfig, status: int) -> None:
    with pytest.raises(PlanError) as caught:
        plan(TABLES, PATH, config, np.zeros(6))
    assert caught.value.status == status


def test_an_unusable_path_is_refused() -> None:
    for points in (1, 101):
        with pytest.raises(PlanError, match="2 to 100 points"):
            plan(TABLES, synthetic.wave_path(points), PlanConfig(), np.zeros(6))
    for column, value in (("x_m", np.nan), ("y_m", 1001.0), ("tangent_rad", np.inf)):
        broken = synthetic.wave_path()
        getattr(broken, column)[50] = value
        with pytest.raises(PlanError, match="path point") as caught:
            plan(TABLES, broken, PlanConfig(), np.zeros(6))
        assert caught.value.status == kernel.ERROR_PATH_POINT
    uneven = synthetic.WavePath(PATH.x_m, PATH.y_m[:50], PATH.tangent_rad)
    with pytest.raises(InputError, match=r"\[100, 50, 100\]"):
        plan(TABLES, uneven, PlanConfig(), np.zeros(6))


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match=r"\(3, 5\)"):
        plan_batch(TABLES, PATH, PlanConfig(), np.zeros((3, 5)))
    with pytest.raises(InputError, match="depths"):
        plan_batch(TABLES, PATH, PlanConfig(), np.zeros((3, 6)), [1, 2])


angles = st.floats(-2100, 2100, width=32)


@given(angles)
def test_wrapped_angles_are_the_same_direction_within_half_a_turn(angle: float) -> None:
    wrapped = float(floats.wrap_angle(np.float32(angle)))
    pi = float(np.float32(np.pi))
    assert -pi < wrapped <= pi
    assert abs(math.remainder(wrapped - angle, 2 * math.pi)) <= 4e-7


@given(angles)
def test_sine_and_cosine_are_within_a_ten_millionth(angle: float) -> None:
    sine, cosine = floats.sincos(np.float32(angle))
    assert abs(float(sine) - math.sin(angle)) <= 1.6 * 2**-24
    assert abs(float(cosine) - math.cos(angle)) <= 1.6 * 2**-24


def test_angles_beyond_the_range_are_nan() -> None:
    for angle in (2100.1, -2100.1, np.inf, -np.inf, np.nan):
        assert np.isnan(floats.wrap_angle(np.float32(angle)))
        assert np.isnan(floats.sincos(np.float32(angle))).all()


@pytest.mark.parametrize("lead", [0.0, 0.4, 0.8])
def test_a_branch_costs_how_far_beside_the_path_its_end_glides(lead: float) -> None:
    """One action beside a straight path along x: the cost rises by the Huber loss of where it glides to."""
    tables = open_image(synthetic.image(60, 1, 2))
    along = np.linspace(0.0, 1.0, 21).astype(np.float32)
    path = synthetic.WavePath(along, np.zeros_like(along), np.zeros_like(along))
    rng, soft_m, weight, losses = np.random.default_rng(5), 0.02, 300.0, []
    for _ in range(count(40, 400)):
        state = rng.uniform([0.3, -0.04, -3.1, 0, -0.03, -0.5], [0.5, 0.04, 3.1, 0.04, 0.03, 0.5])
        base = PlanConfig(1000.0, 100.0, 0.0, 0.0, 500.0, 0.1, soft_m, cost=costs.COST_ROUTE)
        glides = dataclasses.replace(base, glide_weight_per_m=weight, glide_lead=lead)
        start = round(20 * float(state[0]))
        before, after = (plan(tables, path, each, state, along_points=start) for each in (base, glides))
        x_m, y_m, heading = before.predicted[:3].astype(float)
        turn = math.remainder(heading - float(np.float32(state[2])), 2 * math.pi)
        beside_m = abs(y_m + lead * ((y_m - state[1]) + turn * (x_m - state[0])))
        loss = beside_m**2 / (2 * soft_m) if beside_m < soft_m else beside_m - soft_m / 2
        assert float(after.cost) - float(before.cost) == pytest.approx(weight * loss, abs=2e-3)
        losses.append(loss)
    assert min(losses) < soft_m / 4 < max(losses)


@pytest.mark.parametrize("course", [0.0, 20.0, 300.0, 1e6])
def test_a_branch_costs_the_angle_between_its_course_and_the_path_ahead(course: float) -> None:
    """The course by complex numbers: the heading before, plus the motion in the body frame times its weight,
    turned by the motion's turn and its lead."""
    tables, look_ahead_m, lead, weight = open_image(synthetic.image(60, 1, 2)), 0.08, 0.5, 100.0
    along = np.linspace(0.0, 1.0, 21).astype(np.float32)
    path = synthetic.WavePath(along, np.zeros_like(along), np.zeros_like(along))
    rng, angles = np.random.default_rng(6), []
    for _ in range(count(40, 400)):
        state = rng.uniform([0.3, -0.04, -1.4, 0, -0.03, -0.5], [0.5, 0.04, 1.4, 0.04, 0.03, 0.5])
        base = PlanConfig(1000.0, 0.0, 0.0, 0.0, 500.0, look_ahead_m, 0.02, cost=costs.COST_ROUTE)
        aims = dataclasses.replace(
            base, angle_weight_per_rad=weight, turn_lead=lead, course_weight_per_m=course
        )
        start = round(20 * float(state[0]))
        before, after = (plan(tables, path, each, state, along_points=start) for each in (base, aims))
        x_m, y_m, heading = before.predicted[:3].astype(float)
        if x_m < state[0]:
            continue  # the route begins a little behind the robot: no place further back
        first = np.exp(1j * float(np.float32(state[2])))
        motion = (complex(x_m, y_m) - complex(*state[:2])) / first
        turn = math.remainder(heading - float(np.float32(state[2])), 2 * math.pi)
        way = first * (1.0 + course * motion) * np.exp(1j * (1.0 + lead) * turn)
        angles.append(abs(np.angle(way / complex(look_ahead_m, -y_m))))
        expected = weight * 2.0 * math.sin(angles[-1] / 2.0)
        assert float(after.cost) - float(before.cost) == pytest.approx(expected, abs=0.04)
    assert min(angles) < 0.3 < 1.0 < max(angles)
