"""Position fixes from the camera over the pool: pictures in, poses out, in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError
from frogkick.core.interrupts import Bell
from frogkick.core.poses import Fix
from frogkick.vision.calibration import Calibration
from frogkick.vision.sources import Frame
from frogkick.vision.tracker import Tracker
from frogkick.vision.video import Video

POLL_S = 0.002
KEEP_S = 2.0
AWAKE_S = 0.1
STALL_S = 1.0
"""Without a picture of a live camera: its driver hangs, and does not say so."""


@dataclass(frozen=True)
class Sighting:
    """A picture, and the tag in it.

    Attributes:
        image: (height, width) grey or (height, width, 3) BGR; nobody writes to it.
        captured_s: when it was taken, on the fixes' clock.
        corners_px: (4, 2) of the tag, trusted or not; None where there is none.
    """

    image: NDArray[np.uint8]
    captured_s: float
    corners_px: NDArray[np.float64] | None


class CameraFixes:
    """A ``FixSource`` that finds the robot's tag in each picture; poses are in the pool's frame.

    Pictures of a camera count from when its driver handed them over. Those of a video or a folder come as
    fast as they were taken, as if a camera saw them now; their end is a camera that sees nothing more.

    Attributes:
        calibration: of the camera.
        reasons: how many pictures told a pose (``found``), or why not.
        newest: the last picture that was looked at; None before the first.
    """

    def __init__(
        self,
        frames: Iterator[Frame],
        calibration: Calibration,
        name: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin to look.

        Args:
            frames: pictures, as they come.
            calibration: of the camera that took them.
            name: of the camera, for people.
            clock: in s, the one that live pictures' capture times are of.
        """
        self.calibration = calibration
        self.reasons: Counter[str] = Counter()
        self.newest: Sighting | None = None
        self._frames, self._tracker, self._name, self._clock = frames, Tracker(calibration), name, clock
        self._lock = threading.Lock()
        self._bell = Bell()
        self._stop = threading.Event()
        self._poses: list[tuple[float, tuple[float, float, float]]] = []
        self._error: Exception | None = None
        self._video: Video | None = None
        self._sequence = 0
        self._looked_s = 0.0
        self._heard_s: float | None = None  # when a live camera gave its last picture
        self._quiet_since_s: float | None = None
        self._quiet_s = 0.0
        self._asked_s = clock()
        self._thread = threading.Thread(target=self._look, name=name, daemon=True)
        self._thread.start()

    @property
    def ended(self) -> bool:
        """Whether its pictures have come to their end, as those of a video do."""
        return not self._thread.is_alive()

    @property
    def next_event_s(self) -> float:
        """A moment later: nobody knows when the next picture comes."""
        return self._looked_s + POLL_S

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
                told = ", ".join(f"{count} x {reason}" for reason, count in self.reasons.most_common())
                raise InputError(
                    f"{self._name} saw no tag within {timeout_s:g} s ({told or 'not one picture came'}): put "
                    "the robot under it, and look at 'frogkick camera check'"
                )

    def advance(self, until_s: float) -> list[Fix]:
        """Fixes that came since the last call; those older than 2 s are left out.

        Raises:
            InputError: the camera failed: unplugged, frozen, hanging, of another size than its calibration.
        """
        self._looked_s = until_s
        with self._lock:
            if self._error is not None:
                raise self._error
            taken, self._poses = self._poses, []
            heard_s, now_s = self._heard_s, self._clock()
        self._require_alive(heard_s, now_s)
        fixes = []
        for captured_s, pose in taken:
            age_s = now_s - captured_s
            if age_s <= KEEP_S:
                capture_s = until_s - age_s
                fixes.append(Fix(capture_s, until_s - capture_s, *pose, sequence=self._sequence))
                self._sequence = (self._sequence + 1) & 0xFFFF
        return fixes

    def _require_alive(self, heard_s: float | None, now_s: float) -> None:
        """Refuse a live camera that has given nothing for ``STALL_S``, this program being awake."""
        # A computer that slept or was busy elsewhere kept the camera's thread from its pictures as well.
        awake_s, self._asked_s = min(now_s - self._asked_s, AWAKE_S), now_s
        if heard_s is None or heard_s != self._quiet_since_s:
            self._quiet_since_s, self._quiet_s = heard_s, 0.0
            return
        self._quiet_s += awake_s
        if self._quiet_s > STALL_S:
            raise InputError(
                f"{self._name} has given no picture for {now_s - heard_s:.1f} s: plug it in again, or choose "
                "a lower rate or another port"
            )

    def film(self, video: Video) -> None:
        """Keep each picture from now on; its fix has gone before it is written."""
        self._video = video

    def actuate(self, limb: int, start_s: float) -> None:
        """A real limb needs no telling."""

    def close(self) -> None:
        """Let the camera go."""
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
                    self._heard_s = self._clock() if frame.live else None
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
        except Exception as error:  # whatever it is, the run has to hear of it and disarm the robot
            with self._lock:
                self._error = error
                self._bell.ring()
        finally:
            with self._lock:
                self._heard_s = None  # the end of the pictures is told otherwise
            close = getattr(self._frames, "close", None)
            if close is not None:
                close()
