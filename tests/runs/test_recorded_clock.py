"""The stroke clock of recorded runs: other periods, slips, frames missing or doubled; runs without one."""

from __future__ import annotations

import json
import pathlib
import shutil

import numpy as np
import pytest
from tests.conftest import FULL, from_ci, some
from tests.identification.made import robot_option
from tests.runs.test_recorded import REST, RUNS
from typer.testing import CliRunner

from frogkick.cli.app import app
from frogkick.core.errors import InputError
from frogkick.identification import choice as choice_module
from frogkick.identification import outcome as outcome_module
from frogkick.identification.filter import Noise
from frogkick.identification.fit import Model
from frogkick.identification.segments import read_segments, reliable
from frogkick.identification.terms import catalogue
from frogkick.robot import load_robot
from frogkick.runs.recorded.clock import estimate_clock
from frogkick.runs.recorded.importer import clock_problem, load_run, period_limits, read_recorded


def test_half_and_twice_the_period_are_told_apart_by_the_motion() -> None:
    """Labels change only at every second stroke.

    Twice the period fits them too, and half of it always does.
    """
    time = np.arange(0.0, 60.0, 0.067)
    action = np.where(time < 1.0, REST, np.array([0, 0, 1, 1, 2, 2])[((time - 1.0) // 1.1).astype(int) % 6])
    speed = 0.02 + 0.02 * np.sin(2.0 * np.pi * (time - 1.3) / 1.1) * (time > 1.0)
    trusted = np.ones(len(time), dtype=bool)
    reported = estimate_clock(time, action, trusted, REST, (0.5, 2.5), (time, speed))
    assert reported is not None and not reported.problem
    assert reported.period_s == pytest.approx(1.1, abs=0.003)
    assert reported.evidence["clock_motion_power"] > 50.0
    blind = estimate_clock(time, action, trusted, REST, (0.5, 2.5))
    assert blind is not None
    assert blind.period_s == pytest.approx(2.2, abs=0.01), "the longest that fits, where nothing else is seen"


def altered(source: pathlib.Path, folder: pathlib.Path, **how: float) -> pathlib.Path:
    """A recorded run with its clock or its frames changed, with its path beside it.

    Args:
        source: the run's file.
        folder: where to write.
        how: ``stretch``: factor of all times; ``slip_s``: delay from the share ``at`` of the motion on, or if
            negative the time that is cut out there; ``cut``: share of the frames left out; ``holes``: number
            of gaps of 1.5 s; ``twice``: share of the frames written twice.
    """
    head, rows = source.read_text().splitlines()[:2], source.read_text().splitlines()[2:]
    cells = [row.split(",") for row in rows if row.strip()]
    stamp = np.array([float(row[0]) for row in cells])
    stamp = stamp[0] + (stamp - stamp[0]) * how.get("stretch", 1.0)
    rng = np.random.default_rng(3)
    kept = np.ones(len(stamp), dtype=bool)
    if "slip_s" in how:
        first = next(k for k, row in enumerate(cells) if row[-1].strip() != "I")
        at = stamp[first] + how.get("at", 0.5) * (stamp[-1] - stamp[first])
        kept &= (stamp < at) | (stamp >= at - 1e3 * how["slip_s"])
        stamp = np.where(stamp >= at, stamp + 1e3 * how["slip_s"], stamp)
    kept &= rng.random(len(stamp)) >= how.get("cut", 0.0)
    for begin in rng.uniform(stamp[0] + 3e3, stamp[-1] - 2e3, int(how.get("holes", 0))):
        kept &= (stamp < begin) | (stamp >= begin + 1.5e3)
    lines = []
    for row, time, keep in zip(cells, stamp, kept, strict=True):
        lines += [",".join([f"{time:.0f}", *row[1:]])] * (
            int(keep) * (1 + (rng.random() < how.get("twice", 0.0)))
        )
    file = folder / source.name
    file.write_text("\n".join(head + lines) + "\n")
    beside = source.stem.rstrip("0123456789") + "p" + source.stem.lstrip("aceilnps") + ".csv"
    shutil.copy(source.with_name(beside), folder / beside)
    return file


@from_ci
@pytest.mark.parametrize("stretch", [0.75, 0.8, 1.25])
@pytest.mark.parametrize("name", some(RUNS, 3))
def test_a_run_at_another_period_is_read_at_that(
    frog2022_dir: pathlib.Path, tmp_path: pathlib.Path, name: str, stretch: float
) -> None:
    plain = read_recorded(frog2022_dir / "control" / f"{name}.csv")
    run = read_recorded(altered(frog2022_dir / "control" / f"{name}.csv", tmp_path, stretch=stretch))
    assert run.period_s == pytest.approx(stretch * plain.period_s, rel=1e-3)
    assert not clock_problem(run) and run.measured["clock_slips"] == 0
    assert run.measured["clock_resultant"] > 0.98
    assert run.decisions.action.tolist() == plain.decisions.action.tolist()


@pytest.mark.parametrize(
    "how", [{"cut": 0.3}, {"cut": 0.5}, {"holes": 3}, {"twice": 0.3}, {"twice": 1.0}], ids=str
)
@pytest.mark.parametrize("name", some(["line1", "sin3", "ellipse6"], 2))
def test_frames_cut_out_or_doubled_leave_the_clock(
    frog2022_dir: pathlib.Path, tmp_path: pathlib.Path, name: str, how: dict[str, float]
) -> None:
    plain = read_recorded(frog2022_dir / "control" / f"{name}.csv")
    run = read_recorded(altered(frog2022_dir / "control" / f"{name}.csv", tmp_path, **how))
    assert run.period_s == pytest.approx(plain.period_s, rel=6e-3)
    assert abs(run.period_s - plain.period_s) < 4.0 * run.measured["period_std_s"] + 1e-3
    assert not clock_problem(run) and run.measured["clock_slips"] == 0


@pytest.mark.parametrize("share", some([-0.5, -0.3, 0.2, 0.3, 0.5], 2))
@pytest.mark.parametrize(("name", "stretch"), [("sin1", 0.8), ("ellipse3", 1.0), ("ellipse5", 1.0)])
def test_a_slip_is_found_or_the_run_refused(
    frog2022_dir: pathlib.Path, tmp_path: pathlib.Path, name: str, share: float, stretch: float
) -> None:
    """Without line1: it has five changes of action in twelve strokes, which fit a slip of 0.3 s too."""
    period_s = stretch * read_recorded(frog2022_dir / "control" / f"{name}.csv").period_s
    slip_s = share * period_s
    file = altered(frog2022_dir / "control" / f"{name}.csv", tmp_path, stretch=stretch, slip_s=slip_s)
    run = read_recorded(file)
    if clock_problem(run):
        assert "contradict" in clock_problem(run) or "resultant" in clock_problem(run)
        return
    assert run.period_s == pytest.approx(period_s, rel=4e-3)
    assert run.measured["clock_slips"] == 1
    (note,) = [part for part in run.notes.split("; ") if "slips by" in part]
    reported = float(note.split("slips by ")[1].split(" s")[0])
    assert abs((reported - slip_s + 0.5 * period_s) % period_s - 0.5 * period_s) < 0.11
    # Decisions go on by the clock at either side; the period that was cut short is not judged.
    spacing = np.diff(run.decisions.time_s)
    odd = np.flatnonzero(np.abs(spacing - run.period_s) > 1e-6)
    assert len(odd) <= 1 and np.all((spacing > 0.45 * period_s) & (spacing < 1.55 * period_s))
    swim = read_segments(file)
    assert np.all(np.diff(swim.start_s) > 0.79 * period_s)


def test_slips_are_mostly_found(frog2022_dir: pathlib.Path, tmp_path: pathlib.Path) -> None:
    """Refusing all runs would pass the test before. Every slip of half a period is found."""
    for name in ("sin1", "ellipse1", "ellipse3", "ellipse5", "ellipse6"):
        source = frog2022_dir / "control" / f"{name}.csv"
        run = read_recorded(altered(source, tmp_path, slip_s=0.7))
        assert not clock_problem(run) and run.measured["clock_slips"] == 1, name


def without_a_clock(source: pathlib.Path, folder: pathlib.Path) -> pathlib.Path:
    """A recorded run with labels at random times, and its path beside it."""
    file = altered(source, folder)
    lines = file.read_text().splitlines()
    rng, label = np.random.default_rng(5), "I"
    for k in range(75, len(lines)):
        label = "BCDEF"[rng.integers(5)] if rng.random() < 0.1 else label
        lines[k] = ",".join([*lines[k].split(",")[:-1], label])
    file.write_text("\n".join(lines) + "\n")
    return file


@from_ci
def test_a_run_without_a_clock_changes_nothing_among_good_ones(
    frog2022_dir: pathlib.Path, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``identify`` end to end, with few candidates: output and file are those of the good runs alone.

    Laws, which are searched for on the same runs, are included at level full only.
    """
    few = [term for term in catalogue(load_robot("frog2022")) if term.title == "steady_current"]
    monkeypatch.setattr(outcome_module, "catalogue", lambda *_: few)
    monkeypatch.setattr(choice_module, "calibrated_starts", lambda _robot: {})
    if not FULL:
        monkeypatch.setattr(outcome_module, "discovered", lambda found, *_: found)
    good = [frog2022_dir / "control" / f"{name}.csv" for name in ("line1", "sin1")]
    test, bad = (
        frog2022_dir / "control" / "ellipse5.csv",
        without_a_clock(frog2022_dir / "control" / "sin3.csv", tmp_path),
    )
    reported = []
    for number, train in enumerate(([*good], [good[0], bad, good[1]])):
        out = tmp_path / f"robot{number}.toml"
        asked = [
            "identify",
            *(f"--train={file}" for file in train),
            f"--test={test}",
            f"--out={out}",
            f"--robot={robot_option(tmp_path)}",
            "--json",
        ]
        reported.append(CliRunner().invoke(app, asked))
        assert reported[-1].exit_code == 0, reported[-1].output
    plain, mixed = (json.loads(each.stdout) for each in reported)
    assert [row["run"] for row in mixed["left_out"]] == [bad.name] and plain["left_out"] == []
    assert f"{bad.name}' is LEFT OUT: " in reported[1].stderr and "LEFT OUT" not in reported[0].stderr
    assert plain["test"]["before"]["position_rmse_m"] > 0.0
    assert {**mixed, "left_out": [], "out": ""} == {**plain, "out": ""}
    texts = [(tmp_path / f"robot{number}.toml").read_text() for number in range(2)]
    assert texts[0] == texts[1]


def test_a_run_without_a_clock_is_not_used_in_silence(
    frog2022_dir: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    """Labels at random times: one line says so, and nothing uses the run."""
    source = frog2022_dir / "control" / "sin3.csv"
    file = without_a_clock(source, tmp_path)
    run = read_recorded(file)
    assert clock_problem(run)
    good = read_segments(source)
    kept, left_out = reliable([good, read_segments(file)])
    assert kept == [good] and left_out == [{"run": "sin3.csv", "reason": clock_problem(run)}]
    out = tmp_path / "out"
    output = CliRunner().invoke(app, ["import", str(tmp_path), "--out", str(out), "--json"])
    assert output.exit_code == 0 and "stroke clock not usable" in output.stderr
    (row,) = json.loads(output.stdout)["runs"]
    assert row["clock_unusable"] == 1.0 and row["clock_notes"]
    assert clock_problem(load_run(out / "sin3.h5")) == clock_problem(run), "kept in the log"
    for asked in (
        ["identify", "--train", str(file), "--test", str(source), "--out", str(tmp_path / "robot.toml")],
        ["replay", str(out / "sin3.h5")],
    ):
        output = CliRunner().invoke(app, asked)
        assert isinstance(output.exception, InputError), output.stdout
        assert clock_problem(run) in str(output.exception) and "\n" not in str(output.exception)
    shown = CliRunner().invoke(app, ["log", "show", str(source), "--json"])
    values = json.loads(shown.stdout)
    assert values["period_s"] == pytest.approx(1.426, abs=2e-3) and values["clock"]["clock_resultant"] > 0.98
    assert values["clock"]["clock_labels"] == 10


def test_the_range_of_periods_is_the_robots() -> None:
    shortest, longest = period_limits(load_robot("frog2022"))
    assert (shortest, longest) == pytest.approx((1.0 / 1.2, 1.0 / 0.4))


def test_a_run_at_another_period_swims_by_the_profile_there(
    frog2022_dir: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    robot = load_robot("frog2022")
    source = frog2022_dir / "control" / "sin1.csv"
    plain, fast = read_segments(source), read_segments(altered(source, tmp_path, stretch=0.8))
    model = Model(robot, (), Noise())
    assert model.lane(plain).robot is robot
    there = model.lane(fast).robot
    assert there.profile_frequency_hz == pytest.approx(1.0 / fast.period_s) == pytest.approx(0.8754, abs=1e-3)
    assert there.actuation().duration_s == pytest.approx(fast.period_s)
    assert there.actuation().drop_per_m != pytest.approx(robot.actuation().drop_per_m, rel=1e-3)
    with pytest.raises(InputError, match="no limb profile at 10 % EGaIn and 2 Hz"):
        robot.at_period(0.5)
