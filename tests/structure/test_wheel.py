"""The wheel alone, without a clone: all is in it, every command works or names the extra that it needs."""

from __future__ import annotations

import json
import shutil
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from tests.conftest import FULL, LEVEL, REPOSITORY, from_ci, some
from tests.runs import rig
from tests.structure.wheel import Environment, build_wheel, installed, repository_files, with_compiled

from frogkick.cli.app import COMMANDS
from frogkick.core.errors import EXTRAS
from frogkick_codegen.firmware import build

PLACES = {
    "host/frogkick/": "frogkick/",
    "codegen/frogkick_codegen/": "frogkick_codegen/",
    "firmware/": "frogkick_codegen/firmware_sources/",
}
"""Folder of the repository -> where the wheel has it."""
SLOW = "takes up to a minute: FK_LEVEL=ci"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of these very files."""
    if not (REPOSITORY / ".git").exists() or shutil.which("git") is None:
        pytest.skip("not a git checkout: nothing says which files belong to it")
    return build_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def bare(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """Without any extra."""
    return _with_table(installed(wheel, tmp_path_factory.mktemp("bare"), by_pip=False))


@pytest.fixture(scope="module")
def whole(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """With the extra that builds firmware; in make test-full alone numba's cache is empty."""
    made = _with_table(installed(wheel, tmp_path_factory.mktemp("whole"), ["firmware"]))
    return made if FULL else with_compiled(made)


def _with_table(environment: Environment) -> Environment:
    shutil.copyfile(rig.small_table(), environment.here / "t.fkt")
    return environment


def test_every_file_is_in_the_wheel_and_no_other(wheel: Path) -> None:
    expected = {
        there + name.removeprefix(here)
        for name in repository_files()
        for here, there in PLACES.items()
        if name.startswith(here) and (here == "firmware/" or not name.endswith(".md"))
    }
    packed = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert sorted(expected - packed) == [], "not in the wheel"
    assert sorted(packed - expected) == [], "does not belong in the wheel"
    for name in ("firmware_sources/core/fk_robot.c", "firmware_sources/bench/main.c", "planner/tree.c"):
        assert f"frogkick_codegen/{name}" in packed
    assert {"frogkick/py.typed", "frogkick_codegen/py.typed"} <= packed


def test_extras_are_those_of_pyproject() -> None:
    groups = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = {
        extra: {Requirement(text).name for text in groups[extra]}
        for extra in groups
        if extra not in ("docs", "test")
    }
    assert {extra: set(packages.values()) for extra, packages in EXTRAS.items()} == named


@from_ci
def test_the_firmware_is_built_from_the_wheel_alone(whole: Environment, tmp_path: Path) -> None:
    looked = whole.command("doctor", "--json")
    assert looked.code == 0 and json.loads(looked.stdout)["ready_without_robot"], looked.stdout
    bench, emitted = whole.commands(
        [
            ["firmware", "build", "--tables", "t.fkt", "--out", "bench", "--json"],
            ["codegen", "t.fkt", "--no-measure", "--out", "emitted", "--json"],
        ]
    )
    assert (bench.code, emitted.code) == (0, 0), (bench, emitted)
    # The same firmware as a clone's, to the byte: nothing of where it was built is in it.
    here = build("bench", rig.small_table(), rig.robot(), tmp_path / "here")
    assert (whole.here / json.loads(bench.stdout)["image"]).read_bytes() == here.image.read_bytes()
    assert json.loads(bench.stdout)["flash_bytes"] == here.flash_bytes > 0
    assert {"tree.c", "fk_planner.h", "fk_table.c"} <= json.loads(emitted.stdout)["files"].keys()


@from_ci
def test_python_lines_work_too(bare: Environment) -> None:
    lines = 'import frogkick as fk; t = fk.load_table("t.fkt"); print(t.robot.id, *fk.emit_c(t, "lines"))'
    said = bare.script("-c", lines)
    assert said.code == 0, said.stderr
    assert {"frog2022", "tree.c", "fk_planner.h"} <= set(said.stdout.split())
    shutil.rmtree(bare.here / "lines")


FIRMWARE, LINK, FLASH, CLONE = "firmware", "link", "flash", "a clone"
LACKING: list[tuple[str, list[str]]] = [
    (FIRMWARE, ["demo", "--out", "made"]),
    (FIRMWARE, ["codegen", "t.fkt", "--out", "made"]),
    (FIRMWARE, ["firmware", "build", "--tables", "t.fkt", "--out", "made"]),
    (FIRMWARE, ["firmware", "build", "--tables", "t.fkt", "--target", "native", "--out", "made"]),
    (FIRMWARE, ["firmware", "size"]),
    (FIRMWARE, ["firmware", "test"]),
    (FLASH, ["firmware", "flash"]),
    (FIRMWARE, ["parity", "--states", "100"]),
    (FIRMWARE, ["run", "--robot", "pool", "--out", "made.h5"]),
    (FIRMWARE, ["run", "--robot", "virtual", "--out", "made.h5"]),
    (FIRMWARE, ["replay", "run.h5"]),
    (FIRMWARE, ["retune", "run.h5", "--robot", "frog2022", "--out", "made"]),
    (CLONE, ["study", "chip"]),
    (CLONE, ["study", "loop", "--out", "made"]),
    (CLONE, ["study", "twin", "--out", "made"]),
    (CLONE, ["study", "verdicts", "--out", "made"]),
    (LINK, ["run", "--robot", "ble:frogkick", "--fixes", "stdin", "--out", "made.h5"]),
    (LINK, ["run", "--robot", "serial:/dev/ttyACM0", "--fixes", "stdin", "--out", "made.h5"]),
    (LINK, ["push", "t.fkt", "--robot", "ble:frogkick"]),
    (LINK, ["log", "fetch", "--robot", "serial:/dev/ttyACM0", "--out", "made.h5"]),
    ("cluster", ["sweep", "--out", "made", "--cluster", "127.0.0.1:8786"]),
]
"""Extra -> a command that needs it, or a clone. With no table given: none is simulated before it says so."""


@from_ci
def test_without_an_extra_commands_work_or_say_which_they_need(bare: Environment) -> None:
    working = [
        ["robot", "list"],
        ["codegen", "t.fkt", "--no-measure", "--out", "emitted"],
        *([name, "--help"] for name in COMMANDS),
    ]
    looked, *every = bare.commands([["doctor", "--json"], *working, *(line for _, line in LACKING)])
    assert looked.code == 1 and not json.loads(looked.stdout)["ready_without_robot"]
    missing = [row for row in json.loads(looked.stdout)["needed"] if not row["works"]]
    assert {row["install"] for row in missing} == {"pip install 'frogkick[firmware]'"}
    for line, said in zip(working, every, strict=False):
        assert said.code == 0, (line, said)
    for (extra, line), said in zip(LACKING, every[len(working) :], strict=True):
        assert said.code == 2, (line, said)
        assert said.stderr.count("\n") == 1 and said.stdout == "", (line, said)
        needed = "the studies are part of a clone" if extra == CLONE else f"pip install 'frogkick[{extra}]'"
        assert needed in said.stderr, (line, said)
    assert sorted(file.name for file in bare.here.iterdir()) == ["emitted", "t.fkt"]
    assert not list(bare.root.glob("cache/tables/*"))  # nothing was simulated for it


@pytest.mark.skipif(LEVEL == "quick", reason=SLOW)
@pytest.mark.parametrize("name", some(["swim", "run"], 1, 1))
def test_an_example_runs_from_the_wheel(name: str, whole: Environment) -> None:
    said = whole.script(REPOSITORY / "host" / "examples" / f"{name}.py")
    assert said.code == 0, said.stderr
    assert len(said.stdout.splitlines()) >= 2


@pytest.mark.skipif(LEVEL == "quick", reason=SLOW)
def test_a_cold_start_works(whole: Environment) -> None:
    """Where nothing is compiled yet, as after pip install."""
    cold = whole.root / "cold"
    program = (
        f"import os; os.environ['NUMBA_CACHE_DIR'] = {str(cold)!r}\n"
        "from frogkick.cli.main import main; main()"
    )
    said = whole.script("-c", program, "simulate", "--cycles", "1", "--json")
    assert said.code == 0, said.stderr
    assert json.loads(said.stdout) and list(cold.rglob("*.nbc")), "numba compiled, and kept it"


@pytest.mark.skipif(LEVEL == "quick", reason=SLOW)
def test_the_ring_without_a_clone(whole: Environment) -> None:
    few = ["--test-states", "4"]
    lines = [
        ["simulate", "--cycles", "1", "--out", "swim.csv", "--json"],
        ["library", "build", "--states", "6", "--record-s", "0", "--out", "lib.h5", "--json"],
        ["library", "info", "lib.h5", "--json"],
        ["tables", "build", "lib.h5", "--kind", "nearest", *few, "--out", "new.fkt", "--json"],
        ["tables", "info", "new.fkt", *few, "--json"],
        ["codegen", "new.fkt", "--out", "measured", "--json"],
        ["firmware", "size", "--tables", "t.fkt", "--json"],
        ["firmware", "build", "--target", "native", "--tables", "t.fkt", "--out", "native", "--json"],
        ["run", "--robot", "pool", "--tables", "t.fkt", "--simulated-time", "5", "--out", "a.h5", "--json"],
        [
            "run",
            "--robot",
            "virtual",
            "--tables",
            "t.fkt",
            "--simulated-time",
            "8",
            "--out",
            "b.h5",
            "--json",
        ],
        ["replay", "b.h5", "--tables", "t.fkt", "--json"],
        ["log", "show", "b.h5", "--out", "b.png", "--json"],
        ["export", "b.h5", "--csv", "--out", "csv", "--json"],
        ["parity", "--states", "100", "--tables", "t.fkt", "--loop-decisions", "5", "--json"],
    ]
    for line, said in zip(lines, whole.commands(lines), strict=True):
        assert said.code == 0, (line, said)
        assert json.loads(said.stdout)


def test_another_frogkick_is_not_taken_for_the_wheel_s(bare: Environment) -> None:
    """The check that says so finds the editable one, where that is in the way."""
    link = next((bare.root / "venv").glob("**/site-packages")) / "frogkick"
    link.rename(link.with_name("kept"))
    link.symlink_to(REPOSITORY / "host" / "frogkick")
    try:
        with pytest.raises(AssertionError, match="is not the wheel's"):
            bare.commands([])
    finally:
        link.unlink()
        link.with_name("kept").rename(link)
