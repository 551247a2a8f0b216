"""The beam search of the route cost's larger depths: by hand, its budget, its ties; always as the twin."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.codegen.test_planner_c import (
    AFFINE,
    EQUAL,
    IMAGES,
    NEAREST,
    ROUTE,
    STILL,
    Points,
    c_plan,
    some_states,
    twin_plan,
)
from tests.conftest import count
from tests.planner import synthetic

from frogkick.planner import beam
from frogkick.planner.plan import PlanConfig
from frogkick.tables.image import open_image

PATH = synthetic.wave_path()
STRAIGHT = Points([(x, 0.0, 0.0) for x in np.linspace(0.0, 3.0, 61)])
MOTIONS = [[0.050, 0.003, 0.12], [0.047, -0.004, -0.14], [0.031, 0.001, 0.02], [0.012, 0.002, -0.31]]
"""Of four actions, whatever was before: forward m, left m, turn rad."""
SAME = synthetic.pack(np.zeros((1, 3)), np.array([MOTIONS]), np.zeros((1, 4, 3)))


def told(image: bytes, path: Any, config: PlanConfig, given: tuple[Any, Any, Any]) -> list[dict[str, Any]]:
    """What the C answers, which the twin does too."""
    rows = c_plan(image, path, config, *given)
    assert rows == twin_plan(image, path, config, *given)
    return rows


def cost_of(row: dict[str, Any]) -> float:
    return float(np.frombuffer(row["cost"], np.float32)[0])


def by_hand(config: PlanConfig, state: np.ndarray) -> tuple[float, int]:
    """Cost and first action of a beam search along a straight path, in float64 and complex numbers."""
    tables = open_image(SAME)
    motions = tables.transitions[0, :, :3] * tables.motion_scale.astype(float)
    stroke_m = float(tables.stroke_max_m)
    kept = [(0.0, 0.0, -1, complex(*state[:2]), np.exp(1j * state[2]))]
    for _ in range(config.depth + beam.BEYOND):
        found = []
        for _, cost, first, place, heading in kept:
            for action, (forward, left, turn) in enumerate(motions):
                if first < 0 and action == 0:
                    continue  # fires nothing, and the robot rests
                there = place + heading * complex(forward, left)
                beside, soft = abs(there.imag), config.soft_distance_m
                loss = beside**2 / (2 * soft) if beside < soft else beside - soft / 2
                short = stroke_m - min(there.real - place.real, stroke_m)
                so_far = cost + config.distance_weight_per_m * loss + config.progress_weight_per_m * short
                course = 1.0 + config.course_weight_per_m * complex(forward, left)
                way = heading * course * np.exp(1j * (1.0 + config.turn_lead) * turn)
                off = np.angle(way / complex(config.look_ahead_m, -there.imag))
                value = so_far + config.angle_weight_per_rad * 2.0 * math.sin(abs(off) / 2.0)
                begins = action if first < 0 else first
                found.append((value, so_far, begins, there, heading * np.exp(1j * turn)))
        kept = sorted(found, key=lambda branch: branch[0])[: beam.WIDTH]
    return kept[0][0], kept[0][2]


@pytest.mark.parametrize("depth", [3, 4])
def test_it_costs_and_chooses_what_a_beam_by_hand_does(depth: int) -> None:
    number = count(30, 300)
    rng, config = np.random.default_rng(depth), PlanConfig(depth=depth, **ROUTE)
    states = np.zeros((number, 6), dtype=np.float32)
    states[:, 0] = rng.uniform(1.0, 1.5, number)
    states[:, 1:3] = rng.uniform([-0.06, -0.5], [0.06, 0.5], (number, 2))
    use, along = np.zeros((number, 8), dtype=np.uint16), 20.0 * states[:, 0]
    rows = told(SAME, STRAIGHT, config, (states, use, along))
    for row, state in zip(rows, states.astype(float), strict=True):
        cost, action = by_hand(config, state)
        assert cost_of(row) == pytest.approx(cost, rel=1e-4)
        assert row["action"] == action
        assert row["depth_reached"] == depth + beam.BEYOND
    assert len({row["action"] for row in rows}) > 1


@pytest.mark.parametrize("image", [NEAREST, AFFINE])
def test_a_budget_ends_it_between_levels(image: bytes) -> None:
    """Of five actions those that fire begin a branch where the robot is slow. Two levels are depth 2's."""
    given, actions, route = some_states(12, 100, 21), 5, ROUTE | {"look_ahead_m": 0.02}
    shallow = {level: c_plan(image, PATH, PlanConfig(depth=level, **route), *given) for level in (1, 2)}
    firsts = [row["transitions"] for row in shallow[1]]
    assert set(firsts) == {4, 5}
    reached = set()
    for depth in (3, 4):
        for limit in (1, 5, 23, 24, 29, 30, 31, 89, 90, 149, 150, 210, 269, 270, 330, 389, 390, 2**32 - 1):
            config = PlanConfig(depth=depth, transitions_max=limit, **route)
            for index, row in enumerate(told(image, PATH, config, given)):
                made, levels, parents = firsts[index], 1, firsts[index]
                while levels < depth + beam.BEYOND and made + parents * actions <= limit:
                    made, levels = made + parents * actions, levels + 1
                    parents = min(beam.WIDTH, parents * actions)
                assert (row["transitions"], row["depth_reached"]) == (made, levels)
                reached.add(levels)
                if levels == 2:
                    alone = shallow[2][index]
                    assert (row["action"], row["cost"]) == (alone["action"], alone["cost"])
    assert reached == set(range(1, 9))


GLIDE = {"glide_weight_per_m": 150.0, "glide_lead": 1.4}
WALLS = {
    "wall_weight_per_m": 5e4,
    "wall_glide": 2.0,
    "wall_x_min_m": 0.1,
    "wall_x_max_m": 0.9,
    "wall_y_min_m": -0.1,
    "wall_y_max_m": 0.1,
}


@pytest.mark.parametrize("kind", IMAGES)
@pytest.mark.parametrize(
    "weights", [GLIDE, GLIDE | WALLS, GLIDE | {"soft_distance_m": 0.0, "look_ahead_m": 1e6}]
)
def test_every_terminal_cost_is_the_twin_s(kind: str, weights: dict[str, float]) -> None:
    states = some_states(count(40, 400), 100, 5)
    told(IMAGES[kind], PATH, PlanConfig(depth=3, **(ROUTE | weights)), states)
    told(IMAGES[kind], PATH, PlanConfig(depth=4, **(ROUTE | weights | {"look_ahead_m": 0.0})), states)


@pytest.mark.parametrize("image", [EQUAL, STILL])
@pytest.mark.parametrize("weights", [{}, {"distance_weight_per_m": 0.0}, {"progress_weight_per_m": 0.0}])
def test_of_equal_branches_the_lowest_first_action_is_taken(image: bytes, weights: dict[str, float]) -> None:
    """Actions that are the same in groups, and a robot that nothing moves."""
    number = count(60, 600)
    for along in ([0.0], [3.0], None):
        states, use, places = some_states(number, 4, 8, spread_m=0.5)
        if along is not None:
            places[:] = along
        config = PlanConfig(depth=3, **(ROUTE | weights))
        rows = told(image, synthetic.wave_path(4), config, (states, use, places))
        alike = 3 if image is EQUAL else 2
        # The first of its group, or the first of it that fires.
        assert {row["action"] % alike for row in rows} <= {0, 1}


def test_of_equal_branches_that_are_found_late_the_lowest_first_action_is_taken() -> None:
    """Only to glide off the route costs anything. It is ten steps away; a stroke makes two, one or none.

    Five times two is on the route at once, and found first. What begins with one is there at the seventh.
    """
    unit_m, step = 2.0**-16, 2048  # of the table, so that all sums are exact; codes are rounded down
    beside = np.array([32766.0 - 0.001, step + 0.4, 2.0 * step + 0.4, 0.0]) * unit_m
    moves = np.array([[[0.01, left_m, 0.0] for left_m in beside]])
    image = synthetic.pack(np.zeros((1, 3)), moves, np.zeros((1, 4, 3)))
    tables = open_image(image)
    assert tables.motion_scale[1] == unit_m and list(tables.transitions[0, 1:, 1]) == [step, 2 * step, 0]
    glide = {"glide_weight_per_m": 150.0, "glide_lead": 0.1, "cost": ROUTE["cost"]}
    config = PlanConfig(0.0, 0.0, 0.0, 0.0, depth=3, **glide)
    states, use, along = some_states(count(40, 400), 60, 6)
    states[:], along[:] = 0.0, 0.0
    states[:, 1] = -10.0 * step * unit_m
    rows = told(image, STRAIGHT, config, (states, use, along))
    assert {(row["action"], cost_of(row)) for row in rows} == {(1, 0.0)}


def test_a_sequence_does_not_lead_beyond_a_wall_and_back() -> None:
    """Beside the route, which lies beyond the wall, the robot stays inside: every motion's end counts."""
    moves = np.array([[[0.0, 0.0, 0.0], [0.01, 0.03, 0.0], [0.01, -0.03, 0.0], [0.01, 0.0, 0.0]]])
    image = synthetic.pack(np.zeros((1, 3)), moves, np.zeros((1, 4, 3)))
    walls = {"wall_weight_per_m": 5e4, "wall_y_max_m": -0.005, "wall_glide": 0.0}
    config = PlanConfig(depth=3, **(ROUTE | walls))
    given = some_states(count(40, 400), 60, 6, spread_m=0.3)
    given[0][:], given[2][:] = 0.0, 0.0
    given[0][:, 1] = np.linspace(-0.034, -0.006, len(given[0]))
    assert {row["action"] for row in told(image, STRAIGHT, config, given)} <= {2, 3}


def test_a_branch_that_ends_at_its_look_ahead_has_no_direction_to_take() -> None:
    config = PlanConfig(depth=3, **(ROUTE | {"look_ahead_m": 0.0, "progress_weight_per_m": 0.0}))
    at_rest = (np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], np.float32), np.zeros((1, 8), np.uint16))
    (row,) = told(STILL, STRAIGHT, config, (*at_rest, np.zeros(1, np.float32)))
    assert cost_of(row) == 0.0
