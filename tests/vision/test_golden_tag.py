"""The corner order, held by a tag drawn by hand: tag36h11 number 0 as the family's own picture shows it.

Written from the AprilTag library's table (its code and the place of each of the 36 bits), not from OpenCV's
dictionary, which holds the same tag turned by half a turn.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from tests.vision.scenes import calibration, scene

from frogkick.core.poses import wrap_angle
from frogkick.vision.calibration import Calibration, Tag
from frogkick.vision.tags import tag_cells
from frogkick.vision.template import fit_template, likeliest_turn, templates
from frogkick.vision.tracker import Tracker, find_corners

GOLDEN = """
##########
#........#
#.##.#.#.#
#..###.#.#
#..##....#
#.#.#....#
#..#.##..#
#....#...#
#........#
##########
"""
"""Tag 36h11-0 upright: # is white, . is black."""
CODE = 0xD7E00984B
BITS_X = [int(digit) for digit in "123452343666665554654325434111112223"]
BITS_Y = [int(digit) for digit in "111112223123452343666665554654325434"]
"""The AprilTag library's code of the tag, highest bit first, and the column and row of each bit."""


def golden() -> npt.NDArray[np.float32]:
    rows = GOLDEN.split()
    return np.array([[float(cell == "#") for cell in row] for row in rows], dtype=np.float32)


def photograph(cells: npt.NDArray[np.float32], turn: int, cell_px: int = 6) -> npt.NDArray[np.uint8]:
    """A grey picture of 320 x 240 with the cells in its middle, turned counter-clockwise by quarter turns."""
    image = np.full((240, 320), 120.0)
    drawn = np.kron(np.rot90(cells, turn), np.ones((cell_px, cell_px)))
    half = len(drawn) // 2
    image[120 - half : 120 + half, 160 - half : 160 + half] = 40 + 160 * drawn
    return cv2.GaussianBlur(image, (0, 0), 0.6).astype(np.uint8)


def from_above(tag_size_m: float) -> Calibration:
    """A camera straight above: 1 px is 1 mm, x to the right, y up in the picture."""
    homography = np.array([[1000.0, 0, 0], [0, -1000.0, 239], [0, 0, 1]])
    return Calibration((320, 240), (0.32, 0.24), homography, tag=Tag(size_m=tag_size_m))


def test_the_drawn_tag_is_the_library_s() -> None:
    cells = np.zeros((10, 10), np.float32)
    cells[[0, -1], :] = cells[:, [0, -1]] = 1
    for i, (x, y) in enumerate(zip(BITS_X, BITS_Y, strict=True)):
        cells[y + 1, x + 1] = CODE >> (35 - i) & 1
    assert np.array_equal(cells, golden())


def test_our_cells_are_the_golden_ones() -> None:
    assert np.array_equal(tag_cells("tag36h11", 0), golden())


@pytest.mark.parametrize(("turn", "heading_deg"), [(0, 90), (1, 180), (2, -90), (3, 0)])
def test_the_heading_of_the_golden_tag(turn: int, heading_deg: float) -> None:
    """The tag's top points forward on the robot: upright in a camera from above, that is +y."""
    seen = Tracker(from_above(0.048)).observe(photograph(golden(), turn))
    assert seen.reason == "found"
    assert seen.pose is not None
    assert np.degrees(abs(wrap_angle(seen.pose.heading_rad - np.deg2rad(heading_deg)))) < 0.1
    # 60 px across from 130: the centre is between pixels 159 and 160, 119 and 120.
    assert np.allclose([seen.pose.x_m, seen.pose.y_m], [0.1595, 0.1195], atol=5e-5)


def test_the_corners_of_the_golden_tag() -> None:
    """Top left, top right, bottom right, bottom left of the black square, from OpenCV and from the fit."""
    image = photograph(golden(), 0)
    truth = np.array([[135.5, 95.5], [183.5, 95.5], [183.5, 143.5], [135.5, 143.5]])
    decoded, _ = find_corners(image, 0, 48.0)
    assert len(decoded) == 1
    assert np.abs(decoded[0] - truth).max() < 1.5
    fit = fit_template(image, decoded[0], templates("tag36h11", 0))
    assert fit is not None
    assert np.abs(fit.corners_px - truth).max() < 0.05


def test_a_mirrored_tag_is_none() -> None:
    for turn in range(4):
        seen = Tracker(from_above(0.048)).observe(photograph(golden()[:, ::-1], turn))
        assert seen.pose is None, turn


@pytest.mark.parametrize("turn", range(4))
def test_which_way_round_a_square_is(turn: int) -> None:
    """Where the cells cannot be decoded, the template finds the orientation."""
    image = photograph(golden(), turn, cell_px=4)
    square = np.array([[143.5, 103.5], [175.5, 103.5], [175.5, 135.5], [143.5, 135.5]])
    best, likeness = likeliest_turn(image, square, templates("tag36h11", 0))
    assert likeness > 0.9
    # Turned counter-clockwise once, the picture's top left is the frame's bottom left, the fourth corner.
    assert np.array_equal(np.roll(square, -best, axis=0)[0], square[-turn % 4])


def test_where_the_tag_sits_on_the_robot() -> None:
    """A tag 30 mm ahead and 10 mm to the left of the robot's origin, with its top to the robot's left."""
    usual = scene()
    moved = calibration(usual, mount_heading_rad=np.pi / 2, offset_body_m=(0.03, 0.01))
    robot = (0.5, 0.4, 0.3)
    c, s = np.cos(0.3), np.sin(0.3)
    tag = (0.5 + 0.03 * c - 0.01 * s, 0.4 + 0.03 * s + 0.01 * c, 0.3 + np.pi / 2)
    seen = Tracker(moved).observe(usual.picture(tag, np.random.default_rng(5)))
    assert seen.pose is not None
    assert np.allclose([seen.pose.x_m, seen.pose.y_m, seen.pose.heading_rad], robot, atol=1e-3)
