"""What is tracked: the top level, no traces of one machine, no unfinished marks, no long files."""

from __future__ import annotations

import configparser
import os
import re
import subprocess
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from tests.conftest import REPOSITORY

NEEDED = {
    "host", "firmware", "codegen", "tests", "README.md", "pyproject.toml", "Makefile", "CHANGELOG.md",
    "LICENSE", ".ci", ".gitignore", "requirements.lock",
}  # fmt: skip
ALLOWED = {".gitattributes", ".editorconfig"}
LINES_MAX = 450
# Put together here, so that this file passes its own checks.
MARKS = re.compile(r"\b(?:" + "|".join(("TO" + "DO", "FIX" + "ME", "X" * 3)) + r")\b|@[A-Z][A-Z0-9_]*" + "@")
REGISTRIES = (
    "pypi" + ".org", "pythonhosted" + ".org", "npmjs" + ".org", "npmjs" + ".com", "deb.debian" + ".org",
    "security.debian" + ".org", "proxy.golang" + ".org", "crates" + ".io", "maven" + ".org",
)  # fmt: skip


def tracked(root: Path = REPOSITORY) -> list[str]:
    """Return the files that git tracks, relative to the root."""
    if not (root / ".git").exists():
        pytest.skip("not a git checkout: nothing says which files are tracked")
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True)
    return [name for name in listing.stdout.split("\0") if name and (root / name).is_file()]


def texts() -> dict[str, str]:
    """Return the tracked files that are text."""
    contents = {name: (REPOSITORY / name).read_bytes() for name in tracked()}
    return {name: content.decode("utf-8") for name, content in contents.items() if b"\0" not in content}


def machine_paths() -> list[str]:
    """Return the folders that only this machine has: this repository and the home folder, if any."""
    folders = {str(REPOSITORY), *([str(Path.home())] if Path.home().is_dir() else [])}
    return sorted(folder for folder in folders if len(folder) > 1)


def registry_hosts() -> list[str]:
    """Return the public registries' hosts and those that this machine is set up with."""
    urls = [value for name, value in os.environ.items() if name.endswith(("INDEX_URL", "_REGISTRY"))]
    for file in (Path("/etc/pip.conf"), Path.home() / ".config/pip/pip.conf", Path.home() / ".pip/pip.conf"):
        if file.is_file():
            parser = configparser.ConfigParser(interpolation=None)
            parser.read(file)
            urls += [value for section in parser.values() for value in section.values()]
    hosts = {urlsplit(url).hostname or "" for text in urls for url in text.split()}
    return sorted({*REGISTRIES, *(host for host in hosts if "." in host and not host.startswith("127."))})


def path_pattern(folders: list[str]) -> re.Pattern[str]:
    """Match a folder's name where it is a path of its own and not part of a longer word."""
    return re.compile(r"(?<![\w.~})-])(?:" + "|".join(map(re.escape, folders)) + r")(?=/|[^\w.-]|$)")


def hits(pattern: re.Pattern[str], contents: dict[str, str]) -> list[str]:
    """Return file:line of every match."""
    return [
        f"{name}:{number}: {line.strip()[:100]}"
        for name, text in contents.items()
        for number, line in enumerate(text.splitlines(), start=1)
        if pattern.search(line)
    ]


def too_long(contents: dict[str, str]) -> list[str]:
    """Return the sources above the limit; what a program made says so in its first line."""
    return [
        f"{name} has {len(text.splitlines())} lines"
        for name, text in contents.items()
        if name.endswith((".py", ".c", ".h"))
        and len(text.splitlines()) > LINES_MAX
        and not re.search(r"made (?:by|from)\b.*do not edit|do not edit.*made by", text.splitlines()[0], re.I)
    ]


def test_the_top_level_holds_what_the_design_names() -> None:
    top = {name.split("/", 1)[0] for name in tracked()}
    assert sorted(NEEDED - top) == [], "missing at the top level"
    assert sorted(top - NEEDED - ALLOWED) == [], "does not belong at the top level"


def test_no_file_names_this_machine_s_folders() -> None:
    assert hits(path_pattern(machine_paths()), texts()) == []


def test_no_file_names_a_package_registry() -> None:
    assert hits(re.compile("|".join(map(re.escape, registry_hosts()))), texts()) == []


def test_nothing_is_marked_as_unfinished() -> None:
    assert hits(MARKS, texts()) == []


def test_no_source_is_too_long() -> None:
    assert too_long(texts()) == []


def test_the_checks_find_what_they_look_for() -> None:
    folders = path_pattern(["/srv/clone", "/home/ann"])
    for line in ("cd /srv/clone", "'/srv/clone/host'", 'x="/home/ann/a.fkt"', "file:/home/ann"):
        assert hits(folders, {"a.py": f"fine\n{line}\n"}) == [f"a.py:2: {line}"]
    for line in ("docs/srv/clone", "/srv/clones", "./home/ann", "/home/anna/a.fkt", "{root}/home/ann"):
        assert hits(folders, {"a.py": line}) == []
    assert hits(MARKS, {"a.c": "/* TO" + "DO: later */"}) != []
    assert hits(MARKS, {"a.md": "| speed | @SPEED" + "@ m/s |"}) != []  # a figure that is still to be put in
    assert hits(MARKS, {"a.c": "mastodon, METHODO" + "LOGY"}) == []
    long = "x = 1\n" * (LINES_MAX + 1)
    assert too_long({"a.py": long, "a.toml": long, "b.c": "/* Do not edit. Made by x. */\n" + long}) == [
        f"a.py has {LINES_MAX + 1} lines"
    ]
    assert too_long({"a.py": long[: 6 * LINES_MAX]}) == []
