"""The supervisor's table is the code and the documentation; internal errors end in its FAULT, and stay."""

from __future__ import annotations

import re

import pytest
from tests.core.core import ACTION, ACTION_ROWS, FFI, SILENT_US, Robot, core, image
from tests.core.store_rig import NEW, OLD, Flash
from tests.core.test_core_table_commands import begin_values
from tests.planner import synthetic

from frogkick.link.frames import hello
from frogkick.link.layout import link_layout, supervisor
from frogkick_codegen import frames

RUN = "run: python -m frogkick_codegen.frames"
LAYOUT = link_layout()
FAULT, RESET, STATUS, STATES = LAYOUT.fault, LAYOUT.reset, LAYOUT.status, tuple(LAYOUT.state)
SUPPLY = LAYOUT.supply
TABLE = supervisor()


def test_the_header_is_up_to_date() -> None:
    assert frames.SUPERVISOR_HEADER.read_text(encoding="utf-8") == frames.supervisor_header(), RUN


def test_the_documentation_s_table_is_the_code_s() -> None:
    """Read back from the text that people read, and asked of the C that runs, cell by cell."""
    lines = frames.supervisor_table().splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines if line.startswith("| ")]
    assert rows[0] == ["event", *STATES]
    assert [row[0] for row in rows[1:]] == list(TABLE.docs)
    rule = FFI.new("uint8_t[3]")
    for event, *cells in rows[1:]:
        for state, cell in zip(STATES, cells, strict=True):
            core().fk_test_rule(LAYOUT.state[state], TABLE.number(event), rule)
            parts = [] if cell.strip() == "-" else [part.strip() for part in cell.split(",")]
            refused = [part.removeprefix("refused: ") for part in parts if part.startswith("refused: ")]
            actions = [part for part in parts if part in TABLE.actions]
            moves = [part for part in parts if part in STATES]
            assert len(refused) + len(actions) + len(moves) == len(parts)
            assert rule[0] == LAYOUT.state[moves[0] if moves else state], (event, state)
            assert rule[1] == (list(TABLE.actions).index(actions[0]) if actions else 0), (event, state)
            assert rule[2] == STATUS[refused[0] if refused else "OK"] & 0xFF, (event, state)


def test_every_command_is_an_event() -> None:
    commands = [name for name, message in LAYOUT.messages.items() if message.command]
    assert list(TABLE.docs)[: len(commands)] == commands
    assert set(TABLE.docs) - set(commands) == {
        "PULSE",
        "RUN_OVER",
        "FIX_LOST",
        "ERROR",
        "LINK_LOST",
        "SUPPLY_LOW",
    }


def test_nothing_else_changes_the_state() -> None:
    written = [
        line.strip()
        for path in sorted(frames.HEADER.parent.glob("*.c"))
        for line in path.read_text().splitlines()
        if re.search(r"robot->state\s*=[^=]", line)
    ]
    assert written == ["robot->state = FK_STATE_DISARMED;", "robot->state = rule.next;"]


@pytest.mark.parametrize("number", [4, 5, 77, 255])
def test_a_state_that_is_none_counts_as_a_fault(number: int) -> None:
    rule = FFI.new("uint8_t[3]")
    for event in TABLE.docs:
        core().fk_test_rule(number, TABLE.number(event), rule)
        assert rule[0] == LAYOUT.state["FAULT"]


# Internal errors


def state_and_fault(robot: Robot) -> tuple[str, str, int]:
    values = robot.ask("STATUS")
    names = {number: name for name, number in FAULT.items()}
    return STATES[int(values["state"])], names[int(values["fault"])], int(values["fault_detail"])


def fire_until_fault(robot: Robot) -> None:
    """A stroke under way is cut in the tick that sees the error or the next, and nothing begins again."""
    out = robot.tick()
    out = out if out.all_off else robot.tick(max(robot.now_us, min(out.next_tick_us, robot.now_us + 1)))
    assert out.all_off == 1 and out.limb_mask == 0
    for _ in range(50):
        robot.now_us += 100_000
        for name in ("ARM", "STOP", "DISARM"):
            assert robot.status(name) == "FAULT"
        assert robot.stroke("B") == "FAULT"
        assert robot.tick().limb_mask == 0


@pytest.mark.parametrize("state", ["DISARMED", "ARMED", "RUNNING"])
def test_a_clock_that_goes_back(state: str) -> None:
    robot = Robot().begin(state)
    if state == "ARMED":
        assert robot.stroke("B") == "OK"
        assert robot.tick().limb_mask == 0b0011
    robot.tick(robot.now_us + 1000)
    robot.now_us -= 1
    assert state_and_fault(robot) == ("FAULT", "TIME", 0)
    robot.now_us += 1
    fire_until_fault(robot)
    assert state_and_fault(robot) == ("FAULT", "TIME", 0), "latched"


def test_a_clock_that_goes_back_between_two_ticks() -> None:
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    assert robot.tick().limb_mask == 0b0011
    out = robot.tick(robot.now_us - 1)
    assert (out.all_off, out.limb_mask) == (1, 0), "at once"
    robot.now_us += 1
    assert state_and_fault(robot) == ("FAULT", "TIME", 0)


@pytest.mark.parametrize("number", [3, 4, 200])
def test_a_state_that_nobody_set(number: int) -> None:
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    core().fk_test_spoil_robot(robot.memory, number, -1)
    if number == STATES.index("FAULT"):
        assert robot.tick().limb_mask == 0, "no pulse, though a stroke was asked for"
        return
    fire_until_fault(robot)
    assert state_and_fault(robot) == ("FAULT", "STATE", 0)


def test_a_disarmed_robot_with_a_stroke_asked_for_does_not_fire() -> None:
    """As damaged memory could have it: the supervisor refuses the pulse before the guard is asked."""
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    core().fk_test_spoil_robot(robot.memory, STATES.index("DISARMED"), -1)
    assert robot.run_until(robot.now_us + 500_000) == []
    assert robot.ask("STATUS")["pulses_refused"] == 1


@pytest.mark.parametrize("action", [len(ACTION_ROWS) + 1, 100, 254])
def test_an_action_that_the_table_lacks(action: int) -> None:
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    core().fk_test_spoil_robot(robot.memory, -1, action)
    fire_until_fault(robot)
    assert state_and_fault(robot) == ("FAULT", "ACTION", 0)


def test_a_pulse_that_the_port_could_not_start() -> None:
    robot = Robot().begin("RUNNING")
    core().fk_robot_note_pulse_failed(robot.memory, -2)
    fire_until_fault(robot)
    assert state_and_fault(robot) == ("FAULT", "PULSE", -2)
    core().fk_robot_note_pulse_failed(robot.memory, -1)
    assert state_and_fault(robot) == ("FAULT", "PULSE", -2), "the first error is the one that is told"


@pytest.mark.parametrize("state", ["DISARMED", "ARMED", "RUNNING"])
def test_a_port_s_clock_that_is_not_exact(state: str) -> None:
    """Off, and it stays off; however often the port says so, it asks for nothing without end."""
    robot = Robot().begin(state)
    robot.tick()
    core().fk_robot_note_clock_failed(robot.memory)
    assert robot.status("ARM") == "FAULT"
    assert robot.tick().all_off == 1
    core().fk_robot_note_clock_failed(robot.memory)
    assert robot.tick().all_off == 0
    assert state_and_fault(robot) == ("FAULT", "CLOCK", 0)


def test_an_armed_robot_that_hears_nothing_disarms() -> None:
    """An hour later nobody expects it to fire; whatever a host says keeps it armed."""
    robot = Robot().begin("ARMED")
    for _ in range(3):
        robot.run_until(robot.now_us + SILENT_US - 1)
        assert state_and_fault(robot) == ("ARMED", "NONE", 0)
    heard_us = robot.now_us
    out = robot.tick()
    assert out.next_tick_us == heard_us + SILENT_US, "it wakes for it"
    assert robot.tick(heard_us + SILENT_US - 1).all_off == 0
    assert robot.tick(heard_us + SILENT_US).all_off == 1
    assert state_and_fault(robot) == ("DISARMED", "NONE", 0)
    assert robot.stroke("B") == "STATE"
    assert robot.status("ARM") == "OK"


def test_a_command_after_an_hour_of_silence_finds_it_disarmed() -> None:
    robot = Robot().begin("ARMED")
    robot.now_us += 3_600_000_000
    assert robot.stroke("B") == "STATE"
    assert robot.run_until(robot.now_us + 1_000_000) == []


@pytest.mark.parametrize(
    ("state", "then"), [("ARMED", "DISARMED"), ("RUNNING", "RUNNING"), ("FAULT", "FAULT")]
)
def test_a_connection_that_ends(state: str, then: str) -> None:
    """A run outlives a short one, as its fixes tell; nothing else stays armed."""
    robot = Robot().begin(state)
    core().fk_robot_note_link_lost(robot.memory)
    assert robot.state() == then


@pytest.mark.parametrize(
    ("state", "then"),
    [("DISARMED", "DISARMED"), ("ARMED", "DISARMED"), ("RUNNING", "DISARMED"), ("FAULT", "FAULT")],
)
def test_a_supply_that_falls(state: str, then: str) -> None:
    """Off at once, and a run says why it ended; ARM is refused until the supply is well again."""
    robot = Robot().begin(state)
    assert robot.ask("STATUS")["supply"] == SUPPLY["OK"]
    robot.tick()
    robot.take()
    for _ in range(3):  # as often as the port likes
        core().fk_robot_note_supply(robot.memory, 1)
    assert robot.tick().all_off == (state in ("ARMED", "RUNNING"))
    ended = [frame.values for frame in robot.take() if frame.name == "ENDED"]
    assert [values["status"] for values in ended] == ([STATUS["SUPPLY"]] if state == "RUNNING" else [])
    assert (robot.state(), robot.ask("STATUS")["supply"]) == (then, SUPPLY["LOW"])
    assert robot.status("ARM") == ("FAULT" if state == "FAULT" else "SUPPLY")
    assert robot.stroke("B") != "OK" and robot.state() == then
    for _ in range(3):
        core().fk_robot_note_supply(robot.memory, 0)
    assert robot.ask("STATUS")["supply"] == SUPPLY["FELL"], "whoever asks later hears of it"
    assert robot.status("ARM") == ("FAULT" if state == "FAULT" else "OK")
    assert robot.ask("STATUS")["supply"] == SUPPLY["FELL" if state == "FAULT" else "OK"]
    assert robot.run_until(robot.now_us + 100_000) == []


def test_a_supply_that_falls_in_the_middle_of_a_stroke() -> None:
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    assert robot.tick().limb_mask == 0b0011
    robot.now_us += 40_000
    core().fk_robot_note_supply(robot.memory, 1)
    assert robot.tick().all_off == 1
    assert robot.run_until(robot.now_us + 1_000_000) == [], "nor its second limbs"


def test_an_open_update_of_the_table_comes_before_the_supply() -> None:
    """ARM says why it is refused: what the host began itself first."""
    robot, flash = Robot(OLD, 0), Flash(built_in=OLD)
    robot.use_store(flash)
    robot.tick(600_000)
    core().fk_robot_note_supply(robot.memory, 1)
    assert robot.status("ARM") == "SUPPLY"
    assert robot.ask("TABLE_BEGIN", begin_values(NEW))["status"] == 0
    assert robot.status("ARM") == "STATE"


LATE = -16
"""FK_PULSE_LATE"""


def test_a_pulse_that_the_port_is_too_late_for_is_a_refused_stroke() -> None:
    """The first half: none of it happens. The limbs' time on is not used up, and the next stroke goes."""
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    out = robot.tick()
    assert (out.limb_mask, out.next_tick_us > robot.now_us) == (0b0011, True)
    robot.take()
    core().fk_robot_note_pulse_failed(robot.memory, LATE)
    assert robot.run_until(robot.now_us + 1_000_000) == [], "no second half"
    assert [(frame.name, frame.values["action"]) for frame in robot.take()] == [("REFUSED", ACTION["B"])]
    assert state_and_fault(robot) == ("ARMED", "NONE", 0)
    counts = robot.ask("STATUS")
    assert (counts["pulses"], counts["pulses_refused"]) == (0, 1)
    assert robot.stroke("B") == "OK"
    assert [mask for _, mask in robot.run_until(robot.now_us + 1_000_000)] == [0b0011, 0b1100]


@pytest.mark.parametrize("how", ["refused", "late", "disarmed", "swum"])
def test_a_stroke_without_first_limbs_has_not_begun_before_its_second_ones(how: str) -> None:
    """Nothing of it happens where they do not fire: it is refused, and the next stroke goes."""
    rows = [("A", 0b0011, 0b1100), ("B", 0, 0b1100), ("I", 0, 0)]
    robot = Robot(synthetic.pack(*synthetic.transitions(20, 3, 1), action_rows=rows)).begin("ARMED")
    fires = [0b1100]
    if how == "refused":
        assert robot.stroke("A") == "OK" and len(robot.run_until(robot.now_us + 300_000)) == 2
        fires = []
    pulses = robot.ask("STATUS")["pulses"]
    robot.take()
    assert robot.stroke("B") == "OK"
    out = robot.tick()
    assert (out.limb_mask, robot.stroke("A")) == (0, "STATE")
    if how == "disarmed":
        assert robot.status("DISARM") == "OK"
        assert robot.run_until(robot.now_us + 1_000_000) == [] and robot.begin("ARMED")
    else:
        out = robot.tick(out.next_tick_us)
        assert [out.limb_mask] == (fires or [0])
        if how == "late":
            core().fk_robot_note_pulse_failed(robot.memory, LATE)
    told_of = [(frame.name, frame.values["action"]) for frame in robot.take() if frame.name == "REFUSED"]
    assert told_of == ([("REFUSED", 1)] if how in ("refused", "late") else [])
    assert robot.ask("STATUS")["pulses"] == pulses + (how == "swum")
    robot.run_until(robot.now_us + 1_000_000)
    assert robot.stroke("A") == "OK"
    assert [mask for _, mask in robot.run_until(robot.now_us + 1_000_000)] == [0b0011, 0b1100]


def test_a_second_half_that_is_too_late_is_left_out() -> None:
    robot = Robot().begin("ARMED")
    assert robot.stroke("B") == "OK"
    out = robot.tick()
    assert robot.tick(out.next_tick_us).limb_mask == 0b1100
    core().fk_robot_note_pulse_failed(robot.memory, LATE)
    assert robot.run_until(robot.now_us + 1_000_000) == []
    assert "REFUSED" not in [frame.name for frame in robot.take()]
    assert state_and_fault(robot) == ("ARMED", "NONE", 0)
    counts = robot.ask("STATUS")
    assert (counts["pulses"], counts["pulses_refused"]) == (1, 1)


def test_late_for_a_pulse_that_nobody_asked_for() -> None:
    robot = Robot().begin("ARMED")
    robot.tick()
    core().fk_robot_note_pulse_failed(robot.memory, LATE)
    fire_until_fault(robot)
    assert state_and_fault(robot) == ("FAULT", "PULSE", LATE)


def test_a_table_that_is_refused_is_told() -> None:
    table = bytearray(image())
    table[500] ^= 1
    robot = Robot(bytes(table))
    assert robot.error == -25
    fire_until_fault(robot)
    assert state_and_fault(robot) == ("FAULT", "TABLE", -25)
    values = robot.ask("HELLO")
    assert (values["robot_id"], values["actions"], values["table_crc"]) == ("frog2022", 0, 0)
    rows = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]
    assert robot.status("PATH", {"first": 0, "total": 2, "count": 2}, rows) == "FAULT"
    assert robot.fix() == "FAULT" and robot.ask("STATUS")["fixes_refused"] == 0
    assert robot.start() == "FAULT"


@pytest.mark.parametrize("reason", RESET)
def test_why_it_started_is_told(reason: str) -> None:
    robot = Robot()
    assert robot.ask("STATUS")["reset"] == RESET["UNKNOWN"]
    kept = FFI.new("fk_guard_persistent_t *")
    core().fk_robot_note_reset(robot.memory, RESET[reason], kept)
    assert robot.ask("STATUS")["reset"] == RESET[reason]
    assert robot.state() == "DISARMED"


# Versions and repetitions


def test_another_protocol_is_answered_with_ours() -> None:
    robot = Robot().begin("ARMED")
    for version in set(range(256)) - {LAYOUT.protocol_version}:
        answer = robot.ask("HELLO", {"protocol_version": version})
        assert (answer["status"], answer["protocol_version"]) == (STATUS["VERSION"], LAYOUT.protocol_version)
    assert robot.status("HELLO", hello()) == "OK"


@pytest.mark.parametrize("size", [0, 2, 3, 4, 200])
def test_a_hello_of_any_length_is_answered(size: int) -> None:
    robot = Robot()
    payload = bytes([LAYOUT.protocol_version]) + bytes(size - 1) if size else b""
    robot.raw(encoded("HELLO", 7, payload))
    (frame,) = robot.take()
    assert (frame.name, frame.sequence, frame.values["status"]) == ("HELLO", 7, STATUS["VERSION"])


def encoded(name: str, sequence: int, payload: bytes) -> bytes:
    from tests.core.core import encode

    return encode(LAYOUT.messages[name].id, sequence, payload)[:-1]
