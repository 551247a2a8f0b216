"""Checks before a robot is armed: what is refused, and what is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.conftest import REPOSITORY
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.front.bench import Bench, parse_begin, placed
from frogkick.paths import shape
from frogkick.robot.schema import Battery
from frogkick.runs.start_checks import check_battery, check_start, look

POOL_M = (1.2, 0.9)


def fixes(*places: tuple[float, float]) -> list[Fix]:
    return [Fix(0.1 * k, 0.0, *xy, 0.3, sequence=k) for k, xy in enumerate(places)]


AT_REST = fixes(*[(0.3, 0.4)] * 10)
LINE = placed(shape("line"), (), "0.3,0.4,20", (0.0, 0.0, 0.0))[0]


def test_a_robot_on_its_path_in_the_pool_may_swim() -> None:
    assert check_start(AT_REST, LINE, POOL_M) == [
        "position fixes: 10 in 1 s, at most 0.0 mm apart",
        "path: inside the pool; the robot is 0 mm from it",
    ]
    unknown = "path: not compared with the pool, whose size is not known; the robot is 0 mm from it"
    assert check_start(AT_REST, LINE, None)[1] == unknown


def test_batteries_that_nobody_measured_are_said_to_be_unknown_and_how_to_measure_them() -> None:
    said = check_battery(rig.robot(), None)
    assert said == (
        "battery: unknown, not measured by this robot: measure it at each battery's plug, at rest (4 of "
        "them, 10.5 V is low, 12.6 V full) and give the lowest voltage, as --battery-v 11.1"
    )
    battery = rig.robot().battery
    assert battery is not None and not battery.inputs
    seen = replace(rig.robot(), battery=replace(battery, inputs=(0, 1), divider=5.7))
    assert check_battery(seen, None) == (
        "battery: the robot measures 2 of 4 itself, and cannot be armed below 10.5 V"
    )
    page = (REPOSITORY / "host/docs/pages/tutorials/first-day.md").read_text(encoding="utf-8")
    for word in ("--battery-v", "12.6 V", "10.5 V", "battery: unknown, not measured by this robot"):
        assert word in page, word
    assert check_battery(replace(rig.robot(), battery=None), None) == (
        "battery: unknown, not measured, and frog2022 has no [battery] in its file"
    )


def test_batteries_that_are_charged_are_said_to_be() -> None:
    for measured_v in (10.5, 11.4, 12.6, 13.0):
        assert check_battery(rig.robot(), measured_v) == (
            f"battery: {measured_v:g} V, measured by hand (10.5 V is low, 12.6 V full)"
        )


@pytest.mark.parametrize(
    ("measured_v", "complaint"),
    [
        (
            10.49,
            r"^the battery has 10\.49 V, 10\.5 V is the least for frog2022: charge all 4 together, to 12\.6",
        ),
        (3.9, r"has 3\.9 V, 10\.5 V is the least"),
        (
            14.8,
            r"--battery-v is 14\.8, a full battery of frog2022 has 12\.6 V: measure again, at each battery's",
        ),
        (0.0, "--battery-v is 0, a full"),
        (-11.0, "--battery-v is -11, a full"),
        (float("nan"), "--battery-v is nan, a full"),
        (float("inf"), "--battery-v is inf, a full"),
    ],
)
def test_batteries_that_are_low_or_none_are_refused(measured_v: float, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        check_battery(rig.robot(), measured_v)


def test_a_robot_with_one_battery_and_one_that_does_not_say() -> None:
    one = replace(rig.robot(), battery=Battery(1, 3.7, 3.5, 4.2, "at its plug"))
    with pytest.raises(
        InputError, match=r"has 3\.4 V, 3\.5 V is the least for frog2022: charge it, to 4\.2 V"
    ):
        check_battery(one, 3.4)
    with pytest.raises(InputError, match=r"frog2022 has no limit for it: add \[battery\] to its"):
        check_battery(replace(one, battery=None), 3.9)


@pytest.mark.parametrize(
    ("seen", "path", "complaint"),
    [
        (AT_REST[:1], LINE, r"1 position fixes came in 1 s, 2 are needed"),
        (fixes((0.3, 0.4), (0.3, 0.4), (0.35, 0.4)), LINE, r"jump by 50 mm while the robot rests, 20 are"),
        (AT_REST, shape("line"), r"path reaches from \(0\.00, .* the pool is 1\.2 x 0\.9 m"),
        (fixes(*[(1.0, 0.8)] * 3), LINE, r"the robot is 0\.[0-9]+ m from its path, 0\.3 are allowed"),
    ],
)
def test_what_can_only_fail_is_refused(seen: list[Fix], path: object, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        check_start(seen, path, POOL_M)


@pytest.mark.parametrize("name", ["line", "sine", "ellipse"])
def test_a_path_begins_where_and_as_it_is_told(name: str) -> None:
    path = placed(shape(name), (), "0.5,0.2,90", (9.0, 9.0, 9.0))[0]
    assert path.points_m[0] == pytest.approx([0.5, 0.2], abs=1e-6)
    assert float(path.tangent_rad[0]) == pytest.approx(np.pi / 2.0, abs=1e-6)
    assert path.length_m == pytest.approx(shape(name).length_m, rel=1e-5)
    here = placed(shape(name), (), "here", (0.1, 0.3, -1.0))[0]
    assert here.points_m[0] == pytest.approx([0.1, 0.3], abs=1e-6)
    assert float(here.tangent_rad[0]) == pytest.approx(-1.0, abs=1e-6)
    same = placed(shape(name), (), None, (0.1, 0.3, -1.0))[0]
    assert np.array_equal(same.points_m, shape(name).points_m)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "a,b,c", "nan,0,0", "1e9,0,0"])
def test_where_a_path_begins_must_be_three_numbers(text: str) -> None:
    with pytest.raises(InputError, match="--begin is"):
        parse_begin(text)
    with pytest.raises(InputError, match="--begin is"):
        Bench("serial:frog", "stdin", begin=text)


def test_a_look_takes_what_comes_in_a_second() -> None:
    now_s = [0.0]

    class Source:
        def advance(self, until_s: float) -> list[Fix]:
            return AT_REST[:1]

    def wait(seconds: float) -> None:
        now_s[0] += seconds

    assert 95 <= len(look(Source(), lambda: now_s[0], wait)) <= 105
