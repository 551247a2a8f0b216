"""The table image's layout, format versions 2 and 3: offsets, limits, and the order of its states.

The image is one little-endian blob, the same bytes in a file, in flash and on the radio:

====== ============ ==================================================================
offset type         meaning
====== ============ ==================================================================
0      char[4]      magic ``FKTB``
4      u16          format version: 3, or 2 of an image without wear curves
6      u16          kind, 1 = nearest (the paper's table), 2 = affine (local linear correction)
8      u32          length of the whole image, bytes
12     u32          CRC-32 (zlib) of bytes [16, length)
16     char[16]     robot id, 1 to 15 printable ASCII characters, NUL-padded
32     u8[32]       provenance: SHA-256 of the library's content
64     u32          period of one action, microseconds
68     u32          pulse, microseconds
72     u16          states n, 1 to 65535
74     u8           actions a, 1 to 32
75     u8           limbs l, 1 to 8
76     u32          offset of the actions, 176
80     u32          offset of the states
84     u32          offset of the transitions
88     f32[3]       velocity per code: m/s forward, m/s left, rad/s
100    f32[3]       motion per code: m forward, m left, rad
112    u32          delay of an action's second group of limbs, microseconds
116    u32          offset of the columns
120    u32          offset of the splits
124    u32          offset of the models
128    u16          bytes of one state's transitions, r
130    u8           levels of the search tree, t: 0 to 13, 2**t <= n
131    u8           levels of the blocks, b: 0 to 8, 2**b <= n; kind affine 0
132    u16[3]       largest |motion code| that a look-up gives, 1 to 32767
138    u16[3]       kind affine: largest |query - state| per axis, codes, 0 to 16383; else 0
144    u8[6]        kind nearest: shift of the predictions, 14 to 20; affine: of the corrections, 0 to 15
150    u16[6]       codes per unit of a residual, >= 1
162    u8[3]        kind nearest: left shift of the state codes before prediction, 0 to 14; else 0
165    u8           knots of a limb's wear curve, k: 0 (none) to 16
166    u16          kind affine: part of a limb's use that is left a period later, 1/32768, <= 32767; else 0
168    u16          kind affine: use of a limb that fires, 1/32768, <= 32767; else 0
170    u16          zero
172    u32          axes of the search tree's levels, two bits each, the root's the lowest; zeros above
176    u8[a][4]     actions: name (ASCII), mask of the first group, of the second, zero
...    [a][6]       columns: where the residuals of an action's value stand, see below
...    i16[l][k][6] wear curves, see below
...    i16[2**t-1]  splits of the search tree, heap order, |code| <= 16383; zeros to 4 bytes
...    ...          models: coefficients for kind nearest, nothing for affine
...    i16[n][3]    states: velocity codes, |code| <= 16383, in k-d order; zeros to 4 bytes
...    u8[n][r]     transitions: unsigned residuals, least significant bit first; 3 to 6 zeros
====== ============ ==================================================================

Sections follow each other without gaps, and an offset that differs is refused. The six values of a
transition are the motion (forward, left, turn) and the velocity at its end, in codes.

Order. Leaf ``i`` of the 2**t holds rows ``[(i * n) >> t, ((i + 1) * n) >> t)``. Each level
splits on one axis: left of a split no code there is above it, right of it none is below.

Kind nearest. Columns: u16 bit offset in a state's transitions, u8 bits (0 to 16), u8 zero. Models:
i16[2**b][a][6][10], the coefficients of each block, action and value. Block ``i`` holds rows
``[(i * n) >> b, ((i + 1) * n) >> b)``. With ``u`` the state's codes shifted left and the products ``u * u``
shifted right by 14, a value is the sum of the coefficients times (16384, u0, u1, u2, u0u0, u0u1, u0u2, u1u1,
u1u2, u2u2), shifted right by the value's shift, plus its residual times the codes per unit, then clamped.
The sum of a value's |coefficients| is at most 131071.

Kind affine. Columns: i16[3] the least of each derivative; i16 the least value; i16[4], or i16[8] where there
are more limbs: history, what a fully used limb adds, 0 for limbs not there. Transitions: u32 for each action
and value, residuals of three derivatives (7 bits each, the first one lowest) and of the value (11 bits). A
derivative is its least plus residual, a value its least plus residual times the codes per unit.
The query's offset from the state is clamped, times the derivatives, summed, plus half, shifted right; the
limbs' uses times their history are summed and shifted right by 15; the sum of the three is clamped. The sum
of a value's |history| is at most 65535.

Wear. A limb that has lost a share of its contribution changes the six values of each action that fires it, in
codes: knot ``j`` is the change where ``(j + 1) / k`` is lost, and between knots, as from zero to the first
one, the change is linear. Those of all limbs that fire are added before a value is clamped.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from frogkick.core.arrays import Int16, Int64

MAGIC = b"FKTB"
FORMAT_VERSION, FORMAT_PLAIN = 3, 2
"""With wear curves and without."""
KIND_NEAREST = 1
KIND_AFFINE = 2
KINDS = {KIND_NEAREST: "nearest", KIND_AFFINE: "affine"}
HEADER_BYTES = 176
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
TREE_LEVELS_MAX = 13
LEAF_ROWS = 8
"""Rows of a leaf at least, where there are as many; below twice that. Fewest instructions on the chip."""
BLOCK_LEVELS_MAX = 8
COEFFICIENTS = 10
COEFFICIENT_SUM_MAX = 131_071
"""Times 16384: below 2**31."""
PREDICTION_SHIFTS = (14, 20)
CORRECTION_SHIFT_MAX = 15
BITS_MAX = 16
AFFINE_BITS = (7, 7, 7, 11)
"""Of three derivatives and the value: one word, which is fast to take apart."""
HISTORY_SUM_MAX = 65535
"""Times 32767: below 2**31."""
RESIDUAL_CODES_MAX = 2**20 - 1
WEAR_KNOTS = 8
"""Knots of the wear curves that a library holds."""
WEAR_KNOTS_MAX = 16
WEAR_CODE_MAX = 32767
LOST_MAX = 32767
"""A limb's lost share as an integer: all of it."""

LIMB_GONE = 26214
"""A limb that has lost this share (0.8) or more counts as lost."""
USE_MAX = 32767
USE_SHIFT = 15

COLUMN = np.dtype([("at", "<u2"), ("bits", "u1"), ("zero", "u1")])

HEADER = np.dtype(
    [
        ("magic", "S4"), ("format_version", "<u2"), ("kind", "<u2"), ("length", "<u4"), ("crc32", "<u4"),
        ("robot_id", "V16"), ("provenance", "V32"), ("period_us", "<u4"), ("pulse_us", "<u4"),
        ("states", "<u2"), ("actions", "u1"), ("limbs", "u1"),
        ("actions_at", "<u4"), ("states_at", "<u4"), ("transitions_at", "<u4"),
        ("velocity_scale", "<f4", 3), ("motion_scale", "<f4", 3), ("second_delay_us", "<u4"),
        ("columns_at", "<u4"), ("splits_at", "<u4"), ("models_at", "<u4"),
        ("row_bytes", "<u2"), ("tree_levels", "u1"), ("block_levels", "u1"),
        ("motion_limit", "<u2", 3), ("offset_limit", "<u2", 3), ("shift", "u1", 6), ("unit", "<u2", 6),
        ("up", "u1", 3), ("wear_knots", "u1"), ("use", "<u2", 2), ("zero", "<u2"), ("axes", "<u4"),
    ]
)  # fmt: skip
"""The header's fields in order: reading, checking and writing follow from this table."""
assert HEADER.itemsize == HEADER_BYTES

_typed_by_name: Any = namedtuple
Header = _typed_by_name("Header", HEADER.names)
"""A header's values by the names in HEADER; several are a list."""


def header_of(image: bytes) -> Any:
    """The fields of an image, at its beginning."""
    values = np.frombuffer(image, HEADER, 1)[0].item()
    return Header(*(value.tolist() if isinstance(value, np.ndarray) else value for value in values))


class Sections(NamedTuple):
    """Byte offsets that follow from the counts, and the image's length."""

    actions: int
    columns: int
    wear: int
    splits: int
    models: int
    states: int
    transitions: int
    length: int


def affine_column(limbs: int) -> np.dtype[np.void]:
    kept = 4 if limbs <= 4 else 8
    return np.dtype([("least", "<i2", (4,)), ("history", "<i2", (kept,))])


def sections(head: Any) -> Sections:
    """Where each section of an image stands by the counts in its Header."""
    affine = head.kind == KIND_AFFINE
    columns = HEADER_BYTES + 4 * head.actions
    column = affine_column(head.limbs) if affine else COLUMN
    wear = columns + head.actions * 6 * column.itemsize
    splits = wear + 12 * head.limbs * head.wear_knots
    models = _to_four(splits + 2 * (2**head.tree_levels - 1))
    coefficients = 0 if affine else 2**head.block_levels * head.actions * 6 * COEFFICIENTS
    states_at = models + 2 * coefficients
    transitions = _to_four(states_at + 6 * head.states)
    length = _to_four(transitions + head.row_bytes * head.states + 3)
    return Sections(HEADER_BYTES, columns, wear, splits, models, states_at, transitions, length)


def _to_four(offset: int) -> int:
    return (offset + 3) // 4 * 4


def tree_levels_for(states: int) -> int:
    """Levels of the search tree that a packer makes for a number of states."""
    return min(max(states // LEAF_ROWS, 1).bit_length() - 1, TREE_LEVELS_MAX)


def first_rows(states: int, levels: int) -> Int64:
    """First row of each of 2**levels ranges, then ``states``: (2**levels + 1,)."""
    return (np.arange(2**levels + 1, dtype=np.int64) * states) >> levels


def axes_of(word: int, levels: int) -> tuple[int, ...]:
    """The axis of each level of the search tree; 3 for what is none, as is anything above the levels."""
    axes = tuple(word >> 2 * level & 3 for level in range(levels))
    return (*axes, 3) if word >> 2 * levels else axes


def axes_word(axes: Sequence[int]) -> int:
    return sum(axis << 2 * level for level, axis in enumerate(axes))


def kd_order(codes: Int16, levels: int) -> tuple[Int64, tuple[int, ...]]:
    """Return the order of rows that makes them an implicit k-d tree, and each level's axis.

    A level splits on the axis on which its parts are the longest, all together. The order depends on that of
    the rows (n, 3) only among rows with equal codes (the earlier row comes first in sorting).
    """
    order = np.arange(len(codes), dtype=np.int64)
    axes: list[int] = []
    for level in range(levels + 1):
        first = first_rows(len(codes), level)
        part = np.repeat(np.arange(2**level), np.diff(first))
        block = codes[order].astype(np.int64)
        lengths = np.maximum.reduceat(block, first[:-1]) - np.minimum.reduceat(block, first[:-1])
        axis = int(np.argmax(lengths.sum(axis=0)))
        keys = (order, block[:, (axis + 2) % 3], block[:, (axis + 1) % 3], block[:, axis], part)
        order = order[np.lexsort(keys)]
        axes.append(axis)
    return order, tuple(axes[:levels])


def kd_splits(codes: Int16, axes: Sequence[int]) -> Int16:
    """Return the tree's splits, (2**levels - 1,) int16 in heap order, of rows in k-d order.

    A split is the least code to its right.
    """
    found = [np.empty(0, dtype=np.int16)]
    for level, axis in enumerate(axes):
        least = np.minimum.reduceat(codes[:, axis], first_rows(len(codes), level + 1)[:-1])
        found.append(least[1::2].astype(np.int16))
    return np.concatenate(found)


def kd_violation(codes: Int16, splits: Int16, axes: Sequence[int]) -> int | None:
    """Return the first row of codes (n, 3) that stands on the wrong side of a split, or None."""
    levels = len(axes)
    leaf = np.repeat(np.arange(2**levels), np.diff(first_rows(len(codes), levels)))
    wrong = np.zeros(len(codes), dtype=bool)
    for level, axis in enumerate(axes):
        node = leaf >> (levels - level)
        split = splits[2**level - 1 + node]
        right = (leaf >> (levels - level - 1)) & 1 == 1
        here = codes[:, axis]
        wrong |= np.where(right, here < split, here > split)
    return int(np.argmax(wrong)) if wrong.any() else None
