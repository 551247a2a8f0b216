"""Replay: recorded runs of the paper, and our own logs whose decisions are repeated exactly."""

from __future__ import annotations

import dataclasses
import pathlib

import numpy as np
import pytest
from tests.conftest import count, some
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.pool.native_robot import CoreCall, NativeRobot
from frogkick.runs.chip_log import LATE
from frogkick.runs.closed_loop import run_session
from frogkick.runs.decision import Decision
from frogkick.runs.record import RunOptions
from frogkick.runs.recorded.importer import RUN_NAME, load_run
from frogkick.runs.replay import Replay, replay
from frogkick.runs.runlog import Decisions, FixFlag, RunLog
from frogkick.runs.runlog_file import read_run, write_run
from frogkick.runs.session import Session


def both(run: RunLog, place: str, depth: int = 1) -> Replay:
    return replay(run, rig.tables(), PlanConfig(depth=depth), rig.port(place), host=True)


@pytest.mark.parametrize(
    ("name", "place", "depth"),
    some([("line1", "virtual", 3), ("line1", "virtual", 1), ("sin1", "pool", 1), ("ellipse1", "pool", 3)], 2),
)
def test_recorded_runs_are_decided_alike_on_board_and_on_the_host(
    frog2022_dir: pathlib.Path, name: str, place: str, depth: int
) -> None:
    run = load_run(frog2022_dir / "control" / f"{name}.csv")
    result = both(run, place, depth)
    assert result.differences == []
    assert len(result.onboard) == len(result.host) == len(run.decisions) > 0
    assert [d.scheduled_us for d in result.onboard] == [d.scheduled_us for d in result.host]
    assert sum(d.status == 0 for d in result.onboard) > len(run.decisions) // 2
    assert result.agreement is not None and 0.0 <= result.agreement <= 1.0


def test_all_recorded_runs(frog2022_dir: pathlib.Path) -> None:
    files = [file for file in sorted((frog2022_dir / "control").iterdir()) if RUN_NAME.fullmatch(file.name)]
    for file in files[: count(2, len(files))]:
        assert both(load_run(file), "pool").differences == [], file.name


@pytest.fixture(scope="module")
def own_log(tmp_path_factory: pytest.TempPathFactory) -> RunLog:
    recording = rig.swim("pool", "sine", 8.0, depth=2)
    log = recording.log()
    target = tmp_path_factory.mktemp("log") / "run.h5"
    write_run(target, log)
    return read_run(target)


@pytest.mark.parametrize("place", ["virtual", "pool"])
def test_our_own_log_gives_the_decisions_that_were_logged(own_log: RunLog, place: str) -> None:
    result = both(own_log, place, depth=2)
    assert result.differences == []
    assert result.actions == [own_log.action_names[index] for index in own_log.decisions.action]
    assert result.agreement == 1.0


def test_the_host_alone_decides_our_own_log_again(own_log: RunLog) -> None:
    result = replay(own_log, rig.tables(), PlanConfig(depth=2), None, host=True)
    assert result.agreement == 1.0
    assert result.onboard == [] and result.differences == []
    assert result.recorded == result.actions


def made_again(made: list[Decision], log: RunLog) -> bool:
    """Whether estimates and costs of decisions equal those of a log to the bit."""
    decisions = log.decisions
    assert decisions.cost is not None and decisions.estimate is not None
    return [one.cost for one in made] == decisions.cost.tolist() and np.array_equal(
        [one.estimate for one in made], decisions.estimate
    )


@pytest.mark.parametrize("onboard", [True, False])
def test_each_bit_of_a_decision_is_made_again(own_log: RunLog, onboard: bool) -> None:
    """The log has each fix as the planner received it: at which microsecond, and between which decisions."""
    log = own_log
    if not onboard:
        log = rig.swim("pool", "sine", 8.0, depth=2, onboard=False).log()
    assert (log.fixes.extra["heard_us"] >= 0).sum() > 50 and np.ptp(log.fixes.extra["heard_after"]) > 5
    on_host = replay(log, rig.tables(), PlanConfig(depth=2), None, host=True)
    assert made_again(on_host.host, log)
    result = both(log, "pool", depth=2)
    assert result.differences == [] and made_again(result.onboard, log)
    # A log that is wrong by a microsecond in one fix, or in its place among the decisions, is not the same.
    for name in ("heard_us", "heard_after"):
        changed = log.fixes.extra[name].copy()
        changed[-20] += 1
        extra = {**log.fixes.extra, name: changed}
        other = dataclasses.replace(log, fixes=dataclasses.replace(log.fixes, extra=extra))
        assert not made_again(replay(other, rig.tables(), PlanConfig(depth=2), None, host=True).host, log), (
            name
        )


class Late(NativeRobot):
    """A robot whose port is too late to begin its third stroke, so that the stroke is refused."""

    begun = 0

    def turn(self, now_us: int, frame: bytes) -> CoreCall:
        call = super().turn(now_us, frame)
        if not call.outputs[0]:
            return call
        self.begun += 1
        if self.begun != 3:
            return call
        self._core.fk_robot_note_pulse_failed(self._memory, LATE)
        return dataclasses.replace(call, outputs=(0, *call.outputs[1:]))


@pytest.mark.parametrize("onboard", [True, False])
def test_a_stroke_that_was_refused_is_none_in_a_replay(onboard: bool) -> None:
    pool, options = rig.new_pool("sine"), RunOptions(PlanConfig(depth=1), onboard, 8.0)
    port = Late(rig.firmware("native").image, len(rig.robot().limbs))
    recording = run_session(Session(port), pool, rig.recording(shape("sine"), options, pool))
    assert len(recording.rested) == 1 and max(recording.rested) < 4 < len(recording.decisions)
    log = recording.log()
    assert (
        (log.decisions.extra["rested_us"] >= 0).sum() == 1 == (log.decisions.extra["rested_after"] > 9).sum()
    )
    assert made_again(replay(log, rig.tables(), PlanConfig(depth=1), None, host=True).host, log)
    extra = {name: column for name, column in log.decisions.extra.items() if name != "rested_us"}
    untold = dataclasses.replace(log, decisions=dataclasses.replace(log.decisions, extra=extra))
    assert not made_again(replay(untold, rig.tables(), PlanConfig(depth=1), None, host=True).host, log)


def test_a_chip_has_the_fixes_again_within_two_microseconds(own_log: RunLog) -> None:
    """The chip polls its line at its own times, so the last digits of its estimates differ."""
    found = both(own_log, "virtual", depth=2)
    assert found.differences == [] and found.agreement == 1.0 and own_log.decisions.estimate is not None
    estimates = np.array([one.estimate for one in found.onboard])
    assert estimates == pytest.approx(own_log.decisions.estimate, abs=1e-5)


def test_a_log_from_before_has_the_times_of_its_fixes_in_seconds(own_log: RunLog) -> None:
    """An older log has the fixes' times in seconds only, and so has one in which no fix was answered."""
    extra = {key: own_log.fixes.extra[key] for key in ("sequence", "robot_capture_us", "robot_status")}
    nothing = np.full(len(own_log.fixes), -1)
    for place, heard in ((None, {}), ("pool", {}), ("pool", {"heard_us": nothing, "heard_after": nothing})):
        fixes = dataclasses.replace(own_log.fixes, extra={**extra, **heard})
        older = dataclasses.replace(own_log, fixes=fixes)
        port = None if place is None else rig.port(place)
        found = replay(older, rig.tables(), PlanConfig(depth=2), port, host=True)
        assert found.differences == [] and own_log.decisions.estimate is not None
        estimates = np.array([one.estimate for one in found.host])
        assert estimates == pytest.approx(own_log.decisions.estimate, abs=1e-3)


def test_decisions_that_differ_leave_the_host_s_estimates_alone(own_log: RunLog) -> None:
    """The robot swam what it had decided, whatever another planner decides in the replay."""
    as_swum, other = (
        replay(own_log, rig.tables(), PlanConfig(depth=depth, angle_weight_per_rad=weight), None, host=True)
        for depth, weight in ((2, 50.0), (1, 5000.0))
    )
    assert as_swum.agreement == 1.0 and other.agreement is not None and other.agreement < 0.8
    for one, another in zip(as_swum.host, other.host, strict=True):
        assert one.estimate.tobytes() == another.estimate.tobytes() and one.limb_use == another.limb_use


def test_a_run_without_what_a_replay_needs_is_refused(own_log: RunLog) -> None:
    bare = dataclasses.replace(own_log, path=None)
    with pytest.raises(InputError, match="has no path"):
        both(bare, "pool")
    none = dataclasses.replace(own_log, decisions=Decisions([], [], [], []))
    with pytest.raises(InputError, match="no decisions"):
        both(none, "pool")
    lost = np.full(len(own_log.fixes), int(FixFlag.MISSING))
    blind = dataclasses.replace(own_log, fixes=dataclasses.replace(own_log.fixes, flags=lost))
    with pytest.raises(InputError, match="no usable fix"):
        both(blind, "pool")
