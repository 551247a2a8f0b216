"""Cells of a printed tag, as in the family's own pictures, and tagStandard41h12's detection.

The corners of a tag are everywhere in the order of that picture: top left, top right, bottom right, bottom
left. OpenCV 4 has the AprilTag families turned by half a turn, so only this file may use its order of
corners.

OpenCV lacks tagStandard41h12, the AprilTag library (an extra) has it. Its picture has 9 x 9 cells: a ring of
code, a black ring, and a white square of 5 cells with 9 cells of code. The library's size and corners are
those of the white square.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np

from frogkick.core.arrays import AnyArray, Float32, Float64, UInt8
from frogkick.core.errors import InputError, require

STANDARD = "tagStandard41h12"
"""The family of the authors' robot."""
FAMILIES = ("tag36h11", STANDARD)
OPENCV_HALF_TURN = 2
"""Number of corners by which OpenCV 4's order is ahead of the picture's; tests check it."""
WRONG_MAX = 2
"""Number of wrong cells that are corrected; the codes differ in 11 or more."""


@cache
def dictionary() -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of tag36h11."""
    found = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    found.maxCorrectionBits = WRONG_MAX
    return found


@cache
def standard_detector() -> Any:
    """The AprilTag library's detector, made once, as it makes a table of all codes."""
    require(f"tag family {STANDARD}", "pupil_apriltags")
    from pupil_apriltags import Detector

    # Its destructor frees the family before the detector that still uses it, which can crash the interpreter
    # at exit. This detector lives as long as the program.
    lasting = type("LastingDetector", (Detector,), {"__del__": lambda _self: None})
    # Squares are searched at half the resolution (small tags are enlarged before), codes at the full one.
    return lasting(families=STANDARD, nthreads=1, quad_decimate=2.0)


def tag_count(family: str) -> int:
    """Number of tags of a family.

    Raises:
        InputError: the family is not known.
    """
    if family not in FAMILIES:
        raise InputError(f"tag family {family!r} is not known, known are {', '.join(FAMILIES)}")
    if family == STANDARD:
        return int(standard_detector().tag_families[STANDARD].contents.ncodes)
    return len(dictionary().bytesList)


def check_tag(family: str, tag_id: int) -> None:
    """Raise InputError for an unknown family, a number that it lacks, or a missing detector."""
    count = tag_count(family)
    if not 0 <= tag_id < count:
        raise InputError(f"{family} has no tag {tag_id}: its tags are 0 to {count - 1}")


def tag_margin(family: str) -> int:
    """Cells between the edge of a tag's picture and the square of its size and corners: tag36h11's black
    square, tagStandard41h12's white one."""
    return 2 if family == STANDARD else 1


def tag_white(family: str) -> int:
    """Cells of white paper around the print in a tag's picture."""
    return 0 if family == STANDARD else 1


def tag_cells(family: str, tag_id: int) -> Float32:
    """A tag's cells with ``tag_white`` cells of white around them.

    Returns:
        (10, 10) of tag36h11, (9, 9) of tagStandard41h12: 0 black, 1 white; row 0 is the picture's top, column
        0 its left.
    """
    check_tag(family, tag_id)
    if family == STANDARD:
        return _standard_cells(tag_id)
    codes = dictionary()
    bits = cv2.aruco.Dictionary.getBitsFromByteList(codes.bytesList[tag_id : tag_id + 1], codes.markerSize)
    upright = np.rot90(bits, OPENCV_HALF_TURN)
    return np.pad(np.pad(upright, 1), 1, constant_values=1).astype(np.float32)


def _standard_cells(tag_id: int) -> Float32:
    family = standard_detector().tag_families[STANDARD].contents
    wide, inner, bits = int(family.total_width), int(family.width_at_border), int(family.nbits)
    first = (wide - inner) // 2
    picture = np.zeros((wide, wide), np.float32)
    picture[first:-first, first:-first] = 1.0
    picture[first + 1 : -first - 1, first + 1 : -first - 1] = 0.0
    # Places count from the white square's corner, negative outside of it, though the binding is unsigned.
    cols, rows = (np.array(place[:bits], np.uint32).view(np.int32) for place in (family.bit_x, family.bit_y))
    code = int(family.codes[tag_id])
    picture[rows + first, cols + first] = [code >> (bits - 1 - k) & 1 for k in range(bits)]
    return picture


def find_standard(image: UInt8, tag_id: int) -> list[Float64]:
    """(4, 2) corners of the white square at each place of a picture where tagStandard41h12 is decoded.

    They are in the printed picture's order; the centre of the first pixel is (0, 0).
    """
    found = standard_detector().detect(np.ascontiguousarray(image))
    # Its corners start at the bottom left in the opposite direction; its first pixel starts at (0, 0).
    return [
        np.asarray(tag.corners, dtype=np.float64)[::-1] - 0.5
        for tag in found
        if tag.tag_id == tag_id and tag.hamming <= WRONG_MAX
    ]


def picture_order(corners_px: AnyArray) -> Float64:
    """OpenCV's four corners as (4, 2) top left, top right, bottom right, bottom left of the picture."""
    return np.roll(np.asarray(corners_px, dtype=np.float64).reshape(4, 2), OPENCV_HALF_TURN, axis=0)
