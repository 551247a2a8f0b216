"""A robot with an owner's key: nobody else commands it, and whoever likes switches it off."""

from __future__ import annotations

import copy
import hashlib
import hmac
import random
import struct

import pytest
from cobs import cobs
from tests.conftest import from_ci
from tests.core.core import FFI, SILENT_US, Robot, decode, mutated, strings
from tests.core.log_rig import Log
from tests.core.store_rig import NEW, Flash, robot_with_store
from tests.core.test_core_table_commands import begin_values, send

from frogkick.link import auth
from frogkick.link.frames import hello, pack_frame, pack_raw
from frogkick.link.layout import AUTH_BIT, Value, link_layout

KEY = bytes(range(1, 33))
OTHER = bytes(range(2, 34))
NONE = bytes(32)
GUARDED: dict[str, dict[str, Value]] = {
    "ARM": {}, "START": {"delay_us": 0}, "STROKE": {"action": 1}, "PARAM": {"parameter": 1, "value": 2.0},
    "FIX": {"fix_sequence": 1, "quality": 1, "capture_age_us": 0, "x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0},
    "PATH": {"first": 0, "total": 2, "count": 2}, "TABLE_BEGIN": begin_values(NEW),
    "TABLE_CHUNK": {"offset": 0}, "TABLE_COMMIT": {}, "TABLE_ROLLBACK": {"table_crc": 0},
    "KEY": auth.words("key", NONE),
}  # fmt: skip
ROWS = {"PATH": [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]}


def own(robot: Robot, key: bytes = KEY) -> str:
    return robot.status("KEY", auth.words("key", key))


def challenge(robot: Robot, key: bytes = KEY, nonce: bytes = bytes(16)) -> auth.CommandCodes | None:
    return auth.begin(key, nonce, robot.ask("CHALLENGE", auth.words("nonce", nonce)))


def owned() -> tuple[Robot, Flash]:
    """A robot that has an owner, and this conversation is his."""
    robot, flash = robot_with_store()
    assert own(robot) == "OK"
    robot.auth = challenge(robot)
    assert robot.auth is not None
    return robot, flash


def encoded(robot: Robot, name: str, sequence: int = 200) -> bytes:
    """A guarded command as the owner sends it, without its delimiter."""
    return pack_frame(name, "command", sequence, GUARDED[name], ROWS.get(name, ()), robot.auth)[:-1]


def heard(robot: Robot, frame: bytes) -> str:
    robot.raw(frame)
    return link_layout().status_name(int(robot.take()[-1].values["status"]))


def test_anybody_commands_a_robot_without_an_owner() -> None:
    robot, _ = robot_with_store()
    assert robot.ask("STATUS")["owner"] == link_layout().owner["OPEN"]
    assert robot.status("CHALLENGE", auth.words("nonce", bytes(16))) == "AUTH"  # it has no key to prove
    assert robot.status("ARM") == "OK"
    robot.auth = auth.CommandCodes(KEY)
    assert robot.status("ARM") == "MAC"  # nor a key to check by


def test_what_moves_or_changes_it_needs_a_code() -> None:
    assert set(GUARDED) == {name for name, one in link_layout().messages.items() if one.needs_code}
    robot, flash = owned()
    assert robot.ask("STATUS")["owner"] == link_layout().owner["KEY"]
    conversation, robot.auth = robot.auth, None
    before = bytes(FFI.buffer(FFI.addressof(flash.store.record)))
    for name, values in GUARDED.items():
        assert robot.status(name, values, ROWS.get(name, ())) == "AUTH", name
    assert bytes(FFI.buffer(FFI.addressof(flash.store.record))) == before and robot.state() == "DISARMED"
    robot.auth = conversation
    assert robot.status("PATH", GUARDED["PATH"], ROWS["PATH"]) == "OK"
    assert (robot.status("PARAM", GUARDED["PARAM"]), robot.fix(0.0), robot.status("ARM")) == (
        "OK",
        "OK",
        "OK",
    )
    assert robot.start() == "OK"


@pytest.mark.parametrize("name", ["DISARM", "STOP", "STATUS", "TABLE_STATUS", "HELLO", "PLAN"])
def test_the_others_need_none(name: str) -> None:
    robot, _ = owned()
    assert robot.status("ARM") == "OK"
    robot.auth = None
    values = {field.name: 0 for field in link_layout().messages[name].command.fields}  # type: ignore[union-attr]
    assert robot.status(name, hello() if name == "HELLO" else values) in ("OK", "NO_PATH")
    if name in ("DISARM", "STOP"):
        assert robot.state() == {"DISARM": "DISARMED", "STOP": "ARMED"}[name]


def test_a_stranger_switches_a_run_off_and_no_more() -> None:
    robot, _ = owned()
    for name in ("PATH", "ARM"):
        assert heard(robot, encoded(robot, name, 100 + len(name))) == "OK"
    assert robot.fix(0.0) == "OK" and robot.start() == "OK"
    robot.auth = None
    robot.tick(robot.now_us + 1000)
    assert robot.status("STOP") == "OK" and robot.state() == "ARMED"
    assert robot.start() == "AUTH"
    assert robot.status("DISARM") == "OK" and robot.status("ARM") == "AUTH"


@pytest.mark.parametrize("name", sorted(GUARDED))
def test_a_command_that_was_recorded_acts_once(name: str) -> None:
    """Also after what is kept of repetitions is forgotten, in another conversation, and after a reset."""
    robot, flash = owned()
    frame = encoded(robot, name)
    first = heard(robot, frame)
    assert first not in ("AUTH", "MAC")
    if name == "KEY":  # it has no owner now: it gets its key again
        robot.auth = None
        assert own(robot) == "OK"
    again = heard(robot, frame)
    assert again == (first if name != "FIX" else "MAC")  # from memory
    robot.raw(pack_frame("HELLO", "command", 4, hello())[:-1])  # anybody may: it changes nothing
    robot.take()
    assert heard(robot, frame) == again
    robot.core.fk_duplicates_forget(FFI.addressof(robot.memory, "duplicates"))
    assert heard(robot, frame) == "MAC"
    robot.raw(pack_frame("DISARM", "command", 3)[:-1])
    robot.take()
    assert heard(robot, frame) == "MAC"
    robot.auth = challenge(robot, nonce=bytes(range(16)))
    assert heard(robot, encoded(robot, "PARAM", 30)) == "OK"
    assert heard(robot, frame) == "MAC"
    robot, _ = robot_with_store(flash)
    assert heard(robot, frame) == "MAC" and robot.state() == "DISARMED"


def test_what_the_host_says_or_the_robot_cannot_be_sent_back() -> None:
    """A robot's proof is no code of a command, nor is a command's code a proof; no nonce comes again."""
    robot, _ = owned()
    reported = []
    for _ in range(3):
        reported.append(robot.ask("CHALLENGE", auth.words("nonce", bytes(16))))
        robot.status("DISARM")
    assert len({reported["nonce_0"] for reported in reported}) == 3
    for answer in reported:
        proof, nonce = auth.from_words("proof", answer, 4), auth.from_words("nonce", answer, 4)
        for code in (proof[:8], proof[8:], nonce[:8], hmac.digest(KEY, bytes(16) + nonce, "sha256")[:8]):
            body = struct.pack("<I", 1) + code
            assert heard(robot, pack_raw(AUTH_BIT | 2, 9, body)[:-1]) == "MAC"
    assert robot.state() == "DISARMED"


def test_a_wrong_key() -> None:
    robot, _ = owned()
    assert challenge(robot, OTHER) is None
    nonce = auth.from_words("nonce", robot.ask("CHALLENGE", auth.words("nonce", bytes(16))), 4)
    robot.auth = auth.CommandCodes(hmac.digest(OTHER, b"frogkick command" + nonce, "sha256"))
    assert robot.status("ARM") == "MAC" and robot.state() == "DISARMED"


def test_every_bit_of_a_command_is_under_its_code() -> None:
    robot, _ = owned()
    frame = pack_frame("PARAM", "command", 77, GUARDED["PARAM"], (), robot.auth)
    raw = cobs.decode(frame[:-1])[:-4]
    plan = robot.ask("STATUS")
    for bit in range(8 * len(raw)):
        changed = bytearray(raw)
        changed[bit // 8] ^= 1 << bit % 8
        if changed[0] in (raw[0] ^ AUTH_BIT, raw[0] ^ 0x40, raw[0] ^ 0x80):
            continue  # no longer a command with a code
        robot.raw(pack_raw(changed[0], changed[1], bytes(changed[2:]))[:-1])
        answer = decode(robot.take_bytes()[:-1])
        assert answer is not None and answer[2] == struct.pack("b", link_layout().status["MAC"]), bit
    assert robot.ask("STATUS")["state"] == plan["state"]
    assert heard(robot, frame[:-1]) == "OK"


def test_another_of_the_owner_s_hosts_takes_over() -> None:
    robot, _ = owned()
    assert robot.status("PARAM", GUARDED["PARAM"]) == "OK"
    first, robot.auth = robot.auth, challenge(robot, nonce=b"another host ...")
    assert robot.status("PARAM", GUARDED["PARAM"]) == "OK"
    robot.auth = first
    assert robot.status("PARAM", GUARDED["PARAM"]) == "MAC"


def test_frames_that_overtake_each_other() -> None:
    """Each counter counts once, within 32 of the newest, as each of FIX does; beside a plain way to tell."""
    robot, _ = owned()
    conversation = robot.auth
    assert conversation is not None
    rng, seen = random.Random(3), set[tuple[bool, str]]()
    newest, had = {True: 0, False: 0}, {True: set[int](), False: set[int]()}
    for _ in range(1200):
        is_fix = rng.random() < 0.5
        counter = max(0, newest[is_fix] + rng.choice([-40, -32, -31, -5, -1, 0, 1, 1, 2, 30, 31, 32, 33, 70]))
        is_new = counter > 0 and counter not in had[is_fix] and counter > newest[is_fix] - 32
        conversation.counter = conversation.fix_counter = counter - 1
        robot.now_us += 10_000
        answer = robot.fix() if is_fix else robot.status("PARAM", GUARDED["PARAM"])
        assert answer == ("OK" if is_new else "MAC"), (counter, is_fix)
        seen.add((is_fix, answer))
        if is_new:
            had[is_fix].add(counter)
            newest[is_fix] = max(newest[is_fix], counter)
    assert len(seen) == 4


def test_nothing_that_a_stranger_sends_keeps_it_armed() -> None:
    robot, _ = owned()
    assert robot.status("ARM") == "OK"
    armed_us = robot.now_us
    robot.auth = None
    for _ in range(9):
        robot.run_until(robot.now_us + 600_000)
        assert robot.status("PARAM", GUARDED["PARAM"]) == "AUTH"
    assert robot.now_us > armed_us + SILENT_US and robot.state() == "DISARMED"
    robot.auth = challenge(robot)
    assert robot.status("ARM") == "OK"
    for _ in range(9):
        robot.run_until(robot.now_us + 600_000)
        assert robot.status("PARAM", GUARDED["PARAM"]) == "OK"
    assert robot.state() == "ARMED"


def test_the_key_outlives_power_and_tables() -> None:
    robot, flash = owned()
    send(robot, NEW)
    assert own(robot, OTHER) == "STATE"  # while an update is open
    assert robot.status("TABLE_COMMIT") == "OK"
    assert flash.boot() == 0 and flash.image == NEW
    robot, _ = robot_with_store(flash)
    assert robot.status("ARM") == "AUTH"
    robot.auth = challenge(robot)
    assert robot.status("ARM") == "OK"


def test_a_key_is_replaced_and_taken_away_by_its_owner_alone() -> None:
    robot, flash = owned()
    robot.auth, conversation = None, robot.auth
    assert own(robot, OTHER) == own(robot, NONE) == "AUTH"
    robot.auth = conversation
    assert own(robot, OTHER) == "OK"
    assert robot.status("ARM") == "MAC"  # all conversations have ended
    assert challenge(robot, KEY) is None
    robot.auth = challenge(robot, OTHER)
    operations = flash.sim.operations
    assert own(robot, OTHER) == "OK" and flash.sim.operations == operations  # the same: nothing is written
    robot.auth = challenge(robot, OTHER)
    assert own(robot, NONE) == "OK"
    robot.auth = None
    assert robot.ask("STATUS")["owner"] == link_layout().owner["OPEN"] and robot.status("ARM") == "OK"


@pytest.mark.parametrize("state", ["ARMED", "RUNNING"])
def test_no_key_is_taken_unless_disarmed_and_rested(state: str) -> None:
    robot, flash = robot_with_store()
    robot.begin(state)
    assert own(robot) == "STATE"
    assert robot.status("CHALLENGE", auth.words("nonce", bytes(16))) == (
        "AUTH" if state == "ARMED" else "STATE"
    )
    assert flash.sim.operations == 0


def test_no_key_is_taken_before_the_limbs_have_rested() -> None:
    """Writing flash holds the core up."""
    robot, flash = robot_with_store()
    assert robot.status("ARM") == "OK" and robot.status("DISARM") == "OK"
    assert own(robot) == "STATE" and flash.sim.operations == 0  # first all is to be switched off
    robot.tick(robot.now_us + 1000)
    assert own(robot) == "OK"


def test_a_power_cut_while_a_key_is_written_leaves_the_old_or_the_new_one() -> None:
    """At each word that is written."""
    outcomes = set()
    for cut in range(1, 60):
        for how in range(4):
            robot, flash = owned()
            flash.cut(cut, how, cut)
            reported = own(robot, OTHER)
            cut_short = bool(flash.sim.dead)
            assert flash.boot() == 0
            assert flash.key in (KEY, OTHER) and (reported != "OK" or cut_short or flash.key == OTHER)
            outcomes.add((cut_short, flash.key == OTHER))
    assert {(True, False), (False, True)} <= outcomes


def test_a_robot_without_randomness_takes_no_key() -> None:
    """Nobody could prove to it who he is."""
    robot, flash = robot_with_store()
    robot.core.fk_test_random_fails = 1
    try:
        assert own(robot) == "UNKNOWN" and robot.status("ARM") == "OK"
        flash.store.record.owner_key[0] = 1  # as another firmware has left it
        assert robot.status("CHALLENGE", auth.words("nonce", bytes(16))) == "UNKNOWN"
    finally:
        robot.core.fk_test_random_fails = 0


def test_a_frame_too_short_for_a_code() -> None:
    robot, _ = owned()
    for length in range(auth.TRAILER_BYTES):
        assert heard(robot, pack_raw(AUTH_BIT | 2, 9, bytes(length))[:-1]) == "MAC"


def test_the_log_holds_no_key_and_no_code() -> None:
    """Anybody may read it; and what it holds is lived through again without them."""
    robot, _ = robot_with_store()
    log = Log()
    log.memory.magic = 0
    robot.core.fk_robot_use_log(robot.memory, log.memory)
    assert own(robot) == "OK"
    robot.auth = challenge(robot)
    codes = []
    for name in ("PARAM", "PATH", "ARM", "FIX", "START"):
        frame = encoded(robot, name, 60 + len(codes))
        codes.append(cobs.decode(frame)[-12:-4])
        assert heard(robot, frame) == "OK"
    robot.auth = None
    before = len(log.records())
    assert robot.status("STROKE", {"action": 1}) == robot.status("PARAM", GUARDED["PARAM"]) == "AUTH"
    records = log.records()
    assert len(records) == before, "what was refused for want of a code is logged"
    assert [r.name for r in records].count("COMMAND") == 5
    content = log.read()[1]
    assert KEY not in content and not any(code in content for code in codes)


def hmac_of(key: bytes, parts: list[bytes]) -> bytes:
    joined, lengths = strings(parts)
    code = FFI.new("uint8_t[32]")
    Robot().core.fk_test_hmac(key, joined, lengths, len(parts), code)
    return bytes(FFI.buffer(code))


@from_ci
def test_codes_are_those_of_the_standard() -> None:
    """RFC 4231's cases with keys of up to 32 bytes, and any message in any parts beside Python's own."""
    cases: list[tuple[bytes, bytes, str]] = [
        (b"\x0b" * 20, b"Hi There", "b0344c61d8db38535ca8afceaf0bf12b881dc200c9833da726e9376c2e32cff7"),
        (b"Jefe", b"what do ya want for nothing?",
         "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843"),
        (b"\xaa" * 20, b"\xdd" * 50, "773ea91e36800e46854db8ebd09181a72959098b3ef8c122d9635514ced565fe"),
        (bytes(range(1, 26)), b"\xcd" * 50,
         "82558a389a443c0ea4cc819899f2083a85f0faa3e578f8077a2e3ff46729665b"),
    ]  # fmt: skip
    for key, message, code in cases:
        assert hmac_of(key.ljust(32, b"\0"), [message]).hex() == code
    rng = random.Random(1)
    for _ in range(200):
        key = rng.randbytes(32)
        parts = [rng.randbytes(rng.choice([0, 1, 55, 56, 63, 64, 65, 119, 200])) for _ in range(3)]
        assert hmac_of(key, parts) == hmac.new(key, b"".join(parts), hashlib.sha256).digest()


BROKEN: dict[str, tuple[str, str, str]] = {
    "a code is compared in part": (
        "fk_auth.c", "i < FK_AUTH_CODE_BYTES; ++i) {\n        differing", "i < 1u; ++i) {\n        differing",
    ),
    "the type is not under the code": (
        "fk_auth.c", "head[FK_FRAME_HEAD_BYTES] = {frame->type, ", "head[FK_FRAME_HEAD_BYTES] = {0u, ",
    ),
    "the number is not under the code": ("fk_auth.c", ", frame->sequence};", ", 0u};"),
    "a key ends no conversation": ("fk_key_commands.c", "    fk_auth_end(&robot->auth);\n", ""),
    "a disarmed robot ends no conversation": ("fk_robot_state.c", "        fk_auth_end(&robot->auth); ", ""),
    "a nonce that was offered outlives it": (
        "fk_auth.c", "    auth->has_pending = 0u;\n    auth->has_current", "    auth->has_current",
    ),
    "counters are not looked at": ("fk_auth.c", "if (!take_counter(", "if (!1 && !take_counter("),
    "nonces come again": ("fk_auth.c", "        ++auth->nonces;\n", ""),
    "a stranger's CHALLENGE displaces the owner's": (
        "fk_auth.c", "if (!is_fresh(auth, now_us)) {", "if (now_us != 0u) {",
    ),
}  # fmt: skip


def _breaks(robot: Robot, flash: Flash) -> list[str]:
    """What an attacker can do with a core: "" where it holds."""
    found = []
    assert own(robot) == "OK"
    robot.auth = challenge(robot)
    if robot.auth is None:
        return ["no conversation"]
    if robot.status("PARAM", GUARDED["PARAM"]) != "OK":
        found.append("the owner is refused")
    nonces = []
    for _ in range(2):
        nonces += [robot.ask("CHALLENGE", auth.words("nonce", bytes(16)))["nonce_0"] for _ in range(2)]
        robot.auth = None
        robot.status("DISARM")
    found += ["nonces come again"] if nonces[0] == nonces[2] else []
    found += ["a stranger displaces the owner"] if nonces[0] != nonces[1] else []
    robot.auth = challenge(robot)
    held_back = [pack_frame("PARAM", "command", 91, GUARDED["PARAM"], (), robot.auth)[:-1]]
    robot.status("PARAM", GUARDED["PARAM"])
    held_back.append(pack_frame("PARAM", "command", 92, GUARDED["PARAM"], (), robot.auth)[:-1])
    offered = challenge(robot)
    held_back.append(pack_frame("PARAM", "command", 93, GUARDED["PARAM"], (), offered)[:-1])
    robot.status("DISARM")
    found += ["what was held back acts"] if {heard(robot, frame) for frame in held_back} != {"MAC"} else []
    robot.auth = challenge(robot)
    whole = pack_frame("PARAM", "command", 90, GUARDED["PARAM"], (), robot.auth)
    raw = cobs.decode(whole[:-1])[:-4]
    for at in (0, 1, 2, len(raw) - 9, len(raw) - 1):
        changed = bytearray(raw)
        changed[at] ^= 1 if at else 0x0B ^ 0x09
        robot.raw(pack_raw(changed[0], changed[1], bytes(changed[2:]))[:-1])
        answer = decode(robot.take_bytes()[:-1])
        if answer is None or answer[2] != struct.pack("b", link_layout().status["MAC"]):
            found.append(f"byte {at} is not under the code")
    conversation = copy.copy(robot.auth)
    if robot.status("PARAM", GUARDED["PARAM"]) != "OK":
        found.append("the owner is refused")
    robot.auth = conversation
    if robot.status("PARAM", GUARDED["PARAM"]) != "MAC":
        found.append("a counter came twice")
    robot.auth = challenge(robot)
    assert robot.auth is not None
    own(robot, OTHER)
    if robot.status("PARAM", GUARDED["PARAM"]) == "OK":
        found.append("an old conversation goes on")
    return found


def test_nothing_is_found_in_the_core_as_it_is() -> None:
    assert _breaks(*robot_with_store()) == []


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_found(name: str) -> None:
    assert _breaks(*robot_with_store(files=mutated(*BROKEN[name]))) != []
