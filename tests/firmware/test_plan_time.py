"""The bound of a decision's time on the chip, against decisions that were counted there.

The tables, states and weights are chosen so that the searches prune nothing and the look-ups visit all, or
are found by a search for the most cycles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis import target as aim
from tests.cli.commands import frogkick
from tests.conftest import count, from_ci, some
from tests.firmware.test_search_time import ACTIONS, ROBOT
from tests.planner import synthetic

from frogkick.core.errors import InputError
from frogkick.core.files import write_bytes
from frogkick.front.building import build_firmware
from frogkick.front.plan_time import DEPTHS, PlanBound, Search, Shape, search_of, shape_of
from frogkick.paths import shape
from frogkick.planner.plan import (
    SEARCH_MOST_US,
    Cost,
    PlanConfig,
    config_of,
    on_robot,
    plan,
    transitions_in,
)
from frogkick.pool.chip import ChipError
from frogkick.runs.chip_check import ChipPlanner, states_for_timing
from frogkick.tables.image import Tables, open_image
from frogkick.tables.layout import TREE_LEVELS_MAX
from frogkick_codegen import firmware

CYCLES_PER_US = 64
KEPT: Mapping[Cost, PlanConfig] = {
    # Nothing is pruned: distance alone, from far beside the path; and nothing that costs on the way.
    Cost.PAPER: PlanConfig(angle_weight_per_rad=0.0, progress_weight=0.0, level_weight=0.0),
    Cost.ROUTE: replace(
        config_of(ROBOT.planner),
        cost=Cost.ROUTE,
        distance_weight_per_m=0.0,
        progress_weight_per_m=0.0,
        wall_weight_per_m=1e-3,
        transitions_max=0,
    ),
}
TABLES: Mapping[str, Any] = {
    "affine": lambda: synthetic.affine_image(300, len(ACTIONS), 1, action_rows=ACTIONS),
    "nearest": lambda: synthetic.pack(*synthetic.transitions(700, len(ACTIONS), 1), action_rows=ACTIONS),
    "alike": lambda: synthetic.alike(500, 7, action_rows=ACTIONS),
    "closer": lambda: synthetic.alike(600, 0, closer=True, action_rows=ACTIONS),
    "many actions": lambda: synthetic.image(60, 32),
}


@dataclass(frozen=True)
class Built:
    """An image, its planner on the virtual chip, and its bound."""

    tables: Tables
    planner: ChipPlanner
    bound: PlanBound

    def most_us(self, config: PlanConfig, depth: int) -> float:
        return self.bound.plan_us(shape_of(self.tables), depth, Cost(config.cost), config.transitions_max)

    def taken_us(self, config: PlanConfig, depth: int, states: Any, path: Any, **others: Any) -> Any:
        """Times of decisions; of each the search's counts are within what the bound takes them for."""
        self.planner.configure(path, config)
        profile = self.planner.chip.profile()
        before = {each.name: each.calls for each in profile.functions()}
        depths = np.full(len(states), depth, dtype=np.int32)
        rows, cycles = self.planner.plan(np.asarray(states, dtype=np.float32), depths, **others)
        calls = {each.name: each.calls - before.get(each.name, 0) for each in profile.functions()}
        search = search_of(len(self.tables.actions), depth, Cost(config.cost), config.transitions_max)
        assert list(rows["status"]) == [0] * len(states)
        assert rows["transitions"].max() <= search.transitions
        assert calls["fk_lookup"] <= len(states) * (search.opened + 1)
        assert calls["fk_lookup_motion"] <= len(states) * (search.transitions + 1)
        return cycles / CYCLES_PER_US


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Any:
    @cache
    def build(name: str) -> Built:
        folder = tmp_path_factory.mktemp("plan-time")
        image = TABLES[name]()
        write_bytes(folder / "t.fkt", image)
        made = firmware.build("bench", folder / "t.fkt", ROBOT, folder / "out").image
        planner = ChipPlanner(made)
        planner.wear((16384,))
        return Built(open_image(image), planner, PlanBound(made, folder / "out" / "emitted"))

    return build


@pytest.mark.parametrize("name", some(list(TABLES), 2))
@pytest.mark.parametrize("depth", some(list(DEPTHS), 2))
@pytest.mark.parametrize("cost", list(Cost))
def test_no_decision_that_was_counted_takes_longer(built: Any, name: str, depth: int, cost: Cost) -> None:
    """With the weights of the paper and with those that prune nothing; near the path and far from it."""
    one, number = built(name), count(3, 40, quick=1)
    path = shape("ellipse")
    timed = states_for_timing(one.tables, path, number, np.random.default_rng(depth))
    far = np.array([[0.2, 900.0, 0.0, 0.0, 0.0, 0.0]], dtype=np.float32)
    for config in (replace(PlanConfig(), cost=cost), KEPT[cost]):
        limited = on_robot(replace(config, transitions_max=900), one.tables)
        most_us = one.most_us(limited, depth)
        others = {"limb_use": timed.limb_use, "along_points": timed.along_points}
        near_us = one.taken_us(limited, depth, timed.states, path, **others).max()
        far_us = one.taken_us(limited, depth, far, path).max()
        assert max(near_us, far_us) < most_us


@pytest.mark.parametrize(("name", "cost", "least"), [("alike", Cost.PAPER, 0.6), ("closer", Cost.PAPER, 0.6)])
def test_the_bound_is_not_far_above_the_worst_that_was_found(
    built: Any, name: str, cost: Cost, least: float
) -> None:
    """A cost that prunes nothing, and look-ups that visit every state."""
    one = built(name)
    config = on_robot(replace(KEPT[cost], transitions_max=250), one.tables)
    state = np.array([[0.2, 900.0, 0.0, 0.1 if name == "closer" else 0.0, 0.0, 0.0]], dtype=np.float32)
    taken_us = one.taken_us(config, 3, state, shape("line")).max()
    assert least * one.most_us(config, 3) < taken_us < one.most_us(config, 3)


def test_a_search_for_the_longest_decision_stays_within_the_bound(built: Any) -> None:
    one = built("affine")
    scale = one.tables.velocity_scale.astype(float)

    def near(limit: float) -> st.SearchStrategy[float]:
        return st.floats(-limit, limit, width=32)

    @settings(max_examples=count(40, 1500, quick=8))
    @given(
        place=st.tuples(near(1.0), near(1.0), near(3.0)),
        velocity=st.tuples(*(near(float(np.float32(20_000 * one_scale))) for one_scale in scale)),
        cost=st.sampled_from(list(Cost)),
        depth=st.sampled_from((2, 3)),
        weights=st.tuples(st.floats(0.0, 500.0, width=32), st.floats(0.0, 50.0, width=32)),
        along=st.floats(0.0, 1.0, width=32),
    )
    def longest(
        place: tuple[float, ...],
        velocity: tuple[float, ...],
        cost: Cost,
        depth: int,
        weights: tuple[float, float],
        along: float,
    ) -> None:
        path = shape("sine")
        config = replace(
            KEPT[cost], distance_weight_per_m=weights[0], angle_weight_per_rad=weights[1], transitions_max=400
        )
        points = np.array([along * (len(path.x_m) - 1)], dtype=np.float32)
        taken_us = one.taken_us(config, depth, [(*place, *velocity)], path, along_points=points)[0]
        aim(float(taken_us / one.most_us(config, depth)), label=f"{cost.name} {depth}")
        assert taken_us < one.most_us(config, depth)

    longest()


@pytest.mark.parametrize("cost", list(Cost))
@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize("limit", some([0, 1, 8, 100, 629, 630, 900], 3))
def test_a_search_evaluates_as_many_transitions_as_are_counted(cost: Cost, depth: int, limit: int) -> None:
    """Where nothing is pruned as many, never more."""
    tables, path = open_image(synthetic.alike(64, 3, action_rows=ACTIONS)), shape("line")
    config = replace(KEPT[cost], depth=depth, transitions_max=limit)
    made = plan(tables, path, config, np.array([0.2, 900.0, 0.0, 0.3, 0.0, 0.0], np.float32))
    most = search_of(len(ACTIONS), depth, cost, limit).transitions
    assert made.transitions <= most
    if cost == Cost.PAPER:
        assert made.transitions == most


def test_the_counts_of_searches() -> None:
    assert search_of(9, 1, Cost.PAPER) == Search(9, 0)
    assert search_of(9, 3, Cost.PAPER) == Search(9 + 9 + 81 + 729, 9 + 81)
    assert search_of(9, 3, Cost.ROUTE) == Search(9 + 81 + 5 * 108, 9 + 5 * 12)
    assert search_of(9, 3, Cost.ROUTE, 629) == Search(9 + 81 + 4 * 108, 9 + 4 * 12)
    assert search_of(9, 4, Cost.PAPER, 100) == Search(100, 11 + 3)
    assert search_of(1, 4, Cost.ROUTE) == Search(8, 7)


@st.composite
def shapes(draw: st.DrawFn) -> tuple[Shape, int]:
    """Tables that the core takes, with their period."""
    levels = draw(st.integers(0, TREE_LEVELS_MAX))
    leaves = 1 << levels
    states = draw(
        st.one_of(
            st.integers(leaves, 65_535),
            st.integers(1, 65_536 // leaves).map(lambda rows: min(max(rows * leaves - 1, leaves), 65_535)),
        )
    )
    period_us = draw(st.sampled_from([50_000, 250_000, 1_425_000]))
    return Shape(draw(st.integers(1, 32)), states, levels), period_us


def test_every_table_that_the_core_takes_is_in_time(built: Any) -> None:
    """Whatever its states, their tree, its actions and its period, and whatever a command asks for."""
    bound = built("affine").bound

    @settings(max_examples=count(60, 1000, quick=12))
    @given(shapes())
    def in_time(drawn: tuple[Shape, int]) -> None:
        table, period_us = drawn
        if transitions_in(table.states, table.tree_levels, table.actions, period_us) >= table.actions:
            taken_us, _ = bound.turn_us(table, period_us)
            aim(taken_us)
            assert taken_us <= SEARCH_MOST_US

    in_time()


def test_a_table_with_decisions_that_may_be_too_long_is_refused(built: Any) -> None:
    """In one line, with what would fit."""
    one = built("nearest")
    taken_us = one.bound.require_in_time(one.tables)
    assert one.bound.require_in_time(one.tables, taken_us) == taken_us
    with pytest.raises(InputError) as caught:
        one.bound.require_in_time(one.tables, 0.9 * taken_us)
    text = str(caught.value)
    assert text.startswith(
        "a decision of depth 4 in this table of 700 states and 9 actions may take the chip "
    )
    assert "its watchdog allows" in text
    states = int(text.split("at most ")[1].split()[0])
    fitting = Shape(len(ACTIONS), states, 0 if states < 16 else int(np.log2(states // 8)))
    assert one.bound.turn_us(fitting, one.tables.period_us)[0] <= 0.9 * taken_us
    with pytest.raises(InputError, match=r"build one of fewer actions$"):
        one.bound.require_in_time(one.tables, 10.0)


def test_a_loop_that_nobody_has_bounded_is_an_error(built: Any, tmp_path: Path) -> None:
    one = built("nearest")
    source = tmp_path / "nearest.c"
    for file in one.bound.sources.glob("*.[ch]"):
        (tmp_path / file.name).write_text(file.read_text())
    source.write_text(source.read_text().replace("while (node < leaves) {", "while (node != leaves) {"))
    changed = PlanBound(one.bound.elf, tmp_path)
    with pytest.raises(ChipError, match=r"nearest.c:\d+: while \(node != leaves\) {"):
        changed.look_up_us(shape_of(one.tables))


def test_the_command_refuses_a_table_that_the_robot_would_refuse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bytes(tmp_path / "t.fkt", synthetic.alike(40_000, 12, action_rows=ACTIONS))
    done = frogkick(
        capsys, "firmware", "build", "--tables", tmp_path / "t.fkt", "--out", tmp_path / "out", "--json"
    )
    assert done.code == 2 and done.stderr.count("\n") == 1
    assert "the table has 40000 states" in done.stderr and "at most 32768 states" in done.stderr
    assert not (tmp_path / "out").exists()


@from_ci
def test_a_build_tells_the_sample_and_the_bound(tmp_path: Path) -> None:
    write_bytes(tmp_path / "t.fkt", TABLES["affine"]())
    built = build_firmware(tmp_path / "t.fkt", "bench", tmp_path / "out")
    times = built.as_json()["plan_time"]
    assert (times["depth"], times["transitions_max"], times["sampled_states"]) == (3, 746, 12)
    assert (
        0.0 < times["sampled_ms"] < times["bound_ms"] < times["any_bound_ms"] < times["any_limit_ms"] == 925.0
    )


def test_an_image_that_is_too_slow_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As an image would be whose planner is slower than fk_fit.h says."""
    write_bytes(tmp_path / "t.fkt", TABLES["nearest"]())
    monkeypatch.setattr(PlanBound.require_in_time, "__defaults__", (100_000.0,))
    with pytest.raises(
        InputError, match=r"its watchdog allows 100: build one of (at most \d+ states|fewer actions)$"
    ):
        build_firmware(tmp_path / "t.fkt", "bench", tmp_path / "out")
    assert not (tmp_path / "out").exists()
