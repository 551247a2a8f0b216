"""Calibrations from corners and boards, their file, and the heights that they correct for."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from tests.vision.scenes import calibration, scene

from frogkick.core.errors import InputError
from frogkick.vision.board import calibrate_corners, read_corners
from frogkick.vision.calibration import (
    Calibration,
    Lens,
    Tag,
    calibration_text,
    read_calibration,
    refraction_offset_m,
    write_calibration,
)
from frogkick.vision.scene import looking_at

DISTORTED = (-0.18, 0.05, 0.001, -0.0005, 0.0)
POOL = np.array([[0, 0], [1.2, 0], [1.2, 0.9], [0, 0.9]])


def test_four_corners_and_a_height_tell_the_camera_s_place() -> None:
    made = calibration(scene())
    assert made.camera_m is not None
    assert np.allclose(made.camera_m, [0.7, 0.25, 1.35], atol=1e-6)


def test_a_known_lens_tells_it_without_a_height() -> None:
    view = looking_at(distortion=DISTORTED)
    corners = view.pixels(np.c_[POOL, np.zeros(4)])
    lens = Lens(view.matrix_px, np.array(DISTORTED))
    made = calibrate_corners(corners, (1.2, 0.9), view.image_px, Tag(height_m=0.02), lens=lens)
    assert made.camera_m is not None
    assert np.allclose(made.camera_m, [0.7, 0.25, 1.35], atol=1e-4)
    # Points at the tag's height, through the renderer's camera and back.
    xy = np.array([[0.1, 0.1], [1.1, 0.2], [0.6, 0.8]])
    seen = view.pixels(np.c_[xy, np.full(3, 0.02)])
    assert np.allclose(made.pool(made.undistort(seen)), xy, atol=2e-5)
    assert np.allclose(made.distort(made.pixels(xy)), seen, atol=0.02)


def test_corners_of_a_rim_above_the_water() -> None:
    view = looking_at()
    corners = view.pixels(np.c_[POOL, np.full(4, 0.05)])
    made = calibrate_corners(corners, (1.2, 0.9), view.image_px, Tag(height_m=0.01), 0.05, 1.35)
    xy = np.array([[0.1, 0.1], [1.1, 0.2], [0.6, 0.8]])
    seen = view.pixels(np.c_[xy, np.full(3, 0.01)])
    assert np.allclose(made.pool(seen), xy, atol=1e-6)


def test_what_lies_under_water_is_seen_raised() -> None:
    """Snell's law for 0.1 m of depth, 0.2 m beside the camera: the formula is within half a millimetre."""
    depth, height, off = 0.1, 1.35, 0.2
    low, high = 0.0, off
    for _ in range(60):
        x = (low + high) / 2
        sine = x / np.hypot(x, height)
        reach = x + depth * np.tan(np.arcsin(sine / 1.333))
        low, high = (x, high) if reach < off else (low, x)
    apparent = (off - x) * height / x
    assert refraction_offset_m(-depth) == pytest.approx(depth - apparent, abs=5e-4)
    assert refraction_offset_m(0.1) == 0.0


def test_the_file_gives_back_what_was_written(tmp_path: Path) -> None:
    made = calibration(scene(), mount_heading_rad=0.5, height_sd_m=0.001)
    whole = dataclasses.replace(made, lens=Lens(looking_at().matrix_px, np.array(DISTORTED)))
    for one in (made, whole):
        write_calibration(tmp_path / "c.toml", one)
        again = read_calibration(tmp_path / "c.toml")
        assert calibration_text(again) == calibration_text(one)
    assert "refraction_offset_m" in calibration_text(made)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("format = 1", "format = 9"), "has format 9"),
        (("format = 1", "# format"), "is not a calibration of a camera: give the file"),
        (("width_px = 640", "width_px = 4"), "image width is 4 px"),
        (("[image]", "[imago]"), "unknown table 'imago' \\(did you mean 'image'"),
        (("size_m = ", "sise_m = "), "lacks tag.size_m"),
        (("points = 4", "points = 4\nnote = 1"), "unknown key made.note"),
        (("id = 0", "id = 900"), "tag36h11 has no tag 900"),
        (("length_m = 1.2", 'length_m = "long"'), "cannot be used"),
        (("format = 1", "format = "), "is not TOML"),
        (("\nplace_m = [", "\nplace_m = [nan, "), "place_m is not 3 finite numbers"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    text = calibration_text(calibration(scene()))
    assert change[0] in text
    (tmp_path / "c.toml").write_text(text.replace(*change, 1))
    with pytest.raises(InputError, match=says):
        read_calibration(tmp_path / "c.toml")


@pytest.mark.parametrize(
    ("corners", "says"),
    [
        ([[10, 400], [300, 400.5], [600, 400], [30, 30]], "1, 2 and 3 lie on one line"),
        ([[10, 400], [10, 400], [600, 30], [30, 30]], "lie on one line"),
        ([[10, 400], [600, 30], [600, 400], [30, 30]], "cross over"),
        ([[10, 400], [30, 30], [600, 30], [600, 400]], "clockwise as seen from above"),
        ([[10, 400], [5000, 400], [600, 30], [30, 30]], "corner 2 at .* is far outside"),
        ([[10, 620], [470, 620], [450, 30], [30, 30]], "2 of the corners .* give --image as width x height"),
    ],
)
def test_wrong_corners_are_refused(corners: list[list[float]], says: str) -> None:
    with pytest.raises(InputError, match=says):
        calibrate_corners(np.array(corners, dtype=float), (1.2, 0.9), (640, 480), Tag())


def test_a_height_that_cannot_be_corrected_is_refused() -> None:
    corners = scene().corners_px()
    with pytest.raises(InputError, match="the camera's position is unknown: give its height"):
        calibrate_corners(corners, (1.2, 0.9), (640, 480), Tag(height_m=0.012))
    flat = calibrate_corners(corners, (1.2, 0.9), (640, 480), Tag())
    assert flat.camera_m is None
    with pytest.raises(InputError, match="does not fit the corners"):
        calibrate_corners(corners, (1.2, 0.9), (640, 480), Tag(), camera_height_m=90.0)


def test_corners_from_toml_and_csv(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text("corners_px = [[1, 2], [3, 4.5], [5, 6], [7, 8]]\n")
    (tmp_path / "c.csv").write_text("x_px,y_px\n1,2\n3,4.5\n5,6\n7,8\n")
    expected = np.array([[1, 2], [3, 4.5], [5, 6], [7, 8]])
    assert np.array_equal(read_corners(tmp_path / "c.toml"), expected)
    assert np.array_equal(read_corners(tmp_path / "c.csv"), expected)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("c.toml", "corners_px = [[1, 2]]", "has 1 corners, needed are 4"),
        ("c.toml", "corners = [[1, 2]]", "has no 'corners_px'"),
        ("c.toml", "corners_px = [[1, 2], [3, nan], [5, 6], [7, 8]]", "needed are 4"),
        ("c.toml", "corners_px = 3", "each corner is two numbers"),
        ("c.toml", "corners_px = [", "is not TOML"),
        ("c.csv", "x,y\n1,2\n", "has no 'x_px'"),
        ("c.csv", "x_px,y_px\n1,left\n", "each corner is two numbers"),
    ],
)
def test_a_wrong_corners_file_is_refused(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=says):
        read_corners(tmp_path / name)


def test_a_homography_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="not an invertible 3 x 3 matrix"):
        Calibration((640, 480), (1.2, 0.9), np.zeros((3, 3)))
