"""Replay: recorded runs of the paper, and our own logs decided again as they were."""

from __future__ import annotations

import dataclasses
import pathlib

import numpy as np
import pytest
from tests.conftest import count, some
from tests.runs import rig

from frogkick.core.errors import InputError
from frogkick.planner.plan import PlanConfig
from frogkick.runs.recorded.importer import RUN_NAME, load_run
from frogkick.runs.replay import Replay, replay
from frogkick.runs.runlog import Decisions, FixFlag, RunLog
from frogkick.runs.runlog_file import read_run, write_run


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


def test_decisions_that_differ_leave_the_host_s_estimates_alone(own_log: RunLog) -> None:
    """The robot swam what it had decided, whatever another planner would have had it swim."""
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
