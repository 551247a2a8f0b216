"""Flow and external accelerations in the compiled rods: linearised around the body.

About the lane's origin, which is the body's centre of mass at the start of a call, the water moves at
u = u0 + G x, and each node has the acceleration a = a0 + alpha (-y, x): a force at the body's centre and a
torque about it. Both are in the world frame and constant during a call of ``Batch.advance``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numba import njit

from frogkick.core.compiled import INNER
from frogkick.der.lanes import SimdArray, get

WATER = 9
"""Numbers of one lane: u0 (2), G by rows (4), a0 (2), alpha."""


@dataclass(frozen=True)
class Water:
    """Flow and external acceleration about a body's centre of mass, world frame."""

    flow_mps: tuple[float, float] = (0.0, 0.0)  # (2,) velocity of the water there
    # (2, 2) its gradient: row i, column j is d u_i / d x_j
    gradient_per_s: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    push_mps2: tuple[float, float] = (0.0, 0.0)  # (2,) acceleration of the body
    turn_rad_s2: float = 0.0  # angular acceleration of the body

    def numbers(self) -> tuple[float, ...]:
        """Return the WATER numbers for the compiled functions."""
        along, aside = self.gradient_per_s
        return (*self.flow_mps, *along, *aside, *self.push_mps2, self.turn_rad_s2)


STILL = Water()


@njit(**INNER)
def relative_velocity(water: SimdArray, x_m: SimdArray, v_mps: SimdArray, node: int) -> tuple[Any, Any]:
    """World velocity of a node relative to the water; ``water`` of length 0 is still."""
    vx, vy = get(v_mps, node, 0), get(v_mps, node, 1)
    if water.shape[0] > 0:
        x, y = get(x_m, node, 0), get(x_m, node, 1)
        vx = vx - (get(water, 0, 0) + (get(water, 2, 0) * x + get(water, 3, 0) * y))
        vy = vy - (get(water, 1, 0) + (get(water, 4, 0) * x + get(water, 5, 0) * y))
    return vx, vy


@njit(**INNER)
def push(water: SimdArray, x_m: SimdArray, node: int) -> tuple[Any, Any]:
    """World acceleration of a node by the external force and torque."""
    x, y = get(x_m, node, 0), get(x_m, node, 1)
    return get(water, 6, 0) - get(water, 8, 0) * y, get(water, 7, 0) + get(water, 8, 0) * x
