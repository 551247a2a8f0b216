"""The supply of the virtual chip falls: the robot disarms, says why, and is armed again when it is well."""

from __future__ import annotations

import pytest
from test_hang import armed, firing
from tests.conftest import from_ci
from tests.runs import rig

from frogkick.link.layout import link_layout, supervisor
from frogkick.link.log import fetch_log
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.pool.monitor import pulses_of
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.runs.chip_log import replay_log
from frogkick.runs.closed_loop import ENDED, run_session
from frogkick.runs.decision import DecisionTwin
from frogkick.runs.record import RunOptions
from frogkick.runs.replay import compare, replay_on_host
from frogkick.runs.session import Session

LAYOUT = link_layout()
SUPPLY, STATE = LAYOUT.supply, LAYOUT.state


def status_of(session: Session, name: str) -> str:
    return LAYOUT.status_name(int(session.ask(name)["status"]))


def state_and_supply(session: Session) -> tuple[int, int]:
    values = session.request("STATUS")
    return int(values["state"]), int(values["supply"])


@pytest.mark.parametrize("into_pulse_s", [None, 0.0001, 0.001, 0.04, 0.0795])
def test_a_supply_that_falls_disarms_within_a_millisecond(into_pulse_s: float | None) -> None:
    """Asleep or in a pulse: the comparator wakes the core, as no interrupt does."""
    port, session = armed()
    if into_pulse_s is not None:
        session.post("STROKE", {"action": firing()})
        while not session.edges:
            session.step(session.time_s + 0.0001)
        session.step(session.edges[0].time_s + into_pulse_s)
    else:
        session.step(session.time_s + 0.2)
        assert port.chip.sleeping
    fell_s = session.time_s
    port.chip.power.set_supply(2.69)
    session.step(fell_s + 1.0)
    pulses = pulses_of(session.edges, session.time_s)
    assert all(pulse.end_s < fell_s + 0.001 for pulse in pulses)
    assert bool(pulses) == (into_pulse_s is not None)
    assert state_and_supply(session) == (STATE["DISARMED"], SUPPLY["LOW"])
    assert status_of(session, "ARM") == "SUPPLY"
    begun = port.chip.busy_cycles
    session.step(session.time_s + 10.0)
    assert (port.chip.busy_cycles - begun) / 64e6 < 0.1, "it sleeps all the same"
    assert status_of(session, "ARM") == "SUPPLY", "as long as it is low"
    port.chip.power.set_supply(2.75)
    session.step(session.time_s + 1.1)
    assert state_and_supply(session) == (STATE["DISARMED"], SUPPLY["FELL"])
    assert status_of(session, "ARM") == "OK"
    assert state_and_supply(session) == (STATE["ARMED"], SUPPLY["OK"])
    session.request("STROKE", {"action": firing()})
    session.step(session.time_s + 1.0)
    assert len(pulses_of(session.edges, session.time_s)) > len(pulses)


def test_a_supply_that_falls_while_it_computes_disarms_when_that_is_done() -> None:
    """The pulse that is on ends by itself, by the timer; the second one of its stroke does not begin."""
    port, session = armed()
    session.send_path(shape("line"))
    for name, value in (("COST", 0.0), ("PLAN_TIME_US", 0.0)):
        session.request("PARAM", {"parameter": LAYOUT.parameter[name], "value": value})
    state = {"x_m": 0.0, "y_m": 0.02, "heading_rad": 0.1, "vx_mps": 0.02, "vy_mps": 0.0, "omega_rad_s": 0.0}
    rested = {f"limb_use_{limb}": 0 for limb in range(8)}
    session.post("STROKE", {"action": firing()})
    while not session.edges:
        session.step(session.time_s + 0.0001)
    begun_s = session.edges[0].time_s
    session.post("PLAN", {"depth": 4, **state, **rested, "along_points": 0.0})
    session.step(begun_s + 0.005)
    port.chip.power.set_supply(2.69)
    session.step(begun_s + 1.0)
    (answer,) = session.take("PLAN")
    assert begun_s + 0.2 < answer.time_s < begun_s + 0.75, "longer than the pulse"
    pulses = pulses_of(session.edges, session.time_s)
    wanted_s = rig.tables().pulse_us * 1e-6
    assert pulses and all(p.start_s == begun_s for p in pulses)
    assert all(p.end_s - p.start_s == pytest.approx(wanted_s, abs=1e-7) for p in pulses)
    assert state_and_supply(session) == (STATE["DISARMED"], SUPPLY["LOW"])


@pytest.mark.parametrize("supply_v", [2.71, 3.0, 3.6])
def test_a_supply_that_is_well_changes_nothing(supply_v: float) -> None:
    port, session = armed()
    port.chip.power.set_supply(supply_v)
    session.step(session.time_s + 1.0)
    assert state_and_supply(session) == (STATE["ARMED"], SUPPLY["OK"])


def test_a_dip_of_a_microsecond_is_told() -> None:
    """As limbs may cause that are heated: it is well again before the core has looked."""
    port, session = armed()
    port.chip.power.set_supply(2.5)
    session.step(session.time_s + 1e-6)
    port.chip.power.set_supply(3.0)
    session.step(session.time_s + 1.5)
    assert state_and_supply(session) == (STATE["DISARMED"], SUPPLY["FELL"])


def test_a_robot_that_starts_with_a_low_supply_is_not_armed() -> None:
    port = VirtualRobot(rig.firmware("bench").image, len(rig.robot().limbs))
    port.chip.power.set_supply(2.4)
    session = Session(port)
    session.handshake(rig.tables())
    assert state_and_supply(session) == (STATE["DISARMED"], SUPPLY["LOW"])
    assert status_of(session, "ARM") == "SUPPLY"


def test_a_reset_with_a_low_supply() -> None:
    port, session = armed()
    port.chip.power.set_supply(2.4)
    port.chip.hang()
    session.step(session.time_s + 1.2)
    assert len(port.chip.resets) == 1
    session.handshake(rig.tables())
    assert state_and_supply(session) == (STATE["DISARMED"], SUPPLY["LOW"])


@from_ci
@pytest.mark.parametrize("onboard", [True, False])
def test_a_run_ends_where_the_supply_falls(onboard: bool) -> None:
    """The host says why; the robot's log tells it, and is decided again bit for bit up to the end."""
    port = rig.port("virtual")
    assert isinstance(port, VirtualRobot)
    made: list[float] = []

    def progress(time_s: float, _path_index: int) -> None:
        made.append(time_s)
        if len(made) == 3:
            port.chip.power.set_supply(2.5)

    options = RunOptions(PlanConfig(depth=1), onboard, 30.0)
    recording = run_session(
        Session(port), rig.new_pool("line"), rig.recording(shape("line"), options), progress
    )
    assert recording.ended == ENDED["SUPPLY"] and not recording.completed
    assert recording.end_s < made[2] + 3.0
    assert all(edge.time_s < made[2] + 0.002 for edge in recording.edges if edge.level)
    session = Session(port, time_s=recording.end_s + 1.0)
    session.handshake(rig.tables())
    log = fetch_log(session)
    found = replay_log(log, rig.firmware("native").image, [rig.tables()])
    assert found.mismatches == [] and found.replayed > 20
    (records,) = log.records()
    assert [r.values["event"] for r in records if r.name == "STATE"][-1] == supervisor().number("SUPPLY_LOW")
    if onboard:
        twin = DecisionTwin(rig.tables(), shape("line"), PlanConfig(depth=1))
        assert compare(recording.decisions, replay_on_host(recording.events, twin)) == []
