"""Pictures over HTTP, as a network camera gives them: one (JPEG), or one after the other (MJPEG)."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2

from frogkick.core.arrays import UInt8
from frogkick.core.local_server import QuietHandler, serving

STREAM, PICTURE = "/camera.mjpg", "/picture.jpg"
QUALITY = 95
"""Of the JPEG: at less, its blocks shift the edges of a small tag."""
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
                self.answer("image/jpeg", _jpeg(picture()))
            elif self.path == STREAM:
                self.answer(f"multipart/x-mixed-replace; boundary={_BOUNDARY}", None)
                self._stream()
            else:
                self.send_error(404, f"ask for {STREAM} or {PICTURE}")

        def _stream(self) -> None:
            due_s = time.monotonic()
            while not closing.wait(max(0.0, due_s - time.monotonic())):
                content = _jpeg(picture())
                head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(content)}\r\n\r\n"
                self.wfile.write(head.encode() + content + b"\r\n")
                due_s = max(due_s + 1.0 / rate_hz, time.monotonic())  # what is late is left out

    with serving(Handler, port) as base:
        try:
            yield base + STREAM, base + PICTURE
        finally:
            closing.set()


def _jpeg(image: UInt8) -> bytes:
    _, made = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return made.tobytes()
