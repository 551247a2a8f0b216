"""Failures in a lab while a robot runs: one clear line each, the robot disarmed, its log kept."""

from __future__ import annotations

import dataclasses
import re
import resource
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.conftest import REPOSITORY, some
from tests.link.live_robot import LiveRobot, PatientClock
from tests.link.rigged import Rigged, rigged
from tests.link.swim import PATH, LivePool
from tests.link.test_run_camera import SCENE, START, Filmed
from tests.runs import rig
from tests.vision.scenes import calibration

from frogkick.core.errors import FrogkickError, InputError
from frogkick.front.bench import placed
from frogkick.link.layout import link_layout
from frogkick.paths import Path as SwimPath
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs import session as session_module
from frogkick.runs.closed_loop import ENDED, FixSource, run_session
from frogkick.runs.lab_session import CLOCK_SAMPLES, LabPort, LabSession, lab_session
from frogkick.runs.live_log import LiveLog, logged, part_of
from frogkick.runs.record import Recording, RunOptions
from frogkick.runs.runlog_file import read_run
from frogkick.runs.session import LinkError
from frogkick.runs.tracked_fixes import CameraFixes
from frogkick.vision.sources import Frame, live_frames

PERIOD_S = rig.PERIOD_S
STATE = link_layout().state
OPTIONS = RunOptions(PlanConfig(), True, 10 * PERIOD_S)


class Stepping:
    """A clock that can be set."""

    def __init__(self) -> None:
        self.steady, self.offset_s = PatientClock(), 0.0

    def __call__(self) -> float:
        return self.steady() + self.offset_s


@dataclasses.dataclass
class Day:
    """A robot on a serial line, with a log in progress."""

    robot: LiveRobot
    there: Rigged
    session: LabSession
    folder: Path

    def run(
        self,
        source: FixSource,
        path: SwimPath,
        options: RunOptions = OPTIONS,
        decided: Callable[[], None] = lambda: None,
    ) -> Recording:
        with logged(self.folder / "run.h5", rig.recording(path, options)) as keep:
            return run_session(
                self.session, source, rig.recording(path, options), lambda _t, _i: decided(), keep
            )

    def fails(self, error: type[FrogkickError], words: str, go: Callable[[], object]) -> int:
        """Check that it ends in one line, all limbs off and the rows so far in the log; return the state."""
        with pytest.raises(error, match=words) as said:
            go()
        assert "\n" not in str(said.value) and "did not confirm DISARM" not in str(said.value)
        assert self.robot.left_alone(), self.robot.names()
        state = int(self.session.request("STATUS")["state"])
        assert state in (STATE["DISARMED"], STATE["FAULT"])
        assert len(read_run(part_of(self.folder / "run.h5")).fixes.x_m) > 3
        return state


@contextmanager
def day(folder: Path, patch: pytest.MonkeyPatch, clock: Stepping | None = None) -> Iterator[Day]:
    # One clock below both: on a busy machine two would drift apart by its pauses.
    robot = LiveRobot(clock=clock.steady if clock else PatientClock())
    with rigged("serial", robot, folder, patch) as there:
        yield Day(robot, there, LabSession(LabPort(there.wire, clock or robot.clock)), folder)


def pool_of(robot: LiveRobot) -> LivePool:
    return LivePool(robot.pulses, robot.clock)


class Camera:
    """A camera that works for some pictures, and then repeats the last one for ever, or gives nothing."""

    def __init__(self, robot: LiveRobot, pictures: int, hangs: bool) -> None:
        self._frames, self._left, self._hangs = iter(Filmed(robot)), pictures, hangs
        self._last: Frame | None = None
        self.over = threading.Event()

    def grab(self) -> bool:
        self._left -= 1
        if self._left >= 0:
            self._last = next(self._frames)
        elif self._hangs:
            return not self.over.wait(60.0)
        else:
            time.sleep(0.02)
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        assert self._last is not None
        return True, self._last.image


@pytest.mark.parametrize(
    ("hangs", "words"),
    [(False, "camera 3 is frozen: 9 equal pictures"), (True, r"camera 3 has given no picture for 1\.\d s")],
    ids=["frozen", "hanging"],
)
def test_a_camera_that_freezes_while_the_robot_runs(
    hangs: bool, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = LiveRobot()
    path = placed(shape(PATH), (), "here", START)[0]
    driver = Camera(robot, 40, hangs)
    with rigged("serial", robot, tmp_path, monkeypatch) as there:
        source = CameraFixes(live_frames(driver, "camera 3"), calibration(SCENE), "camera 3")
        source.wait_first(120.0)
        now = Day(robot, there, lab_session(there.wire), tmp_path)
        now.fails(InputError, words, lambda: now.run(source, path))
        driver.over.set()
        source.close()


@pytest.mark.parametrize("onboard", [True, False], ids=["onboard", "host"])
def test_this_computer_s_clock_goes_back(
    onboard: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Stepping()
    with day(tmp_path, monkeypatch, clock) as now:
        options = dataclasses.replace(OPTIONS, onboard=onboard)

        def go() -> object:
            return now.run(
                pool_of(now.robot), shape(PATH), options, lambda: setattr(clock, "offset_s", -30.0)
            )

        now.fails(LinkError, r"this computer's clock went back by (29|30)\.\d s while the robot ran", go)


@pytest.mark.parametrize("onboard", [True, False], ids=["onboard", "host"])
@pytest.mark.parametrize(
    ("by_s", "message"), some([(0.4, r"0\.[4-9]"), (1.5, r"1\.[5-9]"), (300.0, r"300\.\d")], 1)
)
def test_this_computer_s_clock_goes_ahead(
    by_s: float, message: str, onboard: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fixes would look older than they are, or the run too long. The robot's own clock reveals it."""
    clock = Stepping()
    with day(tmp_path, monkeypatch, clock) as now:
        options = dataclasses.replace(OPTIONS, onboard=onboard)

        def go() -> object:
            return now.run(pool_of(now.robot), shape(PATH), options, lambda: setattr(clock, "offset_s", by_s))

        # A busy machine takes a while between the two clocks.
        words = (
            rf"clock went ahead by {message} s while the robot ran, so that the ages of .* the run was ended"
        )
        now.fails(LinkError, words, go)


def test_a_computer_that_is_held_up_has_the_right_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both clocks went on meanwhile: the run ends because no fixes came, as with a covered camera."""
    clock = Stepping()
    robot = LiveRobot(clock=clock)
    with rigged("serial", robot, tmp_path, monkeypatch) as there:
        now = Day(robot, there, LabSession(LabPort(there.wire, clock)), tmp_path)
        asked = robot.names().count("STATUS")
        recording = now.run(pool_of(robot), shape(PATH), OPTIONS, lambda: setattr(clock, "offset_s", 3.0))
        assert recording.ended == ENDED["STALE"]
        assert robot.names().count("STATUS") > asked + CLOCK_SAMPLES + 1, (
            "the robot was not asked for its time"
        )
        assert int(now.session.request("STATUS")["state"]) == STATE["DISARMED"]


def test_a_robot_whose_power_fails_for_a_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a serial line no connection drops: only the robot's clock, which begins anew, reveals it."""
    with day(tmp_path, monkeypatch) as now:
        restarts = iter([now.robot.restart])

        def fail() -> None:
            next(restarts, lambda: None)()

        def go() -> object:
            return now.run(pool_of(now.robot), shape(PATH), decided=fail)

        now.fails(LinkError, "the robot or its firmware restarted during the run", go)


def test_the_time_of_day_is_not_asked() -> None:
    """It is set by the network while robots run; runs use clocks that never go back."""
    asks = re.compile(r"\btime\.time\(|\btime_ns\(|datetime\.(now|utcnow|today)\(")
    for folder in ("link", "runs", "vision", "pool", "planner"):
        files = list((REPOSITORY / "host/frogkick" / folder).rglob("*.py"))
        assert files, folder
        for file in files:
            assert not asks.search(file.read_text(encoding="utf-8")), file


def test_the_robot_s_clock_goes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with day(tmp_path, monkeypatch) as now:

        def back() -> None:
            now.robot._begin_s += 0.5

        def go() -> object:
            return now.run(pool_of(now.robot), shape(PATH), decided=back)

        state = now.fails(LinkError, r"the robot met the internal error TIME \(0\) and switched", go)
        assert state == STATE["FAULT"]


def test_the_robot_s_clock_goes_ahead(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By its clock, the robot has had no fix for a minute."""
    with day(tmp_path, monkeypatch) as now:
        steps = iter([60.0])

        def ahead() -> None:
            now.robot._begin_s -= next(steps, 0.0)

        recording = now.run(pool_of(now.robot), shape(PATH), decided=ahead)
        assert recording.ended == ENDED["STALE"]
        assert int(now.session.request("STATUS")["state"]) == STATE["DISARMED"]


@contextmanager
def files_up_to(length: int) -> Iterator[None]:
    """Limit the length of files, which acts as a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (length, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_the_disk_is_full_while_the_robot_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with day(tmp_path, monkeypatch) as now:
        part = part_of(tmp_path / "run.h5")
        write, written = LiveLog._write, 0

        def write_on_a_full_disk(self: LiveLog, rows: list[tuple[str, int, Any]]) -> None:
            nonlocal written
            if written < 12:
                write(self, rows)
                ends = [first + len(values) for name, first, values in rows if name == "fixes/time_s"]
                written = max([written, *ends])
                return
            more = [(name, first + n * len(new), new) for n in range(300) for name, first, new in rows]
            with files_up_to(part.stat().st_size):
                write(self, more)  # more than a chunk, which needs room

        monkeypatch.setattr(LiveLog, "_write", write_on_a_full_disk)
        now.fails(
            InputError,
            r"run\.h5\.part' cannot be continued: is the disk full\?",
            lambda: now.run(pool_of(now.robot), shape(PATH)),
        )


def test_a_robot_that_speaks_another_protocol(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours = link_layout().protocol_version
    newer = dataclasses.replace(link_layout(), protocol_version=ours + 1)
    with day(tmp_path, monkeypatch) as now:
        monkeypatch.setattr(session_module, "link_layout", lambda: newer)
        with pytest.raises(
            LinkError, match=f"the robot speaks protocol {ours}, this host {ours + 1}: flash it again"
        ):
            now.session.handshake(rig.tables())
        assert "ARM" not in now.robot.names()


def test_a_robot_with_a_table_for_another_period(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slower = dataclasses.replace(
        rig.tables(), period_us=2_000_000, image=rig.changed_image(rig.tables().sections.actions, b"Z")
    )
    with (
        day(tmp_path, monkeypatch) as now,
        pytest.raises(LinkError, match=r"a period of 1\.425 s, ours 2\.000 s: give the robot's own") as said,
    ):
        now.session.handshake(slower)
    assert "\n" not in str(said.value) and "ARM" not in now.robot.names()
