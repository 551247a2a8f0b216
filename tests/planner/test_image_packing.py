"""What is packed comes back as near as was asked for, in few bytes; what does not fit is refused by name."""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.planner import synthetic

from frogkick.planner.lookup import DYNAMICS, arrays_of, dynamics_after, find_row, motion_of
from frogkick.tables import coding, layout
from frogkick.tables.image import TableError, Tables, open_image

UNITS = np.array([1e-3, 1e-3, np.pi / 180] * 2)
"""Of the six values: mm, degrees, mm/s, degrees/s."""


def decoded(tables: Tables) -> npt.NDArray[np.float64]:
    """(n, a, 6) the table's values in SI."""
    scale = np.concatenate([tables.motion_scale, tables.velocity_scale]).astype(float)
    return tables.transitions * scale


def errors(
    tables: Tables, velocity: npt.ArrayLike, values: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """(n, a, 6) by how much the table differs from what was packed, in UNITS."""
    codes = np.round(np.asarray(velocity) / tables.velocity_scale.astype(float)).astype(np.int16)
    order, _ = layout.kd_order(codes, layout.tree_levels_for(len(codes)))
    np.testing.assert_array_equal(tables.states, codes[order])
    return np.abs(decoded(tables) - values[order]) / UNITS


def error_max(size: float) -> tuple[float, float, float, float]:
    """As many mm, degrees, mm/s, degrees/s."""
    degree = np.pi / 180
    return (size * 1e-3, size * degree, size * 1e-3, size * degree)


@pytest.mark.parametrize("size", [0.2, 0.1, 0.05, 0.02])
def test_what_is_packed_comes_back_within_the_wanted_error(size: float) -> None:
    velocity, motion, end = synthetic.transitions(300, 9, 5)
    tables = open_image(synthetic.pack(velocity, motion, end, error_max=error_max(size)))
    assert (tables.robot_id, tables.period_us, tables.pulse_us, tables.limbs) == (
        "frog2022",
        1425000,
        80000,
        4,
    )
    assert tables.kind == "nearest"
    assert tables.provenance == bytes(range(32))
    assert [row.name for row in tables.actions] == list("ABCDEFGHI")
    gap = errors(tables, velocity, np.concatenate([motion, end], axis=2))
    assert gap.max() <= size * (1 + 1e-5)
    assert gap.max() > 0.9 * size  # and no finer than that: it would cost bytes


def test_a_coarser_table_is_smaller_and_a_fine_one_nearly_exact() -> None:
    arrays = synthetic.transitions(300, 9, 5)
    images = [synthetic.pack(*arrays, error_max=error_max(size)) for size in (1e-9, 0.01, 0.1, 1.0)]
    sizes = [len(content) for content in images]
    assert sizes == sorted(sizes, reverse=True)
    tables = open_image(images[0])
    assert tables.residual_codes.tolist() == [1] * 6
    gap = errors(tables, arrays[0], np.concatenate(arrays[1:], axis=2))
    assert gap[..., :3].max() < 0.006  # 1/32767 of the largest motion
    assert gap[..., 3:].max() <= 0.0051  # half a code of 0.01 mm/s, 0.01 degrees/s


def test_the_default_error_is_half_the_noise_and_the_bytes_are_few() -> None:
    arrays = synthetic.transitions(2000, 9, 5)
    content = synthetic.pack(*arrays)
    gap = errors(open_image(content), arrays[0], np.concatenate(arrays[1:], axis=2))
    assert 0.05 < gap.max() <= 0.1001
    assert len(content) < 0.4 * 2000 * (6 + 9 * 12)  # 12 bytes a transition without any prediction


def test_the_same_input_gives_the_same_bytes_and_row_order_does_not_matter() -> None:
    velocity, motion, end = synthetic.transitions(200, 9, 5)
    shuffled = np.random.default_rng(0).permutation(200)
    assert synthetic.pack(velocity, motion, end) == synthetic.pack(velocity, motion, end)
    again = synthetic.pack(velocity[shuffled], motion[shuffled], end[shuffled])
    assert again == synthetic.pack(velocity, motion, end)
    parts = synthetic.affine_parts(90, 3, 5)
    some = np.random.default_rng(1).permutation(90)
    mixed = {name: array[some] for name, array in parts.items() if name != "history"}
    assert synthetic.affine_image(90, 3, 5) == synthetic.affine_image(90, 3, 5, **mixed)


@settings(max_examples=60)
@given(
    st.integers(1, 60), st.integers(1, 7), st.integers(0, 2**31), st.floats(-7.0, 1.0), st.floats(-6.0, -1.6)
)
def test_any_values_come_back(states: int, actions: int, seed: int, size: float, scale: float) -> None:
    """Noise that no prediction helps with, at any scale, and equal states with different transitions."""
    rng = np.random.default_rng(seed)
    velocity = rng.choice([-1.0, 0.0, 0.5, 1.0], (states, 3)) * 16000 * 10.0**scale
    motion = rng.standard_cauchy((states, actions, 3)).clip(-90, 90) * 10.0**size
    end = rng.uniform(-16383, 16383, (states, actions, 3)) * 10.0**scale
    wanted = (10.0**size * 1e-3, 10.0**size, 10.0**scale * 3, 10.0**scale * 0.1)
    content = synthetic.pack(velocity, motion, end, velocity_resolution=(10.0**scale,) * 3, error_max=wanted)
    tables = open_image(content)
    order, _ = layout.kd_order(tables.states, layout.tree_levels_for(states))
    np.testing.assert_array_equal(tables.states, tables.states[order])
    code = np.concatenate([tables.motion_scale, tables.velocity_scale]).astype(float)
    allowed = np.maximum(np.array(wanted)[[0, 0, 1, 2, 2, 3]], code / 2) * (1 + 1e-4)
    start = np.round(velocity / tables.velocity_scale.astype(float)).astype(np.int16)
    rows, _ = layout.kd_order(start, layout.tree_levels_for(states))
    gap = np.abs(decoded(tables) - np.concatenate([motion, end], axis=2)[rows])
    assert np.all(gap <= allowed)


def test_bits_come_back() -> None:
    rng = np.random.default_rng(3)
    for number in range(30):
        bits = rng.integers(0, 17, rng.integers(1, 60))
        rows = int(rng.integers(1, 9))
        residuals = rng.integers(0, 2**16, (rows, len(bits))) & ((1 << bits) - 1)
        packed = coding.put_residuals(residuals, bits)
        row_bytes = (int(bits.sum()) + 7) // 8
        assert len(packed) == rows * row_bytes
        found = coding.take_residuals(packed + b"\0\0\0", rows, row_bytes, bits)
        np.testing.assert_array_equal(found, residuals, err_msg=f"number {number}")


def test_the_prediction_is_the_quadratic_of_the_format() -> None:
    """Decoded by hand from the image's bytes, in Python's own integers."""
    content = synthetic.image(800, 2, 7)
    tables = open_image(content)
    at = tables.sections
    blocks = 2 ** content[131]
    assert blocks > 1
    row_bytes = struct.unpack_from("<H", content, 128)[0]
    for row in (0, 57, 199, 200, 399, 400, 799):
        state = struct.unpack_from("<3h", content, at.states + 6 * row)
        u = [code << up for code, up in zip(state, content[162:165], strict=True)]
        factors = [16384, *u, *(u[i] * u[j] >> 14 for i in range(3) for j in range(i, 3))]
        block = max(b for b in range(blocks) if b * 800 // blocks <= row)
        stream = int.from_bytes(content[at.transitions + row * row_bytes :][:row_bytes], "little")
        for action in range(2):
            for value in range(6):
                place = 6 * action + value
                first, bits = struct.unpack_from("<HB", content, at.columns + 4 * place)
                coefficients = struct.unpack_from("<10h", content, at.models + 20 * (12 * block + place))
                total = sum(c * f for c, f in zip(coefficients, factors, strict=True))
                unit = struct.unpack_from("<H", content, 150 + 2 * value)[0]
                code = (total >> content[144 + value]) + (stream >> first & (1 << bits) - 1) * unit
                limit = tables.motion_limit[value] if value < 3 else 16383
                assert tables.transitions[row, action, value] == max(-limit, min(limit, code))


def test_an_affine_table_is_the_states_derivatives_and_history_that_were_packed() -> None:
    parts = synthetic.affine_parts(60, 4, 9)
    tables = open_image(synthetic.affine_image(60, 4, 9, error_max=error_max(0.02)))
    assert tables.kind == "affine"
    gap = errors(tables, parts["velocities"], parts["base"]).max(axis=(0, 1))
    span = np.ptp(parts["base"], axis=0).max(axis=0) / UNITS  # 11 bits of it
    assert np.all(gap <= np.maximum(0.02001, span / 2046 / 2 * 1.15))
    assert np.all(gap <= 0.06)
    code = np.concatenate([tables.motion_scale, tables.velocity_scale]).astype(float)
    np.testing.assert_allclose(tables.history * code, parts["history"], atol=0.51 * code.max())
    assert (tables.use_decay, tables.use_gain) == (round(0.61 * 32768), round(0.43 * 32768))
    codes = np.round(parts["velocities"] / tables.velocity_scale.astype(float)).astype(np.int16)
    order, _ = layout.kd_order(codes, layout.tree_levels_for(60))
    slope = tables.derivatives / 2.0 ** tables.correction_shift[:, None] * code[:, None] / code[3:]
    far = tables.offset_limit * code[3:]
    gap = np.abs(slope - parts["jacobian"][order]) * far / UNITS[:, None]
    ratio = np.ptp(parts["jacobian"], axis=0) * code[3:] / code[:, None]
    span = ratio.max(axis=(0, 2))[:, None] * tables.offset_limit * code[:, None] / UNITS[:, None]
    allowed = np.maximum(0.0201, span / 126 * 1.02)  # between 6 and 7 bits of it, by powers of two
    assert np.all(gap <= allowed)  # of a correction at the furthest offset


def test_an_affine_look_up_is_the_sum_that_it_stands_for() -> None:
    """In float64 from what was packed: base, slope times offset, history times use."""
    parts = synthetic.affine_parts(60, 4, 9)
    tables = open_image(synthetic.affine_image(60, 4, 9, error_max=error_max(0.02)))
    table = arrays_of(tables)
    velocity_scale = tables.velocity_scale.astype(float)
    codes = np.round(parts["velocities"] / velocity_scale).astype(np.int16)
    order, _ = layout.kd_order(codes, layout.tree_levels_for(60))
    rng = np.random.default_rng(2)
    motion, after = np.zeros(3, dtype=np.float32), np.zeros(DYNAMICS, dtype=np.int64)
    clamped = 0
    for _ in range(300):
        dynamics = np.zeros(DYNAMICS, dtype=np.int64)
        dynamics[:3] = rng.integers(tables.states.min(axis=0), tables.states.max(axis=0) + 1)
        dynamics[3:7] = rng.integers(0, 32768, 4)
        row = find_row(table, dynamics)
        offset = np.clip(dynamics[:3] - tables.states[row], -tables.offset_limit, tables.offset_limit)
        action = int(rng.integers(0, 4))
        wanted = parts["base"][order[row], action] + parts["jacobian"][order[row], action] @ (
            offset * velocity_scale
        )
        wanted = wanted + (dynamics[3:7] / 32768.0) @ parts["history"][action]
        motion_of(table, row, dynamics, action, motion)
        dynamics_after(table, row, dynamics, action, after)
        found = np.concatenate([motion, after[:3] * velocity_scale])
        met = np.abs(wanted[:3]) <= tables.motion_limit * tables.motion_scale
        clamped += 3 - met.sum()
        assert np.all((np.abs(found - wanted) / UNITS < 0.15) | ~np.append(met, [True] * 3))
        masks = tables.actions[action].first_mask | tables.actions[action].second_mask
        for limb in range(4):
            use = dynamics[3 + limb] / 32768 * 0.61 + 0.43 * (masks >> limb & 1)
            assert after[3 + limb] / 32768 == pytest.approx(min(use, 32767 / 32768), abs=1e-4)
        assert not after[7:].any()
    assert clamped < 5  # of 900: the limit is that of the queries in the box


def test_offsets_are_clamped_as_told_and_reach_as_far_as_the_box_needs() -> None:
    parts = synthetic.affine_parts(60, 4, 9)
    tables = open_image(synthetic.affine_image(60, 4, 9, offset_limit=(0.001, 0.002, 0.05)))
    np.testing.assert_allclose(tables.offset_limit * tables.velocity_scale, (0.001, 0.002, 0.05), rtol=0.01)
    table = arrays_of(open_image(synthetic.affine_image(60, 4, 9)))
    low, high = table.states.min(axis=0), table.states.max(axis=0)
    rng = np.random.default_rng(4)
    beyond = 0
    for _ in range(2000):
        dynamics = np.zeros(DYNAMICS, dtype=np.int64)
        dynamics[:3] = rng.integers(low, high + 1)
        offset = dynamics[:3] - table.states[find_row(table, dynamics)]
        beyond += np.any(np.abs(offset) > table.offset_limit * 1.1)
    assert beyond < 20
    assert len(parts["velocities"]) == 60


def test_four_times_the_states_of_a_plain_code_fit_a_budget() -> None:
    """An affine table costs a fraction of 48 bytes for each action of a state."""
    content = synthetic.affine_image(400, 9, 2)
    assert len(content) / 400 < 0.62 * 9 * 48


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
    base = np.concatenate(arrays[1:], axis=2)
    with pytest.raises(TableError, match=text):
        synthetic.affine_image(20, 5, 2, velocities=arrays[0], base=base)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"robot_id": "a-much-too-long-id"}, "robot id"),
        ({"robot_id": ""}, "robot id"),
        ({"provenance": b"short"}, "provenance has 5 bytes"),
        ({"limbs": 9}, "9 limbs"),
        ({"limbs": 1}, "beyond the 1"),
        ({"pulse_us": 0}, "pulse 0 us"),
        ({"velocity_resolution": (1e-5, 1e-5, 0.0)}, "velocity_resolution"),
        ({"action_rows": [("AB", 0, 0)] * 5}, "action"),
        ({"action_rows": [("A", 0, 0)] * 5}, "repeats the name"),
        ({"velocities": np.zeros((19, 3))}, "displacements has shape"),
        ({"error_max": (1e-4, 1e-3, 1e-4)}, "error_max is"),
        ({"error_max": (1e-4, 0.0, 1e-4, 1e-3)}, "error_max is"),
        ({"error_max": (1e-4, np.nan, 1e-4, 1e-3)}, "error_max is"),
    ],
)
def test_unusable_metadata_is_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(TableError, match=text):
        synthetic.pack(*synthetic.transitions(20, 5, 2), **changes)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"use_decay": 1.1}, "use_decay is 1.1, allowed is 0 to 1"),
        ({"use_gain": -0.1}, "use_gain is -0.1"),
        ({"use_gain": np.nan}, "use_gain is nan"),
        ({"jacobian": np.full((20, 5, 6, 3), np.nan)}, "jacobian holds NaN"),
        ({"jacobian": np.full((20, 5, 6, 3), 1e6)}, "jacobian and history let a motion reach"),
        ({"history": np.full((5, 4, 6), 500.0)}, "let a motion reach 2001"),
        ({"history": np.full((5, 4, 6), [0, 0, 0, 5.0, 0, 0])}, "history holds a value beyond"),
        ({"history": np.zeros((5, 3, 6))}, "history has shape"),
        ({"offset_limit": (0.1, 0.1)}, "offset_limit is .*needed are three"),
        ({"offset_limit": (0.1, -0.1, 0.1)}, "offset_limit is .*needed are three"),
    ],
)
def test_unusable_corrections_are_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(TableError, match=text):
        synthetic.affine_image(20, 5, 2, **changes)


def test_extreme_values_pack_and_no_motion_packs() -> None:
    velocity, motion, end = synthetic.transitions(20, 2, 2)
    velocity[0, 0], end[1, 1, 1] = 16383e-5, -16383e-5
    motion[:, :, 1] = 0.0
    motion[0, 0, 0] = 900.0
    tables = open_image(synthetic.pack(velocity, motion, end))
    assert tables.states[:, 0].max() == 16383
    assert tables.transitions[:, :, 4].min() <= -16370
    assert np.abs(decoded(tables)[:, :, 1]).max() <= 1e-4
    assert decoded(tables)[:, :, 0].max() == pytest.approx(900.0, abs=0.02)
