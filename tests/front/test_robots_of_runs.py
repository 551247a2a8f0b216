"""Which robot is meant: the one in the logs of runs, one with effects that were found, the one in a pool."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from tests.identification.made import WORN, known_outcome, make_run, make_swim
from tests.identification.made import robot as made_robot
from tests.runs import rig

import frogkick as fk
from frogkick.front.identifying import Identification
from frogkick.front.logs import Run, robot_of
from frogkick.identification.outcome import write_robot
from frogkick.identification.segments import segments_of
from frogkick.robot.rewriting import own_id


@pytest.fixture(scope="module")
def robot() -> fk.Robot:
    return made_robot()


@pytest.fixture(scope="module")
def runs(robot: fk.Robot) -> list[fk.Run]:
    made = [make_run([WORN], seed, 4) for seed in (1, 2, 3)]
    return [Run(**vars(dataclasses.replace(run, made={"robot_toml": robot.toml}))) for run in made]


def test_the_robot_of_runs_is_the_one_in_their_logs(
    runs: list[fk.Run], robot: fk.Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [(run, f"run{number}.h5") for number, run in enumerate(runs)]
    assert robot_of(logs) == robot
    said = capsys.readouterr().err
    if robot != fk.load_robot(robot.id):
        assert f"made with a robot {robot.id!r} that differs in frame.segments, limb." in said
    other = dataclasses.replace(robot, pulse_s=0.07, title="another")
    assert robot_of(logs, robot) is robot and not capsys.readouterr().err
    assert robot_of(logs[:1], other) == other
    assert "file differs in pulse_s from the one that is given and used" in capsys.readouterr().err

    def with_text(text: str) -> tuple[fk.Run, str]:
        return dataclasses.replace(runs[0], made={**runs[0].made, "robot_toml": text}), "changed.h5"

    with pytest.raises(
        fk.InputError, match=r"run0.h5' and 'changed.h5' were made with two robots .* pulse_s"
    ):
        robot_of([*logs[:1], with_text(other.toml)])
    planner = dataclasses.replace(robot.planner, depth=robot.planner.depth % 4 + 1)
    assert robot_of([*logs, with_text(dataclasses.replace(robot, planner=planner).toml)]).planner == planner
    own = dataclasses.replace(robot, effects=({"name": "mine", "file": "mine.py"},))
    with pytest.raises(fk.InputError, match="an effect in a file of its own: give the robot's file"):
        robot_of([with_text(own.toml)])
    unknown = [(dataclasses.replace(run, made={}), name) for run, name in logs]
    assert robot_of(unknown) == fk.load_robot(robot.id)
    with pytest.raises(fk.InputError, match="are of robots frog2022, other: give runs of one"):
        robot_of([*unknown, (dataclasses.replace(runs[0], robot_id="other"), "other.h5")])


def test_a_robot_with_effects_that_were_found_has_an_id_of_its_own(tmp_path: Path) -> None:
    swims = [make_swim([WORN], seed, 8) for seed in (1, 2)]
    outcome = known_outcome(swims[:1], swims[1:], "limb_wear rear_left", (0.7, 0.0, 1.0))
    found = Identification(outcome)
    assert (found.robot.id, found.robot.found_from) == ("frog2022-found", "frog2022")
    found.robot.save(tmp_path / "found.toml")
    again = fk.load_robot(tmp_path / "found.toml")
    assert again == found.robot and [effect["name"] for effect in again.effects] == ["limb_wear"]
    of_nominal = segments_of(make_run([], 1, 3), "run", again)
    assert len(of_nominal.start_s) == 3, "it is its own run"
    with pytest.raises(fk.InputError, match="the model is 'hexapod'"):
        segments_of(make_run([], 1, 3), "run", fk.load_robot("hexapod"))
    nothing = Identification(dataclasses.replace(outcome, found=None))
    assert nothing.robot == outcome.robot, "the nominal one"
    others = [
        again,
        dataclasses.replace(again, id="renamed"),
        dataclasses.replace(again, id="frog2022-found9"),
    ]
    assert [own_id(one)["id"] for one in others] == ["frog2022-found2", "frog2022-found", "frog202-found10"]
    assert {own_id(one)["found_from"] for one in others} == {"frog2022"}
    write_robot(tmp_path / "same.toml", outcome)
    assert fk.load_robot(tmp_path / "same.toml").id == "frog2022", "for its own tables"


def test_a_pool_without_the_effects_of_its_model_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    table, robot = fk.load_table(rig.small_table()), rig.robot()
    wear = {"name": "limb_wear", "limb": "rear_left", "gain": 0.7}
    worn = dataclasses.replace(robot, effects=(wear,))
    world = fk.World([fk.effects.LimbWear(limb="rear_left", gain=0.7)])
    capsys.readouterr()  # the table may have been made
    said = []
    for model, pool in ((robot, fk.World()), (worn, world), (worn, fk.World())):
        fk.run(table, "line", model=model, world=pool, time_limit_s=0.5)
        said.append(capsys.readouterr().err)
    assert said[:2] == ["", ""]
    assert "the model 'frog2022' has effects (limb_wear), and the pool has none" in said[2]
