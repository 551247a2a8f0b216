"""From camera to limbs: a robot on a line swims by pictures of its own pool."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import count, from_ci
from tests.link.live_robot import LiveRobot
from tests.link.rigged import rigged
from tests.link.swim import PATH, LivePool
from tests.runs import rig
from tests.vision.scenes import calibration, scene

from frogkick.core.errors import InputError
from frogkick.effects import World
from frogkick.front import bench
from frogkick.link.pty_line import PtyLine
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import ENDED, TIME, run_session
from frogkick.runs.lab_session import lab_session
from frogkick.runs.record import RunOptions
from frogkick.runs.runlog_file import read_run
from frogkick.runs.summary import summary
from frogkick.runs.tracked_fixes import CameraFixes
from frogkick.vision.calibration import write_calibration
from frogkick.vision.sources import Frame

PERIOD_S = rig.PERIOD_S
SCENE = scene(noise=3.0)
START = (0.35, 0.45, 0.2)
"""In the rendered pool, where the simulated one has its origin."""


def placed(pose: np.ndarray) -> tuple[float, float, float]:
    """A pose of the simulated pool in the rendered one."""
    c, s = np.cos(START[2]), np.sin(START[2])
    x, y, heading = (float(value) for value in pose)
    return START[0] + c * x - s * y, START[1] + s * x + c * y, heading + START[2]


class Filmed:
    """Live pictures of the pool, with the robot where its real pulses have moved it."""

    def __init__(self, robot: LiveRobot, rate_hz: float = 20.0) -> None:
        self.pool = LivePool(robot.pulses)
        self.rate_hz = rate_hz
        self.rng = np.random.default_rng(4)

    def __iter__(self) -> Iterator[Frame]:
        sequence, begin_s = 0, time.monotonic()
        while True:
            time.sleep(max(0.0, begin_s + sequence / self.rate_hz - time.monotonic()))
            taken_s = time.monotonic()
            self.pool.swim()
            reported = self.pool.pool.truth.pose_world
            pose = np.array(reported[-1] if reported else (0.0, 0.0, 0.0))
            yield Frame(SCENE.picture(placed(pose), self.rng), taken_s, sequence, True)
            sequence += 1


@from_ci
def test_a_run_by_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = LiveRobot()
    path = bench.placed(shape(PATH), (), f"{START[0]},{START[1]},{np.degrees(START[2])}", START)[0]
    options = RunOptions(PlanConfig(depth=2), True, 2.2 * PERIOD_S)
    with rigged("serial", robot, tmp_path, monkeypatch) as there:
        camera = CameraFixes(iter(Filmed(robot)), calibration(SCENE), "camera")
        try:
            camera.wait_first(120.0)
            recording = run_session(lab_session(there.wire), camera, rig.recording(path, options))
        finally:
            camera.close()
    assert recording.ended == TIME and len(recording.decisions) == 3
    assert all(decision.status == 0 for decision in recording.decisions)
    assert len({at_s for at_s, _, _ in robot.pulses}) >= 3
    assert sum(fix.robot_status == 0 for fix in recording.fixes) >= 0.9 * len(recording.fixes) > 20
    tracked = recording.tracking()
    assert tracked.mean_distance_m < 0.02 and tracked.progress_mps > 0.005
    assert camera.reasons["found"] >= 0.95 * sum(camera.reasons.values())


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration, and a folder of pictures of a robot that rests for three seconds."""
    folder = tmp_path_factory.mktemp("filmed")
    (folder / "pictures").mkdir()
    rng = np.random.default_rng(5)
    different = [SCENE.picture(START, rng) for _ in range(count(90, 90, 9))]
    for k in range(90):
        cv2.imwrite(str(folder / "pictures" / f"{k:03d}.png"), different[k % len(different)])
    write_calibration(folder / "camera.toml", calibration(SCENE))
    return folder


def test_what_a_page_draws_is_compiled_before_the_robot_is_looked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Compiling takes two minutes on a new installation; during a run, fixes would come late."""
    done = []

    def opened(*_given: object) -> None:
        raise InputError("no camera")

    def warmed(*_given: object) -> SimpleNamespace:
        done.append("planner")
        return SimpleNamespace(status=0)

    monkeypatch.setattr(bench, "warm_up", warmed)
    monkeypatch.setattr(bench, "tree_of", lambda *_given: done.append("what a page draws"))
    monkeypatch.setattr(bench.Bench, "opened", opened)
    for drawn, compiled in ((False, []), (True, ["planner", "what a page draws"])):
        done.clear()
        lab = bench.Bench("serial:frog", "camera.toml", battery_v=12.0, view=drawn)
        with pytest.raises(InputError, match="no camera"):
            bench.run_on_bench(
                lab,
                World(),
                rig.small_table(),
                rig.recording(shape("line"), RunOptions(PlanConfig(depth=1))),
                print,
            )
        assert done == compiled


@from_ci
@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_the_command_takes_a_camera(filmed: Path, tmp_path: Path) -> None:
    """The pictures end, like those of a covered camera, so the robot ends the run by itself."""
    robot, said = LiveRobot(), ""
    with PtyLine(tmp_path / "robot", robot) as line:
        process = subprocess.Popen(
            [
                sys.executable, "-m", "frogkick.cli.main", "run", "--path", PATH, "--json", "--view",
                "--tables", str(rig.small_table()), "--robot", f"serial:{line.path}:115200",
                "--fixes", str(filmed / "camera.toml"), "--source", str(filmed / "pictures"),
                "--begin", "here", "--out", str(tmp_path / "run.h5"), "--battery-v", "11.9",
            ],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            assert process.stderr is not None
            while not (found := re.search(r"drawn at (http://\S+)", said)):
                read = process.stderr.readline()
                assert read, said
                said += read
            with urllib.request.urlopen(found[1] + "picture.jpg", timeout=60.0) as answer:
                shown = cv2.imdecode(np.frombuffer(answer.read(), dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
            told_json, more = process.communicate(timeout=300)
        finally:
            process.kill()
            process.wait()
    said += more
    assert process.returncode == 1, said
    assert "the path was not completed, as position fixes stopped coming" in said.splitlines()[-1]
    first = cv2.imread(str(filmed / "pictures" / "000.png"), cv2.IMREAD_GRAYSCALE)
    assert shown.shape == first.shape and np.abs(shown.astype(float) - first).mean() < 6.0, "its picture"
    output = json.loads(told_json)
    checks = [line.split(": ")[1] for line in said.splitlines() if line.startswith("start check: ")]
    assert checks == ["position fixes", "path", "table", "battery"], said
    assert output["ended"] == ENDED["STALE"] and output["decisions"] >= 1
    assert "start check: battery: 11.9 V, measured by hand" in said
    log = read_run(tmp_path / "run.h5")
    assert log.measured["battery_v"] == 11.9 and summary(log).battery_v == 11.9
    assert log.path is not None
    assert log.path.points_m[0] == pytest.approx(START[:2], abs=2e-3), "it begins where the robot is"
    assert float(np.hypot(log.fixes.x_m - START[0], log.fixes.y_m - START[1]).max()) < 2e-3


def test_a_path_outside_the_pool_is_refused_before_the_robot_is_looked_for(
    filmed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = frogkick(
        capsys, "run", "--tables", rig.small_table(), "--robot", "serial:/dev/none", "--path", PATH,
        "--fixes", filmed / "camera.toml", "--source", filmed / "pictures", "--begin", "1.1,0.8,0",
    )  # fmt: skip
    assert (output.code, output.stdout) == (2, "")
    assert output.stderr.count("\n") == 1 and "the pool is 1.2 x 0.9 m" in output.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--fixes none.toml", "none.toml"),
        ("--fixes CAMERA --source none", "source 'none' is no camera number"),
        ("--fixes CAMERA --source PICTURES --begin there", "--begin is 'there'"),
    ],
)
def test_what_is_no_camera(
    filmed: Path, capsys: pytest.CaptureFixture[str], options: str, words: str
) -> None:
    given = options.replace("CAMERA", str(filmed / "camera.toml"))
    given = given.replace("PICTURES", str(filmed / "pictures"))
    output = frogkick(
        capsys, "run", "--tables", rig.small_table(), "--robot", "serial:/dev/none", *given.split()
    )
    assert (output.code, output.stdout) == (2, "")
    assert output.stderr.count("\n") == 1 and words in output.stderr
