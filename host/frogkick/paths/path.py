"""A desired path: up to 100 points with tangents, as the planner takes it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from frogkick.core.arguments import typed
from frogkick.core.arrays import Float32, Float64, Int64
from frogkick.core.errors import InputError
from frogkick.core.poses import rotate, world_from_body, wrap_angle

# fk_path_t holds this many points (FK_PATH_POINTS_MAX in fk_planner.h); the paper's paths have exactly 100.
POINTS_MAX = 100
AT_ONCE = 4096
"""Points whose distances from a path are computed at once."""
# The planner refuses a position beyond this (FK_ERROR_RANGE), so a path may not lead there.
COORDINATE_MAX_M = 1000.0
LENGTH_MAX_M = 50.0
"""A longer path is likely to be in mm."""


def require_points(name: str, count: int) -> None:
    """Raise InputError if a path has fewer than two points."""
    if count == 0:
        raise InputError(f"path {name!r} is empty (0 points): give at least 2 points")
    if count == 1:
        raise InputError(f"path {name!r} has 1 point: give at least 2 points")


def require_near(name: str, x_m: Float64, y_m: Float64) -> None:
    """Raise InputError if a point lies where the planner refuses a position."""
    far = np.flatnonzero((np.abs(x_m) > COORDINATE_MAX_M) | (np.abs(y_m) > COORDINATE_MAX_M))
    if far.size:
        raise InputError(
            f"path {name!r}: point {far[0]} lies at ({x_m[far[0]]:g}, {y_m[far[0]]:g}) m, the limit is "
            f"{COORDINATE_MAX_M:g} m: give metres, not millimetres"
        )


def no_length(name: str, count: int) -> InputError:
    """Return the error for a path whose points coincide."""
    return InputError(f"path {name!r} has no length (all {count} points coincide): give distinct points")


def along_m(points_m: Float64) -> Float64:
    """(n,) lengths, m, of the polyline through (n, 2) points up to each."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points_m, axis=0).T))])


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """A desired path in the world frame.

    Args:
        x_m: (n,) float32, m, world x of the points, in the order of travel; 2 <= n <= 100.
        y_m: (n,) float32, m, world y.
        tangent_rad: (n,) float32, rad, heading of travel at each point, in (-pi, pi].
        name: for reports.

    Raises:
        InputError: fewer than two points, more than 100, columns that differ in length, a value that is not
            finite or too large, or a path without length or longer than 50 m, which is likely to be in mm.
    """

    x_m: Float32
    y_m: Float32
    tangent_rad: Float32
    name: str = "path"

    def __post_init__(self) -> None:
        x, y, tangent = (self._column(name) for name in ("x_m", "y_m", "tangent_rad"))
        if not x.size == y.size == tangent.size:
            raise InputError(
                f"path {self.name!r}: {x.size} x, {y.size} y and {tangent.size} tangents: "
                "give one of each per point"
            )
        require_points(self.name, x.size)
        if x.size > POINTS_MAX:
            raise InputError(
                f"path {self.name!r} has {x.size} points, the limit is {POINTS_MAX}: "
                "resample it (from_waypoints)"
            )
        require_near(self.name, x, y)
        rounded = wrap_angle(tangent).astype(np.float32)
        rounded[rounded <= np.float32(-np.pi)] = np.float32(np.pi)  # the range is (-pi, pi]
        columns = {"x_m": x.astype(np.float32), "y_m": y.astype(np.float32), "tangent_rad": rounded}
        for column, stored in columns.items():
            stored.flags.writeable = False
            object.__setattr__(self, column, stored)
        if self.length_m == 0.0:
            raise no_length(self.name, x.size)
        if self.length_m > LENGTH_MAX_M:
            raise InputError(
                f"path {self.name!r} has a length of {self.length_m:.4g} m, more than {LENGTH_MAX_M:g} m: "
                "coordinates are in metres, are these mm?"
            )

    def __repr__(self) -> str:
        return f"Path({self.name!r}: {len(self)} points, {1e3 * self.length_m:.0f} mm)"

    def _column(self, column: str) -> Float64:
        try:
            values = np.array(getattr(self, column), dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(
                f"path {self.name!r}: {column} is not a row of numbers: give x_m, y_m, tangent_rad, name"
            ) from None
        if values.ndim != 1:
            raise InputError(
                f"path {self.name!r}: {column} has {values.ndim} dimensions: give one row of numbers"
            )
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                f"path {self.name!r}: {column} of point {bad[0]} is {values[bad[0]]}: "
                "every coordinate must be a finite number"
            )
        return values

    @classmethod
    def from_arrays(cls, x_m: ArrayLike, y_m: ArrayLike, tangent_rad: ArrayLike, name: str = "path") -> Path:
        """A path from numbers of any type, which are checked in float64 and rounded to float32."""
        return cls(cast(Float32, x_m), cast(Float32, y_m), cast(Float32, tangent_rad), name)

    def __len__(self) -> int:
        return int(self.x_m.size)

    def __eq__(self, other: object) -> bool:
        """Whether the points are equal bit for bit, whatever the names."""
        if not isinstance(other, Path):
            return NotImplemented
        columns = ("x_m", "y_m", "tangent_rad")
        return all(np.array_equal(getattr(self, each), getattr(other, each)) for each in columns)

    __hash__ = None  # type: ignore[assignment]

    @property
    def points_m(self) -> Float64:
        """(n,2) float64, m, world: the points."""
        return np.column_stack([self.x_m, self.y_m]).astype(np.float64)

    @property
    def length_m(self) -> float:
        """Length of the polyline through the points, m."""
        return float(np.hypot(*np.diff(self.points_m, axis=0).T).sum())

    @property
    def along_m(self) -> Float64:
        """(n,) float64, m: length of the path up to each point."""
        return along_m(self.points_m)

    def poses_at(self, at_m: Float64) -> Float64:
        """(k, 3) x m, y m, heading rad at (k,) lengths of the path, m; straight on beyond its end."""
        points, lengths_m = self.points_m, self.along_m
        headings_rad = np.unwrap(self.tangent_rad.astype(np.float64))
        beyond_m = np.maximum(at_m - lengths_m[-1], 0.0)
        x, y, heading = (np.interp(at_m, lengths_m, column) for column in (*points.T, headings_rad))
        last = headings_rad[-1]
        return np.column_stack([x + beyond_m * math.cos(last), y + beyond_m * math.sin(last), heading])

    def motion_to(self, pose_world: Sequence[float]) -> tuple[float, float, float]:
        """The pose for ``place`` at which the path begins at a pose (x m, y m, heading rad).

        Raises:
            InputError: the pose is not three finite numbers.
        """
        x_m, y_m, heading_rad = self._pose(pose_world).tolist()
        turn = heading_rad - float(self.tangent_rad[0])
        first_x, first_y = rotate(turn, float(self.x_m[0]), float(self.y_m[0]))
        return x_m - first_x, y_m - first_y, turn

    def place(self, pose_world: Sequence[float] | ArrayLike) -> Path:
        """The path with its origin and x axis moved to a pose (x m, y m, heading rad).

        Raises:
            InputError: the pose is not three finite numbers.
        """
        pose = self._pose(pose_world)
        points = world_from_body(pose[2], self.points_m) + pose[:2]
        tangent = self.tangent_rad.astype(np.float64) + pose[2]
        return Path.from_arrays(points[:, 0], points[:, 1], tangent, self.name)

    def _pose(self, pose_world: ArrayLike) -> Float64:
        try:
            pose = np.asarray(pose_world, dtype=np.float64)
        except (TypeError, ValueError):
            pose = None
        if pose is None or pose.shape != (3,) or not np.isfinite(pose).all():
            shown = pose_world if pose is None else pose.tolist()
            raise InputError(f"path {self.name!r} cannot be placed at {shown}: give x m, y m, heading rad")
        return pose

    def distance_m(self, points_world_m: ArrayLike) -> Float64:
        """(k,) distances, m, of (k, 2) points in the world to the polyline's segments."""
        points = _as_points(points_world_m)
        start = self.points_m[:-1]
        along = np.diff(self.points_m, axis=0)
        square = (along**2).sum(axis=1)
        distance = np.empty(len(points))
        for first in range(0, len(points), AT_ONCE):  # a table of points by segments is large
            part = slice(first, first + AT_ONCE)
            offset = points[part, None, :] - start[None, :, :]
            # The projection on a segment without length is its start.
            share = np.clip((offset * along).sum(axis=2) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
            gap = offset - share[:, :, None] * along[None, :, :]
            distance[part] = np.sqrt((gap**2).sum(axis=2).min(axis=1))
        return distance

    def nearest_index(self, points_world_m: ArrayLike) -> Int64:
        """(k,) index of the path point nearest to each of (k, 2) points, m, world; the lowest on ties.

        It is the index of the paper's cost in float64; the planner uses float32.
        """
        points = _as_points(points_world_m)
        square = ((points[:, None, :] - self.points_m[None, :, :]) ** 2).sum(axis=2)
        return np.asarray(square.argmin(axis=1), dtype=np.int64)


def _as_points(points_world_m: ArrayLike) -> Float64:
    try:
        points = np.asarray(points_world_m, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("points are not numbers: give (k, 2), metres in the world frame") from None
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"points have shape {points.shape}: give (k, 2), metres in the world frame")
    return points
