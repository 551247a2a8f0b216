"""A Kalman filter with fixed-lag smoothing, one for each of x, y and heading, in the world frame.

    state  pose and speed at the last INSTANTS instants; an instant is a time at which an action starts
    F      the table predicts the mean; for the covariance over a period T, p' = p + 0.8 T v and v' = 0.7 v
    Q      q ((0.8 T, 0.7) (0.8 T, 0.7)^T + 0.04 diag(T^2, 1)); q is adapted from the innovations, and is a
           sixteenth in a period of rest
    H      ``Profile``: the pose at any time from poses and speeds at both ends of its period
    R      the variance of a fix, and of the profile's own error
    gate   five standard deviations of the innovation and a margin, for the position and for the heading

A late fix therefore corrects the state at its own time and all states since. The filter is the twin of
fk_covariance.c and fk_track.c. It is written from their headers, with arrays that grow and shrink. Both take
the same float32 operations in the same order, and round each once.

Source: Anderson, Moore 1979, Optimal Filtering, chapter 7 (fixed-lag smoothing); Mehra 1970, IEEE Trans.
Autom. Control 15(2) (process noise from innovations).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from frogkick.core.arrays import Float32, Int64
from frogkick.core.compiled import cached_njit, stamp_of
from frogkick.estimator.profile import Profile, profile_after, profile_within, weighted
from frogkick.estimator.wear import HELD, OFF, ON, WearFilter
from frogkick.planner import floats
from frogkick.planner.lookup import DYNAMICS, arrays_of, dynamics_after, find_row, motion_of, velocity_code
from frogkick.tables.image import Tables
from frogkick.tables.layout import LIMBS_MAX

INSTANTS = 4
COASTS_MAX = 8  # periods of rest that are predicted in a row; after a longer pause the states are forgotten
COAST_US = 200_000  # an action that starts later than this after a period's end follows a period of rest
PERIOD_LEAST_US = 50_000  # an action that starts sooner than this after the one before replaces it

_F = np.float32
_MICROSECOND = _F(1e-6)
_TIME_MAX_US = 2**32 - 1
_F_POSE, _F_SPEED, _APART, _RESTING = _F(0.8), _F(0.7), _F(0.2), _F(0.0625)
_SHAPE_OF_NOISE_S2, _SHAPE_COMMON = _F(0.0064), _F(0.3)
_INFLATION = _F(4)
_SPEED_MOST = _F(1000)
_GATE, _GATE_OPEN = _F(25), _F(1e30)
_INFORMED, _RATIO_MOST = _F(0.5), _F(9)
_LEARN_PARTS = (_F(0.5), _F(0.33333334), _F(0.25), _F(0.2))
_LOWER = np.tri(2 * INSTANTS, dtype=bool)
_COVARIANCE_OF = np.array([0, 0, 1])  # which variances belong to x, y, heading


def _pair(position: float, heading: float) -> Float32:
    return np.array([position, heading], dtype=np.float32)


# Variances in m^2, (m/s)^2 and rad^2, (rad/s)^2.
_FIX = _pair(4e-8, 1.2185e-5)
_SHAPE = _pair(3.6e-7, 1.0966e-4)
_GATE_MORE = _pair(9e-6, 2.7416e-3)
_PROCESS_NOISE = _pair(1e-4, 0.030462)
_PROCESS_NOISE_LEAST = _pair(9e-8, 2.7416e-5)
_PROCESS_NOISE_MOST = _pair(3.6e-3, 1.0966)
_POSE_UNKNOWN = _pair(0.01, 1.0)
_SPEED_UNKNOWN = _pair(2.5e-3, 1.0)


def wrapped(angle: np.float32) -> np.float32:
    """Return an angle in (-pi, pi] as float32, because numba returns a float of Python."""
    return np.float32(floats.wrap_angle(angle))


def sine_cosine(angle: np.float32) -> tuple[np.float32, np.float32]:
    """Return sine and cosine of an angle as float32; see ``wrapped``."""
    sine, cosine = floats.sincos(angle)
    return np.float32(sine), np.float32(cosine)


def _seconds(time_us: int) -> np.float32:
    return np.float32(_F(min(time_us, _TIME_MAX_US)) * _MICROSECOND)


def resting_action_of(tables: Tables) -> int:
    """Return the first action that fires no limb, or the number of actions if there is none."""
    still = np.flatnonzero(~tables.fires.any(axis=1)).tolist()
    return still[0] if still else len(tables.actions)


@dataclass
class _Instant:
    """An instant, and the period that starts there."""

    time_us: int
    limb_use: Int64
    action: int = -1
    coasted: bool = False
    fixes: int = 0


class Track:
    """The filter: mean and covariance of the states at the last instants.

    Attributes:
        tables: tables of the prediction, worn as the limbs are.
        instants: oldest first; the last is the end of the current period.
        mean: (3, 2 n) float32 x, y, heading: pose and speed at each instant, world.
        covariance: (2, 2 n, 2 n) float32: of x and of y, which share one; of the heading.
        process_noise: (2,) float32 variance of a stroke's speed around the table's prediction, (m/s)^2 and
            (rad/s)^2.
        wear: estimates what the limbs have lost; None: they are taken as new.
    """

    def __init__(self, tables: Tables) -> None:
        self._original = tables
        self._use(tables)
        self._per_velocity = _F(1) / np.asarray(tables.velocity_scale, dtype=np.float32)
        self.resting_action = resting_action_of(tables)
        self._fire_s = (_F(tables.pulse_us) + _F(tables.second_delay_us)) * _MICROSECOND
        self.mean: Float32 = np.zeros((3, 0), dtype=np.float32)
        self.covariance: Float32 = np.zeros((2, 0, 0), dtype=np.float32)
        self.wear: WearFilter | None = None
        self.restart()

    def restart(self) -> None:
        """Forget all states and the adapted process noise; keep what the limbs have lost."""
        self.instants: list[_Instant] = []
        self.process_noise: Float32 = _PROCESS_NOISE.copy()
        self._predicted = np.zeros(3, dtype=np.float32)
        self._predicted_variance = np.zeros(2, dtype=np.float32)
        self._learned = 0
        self._prediction_valid = False

    def inflate(self) -> None:
        """Quadruple the process noise: the robot was not where it had been predicted."""
        self.process_noise = np.minimum(_INFLATION * self.process_noise, _PROCESS_NOISE_MOST)

    def learn(self, learn: int) -> None:
        """Set whether the limbs' wear is estimated: ON, HELD or OFF of ``wear``.

        OFF forgets the estimate. HELD keeps the shares alone, which ON starts again from.
        """
        if learn != OFF:
            self.wear = self.wear or WearFilter(self._original)
            self.wear.held = learn == HELD
            if self.wear.held:
                self.wear.restart(self.wear.codes.tolist())
        elif self.wear is not None:
            self._prediction_valid = False  # the current period was predicted with the wear that is forgotten
            self.wear = None
            self._use(self._original)

    def resume(self, codes: Sequence[int]) -> None:
        """Learn from shares on that a robot has kept: (l,) or more, 0 to 32767."""
        self.learn(ON)
        assert self.wear is not None
        self.wear.restart(codes[: self._original.limbs])
        self._use(self.wear.tables)

    def begin(self, at_us: int) -> None:
        """Start at rest with an unknown pose."""
        self._begin(at_us, self.resting_action, coasted=True)

    def coast(self, at_us: int) -> None:
        """Predict periods of rest until a time; after COASTS_MAX of them forget all states.

        The process noise and what the limbs have lost are kept.
        """
        for _ in range(COASTS_MAX):
            if not self.instants or at_us <= self.instants[-1].time_us + COAST_US:
                return
            self._open(self.resting_action, coasted=True)
        if at_us > self.instants[-1].time_us + COAST_US:
            self.instants = []

    def act(self, at_us: int, action: int) -> None:
        """Start an action at a time, which becomes the time of the newest instant."""
        if not self.instants:
            self._begin(at_us, action, coasted=False)
            return
        if len(self.instants) > 2 and self._coasted_too_soon(at_us):
            self._undo()
            self._prediction_valid = False
        if at_us < self.instants[-2].time_us + PERIOD_LEAST_US:
            self._undo()
        else:
            self.end_period(at_us)
            if at_us != self.instants[-1].time_us:
                self._move_newest(at_us)
        self._open(action, coasted=False)

    def end_period(self, at_us: int) -> None:
        """Learn from the current period, which the next action will end at a time; once for each period.

        A decision calls it before it plans, so that it plans with what the last stroke has shown.
        """
        if not (self._prediction_valid and len(self.instants) > 1):
            return
        latest = self.instants[-2]
        if not latest.coasted and at_us >= latest.time_us + PERIOD_LEAST_US:
            if self.wear is not None:
                self._learn_wear(self.wear)
            self._learn()
            self._prediction_valid = False

    def limb_use(self, at_us: int) -> Int64:
        """Return (8,) the recent use of each limb, for an action that starts at a time."""
        return self.instants[-2 if self._coasted_too_soon(at_us) else -1].limb_use

    def state(self, at_us: int) -> tuple[Float32, Float32]:
        """Return pose (3,) and speed (3,), world frame, at a time that is not before the oldest instant."""
        first, profile = self._profile(at_us)
        there = self.mean[:, 2 * first : 2 * first + 4]
        return weighted(profile.pose, there), weighted(profile.speed, there)

    def update(self, at_us: int, pose: Float32, gated: bool = True) -> bool:
        """Correct all states by a pose (3,), world, measured not before the oldest instant.

        Returns whether it was used: False if the gate refuses it.
        """
        first, profile = self._profile(at_us)
        here = slice(2 * first, 2 * first + 4)
        period = self.instants[first]
        innovation = pose - weighted(profile.pose, self.mean[:, here])
        innovation[2] = wrapped(innovation[2])
        cross = weighted(profile.pose, self.covariance[:, :, here])
        expected = weighted(profile.pose, cross[:, here])
        error_share2 = profile.error_share * profile.error_share
        shape = (_SHAPE + _SHAPE_OF_NOISE_S2 * self.process_noise) * error_share2
        variance = expected + (_FIX + shape * (_F(1) + _SHAPE_COMMON * _F(period.fixes)))
        gate = _GATE * (variance + _GATE_MORE) if gated else np.full(2, _GATE_OPEN)
        square = innovation * innovation
        if not (square[0] + square[1] <= gate[0] and square[2] <= gate[1]):
            return False
        self.mean = self.mean + cross[_COVARIANCE_OF] * (innovation / variance[_COVARIANCE_OF])[:, None]
        gain = cross * (_F(1) / variance)[:, None]
        less = self.covariance - gain[:, :, None] * cross[:, None, :]
        lower = _LOWER[: less.shape[1], : less.shape[1]]
        self.covariance = np.where(lower, less, np.swapaxes(less, 1, 2))
        period.fixes = min(period.fixes + 1, 255)
        return True

    def reset_pose(self, at_us: int, pose: Float32) -> None:
        """Restart from a pose (3,) at a time; actions and limb use are kept."""
        first, profile = self._profile(at_us)
        self.instants = self.instants[first:]
        self._unknown(pose)
        for index in range(len(self.instants) - 1):
            self.instants[index].fixes = 0
            self._predict(index)
        self._prediction_valid = False
        off = pose - weighted(profile.pose, self.mean[:, :4])
        self.mean[:, 0::2] = self.mean[:, 0::2] + off[:, None]
        self.update(at_us, pose, gated=False)

    def _coasted_too_soon(self, at_us: int) -> bool:
        """Return whether the current period coasts only because the action of this time came later."""
        return self.instants[-2].coasted and at_us < self.instants[-2].time_us + COAST_US

    def _begin(self, at_us: int, action: int, coasted: bool) -> None:
        self.instants = [_Instant(int(at_us), np.zeros(LIMBS_MAX, dtype=np.int64))]
        self._unknown(np.zeros(3, dtype=np.float32))
        self._open(action, coasted)
        self._prediction_valid = False

    def _unknown(self, pose: Float32) -> None:
        self.mean = np.stack([pose, np.zeros(3, dtype=np.float32)], axis=1)
        self.covariance = np.zeros((2, 2, 2), dtype=np.float32)
        self.covariance[:, 0, 0] = _POSE_UNKNOWN
        self.covariance[:, 1, 1] = _SPEED_UNKNOWN

    def _undo(self) -> None:
        del self.instants[-1]
        self.mean, self.covariance = self.mean[:, :-2], self.covariance[:, :-2, :-2]

    def _open(self, action: int, coasted: bool) -> None:
        if len(self.instants) == INSTANTS:
            del self.instants[0]
            self.mean, self.covariance = self.mean[:, 2:], self.covariance[:, 2:, 2:]
        turns_rad = self.mean[2, -2] - wrapped(self.mean[2, -2])
        self.mean = self.mean.copy()
        self.mean[2, 0::2] = self.mean[2, 0::2] - turns_rad
        last = self.instants[-1]
        last.action, last.coasted, last.fixes = int(action), coasted, 0
        self.instants.append(_Instant(last.time_us + self.tables.period_us, last.limb_use))
        self._prediction_valid = True
        self._predict(len(self.instants) - 2)

    def _predict(self, index: int) -> None:
        """Predict the states at the instant after ``index``, and drop later ones."""
        here, after = self.instants[index], self.instants[index + 1]
        period_s = _seconds(after.time_us - here.time_us)
        pose, speed = self.mean[:, 2 * index], self.mean[:, 2 * index + 1]
        heading = wrapped(pose[2])
        sine, cosine = sine_cosine(heading)
        forward, left = cosine * speed[0] + sine * speed[1], cosine * speed[1] - sine * speed[0]
        velocity = np.array([forward, left, speed[2]], dtype=np.float32)
        velocity[~(np.abs(velocity) <= _SPEED_MOST)] = 0  # also NaN
        motion, velocity, after.limb_use = self._look_up(velocity, here.limb_use, here.action, period_s)
        new = np.empty((3, 2), dtype=np.float32)
        new[0, 0] = pose[0] + (cosine * motion[0] - sine * motion[1])
        new[1, 0] = pose[1] + (sine * motion[0] + cosine * motion[1])
        new[2, 0] = pose[2] + motion[2]
        sine, cosine = sine_cosine(heading + motion[2])
        new[0, 1] = cosine * velocity[0] - sine * velocity[1]
        new[1, 1] = sine * velocity[0] + cosine * velocity[1]
        new[2, 1] = velocity[2]
        self.mean = np.concatenate([self.mean[:, : 2 * index + 2], new], axis=1)
        self._predicted = new[:, 0].copy()

        process_noise = (
            _RESTING * self.process_noise if here.action == self.resting_action else self.process_noise
        )
        pose_gain_s, apart_s = _F_POSE * period_s, _APART * period_s
        size = 2 * index + 2
        grown = np.zeros((2, size + 2, size + 2), dtype=np.float32)
        grown[:, :size, :size] = known = self.covariance[:, :size, :size]
        poses = known[:, :, -2] + pose_gain_s * known[:, :, -1]
        speeds = _F_SPEED * known[:, :, -1]
        grown[:, :size, size] = grown[:, size, :size] = poses
        grown[:, :size, size + 1] = grown[:, size + 1, :size] = speeds
        both = (speeds[:, -2] + pose_gain_s * speeds[:, -1]) + (_F_SPEED * pose_gain_s) * process_noise
        grown[:, size, size] = (poses[:, -2] + pose_gain_s * poses[:, -1]) + (
            pose_gain_s * pose_gain_s + apart_s * apart_s
        ) * process_noise
        grown[:, size, size + 1] = grown[:, size + 1, size] = both
        grown[:, size + 1, size + 1] = (
            _F_SPEED * speeds[:, -1] + (_F_SPEED * _F_SPEED + _APART * _APART) * process_noise
        )
        self.covariance = grown
        self._predicted_variance = grown[:, size, size].copy()

    def _look_up(
        self, velocity: Float32, limb_use: Int64, action: int, period_s: np.float32
    ) -> tuple[Float32, Float32, Int64]:
        """Return the motion in the body frame, and the velocity and the limb use a period later."""
        if action >= len(self.tables.actions):
            return velocity * period_s, velocity, limb_use
        codes, motion = np.zeros(DYNAMICS, dtype=np.int64), np.zeros(3, dtype=np.float32)
        _transition(self._arrays, velocity, self._per_velocity, limb_use, action, motion, codes)
        return motion, codes[:3].astype(np.float32) * self._arrays.velocity_scale, codes[3:]

    def _learn_wear(self, wear: WearFilter) -> None:
        """Update the wear by the last period, if fixes determine its end; predict with the new wear."""
        known = self.covariance[:, -2, -2]
        if not ((known >= 0) & (known <= (_F(1) - _INFORMED) * self._predicted_variance)).all():
            return
        begin, end = self.instants[-2:]
        error, heading_rad = self.mean[:, -2] - self._predicted, wrapped(self.mean[2, -4])
        period_s = _seconds(end.time_us - begin.time_us)
        before = wear.codes
        wear.learn(error, known[_COVARIANCE_OF], heading_rad, begin.action, period_s)
        if (wear.codes != before).any():
            self._use(wear.tables)

    def _use(self, tables: Tables) -> None:
        self.tables = tables
        self._arrays = arrays_of(tables)

    def _learn(self) -> None:
        """Adapt the process noise to the error of the last prediction."""
        error = self.mean[:, -2] - self._predicted
        square = error * error
        reduced = self._predicted_variance - self.covariance[:, -2, -2]
        sums = np.array([square[0] + square[1], square[2]], dtype=np.float32)
        part = _LEARN_PARTS[self._learned]
        for k, axes in enumerate((_F(2), _F(1))):
            if reduced[k] > _INFORMED * self._predicted_variance[k]:
                ratio = min(sums[k] / (axes * reduced[k]), _RATIO_MOST)
                process_noise = self.process_noise[k] * (_F(1) + part * (ratio - _F(1)))
                self.process_noise[k] = min(
                    max(process_noise, _PROCESS_NOISE_LEAST[k]), _PROCESS_NOISE_MOST[k]
                )
        self._learned = min(self._learned + 1, 3)

    def _move_newest(self, at_us: int) -> None:
        """Move the newest instant to another time after the one before it."""
        _, profile = self._profile(at_us)
        mean, known = self.mean[:, -4:], self.covariance
        self.mean = self.mean.copy()
        self.mean[:, -2:] = np.stack([weighted(profile.pose, mean), weighted(profile.speed, mean)], axis=1)
        poses = weighted(profile.pose, known[:, :, -4:])
        speeds = weighted(profile.speed, known[:, :, -4:])
        moved = known.copy()
        moved[:, :-2, -2] = moved[:, -2, :-2] = poses[:, :-2]
        moved[:, :-2, -1] = moved[:, -1, :-2] = speeds[:, :-2]
        moved[:, -2, -2] = weighted(profile.pose, poses[:, -4:])
        moved[:, -2, -1] = moved[:, -1, -2] = weighted(profile.speed, poses[:, -4:])
        moved[:, -1, -1] = weighted(profile.speed, speeds[:, -4:])
        self.covariance = moved
        self.instants[-1].time_us = int(at_us)

    def _profile(self, at_us: int) -> tuple[int, Profile]:
        """Return the index of the period of a time, or of the last one, and the weights at that time."""
        last = len(self.instants) - 2
        if at_us >= self.instants[-1].time_us:
            return last, profile_after(_seconds(at_us - self.instants[-1].time_us))
        index = max((i for i in range(last + 1) if at_us >= self.instants[i].time_us), default=0)
        begin_us, end_us = self.instants[index].time_us, self.instants[index + 1].time_us
        return index, profile_within(_seconds(at_us - begin_us), _seconds(end_us - begin_us), self._fire_s)


def _compiled(stamp: int) -> Any:
    @cached_njit()
    def transition(table, velocity, per_velocity, limb_use, action, motion, after):  # type: ignore[no-untyped-def]
        dynamics = np.zeros(DYNAMICS, dtype=np.int64)
        for axis in range(3):
            dynamics[axis] = velocity_code(velocity[axis], per_velocity[axis])
        dynamics[3:] = limb_use
        row = find_row(table, dynamics)
        motion_of(table, row, dynamics, action, motion)
        dynamics_after(table, row, dynamics, action, after)
        return stamp

    return transition


_transition = _compiled(stamp_of("frogkick.planner"))
"""Write the motion (3,) float32 and the dynamics (DYNAMICS,) a period after an action."""
