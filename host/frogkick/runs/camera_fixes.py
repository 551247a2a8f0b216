"""Position fixes from the camera over the pool, found in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.runs.fix_buffer import FixBuffer
from frogkick.vision.calibration import Calibration
from frogkick.vision.sources import Frame
from frogkick.vision.tracker import Tracker
from frogkick.vision.video import Video

AWAKE_S = 0.1
STALL_S = 1.0
"""A live camera that gives no picture for longer hangs."""


@dataclass(frozen=True)
class Sighting:
    """A picture and the tag in it.

    Attributes:
        image: (height, width) grey or (height, width, 3) BGR; read-only.
        captured_s: capture time on the fixes' clock.
        corners_px: (4, 2) of the tag, trusted or not; None without a tag.
    """

    image: NDArray[np.uint8]
    captured_s: float
    corners_px: NDArray[np.float64] | None


class CameraFixes(FixBuffer):
    """A ``FixSource`` that finds the robot's tag in each picture; poses are in the pool's frame.

    A live picture is captured when the driver hands it over. Pictures of a video or a folder are played at
    the rate at which they were taken.

    Attributes:
        calibration: of the camera.
        reasons: number of pictures with a pose (``found``), and of those without, by reason.
        newest: the last picture; None before the first.
    """

    def __init__(
        self,
        frames: Iterator[Frame],
        calibration: Calibration,
        name: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start to find fixes.

        Args:
            frames: pictures of the camera.
            calibration: of the camera.
            name: of the camera, for people.
            clock: of the live pictures' capture times, in s.
        """
        super().__init__(name, clock)
        self.calibration = calibration
        self.reasons: Counter[str] = Counter()
        self.newest: Sighting | None = None
        self._frames, self._tracker = frames, Tracker(calibration)
        self._stop = threading.Event()
        self._video: Video | None = None
        self._last_picture_s: float | None = None  # of a live camera
        self._quiet_since_s: float | None = None
        self._quiet_s = 0.0
        self._checked_s = clock()
        self._thread = threading.Thread(target=self._look, name=name, daemon=True)
        self._thread.start()

    @property
    def ended(self) -> bool:
        """Whether there are no more pictures, as at the end of a video."""
        return not self._thread.is_alive()

    def wait_first(self, timeout_s: float) -> None:
        """Wait for the first pose.

        Raises:
            InputError: none came in time, or the camera failed.
        """
        self._bell.wait_for(lambda: self.reasons["found"] > 0 or self._error is not None, timeout_s)
        with self._lock:
            if self._error is not None:
                raise self._error
            if not self.reasons["found"]:
                reasons = ", ".join(f"{count} x {reason}" for reason, count in self.reasons.most_common())
                raise InputError(
                    f"{self._name} saw no tag within {timeout_s:g} s ({reasons or 'no picture came'}): put "
                    "the robot under it, and look at 'frogkick camera track --view'"
                )

    def advance(self, until_s: float) -> list[Fix]:
        """Return the fixes that arrived since the last call and are at most 2 s old.

        Raises:
            InputError: the camera failed: unplugged, frozen, hanging, or of another size than its
                calibration.
        """
        fixes = super().advance(until_s)
        with self._lock:
            last_s, now_s = self._last_picture_s, self._clock()
        # A computer that slept or was busy kept the camera's thread from its pictures as well.
        awake_s, self._checked_s = min(now_s - self._checked_s, AWAKE_S), now_s
        if last_s is None or last_s != self._quiet_since_s:
            self._quiet_since_s, self._quiet_s = last_s, 0.0
            return fixes
        self._quiet_s += awake_s
        if self._quiet_s > STALL_S:
            raise InputError(
                f"{self._name} has given no picture for {now_s - last_s:.1f} s: plug it in again, or choose "
                "a lower rate or another port"
            )
        return fixes

    def film(self, video: Video) -> None:
        """Write each picture from now on to a video, after its fix was found."""
        self._video = video

    def close(self) -> None:
        """Release the camera."""
        self._stop.set()
        self._thread.join(timeout=2.0)

    def _look(self) -> None:
        begin_s: float | None = None
        try:
            for frame in self._frames:
                captured_s = frame.capture_s
                if not frame.live:
                    begin_s = self._clock() - frame.capture_s if begin_s is None else begin_s
                    captured_s += begin_s
                    self._stop.wait(max(0.0, captured_s - self._clock()))
                if self._stop.is_set():
                    return
                with self._lock:
                    self._last_picture_s = self._clock() if frame.live else None
                seen = self._tracker.observe(frame.image, captured_s)
                self.newest = Sighting(frame.image, captured_s, seen.corners_px)
                with self._lock:
                    self.reasons[seen.reason] += 1
                    if seen.pose is not None:
                        pose = (seen.pose.x_m, seen.pose.y_m, seen.pose.heading_rad)
                        self._poses.append((captured_s, pose))
                    self._bell.ring()
                if self._video is not None:
                    self._video.write(frame.image, captured_s)
        except Exception as error:  # advance raises it, so that the robot is disarmed
            with self._lock:
                self._error = error
                self._bell.ring()
        finally:
            with self._lock:
                self._last_picture_s = None  # an end of the pictures is no stall
            close = getattr(self._frames, "close", None)
            if close is not None:
                close()
