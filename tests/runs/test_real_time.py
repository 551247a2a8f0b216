"""The real-time guard of a run is undone afterwards, and no fix waits for the disk."""

from __future__ import annotations

import gc
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from tests.runs import rig

from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.decision import DecisionTwin, warm_up
from frogkick.runs.lab_session import SWITCH_S, LabSession
from frogkick.runs.live_log import LiveLog, logged, part_of
from frogkick.runs.record import RunOptions
from frogkick.runs.runlog_file import read_run


def stop_at_once() -> None:
    with LabSession.real_time_guard():
        raise KeyboardInterrupt


def test_threads_give_way_soon_and_what_is_there_is_not_looked_through() -> None:
    before_s, frozen = sys.getswitchinterval(), gc.get_freeze_count()
    with LabSession.real_time_guard():
        assert sys.getswitchinterval() == pytest.approx(SWITCH_S) and before_s > SWITCH_S
        assert gc.get_freeze_count() > frozen + 10_000
    assert (sys.getswitchinterval(), gc.get_freeze_count()) == (before_s, 0)
    with pytest.raises(KeyboardInterrupt):
        stop_at_once()
    assert sys.getswitchinterval() == before_s


@pytest.mark.parametrize("path", ["line", "sine"])
def test_a_twin_is_warm_once_it_has_decided(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    decided = []
    decide = DecisionTwin.decide
    monkeypatch.setattr(
        DecisionTwin, "decide", lambda self, at_us: decided.append(decide(self, at_us)) or decided[-1]
    )
    warm_up(rig.tables(), shape(path), PlanConfig(depth=3))
    assert [one.status for one in decided] == [0, 0] and decided[0].depth_reached == 3


COMPILED_LATER = """
from numba.core import event
import numpy as np
from frogkick.runs.decision import DecisionTwin, warm_up
from frogkick.paths import shape
from frogkick.tables.image import read_image
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.robot import load_robot
import sys
tables, path, config = read_image(sys.argv[1]), shape("sine"), config_of(load_robot("frog2022").planner)
warm_up(tables, path, config)
recorder = event.RecordingListener()
event.register("numba:compile", recorder)
twin, chosen = DecisionTwin(tables, path, config), 0
for number in range(60):
    pose = np.array([path.x_m[number], path.y_m[number], path.tangent_rad[number]], dtype=np.float32)
    twin.add_fix(100_000 * number, pose, number)
    if number % 14 == 3:
        decided = twin.decide(100_000 * number + 50_000)
        twin.act(100_000 * number + 50_000, decided.action)
        chosen += decided.status == 0
    if number == 40:
        twin.restart()
print(chosen, *[when.data["dispatcher"].py_func.__name__ for _, when in recorder.buffer if when.is_start])
"""


def test_nothing_is_compiled_while_a_robot_swims() -> None:
    """Compiling takes a second; after the first stroke, that would end the run on a busy machine."""
    done = subprocess.run(
        [sys.executable, "-c", COMPILED_LATER, str(rig.small_table())],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "5\n"), done.stderr


def test_nobody_waits_for_a_disk_that_is_slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = rig.swim("pool", "line", 4.0)
    wakes, write = threading.Event(), LiveLog._write

    def slow(self: LiveLog, rows: list[object]) -> None:
        assert wakes.wait(60.0)
        write(self, rows)

    monkeypatch.setattr(LiveLog, "_write", slow)
    target = tmp_path / "run.h5"
    grown = rig.recording(shape("line"), RunOptions(recording.options.config))
    with logged(target, grown) as keep:
        for fix in recording.fixes:
            grown.fixes.append(fix)
            keep(grown)  # comes back, though nothing is written
        assert len(read_run(part_of(target)).fixes) == 0
        wakes.set()
    assert len(read_run(part_of(target)).fixes) == len(recording.fixes) > 20
