"""A frame without a trustworthy tag gives no pose, and a reason."""

from __future__ import annotations

import numpy as np
import pytest
from tests.conftest import count
from tests.vision.scenes import calibration, clutter, drawn_pose, scene

from frogkick.core.errors import InputError
from frogkick.vision.scene import Conditions, Scene, looking_at
from frogkick.vision.tags import tag_cells
from frogkick.vision.tracker import Tracker


def test_no_pose_without_a_tag() -> None:
    """Random squares, other tags, the tag's mirror image and negative, chessboards, glare, waves, noise."""
    rng = np.random.default_rng(11)
    still = scene()
    tracker = Tracker(calibration(still))
    false = []
    for k in range(count(80, 10_000, 25)):
        spoilt = Conditions(
            blur_px=rng.uniform(0, 2), noise=rng.uniform(0, 12), light_slope=rng.uniform(0, 0.7),
            glare=int(rng.integers(0, 6)), wave_height_m=rng.uniform(0, 0.002), ripple_px=rng.uniform(0, 2),
        )  # fmt: skip
        # The still pool is drawn once: what lies in it and spoils it is new each time.
        one = Scene(conditions=spoilt)
        one.__dict__["still"] = still.still
        image = one.picture(None, rng, clutter(one, rng))
        tracker.forget()
        if tracker.observe(image).pose is not None:
            false.append(k)
    assert false == []


def test_a_mirrored_picture_is_named() -> None:
    usual = scene()
    tracker = Tracker(calibration(usual))
    image = usual.picture((0.5, 0.5, 1.0), np.random.default_rng(3))
    assert tracker.observe(np.ascontiguousarray(image[:, ::-1])).reason == "mirrored"
    assert tracker.observe(image).reason == "found"
    # A reflection of a tag that was seen the right way round is none of its pictures.
    assert tracker.observe(np.ascontiguousarray(image[:, ::-1])).reason == "no tag"


def test_a_picture_that_is_nearly_black_is_named() -> None:
    usual = scene()
    tracker = Tracker(calibration(usual))
    image = usual.picture((0.5, 0.5, 1.0), np.random.default_rng(3))
    assert tracker.observe((image // 20).astype(np.uint8)).reason == "too dark"


@pytest.mark.parametrize("wrong", [1, 2, 3, 5])
def test_a_tag_with_wrong_cells_is_none(wrong: int) -> None:
    """Codes differ in 11 cells. A tag with a cell that is clearly wrong is refused."""
    rng = np.random.default_rng(12)
    usual = scene()
    tracker = Tracker(calibration(usual))
    for _ in range(count(4, 200)):
        cells = tag_cells("tag36h11", 0).copy()
        for at in rng.choice(36, wrong, replace=False):
            row, col = 2 + at // 6, 2 + at % 6
            cells[row, col] = 1 - cells[row, col]
        x, y, heading = drawn_pose(usual, rng)
        tracker.forget()
        seen = tracker.observe(usual.picture(None, rng, [(cells, x, y, heading, usual.tag_size_m)]))
        assert seen.pose is None
        assert seen.reason in ("unclear", "no tag")


def test_a_lost_tag_is_told_and_found_again() -> None:
    usual = scene()
    tracker = Tracker(calibration(usual))
    rng = np.random.default_rng(13)
    where = (0.5, 0.5, 1.0)
    reasons = [
        tracker.observe(usual.picture(where if there else None, rng)).reason
        for there in (True, True, False, False, True)
    ]
    assert reasons == ["found", "found", "no tag", "no tag", "found"]


def test_two_of_them_are_none() -> None:
    usual = scene()
    rng = np.random.default_rng(14)
    twin = (tag_cells("tag36h11", 0), 0.9, 0.6, 2.0, usual.tag_size_m)
    seen = Tracker(calibration(usual)).observe(usual.picture((0.3, 0.3, 1.0), rng, [twin]))
    assert (seen.pose, seen.reason) == (None, "doubled")


@pytest.mark.parametrize("cover", [0.12, 0.3, 0.5, 0.8])
def test_a_tag_half_covered_is_none(cover: float) -> None:
    covered = scene(cover=cover)
    rng = np.random.default_rng(15)
    tracker = Tracker(calibration(covered))
    for _ in range(count(3, 100)):
        tracker.forget()
        seen = tracker.observe(covered.picture(drawn_pose(covered, rng), rng))
        assert seen.pose is None
        assert seen.reason != "found"


def test_a_tag_cut_by_the_frame_s_edge_is_none() -> None:
    near = Scene(view=looking_at(place_m=(0.6, 0.45, 0.9)))
    tracker = Tracker(calibration(near))
    rng = np.random.default_rng(16)
    # What the camera sees ends 0.45 m from the middle: centres from there on have half a tag at most.
    for x in (1.05, 1.06, 1.07):
        tracker.forget()
        assert tracker.observe(near.picture((x, 0.45, 0.3), rng)).pose is None


@pytest.mark.parametrize(
    "conditions",
    [{"glare_on_tag": 0.2}, {"glare_on_tag": 0.6}, {"glare_on_tag": 1.0}, {"blur_px": 3.0}],
    ids=str,
)
def test_glare_and_blur_give_a_right_pose_or_none(conditions: dict[str, float]) -> None:
    spoilt = scene(**conditions)
    tracker = Tracker(calibration(spoilt))
    rng = np.random.default_rng(17)
    for _ in range(count(16, 300, 8)):
        truth = drawn_pose(spoilt, rng)
        tracker.forget()
        pose = tracker.observe(spoilt.picture(truth, rng)).pose
        if pose is not None:
            assert np.hypot(pose.x_m - truth[0], pose.y_m - truth[1]) < 1e-3
            assert abs(np.sin((pose.heading_rad - truth[2]) / 2)) < np.sin(np.deg2rad(0.5) / 2)


def test_a_tag_of_another_size_or_outside_the_pool_is_none() -> None:
    usual = scene()
    rng = np.random.default_rng(18)
    tracker = Tracker(calibration(usual))
    cells = tag_cells("tag36h11", 0)
    large = tracker.observe(usual.picture(None, rng, [(cells, 0.6, 0.4, 1.0, 1.2 * usual.tag_size_m)]))
    assert (large.pose, large.reason) == (None, "wrong size")
    beside = Scene(pool_m=(0.7, 0.9))
    seen = Tracker(calibration(beside)).observe(beside.picture((0.85, 0.45, 1.0), rng))
    assert (seen.pose, seen.reason) == (None, "outside the pool")


def test_a_frame_of_another_size_is_an_error() -> None:
    with pytest.raises(InputError, match="320 x 240 px, the calibration is for 640 x 480"):
        Tracker(calibration(scene())).observe(np.zeros((240, 320), np.uint8))


def test_a_tag_too_small_is_an_error() -> None:
    small = Scene(tag_size_m=0.02)
    with pytest.raises(InputError, match="px wide in this camera, 12 are needed"):
        Tracker(calibration(small))
