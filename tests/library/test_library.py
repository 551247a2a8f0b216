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
from tests.conftest import count, from_ci, some
from tests.der.single import simulate_action
from tests.identification.made import robot

from frogkick.core.errors import ConvergenceError, InputError
from frogkick.core.hdf5 import seal
from frogkick.library import (
    Failed,
    build,
    build_library,
    library_info,
    quantise,
    read_library,
    read_recorded,
    sample_library,
    truncate_library,
    write_library,
)
from frogkick.library.sampling import box_velocities, rigid_starts
from frogkick.robot import mirror_of, parse_robot
from frogkick.tables.image import open_image

ROBOT = robot()
STATES, SEED = 5, 11
SWUM = count(12, 24)
RECORD_S = count(0, 5)  # where nobody looks at it
PERIOD_MS = count(200, 1425)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("library") / "lib.h5"
    made = build_library(ROBOT, STATES, SEED, 2, out)
    assert made.displacement_body.shape == (STATES, 9, 3) and made.failed == ()
    read = read_library(out)
    for name, value in vars(made).items():  # what is returned need not be read from the file
        np.testing.assert_array_equal(getattr(read, name), value, err_msg=name)
    assert list(out.parent.iterdir()) == [out]  # no part is left
    return out


@from_ci
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
    assert np.array_equal(library.initial_velocity_body, box_velocities(ROBOT, STATES, SEED))
    action = ROBOT.action("E")
    for state, velocity in enumerate(library.initial_velocity_body.tolist()):
        row = simulate_action(ROBOT, velocity, action, ROBOT.period_s)
        rounding = 0.0 if velocity[1] > 0.0 else 1e-7  # of mirror images, the other one was simulated
        assert library.displacement_body[state, 4] == pytest.approx(row[:3], rel=0, abs=rounding)
        assert library.velocity_body_end[state, 4] == pytest.approx(row[3:], rel=0, abs=100 * rounding)


def test_mirror_images_are_exact(built: Path) -> None:
    library, recorded = read_library(built), read_recorded(built)
    mirror = mirror_of(ROBOT)
    assert mirror is not None
    left = np.array([1.0, -1.0, -1.0])
    for state in range(0, STATES - 1, 2):
        pair = library.initial_velocity_body[state : state + 2]
        assert np.array_equal(pair[1], pair[0] * left)
        for action, other in enumerate(mirror.actions):
            for values in (library.displacement_body, library.velocity_body_end):
                assert np.array_equal(values[state + 1, other], values[state, action] * left)
            one, two = recorded.motion[state, action], recorded.motion[state + 1, other]
            assert np.array_equal(two, one * np.tile(left, 2).astype(np.float32))


def test_what_was_recorded_leads_to_the_transition(built: Path) -> None:
    library, recorded = read_library(built), read_recorded(built)
    assert recorded.time_s[[0, -1]] == pytest.approx([0.05, 5.0])
    assert recorded.motion.shape == (STATES, 9, 100, 6)
    assert recorded.motion.dtype == np.float32
    for column in range(3):
        at_period = np.array(
            [
                [np.interp(ROBOT.period_s, recorded.time_s, row[:, column]) for row in rows]
                for rows in recorded.motion
            ]
        )
        assert at_period == pytest.approx(library.displacement_body[:, :, column], abs=2e-3)


@from_ci
def test_another_period_is_cut_from_what_was_recorded(built: Path, tmp_path: Path) -> None:
    """0.05 mm and 0.03 degrees from simulating to that period; 0.02 mm/s and 0.3 degrees/s."""
    for period in some((1.0, 1.23, 2.0, 4.999), 2):
        toml = ROBOT.toml.replace(f"period_s = {ROBOT.period_s}", f"period_s = {period}")
        other = parse_robot(toml, source="test")
        assert other.period_s == period
        truncated = truncate_library(built, other)
        build_library(other, STATES, SEED, 1, tmp_path / "other.h5", record_s=0.0)
        whole = read_library(tmp_path / "other.h5")
        assert np.array_equal(truncated.initial_velocity_body, whole.initial_velocity_body)
        gap = np.abs(truncated.displacement_body - whole.displacement_body).reshape(-1, 3).max(axis=0)
        assert np.all(gap < [5e-5, 5e-5, 5e-4])
        gap = np.abs(truncated.velocity_body_end - whole.velocity_body_end).reshape(-1, 3).max(axis=0)
        assert np.all(gap < [2e-4, 2e-4, 5e-3])
        write_library(truncated, tmp_path / "cut.h5")
        assert read_library(tmp_path / "cut.h5").period_s == period
    with pytest.raises(InputError, match=r"0\.05-5 s are recorded"):
        truncate_library(built, replace(ROBOT, period_s=5.01))
    with pytest.raises(InputError, match="nothing is recorded"):
        truncate_library(tmp_path / "other.h5", other)
    for other in (replace(ROBOT, egain_percent=20.0), replace(ROBOT, effects=({"name": "yaw_drag"},))):
        with pytest.raises(InputError, match="another period only"):
            truncate_library(built, other)


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
    recorded = read_recorded(built)
    write_library(read_library(built), tmp_path / "again.h5", recorded.time_s, recorded.motion)
    assert (tmp_path / "again.h5").read_bytes() == built.read_bytes()


def test_a_library_that_cannot_be_written_leaves_the_one_before(built: Path, tmp_path: Path) -> None:
    file = tmp_path / "lib.h5"
    file.write_bytes(built.read_bytes())
    with pytest.raises(TypeError):
        write_library(replace(read_library(built), sampling=object()), file)
    assert file.read_bytes() == built.read_bytes()
    assert list(tmp_path.iterdir()) == [file]


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
        ("format_version", 4, "format version 4"),
        ("robot_id", "other", "'other'"),
        ("period_s", 1.0, r"1\.0 s"),
        ("robot_sha256", "00" * 32, "does not match"),
        ("robot_toml", "id = 1", "does not match"),
        ("robot_toml", b"id = \xff", "does not match"),  # not UTF-8
    ):
        copy = edited(built, tmp_path)
        with h5py.File(copy, "r+") as file:
            kind = h5py.string_dtype() if isinstance(value, bytes) else None
            file.attrs.create(attribute, value, dtype=kind)
        seal(copy)
        with pytest.raises(InputError, match=says):
            read_library(copy)
    copy = edited(built, tmp_path)
    with h5py.File(copy, "r+") as file:
        file["displacement_body"][2, 3, 1] = np.nan
    seal(copy)
    with pytest.raises(InputError, match=r"displacement_body\[2, 3, 1\]"):
        read_library(copy)
    copy = edited(built, tmp_path)
    with h5py.File(copy, "r+") as file:
        del file["displacement_body"]
        file["displacement_body"] = np.zeros((STATES, 8, 3))
    seal(copy)
    with pytest.raises(InputError, match="shape"):
        read_library(copy)


def test_bad_requests_are_refused_and_leave_nothing(tmp_path: Path) -> None:
    for states, seed, workers in (
        (0, 1, 1),
        (70000, 1, 1),
        (5, -1, 1),
        (5, 2**63, 1),
        (5, 1, 0),
        (5, 1, 9999),
    ):
        with pytest.raises(InputError):
            build_library(ROBOT, states, seed, workers, tmp_path / "x.h5")
    assert list(tmp_path.iterdir()) == []


def test_where_everything_fails_nothing_is_written(tmp_path: Path) -> None:
    box = replace(ROBOT.library_box, omega_rad_s=(1e160, 2e160))
    with pytest.raises(ConvergenceError, match=r"all 27 simulations failed.*state 0 action A.*and 7 more"):
        build_library(replace(ROBOT, library_box=box), 3, 1, 2, tmp_path / "x.h5")
    assert list(tmp_path.iterdir()) == []


@from_ci
def test_failures_are_listed_and_the_rest_survives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = box_velocities(ROBOT, 6, SEED)
    bad = good.copy()
    bad[2] = (0.01, -1e160, 0.0)
    for name, velocities in (("good", good), ("bad", bad)):
        monkeypatch.setattr(build, "sample_starts", lambda *_, v=velocities: rigid_starts(ROBOT, v))
        made = build_library(ROBOT, 6, SEED, 2, tmp_path / f"{name}.h5", record_s=0.0)
    assert len(made.failed) == 9
    assert made.failed[0].reason.startswith("its mirror image did not converge at 0.000000 s")
    library, whole = read_library(tmp_path / "bad.h5"), read_library(tmp_path / "good.h5")
    assert [(f.state, f.action) for f in library.failed] == [(2, action) for action in range(9)]
    assert "pose" in library.failed[0].reason
    assert np.isnan(library.displacement_body[2]).all()
    others = [0, 1, 3, 4, 5]
    assert np.array_equal(library.displacement_body[others], whole.displacement_body[others])
    assert library.whole_states().tolist() == [True, True, False, True, True, True]
    assert library_info(tmp_path / "bad.h5")["failed"] == 9
    tables = open_image(quantise(library))
    assert len(tables.states) == 5
    lost = replace(library, failed=tuple(Failed(s, 0, "made up") for s in range(6)))
    with pytest.raises(InputError, match="no state has all of its actions"):
        quantise(lost)


class Stop(Exception):
    pass


@from_ci
def test_a_stopped_build_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    states = count(34, 70)  # half of them simulated, 3 parts or 2
    build_library(ROBOT, states, SEED, 2, tmp_path / "whole.h5", record_s=2.0)
    out = tmp_path / "out.h5"

    def stop(done: int, _all: int) -> None:
        if done:
            raise Stop

    with pytest.raises(Stop):
        build_library(ROBOT, states, SEED, 1, out, stop, record_s=2.0)
    parts = tmp_path / "out.h5.parts"
    kept = {file.name: file.stat().st_mtime_ns for file in parts.glob("*.npz")}
    assert list(kept) == ["000000.npz"]
    assert not out.exists()
    seen: list[int] = []
    build_library(ROBOT, states, SEED, 2, out, lambda done, _all: seen.append(done), record_s=2.0)
    assert seen[0] == 16 * 2 * 9  # what was kept is not simulated again
    assert seen[-1] == states * 9
    assert out.read_bytes() == (tmp_path / "whole.h5").read_bytes()
    assert not parts.exists()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A library of three states, built in one go."""
    out = tmp_path_factory.mktemp("whole") / "whole.h5"
    build_library(ROBOT, 3, SEED, 1, out, record_s=0.0)
    return out.read_bytes()


@from_ci
@pytest.mark.parametrize("damage", some(["truncated", "other job", "other robot"], 1))
def test_parts_that_do_not_fit_are_simulated_again(tmp_path: Path, whole: bytes, damage: str) -> None:
    out = tmp_path / "out.h5"

    def stop(done: int, _all: int) -> None:
        if done:
            raise Stop

    seed = SEED + 1 if damage == "other job" else SEED
    robot = replace(ROBOT, title="another") if damage == "other robot" else ROBOT
    with pytest.raises(Stop):
        build_library(robot, 3, seed, 1, out, stop, record_s=0.0)
    part = tmp_path / "out.h5.parts" / "000000.npz"
    if damage == "truncated":
        part.write_bytes(part.read_bytes()[:-100])
    build_library(ROBOT, 3, SEED, 1, out, record_s=0.0)
    assert out.read_bytes() == whole
    assert [file.name for file in tmp_path.iterdir()] == ["out.h5"]


def test_somebody_else_s_folder_is_not_touched(tmp_path: Path) -> None:
    folder = tmp_path / "out.h5.parts"
    folder.mkdir()
    (folder / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="frogkick did not make it"):
        build_library(ROBOT, 2, SEED, 1, tmp_path / "out.h5")
    assert (folder / "thesis.txt").read_text() == "mine"


@from_ci
@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGINT")
def test_ctrl_c_ends_the_workers_and_leaves_finished_parts(tmp_path: Path) -> None:
    script = (
        "from dataclasses import replace\n"
        "from frogkick.library import build_library\n"
        "from frogkick.robot import load_robot\n"
        f"robot = replace(load_robot('frog2022'), period_s={PERIOD_MS / 1000})\n"
        "def say(done, total):\n    print(done, flush=True)\n"
        f"build_library(robot, 5000, 1, 2, {str(tmp_path / 'x.h5')!r}, say, record_s={RECORD_S})\n"
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
    process.communicate(timeout=300)
    assert process.returncode != 0
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.h5.parts"]
    deadline = time.monotonic() + 300
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


@from_ci
def test_libraries_of_swims_are_built_alike_whoever_simulates(tmp_path: Path) -> None:
    for workers, record_s in ((1, 3.0), (2, 3.0), (1, 0.0)):
        build_library(
            ROBOT,
            SWUM,
            SEED,
            workers,
            tmp_path / f"{workers}{record_s}.h5",
            sampling="visited",
            record_s=record_s,
        )
    assert (tmp_path / "13.0.h5").read_bytes() == (tmp_path / "23.0.h5").read_bytes()
    library = read_library(tmp_path / "13.0.h5")
    assert library.has_history()
    here = sample_library(ROBOT, SWUM, SEED, "visited")
    assert np.array_equal(library.previous_actions, here.previous_actions)
    assert np.array_equal(library.initial_velocity_body, here.initial_velocity_body)
    assert np.array_equal(library.rows(), here.rows())  # recording on changes nothing
    assert np.array_equal(read_library(tmp_path / "10.0.h5").rows(), here.rows())
    recorded = read_recorded(tmp_path / "13.0.h5")
    # 1.425 s lies halfway between two recorded poses.
    halfway = recorded.motion[:, :, 27:29, :3].mean(axis=2)
    assert recorded.time_s[27:29].mean() == pytest.approx(ROBOT.period_s)
    assert halfway == pytest.approx(library.displacement_body, abs=2e-3)
    info = library_info(tmp_path / "13.0.h5")
    assert info["with_history"] == (library.previous_actions[:, 0] >= 0).sum() == SWUM - 1
    other = replace(ROBOT, period_s=2.0)
    with pytest.raises(InputError, match=r"a period of 1\.425 s: build one for 2 s"):
        truncate_library(tmp_path / "13.0.h5", other)


def test_the_older_format_is_read_as_rested_limbs(built: Path, tmp_path: Path) -> None:
    copy = edited(built, tmp_path)
    with h5py.File(copy, "r+") as file:
        del file["previous_actions"]
        file.attrs["format_version"] = 2
    seal(copy)
    assert library_info(copy)["format_version"] == 2
    old, new = read_library(copy), read_library(built)
    assert not old.has_history()
    assert np.array_equal(old.rows(), new.rows())
    assert old.content_sha256() == new.content_sha256()
    for broken in (np.zeros((STATES, 3), dtype=np.int8), np.full((STATES, 8), 9, dtype=np.int8)):
        copy = edited(built, tmp_path)
        with h5py.File(copy, "r+") as file:
            del file["previous_actions"]
            file["previous_actions"] = broken
        seal(copy)
        with pytest.raises(InputError, match="previous_actions has shape"):
            read_library(copy)
