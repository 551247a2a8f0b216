"""What a printed tag looks like: its cells as the family's own pictures show them.

The corners of a tag are named after that picture everywhere in this package: top left, top right, bottom
right, bottom left. OpenCV 4 holds the AprilTag families turned by half a turn against their pictures, so
that nothing outside of this file may use its order of corners.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from frogkick.errors import InputError

FAMILIES = ("tag36h11",)
OPENCV_HALF_TURN = 2
"""By how many corners OpenCV 4's order is ahead of the picture's; a golden tag in the tests holds it."""


@cache
def dictionary() -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of tag36h11, told to correct up to two bits (its codes are 11 apart)."""
    found = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    found.maxCorrectionBits = 2
    return found


def check_tag(family: str, tag_id: int) -> None:
    """Refuse a tag that does not exist.

    Raises:
        InputError: an unknown family or a number that it does not have.
    """
    if family not in FAMILIES:
        raise InputError(f"tag family {family!r} is not known, known is {', '.join(FAMILIES)}")
    count = len(dictionary().bytesList)
    if not 0 <= tag_id < count:
        raise InputError(f"{family} has no tag {tag_id}: its tags are 0 to {count - 1}")


def tag_cells(family: str, tag_id: int) -> npt.NDArray[np.float32]:
    """Return a tag's cells with its black border and one cell of white around it.

    Returns:
        (10, 10): 0 black, 1 white; row 0 is the picture's top, column 0 its left.

    Raises:
        InputError: there is no such tag.
    """
    check_tag(family, tag_id)
    codes = dictionary()
    bits = cv2.aruco.Dictionary.getBitsFromByteList(codes.bytesList[tag_id : tag_id + 1], codes.markerSize)
    upright = np.rot90(bits, OPENCV_HALF_TURN)
    return np.pad(np.pad(upright, 1), 1, constant_values=1).astype(np.float32)


def picture_order(corners_px: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return OpenCV's corners (4, 2) as top left, top right, bottom right, bottom left of the picture."""
    return np.roll(corners_px, OPENCV_HALF_TURN, axis=0)
