"""The paper's paths, and paths through waypoints.

Source: Huang 2022, section on motion planning; checked against the published path files of seven runs.
What those files show:

- 100 points each, at parameter s = i/99, uniform in s (not in arc length: a sine's and an ellipse's
  points lie closer where the curve bends), tangents dx/ds, dy/ds not normalised.
- Line: the x axis of the start pose; lengths 0.466 m.
- Sine: x = 0.85 l s, y = l/10 sin(10 s) with l = 0.420 and 0.497 m: "l/10" refers to l, while the
  extent forward is 0.85 l (amplitude / extent is 2/17 to the last digit).
- Ellipse: 0.95 of a turn, the angle 1.9 pi s. The start pose is one end of the axis that the robot points
  along, so the centre lies straight ahead and the first tangent is 90 degrees from the heading. Runs 1 and
  3 have semi-axes 0.168/0.084 and 0.174/0.087 m (2:1, long axis ahead, clockwise, first to the left); runs
  5 and 6 are circles of 0.121 and 0.136 m, counter-clockwise, first to the right.

Each shape takes a ``length_m``, m, finite and above 0, and a number of ``points``, 2 to 100; others raise
``InputError``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from frogkick.core.arguments import typed
from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.poses import body_from_world
from frogkick.paths.path import POINTS_MAX, Path, along_m, no_length, require_near, require_points

_REPEATED_M = 1e-9  # a waypoint nearer to the one before it repeats it

# Sizes near those of the recorded runs, which fit the authors' pool.
LINE_LENGTH_M = 0.45
SINE_LENGTH_M = 0.45
ELLIPSE_LENGTH_M = 0.34
SINE_EXTENT_PER_LENGTH = 0.85
SINE_AMPLITUDE_PER_LENGTH = 0.1
SINE_ANGLE_RAD = 10.0
ELLIPSE_TURNS = 0.95
# Sizes of the same order for the other ones.
CIRCLE_LENGTH_M = 0.26
BENDS_LENGTH_M = 0.15
EIGHT_LENGTH_M = 0.6
EIGHT_TURNS = 0.96


def _check_points(points: int, name: str) -> int:
    if not isinstance(points, int | np.integer) or not 2 <= points <= POINTS_MAX:
        raise InputError(f"{name}: {points} points: give 2 to {POINTS_MAX}")
    return points


def _checked(name: str, length_m: float, points: int) -> tuple[float, Float64]:
    """Return the length, and the parameter s of the points, from 0 to 1."""
    s = np.linspace(0.0, 1.0, _check_points(points, name))
    if not (_is_finite(length_m) and length_m > 0.0):
        raise InputError(f"{name}: length {length_m!r} m: give a finite length above 0 m")
    return float(length_m), s


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and bool(np.isfinite(value))


@typed
def line(length_m: float = LINE_LENGTH_M, points: int = POINTS_MAX) -> Path:
    """A straight line from the origin along +x.

    Args:
        length_m: its length, m, finite and above 0.
        points: number of points, 2 to 100.

    Raises:
        InputError: another length or number of points.
    """
    length, s = _checked("line", length_m, points)
    x = length * s
    return Path.from_arrays(x, np.zeros_like(x), np.zeros_like(x), "line")


@typed
def sine(length_m: float = SINE_LENGTH_M, points: int = POINTS_MAX) -> Path:
    """The paper's sine: x = 0.85 l s, y = l/10 sin(10 s), s from 0 to 1.

    Args:
        length_m: l, m, finite and above 0 (the extent along x is 0.85 l).
        points: number of points, 2 to 100.

    Raises:
        InputError: another length or number of points.
    """
    length, s = _checked("sine", length_m, points)
    extent, amplitude = SINE_EXTENT_PER_LENGTH * length, SINE_AMPLITUDE_PER_LENGTH * length
    y = amplitude * np.sin(SINE_ANGLE_RAD * s)
    slope = amplitude * SINE_ANGLE_RAD * np.cos(SINE_ANGLE_RAD * s)
    return Path.from_arrays(extent * s, y, np.arctan2(slope, extent), "sine")


@typed
def ellipse(
    length_m: float = ELLIPSE_LENGTH_M,
    aspect: float = 2.0,
    turns: float = ELLIPSE_TURNS,
    clockwise: bool = True,
    points: int = POINTS_MAX,
) -> Path:
    """The paper's ellipse: its centre lies straight ahead, the first tangent at 90 degrees to +x.

    Args:
        length_m: the full axis along x, m, above 0.
        aspect: axis along x over axis along y (2 in the paper's runs 1 and 3, 1 in 5 and 6), above 0.
        turns: part of it that is travelled, above 0 to 1.
        clockwise: travel clockwise, so that the first tangent points to +y (left); else to -y.
        points: number of points, 2 to 100.

    Raises:
        InputError: an argument is outside of its range.
    """
    length, s = _checked("ellipse", length_m, points)
    if not (_is_finite(aspect) and aspect > 0.0):
        raise InputError(f"ellipse: aspect {aspect}: give a finite ratio above 0")
    if not (_is_finite(turns) and 0.0 < turns <= 1.0):
        raise InputError(f"ellipse: {turns} turns: give a part of one turn, above 0 to 1")
    angle, a = 2.0 * np.pi * turns * s, 0.5 * length
    b = a / aspect * (1.0 if clockwise else -1.0)
    tangent = np.arctan2(b * np.cos(angle), a * np.sin(angle))
    name = "circle" if aspect == 1.0 else "ellipse"
    return Path.from_arrays(a * (1.0 - np.cos(angle)), b * np.sin(angle), tangent, name)


@typed
def circle(length_m: float = CIRCLE_LENGTH_M, points: int = POINTS_MAX) -> Path:
    """A circle of this diameter: ``ellipse`` of aspect 1, clockwise (the paper's run counter-clockwise)."""
    return ellipse(length_m, aspect=1.0, points=points)


@typed
def bends(length_m: float = BENDS_LENGTH_M, points: int = POINTS_MAX) -> Path:
    """An S: arcs of this radius, 135 degrees to the left and 135 degrees to the right."""
    radius_m, s = _checked("bends", length_m, points)
    turn = 0.75 * np.pi
    angle = turn * np.linspace(0.0, 2.0, len(s))
    tangent = np.where(angle <= turn, angle, 2.0 * turn - angle)
    # Centre of the first arc to the left of the start, of the second one to the right of where it begins.
    along, beside = np.sin(tangent), 1.0 - np.cos(tangent)
    x = radius_m * np.where(angle <= turn, along, 2.0 * np.sin(turn) - along)
    y = radius_m * np.where(angle <= turn, beside, 2.0 * (1.0 - np.cos(turn)) - beside)
    return Path.from_arrays(x, y, tangent, "bends")


@typed
def eight(length_m: float = EIGHT_LENGTH_M, points: int = POINTS_MAX) -> Path:
    """A figure eight, this long along its loops, that crosses itself where it begins: 96 % of Gerono's
    lemniscate."""
    length, s = _checked("eight", length_m, points)
    half_m, angle = 0.5 * length, 2.0 * np.pi * EIGHT_TURNS * s
    x, y = half_m * np.sin(angle), half_m * np.sin(angle) * np.cos(angle)
    tangent = np.arctan2(half_m * np.cos(2.0 * angle), half_m * np.cos(angle))
    turned = body_from_world(tangent[0], np.stack([x, y, tangent], axis=-1))  # so that it begins along +x
    return Path.from_arrays(turned[:, 0], turned[:, 1], tangent - tangent[0], "eight")


SHAPES: dict[str, Callable[..., Path]] = {"line": line, "sine": sine, "ellipse": ellipse}
"""The paper's three."""
OTHER_SHAPES: dict[str, Callable[..., Path]] = {"circle": circle, "bends": bends, "eight": eight}


@typed
def shape(name: str, length_m: float | None = None) -> Path:
    """A path by name, one of ``SHAPES`` or ``OTHER_SHAPES``, in its own start frame.

    Raises:
        InputError: no such shape, or a bad length.
    """
    known = SHAPES | OTHER_SHAPES
    if not isinstance(name, str) or name not in known:
        raise InputError(
            f"no path shape is called {name!r}{nearest_name(name, known)}: use {', '.join(known)} or a file"
        )
    return known[name]() if length_m is None else known[name](length_m)


@typed
def from_waypoints(
    waypoints_m: ArrayLike, smooth: bool = True, points: int = POINTS_MAX, name: str = "waypoints"
) -> Path:
    """A path through waypoints, evenly spaced by arc length.

    Args:
        waypoints_m: (k, 2), m, world (or the path's own frame, then place()). Repeats of the point
            before, within 1 nm, are left out.
        smooth: a natural cubic spline over chord length where k > 2, else straight segments.
        points: number of points of the path, 2 to 100.
        name: for reports and errors.

    Raises:
        InputError: not (k, 2), fewer than two distinct points, or a value that is not finite or too large.
    """
    count = _check_points(points, name)
    try:
        given = np.asarray(waypoints_m, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(
            f"path {name!r}: waypoints are not numbers: give (k, 2), x and y in metres"
        ) from None
    if given.size == 0:
        require_points(name, 0)
    if given.ndim != 2 or given.shape[1] != 2:
        raise InputError(f"path {name!r}: waypoints have shape {given.shape}: give (k, 2), x and y in metres")
    bad = np.argwhere(~np.isfinite(given))
    if bad.size:
        row, column = bad[0]
        raise InputError(
            f"path {name!r}: {'xy'[column]} of point {row} is {given[row, column]}: "
            "every coordinate must be a finite number"
        )
    require_points(name, len(given))
    require_near(name, given[:, 0], given[:, 1])
    knots = given[np.diff(along_m(given), prepend=-1.0) > _REPEATED_M]
    if len(knots) < 2:
        raise no_length(name, len(given))
    dense = _spline(knots) if smooth and len(knots) > 2 else knots
    along = along_m(dense)
    target = np.linspace(0.0, along[-1], count)

    def at(places_m: Float64) -> Float64:
        return np.array([np.interp(places_m, along, column) for column in dense.T])

    # The tangent at a point is that of the chord over half a spacing to each side: defined at corners too.
    half = 0.5 * along[-1] / (count - 1)
    dx, dy = at(np.minimum(target + half, along[-1])) - at(np.maximum(target - half, 0.0))
    x, y = at(target)
    return Path.from_arrays(x, y, np.arctan2(dy, dx), name)


def _spline(knots: Float64, per_segment: int = 64) -> Float64:
    """Points on the natural cubic spline over chord length: (segments * per_segment + 1, 2), m.

    Source: de Boor 1978, chapter IV (free ends).
    """
    from scipy.interpolate import CubicSpline

    chord = along_m(knots)
    share = np.arange(per_segment) / per_segment
    at = (chord[:-1, None] + np.diff(chord)[:, None] * share).ravel()
    return np.asarray(CubicSpline(chord, knots, bc_type="natural")(np.append(at, chord[-1])))
