"""The path that holds at another one's end: tangent, no sharper than asked, and about the end."""

from __future__ import annotations

import numpy as np
import pytest

from frogkick.core.errors import InputError
from frogkick.core.poses import wrap_angle
from frogkick.paths import POINTS_MAX, Path, from_waypoints, line, shape
from frogkick.paths.hold import LAP_POINTS, LEAD_POINTS, SPIRAL_POINTS, hold_at_end, hold_from_pose

RADIUS_M = 0.075
STEP_RAD = 2.0 * np.pi / LAP_POINTS
EVERYWHERE = np.array([[-np.inf] * 2, [np.inf] * 2])
PLACED = [(0.0, 0.0, 0.0), (0.4, -0.3, 2.5)]


def bends_rad(path: Path) -> np.ndarray:
    """(n - 1,) how far each chord's direction is from the mean of the tangents at its ends."""
    along = np.diff(path.points_m, axis=0)
    tangent = np.unwrap(path.tangent_rad.astype(np.float64))
    return np.abs(wrap_angle(np.arctan2(along[:, 1], along[:, 0]) - 0.5 * (tangent[:-1] + tangent[1:])))


@pytest.mark.parametrize("name", ["line", "sine", "ellipse", "circle", "bends", "eight"])
@pytest.mark.parametrize("pose", PLACED)
def test_it_leaves_the_path_and_touches_the_circle_tangentially(name: str, pose: tuple[float, ...]) -> None:
    path = shape(name).place(pose)
    hold = hold_at_end(path, RADIUS_M)
    assert np.allclose(hold.end_m, path.points_m[-1])
    assert 0.0 < hold.leave_m < path.length_m - RADIUS_M
    assert len(hold.entry) == len(hold.laps) == POINTS_MAX
    lead = hold.entry.points_m[:LEAD_POINTS]
    assert path.distance_m(lead).max() < 1e-3, "the path's own last part"
    assert bends_rad(hold.entry)[LEAD_POINTS - 1 :].max() < 0.1, "no corner"
    tangent = np.unwrap(hold.entry.tangent_rad.astype(np.float64))[LEAD_POINTS - 1 :]
    step_m = np.hypot(*np.diff(hold.entry.points_m[LEAD_POINTS - 1 :], axis=0).T)
    assert (np.abs(np.diff(tangent)) <= step_m / RADIUS_M * 1.02 + 1e-6).all(), "no sharper than the circle"
    away_m = np.hypot(*(hold.entry.points_m - hold.end_m).T)
    assert np.allclose(away_m[hold.circle_point :], RADIUS_M, rtol=0.01)
    assert (np.diff(away_m[LEAD_POINTS : hold.circle_point]) < 1e-3).all(), "it comes nearer all the way"
    assert len(hold.entry) - hold.circle_point > 2 * LAP_POINTS, "more than two laps"


def test_laps_begin_where_the_entry_comes_to_the_circle() -> None:
    hold = hold_at_end(line(), RADIUS_M)
    assert np.allclose(hold.laps.points_m[0], hold.entry.points_m[hold.circle_point], atol=1e-6)
    assert np.allclose(hold.laps.points_m[LAP_POINTS], hold.laps.points_m[0], atol=1e-6)
    assert np.allclose(np.abs(np.diff(np.unwrap(hold.laps.tangent_rad))), STEP_RAD, atol=1e-5)


@pytest.mark.parametrize("length_m", [0.01, 0.1, 0.2])
def test_a_path_that_is_too_short_is_swum_past_and_come_back_to(length_m: float) -> None:
    hold = hold_at_end(line(length_m), RADIUS_M)
    assert hold.leave_m > length_m
    assert np.allclose(hold.entry.points_m[0], 0.0)
    assert bends_rad(hold.entry).max() < 0.1
    assert len(hold.entry) - hold.circle_point > LAP_POINTS


def test_it_grows_with_the_radius() -> None:
    small, large = (hold_at_end(line(9.0), radius_m) for radius_m in (0.075, 0.15))
    left_m = [9.0 - hold.leave_m for hold in (small, large)]
    assert left_m[1] == pytest.approx(2.0 * left_m[0], abs=0.01)


def test_a_bent_end_is_left_to_the_side_from_which_less_of_it_is_lost() -> None:
    path = from_waypoints([(0.0, 0.0), (0.4, 0.0), (0.7, 0.2), (0.8, 0.5)])
    mirrored = Path.from_arrays(path.x_m, -path.y_m, -path.tangent_rad)
    one, other = hold_at_end(path, RADIUS_M), hold_at_end(mirrored, RADIUS_M)
    assert one.leave_m == pytest.approx(other.leave_m, abs=1e-6)
    assert np.allclose(one.entry.points_m * [1.0, -1.0], other.entry.points_m, atol=1e-5)


@pytest.mark.parametrize("radius_m", [0.0, -1.0, np.nan, np.inf])
def test_a_radius_that_is_none_is_refused(radius_m: float) -> None:
    with pytest.raises(InputError, match="give a finite radius above 0 m"):
        hold_at_end(line(), radius_m)


@pytest.mark.parametrize("course_rad", np.linspace(-3.0, 3.0, 5))
@pytest.mark.parametrize("place_m", [(0.0, 0.0), (0.45, 0.05), (0.6, -0.3), (0.45, 0.0)])
def test_from_anywhere_a_way_leads_onto_the_circle(place_m: tuple[float, float], course_rad: float) -> None:
    pose = np.array([*place_m, course_rad])
    first = hold_at_end(line(0.45), RADIUS_M)
    hold = hold_from_pose(first, RADIUS_M, pose, EVERYWHERE)
    assert hold is not None and hold.end_m == first.end_m
    entry = hold.entry.points_m
    assert np.allclose(entry[0], place_m, atol=1e-6)
    assert abs(wrap_angle(hold.entry.tangent_rad[0] - course_rad)) < 1e-6
    assert bends_rad(hold.entry).max() < 0.15, "no corner"
    tangent = np.unwrap(hold.entry.tangent_rad.astype(np.float64))
    step_m = np.hypot(*np.diff(entry, axis=0).T)
    assert (np.abs(np.diff(tangent)) <= step_m / RADIUS_M * 1.02 + 1e-6).all(), "no sharper than the circle"
    away_m = np.hypot(*(entry - hold.end_m).T)
    assert np.allclose(away_m[hold.circle_point :], RADIUS_M, rtol=0.01)
    assert len(entry) - hold.circle_point > LAP_POINTS
    assert np.allclose(hold.laps.points_m[0], entry[hold.circle_point], atol=1e-6)


def test_it_is_the_shortest_of_both_sides() -> None:
    """Mirrored poses, behind the end and swimming away, have mirrored ways: they turn on the near side."""
    first = hold_at_end(line(0.45), RADIUS_M)
    one, other = (
        hold_from_pose(first, RADIUS_M, np.array([0.75, y_m, 0.0]), EVERYWHERE) for y_m in (-0.2, 0.2)
    )
    assert one is not None and other is not None
    assert np.allclose(one.entry.points_m * [1.0, -1.0], other.entry.points_m, atol=1e-5)
    arc = one.entry.points_m[LEAD_POINTS : one.circle_point - SPIRAL_POINTS]
    assert arc[-1, 1] > -0.2, "to the left, where the end is"


def test_walls_are_kept() -> None:
    first = hold_at_end(line(0.45), RADIUS_M)
    pose = np.array([0.75, -0.2, 0.0])

    def highest_m(area_m: np.ndarray) -> float:
        hold = hold_from_pose(first, RADIUS_M, pose, area_m)
        assert hold is not None
        return float(hold.entry.points_m[: hold.circle_point, 1].max())

    free_m = highest_m(EVERYWHERE)
    assert highest_m(np.array([[-9.0, -9.0], [9.0, free_m - 0.01]])) <= free_m - 0.01
    assert hold_from_pose(first, RADIUS_M, pose, np.array([[0.0, -0.3], [0.8, 0.1]])) is None, "no room"
