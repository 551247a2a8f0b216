"""What a run says in the terminal while it goes on."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.runs import rig

from frogkick.front.run_progress import RunProgress
from frogkick.runs.closed_loop import Recording
from frogkick.runs.decision import LiveCheck


def test_progress_comes_with_the_plan_its_cost_and_the_distance() -> None:
    said: list[tuple[int, int, str]] = []
    check = LiveCheck()
    alone = RunProgress(
        lambda done, whole, note="": said.append((done, whole, note)), 100, rig.tables(), None
    )
    checked = RunProgress(
        lambda done, whole, note="": said.append((done, whole, note)), 100, rig.tables(), check
    )
    alone.progress(0.0, 4)
    recording, _, _ = rig.swim("pool", "line", 3.0)
    made = dataclasses.replace(
        recording.decisions[-1], status=0, action=1, cost=np.float32(12.34), distance_m=np.float32(0.0066)
    )
    growing = Recording()
    alone.keep(growing)
    checked.keep(growing)
    growing.decisions.append(made)
    alone.progress(1.0, 9)
    check.agreed = 2
    checked.progress(1.0, 9)
    growing.decisions.append(dataclasses.replace(made, status=-1))
    alone.progress(2.0, 9)
    assert said == [
        (5, 100, ""),
        (10, 100, "B cost 12.3, 7 mm off"),
        (10, 100, "B cost 12.3, 7 mm off, host agrees with 2 decisions"),
        (10, 100, "no plan"),
    ]


def test_the_command_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    told = frogkick(
        capsys, "run", "--robot", "pool", "--path", "line", "--tables", rig.small_table(),
        "--simulated-time", "6",
    )  # fmt: skip
    assert told.code == 0
    lines = [line for line in told.stderr.splitlines() if line.startswith("line: ")]
    assert lines and all(" cost " in line and line.endswith(" mm off") for line in lines), told.stderr
