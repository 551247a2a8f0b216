"""Moving water and external forces against textbook results, on the robot's own mesh."""

from __future__ import annotations

import numpy as np
import pytest
from tests.conftest import count
from tests.der.single import Swimmer

from frogkick.der import STILL, Batch, Water, prepare
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
RODS = prepare(ROBOT)


def swim(water: Water, velocity: tuple[float, float, float], seconds: float) -> Swimmer:
    swimmer = Swimmer(ROBOT, velocity_body=velocity, rods=RODS)
    swimmer.set_water(water)
    for limb in (1, 2):
        swimmer.fire(limb, 0.05 * limb)
    swimmer.advance(seconds)
    return swimmer


def test_a_steady_current_carries_a_swim_along_and_changes_nothing_else() -> None:
    """Galilei: from drifting with the water, the swim is that in still water plus u t."""
    still = swim(STILL, (0.0, 0.0, 0.0), 1.425)
    drifting = swim(Water(flow_mps=(0.03, -0.01)), (0.03, -0.01, 0.0), 1.425)
    moved = drifting.pose_world() - still.pose_world()
    assert moved == pytest.approx([0.03 * 1.425, -0.01 * 1.425, 0.0], abs=2e-7)


def test_a_robot_at_rest_is_taken_along() -> None:
    swimmer = Swimmer(ROBOT, rods=RODS)
    swimmer.set_water(Water(flow_mps=(0.02, 0.0)))
    speeds = []
    for until in np.arange(1.0, 41.0, 10.0):
        swimmer.advance(float(until))
        speeds.append(swimmer.velocity_body()[0])
    assert 0.0 < speeds[0] < speeds[1] < speeds[2] < speeds[3] < 0.02


def test_water_that_turns_turns_the_robot_likewise() -> None:
    """Rigid rotation of the water about the body: it turns the same way and does not drift."""
    turn = 0.2
    swimmer = Swimmer(ROBOT, rods=RODS)
    swimmer.set_water(Water(gradient_per_s=((0.0, -turn), (turn, 0.0))))
    swimmer.advance(20.0)
    x, y, heading = swimmer.pose_world()
    assert 0.5 < heading < 20.0 * turn
    assert np.hypot(x, y) < 0.01
    assert 0.0 < swimmer.velocity_body()[2] < turn


def test_a_push_accelerates_the_centre_and_a_turn_the_heading() -> None:
    """From rest, before drag matters: v = a t, omega = alpha t for the whole body as rigid."""
    swimmer = Swimmer(ROBOT, rods=RODS)
    swimmer.set_water(Water(push_mps2=(0.002, -0.001), turn_rad_s2=0.02))
    swimmer.advance(0.5)
    assert swimmer.velocity_body() == pytest.approx([0.001, -0.0005, 0.01], rel=0.02)


def test_a_lane_in_still_water_does_not_notice_that_its_neighbour_s_moves() -> None:
    rest, width = np.zeros((2, 3)), count(8, 2)  # 2 is compiled for this test alone
    ends = []
    for neighbour in (STILL, Water(flow_mps=(0.05, 0.02), turn_rad_s2=0.1)):
        batch = Batch([RODS] * 2, rest, rest, 0.0, 0.001, width)
        batch.set_water(1, neighbour)
        for lane in range(2):
            batch.fire(lane, 0, 0.0)
        batch.advance(0.6)
        ends.append(batch.motion_world())
    assert np.array_equal(ends[0][0], ends[1][0])
    assert not np.allclose(ends[0][1], ends[1][1])


def test_a_weak_stroke_pushes_less_and_one_of_no_gain_not_at_all() -> None:
    forward = []
    for gain in (0.0, 0.5, 1.0):
        swimmer = Swimmer(ROBOT, rods=RODS)
        for limb in range(4):
            swimmer.fire(limb, 0.0, gain=gain)
        swimmer.advance(1.4)
        forward.append(swimmer.pose_world()[0])
    assert abs(forward[0]) < 1e-6
    assert 0.001 < forward[1] < forward[2]
