"""What a machine is ready for, from what is plugged in."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from frogkick.front import readiness
from frogkick.front.readiness import adapters, cameras, check_hardware, debug_probes, stages


@pytest.mark.skipif(sys.platform != "linux", reason="looks where Linux has its devices")
def test_devices_are_seen(tmp_path: Path) -> None:
    assert adapters(tmp_path / "none") == []
    for name in ("hci1", "hci0", "video0", "tty1"):
        (tmp_path / name).touch()
    assert adapters(tmp_path) == ["hci0", "hci1"] and cameras(tmp_path) == ["video0"]


def test_each_stage_says_what_it_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readiness, "serial_ports", lambda: ["/dev/ttyACM0"])
    monkeypatch.setattr(readiness, "adapters", lambda: ["hci0"])
    monkeypatch.setattr(readiness, "cameras", lambda: [])
    monkeypatch.setattr(readiness, "debug_probes", lambda: ["683 (J-Link)"])
    hardware = check_hardware()
    assert [finding.detail for finding in hardware] == ["/dev/ttyACM0", "683 (J-Link)", "hci0", "none"]
    first, kit, robot = stages([], hardware)
    assert first.ready and kit.ready and not robot.ready
    (missing,) = [finding for finding in robot.findings if not finding.works]
    assert missing.name == "camera" and "plug one in" in missing.install


def test_another_system_is_not_accused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readiness.sys, "platform", "darwin")
    monkeypatch.setattr(readiness, "serial_ports", lambda: ["/dev/cu.usb"])
    monkeypatch.setattr(readiness, "debug_probes", lambda: ["683 (J-Link)"])
    assert all(stage.ready for stage in stages([], check_hardware()))


def test_a_driver_that_fails_is_no_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    class Probe:
        unique_id, description = "683", "J-Link"

    from pyocd.core.helpers import ConnectHelper

    monkeypatch.setattr(ConnectHelper, "get_all_connected_probes", lambda **_options: [Probe])
    assert debug_probes() == ["683 (J-Link)"]

    def fail(**_options: object) -> None:
        raise RuntimeError("no backend for USB")

    monkeypatch.setattr(ConnectHelper, "get_all_connected_probes", fail)
    assert debug_probes() == []
