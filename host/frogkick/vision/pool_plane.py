"""Calibration of the pool's plane: from its four corners in a small file, or from a board laid on it."""

from __future__ import annotations

import csv
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from frogkick.core.arrays import Float64, UInt8
from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.vision.board import Board
from frogkick.vision.calibration import (
    Calibration,
    Lens,
    Tag,
    apply,
    camera_of,
    from_four,
    refraction_offset_m,
)

SIDES_MOST = 1.25
"""Largest ratio of the apparent scales of the pool's sides; corners marked by hand are within."""
ORDER = "(0, 0), (length, 0), (length, width), (0, width)"


def read_corners(path: Path | str) -> Float64:
    """Read four corners: TOML ``corners_px = [[x, y], ...]`` or CSV with columns ``x_px,y_px``.

    Returns:
        (4, 2) pixels, in the order of ``ORDER``.

    Raises:
        InputError: the file is neither of these, or does not have four corners.
    """
    file = existing_file(path, "corners file")
    try:
        if file.suffix.lower() == ".csv":
            with file.open(encoding="utf-8-sig", newline="") as handle:
                rows = [(row["x_px"], row["y_px"]) for row in csv.DictReader(handle)]
        else:
            rows = tomllib.loads(file.read_text(encoding="utf-8-sig"))["corners_px"]
        corners = np.array([[float(x), float(y)] for x, y in rows])
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            f"corners file {str(path)!r} is not TOML ({error}); CSV files end in .csv"
        ) from error
    except KeyError as error:
        raise InputError(
            f"corners file {str(path)!r} has no {error}: write corners_px = [[x, y], ...], or a CSV with "
            "the columns x_px,y_px"
        ) from error
    except (TypeError, ValueError) as error:
        raise InputError(f"corners file {str(path)!r}: each corner is two numbers, x and y in px") from error
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise InputError(f"corners file {str(path)!r} has {len(corners)} corners, needed are 4: {ORDER}")
    return corners


def calibrate_corners(
    corners_px: Float64,
    pool_m: tuple[float, float],
    image_px: tuple[int, int],
    tag: Tag,
    corner_height_m: float = 0.0,
    camera_height_m: float | None = None,
    lens: Lens | None = None,
) -> Calibration:
    """Calibrate from the pixels of the pool's corners.

    Args:
        corners_px: (4, 2) pixels in the order of ``ORDER``.
        pool_m: length, width.
        image_px: width, height of the pictures.
        tag: the tag on the robot.
        corner_height_m: of the corners over the water (a rim's), negative for corners on the floor.
        camera_height_m: measured, over the water; needed if tag and corners differ in height and the lens is
            unknown.
        lens: intrinsics, if known.

    Raises:
        InputError: the corners do not fit the picture, the pool or the camera.
    """
    width, height = image_px
    beyond = int(((corners_px < 0) | (corners_px > (width, height))).any(axis=1).sum())
    if beyond >= 2 and bool(((corners_px >= 0) & (corners_px <= (height, width))).all()):
        raise InputError(
            f"{beyond} of the corners lie outside of a picture of {width} x {height} px, and all lie in "
            f"one of {height} x {width}: give --image as width x height"
        )
    slack = 0.5 * max(image_px)  # a corner may lie beyond the edge, found by a ruler
    for k, (x, y) in enumerate(corners_px):
        if not (-slack <= x <= width + slack and -slack <= y <= height + slack):
            raise InputError(f"corner {k + 1} at ({x:g}, {y:g}) px is far outside of {width} x {height} px")
    areas = []
    for k in range(4):
        a, b, c = (corners_px[(k + j) % 4] for j in range(3))
        doubled = float((b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]))
        span = max(float(np.linalg.norm(side)) for side in (b - a, c - b, c - a)) + 1e-9
        if abs(doubled) / span < 2.0:
            raise InputError(
                f"corners {k + 1}, {(k + 1) % 4 + 1} and {(k + 2) % 4 + 1} lie on one line (within "
                f"{abs(doubled) / span:.2f} px): give the pool's four corners, {ORDER}"
            )
        areas.append(doubled)
    if not (all(area < 0 for area in areas) or all(area > 0 for area in areas)):
        raise InputError(f"the corners cross over: give them round the pool, {ORDER}")
    if areas[0] > 0:
        raise InputError(
            "the corners run clockwise as seen from above: give them counter-clockwise, "
            f"{ORDER}; if the picture is mirrored, switch that off in the camera"
        )
    length, across = pool_m
    homes = np.array([[0, 0], [length, 0], [length, across], [0, across]], dtype=np.float64)
    blank = Calibration(image_px, pool_m, np.eye(3), lens=lens)
    blank = replace(blank, homography=from_four(homes, blank.undistort(corners_px)))
    made, matrix = _placed(blank, tag, corner_height_m, camera_height_m)
    if matrix is not None:
        scales = np.linalg.norm(np.linalg.solve(matrix, made.homography)[:, :2], axis=0)
        stretch = float(scales[0] / scales[1])
        if not 1.0 / SIDES_MOST < stretch < SIDES_MOST:
            raise InputError(
                f"the pool's length appears {stretch:.2f} times too long for its width: give --pool as "
                f"length x width, and the corners along the length first, {ORDER}"
            )
    return made


def _placed(
    flat: Calibration, tag: Tag, height_m: float, camera_height_m: float | None
) -> tuple[Calibration, Float64 | None]:
    """The calibration with tag, height of its plane and camera; and the camera matrix if known."""
    offset_m = refraction_offset_m(height_m)
    camera = camera_of(flat.homography, flat.image_px, height_m + offset_m, flat.lens, camera_height_m)
    matrix, _, place_m = camera or (None, None, None)
    made = replace(
        flat, plane_height_m=height_m, plane_refraction_offset_m=offset_m, camera_m=place_m, tag=tag
    )
    return made, matrix


def calibrate_plane(
    board: Board,
    image: UInt8,
    board_at_m: tuple[float, float],
    pool_m: tuple[float, float],
    tag: Tag,
    board_height_m: float = 0.0,
    camera_height_m: float | None = None,
    lens: Lens | None = None,
) -> Calibration:
    """Calibrate from a picture of a board at a known place in the pool.

    Args:
        board: the board.
        image: (height, width) grey levels.
        board_at_m: (2,) its first inner corner in the pool's frame; the board lies face up, its columns along
            x, its rows towards -y.
        board_height_m: of its face over the water, negative under it.
        pool_m, tag, camera_height_m, lens: see ``calibrate_corners``.

    Raises:
        InputError: the board looks alike from both ends, is not seen, or does not fit the pool.
    """
    if board.kind == "chessboard" and (board.columns + board.rows) % 2 == 0:
        raise InputError(
            f"a chessboard of {board.columns} x {board.rows} squares looks the same from both ends: take one "
            "with an odd and an even number, as 9x6, or a ChArUco board"
        )
    found = board.find(image)
    if found is None:
        raise InputError(
            f"no {board.kind} board of {board.columns} x {board.rows} squares is seen in the picture of the "
            "plane: all of it must be in sight; check --squares, light and focus"
        )
    home, seen = found
    blank = Calibration((image.shape[1], image.shape[0]), pool_m, np.eye(3), lens=lens)
    flat = blank.undistort(seen)
    on_pool = np.array(board_at_m) + home * [1.0, -1.0]
    fitted, _ = cv2.findHomography(on_pool, flat, 0)
    if fitted is None:
        raise InputError("the board's corners fix no plane: it must not be seen from the edge")
    if np.linalg.det(np.asarray(fitted)[:2, :2]) > 0:
        raise InputError("the board is seen mirrored: switch that off in the camera, or lay it face up")
    homography = np.asarray(fitted, dtype=np.float64)
    rms = float(np.sqrt(np.mean(np.sum((apply(homography, on_pool) - flat) ** 2, axis=1))))
    blank = replace(blank, homography=homography, method=board.kind, points=len(seen), rms_px=rms)
    return _placed(blank, tag, board_height_m, camera_height_m)[0]
