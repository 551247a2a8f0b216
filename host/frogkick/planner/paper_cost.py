"""The paper's cost in float32 (numba): the twin of cost.c.

Source: Huang et al. 2022, Eq. 19 as its authors' runs logged it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from frogkick.core.arrays import AnyArray
from frogkick.core.compiled import INNER
from frogkick.planner.floats import wrap_angle

_F1 = np.float32(1)


@njit(**INNER)
def nearest_point(x_m: AnyArray, y_m: AnyArray, x: np.float32, y: np.float32) -> tuple[int, np.float32]:
    """Return the index of the nearest path point, the lowest on ties, and the squared distance, m^2."""
    index = 0
    best = np.float32(np.inf)
    for point in range(len(x_m)):
        dx = x_m[point] - x
        dy = y_m[point] - y
        distance2 = dx * dx + dy * dy
        if distance2 < best:
            best = distance2
            index = point
    return index, best


@njit(**INNER)
def pose_cost(
    path: AnyArray, distance_w: Any, angle_w: Any, progress_w: Any, x: Any, y: Any, heading: Any
) -> Any:
    """Return the cost of a pose: path (3, n) float32 x, y, tangent; the rest float32."""
    index, distance2 = nearest_point(path[0], path[1], x, y)
    angle = abs(wrap_angle(heading - path[2, index]))
    progress = np.float32(index) / np.float32(path.shape[1] - 1)
    return (distance_w * np.sqrt(distance2) + angle_w * angle) + progress_w * (_F1 - progress)
