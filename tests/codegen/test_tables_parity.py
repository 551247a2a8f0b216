"""The table's C and its twin say the same of a state, bit for bit; the nearest row is the exact one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from tests.codegen.native_tables import LookedUp, NativeTables
from tests.conftest import count, from_ci, some
from tests.planner import synthetic

from frogkick.planner.lookup import (
    DYNAMICS,
    TableArrays,
    action_count,
    arrays_of,
    dynamics_after,
    find_row,
    motion_of,
)
from frogkick.tables.image import Tables, open_image
from frogkick.tables.layout import LIMBS_MAX, VELOCITY_CODE_MAX
from frogkick_codegen.native import planner_files

Int64 = np.ndarray[Any, np.dtype[np.int64]]

SEED = 5
NEAREST = open_image(synthetic.image())
AFFINE = open_image(synthetic.affine_image())
# Derivatives, offsets and history as large as they can be: every clamp and every rounding is met.
EXTREME = open_image(
    synthetic.affine_image(
        40, 5, 3, jacobian=synthetic.affine_parts(40, 5, 3)["jacobian"] * 60.0,
        history=synthetic.affine_parts(40, 5, 3)["history"] * 20.0,
        offset_limit=(0.16, 0.16, 2.8), use_decay=1.0, use_gain=1.0,
    )
)  # fmt: skip
TABLES = {
    "nearest": NEAREST,
    "affine": AFFINE,
    "extreme": EXTREME,
    "nearest of 1 row": open_image(synthetic.image(1, 1)),
    "affine of 2 rows": open_image(synthetic.affine_image(2, 32)),
    "eight limbs": open_image(
        synthetic.affine_image(
            30, 4, limbs=8, history=np.ones((4, 8, 6)) * 0.03,
            action_rows=[("A", 255, 0), ("B", 0, 128), ("C", 1, 254), ("D", 0, 0)],
        )
    ),
    "worn": open_image(
        synthetic.affine_image(limb_wear=synthetic.wear_curves(4, 8, 2))
    ).worn([32767, 12345, 1, 0]),
    "worn, nearest": open_image(
        synthetic.pack(*synthetic.transitions(50, 5, 2), limb_wear=synthetic.wear_curves(4, 16, 3))
    ).worn([4095, 32767, 2048, 20000]),
    "worn as far as codes go": open_image(
        synthetic.affine_image(60, 5, 3, limb_wear=synthetic.wear_curves(4, 2, 4, 200.0))
    ).worn([32767, 32767, 30000, 16384]),
}  # fmt: skip


@pytest.fixture(scope="module")
def library() -> NativeTables:
    return NativeTables()


@njit
def _look_up(
    table: TableArrays, codes: Any, use: Any, rows: Any, motions: Any, dynamics: Any
) -> None:  # pragma: no cover
    state = np.zeros(DYNAMICS, dtype=np.int64)
    for k in range(len(codes)):
        state[:3] = codes[k]
        state[3:] = use[k]
        rows[k] = find_row(table, state)
        for action in range(action_count(table)):
            motion_of(table, rows[k], state, action, motions[k, action])
            dynamics_after(table, rows[k], state, action, dynamics[k, action])


def twin(tables: Tables, codes: Int64, use: Int64) -> LookedUp:
    """Look up in Python."""
    shape = (len(codes), len(tables.actions))
    found = LookedUp(
        np.zeros(len(codes), dtype=np.int64),
        np.zeros((*shape, 3), dtype=np.float32),
        np.zeros((*shape, DYNAMICS), dtype=np.int64),
    )
    _look_up(arrays_of(tables), np.asarray(codes, np.int64), np.asarray(use, np.int64), *found)
    return found


def states(tables: Tables, number: int, seed: int) -> tuple[Int64, Int64]:
    """Velocity codes in and beyond the table's box, on rows and beside them; limb uses with their ends."""
    rng = np.random.default_rng([seed, number])
    low, high = tables.states.min(axis=0) - 500, tables.states.max(axis=0) + 500
    codes = rng.integers(low, high, (number, 3))
    near = tables.states[rng.integers(0, len(tables.states), number)] + rng.integers(-2, 3, (number, 3))
    codes = np.where(rng.random((number, 1)) < 0.3, near, codes)
    far = rng.integers(-VELOCITY_CODE_MAX, VELOCITY_CODE_MAX + 1, (number, 3))
    codes = np.where(rng.random((number, 1)) < 0.1, far, codes)
    ends = rng.choice([0, 1, 16384, 32766, 32767], (number, LIMBS_MAX))
    use = np.where(rng.random((number, LIMBS_MAX)) < 0.4, ends, rng.integers(0, 32768, (number, LIMBS_MAX)))
    return np.clip(codes, -VELOCITY_CODE_MAX, VELOCITY_CODE_MAX), use


def differences(native: LookedUp, python: LookedUp) -> dict[str, int]:
    """How many numbers differ, by what they are."""
    return {
        "rows": int((native.rows != python.rows).sum()),
        "motions": int((native.motions.view(np.uint32) != python.motions.view(np.uint32)).sum()),
        "dynamics": int((native.dynamics != python.dynamics).sum()),
    }


@pytest.mark.parametrize("name", TABLES)
def test_python_and_c_look_up_alike(library: NativeTables, name: str) -> None:
    tables = TABLES[name]
    codes, use = states(tables, count(20_000, 200_000, 5000), SEED)
    python = twin(tables, codes, use)
    assert differences(library.look_up(tables, codes, use), python) == dict.fromkeys(python._fields, 0)
    if name == "extreme":  # the clamps are met, not only passed by
        assert (np.abs(python.dynamics[..., :3]) == VELOCITY_CODE_MAX).sum() > 100
        limit = tables.motion_limit.astype(np.float32) * tables.motion_scale
        assert (np.abs(python.motions) == limit).sum() > 100


@given(
    name=st.sampled_from(sorted(TABLES)),
    codes=st.lists(st.integers(-VELOCITY_CODE_MAX, VELOCITY_CODE_MAX), min_size=3, max_size=3),
    use=st.lists(st.integers(0, 32767), min_size=LIMBS_MAX, max_size=LIMBS_MAX),
)
def test_python_and_c_look_up_any_state_alike(
    library: NativeTables, name: str, codes: list[int], use: list[int]
) -> None:
    python = twin(TABLES[name], np.array([codes]), np.array([use]))
    native = library.look_up(TABLES[name], [codes], [use])
    assert differences(native, python) == dict.fromkeys(python._fields, 0)


def test_whole_chains_of_actions_stay_alike(library: NativeTables) -> None:
    """What one look-up ends in, the next one begins with: 60 strokes, each action in turn."""
    codes, use = states(AFFINE, 50, SEED)
    for stroke in range(60):
        python = twin(AFFINE, codes, use)
        assert differences(library.look_up(AFFINE, codes, use), python) == dict.fromkeys(python._fields, 0)
        after = python.dynamics[np.arange(50), (np.arange(50) + stroke) % 9]
        codes, use = after[:, :3], after[:, 3:]
    assert use[:, :4].max() > 20_000  # limbs that fire are used,
    assert not use[:, 4:].any()  # and others there are none


@pytest.mark.parametrize("name", TABLES)
def test_no_look_up_goes_beyond_the_reach(library: NativeTables, name: str) -> None:
    tables = TABLES[name]
    stroke_max_m, turn_max_rad = library.bounds(tables.image)
    assert (stroke_max_m, turn_max_rad) == (tables.stroke_max_m, tables.turn_max_rad)
    table = arrays_of(tables)
    assert table.stroke_max_m[0] == stroke_max_m
    codes, use = states(tables, 20_000, SEED + 1)
    motions = library.look_up(tables, codes, use).motions.astype(np.float64)
    assert np.hypot(motions[..., 0], motions[..., 1]).max() <= float(stroke_max_m) * (1 + 1e-7)
    assert np.abs(motions[..., 2]).max() <= turn_max_rad
    if name == "nearest":  # and the bound is a near one
        assert np.abs(motions[..., 2]).max() == turn_max_rad
        assert np.hypot(motions[..., 0], motions[..., 1]).max() > 0.6 * float(stroke_max_m)


def brute_force(rows: Int64, codes: Int64) -> Int64:
    """Index of the least squared distance, the lowest on ties."""
    found = np.empty(len(codes), dtype=np.int64)
    _brute_force(rows.astype(np.int64), codes.astype(np.int64), found)
    return found


@njit
def _brute_force(rows: Any, codes: Any, found: Any) -> None:  # pragma: no cover
    for k in range(len(codes)):
        best = np.int64(2) ** 62
        for row in range(len(rows)):
            a = rows[row, 0] - codes[k, 0]
            b = rows[row, 1] - codes[k, 1]
            c = rows[row, 2] - codes[k, 2]
            if a * a + b * b + c * c < best:
                best = a * a + b * b + c * c
                found[k] = row


def full_size(grid: int) -> Tables:
    """As many states as the paper's, on a grid of so many codes: equal distances and equal rows abound."""
    velocity, motion, end = synthetic.transitions(8503, 1, 8)
    step = np.array(synthetic.VELOCITY_SCALE) * grid
    return open_image(synthetic.pack(np.round(velocity / step) * step, motion, end))


def queries(tables: Tables, number: int, grid: int) -> Int64:
    """Inside, at the box's faces, edges and corners, beyond them, at the codes' ends; half of them tie."""
    rng = np.random.default_rng(number)
    rows = tables.states.astype(np.int64)
    low, high = rows.min(axis=0), rows.max(axis=0)
    codes = rng.integers(low, high + 1, (number, 3))
    middle = rows[rng.integers(0, len(rows), number)] + rows[rng.integers(0, len(rows), number)]
    codes = np.where(rng.random((number, 1)) < 0.3, (middle // 2) // grid * grid + grid // 2, codes)
    face = rng.integers(0, 3, (number, 3))
    edge = np.where(face == 0, low, np.where(face == 1, high, codes)) + rng.integers(-1, 2, (number, 3))
    codes = np.where(rng.random((number, 1)) < 0.2, edge, codes)
    beyond = rng.integers(low - 2000, high + 2001, (number, 3))
    codes = np.where(rng.random((number, 1)) < 0.1, beyond, codes)
    end = rng.choice([-VELOCITY_CODE_MAX, 0, VELOCITY_CODE_MAX], (number, 3))
    codes = np.where(rng.random((number, 3)) < 0.02, end, codes)
    return np.clip(codes, -VELOCITY_CODE_MAX, VELOCITY_CODE_MAX)


@from_ci
@pytest.mark.parametrize("grid", [1, 400])
def test_the_nearest_of_8503_states_is_that_of_brute_force(library: NativeTables, grid: int) -> None:
    tables = full_size(grid)
    codes = queries(tables, count(50_000, 500_000, 10_000), grid)
    rows = tables.states.astype(np.int64)
    found = library.nearest(tables.image, codes)
    np.testing.assert_array_equal(found, brute_force(rows, codes))
    ties = 0
    for part in codes[:5000].reshape(-1, 500, 3):
        distance2 = ((rows[None] - part[:, None]) ** 2).sum(axis=2)
        ties += int(((distance2 == distance2.min(axis=1, keepdims=True)).sum(axis=1) > 1).sum())
    assert ties > (2000 if grid > 1 else 0)


@pytest.mark.parametrize("number", [1, 2, 7, 8, 15, 16, 17, 31, 100, 257, 65535])
def test_the_nearest_is_exact_for_any_number_of_states(library: NativeTables, number: int) -> None:
    tables = open_image(synthetic.image(number, 1, number))
    codes = queries(tables, 3000 if number < 60_000 else 300, 50)
    wanted = brute_force(tables.states.astype(np.int64), codes)
    np.testing.assert_array_equal(library.nearest(tables.image, codes), wanted)


def test_a_search_looks_at_few_rows() -> None:
    """Counted in the C itself: rows whose distance is computed, over states in the box and beyond it."""
    files = dict(planner_files())
    source = files["nearest.c"].decode()
    counted = source.replace(
        "            const int32_t d0 =",
        "            fk_rows_seen += 2U;\n" + " " * 12 + "const int32_t d0 =",
        1,
    )
    counted = counted.replace(
        "uint16_t fk_nearest(", "static uint32_t fk_rows_seen;\n\nuint16_t fk_nearest(", 1
    )
    counted = counted.replace(
        "    uint32_t best_row = 0U;\n", "    uint32_t best_row = 0U;\n    fk_rows_seen = 0U;\n", 1
    )
    counted = counted.replace("return (uint16_t)best_row;", "return (uint16_t)fk_rows_seen;", 1)
    assert counted.count("fk_rows_seen") == 4
    files["nearest.c"] = counted.encode()
    counting = NativeTables(files, flags=("-std=c99", "-O2"))
    tables = full_size(1)
    rng = np.random.default_rng(1)
    low, high = tables.states.min(axis=0), tables.states.max(axis=0)
    inside = counting.nearest(tables.image, rng.integers(low, high + 1, (count(20_000, 200_000), 3)))
    anywhere = counting.nearest(tables.image, queries(tables, count(20_000, 200_000), 1))
    print(
        f"rows seen of 8503: inside mean {inside.mean():.0f}, most {inside.max()}, anywhere {anywhere.max()}"
    )
    assert inside.mean() < 70
    assert inside.max() < 260
    assert anywhere.max() < 1000


MUTATIONS = {
    "a tie takes the highest row": ("nearest.c", "(row < best_row)", "(row > best_row)"),
    "a side at the best distance is left": ("nearest.c", "box_distance2 > best", "box_distance2 >= best"),
    "the far box is too far": ("nearest.c", "- apart2[here] + plane2", "+ plane2"),
    "the wrong axis": ("nearest.c", "axes >>= 2;", "axes >>= 0;"),
    "the box of the states is not kept": ("nearest.c", "(below > 0) ? below :", "(below > 0) ? -2 * below :"),
    "a leaf's last row is left out": ("nearest.c", "row < end; row +=", "row + 2U < end; row +="),
    "a leaf's first row is left out": ("nearest.c", "row &= ~1U;", "row = (row + 1U) & ~1U;"),
    "a tie of a pair's second takes it": ("nearest.c", "(row + 1U < best_row)", "(row + 1U > best_row)"),
    "the middle word is read the other way": ("nearest.c", "fk_low(middle) -", "fk_high(middle) -"),
    "a velocity beyond the table stays there": ("lookup.c", "? least :", "? code :"),
    "the edge is at the states": ("lookup.c", "state_most[axis] + tables", "state_most[axis] + 0 * tables"),
    "blocks begin a row early": ("lookup.c", "- 1U) / tables->states", ") / tables->states"),
    "a coefficient is left out": ("lookup.c", "index < FK_COEFFICIENTS / 2U; index++", "index < 4U; index++"),
    "a product is rounded otherwise": ("lookup.c", "(u1 * u2) >> 14", "(u1 * u2 + 8191) >> 14"),
    "a residual has a bit less": ("lookup.c", "(1U << (head >> 16)) - 1U", "(1U << (head >> 16)) / 2U"),
    "a correction is not rounded": ("lookup.c", "((1U << shift) >> 1)", "((0U << shift) >> 1)"),
    "a correction is not clamped": ("lookup.c", "fk_clamp(offset, tables->offset_limit[index])", "offset"),
    "a derivative has a bit less": ("lookup.c", "(word >> 14) & 127U", "(word >> 14) & 63U"),
    "history is rounded otherwise": ("lookup.c", "code + (sum >> 15)", "code + ((sum + 1) >> 15)"),
    "two limbs are left out": ("lookup.c", "(column + 12), lookup->factors[1]", "(column + 12), 0U"),
    "four limbs are left out": ("lookup.c", "column_bytes > 16U", "column_bytes > 99U"),
    "a motion is not clamped": ("lookup.c", "fk_clamp(codes[1], tables->motion_limit[1])", "codes[1]"),
    "a velocity is clamped a code early": ("lookup.c", "FK_VELOCITY_CODE_MAX);", "16382);"),
    "a use decays a period late": ("lookup.c", "use[limb] * tables->use_decay", "use[limb] * 32768U"),
    "a use does not saturate": ("lookup.c", "(used > FK_LIMB_USE_MAX) ? FK_LIMB_USE_MAX : used", "used"),
    "the second group is not counted": ("lookup.c", "row[1] | (uint32_t)row[2]", "row[1]"),
    "a curve begins at its first knot": ("wear.c", "(knot > 0U) ?", "(knot > 9U) ?"),
    "a curve has steps": ("wear.c", "(step * part) >> 15", "(step * part) >> 31"),
    "a curve is rounded otherwise": ("wear.c", "(step * part) >> 15", "(step * part) / 32768"),
    "worn limbs of the second group do not count": ("wear.c", "row[1] | (uint32_t)row[2]", "row[1]"),
    "a shift wraps": ("wear.c", "sum = (sum > INT16_MAX) ? INT16_MAX : sum;", ""),
    "a shift is not added": ("lookup.c", "codes[1] += shift[1];", ""),
    "a unit is one code": ("lookup.c", "residual * tables->unit[first + value]", "residual"),
    "a unit of a value is one code": ("lookup.c", "(word >> 21) * tables->unit[first + value]", "word >> 21"),
}  # fmt: skip


@pytest.mark.parametrize("name", some(MUTATIONS, 6))
def test_a_changed_rule_in_the_c_is_found(name: str) -> None:
    file, before, after = MUTATIONS[name]
    files = dict(planner_files())
    source = files[file].decode()
    assert source.count(before) == 1, "the rule moved: correct the mutation"
    files[file] = source.replace(before, after).encode()
    mutant = NativeTables(files, flags=("-std=c99", "-O1"))
    found = 0
    for tables in (*TABLES.values(), synthetic.grid_tables()):
        codes, use = states(tables, 3000, SEED + 2)
        found += sum(differences(mutant.look_up(tables, codes, use), twin(tables, codes, use)).values())
        rows = brute_force(tables.states.astype(np.int64), codes)
        found += int((mutant.nearest(tables.image, codes) != rows).sum())
    assert found


@pytest.mark.parametrize("content", [synthetic.image(20, 3, 2), synthetic.affine_image(20, 3, 2)])
def test_every_changed_bit_of_a_transition_is_found(library: NativeTables, content: bytes) -> None:
    """Each bit of a row's residuals, well sealed: both sides see another value, and the same one."""
    tables = open_image(content)
    codes, use = states(tables, 300, SEED + 3)
    codes[:20] = tables.states
    before = library.look_up(tables, codes, use)
    last = tables.sections.columns + 4 * 17
    bits = int.from_bytes(content[last : last + 2], "little") + content[last + 2]
    if tables.kind == "affine":
        bits = 3 * 6 * 32
    row_bytes = int.from_bytes(content[128:130], "little")
    missed = 0
    for bit in range(bits):
        at = tables.sections.transitions + row_bytes * (bit % 20) + bit // 8
        changed = open_image(synthetic.resealed(content, at, bytes([content[at] ^ 1 << bit % 8])))
        native = library.look_up(changed, codes, use)
        assert not any(differences(native, twin(changed, codes, use)).values())
        missed += not any(differences(native, before).values())
    assert bits > 30
    assert missed <= bits // 20  # a value at its limit may not grow
