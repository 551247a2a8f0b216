"""Pose and speed at a time within a period, from those at its two ends: the twin of fk_profile.c.

It is the measurement model H of the Kalman filter in ``frogkick.estimator.track``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float32

_F = np.float32
_GLIDE_PART = _F(0.41666667)


@dataclass(frozen=True, eq=False)
class Profile:
    """Pose and speed at a time within a period, as weights of those at its start and end."""

    # (4,) weights of pose and speed at the start, pose and speed at the end
    pose: Float32
    speed: Float32
    error_share: np.float32  # of the profile's own error: 0 at both ends, below 1 in between


def profile_after(after_s: np.float32) -> Profile:
    """Return the weights after the end of a period, where the speed is taken as constant."""
    return Profile(
        np.array([0, 0, 1, after_s], dtype=np.float32), np.array([0, 0, 0, 1], dtype=np.float32), _F(0)
    )


def profile_within(since_s: np.float32, period_s: np.float32, fire_s: np.float32) -> Profile:
    """Return the weights at a time within a period.

    The speed changes linearly while limbs fire, until ``fire_s`` after the start, or until the middle of a
    short period. Then it decays as (u + u^2) / 2, where u falls from 1 to 0.
    """
    one, half = _F(1), _F(0.5)
    x = since_s / period_s
    rest = (one - x) * (one - x)
    fire = min(fire_s / period_s, half)
    half_fire, glide = half * fire, one - fire
    glide_part = _GLIDE_PART * glide
    per_way = one / (half_fire + glide_part)
    per_start = -half_fire * per_way
    per_end = -(glide - glide_part) * per_way
    if x <= fire:
        share = x / fire
        area = half * (x * share)
        at_start, at_end = x - area, _F(0)
        share_start, share_end = one - share, _F(0)
        error_share = share * rest
    else:
        s = (x - fire) / glide
        u = one - s
        curve = glide * ((s - _F(0.75) * (s * s)) + _F(0.16666667) * ((s * s) * s))
        area = half_fire + curve
        at_start, at_end = half_fire, (x - fire) - curve
        share = half * (u * (one + u))
        share_start, share_end = _F(0), one - share
        error_share = rest
    way = area * per_way
    way_speed = share * per_way / period_s
    pose = [one - way, (at_start + area * per_start) * period_s, way, (at_end + area * per_end) * period_s]
    speed = [-way_speed, share_start + share * per_start, way_speed, share_end + share * per_end]
    return Profile(np.array(pose, dtype=np.float32), np.array(speed, dtype=np.float32), error_share)


def weighted(weights: Float32, values: Float32) -> Float32:
    """Return the sum of weights (4,) times the last axis (..., 4), added from the left."""
    parts = weights * values
    return np.asarray(((parts[..., 0] + parts[..., 1]) + parts[..., 2]) + parts[..., 3])
