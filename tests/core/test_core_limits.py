"""The guard's limits come from the robot's file, and the build refuses what no robot may have."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.core.core import Robot, library, mutated, source_files
from tests.planner import synthetic

from frogkick.core.errors import InputError
from frogkick.link.layout import link_layout
from frogkick.planner.plan import PlanConfig, on_robot, transitions_of
from frogkick.robot import load_robot
from frogkick.runs.decision import LIMB_USE_FIELDS, STATE_FIELDS
from frogkick.tables.image import open_image
from frogkick_codegen.firmware import robot_config
from frogkick_codegen.toolchain import ToolchainError

ROBOT = load_robot("frog2022")


@pytest.mark.parametrize("robot_id", ["frog2022", "streamlined", "hexapod", "frog2022-measured"])
def test_the_limits_in_the_core_are_those_of_the_robot_s_file(robot_id: str) -> None:
    guard, config = load_robot(robot_id).guard, robot_config(load_robot(robot_id))
    for name, value in (
        ("PULSE_MAX_US", guard.pulse_max_s * 1e6),
        ("REST_MIN_US", guard.rest_min_s * 1e6),
        ("DUTY_WINDOW_US", guard.duty_window_s * 1e6),
        ("DUTY_ON_MAX_US", guard.duty_max * guard.duty_window_s * 1e6),
        ("LIMBS_AT_ONCE_MAX", guard.limbs_at_once_max),
        ("FIX_FRESH_US", guard.fix_fresh_s * 1e6),
        ("FIX_LOST_US", guard.fix_lost_s * 1e6),
    ):
        assert f"#define FK_{name} {round(value)}u\n" in config


def test_the_ten_percent_robot_has_the_limits_of_its_limbs() -> None:
    guard = ROBOT.guard
    assert (guard.pulse_max_s, guard.rest_min_s, guard.limbs_at_once_max) == (0.1, 0.5, 2)
    assert (guard.duty_max, guard.duty_window_s) == (0.08, 5.0)
    assert (guard.fix_fresh_s, guard.fix_lost_s) == (0.5, 2.0)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("pulse_max_s", 0.1001, "guard.pulse_max_s of robot 'frog2022' is 0.1001 s.* takes 1e-06 to 0.1 s"),
        ("rest_min_s", 0.09, "0.1 to 60"),
        ("duty_window_s", 61.0, "0.1 to 60"),
        ("duty_window_s", 0.05, "0.1 to 60"),
        ("duty_window_s", 7.5, "is 7.5 s: for so many rests .* at most 7.499 s, or a longer guard"),
        ("rest_min_s", 0.333, "is 5 s: for so many rests .* at most 4.994 s"),
        ("limbs_at_once_max", 7, "is 5 s: for so many rests .* at most 4.999 s"),
        ("duty_max", 1.0, "which limits nothing"),
        ("fix_fresh_s", 0.51, "1e-06 to 0.5"),
        ("fix_lost_s", 2.1, "0.5 to 2 s"),
        ("fix_lost_s", 0.4, "0.5 to 2 s"),
    ],
)  # fmt: skip
def test_a_limit_that_is_none_is_refused(name: str, value: float, words: str) -> None:
    robot = replace(ROBOT, guard=replace(ROBOT.guard, **{name: value}))
    with pytest.raises(InputError, match=words):
        robot_config(robot)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("FK_PULSE_MAX_US 100000u", "FK_PULSE_MAX_US 100001u"),
        ("FK_PULSE_MAX_US 100000u", "FK_PULSE_MAX_US 0u"),
        ("FK_REST_MIN_US 500000u", "FK_REST_MIN_US 99999u"),
        ("FK_DUTY_WINDOW_US 5000000u", "FK_DUTY_WINDOW_US 7499800u"),
        ("FK_LIMBS_AT_ONCE_MAX 2u", "FK_LIMBS_AT_ONCE_MAX 7u"),
        ("FK_DUTY_ON_MAX_US 400000u", "FK_DUTY_ON_MAX_US 5000000u"),
        ("FK_LIMBS_AT_ONCE_MAX 2u", "FK_LIMBS_AT_ONCE_MAX 9u"),
        ("FK_LIMBS_AT_ONCE_MAX 2u", "FK_LIMBS_AT_ONCE_MAX 0u"),
        ("FK_FIX_FRESH_US 500000u", "FK_FIX_FRESH_US 500001u"),
        ("FK_FIX_LOST_US 2000000u", "FK_FIX_LOST_US 2000001u"),
    ],
)
def test_the_compiler_refuses_a_header_beyond_the_ceilings(old: str, new: str) -> None:
    assert old in source_files()["fk_robot_config.h"].decode()
    with pytest.raises(ToolchainError, match="limit_is_a_limit"):
        library(mutated("fk_robot_config.h", old, new))


def test_a_search_in_a_table_whose_states_are_all_alike_ends_early() -> None:
    """By as many transitions as on the host; a table whose first level takes too long is refused."""
    for states, levels, period_us in (
        (1200, 7, 1_425_000), (4096, 12, 1_425_000), (4096, 12, 250_000), (4096, 12, 10_000),
        (20_000, 12, 1_425_000),
    ):  # fmt: skip
        times = {"period_us": period_us, "pulse_us": 1000, "second_delay_us": 1000}
        image = synthetic.alike(states, levels, **times)
        robot = Robot(image).begin("DISARMED")
        robot.path()
        for name in ("ANGLE_WEIGHT_PER_RAD", "PROGRESS_WEIGHT", "LEVEL_WEIGHT", "COST", "TRANSITIONS_MAX"):
            assert robot.status("PARAM", {"parameter": link_layout().parameter[name], "value": 0.0}) == "OK"
        state = dict.fromkeys(STATE_FIELDS, 0.0) | {"x_m": 0.2, "y_m": 0.3}
        answer = robot.ask(
            "PLAN", {"depth": 4, **state, **dict.fromkeys(LIMB_USE_FIELDS, 0), "along_points": 0.0}
        )
        most = transitions_of(open_image(image))
        assert answer["status"] == 0 and answer["transitions"] == min(9 + 81 + 729 + 6561, most)
        assert on_robot(PlanConfig(transitions_max=0), open_image(image)).transitions_max == most
    image_count = -26
    for states in (32_000, 60_000):
        image = synthetic.alike(states, 13)
        assert transitions_of(open_image(image)) < 9
        assert Robot(image).error == image_count
