"""Frames from the robot that are lost in a run: why it ended is told all the same, and nothing false."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.runs import rig

from frogkick.link.frames import Frame
from frogkick.link.wire import Edge, RobotPort
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.pool.native_robot import NativeRobot
from frogkick.runs.closed_loop import run_session
from frogkick.runs.decision import LiveCheck
from frogkick.runs.lost_frames import LATE_S
from frogkick.runs.path_change import NextPath
from frogkick.runs.record import DISARMED, ENDED, TIME, UNHEARD, Recording, RunOptions
from frogkick.runs.session import LinkError, Session

Loses = Callable[[Frame], bool]
SOON_S = rig.PERIOD_S + LATE_S + 1.0
"""After the robot's end the host must have noticed it, and fetched the log."""


class Losing:
    """A robot some of whose frames are lost."""

    def __init__(self, loses: Loses, robot: RobotPort | None = None) -> None:
        self._robot, self._loses = robot or rig.port("pool"), loses

    def send(self, encoded: bytes, at_s: float) -> None:
        self._robot.send(encoded, at_s)

    def advance(self, until_s: float) -> None:
        self._robot.advance(until_s)

    def frames(self) -> list[tuple[float, Frame]]:
        return [(time_s, frame) for time_s, frame in self._robot.frames() if not self._loses(frame)]

    def edges(self) -> list[Edge]:
        return self._robot.edges()


def swim(
    loses: Loses = lambda _frame: False,
    limit_s: float = 60.0,
    fixes_until_s: float = 60.0,
    robot: RobotPort | None = None,
    onboard: bool = True,
    check: LiveCheck | None = None,
    then: tuple[NextPath, ...] = (),
) -> Recording:
    pool = rig.new_pool("line")
    pool.last_fix_s = fixes_until_s
    options = RunOptions(PlanConfig(depth=1), onboard, limit_s, check, then=then)
    session = Session(Losing(loses, robot))
    return run_session(session, pool, rig.recording(shape("line"), options, pool))


def is_ended(frame: Frame) -> bool:
    return frame.name == "ENDED"


@pytest.mark.parametrize(("fixes_until_s", "why"), [(60.0, ENDED["OK"]), (5.0, ENDED["STALE"])])
def test_an_end_that_was_not_heard_is_found_in_the_robot_s_log(fixes_until_s: float, why: str) -> None:
    heard, lost = swim(fixes_until_s=fixes_until_s), swim(is_ended, fixes_until_s=fixes_until_s)
    assert heard.ended == lost.ended == why
    assert heard.completed == lost.completed == (why == ENDED["OK"])
    assert len(heard.decisions) == len(lost.decisions) >= 4
    assert heard.end_s < lost.end_s < heard.end_s + SOON_S


@pytest.mark.parametrize(("fixes_until_s", "why"), [(60.0, UNHEARD), (5.0, DISARMED)])
def test_an_end_of_which_the_log_does_not_come_either(fixes_until_s: float, why: str) -> None:
    recording = swim(lambda frame: frame.name in ("ENDED", "LOG"), fixes_until_s=fixes_until_s)
    assert recording.ended == why and not recording.completed


@pytest.mark.parametrize("after_s", [-0.3, 0.01, 0.3])
def test_an_end_just_before_the_time_limit(after_s: float) -> None:
    heard = swim()
    limit_s = heard.end_s - heard.first_decision_s + after_s
    recording = swim(is_ended, limit_s)
    assert recording.ended == (TIME if after_s < 0.0 else ENDED["OK"])


class Nth:
    """Loses the nth event of a name."""

    def __init__(self, name: str, number: int) -> None:
        self._name, self._left = name, number

    def __call__(self, frame: Frame) -> bool:
        self._left -= frame.name == self._name
        return frame.name == self._name and self._left == 0


@pytest.mark.parametrize("number", [1, 3])
def test_a_lost_decision_is_no_difference_between_host_and_robot(number: int) -> None:
    check = LiveCheck()
    recording = swim(Nth("DECISION", number), 8.0, check=check)
    assert recording.ended == TIME and len(recording.decisions) == 5
    assert (check.agreed, check.unchecked) == (number - 1, 6 - number)


def test_a_rest_is_not_booked_to_another_decision() -> None:
    """The robot does not know its limbs' heat, so it refuses each stroke, and one decision is lost."""

    def hot() -> NativeRobot:
        return NativeRobot(rig.firmware("native").image, len(rig.robot().limbs), heat_known=False)

    heard, lost = swim(limit_s=4.0, robot=hot()), swim(Nth("DECISION", 2), 4.0, robot=hot())
    assert set(heard.rested) == {0, 1, 2} and len(lost.decisions) == 2
    assert [lost.rested[row] for row in sorted(lost.rested)] == [heard.rested[0], heard.rested[2]]


def test_a_robot_that_falls_silent_under_a_planner_on_the_host_ends_the_run() -> None:
    """It is asked once two strokes went without an answer."""
    strokes: list[Frame] = []

    def is_silent(frame: Frame) -> bool:
        strokes.extend([frame] if frame.name == "STROKE" else [])
        return len(strokes) > 2

    words = r"no answer to STATUS within 1 s.*did not confirm DISARM: switch it off"
    with pytest.raises(LinkError, match=words):
        swim(is_silent, onboard=False)
    assert len(strokes) == 4


def test_a_path_that_is_never_answered_ends_the_run() -> None:
    started: list[Frame] = []

    def no_answer(frame: Frame) -> bool:
        started.extend([frame] if frame.name == "START" else [])
        return frame.name == "PATH" and bool(started)

    beside = shape("line").place((0.0, 0.01, 0.0))
    with pytest.raises(
        LinkError, match=r"does not answer the path .* that was to take over; run again"
    ) as said:
        swim(no_answer, then=(NextPath(beside, 1.0),))
    assert "did not confirm" not in str(said.value)
