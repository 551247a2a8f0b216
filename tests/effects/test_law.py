"""Laws: formulas are parsed, checked by units, never run as Python, and act as the effects they describe."""

from __future__ import annotations

import copy
import gc
import math
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.conftest import from_ci, some
from tests.der.single import Swimmer

import frogkick as fk
from frogkick.core.errors import InputError
from frogkick.der import prepare
from frogkick.effects import Acting, Body, Effect, Fix, History, Law, Stroke, make_effect, read_world
from frogkick.effects.formula import FUNCTIONS, ONE, parse, unit_of
from frogkick.front.tables import default_tables
from frogkick.robot import load_robot
from frogkick.robot.load import parse_robot
from frogkick.robot.toml_text import to_toml

ROBOT = load_robot("frog2022")
UNITS = {"x": unit_of("m"), "y": unit_of("m"), "t": unit_of("s"), "v": unit_of("m/s"), "a": ONE}
VALUES = {"x": 0.3, "y": -0.4, "t": 2.0, "v": -0.05, "a": 1.5}


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("x + y", "m", -0.1),
        ("-x * 2 - y / 4", "m", -0.5),
        ("hypot(x, y)", "m", 0.5),
        ("max(0, hypot(x, y) - x)", "m", 0.2),
        ("x / t + v", "m/s", 0.1),
        ("sqrt(x * x)", "m", 0.3),
        ("x ** 2", "m^2", 0.09),
        ("(v / v) ** a", "1", 1.0),
        ("sin(a) * (x > y)", "1", math.sin(1.5)),
        ("(a < 1) * x", "m", 0.0),
        ("exp(-x / x) * sign(v)", "1", -math.exp(-1.0)),
        ("atan2(y, x)", "rad", math.atan2(-0.4, 0.3)),
        ("abs(v) * v", "m^2/s^2", -0.0025),
        ("min(a, tanh(a)) * x / x", "1", math.tanh(1.5)),
        ("0", "N", 0.0),
        ("0 * x", "N m", 0.0),
        ("log(exp(a))", "1", 1.5),
        ("(x - x) / (x - x)", "1", 0.0),  # the direction to where one is
    ],
)
def test_a_formula_has_a_value_and_a_unit(text: str, unit: str, value: float) -> None:
    assert parse(text, UNITS, unit_of(unit))(VALUES) == pytest.approx(value, abs=1e-15)
    arrays = {name: np.array([each, 2.0 * each]) for name, each in VALUES.items()}
    doubled = {name: 2.0 * each for name, each in VALUES.items()}
    formula = parse(text, UNITS, unit_of(unit))
    assert np.broadcast_to(formula.over(arrays), 2) == pytest.approx([value, formula(doubled)], nan_ok=True)


def test_threads_may_read_formulas_at_once() -> None:
    """CPython 3.11 raises SystemError where two threads build a syntax tree at the same time."""
    text = "max(0, hypot(x, y) - x) * y / hypot(x - y, y)"
    wrong: list[BaseException] = []

    def read() -> None:
        try:
            for _ in range(100):
                parse(text, UNITS, unit_of("m"))
        except BaseException as error:
            wrong.append(error)

    def let_others_go_on(*_: Any) -> None:
        time.sleep(1e-5)

    threshold, interval = gc.get_threshold(), sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    gc.set_threshold(1)  # a collection runs in the middle of a tree
    gc.callbacks.append(let_others_go_on)
    try:
        threads = [threading.Thread(target=read) for _ in range(4)]
        for each in threads:
            each.start()
        for each in threads:
            each.join()
    finally:
        gc.callbacks.remove(let_others_go_on)
        gc.set_threshold(*threshold)
        sys.setswitchinterval(interval)
    assert not wrong


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x + t", "adds m and s"),
        ("x > t", "compares m and s"),
        ("sin(x)", "sin takes a pure number"),
        ("x * t", "comes out in m s, needed is m"),
        ("1", "comes out in 1, needed is m"),
        ("x ** a", "needs a pure number below it"),
        ("x ** x", "an exponent is in m"),
        ("hypot(x, v)", "m and m s^-1"),
        ("z", "there is no 'z'"),
        ("sine(a) * x", "did you mean 'sin'"),
        ("sin(a, a) * x", "sin takes 1 arguments"),
        ("__import__('os').system('true')", "is not of the language"),
        ("x.real", "is not of the language"),
        ("[x][0]", "is not of the language"),
        ("x if a else y", "is not of the language"),
        ("(lambda: x)()", "is not of the language"),
        ("x and y", "is not of the language"),
        ("'x'", "is not of the language"),
        ("True * x", "is not of the language"),
        ("x < y < x", "is not of the language"),
        ("1e999 * x", "infinite"),
        ("x +", "cannot be read"),
        ("", "cannot be read"),
        ("x" + " + x" * 200, "characters"),
    ],
)
def test_a_wrong_formula_is_one_line(text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(text, UNITS, unit_of("m"))
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("N s/m", (1.0, 0.0, -1.0)),
        ("m^2/s", (0.0, 2.0, -1.0)),
        ("1/s", (0.0, 0.0, -1.0)),
        ("N m", (1.0, 2.0, -2.0)),
        ("kg/m^3", (1.0, -3.0, 0.0)),
        ("rad", ONE),
        ("N\u00a0s/m", (1.0, 0.0, -1.0)),  # a space that does not break, from a web page
    ],
)
def test_units_are_read(text: str, unit: tuple[float, float, float]) -> None:
    assert unit_of(text) == unit


@pytest.mark.parametrize("text", ["", "mm", "m/", "m^x", "5", "m;s", "1/min"])
def test_a_wrong_unit_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        unit_of(text)


def test_functions_that_end_floats_are_infinite_and_the_law_says_so() -> None:
    assert parse("exp(1000 * a)", UNITS, ONE)(VALUES) == math.inf
    assert math.isnan(parse("log(-a)", UNITS, ONE)(VALUES))
    law = Law(
        on="wrench", forward_n="k * exp(1000 * x_m / x_m)", parameters={"k": {"value": 1.0, "unit": "N"}}
    )
    with pytest.raises(InputError, match="finite"):
        swim([law], pose=(0.1, 0.0, 0.0))
    assert set(FUNCTIONS) >= {"sin", "hypot", "max"}


def swim(
    effects: list[Effect], seconds: float = 1.4, pose: tuple[float, float, float] = (0, 0, 0)
) -> list[float]:
    for effect in effects:
        effect.check(ROBOT)
    swimmer = Swimmer(ROBOT, pose_world=pose, rods=prepare(ROBOT))
    acting = Acting(effects, ROBOT, [np.random.default_rng(1)])
    for limb in range(3):  # it turns
        acting.fire(swimmer.batch, 0, limb, 0.0 if limb < 2 else 0.08)
    swimmer.advance(seconds, acting)
    return [float(value) for value in swimmer.pose_world()]


def numbers(**given: tuple[float, str]) -> dict[str, dict[str, Any]]:
    return {name: {"value": value, "unit": unit} for name, (value, unit) in given.items()}


@pytest.mark.parametrize(
    ("built_in", "law"),
    [
        (
            {"name": "limb_wear", "limb": "rear_left", "gain": 0.7},
            {"on": "stroke", "limb": "rear_left", "gain": "share", "parameters": numbers(share=(0.7, "1"))},
        ),
        (
            {"name": "steady_current", "x_mps": 0.01, "y_mps": -0.004},
            {
                "on": "flow", "x_mps": "u", "y_mps": "v",
                "parameters": numbers(u=(0.01, "m/s"), v=(-0.004, "m/s")),
            },
        ),
        (
            {"name": "shear_current", "x_per_s": 0.05},
            {"on": "flow", "x_mps": "rate * y_m", "parameters": numbers(rate=(0.05, "1/s"))},
        ),
        (
            {"name": "steady_wrench", "forward_n": 0.01, "left_n": -0.005, "torque_nm": 1e-4},
            {
                "on": "wrench", "forward_n": "f", "left_n": "l", "torque_nm": "t",
                "parameters": numbers(f=(0.01, "N"), l=(-0.005, "N"), t=(1e-4, "N m")),
            },
        ),
        (
            {"name": "yaw_drag", "quadratic_nms2": 1e-3, "linear_nms": 5e-4},
            {
                "on": "wrench", "torque_nm": "-q * abs(turn_radps) * turn_radps - l * turn_radps",
                "parameters": numbers(q=(1e-3, "N m s^2"), l=(5e-4, "N m s")),
            },
        ),
        (
            {"name": "warm_up", "loss": 0.4, "fade_strokes": 3.0},
            {
                "on": "stroke", "gain": "1 - loss * exp(-strokes / fade)",
                "parameters": numbers(loss=(0.4, "1"), fade=(3.0, "1")),
            },
        ),
    ],
)  # fmt: skip
def test_a_law_swims_as_the_effect_that_it_spells(built_in: dict[str, Any], law: dict[str, Any]) -> None:
    one = swim([make_effect(built_in, Path())], pose=(0.1, 0.2, 0.4))
    other = swim([make_effect({"name": "law", **law}, Path())], pose=(0.1, 0.2, 0.4))
    assert other == pytest.approx(one, abs=1e-12)
    assert swim([], pose=(0.1, 0.2, 0.4)) != pytest.approx(one, abs=1e-6)


def test_a_force_of_the_pool_turns_with_the_body() -> None:
    law = Law(on="wrench", x_n="f", parameters=numbers(f=(0.01, "N")))
    east = law.wrench(0.0, Body(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    north = law.wrench(0.0, Body(0.0, (0.0, 0.0, math.pi / 2), (0.0, 0.0, 0.0)))
    assert east == pytest.approx((0.01, 0.0, 0.0)) and north == pytest.approx((0.0, -0.01, 0.0))


def test_a_stroke_knows_where_the_robot_is_and_who_fired_before() -> None:
    law = Law(on="stroke", limb="rear_left", gain="1 - 0.5 * (heading_rad > 1)")
    law.check(ROBOT)
    body = Body(0.0, (0.0, 0.0, 1.2), (0.0, 0.0, 0.0))
    rng, none = np.random.default_rng(0), History()
    index = [limb.name for limb in ROBOT.limbs].index("rear_left")
    assert law.asks_body and not Law(on="stroke", gain="1 - 0.1 * (strokes > 3)").asks_body
    assert law.stroke(Stroke("rear_left", index, 0.0, body=body), none, rng).gain == 0.5
    assert law.stroke(Stroke("rear_left", index, 0.0), none, rng).gain == 1.0
    assert law.stroke(Stroke("rear_right", 3, 0.0, body=body), none, rng).gain == 1.0
    pair = Law(
        on="stroke", limb="rear_left", gain="1 - loss * (since_front_left_s < w)",
        parameters=numbers(loss=(0.3, "1"), w=(0.2, "s")),
    )  # fmt: skip
    pair.check(ROBOT)
    front = [limb.name for limb in ROBOT.limbs].index("front_left")
    assert pair.stroke(Stroke("rear_left", index, 1.0), History([(0.9, front)]), rng).gain == pytest.approx(
        0.7
    )
    assert pair.stroke(Stroke("rear_left", index, 1.0), History([(0.5, front)]), rng).gain == 1.0


def test_a_misfire_is_a_matter_of_chance() -> None:
    law = Law(on="stroke", limb="rear_left", gain="chance >= share", parameters=numbers(share=(0.3, "1")))
    rng, index = np.random.default_rng(3), [limb.name for limb in ROBOT.limbs].index("rear_left")
    gains = [law.stroke(Stroke("rear_left", index, float(k)), History(), rng).gain for k in range(2000)]
    assert set(gains) == {0.0, 1.0} and gains.count(0.0) == pytest.approx(600, abs=80)
    likeliest = law.likeliest()
    for _ in range(9):
        assert likeliest.stroke(Stroke("rear_left", index, 1.0), History(), rng).gain == 1.0  # type: ignore[union-attr]


def test_a_fix_is_moved_and_made_older() -> None:
    law = Law(on="fix", x_m="bend * y_m * y_m", delay_s="-0.02 * later", parameters=numbers(
        bend=(0.2, "1/m"), later=(1.0, "s")))  # fmt: skip
    fix = law.fix(Fix(1.0, 0.08, 0.3, 0.5, 0.1), np.random.default_rng(0))
    assert (fix.x_m, fix.y_m, fix.heading_rad) == (pytest.approx(0.35), 0.5, 0.1)
    assert (fix.capture_s, fix.delay_s) == (pytest.approx(0.98), pytest.approx(0.1))


CABLE = '''
[[effect]]
name = "law"
title = "cable"
on = "wrench"
x_n = """
-stiffness * max(0, hypot(x_m - post_x, y_m - post_y) - slack)
 * (x_m - post_x) / hypot(x_m - post_x, y_m - post_y)"""
y_n = """
-stiffness * max(0, hypot(x_m - post_x, y_m - post_y) - slack)
 * (y_m - post_y) / hypot(x_m - post_x, y_m - post_y)"""
[effect.parameters]
stiffness = { value = 0.05, unit = "N/m", low = 0.0, high = 1.0 }
slack = { value = 0.1, unit = "m", low = 0.0, high = 1.0 }
post_x = { value = -0.2, unit = "m" }
post_y = { value = 0.0, unit = "m" }
'''


def test_a_world_s_file_has_a_law(tmp_path: Path) -> None:
    (tmp_path / "w.toml").write_text(CABLE)
    (cable,) = read_world(tmp_path / "w.toml").effects
    assert cable.title == "cable" and "post_x" in repr(cable)
    plain, pulled = swim([]), swim([cable])
    assert pulled[0] < plain[0] - 1e-3, "it holds the robot back"
    assert isinstance(cable, Law)
    again = make_effect(cable.table, tmp_path)
    assert swim([again]) == pulled


LAWS_OF_ALL = [
    {"on": "wrench", "x_n": "push", "parameters": {"push": {"value": 0.002, "unit": "N"}}},
    {"on": "flow", "x_mps": "speed", "parameters": {"speed": {"value": 0.01, "unit": "m/s"}}},
    {"on": "stroke", "limb": "front_left", "gain": "0.5"},
    {"on": "fix", "x_m": "off", "parameters": {"off": {"value": 0.02, "unit": "m"}}},
]


@pytest.mark.parametrize("given", LAWS_OF_ALL, ids=lambda given: str(given["on"]))
def test_a_copy_of_a_law_acts_on_what_it_acts_on(given: dict[str, Any]) -> None:
    law = Law(**given)
    for other in (copy.copy(law), copy.deepcopy(law), law.likeliest()):
        assert type(other) is type(law) and other.table == law.table


@from_ci
@pytest.mark.parametrize("given", some(LAWS_OF_ALL, 1), ids=lambda given: str(given["on"]))
def test_a_run_in_a_world_with_a_law_is_another_run(given: dict[str, Any], tmp_path: Path) -> None:
    world = tmp_path / "world.toml"
    world.write_text(to_toml({"effect": [{"name": "law", **given}]}))
    table = default_tables("frog2022", 40, "visited")
    plain, changed = (
        fk.run(table, "line", robot="pool", world=each, time_limit_s=6.0) for each in (None, world)
    )
    assert not np.allclose(plain.log.fixes.pose_world, changed.log.fixes.pose_world, atol=1e-3)


def test_a_robot_s_file_has_a_law_and_keeps_it(tmp_path: Path) -> None:
    file = tmp_path / "held.toml"
    file.write_text('base = "frog2022"\nid = "held"\n' + CABLE)
    robot = load_robot(file)
    assert robot.effects[0]["parameters"]["slack"]["value"] == 0.1
    assert parse_robot(robot.toml, "again").sha256 == robot.sha256
    robot.save(tmp_path / "copy.toml")
    assert load_robot(tmp_path / "copy.toml").effects == robot.effects


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"on": "wind"}, "give wrench, flow, stroke, fix"),
        ({}, "has no formula"),
        ({"forward_n": "k"}, "there is no 'k'"),
        ({"forward": "1"}, "has no 'forward'"),
        ({"on": "flow", "forward_n": "1"}, "has no 'forward_n'"),
        ({"forward_n": "k", "parameters": {"k": {"value": 1.0}}}, "has no unit"),
        ({"forward_n": "k", "parameters": {"k": {"value": 1.0, "unit": "N", "lo": 0}}}, "'lo' (did you mean"),
        (
            {"forward_n": "k", "parameters": {"k": {"value": 1.0, "unit": "m"}}},
            "a law's forward_n: formula 'k'",
        ),
        (
            {"forward_n": "k", "parameters": {"k": {"value": 2.0, "unit": "N", "low": 0, "high": 1}}},
            "0 to 1 N",
        ),
        ({"forward_n": "k", "parameters": {"k": 1.0}}, "give each a value and a unit"),
        ({"forward_n": "k", "parameters": [1.0]}, "give each a value and a unit"),
        ({"forward_n": "k", "parameters": {"k": {"value": "a", "unit": "N"}}}, "finite number"),
        ({"forward_n": "x_m", "parameters": {"x_m": {"value": 1.0, "unit": "N"}}}, "a name that is taken"),
        ({"forward_n": "0", "parameters": {"a b": {"value": 1.0, "unit": "N"}}}, "is no name"),
        ({"forward_n": "0", "parameters": {"k": {"unit": "N", "low": 2, "high": 1}}}, "are no bounds"),
    ],
)
def test_a_wrong_law_is_one_line(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        make_effect({"name": "law", **given}, Path())
    assert words in str(caught.value), caught.value
    assert "\n" not in str(caught.value)


def test_a_law_of_one_s_own_class_changes_the_body_too() -> None:
    class Heavy(Law):
        def robot(self, robot: fk.Robot) -> fk.Robot:
            return robot

    heavy = Heavy(on="stroke", gain="0.5")
    assert heavy.overrides("robot") and heavy.overrides("stroke") and not heavy.overrides("fix")
    assert not Law(on="stroke", gain="0.5").overrides("robot")


def test_a_law_of_a_limb_that_there_is_not_is_refused() -> None:
    for law in (Law(on="stroke", limb="tail", gain="1"), Law(on="stroke", gain="1 - (since_tail_s < 0)")):
        with pytest.raises(InputError, match="tail"):
            law.check(ROBOT)
