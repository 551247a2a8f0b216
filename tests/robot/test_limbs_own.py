"""A limb with strokes and an alloy of its own: read from its file, checked, and at work in the rods."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from frogkick.core.errors import InputError
from frogkick.effects.swims import Gait, simulate_actions, simulate_gaits
from frogkick.robot import Robot, load_robot, mirror_of, parse_robot, robot_warnings
from frogkick.robot.load import BUILT_IN
from frogkick.robot.template import new_robot_text
from frogkick.robot.toml_text import to_toml

ROBOT = load_robot("frog2022")
STROKES = str(BUILT_IN / "frog2022.profiles.toml")


def with_own(own: Mapping[str, Mapping[str, Any]]) -> Robot:
    """The square robot with keys of its own for limbs."""
    table = tomllib.loads(ROBOT.toml)
    for limb in table["limb"]:
        limb |= own.get(limb["name"], {})
    return parse_robot(to_toml(table), "mine", BUILT_IN)


def last_pose(robot: Robot, *actions: str) -> np.ndarray:
    return simulate_actions(robot, actions).pose_world[-1]


def test_a_limb_s_strokes_are_those_of_its_file_and_alloy(tmp_path: Path) -> None:
    robot = with_own({"rear_left": {"egain_percent": 20.0}, "rear_right": {"profiles_file": STROKES}})
    first, second, third, fourth = robot.strokes()
    assert first is second and third is not first
    assert third.drop_per_m == ROBOT.actuation(20.0).drop_per_m != first.drop_per_m
    assert fourth.drop_per_m == first.drop_per_m and robot.limbs[3].profiles == ROBOT.profiles
    assert parse_robot(robot.toml, "again", BUILT_IN) == robot, "its text is whole"
    (tmp_path / "new.toml").write_text(new_robot_text(robot, "new"))
    again = load_robot(tmp_path / "new.toml")
    assert again.limbs == robot.limbs and again.strokes()[2].drop_per_m == third.drop_per_m


def test_strokes_that_are_the_robot_s_give_the_bits_of_none() -> None:
    same = with_own({limb.name: {"egain_percent": 10.0, "profiles_file": STROKES} for limb in ROBOT.limbs})
    for one, other in ((ROBOT, same), (ROBOT, with_own({"front_left": {"egain_percent": 10.0}}))):
        swims = [simulate_actions(robot, ["B", "E"]) for robot in (one, other)]
        assert np.array_equal(swims[0].pose_world, swims[1].pose_world)


def test_a_limb_of_another_alloy_pushes_otherwise_and_its_mirror_image_turns_the_other_way() -> None:
    x_m, _, heading_rad = last_pose(ROBOT, "B")
    left, right = (
        last_pose(with_own({f"rear_{side}": {"egain_percent": 30.0}}), "B") for side in ("left", "right")
    )
    assert abs(heading_rad) < 1e-6 and abs(left[2]) > 1e-3
    assert left == pytest.approx(right * [1.0, -1.0, -1.0], abs=1e-7)
    both = with_own({f"rear_{side}": {"egain_percent": 30.0} for side in ("left", "right")})
    swum = last_pose(both, "B")
    assert abs(swum[1]) < 1e-7 and abs(swum[2]) < 1e-6 and abs(swum[0] - x_m) > 1e-4
    assert mirror_of(both) is not None and mirror_of(with_own({"rear_left": {"egain_percent": 30.0}})) is None


def test_a_gait_of_another_alloy_leaves_a_limb_its_own() -> None:
    own = with_own({"rear_left": {"egain_percent": 10.0}, "rear_right": {"egain_percent": 10.0}})
    swims = [simulate_gaits(robot, [Gait(20.0, 0.7, 0.5)], 2)[0] for robot in (ROBOT, own)]
    assert not np.array_equal(swims[0].pose_world, swims[1].pose_world)


def test_a_limb_s_alloy_gives_it_its_mass() -> None:
    limb = replace(ROBOT.limbs[0], egain_mass_ratio=2.0)
    heavy = replace(limb, egain_percent=50.0)
    assert heavy.with_egain(0.0).mass_per_length_kg_per_m == limb.with_egain(50.0).mass_per_length_kg_per_m


def test_what_is_wrong_with_a_limb_s_own_strokes_is_said_in_one_line(tmp_path: Path) -> None:
    for own, says in (
        ({"egain_percent": 90.0}, "no limb profile at 90 % EGaIn and 0.7 Hz"),
        ({"egain_percent": 101.0}, "limb.2.egain_percent is '101.0': input should be less than"),
        ({"profiles_file": "none.toml"}, "profiles file '.*none.toml' does not exist"),
        ({"profiles_file": 3}, "profiles_file needs a file name"),
        (
            {"profile": [tomllib.loads(ROBOT.toml)["profile"][0]] * 2},
            "two profiles of limb 'rear_left' are called",
        ),
        ({"profile": [{"egain": 3}]}, "unknown key 'limb.2.profile.0.egain'"),
        ({"profile": [tomllib.loads(ROBOT.toml)["profile"][0]]}, "limb 'rear_left': no limb profile at 10 %"),
    ):
        with pytest.raises(InputError, match=says) as error:
            with_own({"rear_left": own})
        assert "\n" not in str(error.value), own


def test_a_limb_s_own_stroke_is_in_the_warnings() -> None:
    weak = with_own({"rear_left": {"egain_percent": 30.0}})
    assert len({stroke.drop_per_m for stroke in weak.strokes()}) == 2
    bent = with_own({"rear_left": {"rest_curvature_per_m": 40.0}})
    assert any(text.startswith("limb rear_left: a stroke takes") for text in robot_warnings(bent))
