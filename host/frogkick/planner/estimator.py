"""The estimator's twin: the state at a decision's time, from late position fixes.

A straight line through the last few fixes (ordinary least squares), taken to the asked time. Every
operation is float32 in one order; the C is ``firmware/core/fk_estimator.c``, written separately, and both
give the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frogkick.planner.kernel import sincos, wrap_angle

FIXES_MAX = 8
WINDOW_US = 250_000
STALE_US = 500_000
FUTURE_US = 100_000
LOST_US = 2_000_000
FIELD_M = np.float32(1000.0)

_MICROSECOND = np.float32(1e-6)
_ZERO = np.float32(0.0)
HEADING = 2


@dataclass(frozen=True)
class Estimate:
    """The state at a time.

    Attributes:
        state: (6,) float32 x_m, y_m, heading_rad (world), vx_mps, vy_mps, omega_rad_s (body).
        fix_sequence: newest fix used.
        fixes: fixes used; 1 = the velocity is unknown and taken as zero.
    """

    state: npt.NDArray[np.float32]
    fix_sequence: int
    fixes: int


class Estimator:
    """Keeps the last fixes and estimates from them."""

    def __init__(self) -> None:
        self._capture_us: list[int] = []
        self._poses: list[tuple[np.float32, np.float32, np.float32]] = []
        self._sequences: list[int] = []

    @property
    def newest_capture_us(self) -> int | None:
        """Capture time of the newest fix, None before the first."""
        return self._capture_us[-1] if self._capture_us else None

    def add(self, capture_us: int, pose_world: npt.NDArray[np.float32], sequence: int) -> bool:
        """Take a fix.

        Args:
            capture_us: capture time on the clock that the decisions use.
            pose_world: (3,) float32 x_m, y_m, heading_rad.
            sequence: number of the fix.

        Returns:
            False where the fix is refused: not finite, beyond 1000 m or rad, or not newer than the newest.
        """
        pose = [np.float32(value) for value in pose_world]
        if not all(abs(value) <= FIELD_M for value in pose):
            return False
        if self._capture_us and capture_us <= self._capture_us[-1]:
            return False
        self._capture_us.append(int(capture_us))
        self._poses.append((pose[0], pose[1], np.float32(wrap_angle(pose[HEADING]))))
        self._sequences.append(int(sequence))
        if len(self._capture_us) > FIXES_MAX:
            del self._capture_us[0], self._poses[0], self._sequences[0]
        return True

    def at(self, at_us: int) -> Estimate | None:
        """The state at a time; None where no fix is near enough to it."""
        if not self._capture_us:
            return None
        newest_us = self._capture_us[-1]
        lead_us = at_us - newest_us
        if lead_us > STALE_US or lead_us < -FUTURE_US:
            return None
        rows = [i for i, time_us in enumerate(self._capture_us) if newest_us - time_us <= WINDOW_US]
        ages_us = [self._capture_us[i] - newest_us for i in rows]
        poses = [self._poses[i] for i in rows]
        return Estimate(_line_at(ages_us, poses, lead_us), self._sequences[-1], len(rows))


def _mean(values: list[np.float32]) -> np.float32:
    total = _ZERO
    for value in values:
        total = total + value
    return np.float32(total / np.float32(len(values)))


def _slope(
    t_s: list[np.float32], t_mean: np.float32, values: list[np.float32], mean: np.float32
) -> np.float32:
    """Least-squares slope; zero where all times are one."""
    above, below = _ZERO, _ZERO
    for t, value in zip(t_s, values, strict=True):
        dt = t - t_mean
        below = below + dt * dt
        above = above + dt * (value - mean)
    return np.float32(above / below) if below > _ZERO else _ZERO


def _line_at(
    ages_us: list[int], poses: list[tuple[np.float32, np.float32, np.float32]], lead_us: int
) -> npt.NDArray[np.float32]:
    """Fit x(t), y(t), heading(t) relative to the newest fix (the last row), evaluate a lead after it.

    numpy's float32 scalars round each operation once, as the C does.
    """
    last = poses[-1]
    t_s = [np.float32(age_us) * _MICROSECOND for age_us in ages_us]
    t_mean = _mean(t_s)
    lead_s = np.float32(lead_us) * _MICROSECOND - t_mean
    at, slopes = [], []
    for k in range(3):
        offsets = [np.float32(pose[k] - last[k]) for pose in poses]
        if k == HEADING:
            offsets = [np.float32(wrap_angle(offset)) for offset in offsets]
        mean = _mean(offsets)
        slopes.append(_slope(t_s, t_mean, offsets, mean))
        at.append(last[k] + (mean + slopes[k] * lead_s))
    heading = np.float32(wrap_angle(at[HEADING]))
    sine, cosine = (np.float32(value) for value in sincos(heading))
    vx = cosine * slopes[0] + sine * slopes[1]
    vy = cosine * slopes[1] - sine * slopes[0]
    return np.array([at[0], at[1], heading, vx, vy, slopes[HEADING]], dtype=np.float32)
