"""Bad input: one line on stderr, exit 2, nothing on stdout, nothing half-written, no traceback."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.cli.commands import frogkick, listing
from tests.conftest import some
from tests.runs import rig

from frogkick.core.hdf5 import seal
from frogkick.library import build_library
from frogkick.robot import load_robot
from frogkick.runs.runlog_file import write_run
from frogkick.tables.layout import FORMAT_VERSION

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of good and bad files."""
    folder = tmp_path_factory.mktemp("stock")
    build_library(rig.robot(), states=2, seed=5, workers=1, out=folder / "lib.h5")
    shutil.copy(rig.small_table(), folder / "x.fkt")
    recording = rig.swim("pool", "line", 2.5)
    log = recording.log()
    write_run(folder / "run.h5", log)
    write_run(folder / "pathless.h5", dataclasses.replace(log, path=None))
    write_run(folder / "foreign_robot.h5", dataclasses.replace(log, robot_id="newt"))
    write_run(folder / "slow.h5", dataclasses.replace(log, period_s=3.0))
    write_run(folder / "planless.h5", dataclasses.replace(log, planner={"depth": 1.0}))
    write_run(folder / "deep.h5", dataclasses.replace(log, planner={**log.planner, "depth": 9.0}))
    write_run(folder / "heavy.h5", dataclasses.replace(log, planner={**log.planner, "level_weight": -1.0}))
    for name in ("lib.h5", "run.h5", "x.fkt"):
        whole = (folder / name).read_bytes()
        (folder / f"cut_{name}").write_bytes(whole[: len(whole) * 2 // 3])
    for name, column in (("nan_x.h5", "fixes/x_m"), ("nan_time.h5", "decisions/time_s")):
        shutil.copy(folder / "run.h5", folder / name)
        with h5py.File(folder / name, "r+") as file:
            file[column][1] = np.nan
        seal(folder / name)
    with h5py.File(folder / "foreign.h5", "w") as file:
        file["data"] = np.zeros(4)
    with h5py.File(folder / "no_decisions.h5", "w") as file, h5py.File(folder / "run.h5") as run:
        for key, value in run.attrs.items():
            file.attrs[key] = value
        for name in run:
            if name != "decisions":
                run.copy(name, file)
    (folder / "newt.fkt").write_bytes(rig.changed_image(16, b"newt".ljust(16, b"\0")))
    (folder / "eft.fkt").write_bytes(rig.changed_image(16, b"eft".ljust(16, b"\0")))  # no eft.toml beside it
    newer = (FORMAT_VERSION + 1).to_bytes(2, "little")
    (folder / "newer.fkt").write_bytes(rig.changed_image(4, newer))
    flipped = bytearray((folder / "x.fkt").read_bytes())
    flipped[300] ^= 1
    (folder / "flipped.fkt").write_bytes(bytes(flipped))
    (folder / "text.fkt").write_text("not a table\n" * 20)
    (folder / "empty").write_bytes(b"")
    (folder / "folder").mkdir()
    (folder / "file").write_text("x")
    toml = load_robot("frog2022").toml
    (folder / "robot.toml").write_text(toml)
    (folder / "bad_effect.toml").write_text(toml + '\n[[effect]]\nname = "drag_scal"\n')
    (folder / "newt.toml").write_text(toml.replace('"frog2022"', '"newt"'))
    (folder / "bad_key.toml").write_text(toml.replace("period_s", "periodd_s"))
    (folder / "bad_value.toml").write_text(toml.replace("period_s = ", "period_s = -"))
    (folder / "broken.toml").write_text(toml[: len(toml) // 2] + "= = =\n")
    (folder / "empty.csv").write_text("x_m,y_m\n")
    (folder / "one.csv").write_text("x_m,y_m\n0.1,0.2\n")
    (folder / "same.csv").write_text("0.1,0.2\n0.1,0.2\n")
    (folder / "nan.csv").write_text("0.1,0.2\n0.3,nan\n0.4,0.4\n")
    (folder / "words.csv").write_text("0.1,0.2\nthree,four\n")
    (folder / "far.csv").write_text("0,0\n5000,0\n")
    (folder / "line9.csv").write_text("1,2,3\n")
    (folder / "none").mkdir()
    return folder


# Words in braces are files of the stock.
CASES = {
    # files that are not there, not whole, not what they should be
    "no library": "tables build {missing.h5} --out out/x.fkt",
    "library is a folder": "library info {folder}",
    "library is empty": "library info {empty}",
    "library cut": "tables build {cut_lib.h5} --out out/x.fkt",
    "library foreign": "tables build {foreign.h5} --out out/x.fkt",
    "library too small to fit": "tables build {lib.h5} --kind affine --out out/x.fkt",
    "budget too small": "tables build {lib.h5} --kind nearest --budget-kib 0.6 --out out/x.fkt",
    "budget of nothing": "tables build {lib.h5} --budget-kib 0 --out out/x.fkt",
    "kind unknown": "tables build {lib.h5} --kind afine --out out/x.fkt",
    "library too small to study": "study tables {lib.h5} --test-states 4 --out out/x.png",
    "too few states for history": "study history --states 10 --out out/x.png",
    "library is text": "library info {robot.toml}",
    "run as library": "tables build {run.h5} --out out/x.fkt",
    "library as run": "replay {lib.h5} --tables {x.fkt}",
    "run missing": "replay {missing.h5} --tables {x.fkt}",
    "run is a folder": "replay {folder} --tables {x.fkt}",
    "run empty": "replay {empty} --tables {x.fkt}",
    "run cut": "replay {cut_run.h5} --tables {x.fkt}",
    "run foreign": "replay {foreign.h5} --tables {x.fkt}",
    "run with NaN": "replay {nan_x.h5} --tables {x.fkt}",
    "run with NaN time": "replay {nan_time.h5} --tables {x.fkt}",
    "run without decisions": "replay {no_decisions.h5} --tables {x.fkt}",
    "run without path": "replay {pathless.h5} --tables {x.fkt}",
    "run of another robot": "replay {foreign_robot.h5} --tables {x.fkt}",
    "run of another period": "replay {slow.h5} --tables {x.fkt}",
    "run with half a planner": "replay {planless.h5} --tables {x.fkt}",
    "run with a deep planner": "replay {deep.h5} --tables {x.fkt}",
    "run with a negative weight": "replay {heavy.h5} --tables {x.fkt} --plan host",
    "run with a negative weight on the chip": "replay {heavy.h5} --tables {x.fkt}",
    "table as run": "replay {x.fkt} --tables {x.fkt}",
    "recorded run of wrong columns": "replay {line9.csv} --tables {x.fkt}",
    "no table": "tables info {missing.fkt}",
    "table is a folder": "tables info {folder}",
    "table cut": "tables info {cut_x.fkt}",
    "table flipped": "codegen {flipped.fkt} --out out/c",
    "table is text": "firmware size --tables {text.fkt}",
    "table is a library": "parity --tables {lib.h5} --states 10",
    "table of a newer format": "tables info {newer.fkt}",
    "library given as table": "firmware build --tables {lib.h5} --out out/fw",
    # another robot
    "table for another robot": "run --tables {eft.fkt} --simulated-time 1 --out out/run.h5",
    "robot of another table": "run --tables {x.fkt} --model {newt.toml} --simulated-time 1 --out out/run.h5",
    "firmware for another robot": "firmware build --tables {x.fkt} --robot {newt.toml} --out out/fw",
    "table info for another robot": "tables info {x.fkt} --robot {newt.toml}",
    # robots
    "unknown robot": "simulate frog2023",
    "swim into a log": "simulate --out out/x.h5",
    "robot file missing": "simulate {missing.toml}",
    "robot with a bad key": "simulate {bad_key.toml} --out out/x.csv",
    "robot with a bad value": "library build {bad_value.toml} --states 1 --out out/lib.h5",
    "robot with an unknown effect": "robot show {bad_effect.toml} --out out/x.png",
    "robot is broken": "simulate {broken.toml}",
    "robot is a folder": "simulate {folder}",
    "robot is a table": "simulate {x.fkt}",
    # paths
    "unknown path": "run --tables {x.fkt} --path elipse --out out/run.h5",
    "path missing": "run --tables {x.fkt} --path {missing.csv} --out out/run.h5",
    "path empty": "run --tables {x.fkt} --path {empty} --out out/run.h5",
    "path without points": "run --tables {x.fkt} --path {empty.csv} --out out/run.h5",
    "path of one point": "run --tables {x.fkt} --path {one.csv} --out out/run.h5",
    "path of no length": "run --tables {x.fkt} --path {same.csv} --out out/run.h5",
    "path with NaN": "run --tables {x.fkt} --path {nan.csv} --out out/run.h5",
    "path of words": "run --tables {x.fkt} --path {words.csv} --out out/run.h5",
    "path too far": "run --tables {x.fkt} --path {far.csv} --simulated-time 1 --out out/run.h5",
    "path is a folder": "run --tables {x.fkt} --path {folder} --out out/run.h5",
    "path is binary": "run --tables {x.fkt} --path {x.fkt} --out out/run.h5",
    # options
    "unknown command": "swim",
    "unknown group command": "library destroy",
    "unknown option": "run --tables {x.fkt} --fast",
    "missing argument": "codegen",
    "missing option": "codegen {x.fkt}",
    "one argument too many": "library info {lib.h5} {lib.h5}",
    "unknown robot to talk to": "run --tables {x.fkt} --robot virtuel",
    "a robot over the air": "run --tables {x.fkt} --robot ble:frog",
    "unknown place": "replay {run.h5} --tables {x.fkt} --plan chip",
    "unknown target": "firmware build --tables {x.fkt} --target zephyr --out out/fw",
    "unknown kind": "tables build {lib.h5} --kind best --out out/x.fkt",
    "depth 0": "run --tables {x.fkt} --depth 0",
    "depth 5": "replay {run.h5} --tables {x.fkt} --depth 5",
    "depth x": "run --tables {x.fkt} --depth x",
    "time 0": "run --tables {x.fkt} --simulated-time 0 --out out/run.h5",
    "time below 0": "run --tables {x.fkt} --simulated-time -3 --out out/run.h5",
    "time nan": "run --tables {x.fkt} --simulated-time nan --out out/run.h5",
    "time inf": "run --tables {x.fkt} --simulated-time inf --out out/run.h5",
    "no fixes": "run --tables {x.fkt} --fix-rate 0 --out out/run.h5",
    "fixes nan": "run --tables {x.fkt} --fix-rate nan --out out/run.h5",
    "states 0": "library build --states 0 --out out/lib.h5",
    "too many states": "library build --states 65536 --out out/lib.h5",
    "states x": "library build --states many --out out/lib.h5",
    "workers below 0": "library build --states 1 --workers -1 --out out/lib.h5",
    "seed below 0": "library build --states 1 --seed -1 --out out/lib.h5",
    "parity of too few": "parity --states 1 --tables {x.fkt}",
    "frequency 0": "simulate --frequency-hz 0 --out out/x.csv",
    "frequency below 0": "simulate --frequency-hz -1 --out out/x.csv",
    "frequency nan": "simulate --frequency-hz nan --out out/x.csv",
    "egain that was not measured": "simulate --egain-percent 99 --out out/x.csv",
    "egain nan": "simulate --egain-percent nan --out out/x.csv",
    "phase beyond 1": "simulate --phase 1.5 --out out/x.csv",
    "phase nan": "simulate --phase nan --out out/x.csv",
    "cycles 0": "simulate --cycles 0 --out out/x.csv",
    "unknown action": "simulate --actions B,Z --out out/x.csv",
    "no action": "simulate --actions , --out out/x.csv",
    "velocity of two": "simulate --actions B --initial-velocity 0,0 --out out/x.csv",
    "velocity nan": "simulate --actions B --initial-velocity nan,0,0 --out out/x.csv",
    "velocity beyond reason": "simulate --actions B --initial-velocity 1e300,0,0 --out out/x.csv",
    "actions and a gait": "simulate --actions B --frequency-hz 1 --out out/x.csv",
    # places that cannot be written to
    "out below a file": "simulate --cycles 1 --out {file}/x.csv",
    "out is a folder": "simulate --cycles 1 --out {folder}",
    "log out ends in a slash": "run --tables {x.fkt} --out out/",
    "animation ends in a slash": "simulate --cycles 1 --animation swim.gif/",
    "a robot that ends in a slash": "robot new out/robot.toml/",
    "library out is a folder": "library build --states 1 --out {folder}",
    "run out below a file": "run --tables {x.fkt} --simulated-time 1 --out {file}/run.h5",
    "tables out is a folder": "tables build {lib.h5} --test-states 4 --out {folder}",
    "codegen out is a file": "codegen {x.fkt} --out {file}",
    "codegen out holds other files": "codegen {x.fkt} --out {.}",
    "firmware out is a file": "firmware build --tables {x.fkt} --out {file}",
    "demo out is a file": "demo --out {file}",
    "demo out below a file": "demo --out {file}/demo",
    "import out is a file": "import {folder} --out {file}",
    # what would replace a file that is read, or another one that is written
    "out is the training run": "identify --train {run.h5} --test {run.h5} --out {run.h5}",
    "report is a run": "identify --train {run.h5} --test {run.h5} --out out/r --report {run.h5}",
    "two outputs in one file": "identify --train {run.h5} --test {run.h5} --out out/r --predictions out/r",
    "out is the library": "tables build {lib.h5} --out {lib.h5}",
    "out is the path": "run --tables {x.fkt} --path {same.csv} --out {same.csv}",
    "out is the robot": "simulate {robot.toml} --out {robot.toml}",
    "out is the exported run": "export {run.h5} --mcap --out {folder}/../run.h5",
    # import
    "import missing": "import {missing} --out out/runs",
    "import nothing": "import {none} --out out/runs",
    "import a file": "import {file} --out out/runs",
}


def words(line: str, stock: Path) -> list[str]:
    return [
        word.replace("{", f"{stock}/", 1).replace("}", "", 1) if word.startswith("{") else word
        for word in line.split()
    ]


@pytest.mark.parametrize(
    ("name", "as_json"),
    [(name, False) for name in CASES] + some([(name, True) for name in CASES], len(CASES) // 3),
    ids=lambda value: value if isinstance(value, str) else "json" if value else "text",
)
def test_one_line_exit_two_and_nothing_written(
    stock: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture, name: str, as_json: bool
) -> None:
    line = CASES[name]
    monkeypatch.chdir(tmp_path)
    before = listing(stock)
    arguments = words(line, stock)
    wants_json = as_json and line not in ("swim", "library destroy")
    done = frogkick(capsys, *arguments, *(["--json"] if wants_json else []))
    complaints = [text for text in done.stderr.splitlines() if text.startswith("frogkick: ")]
    assert done.code == 2, done
    assert len(complaints) == 1, done.stderr
    assert done.stderr.splitlines()[-1] == complaints[0]
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert 20 < len(complaints[0]) < 600
    assert listing(stock) == before
    assert listing(tmp_path) == {}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("simulate {bad_key.toml}", "period_s"),
        ("simulate frog2023", "frog2022"),
        ("run --tables {x.fkt} --path elipse", "ellipse"),
        ("run --tables {x.fkt} --robot virtuel", "virtual"),
        ("tables info {x.fkt} --robot {newt.toml}", "newt"),
        ("replay {nan_x.h5} --tables {x.fkt}", "x_m row 1"),
        ("replay {pathless.h5} --tables {x.fkt}", "no path"),
        ("run --tables {x.fkt} --path {one.csv}", "1 point"),
        ("simulate --actions B,Z", "Z"),
        ("run --tables {x.fkt} --depth 5", "--depth is '5', allowed is 1 to 4 (see 'frogkick run --help')"),
        ("run --seed nan", "--seed is 'nan', allowed is a whole number of 0 or more"),
        ("simulate --cycles 1.5", "--cycles is '1.5', allowed is a whole number of 1 to 200"),
        ("simulate --phase half", "--phase is 'half', needed is a number (see"),
        ("run --plan nobody", "--plan is 'nobody', which is not one of 'onboard', 'host', 'both' (see"),
        ("simulate {x.fkt}", "x.fkt' is not UTF-8 text (byte 8): name a robot's TOML file"),
        (
            "run --tables {x.fkt} --out out/",
            "cannot write 'out/': a name that ends in a slash is a folder's; name a file in it",
        ),
        (
            "run --tables {x.fkt} --world {x.fkt}",
            "x.fkt' is not UTF-8 text (byte 8): name a TOML file of effects",
        ),
        ("push {x.fkt} --robot serial:/dev/null --key {folder}", "cannot be read: Is a directory; check the"),
        ("simulate --actions B --phase 0.2", "--actions uses the robot's own profile"),
        ("study loop --tables {missing.fkt} --out out", "tables '"),
        ("simulate --initial-velocity 0.1,0,0", "a gait begins at rest: give --actions"),
        ("run --robot pool --source 1", "--source 1 is for a real robot, but --robot is 'pool'"),
        (f"run --path {'a' * 5000}.csv", "aaa ... aaa"),
        ("tables build {lib.h5} --out {lib.h5}", "is read by this command"),
        ("identify --train {run.h5} --test {run.h5} --out r --predictions ./r", "is --out too"),
        ("tables info {cut_x.fkt}", "cut_x.fkt"),
    ],
)
def test_the_line_names_what_is_wrong(stock: Path, capsys: Capture, line: str, message: str) -> None:
    assert message in frogkick(capsys, *words(line, stock)).stderr


def test_a_recorded_run_without_its_path(tmp_path: Path, frog2022_dir: Path, capsys: Capture) -> None:
    shutil.copy(frog2022_dir / "control" / "line1.csv", tmp_path)
    done = frogkick(capsys, "replay", tmp_path / "line1.csv", "--tables", rig.small_table())
    assert done.code == 2
    assert "linep1.csv" in done.stderr
    done = frogkick(capsys, "import", tmp_path, "--out", tmp_path / "runs")
    assert done.code == 2
    assert [path.name for path in tmp_path.iterdir()] == ["line1.csv"]


@pytest.mark.parametrize(
    "spoil",
    [lambda cells: ["nan", *cells[1:]], lambda cells: [cells[0], "nan", *cells[2:]], lambda cells: cells[:5]],
)
def test_a_recorded_run_with_a_bad_row(
    tmp_path: Path, frog2022_dir: Path, capsys: Capture, spoil: Callable[[list[str]], list[str]]
) -> None:
    for name in ("line1.csv", "linep1.csv"):
        shutil.copy(frog2022_dir / "control" / name, tmp_path)
    lines = (tmp_path / "line1.csv").read_text().splitlines()
    lines[40] = ",".join(spoil(lines[40].split(",")))
    (tmp_path / "line1.csv").write_text("\n".join(lines) + "\n")
    for arguments in (
        ["replay", tmp_path / "line1.csv", "--tables", rig.small_table()],
        ["import", tmp_path, "--out", tmp_path / "runs"],
    ):
        done = frogkick(capsys, *arguments)
        assert done.code == 2
        assert "41" in done.stderr, "the line's number"
        assert len([line for line in done.stderr.splitlines() if line.startswith("frogkick: ")]) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["line1.csv", "linep1.csv"]
