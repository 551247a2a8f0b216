"""A session: answers, refusals, timeouts, a robot with another table or protocol."""

from __future__ import annotations

import pytest
from tests.runs import rig

from frogkick.link.frames import Frame, hello
from frogkick.link.wire import Edge
from frogkick.paths import shape
from frogkick.runs.decision import LIMB_USE_FIELDS
from frogkick.runs.session import ANSWER_TIMEOUT_S, LinkError, Session
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
