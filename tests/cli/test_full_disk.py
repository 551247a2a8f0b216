"""A disk that is full: one line that names the file, exit 2, nothing half-written."""

from __future__ import annotations

import errno
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import pytest
from tests.cli.commands import frogkick
from tests.conftest import from_ci, some
from tests.runs import rig

import frogkick as fk
from frogkick.core import files
from frogkick.front import running

# No process may write a file longer than this: as good as a full disk, wherever the tests run.
WITHOUT_ROOM = """
import resource, sys
sys.dont_write_bytecode = True  # some Pythons would leave it cut short, for everyone
resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))
from frogkick.cli.main import run_command
sys.exit(run_command(sys.argv[1:]))
"""


pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="limits the length of files")


@from_ci
@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (("robot", "show", "frog2022", "--out"), "robot.png"),
        (("camera", "tag", "--out"), "tag.pdf"),
    ],
)
def test_one_line_names_the_file(tmp_path: Path, arguments: tuple[str, ...], name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_ROOM, *arguments, name],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    output = [line for line in done.stderr.splitlines() if line.startswith("frogkick: ")]
    assert output == [f"frogkick: cannot write {name!r}: File too large; make room or choose another --out"]
    assert "Traceback" not in done.stderr and done.returncode == 2
    assert list(tmp_path.iterdir()) == []


@from_ci
def test_an_export_leaves_no_file_and_no_folder(tmp_path: Path) -> None:
    fk.run(robot="pool", time_limit_s=6.0, out=tmp_path / "run.h5")
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_ROOM, "export", "run.h5", "--csv", "--out", "some/where"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "frogkick: cannot write 'some/where/" in done.stderr and "Traceback" not in done.stderr
    assert done.returncode == 2 and [each.name for each in tmp_path.iterdir()] == ["run.h5"]


@from_ci
@pytest.mark.parametrize("ending", [".pdf", ".svg"])
def test_a_picture_is_not_half_written(ending: str, tmp_path: Path) -> None:
    """The writer of PDF has an error of its own for a disk that is full from the first byte on."""
    program = WITHOUT_ROOM.replace("(8192, 8192)", "(0, 0)")
    done = subprocess.run(
        [sys.executable, "-c", program, "camera", "tag", "--out", f"tag{ending}"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "Traceback" not in done.stderr and done.returncode == 2, done.stderr
    assert done.stderr.splitlines()[-1].startswith(f"frogkick: cannot write 'tag{ending}': File too large; ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("whole", [False, True], ids=["emitted", "firmware"])
def test_a_disk_that_fills_up_amid_several_files_leaves_none(
    whole: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However far it came; and what was there before is there as it was."""
    on_disk: set[tuple[int, int]] = set()
    fsync, room = os.fsync, [100]

    def filling(handle: int) -> None:
        of = os.fstat(handle)
        if (of.st_ino, of.st_mtime_ns) not in on_disk:
            if len(on_disk) == room[0]:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            on_disk.add((of.st_ino, of.st_mtime_ns))
        fsync(handle)

    def make(out: Path, files: int) -> None:
        on_disk.clear()
        room[0] = files
        if whole:
            fk.build_firmware(rig.small_table(), "native", out)
        else:
            fk.emit_c(rig.small_table(), out)

    def state() -> dict[str, bytes | None]:
        return {str(at): at.read_bytes() if at.is_file() else None for at in tmp_path.rglob("*")}

    rig.firmware("native")  # what is kept of it needs no room again
    monkeypatch.setattr(os, "fsync", filling)
    make(tmp_path / "there", 100)
    before, needed = state(), len(on_disk)
    assert needed > 8
    for out in (tmp_path / "new" / "folder", tmp_path / "there"):
        for enough in some(range(needed)[::-1], 4, 6 if whole else needed):
            with pytest.raises(fk.InputError, match="No space left on device"):
                make(out, enough)
            assert state() == before


@from_ci
def test_a_module_that_a_full_disk_cut_short_is_named(tmp_path: Path) -> None:
    """By a Python that kept it so: once "interrupted", for ever."""
    from frogkick.cli import camera

    environment = os.environ | {"PYTHONPYCACHEPREFIX": str(tmp_path / "kept")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    command = [sys.executable, "-m", "frogkick.cli.main", "camera", "--help"]
    subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=True)
    name = Path(importlib.util.cache_from_source(camera.__file__)).name
    (kept,) = (tmp_path / "kept").rglob(f"cli/{name}")
    kept.write_bytes(kept.read_bytes()[:1000])
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    output = done.stderr.strip()
    assert output == (
        f"frogkick: {str(kept)!r} is cut short, for example because the disk was full: "
        "delete it, and it is made again"
    )
    assert done.returncode == 2
    kept.unlink()
    subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=True)


def as_file(folder: Path) -> None:
    """Put a file in the place of a folder, so that not even root can write in it."""
    shutil.rmtree(folder)
    folder.write_text("")


@pytest.mark.parametrize("way", ["simulate", "run"])
def test_a_result_is_not_lost_where_its_place_is_gone_at_the_end(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is written elsewhere, and the error says where."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    of, name, options = {
        "simulate": (fk, "simulate", ("--actions", "B")),
        "run": (running, "run_session", ("--simulated-time", "2", "--tables", rig.small_table())),
    }[way]
    work = getattr(of, name)

    def work_and_spoil(*given: object, **named: object) -> object:
        done = work(*given, **named)
        as_file(tmp_path / "gone")
        return done

    monkeypatch.setattr(of, name, work_and_spoil)
    (tmp_path / "gone").mkdir()
    out = tmp_path / "gone" / "out.csv"
    done = frogkick(capsys, way, *("--robot", "pool") * (way == "run"), *options, "--out", out, "--json")
    (line,) = (each for each in done.stderr.splitlines() if each.startswith("frogkick: "))
    told = re.fullmatch(
        rf"frogkick: cannot write {str(out)!r}: .*; choose another --out; the result is in '(.*)'", line
    )
    assert told is not None and done.code == 2, line
    kept = Path(told[1])
    assert kept.name == "out.csv" and kept.parent.parent == tmp_path
    if way == "run":
        assert fk.load_run(kept).decisions is not None and done.stdout == ""
    else:
        assert kept.read_text().startswith("time_s,x_m") and done.json["distance_m"] > 0.0


def test_a_result_that_no_place_takes_is_an_error_as_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    def full(_file: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(files.UnwritableError) as raised:
        files.save_result(full, "x.toml")
    assert str(raised.value) == "cannot write 'x.toml': No space left on device; choose another --out"
    assert list(tmp_path.iterdir()) == []


@from_ci
def test_a_run_s_log_does_not_end_the_process(tmp_path: Path) -> None:
    """As the HDF5 library does where it cannot write on."""
    program = (
        "import resource, sys, frogkick as fk\n"
        "sys.dont_write_bytecode = True\n"
        "found = fk.run(sys.argv[1], robot='pool', time_limit_s=3.0)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))\n"
        "try:\n    found.save('run.h5')\n"
        "except fk.InputError as error:\n    print(error)\n"
    )
    command = [sys.executable, "-c", program, rig.small_table()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "cannot write 'run.h5': File too large; make room or choose another --out\n"
    assert list(tmp_path.iterdir()) == []


@from_ci
def test_a_library_looks_for_room_before_it_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its parts stay, and the same build goes on from them where there is room."""

    class Usage(NamedTuple):
        free: int

    robot, out = fk.load_robot("frog2022"), tmp_path / "lib.h5"
    with monkeypatch.context() as patch:
        patch.setattr(files.shutil, "disk_usage", lambda _folder: Usage(70_000))
        with pytest.raises(fk.InputError, match=r"lib\.h5': it takes 0\.1 MB, and 0\.1 MB are free there"):
            fk.build_library(robot, states=16, workers=1, out=out)
    assert [entry.name for entry in tmp_path.iterdir()] == ["lib.h5.parts"]
    with pytest.raises(
        fk.InputError, match=r"another library \(frog2022 \w{8}, 16 states, seed 0, box, 0 s\)"
    ):
        fk.build_library(robot, states=16, seed=1, workers=1, out=out)
    reported: list[int] = []
    fk.build_library(robot, states=16, workers=1, out=out, progress=lambda done, _all: reported.append(done))
    assert reported == [16 * 9] and [entry.name for entry in tmp_path.iterdir()] == ["lib.h5"]
    # What is asked for is what is taken, to some kilobytes.
    assert 0 < 65536 + 16 * 9 * 64 - out.stat().st_size < 65536
