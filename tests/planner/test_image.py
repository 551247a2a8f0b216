"""Table images: what is packed comes back, what is damaged is refused by name."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from tests.planner import synthetic

from frogkick.errors import InputError
from frogkick.planner import layout
from frogkick.planner.image import TableError, open_image, read_image

IMAGE = synthetic.image(states=41, actions=5)
STATES_AT = layout.sections(41, 5).states
TRANSITIONS_AT = layout.sections(41, 5).transitions


def test_what_is_packed_comes_back_within_half_a_code() -> None:
    velocity, motion, end = synthetic.transitions(300, 9, 5)
    tables = open_image(synthetic.pack(velocity, motion, end))
    assert (tables.robot_id, tables.period_us, tables.pulse_us, tables.limbs) == (
        "frog2022",
        1425000,
        80000,
        4,
    )
    assert tables.provenance == bytes(range(32))
    assert [row.name for row in tables.actions] == list("ABCDEFGHI")
    scale = tables.velocity_scale.astype(float)
    order = layout.kd_order(np.round(velocity / scale).astype(np.int16))
    np.testing.assert_allclose(tables.states * scale, velocity[order], atol=0.501 * scale.max())
    motions = tables.transitions[:, :, :3] * tables.motion_scale.astype(float)
    assert np.all(np.abs(motions - motion[order]) <= 0.501 * tables.motion_scale)
    ends = tables.transitions[:, :, 3:] * scale
    assert np.all(np.abs(ends - end[order]) <= 0.501 * scale)
    assert np.abs(tables.transitions[:, :, :3]).max(axis=(0, 1)).tolist() == [32767] * 3


def test_the_same_input_gives_the_same_bytes_and_row_order_does_not_matter() -> None:
    velocity, motion, end = synthetic.transitions(200, 9, 5)
    shuffled = np.random.default_rng(0).permutation(200)
    assert synthetic.pack(velocity, motion, end) == synthetic.pack(velocity, motion, end)
    again = synthetic.pack(velocity[shuffled], motion[shuffled], end[shuffled])
    assert again == synthetic.pack(velocity, motion, end)


def test_views_cannot_be_written() -> None:
    tables = open_image(IMAGE)
    for array in (tables.states, tables.transitions, tables.velocity_scale, tables.motion_scale):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@pytest.mark.parametrize("states", [1, 2, 3, 7, 8, 100, 255, 256, 1000])
def test_every_size_is_in_order(states: int) -> None:
    tables = open_image(synthetic.image(states, 2, states))
    assert layout.kd_violation(tables.states) is None
    assert len(tables.states) == states


def test_a_swapped_pair_of_rows_is_found() -> None:
    codes = open_image(synthetic.image(300, 1)).states
    found = 0
    for row in range(0, 299, 7):
        swapped = codes.copy()
        swapped[[row, row + 1]] = swapped[[row + 1, row]]
        found += layout.kd_violation(swapped) is not None
    assert found >= 40


def test_every_flipped_bit_of_the_header_is_refused() -> None:
    for bit in range(128 * 8):
        changed = bytearray(IMAGE)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(TableError):
            open_image(bytes(changed))


def test_every_flipped_byte_of_the_sections_is_refused() -> None:
    for index in range(128, len(IMAGE), 3):
        changed = bytearray(IMAGE)
        changed[index] ^= 0x10
        with pytest.raises(TableError, match="CRC-32"):
            open_image(bytes(changed))


@pytest.mark.parametrize(
    ("offset", "replacement", "text"),
    [
        (0, b"FKTC", "not a table image"),
        (4, struct.pack("<H", 2), "format version 2, newer than this program's 1: update frogkick"),
        (4, struct.pack("<H", 0), "format version 0, not 1"),
        (6, struct.pack("<H", 2), "kind 2, known is 1"),
        (8, struct.pack("<I", 99), "says it has 99 bytes"),
        (16, b"\0" * 16, "robot id"),
        (16, b"x" * 16, "robot id"),
        (16, b"frog\0extra", "robot id"),
        (16, b"fro g", "robot id"),
        (64, struct.pack("<I", 0), "period 0 us"),
        (68, struct.pack("<I", 0), "pulse 0 us"),
        (68, struct.pack("<I", 1_425_000), "pulse 1425000 us"),
        (112, struct.pack("<I", 1_425_000), "second delay 1425000 us"),
        (72, struct.pack("<H", 0), "0 states"),
        (74, b"\0", "0 actions"),
        (74, b"\x21", "33 actions"),
        (75, b"\0", "0 limbs"),
        (75, b"\x09", "9 limbs"),
        (76, struct.pack("<I", 132), "actions at byte 132"),
        (80, struct.pack("<I", 0xFFFFFFF0), "states at byte 4294967280"),
        (84, struct.pack("<I", 130), "transitions at byte 130"),
        (72, struct.pack("<H", 42), "at byte"),
        (88, struct.pack("<f", np.nan), r"velocity_scale\[0\] is nan"),
        (92, struct.pack("<f", np.inf), r"velocity_scale\[1\] is inf"),
        (96, struct.pack("<f", -1e-4), r"velocity_scale\[2\]"),
        (100, struct.pack("<f", 0.0), r"motion_scale\[0\] is 0.0"),
        (108, struct.pack("<f", 0.031), r"motion_scale\[2\]"),
        (116, b"\1", "reserved byte"),
        (127, b"\1", "reserved byte"),
        (128, b"\x7f", "name byte 127"),
        (128, b"B", "repeats the name 'B'"),
        (129, b"\x10", "beyond the 4"),
        (130, b"\x80", "beyond the 4"),
        (131, b"\1", "padding byte"),
        (TRANSITIONS_AT - 1, b"\1", "padding byte"),
        (STATES_AT, struct.pack("<h", 16384), "code 16384, allowed is"),
        (STATES_AT, struct.pack("<h", -16384), "code -16384"),
        (TRANSITIONS_AT, struct.pack("<h", -32768), "code -32768"),
        (TRANSITIONS_AT + 6, struct.pack("<h", 16384), "code 16384"),
        (STATES_AT + 6 * 20, struct.pack("<h", 16383), "breaks the k-d order"),
    ],
)
def test_a_well_sealed_but_wrong_image_is_refused_by_name(offset: int, replacement: bytes, text: str) -> None:
    with pytest.raises(TableError, match=text) as caught:
        open_image(synthetic.resealed(IMAGE, offset, replacement))
    assert "\n" not in str(caught.value)


def test_truncated_joined_and_foreign_bytes_are_refused() -> None:
    for length in (0, 3, 4, 127, 128, len(IMAGE) - 1):
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


@pytest.mark.parametrize(
    ("array", "where", "value", "text"),
    [
        (0, (7, 1), 0.2, "initial velocities: row 7, column vy_mps is 0.2"),
        (0, (3, 0), np.nan, "initial velocities: row 3, column vx_mps is nan"),
        (1, (4, 2, 2), np.inf, "displacements: row 4, action C, column dheading_rad is inf"),
        (1, (4, 0, 0), -2000.0, "displacements: row 4, action A, column dx_m is -2000"),
        (2, (9, 4, 2), -3.0, "end velocities: row 9, action E, column omega_rad_s is -3.0"),
    ],
)
def test_a_value_out_of_range_names_row_and_column(
    array: int, where: tuple[int, ...], value: float, text: str
) -> None:
    arrays = synthetic.transitions(20, 5, 2)
    arrays[array][where] = value
    with pytest.raises(TableError, match=text):
        synthetic.pack(*arrays)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"robot_id": "a-much-too-long-id"}, "robot id"),
        ({"robot_id": ""}, "robot id"),
        ({"provenance": b"short"}, "provenance has 5 bytes"),
        ({"limbs": 9}, "9 limbs"),
        ({"limbs": 1}, "beyond the 1"),
        ({"pulse_us": 0}, "pulse 0 us"),
        ({"velocity_scale": (1e-5, 1e-5, 0.0)}, "velocity_scale"),
        ({"action_rows": [("AB", 0, 0)] * 5}, "action"),
        ({"action_rows": [("A", 0, 0)] * 5}, "repeats the name"),
        ({"velocities": np.zeros((19, 3))}, "displacements has shape"),
    ],
)
def test_unusable_metadata_is_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(TableError, match=text):
        synthetic.pack(*synthetic.transitions(20, 5, 2), **changes)


def test_extreme_values_pack_and_no_motion_packs() -> None:
    velocity, motion, end = synthetic.transitions(20, 2, 2)
    velocity[0, 0], end[1, 1, 1] = 16383e-5, -16383e-5
    motion[:, :, 1] = 0.0
    motion[0, 0, 0] = 900.0
    tables = open_image(synthetic.pack(velocity, motion, end))
    assert tables.states[:, 0].max() == 16383
    assert tables.transitions[:, :, 4].min() == -16383
    assert not tables.transitions[:, :, 1].any()
