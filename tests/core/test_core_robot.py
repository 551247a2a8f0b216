"""The robot through its frames: every state times every command, and what each answers."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import pytest
from cobs import cobs
from tests.core.core import ACTION, FFI, PERIOD_US, RESTING, STATE, Robot, bits, cases, core, decode, image

from frogkick.core.weights import WEIGHTS
from frogkick.link.auth import words
from frogkick.link.frames import hello
from frogkick.link.layout import AUTH_BIT, EVENT_BIT, Value, link_layout
from frogkick.planner.plan import PlanConfig
from frogkick.runs.decision import LIMB_USE_FIELDS
from frogkick_codegen.native import NativeLibrary

STATES = ("DISARMED", "ARMED", "RUNNING", "FAULT")
POSE: dict[str, Value] = {"x_m": 0.1, "y_m": 0.02, "heading_rad": 0.1}
MOTION: dict[str, Value] = {"vx_mps": 0.02, "vy_mps": 0.0, "omega_rad_s": 0.1}
RESTED: dict[str, Value] = dict.fromkeys(LIMB_USE_FIELDS, 0) | {"along_points": 0.0}
FIX: dict[str, Value] = {"fix_sequence": 8, "quality": 1, "capture_age_us": 0, **POSE, "y_m": 0.002}
Rows = Sequence[Sequence[Value]]

# command: values, rows, then (status, next state) from each state; with a path.
TABLE: dict[str, tuple[dict[str, Value], Rows, tuple[tuple[str, str], ...]]] = {
    "HELLO": (hello(), (), (("OK", "DISARMED"), ("OK", "ARMED"), ("OK", "RUNNING"), ("OK", "FAULT"))),
    "ARM": ({}, (), (("OK", "ARMED"), ("OK", "ARMED"), ("STATE", "RUNNING"), ("FAULT", "FAULT"))),
    "DISARM": ({}, (), (("OK", "DISARMED"), ("OK", "DISARMED"), ("OK", "DISARMED"), ("FAULT", "FAULT"))),
    "FIX": (FIX, (), (("OK", "DISARMED"), ("OK", "ARMED"), ("OK", "RUNNING"), ("FAULT", "FAULT"))),
    "PATH": (
        {"first": 0, "total": 2, "count": 2},
        [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)],
        (("OK", "DISARMED"), ("OK", "ARMED"), ("OK", "RUNNING"), ("FAULT", "FAULT")),
    ),
    "START": (
        {"delay_us": 500_000}, (),
        (("STATE", "DISARMED"), ("OK", "RUNNING"), ("STATE", "RUNNING"), ("FAULT", "FAULT")),
    ),
    "STOP": ({}, (), (("OK", "DISARMED"), ("OK", "ARMED"), ("OK", "ARMED"), ("FAULT", "FAULT"))),
    "STATUS": ({}, (), (("OK", "DISARMED"), ("OK", "ARMED"), ("OK", "RUNNING"), ("OK", "FAULT"))),
    "PARAM": (
        {"parameter": 1, "value": 2}, (),
        (("OK", "DISARMED"), ("OK", "ARMED"), ("STATE", "RUNNING"), ("FAULT", "FAULT")),
    ),
    "STROKE": (
        {"action": ACTION["B"]}, (),
        (("STATE", "DISARMED"), ("OK", "ARMED"), ("STATE", "RUNNING"), ("FAULT", "FAULT")),
    ),
    "PLAN": (
        {"depth": 1, **POSE, **MOTION, **RESTED}, (),
        (("OK", "DISARMED"), ("OK", "ARMED"), ("STATE", "RUNNING"), ("FAULT", "FAULT")),
    ),
}  # fmt: skip
# Without a store of tables; test_core_table_commands.py has one.
BEGIN: dict[str, Value] = {"length": 400, **{f"hash_{place}": 0 for place in range(8)}}
UNKNOWN = tuple(("UNKNOWN", state) for state in STATES)
for _name, _values in (
    ("TABLE_BEGIN", BEGIN), ("TABLE_CHUNK", {"offset": 0}), ("TABLE_COMMIT", {}),
    ("TABLE_ROLLBACK", {"table_crc": 0}), ("TABLE_STATUS", {}),
):  # fmt: skip
    TABLE[_name] = (_values, (), UNKNOWN)
TABLE["LOG"] = ({"offset": 0}, (), UNKNOWN)  # without a log; test_core_log.py has one
# Without a store it has no owner; test_core_auth.py has one.
TABLE["KEY"] = (words("key", bytes(32)), (), UNKNOWN)
TABLE["CHALLENGE"] = (
    words("nonce", bytes(16)), (),
    (("AUTH", "DISARMED"), ("AUTH", "ARMED"), ("STATE", "RUNNING"), ("AUTH", "FAULT")),
)  # fmt: skip


def test_the_table_has_every_command() -> None:
    assert set(TABLE) == {name for name, message in link_layout().messages.items() if message.command}
    assert tuple(link_layout().state) == STATES


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("name", TABLE)
def test_every_command_in_every_state(name: str, state: str) -> None:
    values, rows, expected = TABLE[name]
    robot = Robot().begin(state)
    if state in ("DISARMED", "ARMED"):
        robot.path()
        assert name != "START" or robot.fix() == "OK"
    answer = robot.ask(name, values, rows)
    status, next_state = expected[STATES.index(state)]
    assert link_layout().status_name(int(answer["status"])) == status
    if name in ("ARM", "DISARM", "STOP", "STATUS"):
        assert answer["state"] == STATE[next_state]
    assert robot.state() == next_state


def test_boots_disarmed_with_everything_off() -> None:
    robot = Robot()
    assert robot.error == 0
    out = robot.tick()
    assert (out.all_off, out.limb_mask, out.next_tick_us) == (1, 0, 2**64 - 1)
    assert robot.tick().all_off == 0
    assert robot.state() == "DISARMED"
    assert robot.stroke("B") == "STATE"
    assert robot.tick().limb_mask == 0
    answer = robot.ask("HELLO")
    assert (answer["protocol_version"], answer["robot_id"], answer["period_us"]) == (7, "frog2022", PERIOD_US)
    assert (answer["states"], answer["actions"], answer["limbs"], answer["pulse_us"]) == (60, 7, 4, 80_000)
    assert answer["table_crc"] == zlib.crc32(robot.image[16:])


def raw_frame(kind: int, payload: bytes) -> bytes:
    raw = bytes([kind, 77]) + payload
    return bytes(cobs.encode(raw + struct.pack("<I", zlib.crc32(raw))))


@pytest.mark.parametrize("state", STATES)
def test_unknown_types_are_answered(state: str) -> None:
    robot = Robot().begin(state)
    known = {message.id for message in link_layout().messages.values() if message.command}
    for kind in set(range(EVENT_BIT)) - known:
        robot.raw(raw_frame(kind, b"\1\2"))
        answer = decode(robot.take_bytes()[:-1])
        has_code = kind & AUTH_BIT != 0  # of a robot that knows none
        status = link_layout().status["MAC" if has_code else "UNKNOWN"]
        assert answer == ((kind & ~AUTH_BIT if has_code else kind) | 0x80, 77, struct.pack("b", status))
    assert robot.state() == state


def test_an_answer_and_an_event_are_no_commands() -> None:
    """An echo on the line must not make the robot answer its own answers for ever, nor pass for a host."""
    robot = Robot().begin("ARMED")
    robot.now_us += 10**6
    for kind in range(EVENT_BIT, 0x100):
        robot.raw(raw_frame(kind, b""))
        assert robot.take_bytes() == b""
    assert robot.tick(robot.now_us + 4_000_000).all_off, "it heard nobody for 5 s"
    assert robot.ask("STATUS")["frames_bad"] == 192


@pytest.mark.parametrize("state", STATES)
def test_wrong_lengths_are_answered(state: str) -> None:
    robot = Robot().begin(state)
    for name, message in link_layout().messages.items():
        payload = message.command
        if payload is None:
            continue
        for size in range(40):
            fits = size == payload.bytes
            # A PATH in a fault is refused for that, whatever its rows; a shorter one has no head to read.
            fits |= name == "PATH" and state == "FAULT" and size >= payload.bytes
            fits |= name == "TABLE_CHUNK" and size >= payload.bytes  # the store counts the rest
            fits |= name == "HELLO"  # of any length: see the versions
            if not fits:
                robot.raw(raw_frame(message.id, bytes(size)))
                answer = decode(robot.take_bytes()[:-1])
                assert answer is not None and answer[:2] == (message.id | 0x80, 77)
                status = struct.unpack("b", answer[2][:1])[0]
                assert status == link_layout().status["LENGTH"], f"{name} of {size} bytes"
    assert robot.state() == state


@pytest.mark.parametrize(
    ("part", "status"),
    [
        ((0, 20, 0), "LENGTH"),
        ((0, 20, 19), "LENGTH"),
        ((0, 20, 17), "LENGTH"),
        ((0, 1, 1), "VALUE"),
        ((0, 101, 2), "VALUE"),
        ((0, 1, 2), "VALUE"),
        ((1, 20, 2), "VALUE"),
        ((19, 20, 2), "VALUE"),
        ((255, 20, 1), "VALUE"),
    ],
)
def test_a_bad_part_of_a_path_is_refused(part: tuple[int, int, int], status: str) -> None:
    first, total, number = part
    rows = [(0.0, 0.0, 0.0)] * (18 if number == 17 else min(number, 18))
    robot = Robot().begin("ARMED")
    assert robot.status("PATH", {"first": first, "total": total, "count": number}, rows) == status
    assert robot.start() == "NO_PATH"
    # A path that was whole before stays whole: the robot refuses a part by its head and takes nothing.
    robot.path()
    assert robot.status("PATH", {"first": first, "total": total, "count": number}, rows) == status
    assert robot.fix() == robot.start() == "OK"


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1000.1, -1000.1])
@pytest.mark.parametrize("column", [0, 1, 2])
def test_a_path_with_a_bad_point_is_no_path(bad: float, column: int) -> None:
    """Its first rows stand in the place of the old path's by then: neither may be followed."""
    row = [0.0, 0.0, 0.0]
    row[column] = bad
    robot = Robot().begin("ARMED")
    robot.path()
    answer = robot.ask(
        "PATH", {"first": 0, "total": 20, "count": 3}, [(5.0, 5.0, 0.0), tuple(row), (0, 0, 0)]
    )
    assert answer == {"status": link_layout().status["VALUE"], "received": 0}
    assert robot.start() == "NO_PATH"
    assert robot.status("PLAN", {"depth": 1, **POSE, **MOTION, **RESTED}) == "NO_PATH"
    robot.path()
    assert robot.fix() == robot.start() == "OK"


def test_a_path_in_parts() -> None:
    robot = Robot().begin("ARMED")
    robot.path()
    rows = [(0.0, 0.0, 4.0)] * 18

    def part(first: int, total: int, number: int) -> tuple[int, int]:
        answer = robot.ask("PATH", {"first": first, "total": total, "count": number}, rows[:number])
        return int(answer["status"]), int(answer["received"])

    assert part(0, 100, 18) == (0, 18)
    assert robot.start() == "NO_PATH", "a part of the new path is not the old path"
    assert part(0, 100, 18) == (0, 18), "the first part again starts over"
    assert part(36, 100, 18)[0] == link_layout().status["VALUE"], "a part is missing"
    assert part(18, 99, 18)[0] == link_layout().status["VALUE"], "another path's part"
    for first in (18, 36, 54, 72):
        assert part(first, 100, 18) == (0, first + 18)
    assert robot.start() == "NO_PATH"
    assert part(90, 100, 10) == (0, 100)
    assert part(100, 100, 1)[0] == link_layout().status["VALUE"]
    assert robot.fix() == robot.start() == "OK"


def test_parameters_and_their_limits() -> None:
    robot = Robot().begin("ARMED")

    def status(name: str, value: float) -> str:
        return robot.status("PARAM", {"parameter": link_layout().parameter[name], "value": value})

    for value, wanted in [(1, "OK"), (4, "OK"), (0, "VALUE"), (0.99, "VALUE"), (5, "VALUE"), (2.5, "VALUE")]:
        assert status("DEPTH", value) == wanted, value
    period = {
        500_000: "OK",
        5_000_000: "OK",
        499_999: "VALUE",
        5_000_001: "VALUE",
        500_000.5: "VALUE",
        -1: "VALUE",
    }
    for value, wanted in period.items():
        assert status("PERIOD_US", value) == wanted, value
    assert robot.ask("HELLO")["period_us"] == 5_000_000
    for value, wanted in [(0, "OK"), (1, "OK"), (2, "VALUE"), (0.5, "VALUE"), (-1, "VALUE")]:
        assert status("COST", value) == wanted, value
    for name, most in (("PLAN_TIME_US", 1e6), ("TRANSITIONS_MAX", 1e7)):
        for value, wanted in [(most, "OK"), (0, "OK"), (-1, "VALUE"), (most + 1, "VALUE"), (0.5, "VALUE")]:
            assert status(name, value) == wanted, (name, value)
    for value, wanted in [(2, "OK"), (0, "OK"), (2.0001, "VALUE"), (-0.1, "VALUE")]:
        assert status("TURN_LEAD", value) == status("GLIDE_LEAD", value) == wanted, value
    for name in (
        "DISTANCE_WEIGHT_PER_M", "ANGLE_WEIGHT_PER_RAD", "COURSE_WEIGHT_PER_M", "PROGRESS_WEIGHT",
        "PROGRESS_WEIGHT_PER_M", "LOOK_AHEAD_M", "SOFT_DISTANCE_M", "GLIDE_WEIGHT_PER_M", "LEVEL_WEIGHT",
    ):  # fmt: skip
        for value, wanted in [(0, "OK"), (-0.0, "OK"), (1e6, "OK"), (-1e-9, "VALUE"), (1000001.0, "VALUE")]:
            assert status(name, value) == wanted
    for name in link_layout().parameter:
        for value in (np.nan, np.inf, -np.inf):
            assert status(name, value) == "VALUE"
    robot.path()
    answer = robot.ask("PLAN", {"depth": 1, **POSE, **MOTION, **RESTED})
    assert answer["status"] == 0, "what PARAM takes, the planner takes"
    for parameter in (0, 24, 255):
        assert robot.status("PARAM", {"parameter": parameter, "value": 1.0}) == "VALUE"


def test_a_period_shorter_than_a_stroke_is_refused() -> None:
    """Else a decision would take the place of the second limbs of the stroke before it."""
    robot = Robot(image(second_delay_us=600_000)).begin("ARMED")
    parameter = link_layout().parameter["PERIOD_US"]
    # Second limbs at 601 ms, on for 80 ms, and the pulse timer's millisecond.
    assert robot.status("PARAM", {"parameter": parameter, "value": 681_999.0}) == "VALUE"
    assert robot.status("PARAM", {"parameter": parameter, "value": 682_000.0}) == "OK"


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"robot_id": "frog2023"}, "ROBOT"),
        ({"robot_id": "frog202"}, "ROBOT"),
        ({"pulse_us": 100_001}, "IMAGE_TIMES"),
        ({"second_delay_us": 1_400_000}, "IMAGE_TIMES"),
        ({"pulse_us": 90_000, "second_delay_us": 0, "period_us": 181_999}, "IMAGE_TIMES"),
    ],
)
def test_a_table_that_this_robot_cannot_use_is_refused(changes: dict[str, object], name: str) -> None:
    numbers = {"ROBOT": -9, "IMAGE_TIMES": -29}
    assert Robot(image(**changes)).error == numbers[name]


def test_a_damaged_table_is_refused() -> None:
    table = bytearray(image())
    table[500] ^= 1
    assert Robot(bytes(table)).error == -25
    assert Robot(image(pulse_us=100_000)).error == 0


def test_status_counts() -> None:
    robot = Robot().begin("ARMED")
    assert robot.fix(fix_sequence=3) == "OK"
    assert robot.fix(fix_sequence=3) == "DOUBLE"
    assert robot.fix(quality=0) == "VALUE"
    robot.raw(b"\x05abc")
    robot.raw(b"")
    assert robot.stroke("A") == "OK"
    assert robot.tick().limb_mask == 0b0011
    robot.now_us += 200_000
    assert robot.stroke("A") == "OK"
    assert robot.tick().limb_mask == 0
    status = robot.ask("STATUS")
    assert status["now_us"] == robot.now_us
    counters = ("fixes_used", "fixes_refused", "frames_bad", "pulses", "pulses_refused", "answers_dropped")
    assert [status[name] for name in counters] == [1, 2, 2, 1, 1, 0]


def test_fixes() -> None:
    robot = Robot(now_us=1_000_000).begin("ARMED")
    for pose in ((np.nan, 0, 0), (0, np.inf, 0), (0, 0, np.nan), (1000.1, 0, 0), (0, 0, 1001)):
        robot.now_us += 1000
        assert robot.fix(*pose) == "RANGE"
    assert robot.fix(capture_age_us=2_000_001) == "VALUE"
    assert robot.fix(capture_age_us=0xFFFFFFFF) == "VALUE"
    answer = robot.ask("FIX", {**FIX, "fix_sequence": 65_535, "capture_age_us": 400_000})
    assert answer == {"status": 0, "fix_sequence": 65_535, "capture_us": robot.now_us - 400_000}
    assert robot.fix(capture_age_us=400_001) == "OLD", "from before the first one"
    assert robot.fix(0.1, 0.002, 0.1, capture_age_us=350_000) == "OK"
    assert robot.fix(0.1, 0.002, 0.1, capture_age_us=370_000) == "OK", "out of order"
    assert robot.fix(0.4) == robot.fix(0.401) == "OUTLIER"
    assert robot.ask("STATUS")["restarts"] == 0
    assert robot.fix(0.402) == "OK", "three that agree are believed"
    assert robot.ask("STATUS")["restarts"] == 1


def test_a_fix_from_before_the_clock_began_is_refused() -> None:
    """Its time on the robot's clock would have to be invented."""
    robot = Robot(now_us=300_000).begin("ARMED")
    assert robot.fix(capture_age_us=300_001) == "VALUE"
    assert robot.ask("FIX", {**FIX, "capture_age_us": 300_000})["capture_us"] == 0


PARAMETERS = link_layout().parameter


@pytest.mark.parametrize("cost", [0, 1])
@pytest.mark.parametrize("depth", [0, 1, 2, 3, 4, 5])
def test_plan_gives_the_planner_s_bits(depth: int, cost: int) -> None:
    robot = Robot().begin("ARMED")
    rng = np.random.default_rng(depth)
    rows = np.column_stack(
        [np.linspace(0, 1, 18), 0.1 * np.sin(np.arange(18)), rng.uniform(-3, 3, 18)]
    ).astype(np.float32)
    assert robot.status("PATH", {"first": 0, "total": 18, "count": 18}, rows.tolist()) == "OK"
    values = (400, 33, 250, 0.7, 310, 0.12, 0.02, 0.5, 55, 240, 0.8, 290, 3.2, -0.4, 0.6, -0.1, 0.2)
    weights = dict(zip(WEIGHTS, values, strict=True))
    config = PlanConfig(**weights, depth=depth, cost=cost, transitions_max=70)
    for name, value in asdict(config).items():
        if name != "depth":
            assert robot.status("PARAM", {"parameter": PARAMETERS[name.upper()], "value": value}) == "OK"
    states = rng.normal(0, [0.5, 0.2, 2, 0.02, 0.02, 0.3], (cases(300, 3000), 6)).astype(np.float32)
    states[0, 3] = np.nan
    states[1 % len(states), 0] = 1001.0
    uses = np.random.default_rng(depth).integers(0, 32768, (len(states), 8))
    names = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_rad_s")

    class Columns:
        x_m, y_m, tangent_rad = rows.T

    along = rng.uniform(0, 17, len(states)).astype(np.float32)
    wanted = NativeLibrary().plan_batch(
        robot.image, Columns, config, states, limb_use=uses, along_points=along
    )
    for state, use, place, row in zip(states, uses, along, wanted, strict=True):
        asked: dict[str, Value] = {"depth": depth, "along_points": float(place)}
        asked |= {name: float(value) for name, value in zip(names, state, strict=True)}
        asked |= {name: int(limb) for name, limb in zip(LIMB_USE_FIELDS, use, strict=True)}
        answer = robot.ask("PLAN", asked)
        assert answer["status"] == row["status"]
        for name in ("action", "nearest_state", "path_index", "depth_reached", "transitions"):
            assert answer[name] == row[name]
        assert [answer[name] for name in LIMB_USE_FIELDS] == row["predicted_limb_use"].tolist()
        floats = ("cost", "distance_m", "along_points")
        found = [answer[name] for name in (*floats, *names)]
        assert [bits(float(value)) for value in found] == [
            bits(float(value)) for value in (*(row[name] for name in floats), *row["predicted"])
        ]
    # PLAN's depth is its own: the decision's is still the default.
    assert wanted["status"][2:].any() == (depth in (0, 5))


def test_what_does_not_fit_the_buffer_is_dropped_whole() -> None:
    robot = Robot().begin("ARMED")
    for _ in range(100):
        robot.post("STATUS")
    frames = robot.take()
    assert [frame.name for frame in frames] == ["STATUS"] * len(frames)
    assert [frame.sequence for frame in frames] == list(range(2, 2 + len(frames)))
    assert robot.ask("STATUS")["answers_dropped"] == 100 - len(frames)
    assert 5 < len(frames) < 100


def test_what_the_port_could_not_send_is_counted_too() -> None:
    robot = Robot().begin("ARMED")
    robot.core.fk_robot_note_frames_dropped(robot.memory, 3)
    robot.core.fk_robot_note_frames_dropped(robot.memory, 0)
    assert robot.ask("STATUS")["answers_dropped"] == 3


@pytest.mark.parametrize("capacity", [256, 300, 1024])
def test_a_port_that_takes_few_bytes_at_a_time_gets_all_of_them(capacity: int) -> None:
    robot = Robot().begin("ARMED")
    for _ in range(8):
        robot.post("HELLO")
    frames = []
    while part := robot.take(capacity):
        frames += part
    while len(frames) < 8:
        frames += robot.take(capacity)
    assert [frame.sequence for frame in frames] == list(range(2, 10))
    assert robot.take_bytes(0) == b"" == robot.take_bytes()


def test_the_resting_action_is_the_first_without_limbs() -> None:
    robot = Robot().begin("RUNNING")
    robot.run_until(robot.now_us + 1_600_000)
    decisions = [frame.values for frame in robot.take() if frame.name == "DECISION"]
    assert decisions[0]["status"] == link_layout().status["STALE"]
    assert decisions[0]["action"] == RESTING
    rows = [("A", 1, 0), ("B", 2, 0)]
    robot = Robot(image(action_rows=rows)).begin("RUNNING")
    assert robot.run_until(robot.now_us + 1_600_000) == []
    assert robot.take()[-1].values["action"] == len(rows), "none of the table's"


def test_the_robot_s_size_is_what_the_port_must_hold() -> None:
    size = FFI.sizeof("fk_robot_t")
    held = FFI.new("uint8_t[]", b"\xa5" * (size + 64))
    memory = FFI.cast("fk_robot_t *", held)
    table = image()
    kept = FFI.new("uint64_t[]", (len(table) + 7) // 8)
    FFI.memmove(kept, table, len(table))
    assert core().fk_robot_init(memory, FFI.cast("uint8_t *", kept), len(table)) == 0
    core().fk_robot_on_frame(memory, raw_frame(1, b""), len(raw_frame(1, b"")), 5)
    assert bytes(FFI.buffer(held))[size:] == b"\xa5" * 64 + b"\0"
