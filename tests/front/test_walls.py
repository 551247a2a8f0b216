"""Walls that a run keeps away from: as settings, in the plan, and in the pool."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci

import frogkick as fk
from frogkick.core.errors import InputError
from frogkick.front.mission import MARGIN_M, WALL_GLIDE, WALL_WEIGHT_PER_M, with_walls
from frogkick.front.tables import default_tables, load_table
from frogkick.paths import from_waypoints
from frogkick.planner.plan import PlanConfig, config_of, plan


@pytest.fixture(scope="module")
def table() -> fk.Table:
    return load_table(default_tables("frog2022"))


def test_walls_stand_as_far_as_the_robot_reaches(table: fk.Table) -> None:
    plain = config_of(table.robot.planner)
    assert with_walls(plain, None, table) == plain
    made = with_walls(plain, "0,-1,2,1", table)
    away_m = np.hypot(0.045, 0.045) + 0.0355 + MARGIN_M
    assert (made.wall_weight_per_m, made.wall_glide) == (WALL_WEIGHT_PER_M, WALL_GLIDE)
    assert plain.course_weight_per_m > made.course_weight_per_m == 0.0, "the heading alone counts there"
    found = (made.wall_x_min_m, made.wall_x_max_m, made.wall_y_min_m, made.wall_y_max_m)
    assert found == pytest.approx((away_m, 2.0 - away_m, away_m - 1.0, 1.0 - away_m))
    assert with_walls(plain, (0.0, -1.0, 2.0, 1.0), table) == made


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ("0,0,1", "inside is '0,0,1': give X,Y,X,Y"),
        ("a,0,1,1", "give X,Y,X,Y"),
        ("1,0,0,1", "the lower numbers first"),
        ((0.0, 0.0, np.nan, 1.0), "give X,Y,X,Y"),
        ("0,0,1001,1", "give X,Y,X,Y"),
        ("pool", "give --fixes camera.toml"),
        ("0,0,0.19,1", "the robot has no room, as it reaches 0.099 m"),
    ],
)
def test_what_are_no_walls(table: fk.Table, inside: object, said: str) -> None:
    with pytest.raises(InputError, match=said):
        with_walls(config_of(table.robot.planner), inside, table)  # type: ignore[arg-type]


def test_the_published_cost_knows_no_walls(table: fk.Table) -> None:
    with pytest.raises(InputError, match="only the cost 'route'"):
        with_walls(PlanConfig(), "0,0,1,1", table)


def test_a_wall_turns_a_plan_away(table: fk.Table) -> None:
    """Where the path leads to a wall, the robot turns less that way than without."""
    path = from_waypoints([(0.0, 0.0), (0.0, 0.5)])
    plain = dataclasses.replace(config_of(table.robot.planner), course_weight_per_m=0.0)  # as between walls
    state = np.array([0.0, 0.0, 0.8, 0.02, 0.0, 0.0])
    free = plan(table.tables, path, plain, state)
    kept = plan(table.tables, path, with_walls(plain, (-1.0, -1.0, 1.0, 0.11), table), state)
    far = plan(table.tables, path, with_walls(plain, (-1.0, -1.0, 1.0, 3.0), table), state)
    assert (far.action, far.cost) == (free.action, free.cost)
    assert kept.predicted[2] < free.predicted[2] and kept.cost > free.cost


@from_ci
def test_before_a_wall_the_robot_turns(table: fk.Table) -> None:
    """A path that leads slantwise 60 mm further than the robot may go."""
    path = from_waypoints([(0.0, 0.0), (0.5, -0.08)])
    walls = (-1.0, -table.robot.reach_m - 0.02, 2.0, 1.0)
    free, kept = (
        fk.run(table, path, robot="pool", plan="both", time_limit_s=40.0, inside=inside)
        for inside in (None, walls)
    )
    reported = kept.as_json()
    assert free.as_json()["wall_clearance_m"] is None
    assert free.log.truth is not None
    assert free.log.truth.pose_world[:, 1].min() < -0.04  # without walls it goes where the path leads
    assert reported["wall_clearance_m"] > 0.0 and reported["mismatches"] == 0
    assert reported["progress_mps"] > 0.5 * free.as_json()["progress_mps"]


def test_a_log_keeps_the_walls(table: fk.Table, tmp_path: Path) -> None:
    walls = (-1.0, -1.0, 2.0, 1.0)
    run = fk.run(table, "line", robot="pool", time_limit_s=6.0, inside=walls, out=tmp_path / "a.h5")
    again = fk.load_run(tmp_path / "a.h5")
    assert again.as_json()["wall_clearance_m"] == pytest.approx(run.as_json()["wall_clearance_m"])
    assert fk.replay(tmp_path / "a.h5", plan="both", robot="pool").as_json()["mismatches"] == 0
