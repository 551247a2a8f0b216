"""From a worn robot's runs to its new tables, or to a refusal that leaves the old ones."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made import known_outcome, make_run, make_swim, robot, robot_option
from tests.conftest import from_ci

from frogkick.cli.identify import printed
from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.core.progress import Stage
from frogkick.effects import make_effect
from frogkick.front import retune_tables as tables_module
from frogkick.front import retuning as module
from frogkick.front.retune_tables import (
    Tracked,
    TrackedRun,
    table_error,
    table_horizons,
)
from frogkick.front.retuning import (
    BEFORE,
    LIBRARY,
    REFUSED,
    ROBOT,
    TABLES,
    require_new,
    retuned,
    split,
)
from frogkick.identification.outcome import Outcome
from frogkick.identification.segments import Segments, read_segments
from frogkick.identification.terms import catalogue
from frogkick.identification.verdict import FOUND, NOTHING, TOO_LITTLE, UNEXPLAINED
from frogkick.robot import Robot, load_robot
from frogkick.runs.runlog_file import write_run
from frogkick.tables.image import read_image

WORN = {"name": "limb_wear", "limb": "rear_left", "gain": 0.7}
WEAR = ("limb_wear rear_left", (0.7, 0.0, 1.0))
STATES = "46"  # the fewest that a table can be fitted to


@pytest.fixture(scope="module")
def swims() -> list[Segments]:
    return [make_swim([WORN], seed, periods) for seed, periods in ((1, 14), (2, 14), (3, 10))]


@pytest.fixture(scope="module")
def found(swims: list[Segments]) -> Outcome:
    """Identification of the worn robot from its first runs; the last one is held out."""
    return known_outcome(swims[:2], swims[2:], *WEAR)


@dataclass
class Tools:
    """Stands for the tools that build tables: an image is a name, which gives the predictions of a table.

    A period is recognised by the velocity at its start. Calls are recorded.
    """

    answers: Mapping[bytes, np.ndarray]
    distances_m: tuple[float, float] = (0.02, 0.01)  # of the runs with the first table and with the second
    starts: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    made: list[str] = field(default_factory=list)
    swum: list[bytes] = field(default_factory=list)

    def tables(self, swimmer: Robot, library: Path, stage: Stage) -> bytes:
        self.made.append("worn" if swimmer.effects else "nominal")
        library.write_bytes(b"library")
        with stage("library") as progress:
            progress(1, 1)
        return self.made[-1].encode()

    def states(self, image: bytes) -> int:
        return len(image)

    def looked_up(self, image: bytes, velocity_body: np.ndarray, previous: np.ndarray) -> np.ndarray:
        assert velocity_body.shape == (len(previous), 3) and np.isfinite(velocity_body).all()
        known = np.concatenate([self.answers[image], np.full_like(self.answers[image][:1], np.nan)])
        rows = [np.flatnonzero((self.starts == each).all(axis=1)) for each in velocity_body]
        return known[[int(row[0]) if len(row) else -1 for row in rows]]

    def tracked(self, tables: Path, swimmer: Robot, progress: Any) -> Tracked:
        assert [table["name"] for table in swimmer.effects] == ["limb_wear"]
        self.swum.append(tables.read_bytes())
        progress(1, 1)
        distance_m = self.distances_m[min(len(self.swum), 2) - 1]
        return Tracked.of([TrackedRun("line", seed, distance_m, 0.02, seed == 0) for seed in (0, 1)])

    def firmware(self, tables: Path, swimmer: Robot, out: Path) -> Mapping[str, Any]:
        out.mkdir()
        (out / "image.elf").write_bytes(tables.read_bytes())
        return {"flash_bytes": 4}


@contextmanager
def silent(_title: str) -> Iterator[Any]:
    yield lambda _done, _whole: None


def right_answers(outcome: Outcome, off_m: float = 0.0) -> np.ndarray:
    """(n, a, 6) predictions of a table that miss the measured ends of the test run by ``off_m`` forward."""
    (swim,), (rollout,) = outcome.test, outcome.rollouts
    gap = swim.measured - rollout.start[:, :3]
    c, s = np.cos(rollout.start[:, 2]), np.sin(rollout.start[:, 2])
    answers = np.full((len(gap), len(robot().actions), 6), np.nan)
    rows = np.arange(len(gap))
    answers[rows, swim.action, 0] = c * gap[:, 0] + s * gap[:, 1] + off_m
    answers[rows, swim.action, 1] = c * gap[:, 1] - s * gap[:, 0]
    answers[rows, swim.action, 2] = gap[:, 2]
    answers[rows, swim.action, 3:] = np.roll(rollout.start[:, 3:], -1, axis=0)
    return answers


def tools_of(outcome: Outcome, worn_m: float, nominal_m: float) -> Tools:
    return Tools(
        {b"worn": right_answers(outcome, worn_m), b"nominal": right_answers(outcome, nominal_m),
         b"old": right_answers(outcome, nominal_m)},
        starts=outcome.rollouts[0].start[:, 3:],
    )  # fmt: skip


@pytest.fixture
def known(found: Outcome, monkeypatch: pytest.MonkeyPatch) -> Outcome:
    """Identification that returns the outcome of the fixture ``found``."""
    monkeypatch.setattr(module, "identify", lambda *_args, **_more: found)
    return found


def test_tables_are_judged_by_where_they_say_a_period_ends(found: Outcome) -> None:
    tools = tools_of(found, 0.0, 2e-3)
    exact, off = table_error(tools, b"worn", found), table_error(tools, b"nominal", found)
    assert exact.position_rmse_m < 1e-12 and exact.heading_rmse_rad < 1e-12
    assert off.position_rmse_m == pytest.approx(2e-3) and off.heading_rmse_rad < 1e-12
    assert exact.count == off.count == 10


def test_several_periods_ahead_one_look_up_follows_the_other(found: Outcome) -> None:
    """The error of a table adds up over the periods; that of the start's fixes is a fraction of a mm."""
    tools = tools_of(found, 0.0, 2e-3)
    exact, off = (table_error(tools, image, found, 3) for image in (b"worn", b"nominal"))
    assert exact.count == off.count == 8
    assert exact.position_rmse_m < 1e-3 and off.position_rmse_m == pytest.approx(6e-3, rel=0.15)
    horizons = table_horizons(tools, b"nominal", b"worn", found)
    assert [(each.periods, each.before.count) for each in horizons] == [(1, 10), (2, 9), (3, 8), (5, 6)]
    assert horizons[2].before == off and horizons[2].after == exact
    (swim,), (rollout,) = found.test, found.rollouts
    late = np.where(np.arange(10) >= 4, 0.3 * swim.period_s, 0.0)
    paused = replace(swim, start_s=swim.start_s + late, end_s=swim.end_s + late)
    assert table_error(tools, b"worn", replace(found, test=[paused]), 3).count == 8 - 2
    short = replace(swim, start_s=swim.start_s[:2], end_s=swim.end_s[:2], action=swim.action[:2])
    begun = replace(rollout, start=rollout.start[:2])
    few = replace(found, test=[short], rollouts=[begun])
    assert [each.periods for each in table_horizons(tools, b"nominal", b"worn", few)] == [1, 2]


def test_starts_are_taken_as_the_camera_shows_them(found: Outcome) -> None:
    """A camera that doubles all positions doubles the starts; the motions of a table are not scaled."""
    assert found.found is not None
    scale = next(term for term in catalogue(robot()) if term.title == "camera_scale").at((1.25,))
    fitted = found.found.fitted
    both = replace(fitted, model=replace(fitted.model, terms=(*fitted.model.terms, scale)))
    shown = replace(found, found=replace(found.found, fitted=both))
    (rollout,) = found.rollouts
    error = table_error(tools_of(found, 0.0, 0.0), b"worn", shown)
    apart = 0.25 * np.hypot(*rollout.start[:, :2].T)
    assert error.position_rmse_m == pytest.approx(np.sqrt(np.mean(apart**2)), rel=1e-6)


def test_the_last_run_is_held_out(swims: list[Segments]) -> None:
    train, test, said = split(swims)
    assert train == swims[:2] and test == swims[2:] and "made3" in said


def test_better_tables_are_kept_with_the_old_ones(
    known: Outcome, swims: list[Segments], tmp_path: Path
) -> None:
    tools, out = tools_of(known, 0.5e-3, 2e-3), tmp_path / "new"
    out.mkdir()  # an empty one is as good as none
    result = retuned(swims, robot(), out, tools, silent)
    assert result.better and result.done and not result.reason
    assert sorted(path.name for path in out.iterdir()) == sorted([BEFORE, "firmware", LIBRARY, ROBOT, TABLES])
    assert (out / TABLES).read_bytes() == b"worn" and (out / BEFORE).read_bytes() == b"nominal"
    assert (out / "firmware" / "image.elf").read_bytes() == b"worn"
    assert [table["name"] for table in load_robot(out / ROBOT).effects] == ["limb_wear"]
    assert result.before.position_rmse_m == pytest.approx(2e-3)
    assert result.after.position_rmse_m == pytest.approx(0.5e-3)
    assert [path.name for path in tmp_path.iterdir()] == ["new"]
    said = printed(result)
    for reported in (
        "old table, held-out periods: 2.00 mm", "new table, held-out periods: 0.50 mm",
        "old table, states of all runs: ", "10.0 mm from the path, 20.0 mm/s along it",
        "1 of 2 runs completed", "table, 5 periods ahead: ", "effect limb_wear rear_left: gain 0.7 [",
    ):  # fmt: skip
        assert reported in said, said
    assert tools.swum == [b"nominal", b"worn"]  # old tables first, both by the robot as it is now
    loop = result.as_json()["closed_loop"]
    means = {side: {key: each[key] for key in each if key != "each"} for side, each in loop.items()}
    assert means == {
        "before": {"mean_distance_m": 0.02, "progress_mps": 0.02, "completed": 1, "runs": 2},
        "after": {"mean_distance_m": 0.01, "progress_mps": 0.02, "completed": 1, "runs": 2},
    }
    assert loop["after"]["each"][1] == {
        "path": "line", "seed": 1, "mean_distance_m": 0.01, "progress_mps": 0.02, "completed": False
    }  # fmt: skip


def test_a_table_that_predicts_better_and_follows_worse_is_refused(
    known: Outcome, swims: list[Segments], tmp_path: Path
) -> None:
    """As from random strokes, which never hold an action as long as a planner does."""
    tools, out = tools_of(known, 0.5e-3, 2e-3), tmp_path / "new"
    tools.distances_m = (1.7e-3, 8.2e-3)
    result = retuned(swims, robot(), out, tools, silent)
    assert not result.better and not result.done
    assert "predicts better, but follows paths worse" in result.reason
    assert "8.2 mm from the paths, 1.7 mm with the old one" in result.reason
    assert result.after.position_rmse_m < result.before.position_rmse_m
    assert sorted(path.name for path in out.iterdir()) == sorted([BEFORE, LIBRARY, REFUSED, ROBOT])


@pytest.mark.parametrize("worn_m", [2e-3, 1.99e-3, 3e-3])
def test_tables_that_are_no_better_are_refused(
    known: Outcome, swims: list[Segments], tmp_path: Path, worn_m: float
) -> None:
    tools, out = tools_of(known, worn_m, 2e-3), tmp_path / "new"
    result = retuned(swims, robot(), out, tools, silent, old=b"old")
    assert not result.better and not result.done and "no better on held-out" in result.reason
    assert ("neither error fell by 2 %" if worn_m < 2.5e-3 else "error grew by 1 mm") in result.reason
    assert tools.made == ["worn"] and tools.swum == [b"old", b"worn"]  # the old ones were given
    assert sorted(path.name for path in out.iterdir()) == sorted([BEFORE, LIBRARY, REFUSED, ROBOT])
    assert (out / REFUSED).read_bytes() == b"worn" and (out / BEFORE).read_bytes() == b"old"


@pytest.mark.parametrize(
    ("verdict", "said", "done"),
    [(NOTHING, "explains these runs", True), (UNEXPLAINED, "no known effect", False),
     (TOO_LITTLE, "9 periods more", False)],
)  # fmt: skip
def test_without_an_effect_nothing_is_made(
    found: Outcome,
    swims: list[Segments],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    verdict: str,
    said: str,
    done: bool,
) -> None:
    plain = replace(
        found, verdict=verdict, found=None, parameters=[], reason=said if verdict == TOO_LITTLE else ""
    )
    monkeypatch.setattr(module, "identify", lambda *_args, **_more: plain)
    tools = tools_of(found, 0.0, 0.0)
    result = retuned(swims, robot(), tmp_path / "new", tools, silent)
    assert result.done is done and not result.better and said in result.reason
    assert result.tables is None and not tools.made and not tools.swum and result.loop is None
    assert not list(tmp_path.iterdir())


def test_of_what_tables_cannot_know_none_are_made(
    known: Outcome, swims: list[Segments], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert known.found is not None
    outside = tuple(term for term in catalogue(robot()) if term.name in ("camera_scale", "steady_current"))
    assert len(outside) == 2
    fitted = known.found.fitted
    other = replace(fitted, model=replace(fitted.model, terms=outside))
    monkeypatch.setattr(
        module,
        "identify",
        lambda *_args, **_more: replace(
            known, found=replace(known.found, fitted=other, confounded_with=[[], []]), parameters=[[], []]
        ),
    )
    tools, pools = tools_of(known, 0.0, 0.0), list[int]()

    def tracked(tables: Path, swimmer: Robot, progress: Any) -> Tracked:
        pools.append(len(swimmer.effects))
        return Tracked(0.01, 0.02, 1, 2)

    monkeypatch.setattr(tools, "tracked", tracked)
    result = retuned(swims, robot(), tmp_path / "new", tools, silent)
    assert "no table can contain what was found" in result.reason and not list(tmp_path.iterdir())
    assert tools.made == ["nominal"] and pools == [2, 0], "what it costs, with a table as the robot has"


@pytest.mark.parametrize("error", [KeyboardInterrupt, InputError("no tools"), OSError(28, "No space left")])
def test_stopped_amid_its_work_it_leaves_nothing_unless_the_disk_is_full(
    known: Outcome, swims: list[Segments], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Any
) -> None:
    tools = tools_of(known, 0.0, 2e-3)

    def stop(*_args: object) -> dict[str, Any]:
        raise error

    monkeypatch.setattr(tools, "firmware", stop)
    with pytest.raises((KeyboardInterrupt, InputError)) as raised:
        retuned(swims, robot(), tmp_path / "new", tools, silent)
    kept = [str(each) for each in tmp_path.iterdir() if load_robot(each / ROBOT).effects]
    assert tools.made == ["worn", "nominal"] and len(kept) == (1 if isinstance(error, OSError) else 0)
    assert all(
        f"No space left; what was made so far, with {ROBOT}, is in {each!r}" in str(raised.value)
        for each in kept
    )


def test_a_folder_with_something_in_it_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "tables.fkt").write_bytes(b"mine")
    with pytest.raises(InputError, match="is not empty"):
        require_new(tmp_path)
    assert (tmp_path / "tables.fkt").read_bytes() == b"mine"


def test_another_period_is_refused(swims: list[Segments], tmp_path: Path) -> None:
    slow = [replace(swims[0], period_s=2.0)]
    with pytest.raises(InputError, match=r"a period of 2\.000 s, robot 'frog2022' 1\.425 s"):
        retuned(slow, robot(), tmp_path / "new", Tools({}), silent)
    none = [*swims[:1], replace(swims[1], start_s=np.empty(0), end_s=np.empty(0))]
    with pytest.raises(InputError, match="no whole period"):
        retuned(none, robot(), tmp_path / "new", Tools({}), silent)


def command(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    capsys.readouterr()
    code = run_command(["retune", *(str(argument) for argument in arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@from_ci
def test_from_logs_to_firmware(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole retune, and a second one from its own tables, which finds nothing to improve."""
    runs = []
    for seed, periods in ((4, 8), (5, 8), (6, 8)):
        runs.append(tmp_path / f"run{seed}.h5")
        write_run(runs[-1], make_run([WORN], seed, periods))
    out, given = (
        tmp_path / "new",
        ["--robot", robot_option(tmp_path), "--states", STATES, "--workers", "1", "--json"],
    )
    outcome = known_outcome(*(list(map(read_segments, some)) for some in (runs[:2], runs[2:])), *WEAR)

    def identified(*arguments: Any, progress: Any, **more: Any) -> Outcome:
        assert [[swim.name for swim in swims] for swims in arguments[:2]] == [
            [run.name for run in some] for some in (runs[:2], runs[2:])
        ]
        progress("candidates", 1, 1)
        return outcome

    monkeypatch.setattr(module, "identify", identified)
    monkeypatch.setattr(tables_module, "LOOP_PATHS", ("line",))
    monkeypatch.setattr(tables_module, "LOOP_SEEDS", 1)
    code, stdout, stderr = command(capsys, *runs, *given, "--out", out)
    values = json.loads(stdout)
    assert code == 0, stderr
    assert values["verdict"] == FOUND and values["better"] is True and values["bytes_sent"] == 0
    assert [effect["name"] for effect in values["effects"]] == ["limb_wear"]
    assert values["after"]["position_rmse_m"] < 0.6 * values["before"]["position_rmse_m"]
    assert values["after"]["heading_rmse_rad"] < values["before"]["heading_rmse_rad"]
    assert values["rods"]["after"]["position_rmse_m"] < values["rods"]["before"]["position_rmse_m"]
    tables = read_image(out / TABLES)
    assert values["tables"] == {
        "file": str(out / TABLES), "bytes": len(tables.image), "states": len(tables.states)
    }  # fmt: skip
    assert tables.kind == "affine" and len(tables.image) <= 64 * 1024
    assert read_image(out / BEFORE).provenance != tables.provenance
    (effect,) = load_robot(out / ROBOT).effects
    assert make_effect(effect, out).value("gain") == pytest.approx(0.7, abs=0.05)
    assert (out / "firmware" / values["firmware"]["image"]).stat().st_size > 0
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]
    libraries = [f"{which} library of {STATES} states" for which in ("new", "old")]
    for stage in ("identify: candidates", *libraries, "new tables tried", "firmware"):
        assert f"{stage}: " in stderr

    loop = values["closed_loop"]
    assert loop["before"]["runs"] == loop["after"]["runs"] == 1
    assert loop["before"]["completed"] == loop["after"]["completed"] == 1
    assert 0.0 < loop["after"]["mean_distance_m"] < 0.02 and loop["before"] != loop["after"]
    for horizons in (values["horizons"], values["rods"]["horizons"]):
        assert [row["periods"] for row in horizons] == [1, 2, 3, 5]
        assert horizons[3]["after"]["position_rmse_m"] < 0.5 * horizons[3]["before"]["position_rmse_m"]

    def same(_tools: object, _robot: Robot, library: Path, _stage: object) -> bytes:
        library.write_bytes(b"library")
        return tables.image

    monkeypatch.setattr(tables_module.TableMaker, "tables", same)
    monkeypatch.setattr(tables_module.TableMaker, "tracked", lambda *_: Tracked(0.01, 0.02, 1, 1))
    again = tmp_path / "again"
    code, stdout, stderr = command(capsys, *runs, *given, "--tables", out / TABLES, "--out", again)
    values = json.loads(stdout)
    assert code == 1 and values["better"] is False and values["before"] == values["after"]
    assert stderr.splitlines()[-1].startswith("frogkick: the new table is no better")
    assert (again / BEFORE).read_bytes() == (again / REFUSED).read_bytes() == tables.image
    assert not (again / TABLES).exists() and not (again / "firmware").exists()


def test_bad_arguments_are_one_clear_line_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run.h5"
    write_run(run, make_run([], 7, 6))
    full, new, name = tmp_path / "full", tmp_path / "new", "frog2022"
    full.mkdir()
    (full / "kept").write_bytes(b"x")
    cases: list[tuple[list[str | Path], str]] = [
        (["missing.h5", "--robot", name, "--out", new, "--push", "ble"], "neither ble:NAME nor serial:PORT"),
        ([run, run, "--robot", name, "--out", new], f"test run '{run}' is training run '{run}' once more"),
        ([run, "--robot", name, "--out", full], "is not empty"),
        ([run, "--robot", name, "--out", full / "kept"], "is a file"),
        ([run, "--robot", name, "--out", run], "is read by this command"),
        ([run, "--robot", "frog2023", "--out", new], "no robot 'frog2023'"),
        ([run, "--robot", "hexapod", "--out", new], "the model is 'hexapod'"),
        (["missing.h5", "--robot", name, "--out", new], "missing.h5"),
        ([run, "--robot", name, "--out", new, "--tables", run], "table image"),
        ([run, "--robot", name, "--out", new, "--states", "3"], "--states"),
        ([run, "--robot", name], "--out"),
    ]
    for arguments, said in cases:
        code, stdout, stderr = command(capsys, *arguments)
        assert code == 2 and stdout == "", arguments
        assert said in stderr and len(stderr.splitlines()) == 1, stderr
    code, stdout, stderr = command(capsys, run, "--robot", name, "--out", new, "--json")
    values = json.loads(stdout)
    assert code == 1 and values["verdict"] == TOO_LITTLE and values["tables"] is None
    assert values["before"]["position_rmse_m"] is None
    assert stderr.splitlines()[-1].startswith("frogkick: the runs have 4 whole periods")
    assert not new.exists()
