"""Reads and checks a table image's header, sections and columns."""

from __future__ import annotations

import zlib
from typing import NamedTuple

import numpy as np

from frogkick.core.arrays import Int64
from frogkick.tables import layout
from frogkick.tables.fields import AGAIN, require


class Header(NamedTuple):
    """The header's fields in order; arrays as tuples."""

    kind: int
    robot: bytes
    provenance: bytes
    period_us: int
    pulse_us: int
    states: int
    actions: int
    limbs: int
    offsets: tuple[int, ...]  # of Sections but wear
    velocity_scale: tuple[float, ...]
    motion_scale: tuple[float, ...]
    second_delay_us: int
    row_bytes: int
    tree_levels: int
    block_levels: int
    motion_limit: tuple[int, ...]
    offset_limit: tuple[int, ...]
    shift: tuple[int, ...]
    unit: tuple[int, ...]
    up: tuple[int, ...]
    wear_knots: int
    use_decay: int
    use_gain: int
    axes: int


def identified(image: bytes) -> Header:
    """The header of a complete and undamaged image of this version and of a known kind."""
    size = len(image)
    require(
        size >= 4 and image[:4] == layout.MAGIC,
        "not a table image (its first 4 bytes are not 'FKTB'): name a .fkt file",
    )
    require(
        size >= layout.HEADER_BYTES,
        f"table image has {size} bytes, its header alone has {layout.HEADER_BYTES}: {AGAIN}",
    )
    _, version, kind, length, crc, robot, provenance, *rest = layout.HEADER.unpack_from(image)
    known = layout.FORMAT_VERSION
    require(
        version <= known,
        f"table image has format version {version}, newer than this program's {known}: update frogkick",
    )
    require(
        version >= layout.FORMAT_PLAIN,
        f"table image has format version {version}, older than {layout.FORMAT_PLAIN}: {AGAIN}",
    )
    require(
        kind in layout.KINDS, f"table image is of kind {kind}, known are 1 (nearest), 2 (affine): {AGAIN}"
    )
    require(
        length == size,
        f"table image says it has {length} bytes, here are {size}: it is truncated or joined; {AGAIN}",
    )
    found = zlib.crc32(image[16:])
    require(
        crc == found,
        f"table image has CRC-32 {found:08x}, its header says {crc:08x}: it is damaged; {AGAIN}",
    )
    (period, pulse, states, actions, limbs), rest = rest[:5], rest[5:]
    (actions_at, states_at, transitions_at), scales, rest = rest[:3], rest[3:9], rest[9:]
    (delay, columns_at, splits_at, models_at, row_bytes, tree, blocks), rest = rest[:7], rest[7:]
    knots = rest[21]
    require(
        (knots > 0) == (version == known),
        f"table image has format version {version} and {knots} wear knots, which version {known} alone has: "
        f"{AGAIN}",
    )
    return Header(
        kind, robot, provenance, period, pulse, states, actions, limbs,
        (actions_at, columns_at, splits_at, models_at, states_at, transitions_at, length),
        tuple(scales[:3]), tuple(scales[3:]), delay, row_bytes, tree, blocks,
        tuple(rest[:3]), tuple(rest[3:6]), tuple(rest[6:12]), tuple(rest[12:18]), tuple(rest[18:21]),
        knots, rest[22], rest[23], rest[24],
    )  # fmt: skip


def laid_out(head: Header) -> layout.Sections:
    """The sections' offsets by the counts, which must be those in the header."""
    for what, levels, most in (
        ("tree", head.tree_levels, layout.TREE_LEVELS_MAX),
        ("block", head.block_levels, layout.BLOCK_LEVELS_MAX if head.kind == layout.KIND_NEAREST else 0),
    ):
        require(
            levels <= most and 2**levels <= head.states,
            f"table image has {levels} {what} levels, allowed are 0 to {most} and at most log2(states): "
            f"{AGAIN}",
        )
    require(
        head.wear_knots <= layout.WEAR_KNOTS_MAX,
        f"table image has {head.wear_knots} wear knots, at most {layout.WEAR_KNOTS_MAX} are allowed: {AGAIN}",
    )
    right = layout.sections(
        head.kind,
        head.states,
        head.actions,
        head.limbs,
        head.tree_levels,
        head.block_levels,
        head.row_bytes,
        head.wear_knots,
    )
    stored = [name for name in layout.Sections._fields if name != "wear"]
    for name, given in zip(stored, head.offsets, strict=True):
        wanted = getattr(right, name)
        require(
            given == wanted, f"table image has its {name} at byte {given}, its counts say {wanted}: {AGAIN}"
        )
    return right


def require_numbers(head: Header) -> None:
    """Raise TableError for a number of the header out of its range."""
    affine = head.kind == layout.KIND_AFFINE
    for index, scale in enumerate(head.velocity_scale + head.motion_scale):
        what = ("velocity_scale", "motion_scale")[index // 3]
        require(
            layout.SCALE_MIN <= scale <= layout.SCALE_MAX,  # false for NaN as well
            f"table image's {what}[{index % 3}] is {scale!r}, allowed is 1e-9 to 0.03: {AGAIN}",
        )
    shifts = (0, layout.CORRECTION_SHIFT_MAX) if affine else layout.PREDICTION_SHIFTS
    used = layout.USE_MAX if affine else 0
    for what, values, least, most in (
        ("motion_limit", head.motion_limit, 1, layout.MOTION_CODE_MAX),
        ("offset_limit", head.offset_limit, 0, layout.VELOCITY_CODE_MAX if affine else 0),
        ("shift", head.shift, *shifts),
        ("unit", head.unit, 1, 65535),
        ("up", head.up, 0, 0 if affine else 14),
        ("use", (head.use_decay, head.use_gain), 0, used),
    ):
        for index, value in enumerate(values):
            require(
                least <= value <= most,
                f"table image's {what}[{index}] is {value}, allowed is {least} to {most}: {AGAIN}",
            )


class Columns(NamedTuple):
    """Columns: bits (a * c,) of a row; kind affine: least (a, 6, 4), history (a, 6, l)."""

    bits: Int64
    least: Int64
    history: Int64


def columns_of(image: bytes, head: Header, right: layout.Sections) -> Columns:
    """Read the columns' section, whose bits must fill a row without gaps."""
    section = image[right.columns : right.wear]
    unit = np.tile(head.unit, head.actions)
    if head.kind == layout.KIND_AFFINE:
        affine = np.frombuffer(section, layout.affine_column(head.limbs)).reshape(head.actions, 6)
        bits = np.tile(layout.AFFINE_BITS, 6 * head.actions).astype(np.int64)
        least, history = affine["least"].astype(np.int64), affine["history"].astype(np.int64)
        zeros, good = history[..., head.limbs :], np.array([True])
        history, value_bits = history[..., : head.limbs], bits[3::4]
    else:
        raw = np.frombuffer(section, layout.COLUMN)
        bits = value_bits = raw["bits"].astype(np.int64)
        least = np.zeros((head.actions, 6, 4), dtype=np.int64)
        history = np.zeros((head.actions, 6, head.limbs), dtype=np.int64)
        zeros, good = raw["zero"], raw["at"] == np.cumsum(bits) - bits
    require(not zeros.any(), f"table image has a padding byte that is not zero: {AGAIN}")
    good = good & (value_bits <= layout.BITS_MAX)
    good &= ((1 << value_bits) - 1) * unit <= layout.RESIDUAL_CODES_MAX
    require(
        bool(good.all()) and head.row_bytes == (int(bits.sum()) + 7) // 8,
        f"table image's columns do not fill its rows of {head.row_bytes} bytes: {AGAIN}",
    )
    return Columns(bits, least, history)
