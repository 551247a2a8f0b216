"""What the model missed: the predicted pose a period ahead against what happened."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError, body_from_world, wrap_angle
from frogkick.runs.runlog import RunLog

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Residual:
    """One row for each period with a prediction and a measured end.

    Attributes:
        time_s: (n,) decision time.
        gap_body: (n, 3) happened minus predicted pose: forward, left (m) in the body frame at the decision,
            heading (rad), wrapped.
    """

    time_s: FloatArray
    gap_body: FloatArray

    @property
    def error(self) -> PredictionError:
        """Root mean square over all rows."""
        return PredictionError.of(self.gap_body)


def true_poses_at(run: RunLog, time_s: npt.ArrayLike) -> FloatArray:
    """(n, 3) true poses of a simulated run, interpolated between its pictures; headings not wrapped."""
    if run.truth is None or len(run.truth) < 2:
        raise InputError(f"run {run.source!r} has no truth: only a simulated run knows it")
    poses = np.array(run.truth.pose_world)
    poses[:, 2] = np.unwrap(poses[:, 2])
    at = np.asarray(time_s, dtype=np.float64)
    return np.column_stack([np.interp(at, run.truth.time_s, poses[:, k]) for k in range(3)])


def residual(run: RunLog) -> Residual:
    """Compare each prediction of a simulated run with the true pose a period later.

    Raises:
        InputError: no predictions in the run, or no truth, or not one whole period.
    """
    decisions = run.decisions
    if decisions.predicted is None or decisions.estimate is None:
        raise InputError(f"run {run.source!r} holds no predictions: log one with 'frogkick run'")
    end_s = decisions.time_s + run.period_s
    last_s = run.truth.time_s[-1] if run.truth is not None and len(run.truth) else -np.inf
    rows = np.flatnonzero(np.isfinite(decisions.predicted[:, 0]) & (end_s <= last_s))
    if rows.size == 0:
        raise InputError(f"run {run.source!r} has no whole period with a prediction: let it run longer")
    happened = true_poses_at(run, end_s[rows])
    gap = body_from_world(decisions.estimate[rows, 2], happened - decisions.predicted[rows, :3])
    gap[:, 2] = wrap_angle(gap[:, 2])
    return Residual(np.array(decisions.time_s[rows]), gap)
