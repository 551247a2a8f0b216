"""A camera's newest picture for the viewer, and points of the pool in its pixels."""

from __future__ import annotations

import json
import threading
import time

import cv2
import numpy as np
from numpy.typing import NDArray

from frogkick.runs.camera_fixes import CameraFixes, Sighting

FloatArray = NDArray[np.float64]

EVERY_S = 0.1
"""Shortest time between two encoded pictures, however many pages ask."""
WIDTH_MOST_PX = 960
"""Wider pictures are scaled down to this width."""
QUALITY = 80


class CameraView:
    """A camera's pictures as JPEG, encoded on request in the caller's thread.

    Attributes:
        size_px: width and height of the camera's own pictures; all pixels here refer to them.
    """

    def __init__(self, camera: CameraFixes) -> None:
        """Show a camera, which the caller closes."""
        self._camera = camera
        self.size_px = camera.calibration.image_px
        self._lock = threading.Lock()
        self._made_s = -EVERY_S
        self._shown: Sighting | None = None
        self._jpeg = b""

    def pixels(self, points_world_m: FloatArray) -> FloatArray:
        """(n, 2) pixels, with lens distortion, of (n, 2) points of the pool at the tag's height."""
        calibration = self._camera.calibration
        if not len(points_world_m):
            return np.zeros((0, 2))
        return calibration.distort(calibration.pixels(np.asarray(points_world_m, dtype=np.float64)))

    def picture(self) -> tuple[bytes, dict[str, str]] | None:
        """The newest picture as JPEG, and HTTP headers about it; None before the first.

        The headers are ``X-Capture-S`` and ``X-Tag``: JSON of the (4, 2) pixels of the tag's corners, or
        null.
        """
        with self._lock:
            newest, now_s = self._camera.newest, time.monotonic()
            if newest is not None and newest is not self._shown and now_s - self._made_s >= EVERY_S:
                self._jpeg = _jpeg(newest.image)
                self._shown, self._made_s = newest, now_s
            if self._shown is None:
                return None
            corners = self._shown.corners_px
            headers = {
                "X-Capture-S": f"{self._shown.captured_s:.4f}",
                "X-Tag": json.dumps(None if corners is None else np.round(corners, 1).tolist()),
            }
            return self._jpeg, headers


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    height, width = image.shape[:2]
    if width > WIDTH_MOST_PX:
        size = (WIDTH_MOST_PX, round(height * WIDTH_MOST_PX / width))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, made = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return made.tobytes()
