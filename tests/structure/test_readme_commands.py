"""Commands that Markdown files show, in blocks or in code spans, exist with the options shown.

What the commands do is tested with their own parts; here nothing is run but ``--help``.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer
import typer.main
from tests.conftest import REPOSITORY
from tests.structure.test_repository import tracked

from frogkick.cli.app import LazyGroup, app
from frogkick.cli.main import run_command
from frogkick.runs.recorded.table import read_table

BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```[ \t]*$", re.MULTILINE | re.DOTALL)
SHELLS = ("", "sh", "bash", "console")
SPAN = re.compile(r"`((?:frogkick|make) [^`\n]+)`")
OURS = re.compile(r"(?:\w+=\S* )*(?:\S*/)?(?:frogkick|make)(?: |$)")  # NAME=value may stand before it
TARGET = re.compile(r"^([a-z][\w-]*):", re.MULTILINE)


def shell_lines(markdown: str) -> list[str]:
    """Return the commands of shell blocks (lines joined, prompts taken off, pipes cut) and of code spans."""
    lines: list[str] = []
    for language, block in BLOCK.findall(markdown):
        for line in block.replace("\\\n", " ").splitlines() if language.strip() in SHELLS else []:
            text = line.strip().removeprefix("$ ")
            lines += (
                [part.strip() for part in re.split(r"&&| \| ", text)]
                if text and not text.startswith("#")
                else []
            )
    return lines + SPAN.findall(BLOCK.sub("", markdown))


HELP: dict[tuple[str, ...], str] = {}
"""What was asked for before: the same few commands stand in many lines."""


def help_of(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return what ``frogkick WORDS --help`` prints, or "" where there is no such command."""
    if tuple(words) not in HELP:
        code = run_command([*words, "--help"])
        printed = capsys.readouterr()
        HELP[tuple(words)] = printed.out if code == 0 else ""
    return HELP[tuple(words)]


def problem(line: str, makefile: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Return what is wrong with a line, or "" where it is sound or none of our commands."""
    if not OURS.match(line):
        return ""
    words = shlex.split(line, comments=True)
    while re.fullmatch(r"\w+=\S*", words[0]):
        words.pop(0)
    name, words = Path(words[0]).name, words[1:]
    if name == "make":
        targets = {word for word in words if not word.startswith("-") and "=" not in word}
        missing = sorted(targets - set(TARGET.findall(makefile)))
        return f"{line!r}: the Makefile has no target {', '.join(missing)}" if missing else ""
    if words and words[0].isupper():  # stands for a command
        return ""
    text = help_of(words[:1] if words and not words[0].startswith("-") else [], capsys)
    if not text:
        return f"{line!r}: no such command"
    if re.search(r"Usage: .* COMMAND ", text) and len(words) > 1 and not words[1].startswith("-"):
        text = help_of(words[:2], capsys)
        if not text:
            return f"{line!r}: no such command"
    shown = [word.split("=", 1)[0] for word in words if word.startswith("--") and word != "--"]
    known = set(re.findall(r"--[a-z][\w-]*", text))
    missing = [option for option in shown if option not in known]
    if missing:
        return f"{line!r}: no such option: {', '.join(missing)}"
    said = refusal([word for word in words if word != "..."])
    return f"{line!r}: {said}" if said else ""


def refusal(words: list[str]) -> str:
    """Return what a command says against its words, or "". What is merely incomplete may stand in prose."""
    command = typer.main.get_command(app)
    context = command.make_context("frogkick", words[:1], resilient_parsing=True)
    while words and isinstance(command, LazyGroup) and not words[0].startswith("-"):
        command, words = command.get_command(context, words[0]), words[1:]
    if isinstance(command, LazyGroup) or {"-h", "--help"} & set(words):
        return ""
    try:
        command.make_context("frogkick", list(words))
    except Exception as error:
        incomplete = type(error).__name__ in ("MissingParameter", "BadOptionUsage", "NoArgsIsHelpError")
        return "" if incomplete else str(getattr(error, "format_message", error.__str__)())
    return ""


def test_the_commands_of_every_readme_exist(capsys: pytest.CaptureFixture[str]) -> None:
    makefile = (REPOSITORY / "Makefile").read_text()
    found = []
    for name in tracked():
        if Path(name).suffix == ".md":
            for line in shell_lines((REPOSITORY / name).read_text()):
                for command in line.split(" | "):
                    wrong = problem(command, makefile, capsys)
                    found += [f"{name}: {wrong}"] if wrong else []
    assert found == []


def test_the_readme_shows_the_two_commands_that_matter() -> None:
    lines = shell_lines((REPOSITORY / "README.md").read_text())
    assert {"make demo", "make test"} <= {line.split("#")[0].strip() for line in lines}


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("make demo test-full  # all", ""),
        ("FK_LEVEL=full make -j2 test PYTHON=python3.11", ""),
        ("make coffee", "no target coffee"),
        ("frogkick --help", ""),
        (".venv/bin/frogkick library build frog2022 --states 10 --out lib.h5", ""),
        ("frogkick librarian build", "no such command"),
        ("frogkick library bild", "no such command"),
        ("frogkick codegen x.fkt --outt DIR", "no such option: --outt"),
        ("frogkick library build --bogus", "no such option: --bogus"),
        ("frogkick tables build lib.h5 --kind nearst", "'nearst' is not one of"),
        ("frogkick run --depth 9 --path line", "less than or equal to 4"),
        ("frogkick log show a.h5 b.h5", "unexpected extra argument"),
        ("frogkick run --battery-v", ""),
        ("frogkick study verdicts --kind weeds ... --out outside", ""),
        ("frogkick COMMAND --help", ""),
        ("ls -l", ""),
        ("frogkick.toml --> don't parse", ""),
    ],
)
def test_a_wrong_command_is_found(line: str, wrong: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = problem(line, (REPOSITORY / "Makefile").read_text(), capsys)
    assert wrong in found
    assert bool(wrong) == bool(found)


def test_shell_blocks_and_code_spans_are_read() -> None:
    text = (
        "```sh\n# why\n$ make a && make b\nfrogkick run \\\n  --depth 1\n```\n"
        "```\nmake c\n```\n```toml\nmake = 1\n```\nSee `make d`, `frogkick.x` and `frogkick e --f`.\n"
    )
    assert shell_lines(text) == [
        "make a", "make b", "frogkick run    --depth 1", "make c", "make d", "frogkick e --f",
    ]  # fmt: skip


BRACES = re.compile(r"\{([^{}]*,[^{}]*)\}")


def data_files(word: str, folder: Path) -> list[Path]:
    """Return what a shell makes of a word with ``DATA_DIR`` in it: braces first, then wildcards."""
    if braces := BRACES.search(word):
        parts = braces.group(1).split(",")
        return [file for part in parts for file in data_files(word.replace(braces.group(), part, 1), folder)]
    return sorted(folder.glob(word.removeprefix("DATA_DIR/")))


def test_runs_that_the_documentation_names_are_recorded_runs(frog2022_dir: Path) -> None:
    pages = [REPOSITORY / "README.md", *sorted((REPOSITORY / "host" / "docs" / "pages").rglob("*.md"))]
    words = [
        word
        for page in pages
        for line in shell_lines(page.read_text())
        if "DATA_DIR/" in line
        for word in shlex.split(line)
        if word.startswith("DATA_DIR/") and word.endswith(".csv")
    ]
    assert words != []
    for word in words:
        files = data_files(word, frog2022_dir)
        assert len(files) == 7, word
        for file in files:
            read_table(file)  # the path's own file beside a run is refused
