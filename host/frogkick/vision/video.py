"""Pictures that leave this program: a run's video beside its log, and pictures over HTTP.

The video's format is motion JPEG in AVI, so that pictures written before a kill can be read. It has a
nominal rate; a table beside it has the capture times on the log's clock. Over HTTP a picture comes as a
network camera gives it: alone (JPEG), or one after the other (MJPEG).
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import cv2

from frogkick.core.arrays import UInt8
from frogkick.core.errors import InputError
from frogkick.core.local_server import QuietHandler, serving

NOMINAL_HZ = 30.0
LOOK_EVERY = 100
"""Number of pictures after which the file must have grown, as OpenCV does not report a full disk."""


def video_of(log: pathlib.Path) -> pathlib.Path:
    """The video file of a log."""
    return log.with_suffix(".avi")


def times_of(log: pathlib.Path) -> pathlib.Path:
    """The file of its pictures' capture times: CSV with frame, capture_time_s."""
    return log.with_suffix(".frames.csv")


class Video:
    """A run's video, written by one thread."""

    def __init__(self, log: pathlib.Path, zero_s: float) -> None:
        """Prepare; the first picture creates the files. ``zero_s`` is the log's 0 on the camera's clock."""
        self.frames = 0  # pictures written
        self._log, self._zero_s = log, zero_s
        self._writer: Any = None
        self._times: Any = None
        self._grown_bytes = 0

    def write(self, image: UInt8, capture_s: float) -> None:
        """Add a (height, width) grey or (height, width, 3) BGR picture; all are of one size."""
        try:
            if self._writer is None:
                self._open(image.shape[1], image.shape[0])
            self._writer.write(image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
            self._times.write(f"{self.frames},{capture_s - self._zero_s:.6f}\n")
            self._times.flush()
        except OSError as error:
            raise self._full() from error
        self.frames += 1
        if self.frames % LOOK_EVERY == 0:
            length = os.stat(video_of(self._log)).st_size
            if length <= self._grown_bytes:
                raise self._full()
            self._grown_bytes = length

    def close(self) -> None:
        """Close the files."""
        if self._writer is not None:
            self._writer.release()
            with contextlib.suppress(OSError):
                self._times.close()

    def _open(self, width: int, height: int) -> None:
        target = video_of(self._log)
        self._times = times_of(self._log).open("w", encoding="utf-8", newline="")
        self._times.write("frame,capture_time_s\n")
        kind = cv2.VideoWriter_fourcc(*"MJPG")  # type: ignore[attr-defined]
        self._writer = cv2.VideoWriter(str(target), kind, NOMINAL_HZ, (width, height))
        if not self._writer.isOpened():
            raise InputError(f"the video {str(target)!r} cannot be written: choose another --out")

    def _full(self) -> InputError:
        return InputError(f"the video {str(video_of(self._log))!r} cannot be continued: is the disk full?")


STREAM, PICTURE = "/camera.mjpg", "/picture.jpg"
QUALITY = 95
"""Of the JPEG, 0 to 100: at less, its blocks shift the edges of a small tag."""
_BOUNDARY = "picture"


@contextmanager
def streamed(picture: Callable[[], UInt8], rate_hz: float, port: int = 0) -> Iterator[tuple[str, str]]:
    """Serve pictures on this computer alone, as long as the context lives.

    Args:
        picture: makes the newest one; called from other threads, and only while somebody looks.
        rate_hz: pictures a second.
        port: TCP port; 0: a free one.

    Returns:
        The addresses of the stream and of a single picture.
    """
    closing = threading.Event()

    class Handler(QuietHandler):
        def do_GET(self) -> None:
            if self.path == PICTURE:
                self.answer("image/jpeg", jpeg(picture()))
            elif self.path == STREAM:
                self.answer(f"multipart/x-mixed-replace; boundary={_BOUNDARY}", None)
                self._stream()
            else:
                self.send_error(404, f"ask for {STREAM} or {PICTURE}")

        def _stream(self) -> None:
            due_s = time.monotonic()
            while not closing.wait(max(0.0, due_s - time.monotonic())):
                content = jpeg(picture())
                head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(content)}\r\n\r\n"
                self.wfile.write(head.encode() + content + b"\r\n")
                due_s = max(due_s + 1.0 / rate_hz, time.monotonic())  # what is late is left out

    with serving(Handler, port) as base:
        try:
            yield base + STREAM, base + PICTURE
        finally:
            closing.set()


def jpeg(image: UInt8, quality: int = QUALITY) -> bytes:
    """A picture, grey or BGR, as JPEG."""
    _, made = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return made.tobytes()
