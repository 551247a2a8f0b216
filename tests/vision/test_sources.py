"""Sources of pictures, and their errors."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image
from tests.vision.scenes import calibration, scene, scene_frames

from frogkick.core.errors import InputError
from frogkick.vision.board import picture_files, read_picture
from frogkick.vision.sources import FROZEN_FRAMES, live_frames, open_source
from frogkick.vision.tracker import Tracker


def test_rendered_frames_from_source_to_pose() -> None:
    usual = scene()
    tracker = Tracker(calibration(usual))
    source = scene_frames(usual, lambda t: (0.4 + t, 0.5, 0.2), np.random.default_rng(31), rate_hz=10)
    for k, frame in enumerate(itertools.islice(source, 3)):
        seen = tracker.observe(frame.image)
        assert seen.pose is not None
        assert frame.sequence == k and frame.capture_s == pytest.approx(k / 10)
        assert seen.pose.x_m == pytest.approx(0.4 + k / 10, abs=1e-3)


def test_a_folder_of_pictures(tmp_path: Path) -> None:
    for name, level in (("b.png", 20), ("a.png", 10), ("notes.txt", 0)):
        (tmp_path / name).write_bytes(cv2.imencode(".png", np.full((8, 8), level, np.uint8))[1].tobytes())
    frames = list(open_source(str(tmp_path), rate_hz=4.0))
    assert [int(frame.image[0, 0]) for frame in frames] == [10, 20]
    assert [frame.capture_s for frame in frames] == [0.0, 0.25]


def test_numbers_in_names_count_by_their_value(tmp_path: Path) -> None:
    names = ["frame2.png", "frame10.png", "frame0.png", "Frame1.png", "board 7 b.png", "board 7 a2.png"]
    for name in names:
        (tmp_path / name).touch()
    ordered = [file.name for file in picture_files(tmp_path)]
    assert ordered == [
        "board 7 a2.png",
        "board 7 b.png",
        "frame0.png",
        "Frame1.png",
        "frame2.png",
        "frame10.png",
    ]


@pytest.mark.parametrize("turn", range(1, 9))
def test_a_note_to_turn_a_picture_is_ignored(turn: int, tmp_path: Path) -> None:
    """Else half of a board's pictures, taken with the phone upright, give a lens that is off."""
    levels = np.zeros((16, 24), np.uint8)
    levels[:4, :4] = 200
    note = Image.Exif()
    note[274] = turn
    Image.fromarray(levels).save(tmp_path / "turned.png", exif=note)
    assert np.array_equal(read_picture(tmp_path / "turned.png"), levels)


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_levels_of_more_than_8_bits_are_scaled(bits: int, tmp_path: Path) -> None:
    levels = np.array(
        [[0, (1 << bits) - 1], [1 << (bits - 1), 3 << (bits - 2)]], np.uint8 if bits == 8 else np.uint16
    )
    cv2.imwrite(str(tmp_path / "deep.png"), levels)
    assert read_picture(tmp_path / "deep.png").tolist() == [[0, 255], [128, 192]]


def test_levels_that_are_no_whole_numbers_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "float.tiff"), np.full((8, 8), 0.5, np.float32))
    with pytest.raises(InputError, match=r"float\.tiff' has levels of type float32: store 8 or 16 bits"):
        read_picture(tmp_path / "float.tiff")


def test_a_video(tmp_path: Path) -> None:
    file = str(tmp_path / "x.avi")
    writer = cv2.VideoWriter(file, cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
    assert writer.isOpened()
    for level in (0, 100, 200):
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    frames = list(open_source(file))
    assert [frame.sequence for frame in frames] == [0, 1, 2]
    assert np.allclose([frame.image.mean() for frame in frames], [0, 100, 200], atol=4)
    assert np.allclose(np.diff([frame.capture_s for frame in frames]), 0.05, atol=0.01)


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("device:97", "camera 97 cannot be opened: is it plugged in"),
        ("device:front", "a camera is a number"),
        ("none.mp4", "is no camera number, video file or folder"),
        ("text.mp4", "cannot be opened: is it a video|is no video that can be read"),
        ("empty", "holds no picture"),
        ("broken", "is not a readable picture"),
    ],
)
def test_what_is_no_source(source: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("text.mp4").write_text("this is no video\n" * 100)
    Path("empty").mkdir()
    Path("broken").mkdir()
    Path("broken/a.png").write_text("no picture")
    with pytest.raises(InputError, match=says):
        list(open_source(source))


class Camera:
    """Replaces cv2.VideoCapture: gives prepared pictures, then none."""

    def __init__(self, pictures: list[np.ndarray]) -> None:
        self._pictures = iter(pictures)
        self._now: np.ndarray | None = None

    def grab(self) -> bool:
        self._now = next(self._pictures, None)
        return self._now is not None

    def retrieve(self) -> tuple[bool, np.ndarray | None]:
        return self._now is not None, self._now


def noisy(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(32)
    return [rng.integers(0, 255, (8, 8), dtype=np.uint8) for _ in range(count)]


def test_a_camera_that_stops_is_told() -> None:
    stopped: Any = Camera(noisy(3))
    frames = live_frames(stopped, "camera 0")
    assert [next(frames).sequence for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputError, match="camera 0 gave no picture after 3"):
        next(frames)


def test_a_camera_that_freezes_is_told() -> None:
    frozen: Any = Camera(noisy(2) + [noisy(1)[0]] * 50)
    frames = live_frames(frozen, "camera 0")
    seen = list(itertools.islice(frames, 2 + FROZEN_FRAMES))
    with pytest.raises(InputError, match="is frozen: 9 equal pictures"):
        next(frames)
    assert len(seen) == 10
