"""A run's log in progress: rows on disk as they come, readable after a kill, removed when the run ends."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.cli.commands import frogkick
from tests.conftest import from_ci
from tests.link.live_robot import LiveRobot
from tests.link.rigged import rigged
from tests.link.swim import PATH, LivePool
from tests.link.test_run_live import command
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.link.pty_line import PtyLine
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import run_session
from frogkick.runs.decision import Decision
from frogkick.runs.lab_session import lab_session
from frogkick.runs.live_log import CUT_OFF, LiveLog, logged, part_of
from frogkick.runs.record import Recording, RunOptions
from frogkick.runs.runlog import PathChange, RunLog
from frogkick.runs.runlog_file import read_run, write_run
from frogkick.runs.summary import BATTERY_V, NO_ANSWER, lost_of

PERIOD_S = rig.PERIOD_S
OPTIONS = RunOptions(PlanConfig(), True, 1.2 * PERIOD_S)


def same_columns(one: RunLog, two: RunLog, group: str) -> None:
    first, second = getattr(one, group), getattr(two, group)
    for name in first.columns():
        assert np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True), name
    for name in first.extra:
        assert np.array_equal(first.extra[name], second.extra[name]), name


def test_it_says_what_the_whole_log_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also while the run goes on: a reader never meets half a row."""
    robot, target, seen = LiveRobot(), tmp_path / "run.h5", []
    with rigged("serial", robot, tmp_path, monkeypatch) as there:
        known = {BATTERY_V: 11.7}
        with logged(target, rig.recording(shape(PATH), OPTIONS, known=known)) as keep:

            def keep_and_look(recording: Recording) -> None:
                keep(recording)
                if len(recording.fixes) // 10 > len(seen):  # written by another thread, a moment later
                    seen.append(len(read_run(part_of(target)).fixes))

            session = lab_session(there.wire)
            recording = run_session(
                session, LivePool(robot.pulses), rig.recording(shape(PATH), OPTIONS), keep=keep_and_look
            )
            keep(recording)
    assert len(recording.decisions) >= 2 and len(seen) > 2 and seen == sorted(seen)
    whole = recording.log()
    live = read_run(part_of(target))
    assert live.measured == {BATTERY_V: 11.7}, "known before it began"
    same_columns(live, whole, "fixes")
    same_columns(live, whole, "decisions")
    assert live.path is not None and np.array_equal(live.path.points_m, shape(PATH).points_m)
    assert (live.notes, live.planner, live.table_crc) == (CUT_OFF, whole.planner, whole.table_crc)
    write_run(target, live)  # as good as any other log
    same_columns(read_run(target), whole, "fixes")


@from_ci
@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGKILL")
def test_a_killed_run_leaves_what_it_had_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot, target = LiveRobot(), tmp_path / "run.h5"
    with (
        PtyLine(tmp_path / "robot", robot) as line,
        command(line, LivePool(robot.pulses), "--out", str(target)) as process,
    ):
        deadline_s = time.monotonic() + 60.0
        while len(robot.pulses) < 2 and time.monotonic() < deadline_s:
            time.sleep(0.005)
        assert len(robot.pulses) >= 2, "it never swam"
        time.sleep(0.3)
        process.kill()
        process.wait()
        assert not target.exists()
        log = read_run(part_of(target))
    assert len(log.decisions) >= 1 and len(log.fixes) > 10
    assert (log.fixes.extra["robot_status"] == 0).mean() > 0.8
    output = frogkick(capsys, "log", "show", part_of(target), "--out", tmp_path / "killed.png", "--json")
    assert output.code == 0 and CUT_OFF in output.stdout
    assert (tmp_path / "killed.png").stat().st_size > 5000


def test_a_log_in_progress_tells_what_limbs_have_lost(tmp_path: Path) -> None:
    options, target = replace(OPTIONS, learn=True), tmp_path / "run.h5"
    lost = [(0,) * 8, (300, 0, 20_000, 0, 0, 0, 0, 0)]
    recording = rig.recording(shape(PATH), options)
    with logged(target, recording) as keep:
        recording.decisions += [Decision(0, 0, 10**6 * (at + 1), lost=lost[at]) for at in range(2)]
        keep(recording)
    live = read_run(part_of(target))
    assert live.decisions.extra["lost"].tolist() == [list(row) for row in lost]
    whole = recording.log()
    names = [limb.name for limb in rig.robot().limbs]
    assert (
        lost_of(live)
        == lost_of(whole)
        == dict(zip(names, [300 / 32767, 0.0, 20_000 / 32767, 0.0], strict=True))
    )
    same_columns(live, whole, "decisions")


@contextmanager
def empty_log(tmp_path: Path) -> Iterator[LiveLog]:
    live = LiveLog(tmp_path / "run.h5", rig.recording(shape(PATH), OPTIONS).log())
    try:
        yield live
    finally:
        live.close()


def test_a_log_cut_amid_a_row_is_read_up_to_the_row_before(tmp_path: Path) -> None:
    recording = rig.swim("pool", PATH, 4.0)
    with empty_log(tmp_path) as live:
        live.keep(recording)
    whole = read_run(live.path)
    with h5py.File(live.path, "r+") as file:  # a kill between two columns
        file["fixes/heading_rad"].resize(len(whole.fixes) - 1, axis=0)
        file["decisions/cost"].resize(len(whole.decisions) - 1, axis=0)
    cut = read_run(live.path)
    assert len(cut.fixes) == len(whole.fixes) - 1 and len(cut.decisions) == len(whole.decisions) - 1
    assert np.array_equal(cut.fixes.x_m, whole.fixes.x_m[:-1])


def test_a_decision_in_a_log_that_is_cut_off_has_the_fixes_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Answers to fixes that are in the file already are written before the decisions that used them."""
    recording, seen, flush = rig.swim("pool", PATH, 4.0), dict[int, bool](), h5py.Dataset.flush
    unheard = {"robot_capture_us": -1, "robot_status": NO_ANSWER, "heard_us": -1, "heard_after": -1}
    sent = replace(recording, decisions=[], fixes=[replace(fix, **unheard) for fix in recording.fixes])

    def flush_and_look(data: h5py.Dataset) -> None:
        flush(data)
        log = read_run(live.path)
        newest = log.decisions.fix_sequence
        known = bool((log.fixes.extra["heard_us"][newest[newest >= 0]] >= 0).all())
        seen[len(newest)] = seen.get(len(newest), True) and known

    with empty_log(tmp_path) as live:
        live.keep(sent)
        live.settle()
        monkeypatch.setattr(h5py.Dataset, "flush", flush_and_look)
        live.keep(recording)
        live.settle()
        monkeypatch.undo()
    assert seen == {0: True, len(recording.decisions): True}
    same_columns(read_run(live.path), recording.log(), "fixes")


def test_a_decision_in_a_log_that_is_cut_off_has_the_path_that_it_follows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A path is written before the decisions that follow it."""
    recording, seen, flush = rig.swim("pool", PATH, 4.0), list[tuple[int, int]](), h5py.Dataset.flush
    other = shape("ellipse")
    empty = replace(
        rig.recording(shape(PATH), OPTIONS).log(), then=(PathChange(-1, shape(PATH), (0.0, 0.0, 0)),)
    )
    live = LiveLog(tmp_path / "run.h5", empty)

    def flush_and_look(data: h5py.Dataset) -> None:
        flush(data)
        log = read_run(live.path)
        seen.append((len(log.decisions), len(log.then)))

    monkeypatch.setattr(h5py.Dataset, "flush", flush_and_look)
    live.keep(replace(recording, then=[PathChange(1, other)]))
    live.close()
    assert len(recording.decisions) >= 2
    assert set(seen) == {(0, 0), (len(recording.decisions), 1)}
    (change,) = read_run(live.path).then
    assert change.decision == 1 and np.array_equal(change.path.points_m, other.points_m)
    assert change.hold is None, "the room was one for a hold"


def test_a_run_that_never_began_leaves_nothing(tmp_path: Path) -> None:
    """A source of fixes that ends before START, or Ctrl-C before the robot is armed."""
    target = tmp_path / "new" / "run.h5"
    with logged(target, rig.recording(shape(PATH), OPTIONS)):
        assert part_of(target).exists()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "other").write_text("of the user's")
    with pytest.raises(KeyboardInterrupt), logged(target, rig.recording(shape(PATH), OPTIONS)):
        raise KeyboardInterrupt
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["other"]


def test_a_folder_that_cannot_be_written_to_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    log = logged(tmp_path / "file" / "run.h5", rig.recording(shape(PATH), OPTIONS))
    with pytest.raises(InputError, match="choose another --out"), log:
        pass


def test_a_full_disk_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = rig.swim("pool", PATH, 4.0)

    def full(*_values: object, **_more: object) -> None:
        raise OSError(28, "No space left on device")

    def go() -> None:
        with empty_log(tmp_path) as live:
            monkeypatch.setattr(h5py.Dataset, "flush", full)
            live.keep(recording)
            live.settle()
            monkeypatch.undo()
            with pytest.raises(InputError, match="is the disk full"):
                live.keep(recording)
            assert not live._thread.is_alive()

    with pytest.raises(InputError, match="is the disk full"):  # what was lost is told at the end as well
        go()
