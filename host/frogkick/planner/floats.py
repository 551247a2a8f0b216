"""Angles in float32 with the robot's bits: + - * only, one order of operations, own polynomials.

numba would turn ``int * float32`` into float64, so every constant is a float32. No fastmath, no fusing.
"""

from __future__ import annotations

import numpy as np

from frogkick.core.compiled import BARE, cached_njit

ANGLE_MAX_RAD = np.float32(2100)

_F1 = np.float32(1)
_HALF = np.float32(0.5)
_PI = np.float32(3.14159274)
_NAN = np.float32(np.nan)
_SHIFT = np.float32(12582912)  # 1.5 * 2**23: adding and subtracting rounds to the nearest integer
_TURN_1 = np.float32(6.28125)  # 2 pi in three parts: products with a count of turns are exact
_TURN_2 = np.float32(0.00193548203)
_TURN_3 = np.float32(-1.74845553e-07)
_TURNS_PER_RAD = np.float32(0.159154937)
_QUARTER_1 = np.float32(1.5703125)  # pi / 2 likewise
_QUARTER_2 = np.float32(0.000483870506)
_QUARTER_3 = np.float32(-4.37113883e-08)
_QUARTERS_PER_RAD = np.float32(0.636619747)
_S0 = np.float32(-0.166666552)  # least-maximum fits on |r| <= pi / 4 + 0.001
_S1 = np.float32(0.00833215471)
_S2 = np.float32(-0.000195144545)
_C0 = np.float32(0.0416666456)
_C1 = np.float32(-0.00138873595)
_C2 = np.float32(2.44375333e-05)


@cached_njit(**BARE)
def wrap_angle(angle: np.float32) -> np.float32:
    """Wrap an angle to (-pi, pi]; NaN beyond +-2100 rad."""
    if not (abs(angle) <= ANGLE_MAX_RAD):
        return _NAN
    if -_PI < angle <= _PI:
        return angle
    turns = (angle * _TURNS_PER_RAD + _SHIFT) - _SHIFT
    wrapped = ((angle - turns * _TURN_1) - turns * _TURN_2) - turns * _TURN_3
    if wrapped > _PI:
        wrapped = ((wrapped - _TURN_1) - _TURN_2) - _TURN_3
    if wrapped <= -_PI:
        wrapped = ((wrapped + _TURN_1) + _TURN_2) + _TURN_3
    return min(wrapped, _PI)


@cached_njit(**BARE)
def sincos(angle: np.float32) -> tuple[np.float32, np.float32]:
    """Return (sine, cosine) of an angle in rad; NaN beyond +-2100 rad."""
    if not (abs(angle) <= ANGLE_MAX_RAD):
        return _NAN, _NAN
    quarters = (angle * _QUARTERS_PER_RAD + _SHIFT) - _SHIFT
    r = ((angle - quarters * _QUARTER_1) - quarters * _QUARTER_2) - quarters * _QUARTER_3
    r2 = r * r
    sine = r + r * r2 * (_S0 + r2 * (_S1 + r2 * _S2))
    cosine = (_F1 - _HALF * r2) + r2 * r2 * (_C0 + r2 * (_C1 + r2 * _C2))
    quadrant = int(quarters) % 4
    if quadrant == 1:
        return cosine, -sine
    if quadrant == 2:
        return -sine, -cosine
    if quadrant == 3:
        return -cosine, sine
    return sine, cosine
