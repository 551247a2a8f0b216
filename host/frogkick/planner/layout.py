"""The table image's layout, format version 1: offsets, limits, and the order of its states.

The image is one little-endian blob, the same bytes in a file, in flash and on the radio:

====== ============ ==================================================================
offset type         meaning
====== ============ ==================================================================
0      char[4]      magic ``FKTB``
4      u16          format version, 1
6      u16          kind, 1 = nearest (the paper's table)
8      u32          length of the whole image, bytes
12     u32          CRC-32 (zlib) of bytes [16, length)
16     char[16]     robot id, 1 to 15 printable ASCII characters, NUL-padded
32     u8[32]       provenance: SHA-256 of the library's content
64     u32          period of one action, microseconds
68     u32          pulse, microseconds
72     u16          states, 1 to 65535
74     u8           actions, 1 to 32
75     u8           limbs, 1 to 8
76     u32          offset of the actions, 128
80     u32          offset of the states
84     u32          offset of the transitions
88     f32[3]       velocity per code: m/s forward, m/s left, rad/s
100    f32[3]       motion per code: m forward, m left, rad
112    u32          delay of an action's second group of limbs, microseconds
116    u32[3]       zero
128    u8[a][4]     actions: name (ASCII), mask of the first group, of the second, zero
...    i16[n][3]    states: velocity codes, |code| <= 16383, in k-d order; zeros to 4 bytes
...    i16[n][a][6] transitions: motion codes |code| <= 32767, velocity codes |code| <= 16383
====== ============ ==================================================================

Version 1 has exactly this layout: sections follow each other without gaps, and an offset that differs
is refused. Rows are in k-d order: the middle row of every range (``lo + (hi - lo) // 2``) splits it on
axis ``level % 3``, rows before it have codes <= its code on that axis, rows after it >= its code.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

MAGIC = b"FKTB"
FORMAT_VERSION = 1
KIND_NEAREST = 1
HEADER_BYTES = 128
ROBOT_ID_BYTES = 16
ACTIONS_MAX = 32
LIMBS_MAX = 8
STATES_MAX = 65535
VELOCITY_CODE_MAX = 16383
"""So that a difference of two codes is at most 32766 and the sum of three squares below 2**32."""
MOTION_CODE_MAX = 32767
SCALE_MIN = float(np.float32(1e-9))
"""The reciprocal of every scale stays finite in float32."""
SCALE_MAX = float(np.float32(0.03))
"""A motion stays below 1000 m and 1000 rad: float32 positions and angles stay in the planner's range."""

HEADER = struct.Struct("<4sHHII16s32sIIHBBIII3f3fI12x")
assert HEADER.size == HEADER_BYTES

Int16 = npt.NDArray[np.int16]
Int64 = npt.NDArray[np.int64]


class Sections(NamedTuple):
    """Byte offsets that follow from the counts, and the image's length."""

    actions: int
    states: int
    transitions: int
    length: int


def sections(states: int, actions: int) -> Sections:
    """Return where each section of an image with these counts stands."""
    states_offset = HEADER_BYTES + 4 * actions
    transitions_offset = (states_offset + 6 * states + 3) // 4 * 4
    return Sections(
        HEADER_BYTES, states_offset, transitions_offset, transitions_offset + 12 * states * actions
    )


def kd_order(codes: Int16) -> Int64:
    """Return the order of rows that makes them an implicit k-d tree.

    Args:
        codes: (n, 3) int16 velocity codes.

    Returns:
        (n,) row indices: ``codes[kd_order(codes)]`` is in k-d order. It depends on the input's order only
        among rows with equal codes (the earlier row comes first in sorting).
    """
    order = np.arange(len(codes), dtype=np.int64)
    ranges = [(0, len(codes), 0)]
    while ranges:
        low, high, axis = ranges.pop()
        if high - low < 2:
            continue
        rows = order[low:high]
        block = codes[rows]
        keys = (rows, block[:, (axis + 2) % 3], block[:, (axis + 1) % 3], block[:, axis])
        order[low:high] = rows[np.lexsort(keys)]
        middle = low + (high - low) // 2
        ranges.append((low, middle, (axis + 1) % 3))
        ranges.append((middle + 1, high, (axis + 1) % 3))
    return order


def kd_violation(codes: Int16) -> int | None:
    """Return the first row (by level, then index) that stands on the wrong side of a split, or None.

    Args:
        codes: (n, 3) int16 in what should be k-d order.
    """
    low = np.array([0], dtype=np.int64)
    high = np.array([len(codes)], dtype=np.int64)
    least = np.full((1, 3), np.iinfo(np.int16).min, dtype=np.int64)
    most = np.full((1, 3), np.iinfo(np.int16).max, dtype=np.int64)
    axis = 0
    while len(low):
        middle = low + (high - low) // 2
        here = codes[middle].astype(np.int64)
        wrong = np.any((here < least) | (here > most), axis=1)
        if wrong.any():
            return int(middle[wrong].min())
        left_most, right_least = most.copy(), least.copy()
        left_most[:, axis] = here[:, axis]
        right_least[:, axis] = here[:, axis]
        low = np.concatenate([low, middle + 1])
        high = np.concatenate([middle, high])
        least = np.concatenate([least, right_least])
        most = np.concatenate([left_most, most])
        filled = high > low
        low, high, least, most = low[filled], high[filled], least[filled], most[filled]
        axis = (axis + 1) % 3
    return None
