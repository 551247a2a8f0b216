"""Which robots are their own mirror image, and what mirroring does to limbs and actions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.der.single import simulate_action

from frogkick.der import prepare
from frogkick.robot import Robot, load_robot, mirror_of

ROBOT = load_robot("frog2022")


@pytest.mark.parametrize("name", ["frog2022", "streamlined", "hexapod"])
def test_a_mirrored_action_from_a_mirrored_start_gives_the_mirrored_motion(name: str) -> None:
    robot = load_robot(name)
    mirror, rods = mirror_of(robot), prepare(robot)
    assert mirror is not None
    assert [mirror.limbs[i] for i in mirror.limbs] == list(range(len(robot.limbs)))
    assert [mirror.actions[a] for a in mirror.actions] == list(range(len(robot.actions)))
    for action in range(0, len(robot.actions), 2):
        one, other = robot.actions[action], robot.actions[mirror.actions[action]]
        there = np.array(simulate_action(robot, (0.02, 0.015, 0.2), one, 0.5, rods=rods))
        here = np.array(simulate_action(robot, (0.02, -0.015, -0.2), other, 0.5, rods=rods))
        assert here * [1, -1, -1, 1, -1, -1] == pytest.approx(there, abs=1e-6)


def test_names_say_the_same() -> None:
    mirror = mirror_of(ROBOT)
    assert mirror is not None
    names = [limb.name for limb in ROBOT.limbs]
    swapped = [name.replace("right", "?").replace("left", "right").replace("?", "left") for name in names]
    assert [names[i] for i in mirror.limbs] == swapped
    assert "".join(ROBOT.actions[a].name for a in mirror.actions) == "ABDCFEHGI"


def lame(robot: Robot, **changes: object) -> Robot:
    return replace(robot, limbs=(replace(robot.limbs[0], **changes), *robot.limbs[1:]))


@pytest.mark.parametrize(
    "robot",
    [
        lame(ROBOT, modulus_active_pa=7e6),
        lame(ROBOT, length_m=0.036),
        lame(ROBOT, direction_rad=ROBOT.limbs[0].direction_rad + 0.01),
        lame(ROBOT, rest_curvature_per_m=1.01 * ROBOT.limbs[0].rest_curvature_per_m),
        lame(ROBOT, segments=10),
        lame(ROBOT, clamp={"next": "previous", "previous": "next"}[ROBOT.limbs[0].clamp]),
        replace(ROBOT, limbs=ROBOT.limbs[:3]),
        replace(ROBOT, actions=ROBOT.actions[:3]),
        replace(ROBOT, frame=replace(ROBOT.frame, segments=(23, 22, 23, 23))),
        replace(ROBOT, frame=replace(ROBOT.frame, corners_m=((0.05, -0.045), *ROBOT.frame.corners_m[1:]))),
        replace(ROBOT, library_box=replace(ROBOT.library_box, left_mps=(-0.02, 0.03))),
    ],
)
def test_what_differs_left_and_right_has_no_mirror_image(robot: Robot) -> None:
    assert mirror_of(robot) is None
