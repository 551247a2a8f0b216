"""DISARM and STOP pass all that waits, and nothing that came before them is sent any more."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from tests.link.air import Air, Peripheral, VirtualClient, breathe
from tests.link.inline import Inline
from tests.link.live_robot import LiveRobot
from tests.runs import rig

from frogkick.core.poses import Fix
from frogkick.link import ble
from frogkick.link.layout import link_layout
from frogkick.link.wire import WireError
from frogkick.runs.lab_session import RESEND_NUMBERS, RESEND_S, LabSession, lab_session

STATE = link_layout().state
PART: Any = ({"first": 0, "total": 2, "count": 2}, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])


def greeted(wire: Inline) -> LabSession:
    session = wire.session()
    session.handshake(rig.tables())
    return session


def state(session: LabSession) -> int:
    return int(session.request("STATUS")["state"])


@pytest.mark.parametrize("name", ["DISARM", "STOP"])
@pytest.mark.parametrize("window", [1, 4])
def test_they_are_sent_at_once_though_no_answer_comes(window: int, name: str) -> None:
    wire = Inline(window=window)
    session = greeted(wire)
    wire.drops = lambda _frame: True
    for _ in range(2 * window):
        session.post("PATH", *PART)
    asked_s = wire.clock()
    session.post(name)
    sent_s, last = wire.sent[-1]
    assert last.name == name and sent_s == asked_s


def test_what_came_before_them_is_not_sent_any_more() -> None:
    """Neither what waits for its turn nor what waits for its answer."""
    wire = Inline()
    session = greeted(wire)
    wire.drops = lambda _frame: True
    session.post("PATH", *PART)
    session.post("ARM")
    assert not session.make_safe()
    wire.drops = lambda frame: frame.name == "ARM"
    assert state(session) == STATE["DISARMED"] and "ARM" not in wire.names()
    session.post("ARM")
    wire.wait(session, 3 * RESEND_S)
    assert wire.names().count("ARM") >= 3
    before = wire.names().count("ARM")
    session.request("DISARM")
    wire.wait(session, 3 * RESEND_S)
    assert wire.names().count("ARM") == before and state(session) == STATE["DISARMED"]


def test_disarm_is_sent_until_it_is_answered_or_the_robot_counts_as_silent() -> None:
    wire = Inline()
    session = greeted(wire)
    session.request("ARM")
    silent_until_s = wire.clock() + 5.5
    wire.drops = lambda _frame: wire.clock() < silent_until_s
    assert session.make_safe() and state(session) == STATE["DISARMED"]
    wire.drops = lambda _frame: True
    begin_s = wire.clock()
    assert not session.make_safe()
    at_s = [sent_s for sent_s, frame in wire.sent if frame.name == "DISARM" and sent_s >= begin_s]
    gaps_s = [later - earlier for earlier, later in zip(at_s, [*at_s[1:], wire.clock()], strict=True)]
    assert max(gaps_s) <= 2 * RESEND_S and 5.0 < wire.clock() - begin_s < 10.0


def test_a_connection_that_is_lost_ends_the_attempt_too() -> None:
    wire = Inline()
    session = greeted(wire)
    wire.lost()
    begin_s = wire.clock()
    assert not session.make_safe() and wire.clock() - begin_s < 20.0
    wire.lost(WireError("serial:inline went away"))
    assert not session.make_safe()


def test_a_command_is_not_sent_again_once_the_robot_may_have_forgotten_it() -> None:
    """It would act on it a second time. However many fixes pass it, it is sent again."""
    wire = Inline()
    session = greeted(wire)
    wire.drops = lambda frame: frame.name == "PATH"
    session.post("PATH", *PART)

    for _ in range(300):
        session.post_fix(Fix(0.0, 0.0, 0.0, 0.0, 0.0), session.port.now_s)
        session.step(session.port.now_s)
    for _ in range(RESEND_NUMBERS):
        session.post("STATUS")
    wire.wait(session, 3 * RESEND_S)
    before = wire.names().count("PATH")
    assert before >= 3
    session.post("STATUS")
    wire.wait(session, 3 * RESEND_S)
    assert wire.names().count("PATH") == before


@pytest.mark.parametrize("mtu", [23, 247])
def test_they_pass_what_a_radio_holds(monkeypatch: pytest.MonkeyPatch, mtu: int) -> None:
    """The acknowledgement of a path's part never comes, and another command waits behind it in the radio."""
    robot = LiveRobot()
    breathe(monkeypatch, Peripheral(robot, mtu=mtu))
    write, held = VirtualClient.write_gatt_char, asyncio.Event()

    async def stuck(self: VirtualClient, where: Any, data: Any, response: bool) -> None:
        await write(self, where, data, response)
        if response and len(data) > 18:
            await held.wait()

    wire = ble.BleWire("frogkick")
    try:
        session = lab_session(wire)
        session.handshake(rig.tables())
        session.request("ARM")
        monkeypatch.setattr(VirtualClient, "write_gatt_char", stuck)
        session.post("PATH", *PART)
        session.post("ARM")
        assert session.make_safe()
        Air.now.loop.call_soon_threadsafe(held.set)  # type: ignore[union-attr]
        assert state(session) == STATE["DISARMED"]
        assert robot.names().count("ARM") == 1 and robot.names()[-2:] == ["DISARM", "STATUS"]
    finally:
        wire.close()
