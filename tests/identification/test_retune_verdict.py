"""What of the runs a retune learns from, where tables are tried, and when the new one is better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made import make_run, make_swim

from frogkick.core.poses import PredictionError
from frogkick.front.retune_tables import (
    RESTED,
    TableMaker,
    Tracked,
    TrackedRun,
    earlier_actions,
    longest_stroke_m,
    paths_of,
    swims_of,
)
from frogkick.front.retune_verdict import is_better, worse_in_loop
from frogkick.front.retuning import split
from frogkick.identification.segments import Segments
from frogkick.paths import ellipse, line, shape


@pytest.fixture(scope="module")
def swims() -> list[Segments]:
    return [make_swim([], seed, periods) for seed, periods in ((1, 14), (2, 14), (3, 10))]


def test_better_is_both_no_worse_and_one_by_more_than_chance() -> None:
    old = PredictionError(1e-3, 1e-2, 9)
    for better in ((0.97e-3, 1e-2, 9), (1e-3, 0.9e-2, 9)):
        assert is_better(old, PredictionError(*better))
    worse = ((0.99e-3, 0.99e-2, 9), (0.5e-3, 1.01e-2, 9), (1.01e-3, 0.5e-2, 9), (0.5e-3, 0.5e-2, 4))
    for other in ((1e-3, 1e-2, 9), *worse, (np.nan, np.nan, 9)):
        assert not is_better(old, PredictionError(*other))
    # Of a table that predicts positions ten times better, 0.01 degrees more of heading are the camera's.
    old, new = (PredictionError(mm * 1e-3, np.radians(deg), 11) for mm, deg in ((4.05, 0.22), (0.36, 0.23)))
    floor = PredictionError(0.29e-3, np.radians(0.21), 11)
    assert is_better(old, new, floor) and not is_better(old, new, PredictionError())
    assert not is_better(old, replace(new, heading_rmse_rad=np.radians(0.28)), floor)


def tracked_of(*runs: tuple[float, bool]) -> Tracked:
    return Tracked.of([TrackedRun("line", k, 1e-3 * mm, 0.02, ended) for k, (mm, ended) in enumerate(runs)])


def test_a_table_is_worse_in_closed_loop_by_more_than_chance() -> None:
    before = tracked_of((2.0, True), (8.0, True), (3.0, True), (5.0, True))
    assert worse_in_loop(before, before) == ""
    for fine in (
        ((2.0, True), (9.0, True), (2.0, True), (5.5, True)),  # by chance
        ((2.1, True), (8.1, True), (3.1, True), (5.1, True)),  # by little
        ((0.2, True), (30.0, True), (0.3, True), (0.5, True)),  # one is worse, the others are far better
    ):
        assert worse_in_loop(before, tracked_of(*fine)) == ""
    much = tracked_of((3.0, True), (12.0, True), (4.5, True), (7.0, True))
    assert worse_in_loop(before, much) == "6.6 mm from the paths, 4.5 mm with the old one"
    near = tracked_of((0.1, True), (0.1, True), (0.1, True), (0.1, True))
    assert worse_in_loop(near, tracked_of(*[(0.14, True)] * 4)) == "", "far below a millimetre"
    stuck = tracked_of((0.1, False), (0.1, True), (0.1, True), (0.1, True))
    assert worse_in_loop(before, stuck) == "3 of 4 runs completed, 4 with the old one"
    assert worse_in_loop(stuck, before) == ""


def test_the_swims_and_paths_of_runs(swims: list[Segments]) -> None:
    swim = replace(swims[2], action=np.arange(10) % 5)
    late_s = 2.0 * swim.period_s * (np.arange(10) >= 6)
    paused = replace(swim, start_s=swim.start_s + late_s, end_s=swim.end_s + late_s)
    unknown = replace(swim, action=np.where(np.arange(10) == 3, -1, swim.action))
    assert swims_of([swim, paused, unknown]) == [
        [0, 1, 2, 3, 4, 0, 1, 2, 3, 4], [0, 1, 2, 3, 4, 0], [1, 2, 3, 4], [0, 1, 2], [4, 0, 1, 2, 3, 4],
    ]  # fmt: skip
    runs = [replace(make_run([], 1, 2), path=path) for path in (line(), None, ellipse(), line(0.45))]
    assert [path.name for path in paths_of(runs)] == ["line", "ellipse"]
    few = TableMaker(800, 0, 1, paths=paths_of(runs))
    assert [path.name for path in few.loop_paths()] == ["line", "ellipse", "sine"]
    tiny = TableMaker(800, 0, 1, stroke_m=0.0043)
    assert [path.length_m for path in tiny.loop_paths()] == pytest.approx(
        [0.1 * shape(name).length_m for name in ("line", "sine", "ellipse")], rel=1e-3
    )
    assert 0.02 < longest_stroke_m(swims) < 0.06 and np.isnan(longest_stroke_m([]))


def test_earlier_actions_are_forgotten_beyond_a_gap(swims: list[Segments]) -> None:
    swim = replace(swims[2], action=np.arange(10) % 5)
    previous = earlier_actions(swim)
    assert (previous[0] == RESTED).all()
    assert previous[4].tolist() == [3, 2, 1, 0, RESTED, RESTED, RESTED, RESTED]
    assert previous[9].tolist() == [3, 2, 1, 0, 4, 3, 2, 1]
    paused = replace(swim, start_s=swim.start_s + 2.0 * swim.period_s * (np.arange(10) >= 6))
    assert earlier_actions(paused)[7].tolist() == [1, *[RESTED] * 7]
    unknown = replace(swim, action=np.where(np.arange(10) == 3, -1, swim.action))
    assert earlier_actions(unknown)[5].tolist() == [4, *[RESTED] * 7]


def test_of_a_single_run_the_last_third_is_held_out(swims: list[Segments]) -> None:
    swim = swims[0]
    (learned,), (kept,), said = split([swim])
    assert len(learned.start_s) == len(learned.action) == len(learned.end_s) == 9
    assert "periods 10 to 14 of the only run 'made1'" in said
    cut_s = swim.end_s[8]
    assert learned.arrival_s.max() <= cut_s < learned.arrival_s.max() + 0.3
    assert max(time_s for time_s, _ in learned.strokes) < cut_s
    assert np.isnan(kept.measured[:9]).all() and np.array_equal(kept.measured[9:], swim.measured[9:])
    assert np.array_equal(kept.pose, swim.pose) and kept.strokes == swim.strokes
