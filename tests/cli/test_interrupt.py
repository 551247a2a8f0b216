"""Ctrl-C: one line, exit 130, no file, no process left."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from tests.cli.commands import frogkick
from tests.conftest import count, from_ci

from frogkick.core.progress import progress_bar
from frogkick.link.wire import Delivery, Wire

RECORD_S = str(count(5, 5, 0))

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="sends SIGINT to a process group")


def as_in_a_terminal() -> None:
    """What tests inherit from nohup or from a job in the background ignores some signals."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)


def group_members(group: int) -> list[int]:
    """Processes of a group that are alive, by the system's own table."""
    rows = []
    if Path("/proc/self/stat").exists():
        for file in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):  # it has ended meanwhile
                # After the name, which may hold anything: state, parent, group.
                state, _, its_group = file.read_text().rsplit(")", 1)[1].split()[:3]
                rows.append((its_group, file.parent.name, state))
    else:  # a system without that has ps; a small Linux may not
        listed = subprocess.run(
            ["ps", "-e", "-o", "pgid=,pid=,stat="], capture_output=True, text=True, check=True
        )
        rows = [tuple(line.split()) for line in listed.stdout.splitlines()]
    return [int(pid) for pgid, pid, state in rows if int(pgid) == group and not state.startswith("Z")]


@from_ci
@pytest.mark.parametrize(
    ("whole_group", "number"),
    [
        (True, signal.SIGINT),
        (False, signal.SIGINT),
        (True, signal.SIGTERM),
        (False, getattr(signal, "SIGHUP", signal.SIGTERM)),
    ],
    ids=["terminal", "one process", "timeout", "closed terminal"],
)
def test_library_build(tmp_path: Path, whole_group: bool, number: int) -> None:
    process = subprocess.Popen(
        [
            sys.executable, "-m", "frogkick.cli.main",
            "library", "build", "--states", "400", "--workers", "2", "--out", "lib.h5", "--json",
            "--record-s", RECORD_S,
        ],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=as_in_a_terminal,
    )  # fmt: skip
    assert process.stderr is not None
    try:
        first = process.stderr.readline()  # the first progress line: the workers are at it
        assert first.startswith("library: 0/"), first
        time.sleep(0.5)
        (os.killpg if whole_group else os.kill)(process.pid, number)
        stdout, stderr = process.communicate(timeout=300)
        assert process.returncode == 130
        assert stdout == ""
        complaints = [line for line in stderr.splitlines() if not line.startswith("library: ")]
        kept = [entry.name for entry in tmp_path.iterdir()]
        assert kept in ([], ["lib.h5.parts"])  # finished parts stay
        goes_on = "frogkick: finished parts are in 'lib.h5.parts': the same command resumes from there"
        interrupted = "frogkick: interrupted"
        assert complaints == [goes_on, interrupted] or (not kept and complaints == [interrupted])
        assert group_members(process.pid) == []
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


@from_ci
def test_workers_end_where_their_command_is_killed(tmp_path: Path) -> None:
    """They would wait for ever, and hold their memory."""
    process = subprocess.Popen(
        [
            sys.executable, "-m", "frogkick.cli.main",
            "library", "build", "--states", "400", "--workers", "2", "--out", "lib.h5",
        ],
        cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        deadline_s = time.monotonic() + 300.0
        while len(group_members(process.pid)) < 3 and time.monotonic() < deadline_s:
            time.sleep(0.05)
        time.sleep(0.5)
        assert len(group_members(process.pid)) >= 3
        process.kill()
        process.communicate()
        while group_members(process.pid) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        assert group_members(process.pid) == []
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


@from_ci
def test_a_simulated_run_leaves_what_was_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    process = subprocess.Popen(
        [
            sys.executable, "-m", "frogkick.cli.main",
            "run", "--robot", "virtual", "--path", "circle", "--out", "x.h5",
        ],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    assert process.stderr is not None
    try:
        for line in process.stderr:
            reported = re.match(r"circle: (\d+)/100, ", line)
            if reported and int(reported[1]) >= 20:
                break
        os.kill(process.pid, signal.SIGINT)
        _, stderr = process.communicate(timeout=300)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130
    assert [line for line in stderr.splitlines() if line.startswith("frogkick: ")] == [
        "frogkick: the recording so far is in 'x.h5.part'",
        "frogkick: interrupted",
    ]
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.h5.part"]
    monkeypatch.chdir(tmp_path)
    shown = frogkick(capsys, "log", "show", "x.h5.part", "--out", "x.png", "--json")
    assert shown.code == 0, shown.stderr
    assert shown.json["decisions"] >= 3


def test_while_it_is_still_loading(tmp_path: Path) -> None:
    program = (
        "import sys, builtins, os, signal\n"
        "from frogkick.cli.main import run_command\n"
        "real = builtins.__import__\n"
        "def load(name, *rest, **more):\n"
        "    if name == 'numba': os.kill(os.getpid(), signal.SIGINT)\n"
        "    return real(name, *rest, **more)\n"
        "builtins.__import__ = load\n"
        "sys.exit(run_command(['doctor', '--json']))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "frogkick: interrupted\n"


INSTEAD_OF_A_COMMAND = """
import os, signal, sys, time, weakref
from frogkick.cli import main
def press(*_): os.kill(os.getpid(), signal.SIGINT)
class Handle:
    def __del__(self): press()
def command(_arguments):
    {text}
    time.sleep(30.0)
    return 0
main._run = command
main.main()
"""


@pytest.mark.parametrize(
    "text",
    [
        "press()",
        "os.kill(os.getpid(), signal.SIGTERM)",
        "os.kill(os.getpid(), signal.SIGHUP)",
        "signal.signal(signal.SIGINT, signal.SIG_IGN); os.kill(os.getpid(), signal.SIGTERM)",
        "handle = Handle(); del handle",  # the interpreter prints what a destructor raises, and goes on
        "handle = set(); seen = weakref.ref(handle, press); del handle",
        "exec('press()')",  # as making a dataclass does: the interpreter would end by a signal
        # As inside threading.Condition, which has given its lock up when Ctrl-C comes.
        "import threading; lock = threading.Lock()\n    with lock: lock.release(); press()",
    ],
)
def test_wherever_the_interpreter_is(tmp_path: Path, text: str) -> None:
    (tmp_path / "instead.py").write_text(INSTEAD_OF_A_COMMAND.format(text=text))
    done = subprocess.run(
        [sys.executable, "-m", "instead"],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=25.0, preexec_fn=as_in_a_terminal,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "frogkick: interrupted\n"


class Inbox(Wire):
    """The receiving side of a wire."""

    def send(self, encoded: bytes, how: Delivery) -> None:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError


def test_an_inbox_is_open_after_a_ctrl_c_at_any_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the answer to the DISARM that follows would never be heard."""
    inbox, ended, fed = Inbox(), threading.Event(), threading.Semaphore(0)

    def feed() -> None:
        while not ended.wait(1e-4):
            inbox.put(b"x")
            fed.release()

    def press(*_: object) -> None:
        raise KeyboardInterrupt

    def hear_until(pressed_s: float) -> None:
        signal.setitimer(signal.ITIMER_REAL, pressed_s)
        while True:
            inbox.receive(1e-4)

    before = signal.signal(signal.SIGALRM, press)
    threading.Thread(target=feed, daemon=True).start()
    dice = random.Random(1)
    try:
        for _ in range(count(2000, 50_000)):
            with pytest.raises(KeyboardInterrupt):
                hear_until(dice.uniform(1e-6, 3e-4))
            while fed.acquire(blocking=False):
                pass
            assert fed.acquire(timeout=60.0), "nobody can put anything in any more"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        ended.set()


def test_a_line_of_progress_is_one_write(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a Ctrl-C comes between a text and its end, and the line that it gives stands behind that text."""
    written: list[str] = []
    monkeypatch.setattr(sys.stderr, "write", written.append)
    with progress_bar("library") as tell:
        for done in range(3):
            tell(done, 2, note="so far")
    assert written == [f"library: {done}/2, so far\n" for done in range(3)]


@from_ci
@pytest.mark.parametrize("when", ["before", "after_in_parent", "after_in_child"])
def test_while_processes_are_started(tmp_path: Path, when: str) -> None:
    """In what Python runs around a fork nothing can be raised; a new process has nobody to catch it."""
    program = (
        "import os, signal\n"
        "from frogkick.cli import main\n"
        "from frogkick.core import chunks\n"
        "real = chunks.ProcessPoolExecutor\n"
        "def press(): os.kill(os.getpid(), signal.SIGINT)\n"
        "def begin(*given, **named):\n"
        f"    os.register_at_fork({when}=press)\n"
        "    return real(*given, **named)\n"
        "chunks.ProcessPoolExecutor = begin\n"
        "import sys\n"
        "sys.argv = 'frogkick library build --states 40 --workers 2 --out lib.h5 --json "
        f"--record-s {RECORD_S}'.split()\n"
        "main.main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    complaints = [line for line in done.stderr.splitlines() if not line.startswith("library: ")]
    if when == "after_in_child":  # Ctrl-C is the parent's business, and nobody pressed it there
        assert (done.returncode, complaints) == (0, [])
    else:
        assert (done.returncode, done.stdout) == (130, "")
        assert complaints == ["frogkick: interrupted"]
