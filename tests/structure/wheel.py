"""A wheel of this repository, and environments that see nothing else of it."""

from __future__ import annotations

import importlib.metadata
import json
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from tests.conftest import REPOSITORY

from frogkick.core.files import cache_folder

PACKED = ("host", "codegen", "firmware", "pyproject.toml", "README.md", "LICENSE")
"""What of the repository a wheel is made of."""

# One process for many commands: what each of them would load takes longer than most of them.
_COMMANDS = """
import contextlib, io, json, sys
from pathlib import Path
import frogkick, frogkick_codegen
from frogkick.cli.main import run_command

rows = []
for arguments in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run_command(arguments)
    rows.append([code, out.getvalue(), err.getvalue()])
print(json.dumps({"files": [frogkick.__file__, frogkick_codegen.__file__], "rows": rows}))
"""


def repository_files() -> list[str]:
    """Files of ``PACKED``, relative to the repository: those that git has, or would take."""
    listing = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", *PACKED],
        cwd=REPOSITORY, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return sorted(name for name in set(listing.stdout.split("\0")) if (REPOSITORY / name).is_file())


def build_wheel(folder: Path) -> Path:
    """Build the wheel from a copy, as a build leaves its own files beside the sources."""
    for name in repository_files():
        (folder / "tree" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(REPOSITORY / name, folder / "tree" / name)
    earlier = folder / "tree/build/lib/frogkick"  # what an earlier build left is none of this one's
    earlier.mkdir(parents=True)
    (earlier / "gone.py").write_text("", encoding="utf-8")
    _pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder / "dist", folder / "tree")
    shutil.rmtree(folder / "tree")
    (made,) = (folder / "dist").glob("*.whl")
    return made


def _pip(*arguments: str | Path) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *map(str, arguments)]
    result = subprocess.run(command, env=_clean(), capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def _clean() -> dict[str, str]:
    """Our environment variables without those that lead Python elsewhere."""
    ours = {"PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "NUMBA_CACHE_DIR"}
    return {name: value for name, value in os.environ.items() if name not in ours}


@dataclass(frozen=True)
class Said:
    """What one command gave."""

    code: int
    stdout: str
    stderr: str


@dataclass(frozen=True)
class Environment:
    """A virtual environment with the wheel in it, an empty folder to work in, an empty cache."""

    root: Path

    @property
    def here(self) -> Path:
        """The folder that commands run in."""
        return self.root / "here"

    def command(self, *arguments: str | Path) -> Said:
        """Run the command as a user does."""
        program = self.root / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "frogkick"
        done = self._run([str(program), *map(str, arguments)])
        return Said(done.returncode, done.stdout, done.stderr)

    def commands(self, lines: Sequence[Sequence[str]]) -> list[Said]:
        """Run commands one after another, in one process that has the package from the wheel."""
        done = self._run([str(self._python), "-c", _COMMANDS, json.dumps(lines)])
        assert done.returncode == 0, done.stderr
        output: Mapping[str, Any] = json.loads(done.stdout.splitlines()[-1])
        for file in output["files"]:
            inside = Path(file).resolve().is_relative_to(self.root.resolve() / "venv")
            assert inside, f"{file} is not the wheel's"
        return [Said(*row) for row in output["rows"]]

    def script(self, *arguments: str | Path) -> Said:
        """Run Python with the arguments, a file or -c and text."""
        done = self._run([str(self._python), *map(str, arguments)])
        return Said(done.returncode, done.stdout, done.stderr)

    @property
    def _python(self) -> Path:
        return self.root / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "python"

    def _run(self, command: list[str]) -> subprocess.CompletedProcess[str]:
        # Ours would take ten seconds to fill: the C library's own parts, the same for everybody.
        zig = {f"ZIG_{kind}_CACHE_DIR": str(cache_folder("zig")) for kind in ("GLOBAL", "LOCAL")}
        environment = {**_clean(), **zig, "FROGKICK_CACHE_DIR": str(self.root / "cache")}
        return subprocess.run(
            command, cwd=self.here, env=environment, capture_output=True, text=True, check=False, timeout=3600
        )


def installed(wheel: Path, root: Path, extras: Iterable[str] = (), by_pip: bool = True) -> Environment:
    """An environment with the wheel, and of what is installed here only what its metadata ask for.

    Nothing is fetched: packages are linked from where this Python has them.

    Args:
        wheel: the file.
        root: an empty folder.
        extras: of ours that are asked for.
        by_pip: False: unpacked, without the command; takes a tenth of the time.
    """
    venv.create(root / "venv", with_pip=False, symlinks=sys.platform != "win32")
    (root / "here").mkdir()
    made = Environment(root)
    found = root / "venv" / ("Lib" if sys.platform == "win32" else "lib")
    (packages,) = found.glob("**/site-packages")
    if by_pip:
        _pip("--python", made._python, "install", "--no-deps", "--no-index", "--no-compile", wheel)
    else:
        zipfile.ZipFile(wheel).extractall(packages)
    ours = importlib.metadata.Distribution.at(next(packages.glob("frogkick-*.dist-info")))
    for name in _needed([Requirement(text) for text in ours.requires or []], set(extras)):
        _link(importlib.metadata.distribution(name), packages)
    return made


def with_compiled(environment: Environment) -> Environment:
    """The environment with what numba has compiled of this clone, which takes minutes to compile.

    numba takes of it only what is of a file with the very same content: the wheel's own files are compiled
    where they differ.
    """
    (package,) = (environment.root / "venv").glob("**/site-packages/frogkick")
    for file in sorted((REPOSITORY / "host" / "frogkick").rglob("__pycache__/*.nb[ci]")):
        target = package / file.relative_to(REPOSITORY / "host" / "frogkick")
        target.parent.mkdir(exist_ok=True)
        shutil.copyfile(file, target)
    return environment


def _needed(requirements: list[Requirement], extras: set[str]) -> set[str]:
    """Names of all packages that a wheel's requirements bring with them."""
    names: set[str] = set()
    waiting = [(requirement, extras) for requirement in requirements]
    seen = set()
    while waiting:
        requirement, chosen = waiting.pop()
        base = {key: str(value) for key, value in default_environment().items()}
        if requirement.marker is not None and not any(
            requirement.marker.evaluate({**base, "extra": extra}) for extra in ("", *chosen)
        ):
            continue
        key = (canonicalize_name(requirement.name), frozenset(requirement.extras))
        if key in seen:
            continue
        seen.add(key)
        names.add(key[0])
        its_own = importlib.metadata.distribution(requirement.name).requires or []
        waiting += [(Requirement(text), set(requirement.extras)) for text in its_own]
    return names


def _link(package: importlib.metadata.Distribution, packages: Path) -> None:
    for top in {file.parts[0] for file in package.files or [] if file.parts[0] not in ("..", "__pycache__")}:
        source, target = Path(str(package.locate_file(top))), packages / top
        if source.exists() and not target.exists():
            target.symlink_to(source, target_is_directory=source.is_dir())
