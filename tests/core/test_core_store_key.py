"""The owner's key, whatever happens to the power: the old or the new one, and the same at each later boot."""

from __future__ import annotations

import random
from collections import Counter
from typing import Any

import pytest
from tests.conftest import some
from tests.core.core import cases, library, mutated
from tests.core.journal_rig import (
    KEY_A,
    KEY_B,
    KEY_C,
    NONE,
    Scene,
    done,
    first_key,
    first_of_a_page_of_old_steps,
    flip,
    last_of_its_page,
    never_owned,
    never_owned_with_a_table,
    newest_at,
    no_bit_matters,
    replaced_key,
    standing,
    table_behind_the_key,
)
from tests.core.store_rig import (
    HOWS,
    JOURNAL,
    PAGE,
    RECORD,
    STEP,
    Flash,
    table,
)  # fmt: skip

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
    assert min(seen[what] for what in ("cut", "OK", "cut at boot", "repaired")) >= cases(2000, 40_000) // 50


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


MUTATIONS = {
    "a second copy is not read": (
        "fk_journal.c",
        "if (read_copy(store, offset + FK_STORE_RECORD_BYTES, words)) {\n        return IN_DOUBT;",
        "if (0) {",
    ),
    "a damaged step is passed over": ("fk_journal.c", "return is_committed ? DAMAGED :", "return"),
    "a boot leaves in doubt what it found so": (
        "fk_store.c",
        "if (store->in_doubt != 0u) {\n        fk_store_record_t next",
        "if (0) {\n        fk_store_record_t next",
    ),
    "a step begun on the other page is not seen": (
        "fk_journal.c",
        "if ((step == TORN || step == DAMAGED) && read_step",
        "if (0 && step == TORN && read_step",
    ),
    "the page that is left is not marked": (
        "fk_journal.c",
        "if (fk_journal_word(store, other) == UINT32_MAX) {",
        "if (0) {",
    ),
    "a lost store is written to": (
        "fk_journal.c",
        "if (store->lost != 0u) {\n        return FK_STATUS_FLASH;",
        "if (0) {\n",
    ),
    "a mark before the copies": (
        "fk_journal.c",
        "    uint32_t held = 0u;\n",
        "    static const uint32_t early = FK_STORE_COMMITTED;\n"
        "    (void)fk_journal_program(store, offset + FK_STORE_MARK_AT, &early, 1u);\n"
        "    uint32_t held = 0u;\n",
    ),
}


@pytest.mark.parametrize("name", some(MUTATIONS, 3))
def test_a_changed_journal_is_found_out(name: str) -> None:
    lib = library(mutated(*MUTATIONS[name]))
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
