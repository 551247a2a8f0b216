"""The robot's firmware on the virtual chip where its core hangs: the pulse ends, the watchdog resets it."""

from __future__ import annotations

import random
import shutil
from itertools import pairwise
from pathlib import Path

import pytest
from bare_chip import clock_of, power_of
from tests.conftest import REPOSITORY, count, some
from tests.runs import rig

from frogkick.link.layout import link_layout
from frogkick.paths import shape
from frogkick.pool.chip import ChipError
from frogkick.pool.chip.power import Watchdog
from frogkick.pool.monitor import pulses_of
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.runs.session import LinkError, Session
from frogkick_codegen import firmware

RESET, STATE, FAULT = link_layout().reset, link_layout().state, link_layout().fault
WATCHDOG_S = 1.0
CYCLE_S = 1 / 64e6


def armed() -> tuple[VirtualRobot, Session]:
    port = rig.port("virtual")
    assert isinstance(port, VirtualRobot)
    session = Session(port)
    session.handshake(rig.tables())
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
    assert pulses and all(p.end_s - p.start_s == pytest.approx(wanted_s, abs=CYCLE_S) for p in pulses)
    first_mask = rig.tables().actions[firing()].first_mask
    assert sum(1 << pulse.limb for pulse in pulses) == first_mask
    session.step(hung_s + WATCHDOG_S)
    (reset_us,) = port.chip.resets
    assert hung_s < reset_us * 1e-6 <= hung_s + WATCHDOG_S
    # Disarmed, and it says why it began anew.
    session.handshake(rig.tables())
    status = session.request("STATUS")
    assert (status["state"], status["reset"], status["fault"]) == (
        STATE["DISARMED"], RESET["WATCHDOG"], FAULT["NONE"]
    )  # fmt: skip
    assert status["now_us"] < 1e6, "its clock began anew"
    assert session.ask("STROKE", {"action": firing()})["status"] == link_layout().status["STATE"]
    session.step(session.time_s + 1.0)
    assert len(session.edges) == 2 * len(pulses), "no pulse since"
    assert port.chip.resets == [reset_us], "fed again"


def test_a_robot_that_was_held_up_refuses_the_stroke_and_goes_on() -> None:
    """Whenever it is held up for a while: the stroke is swum or refused, and nothing else."""
    port, session = armed()
    row, wanted_s = rig.tables().actions[firing()], rig.tables().pulse_us * 1e-6
    limbs = row.first_mask.bit_count() + row.second_mask.bit_count()
    outcomes, dice = [], random.Random(1)
    for number in range(count(100, 600, 30)):
        seen, posted_s = len(session.edges), session.time_s
        session.post("STROKE", {"action": firing()})
        session.step(posted_s + dice.uniform(1.2e-3, 1.6e-3))  # it begins some 1.4 ms after its command
        port.chip.hang()
        session.step(session.time_s + dice.choice((0.0003, 0.02)))
        port.chip.hang(False)
        session.step(session.time_s + 2.0)
        pulses = pulses_of(session.edges[seen:], session.time_s)
        assert all(p.end_s - p.start_s == pytest.approx(wanted_s, abs=CYCLE_S) for p in pulses)
        outcomes.append(len(pulses))
        assert len(session.take("REFUSED")) == (0 if pulses else 1), number
        status = session.request("STATUS")
        assert (status["state"], status["fault"]) == (STATE["ARMED"], FAULT["NONE"]), number
    assert set(outcomes) == {0, limbs}, outcomes


def test_the_watchdog_is_fed_between_two_commands_that_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands that came together take long together: that must not look like a robot that hangs."""
    port, session = armed()
    session.send_path(shape("line"))
    fed: list[float] = []
    reload = Watchdog._reload

    def noted(self: Watchdog) -> None:
        fed.append(port.chip.now_cycle / 64e6)
        reload(self)

    monkeypatch.setattr(Watchdog, "_reload", noted)
    state = {"x_m": 0.0, "y_m": 0.02, "heading_rad": 0.1, "vx_mps": 0.02, "vy_mps": 0.0, "omega_rad_s": 0.0}
    rested = {f"limb_use_{limb}": 0 for limb in range(8)}
    values = {"depth": 3, **state, **rested, "along_points": 0.0}

    def turns_s(commands: int) -> list[float]:
        """Between two feeds, while so many commands are answered that came at once."""
        del fed[:]
        for _ in range(commands):
            session.post("PLAN", values)
        answered: list[float] = []
        while len(answered) < commands:
            session.step(session.time_s + 0.001)
            answered += [arrival.time_s for arrival in session.take("PLAN")]
        return [later - earlier for earlier, later in pairwise(at for at in fed if at <= answered[-1])]

    one_s = max(turns_s(1))
    assert one_s > 0.003, "long enough for others to come meanwhile"
    # Behind the last command it sleeps while answers are sent, which is longer.
    long = [turn for turn in turns_s(6) if turn > 0.9 * one_s]
    assert len(long) >= 6 and max(long[:6]) < 1.2 * one_s, (one_s, long)


def test_the_watchdog_is_fed_while_nothing_happens() -> None:
    port, session = armed()
    session.step(session.time_s + 4.0)
    assert port.chip.resets == []
    assert session.request("STATUS")["state"] == STATE["ARMED"]
    session.step(session.time_s + 20.0)
    assert port.chip.resets == []
    assert session.request("STATUS")["state"] == STATE["DISARMED"], "nobody spoke to it for 5 s"


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
    session.handshake(rig.tables())
    assert session.request("STATUS")["reset"] == RESET["WATCHDOG"]
    (power,) = (block for block in port.chip.peripherals if block.name == "POWER")
    assert power.values["RESETREAS"] == 0


def test_a_robot_without_a_crystal_does_not_arm() -> None:
    """It says so, in one line, and does not hang."""
    port = VirtualRobot(rig.firmware("bench").image, len(rig.robot().limbs))
    power_of(port.chip).crystal_works = False
    session = Session(port)
    session.handshake(rig.tables())
    with pytest.raises(LinkError, match=r"^the robot refuses ARM: FAULT, internal error CLOCK \(0\)$"):
        session.request("ARM")
    assert session.request("STATUS")["state"] == STATE["FAULT"]
    session.step(session.time_s + 3.0)
    assert port.chip.resets == [] and session.edges == []


def test_a_crystal_that_stops_disarms() -> None:
    port, session = armed()
    session.post("STROKE", {"action": firing()})
    while not session.edges:
        session.step(session.time_s + 0.0001)
    begun = len(session.edges)
    clock_of(port.chip).break_down()
    session.step(session.time_s + 0.5)  # it looks at each turn of its loop
    status = session.request("STATUS")
    assert (status["state"], status["fault"]) == (STATE["FAULT"], FAULT["CLOCK"])
    assert sum(edge.level for edge in session.edges) == begun, "no other limb"
    assert not any(edge.level for edge in session.edges[-begun:])


# Each of these protections taken out: the same look at the pins finds it.

MUTANTS = {
    "no timer ends the pulse": (
        "pulse.c", "    PPI_CHENSET = LIMBS_MASK << FK_PPI_PULSE_END_FIRST;\n", "", "pulse",
    ),
    "a timer of twice the time": (
        "pulse.c", "TIMER_CC(PULSE_TIMER, CC_END) = BEGIN_TICK + pulse_us;",
        "TIMER_CC(PULSE_TIMER, CC_END) = 2u * pulse_us;", "pulse",
    ),
    "no watchdog": ("watchdog.c", "    WDT_TASKS_START = 1u;\n", "", "reset"),
    "a watchdog of twice the time": (
        "watchdog.c", "#define WATCHDOG_TICKS_PER_S 32768u", "#define WATCHDOG_TICKS_PER_S 65536u", "reset",
    ),
    "a watchdog that nobody feeds": ("main.c", "        fk_watchdog_feed();\n", "", "unasked"),
    "a watchdog that sleeps": (
        "watchdog.c", "WDT_CONFIG_SLEEP_Run << WDT_CONFIG_SLEEP_Pos", "0u", "refused",
    ),
    "a reason that is never taken back": ("watchdog.c", "POWER_RESETREAS = reasons;", "", "reason"),
}  # fmt: skip


def what_breaks(elf: Path) -> set[str]:
    """A hang in the middle of a pulse of this firmware: which protections do not hold."""
    port = VirtualRobot(elf, len(rig.robot().limbs))
    session, found = Session(port), set()
    try:
        session.step(2.5)
    except ChipError:
        return {"refused"}
    if port.chip.resets:
        return {"unasked"}
    session.handshake(rig.tables())
    session.request("ARM")
    session.post("STROKE", {"action": firing()})
    session.step(session.time_s + 0.02)
    assert session.edges and all(edge.level for edge in session.edges)
    port.chip.hang()
    hung_s = session.time_s
    session.step(hung_s + rig.robot().guard.pulse_max_s)
    wanted_s = rig.tables().pulse_us * 1e-6
    if any(p.end_s - p.start_s > wanted_s + CYCLE_S for p in pulses_of(session.edges, session.time_s)):
        found.add("pulse")
    session.step(hung_s + WATCHDOG_S)
    if len(port.chip.resets) != 1:
        return found | {"reset"}
    (power,) = (block for block in port.chip.peripherals if block.name == "POWER")
    session.step(session.time_s + 0.2)
    return found | ({"reason"} if power.values["RESETREAS"] else set())


def test_nothing_breaks() -> None:
    assert what_breaks(rig.firmware("bench").image) == set()


@pytest.mark.parametrize("name", some(MUTANTS, 3))
def test_a_firmware_without_a_protection_is_found_out(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, old, new, what = MUTANTS[name]
    for part in ("bench", "core"):
        shutil.copytree(REPOSITORY / "firmware" / part, tmp_path / "firmware" / part)
    source = tmp_path / "firmware" / "bench" / file
    text = source.read_text(encoding="utf-8")
    assert text.count(old) == 1, f"{file} holds {old!r} {text.count(old)} times: correct the mutation"
    source.write_text(text.replace(old, new), encoding="utf-8")
    monkeypatch.setattr(firmware, "firmware_sources", lambda: tmp_path / "firmware")
    built = firmware.build("bench", rig.small_table(), rig.robot(), tmp_path / "out")
    assert what in what_breaks(built.image)
