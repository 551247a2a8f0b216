"""What the bench image does about errata of the nRF52832 (reference/errata.md), seen by the virtual chip."""

from __future__ import annotations

from pathlib import Path

import pytest
from bare_chip import clock_of, power_of
from bench_build import build
from tests.conftest import some
from tests.runs import rig
from unicorn import arm_const

from frogkick.link.layout import link_layout
from frogkick.paths import shape
from frogkick.pool.chip import VirtualChip
from frogkick.pool.chip.bus import CYCLES_PER_US, Peripheral
from frogkick.pool.chip.image import load_image
from frogkick.pool.chip.power import Timer, Watchdog
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.runs.session import Session

RESET = link_layout().reset
PIN, DOG, SOFTWARE, LOCKUP = 1, 2, 4, 8


def block(chip: VirtualChip, name: str) -> Peripheral:
    return next(one for one in chip.peripherals if one.name == name)


def robot() -> VirtualRobot:
    return VirtualRobot(rig.firmware("bench").image, len(rig.robot().limbs))


def test_calibration_is_copied_before_the_first_sleep_after_every_reset() -> None:
    """Errata 31 and 108: the factory's words, only the bits that are meant."""
    chip = robot().chip
    for _ in range(2):
        while not chip.sleeping:
            chip.run_until(chip.time_us + 1.0)
        clock = clock_of(chip).values
        assert (clock["ERRATUM_31"], clock["ERRATUM_108"]) == (0xBFFF >> 13 & 7, 0xCA & 0x4F)
        resets = len(chip.resets)
        chip.hang()
        while len(chip.resets) == resets:
            chip.run_until(chip.time_us + 1000.0)
        assert clock_of(chip).values["ERRATUM_108"] == 0


@pytest.mark.parametrize("others", [0, DOG, SOFTWARE, LOCKUP, DOG | LOCKUP])
def test_a_pin_reset_is_told_as_one_whatever_else_stands_there(others: int) -> None:
    """Erratum 136."""
    port = robot()
    power_of(port.chip).values["RESETREAS"] = PIN | others
    session = Session(port)
    session.handshake(rig.tables())
    assert session.request("STATUS")["reset"] == RESET["PIN"]
    assert power_of(port.chip).values["RESETREAS"] == 0


@pytest.mark.parametrize("limbs", some([1, 2, 3, 4], 2))
@pytest.mark.parametrize("ends", ["by itself", "off"])
def test_a_pulse_s_end_leaves_no_mode_behind_that_costs_current(
    limbs: int, ends: str, tmp_path: Path
) -> None:
    """Errata 156 and 78: after CLR tasks low power, after the timer's stop its shutdown."""
    source = Path(__file__).with_name("driver_echo.c")
    chip = VirtualChip(build([source], tmp_path / "echo.elf", f"-DFK_BOARD_LIMBS={limbs}u"))
    chip.run_until(2000.0)
    chip.send(bytes([0xFE, 1, 1, 100, 0]), chip.time_us)
    chip.run_until(chip.time_us + 1000.0)
    timer = block(chip, "TIMER2")
    assert isinstance(timer, Timer) and timer.draws, "it is on"
    if ends == "off":
        chip.send(bytes([0xFE, 3]), chip.time_us)
    chip.run_until(chip.time_us + 5000.0)
    assert [level for _, pin, level in chip.pin_edges() if pin == 22] == [True, False]
    assert not power_of(chip).constant_latency
    assert not timer.draws


def test_no_flag_of_the_fpu_stands_in_sleep() -> None:
    """Erratum 87: after decisions, which round, no flag keeps the FPU's interrupt pending."""
    port = robot()
    session = Session(port)
    session.handshake(rig.tables())
    session.send_path(shape("line"))
    state = {"x_m": 0.0, "y_m": 0.02, "heading_rad": 0.1, "vx_mps": 0.02, "vy_mps": 0.0, "omega_rad_s": 0.0}
    rested = {f"limb_use_{limb}": 0 for limb in range(8)}
    session.request("PLAN", {"depth": 1, **state, **rested, "along_points": 0.0})
    session.step(session.time_s + 0.2)
    while not port.chip.sleeping:
        session.step(session.time_s + 1e-4)
    assert port.chip._uc.reg_read(arm_const.UC_ARM_REG_FPSCR) & 0x9F == 0


def test_four_instructions_that_write_nothing_follow_each_sleep() -> None:
    """Erratum 220: WFE, and then four NOP."""
    image = load_image(rig.firmware("bench").image)
    begin = image.symbols["fk_sleep"] & ~1
    code = image.flash[begin : begin + 64]
    wfe = bytes.fromhex("20bf")
    at = code.index(wfe)
    assert code[at + 2 : at + 10] == bytes.fromhex("00bf") * 4
    assert image.flash.count(wfe + bytes.fromhex("00bf") * 4) == 1


def test_the_slow_oscillator_is_started_late_enough() -> None:
    """Erratum 132: it may not start between 230 and 330 us after a reset; the watchdog starts it."""
    chip = robot().chip
    for _ in range(2):
        began_cycle = chip.cycles
        chip.run_until(chip.time_us + 20_000.0)
        watchdog = block(chip, "WDT")
        assert isinstance(watchdog, Watchdog)
        assert watchdog.started_cycle - began_cycle > 330 * CYCLES_PER_US
        chip.hang()
        if not chip.resets:
            chip.run_until(chip.time_us + 900_000.0)  # of the watchdog's second
            assert not chip.resets
        while len(chip.resets) == 0:
            chip.run_until(chip.time_us + 1.0)
        chip.hang(False)
