"""Python and C plan alike, bit for bit; and the comparison finds it when they do not."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.conftest import count, from_ci, some
from tests.planner import synthetic

from frogkick.core.errors import FrogkickError, InputError
from frogkick.planner.plan import Cost, PlanConfig
from frogkick.tables.image import Tables, open_image
from frogkick_codegen.native import NativeLibrary, planner_files
from frogkick_codegen.parity import (
    KINDS,
    Cases,
    PairReport,
    compare,
    find_ties,
    make_cases,
    native_place,
    python_place,
)

TABLES = open_image(synthetic.image())
PATH = synthetic.wave_path()
SEED = 2022


@pytest.fixture(scope="module")
def library() -> NativeLibrary:
    return NativeLibrary()


def report(
    library: NativeLibrary,
    states: int,
    tables: Tables = TABLES,
    config: PlanConfig | None = None,
    path: synthetic.WavePath = PATH,
    seed: int = SEED,
) -> PairReport:
    """Compare the twin with a build of the C."""
    settings = config or PlanConfig()
    cases = make_cases(tables, path, states, seed)
    places = {
        "python": python_place(tables, path, settings),
        "native": native_place(library, tables, path, settings),
    }
    (pair,) = compare(cases, places)
    return pair


def test_python_and_c_agree_on_every_kind_of_state(library: NativeLibrary) -> None:
    pair = report(library, count(100_000, 1_000_000, 10_000))
    assert pair.mismatches == 0, pair.first_failure
    assert (pair.first, pair.second, pair.first_failure) == ("python", "native", "")
    assert not any(pair.fields.values())


@pytest.mark.parametrize(
    "config",
    [
        PlanConfig(0.0, 0.0, 0.0, 0.0),
        PlanConfig(1e6, 1e6, 1e6, 1e6),
        PlanConfig(1e-40, 0.0, 300.0, 0.1),
        PlanConfig(0.0, 1.0, 0.0, 2.5),
    ],
)
def test_python_and_c_agree_with_any_weights(library: NativeLibrary, config: PlanConfig) -> None:
    pair = report(library, count(8000, 80_000, 2000), config=config)
    assert pair.mismatches == 0, pair.first_failure


@pytest.mark.parametrize(
    ("states", "actions", "points"),
    [(1, 1, 2), (1, 32, 3), (2, 2, 100), (3, 9, 100), (1000, 9, 57), (8503, 9, 100)],
)
def test_python_and_c_agree_on_any_size(
    library: NativeLibrary, states: int, actions: int, points: int
) -> None:
    tables = open_image(synthetic.image(states, actions, states))
    cases = make_cases(
        tables, synthetic.wave_path(points), count(2000, 20_000, 500), SEED, (0.7, 0.295, 0.005, 0.0)
    )
    route, config = synthetic.wave_path(points), PlanConfig()
    places = {
        "python": python_place(tables, route, config),
        "native": native_place(library, tables, route, config),
    }
    (pair,) = compare(cases, places)
    assert pair.mismatches == 0, pair.first_failure


def test_python_and_c_agree_where_ties_abound(library: NativeLibrary) -> None:
    pair = report(library, count(20_000, 200_000, 4000), tables=synthetic.grid_tables())
    assert pair.mismatches == 0, pair.first_failure


def test_every_kind_of_state_is_there_and_is_what_it_says() -> None:
    cases = make_cases(TABLES, PATH, 15_000, SEED)
    rows = python_place(TABLES, PATH, PlanConfig())(
        cases.states, cases.depths, cases.limb_use, cases.along_points
    )
    by_kind = {name: cases.kinds == index for index, name in enumerate(KINDS)}
    assert set(np.unique(cases.depths)) == {1, 2, 3, 4}
    assert len(KINDS) == 17
    assert set(np.unique(cases.part(0, 17).kinds)) == set(range(17))
    status = {name: set(rows["status"][mask].tolist()) for name, mask in by_kind.items()}
    assert status["not_finite"] == {-2}
    assert status["limit"] == status["limb_use"] == {0, -3}
    assert status["along"] == {0, -2, -3}
    assert status["any_bits"] == {0, -2}
    assert all(
        found == {0}
        for name, found in status.items()
        if name not in ("not_finite", "limit", "any_bits", "limb_use", "along")
    )
    assert not cases.states[by_kind["rest"], 3:].any()
    small = np.abs(cases.states[by_kind["subnormal"]])
    assert 0 < small.max() < np.finfo(np.float32).tiny
    assert np.signbit(cases.states[by_kind["subnormal"]][small == 0]).any()
    assert np.abs(cases.states[by_kind["huge"], 3:]).max() > 1e38
    per_velocity = np.float32(1) / TABLES.velocity_scale
    parts = np.modf(cases.states[by_kind["half_code"], 3:] * per_velocity)[0]
    assert (np.abs(parts) == 0.5).mean() > 0.3
    nearest = TABLES.states.astype(np.int64)
    ties = 0
    for state in cases.states[by_kind["tie"]][:200]:
        codes = np.round(state[3:].astype(float) / TABLES.velocity_scale).astype(np.int64)
        distance2 = ((nearest - codes) ** 2).sum(axis=1)
        ties += int((distance2 == distance2.min()).sum() >= 2)
    assert ties == 200


def test_ties_are_real_and_a_table_of_one_row_has_none() -> None:
    rng = np.random.default_rng(5)
    ties = find_ties(TABLES, rng)
    assert len(ties) == 64
    assert find_ties(open_image(synthetic.image(1, 1)), rng).shape == (0, 3)


def test_the_same_seed_makes_the_same_states() -> None:
    one, two = (make_cases(TABLES, PATH, 500, 9) for _ in range(2))
    assert one.states.tobytes() == two.states.tobytes()
    assert one.depths.tobytes() == two.depths.tobytes()
    assert make_cases(TABLES, PATH, 500, 10).states.tobytes() != one.states.tobytes()


MUTATIONS = {
    "a tie takes the highest row": ("nearest.c", "(row < best_row)", "(row > best_row)"),
    "a side at the best distance is cut": (
        "nearest.c",
        "box_distance2 > best_distance2",
        "box_distance2 >= best_distance2",
    ),
    "a half is rounded down": ("nearest.c", "rest >= 0.5f", "rest > 0.5f"),
    "a half below zero is rounded up": ("nearest.c", "rest <= -0.5f", "rest < -0.5f"),
    "codes are truncated": ("nearest.c", "whole += 1;", "whole += 0;"),
    "a path tie takes the highest point": ("path.c", "distance2 < best_m2", "distance2 <= best_m2"),
    "an equal branch replaces the first": (
        "tree.c",
        "(first_action >= search->best_action)",
        "(first_action < search->best_action)",
    ),
    "the cost is summed in another order": (
        "cost.c",
        "(distance_cost + angle_cost) + progress_cost",
        "distance_cost + (angle_cost + progress_cost)",
    ),
    "the rotation is summed in another order": (
        "fk_search.h",
        "from->x_m + (from->cosine * motion->forward_m - from->sine * motion->left_m)",
        "(from->x_m + from->cosine * motion->forward_m) - from->sine * motion->left_m",
    ),
    "a coefficient is one unit off": ("fk_trig.h", "0.0416666456f", "0.0416666493f"),
    "levels weigh one more": ("tree.c", "(float)(levels - 1U - index)", "(float)(levels - index)"),
    "the beam is narrower": ("fk_internal.h", "#define FK_BEAM 12U", "#define FK_BEAM 11U"),
    "the beam ends a level earlier": ("fk_internal.h", "FK_BEAM_BEYOND 4U", "FK_BEAM_BEYOND 3U"),
    "an equal branch of a higher action is kept": (
        "search_beam.c",
        "(first_action < beam->branches[worst].first_action)",
        "(first_action > beam->branches[worst].first_action)",
    ),
    "a branch counts without how it ends": (
        "search_beam.c",
        "fk_beam_place(beam, value, first_action)",
        "fk_beam_place(beam, cost, first_action)",
    ),
    "a level that just fits is not begun": (
        "search_beam.c",
        "parents * actions > limit",
        "parents * actions >= limit",
    ),
    "the angle is not wrapped": ("cost.c", "fk_wrap_angle(heading_rad", "(heading_rad"),
    "infinity is let through": ("math.c", ">= FK_FLOAT_INFINITY ?", "> FK_FLOAT_INFINITY ?"),
    "the limit itself is refused": (
        "plan.c",
        "(fk_bits_of_float(state->x_m) & FK_FLOAT_MAGNITUDE) > position_limit",
        "(fk_bits_of_float(state->x_m) & FK_FLOAT_MAGNITUDE) >= position_limit",
    ),
}


TELLING = (
    (6000, lambda: TABLES, PlanConfig()),
    (6000, synthetic.grid_tables, PlanConfig()),
    (600, lambda: TABLES, PlanConfig(0.0, 0.0, 0.0, 0.0)),
    (600, lambda: TABLES, PlanConfig(300.0, 20.0, 0.0, 0.0, 400.0, 0.06, 0.02, cost=Cost.ROUTE)),
    (600, lambda: TABLES, PlanConfig(0.0, 0.0, 0.0, 0.0, cost=Cost.ROUTE, transitions_max=9 + 81 + 5 * 108)),
)
"""What tells a changed rule: states, table, configuration."""


@cache
def planned(number: int) -> tuple[Cases, Tables, PlanConfig, Any]:
    """Of one of these the cases and what the twin plans, for all mutants."""
    states, tables_of, config = TELLING[number]
    tables = tables_of()
    cases = make_cases(tables, PATH, states, SEED)
    given = (cases.states, cases.depths, cases.limb_use, cases.along_points)
    return cases, tables, config, python_place(tables, PATH, config)(*given)


def report_on(mutant: NativeLibrary, number: int) -> PairReport:
    cases, tables, config, rows = planned(number)
    places = {"python": lambda *_: rows, "native": native_place(mutant, tables, PATH, config)}
    (pair,) = compare(cases, places)
    return pair


@pytest.mark.parametrize("name", some(MUTATIONS, 5))
def test_a_changed_rule_in_the_c_is_found(name: str) -> None:
    file, before, after = MUTATIONS[name]
    files = dict(planner_files())
    source = files[file].decode()
    assert source.count(before) == 1, "the rule moved: correct the mutation"
    files[file] = source.replace(before, after).encode()
    mutant = NativeLibrary(files, flags=("-std=c99", "-O1", "-ffp-contract=off", "-fno-math-errno"))
    found = next(
        (pair for number in range(len(TELLING)) if (pair := report_on(mutant, number)).mismatches), None
    )
    assert found is not None, "no case tells it from the twin"
    assert f"seed {SEED}, case " in found.first_failure
    assert "state [" in found.first_failure


@from_ci
def test_a_changed_byte_of_the_table_is_found(library: NativeLibrary) -> None:
    row_bytes = (TABLES.sections.length - TABLES.sections.transitions) // 300
    entry = TABLES.sections.transitions + row_bytes * 150 + row_bytes // 2
    changed = open_image(synthetic.resealed(TABLES.image, entry, bytes([TABLES.image[entry] ^ 0x40])))
    config = PlanConfig()
    cases = make_cases(TABLES, PATH, 15_000, SEED)
    places = {
        "python": python_place(TABLES, PATH, config),
        "native": native_place(library, changed, PATH, config),
    }
    (pair,) = compare(cases, places)
    assert pair.mismatches > 0
    assert pair.fields["status"] == 0
    assert pair.fields["nearest_state"] == 0
    assert pair.fields["cost"] + pair.fields["predicted"] > 0


def test_three_places_are_compared_in_pairs(library: NativeLibrary) -> None:
    config = PlanConfig()
    python, native = python_place(TABLES, PATH, config), native_place(library, TABLES, PATH, config)

    def off_by_a_bit(*given: np.ndarray) -> np.ndarray:
        rows = native(*given)
        rows["cost"][7] = np.nextafter(rows["cost"][7], np.float32(np.inf))
        return rows

    cases = make_cases(TABLES, PATH, 30, 1, (1.0, 0.0, 0.0, 0.0))
    pairs = compare(cases, {"python": python, "native": native, "chip": off_by_a_bit})
    assert [(pair.first, pair.second, pair.mismatches) for pair in pairs] == [
        ("python", "native", 0),
        ("python", "chip", 1),
        ("native", "chip", 1),
    ]
    assert pairs[1].fields["cost"] == 1
    assert pairs[1].first_failure.startswith(f"seed 1, case 7 of 30 ({KINDS[7]}), depth 1, state [")


def test_unusable_comparisons_are_refused() -> None:
    place = python_place(TABLES, PATH, PlanConfig())
    cases = make_cases(TABLES, PATH, 15, 1)
    with pytest.raises(FrogkickError, match="1 place given"):
        compare(cases, {"python": place})
    with pytest.raises(FrogkickError, match="'short' returned"):
        compare(cases, {"python": place, "short": lambda *given: place(*given)[:3]})
    with pytest.raises(InputError, match="0 states"):
        make_cases(TABLES, PATH, 0, 1)
