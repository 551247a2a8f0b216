"""The study of the twin: worlds and starts from files, what a planner believed, and a verdict by figures."""

from __future__ import annotations

import dataclasses
import functools
import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.conftest import count, from_ci
from tests.identification import made
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.library import Library, build_library
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig, path_rows, plan
from frogkick.robot import Robot, load_robot, parse_robot
from frogkick.runs.recorded.importer import read_recorded
from frogkick.tables.image import open_image
from frogkick_studies import in_pool
from frogkick_studies import twin as twin_module
from frogkick_studies.in_pool import PAPER, ROBOT, Case, Outcome, PathTask, shape_task
from frogkick_studies.inverse_planning import Choices, assumed_motions, choices_of, image_of_motions
from frogkick_studies.twin import (
    ASSUMED,
    FULL,
    TWIN,
    body_of,
    mean_over,
    planners_of_twin,
    read_runs,
    require_related,
    world_of,
)

MOTION = np.array(
    [
        [0.010, 0.000, 0.00],
        [0.035, 0.000, 0.00],
        [0.024, -0.006, -0.21],
        [0.024, 0.006, 0.21],
        [0.019, -0.004, -0.50],
        [0.019, 0.004, 0.50],
        [0.010, -0.002, -0.25],
        [0.010, 0.002, 0.25],
        [0.003, 0.000, 0.00],
    ]
)
"""What a planner of these tests believes: forward, left (m), turn (rad) of actions A to I."""


def measured() -> Robot:
    return load_robot("frog2022-measured")


def chosen(path_name: str, count: int, seed: int) -> Choices:
    """What the paper's planner chooses near a path where it believes in MOTION."""
    tables, path = open_image(image_of_motions(rig.robot(), MOTION)), shape(path_name)
    rng = np.random.default_rng(seed)
    at = rng.integers(0, len(path), count)
    poses = np.column_stack([path.x_m[at], path.y_m[at], path.tangent_rad[at]])
    poses = (poses + rng.normal(0.0, [0.02, 0.02, 0.4], (count, 3))).astype(np.float32)
    actions = [plan(tables, path, PlanConfig(), [*pose, 0.0, 0.0, 0.0]).action for pose in poses]
    return Choices(path_rows(path), poses, np.array(actions))


def test_the_pool_has_the_effects_of_the_file_and_the_robot_has_them_once() -> None:
    robot = measured()
    world = world_of(robot)
    assert world.name == TWIN and world.tables == robot.effects and len(world.world().effects) > 3
    assert body_of(robot).effects == () and body_of(robot).frame == rig.robot().frame
    with pytest.raises(InputError, match=r"has no \[\[effect\]\]"):
        world_of(rig.robot())
    with pytest.raises(InputError, match="without its folder"):
        world_of(parse_robot(robot.toml, source="text"))


def test_only_one_robots_two_files_are_compared() -> None:
    require_related(measured(), rig.robot())
    with pytest.raises(InputError, match="differ in id"):
        require_related(measured(), load_robot("hexapod"))
    with pytest.raises(InputError, match="differ in period_s"):
        require_related(measured(), dataclasses.replace(rig.robot(), period_s=1.5))
    limbs = (dataclasses.replace(rig.robot().limbs[0], name="tail"), *rig.robot().limbs[1:])
    with pytest.raises(InputError, match="other limbs"):
        require_related(measured(), dataclasses.replace(rig.robot(), limbs=limbs))


def test_the_robots_own_planner_with_its_own_table_is_the_last() -> None:
    planners = planners_of_twin(measured(), True)
    assert [planner.table for planner in planners] == [PAPER, ASSUMED, FULL, ROBOT]
    assert [planner.own for planner in planners] == [False, False, True, True]
    assert all(planner.config == PlanConfig() for planner in planners[:2])
    assert planners[-1].config.depth == measured().planner.depth
    assert [planner.table for planner in planners_of_twin(measured(), False)] == [PAPER, FULL, ROBOT]


def test_recorded_runs_give_path_start_and_figures(frog2022_dir: Path, tmp_path: Path) -> None:
    runs = {run.task.name: run for run in read_runs(frog2022_dir / "control")}
    assert "line1" in runs and "ellipse1" in runs
    line, ellipse = runs["line1"], runs["ellipse1"]
    assert line.mean_distance_m == pytest.approx(0.0178, abs=1e-4)
    assert ellipse.mean_distance_m == pytest.approx(0.0640, abs=1e-4)
    for run in runs.values():
        x, y, heading = run.task.start_world
        assert np.hypot(x - run.task.path.x_m[0], y - run.task.path.y_m[0]) < 0.01
        assert -np.pi < heading <= np.pi
    # An ellipse begins across the robot's heading, a line along it.
    assert abs(line.task.start_world[2] - line.task.path.tangent_rad[0]) < 0.1
    assert abs(ellipse.task.start_world[2] - ellipse.task.path.tangent_rad[0]) == pytest.approx(1.55, abs=0.1)
    with pytest.raises(InputError, match="no run with its path"):
        read_runs(tmp_path)
    with pytest.raises(InputError, match="no folder"):
        read_runs(tmp_path / "none")


def test_a_run_whose_labels_follow_no_clock_is_refused(frog2022_dir: Path, tmp_path: Path) -> None:
    """What a planner chose is only known where it is known when."""
    dice, label = random.Random(4), "B"
    head, rows = (frog2022_dir / "control" / "sin1.csv").read_text().splitlines()[:2], list[str]()
    for line in (frog2022_dir / "control" / "sin1.csv").read_text().splitlines()[2:]:
        label = dice.choice("ABCDEFG") if dice.random() < 0.12 else label
        rows.append(line.rsplit(",", 1)[0] + "," + label)
    (tmp_path / "sin9.csv").write_text("\n".join([*head, *rows]) + "\n")
    shutil.copy(frog2022_dir / "control" / "sinp1.csv", tmp_path / "sinp9.csv")
    with pytest.raises(InputError, match=r"'sin9\.csv' cannot be used: .*: leave it out"):
        read_runs(tmp_path)


def test_choices_are_where_the_newest_fix_was(frog2022_dir: Path) -> None:
    run = read_recorded(frog2022_dir / "control" / "line1.csv")
    choices = choices_of(run)
    assert len(choices.actions) == len(choices.poses_world) == 12
    third = run.decisions.time_s[2]
    newest = np.flatnonzero(run.fixes.time_s < third)[-1]
    assert choices.poses_world[2, 0] == np.float32(run.fixes.x_m[newest])


@from_ci
def test_what_a_planner_believes_is_found_from_what_it_chooses() -> None:
    runs = [chosen(name, 60, seed) for seed, name in enumerate(("line", "sine", "ellipse"))]
    begin = MOTION * [1.5, 0.5, 0.3]
    found = assumed_motions(runs, rig.robot(), begin)
    assert found.decisions == 180
    assert found.nominal_agreement < 0.6 < found.held_out_agreement
    assert found.agreement > 0.85
    # Of the strokes that are chosen most, to a sixth; mirrored ones are mirrored.
    assert found.motion[[4, 5], 2] == pytest.approx(MOTION[[4, 5], 2], rel=0.17)
    assert found.motion[1, 0] == pytest.approx(MOTION[1, 0], rel=0.17)
    assert np.array_equal(found.motion[2] * [1.0, -1.0, -1.0], found.motion[3])
    with pytest.raises(InputError, match="1 runs with 60 decisions"):
        assumed_motions(runs[:1], rig.robot(), begin)
    with pytest.raises(InputError, match="2 runs with 20 decisions"):
        assumed_motions([chosen("line", 10, 0), chosen("sine", 10, 1)], rig.robot(), begin)


def test_a_table_of_motions_moves_alike_at_any_velocity() -> None:
    tables = open_image(image_of_motions(rig.robot(), MOTION))
    path = shape("line")
    for velocity in ([0.0, 0.0, 0.0], [0.03, -0.01, 0.4]):
        made = plan(tables, path, PlanConfig(), [0.1, 0.0, 0.0, *velocity])
        assert (made.action, made.predicted[0]) == (1, pytest.approx(0.135, abs=2e-4))


def test_means_weigh_paths_alike() -> None:
    made = [
        ("line", 4.0, 20.0, True),
        ("sine", 8.0, 20.0, True),
        ("sine", 12.0, 500.0, False),
        ("line1", 30.0, 9.0, False),
    ]
    outcomes = {
        Case(TWIN, path, name, seed): Outcome(1e-3 * (mm + more), 1e-3 * mmps, done, "", 9)
        for seed, (path, mm, mmps, done) in enumerate(made)
        for name, more in (("paper", 0.0), ("robot", 1.0))
    }
    mean = mean_over(outcomes, "paper", ["line", "sine"])
    assert mean.mean_distance_m == pytest.approx(0.007), "not of the runs: 0.008"
    assert (mean.completed, mean.skipped) == (0.75, pytest.approx(1 / 3))
    alone = mean_over(outcomes, "robot", ["line1"])
    assert (alone.mean_distance_m, alone.completed, alone.skipped) == (pytest.approx(0.031), 0.0, 0.0)


def test_a_course_is_known_by_path_and_start() -> None:
    line = shape_task("line")
    assert line.start_world == (0.0, 0.0, 0.0)
    turned = PathTask("line", line.path, (0.0, 0.0, 1.0))
    assert len({line.sha256, turned.sha256, PathTask("line", shape("sine"), line.start_world).sha256}) == 3
    assert shape_task("line").sha256 == line.sha256


@pytest.fixture(scope="module")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Of the fitted robot and of the nominal one, few states."""
    folder = tmp_path_factory.mktemp("libraries")
    measured, nominal = made.robot("frog2022-measured"), made.robot()
    for name, robot, states in (("robot", measured, 48), ("model", nominal, count(48, 48, 4))):
        build_library(robot, states, 0, 1, folder / f"{name}.h5", sampling="box", record_s=0.0)
    return folder / "robot.h5", folder / "model.h5"


def words_of(tmp_path: Path, libraries: tuple[Path, Path]) -> list[str]:
    own, model = libraries
    words = ["study", "twin", "--library", str(own), "--model-library", str(model), "--seeds", "1"]
    words += [
        "--robot",
        made.robot_option(tmp_path, "frog2022-measured"),
        "--model",
        made.robot_option(tmp_path),
    ]
    return [*words, "--path", "line", "--out", str(tmp_path / "out"), "--workers", "1"]


@from_ci
def test_the_command_swims_shapes_in_the_twins_pool(
    tmp_path: Path, libraries: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    words = words_of(tmp_path, libraries)
    code = run_command([*words, "--json"])
    output = json.loads(capsys.readouterr().out)
    assert [row["planner"] for row in output["rows"]] == [
        "paper",
        "robot, full table",
        "robot",
    ]
    assert {(row["world"], row["path"]) for row in output["rows"]} == {(TWIN, "line")}
    assert code == (0 if output["passed"] else 1)
    assert output["passed"] is (output["mean_distance_m"] <= output["limit_m"])
    assert (
        output["recorded"] == {} and output["believed"] is None and output["recorded_mean_distance_m"] is None
    )
    with Image.open(tmp_path / "out" / "twin.png") as picture:
        assert picture.width > 700


@pytest.fixture(scope="module")
def shared() -> Iterator[None]:
    """The recorded runs are read once, and of each library one table is fitted."""
    read, fit = functools.cache(twin_module.read_runs), in_pool.fit_table
    fitted: dict[bytes, Any] = {}

    def once(library: Library, *how: Any) -> Any:
        sha256 = library.content_sha256()
        if sha256 not in fitted:
            fitted[sha256] = fit(library, *how)
        return fitted[sha256]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(twin_module, "read_runs", read)
        patch.setattr(in_pool, "fit_table", once)
        yield


@from_ci
@pytest.mark.usefixtures("shared")
@pytest.mark.parametrize(("far_mm", "code"), [({}, 0), ({"robot": 11.0}, 1)])
def test_the_exit_code_is_the_verdict(
    tmp_path: Path,
    libraries: tuple[Path, Path],
    frog2022_dir: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    far_mm: dict[str, float],
    code: int,
) -> None:
    """Runs are made up: on recorded paths a planner may be far off where it is near on shapes."""

    def made_up(*given: object) -> dict[Case, Outcome]:
        cases, path_tasks = given[4], given[8]
        assert isinstance(cases, list) and isinstance(path_tasks, list)
        names = {task.name for task in path_tasks}
        return {
            case: Outcome(
                1e-3 * (far_mm.get(case.planner, 9.0) if case.path in names else 9.0), 0.02, True, "", 9
            )
            for case in cases
        }

    begun = MOTION * 1.2
    monkeypatch.setattr(twin_module, "run_cases", made_up)
    monkeypatch.setattr(
        twin_module,
        "assumed_motions",
        lambda runs, robot, _nominal: dataclasses.replace(
            twin_module.AssumedMotions(begun, 0.7, 0.6, 0.2, sum(len(run.actions) for run in runs))
        ),
    )
    words = [*words_of(tmp_path, libraries), "--runs", str(frog2022_dir / "control")]
    assert run_command([*words, "--json"]) == code
    reported = json.loads(capsys.readouterr().out)
    assert reported["passed"] is (code == 0)
    assert reported["recorded"]["line1"]["mean_distance_m"] == pytest.approx(0.0178, abs=1e-4)
    means = [run["mean_distance_m"] for run in reported["recorded"].values()]
    assert reported["recorded_mean_distance_m"] == pytest.approx(np.mean(means))
    assert reported["believed"]["motion"]["E"]["turn_rad"] == pytest.approx(1.2 * MOTION[4, 2])
    assert [mean["planner"] for mean in reported["over_paths"]["recorded_paths"]][
        1
    ] == "paper, assumed motions"
    assert open_image((tmp_path / "out" / "believed.fkt").read_bytes()).states.shape == (1, 3)
    assert run_command(words) == code
    text = capsys.readouterr().out
    assert ("misses 10 mm" in text) is (code == 1) and "line1: recorded 17.8 mm" in text
    assert "  E:  2.28 cm forward, -0.48 cm left,  -34.4 deg" in text


@from_ci
def test_wrong_input_is_one_line(
    tmp_path: Path, libraries: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    words = words_of(tmp_path, libraries)
    for more, line in (
        (["--robot", "frog2022"], "has no [[effect]]"),
        (["--model", "hexapod"], "differ in id"),
        (["--runs", str(tmp_path / "none")], "does not exist: check the path"),
        (["--path", "lin"], "did you mean"),
        (["--library", str(libraries[1])], "build it again"),
    ):
        assert run_command([*words, *more]) == 2
        assert line in capsys.readouterr().err
