"""Where pictures come from: a camera, a network camera, a video file, a folder, rendered scenes."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from frogkick.core.arrays import UInt8
from frogkick.core.errors import InputError
from frogkick.core.interrupts import Bell
from frogkick.vision.board import picture_files, read_picture

FROZEN_FRAMES = 8
"""As many pictures that all equal the one before them come from no live camera, whose noise differs."""
SCHEMES = ("http://", "https://", "rtsp://")
"""How the address of a network camera begins."""
STREAM_OPEN_MS, STREAM_READ_MS = 5000, 1500
"""The longest that a network camera is waited for: to answer, and for a picture."""


@dataclass(frozen=True)
class Frame:
    """One picture."""

    image: UInt8  # (height, width) grey or (height, width, 3) BGR
    # when it was taken: ``time.monotonic`` as the driver handed it over, for a camera (exposure and transfer
    # came before); time in the file, for the others
    capture_s: float
    sequence: int  # counts from 0
    live: bool  # whether ``capture_s`` is on this machine's clock


def device_frames(index: int, image_px: tuple[int, int] | None = None) -> Iterator[Frame]:
    """Frames of a camera by its number, until the caller stops; it is asked for the size ``image_px``."""
    camera = _opened(index, f"camera {index}")
    try:
        # Only the newest picture counts: an older one waiting in the driver would be late.
        camera.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if image_px is not None:
            camera.set(cv2.CAP_PROP_FRAME_WIDTH, image_px[0])
            camera.set(cv2.CAP_PROP_FRAME_HEIGHT, image_px[1])
        yield from live_frames(camera, f"camera {index}")
    finally:
        camera.release()


def live_frames(camera: cv2.VideoCapture, what: str) -> Iterator[Frame]:
    """Frames of an open camera; ``what`` names it in errors (see ``device_frames``).

    Raises:
        InputError: the camera gives no picture, or one that cannot be decoded.
    """

    def pictures() -> Iterator[tuple[UInt8 | None, float]]:
        while camera.grab():
            capture_s = time.monotonic()
            ok, image = camera.retrieve()
            if not ok:
                raise InputError(
                    f"{what} gave a picture that cannot be decoded: choose another format or size"
                )
            yield np.asarray(image, dtype=np.uint8), capture_s
        yield None, time.monotonic()

    return _live(pictures(), what, "is it unplugged or used by another?")


def stream_frames(url: str) -> Iterator[Frame]:
    """Frames of a network camera, until the caller stops. Their capture time is that of their arrival here.

    A thread reads each as it comes, because one that waits in a buffer would get too late a time. Of those
    that came meanwhile, the caller gets the newest.
    """
    what = f"camera {url}"
    camera = _opened(url, what)
    newest: deque[tuple[UInt8 | None, float]] = deque(maxlen=1)
    bell, stop = Bell(), threading.Event()

    def read() -> None:
        ok = True
        while ok and not stop.is_set():
            ok, image = camera.read()
            newest.append((np.asarray(image, dtype=np.uint8) if ok else None, time.monotonic()))
            bell.ring()
        camera.release()

    def pictures() -> Iterator[tuple[UInt8 | None, float]]:
        while True:
            bell.wait_for(lambda: newest)
            yield newest.pop()

    thread = threading.Thread(target=read, name=what, daemon=True)
    thread.start()
    try:
        yield from _live(pictures(), what, "is it still there, and switched on?")
    finally:
        stop.set()
        thread.join()  # an interpreter that ends would break it off inside the decoder


def _live(pictures: Iterable[tuple[UInt8 | None, float]], what: str, hint: str) -> Iterator[Frame]:
    """Frames of pictures and their times; None if there are no more. Refuses a camera that freezes."""
    same, last = 0, None
    for sequence, (picture, capture_s) in enumerate(pictures):
        if picture is None:
            raise InputError(f"{what} gave no picture after {sequence} pictures: {hint}")
        same = same + 1 if last is not None and np.array_equal(picture, last) else 0
        if same >= FROZEN_FRAMES:
            raise InputError(f"{what} is frozen: {same + 1} equal pictures in a row; plug it in again")
        last = picture
        yield Frame(picture, capture_s, sequence, True)


def video_frames(path: Path | str) -> Iterator[Frame]:
    """Frames of a video file.

    Raises:
        InputError: it is no video that can be read, or has no pictures.
    """
    if not Path(path).is_file():
        raise InputError(f"video {str(path)!r} does not exist: check the path")
    video = _opened(str(path), f"video {str(path)!r}")
    try:
        sequence = 0
        while True:
            ok, image = video.read()
            if not ok:
                break
            capture = video.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            yield Frame(np.asarray(image, dtype=np.uint8), capture, sequence, False)
            sequence += 1
        if not sequence:
            raise InputError(f"{str(path)!r} is no video that can be read, or has no pictures")
    finally:
        video.release()


def folder_frames(folder: Path | str, rate_hz: float = 30.0) -> Iterator[Frame]:
    """A folder's pictures by name, as if taken at a constant rate (see ``board.picture_files``)."""
    for sequence, file in enumerate(picture_files(folder)):
        yield Frame(read_picture(file), sequence / rate_hz, sequence, False)


def open_source(text: str, image_px: tuple[int, int] | None = None, rate_hz: float = 30.0) -> Iterator[Frame]:
    """A camera (``0``, ``device:0``), a network camera, a video file or a folder, whichever ``text`` names.

    Raises:
        InputError: it is none of these, or cannot be opened; some only as the first frame is asked for.
    """
    number = text.removeprefix("device:")
    if number.isascii() and number.isdigit():
        return device_frames(int(number), image_px)
    if text.startswith("device:"):
        raise InputError(f"source {text!r}: a camera is a number, as device:0")
    if text.startswith(SCHEMES):
        return stream_frames(text)
    if Path(text).is_dir():
        return folder_frames(text, rate_hz)
    if Path(text).is_file():
        return video_frames(text)
    raise InputError(
        f"source {text!r} is no camera number, video file or folder of pictures, nor an address (http:, "
        "rtsp:): check it"
    )


def _opened(where: int | str, what: str) -> cv2.VideoCapture:
    """Open a camera or a file without OpenCV's own complaints on stderr."""
    log: Any = cv2.utils.logging
    level = log.getLogLevel()
    log.setLogLevel(0)
    try:
        if isinstance(where, str) and where.startswith(SCHEMES):
            os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # FFmpeg has lines of its own
            options = [cv2.CAP_PROP_N_THREADS, 1, cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, STREAM_OPEN_MS]
            options += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, STREAM_READ_MS]
            capture = cv2.VideoCapture(where, cv2.CAP_FFMPEG, options)
            hint = "is its address right, and does it give MJPEG or H.264?"
        else:
            capture = cv2.VideoCapture(where)
            hint = "is it a video that this OpenCV can decode?"
            if isinstance(where, int):
                hint = "is it plugged in, and may this user read it?"
    finally:
        log.setLogLevel(level)
    if not capture.isOpened():
        capture.release()
        raise InputError(f"{what} cannot be opened: {hint}")
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # in the sensor's pixels, as board.read_picture has them
    return capture
