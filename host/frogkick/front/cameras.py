"""The camera over the pool: its calibration from corners or a board, and its errors."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.files import write_bytes
from frogkick.core.poses import Fix
from frogkick.front.viewing import camera_viewed
from frogkick.runs.tracked_fixes import CameraFixes
from frogkick.vision.board import (
    Board,
    calibrate_corners,
    calibrate_lens,
    calibrate_plane,
    picture_files,
    read_corners,
    read_picture,
)
from frogkick.vision.calibration import (
    Calibration,
    Tag,
    read_calibration,
    refraction_offset_m,
    write_calibration,
)
from frogkick.vision.check import Place, check_frames, check_points, known_places, rendered
from frogkick.vision.scene import Conditions
from frogkick.vision.sources import Frame, open_source
from frogkick.vision.tags import tag_cells, tag_margin

__all__ = [
    "Board",
    "Conditions",
    "Tag",
    "calibrate_camera",
    "check_camera",
    "take_picture",
    "track_camera",
    "write_tag",
]

EXPOSURE_S = 1.0
"""Time in which a camera that was just opened finds its exposure."""
REMARKS = 5
"""How many of the places beyond the limits are named."""


@dataclass(frozen=True)
class Calibrated:
    """A calibrated camera, and the error of the board's corners in its lens model; NaN without a board."""

    calibration: Calibration
    lens_rms_px: float

    def save(self, file: Path | str) -> None:
        """Write the calibration (.toml) for ``Camera`` and ``run``."""
        write_calibration(Path(file), self.calibration)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``camera calibrate``."""
        made = self.calibration
        corner = np.array([[0, 0], [made.pool_m[0], 0], [*made.pool_m], [0, made.pool_m[1]]], dtype=float)
        middle = corner.mean(axis=0, keepdims=True)
        step = made.pixels(middle + np.array([[0, 0], [1e-3, 0], [0, 1e-3]]))
        shift = None
        if made.camera_m is not None:
            above = made.camera_m[2] - made.tag.apparent_height_m
            shift = float(np.hypot(*(corner - made.camera_m[:2]).T).max() / above)
        return {
            "method": made.method,
            "points": made.points,
            "rms_px": made.rms_px,
            "lens_rms_px": self.lens_rms_px,
            "camera_m": made.camera_m,
            "tag_height_m": made.tag.height_m,
            "refraction_offset_m": made.tag.refraction_offset_m,
            "heave_shift_mm_per_mm": shift,
            "px_per_mm": float(np.sqrt(abs(np.linalg.det(step[1:] - step[0])))),
        }


def calibrate_camera(
    pool_m: tuple[float, float],
    tag: Tag,
    *,
    corners: Path | str | None = None,
    plane_picture: Path | str | None = None,
    image_px: tuple[int, int] | None = None,
    height_m: float = 0.0,
    camera_height_m: float | None = None,
    board: Board | None = None,
    pictures: Path | str | None = None,
    board_at_m: tuple[float, float] = (0.0, 0.0),
) -> Calibrated:
    """Calibrate from the pool's four corners or a board on the water's plane; the lens from a board.

    The arguments are the options of the command ``camera calibrate``, in m and px; ``height_m`` is that of
    corners or board above the water. The refraction of the water is corrected in ``tag``.
    """
    if (corners is None) == (plane_picture is None):
        raise InputError(
            "--corners and --plane-picture: give exactly one, the pool's corners or a picture of the board"
        )
    if not 0.05 <= min(pool_m) <= max(pool_m) <= 100.0:
        raise InputError(
            f"--pool is {pool_m[0]:g} x {pool_m[1]:g} m, but each side must be 0.05 to 100 m: give length x "
            "width in m, such as 1.2x0.9"
        )
    if 0.0 < abs(tag.height_m) < 1e-4:
        raise InputError(f"--tag-height-mm is {1e3 * tag.height_m:g} mm: give mm above the water, such as 12")
    tag = replace(tag, refraction_offset_m=refraction_offset_m(tag.height_m))
    lens, lens_rms_px = None, float("nan")
    if pictures is not None:
        board = _required(board, "--pictures")
        found = [(file.name, read_picture(file)) for file in picture_files(pictures)]
        lens, lens_rms_px = calibrate_lens(board, found)
        seen = (found[0][1].shape[1], found[0][1].shape[0])
        if image_px is not None and image_px != seen:
            raise InputError(
                f"--image is {image_px[0]}x{image_px[1]}, but the pictures have {seen[0]}x{seen[1]} px: "
                "give their size"
            )
        image_px = seen
    if plane_picture is not None:
        board, laid = _required(board, "--plane-picture"), read_picture(plane_picture)
        made = calibrate_plane(board, laid, board_at_m, pool_m, tag, height_m, camera_height_m, lens)
        return Calibrated(made, lens_rms_px)
    assert corners is not None
    if image_px is None:
        raise InputError("the corners are pixels of a picture: give its size, such as --image 640x480")
    made = calibrate_corners(read_corners(corners), pool_m, image_px, tag, height_m, camera_height_m, lens)
    return Calibrated(made, lens_rms_px)


def _required(board: Board | None, option: str) -> Board:
    if board is None:
        raise InputError(f"{option} shows a board: give its kind with --board chessboard or --board charuco")
    return board


@dataclass(frozen=True)
class CameraCheck:
    """Errors of a camera over the pool at known places: marked points, pictures, or rendered ones."""

    calibration: Calibration
    source: str
    found: Sequence[Place]
    limit_mm: float
    limit_deg: float

    def summary(self) -> dict[str, Any]:
        """Root mean square and largest errors (NaN if nothing was seen), and whether they are allowed."""
        errors = np.array([place.error_mm for place in self.found if place.reason == "found"])
        turns = self._turns_deg
        max_mm = float(errors.max()) if len(errors) else math.nan
        turned_deg = float(np.abs(turns).max()) if len(turns) else math.nan
        all_seen = len(errors) == len(self.found)
        return {
            "source": self.source,
            "places": len(self.found),
            "found": len(errors),
            "rms_mm": float(np.sqrt(np.mean(errors**2))) if len(errors) else math.nan,
            "max_mm": max_mm,
            "heading_rms_deg": float(np.sqrt(np.mean(turns**2))) if len(turns) else math.nan,
            "heading_max_deg": turned_deg,
            "limit_mm": self.limit_mm,
            "limit_deg": self.limit_deg,
            "within": all_seen and max_mm <= self.limit_mm and not turned_deg > self.limit_deg,
        }

    @property
    def _turns_deg(self) -> Float64:
        """Errors of the headings that are known."""
        return np.array([p.heading_error_deg for p in self.found if np.isfinite(p.heading_error_deg)])

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``camera check``."""
        return {**self.summary(), "map": [{**asdict(one), "error_mm": one.error_mm} for one in self.found]}

    @property
    def remarks(self) -> list[str]:
        """Return a line for each fault: a rotation of all headings, the first places beyond the limits."""
        said = []
        turns = self._turns_deg
        if len(turns) > 1:
            mean = float(np.degrees(np.angle(np.exp(1j * np.radians(turns)).mean())))
            mean = -mean if round(mean) == -180 else mean
            apart = np.abs((turns - mean + 180.0) % 360.0 - 180.0).max()
            if abs(mean) > max(10.0 * apart, self.limit_deg):
                said.append(
                    f"all headings are off by {mean:.0f} degrees: if the tag is mounted that way, give its "
                    "direction as --tag-heading-deg of 'camera calibrate'; 'camera tag' prints a tag with "
                    "an arrow"
                )
        off = [
            f"({p.x_m:g}, {p.y_m:g}) m: "
            + (
                f"{p.error_mm:.2f} mm, {p.heading_error_deg:.2f} degrees off"
                if p.reason == "found"
                else p.reason
            )
            for p in self.found
            if not p.error_mm <= self.limit_mm or abs(p.heading_error_deg) > self.limit_deg
        ]
        more = f"; {len(off) - REMARKS} more" if len(off) > REMARKS else ""
        return said + ([f"{'; '.join(off[:REMARKS])}{more}"] if off else [])

    def draw(self, file: Path | str) -> None:
        """Write a map of the errors (.png)."""
        from frogkick.report.camera_figure import write_error_map

        facts = self.summary()
        errors = np.array([[p.x_m, p.y_m, p.error_x_mm, p.error_y_mm] for p in self.found])
        title = f"{self.source}: rms {facts['rms_mm']:.3f} mm, max {facts['max_mm']:.3f} mm"
        write_error_map(self.calibration.pool_m, errors, title, Path(file))


def check_camera(
    calibration: Path | str,
    *,
    points: Path | str | None = None,
    places: Path | str | None = None,
    tags: tuple[int, int] = (9, 7),
    conditions: Conditions | None = None,
    seed: int = 0,
    limit_mm: float = 1.0,
    limit_deg: float = 0.5,
) -> CameraCheck:
    """Map a camera's errors over the pool.

    The arguments are the options of the command ``camera check``; ``tags`` is its grid.
    """
    known = read_calibration(Path(calibration))
    if points is not None and places is not None:
        raise InputError("--points and --places are two different checks: give only one of the two")
    if points is not None:
        found, source = check_points(known, points), "points"
    elif places is not None:
        found, source = check_frames(known, known_places(places)), "places"
    else:
        if not 1 <= min(tags) <= max(tags) <= 50:
            raise InputError(f"--grid {tags[0]}x{tags[1]}: give 1x1 to 50x50")
        pictures = rendered(known, conditions or Conditions(), *tags, np.random.default_rng(seed))
        found, source = check_frames(known, pictures), "rendered"
    return CameraCheck(known, source, found, limit_mm, limit_deg)


def track_camera(
    calibration: Path | str,
    source: str = "0",
    *,
    seconds: float | None = None,
    view: bool = False,
    each: Callable[[Fix], None] = lambda _fix: None,
) -> dict[str, Any]:
    """Find the tag in a camera's pictures, without a robot, until they end, the time is up, or Ctrl-C.

    The arguments are the options of the command ``camera track``; ``each`` is called with each fix. Returned
    are the command's keys; ``reasons`` has the number of pictures with a fix ("found"), and by each reason
    without one; ``behind_s`` is how much longer a video or a folder took to play than to take.
    """
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise InputError(f"the duration is {seconds} s: give more than 0")
    known = read_calibration(Path(calibration))
    name = f"camera {source}" if source.isdigit() else source
    camera = CameraFixes(open_source(source, known.image_px), known, name)
    count, times_s = 0, [0.0, 0.0]
    end_s = math.inf
    with closing(camera), camera_viewed(view, camera) as show, suppress(KeyboardInterrupt):
        is_over = False
        while not is_over:
            if seconds is not None and end_s == math.inf and camera.newest is not None:
                end_s = time.monotonic() + seconds
            # The last fixes before the end count as well.
            is_over = camera.ended or time.monotonic() >= end_s
            new = camera.advance(time.monotonic())
            for fix in new:
                each(fix)
                times_s = [times_s[0] if count else fix.capture_s, fix.capture_s]
                count += 1
            show(new)
            if not is_over:
                time.sleep(0.005)
    lasted_s = times_s[1] - times_s[0]
    return {
        "fixes": count,
        "pictures": sum(camera.reasons.values()),
        "rate_hz": (count - 1) / lasted_s if lasted_s > 0.0 else 0.0,
        "reasons": {reason: number for reason, number in camera.reasons.items() if number},
        "behind_s": round(camera.behind_s, 3),
    }


def take_picture(file: Path | str, source: str = "0") -> tuple[int, int]:
    """Write a camera's picture, or the first one of a video or a folder; return its width and height, px."""
    target = Path(file)
    if target.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"picture {str(file)!r} ends in {target.suffix!r}: give a name in .png or .jpg")
    first = image = None
    with closing(cast(Generator[Frame], open_source(source))) as frames:
        for frame in frames:
            first, image = first or frame, frame.image
            if not frame.live or frame.capture_s - first.capture_s >= EXPOSURE_S:
                break
    if image is None:
        raise InputError(f"source {source!r} has no picture: give another --source")
    _, made = cv2.imencode(target.suffix, image)
    write_bytes(target, made.tobytes())
    return image.shape[1], image.shape[0]


def write_tag(
    file: Path | str, *, family: str = "tag36h11", tag_id: int = 0, size_m: float = 0.047
) -> tuple[float, float]:
    """Write a page with a tag at true scale, a forward arrow and a ruler; return its width and height, m."""
    from frogkick.report.camera_figure import write_tag_page

    cells = tag_cells(family, tag_id)
    return write_tag_page(cells, tag_margin(family), size_m, f"{family} {tag_id}", Path(file))
