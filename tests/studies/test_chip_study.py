"""Times of decisions on the virtual chip: what is timed, that it repeats, and that the limits hold."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from tests.codegen import made_up
from tests.conftest import count, from_ci
from tests.planner import synthetic
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.core.files import write_bytes
from frogkick.paths import SHAPES, shape
from frogkick.planner.plan import config_of
from frogkick.pool.chip.cost import CostModel
from frogkick.robot import load_robot
from frogkick.runs.chip_check import CYCLES_PER_MS, ChipPlanner, states_for_timing
from frogkick.tables.image import open_image
from frogkick_codegen import firmware
from frogkick_studies.chip import (
    LIMIT_MS,
    NODE,
    RUN,
    DepthSpeed,
    chip_speed,
    cycles_of,
    fit_cycles,
    most_expensive,
    open_ms,
)

PATHS = {name: shape(name) for name in SHAPES}
ROBOT = load_robot("frog2022")
CONFIG = config_of(ROBOT.planner)


class Built:
    """A bench image around a table."""

    def __init__(self, folder: Path, image: bytes) -> None:
        self.file = folder / "t.fkt"
        write_bytes(self.file, image)
        self.elf = firmware.build("bench", self.file, ROBOT, folder / "out").image

    def speed(self, counts: dict[int, int], workers: int = 1) -> dict[int, DepthSpeed]:
        return chip_speed(self.elf, self.file, PATHS, CONFIG, counts, seed=3, workers=workers)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Built:
    return Built(tmp_path_factory.mktemp("small"), synthetic.image())


@pytest.fixture(scope="module", params=made_up.KINDS)
def large(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Built:
    """As many states as the paper's table, or as an affine one has in 64 KiB."""
    affine = request.param == "affine"
    image = made_up.affine_image(100, size_of_motion=0.3) if affine else made_up.paper_size_image()
    return Built(tmp_path_factory.mktemp(request.param), image)


def test_states_are_from_the_box_and_beyond_it() -> None:
    tables = open_image(synthetic.image())
    timed = states_for_timing(tables, PATHS["sine"], 4000, np.random.default_rng(1))
    scale = tables.velocity_scale.astype(float)
    low, high = tables.states.min(axis=0) * scale, tables.states.max(axis=0) * scale
    velocity = timed.states[:, 3:]
    within = ((velocity >= low - 1e-6) & (velocity <= high + 1e-6)).all(axis=1)
    assert 0.25 <= within.mean() < 0.4
    assert (np.abs(velocity) > 100 * np.abs(high)).any(axis=0).all()
    x, y = PATHS["sine"].x_m, PATHS["sine"].y_m
    distance = np.hypot(timed.states[:, :1] - x, timed.states[:, 1:2] - y).min(axis=1)
    assert np.quantile(distance[within], 0.9) < 0.25
    assert distance.max() > 2.0
    assert timed.limb_use[:, :4].max() > 30_000
    assert not timed.limb_use[:, 4:].any()
    assert 0.0 <= timed.along_points.min() <= timed.along_points.max() <= len(x) - 1


@from_ci
def test_a_summary_is_of_the_states_that_were_timed(small: Built) -> None:
    counts = {1: count(30, 30, 12), 2: count(9, 9, 3)}
    speeds = small.speed(counts)
    assert set(speeds) == {1, 2}
    for depth, speed in speeds.items():
        assert speed.states == counts[depth]
        assert 0.0 < speed.mean_ms <= speed.worst_ms
        assert sum(share.percent for share in speed.shares) == pytest.approx(100.0)
        shares = {share.function: share for share in speed.shares}
        assert shares["fk_plan"].calls == 1.0
        assert shares[NODE].calls == speed.nodes
        # The worst state is one that can be timed again, to the cycle.
        planner = ChipPlanner(small.elf)
        planner.configure(PATHS[speed.worst_path], CONFIG)
        state = np.array([speed.worst_state], dtype=np.float32)
        along = np.array([speed.worst_along_points], dtype=np.float32)
        use = np.array([speed.worst_limb_use], dtype=np.uint16)
        _, cycles = planner.plan(state, np.array([depth], dtype=np.int32), use, along)
        assert cycles[0] / CYCLES_PER_MS == pytest.approx(speed.worst_ms, rel=0.01)
        # By the least that the manuals allow it takes less: that is the model's band.
        assert 0.6 * speed.worst_ms < speed.least_ms < 0.95 * speed.worst_ms
    assert speeds[2].nodes > 3 * speeds[1].nodes


@from_ci
def test_of_many_states_the_dearest_are_run(small: Built, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sixth of them is run, and holds what running them all finds worst; the rest is within the bound."""
    every = small.speed({1: 1800})[1]
    assert (every.run, every.model_error, every.unrun_ms) == (1800, 0.0, 0.0)
    monkeypatch.setitem(RUN, 1, 300)
    some = small.speed({1: 1800})[1]
    assert some.states == 1800
    assert 200 <= some.run <= 300  # the most_expensive of all and those of a reach are partly the same
    assert some.worst_ms == pytest.approx(every.worst_ms, rel=0.002)
    assert (some.worst_path, some.worst_state) == (every.worst_path, every.worst_state)
    assert some.worst_ms_by_reach == pytest.approx(every.worst_ms_by_reach, rel=0.002)
    assert 0.0 < some.model_error < 0.02
    assert every.mean_ms < some.unrun_ms < some.worst_ms * 1.02
    assert some.mean_ms == pytest.approx(every.mean_ms, rel=0.02)


@from_ci
def test_the_model_knows_what_a_block_takes(small: Built) -> None:
    """Fitted to some states, it tells others' cycles; a state asked for twice costs twice nothing else."""
    tables, path = open_image(small.file.read_bytes()), PATHS["ellipse"]
    planner = ChipPlanner(small.elf)
    planner.configure(path, CONFIG)
    depth = 2
    timed = states_for_timing(tables, path, 300, np.random.default_rng(4))
    _, cycles = planner.plan(timed.states, np.full(300, depth), timed.limb_use, timed.along_points)
    costs = fit_cycles(tables.image, CONFIG, [(path, timed.part(0, 200), cycles[:200])], depth)
    settings = dataclasses.replace(CONFIG, depth=depth)
    reported = cycles_of(costs, tables.image, path, settings, timed.part(200, 100))
    np.testing.assert_allclose(reported, cycles[200:], rtol=0.03)  # as the study says of its bound
    spread = cycles[200:].std() / cycles[200:].mean()
    assert (reported / cycles[200:] - 1.0).std() < spread / 5


def test_the_dearest_are_of_every_reach() -> None:
    predicted = np.arange(100.0)
    beyond = np.repeat(np.array([30.0, 3.0, 1.0, 1000.0], dtype=np.float32), 25)
    places = most_expensive(predicted, beyond, 16)
    assert {99, 98, 24, 23, 49, 48, 74, 73} <= set(places.tolist())
    assert len(places) <= 16
    assert set(range(92, 100)) <= set(places.tolist())


def test_processes_change_nothing(small: Built) -> None:
    one, two = small.speed({1: 12}), small.speed({1: 12}, workers=2)
    assert one[1].mean_ms == pytest.approx(two[1].mean_ms, rel=0.01)
    assert one[1].nodes == two[1].nodes


def test_slower_memory_makes_slower_decisions(small: Built) -> None:
    """Each part of the model is in the time: without it, the same decisions take less."""
    state, depth = np.zeros((1, 6), dtype=np.float32), np.array([2], dtype=np.int32)

    def cycles(cost: CostModel) -> int:
        planner = ChipPlanner(small.elf, cost)
        planner.configure(PATHS["line"], CONFIG)
        return int(planner.plan(state, depth)[1][0])

    whole = cycles(CostModel())
    for part in ("branch_refill_cycles", "cache_miss_cycles", "flash_data_wait_cycles"):
        assert cycles(dataclasses.replace(CostModel(), **{part: 0})) < whole


@from_ci
def test_decisions_are_within_their_limits(large: Built) -> None:
    """Worst of all states, paths and places; the most_expensive of 10^5 at each depth in make test-full."""
    counts = {1: count(90, 100_000, 36), 2: count(45, 100_000, 24), 3: count(18, 100_000, 12)}
    speeds = large.speed(counts, workers=count(1, 2))
    for depth, limit_ms in LIMIT_MS.items():
        speed = speeds[depth]
        assert speed.states >= counts[depth]
        assert set(speed.worst_ms_by_reach) == {1.0, 3.0, 30.0, 1000.0}
        for reach, worst_ms in speed.worst_ms_by_reach.items():
            assert worst_ms <= limit_ms, (reach, speed)
        assert speed.unrun_ms <= limit_ms, speed
    assert open_ms(large.elf) < 200.0


@from_ci
def test_the_command_tells_it_and_fails_over_a_limit(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["study", "chip", "--tables", str(rig.small_table()), "--states", "12", "--json"]
    assert run_command(arguments) == 0
    output = json.loads(capsys.readouterr().out)
    assert set(output["plan_ms"]) == {"1", "2", "3", "4"}
    assert output["limit_ms"] == {"1": 0.45, "2": 4.5, "3": 20.0}
    assert output["cycle_model"] == dataclasses.asdict(CostModel())
    monkeypatch.setitem(LIMIT_MS, 1, 0.001)
    assert run_command(arguments) == 1
