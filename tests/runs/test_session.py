"""A session: answers, refusals, timeouts, a robot with another table or protocol."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.runs import rig

from frogkick.core.poses import Fix
from frogkick.link.frames import Frame, hello, unpack_frame
from frogkick.link.layout import link_layout
from frogkick.link.wire import Edge
from frogkick.paths import shape
from frogkick.runs.decision import LIMB_USE_FIELDS
from frogkick.runs.session import ANSWER_TIMEOUT_S, INBOX_MOST, LinkError, Session
from frogkick.tables.image import TableError, open_image


class Silence:
    """A robot that is switched off."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.sent = 0

    def send(self, encoded: bytes, at_s: float) -> None:
        assert at_s >= self.now_s
        self.sent += 1

    def advance(self, until_s: float) -> None:
        self.now_s = until_s

    def frames(self) -> list[tuple[float, Frame]]:
        return []

    def edges(self) -> list[Edge]:
        return []


def test_no_answer_is_an_error_after_the_timeout_and_says_what_was_asked() -> None:
    off = Silence()
    session = Session(off)
    with pytest.raises(LinkError, match=r"no answer to STATUS within 1 s"):
        session.request("STATUS")
    assert ANSWER_TIMEOUT_S <= off.now_s < ANSWER_TIMEOUT_S + 0.1
    assert off.sent == 1
    with pytest.raises(LinkError, match="no answer to HELLO"):
        session.handshake(rig.tables())
    assert off.sent > 2  # a robot that is starting up gets HELLO several times


def test_a_refusal_names_command_and_reason() -> None:
    session = Session(rig.port("pool"))
    session.handshake(rig.tables())
    with pytest.raises(LinkError, match=r"refuses STROKE .*STATE"):
        session.request("STROKE", {"action": 0})
    assert int(session.ask("STROKE", {"action": 0})["status"]) < 0
    session.request("ARM")
    with pytest.raises(LinkError, match=r"refuses START .*NO_PATH"):
        session.request("START", {"delay_us": 0})
    with pytest.raises(LinkError, match="refuses PARAM"):
        session.set_parameters({"DEPTH": 5})


def test_greet_refuses_another_table_and_another_robot() -> None:
    session = Session(rig.port("pool"))
    ours = rig.tables()
    reported = session.handshake(ours)
    assert reported["table_crc"] == ours.crc32
    with pytest.raises(LinkError, match="or build the firmware with it"):
        session.handshake(open_image(rig.changed_image(32, b"another library")))
    with pytest.raises(TableError, match="newt"):
        session.handshake(open_image(rig.changed_image(16, b"newt".ljust(16, b"\0"))))


def test_answers_find_their_own_request() -> None:
    session = Session(rig.port("pool"))
    first = session.post("STATUS")
    second = session.post("HELLO", hello())
    session.step(0.2)
    frames = {arrival.frame.name: arrival.frame for arrival in session.take("STATUS", "HELLO")}
    assert frames["STATUS"].sequence == first
    assert frames["HELLO"].sequence == second
    assert session.take("STATUS", "HELLO") == []


def test_sequence_numbers_wrap() -> None:
    session = Session(rig.port("pool"))
    for _ in range(300):
        session.ask("STATUS")


def test_a_path_arrives_whole() -> None:
    session = Session(rig.port("pool"))
    session.send_path(shape("ellipse"))
    session.request("ARM")
    answer = session.ask(
        "PLAN",
        {"depth": 1, "x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0, "vx_mps": 0.0, "vy_mps": 0.0}
        | {"omega_rad_s": 0.0}
        | dict.fromkeys(LIMB_USE_FIELDS, 0)
        | {"along_points": 0.0},
    )
    assert answer["status"] == 0


class Held:
    """A robot in simulated time, some of whose frames are held back, and some of the host's lost.

    Attributes:
        holds: whether a frame of the robot is held back from now on.
        loses: whether a frame to the robot is lost.
        held: the frames that are held back.
        sent: sequence numbers of the frames from the host.
    """

    def __init__(self) -> None:
        self.robot = rig.port("pool")
        self.holds: Callable[[Frame], bool] = lambda _frame: False
        self.loses: Callable[[Frame], bool] = lambda _frame: False
        self.held: list[Frame] = []
        self.sent: list[int] = []
        self._late: list[Frame] = []
        self._now_s = 0.0

    def release(self) -> None:
        """What was held back comes now."""
        self._late, self.held = self.held, []

    def send(self, encoded: bytes, at_s: float) -> None:
        frame = unpack_frame(encoded[:-1])
        self.sent.append(frame.sequence)
        if not self.loses(frame):
            self.robot.send(encoded, at_s)

    def advance(self, until_s: float) -> None:
        self._now_s = until_s
        self.robot.advance(until_s)

    def frames(self) -> list[tuple[float, Frame]]:
        arrived = [(self._now_s, frame) for frame in self._late]
        self._late = []
        for time_s, frame in self.robot.frames():
            if self.holds(frame):
                self.held.append(frame)
            else:
                arrived.append((time_s, frame))
        return arrived

    def edges(self) -> list[Edge]:
        return self.robot.edges()


def post_fixes(session: Session, count: int) -> None:
    for number in range(count):
        session.post_fix(Fix(session.time_s, 0.0, 0.0, 0.0, 0.0, sequence=number), session.time_s)
        session.step(session.time_s + 0.01)


@pytest.mark.parametrize("when", ["before", "while it waits"])
@pytest.mark.parametrize("fixes", [253, 254, 255, 256])
def test_a_late_answer_to_an_older_disarm_confirms_nothing(fixes: int, when: str) -> None:
    """Though its sequence number comes again."""
    port = Held()
    session = Session(port)
    session.handshake(rig.tables())
    port.holds = lambda frame: frame.name == "DISARM" or when == "while it waits"
    assert not session.make_safe()
    if when == "before":
        port.release()
    post_fixes(session, fixes)
    port.loses = lambda frame: frame.name == "DISARM"
    port.release()
    assert not session.make_safe()


def test_fixes_without_an_answer_use_up_no_numbers() -> None:
    """The robot takes a number that is more than 127 ahead for an earlier one, and would act on it twice."""
    port = Held()
    session = Session(port)
    session.handshake(rig.tables())
    last = port.sent[-1]
    port.loses = lambda _frame: True
    post_fixes(session, 300)
    for _ in range(5):
        session.post("STATUS")
    assert {(number - last) & 0xFF for number in port.sent} <= set(range(128))
    assert len(set(port.sent[-5:])) == 5


@pytest.mark.parametrize("lost", [126, 127, 190, 253, 254, 255])
def test_an_arm_after_lost_frames_is_a_new_one(lost: int) -> None:
    port = Held()
    session = Session(port)
    session.handshake(rig.tables())
    for _ in range(3):
        session.request("ARM")
        session.request("DISARM")
        port.loses = lambda _frame: True
        post_fixes(session, lost)
        port.loses = lambda _frame: False
        session.request("ARM")
        assert int(session.request("STATUS")["state"]) == link_layout().state["ARMED"]
        session.request("DISARM")


def test_what_nobody_asked_for_is_dropped() -> None:
    """Answers without a request, an answer that comes again, an echo; of events the newest are kept."""
    port = Held()
    session = Session(port)
    session.handshake(rig.tables())
    number = session.post("STATUS")
    session.step(session.time_s + 0.1)
    ((_, status),) = [(arrival.time_s, arrival.frame) for arrival in session.take("STATUS")]
    stray = Frame("ARM", "answer", 1, {"status": 0, "state": 1})
    echo = Frame("STATUS", "command", number, {})
    ended = Frame("ENDED", "event", 0, {"status": 0, "state": 1, "decisions": 0})
    for _ in range(2 * INBOX_MOST):
        port.held += [stray, status, echo, ended]
        port.release()
        session.step(session.time_s + 0.001)
    assert session.take("ARM", "STATUS") == []
    assert len(session.take("ENDED")) == INBOX_MOST
    session.request("STATUS")
