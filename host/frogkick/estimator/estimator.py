"""The state at the time of a decision, from fixes that may be late, lost, duplicate or wrong.

A duplicate filter and an outlier buffer stand before the Kalman filter (``frogkick.estimator.track``). Three
outliers in a row that agree with each other reset the pose. This is the twin of
``firmware/core/fk_estimator.c``: each operation is float32 in a fixed order, with the same bits.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from frogkick.core.arrays import Float32, UInt16
from frogkick.estimator.track import Track, sine_cosine, wrapped
from frogkick.tables.image import Tables

MARKS = 64  # accepted fixes and outliers that the duplicate filter remembers
OUTLIERS_MAX = 3  # outliers in a row that agree with each other and so reset the pose
STALE_US = 500_000  # a state is given up to this time after the newest fix
FUTURE_US = 100_000  # and from this time before it
LOST_US = 2_000_000  # a robot without a new fix for longer than this is lost
UNKNOWN_US = 10_000_000  # without a new fix for longer than this the next one starts anew
FIXES_MAX = 255  # fixes are counted up to this number
FIELD_M = np.float32(1000.0)  # largest coordinate of a fix, m, and largest heading, rad
OK, RANGE, DOUBLE, OLD, OUTLIER = 0, -3, -70, -71, -72
"""Status of a fix, as in the link's ``frames.toml``."""

OUTLIERS_AGREE_M, OUTLIERS_AGREE_MPS = np.float32(0.02), np.float32(0.15)
_OUTLIERS_AGREE_RAD, _OUTLIERS_AGREE_RAD_S = np.float32(0.35), np.float32(1.5)
_MICROSECOND = np.float32(1e-6)


@dataclass(frozen=True)
class Estimate:
    """The state at a time."""

    state: Float32  # (6,) x_m, y_m, heading_rad (world), vx_mps, vy_mps, omega_rad_s (body)
    limb_use: UInt16  # (8,) recent use of each limb
    fix_sequence: int  # number of the newest fix in it
    fixes: int  # in it, at most 255; after one the velocity is unknown and taken as zero


class Estimates(Protocol):
    """What decisions need of an estimator: ``Estimator``, or an estimator of a study."""

    @property
    def newest_capture_us(self) -> int | None: ...
    def add(self, capture_us: int, pose_world: Float32, sequence: int) -> int: ...
    def act(self, at_us: int, action: int) -> None: ...
    def at(self, at_us: int) -> Estimate | None: ...


@dataclass(frozen=True)
class _Fix:
    capture_us: int
    pose: Float32
    sequence: int

    @property
    def mark(self) -> tuple[int, bytes]:
        """Key of the duplicate filter; the capture time of a duplicate may differ."""
        return self.sequence & 0xFFFF, self.pose.tobytes()


class Estimator:
    """Predicts from decision to decision with a table, and corrects the prediction by fixes."""

    def __init__(self, tables: Tables) -> None:
        self.track = Track(tables)
        self._marks: deque[tuple[int, bytes]] = deque(maxlen=MARKS)
        self.restarts = 0  # resets to outliers that agree with each other
        self.restart()

    def restart(self) -> None:
        """Forget all but restarts and what the limbs have lost, as at PARAM LEARN OFF or HELD."""
        self.track.restart()
        self._fixes = 0
        self._newest: _Fix | None = None
        self._outliers: list[_Fix] = []
        self._marks.clear()

    @property
    def newest_capture_us(self) -> int | None:
        """Capture time of the newest accepted fix; None while no state is known."""
        return self._newest.capture_us if self._newest is not None and self._fixes else None

    def add(self, capture_us: int, pose_world: Float32, sequence: int) -> int:
        """Add a fix.

        Args:
            capture_us: capture time on the clock of the decisions.
            pose_world: (3,) float32 x_m, y_m, heading_rad.
            sequence: number of the fix.

        Returns:
            OK, or why it is refused: RANGE (not finite, or beyond 1000 m or rad), DOUBLE (a duplicate), OLD
                (before the oldest instant), OUTLIER (outside the gate).
        """
        fix = _Fix(int(capture_us), np.array(pose_world, dtype=np.float32), int(sequence))
        if not (np.abs(fix.pose) <= FIELD_M).all():
            return RANGE
        if fix.mark in self._marks:
            return DOUBLE
        with np.errstate(all="ignore"):
            return self._evaluate(fix)

    def act(self, at_us: int, action: int) -> None:
        """Start an action; a second call for the same time replaces the action."""
        with np.errstate(all="ignore"):
            self._coast(at_us)
            self.track.act(at_us, action)

    def at(self, at_us: int) -> Estimate | None:
        """Return the state at a time; None if no fix is known, or the newest is over STALE_US older or
        FUTURE_US newer."""
        newest = self._newest
        if newest is None or not self._fixes or not -FUTURE_US <= at_us - newest.capture_us <= STALE_US:
            return None
        with np.errstate(all="ignore"):
            self._coast(at_us)
            if not self._fixes or at_us < self.track.instants[0].time_us:
                return None
            pose, speed = self.track.state(at_us)
            heading = wrapped(pose[2])
            sine, cosine = sine_cosine(heading)
            vx, vy = cosine * speed[0] + sine * speed[1], cosine * speed[1] - sine * speed[0]
            state = np.array([pose[0], pose[1], heading, vx, vy, speed[2]], dtype=np.float32)
        limb_use = self.track.limb_use(at_us).astype(np.uint16)
        return Estimate(state, limb_use, newest.sequence & 0xFFFF, self._fixes)

    def _coast(self, at_us: int) -> None:
        self.track.coast(at_us)
        unseen = self._newest is not None and at_us - self._newest.capture_us > UNKNOWN_US
        if not self.track.instants or unseen:
            self._fixes = 0

    def _evaluate(self, fix: _Fix) -> int:
        self._coast(fix.capture_us)
        if not self.track.instants:
            self.track.begin(fix.capture_us)
        if fix.capture_us < self.track.instants[0].time_us:
            return OLD
        self._marks.append(fix.mark)
        pose = fix.pose.copy()
        pose[2] = wrapped(pose[2])
        fix = _Fix(fix.capture_us, pose, fix.sequence)
        if self._fixes == 0:
            self._outliers = [fix]
            self._reset()
        elif self.track.update(fix.capture_us, fix.pose):
            self._accept(fix)
            self._outliers = []
        else:
            if self._outliers and not _agree(fix, self._outliers[-1]):
                self._outliers = []
            self._outliers.append(fix)
            if len(self._outliers) < OUTLIERS_MAX:
                return OUTLIER
            self.track.inflate()
            self._reset()
            self.restarts += 1
        return OK

    def _accept(self, fix: _Fix) -> None:
        if self._newest is None or self._fixes == 0 or fix.capture_us > self._newest.capture_us:
            self._newest = fix
        self._fixes = min(self._fixes + 1, FIXES_MAX)

    def _reset(self) -> None:
        """Reset the pose to the outliers, the earliest first, without those before the oldest instant."""
        kept = [fix for fix in self._outliers if fix.capture_us >= self.track.instants[0].time_us]
        first = min(kept, key=lambda fix: fix.capture_us)
        self.track.reset_pose(first.capture_us, first.pose)
        self._fixes = 0
        self._accept(first)
        for fix in kept:
            if fix is not first:
                self.track.update(fix.capture_us, fix.pose, gated=False)
                self._accept(fix)
        self._outliers = []


def _agree(a: _Fix, b: _Fix) -> bool:
    apart_s = np.float32(abs(a.capture_us - b.capture_us)) * _MICROSECOND
    offset = a.pose - b.pose
    reach_m = OUTLIERS_AGREE_M + OUTLIERS_AGREE_MPS * apart_s
    near = offset[0] * offset[0] + offset[1] * offset[1] <= reach_m * reach_m
    return bool(near and abs(wrapped(offset[2])) <= _OUTLIERS_AGREE_RAD + _OUTLIERS_AGREE_RAD_S * apart_s)
