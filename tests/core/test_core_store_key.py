"""The owner's key in flash: no wrong bit, cut or lost page opens a robot, or brings an older key back."""

from __future__ import annotations

import random
import struct
import zlib
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from tests.conftest import count, some
from tests.core.core import COVERAGE_DIR, FFI, STATE, Robot, cases, kept_of, library, mutated
from tests.core.log_rig import Log
from tests.core.store_rig import (
    HOWS,
    JOURNAL,
    LATER,
    NEW,
    OLD,
    PAGE,
    PLACES,
    RECORD,
    STEP,
    Flash,
    table,
)  # fmt: skip
from tests.planner import synthetic

from frogkick.link.auth import words
from frogkick.link.layout import Value, link_layout

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


@pytest.mark.parametrize("name", SCENES)
def test_no_single_bit_of_the_journal_changes_owner_key_or_table(name: str) -> None:
    no_bit_matters(name)


def test_a_wrong_bit_after_a_wrong_bit() -> None:
    """Each is repaired at the next boot, so they do not add up; TABLE_STATUS tells how many there were."""
    dice = random.Random(3)
    flash = standing(replaced_key)
    flips = cases(2000, 20_000)
    for turn in range(flips):
        flip(flash, 8 * newest_at(flash) + dice.randrange(8 * STEP))
        assert flash.boot() == 0 and flash.key == KEY_B and flash.boot_operations, turn
    assert flash.store.record.repairs == flips
    robot = boot_robot(flash)
    assert robot.ask("TABLE_STATUS")["repairs"] == flips and robot.ask("STATUS")["fault"] == 0


def boot_robot(flash: Flash) -> Robot:
    """As a port starts it, and at rest."""
    robot = Robot(flash.image, 0)
    robot.use_store(flash)
    robot.core.fk_robot_note_reset(robot.memory, link_layout().reset["POWER"], kept_of())
    robot.tick(0)
    robot.tick(600_000)
    return robot


def assert_locked(flash: Flash) -> None:
    """It has an owner, whom nobody can prove to be; it is in FAULT, says why, and stays so at each boot."""
    fault = link_layout().fault
    for _ in range(2):
        assert flash.boot() == 0 and flash.boot_operations == 0
        assert flash.store.lost and flash.lib.fk_store_is_owned(flash.store)
        robot = boot_robot(flash)
        log = Log()
        log.memory.magic = 0
        robot.core.fk_robot_use_log(robot.memory, log.memory)
        answer = robot.ask("STATUS")
        assert (answer["owner"], answer["fault"]) == (link_layout().owner["KEY"], fault["STORE"])
        assert answer["state"] == STATE["FAULT"]
        assert [record.values["fault"] for record in log.records() if record.name == "FAULT"] == [
            fault["STORE"]
        ]
        assert robot.status("HELLO") == "OK"
        assert robot.status("CHALLENGE", words("nonce", bytes(16))) == "FAULT"
        for command in ("ARM", "TABLE_COMMIT"):
            assert robot.status(command) in ("FAULT", "AUTH")
        length: dict[str, Value] = {"length": len(NEW)}
        assert robot.status("TABLE_BEGIN", length | {f"hash_{i}": i for i in range(8)}) in ("FAULT", "AUTH")
        assert robot.status("KEY", words("key", KEY_C)) in ("FAULT", "AUTH")
    # Nor by the store's own functions, whoever calls them.
    was = bytes(flash.memory)
    assert flash.own(KEY_C) == flash.own(NONE) == flash.upload(LATER) == "FLASH"
    assert flash.rollback(flash.built_in) in ("OK", "FLASH")
    assert flash.sim.operations == 0 and bytes(flash.memory) == was


@pytest.mark.parametrize("name", SCENES)
def test_both_copies_damaged_lock_the_robot(name: str) -> None:
    """Any word of the one and any word of the other."""
    flash = standing(SCENES[name])
    if flash.store.sequence == 0:
        return
    at, was, dice = newest_at(flash), bytes(flash.memory), random.Random(5)
    for one in range(RECORD // 4):
        for other in range(RECORD // 4):
            bits = [
                8 * (at + 4 * one) + dice.randrange(32),
                8 * (at + RECORD + 4 * other) + dice.randrange(32),
            ]
            for bit in bits:
                flip(flash, bit)
            assert flash.boot() == 0 and flash.boot_operations == 0
            assert flash.store.lost and flash.lib.fk_store_is_owned(flash.store), (one, other)
            if (one, other) != (26, 26):
                for bit in bits:
                    flip(flash, bit)
    assert_locked(flash)
    flash.restore(was)
    assert not flash.store.lost


@pytest.mark.parametrize("damage", ["erased", "noise", "zeros"])
@pytest.mark.parametrize("name", OWNED)
def test_a_page_that_is_gone(name: str, damage: str) -> None:
    """The one with the newest step: locked. The other one: nothing is lost. Both: the way back."""
    flash = standing(OWNED[name])
    newest, was = int(flash.store.newest_page), bytes(flash.memory)
    state, image = flash.state, flash.image
    gone = {"erased": b"\xff" * PAGE, "noise": random.Random(7).randbytes(PAGE), "zeros": bytes(PAGE)}[damage]
    other = 1 - newest
    flash.memory[other * PAGE : (other + 1) * PAGE] = gone
    assert flash.boot() == 0 and flash.state == state and flash.image == image
    flash.restore(was)
    flash.memory[newest * PAGE : (newest + 1) * PAGE] = gone
    assert flash.boot() == 0
    assert_locked(flash)
    flash.memory[:] = b"\xff" * len(flash.memory)
    assert flash.boot() == 0 and not flash.store.lost and flash.key == NONE
    assert boot_robot(flash).ask("STATUS")["owner"] == link_layout().owner["OPEN"]
    done(flash.own(KEY_C))
    assert flash.boot() == 0 and flash.key == KEY_C


CHANGES: dict[str, tuple[Scene, bytes]] = {
    "first key": (never_owned, KEY_B),
    "first key behind a table": (never_owned_with_a_table, KEY_B),
    "another key": (replaced_key, KEY_C),
    "another key behind a table": (table_behind_the_key, KEY_C),
    "given up": (replaced_key, NONE),
    "a page's last step": (lambda flash: [first_key(flash), flash.fill_journal(1)][0], KEY_C),
    "a page's first step": (lambda flash: [first_key(flash), flash.fill_journal(0)][0], KEY_C),
    "the first step of a page that held others": (
        lambda flash: [first_of_a_page_of_old_steps(flash), flash.fill_journal(0)][0],
        KEY_C,
    ),
}


def cuts_of_a_key(name: str, lib: Any = None) -> Counter[str]:
    """Cut the writing of a key at each word and erase, then the boot that settles it, in each way."""
    prepare, new = CHANGES[name]
    flash = standing(prepare, lib)
    was, old, dice = bytes(flash.memory), flash.key, random.Random(11)
    done(flash.own(new))
    operations, seen = int(flash.sim.operations), Counter[str]()
    assert 55 <= operations <= 57
    for at in range(1, operations + 1):
        for how in range(len(HOWS)):
            for again in (None, *(dice.randrange(1, 60) for _ in range(cases(2, 20, 2)))):
                what = f"cut in operation {at} ({HOWS[how]}), then in {again} of the boot"
                flash.restore(was)
                flash.cut(at, how, seed=dice.randrange(1000))
                flash.own(new)
                assert flash.sim.dead, what
                if again is not None:
                    flash.boot((again, dice.randrange(len(HOWS))))
                    seen["cut twice"] += flash.sim.dead
                assert flash.boot() == 0, what
                found = flash.state
                assert not flash.store.lost and flash.key in (old, new), what
                seen["new" if flash.key == new else "old"] += 1
                seen["settled"] += flash.boot_operations > 0
                for _ in range(3):
                    assert flash.boot() == 0 and flash.state == found and flash.boot_operations == 0, what
                if flash.key == old:
                    done(flash.own(new))
                    assert flash.boot() == 0 and flash.key == new and flash.boot_operations == 0, what
                assert flash.sim.refused == 0, what
    return seen


@pytest.mark.parametrize("name", CHANGES)
def test_power_cut_at_every_operation_of_a_key(name: str) -> None:
    seen = cuts_of_a_key(name)
    print(f"{name}: {dict(seen)}")
    assert min(seen[what] for what in ("cut twice", "new", "old", "settled")) > 50


def hovering(name: str, lib: Any = None) -> None:
    """The last word of a first copy that reads as whole at one boot and not at the next decides once."""
    prepare, new = CHANGES[name]
    flash = standing(prepare, lib)
    was, old = bytes(flash.memory), flash.key
    done(flash.own(new))
    at, read_as_whole = newest_at(flash), bytearray(flash.memory)
    read_as_whole[at + RECORD : at + STEP] = b"\xff" * (STEP - RECORD)
    for mark in (PAGE - 4, 2 * PAGE - 4):  # of a page that is left, which comes later
        if flash.memory[mark : mark + 4] != was[mark : mark + 4] and mark // PAGE != at // PAGE:
            read_as_whole[mark : mark + 4] = was[mark : mark + 4]
    read_as_torn = bytearray(read_as_whole)
    read_as_torn[at + RECORD - 4 : at + RECORD] = b"\xff" * 4
    readings = {old: read_as_torn, new: read_as_whole}
    for first in (old, new):
        flash.restore(bytes(readings[first]))
        for turn in range(4):
            assert flash.key == first and not flash.store.lost, f"{name}: flickers"
            if flash.memory[at : at + RECORD - 4] == read_as_whole[at : at + RECORD - 4]:
                word = readings[old if turn % 2 == (first == old) else new][at + RECORD - 4 : at + RECORD]
                flash.memory[at + RECORD - 4 : at + RECORD] = word
            assert flash.boot() == 0


@pytest.mark.parametrize("name", CHANGES)
def test_a_word_between_two_keys_decides_once(name: str) -> None:
    hovering(name)


def test_keys_tables_cuts_and_wrong_bits_at_random() -> None:
    """What a boot has read each later one reads, though marginal bits read otherwise and one bit is wrong."""
    dice = random.Random(13)
    flash, seen = Flash(), Counter[str]()
    done(flash.own(KEY_A))
    key, image = KEY_A, flash.image
    tables = [table(seed) for seed in range(2, 6)]
    for turn in range(cases(2000, 40_000)):
        wanted_key, wanted = key, image
        if dice.random() < 0.7:
            flash.cut(dice.randrange(1, dice.choice((60, 60, 400, 3000))), dice.randrange(4), seed=turn)
        act = dice.random()
        if act < 0.5:
            wanted_key = dice.randbytes(32)
            told = flash.own(wanted_key)
        elif act < 0.75:
            wanted = dice.choice(tables)
            told = flash.upload(wanted)
        else:
            wanted = dice.choice([*tables, flash.built_in])
            told = flash.rollback(wanted)
        cut_short = bool(flash.sim.dead)
        seen["cut" if cut_short else told] += 1
        if cut_short and dice.random() < 0.3:
            flash.boot((dice.randrange(1, 60), dice.randrange(4)))
            seen["cut at boot"] += flash.sim.dead
        assert flash.boot() == 0 and not flash.store.lost, turn
        assert flash.key in (key, wanted_key) and flash.image in (image, wanted), turn
        assert cut_short or told != "OK" or (flash.key, flash.image) == (wanted_key, wanted), turn
        key, image, state = flash.key, flash.image, flash.state
        for _ in range(2):
            if dice.random() < 0.3:
                flip(
                    flash,
                    dice.choice(
                        (8 * newest_at(flash) + dice.randrange(8 * STEP), dice.randrange(8 * JOURNAL))
                    ),
                )
            assert flash.boot() == 0 and flash.state == state and flash.image == image, turn
            seen["repaired"] += flash.boot_operations > 0
        assert flash.sim.refused == 0, turn
    print(dict(seen))
    assert min(seen[what] for what in ("cut", "OK", "cut at boot", "repaired")) > cases(2000, 40_000) // 50


def test_flash_that_holds_one_copy_or_none() -> None:
    """Done where one copy holds, and written once more; where none does: FLASH, and the old key stays."""
    flash = standing(first_key)
    was = bytes(flash.memory)
    for at in range(1, 56):
        flash.restore(was)
        flash.fail(at)
        assert flash.own(KEY_C) == "OK" and not flash.store.in_doubt
        assert flash.boot() == 0 and flash.key == KEY_C and flash.boot_operations == 0, at
    for first, many, status in ((1, 54, "FLASH"), (1, 108, "FLASH"), (28, 200, "OK"), (55, 200, "OK")):
        flash.restore(was)
        flash.fail(first, many)
        assert flash.own(KEY_C) == status
        assert flash.store.in_doubt == (many != 54)
        for _ in range(2):
            assert flash.boot() == 0 and flash.key == (KEY_C if status == "OK" else KEY_B), (first, many)
    flash.restore(was)
    flip(flash, 8 * newest_at(flash))
    flash.sim.fail_at = 0
    assert flash.boot() == 0 and flash.key == KEY_B


def test_the_owner_stays_where_the_slots_change() -> None:
    """Firmware for tables of another size, with its journal at the same place."""
    flash = standing(table_behind_the_key)
    flash.flash.slots = 1
    assert flash.boot() == 0 and flash.key == KEY_B and flash.image == flash.built_in
    assert not flash.store.record.length[0] and flash.rollback(OLD) == "VALUE"
    done(flash.upload(LATER))
    assert flash.boot() == 0 and flash.key == KEY_B and flash.image == LATER


def test_the_journal_of_an_older_version_is_none() -> None:
    """One record of 28 words for each step, the first one "FKS2"."""
    flash = Flash()
    body = struct.pack("<2I", 0x32534B46, 1) + struct.pack("<I", 2 * PAGE + 2) + bytes(64) + KEY_A
    record = body + struct.pack("<I", zlib.crc32(body))
    assert len(record) == 112
    flash.memory[: len(record)] = record
    assert flash.boot() == 0 and flash.boot_operations and flash.key == NONE and not flash.store.lost
    done(flash.own(KEY_B))
    assert flash.boot() == 0 and flash.key == KEY_B


def test_a_robot_without_a_good_table_keeps_its_owner() -> None:
    flash = standing(first_key)
    flash.built_in = bytes(200)
    flash._built_in = FFI.from_buffer(flash.built_in)
    assert flash.boot() != 0
    robot = boot_robot(flash)
    answer = robot.ask("STATUS")
    assert (answer["owner"], answer["fault"]) == (link_layout().owner["KEY"], link_layout().fault["TABLE"])
    assert robot.status("PARAM", {"parameter": 1, "value": 2.0}) == "AUTH"


def test_a_table_that_changes_after_its_check_is_a_fault() -> None:
    flash = Flash(built_in=OLD)
    robot = boot_robot(flash)
    done(flash.upload(NEW))
    flash.memory[JOURNAL + 3000] = bytes([flash.memory[JOURNAL + 3000][0] ^ 4])
    robot.core.fk_robot_use_tables(robot.memory)
    answer = robot.ask("STATUS")
    assert (answer["state"], answer["fault"]) == (STATE["FAULT"], link_layout().fault["TABLE"])
    assert answer["fault_detail"] == -25 and robot.status("ARM") == "FAULT"


MUTATIONS = {
    "a second copy is not read": (
        "if (read_copy(store, offset + FK_STORE_RECORD_BYTES, words)) {\n        return IN_DOUBT;",
        "if (0) {",
    ),
    "a damaged step is passed over": ("return is_committed ? DAMAGED :", "return"),
    "a boot leaves in doubt what it found so": (
        "if (store->in_doubt != 0u) {\n        fk_store_record_t next",
        "if (0) {\n        fk_store_record_t next",
    ),
    "a step begun on the other page is not seen": (
        "store->in_doubt |= (step == TORN || step == DAMAGED) ? 1u : 0u;", "(void)step;"
    ),
    "the page that is left is not marked": ("if (word_at(store, other) == UINT32_MAX) {", "if (0) {"),
    "a lost store is written to": ("if (store->lost != 0u) {\n        return FK_STATUS_FLASH;", "if (0) {\n"),
    "a mark before the copies": (
        "    uint32_t held = 0u;\n",
        "    static const uint32_t early = FK_STORE_COMMITTED;\n"
        "    (void)program(store, offset + FK_STORE_MARK_AT, &early, 1u);\n    uint32_t held = 0u;\n",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", some(MUTATIONS, 3))
def test_a_changed_journal_is_found_out(name: str) -> None:
    lib = library(mutated("fk_store.c", *MUTATIONS[name]))
    with pytest.raises(AssertionError):
        everything(lib)


def everything(lib: Any) -> None:
    """The tests of this file, by another library."""
    flash = standing(last_of_its_page, lib)
    at = newest_at(flash)
    for copy in range(2):
        flip(flash, 8 * (at + copy * RECORD))
    assert flash.boot() == 0
    assert flash.store.lost and flash.own(KEY_C) == "FLASH"
    flash = standing(replaced_key, lib)
    flash.memory[:PAGE] = b"\xff" * PAGE
    assert flash.boot() == 0 and flash.store.lost
    for name in ("key replaced", "key is the first of its page"):
        no_bit_matters(name, lib)
    for name in CHANGES:
        hovering(name, lib)
        cuts_of_a_key(name, lib)
