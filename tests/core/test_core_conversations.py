"""What ends the conversation of a robot with its owner, and what does not: strangers, fixes, a lost link."""

from __future__ import annotations

import os
import random
from collections.abc import Callable

import pytest
from tests.core.core import SILENT_US, Robot, cases
from tests.core.log_rig import Log, fetched
from tests.core.store_rig import OLD, robot_with_store
from tests.core.test_core_auth import GUARDED, ROWS, challenge, encoded, heard, own, owned
from tests.core.test_core_log_replay import library

from frogkick.link import auth
from frogkick.link.frames import pack_frame
from frogkick.link.layout import link_layout
from frogkick.runs.chip_log import replay_log
from frogkick.tables.image import open_image


def strangers_challenge(robot: Robot) -> None:
    for number in range(20):
        nonce = auth.words("nonce", number.to_bytes(16, "big"))
        robot.raw(pack_frame("CHALLENGE", "command", number, nonce)[:-1])
    robot.take_bytes(20_000)


def test_a_stranger_s_challenge_ends_no_conversation() -> None:
    robot, _ = owned()
    assert robot.status("ARM") == "OK"
    strangers_challenge(robot)
    assert robot.status("PARAM", GUARDED["PARAM"]) == "OK"


def test_a_stranger_s_challenge_keeps_the_owner_out_of_none() -> None:
    """They come before the owner's and after it; and a nonce grows old, whoever asks for it."""
    robot, _ = robot_with_store()
    assert own(robot) == "OK"
    for _ in range(20):
        strangers_challenge(robot)
        robot.auth = challenge(robot, nonce=os.urandom(16))
        strangers_challenge(robot)
        assert robot.status("ARM") == "OK"
        assert robot.status("DISARM") == "OK"
        robot.tick(robot.now_us + 700_000)
    first = robot.ask("CHALLENGE", auth.words("nonce", bytes(16)))["nonce_0"]
    robot.tick(robot.now_us + SILENT_US - 1)
    assert robot.ask("CHALLENGE", auth.words("nonce", bytes(16)))["nonce_0"] == first
    robot.tick(robot.now_us + 1)
    assert robot.ask("CHALLENGE", auth.words("nonce", bytes(16)))["nonce_0"] != first


def end_by_disarm(robot: Robot) -> None:
    assert robot.status("DISARM") == "OK"


def end_by_lost_link(robot: Robot) -> None:
    robot.core.fk_robot_note_link_lost(robot.memory)


def end_by_silence(robot: Robot) -> None:
    robot.run_until(robot.now_us + SILENT_US)


def end_by_low_supply(robot: Robot) -> None:
    robot.core.fk_robot_note_supply(robot.memory, 1)
    robot.core.fk_robot_note_supply(robot.memory, 0)


def end_by_lost_fixes(robot: Robot) -> None:
    for name in ("PATH", "FIX", "START"):
        assert heard(robot, encoded(robot, name, 100 + len(name))) == "OK"
    robot.run_until(robot.now_us + 2_100_000)


ENDS: list[Callable[[Robot], None]] = [
    end_by_disarm, end_by_lost_link, end_by_silence, end_by_low_supply, end_by_lost_fixes,
]  # fmt: skip
"""The first three also where it is disarmed."""


@pytest.mark.parametrize(
    ("state", "end"),
    [(state, end) for state in ("offered", "DISARMED") for end in ENDS[:3]]
    + [("ARMED", end) for end in ENDS],
)
def test_what_was_held_back_acts_no_more(state: str, end: Callable[[Robot], None]) -> None:
    """Somebody keeps the owner's commands from the robot, and lets it have them when it is switched off."""
    robot, _ = owned()
    if state == "offered":
        end_by_disarm(robot)
        robot.auth = challenge(robot)
    elif state == "DISARMED":
        assert robot.status("PARAM", GUARDED["PARAM"]) == "OK"
    else:
        assert robot.status("ARM") == "OK"
    held_back = [
        encoded(robot, name, 150 + place) for place, name in enumerate(("ARM", "STROKE", "PARAM", "FIX"))
    ]
    end(robot)
    robot.auth = None
    assert robot.state() == "DISARMED"
    assert [heard(robot, frame) for frame in held_back] == 4 * ["MAC"]
    strangers_challenge(robot)
    assert [heard(robot, frame) for frame in held_back] == 4 * ["MAC"] and robot.state() == "DISARMED"
    assert robot.run_until(robot.now_us + 10**6) == []
    robot.auth = challenge(robot)
    assert robot.status("ARM") == "OK"
    assert [heard(robot, frame) for frame in held_back] == 4 * ["MAC"]


def test_what_was_held_back_acts_no_more_after_a_fault() -> None:
    """It begins to talk with its owner again in FAULT, which refuses what moves it."""
    robot, _ = owned()
    assert robot.status("ARM") == "OK"
    held_back = encoded(robot, "PARAM", 150)
    robot.core.fk_robot_note_clock_failed(robot.memory)
    assert heard(robot, held_back) == "MAC"
    robot.auth = challenge(robot)
    assert robot.status("ARM") == "FAULT"


def test_a_run_goes_on_in_the_same_conversation_when_its_link_comes_back() -> None:
    robot, _ = owned()
    for name in ("PATH", "ARM", "FIX", "START"):
        assert heard(robot, encoded(robot, name, 100 + len(name))) == "OK"
    end_by_lost_link(robot)
    robot.tick(robot.now_us + 1_500_000)
    assert robot.fix(0.05) == "OK" and robot.state() == "RUNNING"


@pytest.mark.parametrize("rate_hz", [15, 30, 60, 100])
@pytest.mark.parametrize("name", sorted(set(GUARDED) - {"FIX"}))
def test_a_command_that_is_sent_again_is_heard_beside_any_camera(name: str, rate_hz: int) -> None:
    """Its first sendings are lost, or their answers are, for longer than a host tries."""
    robot, _ = owned()
    first = encoded(robot, name)
    lost = []
    for number in range(3 * rate_hz):
        lost.append(encoded(robot, "FIX", number & 0xFF))
        assert robot.fix(0.1 + 1e-4 * number) == "OK"
        robot.tick(robot.now_us + 1_000_000 // rate_hz)
    answer = heard(robot, first)
    assert answer not in ("MAC", "AUTH")
    if name == "KEY":
        return  # it has no owner now
    for number in range(3 * rate_hz):
        robot.fix(0.1 - 1e-4 * number)
        robot.tick(robot.now_us + 1_000_000 // rate_hz)
    assert heard(robot, first) == answer and robot.ask("STATUS")["repeats"] == 1
    assert {heard(robot, frame) for frame in lost[-40:-32]} == {"MAC"}, "fixes that were lost are too old"


@pytest.mark.parametrize("state", ["DISARMED", "ARMED", "FAULT"])
def test_what_strangers_send_does_not_push_the_owner_s_records_out(state: str) -> None:
    """They may send STOP and DISARM as long as they like, and each still switches off."""
    robot, _ = owned()
    log = Log()
    log.memory.magic = 0
    robot.core.fk_robot_use_log(robot.memory, log.memory)
    for place, name in enumerate(("PATH", "ARM", "FIX", "START")):
        assert heard(robot, encoded(robot, name, 60 + place)) == "OK"
    robot.tick()
    assert robot.run_until(robot.now_us + 300_000)
    assert robot.status("STOP") == "OK"
    if state == "DISARMED":
        assert robot.status("DISARM") == "OK"
    elif state == "FAULT":
        robot.core.fk_robot_note_clock_failed(robot.memory)
    robot.tick(robot.now_us + 1000)
    before = log.read()
    names = ("STOP", "DISARM") if state != "ARMED" else ("STOP",)
    for number in range(3000):
        robot.raw(pack_frame(names[number % len(names)], "command", number & 0xFF)[:-1])
        (answer,) = robot.take()
        assert answer.values["state"] == link_layout().state[state]
        out = robot.tick(robot.now_us + 1000)
        assert out.all_off == (names[number % len(names)] == "DISARM") and out.limb_mask == 0
    assert log.read() == before
    if state == "ARMED":
        robot.auth = challenge(robot)
        assert robot.stroke("A") == "OK"
        robot.auth = None
        assert robot.status("STOP") == "OK" and robot.tick(robot.now_us + 1000).limb_mask == 0
        assert robot.status("DISARM") == "OK" and robot.tick().all_off == 1
        (records,) = [[record for record in log.records() if record.offset >= len(before[1])]]
        assert [r.command or r.name for r in records] == [
            "STROKE", "STROKE", "STOP", "DROPPED", "DISARM", "STATE", "OFF",
        ]  # fmt: skip


def test_a_stranger_s_stop_between_the_halves_of_a_stroke_is_logged() -> None:
    """It changes something: the second limbs do not fire."""
    robot, _ = owned()
    log = Log()
    log.memory.magic = 0
    robot.core.fk_robot_use_log(robot.memory, log.memory)
    actions = open_image(OLD).actions
    halves = next(number for number, row in enumerate(actions) if row.first_mask and row.second_mask)
    assert robot.status("ARM") == robot.status("STROKE", {"action": halves}) == "OK"
    assert robot.tick(robot.now_us + 1000).limb_mask == actions[halves].first_mask
    robot.auth = None
    assert robot.status("STOP") == robot.status("STOP") == "OK"
    assert robot.run_until(robot.now_us + 1_000_000) == []
    assert robot.status("DISARM") == robot.status("DISARM") == "OK"  # the first one has not yet switched off
    assert robot.tick().all_off == 1 and robot.status("DISARM") == "OK"
    logged = [record.command for record in log.records()]
    assert (logged.count("STOP"), logged.count("DISARM")) == (1, 2)


@pytest.mark.parametrize("seed", range(cases(3, 30)))
def test_what_an_owner_and_strangers_did_is_decided_again(seed: int) -> None:
    """What is not logged has changed nothing, or the replay would differ from the log."""
    dice = random.Random(seed)
    robot, _ = owned()
    robot._log = log = Log()
    log.memory.magic = 0
    robot.core.fk_robot_use_log(robot.memory, log.memory)
    said = set[str]()
    for _ in range(150):
        name = dice.choice(
            ["ARM", "ARM", "PATH", "START", "PARAM", "STROKE", "STROKE", "FIX", "FIX", "stranger"]
        )
        if name == "stranger":
            for _ in range(dice.randint(1, 4)):
                robot.raw(
                    pack_frame(dice.choice(["STOP", "STOP", "DISARM"]), "command", dice.randrange(256))[:-1]
                )
                robot.tick(robot.now_us + dice.choice([0, 100, 30_000]))
            robot.take()
        elif name == "FIX":
            said.add(robot.fix(1e-8 * robot.now_us + dice.gauss(0.0, 2e-4)))
        else:
            said.add(robot.status(name, GUARDED[name], ROWS.get(name, ())))
        if "MAC" in said:
            robot.auth = challenge(robot) or robot.auth
            said.discard("MAC")
        robot.run_until(robot.now_us + dice.choice([0, 100, 30_000, 200_000]))
    assert {"OK", "STATE"} <= said
    reported = replay_log(fetched(robot), library(), [open_image(OLD)])
    assert reported.mismatches == [] and reported.replayed > 100
