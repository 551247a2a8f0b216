"""The native robot's supply, watchdog and flash: what outlives what, as on the chip."""

from __future__ import annotations

import pytest
from tests.conftest import from_ci
from tests.runs import rig as loop_rig
from tests.soak import rig

from frogkick.link.frames import pack_frame
from frogkick.link.layout import Value, link_layout
from frogkick.link.wire import BYTE_S
from frogkick.pool.monitor import pulses_of
from frogkick.pool.native_robot import WATCHDOG_S, NativeRobot
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.runs.pushing import upload
from frogkick.runs.session import LinkError, Session

RESET, STATE = link_layout().reset, link_layout().state


@pytest.fixture
def robot() -> NativeRobot:
    return NativeRobot(rig.library(), 4)


def rested(robot: NativeRobot) -> Session:
    session = Session(robot, time_s=max(robot.up_s, robot.time_s))
    session.step(session.time_s + 0.7)
    return session


def fire(session: Session) -> float:
    """Heat some limbs, as soon as they may be; when."""
    session.rest(lambda _line: None)
    session.request("ARM")
    session.request("STROKE", {"action": 0})
    session.step(session.time_s + 0.01)
    return max(edge.time_s for edge in session.edges if edge.level)


def test_a_table_by_radio_outlives_power_and_watchdog(robot: NativeRobot) -> None:
    old, new = rig.tables()
    session = rested(robot)
    session.handshake(old)
    assert upload(session, new.image).bytes_sent == len(new.image)
    session.handshake(new)
    robot.cut_power(0.5)
    session = rested(robot)
    session.handshake(new)
    robot.hang()
    session = rested(robot)
    session.handshake(new)
    answer = session.request("TABLE_STATUS")
    assert (answer["running"], answer["slots"], answer["erases_1"], answer["erases_journal"]) == (1, 2, 1, 1)
    session.request("TABLE_ROLLBACK", {"table_crc": old.crc32})
    session.handshake(old)


@from_ci
def test_the_same_flash_as_the_chips() -> None:
    """After the same update, byte for byte."""
    new = rig.tables()[1]
    native, chip = loop_rig.port("pool"), loop_rig.port("virtual")
    assert isinstance(native, NativeRobot) and isinstance(chip, VirtualRobot)
    for port in (native, chip):
        session = Session(port)
        session.step(0.8)
        session.handshake(loop_rig.tables())
        upload(session, new.image)
        session.handshake(new)
    written = bytes(native.flash).rstrip(b"\xff")
    assert len(written) > len(new.image) and written in bytes(chip.chip.flash.content())


def test_an_update_cut_by_a_reset_goes_on_behind_its_last_whole_page(robot: NativeRobot) -> None:
    old, new = rig.tables()

    class Cut(Exception):
        pass

    def stop(done: int, _all: int) -> None:
        if done >= 4096 + 256:
            raise Cut

    session = rested(robot)
    with pytest.raises(Cut):
        upload(session, new.image, stop)
    robot.cut_power(0.1)
    session = rested(robot)
    session.handshake(old)
    assert upload(session, new.image).resumed_at == 4096
    session.handshake(new)


def test_a_power_cut_ends_pulses_at_once_and_a_hang_leaves_them_to_their_timer(robot: NativeRobot) -> None:
    for kind in ("power", "hang"):
        session = rested(robot)
        begun_s = fire(session)
        now_s = session.time_s
        if kind == "power":
            robot.cut_power(0.2)
        else:
            robot.hang()
        session.step(robot.up_s + 0.1)
        pulses = [p for p in pulses_of(session.edges, session.time_s) if p.start_s >= begun_s]
        end_s = now_s if kind == "power" else begun_s + 1e-6 * rig.tables()[0].pulse_us
        assert [pulse.end_s for pulse in pulses] == pytest.approx([end_s] * len(pulses)) and pulses
        status = session.request("STATUS")
        assert status["reset"] == RESET["POWER" if kind == "power" else "WATCHDOG"]
        assert (status["state"], status["pulses"]) == (STATE["DISARMED"], 0)


def test_nobody_answers_until_it_has_started_again(robot: NativeRobot) -> None:
    session = rested(robot)
    robot.hang()
    begin_s = session.time_s
    with pytest.raises(LinkError):
        session.ask("STATUS", timeout_s=WATCHDOG_S - 0.01)
    session.step(robot.up_s)
    assert begin_s + WATCHDOG_S < robot.up_s < begin_s + WATCHDOG_S + 0.1
    status = session.request("STATUS")
    assert 0 < int(status["now_us"]) < 50_000, "its clock began anew"


@pytest.mark.parametrize("heard", range(1, 6))
def test_of_a_frame_under_way_the_end_is_heard(robot: NativeRobot, heard: int) -> None:
    """Which is no frame; the delimiter alone is nothing."""
    session = rested(robot)
    frame = pack_frame("STATUS", "command", 9)
    robot.cut_power(0.5)
    robot.send(frame, robot.up_s + (heard - len(frame)) * BYTE_S)
    session.step(robot.up_s + 0.1)
    assert session.request("STATUS")["frames_bad"] == (heard > 1)
    assert session.take("STATUS") == []


def test_heat_outlives_the_watchdog_and_a_time_without_supply(robot: NativeRobot) -> None:
    """The first by its book; of the second nobody knows how long it was: all limbs count as fully heated."""

    def refused_after(reset: str, strokes: int) -> int:
        """Strokes of one limb, then a reset; how many are refused after it."""
        session = rested(robot)
        session.rest(lambda _line: None)
        session.request("ARM")
        actions = enumerate(rig.tables()[0].actions)
        action = next(index for index, row in actions if row.first_mask and not row.second_mask)
        for _ in range(strokes):
            session.request("STROKE", {"action": action})
            session.step(session.time_s + 0.6)
        if reset == "power":
            robot.cut_power(0.1)
        else:
            robot.hang()
        session = rested(robot)
        session.request("ARM")
        session.request("STROKE", {"action": action})
        session.step(session.time_s + 0.05)
        return int(session.request("STATUS")["pulses_refused"])

    assert refused_after("hang", 5) == 1
    session = rested(robot)
    session.step(session.time_s + 5.0)
    assert refused_after("hang", 2) == 0
    assert refused_after("power", 5) == refused_after("power", 0) == 1


def test_it_can_have_lain_idle_until_near_a_wrap(robot: NativeRobot) -> None:
    idle_s = 2**32 * 1e-6 - 0.5
    robot.cut_power(6.0, idle_s)
    session = Session(robot, time_s=robot.up_s)
    session.step(session.time_s + 1e-3)
    told_us = int(session.request("STATUS")["now_us"])
    assert 2**32 - 500_000 < told_us < 2**32 - 450_000
    session.step(session.time_s + 1.0)
    later: dict[str, Value] = session.request("STATUS")
    assert int(later["now_us"]) > 2**32 and later["fault"] == 0


def test_ram_is_always_the_same_and_nothing_beside_it_is_touched(robot: NativeRobot) -> None:
    size = robot.ram_bytes()
    session = rested(robot)
    fire(session)
    robot.cut_power(1.0)
    assert robot.ram_bytes() == size > 1000
