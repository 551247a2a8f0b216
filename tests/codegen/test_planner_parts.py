"""The planner's parts in C: nearest rows and points, floats, angles, checksums."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from tests.codegen import planner_c
from tests.codegen.planner_c import FFI, library, path_of
from tests.conftest import count
from tests.planner import synthetic

from frogkick.planner import floats
from frogkick.planner.lookup import DYNAMICS, arrays_of, find_row
from frogkick.tables.image import open_image

NEAREST = synthetic.image(60, 5)
NAN, INFINITY = float("nan"), float("inf")


def test_of_equally_near_rows_the_lowest_answers_wherever_the_tree_finds_it() -> None:
    tables = synthetic.grid_tables(states=300)
    rng = np.random.default_rng(14)
    low, high = tables.states.min(axis=0) - 900, tables.states.max(axis=0) + 900
    codes = rng.integers(low, high, (count(1000, 20_000), 3))
    codes[::2] = codes[::2] // 400 * 400
    distance2 = ((tables.states.astype(np.int64)[None] - codes[:, None]) ** 2).sum(axis=2)
    assert ((distance2 == distance2.min(axis=1, keepdims=True)).sum(axis=1) > 1).sum() > 100
    pointer = planner_c.opened(tables.image)
    for code, row in zip(codes.tolist(), distance2.argmin(axis=1).tolist(), strict=True):
        assert library().fk_nearest(pointer.pointer, code) == row


@pytest.mark.parametrize("image", [NEAREST, synthetic.affine_image()], ids=["nearest", "affine"])
def test_a_velocity_beyond_the_table_counts_as_the_nearest_one_at_its_edge(image: bytes) -> None:
    tables = open_image(image)
    states = tables.states.astype(np.int64)
    low, high = states.min(axis=0) - tables.offset_limit, states.max(axis=0) + tables.offset_limit
    codes = np.clip(np.random.default_rng(3).integers(4 * low, 4 * high, (2000, 3)), -16383, 16383)
    codes[::3] = np.random.default_rng(4).integers(low - 2, high + 3, (len(codes[::3]), 3))  # at the edge
    edge = np.clip(codes, low, high)
    rows = ((states[None] - edge[:, None]) ** 2).sum(axis=2).argmin(axis=1)
    assert (rows != ((states[None] - codes[:, None]) ** 2).sum(axis=2).argmin(axis=1)).sum() > 20
    pointer = planner_c.opened(image)
    from_, found = FFI.new("fk_dynamics_t *"), FFI.new("fk_lookup_t *")
    table, dynamics = arrays_of(tables), np.zeros(DYNAMICS, dtype=np.int64)
    for code, row in zip(codes, rows.tolist(), strict=True):
        from_.velocity_code = code.tolist()
        library().fk_lookup(pointer.pointer, from_, found)
        assert found.row == row
        dynamics[:3] = code
        assert find_row(table, dynamics) == row


@pytest.mark.parametrize("states", [1, 3, 5, 7, 21])
def test_what_lies_behind_the_last_row_is_no_row(states: int) -> None:
    """Rows are read in pairs: asked for exactly the bytes behind an odd last row, a real row answers."""
    image = synthetic.image(states, 2)
    tables = open_image(image)
    behind = tables.sections.states + 6 * states
    codes = np.clip(np.frombuffer(image[behind : behind + 6], "<i2").astype(np.int64), -16383, 16383)
    distance2 = ((tables.states.astype(np.int64) - codes) ** 2).sum(axis=1)
    opened = planner_c.opened(image)
    assert library().fk_nearest(opened.pointer, codes.tolist()) == distance2.argmin()


def test_the_nearest_point_is_the_lowest_of_equal_ones() -> None:
    path = path_of([(1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
    distance2 = FFI.new("float *")
    assert library().fk_path_nearest(path, 0.0, 3.0, distance2) == 1
    assert distance2[0] == 9.0
    assert library().fk_path_nearest(path, 1.5, 0.0, FFI.NULL) == 0


@pytest.mark.parametrize("flush", [0, 1])
def test_a_processor_that_breaks_a_float_rule_opens_no_table(flush: int) -> None:
    image, tables = FFI.new("uint8_t[]", NEAREST), FFI.new("fk_tables_t *")
    before = bytes(FFI.buffer(tables))
    status = library().fk_test_open_spoiled(image, len(NEAREST), flush, tables)
    assert status == planner_c.codes()["FLOAT_RULES"]
    assert bytes(FFI.buffer(tables)) == before
    assert library().fk_tables_open(image, len(NEAREST), tables) == 0


def test_angles_are_wrapped_at_every_half_turn_as_in_the_twin() -> None:
    """Around odd multiples of pi, where the quotient's rounding may choose either turn."""
    odd = np.arange(-667, 668, 2) * np.pi
    near = np.concatenate([odd + off for off in (-2e-4, -6e-5, -2e-5, 0.0, 2e-5, 6e-5, 2e-4)])
    angles = np.concatenate([near, [0.0, -0.0, np.pi, -np.pi, 2100.0, -2100.0, 2100.5, NAN, INFINITY]])
    for angle in angles.astype(np.float32):
        native = np.float32(library().fk_wrap_angle(float(angle)))
        twin = np.float32(floats.wrap_angle(angle))
        assert native.tobytes() == twin.tobytes() or (np.isnan(native) and np.isnan(twin)), angle
        if not np.isnan(native):
            assert -np.float32(np.pi) < native <= np.float32(np.pi)


def test_no_angle_at_all_is_wrapped_beyond_half_a_turn() -> None:
    """Every float32 from FK_PI to FK_ANGLE_MAX_RAD, of both signs; in the counted build every thousandth."""
    step = 1009 if planner_c.COVERAGE_DIR else 1
    assert library().fk_test_wrapped_wrong(step) == 0


def test_a_velocity_is_turned_into_the_body_frame() -> None:
    forward, left = FFI.new("float *"), FFI.new("float *")
    for heading_rad in (-3.0, -1.6, -0.4, 0.0, 0.8, 1.6, 2.4, 700.0):
        library().fk_velocity_to_body(heading_rad, 0.3, -0.2, forward, left)
        cosine, sine = np.cos(np.float32(heading_rad)), np.sin(np.float32(heading_rad))
        assert forward[0] == pytest.approx(cosine * 0.3 - sine * 0.2, abs=1e-6)
        assert left[0] == pytest.approx(-cosine * 0.2 - sine * 0.3, abs=1e-6)
    library().fk_velocity_to_body(3000.0, 0.3, -0.2, forward, left)
    assert np.isnan(forward[0])
    assert np.isnan(left[0])


def test_floats_that_are_not_finite_are_told() -> None:
    for value in (0.0, -0.0, 3.4e38, -3.4e38, 1e-45):
        assert library().fk_float_is_not_finite(value) == 0
    for value in (NAN, -NAN, INFINITY, -INFINITY):
        assert library().fk_float_is_not_finite(value) == 1


def test_the_crc_is_zlib_s_and_takes_nothing_of_nothing() -> None:
    assert library().fk_crc32(0, FFI.NULL, 0) == 0
    part = library().fk_crc32(0, NEAREST, 100)
    assert library().fk_crc32(part, NEAREST[100:], len(NEAREST) - 100) == zlib.crc32(NEAREST)


@pytest.mark.parametrize(
    ("size", "lost"),
    [(1.0, [32767, 12345, 1, 0]), (200.0, [32767, 32767, 30000, 16384])],
    ids=["some", "all"],
)
def test_worn_limbs_shift_each_action_s_values(size: float, lost: list[int]) -> None:
    fresh = open_image(synthetic.affine_image(limb_wear=synthetic.wear_curves(4, 8, 2, size)))
    worn = fresh.worn(lost)
    pointer, made = planner_c.opened(fresh.image), FFI.new("int16_t[192]")
    library().fk_wear_shift(pointer.pointer, [*lost, 0, 0, 0, 0], made)
    actions = len(fresh.actions)
    assert list(made)[: 6 * actions] == worn.shift.ravel().tolist()
    assert (np.abs(worn.shift).max() == 32767) == (size > 1.0)
    codes = np.random.default_rng(5).integers(-300, 300, (200, 3))
    use = np.zeros((len(codes), 8), dtype=np.uint16)
    before, after = (planner_c.native_tables().look_up(each, codes, use) for each in (fresh, worn))
    assert (before.rows == after.rows).all()
    ends = before.dynamics[:, :, :3]
    wanted = ends + worn.shift[None, :, 3:]
    inside = (np.abs(ends) < 16383) & (np.abs(wanted) < 16383)
    assert inside.any()
    np.testing.assert_array_equal(after.dynamics[:, :, :3][inside], wanted[inside])
