"""A conversation over a real pseudo-terminal, and with bleak's real client: the same on both."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import count, from_ci
from tests.core.store_rig import crc_of
from tests.link.live_robot import LiveRobot
from tests.link.rigged import TRANSPORTS, Rigged, rigged
from tests.planner import synthetic
from tests.runs import rig

from frogkick.core.errors import FrogkickError
from frogkick.core.poses import Fix
from frogkick.link.frames import Frame
from frogkick.link.layout import link_layout
from frogkick.link.wire import WireError
from frogkick.paths import shape
from frogkick.runs.lab_session import LabSession, lab_session
from frogkick.runs.pushing import CHUNK_BYTES, upload
from frogkick.runs.session import LinkError
from frogkick.tables.image import open_image

NEW, NEXT = synthetic.affine_image(40, 9, 2), synthetic.affine_image(40, 9, 3)


@pytest.fixture(params=TRANSPORTS)
def robot_there(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[LiveRobot, Rigged]]:
    robot = LiveRobot()
    with rigged(request.param, robot, tmp_path, monkeypatch) as there:
        yield robot, there


@pytest.fixture
def robot(robot_there: tuple[LiveRobot, Rigged]) -> LiveRobot:
    return robot_there[0]


@pytest.fixture
def there(robot_there: tuple[LiveRobot, Rigged]) -> Rigged:
    return robot_there[1]


def test_a_conversation(robot: LiveRobot, there: Rigged) -> None:
    session = lab_session(there.wire)
    reported = session.handshake(rig.tables())
    assert reported["table_crc"] == rig.tables().crc32
    trips = []
    for _ in range(count(100, 2000, 30)):
        before_s = time.perf_counter()
        session.request("STATUS")
        trips.append(time.perf_counter() - before_s)
    print(f"\nround trip {1e3 * np.median(trips):.2f} ms, p99 {1e3 * np.percentile(trips, 99):.2f} ms")
    session.send_path(shape("ellipse"))
    session.request("ARM")
    session.request("DISARM")
    with pytest.raises(LinkError, match=r"refuses STROKE .*STATE"):
        session.request("STROKE", {"action": 0})
    offset_us = session.robot_clock_offset_us()
    assert abs(robot.now_us - offset_us - session.port.now_s * 1e6) < 500_000
    assert session.port.bad == 0


@from_ci
def test_what_is_lost_on_the_way_is_sent_again_and_done_once(robot: LiveRobot, there: Rigged) -> None:
    numbers = itertools.count()
    robot.deaf_to = lambda _frame: next(numbers) % 3 != 2  # two of three
    session = lab_session(there.wire)
    session.handshake(rig.tables())
    session.send_path(shape("line"))
    session.request("ARM")
    session.request("DISARM")
    assert session.port.resent >= 10
    assert int(session.request("STATUS")["state"]) == link_layout().state["DISARMED"]


def test_forced_reconnects(robot: LiveRobot, there: Rigged) -> None:
    """50 reconnects, 1,000 at level full: the conversation continues after each, and each ARM acts once."""
    session = lab_session(there.wire)
    session.handshake(rig.tables())
    begin_s = time.monotonic()
    times = count(50, 1000, 12)
    for time_of in range(times):
        if time_of % 2:
            there.drop()
            session.request("ARM")
        else:
            session.post("STATUS")  # under way while it drops
            there.drop()
            session.request("DISARM")
    assert there.wire.connections == times + 1
    took_s = time.monotonic() - begin_s
    print(f"\n{times} reconnects, {1e3 * took_s / times:.0f} ms each, {session.port.resent} sent again")
    session.handshake(rig.tables())
    assert int(session.request("STATUS")["restarts"]) == 0


def cut_session(robot: LiveRobot, there: Rigged, every: int) -> LabSession:
    """A session whose connection drops at every n-th chunk, before the chunk arrives."""
    chunks = itertools.count(1)
    last: list[Frame] = []

    def cut(frame: Frame) -> bool:
        if frame.name != "TABLE_CHUNK" or frame in last:
            return False
        last[:] = [frame]
        if next(chunks) % every:
            return False
        cuts.append(frame)
        return True

    cuts: list[Frame] = []
    robot.deaf_to = cut
    session = lab_session(there.wire)

    def drop_at_cut(_time_s: float, _edges: object) -> None:
        if cuts:
            cuts.clear()
            there.drop()

    session.on_step = drop_at_cut
    return session


def test_a_table_cut_at_every_tenth_chunk(robot: LiveRobot, there: Rigged) -> None:
    session = cut_session(robot, there, 10)
    begin_s = time.monotonic()
    done = upload(session, NEW)
    took_s = time.monotonic() - begin_s
    assert (done.bytes_sent, done.table_crc) == (len(NEW), crc_of(NEW))
    chunks = -(-len(NEW) // CHUNK_BYTES)
    drops = there.wire.connections - 1
    assert drops >= chunks // 10 >= 5
    if there.wire.window == 1:  # else some chunks behind a cut one come twice, and are counted
        assert drops == chunks // 10
    session.on_step = lambda _time_s, _edges: None
    robot.deaf_to = lambda _frame: False
    session.handshake(open_image(NEW))
    print(f"\n{len(NEW)} bytes with {drops} drops in {took_s:.2f} s")
    # Another, without a drop: how fast it is.
    begin_s = time.monotonic()
    upload(session, NEXT)
    assert robot.flash.image == NEXT
    print(f"without drops {len(NEXT) / (time.monotonic() - begin_s) / 1e3:.1f} kB/s")


def test_an_upload_that_was_given_up_is_resumed(robot: LiveRobot, there: Rigged) -> None:

    class Lost(Exception):
        pass

    def stop(done: int, _all: int) -> None:
        if done >= 4096 + 256:
            raise Lost

    with pytest.raises(Lost):
        upload(lab_session(there.wire), NEW, stop)
    robot.restart()  # power lost
    session = lab_session(there.wire)
    session.handshake(rig.tables())
    assert upload(session, NEW).resumed_at == 4096
    session.handshake(open_image(NEW))


def test_fixes_need_no_answer_and_are_not_sent_again(robot: LiveRobot, there: Rigged) -> None:
    session = lab_session(there.wire)
    session.handshake(rig.tables())
    robot.deaf_to = lambda frame: frame.name == "FIX"
    resent = session.port.resent
    for number in range(20):
        session.post_fix(Fix(session.time_s, 0.0, 0.0, 0.0, 0.0, sequence=number), session.time_s)
        session.step(session.port.now_s + 0.03)
    assert session.take("FIX") == []
    assert session.port.resent == resent
    session.request("STATUS")


def test_another_table_is_refused(robot: LiveRobot, there: Rigged) -> None:
    with pytest.raises(LinkError, match=r"CRC-32 .*or build the firmware with it"):
        lab_session(there.wire).handshake(open_image(NEW))


def test_other_firmware_does_not_answer(robot: LiveRobot, there: Rigged) -> None:
    robot.mute = True
    with pytest.raises(LinkError, match="does not answer HELLO: it has other firmware or another speed"):
        lab_session(there.wire).handshake(rig.tables())


def test_a_robot_that_stays_away_is_told_of(
    robot: LiveRobot, there: Rigged, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = lab_session(there.wire)
    session.handshake(rig.tables())
    for name, value in (("reconnect_s", 0.3), ("_scan_s", 0.2)):
        monkeypatch.setattr(there.wire, name, value, raising=False)
    there.away()
    with pytest.raises(WireError, match=r"(went away|dropped out) for 0.3 s: .*(is not there|advertises)"):
        session.request("STATUS")
    assert isinstance(WireError(""), FrogkickError)


def test_a_robot_that_was_switched_off_and_on_is_another(robot: LiveRobot, there: Rigged) -> None:
    session = lab_session(there.wire)
    session.handshake(rig.tables())
    session.request("ARM")
    robot.restart()
    assert int(session.request("STATUS")["state"]) == link_layout().state["DISARMED"]
