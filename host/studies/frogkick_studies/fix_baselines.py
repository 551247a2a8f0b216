"""Two simple ways from fixes to a state, to compare the robot's estimator with."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from frogkick.core.poses import body_from_world, wrap_angle
from frogkick.estimator.estimator import FIELD_M, FUTURE_US, OK, OLD, RANGE, STALE_US, Estimate

FloatArray = npt.NDArray[np.float64]

LINE_FIXES_MAX = 8
LINE_WINDOW_S = 0.25


class _FromLastFixes(ABC):
    """Keeps the last fixes in order of capture; knows nothing of strokes."""

    def __init__(self) -> None:
        self._fixes: list[tuple[int, FloatArray, int]] = []

    @property
    def newest_capture_us(self) -> int | None:
        """Capture time of the newest fix, None before the first."""
        return self._fixes[-1][0] if self._fixes else None

    def add(self, capture_us: int, pose_world: npt.NDArray[np.float32], sequence: int) -> int:
        """Take a fix that is newer than the newest."""
        if not (np.abs(pose_world) <= FIELD_M).all():
            return RANGE
        if self._fixes and capture_us <= self._fixes[-1][0]:
            return OLD
        self._fixes = [*self._fixes[1 - LINE_FIXES_MAX :], (capture_us, pose_world.astype(float), sequence)]
        return OK

    def act(self, at_us: int, action: int) -> None:
        """Strokes do not matter here."""
        del at_us, action

    def at(self, at_us: int) -> Estimate | None:
        """The state at a time; None where no fix is near enough to it."""
        if not self._fixes or not -FUTURE_US <= at_us - self._fixes[-1][0] <= STALE_US:
            return None
        pose, speed = self._state((at_us - self._fixes[-1][0]) * 1e-6)
        heading = wrap_angle(pose[2])
        state = [*pose[:2], heading, *body_from_world(heading, np.asarray(speed))]
        use = np.zeros(8, dtype=np.uint16)
        return Estimate(np.array(state, dtype=np.float32), use, self._fixes[-1][2], len(self._fixes))

    @abstractmethod
    def _state(self, lead_s: float) -> tuple[FloatArray, FloatArray]:
        """Pose and speed (3,), world, a time after the newest fix."""

    def _before_newest(self) -> tuple[FloatArray, FloatArray]:
        """Times (n,) s and poses (n, 3) relative to the newest fix, the short way round."""
        newest_us, newest, _ = self._fixes[-1]
        time_s = np.array([(time_us - newest_us) * 1e-6 for time_us, _, _ in self._fixes])
        poses = np.array([pose - newest for _, pose, _ in self._fixes])
        poses[:, 2] = np.angle(np.exp(1j * poses[:, 2]))
        return time_s, poses


class DifferenceEstimator(_FromLastFixes):
    """The paper's way: the pose is the newest fix, the velocity the difference of the last two.

    Source: Huang et al. 2022, section on closed-loop control; their logger's xdot, ydot, thetadot.
    """

    def _state(self, lead_s: float) -> tuple[FloatArray, FloatArray]:
        time_s, poses = self._before_newest()
        speed = -poses[-2] / -time_s[-2] if len(time_s) > 1 else np.zeros(3)
        return self._fixes[-1][1], speed


class LineEstimator(_FromLastFixes):
    """A straight line by least squares through the fixes of the last quarter second, to the asked time."""

    def _state(self, lead_s: float) -> tuple[FloatArray, FloatArray]:
        time_s, poses = self._before_newest()
        recent = time_s >= -LINE_WINDOW_S
        time_s, poses = time_s[recent], poses[recent]
        off_s = time_s - time_s.mean()
        spread = (off_s**2).sum()
        speed = (off_s[:, None] * poses).sum(axis=0) / spread if spread > 0.0 else np.zeros(3)
        return self._fixes[-1][1] + poses.mean(axis=0) + speed * (lead_s - time_s.mean()), speed
