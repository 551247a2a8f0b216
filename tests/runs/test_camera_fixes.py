"""Position fixes from pictures: right pose and time, and one clear line if the camera fails."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from tests.vision.scenes import calibration, scene

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.runs import tracked_fixes
from frogkick.runs.tracked_fixes import CameraFixes
from frogkick.vision.sources import Frame, live_frames

SCENE = scene(noise=3.0)
POSE = (0.5, 0.4, 0.7)
PATIENCE_S = 120.0
"""A test ends as soon as what it waits for is there; a busy machine may take long."""


def frames(
    count: int, pose: tuple[float, float, float] | None = POSE, rate_hz: float = 40.0
) -> Iterator[Frame]:
    """Frames like those of a folder of pictures."""
    rng = np.random.default_rng(1)
    for k in range(count):
        yield Frame(SCENE.picture(pose, rng), k / rate_hz, k, False)


def collected(source: CameraFixes, number: int) -> list[tuple[float, Fix]]:
    """(monotonic time of the look, fix) of the first ``number`` fixes."""
    found: list[tuple[float, Fix]] = []
    until_s = time.monotonic() + PATIENCE_S
    while len(found) < number and time.monotonic() < until_s:
        now_s = time.monotonic()
        found += [(now_s, fix) for fix in source.advance(now_s)]
        time.sleep(0.002)
    return found


def test_fixes_are_where_the_tag_is_and_when_it_was_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracked_fixes, "KEEP_S", PATIENCE_S)
    source = CameraFixes(frames(12), calibration(SCENE), "a folder")
    source.wait_first(PATIENCE_S)
    found = collected(source, 12)
    source.close()
    assert [fix.sequence for _, fix in found] == list(range(12))
    for now_s, fix in found:
        assert np.hypot(fix.pose_world[0] - POSE[0], fix.pose_world[1] - POSE[1]) < 1e-3
        assert abs(fix.pose_world[2] - POSE[2]) < np.deg2rad(0.5)
        assert fix.capture_s <= now_s
    taken_s = np.array([fix.capture_s for _, fix in found])
    slower_s = np.diff(taken_s) - 1.0 / 40.0
    assert slower_s.min() > -1e-3, "as fast as they were taken"
    assert slower_s.sum() == pytest.approx(source.behind_s, abs=1e-3), "or slower, and that is said"
    assert source.reasons == {"found": 12}


def test_a_video_waits_for_a_machine_that_is_too_slow() -> None:
    """The clock runs 3 s while a picture is searched: no fix is dropped, and the delay is said."""
    now_s = 0.0

    def slow() -> Iterator[Frame]:
        nonlocal now_s
        for frame in frames(4, rate_hz=1e6):
            now_s += 3.0
            yield frame

    source = CameraFixes(slow(), calibration(SCENE), "a video", clock=lambda: now_s)
    source.wait_first(PATIENCE_S)
    found = []
    while not source.ended:
        found += source.advance(now_s)
    found += source.advance(now_s)
    source.close()
    assert sum(source.reasons.values()) == 4
    assert source.reasons["found"] == len(found), "each picture with a fix is one that was handed over"
    assert source.reasons["too late"] == 4 - len(found)
    assert source.behind_s == pytest.approx(9.0, abs=1e-3)


def test_a_fix_that_is_dropped_has_a_reason() -> None:
    now_s = 0.0
    source = CameraFixes(frames(3, rate_hz=1e6), calibration(SCENE), "a video", clock=lambda: now_s)
    source.wait_first(PATIENCE_S)
    source.close()
    now_s = tracked_fixes.KEEP_S + 1.0
    assert source.advance(now_s) == []
    assert source.reasons["found"] == 0 and source.reasons["too late"] >= 1


def test_a_pool_without_a_tag_is_said() -> None:
    source = CameraFixes(frames(5, None), calibration(SCENE), "camera 0")
    until_s = time.monotonic() + PATIENCE_S
    while not source.ended and time.monotonic() < until_s:
        time.sleep(0.01)
    with pytest.raises(InputError, match=r"camera 0 saw no tag within 0\.5 s \(5 x no tag\): put the robot"):
        source.wait_first(0.5)
    source.close()


def test_a_frozen_camera_ends_the_run_in_one_line() -> None:
    class Frozen:
        """A camera that repeats the same picture."""

        picture = SCENE.picture(POSE, np.random.default_rng(2))

        def grab(self) -> bool:
            time.sleep(0.005)
            return True

        def retrieve(self) -> tuple[bool, object]:
            return True, self.picture

    source = CameraFixes(live_frames(Frozen(), "camera 7"), calibration(SCENE), "camera 7")
    with pytest.raises(InputError, match="camera 7 is frozen: 9 equal pictures in a row"):
        collected(source, 10_000)
    source.close()


def test_pictures_of_another_size_than_the_calibration_s_are_refused() -> None:
    small = (Frame(f.image[::2, ::2], f.capture_s, f.sequence, False) for f in frames(3))
    source = CameraFixes(small, calibration(SCENE), "a folder")
    with pytest.raises(InputError, match=r"the frame is 320 x 240 px, the calibration is for 640 x 480"):
        source.wait_first(PATIENCE_S)
    source.close()


def test_a_driver_that_breaks_is_not_kept_quiet() -> None:
    def broken() -> Iterator[Frame]:
        yield from frames(2)
        raise RuntimeError("the driver fell over")

    source = CameraFixes(broken(), calibration(SCENE), "camera 0")
    with pytest.raises(RuntimeError, match="the driver fell over"):
        collected(source, 10_000)
    source.close()


def test_an_old_fix_is_left_out() -> None:
    now_s = [100.0]
    source = CameraFixes(frames(2), calibration(SCENE), "a folder", lambda: now_s[0])
    source.wait_first(PATIENCE_S)
    now_s[0] += 3.0
    assert source.advance(103.0) == []
    source.close()


def stay_quiet(source: CameraFixes, now_s: list[float]) -> None:
    for _ in range(20):
        now_s[0] += 0.1
        source.advance(30.0)


def test_a_computer_that_slept_does_not_blame_the_camera() -> None:
    """A live camera, while this program's clock stood still: pictures may come again."""
    now_s, goes_on = [100.0], threading.Event()
    picture = SCENE.picture(POSE, np.random.default_rng(2))

    def filmed() -> Iterator[Frame]:
        yield Frame(picture, now_s[0], 0, True)
        goes_on.wait(60.0)

    source = CameraFixes(filmed(), calibration(SCENE), "camera 2", clock=lambda: now_s[0])
    source.wait_first(PATIENCE_S)
    source.advance(0.0)
    now_s[0] += 30.0
    source.advance(30.0)
    for _ in range(9):  # awake for 0.9 s more, in which it says nothing
        now_s[0] += 0.1
        source.advance(30.0)
    with pytest.raises(InputError, match=r"camera 2 has given no picture for 31\.\d s: plug it in again"):
        stay_quiet(source, now_s)
    goes_on.set()
    source.close()
