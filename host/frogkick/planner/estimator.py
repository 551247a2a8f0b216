"""The estimator's twin: the state at a decision's time, from late position fixes.

A straight line through the last few fixes (ordinary least squares), taken to the asked time. Every operation is
float32 in one order; the C is ``firmware/core/fk_estimator.c``, written separately, and both give the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from frogkick.planner.math32 import velocity_to_body, wrap_angle

FIXES_MAX = 8
WINDOW_US = 250_000
STALE_US = 500_000
FUTURE_US = 100_000
LOST_US = 2_000_000
FIELD_M = np.float32(1000.0)

_MICROSECOND = np.float32(1e-6)
_ZERO = np.float32(0.0)


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
        self._poses.append((pose[0], pose[1], wrap_angle(pose[2])))
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
        ages = np.array([self._capture_us[i] - newest_us for i in rows], dtype=np.int32)
        poses = np.array([self._poses[i] for i in rows], dtype=np.float32)
        return Estimate(_line_at(ages, poses, np.int32(lead_us)), self._sequences[-1], len(rows))


@nb.njit(cache=True)
def _slope(
    t: npt.NDArray[np.float32], t_mean: np.float32, v: npt.NDArray[np.float32], v_mean: np.float32
) -> np.float32:
    above, below = _ZERO, _ZERO
    for i in range(t.shape[0]):
        dt = np.float32(t[i] - t_mean)
        below = np.float32(below + np.float32(dt * dt))
        above = np.float32(above + np.float32(dt * np.float32(v[i] - v_mean)))
    if below > _ZERO:
        return np.float32(above / below)
    return _ZERO


@nb.njit(cache=True)
def _mean(v: npt.NDArray[np.float32]) -> np.float32:
    total = _ZERO
    for i in range(v.shape[0]):
        total = np.float32(total + v[i])
    return np.float32(total / np.float32(v.shape[0]))


@nb.njit(cache=True)
def _line_at(
    ages_us: npt.NDArray[np.int32], poses: npt.NDArray[np.float32], lead_us: np.int32
) -> npt.NDArray[np.float32]:
    """Fit x(t), y(t), heading(t) relative to the newest fix (the last row) and evaluate at its time + lead."""
    n = ages_us.shape[0]
    t = np.empty(n, dtype=np.float32)
    offsets = np.empty((3, n), dtype=np.float32)
    last = poses[n - 1]
    for i in range(n):
        t[i] = np.float32(np.float32(ages_us[i]) * _MICROSECOND)
        offsets[0, i] = np.float32(poses[i, 0] - last[0])
        offsets[1, i] = np.float32(poses[i, 1] - last[1])
        offsets[2, i] = wrap_angle(np.float32(poses[i, 2] - last[2]))
    t_mean = _mean(t)
    lead_s = np.float32(np.float32(np.float32(lead_us) * _MICROSECOND) - t_mean)
    at = np.empty(3, dtype=np.float32)
    slopes = np.empty(3, dtype=np.float32)
    for k in range(3):
        mean = _mean(offsets[k])
        slopes[k] = _slope(t, t_mean, offsets[k], mean)
        at[k] = np.float32(last[k] + np.float32(mean + np.float32(slopes[k] * lead_s)))
    heading = wrap_angle(at[2])
    vx, vy = velocity_to_body(heading, slopes[0], slopes[1])
    state = np.empty(6, dtype=np.float32)
    state[0], state[1], state[2] = at[0], at[1], heading
    state[3], state[4], state[5] = vx, vy, slopes[2]
    return state
