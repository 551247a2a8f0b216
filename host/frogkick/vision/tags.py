"""Cells of a printed tag, as in the family's own pictures.

The corners of a tag are everywhere in the order of that picture: top left, top right, bottom right, bottom
left. OpenCV 4 has the AprilTag families turned by half a turn, so only this file may use its order of
corners.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from frogkick.core.arrays import Float32, Float64
from frogkick.core.errors import InputError
from frogkick.vision import standard

STANDARD = "tagStandard41h12"
"""The family of the authors' robot; OpenCV lacks it, the extra 'apriltag' has it."""
FAMILIES = ("tag36h11", STANDARD)
OPENCV_HALF_TURN = 2
"""Number of corners by which OpenCV 4's order is ahead of the picture's; tests check it."""


@cache
def dictionary() -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of tag36h11, which corrects up to two bits (the codes differ in 11)."""
    found = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    found.maxCorrectionBits = 2
    return found


def tag_count(family: str) -> int:
    """Number of tags of a family.

    Raises:
        InputError: an unknown family, or one whose detector is not installed.
    """
    if family not in FAMILIES:
        raise InputError(f"tag family {family!r} is not known, known are {', '.join(FAMILIES)}")
    return standard.count() if family == STANDARD else len(dictionary().bytesList)


def check_tag(family: str, tag_id: int) -> None:
    """Raise InputError for an unknown family, a number that it lacks, or a missing detector."""
    count = tag_count(family)
    if not 0 <= tag_id < count:
        raise InputError(f"{family} has no tag {tag_id}: its tags are 0 to {count - 1}")


def tag_margin(family: str) -> int:
    """Cells between the edge of a tag's picture and the square of its size and corners.

    tag36h11: the white around its black square. tagStandard41h12: a ring of code, and the black around its
        white
    square of 5 cells.
    """
    return 2 if family == STANDARD else 1


def tag_white(family: str) -> int:
    """Cells of white paper around the print in a tag's picture."""
    return 0 if family == STANDARD else 1


def tag_cells(family: str, tag_id: int) -> Float32:
    """A tag's cells with ``tag_white`` cells of white around them.

    Returns:
        (10, 10) of tag36h11, (9, 9) of tagStandard41h12: 0 black, 1 white; row 0 is the picture's top, column
        0 its left.

    Raises:
        InputError: there is no such tag.
    """
    check_tag(family, tag_id)
    if family == STANDARD:
        return standard.cells(tag_id)
    codes = dictionary()
    bits = cv2.aruco.Dictionary.getBitsFromByteList(codes.bytesList[tag_id : tag_id + 1], codes.markerSize)
    upright = np.rot90(bits, OPENCV_HALF_TURN)
    return np.pad(np.pad(upright, 1), 1, constant_values=1).astype(np.float32)


def picture_order(corners_px: Float64) -> Float64:
    """OpenCV's corners (4, 2) as top left, top right, bottom right, bottom left of the picture."""
    return np.roll(corners_px, OPENCV_HALF_TURN, axis=0)
