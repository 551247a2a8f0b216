"""All commands that talk with a robot, against ``frogkick pool``, without hardware."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import from_ci
from tests.planner import synthetic
from tests.runs import rig
from tests.vision.scenes import scene

from frogkick.core.files import write_bytes
from frogkick.link.auth import read_keys
from frogkick.runs.record import DROPPED, TIME
from frogkick.runs.runlog_file import read_run

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")

PERIOD_S = rig.PERIOD_S
COMMAND = (sys.executable, "-m", "frogkick.cli.main")
BEGIN = (0.36, 0.45, 0.0)


class Served:
    """``frogkick pool`` in its own process and folder."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.folder = folder
        self.process = subprocess.Popen(
            [*COMMAND, "pool", "--tables", str(rig.small_table()), "--json", *options],
            cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            start_new_session=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        self.told: dict[str, Any] = json.loads(line) if line else {}
        self.target, self.source = self.told.get("target", ""), self.told.get("source", "")

    def act(self, words: str) -> str:
        """Send it a line; return its answer."""
        assert self.process.stdin is not None and self.process.stderr is not None
        self.process.stdin.write(f"{words}\n")
        self.process.stdin.flush()
        return self.process.stderr.readline().removeprefix("frogkick: ").strip()

    def end(self, number: signal.Signals = signal.SIGINT) -> tuple[int, str]:
        """Interrupt it; return exit code and output."""
        if self.process.poll() is None:
            os.kill(self.process.pid, number)
        _, said = self.process.communicate(timeout=60.0)
        return self.process.returncode, said


@contextmanager
def serving(folder: Path, *options: str) -> Iterator[Served]:
    served = Served(folder, *options)
    try:
        yield served
    finally:
        if served.process.poll() is None:
            served.process.kill()
        served.process.communicate()


@pytest.fixture(scope="module")
def pool(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("pool")) as served:
        assert re.fullmatch(r"serial:/dev/\S+", served.target), served.target
        yield served


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A user without a key."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))


@pytest.fixture(scope="module")
def camera(pool: Served) -> Path:
    """The camera's calibration, from the corners in its picture and the camera's height."""
    usual = scene()
    rows = ", ".join(f"[{x:.1f}, {y:.1f}]" for x, y in usual.corners_px())
    (pool.folder / "corners.toml").write_text(f"corners_px = [{rows}]\n")
    out = pool.folder / "camera.toml"
    done = subprocess.run(
        [
            *COMMAND, "camera", "calibrate", "--pool", "1.2x0.9", "--image", "640x480", "--corners",
            str(pool.folder / "corners.toml"), "--camera-height-m", "1.35", "--tag-height-mm", "12", "--out",
            str(out),
        ], check=False,
    )  # fmt: skip
    assert done.returncode == 0
    return out


def run_command(pool: Served, *options: str | Path, **streams: Any) -> subprocess.Popen[str]:
    """``frogkick run`` with this robot."""
    return subprocess.Popen(
        [
            *COMMAND, "run", "--robot", pool.target, "--tables", str(rig.small_table()), "--begin", "here",
            "--json", *map(str, options),
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, **streams,
    )  # fmt: skip


def test_a_table_goes_there_and_back(
    pool: Served, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    built_in = rig.tables().crc32
    assert pool.told["table_crc"] == f"{built_in:08x}"
    write_bytes(tmp_path / "new.fkt", synthetic.affine_image(20, 9, 2))
    output = frogkick(capsys, "push", tmp_path / "new.fkt", "--robot", pool.target, "--json")
    assert output.code == 0, output.stderr
    assert output.json["bytes_sent"] > 1000 and output.json["kept_crc"] == f"{built_in:08x}"
    assert pool.act("restart") == "the robot was switched off and on"
    again = frogkick(capsys, "push", tmp_path / "new.fkt", "--robot", pool.target, "--json")
    assert (again.code, again.json["bytes_sent"]) == (0, 0), "its flash outlived that"
    back = frogkick(capsys, "push", "--rollback", "--robot", pool.target, "--json")
    assert back.code == 0 and back.json["table_crc"] == f"{built_in:08x}"


def test_it_gets_an_owner_and_loses_him(
    pool: Served, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    key, other = tmp_path / "mine.key", tmp_path / "other.key"
    output = frogkick(capsys, "own", "--robot", pool.target, "--key", key)
    assert output.code == 0 and len(read_keys(key)) == 1, output.stderr
    other.write_text("ab" * 32)
    stranger = frogkick(capsys, "push", "--rollback", "--robot", pool.target, "--key", other)
    assert stranger.code == 2 and "key" in stranger.stderr
    output = frogkick(capsys, "own", "--robot", pool.target, "--key", key, "--release")
    assert output.code == 0, output.stderr


@from_ci
def test_a_run_by_a_tracker_s_lines_and_the_robot_s_log(
    pool: Served, camera: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What ``camera track`` finds in the pictures, piped into ``run --fixes stdin``."""
    options = ("--fixes", "stdin", "--simulated-time", f"{2.5 * PERIOD_S}", "--out", tmp_path / "run.h5")
    for _ in range(3):
        assert pool.act("put 0.3,0.4,20") == "the robot lies at 0.3, 0.4 m, 20 degrees"
        tracker = subprocess.Popen(
            [*COMMAND, "camera", "track", str(camera), "--source", pool.source],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            running = run_command(pool, *options, stdin=tracker.stdout)
            reported, said = running.communicate(timeout=120.0)
        finally:
            tracker.terminate()
            _, tracked = tracker.communicate()
        if "has given no picture for" not in tracked:  # as on a machine too busy to draw them
            break
    assert running.returncode == 0, said + tracked
    numbers, log = json.loads(reported), read_run(tmp_path / "run.h5")
    assert numbers["ended"] == TIME and numbers["decisions"] >= 2 and numbers["progress_mps"] > 0.005
    assert (log.fixes.x_m[0], log.fixes.y_m[0]) == pytest.approx((0.3, 0.4), abs=1e-3)
    assert np.hypot(log.fixes.x_m[-1] - 0.3, log.fixes.y_m[-1] - 0.4) > 0.01, "it swam"
    fetched = frogkick(capsys, "log", "fetch", "--robot", pool.target, "--out", tmp_path / "log.h5")
    assert fetched.code == 0, fetched.stderr
    replayed = frogkick(capsys, "log", "replay", tmp_path / "log.h5", "--tables", rig.small_table(), "--json")
    assert replayed.code == 0, replayed.stderr
    assert replayed.json["decisions"] == numbers["decisions"]


@from_ci
def test_a_run_by_pictures_that_a_page_shows(pool: Served, camera: Path, tmp_path: Path) -> None:
    pool.act("put")
    options = ("--fixes", camera, "--source", pool.source, "--view", "--simulated-time", f"{2.5 * PERIOD_S}")
    running = run_command(pool, *options, "--out", tmp_path / "run.h5", stdin=subprocess.DEVNULL)
    said = ""
    try:
        assert running.stderr is not None
        while not (found := re.search(r"drawn at (http://\S+)", said)):
            read = running.stderr.readline()
            assert read, said
            said += read
        with urllib.request.urlopen(found[1] + "picture.jpg", timeout=60.0) as answer:
            shown = cv2.imdecode(np.frombuffer(answer.read(), dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
            corners = np.array(json.loads(answer.headers["X-Tag"]))
        reported, more = running.communicate(timeout=120.0)
    finally:
        running.kill()
        running.communicate()
    assert running.returncode == 0, said + more
    usual = scene()
    expected = usual.picture(BEGIN, np.random.default_rng(0))
    assert shown.shape == expected.shape and np.abs(shown.astype(float) - expected).mean() < 6.0
    middle = usual.view.pixels(np.array([[BEGIN[0], BEGIN[1], usual.tag_height_m]]))[0]
    assert corners.mean(axis=0) == pytest.approx(middle, abs=2.0), "the tag's outline lies on the tag"
    numbers = json.loads(reported)
    assert numbers["ended"] == TIME and numbers["decisions"] >= 2 and numbers["progress_mps"] > 0.005
    assert numbers["mean_distance_m"] < 5e-3


def test_bad_days(pool: Served, camera: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A covered tag, a mirrored camera, a cable that comes back, unknown words."""
    pool.act("put")
    track = ("camera", "track", camera, "--source", pool.source, "--seconds", "0.5", "--json")
    assert pool.act("hide") == "the tag is covered"
    output = frogkick(capsys, *track)
    assert output.code == 1 and output.json["fixes"] == 0 and set(output.json["reasons"]) == {"no tag"}
    assert pool.act("show") == "the tag is uncovered"
    assert pool.act("mirror") == "the camera's pictures are mirrored"
    assert frogkick(capsys, *track).code == 1
    assert pool.act("mirror") == "the camera's pictures are not mirrored"
    assert frogkick(capsys, *track).code == 0
    assert pool.act("unplug") == "the cable is pulled"
    gone = frogkick(capsys, "push", "--rollback", "--robot", pool.target)
    assert gone.code == 2 and "is not there" in gone.stderr
    said = pool.act("plug")
    assert said.startswith("the cable is plugged in: serial:/dev/")
    pool.target = said.rpartition(" ")[2]
    assert frogkick(capsys, "log", "fetch", "--robot", pool.target, "--out", camera.parent / "l.h5").code == 0
    assert pool.act("hid").startswith("'hid' (did you mean 'hide'?) is no command of this pool")
    assert "outside the pool" in pool.act("put 2,0,0") and "give X,Y,DEG" in pool.act("put here")


@from_ci
def test_its_flash_outlives_it_and_its_port_keeps_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bytes(tmp_path / "new.fkt", synthetic.affine_image(20, 9, 2))
    options = ("--flash", "flash.bin", "--line", "frog")
    push = ("push", tmp_path / "new.fkt", "--robot", f"serial:{tmp_path / 'frog'}", "--json")
    with serving(tmp_path, *options) as pool:
        assert pool.target == "serial:frog"
        assert frogkick(capsys, *push).json["bytes_sent"] > 1000
        code, said = pool.end()
        assert code == 0 and re.fullmatch(
            r"frogkick: the pool is closed after \d+ s, and the robot's flash is in flash.bin\n", said
        ), said
    assert not (tmp_path / "frog").exists()
    with serving(tmp_path, *options, "--begin", "0.5,0.3,90") as pool:
        assert pool.told["begin"] == "0.5,0.3,90"
        output = frogkick(capsys, *push)
        assert output.json["bytes_sent"] == 0, "it has the table already"
        code, said = pool.end(signal.SIGTERM)
        assert code == 0 and said.count("\n") == 1, said


@from_ci
def test_the_virtual_chip_keeps_its_flash_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_bytes(tmp_path / "new.fkt", synthetic.affine_image(20, 9, 2))
    options = ("--virtual", "--flash", str(tmp_path / "chip.bin"))
    for expected in (True, False):
        with serving(tmp_path, *options) as pool:
            output = frogkick(capsys, "push", tmp_path / "new.fkt", "--robot", pool.target, "--json")
            assert output.code == 0 and bool(output.json["bytes_sent"]) is expected, output.stderr
            assert pool.end()[0] == 0
    held = bytearray((tmp_path / "chip.bin").read_bytes())
    held[0x400] ^= 1
    write_bytes(tmp_path / "chip.bin", bytes(held))
    other = frogkick(capsys, "pool", *options, "--tables", rig.small_table())
    assert other.code == 2 and "the flash holds other firmware than this table gives" in other.stderr


@from_ci
def test_a_run_whose_connection_was_lost_for_too_long(camera: Path, tmp_path: Path) -> None:
    """The robot ends the run alone, and its ENDED is lost: a run that was cut short has exit code 1."""
    with serving(tmp_path, "--line", "frog") as pool:
        pool.target = f"serial:{tmp_path / 'frog'}"
        running = run_command(
            pool, "--fixes", camera, "--source", pool.source, "--out", tmp_path / "run.h5",
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            assert running.stderr is not None
            while not (line := running.stderr.readline()).startswith("line: "):
                assert line
            pool.act("unplug")
            time.sleep(4.0)
            pool.act("plug")
            reported, said = running.communicate(timeout=120.0)
        finally:
            running.kill()
            running.communicate()
    assert running.returncode == 1, said
    assert json.loads(reported)["ended"] == DROPPED
    assert "the path was not completed, as the connection was lost" in said


@from_ci
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--begin 2,0.4,0", "--begin 2,0.4,0 is outside the pool: give x and y from 0,0 to 1.2,0.9 m"),
        ("--begin here", "--begin is 'here': give X,Y,DEG in m and degrees"),
        ("--robot bench", "'bench'"),
        ("--flash short", "flash has"),
        ("--camera none.toml", "none.toml"),
        ("--port 70000", "--port is 70000: give 1 to 65535"),
        ("--line short", "is there already, and no link to a port"),
        ("--world none.toml", "none.toml"),
    ],
)
def test_what_it_refuses(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    options: str,
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short").write_bytes(b"short")
    output = frogkick(capsys, "pool", "--tables", rig.small_table(), *options.split())
    assert (output.code, output.stdout) == (2, "")
    assert output.stderr.count("\n") == 1 and words in output.stderr
