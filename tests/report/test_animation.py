"""Animations of swims: number of pictures, content, refusals."""

from __future__ import annotations

import dataclasses
import json
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from tests.conftest import from_ci
from tests.der.single import simulate_gait

from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.core.poses import wrap_angle
from frogkick.effects.swims import simulate_actions
from frogkick.paths import Path as SwimPath
from frogkick.report import animation, style
from frogkick.report.animation import actions_swim, film, gait_swim, run_swim, write_animation
from frogkick.robot import load_robot
from frogkick.runs.runlog import Decisions, Fixes, RunLog, Strokes
from frogkick.runs.runlog_file import write_run

FROG = load_robot("frog2022")
HEX = load_robot("hexapod")


def count_of(picture: np.ndarray, colour: str) -> int:
    ink = np.round(255 * np.array(to_rgb(colour))).astype(int)
    return int((np.abs(picture.astype(int) - ink).max(axis=2) <= 2).sum())


def pictures_of(file: Path) -> list[np.ndarray]:
    found = []
    with Image.open(file) as moving:
        for k in range(moving.n_frames):
            moving.seek(k)
            found.append(np.asarray(moving.convert("RGB")))
    return found


def test_the_film_is_the_simulated_swim() -> None:
    swim = actions_swim(FROG, [FROG.action("B"), FROG.action("C")], (0.02, 0.0, 0.1))
    shot = film(swim)
    assert shot.time_s == pytest.approx(np.arange(58) / 20)
    assert shot.speed == 1.0
    reference = simulate_actions(FROG, ["B", "C"], (0.02, 0.0, 0.1))
    x_m = np.interp(shot.time_s, reference.time_s, reference.pose_world[:, 0])
    assert shot.pose_world[:, 0] == pytest.approx(x_m, abs=1e-4)
    # Front limbs at once, rear ones a pulse later, only front left in the second stroke (at 1.425 s).
    assert shot.heated[0] == 0b0011
    assert shot.heated[2] == 0b1100
    assert shot.heated[29] == 0b0010
    assert shot.heated[31] == 0b1100
    assert shot.heated[10] == 0


def test_a_run_s_film_is_where_its_fixes_were(tmp_path: Path) -> None:
    time_s = np.linspace(0.5, 2.5, 21)
    x_m, y_m, heading_rad = 0.1 * time_s, 0.05 * time_s, 2.6 + 0.4 * time_s

    def seen(count: int) -> Fixes:
        columns = (time_s, time_s, x_m, y_m, wrap_angle(heading_rad), np.ones(21), np.zeros(21))
        return Fixes(*(column[:count] for column in columns))

    log = RunLog(
        "frog2022", "a.h5", 1.425, 0.08, ("A", "B"), seen(21),
        Decisions(np.array([0.6]), np.array([1]), np.array([1]), np.zeros(1)),
        Strokes(np.array([0.6]), np.array([0b0011]), np.array([0.08])),
        SwimPath.from_arrays(np.array([0.0, 0.5]), np.zeros(2), np.zeros(2), "here"),
    )  # fmt: skip
    swim = run_swim(log)
    assert swim.title == "frog2022 along here"
    assert swim.pulses == ((pytest.approx(0.1), 0b0011),)
    shot = film(swim)
    assert shot.time_s == pytest.approx(np.arange(41) / 20)
    assert shot.pose_world[::2] == pytest.approx(np.column_stack([x_m, y_m, heading_rad]))
    assert np.hypot(*(shot.nodes_m - shot.pose_world[:, None, :2]).T).max() < 0.12, "the robot is there"
    assert list(shot.heated[:5]) == [0, 0, 3, 3, 0]
    write_run(tmp_path / "run.h5", log)
    assert run_command(["log", "show", str(tmp_path / "run.h5"), "--out", str(tmp_path / "run.gif")]) == 0
    assert len(pictures_of(tmp_path / "run.gif")) == 41
    with pytest.raises(InputError, match="fewer than 2 usable position fixes"):
        run_swim(dataclasses.replace(log, fixes=seen(1), decisions=Decisions(*np.zeros((4, 0)))))


def test_a_gait_s_film_is_the_simulated_gait() -> None:
    shot = film(gait_swim(FROG, 10.0, 0.8, 0.5, 2))
    reference = simulate_gait(FROG, 10.0, 0.8, 0.5, 2)
    x_m = np.interp(shot.time_s, reference.time_s, reference.pose_world[:, 0])
    assert shot.pose_world[:, 0] == pytest.approx(x_m, abs=1e-4)


def test_long_swims_are_shown_faster_and_stay_small(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(animation, "PICTURES_MAX", 12)
    swim = actions_swim(HEX, [HEX.action("E")] * 3)
    shot = film(swim)
    assert len(shot.time_s) == 12
    assert shot.time_s[-1] == pytest.approx(3 * HEX.period_s)
    assert shot.speed == pytest.approx(3 * HEX.period_s / 11 * 20)
    reported = write_animation(swim, tmp_path / "x.gif")
    assert reported["pictures"] == 12
    assert reported["bytes"] < 12 * 30_000
    # Each group that fires is seen in at least one picture, though the pulses are shorter than the spacing.
    assert {0b101001, 0b010110} <= {
        mask & both for mask in shot.heated.tolist() for both in (0b101001, 0b010110)
    }


def test_the_gif_shows_frame_limbs_and_trail(tmp_path: Path) -> None:
    file = tmp_path / "swim.gif"
    done: list[tuple[int, int]] = []
    swim = actions_swim(HEX, [HEX.action("B")])
    reported = write_animation(swim, file, lambda k, n: done.append((k, n)))
    pictures = pictures_of(file)
    assert reported == {"pictures": 22, "rate_hz": 20, "speed": 1.0, "bytes": file.stat().st_size}
    assert done[-1] == (22, 22)
    with Image.open(file) as moving:
        assert moving.info["duration"] == 50
        assert moving.info["loop"] == 0
    assert len(pictures) == 22
    first, last = pictures[0], pictures[-1]
    assert first.shape[1] == animation.WIDTH_PX
    assert animation.HEIGHT_MIN_PX <= first.shape[0] <= animation.HEIGHT_MAX_PX
    # Four limbs are heated at first, two are not; at the end none; the trail grows.
    assert count_of(first, style.ALARM) > 1.5 * count_of(first, style.TRUE) > 0
    assert count_of(last, style.ALARM) == 0
    assert count_of(last, style.TRUE) > 2 * count_of(first, style.TRUE)
    assert count_of(last, style.ESTIMATED) > count_of(first, style.ESTIMATED) + 5
    assert count_of(last, "#000000") > 100


@from_ci
def test_the_same_swim_gives_the_same_bytes(tmp_path: Path) -> None:
    swim = actions_swim(FROG, [FROG.action("A")])
    for name in ("one.gif", "two.gif"):
        write_animation(swim, tmp_path / name)
    assert (tmp_path / "one.gif").read_bytes() == (tmp_path / "two.gif").read_bytes()


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "swim.gif"
    assert run_command(
        ["simulate", "streamlined", "--actions", "C", "--animation", str(file), "--json"]
    ) == 0  # fmt: skip
    output = json.loads(capsys.readouterr().out)
    assert output["animation"]["pictures"] == len(pictures_of(file)) == 29
    assert output["speed_mps"] > 0.0
    assert run_command(["simulate", "--actions", "C", "--animation", str(tmp_path / "swim.avi")]) == 2
    assert "does not end in .gif or .mp4" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["swim.gif"]


class Recorder:
    """Replaces cv2.VideoWriter where OpenCV is not installed: keeps what it is given."""

    opens = True
    pictures: list[np.ndarray]

    def __init__(self, file: str, code: int, rate_hz: float, size: tuple[int, int]) -> None:
        self.file, self.rate_hz, self.size = Path(file), rate_hz, size
        Recorder.pictures = []

    def isOpened(self) -> bool:
        return self.opens

    def write(self, picture: np.ndarray) -> None:
        assert picture.shape == (self.size[1], self.size[0], 3)
        assert picture.flags.c_contiguous
        assert self.rate_hz == 20.0
        self.pictures.append(picture)

    def release(self) -> None:
        self.file.write_bytes(b"mp4")


@pytest.mark.parametrize("opens", [True, False])
def test_mp4_gets_pictures_in_opencvs_order(
    opens: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module: Any = types.ModuleType("cv2")
    module.VideoWriter = Recorder
    module.VideoWriter_fourcc = lambda *letters: len(letters)
    monkeypatch.setattr(Recorder, "opens", opens)
    monkeypatch.setitem(sys.modules, "cv2", module)
    swim = actions_swim(FROG, [FROG.action("A")])
    if not opens:
        with pytest.raises(Exception, match="no MP4 encoder"):
            write_animation(swim, tmp_path / "x.mp4")
        assert list(tmp_path.iterdir()) == []
        return
    write_animation(swim, tmp_path / "x.mp4")
    assert len(Recorder.pictures) == 29
    assert all(side % 2 == 0 for side in Recorder.pictures[0].shape[:2])
    assert count_of(Recorder.pictures[0][:, :, ::-1], style.ALARM) > 20
    assert count_of(Recorder.pictures[0], style.ALARM) == 0


def test_opencv_writes_a_readable_mp4(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: .mp4 is not tried")
    write_animation(actions_swim(FROG, [FROG.action("A")]), tmp_path / "x.mp4")
    video = cv2.VideoCapture(str(tmp_path / "x.mp4"))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == 29


def test_names_are_checked_before_anything_is_simulated(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.gif or \.mp4"):
        animation.require_animation_name(tmp_path / "x.png")
