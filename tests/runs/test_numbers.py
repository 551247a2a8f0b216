"""Numbers of a run: residual, distance and progress along a path, tracking, JSON."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from frogkick.core.errors import InputError
from frogkick.paths import Path, line, wrap_angle
from frogkick.runs.runlog import Decisions, Fixes, RunLog, Strokes, Truth
from frogkick.runs.summary import along_paths, residual, summary, true_poses_at

PERIOD_S = 1.4


def synthetic_run(offset_body_m: tuple[float, float], turn_rad: float) -> RunLog:
    """A robot on a circle whose predictions have a known offset in the body frame at each decision."""
    time_s = np.arange(0.0, 12.0, 0.02)

    def pose(at: np.ndarray) -> np.ndarray:
        angle = 0.9 * at  # more than a whole turn, so that headings wrap
        return np.column_stack([0.1 * np.sin(angle), -0.1 * np.cos(angle), angle])

    decided_s = np.arange(1.0, 10.0, PERIOD_S)
    now, then = pose(decided_s), pose(decided_s + PERIOD_S)
    cos, sin = np.cos(now[:, 2]), np.sin(now[:, 2])
    forward, left = offset_body_m
    predicted = np.column_stack(
        [
            then[:, 0] - (cos * forward - sin * left),
            then[:, 1] - (sin * forward + cos * left),
            wrap_angle(then[:, 2] - turn_rad),
            np.zeros((len(then), 3)),
        ]
    )
    estimate = np.column_stack([now[:, :2], wrap_angle(now[:, 2]), np.zeros((len(now), 3))])
    truth = pose(time_s)
    truth[:, 2] = wrap_angle(truth[:, 2])
    count = len(decided_s)
    return RunLog(
        robot_id="frog2022",
        source="synthetic",
        period_s=PERIOD_S,
        pulse_s=0.08,
        action_names=("A", "B"),
        fixes=Fixes([0.0], [0.0], [0.0], [0.0], [0.0], [1], [0]),
        decisions=Decisions(
            time_s=decided_s,
            action=np.arange(count) % 2,
            fix_sequence=np.zeros(count, dtype=int),
            flags=np.zeros(count, dtype=int),
            estimate=estimate,
            predicted=predicted,
        ),
        strokes=Strokes([], [], []),
        path=line(0.4),
        truth=Truth(time_s, truth, np.zeros((len(time_s), 3))),
    )


@pytest.mark.parametrize(
    ("offset", "turn"), [((0.0, 0.0), 0.0), ((0.003, -0.004), 0.1), ((-0.01, 0.0), -3.0)]
)
def test_residual_is_the_offset_that_was_put_in(offset: tuple[float, float], turn: float) -> None:
    time_s, gap_body = residual(synthetic_run(offset, turn))
    # The pool's poses are interpolated between pictures: 20 ms on this circle make some 5 um.
    assert np.allclose(gap_body[:, :2], offset, atol=2e-5)
    assert np.allclose(gap_body[:, 2], turn, atol=1e-9)
    assert len(time_s) == len(gap_body) == len(synthetic_run(offset, turn).decisions)
    error = summary(synthetic_run(offset, turn))
    assert error.position_rmse_m == pytest.approx(np.hypot(*offset), abs=2e-5)
    assert error.heading_rmse_rad == pytest.approx(abs(turn), abs=1e-9)


def test_residual_counts_only_whole_periods_with_a_prediction() -> None:
    run = synthetic_run((0.001, 0.0), 0.0)
    assert run.truth is not None
    half = run.truth.time_s <= 5.0
    short = Truth(run.truth.time_s[half], run.truth.pose_world[half], run.truth.velocity_body[half])
    time_s, _ = residual(dataclasses.replace(run, truth=short))
    assert time_s.max() + PERIOD_S <= 5.0
    assert len(time_s) == int((run.decisions.time_s + PERIOD_S <= short.time_s[-1]).sum())
    with pytest.raises(InputError, match="no complete period"):
        residual(dataclasses.replace(run, truth=None))
    with pytest.raises(InputError, match="no true poses"):
        true_poses_at(dataclasses.replace(run, truth=None), [1.0])
    bare = dataclasses.replace(run.decisions, predicted=None)
    with pytest.raises(InputError, match="no predictions"):
        residual(dataclasses.replace(run, decisions=bare))


def straight(length_m: float = 0.4) -> Path:
    x = np.linspace(0.0, length_m, 100, dtype=np.float32)
    return Path(x, np.zeros_like(x), np.zeros_like(x), "straight")


def test_along_path_of_a_track_beside_a_line() -> None:
    time_s = np.linspace(2.0, 12.0, 201)
    x = np.linspace(0.0, 0.3, 201)
    mean_m, p95_m, progress_mps = along_paths(
        [(-np.inf, straight())], time_s, np.column_stack([x, np.full(201, 0.02)])
    )
    assert mean_m == pytest.approx(0.02, abs=1e-7)
    assert p95_m == pytest.approx(0.02, abs=1e-7)
    assert progress_mps == pytest.approx(0.03, rel=0.02)  # to the nearest of 100 points


def test_along_path_percentile_and_backward_progress() -> None:
    time_s = np.linspace(0.0, 10.0, 101)
    side = np.zeros(101)
    side[:11] = 0.1  # a tenth of the time far away
    x = np.linspace(0.3, 0.1, 101)
    mean_m, p95_m, progress_mps = along_paths([(-np.inf, straight())], time_s, np.column_stack([x, side]))
    assert mean_m == pytest.approx(0.1 * 11 / 101, rel=1e-5)
    assert p95_m == pytest.approx(0.1, rel=1e-5)
    assert progress_mps == pytest.approx(-0.02, rel=0.03)


def test_along_path_of_nearly_nothing_is_zero() -> None:
    assert along_paths([(-np.inf, straight())], np.array([1.0]), np.zeros((1, 3))) == (0.0, 0.0, 0.0)
    assert along_paths([(-np.inf, straight())], np.array([]), np.zeros((0, 3))) == (0.0, 0.0, 0.0)
