"""Sampling by the planner in the loop: the states that a planned run meets."""

from __future__ import annotations

import numpy as np

from frogkick.der import prepare
from frogkick.library import quantise, sample_velocities
from frogkick.library.error import looked_up
from frogkick.library.planned import planned_swims
from frogkick.library.store import make_library
from frogkick.library.transitions import simulate_states
from frogkick.planner.image import open_image
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
STATES = 96


def test_planned_states_are_drawn_again_and_each_is_its_own() -> None:
    drawn = sample_velocities(ROBOT, STATES, 3, "planned")
    assert drawn.shape == (STATES, 3)
    assert np.array_equal(drawn, sample_velocities(ROBOT, STATES, 3, "planned"))
    assert not np.array_equal(drawn, sample_velocities(ROBOT, STATES, 4, "planned"))
    assert len({tuple(row) for row in drawn.tolist()}) == STATES


def test_the_planned_robot_swims_and_turns_both_ways() -> None:
    first = sample_velocities(ROBOT, 64, 0, "visited")
    met = next(planned_swims(ROBOT, 5, first))
    assert met[:, 0].max() > 0.02  # forward, m/s
    assert met[:, 2].min() < -0.05 < 0.05 < met[:, 2].max()  # turn rate, rad/s


def test_a_table_of_planned_states_errs_less_where_a_planned_run_goes() -> None:
    """On the states of other planned swims: less than half of what a table from the whole box errs."""
    rods = prepare(ROBOT)
    unseen = next(planned_swims(ROBOT, 77, sample_velocities(ROBOT, 64, 78, "visited")))[::4]
    truth = simulate_states(rods, unseen, 0.0).rows

    def error_m(sampling: str) -> float:
        drawn = sample_velocities(ROBOT, STATES, 0, sampling)
        rows = simulate_states(rods, drawn, 0.0).rows
        tables = open_image(quantise(make_library(ROBOT, sampling, 0, drawn, rows, ())))
        gap = looked_up(tables, unseen) - truth
        return float(np.sqrt((gap[..., :2] ** 2).sum(axis=-1).mean()))

    assert error_m("planned") < 0.5 * error_m("box")
