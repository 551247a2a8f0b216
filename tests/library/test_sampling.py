"""Initial velocities: in pairs of mirror images, the visited ones where swims lead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frogkick.errors import InputError
from frogkick.library import sample_velocities
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
LEFT = np.array([1.0, -1.0, -1.0])


@pytest.mark.parametrize("sampling", ["box", "visited"])
def test_states_come_in_mirror_pairs(sampling: str) -> None:
    v = sample_velocities(ROBOT, 41, 3, sampling)
    assert v.shape == (41, 3)
    assert len(np.unique(v, axis=0)) == 41
    rows = {tuple(row) for row in v.tolist()}
    single = [row for row in rows if tuple((np.array(row) * LEFT + 0.0).tolist()) not in rows]
    assert len(single) <= 1  # an odd number leaves one


@pytest.mark.parametrize("sampling", ["box", "visited"])
def test_fewer_states_are_the_first_of_more(sampling: str) -> None:
    few, many = (sample_velocities(ROBOT, n, 3, sampling) for n in (10, 60))
    if sampling == "visited":
        assert np.array_equal(few, many[:10])
    again = sample_velocities(ROBOT, 60, 3, sampling)
    assert np.array_equal(many, again)
    assert not np.array_equal(many, sample_velocities(ROBOT, 60, 4, sampling))


def test_visited_states_are_those_of_a_swimming_robot() -> None:
    v = sample_velocities(ROBOT, 300, 0, "visited")
    assert v[0].tolist() == [0.0, 0.0, 0.0]
    forward, left, omega = v.T
    assert 0.015 < np.median(forward) < 0.06
    assert np.abs(forward).max() < 0.1
    assert np.abs(left).max() < 0.1
    assert np.abs(omega).max() < 1.5
    assert abs(left.sum()) < 0.05 * np.abs(left).sum()


def test_a_robot_without_a_mirror_image_is_sampled_without_pairs() -> None:
    worn = replace(ROBOT.limbs[0], modulus_active_pa=0.8 * ROBOT.limbs[0].modulus_active_pa)
    lame = replace(ROBOT, limbs=(worn, *ROBOT.limbs[1:]))
    v = sample_velocities(lame, 40, 3)
    assert len(np.unique(np.abs(v), axis=0)) == 40


def test_an_unknown_sampling_is_refused() -> None:
    with pytest.raises(InputError, match="visited"):
        sample_velocities(ROBOT, 10, 3, "visitd")
