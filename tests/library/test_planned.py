"""Sampling by the planner in the loop: the states that a planned run meets."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from tests.conftest import count, from_ci
from tests.identification.made import robot

from frogkick.der import prepare
from frogkick.library import Library, error_on, quantise, sample_library, sampling
from frogkick.library.sampling import VisitedStates, planned_swims, rigid_starts
from frogkick.library.store import library_of
from frogkick.library.transitions import RESTED, simulate_task
from frogkick.tables.image import open_image

ROBOT = robot()
STATES = count(64, 128, 48)
FIRST_STATES = count(32, 64, 16)


@pytest.fixture(autouse=True)
def first_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of how many states the table is that swims are planned with."""
    monkeypatch.setattr(sampling, "_FIRST_TABLE_STATES", FIRST_STATES)


@from_ci
def test_planned_states_are_drawn_again_whoever_simulates() -> None:
    few = robot()
    one = list(itertools.islice(planned_swims(few, 3), 2))
    assert [len(swims) for swims in one] == [8, 8]
    assert one == list(itertools.islice(planned_swims(few, 3, workers=2), 2))
    assert one[0] != next(planned_swims(few, 4))
    assert len({tuple(swim) for swims in one for swim in swims}) > 8


@from_ci
def test_a_table_of_planned_states_errs_less_where_a_planned_run_goes() -> None:
    """On the velocities of other planned swims: less than half of what a table from the whole box errs.

    With limbs at rest, since a nearest table knows no history: only where the states lie is compared.
    """
    visited, rods = VisitedStates(ROBOT), prepare(ROBOT)
    visited.add(next(planned_swims(ROBOT, 77)), STATES)
    starts = visited.starts()
    done = [simulate_task(rods, task) for task in starts.tasks]
    met_there = library_of(ROBOT, "planned", 77, starts.unfolded(done))
    velocity = met_there.initial_velocity_body
    assert velocity[:, 0].max() > 0.02  # forward, m/s
    assert velocity[:, 2].min() < -0.05 < 0.05 < velocity[:, 2].max()  # turn rate, rad/s
    assert (met_there.previous_actions[:, 0] != RESTED).sum() > STATES // 2

    def at_rest(velocity: np.ndarray) -> Library:
        starts = rigid_starts(ROBOT, velocity)
        done = [simulate_task(rods, task) for task in starts.tasks]
        return library_of(ROBOT, "box", 0, starts.unfolded(done))

    unseen = at_rest(velocity)

    def error(sampling: str) -> dict[str, float]:
        states = sample_library(ROBOT, STATES, 0, sampling).initial_velocity_body
        return error_on(open_image(quantise(at_rest(states))), unseen)

    ours, box = error("planned"), error("box")
    assert ours["position_m"] < 0.5 * box["position_m"]
    assert ours["heading_rad"] < 0.5 * box["heading_rad"]
