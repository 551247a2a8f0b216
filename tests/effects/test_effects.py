"""Effects: their parameters, a user's own file, and what they do to a swimmer."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from tests.der.single import Swimmer

import frogkick as fk
from frogkick.core.errors import InputError
from frogkick.der import Batch, prepare
from frogkick.effects import (
    BUILT_IN,
    Acting,
    Body,
    Effect,
    Fix,
    History,
    Stroke,
    changed_robot,
    make_effect,
    read_world,
    rods_of,
)
from frogkick.effects.acting import lane_effects, program_of
from frogkick.identification.terms import catalogue
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
RNG = np.random.default_rng(5)


GIVEN = {name: {"group": "front"} for name in ("group_gain", "limb_mount", "limb_fatigue")} | {
    "law": {"forward_n": "0"}
}  # what has no default


def effect(name: str, **values: object) -> Effect:
    return make_effect({"name": name, **GIVEN.get(name, {}), **values}, Path())


def swim(
    effects: list[Effect], seconds: float = 1.4, pose: tuple[float, float, float] = (0, 0, 0)
) -> Swimmer:
    robot = changed_robot(ROBOT, effects)
    swimmer = Swimmer(robot, pose_world=pose, rods=prepare(robot))
    acting = Acting(effects, robot, [np.random.default_rng(1)])
    for limb in range(4):
        acting.fire(swimmer.batch, 0, limb, 0.0 if limb < 2 else 0.08)
    swimmer.advance(seconds, acting)
    return swimmer


@pytest.mark.parametrize("name", BUILT_IN)
def test_an_effect_with_nominal_parameters_changes_nothing(name: str) -> None:
    plain, with_effect = swim([]), swim([effect(name)])
    assert with_effect.pose_world() == pytest.approx(plain.pose_world(), abs=1e-6)
    made = effect(name)
    exported = getattr(fk.effects, BUILT_IN[name].__name__, None)
    assert exported is BUILT_IN[name], "not exported by frogkick.effects"
    assert made.about and made.shown_by
    assert all(p.low <= p.nominal <= p.high and p.about and p.unit for p in made.parameters)
    fix = made.fix(Fix(1.0, 0.08, 0.3, 0.2, 0.1), RNG)
    assert fix == Fix(1.0, 0.08, 0.3, 0.2, 0.1)


def test_wrong_parameters_are_refused_by_name() -> None:
    for table, words in (
        ({"name": "limb_ware"}, "did you mean 'limb_wear'"),
        ({"name": "limb_wear", "gane": 1.0}, "no parameter 'gane'"),
        ({"name": "limb_wear", "gain": 9.0}, "gain is 9, allowed is 0.3 to 1.5$"),
        ({"name": "limb_wear", "gain": math.nan}, "gain is nan"),
        ({"name": "limb_wear", "gain": "half"}, "needed is a number"),
        ({"file": "none.py"}, "none.py"),
    ):
        with pytest.raises(InputError, match=words):
            make_effect(table, Path())
    with pytest.raises(InputError, match="no limb 'rear_lift'"):
        changed_robot(ROBOT, [effect("limb_wear", limb="rear_lift")])


def test_a_worn_limb_turns_the_robot_and_its_mirror_image_the_other_way() -> None:
    left, right = (
        swim([effect("limb_wear", limb=limb, gain=0.8)]).pose_world() for limb in ("rear_left", "rear_right")
    )
    assert abs(left[2]) > 0.02
    assert left == pytest.approx(right * [1.0, -1.0, -1.0], abs=1e-9)
    plain, all_worn = swim([]).pose_world(), swim([effect("limb_wear", gain=0.8)]).pose_world()
    assert 0.3 * plain[0] < all_worn[0] < 0.9 * plain[0]
    assert abs(all_worn[2]) < 1e-9


def test_history_decides_what_a_stroke_is_worth() -> None:
    memory, warm, group = (
        effect("limb_memory", loss=0.4),
        effect("warm_up", loss=0.5),
        effect("group_loss", loss=0.3),
    )
    history = History([(0.0, 1), (1.5, 1), (1.5, 2)])
    assert memory.stroke(Stroke("a", 0, 3.0), history, RNG).gain == 1.0
    assert memory.stroke(Stroke("b", 1, 3.0), history, RNG).gain == pytest.approx(1 - 0.4 * math.exp(-1.0))
    assert warm.stroke(Stroke("a", 0, 0.0), History(), RNG).gain == 0.5
    assert warm.stroke(Stroke("a", 0, 3.0), history, RNG).gain == pytest.approx(1 - 0.5 * math.exp(-1.0))
    beside = group.stroke(Stroke("a", 0, 1.58), history, RNG)
    assert beside is not None and beside.gain == pytest.approx(1 - 0.3 * math.exp(-0.08 / 0.15))
    fired = History([(0.0, 0), (0.0, 1), (1.4, 0)])  # the limb beside it, now, and both 1.4 s ago
    again = group.stroke(Stroke("b", 1, 1.4), fired, RNG)
    assert again is not None and again.gain == pytest.approx(1 - 0.3 * math.exp(-1.4 / 0.15))
    sag = effect("battery_sag", loss_per_min=0.2).stroke(Stroke("a", 0, 30.0), history, RNG)
    assert sag is not None and sag.gain == pytest.approx(0.9)


def test_a_current_carries_and_a_vortex_turns() -> None:
    plain = swim([], 5.0).pose_world()
    carried = swim([effect("steady_current", x_mps=0.01)], 5.0).pose_world()
    assert 0.005 < carried[0] - plain[0] < 0.05
    whirl = effect("vortex", circulation_m2ps=0.01, core_m=0.5)
    inside = 0.01 / (2 * math.pi * 0.25)
    assert whirl.flow(0.0, np.array([0.1, 0.2])) == pytest.approx((-0.2 * inside, 0.1 * inside))
    outside = whirl.flow(0.0, np.array([2.0, 0.0]))
    assert outside == pytest.approx((0.0, 0.01 / (2 * math.pi * 2.0)))
    assert swim([whirl], 5.0).pose_world()[2] > 0.005


def test_resistance_slows_and_a_wrench_turns() -> None:
    plain = swim([]).pose_world()
    assert swim([effect("drag_scale", frame=2.0)]).pose_world()[0] < 0.95 * plain[0]
    assert swim([effect("mass_scale", frame=1.5)]).pose_world()[0] < 0.95 * plain[0]
    assert swim([effect("steady_wrench", torque_nm=1e-4)]).pose_world()[2] > 0.05
    spun = Swimmer(ROBOT, velocity_body=(0.0, 0.0, 1.0))
    spun.advance(0.3, Acting([effect("yaw_drag", linear_nms=1e-3)], ROBOT, [RNG]))
    inertia, free = spun.inertia_kg_m2, Swimmer(ROBOT, velocity_body=(0.0, 0.0, 1.0))
    free.advance(0.3)
    ratio = spun.velocity_body()[2] / free.velocity_body()[2]
    assert ratio == pytest.approx(math.exp(-1e-3 * 0.3 / inertia), rel=0.05)


def test_a_hull_a_mount_and_fatigue_change_what_strokes_do() -> None:
    plain = swim([])
    heavy = swim([effect("hull", mass=2.0)])
    assert heavy.mass_kg > 1.5 * plain.mass_kg and heavy.pose_world()[0] < 0.95 * plain.pose_world()[0]
    filled = swim([effect("hull", centre_share=0.8)])
    assert filled.mass_kg == pytest.approx(plain.mass_kg)
    assert filled.inertia_kg_m2 < 0.6 * plain.inertia_kg_m2
    assert swim([effect("hull", limb_drag=2.0)]).pose_world()[0] > 1.1 * plain.pose_world()[0]
    turned = changed_robot(ROBOT, [effect("limb_mount", group="rear", outward_deg=20.0)])
    was, now = ([math.degrees(limb.direction_rad) for limb in each.limbs] for each in (ROBOT, turned))
    assert np.subtract(now, was) == pytest.approx([0.0, 0.0, -20.0, 20.0]), "both point more to their sides"
    tired = effect("limb_fatigue", group="rear", loss=0.2, fade_s=2.0)
    history = History([(0.0, 2), (2.0, 2), (2.0, 1)])
    gain = 1.0 - 0.2 * (math.exp(-2.0) + math.exp(-1.0))
    assert tired.stroke(Stroke("rear_left", 2, 4.0), history, RNG).gain == pytest.approx(gain)
    assert tired.stroke(Stroke("front_left", 1, 4.0), history, RNG).gain == 1.0
    with pytest.raises(InputError, match="no limb with 'middle' in its name: choose from front"):
        changed_robot(ROBOT, [effect("limb_fatigue", group="middle")])


def test_drifting_turns_a_body_by_munk_s_moment() -> None:
    moment = effect("munk_moment", mass_gap_kg=0.2)
    body = Body(0.0, (0.0, 0.0, 0.0), (0.03, 0.01, 0.0))
    assert moment.wrench(0.0, body) == pytest.approx((0.0, 0.0, 0.2 * 0.03 * 0.01))
    for velocity in np.random.default_rng(1).normal(size=(20, 3)):
        wrench = moment.wrench(0.0, Body(0.0, (0.0, 0.0, 0.0), tuple(velocity)))
        assert abs(wrench[0]) > 0.0 and np.dot(wrench, velocity) == pytest.approx(0.0, abs=1e-12), "no work"
    drifting = Swimmer(ROBOT, velocity_body=(0.03, 0.02, 0.0))
    drifting.advance(0.5, Acting([moment], ROBOT, [RNG]))
    plain = Swimmer(ROBOT, velocity_body=(0.03, 0.02, 0.0))
    plain.advance(0.5)
    assert drifting.velocity_body()[2] - plain.velocity_body()[2] > 0.01
    turning, straight = (Swimmer(ROBOT, velocity_body=(0.03, 0.02, 0.2)) for _ in range(2))
    turning.advance(0.5, Acting([moment], ROBOT, [RNG]))
    straight.advance(0.5)
    assert straight.velocity_body()[0] - turning.velocity_body()[0] > 5e-4, "slowed in a turn"


def test_legs_are_short_enough() -> None:
    """Half of the leg changes the end of a swim by less than half a millimetre and a tenth of a degree."""
    effects = [effect("vortex", circulation_m2ps=0.01, x_m=0.1), effect("yaw_drag", quadratic_nms2=1e-3)]
    robot, ends = changed_robot(ROBOT, effects), []
    for legs in (1, 4):
        swimmer, acting = Swimmer(robot), Acting(effects, robot, [np.random.default_rng(1)])
        for limb in (0, 3):
            acting.fire(swimmer.batch, 0, limb, 0.0)
        for leg in range(100 * legs):
            swimmer.advance((leg + 1) * 0.02 / legs, acting)
        ends.append(swimmer.pose_world())
    assert np.abs(ends[0][:2] - ends[1][:2]).max() < 5e-4
    assert abs(ends[0][2] - ends[1][2]) < math.radians(0.1)


MINE = """
from frogkick.effects import Effect, Parameter

class Whirl(Effect):
    parameters = (Parameter("turns", "1/s", 0.0, 0.5, 0.1),)
    def flow(self, time_s, position_world_m):
        x, y = position_world_m
        return -y * self.turns, x * self.turns

class Plain:
    def __init__(self, share=0.5):
        self.share = share
    def stroke(self, stroke, history, rng):
        stroke.gain *= self.share
    def fix(self, fix, rng):
        return None if rng.random() < self.share else fix
    def wrench(self, time_s, body):
        return (0.0, 0.0), 1e-4 * self.share
"""


def test_a_user_s_own_file_works_where_a_name_does(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "world.toml").write_text(
        '[[effect]]\nfile = "mine.py"\nclass = "Whirl"\nturns = 0.2\n'
        '[[effect]]\nfile = "mine.py"\nclass = "Plain"\nshare = 0.4\n'
        '[[effect]]\nname = "limb_wear"\nlimb = "rear_left"\ngain = 0.7\n'
    )
    whirl, plain, wear = read_world(tmp_path / "world.toml").effects
    assert (whirl.title, plain.title, wear.title) == ("Whirl", "Plain", "limb_wear")
    acting = Acting([whirl, plain, wear], ROBOT, [np.random.default_rng(3)])
    kept = sum(acting.fix(Fix(0.0, 0.1, 0.0, 0.0, 0.0)) is not None for _ in range(1000))
    assert 550 < kept < 650
    weak, strong = swim([plain]), swim([])
    assert 0.0 < weak.pose_world()[0] < 0.8 * strong.pose_world()[0]
    assert weak.pose_world()[2] > 0.01
    assert swim([whirl]).pose_world()[2] > 0.02


OWN = """
from frogkick.effects import Effect, LimbWear, Parameter, parameter

TURNS = Parameter("turns", "1/s", 0.0, 0.5, 0.1)

class Listed(Effect):
    TURNS = TURNS
    parameters = (TURNS,)
    def flow(self, time_s, position_world_m):
        return self.turns, 0.0

class Wearier(LimbWear):
    gain = parameter("1", 0.0, 1.0, 1.0)
    lost = parameter("1", 0.0, 1.0, 0.0)

class Comma(Effect):
    parameters = (TURNS)
    def flow(self, time_s, position_world_m):
        return self.turns, 0.0
"""


def test_a_user_s_parameters_are_those_that_the_class_names(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN)
    listed = make_effect({"file": "own.py", "class": "Listed", "turns": 0.2}, tmp_path)
    assert [p.name for p in listed.parameters] == ["turns"]
    wearier = make_effect({"file": "own.py", "class": "Wearier", "gain": 0.1}, tmp_path)
    assert [p.name for p in wearier.parameters] == ["gain", "delay_s", "duration_scale", "lost"]
    assert wearier.value("gain") == 0.1
    with pytest.raises(InputError, match="'Comma' cannot be made with"):
        make_effect({"file": "own.py", "class": "Comma"}, tmp_path)
    with pytest.raises(InputError, match=r"'Comma': parameters are .*: give a tuple of Parameter"):
        catalogue(ROBOT, tmp_path / "own.py")


HUGE = 10**400
"""Which TOML holds, and no float."""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[effect]]\nname = 3\n", "no effect '3'"),
        ("effect = 3\n", "an effect that is no table"),
        ('[[effect]]\nname = "limb_wear"\nlimb = "tail"\n', "has no limb 'tail'"),
        (
            f'[[effect]]\nname = "drag_scale"\nframe = {HUGE}\n',
            "frame of an effect is 1000000000..., a number",
        ),
        (
            f'[[effect]]\nname = "law"\nforward_n = "a"\nparameters.a = {{unit = "N", low = -{HUGE}}}\n',
            "low of an effect is -100000000..., a number beyond",
        ),
        ('[[effect]]\nname = "law"\non = ["flow"]\n', r"a law on \['flow'\].*: give wrench"),
        ("[[effects]]\n", "has effects: a world has"),
        ("[[effect]\n", "cannot be read as TOML"),
        ('[[effect]]\nfile = "mine.py"\n', "has no effect class None"),
        ('[[effect]]\nfile = "mine.py"\nclass = "Wirl"\n', "did you mean 'Whirl'"),
        ('[[effect]]\nfile = "broken.py"\n', "does not run: ZeroDivisionError"),
        ('[[effect]]\nfile = "ends.py"\n', "does not run: SystemExit: 0"),
    ],
)
def test_a_wrong_world_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "broken.py").write_text("1 / 0\n")
    (tmp_path / "ends.py").write_text("raise SystemExit(0)\n")
    (tmp_path / "world.toml").write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_world(tmp_path / "world.toml", load_robot("frog2022"))
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"world file '{tmp_path / 'world.toml'}'")


@pytest.mark.parametrize("bad", [math.nan, 1e200])
def test_a_simulation_that_diverges_is_no_effect_s_fault(bad: float) -> None:
    by_speed = {"value": 0.5, "unit": "s/m", "low": -1.0, "high": 1.0}
    law = {"name": "law", "on": "stroke", "gain": "1 + by * forward_mps", "parameters": {"by": by_speed}}
    robot, still = load_robot("frog2022-measured"), np.zeros((2, 3))
    ends = []
    for wrong in ({}, {1: (np.zeros(3), np.full(3, bad))}):
        batch, acting = (
            Batch([rods_of(robot)] * 2, still, still),
            lane_effects(robot, 2, [make_effect(law, Path())]),
        )
        batch.shift(wrong)
        for lane in (0, 1):
            acting.fire_all(batch, lane, program_of(robot, robot.actions[1]))
        acting.advance(batch, 0.5)
        assert list(batch.failures) == list(wrong)
        ends.append(batch.pose_world()[0].tolist())
    assert ends[0] == ends[1]


def test_a_method_that_gives_nonsense_is_named(tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text(
        "class Bad:\n    def flow(self, time_s, position_world_m):\n        return 1.0\n"
    )
    bad = make_effect({"file": "bad.py"}, tmp_path)
    with pytest.raises(InputError, match=r"'Bad': flow gave 1\.0, needed are 2 finite numbers"):
        swim([bad])


@pytest.mark.parametrize(
    ("method", "words"),
    [
        ("flow(self, time_s, position_world_m):\n        return 1 / 0", "flow fails: ZeroDivisionError"),
        ("wrench(self, time_s):\n        return 0, 0, 0", "wrench fails: TypeError"),
        (
            "stroke(self, stroke, history, rng):\n        return 5",
            "stroke gave 5, needed is a Stroke or None",
        ),
        (  # a typo had no effect at all
            "stroke(self, stroke, history, rng):\n        stroke.gian = 0.5",
            "stroke fails: AttributeError: 'Stroke' object has no attribute 'gian'",
        ),
        ("flow(self, time_s, position_world_m):\n        raise SystemExit(0)", "flow fails: SystemExit: 0"),
    ],
)
def test_a_method_that_fails_is_named(tmp_path: Path, method: str, words: str) -> None:
    (tmp_path / "bad.py").write_text(f"class Bad:\n    def {method}\n")
    with pytest.raises(InputError, match=f"effect 'Bad': {words}") as caught:
        swim([make_effect({"file": "bad.py"}, tmp_path)])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("given", ["float('nan')", "float('inf')", "'x'", "None", "10**400"])
def test_what_is_no_finite_number_is_refused(tmp_path: Path, given: str) -> None:
    lines = "class Bad:", "    def {0}(self, {0}, *more):", "        {0}.{1} = {2}", "        return {0}", ""
    for hook, name in (("stroke", "gain"), ("fix", "heading_rad")):
        (tmp_path / "bad.py").write_text("\n".join(lines).format(hook, name, given))
        acting = Acting([make_effect({"file": "bad.py"}, tmp_path)], ROBOT, [RNG])
        with pytest.raises(InputError, match=f"give a {hook} of .*: values must be finite"):
            acting.stroke(0, 0, 0.0) if hook == "stroke" else acting.fix(Fix(0.0, 0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("change", ["limb = 'rear_left'", "index = 3", "time_s += 0.1"])
def test_a_stroke_stays_that_of_its_limb_at_its_time(tmp_path: Path, change: str) -> None:
    """A change of limb or time would have no effect, so it is refused."""
    lines = f"class Bad:\n    def stroke(self, stroke, history, rng):\n        stroke.{change}\n"
    (tmp_path / "bad.py").write_text(lines)
    acting = Acting([make_effect({"file": "bad.py"}, tmp_path)], ROBOT, [RNG])
    with pytest.raises(InputError, match=r"which was one of .* at 1\.5 s: change its gain, delay_s and dur"):
        acting.stroke(0, 0, 1.5)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_world_as_an_editor_on_windows_writes_it(tmp_path: Path, end: str) -> None:
    text = "\ufeff" + end.join(["[[effect]]", 'name = "battery_sag"', "loss_per_min = 0.2", ""])
    (tmp_path / "world.toml").write_bytes(text.encode())
    assert read_world(tmp_path / "world.toml").effects[0].value("loss_per_min") == 0.2


def test_a_fix_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text("class Bad:\n    def fix(self, fix, rng):\n        return 'x'\n")
    acting = Acting([make_effect({"file": "bad.py"}, tmp_path)], ROBOT, [RNG])
    with pytest.raises(InputError, match="'Bad': fix gave 'x', needed is a Fix or None"):
        acting.fix(Fix(0.0, 0.0, 0.0, 0.0, 0.0))
