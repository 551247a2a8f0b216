"""Every command of the contract: one JSON object, its keys, --out alone written to, the same bytes twice."""

from __future__ import annotations

import csv
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from tests.cli.commands import frogkick, listing
from tests.conftest import FULL, count, from_ci, some
from tests.library.synthetic import Known
from tests.runs import rig

import frogkick as fk
from frogkick.cli.common import Result, show
from frogkick.core.files import cache_folder
from frogkick.front import building
from frogkick.library import fitting, write_library
from frogkick.runs.runlog_file import read_run
from frogkick.tables.image import read_image

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder, in which nothing but --out may appear."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library of three states."""
    from frogkick.library import build_library

    out = tmp_path_factory.mktemp("library") / "lib.h5"
    build_library(rig.robot(), states=3, seed=5, workers=1, out=out)
    return out


def test_doctor(here: Path, capsys: Capture) -> None:
    done = frogkick(capsys, "doctor", "--json")
    assert done.code == 0
    assert {"needed", "optional", "ready_without_robot"} <= done.json.keys()
    assert all(finding["works"] for finding in done.json["needed"])
    assert listing(here) == {}
    assert [stage["name"] for stage in done.json["stages"]] == [
        "no hardware", "a development kit", "a robot in a pool",
    ]  # fmt: skip
    assert done.json["stages"][0]["ready"]
    for stage in done.json["stages"]:
        assert stage["ready"] == (not stage["missing"])
    said = frogkick(capsys, "doctor").stdout
    assert "ready     no hardware: frogkick demo" in said
    for stage in done.json["stages"]:
        assert all(finding["install"] in said for finding in stage["missing"])


@pytest.mark.parametrize("package", ["ziglang", "elftools", "intelhex", "unicorn", "capstone"])
def test_doctor_lacks_what_demo_lacks(
    package: str, here: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    if package != "intelhex":  # as where nothing of the chip was loaded before
        monkeypatch.delitem(sys.modules, "frogkick.pool.chip", raising=False)
        monkeypatch.delitem(sys.modules, "frogkick.pool.chip.emulator", raising=False)
    done = frogkick(capsys, "doctor", "--json")
    stage = done.json["stages"][0]
    assert done.code == 1 and not stage["ready"]
    assert {finding["install"] for finding in stage["missing"]} == {"pip install 'frogkick[firmware]'"}
    assert "NOT READY no hardware" in frogkick(capsys, "doctor").stdout


def test_simulate_a_gait(here: Path, capsys: Capture) -> None:
    options = ("--egain-percent", "10", "--frequency-hz", "0.8", "--phase", "0.5", "--cycles", "2")
    done = frogkick(capsys, "simulate", "frog2022", *options, "--out", "x.csv", "--json")
    assert done.code == 0
    assert {"speed_mps", "distance_m", "cost_of_transport"} <= done.json.keys()
    assert done.json["distance_m"] > 0.01
    with Path("x.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time_s", "x_m", "y_m", "heading_rad"]
    assert float(rows[-1]["time_s"]) == pytest.approx(2 / 0.8, abs=0.02)
    assert list(listing(here)) == ["x.csv"]
    again = frogkick(capsys, "simulate", "frog2022", *options, "--out", "y.csv", "--json")
    assert again.stdout == done.stdout
    assert Path("x.csv").read_bytes() == Path("y.csv").read_bytes()


def test_simulate_actions(here: Path, capsys: Capture) -> None:
    done = frogkick(capsys, "simulate", "--actions", "B,C", "--initial-velocity", "0.02,-0.001,0.1", "--json")
    assert done.code == 0
    assert {"speed_mps", "distance_m", "cost_of_transport"} <= done.json.keys()
    still = frogkick(capsys, "simulate", "--actions", "I", "--json")
    assert still.json["distance_m"] == pytest.approx(0.0, abs=1e-9)
    assert still.json["cost_of_transport"] in (0.0, None)  # no distance at no cost
    assert listing(here) == {}


def test_library_build_and_info(here: Path, capsys: Capture) -> None:
    options = ("--states", "2", "--seed", "3", "--json")
    done = frogkick(capsys, "library", "build", "frog2022", *options, "--workers", "1", "--out", "a.h5")
    assert done.code == 0
    assert {"transitions", "wall_s", "simulated_s"} <= done.json.keys()
    assert done.json["transitions"] == 2 * 9
    assert done.json["simulated_s"] == pytest.approx(18 * 5.0)  # recorded beyond the period
    assert done.json["failed"] == 0
    assert "18/18" in done.stderr
    frogkick(capsys, "library", "build", *options, "--workers", "2", "--out", "b.h5")
    assert Path("a.h5").read_bytes() == Path("b.h5").read_bytes()
    assert sorted(listing(here)) == ["a.h5", "b.h5"]
    info = frogkick(capsys, "library", "info", "a.h5", "--json")
    assert info.code == 0
    assert {"transitions", "wall_s", "simulated_s"} <= info.json.keys()
    assert info.json["states"] == 2 and info.json["seed"] == 3


def test_tables_build_and_info(here: Path, library: Path, capsys: Capture) -> None:
    options = ("--kind", "nearest", "--test-states", "4", "--json")
    done = frogkick(capsys, "tables", "build", library, *options, "--out", "x.fkt")
    assert done.code == 0
    assert {"bytes", "states", "error"} <= done.json.keys()
    assert {"position_m", "heading_rad"} <= done.json["error"].keys()
    assert done.json["states"] == 3
    assert done.json["bytes"] == Path("x.fkt").stat().st_size
    again = frogkick(capsys, "tables", "build", library, *options, "--out", "y.fkt")
    assert Path("x.fkt").read_bytes() == Path("y.fkt").read_bytes()
    assert again.json["error"] == done.json["error"]
    assert sorted(listing(here)) == ["x.fkt", "y.fkt"]
    info = frogkick(capsys, "tables", "info", "x.fkt", "--test-states", "4", "--json")
    assert info.code == 0
    assert info.json["error"] == done.json["error"]
    assert {**done.json, "out": None} == {**info.json, "out": None}
    quick = frogkick(capsys, "tables", "info", "x.fkt", "--robot", "frog2022", "--test-states", "0", "--json")
    assert quick.json["error"] is None
    assert quick.json["sampling"] is None


@from_ci
def test_a_table_of_another_robot_finds_its_file(here: Path, tmp_path: Path, capsys: Capture) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('base = "frog2022"\nid = "tri"\n[frame]\ndrag_normal = 0.9\n')
    made = ("library", "build", mine, "--states", "3", "--workers", "1", "--record-s", "0", "--out", "lib.h5")
    assert frogkick(capsys, *made).code == 0
    assert frogkick(capsys, "tables", "build", "lib.h5", "--test-states", "4", "--out", "x.fkt").code == 0
    options = ("run", "--robot", "pool", "--tables", "x.fkt", "--simulated-time", "2", "--out", "run.h5")
    without = frogkick(capsys, *options)
    assert without.code == 2 and not Path("run.h5").exists()
    assert "is for robot 'tri', which is not built in: give its TOML file with --model" in without.stderr
    assert frogkick(capsys, *options, "--model", mine).code == 0
    mine.rename("tri.toml")
    assert frogkick(capsys, *options).code == 0


@from_ci
def test_tables_within_a_budget(
    here: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a made library: nothing but the unseen states is simulated, and they are not its."""
    monkeypatch.setattr(fitting, "_SAMPLES", (count(1024, 8192), 131_072))
    monkeypatch.setattr(fitting, "_SAMPLES_A_CELL", count(16, 64))
    lib = tmp_path / "made.h5"
    write_library(Known(1, 3).library(100, 2), lib)
    common = ("--test-states", "4", "--json", "--out", "x.fkt")
    for kind in ("affine", "nearest"):
        done = frogkick(capsys, "tables", "build", lib, "--kind", kind, "--budget-kib", "3.5", *common)
        assert done.code == 0
        assert done.json["kind"] == kind
        assert done.json["bytes"] == Path("x.fkt").stat().st_size <= 3.5 * 1024
        assert {"position_m", "heading_rad"} <= done.json["error"].keys()
        assert done.json["states"] == len(read_image("x.fkt").states)
    assert "tables tried" in done.stderr
    better = frogkick(capsys, "tables", "build", lib, "--budget-kib", "3.5", *common)
    assert better.json["kind"] == "affine"
    roomy = frogkick(capsys, "tables", "build", lib, "--kind", "affine", *common)
    assert 3.5 * 1024 < roomy.json["bytes"] <= 64 * 1024
    assert (
        frogkick(capsys, "tables", "info", "x.fkt", "--test-states", "0", "--json").json["kind"] == "affine"
    )
    whole = frogkick(capsys, "tables", "build", lib, *common)
    assert (whole.json["kind"], whole.json["states"]) == ("affine", roomy.json["states"])
    assert whole.json["crc32"] == roomy.json["crc32"]
    paper = frogkick(capsys, "tables", "build", lib, "--kind", "nearest", *common)
    assert (paper.json["kind"], paper.json["states"]) == ("nearest", 100)


def test_codegen(here: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    table = rig.small_table()
    monkeypatch.setitem(building.STATES, 1, count(12, 60))
    monkeypatch.setitem(building.STATES, 2, count(6, 30))
    monkeypatch.setitem(building.STATES, 3, count(3, 12))
    done = frogkick(capsys, "codegen", table, "--out", "emitted", "--json")
    assert done.code == 0
    assert sorted(done.json["files"]) == sorted(path.name for path in Path("emitted").iterdir())
    first = listing(here)
    assert frogkick(capsys, "codegen", table, "--out", "emitted", "--json").stdout == done.stdout
    assert listing(here) == first
    assert all(name.startswith("emitted") for name in first)


@pytest.mark.parametrize("target", some(["native", "bench"], 1))
def test_firmware_build(
    here: Path,
    capsys: Capture,
    target: str,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    table = rig.small_table()

    def compile_anew() -> None:
        monkeypatch.setenv("FROGKICK_CACHE_DIR", str(tmp_path_factory.mktemp("kept")))

    for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"):  # which takes seconds to fill
        monkeypatch.setenv(name, str(cache_folder("zig")))
    if FULL:  # else the first is what some other test had compiled, elsewhere too
        compile_anew()
    done = frogkick(
        capsys, "firmware", "build", "--target", target, "--tables", table, "--out", "a/fw", "--json"
    )
    assert done.code == 0
    assert {"flash_bytes", "ram_bytes", "stack_bytes", "files"} <= done.json.keys()
    assert all(Path(file).is_file() for file in done.json["files"].values())
    if target == "bench":
        assert table.stat().st_size < done.json["flash_bytes"] < 512 * 1024
        assert 0 < done.json["stack_bytes"] < done.json["ram_bytes"] < 64 * 1024
    # Other folders, the same bytes: nothing of this machine's paths gets in.
    compile_anew()
    frogkick(capsys, "firmware", "build", "--target", target, "--tables", table, "--out", "b/other")
    assert listing(here / "a" / "fw") == listing(here / "b" / "other")
    assert sorted(path.name for path in here.iterdir()) == ["a", "b"]
    image = Path(done.json["image"]).read_bytes()
    assert str(here.parent).encode() not in image
    assert b"workshop" not in image


@from_ci
def test_firmware_size_and_test(here: Path, capsys: Capture) -> None:
    table = rig.small_table()
    size = frogkick(capsys, "firmware", "size", "--tables", table, "--json")
    assert size.code == 0
    assert 0 < size.json["stack_bytes"] < size.json["stack_reserved_bytes"]
    trial = frogkick(capsys, "firmware", "test", "--tables", table, "--json")
    assert trial.code == 0
    for key in ("flash_bytes", "ram_bytes", "stack_bytes"):
        assert trial.json[key] == size.json[key], key
    assert trial.json["passed"] and set(trial.json["checks"].values()) == {"ok"}
    assert sorted(trial.json["plan_ms"]) == ["1", "2", "3", "4"]
    assert listing(here) == {}


RUN_KEYS = {
    "mean_distance_m", "p95_distance_m", "progress_mps", "completed", "decisions", "fixes_lost",
    "limit_violations", "plan_ms_p99",
}  # fmt: skip


@pytest.mark.parametrize(
    ("robot", "plan", "path", "depth"),
    some(
        [
            ("virtual", "onboard", "line", "1"),
            ("pool", "host", "sine", "1"),
            ("pool", "onboard", "ellipse", "2"),
        ],
        2,
    ),
)
def test_run(here: Path, capsys: Capture, robot: str, plan: str, path: str, depth: str) -> None:
    options = (
        "--robot", robot, "--plan", plan, "--path", path, "--depth", depth, "--planner", "paper",
        "--simulated-time", "4", "--tables", rig.small_table(), "--seed", "7", "--json",
    )  # fmt: skip
    done = frogkick(capsys, "run", *options, "--out", "run.h5")
    assert done.code == 0
    assert done.json.keys() >= RUN_KEYS
    assert done.json["decisions"] == 3
    assert done.json["limit_violations"] == 0
    assert list(listing(here)) == ["run.h5"]
    again = frogkick(capsys, "run", *options, "--out", "again.h5")
    timed = robot == "virtual" or plan == "host"
    assert (done.json["plan_ms_p99"] is not None) == timed, "the robot's core plans in no time of the pool"
    with h5py.File("run.h5") as file:
        about = {name: text.asstr()[()] for name, text in file["made"].items()}
        assert about["robot_sha256"] == rig.robot().sha256.hex() and about["robot_toml"] == rig.robot().toml
        assert about["table_sha256"] == hashlib.sha256(rig.small_table().read_bytes()).hexdigest()
        assert "began_at" not in about, "a simulated run has the same bytes whenever it is made"
    assert Path("run.h5").read_bytes() == Path("again.h5").read_bytes()
    if plan == "onboard":
        assert again.stdout == done.stdout
    output = frogkick(capsys, "log", "show", "run.h5", "--json").json["made"]
    assert output == {name: text for name, text in about.items() if name != "robot_toml"}
    replayed = frogkick(capsys, "replay", "run.h5", "--tables", rig.small_table(), "--json")
    assert replayed.code == 0
    assert {"decisions", "actions", "mismatches"} <= replayed.json.keys()
    assert replayed.json["mismatches"] == 0
    # Without --planner and --depth a log is decided again with its own.
    assert replayed.json["depth"] == int(depth)
    assert replayed.json["actions"] == replayed.json["recorded_actions"]


def test_a_run_that_gets_nowhere_says_so(here: Path, capsys: Capture) -> None:
    worn = "".join(
        f'[[effect]]\nname = "limb_wear"\nlimb = "{limb}"\ngain = 0.4\n'
        for limb in ("front_right", "front_left", "rear_left", "rear_right")
    )
    against = '[[effect]]\nname = "steady_current"\nx_mps = -0.03\ny_mps = 0.0\n'
    Path("weir.toml").write_text(worn + against)
    done = frogkick(
        capsys, "run", "--robot", "pool", "--path", "line", "--world", "weir.toml",
        "--tables", rig.small_table(), "--simulated-time", "17", "--out", "run.h5", "--json",
    )  # fmt: skip
    assert done.code == 1 and done.json["decisions"] >= 10
    assert "no progress along the path" in done.stderr.splitlines()[-1]
    assert Path("run.h5").is_file(), "its log is kept all the same"


@from_ci
def test_commands_make_their_own_table_where_none_is_given(
    here: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is affine, so from more states than the small table."""
    monkeypatch.setattr("frogkick.front.tables.STATES", fitting.WHOLE_MIN)
    done = frogkick(
        capsys, "run", "--robot", "virtual", "--plan", "onboard", "--path", "line", "--simulated-time", "2",
        "--out", "run.h5", "--json",
    )  # fmt: skip
    assert done.code == 0 and done.json.keys() >= RUN_KEYS
    assert frogkick(capsys, "replay", "run.h5", "--json").json["mismatches"] == 0
    assert frogkick(capsys, "firmware", "size", "--json").json["flash_bytes"] > 0
    assert list(listing(here)) == ["run.h5"]
    used = fk.load_table()
    assert used.kind == "affine" and used.crc32 == read_run("run.h5").table_crc


@from_ci
def test_a_damaged_cached_table_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from frogkick.front.tables import default_tables

    monkeypatch.setenv("FROGKICK_CACHE_DIR", str(tmp_path))
    made = default_tables("frog2022", 1, "visited")
    whole = made.read_bytes()
    made.write_bytes(whole[:-4])
    assert default_tables("frog2022", 1, "visited").read_bytes() == whole
    assert [path.name for path in (tmp_path / "tables").iterdir()] == [made.name]


@from_ci
def test_two_that_want_the_same_table_at_once_both_get_it(tmp_path: Path) -> None:
    """One builds it, the other waits; neither takes away what the other reads."""
    code = (
        "from frogkick.front.tables import default_tables as made\nprint(made('frog2022', 2, 'visited').stem)"
    )
    asking = 3
    many = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            env={**os.environ, "FROGKICK_CACHE_DIR": str(tmp_path)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(asking)
    ]
    reported = [process.communicate(timeout=600) for process in many]
    assert [process.returncode for process in many] == [0] * asking, reported
    assert len({stdout for stdout, _ in reported}) == 1
    assert sum("library for" in stderr for _, stderr in reported) == 1, "built more than once"


@pytest.mark.parametrize("plan", some(["onboard", "host", "both"], 1))
def test_replay_a_recorded_run(here: Path, capsys: Capture, frog2022_dir: Path, plan: str) -> None:
    run = frog2022_dir / "control" / "line1.csv"
    done = frogkick(capsys, "replay", run, "--plan", plan, "--tables", rig.small_table(), "--json")
    assert done.code == 0
    assert done.json["mismatches"] == 0
    assert done.json["decisions"] == len(done.json["actions"]) == len(done.json["recorded_actions"]) == 12
    assert done.json["recorded_actions"] == "BBBBBBBCBCCA"
    assert 0.0 <= done.json["agreement_with_recorded"] <= 1.0
    assert done.json["places"] == (["onboard", "host"] if plan == "both" else [plan])
    assert done.json["depth"] == 1  # the paper's
    assert listing(here) == {}


@from_ci
def test_parity(here: Path, capsys: Capture) -> None:
    options = ("--states", "300", "--chip-states", "60", "--loop-decisions", str(count(40, 200, 20)))
    done = frogkick(capsys, "parity", *options, "--tables", rig.small_table(), "--json")
    assert done.code == 0
    assert done.json["states"] == 300
    pairs = done.json["mismatches"] | {"loop " + name: n for name, n in done.json["loop_mismatches"].items()}
    assert {"python-native", "python-chip", "native-chip", "loop python-native", "loop native-chip"} <= set(
        pairs
    )
    assert not any(pairs.values())
    assert listing(here) == {}


def test_import(here: Path, capsys: Capture, frog2022_dir: Path) -> None:
    done = frogkick(capsys, "import", frog2022_dir, "--out", "runs", "--json")
    assert done.code == 0
    files = sorted(row["file"] for row in done.json["runs"])
    assert files == sorted(path.name for path in Path("runs").iterdir())
    assert "line1.h5" in files
    first = listing(here)
    frogkick(capsys, "import", frog2022_dir / "control", "--out", "again")
    assert listing(here / "again") == listing(here / "runs")
    assert set(first) == {"runs", *(f"runs/{name}" for name in files)}
    replayed = frogkick(
        capsys, "replay", "runs/line1.h5", "--robot", "pool", "--tables", rig.small_table(), "--json"
    )
    assert replayed.json["mismatches"] == 0


def test_help_and_text_need_no_json(here: Path, capsys: Capture) -> None:
    assert "simulate" in frogkick(capsys, "--help").stdout
    assert frogkick(capsys, "run", "--help").code == 0
    text = frogkick(capsys, "tables", "info", rig.small_table(), "--test-states", "0").stdout
    assert "states: 40" in text


def test_results_are_read_by_people_too(here: Path, capsys: Capture) -> None:
    """No dict of Python, no digits beyond what is known, no nan."""
    values = {
        "speed_mps": 0.30000000000000004, "completed": False, "ended": None, "left": float("nan"),
        "decisions": 12345, "plan": {"ms": {"p99": 1.23456}, "none": {}},
        "rows": [{"name": "a", "at_m": (0.1, 2.0)}], "names": ["b", "c"],
    }  # fmt: skip
    show(Result(values), False, sys.stdout)
    assert capsys.readouterr().out.splitlines() == [
        "speed_mps: 0.3", "completed: no", "ended: -", "left: -", "decisions: 12345", "plan:", "  ms:",
        "    p99: 1.235", "  none: -", "rows:", "  name a, at_m 0.1, 2", "names: b, c",
    ]  # fmt: skip
    states = str(count(64, 64, 8))
    output = frogkick(capsys, "tables", "info", rig.small_table(), "--test-states", states).stdout
    assert "{" not in output and ": nan" not in output
