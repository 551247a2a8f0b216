"""The estimate of the limbs' losses over a reset: kept if it is whole and of the same table, else lost."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.core.core import FFI, Robot, cases, core, image, library, mutated
from tests.core.log_rig import fetched, robot_with_log
from tests.core.store_rig import Flash, crc_of
from tests.core.test_core_guard_history import flipped
from tests.core.test_core_log_replay import replayed
from tests.core.test_core_snapshot import snapshot_of
from tests.core.test_core_table_commands import send
from tests.core.test_core_wear import lost_of, set_learn, worn
from tests.planner import synthetic

from frogkick.core.shared_library import load
from frogkick.estimator.wear import HELD, OFF, ON, WearFilter
from frogkick.pool.native_robot import kept_wear
from frogkick.runs.chip_twin import ChipTwin
from frogkick.tables.image import open_image
from frogkick_codegen.native import build_shared

BYTES, WORDS = 44, 12
"""Of the record, and how many words are written to renew it: the first one twice."""
LOST = [0, 20_000, 0, 32_767]


def other_image() -> bytes:
    return image(limb_wear=synthetic.wear_curves(4, 5, 6))


def record(content: bytes) -> Any:
    """RAM that no start-up clears, with this content."""
    assert len(content) == FFI.sizeof("fk_wear_persistent_t") == BYTES, "no bytes between"
    kept = FFI.new("fk_wear_persistent_t *")
    FFI.buffer(kept)[:] = content
    return kept


def whole(lost: Sequence[int] = LOST, table: bytes | None = None) -> bytes:
    return kept_wear(crc_of(image() if table is None else table), lost)


def with_learn(learn: int, content: bytes) -> bytes:
    """The same record with another FK_LEARN_... and its CRC."""
    reported = struct.pack("<I", learn) + content[4:-4]
    return reported + struct.pack("<I", zlib.crc32(reported))


def reset(kept: Any, table: bytes | None = None, made: Any = None) -> Robot:
    """A robot that starts with this RAM."""
    robot = Robot(table, now_us=0, made=made)
    robot.core.fk_robot_use_learned(robot.memory, kept)
    return robot


def known(robot: Robot) -> tuple[int, list[int]]:
    return int(robot.ask("STATUS")["learn"]), lost_of(robot)


FORGOTTEN = (OFF, [0, 0, 0, 0])


@pytest.mark.parametrize("seed", range(1, 1 + cases(2, 20)))
def test_after_a_reset_it_goes_on_from_what_it_knew(seed: int) -> None:
    """The shares are the same. The Python starts from them, and both have the same bits from then on."""
    kept = record(bytes(BYTES))
    learned = lost_of(worn(seed, 50, kept))
    assert max(learned) > 10_000
    again = robot_with_log(now_us=0, learned=kept)[0]
    assert known(again) == (ON, learned)
    again.tick()
    assert again.status("ARM") == "OK"
    wear = ChipTwin(snapshot_of(again), open_image(image())).wear
    assert wear is not None
    twin = WearFilter(open_image(image()))
    twin.restart(learned)
    assert wear.codes.tolist() == twin.codes.tolist() == learned
    for name in ("_information", "_vector", "current"):
        assert getattr(wear, name).tobytes() == getattr(twin, name).tobytes()
    second = worn(seed + 1000, 30, kept)
    reported = replayed(fetched(second))
    assert reported.mismatches == [] and reported.decisions
    assert known(reset(kept)) == known(second)


def test_of_a_kept_share_a_quarter_is_one_standard_deviation() -> None:
    wear = WearFilter(open_image(image()))
    wear.restart(LOST)
    for limb, share in enumerate(np.array(LOST) / 32767):
        if share:
            assert wear._information[3 + limb, 3 + limb] ** -0.5 == pytest.approx(share / 18**0.5, rel=1e-5)
    assert 0.23 < 18**-0.5 < 0.25


@pytest.mark.parametrize(("learn", "wanted"), [(ON, ON), (HELD, HELD), (OFF, OFF)])
def test_whether_it_learns_is_kept_with_what_it_learned(learn: int, wanted: int) -> None:
    kept = record(whole())
    robot = reset(kept)
    robot.tick()
    assert set_learn(robot, learn) == "OK"
    robot.tick()
    assert known(reset(kept)) == (wanted, LOST if wanted else [0, 0, 0, 0])


def test_all_that_is_no_learning_forgets_by_itself() -> None:
    """Other parameters have their defaults after each start, and so does this one if nothing is learned."""
    kept = record(bytes(BYTES))
    robot = reset(kept)
    robot.tick()
    assert known(robot) == FORGOTTEN and kept.learn == OFF
    assert set_learn(robot, ON) == "OK"
    robot.tick()
    assert known(reset(kept)) == (ON, [0, 0, 0, 0])


@from_ci
def test_one_flipped_bit_forgets() -> None:
    content = whole()
    assert known(reset(record(content))) == (ON, LOST)
    for bit in range(8 * BYTES):
        assert known(reset(record(flipped(content, bit)))) == FORGOTTEN, bit


@pytest.mark.parametrize("byte", [b"\x00", b"\xff", b"\xa5", b"\x01"])
def test_ram_as_the_supply_finds_it_holds_nothing(byte: bytes) -> None:
    assert known(reset(record(byte * BYTES))) == FORGOTTEN


def test_numbers_out_of_their_range_forget_though_the_crc_is_right() -> None:
    assert known(reset(record(whole([0, 0, 0, 32_767])))) == (ON, [0, 0, 0, 32_767])
    for lost in ([0, 0, 0, 32_768], [2**32 - 1], [0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0, 0, 1]):
        assert known(reset(record(whole(lost)))) == FORGOTTEN, lost
    for learn in (OFF, 3, 257, 2**32 - 1):
        assert known(reset(record(with_learn(learn, whole())))) == FORGOTTEN, learn
    assert known(reset(record(with_learn(HELD, whole())))) == (HELD, LOST)


def test_another_table_forgets() -> None:
    """Also if the first table is back after a start with another one."""
    kept = record(whole())
    robot = reset(kept, other_image())
    assert known(robot) == FORGOTTEN
    robot.tick()
    assert known(reset(kept)) == FORGOTTEN


def test_a_table_without_wear_curves_forgets() -> None:
    bare = image(limb_wear=np.zeros((4, 0, 6)))
    assert known(reset(record(whole(table=bare)), bare)) == FORGOTTEN


def test_a_table_that_is_refused_forgets() -> None:
    broken = bytearray(image())
    broken[200] ^= 1
    kept = record(whole())
    robot = reset(kept, bytes(broken))
    assert robot.error != 0 and known(robot) == FORGOTTEN
    robot.tick()
    assert known(reset(kept)) == FORGOTTEN


def test_a_table_by_radio_and_a_rollback_forget() -> None:
    old, new = (
        synthetic.affine_image(20, 9, seed, limb_wear=synthetic.wear_curves(4, 3, seed)) for seed in (2, 3)
    )
    flash = Flash(built_in=old, slot_bytes=3 * 4096)
    kept = record(whole(table=old))
    robot = reset(kept, old)
    robot.use_store(flash)
    robot.tick(600_000)
    assert known(robot) == (ON, LOST)
    send(robot, new)
    assert robot.status("TABLE_COMMIT") == "OK"
    robot.tick()
    assert known(robot) == (ON, [0, 0, 0, 0]), "as before: it learns on, from nothing"
    assert known(reset(kept, old)) == FORGOTTEN, "a start with the old one after all"
    FFI.buffer(kept)[:] = whole(table=new)
    again = reset(kept, new)
    again.use_store(flash)
    again.tick(600_000)
    assert known(again) == (ON, LOST)
    assert again.status("TABLE_ROLLBACK", {"table_crc": crc_of(old)}) == "OK"
    again.tick()
    assert known(again) == (ON, [0, 0, 0, 0]) and known(reset(kept, new)) == FORGOTTEN


@cache
def cutting_core() -> tuple[Any, Any]:
    """A core that is reset after this many words of the record: the others are not written."""
    files = mutated(
        "fk_wear_keep.c",
        "static void put(volatile uint32_t *word, uint32_t value) { *word = value; }",
        """uint32_t fk_test_words;
           static void put(volatile uint32_t *word, uint32_t value)
           {
               if (fk_test_words > 0u) {
                   *word = value;
                   --fk_test_words;
               }
           }""",
    )
    return load(build_shared("fk_core", files))


STATES = {
    "nothing": (OFF, [0, 0, 0, 0]),
    "one limb": (ON, [0, 20_000, 0, 0]),
    "the same limb a little more": (ON, [0, 20_001, 0, 0]),
    "all limbs": (ON, [655, 20_000, 700, 32_767]),
    "held": (HELD, [655, 20_000, 700, 32_767]),
}


@pytest.mark.parametrize("before", STATES)
@pytest.mark.parametrize("after", STATES)
def test_a_reset_at_each_word_of_a_changed_record(before: str, after: str) -> None:
    """It leaves the record before, the record after, or none."""
    ffi, made = cutting_core()
    content = image()
    words = ffi.new("uint64_t[]", (len(content) + 7) // 8)
    ffi.memmove(words, content, len(content))
    tables, wear, kept = (
        ffi.new(f"{name} *") for name in ("fk_tables_t", "fk_wear_t", "fk_wear_persistent_t")
    )
    assert made.fk_tables_open(ffi.cast("uint8_t *", words), len(content), tables) == 0

    def keep(state: str, most: int) -> None:
        made.fk_wear_init(wear, tables, STATES[state][0])
        wear.lost = STATES[state][1] + 4 * [0]
        made.fk_test_words = most
        made.fk_wear_keep(wear, tables, kept)

    def found() -> tuple[int, list[int]]:
        made.fk_wear_init(wear, tables, OFF)
        taken = made.fk_wear_resume(wear, tables, kept)
        assert taken == (wear.learn != OFF)
        return int(wear.learn), list(wear.lost)[:4]

    for written in range(WORDS + 1):
        keep(before, WORDS)
        assert found() == STATES[before]
        keep(after, written)
        if before == after:
            assert made.fk_test_words == written, "nothing is written where nothing changed"
        wanted = before if before == after or written == 0 else after if written == WORDS else "nothing"
        assert found() == STATES[wanted], written
        if 0 < written < WORDS and before != after:
            assert kept.learn == OFF, "whatever the CRC"


MUTANTS = {
    "no check": ("persistent->crc != crc_of(persistent, persistent->learn)", "0", "flip"),
    "any table": ("persistent->table_crc32 != tables->image_crc32)", "0)", "table"),
    "any share": ("persistent->lost[limb] > ((limb < tables->limbs) ? FK_LOST_MAX : 0u)", "0", "range"),
    "nothing taken": ("    wear->learn = (uint8_t)persistent->learn;\n", "", "whole"),
    "shares without what follows": ("    fk_wear_use(wear, tables);\n", "", "whole"),
    "never written": ("    put(&persistent->learn, wear->learn);\n", "", "written"),
}
"""What is taken out, what stands there instead, and what that breaks."""


def breaks(made: Any) -> set[str]:
    """The requirements that a core violates."""
    content = whole()
    found = set()
    robot = reset(record(content), made=made)
    if known(robot) != (ON, LOST) or robot.memory.tables.worn == FFI.NULL:
        found.add("whole")
    if any(known(reset(record(flipped(content, bit)), made=made)) != FORGOTTEN for bit in range(64, 100)):
        found.add("flip")
    if known(reset(record(content), other_image(), made)) != FORGOTTEN:
        found.add("table")
    if known(reset(record(whole([40_000])), made=made)) != FORGOTTEN:
        found.add("range")
    kept = record(bytes(BYTES))
    robot = reset(kept, made=made)
    assert set_learn(robot, ON) == "OK"
    robot.tick()
    if kept.learn != ON:
        found.add("written")
    return found


def test_a_core_as_it_is_breaks_nothing() -> None:
    assert breaks(core()) == set()


@pytest.mark.parametrize("name", MUTANTS)
def test_a_changed_core_is_found_out(name: str) -> None:
    old, new, what = MUTANTS[name]
    assert what in breaks(library(mutated("fk_wear_keep.c", old, new)))
