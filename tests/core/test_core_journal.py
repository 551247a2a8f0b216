"""The journal of key and tables: no wrong bit and no lost page opens a robot, or brings an older key back."""

from __future__ import annotations

import random
import struct
import zlib

import pytest
from tests.core.core import FFI, STATE, cases
from tests.core.journal_rig import (
    KEY_A,
    KEY_B,
    KEY_C,
    NONE,
    OWNED,
    SCENES,
    boot_robot,
    done,
    first_key,
    first_of_its_page,
    flip,
    newest_at,
    no_bit_matters,
    replaced_key,
    standing,
    table_behind_the_key,
)
from tests.core.log_rig import Log
from tests.core.store_rig import (
    JOURNAL,
    LATER,
    NEW,
    OLD,
    PAGE,
    PLACES,
    RECORD,
    STEP,
    Flash,
)  # fmt: skip

from frogkick.link.auth import words
from frogkick.link.layout import Value, link_layout


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


def test_what_is_older_may_be_damaged() -> None:
    """A step of the page that comes next, with the newest one the last of its own: nothing is written."""
    flash = standing(first_of_its_page)
    flash.fill_journal(0)
    assert flash.boot() == 0 and (flash.store.page, flash.store.place) == (1, PLACES)
    for place in range(PLACES):
        for copy in range(2):
            flip(flash, 8 * (place * STEP + copy * RECORD))
        assert flash.boot() == 0 and flash.boot_operations == 0
        assert flash.key == KEY_B and not flash.store.lost, place


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
