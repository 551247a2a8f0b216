"""``frogkick log`` and ``frogkick export``: what they say of a run, and what they refuse."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.report.run_figure import compare_figure
from frogkick.runs.runlog import RunLog
from frogkick.runs.runlog_file import write_run
from frogkick.runs.summary import compare_runs, summary


def swum(path: str, seconds: float) -> RunLog:
    recording = rig.swim("pool", path, seconds)
    return recording.log()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("runs")
    write_run(made / "sine.h5", swum("sine", 6.0))
    write_run(made / "longer.h5", swum("sine", 8.0))
    write_run(made / "line.h5", swum("line", 6.0))
    return made


def output_of(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, object]:
    assert run_command([*words, "--json"]) == 0
    return dict(json.loads(capsys.readouterr().out))


@from_ci
def test_show_says_what_the_run_was(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = folder / "sine.png"
    found = output_of(capsys, "log", "show", str(folder / "sine.h5"), "--out", str(picture))
    run = swum("sine", 6.0)
    assert found["decisions"] == len(run.decisions) and found["measured_by"] == "truth"
    assert found["mean_distance_m"] == pytest.approx(run.measured["mean_distance_m"], rel=0.2)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert run_command(["log", "show", str(folder / "sine.h5")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "path: sine" in lines and any(line.startswith("actions: ") for line in lines)


def test_show_takes_a_recorded_run(
    frog2022_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "line1.png"
    source = frog2022_dir / "control" / "line1.csv"
    found = output_of(capsys, "log", "show", str(source), "--out", str(picture))
    assert (found["measured_by"], found["position_rmse_m"], found["decisions"]) == ("fixes", None, 12)
    assert 0.005 < float(str(found["mean_distance_m"])) < 0.05
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_two_runs_of_one_seed_are_the_same_as_long_as_both_last(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = output_of(capsys, "log", "compare", str(folder / "sine.h5"), str(folder / "longer.h5"))
    assert found["a"]["made"] == {}, "nobody said how it came about"
    assert found["same_robot"] and found["same_table"] and found["same_path"]
    assert found["same_decisions"] == len(swum("sine", 6.0).decisions)
    assert float(str(found["apart_m"])) < 1e-9
    more = found["b_minus_a"]
    assert isinstance(more, dict) and more["decisions"] > 0


def test_runs_on_two_paths_are_told_apart(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = folder / "both.png"
    words = [str(folder / name) for name in ("sine.h5", "line.h5")]
    found = output_of(capsys, "log", "compare", *words, "--out", str(picture))
    assert found["same_path"] is False and found["apart_m"] is None
    assert picture.read_bytes().startswith(b"\x89PNG")
    figure = compare_figure((swum("sine", 6.0), swum("line", 6.0)), ("one", "two"))
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["y in the pool (cm)", "distance (mm)", "action"]
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == [
        "desired path of one", "desired path of two", "one", "two",
    ]  # fmt: skip


def test_a_difference_of_one_decision_is_counted() -> None:
    run, other = swum("sine", 6.0), swum("sine", 6.0)
    action = np.array(other.decisions.action)
    action[2] = (action[2] + 1) % len(other.action_names)
    object.__setattr__(other.decisions, "action", action)
    assert compare_runs(run, other).same_decisions == 2
    assert summary(run).actions != summary(other).actions


@pytest.mark.skipif(sys.platform == "win32", reason="makes a pipe with a name")
def test_a_pipe_is_not_replaced_by_a_picture(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / "pipe.png"
    os.mkfifo(pipe)
    assert run_command(["log", "show", str(folder / "sine.h5"), "--out", str(pipe)]) == 2
    assert "is a device or a pipe, and would be replaced: name a file" in capsys.readouterr().err
    assert pipe.is_fifo()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["export", "RUN", "--out", "OUT"], "--csv, --mcap: give exactly one"),
        (["export", "RUN", "--csv", "--mcap", "--out", "OUT"], "--csv, --mcap: give exactly one"),
        (["export", "RUN", "--mcap", "--out", "."], "is a folder"),
        (["export", "RUN", "--csv", "--out", "RUN"], "is read by this command"),
        (["export", "none.h5", "--csv", "--out", "OUT"], "does not exist"),
        (["log", "show", "RUN", "--out", "OUT.jpg"], "does not end in .png, .gif or .mp4"),
        (["log", "compare", "RUN", "RUN", "--out", "OUT.gif"], "does not end in .png: name"),
        (["log", "show", "none.h5"], "does not exist"),
        (["log", "compare", "RUN", "none.h5"], "does not exist"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], complaint: str
) -> None:
    places = {
        "RUN": str(folder / "sine.h5"),
        "OUT": str(tmp_path / "out"),
        "OUT.jpg": str(tmp_path / "o.jpg"),
    }
    assert run_command([places.get(word, word) for word in words]) == 2
    said = capsys.readouterr().err.strip()
    assert complaint in said and "\n" not in said
    assert not list(tmp_path.iterdir())
