"""tagStandard41h12, the tag of the authors' robot: corner order, poses, no false poses, a missing package.

The golden picture is written from the AprilTag library's published table: its first code and the place of
each of the 41 bits.
"""

from __future__ import annotations

import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from tests.cli.commands import frogkick
from tests.conftest import count
from tests.vision.scenes import calibration, clutter, drawn_pose, errors, scene
from tests.vision.test_golden_tag import from_above, photograph

from frogkick.core.errors import InputError
from frogkick.core.poses import wrap_angle
from frogkick.vision import tags
from frogkick.vision.calibration import Tag, read_calibration
from frogkick.vision.scene import Scene
from frogkick.vision.tags import STANDARD, tag_cells
from frogkick.vision.template import fit_template, templates
from frogkick.vision.tracker import Tracker, find_corners

GOLDEN = """
##.####..
.........
#.#####..
..#####.#
..#..##..
..#.#.#.#
#.#####..
.........
##.#..#..
"""
"""Tag 41h12-0 upright: # is white, . is black."""
CODE = 0x1BD8A64AD10
BITS_X = [int(digit) for digit in "01234567348888888855876543215400000000334"]
BITS_Y = [int(digit) for digit in "00000000330123456734888888885587654321544"]
"""The AprilTag library's code of the tag, highest bit first, and the column and row of each bit."""
USUAL = replace(scene(), family=STANDARD)


def golden() -> npt.NDArray[np.float32]:
    return np.array([[float(cell == "#") for cell in row] for row in GOLDEN.split()], dtype=np.float32)


def spoilt(**conditions: float) -> Scene:
    return replace(scene(**conditions), family=STANDARD)


def test_the_drawn_tag_is_the_library_s() -> None:
    cells = np.zeros((9, 9), np.float32)
    cells[2:7, 2:7] = 1.0
    cells[3:6, 3:6] = 0.0
    for i, (x, y) in enumerate(zip(BITS_X, BITS_Y, strict=True)):
        cells[y, x] = CODE >> (40 - i) & 1
    assert np.array_equal(cells, golden())


def test_our_cells_are_the_golden_ones() -> None:
    assert np.array_equal(tag_cells(STANDARD, 0), golden())


@pytest.mark.parametrize(("turn", "heading_deg"), [(0, 90), (1, 180), (2, -90), (3, 0)])
def test_the_heading_of_the_golden_tag(turn: int, heading_deg: float) -> None:
    """As for tag36h11: the picture's top is where the robot's forward is."""
    above = from_above(0.03)
    seen = Tracker(replace(above, tag=replace(above.tag, family=STANDARD))).observe(
        photograph(golden(), turn)
    )
    assert seen.reason == "found" and seen.pose is not None
    assert np.degrees(abs(wrap_angle(seen.pose.heading_rad - np.deg2rad(heading_deg)))) < 0.1
    # 54 px across from 133 (and 93): the centre is at pixel 159.5, 119.5.
    assert np.allclose([seen.pose.x_m, seen.pose.y_m], [0.1595, 0.1195], atol=5e-5)


def test_the_corners_of_the_golden_tag() -> None:
    """Top left, top right, bottom right, bottom left of the white square, as decoded and as fitted."""
    image = photograph(golden(), 0)
    truth = np.array([[144.5, 104.5], [174.5, 104.5], [174.5, 134.5], [144.5, 134.5]])
    decoded, squares = find_corners(image, 0, 30.0, STANDARD)
    assert (len(decoded), squares) == (1, [])
    assert np.abs(decoded[0] - truth).max() < 1.5
    fit = fit_template(image, decoded[0], templates(STANDARD, 0))
    assert fit is not None
    assert np.abs(fit.corners_px - truth).max() < 0.05


@pytest.mark.parametrize(
    "conditions",
    [{}, {"noise": 6.0}, {"blur_px": 1.0}, {"light_slope": 0.7}, {"wave_height_m": 0.0005}],
    ids=lambda conditions: ",".join(f"{key}={value}" for key, value in conditions.items()) or "plain",
)
def test_position_and_heading(conditions: dict[str, float]) -> None:
    """Within the bounds of tag36h11."""
    off, seen = errors(spoilt(**conditions), count(6, 500, 4), np.random.default_rng(1))
    assert [one.reason for one in seen if one.pose is None] == []
    assert 1e3 * np.hypot(off[:, 0], off[:, 1]).max() < 1.0
    assert np.degrees(np.abs(off[:, 2]).max()) < 0.5
    inside = [
        float(e @ np.linalg.solve(p.covariance, e)) < 6.25  # nine of ten, chi squared
        for e, p in zip(off, [one.pose for one in seen if one.pose is not None], strict=True)
    ]
    assert np.mean(inside) > 0.7


def test_no_pose_without_a_tag() -> None:
    """Random cells in the tag's frame, other tags, its mirror image and negative, chessboards."""
    rng = np.random.default_rng(11)
    tracker = Tracker(calibration(USUAL))
    for k in range(count(20, 10_000, 10)):
        tracker.forget()
        assert tracker.observe(USUAL.picture(None, rng, clutter(USUAL, rng))).pose is None, k


@pytest.mark.parametrize("wrong", [1, 3, 5])
def test_a_tag_with_wrong_cells_is_none(wrong: int) -> None:
    rng = np.random.default_rng(12)
    tracker = Tracker(calibration(USUAL))
    for _ in range(count(4, 200)):
        cells, x_m, y_m, heading_rad, size_m = USUAL.print_of(0, drawn_pose(USUAL, rng), USUAL.tag_size_m)
        for at in rng.choice(41, wrong, replace=False):
            row, col = BITS_Y[at], BITS_X[at]
            cells[row, col] = 1 - cells[row, col]
        tracker.forget()
        seen = tracker.observe(USUAL.picture(None, rng, [(cells, x_m, y_m, heading_rad, size_m)]))
        assert seen.pose is None


def test_two_of_them_are_none() -> None:
    twin = USUAL.print_of(0, (0.9, 0.6, 2.0), USUAL.tag_size_m)
    image = USUAL.picture((0.3, 0.3, 1.0), np.random.default_rng(14), [twin])
    seen = Tracker(calibration(USUAL)).observe(image)
    assert (seen.pose, seen.reason) == (None, "doubled")


def test_it_is_followed_in_a_window() -> None:
    tracker = Tracker(calibration(USUAL))
    rng = np.random.default_rng(6)
    for k in range(6):
        truth = (0.6 + 0.01 * k, 0.45, 0.1 * k)
        seen = tracker.observe(USUAL.picture(truth, rng))
        assert seen.pose is not None and seen.windowed == (k > 0)
        assert np.hypot(seen.pose.x_m - truth[0], seen.pose.y_m - truth[1]) < 1e-3


def test_the_command_writes_the_family_and_checks_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    corners = tmp_path / "corners.toml"
    corners.write_text(f"corners_px = {USUAL.corners_px().tolist()}")
    out = str(tmp_path / "camera.toml")
    size = ["--pool", "1.2x0.9", "--image", "640x480", "--corners", str(corners), "--camera-height-m", "1.35"]
    made = ["camera", "calibrate", *size, "--tag-family", STANDARD, "--tag-height-mm", "12", "--out", out]
    assert frogkick(capsys, *made).code == 0
    assert read_calibration(out).tag.family == STANDARD
    assert frogkick(capsys, "camera", "check", out, "--grid", "3x2").code == 0
    refused = frogkick(capsys, *made, "--tag-id", "2115")
    assert refused.code == 2
    assert "tagStandard41h12 has no tag 2115: its tags are 0 to 2114" in refused.stderr


def test_a_program_that_looked_for_one_ends_in_peace() -> None:
    """The library's own detector frees a family that it still uses, which can crash a program at its end."""
    from pupil_apriltags import Detector

    assert isinstance(tags.standard_detector(), Detector)
    assert type(tags.standard_detector()).__del__ is not Detector.__del__
    program = f"""
        import gc
        import numpy as np
        from frogkick.vision import tags
        for _ in range({count(5, 100, 2)}):
            tags.standard_detector.cache_clear()
            assert tags.find_standard(np.zeros((60, 80), np.uint8), 0) == []
            gc.collect()
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def test_without_the_extra_it_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    tags.standard_detector.cache_clear()
    monkeypatch.setitem(sys.modules, "pupil_apriltags", None)
    with pytest.raises(
        InputError, match=r"tagStandard41h12 needs .* pip install 'frogkick\[apriltag\]'"
    ) as said:
        Tag(family=STANDARD)
    assert "\n" not in str(said.value)
    assert Tag().family == "tag36h11"  # which needs nothing more
