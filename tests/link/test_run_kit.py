"""The whole command with a development kit on a line: no limbs, water or camera, and still a closed loop."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci, some
from tests.link.live_robot import LiveRobot
from tests.link.swim import PATH
from tests.runs import rig

from frogkick.link.pty_line import PtyLine
from frogkick.runs.closed_loop import ENDED, TIME
from frogkick.runs.runlog_file import read_run

TRIES = 6
PERIOD_S = rig.PERIOD_S


@from_ci
@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
@pytest.mark.parametrize("plan", some(["onboard", "host"], 1))
def test_a_kit_closes_the_loop_through_its_line(plan: str, tmp_path: Path) -> None:
    rig.swim("pool", PATH, 1.0, onboard=False)  # compiled here, where others wait for it, not in the command
    # In real time: on a machine that is busy elsewhere fixes come late, and the robot ends the run itself.
    for attempt in range(TRIES):
        kit, out = LiveRobot(), tmp_path / f"kit{attempt}.h5"
        with PtyLine(tmp_path / "robot", kit) as line:
            done = subprocess.run(
                [
                    sys.executable, "-m", "frogkick.cli.main", "run", "--path", PATH, "--json",
                    "--plan", plan, "--tables", str(rig.small_table()),
                    "--robot", f"serial:{line.path}:115200",
                    "--fixes", "pool", "--simulated-time", f"{2.2 * PERIOD_S}", "--out", str(out),
                ],
                stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=300,
            )  # fmt: skip
        assert done.returncode == 0, done.stderr
        output = json.loads(done.stdout)
        assert output["ended"] in (TIME, ENDED["STALE"]) and 1 <= output["decisions"] <= 3, done.stderr
        assert kit.left_alone()
        if output["ended"] == TIME:
            break
    assert output["limit_violations"] is None, "nobody saw its pins"
    assert output["mean_distance_m"] < 0.02
    assert kit.pulses
    log = read_run(out)
    assert np.hypot(log.fixes.x_m[-1] - log.fixes.x_m[0], log.fixes.y_m[-1] - log.fixes.y_m[0]) > 0.005, (
        "it swam"
    )
