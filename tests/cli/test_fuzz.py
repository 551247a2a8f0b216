"""Files with bytes changed or cut off: a command refuses them in one line or does its work, never more."""

from __future__ import annotations

import contextlib
import functools
import io
import shutil
import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
from tests.conftest import count
from tests.runs import rig

from frogkick.cli.main import run_command
from frogkick.library import build_library
from frogkick.robot import load_robot
from frogkick.runs.runlog_file import write_run


@functools.cache
def stock() -> dict[str, bytes]:
    """Whole files by name. No fixture: hypothesis would print them with a failure."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build_library(rig.robot(), states=2, seed=5, workers=1, out=folder / "lib.h5")
        recording = rig.swim("pool", "line", 2.5)
        log = recording.log()
        write_run(folder / "run.h5", log)
        shutil.copy(rig.small_table(), folder / "x.fkt")
        (folder / "robot.toml").write_text(load_robot("frog2022").toml)
        return {file.name: file.read_bytes() for file in folder.iterdir()}


@st.composite
def damage(draw: st.DrawFn) -> tuple[float, list[tuple[float, int]]]:
    """Where to cut (1 = not), and which bytes to change to what, places as parts of the length."""
    cut = draw(st.one_of(st.just(1.0), st.floats(0.0, 1.0)))
    # Headers hold what a reader trusts: half of the changes go there.
    place = st.one_of(st.floats(0.0, 0.999), st.floats(0.0, 0.02))
    return cut, draw(st.lists(st.tuples(place, st.integers(0, 255)), min_size=1, max_size=4))


def spoilt(content: bytes, how: tuple[float, list[tuple[float, int]]]) -> bytes:
    cut, changes = how
    bytes_left = bytearray(content[: round(cut * len(content))])
    for place, value in changes:
        if bytes_left:
            bytes_left[int(place * len(bytes_left))] = value
    return bytes(bytes_left)


def refused_or_done(content: bytes, name: str, *command: str) -> None:
    """Run a command on a file; FILE stands for it, and OUT for a folder to write to."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        file, out = folder / name, folder / "out"
        file.write_bytes(content)
        arguments = [word.replace("FILE", str(file)).replace("OUT", str(out)) for word in command]
        stdout, stderr = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
            code = run_command(arguments)
        if code == 0:
            return
        assert code == 2, stderr.getvalue()
        complaints = [line for line in stderr.getvalue().splitlines() if line.startswith("frogkick: ")]
        assert len(complaints) == 1 and stdout.getvalue() == ""
        assert sorted(path.name for path in folder.iterdir()) == [name]


fuzzed = settings(max_examples=count(60, 600, 15), deadline=None, print_blob=True)


@fuzzed
@given(damage())
def test_table(how: tuple[float, list[tuple[float, int]]]) -> None:
    content = spoilt(stock()["x.fkt"], how)
    refused_or_done(content, "x.fkt", "tables", "info", "FILE", "--test-states", "0", "--json")
    refused_or_done(content, "x.fkt", "codegen", "FILE", "--out", "OUT", "--json")


@fuzzed
@given(damage())
def test_table_with_a_right_checksum(how: tuple[float, list[tuple[float, int]]]) -> None:
    import zlib

    content = bytearray(spoilt(stock()["x.fkt"], how))
    if len(content) > 16:
        content[12:16] = zlib.crc32(content[16:]).to_bytes(4, "little")
    refused_or_done(bytes(content), "x.fkt", "tables", "info", "FILE", "--test-states", "0", "--json")


@fuzzed
@given(damage())
def test_library(how: tuple[float, list[tuple[float, int]]]) -> None:
    refused_or_done(spoilt(stock()["lib.h5"], how), "lib.h5", "library", "info", "FILE", "--json")


@fuzzed
@given(damage())
def test_run(how: tuple[float, list[tuple[float, int]]]) -> None:
    table = str(rig.small_table())
    refused_or_done(
        spoilt(stock()["run.h5"], how),
        "run.h5",
        "replay",
        "FILE",
        "--plan",
        "host",
        "--tables",
        table,
        "--json",
    )


@fuzzed
@given(damage())
def test_robot(how: tuple[float, list[tuple[float, int]]]) -> None:
    table = str(rig.small_table())
    refused_or_done(
        spoilt(stock()["robot.toml"], how),
        "robot.toml",
        "tables", "info", table, "--robot", "FILE", "--test-states", "0", "--json",
    )  # fmt: skip


@fuzzed
@given(st.text(alphabet='0123456789.,-+eE \nnaix_ym#"\t', max_size=60))
def test_path(text: str) -> None:
    # A path is read before the table, so a table that is not there ends the command there.
    refused_or_done(text.encode(), "p.csv", "run", "--path", "FILE", "--tables", "OUT/missing.fkt")
