"""Paths that take over during a run: sent in time, followed, logged, and repeated in a replay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from tests.conftest import from_ci, some
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.link.frames import Frame, pack_frame, unpack_frame
from frogkick.link.layout import Value, link_layout
from frogkick.paths import Path, line, shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import run_session
from frogkick.runs.decision import STALE, Decision, DecisionTwin, LiveCheck
from frogkick.runs.export_csv import columns_of
from frogkick.runs.live_log import logged, part_of
from frogkick.runs.live_view import LiveView
from frogkick.runs.path_change import TRIES, NextPath, PathChanges, PathSender
from frogkick.runs.record import Recording, RunOptions
from frogkick.runs.replay import replay, replay_on_host
from frogkick.runs.runlog import PathChange, RunLog
from frogkick.runs.runlog_file import read_run, write_run
from frogkick.runs.session import LinkError, Session
from frogkick.runs.summary import bends_of, compare_runs, distances_m, summary

STATUS = link_layout().status
BESIDE = replace(line(), name="beside", y_m=line().y_m + np.float32(0.01))
THEN = (NextPath(BESIDE, 2.0), NextPath(line(), 5.0, here=True))
LIMIT_S = 6.2 * rig.PERIOD_S


def swim(place: str, plan: str = "both", keep: object = None) -> tuple[Recording, RunLog]:
    check = LiveCheck() if plan == "both" else None
    options = RunOptions(PlanConfig(depth=1), plan != "host", LIMIT_S, check, then=THEN)
    pool = rig.new_pool("line")
    keep_it = keep if callable(keep) else lambda _recording: None
    recording = run_session(
        Session(rig.port(place)), pool, rig.recording(shape("line"), options, pool), keep=keep_it
    )
    if check is not None:
        assert check.agreed == len(recording.decisions) and check.unchecked == 0
    return recording, recording.log()


@pytest.fixture(scope="module")
def swum() -> tuple[Recording, RunLog]:
    return swim("pool")


@from_ci
@pytest.mark.parametrize(
    ("place", "plan"), some([("virtual", "both"), ("pool", "host"), ("pool", "both")], 1)
)
def test_a_path_takes_over_at_the_next_decision(place: str, plan: str) -> None:
    recording, log = swim(place, plan)
    assert [change.decision for change in recording.then] == [2, 4], "2 s and 5 s, in periods of 1.425 s"
    assert recording.then[0].path is BESIDE
    begins = recording.then[1].path
    near = min(np.hypot(fix.x_m - begins.x_m[0], fix.y_m - begins.y_m[0]) for fix in recording.fixes)
    assert near < 1e-6, "here: the newest fix"
    assert [d.status for d in recording.decisions] == [0] * len(recording.decisions)
    spaced = np.diff([d.scheduled_us for d in recording.decisions])
    assert (spaced == rig.tables().period_us).all(), "no decision waits"
    assert [change.decision for change in log.then] == [2, 4]


def test_the_events_of_a_run_hold_its_paths(swum: tuple[Recording, RunLog]) -> None:
    recording, _ = swum
    again = replay_on_host(recording.events, DecisionTwin(rig.tables(), shape("line"), PlanConfig(depth=1)))
    assert not [a.differences(b) for a, b in zip(again, recording.decisions, strict=True) if a.differences(b)]


@pytest.mark.parametrize("place", ["pool", "virtual", "host"])
def test_a_replay_follows_the_change(swum: tuple[Recording, RunLog], place: str, tmp_path: FilePath) -> None:
    recording, log = swum
    write_run(tmp_path / "run.h5", log)
    read = read_run(tmp_path / "run.h5")
    assert [change.path.name for change in read.then] == ["beside", "line"]
    assert np.array_equal(read.then[1].path.points_m, recording.then[1].path.points_m)
    port = None if place == "host" else rig.port(place)
    again = replay(read, rig.tables(), PlanConfig(depth=1), port, host=True)
    assert again.differences == []
    assert again.agreement == 1.0
    made = again.onboard or again.host
    assert [round(float(d.distance_m), 3) for d in made] == [
        round(float(d.distance_m), 3) for d in recording.decisions
    ]
    alone = replay(replace(read, then=()), rig.tables(), PlanConfig(depth=1), None, host=True)
    assert alone.host[2].distance_m != made[2].distance_m


def test_a_run_is_measured_by_the_path_that_it_followed(swum: tuple[Recording, RunLog]) -> None:
    recording, log = swum
    time_s, poses = log.truth.time_s, log.truth.pose_world  # type: ignore[union-attr]
    times = [log.decisions.time_s[change.decision] for change in log.then]
    assert log.paths == [(-np.inf, log.path), (times[0], BESIDE), (times[1], log.then[1].path)]
    found = distances_m(log.paths, time_s, poses)
    before, between = time_s < times[0], (time_s >= times[0]) & (time_s < times[1])
    assert np.array_equal(found[before], log.path.distance_m(poses[before, :2]))  # type: ignore[union-attr]
    assert np.array_equal(found[between], BESIDE.distance_m(poses[between, :2]))
    reported = summary(log)
    assert (reported.path, reported.then) == ("line", ("beside", "line"))
    assert reported.mean_distance_m == log.measured["mean_distance_m"]  # as the run itself printed it
    from_track = summary(replace(log, measured={}))
    assert from_track.mean_distance_m == pytest.approx(log.measured["mean_distance_m"], rel=0.05)
    assert reported.progress_mps is not None and reported.progress_mps > 0.02
    tracked = replace(recording, pool=None).tracking()
    assert tracked.mean_distance_m == pytest.approx(log.measured["mean_distance_m"], abs=1e-3)
    assert bends_of(log, 0.03) is None
    assert compare_runs(log, log).same_path
    assert not compare_runs(log, replace(log, then=())).same_path


def test_what_is_drawn_and_exported(swum: tuple[Recording, RunLog]) -> None:
    recording, log = swum
    view = LiveView(())
    view.show(recording)
    assert view.path is recording.then[1].path
    view.show_log(log, float(log.decisions.time_s[2]))
    assert view.path is BESIDE
    view.show_log(log, 0.0)
    assert view.path is log.path
    columns = dict(columns_of(log))
    assert columns["then_1"]["decision"].tolist() == [2] * 100
    assert np.array_equal(columns["then_1"]["y_m"], BESIDE.y_m)


def test_the_log_of_a_run_that_goes_on_has_its_paths(tmp_path: FilePath) -> None:
    target, seen = tmp_path / "run.h5", []
    options = RunOptions(PlanConfig(depth=1), True, LIMIT_S, then=THEN)
    with logged(target, rig.recording(shape("line"), options)) as keep:

        def keep_and_look(recording: Recording) -> None:
            keep(recording)
            if len(recording.decisions) >= len(seen) + 1 and len(recording.fixes) % 7 == 0:
                seen.append([change.decision for change in read_run(part_of(target)).then])

        recording, _ = swim("pool", keep=keep_and_look)
    cut = read_run(part_of(target))
    assert seen[0] == [] and all(one in ([], [2], [2, 4]) for one in seen)
    assert [change.decision for change in cut.then] == [2, 4]
    assert np.array_equal(cut.then[1].path.points_m, recording.then[1].path.points_m)


def test_a_log_whose_paths_change_nowhere_is_refused(swum: tuple[Recording, RunLog]) -> None:
    _, log = swum
    for rows in ((99,), (4, 2), (-2,)):
        with pytest.raises(InputError, match="paths change at the decisions"):
            replace(log, then=tuple(PathChange(row, BESIDE) for row in rows))


class Deaf:
    """A session that records what is posted, and gets no answers."""

    link_s = 0.0

    def __init__(self) -> None:
        self.posted: list[int] = []

    def post(self, name: str, values: dict[str, Value], rows: object) -> int:
        assert name == "PATH"
        self.posted.append(int(values["first"]))
        return len(self.posted)


def answer(sequence: int, status: str) -> Frame:
    values: dict[str, Value] = {"status": STATUS[status], "received": 0}
    return unpack_frame(pack_frame("PATH", "answer", sequence, values)[:-1])


def test_a_refused_part_is_begun_anew_and_not_for_ever() -> None:
    deaf = Deaf()
    sender = PathSender(deaf)  # type: ignore[arg-type]
    assert sender.answered(answer(0, "OK")) is None, "nothing was sent"
    sender.begin(BESIDE)
    assert sender.answered(answer(9, "OK")) is None, "of another command"
    assert deaf.posted == [0]
    assert sender.answered(answer(1, "OK")) is None
    assert sender.answered(answer(2, "VALUE")) is None
    assert deaf.posted == [0, 18, 0]
    for sequence in range(3, 8):
        assert sender.answered(answer(sequence, "OK")) is None
    assert sender.answered(answer(8, "OK")) is BESIDE
    assert deaf.posted == [0, 18, 0, 18, 36, 54, 72, 90]
    sender.begin(BESIDE)
    for sequence in range(9, 8 + TRIES):
        assert sender.answered(answer(sequence, "VALUE")) is None
    with pytest.raises(LinkError, match="refuses the path 'beside' that was to take over: VALUE; run again"):
        sender.answered(answer(8 + TRIES, "VALUE"))


def test_a_path_waits_for_its_time_its_fix_and_an_estimate() -> None:
    changes = PathChanges((NextPath(BESIDE, 1.0), NextPath(line(), 2.0, here=True)))
    fix = Fix(2.0, 0.1, 0.3, 0.2, 1.0, sequence=1)
    assert changes.due(0.99, [fix], []) is None
    assert changes.due(1.0, [], []) is BESIDE
    assert changes.due(1.5, [fix], []) is None
    assert changes.due(2.0, [], []) is None
    path = changes.due(2.1, [fix], [])
    assert path is not None and (path.x_m[0], path.y_m[0]) == pytest.approx((0.3, 0.2))
    assert path.tangent_rad[0] == pytest.approx(1.0)
    assert changes.due(9.0, [fix], []) is None
    changes.arrived(path)
    stale, made = Decision(STALE, 0, 0), Decision(0, 0, 0)
    changes.decided([made, stale])
    assert changes.made == []
    changes.decided([made, stale, made])
    changes.decided([made, stale, made, made])
    assert [(one.decision, one.path) for one in changes.made] == [(2, path)]


def test_a_path_begins_at_a_pose() -> None:
    path: Path = shape("ellipse")
    placed = path.place(path.motion_to((0.5, -0.2, 2.0)))
    assert (placed.x_m[0], placed.y_m[0], placed.tangent_rad[0]) == pytest.approx((0.5, -0.2, 2.0), abs=1e-6)
