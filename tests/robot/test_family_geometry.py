"""Wrong geometry is refused in one line; doubtful geometry is told."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from frogkick.core.errors import InputError
from frogkick.der import prepare
from frogkick.robot import built_in_robots, limb_points, load_robot, parse_robot, robot_warnings
from frogkick.robot.toml_text import to_toml

ROBOT = load_robot("frog2022")


def changed(change: Callable[[dict[str, Any]], None], name: str = "frog2022") -> str:
    table = tomllib.loads(load_robot(name).toml)
    change(table)
    return to_toml(table)


def set_limb(index: int, **values: Any) -> Callable[[dict[str, Any]], None]:
    return lambda table: table["limb"][index].update(values)


def set_frame(**values: Any) -> Callable[[dict[str, Any]], None]:
    return lambda table: table["frame"].update(values)


SQUARE = [[0.045, -0.045], [0.045, 0.045], [-0.045, 0.045], [-0.045, -0.045]]
STAR = [[0.05 * math.cos(math.radians(144 * k)), 0.05 * math.sin(math.radians(144 * k))] for k in range(5)]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (set_frame(corners_m=STAR, segments=[9] * 5), "frame edges 0 and 2 cross"),
        (set_frame(corners_m=SQUARE[::-1]), "counter-clockwise"),
        (set_frame(corners_m=[*SQUARE[:3], SQUARE[2]]), "distinct corners"),
        (
            set_frame(corners_m=[*SQUARE, [0.2, -0.046], [0.045, -0.047]], segments=[9] * 6),
            "turns by -179 degrees at corner 4",
        ),
        (set_frame(segments=[500, 500, 500, 500], corners_m=[[x / 4, y / 4] for x, y in SQUARE]), "segments"),
        (set_frame(mass_per_length_kg_per_m=0.0), "greater than 0"),
        (set_frame(mass_per_length_kg_per_m=-1.0), "greater than 0"),
        (set_limb(2, corner=4), "corner 4: the last one is 3"),
        (set_limb(2, length_m=0.0), "greater than 0"),
        (set_limb(2, length_m=3.55e-5), "make each 0.0001 m or longer"),
        (set_limb(2, rest_curvature_per_m=230.0), "'rear_left' crosses itself"),
        (set_limb(2, rest_curvature_per_m=1e300), "'rear_left' crosses itself"),  # wound up to one point
        (set_limb(2, rest_curvature_per_m=True), "input should not be true or false"),
        (lambda table: table.update(water=1000.0), "water is '1000.0': it is a table, so write [water] and"),
        (set_limb(0, direction_deg=135.0, rest_curvature_per_m=5.0, length_m=0.14), "crosses frame edge 2"),
        (
            set_limb(0, direction_deg=-179.0, rest_curvature_per_m=-0.1, length_m=0.12),
            "limbs 'front_right' and 'rear_right' cross",
        ),
        (set_limb(1, mass_per_length_kg_per_m=0.0), "greater than 0"),
    ],
)
def test_what_cannot_be_built_is_refused_in_one_line(
    change: Callable[[dict[str, Any]], None], says: str
) -> None:
    with pytest.raises(InputError) as caught:
        parse_robot(changed(change), source="mine.toml")
    assert says in str(caught.value)
    assert str(caught.value).startswith("mine.toml")
    assert "\n" not in str(caught.value)


def only_front(table: dict[str, Any]) -> None:
    table["action"] = table["action"][:1]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (only_front, "limbs rear_left, rear_right: no action fires it"),
        (
            set_limb(1, rest_curvature_per_m=-115.0),
            "front_right, front_left: at mirrored corners but no mirror images in rest_curvature_per_m",
        ),
        (set_limb(1, direction_deg=100.0), "no mirror images in direction_deg"),
        (set_limb(2, clamp="previous"), "rear_right: at mirrored corners but no mirror images in clamp"),
        (set_limb(2, rest_curvature_per_m=60.0), "it bends the other way"),
        (lambda table: table["guard"].update(limbs_at_once_max=1), "action A: 2 limbs at once"),
        (lambda table: table.update(second_delay_s=0.0), "action B: 4 limbs at once"),
        (lambda table: table["guard"].update(pulse_max_s=0.05), "all is refused"),
        (lambda table: table["guard"].update(rest_min_s=1.4), "within period_s"),
        (lambda table: table["guard"].update(duty_max=0.05), "refused after a while"),
        (lambda table: table["action"][1].update(second=["front_left"]), "a limb in both groups"),
    ],
)  # fmt: skip
def test_what_may_not_be_meant_is_told(change: Callable[[dict[str, Any]], None], says: str) -> None:
    reported = robot_warnings(parse_robot(changed(change), source="mine.toml"))
    assert any(says in line for line in reported), reported
    assert not any(says in line for line in robot_warnings(ROBOT))


def test_a_limb_that_is_curled_over_two_edges_is_named_once() -> None:
    text = load_robot("hexapod").toml.replace("length_m = 0.0355", "length_m = 0.042", 1)
    reported = robot_warnings(parse_robot(text, source="mine.toml"))
    assert any(line.startswith("limbs front_right, front_left, ") for line in reported), reported


@pytest.mark.parametrize("name", built_in_robots())
def test_built_in_robots_have_nothing_but_curls_over_their_edge(name: str) -> None:
    reported = robot_warnings(load_robot(name))
    assert all("curled over the frame edge" in line for line in reported), reported


@pytest.mark.parametrize("name", built_in_robots())
def test_the_outline_is_the_simulated_one(name: str) -> None:
    """Checks and pictures take limbs from their own few lines; they must be the mesh's limbs."""
    robot = load_robot(name)
    mesh = prepare(robot).mesh
    offset = np.array(robot.frame.corners_m[0]) - mesh.rest_m[0]
    first = mesh.frame_nodes
    for limb in robot.limbs:
        points = limb_points(robot.frame, limb)
        assert points[1:] == pytest.approx(mesh.rest_m[first : first + limb.segments] + offset, abs=1e-15)
        first += limb.segments
