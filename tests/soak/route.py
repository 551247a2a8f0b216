"""A closed route around the pool, of which a robot is given the part ahead of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from frogkick.paths import Path

POINTS = 1200
AHEAD_M = 1.2
PATH_POINTS = 100
_RADIUS_M, _WAVE_M, _WAVES = 0.3, 0.02, 3


class Route:
    """A circle with waves: bends to both sides, none tighter than the robot's own turns.

    Attributes:
        points_m: (n, 2) points, evenly spaced, in the direction of travel.
        tangent_rad: (n,) there.
        spacing_m: between two of them.
    """

    def __init__(self) -> None:
        angle = np.linspace(0.0, 2.0 * np.pi, 20 * POINTS + 1)
        radius = _RADIUS_M + _WAVE_M * np.cos(_WAVES * angle)
        dense = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(dense, axis=0).T))])
        at = np.linspace(0.0, along[-1], POINTS, endpoint=False)
        self.length_m = float(along[-1])
        self.spacing_m = self.length_m / POINTS
        self.points_m = np.column_stack([np.interp(at, along, dense[:, axis]) for axis in (0, 1)])
        step = np.roll(self.points_m, -1, axis=0) - np.roll(self.points_m, 1, axis=0)
        self.tangent_rad = np.arctan2(step[:, 1], step[:, 0])

    def start(self) -> tuple[float, float, float]:
        """A pose on it."""
        return float(self.points_m[0, 0]), float(self.points_m[0, 1]), float(self.tangent_rad[0])

    def place(self, position_m: npt.ArrayLike) -> tuple[int, float]:
        """The nearest point's index, and the distance to the route there, m."""
        offset = self.points_m - np.asarray(position_m)
        index = int(np.argmin((offset**2).sum(axis=1)))
        tangent = self.tangent_rad[index]
        beside = -np.sin(tangent) * offset[index, 0] + np.cos(tangent) * offset[index, 1]
        along = np.cos(tangent) * offset[index, 0] + np.sin(tangent) * offset[index, 1]
        # Between two points the foot lies beside the robot; what is more than half a spacing counts.
        return index, float(np.hypot(beside, max(0.0, abs(along) - self.spacing_m)))

    def ahead(self, position_m: npt.ArrayLike) -> Path:
        """The path from the nearest point on, as far as a robot is sent at once."""
        first, _ = self.place(position_m)
        last = AHEAD_M / self.spacing_m
        rows = (first + np.linspace(0.0, last, PATH_POINTS).round().astype(int)) % POINTS
        return Path.from_arrays(*self.points_m[rows].T, self.tangent_rad[rows], "route")
