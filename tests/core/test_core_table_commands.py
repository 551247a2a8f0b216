"""Tables by frames: only at rest, no ARM meanwhile, and the new table decides."""

from __future__ import annotations

import hashlib
import struct

import pytest
from tests.core.core import Robot, decode, encode
from tests.core.store_rig import AT_REST_US, LATER, NEW, OLD, crc_of, robot_with_store

from frogkick.link.frames import pack_frame
from frogkick.link.layout import Value, link_layout


def begin_values(image: bytes) -> dict[str, Value]:
    words = struct.unpack(">8I", hashlib.sha256(image).digest())
    return {"length": len(image)} | {f"hash_{place}": word for place, word in enumerate(words)}


def send(robot: Robot, image: bytes) -> None:
    answer = robot.ask("TABLE_BEGIN", begin_values(image))
    assert answer["status"] == 0
    while (at := int(answer["next_offset"])) < len(image):
        answer = robot.ask("TABLE_CHUNK", {"offset": at}, [(byte,) for byte in image[at : at + 128]])
        assert answer["status"] == 0
        assert int(answer["next_offset"]) == min(at + 128, len(image))


def test_an_update_by_frames() -> None:
    robot, flash = robot_with_store()
    assert robot.ask("HELLO")["table_crc"] == crc_of(OLD)
    send(robot, NEW)
    assert robot.ask("HELLO")["table_crc"] == crc_of(OLD)
    assert robot.status("ARM") == "STATE"
    answer = robot.ask("TABLE_COMMIT")
    assert (answer["status"], answer["error"], answer["table_crc"]) == (0, 0, crc_of(NEW))
    assert robot.ask("HELLO")["table_crc"] == crc_of(NEW)
    assert robot.status("ARM") == "OK"
    status = robot.ask("TABLE_STATUS")
    assert status == {
        "status": 0, "running": 1, "active": 1, "previous": 0, "open": 0, "slots": 2, "slot_bytes": 8192,
        "running_crc": crc_of(NEW), "previous_crc": crc_of(OLD), "built_in_crc": crc_of(OLD),
        "next_offset": len(NEW), "erases_1": 1, "erases_2": 0, "erases_journal": 1,
        "repairs": 0,
    }  # fmt: skip
    assert robot.status("DISARM") == "OK"
    robot.tick(robot.now_us + 1000)
    assert robot.status("TABLE_ROLLBACK", {"table_crc": crc_of(OLD)}) == "OK"
    assert robot.ask("HELLO")["table_crc"] == crc_of(OLD)
    assert flash.sim.refused == 0


@pytest.mark.parametrize("between", ["another table", "LEARN OFF"])
def test_what_is_counted_since_boot_survives(between: str) -> None:
    """The estimator begins anew with either."""
    robot, _ = robot_with_store()
    for x_m in (0.1, 0.4, 0.401, 0.402):
        robot.fix(x_m)
    before = robot.ask("STATUS")
    assert (before["restarts"], before["fixes_used"], before["fixes_refused"]) == (1, 2, 2)
    if between == "another table":
        send(robot, NEW)
        assert robot.status("TABLE_COMMIT") == "OK"
    else:
        off: dict[str, Value] = {"parameter": link_layout().parameter["LEARN"], "value": 0.0}
        assert robot.status("PARAM", off) == "OK"
    assert robot.ask("STATUS") == before


def test_a_command_that_comes_again_behind_a_whole_table_acts_once() -> None:
    """A radio delivers an ARM again behind a table, whose chunks had displaced it: the robot armed itself."""
    robot, flash = robot_with_store()
    arm = pack_frame("ARM", "command", 1, {})[:-1]
    robot._sequence = 1
    robot.raw(arm)
    assert robot.status("DISARM") == "OK"
    robot.tick(robot.now_us + 1000)
    chunks = -(-len(NEW) // 128)
    send(robot, NEW)
    assert robot.status("TABLE_COMMIT") == "OK"
    assert chunks > 32 and robot._sequence < 64, "still to be known by what link.md says"
    robot.raw(arm)
    robot.take()
    assert robot.state() == "DISARMED"
    assert flash.sim.refused == 0


@pytest.mark.parametrize("state", ["ARMED", "RUNNING"])
def test_nothing_is_written_unless_disarmed(state: str) -> None:
    robot, flash = robot_with_store()
    robot.begin(state)
    writes = {
        "TABLE_BEGIN": begin_values(NEW), "TABLE_CHUNK": {"offset": 0}, "TABLE_COMMIT": None,
        "TABLE_ROLLBACK": {"table_crc": crc_of(OLD)},
    }  # fmt: skip
    for name, values in writes.items():
        assert robot.status(name, values) == "STATE"
    assert robot.ask("TABLE_STATUS")["status"] == 0
    assert flash.sim.operations == 0


def test_nothing_is_written_before_the_limbs_have_rested() -> None:
    robot, flash = robot_with_store(at_us=499_999)  # since a boot that may have cut a pulse
    assert robot.status("TABLE_BEGIN", begin_values(NEW)) == "STATE"
    robot.tick(600_000)
    assert robot.status("ARM") == "OK"
    assert robot.stroke("B") == "OK"
    pulses = robot.run_until(900_000)
    assert pulses
    assert robot.status("DISARM") == "OK"
    assert robot.status("TABLE_BEGIN", begin_values(NEW)) == "STATE"  # all is to be switched off first
    last_us = pulses[-1][0]
    for at_us in range(robot.now_us, last_us + 580_000, 5000):
        robot.tick(at_us)
        assert robot.status("TABLE_BEGIN", begin_values(NEW)) == "STATE"
    assert flash.sim.operations == 0
    robot.tick(last_us + 600_000)
    assert robot.status("TABLE_BEGIN", begin_values(NEW)) == "OK"


def test_the_guard_remembers_over_a_new_table() -> None:
    """A limb that was heated before the update is as hot after it."""
    kept = []
    for update in (False, True):
        robot, _ = robot_with_store()
        assert robot.status("ARM") == "OK"
        refused = []
        for turn in range(12):
            robot.run_until(robot.now_us + 560_000 + 100_000)
            if update and turn == 6:
                assert robot.status("DISARM") == "OK"
                robot.tick()
                robot.tick(robot.now_us + 600_000)
                send(robot, NEW)
                assert robot.status("TABLE_COMMIT") == "OK"
                assert robot.status("ARM") == "OK"
            elif turn == 6:
                robot.tick(robot.now_us + 600_000)
            assert robot.stroke("B") == "OK"
            robot.run_until(robot.now_us + 1000)
            refused.append(robot.ask("STATUS")["pulses_refused"])
        kept.append(refused[-1])
    assert kept[0] == kept[1] > 0


def test_lengths_and_refusals() -> None:
    robot, flash = robot_with_store()
    ids = {name: message.id for name, message in link_layout().messages.items()}
    for name, lengths in (
        ("TABLE_BEGIN", (0, 35, 37)), ("TABLE_CHUNK", (0, 3)), ("TABLE_COMMIT", (1,)),
        ("TABLE_ROLLBACK", (0, 3, 5)), ("TABLE_STATUS", (1,)),
    ):  # fmt: skip
        for length in lengths:
            robot.raw(encode(ids[name], 200 + length, bytes(length))[:-1])
            answer = decode(robot.take_bytes()[:-1])
            assert answer is not None
            reported = answer[2]
            assert struct.unpack("<b", reported[:1])[0] == link_layout().status["LENGTH"], name
    assert flash.sim.operations == 0
    reported = robot.ask("TABLE_BEGIN", begin_values(NEW))
    assert robot.ask("TABLE_CHUNK", {"offset": 128}, [(1,)] * 128)["next_offset"] == 0
    assert robot.status("TABLE_CHUNK", {"offset": 0}, [(1,)] * 127) == "LENGTH"
    assert robot.status("TABLE_COMMIT") == "STATE"
    assert robot.status("TABLE_ROLLBACK", {"table_crc": crc_of(LATER)}) == "VALUE"
    assert robot.status("ARM") == "OK"  # that closed it


def test_a_port_without_a_store() -> None:
    robot = Robot(OLD, 0)
    robot.tick(AT_REST_US)
    assert robot.status("TABLE_STATUS") == "UNKNOWN"
    assert robot.status("TABLE_BEGIN", begin_values(NEW)) == "UNKNOWN"
