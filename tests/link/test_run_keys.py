"""The whole command at a real terminal: armed by Enter, stopped by any key, the robot on a serial line."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.conftest import count, from_ci, some
from tests.link.live_robot import LiveRobot
from tests.link.swim import PATH, LivePool
from tests.link.test_run_camera import SCENE, START
from tests.runs import rig
from tests.vision.scenes import calibration

from frogkick.link.layout import link_layout
from frogkick.link.pty_line import PtyLine
from frogkick.runs.closed_loop import STOPPED
from frogkick.runs.live_log import part_of
from frogkick.runs.runlog_file import read_run
from frogkick.vision.calibration import write_calibration

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")

STATE = link_layout().state
ASKED = b"press Enter to arm the robot or Ctrl-C to leave; any key stops the run"
PLAN = re.compile(rb"line, [A-I] cost \d+\.\d, \d+ mm off")
PATIENCE_S = 240.0
FILM_S, FILM_HZ = count(120, 120, 60), 10


@dataclass
class Terminal:
    """A person at a terminal, and the command that runs there.

    Attributes:
        process: the command; the terminal is its standard error, and its input if no fixes come in there.
        said: what it has written there so far.
        before: the terminal's settings before the command.
    """

    process: subprocess.Popen[str]
    number: int
    before: list[object]
    said: bytearray = field(default_factory=bytearray)

    def press(self, keys: bytes) -> None:
        os.write(self.number, keys)

    def wait(self, until: Callable[[], object]) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not until():
            assert time.monotonic() < deadline_s and self.process.poll() is None, bytes(self.said[-1000:])
            time.sleep(0.005)

    def listen(self) -> None:
        with suppress(OSError):  # the other end is closed
            while read := os.read(self.number, 4096):
                self.said += read

    def result(self) -> tuple[int, str]:
        """Exit code and standard output, after checking that the terminal is as it was."""
        assert self.process.stdout is not None
        code = self.process.wait(PATIENCE_S)
        output = self.process.stdout.read()
        assert termios.tcgetattr(self.number) == self.before, "the terminal is left as it was found"
        return code, output


@contextmanager
def seated(
    folder: Path, words: list[str], piped: LivePool | None, in_front: bool = True
) -> Iterator[Terminal]:
    """Start a command at a terminal of its own, with a tracker that pipes fixes into it, if there is one.

    The shell leads a new session. The terminal that it opens first is that session's, with keys and Ctrl-C.
    """
    ours, theirs = os.openpty()
    name, before = os.ttyname(theirs), termios.tcgetattr(theirs)
    opened = 'exec 2<>"$0"; ' if piped else 'exec <"$0" 2>"$0"; '
    opened += 'exec "$@"' if in_front else 'set -m; "$@" <&0 & wait $!'
    process = subprocess.Popen(
        ["sh", "-c", opened, name, sys.executable, "-m", "frogkick.cli.main", "run", *words],
        cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    there = Terminal(process, ours, before)
    stop = threading.Event()

    def write(text: str) -> None:
        assert process.stdin is not None
        with suppress(BrokenPipeError, ValueError):
            process.stdin.write(text)
            process.stdin.flush()

    threads = [threading.Thread(target=there.listen, daemon=True)]
    if piped is not None:
        threads.append(threading.Thread(target=piped.lines, args=(write, stop), daemon=True))
    for thread in threads:
        thread.start()
    try:
        yield there
    finally:
        process.kill()
        process.wait()
        stop.set()
        os.close(theirs)
        for thread in threads:
            thread.join()
        os.close(ours)
        for stream in (process.stdin, process.stdout):
            with suppress(BrokenPipeError):
                stream.close()  # type: ignore[union-attr]


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration, and a video of a robot at rest that is longer than any run here."""
    folder, rng = tmp_path_factory.mktemp("film"), np.random.default_rng(6)
    write_calibration(folder / "camera.toml", calibration(SCENE))
    kind = cv2.VideoWriter_fourcc(*"MJPG")  # type: ignore[attr-defined]
    writer = cv2.VideoWriter(str(folder / "film.avi"), kind, FILM_HZ, SCENE.view.image_px)
    pictures = [cv2.cvtColor(SCENE.picture(START, rng), cv2.COLOR_GRAY2BGR) for _ in range(5)]
    for k in range(FILM_S * FILM_HZ):
        writer.write(pictures[k % len(pictures)])
    writer.release()
    return folder


def run_with(line: PtyLine) -> list[str]:
    """The words of a run command with the robot on a line."""
    robot = f"serial:{line.path}:115200"
    return ["--path", PATH, "--tables", str(rig.small_table()), "--json", "--robot", robot]


@contextmanager
def swimming(source: str, film: Path, folder: Path) -> Iterator[tuple[LiveRobot, Terminal]]:
    """The command with its robot on a line; fixes from a video, or piped in by a tracker."""
    robot = LiveRobot()
    with PtyLine(folder / "robot", robot) as line:
        words = [*run_with(line), "--out", "run.h5", "--begin", "here"]
        if source == "camera":
            words += ["--fixes", str(film / "camera.toml"), "--source", str(film / "film.avi")]
        else:
            words += ["--fixes", "stdin"]
        piped = LivePool(robot.pulses) if source == "tracker" else None
        with seated(folder, words, piped) as terminal:
            terminal.wait(lambda: ASKED in terminal.said)
            assert b"start check: battery: unknown, not measured by this robot" in terminal.said
            assert "ARM" not in robot.names()
            yield robot, terminal


@from_ci
@pytest.mark.parametrize("source", some(["camera", "tracker"], 1))
def test_enter_arms_and_any_key_stops(source: str, film: Path, tmp_path: Path) -> None:
    with swimming(source, film, tmp_path) as (robot, terminal):
        terminal.press(b"x ")
        time.sleep(0.3)
        assert "ARM" not in robot.names(), "armed by another key than Enter"
        terminal.press(b"\n")
        terminal.wait(lambda: robot.pulses and PLAN.search(terminal.said))
        assert "ARM" in robot.names()
        pressed_s = time.monotonic()
        terminal.press(b"q")
        code, reported = terminal.result()
        assert code == 0, bytes(terminal.said[-1000:])
        stopped_s = next(at_s for at_s, frame in robot.heard if frame.name == "STOP")
        assert stopped_s > pressed_s and all(at_s <= stopped_s for at_s, _, _ in robot.pulses)
        assert [name for name in robot.names() if name != "FIX"][-3:] == ["STOP", "DISARM", "STATUS"]
        assert int(robot.core.ask("STATUS")["state"]) == STATE["DISARMED"]
    assert json.loads(reported)["ended"] == STOPPED
    log = read_run(tmp_path / "run.h5")
    assert not part_of(tmp_path / "run.h5").exists(), "the log is whole"
    assert log.notes == STOPPED and len(log.decisions) == json.loads(reported)["decisions"] >= 1
    assert (log.fixes.extra["robot_status"] == 0).sum() > 3


@from_ci
@pytest.mark.parametrize("source", some(["camera", "tracker"], 1))
def test_ctrl_c_at_the_question_arms_nothing(source: str, film: Path, tmp_path: Path) -> None:
    with swimming(source, film, tmp_path) as (robot, terminal):
        terminal.press(b"\x03")
        assert terminal.result() == (130, "")
        assert b"interrupted" in terminal.said
        assert "ARM" not in robot.names() and not robot.pulses
        assert int(robot.core.ask("STATUS")["state"]) == STATE["DISARMED"]
    assert not (tmp_path / "run.h5").exists()


@from_ci
def test_in_the_background_of_a_terminal_nothing_is_asked(tmp_path: Path) -> None:
    """The system halts a background program that reads keys or changes the terminal's settings."""
    robot = LiveRobot()
    with PtyLine(tmp_path / "robot", robot) as line:
        words = [*run_with(line), "--simulated-time", "0.5", "--fixes", "stdin"]
        with seated(tmp_path, words, LivePool(robot.pulses), in_front=False) as terminal:
            code, reported = terminal.result()
    assert code == 0, bytes(terminal.said[-1000:])
    assert json.loads(reported)["decisions"] == 1 and ASKED not in terminal.said
