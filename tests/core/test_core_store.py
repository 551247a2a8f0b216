"""Tables in flash: the order of an update, what is refused, rollback, boot, wear."""

from __future__ import annotations

import hashlib
import random

from tests.core.core import FFI, cases, core
from tests.core.store_rig import (
    JOURNAL,
    LATER,
    NEW,
    NEXT,
    OLD,
    PAGE,
    Flash,
    crc_of,
    forged,
    refusals,
    table,
)  # fmt: skip
from tests.planner import synthetic


def test_refuses_what_is_no_table_of_this_robot() -> None:
    refusals()


def test_hash_is_sha256() -> None:
    for length in (*range(130), 1000, 4096, len(NEW)):
        digest = FFI.new("uint8_t[32]")
        data = (NEW * 2)[:length]
        core().fk_test_sha256(data, length, digest)
        assert bytes(FFI.buffer(digest)) == hashlib.sha256(data).digest(), length


def test_order_of_an_update() -> None:
    flash = Flash()
    assert flash.chunk(0, NEW[:128]) == "STATE"
    assert flash.commit() == "STATE"
    for length in (0, 172, 2 * PAGE + 4, len(NEW) - 1, 2**32 - 4):
        assert flash.begin(NEW, length) == "VALUE"
    assert flash.sim.operations == 0
    assert flash.begin(NEW) == "OK"
    assert flash.chunk(128, NEW[128:256]) == "OFFSET"
    assert flash.chunk(0, NEW[:124]) == "LENGTH"
    assert flash.chunk(0, NEW[:132]) == "LENGTH"
    assert flash.chunk(0, b"") == "LENGTH"
    assert flash.commit() == "STATE"
    assert flash.chunk(0, NEW[:128]) == "OK"
    assert flash.chunk(0, NEW[:128]) == "OFFSET"  # its answer was lost; next_offset says how to go on
    assert flash.store.next_offset == 128
    assert flash.commit() == "STATE"
    assert set(flash.chunks(NEW)) == {"OK"}
    assert flash.chunk(len(NEW), b"") == "LENGTH"
    assert flash.store.open == 1 and flash.image == flash.built_in
    assert flash.commit() == "OK"
    assert flash.commit() == "STATE"
    assert flash.image == NEW


def test_goes_on_where_a_reset_stopped_it() -> None:
    flash = Flash()
    assert flash.upload(NEW, PAGE + 512) == "OK"
    assert flash.boot() == 0
    assert flash.store.open == 0
    assert flash.chunk(PAGE + 512, NEW[PAGE + 512 : PAGE + 640]) == "STATE"
    assert flash.begin(NEW) == "OK"
    assert flash.store.next_offset == PAGE
    assert set(flash.chunks(NEW)) == {"OK"}
    assert flash.commit() == "OK"
    assert flash.sim.erased[1] == 3  # the part of a page that was cut off once more
    assert list(flash.store.record.erases) == [2, 0]
    for other in (OLD, NEW[:-4]):  # another hash, another length: from the start
        flash = Flash()
        assert flash.upload(NEW, PAGE) == "OK"
        assert flash.begin(other) == "OK"
        assert flash.store.next_offset == 0
    flash = Flash()
    assert flash.upload(NEW, PAGE) == "OK"
    assert flash.begin(OLD, len(NEW) - 4) == "OK"
    assert flash.store.next_offset == 0


def test_a_length_of_whole_pages_resumes_at_its_end() -> None:
    flash = Flash()
    image = bytes(2 * PAGE)
    assert flash.upload(image, 2 * PAGE - 1) == "OK"
    assert flash.store.next_offset == 2 * PAGE
    assert flash.boot() == 0 and flash.begin(image) == "OK"
    assert flash.store.next_offset == 2 * PAGE
    assert flash.commit() == "TABLE" and flash.error[0] == -21


def test_rollback() -> None:
    flash = Flash()
    assert flash.rollback(NEW) == "VALUE"
    assert flash.rollback(flash.built_in) == "OK"
    assert flash.sim.operations == 0  # in use already
    assert flash.upload(OLD) == "OK"
    assert flash.upload(NEW) == "OK"
    for image in (OLD, NEW, OLD, flash.built_in):
        for _ in range(2):  # asked twice, done once
            assert flash.rollback(image) == "OK"
            assert flash.image == image
        assert flash.boot() == 0
        assert flash.image == image
    assert flash.rollback(NEW) == "VALUE"  # only one before is known
    assert flash.rollback(OLD) == "OK"
    assert flash.lib.fk_store_crc32(flash.store, flash.store.running) == crc_of(OLD)
    # An update that is open is closed, and goes on later.
    assert flash.upload(LATER, PAGE) == "OK"
    assert flash.rollback(OLD) == "OK"
    assert flash.store.open == 0
    assert flash.chunk(PAGE, LATER[PAGE : PAGE + 128]) == "STATE"
    assert flash.begin(LATER) == "OK"
    assert flash.store.next_offset == PAGE


def test_one_slot_is_emptied_before_it_is_filled() -> None:
    flash = Flash(slots=1)
    assert flash.upload(OLD) == "OK"
    assert flash.begin(NEW) == "SLOT"
    assert flash.image == OLD
    assert flash.rollback(flash.built_in) == "OK"
    assert flash.rollback(OLD) == "OK"
    assert flash.rollback(flash.built_in) == "OK"
    assert flash.begin(NEW) == "OK"
    assert flash.rollback(OLD) == "OK"  # nothing of it was erased yet
    assert flash.rollback(flash.built_in) == "OK"
    assert flash.begin(NEW) == "OK" and flash.chunk(0, NEW[:128]) == "OK"
    assert flash.rollback(OLD) == "VALUE"
    assert flash.upload(NEW) == "OK"
    assert flash.boot() == 0
    assert flash.image == NEW


def test_boot_falls_back_to_the_last_good_table() -> None:
    flash = Flash()
    assert flash.upload(OLD) == "OK"
    assert flash.upload(NEW) == "OK"
    second_slot = JOURNAL + 2 * PAGE
    assert bytes(flash.memory[second_slot : second_slot + 16]) == NEW[:16]
    flash.memory[second_slot + 3000] = bytes([flash.memory[second_slot + 3000][0] ^ 0x10])
    assert flash.boot() == 0
    assert flash.image == OLD
    assert (flash.store.running, flash.store.record.active) == (1, 2)
    assert flash.rollback(NEW) == "VALUE"
    assert flash.rollback(OLD) == "OK"
    # The next update goes to the damaged slot, never to the one that runs.
    before = bytes(flash.memory)
    assert flash.upload(LATER) == "OK"
    assert flash.sim.touched == 0 and flash.image == LATER
    assert flash.rollback(OLD) == "OK"
    flash.memory[:] = before
    # A table that another writer put there is whole, but not what was committed.
    flash.memory[JOURNAL : JOURNAL + len(NEXT)] = NEXT
    assert flash.boot() == 0
    assert flash.image == flash.built_in
    assert (flash.store.running, flash.store.record.active) == (0, 2)


def test_rollback_to_a_damaged_table_is_refused() -> None:
    flash = Flash()
    assert flash.upload(OLD) == "OK"
    assert flash.upload(NEW) == "OK"
    flash.memory[JOURNAL + 2000] = bytes([flash.memory[JOURNAL + 2000][0] ^ 1])
    assert flash.rollback(OLD) == "TABLE"
    assert flash.error[0] == -25
    assert flash.image == NEW


def test_no_good_table_at_all() -> None:
    flash = Flash()
    flash.built_in = forged({16: b"another\0\0"})
    flash._built_in = FFI.from_buffer(flash.built_in)
    assert flash.boot() == -9
    flash = Flash()
    assert flash.upload(NEW) == "OK"
    flash.built_in = bytes(200)
    flash._built_in = FFI.from_buffer(flash.built_in)
    assert flash.boot() == 0
    assert flash.image == NEW


def test_flash_of_another_layout_is_not_believed() -> None:
    flash = Flash(slots=2)
    assert flash.upload(NEW) == "OK"
    flash.flash.slots = 1
    assert flash.boot() == 0
    assert flash.image == flash.built_in


def test_wear_is_counted() -> None:
    flash = Flash()
    images = [table(seed) for seed in (2, 3, 4)]
    updates = cases(100, 400)
    for turn in range(updates):
        assert flash.upload(images[turn % 3]) == "OK"
    record, sim = flash.store.record, flash.sim
    assert record.journal_erases == sim.erased[0] == sim.page_erases[0] + sim.page_erases[1]
    assert abs(sim.page_erases[0] - sim.page_erases[1]) <= 1
    for slot in range(2):
        pages = sim.page_erases[2 + 2 * slot : 4 + 2 * slot]
        assert record.erases[slot] == max(pages) == (updates + 1 - slot) // 2
    # A cut while the journal changes its page loses one count at most; a slot's count is never too low.
    for turn in range(cases(200, 1000)):
        flash.cut(1 + turn * 7 % 1500, turn % 3, seed=turn)
        flash.upload(images[turn % 3])
        assert flash.boot() == 0
    assert record.journal_erases <= sim.erased[0] <= record.journal_erases + cases(200, 1000)
    for slot in range(2):
        assert max(sim.page_erases[2 + 2 * slot : 4 + 2 * slot]) <= record.erases[slot]


def test_an_update_that_is_only_begun_wears_nothing() -> None:
    """Whoever may begin updates could otherwise end them for ever, with no page erased."""
    flash = Flash()
    assert flash.upload(OLD) == "OK"
    before, counted = bytes(flash.memory), list(flash.store.record.erases)
    flash.sim.operations = 0
    for turn in range(10_001):
        assert flash.begin((NEW, NEXT)[turn % 2]) == "OK"
    assert flash.sim.operations == 0 and bytes(flash.memory) == before
    assert list(flash.store.record.erases) == counted
    assert flash.upload(NEW) == "OK" and flash.image == NEW
    assert flash.rollback(OLD) == "OK"


def test_a_rollback_after_an_update_that_was_only_begun_finds_the_table_before() -> None:
    flash = Flash()
    assert flash.upload(OLD) == "OK" and flash.upload(NEW) == "OK"
    assert flash.begin(NEXT) == "OK"
    assert flash.rollback(OLD) == "OK" and flash.image == OLD
    assert flash.boot() == 0 and flash.image == OLD


def test_a_worn_slot_falls_through_to_the_other() -> None:
    flash = Flash()
    flash.store.record.erases[0] = 10_000
    assert flash.upload(NEW) == "OK"
    assert flash.store.running == 2 and list(flash.store.record.erases) == [10_000, 1]
    assert flash.upload(NEXT) == "WORN" and flash.image == NEW
    flash = Flash()
    assert flash.begin(NEW) == "OK" and flash.chunk(0, NEW[:128]) == "OK"
    flash.store.record.erases[0] = 10_000  # worn amid an update: it begins anew in the other
    assert flash.begin(NEW) == "OK" and flash.store.next_offset == 0
    assert flash.upload(NEW) == "OK" and flash.store.running == 2


def test_a_worn_slot_is_written_no_more() -> None:
    flash = Flash()
    flash.store.record.erases[0] = 9999
    assert flash.upload(NEW) == "OK"
    flash.store.record.erases[1] = 10_000
    assert flash.upload(NEXT) == "WORN"
    assert flash.image == NEW
    assert flash.rollback(flash.built_in) == "OK"
    assert flash.image == flash.built_in


def test_the_only_slot_is_worn() -> None:
    flash = Flash(slots=1)
    flash.store.record.erases[0] = 10_000
    assert flash.upload(NEW) == "WORN"
    assert flash.image == flash.built_in


def test_a_table_of_the_other_kind() -> None:
    flash = Flash()
    assert flash.upload(synthetic.image(60)) == "OK"
    assert flash.boot() == 0
    assert flash.image == synthetic.image(60)


def test_a_journal_of_noise_is_no_journal() -> None:
    dice = random.Random(5)
    flash = Flash()
    for share in (1.0, 0.02):
        noise = [dice.randrange(255) if dice.random() < share else 255 for _ in range(len(flash.memory))]
        flash.memory[:] = bytes(noise)
        assert flash.boot() == 0
        assert flash.image == flash.built_in
        assert flash.upload(NEW) == "OK"
        assert flash.boot() == 0
        assert flash.image == NEW


def test_an_update_spares_the_table_that_a_rollback_leads_to() -> None:
    flash = Flash()
    assert flash.upload(OLD) == "OK"
    assert flash.rollback(flash.built_in) == "OK"
    assert flash.upload(NEW, PAGE) == "OK"
    assert flash.rollback(OLD) == "OK"
    assert flash.image == OLD
    assert flash.boot() == 0
    assert flash.image == OLD
