"""Damaged HDF5 files are refused in one line, and in the end: no reader hangs or crashes."""

from __future__ import annotations

import errno
import fcntl
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.conftest import count
from tests.library.synthetic import Known
from tests.runs import rig

from frogkick.core import files, hdf5
from frogkick.core.errors import InputError
from frogkick.library.store import read_library, write_library
from frogkick.link.log import ChipLog, Stretch
from frogkick.runs.chip_log import FetchedLog, read_log, write_log
from frogkick.runs.recorded.importer import load_run
from frogkick.runs.runlog_file import fill, read_run, write_run


def a_run(path: Path) -> None:
    write_run(path, rig.swim("pool", "line", 4.0).log())


def a_chip_log(path: Path) -> None:
    write_log(path, FetchedLog("frog2022", 1, ChipLog((Stretch(0, bytes(200)),), 0)))


def a_library(path: Path) -> None:
    write_library(Known(seed=1, degree=1).library(states=6, seed=2), path)


FILES: list[tuple[Callable[[Path], None], Callable[[Path], object]]] = [
    (a_run, read_run),
    (a_chip_log, read_log),
    (a_library, read_library),
]


@pytest.mark.parametrize(("write", "read"), FILES)
def test_damage_anywhere_is_refused(
    write: Callable[[Path], None], read: Callable[[Path], object], tmp_path: Path
) -> None:
    file = tmp_path / "x.h5"
    write(file)
    read(file)
    whole = file.read_bytes()
    with h5py.File(file) as plain:
        assert "format" in plain.attrs, "other programs read it as well"
    rng = np.random.default_rng(5)
    for at in rng.integers(hdf5.BLOCK_BYTES, len(whole), count(20, 400)):
        spoilt = bytearray(whole)
        spoilt[at] ^= 1 << int(rng.integers(8))
        file.write_bytes(spoilt)
        with pytest.raises(InputError, match="its checksum does not match its content"):
            read(file)
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="its checksum does not match its content"):
        read(file)


def without_checksum(path: Path) -> bytes:
    """Write a run as an older frogkick did."""
    with h5py.File(path, "w") as file:
        fill(file, rig.swim("pool", "line", 4.0).log())
    return path.read_bytes()


def test_a_file_without_a_checksum_is_read(tmp_path: Path) -> None:
    file = tmp_path / "x.h5"
    without_checksum(file)
    assert load_run(file).robot_id == "frog2022"


def test_a_damaged_file_without_a_checksum_does_not_hang(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """44 zeros in the global heap keep the HDF5 library in a loop that no signal ends."""
    file = tmp_path / "x.h5"
    spoilt = bytearray(without_checksum(file))
    at = spoilt.index(b"GCOL") + 16
    spoilt[at : at + 44] = bytes(44)
    file.write_bytes(spoilt)
    monkeypatch.setattr(hdf5, "PROBE_S", 3.0)
    with pytest.raises(InputError, match=r"is damaged \(it could not be read in 3 s\)"):
        read_run(file)


def test_a_file_that_another_program_writes_is_not_called_damaged(tmp_path: Path) -> None:
    file = tmp_path / "x.h5"
    a_run(file)
    code = "import h5py, sys; f = h5py.File(sys.argv[1], 'r+'); print('open', flush=True); sys.stdin.read()"
    holder = subprocess.Popen(
        [sys.executable, "-c", code, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert holder.stdout is not None and holder.stdout.readline() == b"open\n"
        with pytest.raises(
            InputError, match="is open in another program, which may write it: close it there"
        ):
            read_run(file)
    finally:
        holder.communicate()


def test_on_a_disk_without_locks_files_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(_file: object, _how: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    with files.sole_writer(tmp_path / "x.h5"):
        a_run(tmp_path / "x.h5")
    with files.one_at_a_time(tmp_path, "work") as one, files.one_at_a_time(tmp_path, "work") as other:
        assert one.is_dir() and other.is_dir() and one != other
    assert load_run(tmp_path / "x.h5").robot_id == "frog2022"
    assert [entry.name for entry in tmp_path.iterdir() if entry.is_file() and "lock" not in entry.name] == [
        "x.h5"
    ]
