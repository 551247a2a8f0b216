"""A battery is low, or well again, by readings at rest that agree; unknown is low."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from tests.core.core import FFI, core

LEAST_MV, EVERY_US, REST_US, LATE_US, AGREE = 2000, 100_000, 300_000, 50_000, 3
WELL_MV = LEAST_MV + LEAST_MV // 50


class Battery:
    """The core's, and a clock."""

    def __init__(self) -> None:
        self.core, self.now_us = core(), 0
        self.memory: Any = FFI.new("fk_battery_t *")
        self.core.fk_battery_init(self.memory)

    @property
    def is_low(self) -> bool:
        return bool(self.core.fk_battery_is_low(self.memory))

    def is_due(self, after_us: int, limb_is_on: bool = False) -> bool:
        self.now_us += after_us
        return bool(self.core.fk_battery_is_due(self.memory, self.now_us, int(limb_is_on), LEAST_MV))

    def note(self, lowest_mv: int) -> None:
        self.core.fk_battery_note(self.memory, lowest_mv, LEAST_MV)

    def read(self, *lowest_mv: int) -> bool:
        for value in lowest_mv:
            assert self.is_due(REST_US)
            self.note(value)
        return self.is_low


def well() -> Battery:
    battery = Battery()
    assert battery.is_low and not battery.read(*[WELL_MV] * AGREE)
    return battery


@pytest.mark.parametrize("wrong", [*itertools.product([False, True], repeat=5)])
def test_readings_in_a_row_decide(wrong: tuple[bool, ...]) -> None:
    battery, in_a_row, low = well(), 0, False
    for is_low in wrong:
        found = battery.read(LEAST_MV - 1 if is_low else WELL_MV)
        in_a_row = in_a_row + 1 if is_low != low else 0
        low, in_a_row = (is_low, 0) if in_a_row == AGREE else (low, in_a_row)
        assert found == low


def test_it_is_low_below_its_limit_and_well_only_above_it() -> None:
    battery = well()
    assert not battery.read(*[LEAST_MV] * 9)
    assert battery.read(*[LEAST_MV - 1] * AGREE)
    assert battery.read(*[WELL_MV - 1] * 9)
    assert not battery.read(*[WELL_MV] * AGREE)


def test_nothing_is_read_while_limbs_are_on_nor_soon_after() -> None:
    battery = well()
    assert not battery.is_due(REST_US, limb_is_on=True)
    assert not battery.is_due(REST_US - 1)
    assert battery.is_due(1)
    battery.note(WELL_MV)
    assert not battery.is_due(EVERY_US - 1) and battery.is_due(1)


def test_a_reading_that_a_pulse_began_in_is_not_counted() -> None:
    battery = well()
    for _ in range(9):
        assert battery.is_due(REST_US)
        assert not battery.is_due(10, limb_is_on=True)
        battery.note(0)
        assert not battery.is_low


def test_readings_that_never_come_are_low() -> None:
    battery = well()
    assert battery.is_due(REST_US) and not battery.is_due(LATE_US), "it may still come"
    for _ in range(AGREE - 1):
        assert battery.is_due(REST_US) and not battery.is_low
    assert battery.is_due(REST_US) and battery.is_low
