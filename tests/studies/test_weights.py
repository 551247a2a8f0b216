"""Weights are tuned on some paths and judged on others; what is found is never worse where it was tuned."""

from __future__ import annotations

import dataclasses
import json
import tomllib

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.robot import load_robot
from frogkick_codegen.native import NativeLibrary
from frogkick_studies.weights import (
    POPULATION,
    TUNED,
    PathRuns,
    off_path_loss,
    random_path,
    score,
    swim,
    training_paths,
    tune,
)

CONFIG = dataclasses.replace(config_of(load_robot("frog2022").planner), depth=1)


@pytest.fixture(scope="module")
def library() -> NativeLibrary:
    return NativeLibrary()


def test_random_paths_bend_as_much_as_is_asked() -> None:
    for bend in (0.2, 0.6):
        path = random_path(np.random.default_rng(3), 0.06, bend)
        length_m = np.hypot(*np.diff(path.points_m, axis=0).T)
        assert length_m.sum() == pytest.approx(0.9, rel=0.03)
        turn = np.abs(np.diff(np.unwrap(path.tangent_rad.astype(float)))) / length_m * 0.06
        assert 0.3 * bend < turn.max() < 1.2 * bend
    paths = training_paths(np.random.default_rng(3), 0.06, 4)
    assert len(paths) == 9
    for path in paths.values():
        assert np.isfinite(path.points_m).all()


def test_a_run_by_the_table_ends_and_repeats(library: NativeLibrary) -> None:
    path = shape("line")
    first, again = (swim(library, rig.tables(), path, CONFIG, 3, 5) for _ in range(2))
    assert first == again and first.completed == 1.0
    assert 0.0 < first.distance_m < 0.02 and first.progress_mps > 0.015
    other = swim(library, rig.tables(), path, CONFIG, 3, 6)
    assert other != first
    weightless = dict.fromkeys(("distance_weight_per_m", "angle_weight_per_rad", "glide_weight_per_m"), 0.0)
    aimless = dataclasses.replace(CONFIG, **weightless)
    assert swim(library, rig.tables(), path, aimless, 3, 5).distance_m > first.distance_m


def test_a_run_from_astray_finds_its_path(library: NativeLibrary) -> None:
    near, beside, turned = (
        swim(library, rig.tables(), shape("line"), CONFIG, 3, 5, offset)
        for offset in ((0.0, 0.0), (1.5, 0.0), (0.0, -2.2))
    )
    for run in (beside, turned):
        assert run.completed == 1.0 and 2.0 * near.distance_m < run.distance_m < 0.1
    ends = [
        swim(library, rig.tables(), shape("line"), CONFIG, 3, 5, (1.5, 0.0), last).distance_m
        for last in (1000, 10, 3)
    ]
    assert ends[0] == beside.distance_m > ends[1] > ends[2] and ends[2] < 2.0 * near.distance_m


def test_the_score_prefers_near_runs_but_never_slow_ones() -> None:
    before = [PathRuns(0.004, 0.02, 1.0), PathRuns(0.008, 0.03, 1.0)]
    assert score(before, before) == 0.0
    nearer = [dataclasses.replace(each, distance_m=0.5 * each.distance_m) for each in before]
    assert score(nearer, before) == pytest.approx(np.log(0.5))
    assert (
        score([dataclasses.replace(each, progress_mps=0.9 * each.progress_mps) for each in nearer], before)
        > 0
    )
    assert (
        score([dataclasses.replace(each, progress_mps=1.1 * each.progress_mps) for each in before], before)
        == 0
    )
    assert score([dataclasses.replace(each, completed=0.5) for each in nearer], before) > 0
    lost = [before[0], PathRuns(0.08, 0.005, 0.0)]
    assert score([before[0], dataclasses.replace(lost[1], progress_mps=0.001)], lost) == 0.0


def test_no_run_from_astray_may_end_farther_than_before() -> None:
    before = [PathRuns(0.002, 0.02, 1.0), PathRuns(0.02, 0.03, 1.0)]
    assert off_path_loss(before, before, 0.005) == 0.0
    for distance_m, cost in ((0.004, 0.0), (0.01, np.log(2.0)), (0.02, np.log(4.0))):
        assert off_path_loss(
            [PathRuns(distance_m, 0.02, 1.0), PathRuns(0.01, 0.03, 1.0)], before, 0.005
        ) == pytest.approx(cost)
    assert off_path_loss([before[0], PathRuns(0.02, 0.03, 0.5)], before, 0.005) > 1.0


def test_what_is_found_is_the_best_that_was_tried() -> None:
    tried: list[float] = []

    def judge(config: PlanConfig) -> float:
        tried.append(
            abs(np.log(config.look_ahead_m / 0.05)) + abs(np.log(config.distance_weight_per_m / 400.0))
        )
        return tried[-1]

    found = tune(judge, CONFIG, 66, np.random.default_rng(1))
    assert len(tried) == 64, "whole populations"
    assert judge(found) == min(tried)
    assert min(tried) < 0.4 * tried[0]
    kept = {
        name: getattr(found, name) for name in ("progress_weight_per_m", "wall_weight_per_m", "depth", "cost")
    }
    assert kept == {name: getattr(CONFIG, name) for name in kept}


@from_ci
def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["study", "weights", "--tables", str(rig.small_table()), "--depth", "1"]
    few = ["--trials", "16", "--paths", "2", "--runs", "1"]
    assert run_command([*arguments, "--trials", str(POPULATION - 1)]) == 2
    assert f"{POPULATION}" in capsys.readouterr().err
    assert run_command([*arguments, *few, "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert set(output["weights"]) == set(TUNED)
    assert output["before"].keys() == output["after"].keys() and "line" not in output["before"]
    assert run_command([*arguments, *few]) == 0
    text = capsys.readouterr().out
    lines = tomllib.loads(text[text.index("distance_weight_per_m") :])
    assert lines == pytest.approx(output["weights"])
