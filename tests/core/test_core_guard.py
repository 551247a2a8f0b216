"""The guard: requests dense at its limits, judged by a slow reference and by the independent monitor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from tests.conftest import some
from tests.core.core import FFI, LATE_US, cases, core, kept_of, library, mutated, pick

from frogkick.pool.monitor import Pulse, violations
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
LIMBS = len(ROBOT.limbs)
PULSE_MAX_US = round(ROBOT.guard.pulse_max_s * 1e6)
REST_US = round(ROBOT.guard.rest_min_s * 1e6)
WINDOW_US = round(ROBOT.guard.duty_window_s * 1e6)
ON_MAX_US = round(ROBOT.guard.duty_max * ROBOT.guard.duty_window_s * 1e6)
AT_ONCE = ROBOT.guard.limbs_at_once_max
FRESH_US = round(ROBOT.guard.fix_fresh_s * 1e6)
LOST_US = round(ROBOT.guard.fix_lost_s * 1e6)
WISHES = 24


class Guard:
    """One guard in C, of limbs that are known to be cold, or of what is kept."""

    def __init__(self, made: Any = None, kept: Any = None) -> None:
        self._core = core() if made is None else made
        self._memory = FFI.new("fk_guard_t *")
        self.bytes = FFI.buffer(self._memory)
        self._core.fk_guard_init(self._memory)
        self.known = bool(self._core.fk_guard_resume(self._memory, kept_of() if kept is None else kept))

    def allow(self, mask: int, pulse_us: int, now_us: int) -> bool:
        return self.answer(mask, pulse_us, now_us) > 0

    def answer(self, mask: int, pulse_us: int, now_us: int) -> int:
        return int(self._core.fk_guard_allow(self._memory, mask, pulse_us, now_us))

    def not_begun(self, mask: int) -> None:
        self._core.fk_guard_not_begun(self._memory, mask)

    def keep(self) -> Any:
        kept = FFI.new("fk_guard_persistent_t *")
        self._core.fk_guard_keep(self._memory, kept)
        return kept

    def cut(self, now_us: int) -> None:
        self._core.fk_guard_cut(self._memory, now_us)

    def closed_loop(self, closed: bool) -> None:
        self._core.fk_guard_closed_loop(self._memory, closed)

    def note_fix(self, capture_us: int) -> None:
        self._core.fk_guard_note_fix(self._memory, capture_us)

    def is_sound(self) -> bool:
        return bool(self._core.fk_guard_is_sound(self._memory))


@dataclass
class Heat:
    """One pulse in the history: from, to, and when its pin is low for certain."""

    start: int
    end: int
    off: int
    cut: bool = False


@dataclass
class Reference:
    """The limits word by word over every pulse ever, in whole microseconds; a port may be LATE_US late."""

    pulses: list[list[Heat]] = field(default_factory=lambda: [[] for _ in range(8)])
    closed: bool = False
    fix_us: int = 0

    def allow(self, mask: int, pulse_us: int, now_us: int) -> bool:
        if not mask or not 0 < pulse_us <= PULSE_MAX_US:
            return False
        if self.closed and (not self.fix_us or now_us + LATE_US - self.fix_us > FRESH_US):
            return False  # 0: there was no fix
        end_us = now_us + pulse_us
        on = 0
        for limb, mine in enumerate(self.pulses):
            if mask >> limb & 1:
                on += 1
                # A limb may have been on until the reset: it rests first.
                if now_us - max((heat.off for heat in mine), default=0) < REST_US:
                    return False
                # Every window over the old pulses and this one: the fullest ends at some pulse's end.
                every = [*((heat.start, heat.end) for heat in mine), (now_us, end_us)]
                for _, until in every:
                    held = sum(max(0, min(e, until) - max(s, until - WINDOW_US - LATE_US)) for s, e in every)
                    if held > ON_MAX_US:
                        return False
            else:
                on += any(heat.start <= now_us < heat.off and not heat.cut for heat in mine)
        if on > AT_ONCE:
            return False
        self.note(mask, pulse_us, now_us)
        return True

    def note(self, mask: int, pulse_us: int, now_us: int) -> None:
        for limb in range(8):
            if mask >> limb & 1:
                end_us = now_us + pulse_us
                self.pulses[limb].append(Heat(now_us, end_us, end_us + LATE_US))

    def cut(self, now_us: int) -> None:
        off_us = now_us + LATE_US
        for mine in self.pulses:
            for heat in mine:
                if heat.off > off_us:
                    heat.end, heat.off, heat.cut = min(heat.end, off_us), off_us, True


class Book:
    """What a guard allowed, without judging; and the pins of a port that is late by what it may be."""

    def __init__(self, seed: int) -> None:
        self.reference = Reference()
        self._late = np.random.default_rng([seed, 1])
        self._pins_us = 0  # a port does one thing after the other
        self._on: list[list[int]] = []

    def _pin_us(self, now_us: int) -> int:
        self._pins_us = max(self._pins_us, now_us + int(self._late.integers(0, LATE_US + 1)))
        return self._pins_us

    def note(self, mask: int, pulse_us: int, now_us: int) -> None:
        self.reference.note(mask, pulse_us, now_us)
        pin_us = self._pin_us(now_us)
        self._on += [[limb, pin_us, pin_us + pulse_us] for limb in range(8) if mask >> limb & 1]

    def cut(self, now_us: int) -> None:
        self.reference.cut(now_us)
        pin_us = self._pin_us(now_us)
        for pulse in self._on:
            pulse[2] = min(pulse[2], pin_us)

    def seen(self) -> list[Pulse]:
        """As the monitor sees pins."""
        return [Pulse(limb, s * 1e-6, e * 1e-6) for limb, s, e in self._on if e > s]


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
        at_us = now_us + pick(rng, [0, 1, 40_000, 100_000, 600_000, 1_425_000])
    elif choice < 0.55:
        at_us = mine[-1].off + REST_US + near
    elif choice < 0.65:
        at_us = mine[-1].off + near  # a limb goes off
    else:  # an edge of an old pulse leaves the window as the new pulse ends
        heat = mine[int(rng.integers(max(0, len(mine) - 12), len(mine)))]
        edge = heat.start if rng.random() < 0.5 else heat.end
        at_us = edge + WINDOW_US + LATE_US - min(pulse_us, PULSE_MAX_US) + near
    return max(now_us, at_us)


def one_sequence(seed: int, guard: Guard, judge: Callable[[str, bool, bool], None]) -> list[Pulse]:
    """Play one random sequence: ``judge`` gets each wish and both answers; returns the pulses."""
    rng = np.random.default_rng(seed)
    reference, book = Reference(), Book(seed)
    now_us = pick(rng, [0, 1, 499_999, 500_000, 10**6, 2**32 - 700_000, 2**40])
    gentle = rng.random() < 0.3  # one limb, legal pulses: reaches the duty limit
    for _ in range(WISHES):
        pulse_us = pick(rng, [PULSE_MAX_US, 80_000] if gentle else PULSES_US)
        mask = 1 if gentle else pick(rng, MASKS)
        now_us = next_time_us(rng, now_us, pulse_us, book.reference)
        if rng.random() < 0.05:
            guard.cut(now_us)
            reference.cut(now_us)
            book.cut(now_us)
        if rng.random() < 0.1:
            closed, fix_us = bool(rng.random() < 0.5), max(0, now_us - int(rng.integers(0, 2 * FRESH_US)))
            if rng.random() < 0.5:  # the wish comes within a microsecond of where the fix is too old
                fix_us = max(0, now_us + LATE_US - FRESH_US + int(rng.integers(-1, 2)))
            guard.closed_loop(closed)
            guard.note_fix(fix_us)
            reference.closed, reference.fix_us = closed, max(reference.fix_us, fix_us)
        allowed = guard.allow(mask, pulse_us, now_us)
        judge(
            f"mask {mask} for {pulse_us} us at {now_us} us", allowed, reference.allow(mask, pulse_us, now_us)
        )
        if allowed:
            book.note(mask, pulse_us, now_us)
    return book.seen()


def test_no_wish_breaks_a_limit_and_every_wish_within_them_is_allowed() -> None:
    allowed_count = refused_count = 0
    for seed in range(cases(6000, 400_000, 1000)):  # each planted fault is found within 3000
        guard = Guard()

        def judge(wish: str, allowed: bool, wanted: bool, seed: int = seed, guard: Guard = guard) -> None:
            nonlocal allowed_count, refused_count
            assert allowed == wanted, f"{wish}: replay with one_sequence({seed}, Guard(), print)"
            allowed_count += allowed
            refused_count += not allowed
            assert guard.is_sound(), wish

        pulses = one_sequence(seed, guard, judge)
        broken = violations(ROBOT, pulses)
        assert not broken, f"{broken[:3]}: replay with one_sequence({seed}, Guard(), print)"
    # Both answers are common, or the sequences would test nothing.
    assert min(allowed_count, refused_count) > 0.2 * (allowed_count + refused_count)


BROKEN = {
    "pulse unlimited": ("pulse_us > FK_PULSE_MAX_US", "0"),
    "pulse doubled": ("pulse_us > FK_PULSE_MAX_US", "pulse_us > 2u * FK_PULSE_MAX_US"),
    "rest unlimited": ("now_us < limb->off_us + FK_REST_MIN_US", "0"),
    "rest halved": ("limb->off_us + FK_REST_MIN_US", "limb->off_us + FK_REST_MIN_US / 2u"),
    "duty unlimited": ("+ pulse_us > FK_DUTY_ON_MAX_US", "+ pulse_us > UINT64_MAX"),
    "duty doubled": ("+ pulse_us > FK_DUTY_ON_MAX_US", "+ pulse_us > 2u * FK_DUTY_ON_MAX_US"),
    "new pulse not counted": ("on_time_us(limb, end_us) + pulse_us", "on_time_us(limb, end_us)"),
    "window halved": ("window_us = FK_DUTY_WINDOW_US", "window_us = FK_DUTY_WINDOW_US / 2u"),
    "limbs unlimited": ("limbs_on > FK_LIMBS_AT_ONCE_MAX", "limbs_on > 99u"),
    "limbs doubled": ("limbs_on > FK_LIMBS_AT_ONCE_MAX", "limbs_on > 2u * FK_LIMBS_AT_ONCE_MAX"),
    "other limbs forgotten": (
        "limbs_on += (limb->off_us > now_us && limb->was_cut == 0u) ? 1u : 0u", "limbs_on += 0u"
    ),
    "a cut forgets the pulse": ("            limb->off_us = off_us;", "            limb->off_us = 0u;"),
    "a late port's rest": ("limb->off_us = end_us + FK_PORT_LATE_US;", "limb->off_us = end_us;"),
    "a late port's cut": ("off_us = now_us + FK_PORT_LATE_US", "off_us = now_us"),
}  # fmt: skip


@pytest.mark.parametrize("name", some(BROKEN, 5))
def test_the_monitor_finds_a_guard_without_its_limit(name: str) -> None:
    broken = library(mutated("fk_guard.c", *BROKEN[name]))
    for seed in range(3000):
        if violations(ROBOT, one_sequence(seed, Guard(broken), lambda *_: None)):
            return
    pytest.fail(f"a guard with {name} went through 3000 sequences unnoticed")


SHIFTED = {
    "pulse": ("pulse_us > FK_PULSE_MAX_US", "pulse_us >= FK_PULSE_MAX_US"),
    "pulse longer": ("pulse_us > FK_PULSE_MAX_US", "pulse_us > FK_PULSE_MAX_US + 1u"),
    "rest": ("now_us < limb->off_us + FK_REST_MIN_US", "now_us <= limb->off_us + FK_REST_MIN_US"),
    "rest shorter": ("now_us < limb->off_us +", "now_us + 1u < limb->off_us +"),
    "duty": ("+ pulse_us > FK_DUTY_ON_MAX_US", "+ pulse_us >= FK_DUTY_ON_MAX_US"),
    "duty more": ("+ pulse_us > FK_DUTY_ON_MAX_US", "+ pulse_us > FK_DUTY_ON_MAX_US + 1u"),
    "window": ("window_us = FK_DUTY_WINDOW_US", "window_us = FK_DUTY_WINDOW_US - 1u"),
    "window at the start": ("on_time_us(limb, end_us)", "on_time_us(limb, now_us)"),
    "a late port's window": ("FK_DUTY_WINDOW_US + FK_PORT_LATE_US;", "FK_DUTY_WINDOW_US;"),
    "limbs": ("limbs_on > FK_LIMBS_AT_ONCE_MAX", "limbs_on >= FK_LIMBS_AT_ONCE_MAX"),
    "a limb that just went off": ("limb->off_us > now_us &&", "limb->off_us >= now_us &&"),
    "a limb that was cut": ("limb->was_cut = 1u;", "limb->was_cut = 0u;"),
    "a fix that is no longer fresh": (
        "> guard->fix_us + FK_FIX_FRESH_US",
        ">= guard->fix_us + FK_FIX_FRESH_US",
    ),
    "a fix that is fresh for longer": ("> guard->fix_us + FK_FIX_FRESH_US", "> guard->fix_us + 500001u"),
    "a fix from before": (" && capture_us > guard->fix_us)", ")"),
}


@pytest.mark.parametrize("name", some(SHIFTED, 5))
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
    off_us = REST_US + PULSE_MAX_US + LATE_US
    assert not guard.allow(6, 80_000, off_us - 1), "limb 0 may still be on"
    assert guard.allow(6, 80_000, off_us)
    assert not guard.allow(1, 80_000, off_us + REST_US - 1)
    assert guard.allow(1, 80_000, off_us + REST_US)


def test_a_closed_loop_needs_a_fresh_fix() -> None:
    guard = Guard()
    guard.closed_loop(True)
    assert not guard.allow(1, 80_000, 10**6), "no fix ever"
    guard.note_fix(10**6)
    assert not guard.allow(1, 80_000, 10**6 + FRESH_US - LATE_US + 1)
    guard.note_fix(10**6 - 1)  # one that comes late is not the newest
    assert guard.allow(1, 80_000, 10**6 + FRESH_US - LATE_US)
    guard.closed_loop(False)
    assert guard.allow(2, 80_000, 10**7)


def test_a_closed_loop_without_any_fix_fires_nothing_soon_after_the_start_either() -> None:
    """The clock starts at 0, when no fix was captured; limbs rest for less time than a fix is fresh."""
    files = mutated("fk_robot_config.h", "FK_REST_MIN_US 500000u", "FK_REST_MIN_US 100000u")
    limits = files["fk_robot_config.h"].decode()
    assert limits.count("FK_DUTY_WINDOW_US 5000000u") == 1
    files["fk_robot_config.h"] = limits.replace("_WINDOW_US 5000000u", "_WINDOW_US 600000u").encode()
    guard = Guard(library(files))
    guard.closed_loop(True)
    assert not guard.allow(1, 80_000, 100_000)
    guard.closed_loop(False)
    assert guard.allow(1, 80_000, 100_000)


def test_when_a_fix_is_lost() -> None:
    made = core()
    memory = FFI.new("fk_guard_t *")
    made.fk_guard_init(memory)
    assert made.fk_guard_lost_us(memory) == 0, "no fix is one that is lost"
    made.fk_guard_note_fix(memory, 3_000_000)
    assert made.fk_guard_lost_us(memory) == 3_000_000 + LOST_US + 1


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
    off_us = 1_040_000 + LATE_US
    assert not guard.allow(0b0011, 100_000, off_us + REST_US - 1)
    assert guard.allow(0b0011, 100_000, off_us + REST_US)
    guard.cut(off_us + REST_US)
    assert not guard.allow(0b0011, 100_000, off_us + LATE_US + 2 * REST_US - 1)
    # 40 ms of the first pulse and what a late port adds to both count: less than 360 ms are left of 400.
    at_us = 2_100_000
    for pulse_us in (100_000, 100_000, 100_000, 60_000 - 2 * LATE_US):
        assert guard.allow(1, pulse_us, at_us)
        at_us += pulse_us + REST_US + LATE_US
    assert not guard.allow(1, 1, at_us)


def test_a_cut_when_nothing_is_on_changes_nothing() -> None:
    guard = Guard()
    assert guard.allow(1, 80_000, 1_000_000)
    guard.cut(1_080_000)
    guard.cut(3_000_000)
    assert not guard.allow(1, 80_000, 1_580_000 + LATE_US - 1)
    assert guard.allow(1, 80_000, 3_000_000)


def test_a_cut_between_a_pulse_and_the_end_of_a_late_one_ends_it_in_the_history() -> None:
    """Its pin may have been on until then; and a cut long after it is none."""
    guard = Guard()
    assert guard.allow(0b0011, 100_000, 1_000_000)
    guard.cut(1_100_000 - LATE_US // 2)
    assert guard.allow(0b1100, 100_000, 1_100_000)
    assert not guard.allow(0b0011, 100_000, 1_100_000 + LATE_US // 2 + REST_US - 1)
    assert guard.allow(0b0011, 100_000, 1_100_000 + LATE_US // 2 + REST_US)


def test_what_is_kept_over_a_reset_counts_as_if_it_had_just_happened() -> None:
    before = Guard()
    for number in range(5):
        assert before.allow(0b01, 80_000, 10**7 + 600_000 * number)
    assert before.allow(0b10, 80_000, 2 * 10**7)
    kept = before.keep()
    assert list(kept.on_us) == [400_000, 80_000, 0, 0, 0, 0, 0, 0]
    assert bytes(FFI.buffer(kept)) == bytes(FFI.buffer(kept_of([400_000, 80_000])))
    after = Guard(kept=kept)
    assert after.allow(0b10, 80_000, REST_US), "its 80 ms and these are far below the limit"
    for at_us in range(REST_US, WINDOW_US, 100_000):
        assert not after.allow(0b01, 80_000, at_us)
    # The first 20 ms of its 100 in all have left the window, four times over.
    assert not Guard(kept=kept).allow(0b01, 80_000, WINDOW_US + LATE_US - 80_000 + 19_999)
    assert Guard(kept=kept).allow(0b01, 80_000, WINDOW_US + LATE_US - 80_000 + 20_000)


def test_more_than_the_books_hold_fills_them() -> None:
    after = Guard(kept=kept_of([0xFFFFFFFF]))
    assert not after.allow(0b01, 80_000, WINDOW_US - 80_000)
    assert after.allow(0b10, 80_000, WINDOW_US)
