"""Tables in flash: whatever happens to the power, the whole old one or the whole new one."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from tests.conftest import count, some
from tests.core.core import COVERAGE_DIR, cases, library, mutated
from tests.core.store_rig import (
    HOWS,
    LATER,
    NEW,
    NEXT,
    OLD,
    PAGE,
    PLACES,
    RECORD,
    STEP,
    Flash,
    refusals,
    table,
)  # fmt: skip

Step = Callable[[Flash], str]


def upload(flash: Flash) -> str:
    return flash.upload(NEW)


def first(flash: Flash) -> None:
    """Nothing was ever written."""


def second(flash: Flash) -> None:
    assert flash.upload(OLD) == "OK"


def third(flash: Flash) -> None:
    """Both slots hold tables, the one before is overwritten."""
    assert flash.upload(LATER) == "OK"
    assert flash.upload(OLD) == "OK"


def page_change(left: int) -> Callable[[Flash], None]:
    """The journal's page is full after so many records."""

    def prepare(flash: Flash) -> None:
        second(flash)
        flash.fill_journal(left)

    return prepare


def both_pages_used(flash: Flash) -> None:
    """The page that is erased holds old records."""
    second(flash)
    for _ in range(PLACES):
        assert flash.begin(table(9)) == "OK" and flash.chunk(0, table(9)[:128]) == "OK"
    flash.fill_journal(1)


def half_sent(flash: Flash) -> None:
    """The update goes on behind its first page."""
    second(flash)
    assert flash.upload(NEW, PAGE + 256) == "OK"
    assert flash.boot() == 0


def back_to_new(flash: Flash) -> None:
    assert flash.upload(NEW) == "OK"
    assert flash.upload(OLD) == "OK"


def back_and_full(flash: Flash) -> None:
    back_to_new(flash)
    # Uploads that are begun overwrite the table before: coast back and forth instead.
    while flash.store.place < PLACES:
        assert flash.rollback(NEW if flash.image == OLD else OLD) == "OK"
    if flash.image == NEW:
        flash.store.place = PLACES  # as it is
        assert flash.rollback(OLD) == "OK"
        while flash.store.place < PLACES - 1:
            assert flash.rollback(NEW if flash.image == OLD else OLD) == "OK"
        assert flash.rollback(NEW if flash.image == OLD else OLD) == "OK"


def roll_back(flash: Flash) -> str:
    return flash.rollback(NEW)


SCENES: dict[str, tuple[Callable[[Flash], None], Step, int]] = {
    "first update": (first, upload, 2),
    "second update": (second, upload, 2),
    "third update": (third, upload, 2),
    "journal page changes at BEGIN": (page_change(0), upload, 2),
    "journal page changes at a page's record": (page_change(1), upload, 2),
    "journal page changes at COMMIT": (page_change(2), upload, 2),
    "journal page of old records changes": (both_pages_used, upload, 2),
    "update goes on": (half_sent, upload, 2),
    "rollback": (back_to_new, roll_back, 2),
    "rollback with a full journal page": (back_and_full, roll_back, 2),
    "one slot": (first, upload, 1),
}


def cuts_of(lib: Any, name: str, every: int = 31) -> tuple[int, int]:
    """Cut a scene in each way: how many operations there are, how many cuts were tried.

    Cut is at each operation where their kinds change, and at one in ``every`` between.
    """
    prepare, step, slots = SCENES[name]
    flash = Flash(lib, slots)
    prepare(flash)
    assert flash.boot() == 0
    before, old = bytes(flash.memory), flash.image
    assert old != NEW
    erased = list(flash.sim.page_erases)
    assert step(flash) == "OK"
    operations = flash.sim.operations
    assert flash.sim.touched == 0
    assert flash.image == NEW
    assert max(now - then for now, then in zip(flash.sim.page_erases, erased, strict=True)) <= 1
    places = set(range(1, operations + 1))
    if every > 1:
        places &= {*range(25), *range(operations - 60, operations + 1), *range(1, operations, every)}
        for page, now in enumerate(flash.sim.page_erases):
            if now > erased[page]:
                places |= {flash.sim.erase_places[page] + i for i in range(3)}
    tried, is_new = 0, []
    for at in sorted(places):
        for how in range(len(HOWS)):
            found = one_cut(flash, before, step, (at, how), old)
            is_new += [found == NEW] if HOWS[how] == "not done" else []
            tried += 1
    # One operation makes the new table the one, the last word of the first copy: not before, and not later.
    assert is_new == sorted(is_new)
    restore(flash, before, (decisive(operations, name), 0))
    step(flash)
    assert flash.boot() == 0 and flash.image == old
    restore(flash, before, (decisive(operations, name) + 1, 0))
    step(flash)
    assert flash.boot() == 0 and flash.image == NEW
    return operations, tried


def decisive(operations: int, name: str) -> int:
    """Behind it come the second copy, the mark, and in a page's first step that of the page that is left."""
    return operations - RECORD // 4 - 1 - ("changes at COMMIT" in name or "full journal" in name)


def restore(flash: Flash, before: bytes, cut: tuple[int, int]) -> None:
    flash.restore(before)
    flash.cut(cut[0], cut[1], seed=cut[0])


def one_cut(flash: Flash, before: bytes, step: Step, cut: tuple[int, int], old: bytes) -> bytes:
    """The table after the next boot, and after each one from then on."""
    what = f"cut in operation {cut[0]}, {HOWS[cut[1]]}"
    restore(flash, before, cut)
    step(flash)
    assert flash.sim.dead and flash.sim.touched == 0, what
    assert flash.boot() == 0, what
    found = flash.image
    assert found in (old, NEW), what
    for _ in range(3):
        assert flash.boot() == 0 and flash.image == found and flash.boot_operations == 0, what
    # The same update again, and one more: the cut has left nothing that is in their way.
    if flash.flash.slots == 2 or found == old:
        assert step(flash) == "OK" and flash.image == NEW, what
    assert flash.boot() == 0 and flash.image == NEW, what
    if cut[0] % 16 == 0:
        if flash.flash.slots == 1:
            assert flash.rollback(flash.built_in) == "OK" and flash.boot() == 0
        assert flash.upload(NEXT) == "OK", what
        assert flash.boot() == 0 and flash.image == NEXT, what
    assert flash.sim.refused == 0 and flash.sim.touched == 0, what
    return found


@pytest.mark.parametrize("name", SCENES)
def test_power_cut_at_every_operation(name: str) -> None:
    """What coverage counts needs each kind of operation once, not each operation."""
    every = 31 if COVERAGE_DIR else count(1, 1, 31)
    operations, tried = cuts_of(None, name, every)
    print(f"{name}: {operations} operations, {tried} cuts")
    assert tried >= (operations if every == 1 else min(operations, 69)) * len(HOWS)
    if not COVERAGE_DIR:
        assert operations >= (1400 if name == "first update" else 20)


def test_cut_after_cut() -> None:
    """Many updates and rollbacks in a row, each cut somewhere: never anything but a whole table."""
    count = cases(400, 4000)
    dice = random.Random(7)
    flash = Flash()
    whole = [table(seed) for seed in range(2, 7)]
    now = flash.built_in
    for turn in range(count):
        want = dice.choice(whole)
        limit = dice.choice((30, 400, 1500, 3000))
        flash.cut(dice.randrange(1, limit), dice.randrange(len(HOWS)), seed=turn)
        if dice.random() < 0.3:
            want = dice.choice([*whole, flash.built_in])
            flash.rollback(want)
        else:
            flash.upload(want)
        assert flash.sim.refused == 0 and flash.sim.touched == 0
        assert flash.boot() == 0
        assert flash.image in (now, want), turn
        now = flash.image


WRITE = """    if (fk_journal_program(store, at, words, count / 4u) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }"""
MUTATIONS = {
    "commit before it is verified": (
        "fk_store.c",
        "    int8_t status = verify(store, &next.crc32[slot - 1u], error);\n",
        "    (void)fk_journal_append(store, &next);\n    int8_t status = FK_STATUS_OK;\n"
        "    (void)verify(store, &next.crc32[slot - 1u], error);\n",
    ),
    "the newest record's page is erased": (
        "fk_journal.c",
        "uint32_t page = FK_STORE_JOURNAL_PAGES - 1u - store->newest_page;",
        "uint32_t page = store->newest_page;",
    ),
    "a record needs no CRC": (
        "fk_journal.c",
        "words->record.check == check_of(words)",
        "words->record.check != UINT32_MAX",
    ),
    "the slot in use is erased": ("fk_store.c", "slot != store->running &&", "slot != 0u &&"),
    "a slot is written before a record says so": (
        "fk_store.c",
        "    ++store->update.erases[store->update.pending - 1u];",
        "    (void)fk_journal_erase(store, slot_offset(store, store->update.pending));\n"
        "    ++store->update.erases[store->update.pending - 1u];",
    ),
    "a page is not erased again after a cut": (
        "fk_store.c",
        "FK_FLASH_PAGE_BYTES == 0u && fk_journal_erase(store, at) != FK_STATUS_OK) {",
        "FK_FLASH_PAGE_BYTES == 0u && fk_journal_word(store, at) != UINT32_MAX &&"
        " fk_journal_erase(store, at) != FK_STATUS_OK) {",
    ),
    "a torn record's place is used again": (
        "fk_journal.c",
        "store->place = place + 1u;\n                }\n                store->in_doubt = 1u;",
        "}\n                store->in_doubt = 1u;",
    ),
    "a page counts before it is written": (
        "fk_store.c",
        f"{WRITE}\n    store->next_offset += count;",
        "    store->next_offset += count;\n    if (store->next_offset % FK_FLASH_PAGE_BYTES == 0u) {\n"
        "        fk_store_record_t early = store->record;\n"
        "        early.pages_done = (uint8_t)(store->next_offset / FK_FLASH_PAGE_BYTES);\n"
        f"        (void)fk_journal_append(store, &early);\n    }}\n{WRITE}",
    ),
}


@pytest.mark.parametrize("name", some(MUTATIONS, 3))
def test_a_changed_store_is_found_out(name: str) -> None:
    lib = library(mutated(*MUTATIONS[name]))
    with pytest.raises(AssertionError):
        all_of(lib)


def all_of(lib: Any) -> None:
    refusals(lib)
    for scene in reversed(SCENES):
        cuts_of(lib, scene)


def test_a_record_that_hovers_is_passed_over_for_good() -> None:
    """A record cut in its last word may read as whole at one boot and not at the next: the newer one wins."""
    flash = Flash()
    assert flash.upload(OLD) == "OK"
    before = bytes(flash.memory)
    assert flash.boot() == 0
    assert flash.upload(NEW) == "OK"
    operations = flash.sim.operations
    at = (flash.store.place - 1) * STEP
    whole = bytes(flash.memory[at : at + RECORD])
    flash.restore(before)
    flash.cut(decisive(operations, ""), 1, seed=3)
    flash.upload(NEW)
    assert flash.boot() == 0 and flash.image == OLD and flash.boot_operations
    settled = bytes(flash.memory)
    for image in (OLD, NEXT):
        flash.restore(settled)
        assert flash.upload(image) == "OK"
        flash.memory[at : at + RECORD] = whole
        assert flash.boot() == 0
        assert flash.image == image


def test_flash_that_does_not_hold_what_is_written() -> None:
    """Wherever a word or an erase does not take, or none from there on: it is told, and the old table stays.

    Where one copy of the last record holds the new table is used. It works again afterwards.
    """
    reported: list[str] = []
    for name in ("third update", "journal page of old records changes", "rollback with a full journal page"):
        prepare, step, slots = SCENES[name]
        flash = Flash(slots=slots)
        prepare(flash)
        assert flash.boot() == 0
        before = bytes(flash.memory)
        assert step(flash) == "OK"
        operations = flash.sim.operations
        places = {
            *range(1, 40),
            *range(1, operations, count(29, 7, 97)),
            *range(max(1, operations - 60), operations + 1),
        }
        for at in sorted(place for place in places if place <= operations):
            for many in (1, operations):
                flash.restore(before)
                flash.fail(at, many)
                reported.append(step(flash))
                assert many == 1 or (reported[-1] == "OK") == (at > decisive(operations, name)), (name, at)
                # Words of the image that are all ones are there without being written.
                for _ in range(2):
                    assert flash.image == (NEW if reported[-1] == "OK" else OLD), (name, at)
                    assert flash.store.open == 0
                    assert flash.boot() == 0
                assert step(flash) == "OK"
                assert flash.upload(NEXT) == "OK"
                assert flash.boot() == 0 and flash.image == NEXT
    assert set(reported) == {"FLASH", "OK"} and reported.count("FLASH") > 200


def test_a_journal_page_that_cannot_be_erased_is_tried_again() -> None:
    flash = Flash()
    both_pages_used(flash)
    flash.fill_journal(0)
    for _ in range(3):
        flash.fail(1)
        assert flash.begin(NEW) == "OK" and flash.chunk(0, NEW[:128]) == "FLASH"
        assert flash.store.open == 0
    # Erased, but no record takes in all of that page: the other one still holds the newest.
    for _ in range(PLACES):
        flash.fail(2 if flash.store.place >= PLACES else 1, 1000)
        assert flash.begin(NEW) == "OK" and flash.chunk(0, NEW[:128]) == "FLASH"
    assert flash.boot() == 0
    assert flash.image == OLD
    assert flash.upload(NEW) == "OK"
    assert flash.boot() == 0 and flash.image == NEW
