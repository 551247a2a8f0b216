"""States of a library: uniform in the box, or met by swimming; in pairs of mirror images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.conftest import count, from_ci
from tests.identification.made import robot

from frogkick.core.errors import InputError
from frogkick.effects import rods_of
from frogkick.library import Library, error_on, fit_table, sample_library, sample_starts, sampling
from frogkick.library.sampling import RUNS, VisitedStates, box_velocities
from frogkick.library.store import library_of
from frogkick.library.transitions import HISTORY, RESTED, simulate_task
from frogkick.robot import Robot, load_robot, mirror_of
from frogkick.tables.image import open_image

ROBOT = load_robot("frog2022")
MIRROR = mirror_of(ROBOT)
LEFT = np.array([1.0, -1.0, -1.0])
VISITED = count(100, 100, 64)


def test_velocities_fill_the_box_and_repeat() -> None:
    v = box_velocities(ROBOT, 4000, 1)
    box = ROBOT.library_box
    low, high = np.array([box.forward_mps, box.left_mps, box.omega_rad_s]).T
    assert np.all(v >= low)
    assert np.all(v <= high)
    assert np.all(np.abs(v.mean(axis=0) - 0.5 * (low + high)) < 0.03 * (high - low))
    assert np.array_equal(v, box_velocities(ROBOT, 4000, 1))
    assert not np.array_equal(v, box_velocities(ROBOT, 4000, 2))


def test_states_of_the_box_come_in_mirror_pairs() -> None:
    v = box_velocities(ROBOT, 41, 3)
    assert v.shape == (41, 3)
    assert len(np.unique(v, axis=0)) == 41
    rows = {tuple(row) for row in v.tolist()}
    single = [row for row in rows if tuple((np.array(row) * LEFT + 0.0).tolist()) not in rows]
    assert len(single) == 1  # an odd number leaves one


@pytest.fixture(scope="module")
def visited() -> Library:
    return sample_library(ROBOT, VISITED, 0, "visited")


@from_ci
def test_visited_states_are_those_of_a_swimming_robot(visited: Library) -> None:
    v = visited.initial_velocity_body
    assert v[0].tolist() == [0.0, 0.0, 0.0]
    forward, left, omega = v.T
    assert 0.01 < np.median(forward) < 0.06
    assert np.abs(forward).max() < 0.1
    assert np.abs(left).max() < 0.1
    assert np.abs(omega).max() < 1.5
    assert abs(left.sum()) < 0.05 * np.abs(left).sum()


@from_ci
def test_visited_states_know_what_was_done_before_them(visited: Library) -> None:
    """From rest through the earlier actions, one after another, to the state's velocity."""
    before = visited.previous_actions
    assert before.shape == (VISITED, HISTORY)
    assert (before[0] == RESTED).all()
    assert len(np.unique(before[before[:, -1] == RESTED], axis=0)) == (before[:, -1] == RESTED).sum()
    place = {tuple(row): state for state, row in enumerate(before.tolist())}
    followed = 0
    for state, row in enumerate(before.tolist()):
        earlier = place.get((*row[1:], RESTED))
        if row[0] != RESTED and row[-1] == RESTED and earlier is not None:
            came = visited.velocity_body_end[earlier, row[0]]
            # Nearly always within rounding. It begins at another time there, and where a residual is at its
            # limit, rounding decides on one correction more: 2e-10 m/s. A table's code is 1e-5 m/s.
            assert visited.initial_velocity_body[state] == pytest.approx(came, abs=1e-9)
            followed += 1
    assert followed > 20


def test_visited_states_come_in_mirror_pairs(visited: Library) -> None:
    assert MIRROR is not None
    place = {tuple(row): state for state, row in enumerate(visited.previous_actions.tolist())}
    paired = 0
    for state, row in enumerate(visited.previous_actions.tolist()):
        if row[-1] != RESTED:
            continue  # what was done still earlier may differ
        other = place.get(tuple(a if a == RESTED else MIRROR.actions[a] for a in row))
        assert other is not None or state == VISITED - 1
        if other is not None and other != state:  # one that is its own image is simulated as it is
            images = visited.rows()[other, list(MIRROR.actions)]
            assert np.array_equal(images, visited.rows()[state] * np.tile(LEFT, 2))
            paired += 1
    assert paired > 20


def test_fewer_visited_states_are_the_first_of_more(visited: Library) -> None:
    few = sample_library(ROBOT, 10, 0, "visited")
    assert np.array_equal(few.initial_velocity_body, visited.initial_velocity_body[:10])
    assert np.array_equal(few.rows(), visited.rows()[:10])
    other = sample_library(ROBOT, 10, 4, "visited")
    assert not np.array_equal(few.initial_velocity_body, other.initial_velocity_body)


def test_resting_before_the_first_stroke_is_no_history() -> None:
    """No state but the first one is at rest."""
    drawn = sample_starts(ROBOT, 400, 0, "visited")
    resting = ROBOT.actions.index(ROBOT.action("I"))
    firsts = set()
    for state in range(len(drawn)):
        task = drawn.tasks[drawn.part[state]]
        swim, stroke = np.argwhere(task.wanted)[drawn.row[state]]
        firsts.add(tuple(task.actions[swim, :stroke].tolist()))
    assert () in firsts
    assert not any(set(actions) == {resting} for actions in firsts - {()})


def test_a_robot_without_a_mirror_image_is_sampled_without_pairs() -> None:
    worn = replace(ROBOT.limbs[0], modulus_active_pa=0.8 * ROBOT.limbs[0].modulus_active_pa)
    lame = replace(ROBOT, limbs=(worn, *ROBOT.limbs[1:]))
    v = box_velocities(lame, 40, 3)
    assert len(np.unique(np.abs(v), axis=0)) == 40
    assert not sample_starts(lame, 30, 0, "visited").mirrored.any()


def test_an_unknown_sampling_is_refused() -> None:
    with pytest.raises(InputError, match="visited"):
        sample_starts(ROBOT, 10, 3, "visitd")


def worn() -> Robot:
    """A robot without a mirror image that turns less to one side."""
    return replace(robot(), effects=({"name": "limb_wear", "limb": "front_left", "gain": 0.65},))


def test_states_of_runs_come_first_then_planned_and_held_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "_FIRST_TABLE_STATES", 16)
    runs = [[6] * 12, [1, 4] * 6]
    starts = sample_starts(worn(), 40, 0, RUNS, swims=runs)
    assert len(starts) == 40
    done = [
        tuple(task.actions[swim, :stroke].tolist())
        for task in starts.tasks
        for swim, stroke in np.argwhere(task.wanted)
    ]
    assert len(set(done)) == 40, "each of them once"
    of_runs = {tuple(run[:stroke]) for run in runs for stroke in range(len(run))}
    assert 15 <= len(of_runs & set(done)) <= 24, "up to half of the states, from all parts of the runs"
    assert any(len(each) > 8 and set(each) == {6} for each in done)
    assert len(sample_starts(worn(), 40, 0, RUNS)) == 40, "a robot that has not swum"


@from_ci
def test_a_table_has_the_turn_that_a_run_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """A planner that makes up for a worn limb holds one action for dozens of strokes, unlike random ones."""
    held = [[6] * 24]
    visited = VisitedStates(worn())
    visited.add(held, 24)
    starts, rods = visited.starts(), rods_of(worn())
    there = library_of(
        worn(), "runs", 0, starts.unfolded([simulate_task(rods, task) for task in starts.tasks])
    )
    errors = []
    for kind in ("visited", RUNS):
        drawn = sample_starts(worn(), 64, 0, kind, swims=held)
        made = drawn.unfolded([simulate_task(rods, task) for task in drawn.tasks])
        image = fit_table(library_of(worn(), kind, 0, made), "affine").image
        errors.append(error_on(open_image(image), there)["position_m"])
    assert errors[1] < 0.3 * errors[0] and errors[1] < 1e-4, errors


def test_a_robot_with_one_action_is_told_that_it_has_few_states() -> None:
    one = replace(ROBOT, actions=ROBOT.actions[:1])
    with pytest.raises(InputError, match="visit 12 different states, wanted are 50: give fewer --states"):
        sample_starts(one, 50, 0, "visited")
