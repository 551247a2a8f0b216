"""Sampling by the planner in the loop: the states that a planned run meets."""

from __future__ import annotations

import itertools

from frogkick.der import prepare
from frogkick.library import error_on, quantise, sample_library
from frogkick.library.planned import planned_swims
from frogkick.library.starts import Met
from frogkick.library.store import make_library
from frogkick.library.transitions import RESTED, simulate_task
from frogkick.planner.image import open_image
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
STATES = 96


def test_planned_states_are_drawn_again_whoever_simulates() -> None:
    one = list(itertools.islice(planned_swims(ROBOT, 3), 2))
    assert [len(swims) for swims in one] == [8, 8]
    assert one == list(itertools.islice(planned_swims(ROBOT, 3, workers=2), 2))
    assert one[0] != next(planned_swims(ROBOT, 4))
    assert len({tuple(swim) for swims in one for swim in swims}) > 8


def test_a_table_of_planned_states_errs_less_where_a_planned_run_goes() -> None:
    """On the states of other planned swims: less than half of what a table from the whole box errs."""
    met, rods = Met(ROBOT), prepare(ROBOT)
    met.add(next(planned_swims(ROBOT, 77)), STATES)
    starts = met.starts()
    unseen = make_library(ROBOT, "planned", 77, starts, [simulate_task(rods, task) for task in starts.tasks])
    velocity = unseen.initial_velocity_body
    assert velocity[:, 0].max() > 0.02  # forward, m/s
    assert velocity[:, 2].min() < -0.05 < 0.05 < velocity[:, 2].max()  # turn rate, rad/s
    assert (unseen.previous_actions[:, 0] != RESTED).sum() > STATES // 2

    def error_m(sampling: str) -> float:
        tables = open_image(quantise(sample_library(ROBOT, STATES, 0, sampling)))
        return error_on(tables, unseen)["position_m"]

    assert error_m("planned") < 0.5 * error_m("box")
