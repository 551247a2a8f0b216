"""Paths that a robot cannot simply follow: the run recovers, or ends by itself and says why."""

from __future__ import annotations

import functools
import math
import pathlib
import tempfile

import numpy as np
import pytest
from tests.conftest import from_ci, some
from tests.runs import rig

from frogkick.estimator.follow import IDLE_DECISIONS_MAX, End
from frogkick.front.tables import default_tables
from frogkick.paths import Path, from_waypoints
from frogkick.paths.shapes import circle
from frogkick.planner.plan import config_of
from frogkick.pool.native_robot import NativeRobot
from frogkick.pool.pool import Camera, Pool
from frogkick.runs.closed_loop import run_session
from frogkick.runs.record import Recording, RunOptions
from frogkick.runs.session import Session
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.firmware import Firmware, build

LIMIT_S = 150.0

# Lives as long as the test session.
_FOLDER = tempfile.TemporaryDirectory(prefix="frogkick-tests-")


@functools.cache
def tables() -> Tables:
    """The default tables, for which the planner's weights were tuned."""
    return read_image(default_tables("frog2022"))


@functools.cache
def firmware() -> Firmware:
    return build("native", default_tables("frog2022"), rig.robot(), pathlib.Path(_FOLDER.name))


def port() -> NativeRobot:
    return NativeRobot(firmware().image, len(rig.robot().limbs))


def reach_m() -> float:
    return float(tables().stroke_max_m)


RESTING = next(
    i for i, action in enumerate(rig.robot().actions) if not action.first_mask | action.second_mask
)


def polyline(*points_m: tuple[float, float]) -> Path:
    return from_waypoints(points_m, smooth=False, points=40)


STRAIGHT = polyline((0.0, 0.0), (0.5, 0.0))


def swim(
    path: Path, start: tuple[float, float, float], onboard: bool = True
) -> tuple[Recording, np.ndarray, np.ndarray]:
    """A run of the robot's own planner: recording, distance of each estimate to the path, final pose."""
    pool = Pool(rig.robot(), start, Camera(), np.random.default_rng(0))
    options = RunOptions(config_of(rig.robot().planner), onboard, LIMIT_S)
    recording = run_session(Session(port()), pool, Recording(rig.robot(), tables(), path, options))
    places = np.array([decision.estimate[:2] for decision in recording.decisions], dtype=np.float64)
    return recording, path.distance_m(places), pool.state()[0]


@pytest.mark.parametrize(
    ("path", "start"),
    some(
        [
            # Seven reaches ahead, and beside; then nearly two reaches beside.
            pytest.param(polyline((0.4, 0.1), (0.8, 0.1)), (0.0, 0.0, 0.0), id="far ahead"),
            pytest.param(polyline((0.0, 0.0), (0.4, 0.0)), (0.0, 0.1, 0.0), id="beside"),
            pytest.param(STRAIGHT, (0.0, 0.0, math.radians(45.0)), id="askew"),
            pytest.param(STRAIGHT, (0.0, 0.0, math.radians(90.0)), id="across"),
            pytest.param(STRAIGHT, (0.0, 0.0, math.radians(-90.0)), id="across to the right"),
            pytest.param(polyline((0.0, 0.0), (-0.5, 0.0)), (0.0, 0.0, 0.0), id="behind"),
        ],
        3,
    ),
)
def test_a_path_that_can_be_reached_is_reached_and_followed(
    path: Path, start: tuple[float, float, float]
) -> None:
    recording, distance_m, pose = swim(path, start)
    assert (recording.completed, recording.ended) == (True, End.COMPLETED.value)
    askew_rad = abs(math.remainder(start[2] - float(path.tangent_rad[0]), 2.0 * math.pi))
    assert max(distance_m[0], askew_rad) > 0.09, "it is not on its way from the start"
    assert distance_m[-3:].max() < 0.5 * reach_m()
    assert math.dist(pose[:2], path.points_m[-1]) < reach_m()
    assert recording.end_s < 0.5 * LIMIT_S


@from_ci
@pytest.mark.parametrize(
    ("path", "start"),
    some(
        [
            pytest.param(STRAIGHT, (0.0, 0.0, math.radians(135.0)), id="turned away"),
            pytest.param(polyline((0.0, 0.0), (-0.4, 0.0)), (0.0, 0.0, 0.0), id="behind, and short"),
            pytest.param(polyline((0.0, 0.0), (0.2, 0.0)), (0.4, 0.0, 0.0), id="already passed"),
            pytest.param(
                polyline((0.0, 0.0), (0.1, 0.0), (0.1, 0.05), (0.0, 0.05), (0.0, 0.1), (0.1, 0.1)),
                (0.0, 0.0, 0.0),
                id="too tight",
            ),
        ],
        2,
    ),
)
def test_a_path_beyond_the_robot_is_tried_and_its_end_told_as_it_was(
    path: Path, start: tuple[float, float, float]
) -> None:
    recording, _, pose = swim(path, start)
    actions = [decision.action for decision in recording.decisions]
    assert actions[0] != RESTING and actions.count(RESTING) < 0.5 * len(actions)
    turned_rad = [abs(math.remainder(d.estimate[2] - start[2], 2.0 * math.pi)) for d in recording.decisions]
    assert max(turned_rad) > 0.5 * math.pi, "it turns round"
    assert recording.ended in {end.value for end in End} and recording.end_s < LIMIT_S
    is_there = (
        math.dist(pose[:2], path.points_m[-1]) < 1.1 * reach_m()
    )  # completed: within a reach, by the fixes
    assert recording.completed is is_there is (recording.ended == End.COMPLETED.value)


def test_a_robot_that_cannot_move_gives_up() -> None:
    """Its limbs do nothing, so no decision moves it."""
    pool = Pool(rig.robot(), (0.0, 0.0, 0.0), Camera(), np.random.default_rng(0))
    pool.actuate = lambda limb, time_s: None
    options = RunOptions(config_of(rig.robot().planner), True, LIMIT_S)
    recording = run_session(Session(port()), pool, Recording(rig.robot(), tables(), STRAIGHT, options))
    assert (recording.completed, recording.ended) == (False, End.STALLED.value)
    assert len(recording.decisions) == IDLE_DECISIONS_MAX + 1
    assert math.dist(pool.state()[0][:2], (0.0, 0.0)) < 2e-3


def test_a_circle_much_smaller_than_the_robot_ends_before_the_time_does() -> None:
    recording, distance_m, _ = swim(circle(0.02), (0.0, 0.0, math.pi / 2))
    assert recording.ended in {end.value for end in End}
    assert recording.completed is (recording.ended == End.COMPLETED.value)
    assert recording.end_s < LIMIT_S
    # It says that it came to the end only where it did.
    assert not recording.completed or distance_m[-1] < 2 * reach_m()


def test_an_end_passed_at_a_distance_is_said_to_be() -> None:
    path, start = polyline((0.0, 0.0), (0.04, 0.0)), (0.0, 0.1, 0.0)
    recording, distance_m, pose = swim(path, start)
    assert (recording.completed, recording.ended) == (False, End.PASSED.value)
    assert pose[0] > 0.04 and distance_m[-1] > reach_m()
    again, _, _ = swim(path, start, onboard=False)
    assert (again.completed, again.ended) == (False, End.PASSED.value)
    assert [d.action for d in again.decisions] == [d.action for d in recording.decisions]
