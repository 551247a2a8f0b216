"""Libraries: the same bytes each time, checked when read, nothing half-written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from frogkick.der import simulate_action
from frogkick.errors import ConvergenceError, InputError
from frogkick.library import (
    build_library,
    library_info,
    quantise,
    read_library,
    sample_velocities,
    write_library,
)
from frogkick.planner.image import open_image
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
STATES, SEED = 5, 11


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("library") / "lib.h5"
    report = build_library(ROBOT, STATES, SEED, 2, out)
    assert report.transitions == STATES * 9
    assert report.simulated_s == pytest.approx(STATES * 9 * ROBOT.period_s)
    return out


def test_velocities_fill_the_box_and_repeat() -> None:
    v = sample_velocities(ROBOT, 4000, 1)
    box = ROBOT.library_box
    low, high = np.array([box.forward_mps, box.left_mps, box.omega_rad_s]).T
    assert np.all(v >= low)
    assert np.all(v <= high)
    assert np.all(np.abs(v.mean(axis=0) - 0.5 * (low + high)) < 0.03 * (high - low))
    assert np.array_equal(v, sample_velocities(ROBOT, 4000, 1))
    assert not np.array_equal(v, sample_velocities(ROBOT, 4000, 2))


def test_the_bytes_do_not_depend_on_the_workers(built: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    build_library(ROBOT, STATES, SEED, 1, tmp_path / "one.h5", lambda done, total: seen.append((done, total)))
    assert (tmp_path / "one.h5").read_bytes() == built.read_bytes()
    assert seen[0] == (0, 45)
    assert seen[-1] == (45, 45)
    assert seen == sorted(seen)


def test_transitions_are_those_of_the_rods(built: Path) -> None:
    library = read_library(built)
    assert library.robot() == ROBOT
    assert np.array_equal(library.initial_velocity_body, sample_velocities(ROBOT, STATES, SEED))
    action = ROBOT.action("E")
    row = simulate_action(ROBOT, library.initial_velocity_body[3].tolist(), action, ROBOT.period_s)
    assert np.array_equal(library.displacement_body[3, 4], row[:3])
    assert np.array_equal(library.velocity_body_end[3, 4], row[3:])


def test_info_says_what_is_inside(built: Path) -> None:
    info = library_info(built)
    assert (info["states"], info["actions"], info["transitions"]) == (STATES, 9, 45)
    assert info["robot"] == "frog2022"
    assert info["seed"] == SEED
    with h5py.File(built) as file:
        for name in ("initial_velocity_body", "displacement_body", "velocity_body_end"):
            assert file[name].attrs["units"]
            assert file[name].attrs["frame"].startswith("body")


def test_writing_back_gives_the_same_bytes(built: Path, tmp_path: Path) -> None:
    write_library(read_library(built), tmp_path / "again.h5")
    assert (tmp_path / "again.h5").read_bytes() == built.read_bytes()


def test_truncated_libraries_are_refused_at_every_length(built: Path, tmp_path: Path) -> None:
    whole = built.read_bytes()
    for length in np.linspace(0, len(whole) - 1, 40).astype(int):
        broken = tmp_path / "broken.h5"
        broken.write_bytes(whole[:length])
        with pytest.raises(InputError) as caught:
            read_library(broken)
        assert "\n" not in str(caught.value)


def edited(built: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "edited.h5"
    copy.write_bytes(built.read_bytes())
    return copy


def test_foreign_and_changed_libraries_are_refused(built: Path, tmp_path: Path) -> None:
    text = tmp_path / "text.h5"
    text.write_text("not HDF5 at all")
    with pytest.raises(InputError, match="not a library"):
        read_library(text)
    with pytest.raises(InputError, match="does not exist"):
        read_library(tmp_path / "none.h5")
    foreign = tmp_path / "foreign.h5"
    with h5py.File(foreign, "w") as file:
        file["x"] = 1.0
    with pytest.raises(InputError, match="name a library"):
        read_library(foreign)
    for attribute, value, says in (
        ("format_version", 2, "format version 2"),
        ("robot_id", "other", "'other'"),
        ("period_s", 1.0, r"1\.0 s"),
        ("robot_sha256", "00" * 32, "does not match"),
        ("robot_toml", "id = 1", "does not match"),
    ):
        copy = edited(built, tmp_path)
        with h5py.File(copy, "r+") as file:
            file.attrs[attribute] = value
        with pytest.raises(InputError, match=says):
            read_library(copy)
    copy = edited(built, tmp_path)
    with h5py.File(copy, "r+") as file:
        file["displacement_body"][2, 3, 1] = np.nan
    with pytest.raises(InputError, match=r"displacement_body\[2, 3, 1\]"):
        read_library(copy)
    copy = edited(built, tmp_path)
    with h5py.File(copy, "r+") as file:
        del file["displacement_body"]
        file["displacement_body"] = np.zeros((STATES, 8, 3))
    with pytest.raises(InputError, match="shape"):
        read_library(copy)


def test_bad_requests_are_refused_and_leave_nothing(tmp_path: Path) -> None:
    for states, seed, workers in ((0, 1, 1), (70000, 1, 1), (5, -1, 1), (5, 1, 0), (5, 1, 9999)):
        with pytest.raises(InputError):
            build_library(ROBOT, states, seed, workers, tmp_path / "x.h5")
    assert list(tmp_path.iterdir()) == []


def test_failed_simulations_are_all_named_and_nothing_is_written(tmp_path: Path) -> None:
    box = replace(ROBOT.library_box, omega_rad_s=(1e160, 2e160))
    with pytest.raises(ConvergenceError, match=r"27 of 27 simulations failed.*state 0 action A.*and 7 more"):
        build_library(replace(ROBOT, library_box=box), 3, 1, 2, tmp_path / "x.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGINT")
def test_ctrl_c_ends_the_workers_and_leaves_no_file(tmp_path: Path) -> None:
    script = (
        "from frogkick.library import build_library\n"
        "from frogkick.robot import load_robot\n"
        "def say(done, total):\n    print(done, flush=True)\n"
        f"build_library(load_robot('frog2022'), 5000, 1, 2, {str(tmp_path / 'x.h5')!r}, say)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    assert process.stdout is not None
    while int(process.stdout.readline()) == 0:
        pass
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the parent and its workers
    process.communicate(timeout=60)
    assert process.returncode != 0
    assert list(tmp_path.iterdir()) == []
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("a worker outlived its parent")


def test_the_table_carries_the_library(built: Path) -> None:
    library = read_library(built)
    image = quantise(library)
    assert image == quantise(read_library(built))
    tables = open_image(image)
    assert tables.robot_id == "frog2022"
    assert tables.provenance == library.content_sha256()
    changed = replace(library, displacement_body=library.displacement_body + 1e-9)
    assert open_image(quantise(changed)).provenance != tables.provenance
