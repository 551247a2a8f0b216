"""Actions that are called by words: written, swum, run, drawn exported by them; a table stays as it is."""

from __future__ import annotations

import csv
import json
import re
import string
from pathlib import Path

import pytest
from tests.cli.commands import frogkick
from tests.conftest import from_ci
from tests.runs import rig

import frogkick as fk
from frogkick.core.errors import InputError
from frogkick.robot import in_a_row, parse_robot

WORDS = {"A": "hop", "B": "kick", "C": "veer-left", "D": "veer_right", "F": "A", "I": "Glide"}


def worded(text: str) -> str:
    """A robot's TOML with words for letters."""
    for letter, word in WORDS.items():
        text = text.replace(f'name = "{letter}"\n', f'name = "{word} "\n')
    return text.replace(' "\n', '"\n')


@from_ci
def test_a_robot_whose_actions_are_words_swims_by_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert frogkick(capsys, "robot", "new", "tri.toml", "--from", "frog2022", "--limbs", "3").code == 0
    file = Path("tri.toml")
    letters = fk.load_robot(file)
    file.write_text(worded(file.read_text()))
    robot = fk.load_robot(file)
    names = {action.name for action in robot.actions}
    assert names >= {"hop", "kick", "A", "Glide"} and len(robot.actions) == len(letters.actions)

    again = frogkick(capsys, "robot", "new", "other.toml", "--from", "tri.toml")
    assert again.code == 0 and {action.name for action in fk.load_robot("other.toml").actions} == names
    shown = frogkick(capsys, "robot", "show", file)
    assert "actions hop kick" in shown.stdout and "action Glide: none; then none" in shown.stdout
    swum = [
        frogkick(capsys, "simulate", each, "--actions", row, "--json").json
        for each, row in ((file, "kick,GLIDE,A"), (file, "kick"), ("frog2022", "BC"), ("frog2022", "b,c"))
    ]
    assert swum[0] != swum[1] and swum[2] == swum[3]
    wrong = frogkick(capsys, "simulate", file, "--actions", "kik")
    assert wrong.code == 2 and "choose from hop, kick, " in wrong.stderr

    made = ("library", "build", file, "--states", "8", "--workers", "1", "--record-s", "0", "--out", "lib.h5")
    assert frogkick(capsys, *made).code == 0
    assert frogkick(capsys, "tables", "build", "lib.h5", "--test-states", "4", "--out", "tri.fkt").code == 0
    run = frogkick(
        capsys, "run", "--robot", "pool", "--tables", "tri.fkt", "--simulated-time", "6", "--out", "run.h5"
    )
    assert run.code in (0, 1), run.stderr
    log = fk.load_run("run.h5")
    assert set(log.actions) <= names and log.log.action_names == tuple(a.name for a in robot.actions)
    assert set() < set(re.findall(r", (\S+) cost ", run.stderr)) <= set(log.actions)
    output = frogkick(capsys, "log", "show", "run.h5", "--out", "run.png", "--json").json
    assert set(output["actions"]) == set(log.actions) and Path("run.png").stat().st_size
    replayed = frogkick(
        capsys, "replay", "run.h5", "--model", file, "--tables", "tri.fkt", "--robot", "pool", "--json"
    )
    assert replayed.json["actions"] == replayed.json["recorded_actions"] == in_a_row(log.actions)
    assert "was planned with table" not in replayed.stderr
    fk.replay("run.h5", table=fk.fit_table(fk.build_library(file, 8, seed=1, workers=1)), plan="host")
    assert "was planned with table" in capsys.readouterr().err
    assert frogkick(capsys, "export", "run.h5", "--csv", "--out", "csv").code == 0
    rows = list(csv.DictReader(Path("csv/decisions.csv").read_text(encoding="utf-8").splitlines()))
    assert tuple(row["action_name"] for row in rows) == log.actions
    assert json.loads(Path("csv/run.json").read_text())["actions"] == [a.name for a in robot.actions]
    planned = fk.Planner(fk.load_table("tri.fkt")).plan([0.0] * 6, "line")
    assert set(planned.actions) <= names


def test_an_image_is_the_same_whatever_its_actions_are_called() -> None:
    letters = rig.robot()
    assert "".join(letters.action_codes) == "".join(action.name for action in letters.actions) == "ABCDEFGHI"
    words = parse_robot(worded(letters.toml), "mine.toml")
    # "A" is the name of one of them, so the others take the next free ones.
    assert "".join(words.action_codes) == "BCDFEAGHI"
    many = [{"name": f"act-{k}", "first": [], "second": []} for k in range(32)]
    table = fk.load_robot("frog2022").toml
    table = table[: table.index("[[action]]")] + table[table.index("[gait]") :]
    rows = "".join(f'[[action]]\nname = "{each["name"]}"\nfirst = []\nsecond = []\n' for each in many)
    assert "".join(parse_robot(table + rows, "mine.toml").action_codes) == string.ascii_uppercase + "abcdef"
    with pytest.raises(InputError, match="there are 33 actions: a table has room for 32"):
        parse_robot(table + rows + '[[action]]\nname = "one-more"\nfirst = []\nsecond = []\n', "mine.toml")


@pytest.mark.parametrize("name", ['"two words"', '"7up"', '""', "7", '"abcdefghijklmnopqrstu"', '"nöt"'])
def test_other_names_are_refused_in_one_line(name: str) -> None:
    with pytest.raises(
        InputError, match=r"action.1.name is .*: give a letter, or a word of up to 20"
    ) as raised:
        parse_robot(rig.robot().toml.replace('name = "B"', f"name = {name}"), "mine.toml")
    assert "\n" not in str(raised.value)
    text = rig.robot().toml.replace('name = "B"', 'name = "kick"')
    with pytest.raises(InputError, match="two actions are called 'KICK'"):
        parse_robot(text.replace('name = "C"', 'name = "Kick"'), "mine.toml")
