"""What only a serial line has: ports and their errors, noise, speeds; and addresses of robots."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tests.link.live_robot import LiveRobot
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.link.pty_line import PtyLine
from frogkick.link.serial import SerialWire, _account
from frogkick.link.wire import Target, WireError, is_target, parse_target
from frogkick.runs.lab_session import lab_session


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("ble:frogkick", Target("ble", "frogkick")),
        ("ble:C0:00:00:00:00:01", Target("ble", "C0:00:00:00:00:01")),
        ("serial:/dev/ttyACM0", Target("serial", "/dev/ttyACM0", 115_200)),
        ("serial:COM3:1000000", Target("serial", "COM3", 1_000_000)),
        ("serial:/dev/serial/by-id/a:b", Target("serial", "/dev/serial/by-id/a:b", 115_200)),
    ],
)
def test_targets(text: str, target: Target) -> None:
    assert is_target(text) and parse_target(text) == target


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("ble:", "neither ble:NAME nor serial:PORT"),
        ("serial:", "neither ble:NAME nor serial:PORT"),
        ("bel:frogkick", "did you mean 'ble'"),
        ("serial::115200", "names no port"),
        ("serial:COM3:300", "300 bits/s, allowed is 1200 to 4000000"),
        ("serial:COM3:4000001", "4000001 bits/s"),
        ("serial:COM3:9600x", "has the speed '9600x': give a whole number, as serial:COM3:115200"),
    ],
)
def test_no_targets(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_target(text)


def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(WireError, match=r"is not there \(ports here: .*\): plug it in"):
        SerialWire(str(tmp_path / "none"))


def test_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(WireError, match="is not a serial port"):
        SerialWire(str(tmp_path / "file"))


def test_a_port_in_use(tmp_path: Path) -> None:
    with PtyLine(tmp_path / "robot", LiveRobot()) as line:
        wire = SerialWire(str(line.path))
        with pytest.raises(WireError, match="in use by another program"):
            SerialWire(str(line.path))
        wire.close()
        SerialWire(str(line.path)).close()


def test_no_permission_says_what_to_do() -> None:
    # Tests may run as root, for whom every port opens.
    text = _account("/dev/ttyACM0", PermissionError(13, os.strerror(13)))
    assert text.startswith("no permission for serial port '/dev/ttyACM0'") and "dialout" in text


def test_noise_on_the_line_costs_nothing(tmp_path: Path) -> None:
    class Noisy(LiveRobot):
        def feed(self, data: bytes) -> bytes:
            return b"\x55\x00\xff\xfe\x00" + super().feed(data)

    robot = Noisy()
    robot.feed(b"\x11\x22half a frame")  # the receiver is in the middle of something
    with PtyLine(tmp_path / "robot", robot) as line:
        wire = SerialWire(str(line.path))
        session = lab_session(wire)
        session.handshake(rig.tables())
        for _ in range(20):
            session.request("STATUS")
        assert session.port.bad >= 40
        wire.close()
