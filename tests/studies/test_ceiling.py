"""The ceiling of tables: the rods tell exactly what comes, a bad table does not, and the study says so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import typeof
from tests.conftest import count, from_ci
from tests.identification import made

from frogkick.cli.main import run_command
from frogkick.der import STEP_S, WIDTH, Batch
from frogkick.effects import rods_of
from frogkick.effects.acting import lane_effects, program_of
from frogkick.library import Library, fit_table, quantise, sample_library, write_library
from frogkick.paths import shape
from frogkick.planner.lookup import arrays_of
from frogkick.planner.plan import Cost, PlanConfig, config_of, plan
from frogkick.robot import parse_robot
from frogkick.tables.image import open_image
from frogkick_studies.ceiling import CeilingStudy, mean_of, more_than, over_seeds, rms_error
from frogkick_studies.rods_in_loop import (
    AFFINE,
    NEAREST,
    RODS,
    SETTLE_S,
    SOURCES,
    TIME,
    Run,
    ask_rods,
    follow_paths,
    table_of_motions,
)

ROBOT = made.robot()
ACTIONS = len(ROBOT.actions)
LINE_M = float(np.hypot(*np.diff(shape("line").points_m[[0, -1]], axis=0)[0]))
THREE_DECISIONS_S = SETTLE_S + 2.5 * ROBOT.period_s


@pytest.fixture(scope="module")
def library() -> Library:
    return sample_library(ROBOT, 60, 4, "box")


@pytest.fixture(scope="module")
def images(library: Library) -> dict[str, bytes]:
    """A good table and, as the nearest one, a bad one: of one state."""
    return {AFFINE: fit_table(library, "affine").image, NEAREST: quantise(library.part(np.arange(1)))}


@pytest.fixture(scope="module")
def whole_runs(images: dict[str, bytes]) -> list[Run]:
    return follow_paths(ROBOT, images, ["line"], [1], count(3, 8, 2))


def test_the_rods_tell_to_the_last_bit_what_sequences_lead_to() -> None:
    lanes, depth = 2, 2
    robot = replace(ROBOT, actions=ROBOT.actions[3:6])
    rng = np.random.default_rng(3)
    begin = rng.normal(0.0, 0.3, (lanes, 3))
    batch = Batch([rods_of(robot)] * lanes, begin, np.zeros_like(begin), 0.0, STEP_S, WIDTH)
    acting = lane_effects(robot, lanes)
    period = robot.period_s

    def swim(actions: list[int]) -> np.ndarray:
        start_s, before = float(batch.time_s[0]), batch.pose_world()
        for lane, action in enumerate(actions):
            acting.fire_all(batch, lane, program_of(robot, robot.actions[action], start_s))
        acting.advance(batch, start_s + period)
        moved = batch.pose_world() - before
        turn = np.arctan2(np.sin(moved[:, 2]), np.cos(moved[:, 2]))
        c, s = np.cos(before[:, 2]), np.sin(before[:, 2])
        return np.stack([c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0], turn], axis=1)

    swim([2, 0])  # its strokes go on in what is asked
    nodes = batch.nodes_world()
    reported = ask_rods(robot, batch, acting, depth)
    assert reported.shape == (lanes, 1 + 3, 3, 3)
    assert np.array_equal(batch.nodes_world(), nodes)
    first, second = [1, 2], [2, 0]
    for made, expected in (
        (swim(first), [reported[lane, 0, first[lane]] for lane in range(lanes)]),
        (swim(second), [reported[lane, 1 + first[lane], second[lane]] for lane in range(lanes)]),
    ):
        assert np.abs(made).max() > 1e-3
        assert made == pytest.approx(np.array(expected), abs=1e-14)


def leading(nodes: int, forward_m: float) -> np.ndarray:
    motions = np.zeros((nodes, ACTIONS, 3))
    motions[..., 0] = forward_m
    return motions


@from_ci
@pytest.mark.parametrize("config", [PlanConfig(), config_of(ROBOT.planner)], ids=["paper", "route"])
def test_the_planner_finds_what_a_tree_holds(config: PlanConfig, images: dict[str, bytes]) -> None:
    class Straight:
        x_m = np.linspace(0.0, 1.0, 100).astype(np.float32)
        y_m = np.zeros(100, dtype=np.float32)
        tangent_rad = np.zeros(100, dtype=np.float32)

    like = open_image(images[AFFINE])

    def chosen(motions: np.ndarray, depth: int) -> int:
        tree = table_of_motions(motions, like)
        assert [typeof(part) for part in arrays_of(tree)] == [typeof(part) for part in arrays_of(like)]
        asked = PlanConfig(**{**config.__dict__, "depth": depth, "transitions_max": 0})
        made = plan(tree, Straight(), asked, np.zeros(6))
        assert made.predicted[:3] == pytest.approx(motions[0, made.action], abs=1e-4)
        return made.action

    resting = next(k for k, action in enumerate(ROBOT.actions) if not action.first_mask | action.second_mask)
    for action in set(range(ACTIONS)) - ({resting} if config.cost == Cost.ROUTE else set()):
        motions = leading(1, 0.01)
        motions[0, action, 0] = 0.05
        assert chosen(motions, 1) == action
    for depth in (2,) if config.cost == Cost.ROUTE else (2, 3):  # the route cost's 3 is a beam search
        motions = leading(sum(ACTIONS**level for level in range(depth)), 0.01)
        node = 0
        for action in (6, 2, 4)[: depth - 1]:
            node = 1 + node * ACTIONS + action
        motions[node, 4, 0] = 0.2  # further than the table's longest: it is not cut
        assert chosen(motions, depth) == 6
        assert float(table_of_motions(motions, like).stroke_max_m) == pytest.approx(0.2, abs=0.1)


@from_ci
def test_nothing_is_more_exact_than_the_rods_and_a_bad_table_is_off(whole_runs: list[Run]) -> None:
    of = {source: [run for run in whole_runs if run.source == source] for source in SOURCES}
    for run in of[RODS]:
        assert run.completed
        assert len(run.told) > 8
        assert run.progress_mps * len(run.told) * ROBOT.period_s == pytest.approx(LINE_M, rel=0.2)
        assert not run.told.any()
        # But for the planner's float32: position in m, heading in rad.
        assert np.abs(run.planned[:, :2]).max() < count(20, 20, 30) * 1e-6
        assert np.abs(run.planned[:, 2]).max() < 30e-6
    for name, least in (("position_m", 1e-3), ("heading_rad", 0.02)):
        reported = {source: rms_error(of[source], "told")[name] for source in SOURCES}
        planned = {source: rms_error(of[source], "planned")[name] for source in SOURCES}
        assert reported[NEAREST] > least
        assert reported[NEAREST] > 4.0 * reported[AFFINE] > 0.0
        assert planned[NEAREST] > 2.0 * planned[AFFINE] > 10.0 * planned[RODS]
    distance = {source: over_seeds(of[source], "mean_distance_m").value for source in SOURCES}
    assert distance[NEAREST] > 5.0 * distance[RODS]
    more = more_than(of[NEAREST], of[RODS], "mean_distance_m")
    assert more.value == pytest.approx(distance[NEAREST] - distance[RODS])


@from_ci
def test_a_seed_has_its_run_whatever_else_runs(images: dict[str, bytes]) -> None:
    reported: list[tuple[int, int]] = []
    three = follow_paths(
        ROBOT, images, ["ellipse"], [1], 3, THREE_DECISIONS_S, 1, lambda *done: reported.append(done)
    )
    one = follow_paths(ROBOT, images, ["ellipse"], [1], 1, THREE_DECISIONS_S)
    assert reported[0] == (0, 9)
    assert reported[-1] == (9, 9)
    assert [(run.source, run.seed) for run in three] == [(s, seed) for s in SOURCES for seed in range(3)]
    for alone, beside in zip(one, [run for run in three if run.seed == 0], strict=True):
        assert alone.ended == beside.ended == TIME
        assert len(alone.planned) == 3
        assert (alone.mean_distance_m, alone.progress_mps) == (beside.mean_distance_m, beside.progress_mps)
        assert np.array_equal(alone.planned, beside.planned)
        assert np.array_equal(alone.told, beside.told)
    rods = [run for run in three if run.source == RODS]
    assert len({run.mean_distance_m for run in rods}) == 3
    # Some begin before the start, where the ellipse ends as well.
    assert all(0.0 < run.progress_mps < 0.05 for run in rods)


def made(source: str, path: str, seed: int, far_m: float, depth: int = 1, ended: str = "completed") -> Run:
    errors = np.array([[3e-3, 4e-3, 0.1]])
    return Run(path, source, depth, seed, far_m, 0.03, ended, errors, 2.0 * errors)


def test_means_intervals_and_pairs() -> None:
    assert mean_of([1.0, 2.0, 3.0]).value == 2.0
    assert mean_of([1.0, 2.0, 3.0]).half_width == pytest.approx(4.302653 / 3.0**0.5)  # t of 2 degrees
    assert np.isnan(mean_of([1.0]).half_width)
    runs = [made(AFFINE, path, seed, far) for path, seed, far in
            (("line", 0, 1.0), ("sine", 0, 3.0), ("line", 1, 2.0), ("sine", 1, 6.0))]  # fmt: skip
    rods = [made(RODS, run.path, run.seed, run.mean_distance_m - 0.5) for run in reversed(runs)]
    assert over_seeds(runs, "mean_distance_m") == mean_of([2.0, 4.0])
    assert more_than(runs, rods, "mean_distance_m") == mean_of([0.5, 0.5])
    assert rms_error(runs, "told") == pytest.approx({"position_m": 0.01, "heading_rad": 0.2})


def test_the_picture_has_every_source_and_units() -> None:
    runs = [
        made(source, path, seed, 0.001 * place * (seed + 1), depth)
        for place, source in enumerate(SOURCES, start=1)
        for path in ("line", "sine")
        for depth in (1, 2)
        for seed in (0, 1)
    ]
    figure = CeilingStudy(runs, (1, 2), 2, {}).plot()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[:2] == ["mean distance to the path (mm)"] * 2
    assert labels[2::3] == ["position error (mm)", "heading error (degrees)"]
    bars = sorted(round(bar.get_height(), 6) for bar in figure.axes[0].patches)
    assert bars == [1.5] * 3 + [3.0] * 3 + [4.5] * 3
    assert len({bar.get_facecolor() for bar in figure.axes[0].patches}) == len(SOURCES)
    assert not figure.axes[0].texts
    stopped = [
        made(source, "line", seed, 0.001, 1, TIME if seed else "completed")
        for source in SOURCES
        for seed in range(3)
    ]
    said = {text.get_text() for text in CeilingStudy(stopped, (1,), 3, {}).plot().axes[0].texts}
    assert said == {"2 of 3\nnot to\nthe end"}


@from_ci
def test_the_command_tells_draws_and_refuses(
    library: Library, images: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, table, picture = tmp_path / "lib.h5", tmp_path / "own.fkt", tmp_path / "ceiling.png"
    write_library(library, file)
    table.write_bytes(images[AFFINE])
    short = ("--seeds", "2", "--depth", "1", "--simulated-time", str(SETTLE_S + 0.5), "--workers", "1")
    command = ["study", "ceiling", str(file), *short]
    assert run_command([*command, "--tables", str(table), "--out", str(picture), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [(row["path"], row["source"]) for row in output["rows"]] == [
        (path, source) for path in ("line", "sine", "ellipse", "all") for source in SOURCES
    ]
    assert all(row["decisions"] == 2 * (3 if row["path"] == "all" else 1) for row in output["rows"])
    assert output["one_stroke_ahead"][RODS]["told"] == {"position_m": 0.0, "heading_rad": 0.0}
    assert [row["source"] for row in output["further_than_rods_m"]] == [NEAREST, AFFINE]
    assert output["table_bytes"][AFFINE] == len(images[AFFINE])
    assert run_command(command) == 0
    assert "further from the paths than the rods" in capsys.readouterr().out
    strangers = []
    for old, new in (('"frog2022"', '"newt"'), ("period_s = 1.425", "period_s = 1.6")):
        assert old in ROBOT.toml
        stranger = parse_robot(ROBOT.toml.replace(old, new), source="stranger")
        strangers.append(tmp_path / f"{len(strangers)}.fkt")
        strangers[-1].write_bytes(quantise(sample_library(stranger, 2, 0, "box")))
    for wrong in (
        ["study", "ceiling", str(tmp_path / "none.h5")],
        [*command, "--tables", str(file)],
        *([*command, "--tables", str(stranger)] for stranger in strangers),
        [*command, "--out", str(tmp_path)],
        [*command, "--depth", "4"],
    ):
        assert run_command(wrong) == 2
