"""Desired paths: line, sine, ellipse, waypoints, files; resampling, tangents, distances."""

from frogkick.core.poses import wrap_angle
from frogkick.paths.csvfile import from_csv
from frogkick.paths.path import POINTS_MAX, Path
from frogkick.paths.shapes import OTHER_SHAPES, SHAPES, ellipse, from_waypoints, line, shape, sine

__all__ = [
    "OTHER_SHAPES", "POINTS_MAX", "SHAPES", "Path", "ellipse", "from_csv", "from_waypoints", "line", "shape",
    "sine", "wrap_angle",
]  # fmt: skip
