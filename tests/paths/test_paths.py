"""Path, shapes, waypoints: geometry against closed forms and against the published path files."""

from __future__ import annotations

import math
import pathlib
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frogkick.core.errors import InputError
from frogkick.paths import Path, ellipse, from_csv, from_waypoints, line, shape, sine, wrap_angle

COORDINATE = st.floats(-5.0, 5.0, allow_nan=False)


def test_line_is_straight_and_even() -> None:
    path = line(0.4)
    assert len(path) == 100
    assert path.x_m.dtype == np.float32
    assert path.length_m == pytest.approx(0.4, rel=1e-6)
    assert np.all(path.y_m == 0.0)
    assert np.all(path.tangent_rad == 0.0)
    assert path.x_m[33] == np.float32(0.4 * 33 / 99)


def test_a_path_shows_itself_in_one_line() -> None:
    assert repr(line(0.4)) == "Path('line': 100 points, 400 mm)"


def test_shapes_start_at_the_origin_and_keep_their_tangent() -> None:
    for name in ("line", "sine", "ellipse"):
        path = shape(name)
        assert path.points_m[0] == pytest.approx([0.0, 0.0], abs=1e-9)
        chord = np.diff(path.points_m, axis=0)
        off = wrap_angle(np.arctan2(chord[:, 1], chord[:, 0]) - path.tangent_rad[:-1])
        assert np.abs(off).max() < 0.08, name  # half a step of turning between two points


@pytest.mark.parametrize(
    ("run", "clockwise", "aspect"), [(1, True, 2), (3, True, 2), (5, False, 1), (6, False, 1)]
)
def test_ellipse_is_the_published_one(
    frog2022_dir: pathlib.Path, run: int, clockwise: bool, aspect: int
) -> None:
    published = from_csv(frog2022_dir / "control" / f"ellipsep{run}.csv")
    # Points 0 and 99 of an arc from angle 0 to 1.9 pi give the axis: solve by trying the long semi-axis.
    side = 1.0 if clockwise else -1.0
    start = published.points_m[0]
    heading = float(published.tangent_rad[0]) - side * math.pi / 2
    ahead = (published.points_m - start) @ np.array([math.cos(heading), math.sin(heading)])
    half = ahead[26] / (1.0 - math.cos(1.9 * math.pi * 26 / 99))
    made = ellipse(2 * half, aspect, clockwise=clockwise).place((*start, heading))
    assert np.abs(made.points_m - published.points_m).max() < 2e-7
    assert np.abs(wrap_angle(made.tangent_rad - published.tangent_rad)).max() < 1e-6


@pytest.mark.parametrize("run", [1, 3])
def test_sine_is_the_published_one(frog2022_dir: pathlib.Path, run: int) -> None:
    published = from_csv(frog2022_dir / "control" / f"sinp{run}.csv")
    chord = published.points_m[-1] - published.points_m[0]
    length = np.hypot(*chord) / math.hypot(0.85, 0.1 * math.sin(10.0))
    heading = math.atan2(chord[1], chord[0]) - math.atan2(0.1 * math.sin(10.0), 0.85)
    made = sine(float(length)).place((*published.points_m[0], heading))
    assert np.abs(made.points_m - published.points_m).max() < 2e-7
    assert np.abs(wrap_angle(made.tangent_rad - published.tangent_rad)).max() < 1e-6


def test_line_is_the_published_one(frog2022_dir: pathlib.Path) -> None:
    published = from_csv(frog2022_dir / "control" / "linep1.csv")
    made = line(published.length_m).place((*published.points_m[0], float(published.tangent_rad[0])))
    assert np.abs(made.points_m - published.points_m).max() < 2e-7
    assert published.length_m == pytest.approx(0.46563, abs=1e-5)


def test_place_turns_then_moves() -> None:
    placed = line(1.0).place((2.0, 3.0, math.pi / 2))
    assert placed.points_m[-1] == pytest.approx([2.0, 4.0], abs=1e-6)
    assert placed.tangent_rad == pytest.approx(math.pi / 2)
    turned = line(1.0).place((0.0, 0.0, 3.0 * math.pi))
    assert turned.tangent_rad[0] == np.float32(math.pi)
    with pytest.raises(InputError, match="cannot be placed"):
        line().place((0.0, math.nan, 0.0))


@given(st.lists(COORDINATE, min_size=3, max_size=3))
@settings(max_examples=50, deadline=None)
def test_place_keeps_lengths_and_tangent_range(pose: list[float]) -> None:
    path = sine(0.4)
    placed = path.place(pose)
    assert placed.length_m == pytest.approx(path.length_m, rel=1e-3)
    assert np.all(placed.tangent_rad <= np.float32(math.pi))
    assert np.all(placed.tangent_rad > -np.float32(math.pi))


def test_distance_is_to_segments() -> None:
    path = from_waypoints([(0.0, 0.0), (1.0, 0.0)], points=2)
    assert path.distance_m([(0.5, 0.2), (-3.0, 4.0), (1.0, 1.0), (0.25, 0.0)]) == pytest.approx(
        [0.2, 5.0, 1.0, 0.0]
    )
    assert path.nearest_index([(0.5, 0.0), (0.6, 0.0)]).tolist() == [0, 1]
    with pytest.raises(InputError, match="shape"):
        path.distance_m([1.0, 2.0])


def test_distances_of_many_points_take_little_memory() -> None:
    """A file of a million points took gigabytes."""
    path, rng = ellipse(), np.random.default_rng(3)
    points = rng.uniform(-0.5, 0.5, (50_000, 2))
    tracemalloc.start()
    distance = path.distance_m(points)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 60e6
    some = rng.integers(0, len(points), 500)
    assert np.array_equal(distance[some], path.distance_m(points[some]))


@given(st.lists(st.tuples(COORDINATE, COORDINATE), min_size=1, max_size=20))
@settings(max_examples=50, deadline=None)
def test_distance_never_exceeds_that_to_points(points: list[tuple[float, float]]) -> None:
    path = sine(1.0)
    to_points = np.hypot(*(np.asarray(points)[:, None, :] - path.points_m[None]).transpose(2, 0, 1)).min(
        axis=1
    )
    to_line = path.distance_m(points)
    assert np.all(to_line <= to_points + 1e-12)
    assert np.all(to_line >= to_points - 0.02)  # half the widest spacing


NEAR = st.floats(-1.0, 1.0, allow_nan=False)  # so that no path is longer than one may be


@given(st.lists(st.tuples(NEAR, NEAR), min_size=2, max_size=12), st.booleans())
@settings(max_examples=80, deadline=None)
def test_waypoints_give_an_even_path_through_them(points: list[tuple[float, float]], smooth: bool) -> None:
    given_points = np.asarray(points, dtype=np.float64)
    gaps = np.hypot(*np.diff(given_points, axis=0).T)
    if gaps.max() < 1e-3 or (0.0 < gaps[gaps > 0].min() < 1e-3):
        return
    path = from_waypoints(points, smooth=smooth)
    steps = np.hypot(*np.diff(path.points_m, axis=0).T)
    assert len(path) == 100
    assert path.points_m[0] == pytest.approx(points[0], abs=1e-5)
    assert path.points_m[-1] == pytest.approx(points[-1], abs=1e-5)
    # Even along the curve: a chord cuts corners, so it is never longer than the mean spacing.
    assert steps.max() <= path.length_m / 99 * 1.6 + 1e-5


def test_smooth_waypoints_follow_a_circle() -> None:
    angle = np.linspace(0.0, math.pi, 13)
    path = from_waypoints(np.column_stack([np.cos(angle), np.sin(angle)]))
    radius = np.hypot(*path.points_m.T)
    assert np.abs(radius - 1.0).max() < 0.01
    assert path.length_m == pytest.approx(math.pi, rel=2e-3)
    middle = slice(10, 90)
    along = np.arctan2(path.points_m[middle, 1], path.points_m[middle, 0])
    assert np.abs(wrap_angle(path.tangent_rad[middle] - along - math.pi / 2)).max() < 0.02


def test_corner_keeps_its_sides() -> None:
    path = from_waypoints([(0, 0), (0, 0), (1, 0), (1, 1)], smooth=False)
    assert path.length_m == pytest.approx(2.0, abs=0.02)
    assert path.tangent_rad[10] == pytest.approx(0.0, abs=1e-6)
    assert path.tangent_rad[90] == pytest.approx(math.pi / 2, abs=1e-6)


def test_a_waypoint_that_differs_by_rounding_is_a_repeat() -> None:
    corner = [(0.0, 0.0), (0.2, 0.0), (0.2, 1e-18), (0.2, 1e-10), (0.4, 0.1)]
    assert from_waypoints(corner) == from_waypoints([corner[0], corner[1], corner[4]])


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ([], "empty"),
        ([(1.0, 2.0)], "1 point"),
        ([(1.0, 2.0), (1.0, 2.0)], "no length"),
        ([(1.0, 2.0), (1.0, math.nan)], "y of point 1 is nan"),
        ([(1.0, 2.0), (1.0, math.inf)], "y of point 1 is inf"),
        ([(1.0, 2.0, 3.0)], "shape"),
        ([(0.0, 0.0), (5000.0, 0.0)], "1000 m"),
        ([(0.0, 0.0), (1e200, 0.0), (2e200, 1e200)], "1000 m"),
        ([(0.0, 0.0), (1e-200, 0.0), (2e-200, 1e-200)], "no length"),
    ],
)
def test_bad_waypoints(points: list[tuple[float, ...]], text: str) -> None:
    with pytest.raises(InputError, match=text):
        from_waypoints(points)


@pytest.mark.parametrize(
    "made",
    [
        lambda: from_waypoints([(0, 0), (300, 200)]),
        lambda: line(450.0),
        lambda: sine(450.0),
        lambda: shape("eight", 600.0),
        lambda: Path([0.0, 450.0], [0.0, 0.0], [0.0, 0.0]),  # type: ignore[arg-type]
        lambda: Path.from_arrays([0, 300], [0, 200], [0, 0]),
    ],
)
def test_millimetres_are_refused_wherever_a_path_is_made(made: Callable[[], Path]) -> None:
    with pytest.raises(InputError, match=r"m, more than 50 m: coordinates are in metres, are these mm\?"):
        made()


def test_bad_arrays() -> None:
    with pytest.raises(InputError, match="empty"):
        Path.from_arrays([], [], [])
    with pytest.raises(InputError, match="1 point"):
        Path.from_arrays([0], [0], [0])
    with pytest.raises(InputError, match="101 points"):
        Path.from_arrays(np.arange(101), np.zeros(101), np.zeros(101))
    with pytest.raises(InputError, match="tangent_rad of point 1 is nan"):
        Path.from_arrays([0, 1], [0, 0], [0, math.nan])
    with pytest.raises(InputError, match="2 x, 2 y and 3 tangents"):
        Path.from_arrays([0, 1], [0, 0], [0, 0, 0])


@pytest.mark.parametrize("wrong", ["x", None, [1.0], 1j, (0.0, 0.0), [[0.0, "a"]], (x for x in "a")])
def test_what_is_no_number_is_told(wrong: Any) -> None:
    for mistake in (
        lambda: line(wrong),
        lambda: line(points=wrong),
        lambda: ellipse(aspect=wrong),
        lambda: ellipse(turns=wrong),
        lambda: shape(wrong),
        lambda: line().place(wrong),
        lambda: line().motion_to(wrong),
        lambda: line().distance_m(wrong),
        lambda: line().nearest_index(wrong),
    ):
        with pytest.raises(InputError) as caught:
            mistake()
        assert "\n" not in str(caught.value)


def test_arrays_are_kept_from_changes() -> None:
    path = line()
    with pytest.raises(ValueError, match="read-only"):
        path.x_m[0] = 1.0
    assert path == line()
    assert path != line(0.2)


def test_shape_names_and_lengths() -> None:
    with pytest.raises(InputError, match="did you mean 'sine'"):
        shape("sin")
    with pytest.raises(InputError, match="length"):
        shape("line", 0.0)
    with pytest.raises(InputError, match="length"):
        sine(math.nan)
    with pytest.raises(InputError, match="turns"):
        ellipse(turns=1.5)
    with pytest.raises(InputError, match="aspect"):
        ellipse(aspect=0.0)
    assert shape("line", 0.2).length_m == pytest.approx(0.2)


def test_wrap_angle_range() -> None:
    angles = wrap_angle([math.pi, -math.pi, 3 * math.pi, -3.5, 0.0, np.nextafter(-math.pi, -4.0)])
    assert angles[0] == math.pi
    assert angles[1] == math.pi
    assert np.all((angles > -math.pi) & (angles <= math.pi))
    assert angles[4] == 0.0
