"""Plausible mistakes in Python: each is refused in one line that names what was given and what to give."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import frogkick as fk
from frogkick.front.retune_tables import TableMaker

MISTAKES: dict[str, tuple[Callable[[Any], object], str]] = {
    "an action's number": (lambda _: fk.simulate("frog2022", [1]), "no action 1: choose from A, B"),
    "a number of actions": (lambda _: fk.simulate("frog2022", 3), "actions is 3: give names"),
    "mm/s": (lambda _: fk.simulate("frog2022", "B", velocity_body=(20, 0, 0)), "(20, 0, 0): give forward"),
    "two velocities": (
        lambda _: fk.simulate("frog2022", "B", velocity_body=(0.01, 0)),
        "(0.01, 0): give forward",
    ),
    "one velocity": (lambda _: fk.simulate("frog2022", "B", velocity_body=0.02), "0.02: give forward"),
    "a velocity as text": (lambda _: fk.simulate("frog2022", "B", velocity_body="0,0,0"), "'0,0,0': give"),
    "a frequency as text": (lambda _: fk.simulate("frog2022", frequency_hz="0.7"), "frequency_hz is '0.7'"),
    "half a cycle": (lambda _: fk.simulate("frog2022", cycles=2.5), "cycles is 2.5: give 1 or more"),
    "states as a float": (lambda _: fk.build_library("frog2022", 100.0), "states is 100.0: give 1 to 65535"),
    "states as text": (lambda _: fk.build_library("frog2022", "100"), "states is '100': give 1 to 65535"),
    "a seed as text": (lambda _: fk.build_library("frog2022", 10, "a"), "seed is 'a': give 0 or more"),
    "a seed that no file holds": (
        lambda _: fk.build_library("frog2022", 10, 2**63),
        "a whole number below 2^63",
    ),
    "a number as a sampling": (lambda _: fk.build_library("frog2022", 10, sampling=5), "sampling"),
    "a number as a target": (lambda _: fk.connect(5).__enter__(), "5"),
    "a name as long as no file's": (lambda _: fk.load_robot("x" * 5000), "name a TOML file or one of"),
    "a log's name as long as no file's": (lambda _: fk.load_run("x" * 5000), "name too long; check the path"),
    "a robot as library": (lambda robot: fk.fit_table(robot), "library is given as Robot: give a file"),
    "a robot as table": (lambda robot: fk.load_table(robot), "table image is given as Robot: give a file"),
    "an effect's name as world": (
        lambda _: fk.World("limb_wear"),
        "effects of a world are 'limb_wear': give a list",
    ),
    "an effect without a list": (
        lambda _: fk.World(fk.effects.LimbWear(limb="rear_left")),
        "effects of a world are limb_wear(",
    ),
    "a shape as waypoints": (
        lambda _: fk.paths.from_waypoints("line"),
        "waypoints are not numbers: give (k, 2)",
    ),
    "a path's name first": (
        lambda _: fk.Path("p", [0, 0.1], [0, 0], [0, 0]),
        "x_m is not a row of numbers: give x_m",
    ),
    "a folder to save to": (lambda robot: robot.save("."), "cannot write '.': it is a folder"),
    "a retune of too many states": (
        lambda _: TableMaker(10**9, 0, 1),
        "states is 1000000000: give 1 to 65535",
    ),
    "a retune of too few states": (lambda _: TableMaker(45, 0, 1), "states is 45: give 46 or more"),
    "a retune with a negative seed": (lambda _: TableMaker(800, -1, 1), "seed is -1: give 0 or more"),
    "a table as runs": (lambda robot: fk.identify(robot, test=[robot]), "runs are given as Robot: give runs"),
    "a run to train on and to test": (
        lambda _: fk.identify(["a.h5", "b.h5"], test="./b.h5"),
        "run 'b.h5' is a training run and a test run: its test would show how well it was fitted",
    ),
    "a robot to emit": (
        lambda robot: fk.emit_c(robot, "emitted"),
        "table image is given as Robot: give a file",
    ),
}
OF_A_TABLE: dict[str, tuple[Callable[[Any], object], str]] = {
    "a number to save to": (lambda t: t.save(3), "file to write is given as int: give its name"),
    "a robot where it is": (lambda t: fk.run(t, robot=t.robot), "--robot is Robot('frog2022'"),
    "a seed that no log holds": (lambda t: fk.run(t, seed=2**63), "a whole number below 2^63"),
    "a folder as a log": (lambda t: fk.run(t, out="."), "is a folder: name a file in it"),
    "a log where none can be": (lambda t: fk.run(t, out="/proc/r.h5"), "cannot write '/proc/r.h5'"),
    "a number as a plan": (lambda t: fk.run(t, plan=5), "5"),
    "a number as a planner": (lambda t: fk.Planner(t, planner=5), "5"),
    "a seed with a point": (lambda t: fk.run(t, seed=1.5), "seed is 1.5: give 0 or more"),
    "seconds as text": (lambda t: fk.run(t, time_limit_s="30"), "simulated time is '30' s: give"),
    "a depth as text": (lambda t: fk.Planner(t, depth="3"), "--depth is '3', but the planner looks 1"),
    "a pose alone": (lambda t: fk.Planner(t).plan([0, 0, 0], "line"), "state is [0, 0, 0]: give six numbers"),
    "degrees as radians": (
        lambda t: fk.Planner(t).plan([0, 0, 90, 0, 0, 0], "line"),
        "the heading of the state is 90 rad, which is more than two turns: give radians, not degrees",
    ),
    "a table as library": (lambda t: fk.fit_table(t), "library is given as Table: give a file"),
    "a limb's number": (
        lambda t: fk.run(t, world=fk.World([fk.effects.LimbWear(limb=2, gain=0.7)])),
        "has no limb 2: it has front_right",
    ),
}


@pytest.fixture(scope="module")
def robot() -> fk.Robot:
    return fk.load_robot("frog2022")


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_in_one_line(mistake: str, robot: fk.Robot) -> None:
    do, told = MISTAKES[mistake]
    with pytest.raises(fk.InputError) as refused:
        do(robot)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_mistyped_name_of_the_front_door_gets_the_nearest() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'identfy' \(did you mean 'identify'\?\)"):
        _ = fk.identfy


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> fk.Table:
    return fk.fit_table(fk.build_library("frog2022", 2, workers=1))


@pytest.mark.parametrize("mistake", OF_A_TABLE)
def test_a_mistake_with_a_table_is_told_in_one_line(mistake: str, table: fk.Table) -> None:
    do, told = OF_A_TABLE[mistake]
    with pytest.raises(fk.InputError) as refused:
        do(table)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_budget_as_text_is_told(robot: fk.Robot, table: fk.Table) -> None:
    library = fk.build_library(robot, 2, workers=1)
    with pytest.raises(fk.InputError, match="budget is '64' KiB: give"):
        fk.fit_table(library, budget_kib="64")
