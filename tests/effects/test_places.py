"""Effects of the mass's distribution and of the pool's walls, compared with the motion of a rigid body."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from tests.der.single import Swimmer

from frogkick.core.errors import InputError
from frogkick.der import prepare
from frogkick.effects import Acting, Body, Effect, Fix, World, changed_robot, make_effect, make_effects
from frogkick.effects.body import gyration_m
from frogkick.effects.water import REACH_M
from frogkick.pool.pool import Camera, Pool
from frogkick.robot import Robot, load_robot

ROBOT = load_robot("frog2022")
RNG = np.random.default_rng(5)
HALF_M = 0.045  # of the frame's width


def effect(name: str, **values: object) -> Effect:
    return make_effect({"name": name, **values}, Path())


def inertias(robot: Robot) -> tuple[float, np.ndarray, float]:
    """Mass (kg), centre of mass from the corners' mean (m), moment of inertia about that mean (kg m^2)."""
    mesh = prepare(robot).mesh
    corners = [i * 23 for i in range(4)]
    about = mesh.rest_m - mesh.rest_m[corners].mean(axis=0)
    return (
        float(mesh.mass_kg.sum()),
        mesh.mass_kg @ about / mesh.mass_kg.sum(),
        float(mesh.mass_kg @ (about**2).sum(axis=1)),
    )


def test_gyration_of_a_square_and_of_any_frame() -> None:
    assert gyration_m(ROBOT.frame) == pytest.approx(2.0 * HALF_M / math.sqrt(3.0), rel=1e-12)
    frame = load_robot("hexapod").frame
    sides = len(frame.corners_m)
    points = np.concatenate(
        [np.linspace(frame.corners_m[i], frame.corners_m[(i + 1) % sides], 4001)[:-1] for i in range(sides)]
    )
    lengths = np.hypot(*(np.roll(frame.corners_m, -1, axis=0) - frame.corners_m).T)
    weights = np.repeat(lengths, 4000)
    about = points - np.mean(frame.corners_m, axis=0)
    squares = np.average((about**2).sum(axis=1), weights=weights)
    assert gyration_m(frame) == pytest.approx(math.sqrt(squares), rel=1e-4)


@pytest.mark.parametrize(("ahead", "left"), [(0.004, 0.0), (-0.003, 0.009), (0.0, -0.015)])
def test_the_centre_of_mass_moves_as_told_and_nothing_else(ahead: float, left: float) -> None:
    plain = inertias(ROBOT)
    moved = inertias(changed_robot(ROBOT, [effect("off_centre_mass", forward_m=ahead, left_m=left)]))
    assert moved[0] == pytest.approx(plain[0], rel=1e-9)
    assert moved[1] - plain[1] == pytest.approx((ahead, left), abs=1e-6)
    assert moved[2] == pytest.approx(plain[2], rel=2e-3)  # the outline's corners are nodes, not edges


def test_effects_of_inertia_go_together_in_any_order() -> None:
    off, full = effect("off_centre_mass", left_m=0.006), effect("centre_mass", share=0.4)
    one, other = (inertias(changed_robot(ROBOT, pair)) for pair in ([off, full], [full, off]))
    assert one[1] == pytest.approx(other[1], abs=1e-9)
    assert one[2] == pytest.approx(other[2], rel=1e-9)
    centred = inertias(changed_robot(ROBOT, [full]))
    assert one[1] - centred[1] == pytest.approx((0.0, 0.006), abs=1e-6)
    assert one[2] == pytest.approx(centred[2], rel=2e-3)


def test_a_centre_of_mass_to_the_left_turns_a_robot_that_pushes_straight() -> None:
    """Before drag matters, a push that moves the centre by x turns it by m x d / I, to the heavy side."""
    turns = {}
    for left_m in (0.0, 0.006, -0.006):
        robot = changed_robot(ROBOT, [effect("off_centre_mass", left_m=left_m)])
        swimmer = Swimmer(robot, rods=prepare(robot))
        for limb in range(4):
            swimmer.fire(limb, 0.0)
        swimmer.advance(0.1)
        turns[left_m] = float(swimmer.pose_world()[2])
        rigid = float(swimmer.pose_world()[0]) * left_m * swimmer.mass_kg / swimmer.inertia_kg_m2
        assert turns[left_m] == pytest.approx(rigid, rel=0.05, abs=1e-9)
    assert turns[0.006] == pytest.approx(-turns[-0.006], abs=1e-6)


def test_the_tag_stays_on_the_frame() -> None:
    """A robot that spins about its centre of mass carries its tag round on a circle of the offset."""
    made = effect("off_centre_mass", forward_m=0.01)
    for heading in (0.0, 1.0, -2.5):
        fix = made.fix(Fix(0.0, 0.08, 0.2, -0.1, heading), RNG)
        assert fix is not None and fix.heading_rad == heading
        assert (fix.x_m, fix.y_m) == pytest.approx(
            (0.2 - 0.01 * math.cos(heading), -0.1 - 0.01 * math.sin(heading))
        )


def test_heavier_limbs_push_another_way_than_a_heavier_frame() -> None:
    limbs = changed_robot(ROBOT, [effect("mass_scale", limbs=3.0)])
    light = changed_robot(ROBOT, [effect("mass_scale", limbs=0.5)])
    assert limbs.frame == ROBOT.frame
    for robot, factor in ((limbs, 3.0), (light, 0.5)):
        for was, now in zip(ROBOT.limbs, robot.limbs, strict=True):
            whole = [
                limb.mass_per_length_kg_per_m + limb.added_mass_per_length_kg_per_m for limb in (was, now)
            ]
            assert whole[1] == pytest.approx(factor * whole[0])
            assert now.mass_per_length_kg_per_m <= was.mass_per_length_kg_per_m
    grown = inertias(limbs)[0] - inertias(ROBOT)[0]
    assert grown == pytest.approx(2.0 * 4 * 0.0355 * 0.0312, rel=1e-6)


def wall(**values: object) -> Effect:
    made = effect("wall", **values)
    made.check(ROBOT)
    return made


def body(x: float, y: float, heading: float, velocity: tuple[float, float, float]) -> Body:
    return Body(0.0, (x, y, heading), velocity)


def test_a_wall_is_felt_near_it_and_only_there() -> None:
    bank = wall(side="x_high", at_m=1.0, drag_ns_per_m=0.8)
    far = 1.0 - HALF_M - REACH_M
    assert bank.wrench(0.0, body(far - 0.05, 0.0, 0.0, (0.04, 0.0, 0.0))) == (0.0, 0.0, 0.0)
    # Both front corners are half of the reach away, the rear ones beyond it: half of half of the drag.
    near = bank.wrench(0.0, body(far + 0.5 * REACH_M, 0.0, 0.0, (0.04, 0.01, 0.0)))
    assert near[:2] == pytest.approx((-0.2 * 0.04, -0.2 * 0.01))
    # At the wall, heading along it: the two corners at the wall are held, and turn the robot towards it.
    along = bank.wrench(0.0, body(1.0 - HALF_M, 0.0, math.pi / 2.0, (0.04, 0.0, 0.0)))
    assert along[0] == pytest.approx(-0.4 * 0.04) and along[1] == pytest.approx(0.0, abs=1e-12)
    assert along[2] == pytest.approx(-0.4 * 0.04 * HALF_M)  # clockwise, to its right, where the wall is


@pytest.mark.parametrize("side", ["x_low", "x_high", "y_low", "y_high"])
def test_a_wall_pushes_back_from_its_own_side(side: str) -> None:
    out = {"x_low": (-1, 0), "x_high": (1, 0), "y_low": (0, -1), "y_high": (0, 1)}[side]
    heading = math.atan2(out[1], out[0])
    made = wall(side=side, at_m=0.5, hardness=0.75)
    in_front = made.wrench(0.0, body(0.4 * out[0], 0.4 * out[1], heading, (0.0, 0.0, 0.0)))
    assert in_front == (0.0, 0.0, 0.0)
    pressed = 0.5 - HALF_M + 0.002
    pushed = made.wrench(0.0, body(pressed * out[0], pressed * out[1], heading, (0.0, 0.0, 0.0)))
    assert pushed == pytest.approx((-2 * 24.0 * 0.002, 0.0, 0.0), abs=1e-12)
    away = made.wrench(0.0, body(pressed * out[0], pressed * out[1], heading, (-0.5, 0.0, 0.0)))
    assert away == pytest.approx((0.0, 0.0, 0.0), abs=1e-12), "a wall never pulls"


def test_a_wall_stops_a_robot_that_swims_at_it() -> None:
    ends = {}
    for hardness in (0.0, 0.75):
        made = effect("wall", at_m=0.12, hardness=hardness)
        robot = changed_robot(ROBOT, [made])
        swimmer, acting = Swimmer(robot), Acting([made], robot, [np.random.default_rng(1)])
        for period in range(4):
            for limb in range(4):
                acting.fire(swimmer.batch, 0, limb, 1.4 * period + (0.0 if limb < 2 else 0.08))
            swimmer.advance(1.4 * (period + 1), acting)
        ends[hardness] = swimmer.pose_world()
    assert ends[0.0][0] > 0.13
    assert 0.04 < ends[0.75][0] < 0.12 - HALF_M + 0.01
    assert abs(ends[0.75][2]) < 1e-3


def test_a_wall_s_side_is_named() -> None:
    with pytest.raises(InputError, match=r"side is 'x_hihg', did you mean 'x_high'|side is 'x_hihg'"):
        effect("wall", side="x_hihg")
    (start,) = wall(side="y_low").starts(np.array([-0.1, -0.4]), np.array([0.5, 0.2]))
    assert start == {"at_m": pytest.approx(0.4 + HALF_M)}


def test_the_simulated_pool_has_walls_and_robots_out_of_balance() -> None:
    tables = [
        {"name": "wall", "side": "y_high", "at_m": 0.05, "drag_ns_per_m": 1.0, "hardness": 0.6},
        {"name": "off_centre_mass", "left_m": 0.005},
    ]
    shown = []
    for effects in ([], tables):
        pool = Pool(
            ROBOT, (0, 0, 0), Camera(), np.random.default_rng(3), World(make_effects(effects, Path()))
        )
        for limb in range(4):
            pool.actuate(limb, 0.0)
        shown.append(pool.advance(1.4)[-1].pose_world)
    assert shown[1][2] < shown[0][2] - 0.01 or shown[1][2] > shown[0][2] + 0.01
    assert shown[1][0] < shown[0][0] - 0.002


def test_searches_begin_where_runs_went() -> None:
    low, high = np.array([-0.3, 0.0]), np.array([0.3, 0.6])
    starts = effect("vortex").starts(low, high)
    assert len(starts) == 9
    assert {(round(each["x_m"], 6), round(each["y_m"], 6)) for each in starts} == {
        (x, y) for x in (-0.2, 0.0, 0.2) for y in (0.1, 0.3, 0.5)
    }
    assert effect("group_loss").starts(low, high) == ({"fade_s": 0.15},)
    assert not effect("drag_scale").starts(low, high)
