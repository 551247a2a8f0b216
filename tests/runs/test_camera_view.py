"""The viewer of a camera: the camera's own picture, with the run drawn where the camera sees it."""

from __future__ import annotations

import json
import re
import socket
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.error import HTTPError

import cv2
import numpy as np
import pytest
from tests.runs import rig
from tests.vision.scenes import calibration, scene

from frogkick.core.poses import Fix
from frogkick.front.viewing import viewed
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.report.live_page import served
from frogkick.runs import tracked_fixes
from frogkick.runs.record import RunOptions
from frogkick.runs.tracked_fixes import CameraFixes, CameraView
from frogkick.vision.calibration import Calibration
from frogkick.vision.scene import Scene, looking_at
from frogkick.vision.sources import Frame

POSE = (0.4, 0.5, 0.3)
BENT = Scene(view=looking_at(distortion=(-0.15, 0.03, 0.0, 0.0, 0.0)))
"""Through a lens that bends straight lines by pixels."""


class Still:
    """A camera that takes single pictures on request."""

    def __init__(self, of: Scene) -> None:
        self.scene, self.rng = of, np.random.default_rng(3)
        self.asked, self.over = threading.Semaphore(1), False
        self.taken: list[np.ndarray] = []

    def __iter__(self) -> Iterator[Frame]:
        while True:
            self.asked.acquire()
            if self.over:
                return
            self.taken.append(self.scene.picture(POSE, self.rng))
            yield Frame(self.taken[-1], time.monotonic(), len(self.taken), True)


@contextmanager
def looking(of: Scene, by: Calibration | None = None) -> Iterator[tuple[Still, CameraFixes]]:
    still = Still(of)
    camera = CameraFixes(iter(still), by or calibration(of), "camera")
    try:
        camera.wait_first(120.0)
        yield still, camera
    finally:
        still.over = True
        still.asked.release()
        camera.close()


def bent_calibration() -> Calibration:
    """The calibration of a camera with lens distortion, known from a board."""
    from frogkick.vision.board import calibrate_corners
    from frogkick.vision.calibration import Lens, Tag

    view = BENT.view
    tag = Tag(size_m=BENT.tag_size_m, height_m=BENT.tag_height_m)
    lens = Lens(view.matrix_px, view.distortion)
    return calibrate_corners(
        BENT.corners_px(), BENT.pool_m, view.image_px, tag, 0.0, float(view.place_m[2]), lens
    )


@pytest.mark.parametrize("bent", [False, True], ids=["straight", "bent"])
def test_places_of_the_pool_are_drawn_where_the_camera_sees_them(bent: bool) -> None:
    """Through calibration and lens, compared with the pinhole camera that rendered the scene."""
    of = BENT if bent else scene()
    with looking(of, bent_calibration() if bent else None) as (_, camera):
        eye = CameraView(camera)
        places = np.random.default_rng(5).uniform([0.1, 0.1], [1.1, 0.8], (50, 2))
        seen = of.view.pixels(np.c_[places, np.full(50, of.tag_height_m)])
        assert np.abs(eye.pixels(places) - seen).max() < 0.3
        assert eye.pixels(np.zeros((0, 2))).shape == (0, 2)
        assert eye.size_px == of.view.image_px


@pytest.mark.parametrize("most_px", [960, 320], ids=["as it is", "made smaller"])
def test_the_page_is_given_the_camera_s_picture(most_px: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracked_fixes, "WIDTH_MOST_PX", most_px)
    of = scene()
    with looking(of) as (still, camera):
        eye = CameraView(camera)
        with served(lambda: "{}", eye.picture) as address:
            answer = urllib.request.urlopen(address + "picture.jpg", timeout=60.0)
            shown = cv2.imdecode(np.frombuffer(answer.read(), dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
        width, height = of.view.image_px
        assert answer.headers["Content-Type"] == "image/jpeg"
        assert shown.shape == ((height, width) if most_px > width else (240, 320))
        expected = cv2.resize(still.taken[0], shown.shape[::-1], interpolation=cv2.INTER_AREA)
        assert np.abs(shown.astype(float) - expected).mean() < 4.0, "JPEG, no more"
        # The tag is outlined where it lies: its corners as the scene's pinhole sees them.
        half = of.tag_size_m / 2
        c, s = np.cos(POSE[2]), np.sin(POSE[2])
        square = half * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) @ np.array([[c, s], [-s, c]])
        corners = of.view.pixels(np.c_[square + POSE[:2], np.full(4, of.tag_height_m)])
        assert np.abs(np.array(json.loads(answer.headers["X-Tag"])) - corners).max() < 0.5


def test_no_picture_is_made_that_nobody_asks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor two at once, nor the same twice: pages that ask often get the same picture."""
    made: list[int] = []
    encode = cv2.imencode
    monkeypatch.setattr(tracked_fixes.cv2, "imencode", lambda *given: made.append(1) or encode(*given))
    with looking(scene()) as (still, camera):
        eye = CameraView(camera)
        for _ in range(3):
            still.asked.release()
        deadline_s = time.monotonic() + 120.0
        while sum(camera.reasons.values()) < 4:
            assert time.monotonic() < deadline_s
            time.sleep(0.005)
        assert not made
        first, second = eye.picture(), eye.picture()
        assert first is not None and first == second and len(made) == 1
        monkeypatch.setattr(tracked_fixes, "EVERY_S", 1e9)
        before = camera.newest
        still.asked.release()
        while camera.newest is before:
            assert time.monotonic() < deadline_s
            time.sleep(0.005)
        assert eye.picture() == first and len(made) == 1, "a newer one, but too soon"
        monkeypatch.setattr(tracked_fixes, "EVERY_S", 0.0)
        later = eye.picture()
        assert later is not None and later[1]["X-Capture-S"] > first[1]["X-Capture-S"] and len(made) == 2


def test_before_the_first_picture_there_is_none() -> None:
    still = Still(scene())
    still.asked.acquire()
    camera = CameraFixes(iter(still), calibration(scene()), "camera")
    try:
        eye = CameraView(camera)
        assert eye.picture() is None
        with served(lambda: "{}", eye.picture) as address, pytest.raises(HTTPError, match="404"):
            urllib.request.urlopen(address + "picture.jpg", timeout=60.0)
    finally:
        still.over = True
        still.asked.release()
        camera.close()


def test_a_real_run_is_drawn_over_its_camera_s_picture(capsys: pytest.CaptureFixture[str]) -> None:
    """All that is drawn is in the picture's pixels, and lies where the tag is seen."""
    of = scene()
    with looking(of) as (_, camera):
        path = shape("line").place((POSE[0], POSE[1], POSE[2] - float(shape("line").tangent_rad[0])))
        recording = rig.recording(path, RunOptions(PlanConfig(depth=2)))
        recording.fixes.append(Fix(0.0, 0.02, *POSE))
        with viewed(True, recording, camera) as keep:
            address = re.findall(r"http://\S+", capsys.readouterr().err)[0]
            keep(recording)
            deadline_s = time.monotonic() + 120.0
            output: dict[str, object] = {}
            while not output.get("fixes"):
                assert time.monotonic() < deadline_s, "nobody draws"
                output = json.loads(urllib.request.urlopen(address + "state.json", timeout=60.0).read())
                time.sleep(0.02)
            corners = json.loads(
                urllib.request.urlopen(address + "picture.jpg", timeout=60.0).headers["X-Tag"]
            )
    drawn = output["camera"]
    assert isinstance(drawn, dict) and drawn["size"] == list(of.view.image_px)
    assert set(drawn) == {"size", "path", "fixes", "track", "robot", "decisions", "fan", "branch"}
    assert drawn["fixes"][0] == pytest.approx(np.mean(corners, axis=0), abs=1.0)
    points = np.c_[path.points_m, np.full(len(path), of.tag_height_m)]
    assert np.array(drawn["path"]) == pytest.approx(of.view.pixels(points), abs=0.4)


def test_a_page_that_goes_away_is_not_told_of(capfd: pytest.CaptureFixture[str]) -> None:
    """A window that is closed during an answer leaves no traceback in the terminal of the run."""
    asked, gone = threading.Event(), threading.Event()

    def slow() -> tuple[bytes, dict[str, str]]:
        asked.set()
        gone.wait(60.0)
        return b"x" * 5_000_000, {}

    with served(lambda: "{}", slow) as address:
        host, port = re.findall(r"//([\d.]+):(\d+)/", address)[0]
        with socket.create_connection((host, int(port))) as page:
            page.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # closed by a reset
            page.sendall(b"GET /picture.jpg HTTP/1.1\r\nHost: here\r\n\r\n")
            assert asked.wait(60.0)
        gone.set()
        time.sleep(0.3)
        assert urllib.request.urlopen(address, timeout=60.0).status == 200
    assert capfd.readouterr().err == ""
