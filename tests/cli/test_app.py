"""What ``frogkick`` says before a command is loaded, and that every command is found."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from enum import EnumType
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import pytest
from typer.testing import CliRunner

import frogkick
from frogkick.cli.app import COMMANDS, LONGER, SECTIONS, STUDY_COMMANDS, app
from frogkick.cli.main import run_command
from frogkick.link.wire import KINDS

GROUPS = {name: place for name, (place, _) in COMMANDS.items() if isinstance(place, dict)}
NAMES = [[name] for name in COMMANDS] + [[group, name] for group in GROUPS for name in GROUPS[group]]
WIDTH = 80


@pytest.mark.parametrize("names", NAMES, ids=" ".join)
def test_every_command_is_found_and_says_what_it_does(names: list[str]) -> None:
    output = CliRunner().invoke(app, [*names, "--help"])
    assert output.exit_code == 0 and output.stdout.startswith(f"Usage: frogkick {' '.join(names)} ")
    assert "--install-completion" not in output.stdout and "╭" not in output.stdout


@pytest.mark.parametrize("group", [[], ["log"], ["study"]], ids=["all", "log", "study"])
def test_the_list_says_each_command_in_one_line(group: list[str]) -> None:
    table = GROUPS[group[0]] if group else COMMANDS
    lines = CliRunner().invoke(app, [*group, "--help"]).stdout.splitlines()
    titles = ["Commands"] if group else list(SECTIONS)
    assert [line[:-1] for line in lines if line.endswith(":") and line != "Options:"] == titles
    rows = lines[lines.index(f"{titles[0]}:") + 1 :]
    listed = [line.split(maxsplit=1) for line in rows if line.startswith("  ")]
    assert sorted(listed) == sorted([name, text] for name, (_, text) in table.items())
    assert max(map(len, lines)) <= WIDTH


@pytest.mark.parametrize("group", GROUPS)
def test_no_sentence_of_a_group_is_cut(group: str) -> None:
    output = CliRunner().invoke(app, [group, "-h"])
    assert output.exit_code == 0 and "Commands:" in output.stdout
    assert not [line for line in output.stdout.splitlines() if line.endswith("...") and "Usage" not in line]
    assert LONGER.get(group, COMMANDS[group][1]) in " ".join(output.stdout.split())


@pytest.mark.parametrize(
    ("words", "offered"), [("frogkick fi", {"firmware"}), ("frogkick camera t", {"track", "tag"})]
)
def test_a_shell_completes_commands(words: str, offered: set[str]) -> None:
    asked = {"_FROGKICK_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    done = subprocess.run(
        [sys.executable, "-m", "frogkick.cli.main"],
        env=os.environ | asked, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert set(done.stdout.split()) == offered, done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="closes streams by a shell")
@pytest.mark.parametrize(("closed", "other"), [(1, "stderr"), (2, "stdout")])
def test_a_closed_stream_is_not_missed(closed: int, other: str) -> None:
    """And what belongs there is not printed to the other one."""
    line = f'exec "$0" -m frogkick.cli.main simulate --actions B --json {closed}>&-'
    done = subprocess.run(
        ["sh", "-c", line, sys.executable], capture_output=True, text=True, check=False
    )  # fmt: skip
    printed = getattr(done, other)
    assert done.returncode == 0 and "Traceback" not in printed
    assert (other == "stdout") is ("speed_mps" in printed)


def test_the_version_is_one_line() -> None:
    output = CliRunner().invoke(app, ["--version"])
    assert (output.exit_code, output.stdout) == (0, f"frogkick {frogkick.__version__}\n")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--help"], 0, "Usage: frogkick "),
        ([], 2, "Usage: frogkick "),
        (["study"], 2, "Usage: frogkick study "),
        (["study", "--help"], 0, "Usage: frogkick study "),
        (["simulat"], 2, "frogkick: No such command 'simulat'. Did you mean 'simulate'?"),
        (["-h"], 0, "Usage: frogkick "),
        (["--version"], 0, "frogkick 0"),
        (["study", "heldot"], 2, "frogkick: No such command 'heldot'. Did you mean 'heldout'?"),
    ],
    ids=["help", "nothing", "group", "group's help", "typo", "h", "version", "group's typo"],
)
def test_nothing_is_loaded_before_a_command_is_known(arguments: list[str], code: int, message: str) -> None:
    """Who asks what there is does not wait for physics and pictures."""
    script = (
        "import sys\n"
        "from frogkick.cli.main import run_command\n"
        f"code = run_command({arguments!r})\n"
        "heavy = {'numpy', 'numba', 'scipy', 'h5py', 'matplotlib', 'cv2', 'asyncio'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "sys.exit(code)"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert run.returncode == code, run.stderr
    assert (run.stderr if code else run.stdout).startswith(message)


def test_no_command_loads_what_it_does_before_it_is_asked_to() -> None:
    """Arguments in, printing out: what is between is loaded when it is called, and not for ``--help``."""
    entries = [entry for table in (COMMANDS, *GROUPS.values()) for entry in table.values()]
    places = [entry if isinstance(entry, str) else entry[0] for entry in entries]
    files = {place.partition(":")[0] for place in places if isinstance(place, str)}
    modules = ", ".join(sorted(f"frogkick.cli.{file}" for file in files))
    later = "{'numpy', 'numba', 'scipy', 'h5py', 'matplotlib', 'cv2', 'frogkick_codegen'}"
    configured = f"[frogkick.cli.research.command(name) for name in {list(STUDY_COMMANDS)}]"
    script = f"import sys, {modules}\n{configured}\nassert not {later} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)


def kinds_in(hint: Any) -> set[Any]:
    """The kinds of value that a type allows, of a list or a sequence those in it."""
    if get_origin(hint) in (Union, UnionType, list, Sequence):
        return set().union(*map(kinds_in, get_args(hint)))
    return {str} if isinstance(hint, EnumType) else {int, hint} if hint is float else {hint}


def test_every_option_goes_to_the_call_or_is_used() -> None:
    """``opt.call`` passes options by their names: one that is named otherwise would be lost in silence.

    A variable that happens to be named as a parameter must not be passed, nor an option of another type.
    """
    calls = 0
    for file in Path(frogkick.__file__).parent.glob("cli/*.py"):
        for command in ast.walk(ast.parse(file.read_text())):
            if not isinstance(command, ast.FunctionDef):
                continue
            inner = [each for statement in command.body for each in ast.walk(statement)]
            names = [each for each in inner if isinstance(each, ast.Name)]
            used = {each.id for each in names}
            imported = {
                name.asname or name.name: (each.module, name.name)
                for each in inner
                if isinstance(each, ast.ImportFrom)
                for name in each.names
            }
            own = {each.id for each in names if isinstance(each.ctx, ast.Store)} | imported.keys()
            for each in inner:
                if isinstance(each, ast.Call) and ast.unparse(each.func) == "opt.call":
                    called = ast.unparse(each.args[0])
                    module, name = imported.get(called, ("frogkick", called.removeprefix("fk.")))
                    function = getattr(importlib.import_module(str(module)), name)
                    known = inspect.signature(function).parameters.keys()
                    options = {argument.arg for argument in command.args.args}
                    keywords = {key.arg for key in each.keywords if key.arg}
                    assert options <= known | used, (command.name, options - known - used)
                    assert keywords <= known, command.name
                    assert not own & known - keywords, (command.name, own & known - keywords)
                    place = importlib.import_module(f"frogkick.cli.{file.stem}")
                    given = get_type_hints(getattr(place, command.name))
                    taken = get_type_hints(inspect.unwrap(function))
                    for option in options & known - keywords:
                        assert kinds_in(given[option]) <= kinds_in(taken[option]), (command.name, option)
                    calls += 1
    assert calls > 10


def test_every_study_has_its_line_its_configuration_and_its_module() -> None:
    from frogkick_studies import configs

    assert configs.STUDIES.keys() == STUDY_COMMANDS.keys()
    for name in configs.STUDIES:
        assert callable(importlib.import_module(f"frogkick_studies.{name}").run)


@pytest.mark.parametrize("command", [("run",), ("push",), ("own",), ("retune",), ("log", "fetch")])
def test_the_help_names_every_kind_of_target(command: tuple[str, ...]) -> None:
    output = CliRunner().invoke(app, [*command, "--help"]).stdout
    assert all(f"{kind}:" in output for kind in KINDS)


def test_numbers_that_stand_twice_are_the_same() -> None:
    """In a command's file once more, so that its help loads nothing else."""
    from frogkick.cli import identify, make, research
    from frogkick.front import parity as parity_of_places
    from frogkick.front import retuning
    from frogkick.library import RECORD_S
    from frogkick.library.fitting import WHOLE_MIN
    from frogkick_codegen.firmware import TARGETS

    assert make.RECORD_S == RECORD_S and list(make.Target) == list(TARGETS)
    assert research.LOOP_DECISIONS == parity_of_places.LOOP_DECISIONS
    assert identify.STATES_LEAST == WHOLE_MIN and identify.STATES == retuning.STATES


@pytest.mark.parametrize(
    ("arguments", "place"),
    [
        (["run", "--dept", "3"], "run"),
        (["library", "build", "--state", "3"], "library build"),
        (["nothing"], ""),
    ],
    ids=["a command", "a group's command", "no command"],
)
def test_a_hint_names_the_help_of_what_was_called(
    arguments: list[str], place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(arguments) == 2
    called = " ".join(["frogkick", *place.split()])
    assert capsys.readouterr().err.endswith(f"(see '{called} --help')\n")


def test_one_option_names_the_robot_s_file_everywhere() -> None:
    """``--robot`` is the robot to talk to in some commands; ``--model`` is the file in all."""
    talks = {"run", "replay", "push", "own", "log fetch", "study twin"}  # of two robots, the last one
    waiting, seen = [[name] for name in COMMANDS], 0
    while waiting:
        names = waiting.pop()
        output = CliRunner().invoke(app, [*names, "--help"]).stdout
        if "\nCommands:\n" in output:
            rows = output.split("\nCommands:\n")[1].splitlines()
            waiting += [[*names, row.split()[0]] for row in rows if row[:3].strip()]
        elif "  --robot" in output and " ".join(names) not in talks:
            assert "  --robot, --model" in output, names
            seen += 1
        assert "--robot" not in output or "--model" in output or " ".join(names) in talks, names
    assert seen > 8


def test_what_a_users_file_prints_is_not_in_the_json(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    lines = "print('loaded')\nclass Says:\n    def flow(self, time_s, at):\n        print('asked')\n"
    (tmp_path / "says.py").write_text(lines + "        return 0.0, 0.0\n")
    told = '\n[[effect]]\nfile = "says.py"\nclass = "Says"\n'
    (tmp_path / "robot.toml").write_text("\ufeff" + frogkick.load_robot("frog2022").toml + told)
    for workers in ([], ["--workers", "2"]):
        if workers:
            words = ["library", "build", str(tmp_path / "robot.toml"), "--states", "1", "--record-s", "0"]
            words += ["--out", str(tmp_path / "l.h5"), *workers]
        else:
            words = ["simulate", str(tmp_path / "robot.toml"), "--actions", "B"]
        assert run_command([*words, "--json"]) == 0
        printed = capfd.readouterr()
        assert isinstance(json.loads(printed.out), dict)
        assert "loaded" in printed.err


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_letters_that_a_terminal_lacks_are_escaped(tmp_path: Path, encoding: str) -> None:
    file = tmp_path / "robot.toml"
    file.write_text('base = "frog2022"\nid = "mine"\ntitle = "\u03b1 na\u00efve"\n', encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "frogkick.cli.main", "robot", "show", file],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": encoding},
        check=False,
    )
    title = "\\u03b1 na\u00efve" if encoding == "cp1252" else "\\u03b1 na\\xefve"
    assert done.returncode == 0, done.stderr
    assert done.stdout.decode(encoding).startswith(f"mine: {title}\n")
