"""The robot's firmware on the virtual chip where its core hangs: the pulse ends, the watchdog resets it."""

from __future__ import annotations

import pytest
from tests.loop import rig

from frogkick.link.layout import link_layout
from frogkick.loop.session import Session
from frogkick.pool.monitor import pulses_of
from frogkick.pool.virtual_robot import VirtualRobot

RESET, STATE, FAULT = link_layout().reset, link_layout().state, link_layout().fault
WATCHDOG_S = 1.0


def armed() -> tuple[VirtualRobot, Session]:
    port = rig.port("virtual")
    assert isinstance(port, VirtualRobot)
    session = Session(port)
    session.greet(rig.tables())
    session.request("ARM")
    session.step(max(session.time_s, 0.6))  # limbs rest after the start
    return port, session


def firing() -> int:
    return next(i for i, row in enumerate(rig.tables().actions) if row.first_mask and row.second_mask)


@pytest.mark.parametrize("into_pulse_s", [0.0002, 0.001, 0.04, 0.0795])
def test_a_hang_in_the_middle_of_a_pulse(into_pulse_s: float) -> None:
    port, session = armed()
    assert session.request("STATUS")["reset"] == RESET["POWER"]
    session.post("STROKE", {"action": firing()})
    while not session.edges:
        session.step(session.time_s + 0.0001)
    begin_s = session.edges[0].time_s
    session.step(begin_s + into_pulse_s)
    assert all(edge.level for edge in session.edges), "still on"
    port.chip.hang()
    hung_s = session.time_s
    session.step(begin_s + rig.robot().guard.pulse_max_s)
    # The hardware ends it to the cycle that the table says, and nothing begins while the core hangs.
    pulses = pulses_of(session.edges, session.time_s)
    wanted_s = rig.tables().pulse_us * 1e-6
    assert pulses and all(wanted_s - 2e-6 <= p.end_s - p.start_s <= wanted_s for p in pulses)
    first_mask = rig.tables().actions[firing()].first_mask
    assert sum(1 << pulse.limb for pulse in pulses) == first_mask
    session.step(hung_s + WATCHDOG_S)
    (reset_us,) = port.chip.resets
    assert hung_s < reset_us * 1e-6 <= hung_s + WATCHDOG_S
    # Disarmed, and it says why it began anew.
    session.conversation = 2
    session.greet(rig.tables())
    told = session.request("STATUS")
    assert (told["state"], told["reset"], told["fault"]) == (
        STATE["DISARMED"], RESET["WATCHDOG"], FAULT["NONE"]
    )  # fmt: skip
    assert told["now_us"] < 1e6, "its clock began anew"
    assert session.ask("STROKE", {"action": firing()})["status"] == link_layout().status["STATE"]
    session.step(session.time_s + 1.0)
    assert len(session.edges) == 2 * len(pulses), "no pulse since"
    assert port.chip.resets == [reset_us], "fed again"


def test_the_watchdog_is_fed_while_nothing_happens() -> None:
    port, session = armed()
    session.step(session.time_s + 5.0)
    assert port.chip.resets == []
    assert session.request("STATUS")["state"] == STATE["ARMED"]


def test_a_chip_that_hangs_again_and_again_never_fires() -> None:
    port, session = armed()
    for _ in range(3):
        session.step(session.time_s + 0.05)
        port.chip.hang()
        session.step(session.time_s + WATCHDOG_S)
    assert len(port.chip.resets) == 3
    assert session.edges == []


def test_two_reasons_are_not_mixed_up() -> None:
    """The second start tells its own reason: the first was taken back."""
    port, session = armed()
    port.chip.hang()
    session.step(session.time_s + WATCHDOG_S + 0.1)
    session.conversation = 2
    session.greet(rig.tables())
    assert session.request("STATUS")["reset"] == RESET["WATCHDOG"]
    (power,) = (block for block in port.chip.peripherals if block.name == "POWER")
    assert power.values["RESETREAS"] == 0
