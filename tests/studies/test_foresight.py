"""Whole runs planned at once: they can be swum, short ones are the best there are, slower ones are nearer."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.paths import from_waypoints, shape
from frogkick.runs.summary import along_paths
from frogkick_studies.foresight import SAMPLES, OfflinePlan, nearest_at, plan_offline, swim

REST = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def sine() -> list[OfflinePlan]:
    path = shape("sine")
    return plan_offline(rig.tables(), path, (0.0, 0.0, float(path.tangent_rad[0])), breadth=60)


def test_a_slower_plan_stays_nearer_and_all_are_swum_as_told(sine: list[OfflinePlan]) -> None:
    path, tables = shape("sine"), rig.tables()
    assert len(sine) > 3
    assert [len(plan.actions) for plan in sine] == sorted({len(plan.actions) for plan in sine})
    assert all(later.mean_distance_m < plan.mean_distance_m for plan, later in itertools.pairwise(sine))
    for plan in sine:
        poses = swim(tables, plan.actions, (0.0, 0.0, float(path.tangent_rad[0])))
        np.testing.assert_array_equal(poses, plan.poses_world)
        assert len(poses) == SAMPLES * len(plan.actions) + 1
        assert np.hypot(*(poses[-1, :2] - path.points_m[-1])) < 0.06
    assert nearest_at(sine, 0.0) == sine[-1].mean_distance_m
    assert nearest_at(sine, sine[0].progress_mps) == sine[0].mean_distance_m
    assert nearest_at(sine, 1.0) is None


def test_a_larger_breadth_finds_nearer_plans(sine: list[OfflinePlan]) -> None:
    path = shape("sine")
    narrow = plan_offline(rig.tables(), path, (0.0, 0.0, float(path.tangent_rad[0])), breadth=4)
    wide = {len(plan.actions): plan.mean_distance_m for plan in sine}
    gain_m = [p.mean_distance_m - wide[len(p.actions)] for p in narrow if len(p.actions) in wide]
    assert len(gain_m) > 1 and np.mean(gain_m) > 0.0


@from_ci
def test_a_short_path_is_planned_as_trying_everything_finds() -> None:
    """All sequences of up to four actions, swum one by one."""
    path = from_waypoints([(0.0, 0.0), (0.06, 0.02)], smooth=False, points=40)
    tables = rig.tables()
    found = plan_offline(tables, path, REST, breadth=5000)
    best: dict[int, float] = {}
    for count in range(1, 5):
        for actions in itertools.product(range(len(tables.actions)), repeat=count):
            poses = swim(tables, actions, REST)
            times_s = np.arange(len(poses), dtype=np.float64)
            if path.nearest_index(poses[-1:, :2])[0] >= len(path.x_m) - 1:
                mean_m = along_paths([(-np.inf, path)], times_s, poses)[0]
                best[count] = min(best.get(count, np.inf), mean_m)
    assert best
    for plan in found:
        if len(plan.actions) in best:
            assert plan.mean_distance_m == pytest.approx(best[len(plan.actions)], abs=4e-4)


def test_a_path_out_of_reach_is_told() -> None:
    with pytest.raises(InputError, match=r"no plan comes to the end of path .* within 150 decisions"):
        plan_offline(rig.tables(), from_waypoints([(0.0, 0.0), (50.0, 0.0)], smooth=False), REST, breadth=1)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "f.png"
    arguments = ["study", "foresight", "--path", "line", "--tables", str(rig.small_table())]
    options = ["--breadth", "20", "--at-least", "0.02", "--out", str(picture), "--json"]
    assert run_command([*arguments, *options]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["nearest_m"] < 0.002
    assert min(plan["mean_distance_m"] for plan in output["plans"]) <= output["nearest_m"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert run_command([*arguments, "--at-least", "-1"]) == 2
    assert "--at-least -1.0 m/s" in capsys.readouterr().err
