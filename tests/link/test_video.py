"""``run --video``: the pictures beside the log, each with its time; readable after a kill."""

from __future__ import annotations

import csv
import subprocess
import sys
import textwrap
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import from_ci
from tests.link.live_robot import LiveRobot
from tests.link.test_run_camera import filmed  # noqa: F401 - a fixture
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.link.pty_line import PtyLine
from frogkick.runs.runlog_file import read_run
from frogkick.vision.video import LOOK_EVERY, Video, times_of, video_of


def pictures_of(video: Path) -> list[np.ndarray]:
    capture, found = cv2.VideoCapture(str(video)), []
    while True:
        ok, image = capture.read()
        if not ok:
            capture.release()
            return found
        found.append(np.asarray(image))


def rows_of(table: Path) -> list[tuple[int, float]]:
    with table.open(encoding="utf-8", newline="") as handle:
        return [(int(row["frame"]), float(row["capture_time_s"])) for row in csv.DictReader(handle)]


def test_pictures_and_times(tmp_path: Path) -> None:
    log = tmp_path / "run.h5"
    video = Video(log, zero_s=100.0)
    for k in range(12):
        image = np.full((48, 64), 10 * k, np.uint8)
        video.write(image if k % 2 else np.dstack([image] * 3), 100.5 + k / 20)
    video.close()
    found = pictures_of(video_of(log))
    assert [round(float(image.mean()) / 10) for image in found] == list(range(12))
    assert rows_of(times_of(log)) == [(k, pytest.approx(0.5 + k / 20)) for k in range(12)]


def test_a_kill_leaves_what_was_written(tmp_path: Path) -> None:
    program = """
        import os, sys
        from pathlib import Path
        import numpy as np
        from frogkick.vision.video import Video
        video, rng = Video(Path(sys.argv[1]), 0.0), np.random.default_rng(0)
        for k in range(60):
            video.write(rng.integers(0, 255, (240, 320), np.uint8), k / 30)
        os.kill(os.getpid(), 9)
    """
    log = tmp_path / "run.h5"
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program), str(log)], capture_output=True, check=False
    )
    assert done.returncode == -9
    assert 55 <= len(pictures_of(video_of(log))) <= 60  # the last ones may wait in the library's buffer
    assert len(rows_of(times_of(log))) == 60


def test_a_disk_that_takes_no_more_is_said(tmp_path: Path) -> None:
    video = Video(tmp_path / "run.h5", 0.0)
    image = np.zeros((48, 64), np.uint8)

    class Stuck:
        def write(self, _image: object) -> None: ...

        def release(self) -> None: ...

    video.write(image, 0.0)
    video._writer.release()
    video._writer = Stuck()

    def go_on() -> None:
        for k in range(2 * LOOK_EVERY):
            video.write(image, k / 30)

    with pytest.raises(InputError, match=r"run\.avi' cannot be continued: is the disk full\?"):
        go_on()
    video.close()


@from_ci
def test_the_command_keeps_them(filmed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:  # noqa: F811
    robot, log = LiveRobot(), tmp_path / "run.h5"
    with PtyLine(tmp_path / "robot", robot) as line:
        output = frogkick(
            capsys, "run", "--path", "line", "--tables", rig.small_table(), "--robot", f"serial:{line.path}",
            "--fixes", filmed / "camera.toml", "--source", filmed / "pictures", "--begin", "here",
            "--simulated-time", "0.5", "--out", log, "--video", "--json",
        )  # fmt: skip
    assert output.code == 0, output.stderr
    rows, run = rows_of(times_of(log)), read_run(log)
    assert len(pictures_of(video_of(log))) == len(rows) >= 5
    # The fixes of the log are of these pictures, and say so by the same times.
    times_s = np.array([time_s for _, time_s in rows])
    nearest_s = [float(np.abs(times_s - at_s).min()) for at_s in run.fixes.capture_time_s]
    assert sorted(nearest_s)[len(nearest_s) // 2] < 0.01 and np.all(np.diff(times_s) > 0.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--robot pool --out run.h5", "this run has no camera: give --fixes camera.toml"),
        ("--robot serial:/dev/none --fixes stdin --out run.h5", "this run has no camera"),
        ("--robot serial:/dev/none --fixes camera.toml", "give --out run.h5"),
    ],
)
def test_a_video_of_nothing_is_refused(capsys: pytest.CaptureFixture[str], options: str, words: str) -> None:
    output = frogkick(capsys, "run", "--tables", rig.small_table(), "--video", *options.split())
    assert (output.code, output.stdout) == (2, "")
    assert output.stderr.count("\n") == 1 and words in output.stderr
