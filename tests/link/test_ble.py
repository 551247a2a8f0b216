"""What only Bluetooth has: finding a robot, sizes, pairing, adapters; with bleak's real client."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import bleak
import pytest
from bleak.exc import (
    BleakBluetoothNotAvailableError,
    BleakBluetoothNotAvailableReason,
    BleakDBusError,
    BleakError,
)
from tests.link.air import Air, Peripheral, VirtualScanner, breathe
from tests.link.live_robot import LiveRobot
from tests.planner import synthetic
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.core.poses import Fix
from frogkick.link import ble
from frogkick.link.ble import BleWire, explained
from frogkick.link.frames import unpack_frame
from frogkick.link.wire import WireError
from frogkick.paths import shape
from frogkick.runs.lab_session import lab_session
from frogkick.runs.pushing import upload


@contextmanager
def connected(place: str, scan_s: float = 0.5) -> Iterator[BleWire]:
    wire = BleWire(place, scan_s)
    try:
        yield wire
    finally:
        wire.close()


def test_by_name_and_by_address(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = Peripheral(LiveRobot(), "frog1"), Peripheral(LiveRobot(), "frog2")
    breathe(monkeypatch, first, second)
    with connected("frog2") as wire:
        assert wire.address == second.address
        lab_session(wire).handshake(rig.tables())
    assert (first.connections, second.connections) == (0, 1)
    breathe(monkeypatch, first, second)
    with connected(first.address.lower()) as wire:
        assert wire.address == first.address
    assert (first.connections, second.connections) == (1, 1)


def test_two_robots_with_one_name(monkeypatch: pytest.MonkeyPatch) -> None:
    robots = [Peripheral(LiveRobot()), Peripheral(LiveRobot())]
    breathe(monkeypatch, *robots)
    one, other = sorted(robot.address for robot in robots)
    with pytest.raises(WireError) as caught, connected("frogkick"):
        pass
    assert str(caught.value) == (
        f"2 robots are called 'frogkick' ({one}, {other}): switch the others off, or give the address, as "
        f"--robot ble:{one}"
    )
    assert [robot.connections for robot in robots] == [0, 0]


def test_a_robot_that_came_back_is_the_same_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even if another robot of its name has been switched on meanwhile."""
    robot, other = Peripheral(LiveRobot()), Peripheral(LiveRobot(), asleep=True)
    air = breathe(monkeypatch, robot, other)
    with connected("frogkick") as wire:
        session = lab_session(wire)
        session.handshake(rig.tables())
        air.call(other.advertise)
        air.call(robot.drop)
        session.request("STATUS")
        assert (robot.connections, other.connections) == (2, 0)


def test_a_robot_asleep(monkeypatch: pytest.MonkeyPatch) -> None:
    breathe(monkeypatch, Peripheral(LiveRobot(), asleep=True), Peripheral(LiveRobot(), "frog7"))
    with (
        pytest.raises(WireError, match=r"'frogkick' advertises within 0.5 s \(heard: frog7\): switch it on"),
        connected("frogkick"),
    ):
        pass
    breathe(monkeypatch)
    with pytest.raises(WireError, match=r"\(heard: none\)"), connected("frogkick"):
        pass


def test_other_firmware_is_not_heard_or_lacks_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    breathe(monkeypatch, Peripheral(None, has_characteristics=False))
    with pytest.raises(WireError, match="'frogkick' has no Nordic UART Service"), connected("frogkick"):
        pass


def test_a_robot_that_wants_pairing(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Peripheral(LiveRobot(), wants_pairing=True)
    breathe(monkeypatch, robot)
    with pytest.raises(WireError, match="wants pairing"), connected("frogkick") as wire:
        lab_session(wire).handshake(rig.tables())
    assert robot.written == []


@pytest.mark.parametrize("mtu", [23, 64, 247])
def test_frames_are_cut_to_the_size_negotiated(monkeypatch: pytest.MonkeyPatch, mtu: int) -> None:
    live = LiveRobot()
    robot = Peripheral(live, mtu=mtu)
    breathe(monkeypatch, robot)
    with connected("frogkick") as wire:
        session = lab_session(wire)
        session.handshake(rig.tables())
        session.send_path(shape("sine"))
        for number in range(30):  # fixes, in parts too, beside commands
            session.post_fix(Fix(session.time_s, 0.0, 0.0, 0.0, 0.0, sequence=number), session.port.now_s)
            session.request("STATUS")
        session.step(session.port.now_s + 0.1)
        assert wire.part_bytes == mtu - 3
        assert max(robot.written) == min(mtu - 3, max(robot.written))
        assert int(session.request("STATUS")["frames_bad"]) == 0
    assert live.names().count("PATH") == 6
    assert live.names().count("FIX") >= 10


def test_how_frames_are_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands with response. Fixes and chunks of a table, which the robot answers itself, without."""
    new = synthetic.affine_image(20, 9, 2)
    air = breathe(monkeypatch, Peripheral(LiveRobot()))
    with connected("frogkick") as wire:
        session = lab_session(wire)
        session.handshake(rig.tables())
        session.post_fix(Fix(0.0, 0.0, 0.0, 0.0, 0.0), session.port.now_s)
        upload(session, new)
    with_response: dict[str, set[bool]] = {}
    for data, response in air.writes:
        if data != b"\0":
            with_response.setdefault(unpack_frame(data[:-1]).name, set()).add(response)
    assert with_response == {
        "HELLO": {True}, "STATUS": {True}, "FIX": {False}, "TABLE_STATUS": {True}, "TABLE_BEGIN": {True},
        "TABLE_CHUNK": {False}, "TABLE_COMMIT": {True},
    }  # fmt: skip


def test_fixes_that_wait_are_the_newest(monkeypatch: pytest.MonkeyPatch) -> None:
    live = LiveRobot()
    breathe(monkeypatch, Peripheral(live))
    with connected("frogkick") as wire:
        session = lab_session(wire)
        session.handshake(rig.tables())

        async def burst() -> None:  # nothing of it can be written before its end
            for number in range(10):
                session.post_fix(Fix(0.0, 0.0, 0.0, 0.0, 0.0, sequence=number), session.port.now_s)

        Air.now.call(burst)
        session.request("STATUS")
        session.step(session.port.now_s + 0.1)
    numbers = [frame.values["fix_sequence"] for _, frame in live.heard if frame.name == "FIX"]
    assert numbers[-1] == 9 and len(numbers) <= ble.FIXES_WAITING + 1


@pytest.mark.skipif(sys.platform != "linux", reason="asks for BlueZ's bus, which is Linux's")
def test_without_a_bluetooth_service(monkeypatch: pytest.MonkeyPatch) -> None:
    """bleak's own backend, without a D-Bus that answers."""
    from bleak.backends.bluezdbus import manager

    monkeypatch.setitem(os.environ, "DBUS_SYSTEM_BUS_ADDRESS", "unix:path=/nonexistent/bus")
    with pytest.raises(WireError, match=r"no Bluetooth service runs here .*bluez"), connected("frogkick"):
        pass
    manager._global_instances.clear()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ("NO_BLUETOOTH", "no Bluetooth adapter that could talk"),
        ("NO_BLE_CENTRAL_ROLE", "no Bluetooth adapter that could talk"),
        ("POWERED_OFF", "Bluetooth is switched off here"),
        ("DENIED_BY_USER", "no permission for Bluetooth"),
        ("DENIED_BY_SYSTEM", "no permission for Bluetooth"),
        ("UNKNOWN", "no Bluetooth adapter that could talk"),
    ],
)
def test_adapters(monkeypatch: pytest.MonkeyPatch, error: str, words: str) -> None:
    """An error of the adapter at the start of a scan reaches the user, and the scan is not repeated."""
    started = []

    class Without(VirtualScanner):
        async def start(self) -> None:
            started.append(self)
            raise BleakBluetoothNotAvailableError("backend", BleakBluetoothNotAvailableReason[error])

    breathe(monkeypatch)
    monkeypatch.setattr(bleak, "get_platform_scanner_backend_type", lambda: (Without, "virtual"))
    with pytest.raises(WireError, match=words), connected("frogkick"):
        pass
    assert len(started) == 1


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (BleakDBusError("org.freedesktop.DBus.Error.AccessDenied", ["no"]), "no permission"),
        (BleakDBusError("org.bluez.Error.NotReady", ["Resource Not Ready"]), "switched off here"),
        (BleakDBusError("org.freedesktop.DBus.Error.ServiceUnknown", ["x"]), "no Bluetooth service runs"),
        (PermissionError(13, "Permission denied"), "no permission"),
        (TimeoutError(), "takes no connection within 10 s"),
        (BleakError("le-connection-abort-by-local"), r"failed \(le-connection-abort-by-local\)"),
        (RuntimeError("odd"), r"RuntimeError: odd"),
    ],
)
def test_what_backends_say(error: Exception, words: str) -> None:
    with pytest.raises(WireError, match=words):
        raise explained(error, "frogkick")
    assert "\n" not in str(explained(error, "frogkick"))


def test_a_scan_tells_who_is_there(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two robots of one name have their addresses; for pairing or other firmware there is the reason."""
    robots = [
        Peripheral(LiveRobot(), "frog"),
        Peripheral(LiveRobot(), "twin"),
        Peripheral(LiveRobot(), "twin"),
        Peripheral(LiveRobot(), "shy", wants_pairing=True),
        Peripheral(LiveRobot(), "asleep", asleep=True),
        Peripheral(None, "other", has_characteristics=False),
    ]
    breathe(monkeypatch, *robots)
    assert run_command(["scan", "--seconds", "0.5", "--json"]) == 0
    found = {row.pop("address"): row for row in json.loads(capsys.readouterr().out)["robots"]}
    assert set(found) == {robot.address for robot in robots if not robot.asleep}
    frog, twin, _, shy, _, other = (found.get(robot.address) for robot in robots)
    assert frog == {
        "target": "ble:frog", "signal_dbm": frog["signal_dbm"], "robot": "frog2022",
        "table_crc": rig.tables().crc32, "state": "DISARMED", "owned": False, "error": "",
    }  # fmt: skip
    assert -128 < frog["signal_dbm"] <= 20
    assert twin["target"] == f"ble:{robots[1].address}" and twin["robot"] == "frog2022"
    assert "wants pairing" in shy["error"] and shy["robot"] is None
    assert "no Nordic UART Service" in other["error"]

    breathe(monkeypatch, robots[0])
    assert run_command(["scan", "--seconds", "0.5"]) == 0
    output = capsys.readouterr().out
    assert re.fullmatch(rf"ble:frog  -?\d+ dBm  frog2022, table {rig.tables().crc32:08x}, DISARMED\n", output)

    breathe(monkeypatch)
    assert run_command(["scan", "--seconds", "0.5"]) == 1
    silence = capsys.readouterr()
    assert silence.out == "" and silence.err.startswith("frogkick: no robot advertises within 0.5 s: ")
    assert run_command(["scan", "--seconds", "0"]) == 2
