"""The C opens what the host opens, refuses what the host refuses, and says why by its own code."""

from __future__ import annotations

import re
import struct

import numpy as np
import pytest
from tests.codegen import planner_c
from tests.codegen.native_tables import NativeTables
from tests.conftest import count
from tests.planner import synthetic
from tests.planner.test_image import WRONG, WRONG_AFFINE, WRONG_NEAREST

from frogkick.planner.lookup import velocity_code
from frogkick.tables import layout
from frogkick.tables.image import TableError, open_image
from frogkick_codegen.native import planner_files

IMAGE = synthetic.image(states=41, actions=5)
AFFINE = synthetic.affine_image(states=41, actions=5)
THREE = synthetic.affine_image(
    20, 2, limbs=3, action_rows=[("A", 7, 0), ("B", 1, 6)], history=np.ones((2, 3, 6)) * 1e-3
)
WORN = synthetic.affine_image(41, 5, limb_wear=synthetic.wear_curves(4, 3, 1))
AT = open_image(IMAGE).sections
WORN_AT = open_image(WORN).sections
AFFINE_AT = open_image(AFFINE).sections
THREE_AT = open_image(THREE).sections
HEADER = layout.HEADER_BYTES


@pytest.fixture(scope="module")
def library() -> NativeTables:
    return planner_c.native_tables()


def error_codes() -> dict[str, int]:
    """Return the image errors of fk_tables.h."""
    text = planner_files()["fk_tables.h"].decode()
    return {name: int(value) for name, value in re.findall(r"\bFK_ERROR_IMAGE_(\w+) = (-?\d+)", text)}


def u16(value: int) -> bytes:
    return struct.pack("<H", value)


@pytest.mark.parametrize(
    ("content", "offset", "replacement", "name"),
    [
        (IMAGE, 0, b"G", "MAGIC"),
        (IMAGE, 1, b"L", "MAGIC"),
        (IMAGE, 2, b"U", "MAGIC"),
        (IMAGE, 3, b"C", "MAGIC"),
        (IMAGE, 4, u16(1), "VERSION"),
        (IMAGE, 4, u16(4), "VERSION"),
        (IMAGE, 4, u16(3), "COUNT"),
        (WORN, 4, u16(2), "COUNT"),
        (IMAGE, 6, u16(3), "KIND"),
        (IMAGE, 8, struct.pack("<I", 99), "LENGTH"),
        (IMAGE, 16, b"\0", "ROBOT_ID"),
        (IMAGE, 16, b"\x7f", "ROBOT_ID"),
        (IMAGE, 18, b" ", "ROBOT_ID"),
        (IMAGE, 30, b"x", "ROBOT_ID"),
        (IMAGE, 68, struct.pack("<I", 0), "TIMES"),
        (IMAGE, 72, u16(0), "COUNT"),
        (IMAGE, 74, b"\0", "COUNT"),
        (IMAGE, 75, b"\x09", "COUNT"),
        (IMAGE, 130, b"\x06", "COUNT"),
        (IMAGE, 130, b"\x0e", "COUNT"),
        (IMAGE, 131, b"\x09", "COUNT"),
        (IMAGE, 131, b"\x06", "COUNT"),
        (AFFINE, 131, b"\x01", "COUNT"),
        (IMAGE, 76, struct.pack("<I", 132), "OFFSET"),
        (IMAGE, 84, struct.pack("<I", 0xFFFFFFFC), "OFFSET"),
        (IMAGE, 116, struct.pack("<I", 0), "OFFSET"),
        (IMAGE, 120, struct.pack("<I", 0), "OFFSET"),
        (IMAGE, 124, struct.pack("<I", 0), "OFFSET"),
        (IMAGE, 72, u16(65535), "OFFSET"),
        (IMAGE, 128, u16(65535), "OFFSET"),
        (IMAGE, 88, struct.pack("<f", np.nan), "SCALE"),
        (IMAGE, 100, struct.pack("<f", -0.0), "SCALE"),
        (IMAGE, 132, u16(0), "SCALE"),
        (IMAGE, 136, u16(32768), "SCALE"),
        (IMAGE, 138, u16(1), "SCALE"),
        (AFFINE, 142, u16(16384), "SCALE"),
        (IMAGE, 144, b"\x0d", "SCALE"),
        (IMAGE, 149, b"\x15", "SCALE"),
        (AFFINE, 149, b"\x10", "SCALE"),
        (IMAGE, 160, u16(0), "SCALE"),
        (IMAGE, 164, b"\x0f", "SCALE"),
        (AFFINE, 162, b"\x01", "SCALE"),
        (IMAGE, 166, u16(1), "SCALE"),
        (AFFINE, 168, u16(32768), "SCALE"),
        (IMAGE, 165, b"\1", "COUNT"),
        (IMAGE, 165, b"\x11", "COUNT"),
        (WORN, 165, b"\2", "OFFSET"),
        (WORN, WORN_AT.wear, struct.pack("<h", -32768), "CODE"),
        (WORN, WORN_AT.splits - 2, struct.pack("<h", -32768), "CODE"),
        (IMAGE, 171, b"\1", "PADDING"),
        (IMAGE, 172, b"\3", "ORDER"),
        (IMAGE, 175, b"\1", "ORDER"),
        (IMAGE, HEADER, b"B", "ACTION"),
        (IMAGE, HEADER, b"\x20", "ACTION"),
        (IMAGE, HEADER + 1, b"\x10", "ACTION"),
        (IMAGE, HEADER + 3, b"\1", "PADDING"),
        (IMAGE, AT.columns, u16(1), "COLUMN"),
        (IMAGE, AT.columns + 2, b"\x11", "COLUMN"),
        (IMAGE, AT.columns + 3, b"\1", "PADDING"),
        (IMAGE, AT.columns + 4 * 29 + 2, b"\x0c", "COLUMN"),
        (IMAGE, AT.columns + 4 * 29 + 2, b"\x10", "COLUMN"),
        (IMAGE, 156, u16(65535), "COLUMN"),
        (IMAGE, AT.splits, struct.pack("<h", 16384), "CODE"),
        (IMAGE, AT.models - 1, b"\1", "PADDING"),
        (IMAGE, AT.models, struct.pack("<5h", *[32767] * 5), "CODE"),
        (AFFINE, AFFINE_AT.columns, struct.pack("<h", -32768), "CODE"),
        (AFFINE, AFFINE_AT.columns + 4, struct.pack("<h", 32641), "CODE"),
        (AFFINE, AFFINE_AT.columns + 6, struct.pack("<h", -32768), "CODE"),
        (AFFINE, AFFINE_AT.columns + 14, struct.pack("<h", -32768), "CODE"),
        (AFFINE, AFFINE_AT.columns + 8, struct.pack("<3h", 32767, 32767, 32767), "CODE"),
        (AFFINE, 150, u16(513), "COLUMN"),
        (THREE, THREE_AT.columns + 14, u16(1), "PADDING"),
        (IMAGE, AT.states, struct.pack("<h", 16384), "CODE"),
        (IMAGE, 162, b"\x0e", "CODE"),
        (IMAGE, AT.states, struct.pack("<3h", 4095, 4095, 4095), "ORDER"),
        (IMAGE, AT.transitions - 1, b"\1", "PADDING"),
        (IMAGE, AT.length - 1, b"\1", "PADDING"),
    ],
)
def test_the_c_refuses_a_wrong_image_by_its_own_code(
    library: NativeTables, content: bytes, offset: int, replacement: bytes, name: str
) -> None:
    changed = synthetic.resealed(content, offset, replacement)
    assert library.open_status(changed) == error_codes()[name]
    with pytest.raises(TableError):
        open_image(changed)


def test_the_c_refuses_whatever_the_host_refuses_by_name(library: NativeTables) -> None:
    for content, cases in ((IMAGE, WRONG + WRONG_NEAREST), (AFFINE, WRONG + WRONG_AFFINE)):
        assert library.open_status(content) == 0
        for offset, replacement, _ in cases:
            assert library.open_status(synthetic.resealed(content, offset, replacement)) < 0, offset


def test_the_c_refuses_damage_and_wrong_sizes(library: NativeTables) -> None:
    numbers = error_codes()
    for content in (IMAGE, AFFINE):
        assert library.open_status(content) == 0
        assert library.open_status(content[: HEADER - 1]) == numbers["SIZE"]
        assert library.open_status(content[:-1]) == numbers["LENGTH"]
        assert library.open_status(content + b"\0") == numbers["LENGTH"]
        damaged = bytearray(content)
        damaged[300] ^= 1
        assert library.open_status(bytes(damaged)) == numbers["CRC"]
        with pytest.raises(TableError, match=r"fk_error_t -25"):
            library.nearest(bytes(damaged), [[0, 0, 0]])


@pytest.mark.parametrize(
    "content", [IMAGE, AFFINE, THREE, synthetic.image(7, 2), synthetic.affine_image(1, 1)]
)
def test_c_and_python_refuse_the_same_images(library: NativeTables, content: bytes) -> None:
    """Random well-sealed changes, one byte or some: both open an image, or neither does."""
    seed = 11
    rng = np.random.default_rng(seed)
    opened = 0
    edges = [0, 1, 2, 3, 5, 14, 15, 16, 127, 128, 255]
    for number in range(count(1500, 20_000, 300)):
        changed = content
        for _ in range(int(rng.integers(1, 3))):
            late = rng.random() < 0.3
            offset = int(rng.integers(HEADER, len(content)) if late else rng.integers(4, HEADER))
            value = rng.choice(edges) if rng.random() < 0.5 else rng.integers(0, 256)
            changed = synthetic.resealed(changed, offset, bytes([int(value)]))
        try:
            open_image(changed)
            good = True
        except TableError:
            good = False
        opened += good
        assert (library.open_status(changed) == 0) == good, f"seed {seed}, number {number}"
    assert opened > 50


def test_what_opens_after_any_change_is_looked_up_within_bounds(library: NativeTables) -> None:
    """Whatever a sealed image says, no look-up leaves its limits or the image."""
    rng = np.random.default_rng(12)
    for content in (synthetic.image(30, 3), synthetic.affine_image(30, 3)):
        at = open_image(content).sections
        for _ in range(count(150, 2000, 40)):
            body = bytearray(content)
            for offset in rng.integers(at.models, len(content), 40):
                body[offset] = rng.integers(0, 256)
            body[132:138] = rng.integers(1, 32768, 3).astype("<u2").tobytes()
            changed = synthetic.resealed(bytes(body), 0, b"F")
            if library.open_status(changed) != 0:
                continue
            tables = open_image(changed)
            codes = rng.integers(-16383, 16384, (50, 3))
            found = library.look_up(tables, codes, rng.integers(0, 65536, (50, 8)))
            limit = tables.motion_limit.astype(np.float32) * tables.motion_scale
            assert np.all(np.abs(found.motions) <= limit)
            assert np.abs(found.dynamics[..., :3]).max() <= 16383
            assert found.dynamics[..., 3:].max() <= 32767


def test_c_and_python_find_the_same_break_of_order(library: NativeTables) -> None:
    content = synthetic.image(120, 1)
    at = open_image(content).sections
    levels = content[130]
    axes = layout.axes_of(int.from_bytes(content[172:176], "little"), levels)
    rng = np.random.default_rng(12)
    broken = 0
    for number in range(count(600, 6000)):
        if number % 3:
            offset = at.states + 2 * int(rng.integers(0, 360))
        else:
            offset = at.splits + 2 * int(rng.integers(0, 2**levels - 1))
        changed = synthetic.resealed(content, offset, struct.pack("<h", int(rng.integers(-4000, 4000))))
        codes = np.frombuffer(changed, "<i2", 360, at.states).reshape(120, 3)
        splits = np.frombuffer(changed, "<i2", 2**levels - 1, at.splits)
        wrong = layout.kd_violation(codes, splits, axes) is not None
        broken += wrong
        assert (library.open_status(changed) == error_codes()["ORDER"]) == wrong
    assert 100 < broken < count(600, 6000) - 100


def test_the_widest_squared_distance_does_not_overflow(library: NativeTables) -> None:
    """Two rows in opposite corners: 3 x 32766^2 must still compare as the larger distance."""
    velocity = np.array([[-0.16383] * 3, [0.16383] * 3])
    content = synthetic.pack(
        velocity, np.zeros((2, 1, 3)), np.zeros((2, 1, 3)), velocity_resolution=[1e-5] * 3
    )
    states = open_image(content).states
    for code in (-16383, 16383):
        (row,) = library.nearest(content, [[code] * 3])
        assert states[row].tolist() == [code] * 3


def test_a_table_for_another_robot_is_refused(library: NativeTables) -> None:
    assert library.robot_status(IMAGE, b"frog2022") == 0
    for other in (b"frog2023", b"frog202", b"frog20222", b"", b"a-much-longer-name-of-a-robot"):
        assert library.robot_status(IMAGE, other) == -9
    named = synthetic.resealed(IMAGE, 16, b"fifteen_letters\0")
    assert library.robot_status(named, b"fifteen_letters") == 0
    assert library.robot_status(named, b"fifteen_letterss") == -9


def test_actions_are_read_and_those_beyond_refused(library: NativeTables) -> None:
    for index, row in enumerate(open_image(IMAGE).actions):
        assert library.action(IMAGE, index) == (row.name, row.first_mask, row.second_mask)
    for index in (5, 255):
        with pytest.raises(TableError, match="fk_error_t -8"):
            library.action(IMAGE, index)


def test_null_pointers_are_refused_everywhere(library: NativeTables) -> None:
    assert library.null_statuses(IMAGE) == [-1] * 6


def test_velocities_become_codes_as_in_the_twin(library: NativeTables) -> None:
    rng = np.random.default_rng(13)
    per_velocity = np.float32(1) / np.float32(1e-5)
    halves = (rng.integers(-16400, 16400, 5000) + 0.5) * 1e-5
    velocities = np.concatenate(
        [
            halves, np.nextafter(halves.astype(np.float32), np.float32(1)), rng.uniform(-0.2, 0.2, 5000),
            [0.0, -0.0, 1e-45, 0.163825, -0.163825, 0.16383, 1e38, -1e38, 3.4e38],
        ]
    ).astype(np.float32)  # fmt: skip
    twin = [velocity_code(velocity, per_velocity) for velocity in velocities]
    assert library.velocity_codes(velocities, per_velocity).tolist() == twin
    assert twin[-1] == 16383
