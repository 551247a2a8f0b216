"""What stands in the store's journal: scenes with an owner's key and without, and every wrong bit in them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.conftest import count
from tests.core.core import COVERAGE_DIR, FFI, Robot, kept_of
from tests.core.store_rig import (
    JOURNAL,
    NEW,
    OLD,
    PAGE,
    PLACES,
    STEP,
    Flash,
)  # fmt: skip
from tests.planner import synthetic

from frogkick.link.layout import link_layout

KEY_A, KEY_B, KEY_C = (bytes(range(first, first + 32)) for first in (1, 33, 65))
NONE = bytes(32)
SMALL = synthetic.affine_image(2, 2, 1)
"""A table that is soon checked at each boot."""


def done(*statuses: str) -> None:
    assert set(statuses) == {"OK"}


def never_owned(flash: Flash) -> None:
    """As it was flashed."""


def never_owned_with_a_table(flash: Flash) -> None:
    done(flash.upload(OLD))


def first_key(flash: Flash) -> None:
    done(flash.own(KEY_B))


def replaced_key(flash: Flash) -> None:
    done(flash.own(KEY_A), flash.own(KEY_B))


def given_up(flash: Flash) -> None:
    done(flash.own(KEY_A), flash.own(NONE))


def table_behind_the_key(flash: Flash) -> None:
    done(flash.own(KEY_A), flash.own(KEY_B), flash.upload(OLD), flash.upload(NEW))


def rollback_behind_the_key(flash: Flash) -> None:
    done(flash.upload(OLD), flash.upload(NEW), flash.own(KEY_B), flash.rollback(OLD))


def half_an_update_behind_the_key(flash: Flash) -> None:
    done(flash.own(KEY_A), flash.own(KEY_B), flash.upload(NEW, PAGE + 256))


def last_of_its_page(flash: Flash) -> None:
    done(flash.own(KEY_A))
    flash.fill_journal(1)
    done(flash.own(KEY_B))
    assert flash.store.place == PLACES


def first_of_its_page(flash: Flash) -> None:
    done(flash.own(KEY_A))
    flash.fill_journal(0)
    done(flash.own(KEY_B))
    assert (flash.store.page, flash.store.place) == (1, 1)


def first_of_a_page_of_old_steps(flash: Flash) -> None:
    done(flash.own(KEY_A))
    flash.fill_journal(0)
    done(flash.upload(NEW))
    flash.fill_journal(0)
    done(flash.own(KEY_B))
    assert (flash.store.page, flash.store.place) == (0, 1)


Scene = Callable[[Flash], None]
OWNED: dict[str, Scene] = {
    "first key": first_key,
    "key replaced": replaced_key,
    "key, then a table": table_behind_the_key,
    "key, then a rollback": rollback_behind_the_key,
    "key, then half an update": half_an_update_behind_the_key,
    "key is the last of its page": last_of_its_page,
    "key is the first of its page": first_of_its_page,
    "key is the first of a page that held others": first_of_a_page_of_old_steps,
}
SCENES: dict[str, Scene] = OWNED | {
    "never owned": never_owned,
    "never owned, with a table": never_owned_with_a_table,
    "key given up": given_up,
}


def standing(scene: Scene, lib: Any = None, built_in: bytes = b"") -> Flash:
    flash = Flash(lib, built_in=built_in)
    scene(flash)
    assert flash.boot() == 0 and flash.boot_operations == 0
    return flash


def newest_at(flash: Flash) -> int:
    """Where the newest step begins."""
    return int(flash.store.newest_page) * PAGE + (int(flash.store.place) - 1) * STEP


def flip(flash: Flash, bit: int) -> None:
    flash.memory[bit // 8] = bytes([flash.memory[bit // 8][0] ^ 1 << bit % 8])


def every_bit(flash: Flash, begin: int, end: int) -> Any:
    found = FFI.new("fk_flips_t *")
    before = FFI.new("uint8_t[]", len(flash.memory))
    every = count(1, 1, 32)
    flash.lib.fk_test_store_every_bit(flash.sim, flash.store, before, begin, end, every, found)
    return found


def no_bit_matters(name: str, lib: Any = None) -> None:
    """Every bit of both journal pages, wrong by itself: the same owner, key and table at each boot.

    Where nothing was ever written make test takes one bit of each word.
    """
    flash = standing(SCENES[name], lib, SMALL)
    newest, was = newest_at(flash), bytes(flash.memory)
    begin, end = (newest, newest + STEP) if COVERAGE_DIR and flash.store.sequence else (0, JOURNAL)
    found = every_bit(flash, begin, end)
    print(f"{name}: {found.boots} bits, {found.repaired} repaired")
    assert found.boots == 8 * (end - begin) or (count(1, 1, 32) > 1 and found.boots >= (end - begin) // 4)
    assert (found.other, found.lost, found.unsettled) == (0, 0, 0), f"{name}, bit {found.worst}"
    assert found.opened == (0 if name in OWNED else found.boots)
    assert bytes(flash.memory) == was
    if flash.store.sequence:
        found = every_bit(flash, newest, newest + STEP)
        assert found.repaired == found.boots == 8 * STEP, "a wrong bit in the newest step was left there"


def boot_robot(flash: Flash) -> Robot:
    """As a port starts it, and at rest."""
    robot = Robot(flash.image, 0)
    robot.use_store(flash)
    robot.core.fk_robot_note_reset(robot.memory, link_layout().reset["POWER"], kept_of())
    robot.tick(0)
    robot.tick(600_000)
    return robot
