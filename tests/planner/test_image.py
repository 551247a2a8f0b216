"""Table images: what is damaged, foreign or out of range is refused by name, for both kinds."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from tests.planner import synthetic

from frogkick.core.errors import InputError
from frogkick.tables import layout
from frogkick.tables.image import TableError, open_image, read_image

IMAGE = synthetic.image(states=41, actions=5)
AFFINE = synthetic.affine_image(states=41, actions=5)
AT = open_image(IMAGE).sections
AFFINE_AT = open_image(AFFINE).sections
HEADER = layout.HEADER_BYTES


def u16(value: int) -> bytes:
    return struct.pack("<H", value)


def i16(value: int) -> bytes:
    return struct.pack("<h", value)


def u32(value: int) -> bytes:
    return struct.pack("<I", value)


def f32(value: float) -> bytes:
    return struct.pack("<f", value)


def test_views_cannot_be_written() -> None:
    for content in (IMAGE, AFFINE):
        tables = open_image(content)
        for array in (
            tables.states, tables.transitions, tables.derivatives, tables.history, tables.velocity_scale,
            tables.motion_scale, tables.motion_limit, tables.offset_limit, tables.correction_shift,
        ):  # fmt: skip
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0


@pytest.mark.parametrize("states", [1, 2, 3, 7, 8, 15, 16, 17, 100, 255, 256, 1000])
def test_every_size_is_in_order(states: int) -> None:
    tables = open_image(synthetic.image(states, 2, states))
    levels = layout.tree_levels_for(states)
    assert states >> levels < 16
    assert states >> levels >= min(states, 8)
    axes = layout.axes_of(int.from_bytes(tables.image[172:176], "little"), levels)
    splits = np.frombuffer(tables.image, "<i2", 2**levels - 1, tables.sections.splits)
    assert layout.kd_violation(tables.states, splits, axes) is None
    assert len(tables.states) == states


def test_a_swapped_pair_of_rows_is_found() -> None:
    """Rows of two leaves; those of one leaf may stand in any order."""
    codes = open_image(synthetic.image(300, 1)).states
    levels = layout.tree_levels_for(300)
    order, axes = layout.kd_order(codes, levels)
    np.testing.assert_array_equal(codes[order], codes)
    splits = layout.kd_splits(codes, axes)
    leaf = np.repeat(np.arange(2**levels), np.diff(layout.first_rows(300, levels)))
    found = np.zeros(2, dtype=int)
    for row in range(0, 288, 7):
        other = row + 1 + row % 12
        swapped = codes.copy()
        swapped[[row, other]] = swapped[[other, row]]
        elsewhere = int(leaf[row] != leaf[other])
        broken = layout.kd_violation(swapped, splits, axes) is not None
        assert not broken or elsewhere
        found[elsewhere] += broken
    assert found[1] >= 20


def test_every_flipped_bit_of_the_header_is_refused() -> None:
    for content in (IMAGE, AFFINE):
        for bit in range(HEADER * 8):
            changed = bytearray(content)
            changed[bit // 8] ^= 1 << bit % 8
            with pytest.raises(TableError):
                open_image(bytes(changed))


def test_every_flipped_byte_of_the_sections_is_refused() -> None:
    for index in range(HEADER, len(IMAGE), 3):
        changed = bytearray(IMAGE)
        changed[index] ^= 0x10
        with pytest.raises(TableError, match="CRC-32"):
            open_image(bytes(changed))


WRONG = [
    (0, b"FKTC", "not a table image"),
    (4, u16(4), "format version 4, newer than this program's 3: update frogkick"),
    (4, u16(3), "format version 3 and 0 wear knots"),
    (4, u16(1), "format version 1, older than 2: make it again with 'frogkick tables build'"),
    (4, u16(0), "format version 0, older than 2"),
    (6, u16(3), r"kind 3, known are 1 \(nearest\), 2 \(affine\)"),
    (6, u16(0), "kind 0, known are"),
    (8, u32(99), "says it has 99 bytes"),
    (16, b"\0" * 16, "robot id"),
    (16, b"x" * 16, "robot id"),
    (16, b"frog\0extra", "robot id"),
    (16, b"fro g", "robot id"),
    (64, u32(0), "period 0 us"),
    (68, u32(0), "pulse 0 us"),
    (68, u32(1_425_000), "pulse 1425000 us"),
    (112, u32(1_425_000), "second delay 1425000 us"),
    (72, u16(0), "0 states"),
    (74, b"\0", "0 actions"),
    (74, b"\x21", "33 actions"),
    (75, b"\0", "0 limbs"),
    (75, b"\x09", "9 limbs"),
    (130, b"\x0e", "14 tree levels"),
    (130, b"\x06", "6 tree levels"),  # 64 leaves of 41 states
    (130, b"\x03", "at byte"),
    (76, u32(180), "actions at byte 180"),
    (80, u32(0xFFFFFFF0), "states at byte 4294967280"),
    (84, u32(130), "transitions at byte 130"),
    (116, u32(0), "columns at byte 0"),
    (120, u32(0xFFFFFFFC), "splits at byte 4294967292"),
    (124, u32(4), "models at byte 4"),
    (72, u16(42), "at byte"),
    (128, u16(65535), "at byte"),
    (88, f32(np.nan), r"velocity_scale\[0\] is nan"),
    (92, f32(np.inf), r"velocity_scale\[1\] is inf"),
    (96, f32(-1e-4), r"velocity_scale\[2\]"),
    (100, f32(0.0), r"motion_scale\[0\] is 0.0"),
    (108, f32(0.031), r"motion_scale\[2\]"),
    (132, u16(0), r"motion_limit\[0\] is 0, allowed is 1 to 32767"),
    (136, u16(32768), r"motion_limit\[2\] is 32768"),
    (150, u16(0), r"unit\[0\] is 0, allowed is 1 to 65535"),
    (160, u16(0), r"unit\[5\] is 0"),
    (165, b"\1", "format version 2 and 1 wear knots"),
    (165, b"\x11", "17 wear knots"),
    (170, b"\1", "reserved byte"),
    (171, b"\1", "reserved byte"),
    (172, u32(3), "level without an axis"),
    (172, u32(1 << 4), "level without an axis"),  # above the two levels
    (HEADER, b"\x7f", "name byte 127"),
    (HEADER, b"B", "repeats the name 'B'"),
    (HEADER + 1, b"\x10", "beyond the 4"),
    (HEADER + 2, b"\x80", "beyond the 4"),
    (HEADER + 3, b"\1", "padding byte"),
]
WRONG_NEAREST = [
    (131, b"\x09", "9 block levels"),
    (131, b"\x06", "6 block levels"),
    (138, u16(1), r"offset_limit\[0\] is 1, allowed is 0 to 0"),
    (144, b"\x0d", r"shift\[0\] is 13, allowed is 14 to 20"),
    (149, b"\x15", r"shift\[5\] is 21"),
    (162, b"\x0f", r"up\[0\] is 15, allowed is 0 to 14"),
    (164, b"\x0e", r"states \(0, 2\) have code"),
    (166, u16(1), r"use\[0\] is 1, allowed is 0 to 0"),
    (168, u16(1), r"use\[1\] is 1"),
    (AT.columns, u16(1), "columns do not fill"),
    (AT.columns + 2, b"\x11", "columns do not fill"),
    (AT.columns + 4 * 29 + 2, b"\x0c", "columns do not fill"),
    (AT.columns + 4 * 29 + 2, b"\x10", "columns do not fill"),
    (AT.columns + 3, b"\1", "padding byte"),
    (156, u16(65535), "columns do not fill"),  # a residual of more than 2**20 codes
    (128, u16(1), "at byte"),
    (AT.splits, i16(16384), r"splits \(0,\) have code 16384, allowed is \+-16383"),
    (AT.splits, i16(-16384), "have code -16384"),
    (AT.splits, i16(16383), "breaks the k-d order"),
    (AT.models - 1, b"\1", "padding byte"),
    (AT.models, i16(32767) * 5, "coefficients that sum to"),
    (AT.models, i16(-32768) * 4, "coefficients that sum to"),
    (AT.states, i16(16384), "code 16384, allowed is"),
    (AT.states, i16(-16384), "code -16384"),
    (AT.states, i16(4095) * 3, "state 0 breaks the k-d order"),
    (AT.transitions - 1, b"\1", "padding byte"),
    (AT.length - 1, b"\1", "padding byte"),
]
WRONG_AFFINE = [
    (131, b"\x01", "1 block levels, allowed are 0 to 0"),
    (138, u16(16384), r"offset_limit\[0\] is 16384, allowed is 0 to 16383"),
    (144, b"\x10", r"shift\[0\] is 16, allowed is 0 to 15"),
    (162, b"\1", r"up\[0\] is 1, allowed is 0 to 0"),
    (166, u16(32768), r"use\[0\] is 32768, allowed is 0 to 32767"),
    (168, u16(32768), r"use\[1\] is 32768"),
    (AFFINE_AT.columns, i16(-32768), "least value, derivative or history"),
    (AFFINE_AT.columns + 4, i16(32641), "least value, derivative or history"),
    (AFFINE_AT.columns + 6, i16(-32768), "least value, derivative or history"),
    (AFFINE_AT.columns + 14, i16(-32768), "least value, derivative or history"),
    (AFFINE_AT.columns + 8, i16(32767) * 3, "least value, derivative or history"),
    (75, b"\x03", "fires a limb"),
    (75, b"\x05", "at byte"),
    (160, u16(513), "columns do not fill"),
    (128, u16(24), "at byte"),
    (AFFINE_AT.states, i16(16384), "code 16384"),
    (AFFINE_AT.length - 1, b"\1", "padding byte"),
]


@pytest.mark.parametrize(
    ("content", "offset", "replacement", "text"),
    [
        *((IMAGE, *case) for case in WRONG + WRONG_NEAREST),
        *((AFFINE, *case) for case in WRONG + WRONG_AFFINE),
    ],
)
def test_a_well_sealed_but_wrong_image_is_refused_by_name(
    content: bytes, offset: int, replacement: bytes, text: str
) -> None:
    with pytest.raises(TableError, match=text) as caught:
        open_image(synthetic.resealed(content, offset, replacement))
    assert "\n" not in str(caught.value)


def test_truncated_joined_and_foreign_bytes_are_refused() -> None:
    for length in (0, 3, 4, HEADER - 1, HEADER, len(IMAGE) - 1):
        with pytest.raises(TableError):
            open_image(IMAGE[:length])
    with pytest.raises(TableError, match="truncated or joined"):
        open_image(IMAGE + b"\0")


def test_reading_names_the_file(tmp_path: Path) -> None:
    good = tmp_path / "good.fkt"
    good.write_bytes(IMAGE)
    assert read_image(good).image == IMAGE
    bad = tmp_path / "bad.fkt"
    bad.write_bytes(b"PK\x03\x04 something else")
    with pytest.raises(TableError, match=r"bad\.fkt.*not a table image"):
        read_image(bad)
    with pytest.raises(InputError, match="does not exist"):
        read_image(tmp_path / "missing.fkt")


def test_a_table_for_another_robot_names_both() -> None:
    tables = open_image(IMAGE)
    tables.require_robot("frog2022")
    with pytest.raises(TableError, match=r"robot 'frog2022', this robot is 'turtle'"):
        tables.require_robot("turtle")
