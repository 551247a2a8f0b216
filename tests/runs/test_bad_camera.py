"""Runs with fixes late, lost, doubled, out of order, wrong: the same decisions everywhere, near the truth."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.runs import rig

from frogkick.link.layout import link_layout
from frogkick.paths import shape
from frogkick.pool.pool import Camera
from frogkick.runs.decision import DecisionTwin
from frogkick.runs.record import Recording
from frogkick.runs.replay import compare, replay, replay_on_host
from frogkick.runs.runlog import RunLog
from frogkick.runs.summary import true_poses_at

BAD = Camera(rate_hz=15.0, jitter_s=0.2, lost=0.2, doubled=0.1, held=0.1, outliers=0.05)
STATUS = link_layout().status


def bad_pool(path_name: str, camera: Camera = BAD, seed: int = 0) -> rig.FadingPool:
    path = shape(path_name)
    start = (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0]))
    return rig.FadingPool(rig.robot(), start, camera, np.random.default_rng(seed))


@functools.cache
def run(place: str, onboard: bool = True) -> Recording:
    return rig.swim(place, "ellipse", 14.0, onboard=onboard, pool=bad_pool("ellipse"))


def log_of(place: str, onboard: bool = True) -> RunLog:
    recording = run(place, onboard)
    return recording.log()


@from_ci
@pytest.mark.parametrize("place", ["virtual", "pool"])
def test_every_decision_on_board_is_the_twins(place: str) -> None:
    recording = run(place)
    assert len(recording.decisions) >= 9
    assert {0, STATUS["DOUBLE"], STATUS["OUTLIER"]} <= {fix.robot_status for fix in recording.fixes}
    again = replay_on_host(
        recording.events, DecisionTwin(rig.tables(), shape("ellipse"), recording.options.config)
    )
    assert compare(recording.decisions, again) == []


@pytest.mark.parametrize("onboard", [True, False])
def test_the_state_at_decision_time_is_near_the_truth(onboard: bool) -> None:
    log = log_of("pool", onboard)
    assert log.decisions.estimate is not None
    error = log.decisions.estimate[:, :3] - true_poses_at(log, log.decisions.time_s)
    error[:, 2] = np.angle(np.exp(1j * error[:, 2]))
    away_m = np.hypot(error[:, 0], error[:, 1])
    assert away_m.max() < 0.004 and np.sqrt(np.mean(away_m**2)) < 0.0015
    assert np.abs(error[:, 2]).max() < np.deg2rad(1.5)


def test_fixes_lost_are_those_that_the_robot_refused() -> None:
    recording = run("pool")
    tracked = recording.tracking()
    refused = [fix.robot_status for fix in recording.fixes if fix.robot_status < 0]
    assert tracked.fixes_lost == recording.fixes_refused
    assert len(refused) <= tracked.fixes_lost <= len(refused) + 3, (
        "a last one or so is answered after the run"
    )
    taken = sum(fix.robot_status == 0 for fix in recording.fixes)
    assert sum(fix.robot_capture_us >= 0 for fix in recording.fixes) == taken > 100


@pytest.mark.parametrize("place", ["virtual", "pool"])
def test_the_log_is_decided_again_as_it_was(place: str) -> None:
    log = log_of("pool")
    again = replay(log, rig.tables(), run("pool").options.config, rig.port(place), host=True)
    assert again.differences == []
    assert again.agreement == 1.0
    assert (log.fixes.extra["robot_status"] == STATUS["DOUBLE"]).any()
    assert log.decisions.extra["limb_use"].shape == (len(log.decisions), 8)


def test_at_two_fixes_a_second_it_still_gets_along() -> None:
    """A decision more than half a second after the newest fix gives a rest, as the guard demands."""
    pool = bad_pool("line", Camera(rate_hz=2.0))
    recording = rig.swim("pool", "line", 40.0, pool=pool)
    statuses = [d.status for d in recording.decisions]
    assert set(statuses) <= {0, STATUS["STALE"]} and statuses.count(0) > len(statuses) // 2
    assert recording.completed
    tracked = recording.tracking()
    assert tracked.mean_distance_m < 0.02 and tracked.fixes_lost == 0
