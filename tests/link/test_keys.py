"""A run that is started and stopped by keys."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import pytest
from tests.link.live_robot import LiveRobot, PatientClock
from tests.link.rigged import rigged
from tests.link.swim import PATH, LivePool
from tests.runs import rig

from frogkick.cli.run import Keys
from frogkick.link.layout import link_layout
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import STOPPED, run_session
from frogkick.runs.lab_session import LabPort, LabSession
from frogkick.runs.record import RunOptions

PERIOD_S = rig.PERIOD_S
STATE = link_layout().state

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="terminals of Windows are no files")


@pytest.fixture
def terminal() -> Iterator[tuple[int, TextIO]]:
    """The end of a terminal where keys are pressed, and the end that a program reads."""
    ours, theirs = os.openpty()
    with os.fdopen(theirs, encoding="utf-8") as stream:
        yield ours, stream
    os.close(ours)


def test_a_key_is_seen_without_enter_and_once(terminal: tuple[int, TextIO]) -> None:
    ours, stream = terminal
    with Keys(stream) as keys:
        assert not keys.pressed()
        os.write(ours, b"x")
        seen = [keys.pressed() for _ in range(1000)]
        assert seen.count(True) == 1


def test_only_enter_arms_and_what_came_before_does_not(
    terminal: tuple[int, TextIO], capsys: pytest.CaptureFixture[str]
) -> None:
    ours, stream = terminal
    armed = threading.Event()

    def ask() -> None:
        keys.wait_to_arm()
        armed.set()

    with Keys(stream) as keys:
        os.write(ours, b"\n")
        asking = threading.Thread(target=ask)
        asking.start()
        assert not armed.wait(0.3), "armed by an Enter from before"
        os.write(ours, b"ax ")
        assert not armed.wait(0.3), "armed by another key"
        os.write(ours, b"\n")
        assert armed.wait(10.0)
        asking.join()
    assert "Enter to arm" in capsys.readouterr().err


def test_without_a_terminal_nothing_is_asked(tmp_path: Path) -> None:
    (tmp_path / "keys").write_text("x\n")
    with (tmp_path / "keys").open() as stream, Keys(stream) as keys:
        keys.wait_to_arm()
        assert not keys.pressed()


@pytest.mark.parametrize("onboard", [True, False], ids=["onboard", "host"])
def test_a_key_ends_the_run_disarmed_with_its_log(
    onboard: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, asked = LiveRobot(clock=PatientClock()), []

    def pressed() -> bool:
        if len(robot.pulses) >= 2:
            asked.append(len(robot.pulses))
        return bool(asked)

    options = RunOptions(PlanConfig(), onboard, 20 * PERIOD_S, stop=pressed)
    with rigged("serial", robot, tmp_path, monkeypatch) as there:
        session = LabSession(LabPort(there.wire, robot.clock))
        source = LivePool(robot.pulses, robot.clock)
        recording = run_session(session, source, rig.recording(shape(PATH), options))
        assert int(session.request("STATUS")["state"]) == STATE["DISARMED"]
    assert recording.ended == STOPPED
    assert len(asked) == 1, "it is asked no more once it has stopped"
    assert recording.decisions and recording.end_s > 0.0
    assert len(robot.pulses) <= asked[0] + 1, "no stroke begins after the key"
