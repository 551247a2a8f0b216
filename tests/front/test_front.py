"""What ``import frogkick as fk`` gives: a table, a run, a worn limb found and new tables, all in memory."""

from __future__ import annotations

import dataclasses
import inspect
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import count, from_ci
from tests.front.readme import fewer, readme_lines
from tests.identification.made import robot as made_robot
from tests.link.live_robot import LiveRobot
from tests.runs import rig

import frogkick as fk
from frogkick.effects import LimbWear
from frogkick.effects.base import Effect
from frogkick.front import replaying
from frogkick.front import tables as tables_module
from frogkick.identification import choice as choice_module
from frogkick.identification import outcome as outcome_module
from frogkick.identification.terms import catalogue
from frogkick.link.pty_line import PtyLine
from frogkick.robot import parse_robot
from frogkick.robot.toml_text import to_toml

WORN = "rear_left"


@pytest.fixture(scope="module")
def readme(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the names of README's Python lines are after these ran.

    But with test-full with fewer states and few candidates: the same lines, in seconds.
    """
    names: dict[str, Any] = {"made_robot": made_robot}
    folder = tmp_path_factory.mktemp("readme")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        few = count(60, 0, 46)
        if few:
            some = [term for term in catalogue(made_robot()) if "limb_wear rear" in term.title]
            patch.setattr(outcome_module, "catalogue", lambda *_: some)
            patch.setattr(choice_module, "calibrated_starts", lambda _robot: {})
        exec(compile(readme_lines(*(fewer(few) if few else ())), "README.md", "exec"), names)
    return {**names, "folder": folder}


@pytest.fixture(scope="module")
def robot(readme: dict[str, Any]) -> fk.Robot:
    return readme["robot"]


@pytest.fixture(scope="module")
def library(robot: fk.Robot) -> fk.Library:
    return fk.build_library(robot, states=count(100, 300, 20), seed=0)


@pytest.fixture(scope="module")
def table(readme: dict[str, Any]) -> fk.Table:
    return readme["table"]


@pytest.fixture(scope="module")
def runs(readme: dict[str, Any]) -> list[fk.Run]:
    return readme["runs"]


def test_every_name_is_there_and_says_what_it_is() -> None:
    assert len(fk.__all__) == len(set(fk.__all__)) and set(dir(fk)) == set(fk.__all__)
    for name in set(fk.__all__) - {"__version__"}:
        found = getattr(fk, name)
        assert inspect.getdoc(found), f"{name} has no docstring"
        if not inspect.isclass(found):
            continue
        for attribute, value in vars(found).items():
            shown = inspect.isfunction(value) or isinstance(value, property)
            if shown and not attribute.startswith("_"):
                assert inspect.getdoc(value), f"{name}.{attribute} has no docstring"
    with pytest.raises(AttributeError, match="no attribute 'swim'"):
        fk.swim  # noqa: B018


def test_a_function_takes_its_name_whatever_was_loaded_before() -> None:
    """No folder of the package has the name of a function: the one that is loaded last would win."""
    folders = {path.parent.name for path in Path(fk.__file__).parent.glob("*/__init__.py")}
    assert {name for name in fk.__all__ if name in folders} == {"effects", "paths"}


def test_importing_loads_nothing_that_takes_time() -> None:
    code = "import sys, frogkick as fk; dir(fk); print({'numpy', 'numba', 'typer'} & set(sys.modules))"
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert output.stdout.strip() == "set()"


def test_who_reads_a_log_loads_no_camera_and_no_firmware() -> None:
    late = "{'cv2', 'frogkick.vision', 'frogkick_codegen'}"
    code = f"import sys, frogkick as fk; fk.load_run, fk.identify; print({late} & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout == "set()\n"


def test_a_robot_is_one_line_and_a_picture(robot: fk.Robot, tmp_path: Path) -> None:
    assert repr(robot).startswith("Robot('frog2022': 4 limbs, 9 actions") and len(repr(robot)) < 120
    page = robot._repr_html_()
    assert page.count("<polyline") == 1 + len(robot.limbs) and all(limb.name in page for limb in robot.limbs)
    robot.save(tmp_path / "robot.toml")
    assert fk.load_robot(tmp_path / "robot.toml") == robot


@from_ci
def test_a_default_table_is_that_of_the_numerical_packages_and_wear_gains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FROGKICK_CACHE_DIR", str(tmp_path))
    made = tables_module.default_tables("frog2022", 1, "visited")
    assert tables_module.default_tables("frog2022", 1, "visited") == made
    monkeypatch.setattr(tables_module, "numerical_versions", lambda: "numpy 0.1\n")
    assert tables_module.default_tables("frog2022", 1, "visited") != made
    monkeypatch.setattr(tables_module, "_is_valid", lambda _target: True)  # the names alone
    other = tables_module.default_tables("frog2022", 1, "visited")
    monkeypatch.setattr("frogkick.library.wear.GAINS", (0.7, 0.2))
    assert tables_module.default_tables("frog2022", 1, "visited") != other


@from_ci
def test_a_robot_with_an_effect_of_ones_own_is_saved_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / "mine.py").write_text(
        "class Mine:\n    def wrench(self, time_s, body):\n        return 0.0, 0.0, 0.0\n"
    )
    own = '[[effect]]\nfile = "mine.py"\nclass = "Mine"\n'
    (tmp_path / "a" / "robot.toml").write_text('base = "frog2022"\nid = "own"\n' + own)
    first = fk.load_robot(tmp_path / "a" / "robot.toml")
    first.save(tmp_path / "b" / "robot.toml")
    second = fk.load_robot(tmp_path / "b" / "robot.toml")
    assert second.effects[0]["file"] == "../a/mine.py"
    assert isinstance(fk.effects.effects_of(second)[0], Effect)
    # And it comes along in memory, where no file is named.
    table = fk.fit_table(fk.build_library(first, states=2))
    assert isinstance(fk.effects.effects_of(table.robot)[0], Effect)


def few_with(robot: fk.Robot, effect: LimbWear) -> fk.Robot:
    """The robot with an effect in its file."""
    table = tomllib.loads(robot.toml)
    table["effect"] = [{"name": effect.name, "limb": effect.limb, "gain": effect.gain}]
    return parse_robot(to_toml(table), "with an effect")


def test_a_row_of_actions_and_a_gait(robot: fk.Robot) -> None:
    swum = fk.simulate(robot, "BBC")
    assert swum.pose_world.shape == swum.velocity_body.shape == (len(swum.time_s), 3)
    same = fk.simulate(robot, ["B", "b", "C"])
    assert np.array_equal(swum.pose_world, same.pose_world) and len(repr(swum)) < 120
    # The velocity is that of the poses: carried through the whole row it ends where they do.
    heading, steps = swum.pose_world[:, 2], np.diff(swum.time_s)
    forward, left = swum.velocity_body[:, 0], swum.velocity_body[:, 1]
    x_mps = forward * np.cos(heading) - left * np.sin(heading)
    moved_m = float((steps * (x_mps[1:] + x_mps[:-1]) / 2.0).sum())
    assert moved_m == pytest.approx(swum.pose_world[-1, 0], abs=2e-4)
    worn = few_with(robot, LimbWear(limb="front_left", gain=0.5))
    plain, turned = fk.simulate(robot, "BB"), fk.simulate(worn, "BB")
    assert abs(plain.pose_world[-1, 2]) < 0.01 < abs(turned.pose_world[-1, 2]), "its effects act"
    assert fk.simulate(worn, cycles=2).speed_mps < fk.simulate(robot, cycles=2).speed_mps
    gait = fk.simulate(robot, cycles=2)
    assert gait.distance_m > 0.01 and gait.time_s[-1] == pytest.approx(2.0 / robot.profile_frequency_hz)
    with pytest.raises(fk.InputError, match="leave egain_percent"):
        fk.simulate(robot, "B", egain_percent=10.0)
    with pytest.raises(fk.InputError, match="actions is empty"):
        fk.simulate(robot, " , ")
    with pytest.raises(fk.InputError, match="no action 'Z'"):
        fk.simulate(robot, "BZ")


def test_libraries_and_tables_in_memory_and_in_files(
    library: fk.Library, robot: fk.Robot, tmp_path: Path
) -> None:
    table = fk.fit_table(library)
    assert len(repr(library)) < 120 and len(repr(table)) < 160 and "Table" in table._repr_html_()
    library.save(tmp_path / "lib.h5")
    read = fk.load_library(tmp_path / "lib.h5")
    assert read.content_sha256() == library.content_sha256()
    out = fk.build_library(
        robot, states=len(library.initial_velocity_body), workers=1, out=tmp_path / "out.h5"
    )
    assert out.content_sha256() == library.content_sha256()
    assert fk.fit_table(read).image == table.image
    table.save(tmp_path / "a.fkt")
    again = fk.load_table(tmp_path / "a.fkt", robot)
    assert again.image == table.image and again.name == "a.fkt" and again.facts() == table.facts()
    error = table.error(states=4)
    assert 0.0 < error["position_m"] < 0.1
    with pytest.raises(fk.FrogkickError, match="this robot is 'hexapod'"):
        fk.load_table(tmp_path / "a.fkt", "hexapod")
    with pytest.raises(fk.InputError, match=r"budget is 0\.1 KiB"):
        fk.fit_table(library, "affine", 0.1)


def test_the_planner_gives_its_whole_branch(table: fk.Table) -> None:
    path = fk.paths.sine()
    planner = fk.Planner(table, depth=3)
    found = planner.plan(np.zeros(6), path)
    assert (
        found.predicted_pose.shape == (3, 3) and len(found.actions) == 3 and found.action == found.actions[0]
    )
    one = fk.Planner(table, depth=1).plan(np.zeros(6), path)
    assert one.predicted_pose.shape == (1, 3) and np.isfinite(one.cost)
    # The first step of the branch is what the table says of its first action, from rest.
    assert np.hypot(*found.predicted_pose[0, :2]) < float(table.tables.stroke_max_m) + 1e-6
    paper = fk.Planner(table, planner="paper")
    assert paper.config.depth == 1 and len(repr(planner)) < 200
    with pytest.raises(fk.FrogkickError, match="NaN"):
        planner.plan(np.full(6, np.nan), path)
    with pytest.raises(fk.InputError, match="choose robot or paper"):
        fk.Planner(table, planner="papre")


def test_a_run_is_kept_drawn_and_read_back(runs: list[fk.Run], tmp_path: Path) -> None:
    run = runs[0]
    assert run.tracking.completed and 0.0 < run.tracking.mean_distance_m < 0.2
    assert len(run.actions) == run.tracking.decisions
    run.save(tmp_path / "a.h5")
    read = fk.load_run(tmp_path / "a.h5")
    assert read.tracking == run.tracking and read.actions == run.actions and read.ended == run.ended
    assert run.plot().axes and len(repr(run)) < 160 and "<img" in run._repr_html_()


def test_an_effect_that_remembers_begins_anew_with_each_run(table: fk.Table) -> None:
    world = fk.World([fk.effects.WarmUp(), fk.effects.LimbMemory(loss=0.2)])
    first, second = (fk.run(table, "line", world=world, seed=3, time_limit_s=6.0) for _ in range(2))
    assert first.log.truth is not None and second.log.truth is not None
    assert np.array_equal(first.log.truth.pose_world, second.log.truth.pose_world)


def test_runs_of_one_seed_along_different_paths_have_different_noise(table: fk.Table) -> None:
    """Identification takes their fixes for independent. Runs along one path can be compared."""
    runs = [fk.run(table, path, seed=3, time_limit_s=1.0).log for path in ("line", "sine", "line")]
    at_rest = [
        np.array([run.fixes.x_m[:5] - run.path.x_m[0], run.fixes.y_m[:5] - run.path.y_m[0]])
        for run in runs
        if run.path is not None
    ]
    assert np.array_equal(at_rest[0], at_rest[2])
    assert np.abs(at_rest[0] - at_rest[1]).min() > 1e-6


def test_places_and_planners_that_there_are_not(table: fk.Table, robot: fk.Robot) -> None:
    for given, text in (
        ({"robot": "pol"}, "did you mean 'pool'"),
        ({"plan": "onbord"}, "did you mean 'onboard'"),
        ({"planner": "papr"}, "did you mean 'paper'"),
        ({"fixes": "pool"}, "is for a real robot"),
        ({"path": "elipse"}, "did you mean 'ellipse'"),
        ({"time_limit_s": float("nan")}, "finite number above 0"),
    ):
        options: dict[str, Any] = {"time_limit_s": 2.0, **given}
        with pytest.raises(fk.InputError, match=text):
            fk.run(table, options.pop("path", "line"), **options)
    with pytest.raises(fk.InputError, match="test is empty"):
        fk.identify([], test=[], robot=robot)
    with pytest.raises(fk.InputError, match="choose ble:NAME"), fk.connect("frogkick"):
        pass


@from_ci
def test_files_and_names_are_taken_wherever_objects_are(
    runs: list[fk.Run], table: fk.Table, tmp_path: Path
) -> None:
    table.save(tmp_path / "t.fkt")
    runs[0].save(tmp_path / "run.h5")
    assert repr(fk.simulate("frog2022", "B")) == repr(fk.simulate(fk.load_robot("frog2022"), "B"))
    library = fk.build_library("frog2022", states=3, workers=1, out=tmp_path / "lib.h5")
    assert fk.fit_table(tmp_path / "lib.h5").image == fk.fit_table(library).image
    assert fk.Planner(tmp_path / "t.fkt").plan([0.0] * 6, "line").actions
    assert fk.build_firmware(tmp_path / "t.fkt", "native").files
    (tmp_path / "line.csv").write_text("x,y\n0,0\n0.3,0\n", encoding="utf-8")
    assert fk.run(tmp_path / "t.fkt", tmp_path / "line.csv", time_limit_s=2.0).path is not None
    assert repr(fk.identify(runs[1], test=str(tmp_path / "run.h5"))) == repr(
        fk.identify(runs[1:2], test=[tmp_path / "run.h5"])
    )
    runs[0].save(tmp_path / "copy.h5")
    with pytest.raises(fk.InputError, match=r"run 'run\.h5' is training run 'copy\.h5' once more"):
        fk.identify([runs[1], tmp_path / "copy.h5"], test=tmp_path / "run.h5")


def test_what_is_no_object_of_ours_is_named(table: fk.Table) -> None:
    planner = fk.Planner(table)
    for call, text in (
        (lambda: planner.plan("line", [0.0] * 6), "state is .line.: give six numbers"),  # type: ignore[arg-type]
        (lambda: planner.plan(["x"] * 6, "line"), "is not an array of numbers"),
        (lambda: fk.run(table, np.zeros((9, 2))), "path is given as ndarray: .*fk.paths.from_waypoints"),  # type: ignore[arg-type]
        (lambda: fk.run(table, "line", world=[1]), r"world is given as list: give fk.World\(\[...\]\)"),  # type: ignore[arg-type]
    ):
        with pytest.raises(fk.InputError, match=text):
            call()
    with pytest.raises(fk.InputError, match=r"gain is -3, allowed is 0.3 to 1.5$"):
        fk.effects.LimbWear(limb="rear_left", gain=-3.0)


@from_ci
def test_a_worn_limb_is_found_and_given_back_as_a_robot(
    readme: dict[str, Any], runs: list[fk.Run], robot: fk.Robot, tmp_path: Path
) -> None:
    found: fk.Identification = readme["found"]
    (effect,) = found.effects
    assert found.verdict == "found" and effect.name == "limb_wear" and effect.options == {"limb": WORN}
    gain = effect.parameters["gain"]
    assert gain.interval[0] < 0.7 < gain.interval[1] and gain.unit == "1"
    assert isinstance(effect.confounded_with, tuple)
    assert found.after.position_rmse_m < 0.3 * found.before.position_rmse_m
    assert found.noise_floor.position_rmse_m > 0.0 and len(repr(found)) < 160
    assert "limb_wear" in found._repr_html_()
    worn = fk.load_robot(readme["folder"] / "worn.toml")
    assert worn == found.robot and worn.effects[0]["limb"] == WORN
    (acting,) = fk.effects.effects_of(worn)
    assert isinstance(acting, LimbWear)
    found.report(tmp_path / "what.html")
    assert "limb_wear" in (tmp_path / "what.html").read_text(encoding="utf-8")
    found.predictions(tmp_path / "p.csv")
    assert (tmp_path / "p.csv").read_text(encoding="utf-8").startswith("run,time_s,horizon_s,x_m")
    assert found.as_json()["verdict"] == "found"


def test_c_and_firmware(readme: dict[str, Any], table: fk.Table, tmp_path: Path) -> None:
    files = fk.emit_c(table, readme["folder"] / "emitted")
    assert {path.name for path in (readme["folder"] / "emitted").iterdir()} == set(files)
    built = fk.build_firmware(table)
    assert 0 < built.ram_bytes < 64 * 1024 and built.flash_bytes > len(table.image)
    assert built.files["hex"].is_file() and len(repr(built)) < 120
    kept = fk.build_firmware(table, out=tmp_path / "built")
    assert kept.files["hex"].read_bytes() == built.files["hex"].read_bytes()


@from_ci
@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_real_robot(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A kit without limbs at a line: asked, given a table, and swum with by fixes of a simulated pool."""
    rig.swim("pool", "line", 1.0, onboard=False)  # compiled here, where nothing waits for it
    old, table = rig.tables(), fk.load_table(rig.small_table())
    kit = LiveRobot()
    with PtyLine(tmp_path / "robot", kit) as line, fk.connect(f"serial:{line.path}:115200") as bot:
        reported = bot.status()
        assert reported["robot_id"] == "frog2022" and reported["table_crc"] == old.crc32
        pushed = bot.push(table)
        assert pushed.table_crc == table.crc32
        log = bot.follow("line", fixes="pool", table=table, time_limit_s=3.5)
        assert log.tracking.decisions >= 1 and kit.pulses and "DISARM" in kit.names()
        assert repr(bot) == f"Connection('serial:{line.path}:115200')"
    assert "start check: table" in capfd.readouterr().err


def test_the_command_and_the_call_give_the_same(
    table: fk.Table, robot: fk.Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table.save(tmp_path / "a.fkt")
    robot.save(tmp_path / "robot.toml")
    words = ["run", "--robot", "pool", "--tables", tmp_path / "a.fkt", "--model", tmp_path / "robot.toml"]
    output = frogkick(capsys, *words, "--path", "line", "--seed", 2, "--json")
    assert output.code == 0, output.stderr
    assert output.json == fk.run(table, "line", seed=2).as_json()


def test_a_log_of_a_robot_that_never_swam_is_read_and_given_on(runs: list[fk.Run], tmp_path: Path) -> None:
    log = runs[0]
    none = {name: getattr(log.decisions, name)[:0] for name in ("time_s", "action", "fix_sequence", "flags")}
    dataclasses.replace(runs[0], decisions=type(log.decisions)(**none), tracked=None).save(tmp_path / "a.h5")
    read = fk.load_run(tmp_path / "a.h5")
    assert "0 decisions, not seen swimming" in repr(read) and "<img" not in read._repr_html_()
    assert tmp_path / "csv" / "fixes.csv" in read.export_csv(tmp_path / "csv")
    for reported in (lambda: read.tracking, read.summary, lambda: read.compare(runs[0])):
        with pytest.raises(fk.InputError, match="has no decisions"):
            reported()


def test_a_table_in_memory_takes_the_robot_that_is_given(table: fk.Table, robot: fk.Robot) -> None:
    deeper = dataclasses.replace(
        robot, planner=dataclasses.replace(robot.planner, depth=robot.planner.depth % 4 + 1)
    )
    assert fk.load_table(table).robot is table.robot
    used = fk.load_table(table, deeper)
    assert used.robot == deeper and used.image == table.image and used.tables.actions == table.tables.actions
    with pytest.raises(fk.InputError, match="this robot is 'hexapod'"):
        fk.load_table(table, "hexapod")


def test_a_run_of_a_robot_of_one_s_own_is_decided_again(
    runs: list[fk.Run], library: fk.Library, robot: fk.Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = parse_robot(robot.toml.replace(f'id = "{robot.id}"', 'id = "mine"'), "mine")
    mine.save(tmp_path / "mine.toml")
    own = fk.fit_table(
        dataclasses.replace(library, robot_id=mine.id, robot_toml=mine.toml, robot_sha256=mine.sha256)
    )
    own.save(tmp_path / "own.fkt")
    run = dataclasses.replace(runs[0], robot_id=mine.id)
    beside = fk.replay(run, table=tmp_path / "own.fkt", plan="host")
    asked = list[fk.Robot | str]()

    def default(one: fk.Robot | str) -> Path:
        asked.append(one)
        return tmp_path / "own.fkt"

    monkeypatch.setattr(replaying, "default_tables", default)
    again = fk.replay(run, model=str(tmp_path / "mine.toml"), plan="host")
    assert again.result.actions == beside.result.actions
    assert [one.id for one in asked if isinstance(one, fk.Robot)] == ["mine"]
    with pytest.raises(
        fk.InputError, match="is of robot 'mine', not 'frog2022': give its robot with --model"
    ):
        fk.replay(run, model="frog2022", plan="host")


def test_a_run_is_decided_again_in_memory(runs: list[fk.Run], table: fk.Table) -> None:
    again = fk.replay(runs[0], table=table, robot="pool")
    assert again.mismatches == 0 and again.result.agreement == 1.0
    assert again.as_json()["actions"] == "".join(runs[0].actions) and "0 mismatches" in repr(again)
    with pytest.raises(fk.InputError, match="did you mean 'host'"):
        fk.replay(runs[0], plan="hots")


def test_gaits_are_ranked_in_memory() -> None:
    reported: list[tuple[int, int]] = []
    swept = fk.sweep(
        made_robot(),
        egain_percent=[10.0],
        frequencies_hz=[0.4, 0.5],
        phases=1,
        workers=1,
        progress=lambda done, whole: reported.append((done, whole)),
    )
    assert reported[-1] == (2, 2) and len(swept.points) == 2
    first, second = swept.fastest
    assert first.speed_mps > second.speed_mps > 0.0
    assert swept.as_json()["gaits"] == 2 and repr(swept).startswith("Swept('frog2022': 2 designs, 2 gaits; ")
    assert "mm/s" in swept._repr_html_()
    with pytest.raises(fk.InputError, match="nowhere"):
        fk.validate("nowhere", made_robot())
