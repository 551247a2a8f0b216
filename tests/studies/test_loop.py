"""The study of looking ahead: repeatable, resumable, worlds kept apart, and a verdict that figures decide."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.conftest import from_ci
from tests.identification.made import robot, robot_option
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.library import build_library
from frogkick.planner.plan import Cost, PlanConfig
from frogkick_studies import in_pool as study
from frogkick_studies import loop as loop_module
from frogkick_studies.in_pool import PAPER, ROBOT, Case, Outcome, Setting, Summary, run_cases, summaries
from frogkick_studies.loop import HIDDEN, NOMINAL, judge, loop_figure, planners_of, setting_of, settings_of

PLANNERS = planners_of(rig.robot())
NAMES = [planner.name for planner in PLANNERS]
PATH = "sine"
WORN = '[[effect]]\nname = "limb_wear"\nlimb = "rear_left"\ngain = 0.4\n'
Outcomes = dict[Case, Outcome]


def cases_of(
    settings: tuple[Setting, ...], seeds: int = 1, planners: tuple[str, ...] = ("paper",)
) -> list[Case]:
    return [Case(s.name, PATH, name, seed) for s in settings for name in planners for seed in range(seeds)]


def run(out: Path, settings: tuple[Setting, ...], cases: list[Case]) -> Outcomes:
    """With firmware that is built once for all tests here; the command's test builds its own."""
    tables = {PAPER: rig.small_table(), ROBOT: rig.small_table()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "build", lambda target, *_: rig.firmware(target))
        return run_cases(robot(), tables, PLANNERS, settings, cases, out)


@pytest.fixture(scope="module")
def swum(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcomes]:
    """Two seeds of the paper's planner and one each of the robot's, in the plain pool."""
    out = tmp_path_factory.mktemp("loop")
    cases = [*cases_of((NOMINAL,), 2), *cases_of((NOMINAL,), 1, ("robot, depth 1", "robot, depth 3"))]
    return out, run(out, (NOMINAL,), cases)


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[Case]:
    """The cases that are really run."""
    seen: list[Case] = []
    real = study._run

    def noting(ready: study._Ready, case: Case) -> Outcome:
        seen.append(case)
        return real(ready, case)

    monkeypatch.setattr(study, "_run", noting)
    return seen


def test_the_planners_are_the_papers_and_the_robots_own() -> None:
    assert NAMES == ["paper", "paper, depth 3", "robot, depth 1", "robot, depth 2", "robot, depth 3"]
    paper, *_ = PLANNERS
    assert (paper.table, paper.config, paper.own) == (PAPER, PlanConfig(), False)
    assert (paper.config.cost, paper.config.depth, paper.config.level_weight) == (Cost.PAPER, 1, 0.3)
    for depth, planner in enumerate(PLANNERS[2:], 1):
        assert (planner.table, planner.config.depth, planner.own) == (ROBOT, depth, True)
        assert planner.config.cost == Cost.ROUTE
        assert planner.config.distance_weight_per_m == rig.robot().planner.distance_weight_per_m
    deeper = dataclasses.replace(rig.robot(), planner=dataclasses.replace(rig.robot().planner, depth=4))
    assert planners_of(deeper)[-1].config.depth == 4, "the robot's own depth is always among them"


@from_ci
def test_a_run_is_that_of_its_seed_and_its_planner(tmp_path: Path, swum: tuple[Path, Outcomes]) -> None:
    _, outcomes = swum
    first, second, shallow, deep = outcomes.values()
    assert len({outcome.mean_distance_m for outcome in (first, second, shallow, deep)}) == 4
    for outcome in outcomes.values():
        assert outcome.completed and outcome.ended == "completed"
        assert 0.0 < outcome.mean_distance_m < 0.3 and 0.005 < outcome.progress_mps < 0.05
    again = run(tmp_path, (NOMINAL,), cases_of((NOMINAL,), 2)[1:])
    assert list(again.values()) == [second]


@from_ci
def test_what_was_run_is_not_run_again(
    tmp_path: Path, swum: tuple[Path, Outcomes], counted: list[Case]
) -> None:
    folder, outcomes = swum
    kept = tmp_path / "runs.jsonl"
    whole = (folder / "runs.jsonl").read_text(encoding="utf-8")
    kept.write_text(whole, encoding="utf-8")
    assert run(tmp_path, (NOMINAL,), list(outcomes)) == outcomes
    assert counted == []
    # A stop in the middle of a line: that case alone is run again, to the same bits, and the file is whole.
    kept.write_text(whole[:-40], encoding="utf-8")
    assert run(tmp_path, (NOMINAL,), list(outcomes)) == outcomes
    assert counted == [list(outcomes)[-1]]
    assert kept.read_text(encoding="utf-8") == whole
    # Other tables, planners or code: nothing of it counts.
    kept.write_text(whole.replace('{"stamp": "', '{"stamp": "0', 1), encoding="utf-8")
    run(tmp_path, (NOMINAL,), cases_of((NOMINAL,)))
    assert counted[1:] == cases_of((NOMINAL,))
    assert len(kept.read_text(encoding="utf-8").splitlines()) == 2


def test_a_kept_result_is_of_the_code_that_a_user_wrote(tmp_path: Path) -> None:
    own = tmp_path / "mine.py"
    own.write_text("class Mine:\n    def wrench(self, time_s, body):\n        return 0.0, 0.0, 0.0\n")
    mine = dataclasses.replace(rig.robot(), effects=({"file": "mine.py"},), folder=tmp_path)
    before = study.stamp_of(mine, [b"table"])
    assert study.stamp_of(mine, [b"table"]) == before
    own.write_text(own.read_text().replace("0.0, 0.0, 0.0", "1e-5, 0.0, 0.0"))
    assert study.stamp_of(mine, [b"table"]) != before
    assert study.stamp_of(rig.robot(), [b"ta", b"ble"]) != study.stamp_of(rig.robot(), [b"table"])


def test_worlds_are_applied_and_never_mixed(
    tmp_path: Path, swum: tuple[Path, Outcomes], counted: list[Case]
) -> None:
    folder, outcomes = swum
    (tmp_path / "runs.jsonl").write_bytes((folder / "runs.jsonl").read_bytes())
    file = tmp_path / "worn.toml"
    file.write_text(WORN, encoding="utf-8")
    worn = settings_of(["nominal", str(file)], rig.robot())
    assert [setting.name for setting in worn] == ["nominal", "worn"]
    found = run(tmp_path, worn, cases_of(worn))
    assert [case.world for case in counted] == ["worn"], "the plain pool's result is kept"
    nominal, strong = found.values()
    assert nominal == next(iter(outcomes.values()))
    assert abs(strong.mean_distance_m - nominal.mean_distance_m) > 2e-3
    # Another world in a file of the same name is another one; the first one's result stays known.
    file.write_text(WORN.replace("0.4", "1.4"), encoding="utf-8")
    other = settings_of([str(file)], rig.robot())
    (stronger,) = run(tmp_path, other, cases_of(other)).values()
    assert len(counted) == 2 and stronger != strong
    assert list(run(tmp_path, worn[1:], cases_of(worn[1:])).values()) == [strong]
    assert len(counted) == 2


def test_a_world_is_all_that_its_file_names(tmp_path: Path) -> None:
    text = "from frogkick.effects import Effect\n\n\nclass Whirl(Effect):\n"
    text += "    def flow(self, time_s, position_world_m):\n"
    (tmp_path / "whirl.py").write_text(text + "        return (0.01, 0.0)\n", encoding="utf-8")
    file = tmp_path / "mine.toml"
    file.write_text('[[effect]]\nfile = "whirl.py"\n', encoding="utf-8")
    before = setting_of(str(file), rig.robot())
    (effect,) = before.world().effects
    assert tuple(effect.flow(0.0, np.zeros(2))) == (0.01, 0.0)
    assert before.world().effects[0] is not effect, "each run has its own"
    (tmp_path / "whirl.py").write_text(text + "        return (0.02, 0.0)\n", encoding="utf-8")
    assert setting_of(str(file), rig.robot()).sha256 != before.sha256
    assert setting_of("hidden", rig.robot()) == HIDDEN and len(HIDDEN.world().effects) == 4
    assert setting_of("nominal", rig.robot()) == NOMINAL and NOMINAL.world().effects == ()
    assert len({NOMINAL.sha256, HIDDEN.sha256, before.sha256}) == 3


def test_wrong_worlds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="world file"):
        setting_of(str(tmp_path / "none.toml"), rig.robot())
    file = tmp_path / "worn.toml"
    file.write_text(WORN.replace("rear_left", "tail"), encoding="utf-8")
    with pytest.raises(InputError, match="tail"):
        setting_of(str(file), rig.robot())
    file.write_text(WORN, encoding="utf-8")
    with pytest.raises(InputError, match="two worlds are named 'worn'"):
        settings_of([str(file), "nominal", str(file)], rig.robot())


def figures(distance_mm: tuple[float, ...], progress_mmps: tuple[float, ...]) -> list[Summary]:
    """Made-up ones of two paths, one off by a millimetre, on the planners' means."""
    return [
        Summary("w", path, name, 1e-3 * (mm + more), 0.0, 1e-3 * mmps, 1.0)
        for path, more in (("line", 1.0), ("sine", -1.0))
        for name, mm, mmps in zip(NAMES, distance_mm, progress_mmps, strict=True)
    ]


GOOD = (40.0, 35.0, 18.0, 17.0, 16.0)
EVEN = (20.0, 20.0, 20.0, 20.0, 20.0)


@pytest.mark.parametrize(
    ("distance_mm", "progress_mmps", "missed"),
    [
        (GOOD, EVEN, []),
        ((40.0, 5.0, 20.0, 20.0, 20.0), EVEN, []),  # the limits themselves
        ((40.0, 35.0, 18.0, 30.0, 17.9), EVEN, []),  # one of depth 2 and 3 is enough
        ((40.0, 35.0, 25.0, 18.0, 20.1), EVEN, ["is more than 0.5 of the paper's"]),
        (GOOD, (20.0, 20.0, 30.0, 30.0, 19.9), ["less progress"]),
        ((40.0, 35.0, 15.9, 17.0, 16.0), EVEN, ["depth 2 and depth 3 are both larger"]),
        (
            (40.0, 5.0, 3.0, 4.0, 41.0),
            (20.0, 9.0, 9.0, 9.0, 9.0),
            ["is more than", "less progress", "both larger"],
        ),
        ((0.0, 0.0, 0.0, 0.0, 0.0), EVEN, []),
        ((float("nan"), 1.0, 1.0, 1.0, 1.0), EVEN, ["is more than"]),
    ],
)
def test_the_verdict_follows_from_the_figures(
    distance_mm: tuple[float, ...], progress_mmps: tuple[float, ...], missed: list[str]
) -> None:
    rows = figures(distance_mm, progress_mmps)
    others = [dataclasses.replace(row, world="other", mean_distance_m=9.0) for row in rows]
    verdict = judge([*others, *rows], "w", PLANNERS, 3)
    assert len(verdict.missed) == len(missed)
    assert all(part in text for part, text in zip(missed, verdict.missed, strict=True))
    assert verdict.passed is (not missed)
    assert list(verdict.mean_distance_m.values()) == pytest.approx(
        [1e-3 * mm for mm in distance_mm], nan_ok=True
    )
    if distance_mm[0] > 0:
        assert verdict.ratio_to_paper["robot, depth 3"] == pytest.approx(distance_mm[4] / distance_mm[0])


def test_the_verdict_is_of_the_robots_own_depth() -> None:
    rows = figures((40.0, 35.0, 18.0, 17.0, 21.0), EVEN)
    assert judge(rows, "w", PLANNERS, 2).passed and not judge(rows, "w", PLANNERS, 3).passed


def made_up(worlds: tuple[str, ...], paths: tuple[str, ...], distance_mm: tuple[float, ...]) -> Outcomes:
    return {
        Case(world, path, name, seed): Outcome(1e-3 * (mm + seed), 0.02, seed == 0, "completed", 9)
        for world in worlds
        for path in paths
        for name, mm in zip(NAMES, distance_mm, strict=True)
        for seed in range(2)
    }


def test_summaries_are_means_over_the_seeds() -> None:
    rows = summaries(made_up(("w",), ("line", "sine"), GOOD))
    assert [(row.path, row.planner) for row in rows] == [(p, n) for p in ("line", "sine") for n in NAMES]
    assert rows[0].mean_distance_m == pytest.approx(0.0405) and rows[0].deviation_m == pytest.approx(0.0005)
    assert (rows[0].completed, rows[0].progress_mps) == (0.5, pytest.approx(0.02))


def test_the_picture_shows_every_run() -> None:
    outcomes = made_up(("nominal", "worn"), ("line", "sine"), (2500.0, 35.0, 18.0, 17.0, 0.0))
    figure = loop_figure(outcomes, ["nominal", "worn"], ["line", "sine"], NAMES)
    assert [axes.get_title(loc="left") for axes in figure.axes[:2]] == ["world: nominal", "world: worn"]
    for axes, scale, name in (
        (figure.axes[1], 1e3, "mean_distance_m"),
        (figure.axes[3], 1e3, "progress_mps"),
    ):
        points = [
            y for line in axes.lines if line.get_marker() == "." for y in np.atleast_1d(line.get_ydata())
        ]
        reported = [scale * getattr(o, name) for case, o in outcomes.items() if case.world == "worn"]
        assert sorted(points) == pytest.approx(sorted(reported))
        low, high = axes.get_ylim()
        assert all(low < y < high for y in points), "none is cut off"
    dashed = [line.get_ydata() for line in figure.axes[0].lines if line.get_linestyle() == "--"]
    half = [y[0] for y in dashed if len(y)]
    assert half == pytest.approx([1250.25, 1250.25])


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("library") / "lib.h5"
    build_library(robot(), 6, 0, 1, file, record_s=0.0)
    return file


def words_of(tmp_path: Path, library: Path) -> list[str]:
    words = [
        "study",
        "loop",
        "--robot",
        robot_option(tmp_path),
        "--library",
        str(library),
        "--tables",
        str(rig.small_table()),
    ]
    return [*words, "--out", str(tmp_path / "out"), "--seeds", "1", "--path", "line", "--workers", "1"]


@from_ci
@pytest.mark.parametrize(("distance_mm", "code"), [(GOOD, 0), (EVEN, 1)])
def test_the_exit_code_is_the_verdict(
    tmp_path: Path,
    library: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    distance_mm: tuple[float, ...],
    code: int,
) -> None:
    made = made_up(("nominal", "hidden"), ("line",), distance_mm)
    monkeypatch.setattr(loop_module, "run_cases", lambda *_: made)
    words = words_of(tmp_path, library)
    assert run_command([*words, "--json"]) == code
    output = json.loads(capsys.readouterr().out)
    assert list(output["over_paths"]) == ["nominal", "hidden"]
    assert all(verdict["passed"] is (code == 0) for verdict in output["over_paths"].values())
    assert output["rows"] == [dataclasses.asdict(row) for row in summaries(made)]
    assert run_command(words) == code
    text = capsys.readouterr().out
    assert "nominal, over all paths:" in text and "hidden, over all paths:" in text
    assert ("requirement not met: the distance of robot, depth 3" in text) is (code == 1)
    assert ("all requirements are met" in text) is (code == 0)


@from_ci
def test_the_command_runs_a_world_and_says_its_name(
    tmp_path: Path, library: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "worn.toml"
    file.write_text(WORN, encoding="utf-8")
    words = [*words_of(tmp_path, library), "--world", str(file), "--learn"]
    code = run_command([*words, "--json"])
    output = json.loads(capsys.readouterr().out)
    assert {(row["world"], row["path"]) for row in output["rows"]} == {("worn", "line")}
    assert [row["planner"] for row in output["rows"]] == [*NAMES, "robot, learning"]
    *_, plain, learned = output["rows"]
    assert learned["mean_distance_m"] != plain["mean_distance_m"], "it plans for a worn limb"
    verdict = output["over_paths"]["worn"]
    assert (code, verdict["passed"]) == ((1, False) if verdict["missed"] else (0, True))
    assert output["table_bytes"]["robot"] == rig.small_table().stat().st_size
    with Image.open(tmp_path / "out" / "loop.png") as picture:
        assert picture.width > 700
    assert run_command([*words, "--path", "lin"]) == 2
    assert "did you mean" in capsys.readouterr().err
    assert run_command([*words, "--world", str(tmp_path / "no.toml")]) == 2
    assert "world file" in capsys.readouterr().err
