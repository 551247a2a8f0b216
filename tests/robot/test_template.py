"""A new robot's file: complete, with a comment on every key, read by every command as it stands."""

from __future__ import annotations

import itertools
import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel
from tests.cli.commands import frogkick
from tests.conftest import from_ci

import frogkick as fk
from frogkick.core.errors import InputError
from frogkick.effects.swims import simulate_actions
from frogkick.front.describing import write_new_robot
from frogkick.robot import built_in_robots, load_robot, mirror_of, robot_warnings
from frogkick.robot.schema import ABOUT, LIMBS_MAX, RobotFile


def keys_of(table: type[BaseModel]) -> set[str]:
    """Every key of the schema below this table, with the table that it is in."""
    found = set()
    for name, field in table.model_fields.items():
        inner = list(re.findall(r"\w+Table", str(field.annotation)))
        if inner:
            module = __import__("frogkick.robot.schema", fromlist=inner)
            found |= {f"{name}.{key}" for key in getattr(module, inner[0]).model_fields}
        elif name != "effect":
            found.add(name)
    return found


def test_every_key_of_a_robot_file_is_described() -> None:
    assert keys_of(RobotFile) == set(ABOUT)
    assert all(about not in ("", "None") for about in ABOUT.values())


@pytest.mark.parametrize("base", built_in_robots())
def test_a_new_robot_is_like_the_one_it_began_from(tmp_path: Path, base: str) -> None:
    mine = write_new_robot(tmp_path / "mine.toml", base)
    old = load_robot(base)
    assert (mine.id, mine.frame, mine.limbs, mine.guard, mine.planner) == (
        "mine", old.frame, old.limbs, old.guard, old.planner,
    )  # fmt: skip
    assert mine.actuation().activation.tolist() == old.actuation().activation.tolist()
    assert load_robot(tmp_path / "mine.toml") == mine
    lines = (tmp_path / "mine.toml").read_text().splitlines()
    reported = {
        line.removeprefix("# ").split(" = ")[0]
        for above, line in itertools.pairwise(lines)
        if above[:2] == "# "
    }
    assert mine.pulse_energy_j is None and "# pulse_energy_j = " in lines, "of the other robot's limbs"
    left_out = ("battery.", "found_from")  # what not every robot has
    assert reported >= {re.sub(r".*\.", "", name) for name in ABOUT if not name.startswith(left_out)}


@pytest.mark.parametrize("base", ["frog2022", "hexapod", "streamlined"])
@pytest.mark.parametrize("limbs", range(1, LIMBS_MAX + 1))
def test_any_number_of_limbs_is_laid_out_in_pairs_and_a_tail(tmp_path: Path, base: str, limbs: int) -> None:
    mine = write_new_robot(tmp_path / "mine.toml", base, limbs)
    assert len(mine.limbs) == limbs
    pairs = [(action.first_mask, action.second_mask) for action in mine.actions]
    assert len(set(pairs)) == len(pairs) > 1 and all(first or not second for first, second in pairs[:-1])
    assert all("curled over the frame edge" in text for text in robot_warnings(mine))
    assert (mirror_of(mine) is not None) == (limbs % 2 == 0)
    names = [limb.name for limb in mine.limbs]
    assert ("tail" in names) == (limbs % 2 == 1)
    assert sum(name.endswith("_left") for name in names) == limbs // 2
    assert "effect" not in tomllib.loads((tmp_path / "mine.toml").read_text())


def test_a_base_with_a_tail_keeps_it(tmp_path: Path) -> None:
    three = write_new_robot(tmp_path / "three.toml", limbs=3)
    longer = replace_in(tmp_path / "three.toml", 'name = "tail"', 'name = "caudal"')
    one = write_new_robot(tmp_path / "one.toml", str(longer), 1)
    five = write_new_robot(tmp_path / "five.toml", str(longer), 5)
    for robot in (one, five):
        tail = next(limb for limb in robot.limbs if limb.name == "tail")
        x, y = robot.frame.corners_m[tail.corner]
        assert y == 0.0 and x == min(x for x, _ in robot.frame.corners_m)
    assert one.frame == three.frame and len(five.frame.corners_m) == 5


def replace_in(file: Path, old: str, new: str) -> Path:
    """Write a file anew with another text."""
    text = file.read_text()
    file.write_text(text.replace(old, new).replace(f'"{old[8:-1]}"', f'"{new[8:-1]}"'))
    return file


@pytest.mark.parametrize("limbs", [2, 6])
def test_laid_out_pairs_swim_straight(tmp_path: Path, limbs: int) -> None:
    robot = write_new_robot(tmp_path / "mine.toml", limbs=limbs)
    x_m, y_m, heading_rad = simulate_actions(robot, ["A", "A"]).pose_world[-1]
    assert x_m > 0.003 and abs(y_m) < 1e-6 and abs(heading_rad) < 1e-5


def test_an_odd_limb_pushes_forward(tmp_path: Path) -> None:
    robot = write_new_robot(tmp_path / "mine.toml", limbs=3)
    assert simulate_actions(robot, ["J"]).pose_world[-1, 0] > 0.0


@from_ci
@pytest.mark.parametrize("limbs", [1, 3, 6, 8])
def test_any_number_of_limbs_has_a_library_and_a_table_and_swims_in_the_pool(
    tmp_path: Path, limbs: int
) -> None:
    robot = write_new_robot(tmp_path / "mine.toml", limbs=limbs)
    table = fk.fit_table(fk.build_library(robot, states=20, seed=0, workers=1))
    run = fk.run(table, fk.paths.line(), robot="pool", seed=0, time_limit_s=20.0)
    assert run.tracking.progress_mps > 0.0 and run.tracking.limit_violations == 0


def test_costs_of_transport_are_unknown_without_the_energy_of_a_pulse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The energy of another robot's limbs is not taken for this one's."""
    for name, text, known in (
        ("slow", "period_s = 1.5\n", True),
        ("long", "[limb_default]\nlength_m = 0.03\n", False),
        ("short", "pulse_s = 0.06\n", False),
        ("own", "pulse_energy_j = 3.0\npulse_s = 0.06\n", True),
    ):
        file = tmp_path / f"{name}.toml"
        file.write_text(f'base = "frog2022"\nid = "{name}"\n{text}')
        assert (load_robot(file).pulse_energy_j is not None) == known, name
    file = tmp_path / "long.toml"
    done = frogkick(capsys, "simulate", file, "--cycles", "2", "--json")
    assert done.code == 0 and done.json["cost_of_transport"] is None and done.json["speed_mps"] > 0.0
    assert "write pulse_energy_j = J of one pulse on one limb in the file of robot 'long'" in done.stderr
    own = frogkick(capsys, "simulate", tmp_path / "own.toml", "--cycles", "2", "--json")
    assert own.json["cost_of_transport"] > 0.0 and "pulse_energy_j" not in own.stderr
    swept = fk.sweep(
        file, egain_percent=[10.0], frequencies_hz=[0.7, 1.0], phases=2, out=tmp_path / "s", workers=1
    )
    again = fk.sweep(
        file, egain_percent=[10.0], frequencies_hz=[0.7, 1.0], phases=2, out=tmp_path / "s", workers=1
    )
    for one in (swept, again):
        assert len(one.fastest) == 2 and not one.most_efficient and "unknown" in one.energy_model
        assert all(row["cost_of_transport"] is None for row in one.as_json()["fastest"])
    assert swept.save(tmp_path / "s")


def test_the_command_writes_it_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "tri.toml"
    done = frogkick(capsys, "robot", "new", file, "--from", "frog2022", "--limbs", "3", "--json")
    assert done.code == 0 and done.json["id"] == "tri" and done.json["limbs"] == 3
    assert frogkick(capsys, "robot", "show", file).code == 0
    text = file.read_text()
    for arguments, says in (
        ((file,), "exists already"),
        ((tmp_path / "x.toml", "--limbs", "9"), "--limbs is 9: give 1 to 8"),
        ((tmp_path / "a b.toml",), "id is 'a b'"),
        ((tmp_path / "x.toml", "--from", "frog2021"), "did you mean 'frog2022'"),
    ):
        output = frogkick(capsys, "robot", "new", *arguments)
        assert output.code == 2 and says in output.stderr and output.stderr.count("\n") == 1, output.stderr
    assert file.read_text() == text and [each.name for each in tmp_path.iterdir()] == ["tri.toml"]
    with pytest.raises(InputError, match="--limbs is 0"):
        write_new_robot(tmp_path / "y.toml", limbs=0)


def test_limits_that_no_firmware_takes_are_seen_before_a_library_is_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "long.toml"
    file.write_text('base = "frog2022"\nid = "long"\n[guard]\npulse_max_s = 0.2\n')
    shown = frogkick(capsys, "robot", "show", file, "--json")
    assert shown.code == 0
    assert [line for line in shown.json["warnings"] if "pulse_max_s of robot 'long' is 0.2 s" in line]
