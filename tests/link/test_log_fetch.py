"""``frogkick log fetch`` over each transport, then ``log replay``: the robot's decisions, repeated."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cli.commands import frogkick
from tests.core.log_rig import Log
from tests.link.live_robot import LiveRobot
from tests.link.rigged import TRANSPORTS, rigged
from tests.runs import rig

from frogkick.link.log import fetch_log
from frogkick.paths import shape
from frogkick.runs.lab_session import lab_session


@pytest.fixture
def robot() -> LiveRobot:
    """A robot that keeps a log."""
    live, log = LiveRobot(), Log()
    live.core._log = log  # lives as long
    live.core.core.fk_robot_use_log(live.core.memory, log.memory)
    return live


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_fetched_by_command_and_decided_again(
    transport: str,
    robot: LiveRobot,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "log.h5"
    with rigged(transport, robot, tmp_path, monkeypatch) as there:
        session, path = lab_session(there.wire), shape("line")
        session.handshake(rig.tables())
        session.send_path(path)
        session.request("ARM")
        pose = {"x_m": float(path.x_m[0]), "y_m": float(path.y_m[0]), "heading_rad": 0.0}
        for number in range(5):
            session.request("FIX", {"fix_sequence": number, "quality": 1, "capture_age_us": 1000, **pose})
        session.request("START", {"delay_us": 0})
        begun = fetch_log(session)
        assert begun.records()[0][-1].name != "SNAPSHOT"
        session.request("DISARM")
        there.wire.close()  # the command opens its own
        fetched = frogkick(capsys, "log", "fetch", "--robot", there.target, "--out", file, "--json")
    assert fetched.code == 0, fetched.stderr
    kinds = fetched.json["kinds"]
    assert (kinds["FIX"], kinds["START"], kinds["DISARM"], fetched.json["gaps"]) == (5, 1, 1, 0)
    output = frogkick(capsys, "log", "replay", file, "--tables", rig.small_table(), "--json")
    assert output.code == 0, output.stdout + output.stderr
    assert output.json["mismatches"] == 0
    assert output.json["decisions"] == kinds.get("DECISION", 0) >= 1


def test_a_firmware_without_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with rigged("serial", LiveRobot(), tmp_path, monkeypatch) as there:
        there.wire.close()
        output = frogkick(capsys, "log", "fetch", "--robot", there.target, "--out", tmp_path / "log.h5")
    assert output.code != 0 and "its firmware keeps no log" in output.stderr
    assert not (tmp_path / "log.h5").exists()
