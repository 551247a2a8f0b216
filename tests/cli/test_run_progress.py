"""What a run says in the terminal while it goes on."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import from_ci
from tests.runs import rig

import frogkick as fk
from frogkick.core.files import sole_writer
from frogkick.front.viewing import run_progress
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.decision import LiveCheck
from frogkick.runs.record import DISARMED, DROPPED, ENDED, STOPPED, TIME, UNHEARD, RunOptions


def test_progress_comes_with_the_plan_its_cost_and_the_distance() -> None:
    said: list[tuple[int, int, str]] = []
    check = LiveCheck()
    growing = rig.recording(shape("line"), RunOptions(PlanConfig()))
    alone, checked = (
        run_progress(lambda done, whole, note="": said.append((done, whole, note)), one)
        for one in (growing, dataclasses.replace(growing, options=RunOptions(PlanConfig(), check=check)))
    )
    alone(0.0, 4)
    recording = rig.swim("pool", "line", 3.0)
    made = dataclasses.replace(
        recording.decisions[-1], status=0, action=1, cost=np.float32(12.34), distance_m=np.float32(0.0066)
    )
    growing.decisions.append(made)
    alone(1.0, 9)
    check.agreed = 2
    checked(1.0, 9)
    growing.decisions.append(dataclasses.replace(made, status=-1))
    alone(2.0, 9)
    assert said == [
        (5, 100, ""),
        (10, 100, "B cost 12.3, 7 mm off"),
        (10, 100, "B cost 12.3, 7 mm off, host agrees with 2 decisions"),
        (10, 100, "no plan"),
    ]


def test_the_command_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    output = frogkick(
        capsys, "run", "--robot", "pool", "--path", "line", "--tables", rig.small_table(),
        "--simulated-time", "6",
    )  # fmt: skip
    assert output.code == 0
    lines = [line for line in output.stderr.splitlines() if line.startswith("line: ")]
    if "preparing" in lines[0]:  # shown where that takes long
        lines = lines[1:]
    assert lines and all(" cost " in line and line.endswith(" mm off") for line in lines), output.stderr


@pytest.mark.parametrize(
    ("ended", "words"),
    [
        (ENDED["STALE"], "as position fixes stopped coming: the robot left the picture"),
        (ENDED["SUPPLY"], "as the robot's supply fell too low: charge all batteries"),
        (DISARMED, "as the robot disarmed itself: 'frogkick log fetch' shows what led to it"),
        (DROPPED, "as the connection was lost and the robot ended the run meanwhile"),
        (UNHEARD, "as the robot ended the run, and its reason was lost: see its log"),
        (TIME, ""),
        (STOPPED, ""),
    ],
)
def test_a_run_that_was_cut_short_is_a_failure(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, ended: str, words: str
) -> None:
    """One that a person ended, or its time, is none."""
    whole = fk.run(rig.small_table(), "line", time_limit_s=3.0)
    cut = dataclasses.replace(whole, notes=ended)
    monkeypatch.setattr(fk, "run", lambda *_given, **_named: cut)
    output = frogkick(capsys, "run", "--tables", rig.small_table(), "--json")
    assert output.json["ended"] == ended and output.code == (1 if words else 0)
    assert words in output.stderr and ("the path was not completed" in output.stderr) is bool(words)


@pytest.mark.skipif(sys.platform == "win32", reason="has no such locks")
def test_two_runs_do_not_write_one_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run.h5"
    asked = ("run", "--robot", "pool", "--tables", rig.small_table(), "--simulated-time", "2", "--out", out)
    with sole_writer(out):
        output = frogkick(capsys, *asked)
        assert (output.code, output.stdout) == (2, "")
        assert (
            f"another process is about to write {str(out)!r}: wait for it, or give another --out"
            in output.stderr
        )
    assert frogkick(capsys, *asked).code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


@from_ci
def test_a_path_that_no_choice_of_actions_follows_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    asked = ("run", "--robot", "pool", "--tables", rig.small_table(), "--simulated-time", "30", "--path")
    tight = frogkick(capsys, *asked, "sine")
    assert tight.code == 0 and re.search(
        r"frogkick: the path bends by up to \d+ degrees in the \d+ mm that the robot moves in a period, but "
        r"the robot turned by \d+ degrees in a period at most: it cannot follow such a path; make the "
        r"path about [2-9]\.\d times as ",
        tight.stderr,
    ), tight.stderr
    assert "bends" not in frogkick(capsys, *asked, "line").stderr
