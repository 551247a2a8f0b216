"""Position fixes of a real robot, found in a thread of its own: by a camera, or any tracker's lines."""

from __future__ import annotations

import json
import math
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from frogkick.core.arrays import Float64, UInt8
from frogkick.core.errors import InputError
from frogkick.core.interrupts import Bell
from frogkick.core.poses import Fix
from frogkick.core.progress import tell_line
from frogkick.vision.calibration import Calibration
from frogkick.vision.sources import Frame
from frogkick.vision.tracker import Tracker
from frogkick.vision.video import Video, jpeg

POLL_S = 0.002
KEEP_S = 2.0
"""Age beyond which a fix is dropped, because the robot would refuse it."""
BEHIND_S = 0.5
"""A video or a folder whose pictures are later than this is played that much later from there on."""
AGE_MAX_S, FIELD_M = 10.0, 1000.0
"""Limits of a line's age, and of its x and y."""
_LINE_MAX = 200  # bytes without a line's end after which they are taken for a line
AWAKE_S = 0.1
"""Longest time between two looks at a camera that counts as its silence: this program may have slept."""
STALL_S = 1.0
"""A live camera that gives no picture for longer is considered to hang."""
EVERY_S = 0.1
"""Shortest time between two encoded pictures, however many pages ask."""
WIDTH_MOST_PX = 960
"""Wider pictures are scaled down to this width."""
QUALITY = 80


class FixBuffer:
    """A ``FixSource`` without its reader: a subclass fills the protected attributes under ``_lock``."""

    def __init__(self, name: str, clock: Callable[[], float]) -> None:
        """Start empty. ``name`` is for people, ``clock`` in s."""
        self._name, self._clock = name, clock
        self._lock = threading.Lock()
        self._bell = Bell()
        self._poses: list[tuple[float, tuple[float, float, float]]] = []  # capture time and pose
        self._error: Exception | None = None
        self._seen = 0
        self._ended = False  # the source has ended, such as a file
        self._sequence = 0
        self._polled_s = 0.0

    def wait_first(self, timeout_s: float) -> None:
        """Wait for the first pose. InputError: none came in time, or the reader failed."""
        self._bell.wait_for(lambda: self._seen > 0 or self._error is not None or self._ended, timeout_s)
        with self._lock:
            if self._error is not None:
                raise self._error
            if not self._seen:
                raise InputError(self._none_came(timeout_s))

    def _none_came(self, timeout_s: float) -> str:
        raise NotImplementedError

    @property
    def next_event_s(self) -> float:
        """Time of the next poll: when the next pose arrives is not known."""
        return self._polled_s + POLL_S

    def advance(self, until_s: float) -> list[Fix]:
        """Return the fixes that arrived since the last call and are at most 2 s old.

        Raises:
            InputError: the reader failed.
        """
        self._polled_s = until_s
        with self._lock:
            if self._error is not None:
                raise self._error
            taken, self._poses = self._poses, []
        now_s = self._clock()
        fixes = []
        for captured_s, pose in taken:
            if now_s - captured_s > KEEP_S:
                self._note_too_old()
                continue
            capture_s = until_s - (now_s - captured_s)
            fixes.append(Fix(capture_s, until_s - capture_s, *pose, sequence=self._sequence))
            self._sequence = (self._sequence + 1) & 0xFFFF
        return fixes

    def _note_too_old(self) -> None:
        """A fix was dropped because of its age."""

    def actuate(self, limb: int, start_s: float) -> None:
        """No effect, because the tracker sees the real limbs."""


class LineFixes(FixBuffer):
    """A ``FixSource`` that reads lines ``x_m y_m heading_rad [age_s]`` in a thread.

    Poses are in the world frame; the age is from the picture to the line's arrival, 0 by default. Empty lines
    and lines that begin with # are skipped, and those with a NaN in the pose, which a tracker writes for an
    occluded robot. After the end of the file no more fixes arrive.
    """

    def __init__(self, file: int, name: str) -> None:
        """Start to read from a file descriptor."""
        super().__init__(name, time.monotonic)
        self._file = file
        threading.Thread(target=self._read, name=name, daemon=True).start()

    def _none_came(self, timeout_s: float) -> str:
        how = "and it has ended" if self._ended else f"within {timeout_s:g} s"
        return (
            f"no position fix came from {self._name} {how}: start the tracker, "
            "whose lines are 'x_m y_m heading_rad [age_s]'"
        )

    def _read(self) -> None:
        rest, number = b"", 0
        while data := self._more():
            now_s = self._clock()
            *lines, rest = (rest + data).split(b"\n")
            for line in [*lines, *([rest] if len(rest) > _LINE_MAX else [])]:
                number += 1
                text = line.decode("utf-8", "replace").lstrip("\ufeff").strip()
                if not text or text.startswith("#") or _is_lost(text):
                    continue
                with self._lock:
                    try:
                        age_s, pose = parse_line(text)
                    except InputError as error:
                        self._error = InputError(f"{self._name} line {number}: {error}")
                    else:
                        self._poses.append((now_s - age_s, pose))
                        self._seen += 1
                    self._bell.ring()
                    if self._error is not None:
                        return
        with self._lock:
            self._ended = True
            self._bell.ring()
        if self._seen:
            tell_line(f"{self._name} has ended after {self._seen} position fixes: no more will come from it")

    def _more(self) -> bytes:
        # Unbuffered: a waiting thread would hold a buffered stream's lock, and the program could not end.
        try:
            return os.read(self._file, 4096)
        except OSError:
            return b""


def _is_lost(text: str) -> bool:
    """Whether a line says that the tracker did not see the robot: its pose has a NaN."""
    return "nan" in text.lower().replace(",", " ").split()[:3]


def parse_line(text: str) -> tuple[float, tuple[float, float, float]]:
    """Age in s and pose (x_m, y_m, heading_rad) of a line.

    Raises:
        InputError: the line is not three or four numbers, or one is outside its limits.
    """
    words = text.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 4):
        raise InputError(f"{text[:60]!r} is not a position fix: give 'x_m y_m heading_rad [age_s]'")
    x_m, y_m, heading_rad = numbers[:3]
    age_s = numbers[3] if len(numbers) == 4 else 0.0
    limits = {"x_m": FIELD_M, "y_m": FIELD_M, "heading_rad": 1000.0}
    for (name, limit), value in zip(limits.items(), numbers[:3], strict=True):
        if not abs(value) <= limit:  # a NaN as well
            raise InputError(
                f"{name} is {value}, allowed is -{limit:g} to {limit:g}: check the tracker's units"
            )
    if not 0.0 <= age_s <= AGE_MAX_S:
        raise InputError(f"age is {age_s} s, allowed is 0 to {AGE_MAX_S:g}: give it in seconds")
    return age_s, (x_m, y_m, math.remainder(heading_rad, math.tau))


@dataclass(frozen=True)
class Sighting:
    """A picture and the tag in it."""

    image: UInt8  # (height, width) grey or (height, width, 3) BGR; read-only
    captured_s: float  # capture time on the fixes' clock
    corners_px: Float64 | None  # (4, 2) of the tag, trusted or not; None without a tag


class CameraFixes(FixBuffer):
    """A ``FixSource`` that finds the robot's tag in each picture; poses are in the world frame.

    A live picture is captured when the driver hands it over. Pictures of a video or a folder are played at
    the rate at which they were taken, or slower where this machine needs longer for them: none is dropped.

    Attributes:
        calibration: of the camera.
        reasons: number of pictures that gave a fix (``found``), and of the others, by reason; a fix that was
            older than KEEP_S when it was asked for counts as ``too late``.
        behind_s: how much longer a video or a folder took to play than to take.
        newest: the last picture; None before the first.
    """

    def __init__(
        self,
        frames: Iterator[Frame],
        calibration: Calibration,
        name: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start to find fixes in a camera's pictures; ``clock`` is that of their capture times, in s."""
        super().__init__(name, clock)
        self.calibration = calibration
        self.reasons: Counter[str] = Counter()
        self.behind_s = 0.0
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

    def _none_came(self, timeout_s: float) -> str:
        reasons = ", ".join(f"{count} x {reason}" for reason, count in self.reasons.most_common())
        return (
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
        # If the computer slept or was busy, the camera's thread could not take pictures either.
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

    def _note_too_old(self) -> None:
        with self._lock:
            self.reasons["found"] -= 1
            self.reasons["too late"] += 1

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
                    now_s = self._clock()
                    begin_s = now_s - frame.capture_s if begin_s is None else begin_s
                    late_s = now_s - begin_s - self.behind_s - frame.capture_s
                    self.behind_s += late_s if late_s > BEHIND_S else 0.0
                    captured_s += begin_s + self.behind_s
                    self._stop.wait(max(0.0, captured_s - now_s))
                if self._stop.is_set():
                    return
                with self._lock:
                    self._last_picture_s = self._clock() if frame.live else None
                seen = self._tracker.observe(frame.image)
                self.newest = Sighting(frame.image, captured_s, seen.corners_px)
                with self._lock:
                    self.reasons[seen.reason] += 1
                    if seen.pose is not None:
                        pose = (seen.pose.x_m, seen.pose.y_m, seen.pose.heading_rad)
                        self._poses.append((captured_s, pose))
                        self._seen += 1
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

    def pixels(self, points_world_m: Float64) -> Float64:
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


def _jpeg(image: UInt8) -> bytes:
    height, width = image.shape[:2]
    if width > WIDTH_MOST_PX:
        size = (WIDTH_MOST_PX, round(height * WIDTH_MOST_PX / width))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return jpeg(image, QUALITY)
