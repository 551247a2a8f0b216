"""Robot files: what they say is what comes out; wrong ones are refused by name."""

from __future__ import annotations

import math
import pickle
import re
import tomllib
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from frogkick.core.errors import InputError
from frogkick.robot import Robot, load_robot, parse_robot
from frogkick.robot.load import BUILT_IN
from frogkick.robot.toml_text import to_toml

ROBOT = load_robot("frog2022")


def test_the_paper_robot_is_as_published() -> None:
    assert [limb.name for limb in ROBOT.limbs] == ["front_right", "front_left", "rear_left", "rear_right"]
    masks = {a.name: (a.first_mask, a.second_mask) for a in ROBOT.actions}
    # Limbs in the order front right, front left, rear left, rear right: C is 0111, H is 1000.
    assert masks == {
        "A": (0b0011, 0),
        "B": (0b0011, 0b1100),
        "C": (0b0010, 0b1100),
        "D": (0b0001, 0b1100),
        "E": (0b0010, 0b0100),
        "F": (0b0001, 0b1000),
        "G": (0b0010, 0),
        "H": (0b0001, 0),
        "I": (0, 0),
    }
    assert (ROBOT.period_s, ROBOT.pulse_s) == (1.425, 0.080)
    assert ROBOT.library_box.omega_rad_s == pytest.approx((-math.pi / 6, math.pi / 6))
    assert len(ROBOT.sha256) == 32
    assert 0.3 < ROBOT.mass_kg < 0.4


def test_canonical_text_reads_back_to_the_same_robot() -> None:
    again = parse_robot(ROBOT.toml, source="text")
    assert again == ROBOT


@pytest.mark.parametrize("name", ["frog2022", "frog2022-measured", "frog2022-sim", "hexapod"])
def test_replaced_values_are_those_that_are_saved(name: str, tmp_path: Path) -> None:
    robot = load_robot(name)
    alloy = robot.profiles[0].egain_percent
    own = tuple(each for each in robot.profiles if each.egain_percent == alloy)
    limb = replace(robot.limbs[0], length_m=0.034, direction_rad=0.5, egain_percent=alloy, profiles=own)
    changes: dict[str, Any] = {
        "period_s": 1.3,
        "water_density_kg_per_m3": 1030.0,
        "gait_lead_mask": 1,
        "limbs": (limb, *robot.limbs[1:]),
        "actions": robot.actions[:3],
        "profiles": tuple(replace(each, rms_per_m=1.0) for each in robot.profiles),
        "library_box": replace(robot.library_box, omega_rad_s=(-0.25, 0.25)),
        "guard": replace(robot.guard, duty_max=0.09),
        "planner": replace(robot.planner, depth=2),
        "battery": None,
        "effects": ({"name": "limb_wear", "limb": robot.limbs[1].name, "gain": 0.7},),
    }
    for some in ([each] for each in changes):
        changed = replace(robot, **{key: changes[key] for key in some})
        changed.save(tmp_path / "changed.toml")
        again = load_robot(tmp_path / "changed.toml")
        assert again == changed and again.sha256 == changed.sha256, some
        assert (changed.sha256 == robot.sha256) == (changed == robot), some
        assert load_robot(changed) == again and pickle.loads(pickle.dumps(changed)).toml == again.toml
    every = replace(robot, **changes)
    assert load_robot(every) == every
    assert replace(every, **{key: getattr(robot, key) for key in changes}).toml == robot.toml
    assert load_robot(robot) is robot


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda robot: replace(robot, pulse_s=-1.0), "with replaced values: pulse_s is '-1.0'"),
        (lambda robot: replace(robot, pulse_s=70.0), "is the number in ms"),
        (
            lambda robot: replace(robot, limbs=(replace(robot.limbs[0], tip_shedding=0.5), *robot.limbs[1:])),
            "limbs.tip_shedding is 0.5: no file holds it",
        ),
    ],
)
def test_replaced_values_that_no_file_can_have_are_refused(
    change: Callable[[Robot], Robot], says: str, tmp_path: Path
) -> None:
    for use in (load_robot, lambda robot: robot.save(tmp_path / "robot.toml")):
        with pytest.raises(InputError, match=re.escape(says)):
            use(change(ROBOT))
    assert not list(tmp_path.iterdir())


def test_comments_do_not_change_the_hash_and_values_do() -> None:
    assert parse_robot("# a comment\n" + ROBOT.toml, source="text").sha256 == ROBOT.sha256
    changed = parse_robot(ROBOT.toml.replace("period_s = 1.425", "period_s = 1.426"), source="text")
    assert changed.sha256 != ROBOT.sha256


def test_a_file_is_read_like_a_name(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(ROBOT.toml)
    assert load_robot(file) == ROBOT


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("pulse_s =", "pulses_s =", "'pulse_s'"),
        ("corner = 0", "cornr = 0", "'corner'"),
        ("drag_width_m = 0.0275", "drag_width = 0.0275", "'drag_width_m'"),
        ("period_s = 1.425", "period_s = nan", "period_s"),
        ("period_s = 1.425", "period_s = -1.0", "greater than 0"),
        ("corner = 3", "corner = 9", "corner 9"),
        ("corner = 3", "corner = 2", "two limbs' corners"),
        ('name = "B"', 'name = "A"', "two actions"),
        ('first = ["front_left"]', 'first = ["front_lef"]', "'front_left'"),
        ("segments = [23, 23, 23, 23]", "segments = [23, 23]", "2 entries for 4 edges"),
        ("forward_mps = [0.0, 0.04]", "forward_mps = [0.04, 0.0]", "lower end first"),
        ("profile_frequency_hz = 0.7", "profile_frequency_hz = 3.0", "0.4-1.2 Hz"),
        ('id = "frog2022"', 'id = "a-name-longer-than-15"', "give 1 to 15 letters, digits, - or _"),
        ('id = "frog2022"', 'id = "dr\u00fc 3"', "give 1 to 15 letters, digits, - or _"),
        ('name = "front_left"', 'name = "front left"', "limb.1.name is 'front left': give letters, digits"),
        ("period_s = 1.425", "period_s = = 1", "not TOML"),
        # A slip by a thousand, with the unit that was likely meant.
        ("corners_m = [[0.045, -0.045]", "corners_m = [[45.0, -45.0]", "frame.corners_m is 45, above 2"),
        ("period_s = 1.425", "period_s = 900.0", "period_s is 900, above 120"),
        ("pulse_s = 0.08\n", "pulse_s = 80.0\n", "pulse_s is 80, above 10"),
        ("length_m = 0.0355", "length_m = 35.5", "limb.front_right.length_m is 35.5"),
        ("modulus_rest_pa = 3000000.0", "modulus_rest_pa = 3.0", "is the number in MPa?"),
        ("second_moment_m4 = 1.4967e-11", "second_moment_m4 = 14.967", "is the number in mm^4?"),
        ("density_kg_per_m3 = 1000.0", "density_kg_per_m3 = 1.0", "below 100"),
        ("forward_mps = [0.0, 0.04]", "forward_mps = [0.0, 40.0]", "is the number in mm/s?"),
    ],
)
def test_wrong_values_are_refused_in_one_line(old: str, new: str, says: str) -> None:
    assert old in ROBOT.toml
    with pytest.raises(InputError) as caught:
        parse_robot(ROBOT.toml.replace(old, new, 1), source="my.toml")
    text = str(caught.value)
    assert "my.toml" in text
    assert says in text
    assert "\n" not in text


def test_a_missing_key_is_named() -> None:
    with pytest.raises(InputError, match="'pulse_s' is missing"):
        parse_robot(ROBOT.toml.replace("pulse_s = 0.08\n", "", 1), source="my.toml")


def test_unknown_robots_and_actions_are_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'frog2022'"):
        load_robot("frog2021")
    with pytest.raises(InputError, match="does not exist"):
        load_robot("nowhere/robot.toml")
    with pytest.raises(InputError, match="A, B, C"):
        ROBOT.action("Z")
    assert ROBOT.action("c").name == "C"


def test_profiles_are_not_extrapolated() -> None:
    for egain, frequency in ((10.0, 2.0), (10.0, 0.1), (60.0, 1.0), (35.0, 1.0), (10.0, math.nan)):
        with pytest.raises(InputError, match=r"0\.4-1\.2 Hz"):
            ROBOT.actuation(egain, frequency)


@pytest.mark.parametrize("period_s", [0.9, 0.7, 1.1, 1.3])
def test_a_robot_s_only_profile_is_known_at_its_own_frequency(period_s: float) -> None:
    """One over a period is seldom a round number: what was asked for was once rounded, what is known not."""
    (measured,) = (p for p in ROBOT.profiles if (p.egain_percent, p.frequency_hz) == (10.0, 0.7))
    only = replace(measured, frequency_hz=1.0 / period_s, duration_s=period_s)
    table = tomllib.loads(ROBOT.toml)
    table |= {"period_s": period_s, "profile_frequency_hz": 1.0 / period_s, "profile": [asdict(only)]}
    robot = parse_robot(to_toml(table), source="text")
    assert robot.actuation(10.0, 1.0 / period_s).duration_s == pytest.approx(period_s)


def test_between_profiles_a_stroke_lies_between_them() -> None:
    low, mid, high = (ROBOT.actuation(10.0, f) for f in (0.7, 0.75, 0.8))
    assert (
        low.drop_per_m < mid.drop_per_m < high.drop_per_m or low.drop_per_m > mid.drop_per_m > high.drop_per_m
    )
    assert mid.duration_s == pytest.approx(1.0 / 0.75)
    for stroke in (low, mid, high):
        assert stroke.activation[0] == stroke.activation[-1] == 0.0
        assert stroke.activation.min() >= 0.0
        assert stroke.activation.max() == 1.0


def test_a_battery_is_what_the_file_says_or_none() -> None:
    assert ROBOT.battery is not None
    assert (ROBOT.battery.count, ROBOT.battery.low_v, ROBOT.battery.full_v) == (4, 10.5, 12.6)
    assert ROBOT.battery.low_v < ROBOT.battery.nominal_v < ROBOT.battery.full_v
    without = ROBOT.toml.replace("[battery]", "[batery]")
    with pytest.raises(InputError, match=r"unknown key 'batery'.*'battery'"):
        parse_robot(without, source="text")
    with pytest.raises(
        InputError, match=r"battery\.low_v is 12\.6 V and battery\.full_v 12\.6 V: a full one"
    ):
        parse_robot(ROBOT.toml.replace("low_v = 10.5", "low_v = 12.6"), source="text")
    table = tomllib.loads(ROBOT.toml)
    del table["battery"]
    assert parse_robot(to_toml(table), source="text").battery is None
    assert load_robot("frog2022-measured").battery == ROBOT.battery


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ("inputs = [0]", r"12\.6 V with battery\.divider 1 is 12\.6 V at an input.*takes 3 V"),
        ("inputs = [0, 0]\ndivider = 5.7", r"inputs are \[0, 0\], battery\.count is 4: give one input"),
        ("inputs = [0, 1, 2, 3, 5]\ndivider = 5.7", r"battery\.count is 4: give one input"),
        ("inputs = [8]\ndivider = 5.7", r"inputs"),
        ("inputs = [0]\ndivider = 0.5", r"divider"),
    ],
)
def test_inputs_that_see_no_battery_are_refused(lines: str, complaint: str) -> None:
    text = ROBOT.toml.replace("[battery]", f"[battery]\n{lines}")
    with pytest.raises(InputError, match=complaint):
        parse_robot(text, source="text")


def test_toml_refuses_what_it_cannot_hold() -> None:
    with pytest.raises(InputError):
        to_toml({"a": math.inf})
    with pytest.raises(InputError):
        to_toml({"a": None})


def test_another_number_of_limbs_follows_from_the_file() -> None:
    """Nothing but the TOML knows of four limbs: a hexagon with six limbs loads and has 6 mask bits."""
    radius = 0.06
    corners = [[radius * math.cos(k * math.pi / 3), radius * math.sin(k * math.pi / 3)] for k in range(6)]

    table = tomllib.loads(ROBOT.toml)
    limb = table["limb"][1]
    table["frame"] |= {"corners_m": corners, "segments": [8] * 6}
    table["limb"] = [{**limb, "name": f"limb{k}", "corner": k, "direction_deg": 60.0 * k} for k in range(6)]
    table["action"] = [{"name": "A", "first": ["limb0", "limb5"], "second": ["limb3"]}]
    table["gait"] = {"lead": ["limb0"], "lag": ["limb5"]}
    robot = parse_robot(to_toml(table), source="six")
    assert len(robot.limbs) == 6
    assert robot.action("A").first_mask == 0b100001
    assert replace(robot, title="x") != robot


def test_fitted_profiles_follow_the_formula_outside_of_the_cycle() -> None:
    profile = ROBOT.profiles[0]
    k = profile.curvature_per_m(np.array([-1.0, 0.0, profile.duration_s, 99.0]))
    assert k == pytest.approx(profile.rest_curvature_per_m)


def test_a_file_on_a_base_has_its_keys_but_those_of_its_own(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('base = "frog2022"\ntitle = "mine"\nperiod_s = 1.5\n')
    mine = load_robot(file)
    assert (mine.title, mine.period_s, mine.frame, mine.profiles) == (
        "mine",
        1.5,
        ROBOT.frame,
        ROBOT.profiles,
    )
    assert parse_robot(mine.toml, "again").sha256 == mine.sha256, "its text is whole"
    measured = load_robot("frog2022-measured")
    assert measured.id == ROBOT.id and len(measured.effects) > 5
    for base, says in (
        ('"frog2021"', "did you mean 'frog2022'"),
        ("3", "base is 3: give one of"),
        ('"other.toml"', "base '.*other.toml' does not exist: check the path"),
        ('"mine.toml"', "base 'mine.toml' is based on this file itself"),
    ):
        file.write_text(f"base = {base}\n")
        with pytest.raises(InputError, match=says) as error:
            load_robot(file)
        assert "\n" not in str(error.value)
    with pytest.raises(InputError, match=r"base is 'x.toml'.*: give one of"):
        parse_robot('base = "x.toml"\n', "a text without a folder")


def test_a_base_may_be_a_file_with_a_base_with_paths_from_its_own_folder(tmp_path: Path) -> None:
    for folder in ("kinds", "mine"):
        (tmp_path / folder).mkdir()
    strokes = (BUILT_IN / "frog2022.profiles.toml").read_text().split("[[profile]]")
    of_alloy = [text for text in strokes if "egain_percent = 10.0" in text]
    (tmp_path / "kinds/strokes.toml").write_text("".join(f"[[profile]]{text}" for text in of_alloy))
    (tmp_path / "kinds/current.py").write_text("")
    (tmp_path / "kinds/long.toml").write_text(
        'base = "frog2022"\nid = "long"\nperiod_s = 1.5\nprofiles_file = "strokes.toml"\n'
        "[limb_default]\nlength_m = 0.03\n[[effect]]\nfile = 'current.py'\nclass = 'Mine'\n"
    )
    (tmp_path / "mine/two.toml").write_text(
        'base = "../kinds/long.toml"\nid = "two"\n[limb_default]\ndrag_width_m = 0.02\n'
    )
    (tmp_path / "mine/three.toml").write_text('base = "two.toml"\nperiod_s = 1.6\n')
    long, two, three = (
        load_robot(tmp_path / f"{name}.toml") for name in ("kinds/long", "mine/two", "mine/three")
    )
    assert long.limbs == tuple(replace(limb, length_m=0.03) for limb in ROBOT.limbs)
    assert two.limbs == three.limbs == tuple(replace(limb, drag_width_m=0.02) for limb in long.limbs)
    assert (two.id, two.period_s, three.id, three.period_s) == ("two", 1.5, "two", 1.6)
    assert two.profiles == long.profiles and len(two.profiles) < len(ROBOT.profiles)
    assert [effect["file"] for effect in (*long.effects, *three.effects)] == [
        "current.py",
        "../kinds/current.py",
    ]
    assert parse_robot(three.toml, "again", three.folder) == three, "its text is whole"
    measured = tmp_path / "measured.toml"
    measured.write_text('base = "frog2022-measured"\nid = "mine"\n')
    assert load_robot(measured).effects == load_robot("frog2022-measured").effects
    (tmp_path / "kinds/long.toml").write_text('base = "../mine/three.toml"\n')
    with pytest.raises(InputError, match="is based on this file itself"):
        load_robot(tmp_path / "mine/two.toml")


def test_a_profiles_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "strokes.toml").write_bytes(b"# \xe9")
    with pytest.raises(InputError, match=r"profiles file 'strokes.toml' is not UTF-8 text \(byte 2\)"):
        parse_robot('base = "frog2022"\nprofiles_file = "strokes.toml"\n', "mine", tmp_path)


def test_a_table_on_a_base_keeps_the_base_s_other_keys(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('base = "frog2022"\n[frame]\ndrag_normal = 0.9\n[limb_default]\nlength_m = 0.03\n')
    mine = load_robot(file)
    assert mine.frame == replace(ROBOT.frame, drag_normal=0.9)
    assert mine.limbs == tuple(replace(limb, length_m=0.03) for limb in ROBOT.limbs)


def test_all_missing_keys_are_named() -> None:
    text = ROBOT.toml.replace("pulse_s = 0.08\n", "", 1).replace("period_s = 1.425\n", "", 1)
    with pytest.raises(InputError, match="keys 'period_s', 'pulse_s' are missing: add them"):
        parse_robot(text, source="my.toml")


def test_a_robot_at_another_period_has_the_text_and_the_hash_of_that_period() -> None:
    # Libraries, logs and the cache of default tables take a robot's text and hash for the robot.
    other = ROBOT.at_period(1.2)
    assert other.period_s == 1.2 and other.profile_frequency_hz == 1.0 / 1.2
    assert parse_robot(other.toml, "1.2 s", ROBOT.folder) == other
    assert other.sha256 != ROBOT.sha256
    assert ROBOT.at_period(1.425 * 1.01) is ROBOT
