"""The guard: wishes dense at its limits, judged by a slow reference and by the independent monitor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from tests.core.core import FFI, cases, core, library, mutated

from frogkick.pool.monitor import Pulse, violations
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
LIMBS = len(ROBOT.limbs)
PULSE_MAX_US = round(ROBOT.guard.pulse_max_s * 1e6)
REST_US = round(ROBOT.guard.rest_min_s * 1e6)
WINDOW_US = round(ROBOT.guard.duty_window_s * 1e6)
ON_MAX_US = round(ROBOT.guard.duty_max * ROBOT.guard.duty_window_s * 1e6)
AT_ONCE = ROBOT.guard.limbs_at_once_max
WISHES = 24


class Guard:
    """One guard in C."""

    def __init__(self, made: Any = None) -> None:
        self._core = core() if made is None else made
        self._memory = FFI.new("uint64_t[]", self._core.fk_test_guard_bytes() // 8)
        self._core.fk_guard_init(self._memory)

    def allow(self, mask: int, pulse_us: int, now_us: int) -> bool:
        return bool(self._core.fk_guard_allow(self._memory, mask, pulse_us, now_us))

    def cut(self, now_us: int) -> None:
        self._core.fk_guard_cut(self._memory, now_us)


@dataclass
class Reference:
    """The limits word by word over every pulse ever, in whole microseconds. Nothing is on before boot."""

    pulses: list[list[tuple[int, int]]] = field(default_factory=lambda: [[] for _ in range(8)])

    def allow(self, mask: int, pulse_us: int, now_us: int) -> bool:
        if not mask or not 0 < pulse_us <= PULSE_MAX_US:
            return False
        end_us = now_us + pulse_us
        on = 0
        for limb, mine in enumerate(self.pulses):
            if mask >> limb & 1:
                on += 1
                # A limb may have been on until the reset: it rests first.
                if now_us - max((end for _, end in mine), default=0) < REST_US:
                    return False
                # Every window over the old pulses and this one: the fullest ends at some pulse's end.
                every = [*mine, (now_us, end_us)]
                for _, until in every:
                    held = sum(max(0, min(e, until) - max(s, until - WINDOW_US)) for s, e in every)
                    if held > ON_MAX_US:
                        return False
            else:
                on += any(s <= now_us < e for s, e in mine)
        if on > AT_ONCE:
            return False
        for limb in range(8):
            if mask >> limb & 1:
                self.pulses[limb].append((now_us, end_us))
        return True

    def cut(self, now_us: int) -> None:
        self.pulses = [[(s, min(e, now_us)) for s, e in mine] for mine in self.pulses]

    def seen(self) -> list[Pulse]:
        """As the monitor sees pins."""
        return [
            Pulse(limb, s * 1e-6, e * 1e-6) for limb, mine in enumerate(self.pulses) for s, e in mine if e > s
        ]


class Book:
    """What a guard allowed, without judging."""

    def __init__(self) -> None:
        self.reference = Reference()

    def note(self, mask: int, pulse_us: int, now_us: int) -> None:
        for limb in range(8):
            if mask >> limb & 1:
                self.reference.pulses[limb].append((now_us, now_us + pulse_us))


PULSES_US = [
    PULSE_MAX_US, PULSE_MAX_US, PULSE_MAX_US - 1, PULSE_MAX_US + 1, 80_000, 80_000, 80_000, ON_MAX_US // 4,
    50_000, 1, 2, 0, 2 * PULSE_MAX_US, 0xFFFFFFFF,
]  # fmt: skip
MASKS = [1, 2, 4, 8, 3, 12, 6, 5, 9, 10, 7, 14, 15, 0]


def next_time_us(rng: np.random.Generator, now_us: int, pulse_us: int, book: Reference) -> int:
    """A time not before now, mostly within a microsecond of where some limit begins or ends to hold."""
    near = int(rng.integers(-1, 2))
    limb = int(rng.integers(LIMBS))
    mine = book.pulses[limb]
    choice = rng.random()
    if choice < 0.15 or not mine:
        at_us = now_us + int(rng.choice([0, 1, 40_000, 100_000, 600_000, 1_425_000]))
    elif choice < 0.55:
        at_us = mine[-1][1] + REST_US + near
    elif choice < 0.65:
        at_us = mine[-1][1] + near  # a limb goes off
    else:  # an edge of an old pulse leaves the window as the new pulse ends
        start, end = mine[int(rng.integers(max(0, len(mine) - 12), len(mine)))]
        at_us = (start if rng.random() < 0.5 else end) + WINDOW_US - min(pulse_us, PULSE_MAX_US) + near
    return max(now_us, at_us)


def one_sequence(seed: int, guard: Guard, judge: Callable[[str, bool, bool], None]) -> list[Pulse]:
    """Play one random sequence: ``judge`` gets each wish and both answers; returns the pulses."""
    rng = np.random.default_rng(seed)
    reference, book = Reference(), Book()
    now_us = int(rng.choice([0, 1, 499_999, 500_000, 10**6, 2**32 - 700_000, 2**40]))
    gentle = rng.random() < 0.3  # one limb, legal pulses: reaches the duty limit
    for _ in range(WISHES):
        pulse_us = int(rng.choice([PULSE_MAX_US, 80_000] if gentle else PULSES_US))
        mask = 1 if gentle else int(rng.choice(MASKS))
        now_us = next_time_us(rng, now_us, pulse_us, book.reference)
        if rng.random() < 0.05:
            guard.cut(now_us)
            reference.cut(now_us)
            book.reference.cut(now_us)
        allowed = guard.allow(mask, pulse_us, now_us)
        judge(
            f"mask {mask} for {pulse_us} us at {now_us} us", allowed, reference.allow(mask, pulse_us, now_us)
        )
        if allowed:
            book.note(mask, pulse_us, now_us)
    return book.reference.seen()


def test_no_wish_breaks_a_limit_and_every_wish_within_them_is_allowed() -> None:
    allowed_count = refused_count = 0
    for seed in range(cases(20_000, 400_000)):

        def judge(wish: str, allowed: bool, wanted: bool, seed: int = seed) -> None:
            nonlocal allowed_count, refused_count
            assert allowed == wanted, f"{wish}: replay with one_sequence({seed}, Guard(), print)"
            allowed_count += allowed
            refused_count += not allowed

        pulses = one_sequence(seed, Guard(), judge)
        broken = violations(ROBOT, pulses)
        assert not broken, f"{broken[:3]}: replay with one_sequence({seed}, Guard(), print)"
    # Both answers are common, or the sequences would test nothing.
    assert min(allowed_count, refused_count) > 0.2 * (allowed_count + refused_count)


BROKEN = {
    "pulse unlimited": ("pulse_us > FK_PULSE_MAX_US", "0"),
    "pulse doubled": ("pulse_us > FK_PULSE_MAX_US", "pulse_us > 2u * FK_PULSE_MAX_US"),
    "rest unlimited": ("now_us < rested_from_us + FK_REST_MIN_US", "0"),
    "rest halved": ("rested_from_us + FK_REST_MIN_US", "rested_from_us + FK_REST_MIN_US / 2u"),
    "duty unlimited": ("+ pulse_us > FK_DUTY_ON_MAX_US", "+ pulse_us > UINT64_MAX"),
    "duty doubled": ("+ pulse_us > FK_DUTY_ON_MAX_US", "+ pulse_us > 2u * FK_DUTY_ON_MAX_US"),
    "new pulse not counted": ("on_time_us(limb, end_us) + pulse_us", "on_time_us(limb, end_us)"),
    "window halved": ("until_us - FK_DUTY_WINDOW_US", "until_us - FK_DUTY_WINDOW_US / 2u"),
    "limbs unlimited": ("limbs_on > FK_LIMBS_AT_ONCE_MAX", "limbs_on > 99u"),
    "limbs doubled": ("limbs_on > FK_LIMBS_AT_ONCE_MAX", "limbs_on > 2u * FK_LIMBS_AT_ONCE_MAX"),
    "other limbs forgotten": ("limbs_on += (rested_from_us > now_us) ? 1u : 0u", "limbs_on += 0u"),
    "a cut forgets the pulse": ("end_us[i] = now_us;", "end_us[i] = 0u;"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_the_monitor_finds_a_guard_without_its_limit(name: str) -> None:
    broken = library(mutated("fk_guard.c", *BROKEN[name]))
    for seed in range(3000):
        if violations(ROBOT, one_sequence(seed, Guard(broken), lambda *_: None)):
            return
    pytest.fail(f"a guard with {name} went through 3000 sequences unnoticed")


SHIFTED = {
    "pulse": ("pulse_us > FK_PULSE_MAX_US", "pulse_us >= FK_PULSE_MAX_US"),
    "pulse longer": ("pulse_us > FK_PULSE_MAX_US", "pulse_us > FK_PULSE_MAX_US + 1u"),
    "rest": ("now_us < rested_from_us + FK_REST_MIN_US", "now_us <= rested_from_us + FK_REST_MIN_US"),
    "rest shorter": ("now_us < rested_from_us", "now_us + 1u < rested_from_us"),
    "duty": ("+ pulse_us > FK_DUTY_ON_MAX_US", "+ pulse_us >= FK_DUTY_ON_MAX_US"),
    "duty more": ("+ pulse_us > FK_DUTY_ON_MAX_US", "+ pulse_us > FK_DUTY_ON_MAX_US + 1u"),
    "window": ("until_us - FK_DUTY_WINDOW_US", "until_us - FK_DUTY_WINDOW_US + 1u"),
    "window at the start": ("on_time_us(limb, end_us)", "on_time_us(limb, now_us)"),
    "limbs": ("limbs_on > FK_LIMBS_AT_ONCE_MAX", "limbs_on >= FK_LIMBS_AT_ONCE_MAX"),
    "a limb that just went off": ("(rested_from_us > now_us)", "(rested_from_us >= now_us)"),
}


@pytest.mark.parametrize("name", SHIFTED)
def test_the_reference_sees_a_limit_that_is_one_microsecond_off(name: str) -> None:
    shifted = library(mutated("fk_guard.c", *SHIFTED[name]))
    different = []
    for seed in range(3000):
        one_sequence(seed, Guard(shifted), lambda wish, a, b: different.append(wish) if a != b else None)
        if different:
            return
    pytest.fail(f"a guard whose limit of {name} is off by one went through 3000 sequences unnoticed")


def test_limits_to_the_microsecond() -> None:
    guard = Guard()
    assert not guard.allow(1, 80_000, REST_US - 1), "a limb may have been hot before the reset"
    assert not guard.allow(0, 80_000, REST_US)
    assert not guard.allow(1, 0, REST_US)
    assert not guard.allow(1, PULSE_MAX_US + 1, REST_US)
    assert not guard.allow(7, 80_000, REST_US), "three limbs at once"
    assert guard.allow(1, PULSE_MAX_US, REST_US)
    end_us = REST_US + PULSE_MAX_US
    assert not guard.allow(6, 80_000, end_us - 1), "limb 0 is still on"
    assert guard.allow(6, 80_000, end_us)
    assert not guard.allow(1, 80_000, end_us + REST_US - 1)
    assert guard.allow(1, 80_000, end_us + REST_US)


def test_a_refused_wish_leaves_no_trace() -> None:
    guard = Guard()
    assert not guard.allow(0b111, 80_000, REST_US)
    assert not guard.allow(0b001, PULSE_MAX_US + 1, REST_US)
    assert guard.allow(0b011, 80_000, REST_US)
    # Limb 0 must rest, so limb 2 is not heated either and may be at once.
    assert not guard.allow(0b101, 80_000, REST_US + 90_000)
    assert guard.allow(0b100, 80_000, REST_US + 90_000)


def test_all_off_in_the_middle_of_a_pulse() -> None:
    guard = Guard()
    assert guard.allow(0b0011, 100_000, 1_000_000)
    guard.cut(1_040_000)
    assert guard.allow(0b1100, 100_000, 1_040_000), "the first two are off"
    assert not guard.allow(0b0011, 100_000, 1_040_000 + REST_US - 1)
    assert guard.allow(0b0011, 100_000, 1_040_000 + REST_US)
    guard.cut(1_040_000 + REST_US)
    assert not guard.allow(0b0011, 100_000, 1_040_000 + 2 * REST_US - 1)
    # 40 ms of the first pulse and nothing of the second count: 360 ms are left of the 400 ms within 5 s.
    at_us = 2_100_000
    for pulse_us in (100_000, 100_000, 100_000, 60_000):
        assert guard.allow(1, pulse_us, at_us)
        at_us += pulse_us + REST_US
    assert not guard.allow(1, 1, at_us)


def test_a_cut_when_nothing_is_on_changes_nothing() -> None:
    guard = Guard()
    assert guard.allow(1, 80_000, 1_000_000)
    guard.cut(1_080_000)
    guard.cut(3_000_000)
    assert not guard.allow(1, 80_000, 1_579_999)
    assert guard.allow(1, 80_000, 3_000_000)
