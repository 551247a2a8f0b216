"""The C core as a robot in simulated time: wire, ticks and edges."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from tests.core.core import ACTION, DELAY_US, GAP_US, PERIOD_US, PULSE_US, image

from frogkick.core.errors import FrogkickError, InputError
from frogkick.link.frames import pack_frame
from frogkick.link.layout import Value
from frogkick.link.wire import BYTE_S, Edge
from frogkick.pool.monitor import pulses_of, violations
from frogkick.pool.native_robot import NativeRobot
from frogkick.robot import load_robot
from frogkick_codegen.firmware import build

ROBOT = load_robot("frog2022")
SECOND_S = (DELAY_US + GAP_US) * 1e-6
PULSE_S = PULSE_US * 1e-6


def native(folder: Path, **changes: object) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "test.fkt").write_bytes(image(**changes))
    return build("native", folder / "test.fkt", ROBOT, folder / "out").image


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return native(tmp_path_factory.mktemp("native"))


@pytest.fixture
def robot(shared: Path) -> NativeRobot:
    return NativeRobot(shared, 4)


def command(name: str, sequence: int = 1, **values: Value) -> bytes:
    return pack_frame(name, "command", sequence, values)


def wire_s(encoded: bytes) -> float:
    return len(encoded) * BYTE_S


def test_a_frame_arrives_when_its_last_byte_is_through(robot: NativeRobot) -> None:
    encoded = command("STATUS")
    robot.send(encoded, 0.1)
    robot.advance(0.1 + wire_s(encoded) - 2e-6)
    assert robot.frames() == []
    robot.advance(0.1 + wire_s(encoded) + 2e-6)
    ((time_s, frame),) = robot.frames()
    assert frame.name == "STATUS" and time_s == pytest.approx(0.1 + wire_s(encoded), abs=1e-6)
    assert robot.frames() == []


def test_frames_queue_on_the_wire(robot: NativeRobot) -> None:
    encoded = command("STATUS", 1)
    robot.send(encoded + command("STATUS", 2), 0.1)
    robot.send(command("STATUS", 3), 0.1)
    robot.advance(1.0)
    found = robot.frames()
    assert [frame.sequence for _, frame in found] == [1, 2, 3]
    for index, (time_s, _) in enumerate(found):
        assert time_s == pytest.approx(0.1 + (index + 1) * wire_s(encoded), abs=2e-6)


def test_a_frame_may_come_in_parts_and_between_noise(robot: NativeRobot) -> None:
    encoded = command("STATUS", 5)
    robot.send(encoded[:3], 0.1)
    robot.advance(0.2)
    robot.send(encoded[3:], 0.3)
    robot.send(b"\0\0\0", 0.4)
    robot.send(b"\x07" * 1000, 0.5)
    robot.send(b"\0" + command("STATUS", 6), 0.7)
    robot.advance(1.0)
    first, second = [frame for _, frame in robot.frames()]
    assert (first.name, first.sequence, second.sequence) == ("STATUS", 5, 6)
    assert second.values["frames_bad"] == 1, "empty frames are nothing, a long one is one"


def test_edges_of_a_stroke(robot: NativeRobot) -> None:
    robot.send(command("ARM") + command("STROKE", action=ACTION["B"]), 1.0)
    arrival_s = 1.0 + wire_s(command("ARM") + command("STROKE", action=ACTION["B"]))
    robot.advance(arrival_s + 0.04)
    first = robot.edges()
    assert [(edge.limb, edge.level) for edge in first] == [(0, True), (1, True)]
    assert robot.edges() == [], "the ends are not yet"
    robot.advance(arrival_s + 1.0)
    rest = robot.edges()
    assert [(edge.limb, edge.level) for edge in rest] == [
        (0, False), (1, False), (2, True), (3, True), (2, False), (3, False),
    ]  # fmt: skip
    start_s = first[0].time_s
    assert start_s == pytest.approx(arrival_s, abs=2e-6)
    wanted = [PULSE_S, PULSE_S, SECOND_S, SECOND_S, SECOND_S + PULSE_S, SECOND_S + PULSE_S]
    assert [edge.time_s - start_s for edge in rest] == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("taken", [False, True])
def test_disarm_in_the_middle_of_a_pulse_takes_back_its_end(robot: NativeRobot, taken: bool) -> None:
    robot.send(command("ARM") + command("STROKE", action=ACTION["B"]), 1.0)
    robot.advance(1.04)
    edges = robot.edges() if taken else []
    robot.send(command("DISARM"), 1.04)
    robot.advance(3.0)
    edges += robot.edges()
    off_s = 1.04 + wire_s(command("DISARM"))
    pulses = pulses_of(edges, 3.0)
    assert [pulse.limb for pulse in pulses] == [0, 1]
    assert [pulse.end_s for pulse in pulses] == pytest.approx([off_s, off_s], abs=2e-6)


def test_a_run_keeps_every_limit_and_its_times(robot: NativeRobot) -> None:
    fix: dict[str, Value] = {"quality": 1, "capture_age_us": 0, "y_m": 0.0, "heading_rad": 0.0}
    rows = [(0.1 * index, 0.0, 0.0) for index in range(11)]
    robot.send(pack_frame("PATH", "command", 1, {"first": 0, "total": 11, "count": 11}, rows), 0.1)
    robot.send(command("ARM") + command("FIX", fix_sequence=0, x_m=0.0, **fix), 0.9)
    robot.send(command("START", delay_us=100_000), 1.0)
    for index in range(1, 150):
        robot.send(command("FIX", fix_sequence=index, x_m=0.001 * index, **fix), 1.0 + index / 15)
    robot.advance(10.0)
    decisions = [frame.values for _, frame in robot.frames() if frame.name == "DECISION"]
    assert len(decisions) == 7
    times_us = [int(values["scheduled_us"]) for values in decisions]
    assert {b - a for a, b in pairwise(times_us)} == {PERIOD_US}
    pulses = pulses_of(robot.edges(), 10.0)
    starts_us = {round(pulse.start_s * 1e6) for pulse in pulses}
    assert starts_us <= {t + k for t in times_us for k in (0, DELAY_US + GAP_US)} and starts_us
    assert violations(ROBOT, pulses) == []


def test_time_does_not_go_back(robot: NativeRobot) -> None:
    robot.advance(2.0)
    robot.send(command("STATUS"), 1.0)  # the wire's past: it is here now
    robot.advance(2.1)
    ((time_s, frame),) = robot.frames()
    assert time_s == 2.0 and frame.values["now_us"] == 2_000_000
    robot.advance(1.0)
    assert robot.edges() == []


def test_a_table_for_another_robot_is_not_built(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="frog2023"):
        native(tmp_path / "other", robot_id="frog2023")


def test_a_core_that_refuses_its_table_says_so(tmp_path: Path) -> None:
    with pytest.raises(FrogkickError, match="fk_error_t -29"):
        NativeRobot(native(tmp_path / "long", pulse_us=100_001), 4)


def test_an_edge_is_a_value() -> None:
    assert Edge(1.0, 2, True) == Edge(1.0, 2, True)
