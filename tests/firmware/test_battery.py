"""A robot that sees its batteries through dividers disarms where one of them is low at rest."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from test_hang import firing
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.link.layout import link_layout
from frogkick.pool.chip.pins import Saadc
from frogkick.pool.monitor import pulses_of
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot
from frogkick.robot.schema import Battery
from frogkick.runs.session import Session
from frogkick_codegen.firmware import _build_image, build

LAYOUT = link_layout()
SUPPLY, STATE = LAYOUT.supply, LAYOUT.state
DIVIDER = 5.7
BATTERY = Battery(4, 11.1, 10.5, 12.6, "at the plug", (0, 4), DIVIDER)
DECIDED_S = 4.0
"""Three readings, each at another turn of a loop that sleeps for half a second, and one turn more."""


def seeing(battery: Battery) -> Robot:
    return replace(rig.robot(), battery=battery)


@cache
def image() -> Path:
    folder = Path(rig._FOLDER.name) / "battery"
    return build("bench", rig.small_table(), seeing(BATTERY), folder).image


def robot(*volts: float) -> tuple[VirtualRobot, Session]:
    """Switched on, with such batteries at AIN0 and AIN4."""
    port = VirtualRobot(image(), 4)
    set_batteries(port, *volts)
    session = Session(port)
    session.handshake(rig.tables())
    session.step(DECIDED_S)
    return port, session


def set_batteries(port: VirtualRobot, *volts: float) -> None:
    for place, volt in zip(BATTERY.inputs, volts, strict=True):
        port.chip.power.input_v[place] = volt / DIVIDER


def state_and_supply(session: Session) -> tuple[int, int]:
    values = session.request("STATUS")
    return int(values["state"]), int(values["supply"])


def arm(session: Session) -> str:
    return LAYOUT.status_name(int(session.ask("ARM")["status"]))


@pytest.mark.parametrize("falls", [0, 1])
def test_one_battery_that_is_low_disarms(falls: int) -> None:
    """Well again only so far above the limit that a battery that recovers a little is not."""
    port, session = robot(12.0, 12.0)
    assert arm(session) == "OK"
    volts = [12.0, 12.0]
    for volt, state, supply in (
        (10.55, "ARMED", "OK"),
        (10.45, "DISARMED", "LOW"),
        (10.6, "DISARMED", "LOW"),
        (10.75, "DISARMED", "FELL"),
    ):
        volts[falls] = volt
        set_batteries(port, *volts)
        for _ in range(4):  # a link that says nothing disarms as well
            session.step(session.time_s + DECIDED_S / 4)
            found = state_and_supply(session)
        assert found == (STATE[state], SUPPLY[supply]), volt
        if supply == "LOW":
            assert arm(session) == "SUPPLY"
    assert arm(session) == "OK"


def test_a_battery_that_sags_under_load_is_none_that_is_low() -> None:
    port, session = robot(11.0, 11.0)
    assert arm(session) == "OK"
    for _ in range(6):
        session.post("STROKE", {"action": firing()})
        seen = len(session.edges)
        end_s = session.time_s + 1.2
        while session.time_s < end_s:
            session.step(session.time_s + 0.002)
            heated = any(p.end_s > session.time_s - 0.15 for p in pulses_of(session.edges, session.time_s))
            set_batteries(port, *([7.0, 7.0] if heated else [11.0, 11.0]))
        assert len(session.edges) > seen
        assert state_and_supply(session) == (STATE["ARMED"], SUPPLY["OK"])


@pytest.mark.parametrize("volts", [(0.0, 12.0), (12.0, 0.0), (10.6, 12.0)])
def test_a_battery_that_was_never_seen_well_counts_as_low(volts: tuple[float, float]) -> None:
    """A plug that is out; and one between the limit and well."""
    _, session = robot(*volts)
    assert state_and_supply(session) == (STATE["DISARMED"], SUPPLY["LOW"])
    assert arm(session) == "SUPPLY"


def test_a_converter_that_stops_disarms() -> None:
    port, session = robot(12.0, 12.0)
    assert arm(session) == "OK"
    (converter,) = (each for each in port.chip.peripherals if isinstance(each, Saadc))
    converter.works = False
    for _ in range(4):
        session.step(session.time_s + DECIDED_S / 4)
        found = state_and_supply(session)
    assert found == (STATE["DISARMED"], SUPPLY["LOW"])


def test_a_robot_that_sees_no_battery_never_asks() -> None:
    port = VirtualRobot(rig.firmware("bench").image, 4)
    session = Session(port)
    session.handshake(rig.tables())
    session.step(2.0)
    (converter,) = (each for each in port.chip.peripherals if isinstance(each, Saadc))
    assert not any(converter.values.values())
    assert arm(session) == "OK"


def test_the_gate_of_a_limb_sees_no_battery(tmp_path: Path) -> None:
    """AIN4 is the fifth limb's gate; this robot has four limbs, and one of its batteries there."""
    with pytest.raises(InputError, match="has 4, on the bench the gate of limb 5 of 6"):
        _build_image(tmp_path, "bench", 6, 4096, seeing(BATTERY))
