"""When a robot may choose to rest.

Slow it may not: at rest that changes nothing, so it would rest for ever. Nearing a wall it may not either.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from tests.codegen.test_planner_c import ROUTE, c_plan, twin_plan
from tests.planner import synthetic

from frogkick.planner.plan import Cost, PlanConfig
from frogkick.tables.image import open_image

PATH = synthetic.wave_path()
CONFIG = PlanConfig(**ROUTE)
PERIOD_S = 1.425
FIRES = [("A", 0, 0), ("B", 1, 0), ("C", 0, 0), ("D", 0, 4), ("E", 2, 1)]
STILL_ROWS = [(name, 0, 0) for name, _, _ in FIRES]


PLACES = np.random.default_rng(3).uniform([-0.05, -0.3, -math.pi], [0.2, 0.3, math.pi], (200, 3))


def decided(image: bytes, config: PlanConfig, *velocities: tuple[float, float, float]) -> list[int]:
    """Actions of the C, which are the twin's, from all around the path's start, at velocities."""
    states = np.array([[*place, *speed] for speed in velocities for place in PLACES], dtype=np.float32)
    given = (PATH, config, states, np.zeros((len(states), 8), np.uint16), np.zeros(len(states), np.float32))
    planned = c_plan(image, *given)
    assert planned == twin_plan(image, *given)
    return [row["action"] for row in planned]


def table(rows: list[tuple[str, int, int]]) -> bytes:
    """A table whose resting actions move the robot next to nothing."""
    parts = synthetic.affine_parts(60, len(rows), 1)
    for action in (0, 2):
        parts["base"][:, action] *= 1e-3
    return synthetic.affine_image(60, len(rows), action_rows=rows, **parts)


@pytest.mark.parametrize("limit", [0, 40])
@pytest.mark.parametrize("depth", [1, 2, 3])
def test_from_rest_it_moves_at_any_depth_and_within_any_budget(depth: int, limit: int) -> None:
    config = dataclasses.replace(CONFIG, depth=depth, transitions_max=limit)
    rests = {index for index, (_, first, second) in enumerate(FIRES) if not first | second}
    actions = decided(table(FIRES), config, (0.0, 0.0, 0.0), (1e-4, -1e-4, 1e-3))
    assert set(actions) and not rests & set(actions)


@pytest.mark.parametrize("turn_rad_s", [0.0, 3.0])
@pytest.mark.parametrize("axis", range(2))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_while_it_moves_it_may_rest(axis: int, sign: float, turn_rad_s: float) -> None:
    """Beyond three eighths of a reach in a period, whether it turns or not."""
    image = table(FIRES)
    reach_m = float(open_image(image).stroke_max_m)
    for part, may_rest in ((0.99, False), (1.01, True)):
        speed = [0.0, 0.0, turn_rad_s]
        speed[axis] = sign * part * 0.375 * reach_m / PERIOD_S
        actions = decided(image, CONFIG, (speed[0], speed[1], speed[2]))
        assert bool({0, 2} & set(actions)) is may_rest


def test_speed_counts_in_any_direction_and_any_size() -> None:
    image = table(FIRES)
    speed = 0.9 * 0.375 * float(open_image(image).stroke_max_m) / PERIOD_S
    for velocity in ((speed, speed, 0.0), (3e38, 0.0, 0.0), (0.0, -3e38, 0.0)):
        assert {0, 2} & set(decided(image, CONFIG, velocity))
    assert not {0, 2} & set(decided(image, CONFIG, (0.0, 0.0, 3e38)))


def test_where_its_speed_leads_beyond_a_wall_within_four_periods_it_may_not_rest() -> None:
    """The walls' cost is next to nothing here: they change which actions are candidates, and nothing else."""
    low, high = np.array([-0.15, -0.35]), np.array([0.3, 0.35])
    walls = dict(
        zip(("wall_x_min_m", "wall_y_min_m", "wall_x_max_m", "wall_y_max_m"), (*low, *high), strict=True)
    )
    config = dataclasses.replace(CONFIG, wall_weight_per_m=1e-6, **walls)
    speed = 0.05
    ahead_m = 4.0 * PERIOD_S * speed * np.stack([np.cos(PLACES[:, 2]), np.sin(PLACES[:, 2])], axis=1)
    there = PLACES[:, :2] + ahead_m
    beyond = np.hstack([there < low - 1e-4, there > high + 1e-4])
    assert beyond.any(axis=0).all(), "towards each of the four"
    inside = ((there > low + 1e-4) & (there < high - 1e-4)).all(axis=1)
    rests = np.isin(decided(table(FIRES), config, (speed, 0.0, 0.0)), (0, 2))
    free = np.isin(decided(table(FIRES), CONFIG, (speed, 0.0, 0.0)), (0, 2))
    assert not rests[beyond.any(axis=1)].any() and free[beyond.any(axis=1)].any()
    assert (rests[inside] == free[inside]).all() and rests[inside].any()
    for velocity in ((3e38, 0.0, 0.0), (3e38, -3e38, 0.0), (0.0, 3e38, 0.0)):
        assert not {0, 2} & set(decided(table(FIRES), config, velocity))


def test_a_table_that_can_only_rest_rests() -> None:
    assert set(decided(table(STILL_ROWS), CONFIG, (0.0, 0.0, 0.0))) <= set(range(5))
    assert {0, 2} & set(decided(table(STILL_ROWS), CONFIG, (0.0, 0.0, 0.0)))


def test_the_paper_s_cost_rests_as_it_did() -> None:
    paper = PlanConfig()
    assert paper.cost == Cost.PAPER
    assert {0, 2} & set(decided(table(FIRES), paper, (0.0, 0.0, 0.0)))
