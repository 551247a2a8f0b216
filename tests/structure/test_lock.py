"""The lock files and pyproject.toml agree: everybody installs one set of versions, and it fits."""

from __future__ import annotations

import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import Version
from tests.conftest import REPOSITORY


def disagreements(project: dict[str, object], lock: str) -> list[str]:
    """Return one line for each thing that does not fit.

    Args:
        project: the [project] table.
        lock: requirements.lock's text.
    """
    found: list[str] = []
    pinned: dict[str, Version] = {}
    for number, line in enumerate(lock.splitlines(), start=1):
        text = line.split("#", 1)[0].strip()
        if not text:
            continue
        requirement = Requirement(text)
        name = canonicalize_name(requirement.name)
        exact = [one for one in requirement.specifier if one.operator == "==" and "*" not in one.version]
        if len(exact) != 1 or len(requirement.specifier) != 1:
            found.append(f"lock line {number}: {text!r} is not one exact version")
            continue
        if name in pinned:
            found.append(f"lock line {number}: {name} is there twice")
        pinned[name] = Version(exact[0].version)
    groups = [project["dependencies"], *dict(project["optional-dependencies"]).values()]
    for wanted in (Requirement(text) for group in groups for text in group):
        name = canonicalize_name(wanted.name)
        if name not in pinned:
            found.append(f"{name} is a dependency and not locked")
        elif not wanted.specifier.contains(pinned[name], prereleases=True):
            found.append(f"{name} is locked at {pinned[name]}, pyproject wants {wanted.specifier}")
    return found


def project(root: Path = REPOSITORY) -> dict[str, object]:
    """Return pyproject's [project] table."""
    table: dict[str, object] = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    return table


def test_every_dependency_is_locked_at_a_version_that_fits() -> None:
    locks = [REPOSITORY / "requirements.lock", REPOSITORY / "host" / "docs" / "requirements.lock"]
    assert disagreements(project(), "".join(lock.read_text() for lock in locks)) == []


def test_the_oldest_python_is_the_one_that_make_asks_for() -> None:
    supported = SpecifierSet(str(project()["requires-python"]))
    assert supported.contains("3.11.0")
    assert not supported.contains("3.10.9")
    assert "v >= (3, 11)" in (REPOSITORY / "Makefile").read_text()


def test_a_lock_that_does_not_fit_is_found() -> None:
    made_up: dict[str, object] = {
        "dependencies": ["numpy>=2.1,<3", "Jinja2>=3"],
        "optional-dependencies": {"test": ["pytest>=8"]},
    }
    sound = "# all\nnumpy==2.4.6\njinja2==3.1.6\npytest==9.0\n"
    assert disagreements(made_up, sound) == []
    assert disagreements(made_up, sound.replace("2.4.6", "3.0")) == [
        "numpy is locked at 3.0, pyproject wants <3,>=2.1"
    ]
    assert disagreements(made_up, sound.replace("pytest==9.0\n", "")) == [
        "pytest is a dependency and not locked"
    ]
    assert disagreements(made_up, sound.replace("pytest==9.0", "pytest>=9.0")) == [
        "lock line 4: 'pytest>=9.0' is not one exact version",
        "pytest is a dependency and not locked",
    ]
    assert disagreements(made_up, sound + "NumPy==2.4.6\n") == ["lock line 5: numpy is there twice"]
