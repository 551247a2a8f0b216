"""A limb with strokes, an alloy and a taper of its own: read from its file, checked, at work in the rods."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from frogkick.core.errors import InputError
from frogkick.der.mesh import build_mesh
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


TAPER = {"tip_width_ratio": 0.4, "tip_stiffness_ratio": 0.3}


def test_a_limb_that_is_as_wide_and_stiff_at_its_tip_has_the_bits_of_none() -> None:
    even = with_own({limb.name: dict.fromkeys(TAPER, 1.0) for limb in ROBOT.limbs})
    assert even.toml == ROBOT.toml
    for one, other in zip(build_mesh(ROBOT)[0], build_mesh(even)[0], strict=True):
        assert np.array_equal(one, other)


def test_taper_takes_mass_drag_and_stiffness_from_the_tip_by_hand() -> None:
    limb, narrow = ROBOT.limbs[0], with_own({"front_right": TAPER})
    (before, _), (after, _) = build_mesh(ROBOT), build_mesh(narrow)
    first = before.frame_nodes
    edges, shares = slice(first, first + limb.segments), (np.arange(limb.segments) + 0.5) / limb.segments
    width = 1.0 - 0.6 * shares
    for name in ("edge_drag_normal", "edge_drag_tangential", "edge_stiffness_n"):
        assert getattr(after, name)[edges] == pytest.approx(getattr(before, name)[edges] * width)
    piece_m = limb.length_m / limb.segments
    less_kg = piece_m * (
        limb.mass_per_length_kg_per_m * (1.0 - width).sum()
        + limb.added_mass_per_length_kg_per_m * (1.0 - width**2).sum()
    )
    assert before.mass_kg.sum() - after.mass_kg.sum() == pytest.approx(less_kg, rel=1e-6)
    dry_kg = 0.3 * limb.length_m * limb.mass_per_length_kg_per_m
    assert ROBOT.mass_kg - narrow.mass_kg == pytest.approx(dry_kg, rel=1e-6)
    bends = np.flatnonzero(before.bend_column == 0)
    softer = 1.0 - 0.7 * np.arange(1, limb.segments) / limb.segments
    assert after.bend_stiffness_n_m2[bends] == pytest.approx(before.bend_stiffness_n_m2[bends] * softer)
    rest = np.setdiff1d(np.arange(len(before.bend_stiffness_n_m2)), bends)
    assert np.array_equal(after.bend_stiffness_n_m2[rest], before.bend_stiffness_n_m2[rest])


def test_tapered_pairs_swim_straight_and_one_tapered_limb_turns() -> None:
    every = last_pose(with_own({limb.name: TAPER for limb in ROBOT.limbs}), "B")
    assert every[0] > 1e-3 and abs(every[1]) < 1e-7 and abs(every[2]) < 1e-6
    left, right = (last_pose(with_own({f"front_{side}": TAPER}), "B") for side in ("left", "right"))
    assert abs(left[2]) > 1e-3 and left == pytest.approx(right * [1.0, -1.0, -1.0], abs=1e-7)


def test_a_limb_s_alloy_gives_it_its_mass() -> None:
    limb = replace(ROBOT.limbs[0], egain_mass_ratio=2.0)
    heavy = replace(limb, egain_percent=50.0)
    assert heavy.with_egain(0.0).mass_per_length_kg_per_m == limb.with_egain(50.0).mass_per_length_kg_per_m


def test_what_is_wrong_with_a_limb_s_own_strokes_is_said_in_one_line(tmp_path: Path) -> None:
    for own, says in (
        ({"egain_percent": 90.0}, "no limb profile at 90 % EGaIn and 0.7 Hz"),
        ({"egain_percent": 101.0}, "limb.2.egain_percent is '101.0': input should be less than"),
        ({"profiles_file": "none.toml"}, "profiles file '.*none.toml' does not exist"),
        ({"tip_width_ratio": 0.0}, "limb.2.tip_width_ratio is '0.0': input should be greater than 0"),
        ({"tip_stiffness_ratio": 11.0}, "limb.2.tip_stiffness_ratio is '11.0': input should be less than"),
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
