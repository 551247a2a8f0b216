"""Errors of a calibration over the pool: at marked points, at known places, and in rendered pictures."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from frogkick.core.arrays import UInt8
from frogkick.core.errors import InputError
from frogkick.core.files import csv_numbers, existing_file
from frogkick.core.poses import wrap_angle
from frogkick.vision.board import read_picture
from frogkick.vision.calibration import Calibration, camera_of
from frogkick.vision.pose import tag_place
from frogkick.vision.scene import Conditions, Scene, Viewpoint
from frogkick.vision.tracker import Tracker


@dataclass(frozen=True)
class Place:
    """A checked place."""

    # x_m, y_m: true place, pool frame
    x_m: float
    y_m: float
    # errors, seen minus true; NaN if nothing was seen, or the true heading is unknown
    error_x_mm: float = math.nan
    error_y_mm: float = math.nan
    heading_error_deg: float = math.nan
    reason: str = "found"  # or why there is no pose

    @property
    def error_mm(self) -> float:
        """Distance of the seen from the true place."""
        return float(np.hypot(self.error_x_mm, self.error_y_mm))


def check_points(calibration: Calibration, path: Path | str) -> list[Place]:
    """Compare marked points of the reference plane with the calibration's map of their pixels.

    ``path`` is a CSV with the columns x_px, y_px, x_m, y_m: pixels of the picture, pool frame.
    """
    rows = np.array(csv_numbers(path, "CSV", ("x_px", "y_px", "x_m", "y_m")))
    seen = calibration.pool(calibration.undistort(rows[:, :2]), calibration.plane_apparent_m)
    off = 1e3 * (seen - rows[:, 2:])
    return [
        Place(float(x), float(y), float(dx), float(dy))
        for (x, y), (dx, dy) in zip(rows[:, 2:], off, strict=True)
    ]


def check_frames(
    calibration: Calibration, frames: Iterable[tuple[UInt8, float, float, float]]
) -> list[Place]:
    """Find the tag in frames with a known pose; each search covers the complete frame.

    ``frames`` are picture, x_m, y_m, heading_rad (NaN: unknown) of the robot.
    """
    tracker = Tracker(calibration)
    places = []
    for image, x, y, heading in frames:
        tracker.forget()
        seen = tracker.observe(image)
        if seen.pose is None:
            places.append(Place(x, y, reason=seen.reason))
            continue
        turned = np.degrees(wrap_angle(seen.pose.heading_rad - heading)) if np.isfinite(heading) else math.nan
        off = 1e3 * (np.array([seen.pose.x_m, seen.pose.y_m]) - (x, y))
        places.append(Place(x, y, float(off[0]), float(off[1]), float(turned)))
    return places


def known_places(path: Path | str) -> Iterable[tuple[UInt8, float, float, float]]:
    """Pictures of the tag at places of a CSV with the columns image, x_m, y_m and perhaps heading_deg.

    Raises:
        InputError: a column is missing, or a picture cannot be read.
    """
    rows = np.array(csv_numbers(path, "CSV", ("x_m", "y_m"), ("heading_deg",)))
    with Path(path).open(encoding="utf-8-sig", newline="") as handle:
        names = [row.get("image") or "" for row in csv.DictReader(handle)]
    for name, (x, y, heading) in zip(names, rows, strict=True):
        if not name:
            raise InputError(f"{str(path)!r} has a row without a picture: the column 'image' names files")
        picture = existing_file(Path(path).parent / name, "picture")
        yield read_picture(picture), float(x), float(y), float(np.deg2rad(heading))


def scene_of(calibration: Calibration, conditions: Conditions) -> Scene:
    """A rendered pool as the calibrated camera sees it.

    Raises:
        InputError: the calibration lacks the camera's position.
    """
    if calibration.camera_m is None:
        raise InputError(
            "the calibration does not contain the camera's position, so no picture can be rendered: "
            "calibrate with --camera-height-m or a board, or check with --points or --places"
        )
    plane = calibration.plane_apparent_m
    lens, tag, height = calibration.lens, calibration.tag, float(calibration.camera_m[2])
    camera = camera_of(calibration.homography, calibration.image_px, plane, lens, height)
    assert camera is not None
    distortion = np.zeros(5) if lens is None else lens.distortion
    return Scene(
        Viewpoint(calibration.image_px, *camera, distortion),
        calibration.pool_m, tag.family, tag.id, tag.size_m, tag.apparent_height_m, conditions,
    )  # fmt: skip


def rendered(
    calibration: Calibration, conditions: Conditions, columns: int, rows: int, rng: np.random.Generator
) -> Iterable[tuple[UInt8, float, float, float]]:
    """Pictures of the tag on a grid over the pool, a tag's width from its walls, at random headings."""
    scene = scene_of(calibration, conditions)
    edge = calibration.tag.size_m
    length, width = calibration.pool_m
    for y in np.linspace(edge, width - edge, rows):
        for x in np.linspace(edge, length - edge, columns):
            heading = float(rng.uniform(-np.pi, np.pi))
            at = tag_place(calibration, float(x), float(y), heading)
            picture = scene.picture((float(at[0]), float(at[1]), float(at[2])), rng)
            yield picture, float(x), float(y), heading
