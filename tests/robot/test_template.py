"""A new robot's file: complete, with a comment on every key, read by every command as it stands."""

from __future__ import annotations

import itertools
import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel
from tests.cli.commands import frogkick

from frogkick.core.errors import InputError
from frogkick.front.describing import write_new_robot
from frogkick.robot import built_in_robots, load_robot, robot_warnings
from frogkick.robot.schema import ABOUT, RobotFile


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
    reported = {line.split(" = ")[0] for above, line in itertools.pairwise(lines) if above[:2] == "# "}
    assert reported >= {re.sub(r".*\.", "", name) for name in ABOUT if not name.startswith("battery.")}


@pytest.mark.parametrize("limbs", [1, 2, 3])
def test_fewer_limbs_have_the_actions_that_they_can_do(tmp_path: Path, limbs: int) -> None:
    mine = write_new_robot(tmp_path / "tri.toml", "frog2022", limbs)
    assert len(mine.limbs) == limbs
    pairs = [(action.first_mask, action.second_mask) for action in mine.actions]
    assert len(set(pairs)) == len(pairs) > 1 and all(first or not second for first, second in pairs)
    assert not [text for text in robot_warnings(mine) if "no action fires" in text]
    assert "effect" not in tomllib.loads((tmp_path / "tri.toml").read_text())


def test_the_command_writes_it_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "tri.toml"
    done = frogkick(capsys, "robot", "new", file, "--from", "frog2022", "--limbs", "3", "--json")
    assert done.code == 0 and done.json["id"] == "tri" and done.json["limbs"] == 3
    assert frogkick(capsys, "robot", "show", file).code == 0
    text = file.read_text()
    for arguments, says in (
        ((file,), "exists already"),
        ((tmp_path / "x.toml", "--limbs", "5"), "--limbs is 5, robot 'frog2022' has 4"),
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
