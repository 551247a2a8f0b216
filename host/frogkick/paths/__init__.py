"""Desired paths: line, sine, ellipse, waypoints, files; resampling, tangents, distances."""

from frogkick.paths.csvfile import from_csv
from frogkick.paths.path import POINTS_MAX, Path, wrap_angle
from frogkick.paths.shapes import OTHER_SHAPES, SHAPES, ellipse, from_waypoints, line, shape, sine

__all__ = [
    "OTHER_SHAPES",
    "POINTS_MAX",
    "SHAPES",
    "Path",
    "ellipse",
    "from_csv",
    "from_waypoints",
    "line",
    "shape",
    "sine",
    "wrap_angle",
]
