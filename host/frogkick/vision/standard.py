"""tagStandard41h12 with the AprilTag library, an extra: pictures of tags, and their detection.

Its picture has 9 x 9 cells: a ring of code, a black ring, and a white square of 5 cells with 9 cells of code.
The library's size and corners are those of the white square.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from frogkick.core.arrays import Float32, Float64, UInt8
from frogkick.core.extras import require

NAME = "tagStandard41h12"
HAMMING_MAX = 2
"""Number of wrong cells that are corrected, as for tag36h11; the codes differ in 12."""


@cache
def _detector() -> Any:
    """The library's detector, made once, as it makes a table of all codes.

    Raises:
        InputError: it is not installed.
    """
    require(f"tag family {NAME}", "pupil_apriltags")
    from pupil_apriltags import Detector

    # Its destructor frees the family before the detector that still uses it, which can crash the interpreter
    # at exit. This detector lives as long as the program.
    lasting = type("LastingDetector", (Detector,), {"__del__": lambda _self: None})
    # Squares are searched at half the resolution (small tags are enlarged before), codes at the full one.
    return lasting(families=NAME, nthreads=1, quad_decimate=2.0)


def _family() -> Any:
    """The library's own description of the family."""
    return _detector().tag_families[NAME].contents


def count() -> int:
    """Number of tags.

    Raises:
        InputError: the detector is not installed.
    """
    return int(_family().ncodes)


def cells(tag_id: int) -> Float32:
    """A tag's (9, 9) cells from the library's codes: 0 black, 1 white, row 0 the picture's top.

    Raises:
        InputError: the detector is not installed.
    """
    family = _family()
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
    """Find the places where a tag is decoded.

    Args:
        image: (height, width) grey levels.
        tag_id: its number.

    Returns:
        (4, 2) corners of the white square of each, in the printed picture's order; the centre of the first
        pixel is (0, 0).

    Raises:
        InputError: the detector is not installed.
    """
    found = _detector().detect(np.ascontiguousarray(image))
    # Its corners start at the bottom left in the opposite direction; its first pixel starts at (0, 0).
    return [
        np.asarray(tag.corners, dtype=np.float64)[::-1] - 0.5
        for tag in found
        if tag.tag_id == tag_id and tag.hamming <= HAMMING_MAX
    ]
