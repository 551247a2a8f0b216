"""However a run ends: its end is told as it was, and the robot is disarmed, or the user is told to do it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.link.inline import Inline
from tests.link.live_robot import LiveRobot
from tests.link.swim import PATH, LivePool
from tests.runs import rig

from frogkick.core.errors import FrogkickError
from frogkick.link.frames import Frame
from frogkick.link.layout import link_layout
from frogkick.link.wire import WireError
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import run_session
from frogkick.runs.lab_session import LabSession
from frogkick.runs.record import DROPPED, ENDED, STOPPED, TIME, Recording, RunOptions
from frogkick.runs.session import LinkError

STATE = link_layout().state
Decided = Callable[[int], None]


def swim(
    wire: Inline,
    decided: Decided = lambda _count: None,
    limit_s: float = 60.0,
    stop: Callable[[], bool] = lambda: False,
    session: LabSession | None = None,
) -> Recording:
    """A run whose ``decided`` is called with the number of decisions so far."""
    options = RunOptions(PlanConfig(depth=1), True, limit_s, stop=stop)
    recording = rig.recording(shape(PATH), options)

    def progress(_time_s: float, _index: int) -> None:
        decided(len(recording.decisions))

    source = LivePool(wire.robot.pulses, wire.clock)
    return run_session(session or wire.session(), source, recording, progress)


def state_of(robot: LiveRobot) -> int:
    """The robot's state, asked without the wire."""
    robot.core.take_bytes()
    return int(robot.core.ask("STATUS")["state"])


def once(count: int, do: Callable[[], None]) -> Decided:
    """``do`` at a decision."""
    return lambda decisions: do() if decisions == count else None


@pytest.fixture(scope="module")
def whole() -> Recording:
    recording = swim(Inline())
    assert recording.completed and recording.ended == ENDED["OK"]
    return recording


def test_a_run_that_is_completed_while_the_connection_is_down_counts_as_completed() -> None:
    wire = Inline()

    def fades(frame: Frame) -> bool:
        if frame.name == "ENDED":
            wire.go_down(0.3)
        return frame.name == "ENDED"

    wire.drops = fades
    recording = swim(wire)
    assert recording.completed and recording.ended == ENDED["OK"]
    assert wire.connections == 2 and state_of(wire.robot) == STATE["DISARMED"]


def test_a_run_whose_fixes_are_lost_with_the_connection_says_so() -> None:
    wire = Inline()
    recording = swim(wire, once(2, lambda: wire.go_down(6.0)))
    assert recording.ended == DROPPED and not recording.completed
    assert wire.connections == 2 and state_of(wire.robot) == STATE["DISARMED"]


def test_one_lost_frame_does_not_prolong_a_run(whole: Recording) -> None:
    wire = Inline(drops=lambda frame: frame.name == "ENDED")
    recording = swim(wire)
    assert recording.completed and recording.ended == ENDED["OK"]
    assert recording.end_s < whole.end_s + rig.PERIOD_S + 3.0


def raising(error: BaseException) -> Callable[[], None]:
    def throw() -> None:
        raise error

    return throw


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), RuntimeError("a bug"), FrogkickError("a file is gone"), SystemExit(1)]
)
def test_what_ends_a_run_disarms_though_a_path_waits_for_its_answer(error: BaseException) -> None:
    wire = Inline()
    session = wire.session()

    def fail() -> None:
        wire.drops = lambda frame: frame.name == "PATH"
        session.post("PATH", {"first": 0, "total": 2, "count": 2}, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
        raise error

    with pytest.raises(type(error)) as said:
        swim(wire, once(2, fail), session=session)
    assert said.value is error and state_of(wire.robot) == STATE["DISARMED"]


@pytest.mark.parametrize("answers", ["lost", "connection lost", "a bug"])
def test_a_robot_that_cannot_be_disarmed_is_told_of(answers: str, monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Inline()

    def fail() -> None:
        if answers == "lost":
            wire.drops = lambda _frame: True
        elif answers == "connection lost":
            wire.lost(WireError("serial:inline went away"))
        else:
            monkeypatch.setattr(wire, "receive", lambda _timeout_s: raising(RuntimeError("a bug"))())
        raise KeyboardInterrupt

    with pytest.raises(LinkError, match="interrupted; the robot did not confirm DISARM: switch it off"):
        swim(wire, once(2, fail))
    assert answers == "connection lost" or wire.names()[-1] == "DISARM"


def test_a_second_ctrl_c_does_not_keep_a_robot_armed() -> None:
    """It comes before the first one has made the program ignore it."""
    wire = Inline()
    session, make_safe, more = wire.session(), LabSession.make_safe, iter([KeyboardInterrupt()])

    class Hasty(LabSession):
        def make_safe(self) -> bool:
            for again in more:
                raise again
            return make_safe(self)

    hasty = Hasty(session.port)
    with pytest.raises(KeyboardInterrupt):
        swim(wire, once(2, raising(KeyboardInterrupt())), session=hasty)
    assert state_of(wire.robot) == STATE["DISARMED"]


@pytest.mark.parametrize(("at", "why"), [("STOP", STOPPED), ("DISARM", TIME)])
def test_a_key_that_is_pressed_as_a_run_ends(at: str, why: str) -> None:
    wire = Inline()
    recording = swim(wire, limit_s=2.0, stop=lambda: at in wire.names())
    assert recording.ended == why and state_of(wire.robot) == STATE["DISARMED"]


def test_a_disarm_that_was_confirmed_is_not_called_in_doubt() -> None:
    """The robot answers no more after it."""
    wire = Inline()

    def silent(_frame: Frame) -> bool:
        return "DISARM" in wire.names()[:-1]

    wire.drops = silent
    with pytest.raises(LinkError, match="no answer to STATUS") as said:
        swim(wire, limit_s=2.0)
    assert "did not confirm" not in str(said.value) and state_of(wire.robot) == STATE["DISARMED"]
