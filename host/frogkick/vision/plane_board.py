"""Calibration of the pool's plane from a board laid on it."""

from __future__ import annotations

import cv2
import numpy as np

from frogkick.core.arrays import UInt8
from frogkick.core.errors import InputError
from frogkick.vision.board import Board
from frogkick.vision.calibration import Calibration, Lens, Tag, camera_of, refraction_offset_m
from frogkick.vision.plane import apply


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
        pool_m: length, width.
        tag: the tag on the robot.
        board_height_m: of its face over the water, negative under it.
        camera_height_m: over the water; needed if tag and board differ in height and the lens is unknown.
        lens: intrinsics, if known.

    Raises:
        InputError: the board is not seen, or the camera's height does not fit.
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
    image_px = (image.shape[1], image.shape[0])
    blank = Calibration(image_px, pool_m, np.eye(3), lens=lens)
    flat = blank.undistort(seen)
    on_pool = np.array(board_at_m) + home * [1.0, -1.0]
    fitted, _ = cv2.findHomography(on_pool, flat, 0)
    if fitted is None:
        raise InputError("the board's corners fix no plane: it must not be seen from the edge")
    if np.linalg.det(np.asarray(fitted)[:2, :2]) > 0:
        raise InputError("the board is seen mirrored: switch that off in the camera, or lay it face up")
    homography = np.asarray(fitted, dtype=np.float64)
    rms = float(np.sqrt(np.mean(np.sum((apply(homography, on_pool) - flat) ** 2, axis=1))))
    offset = refraction_offset_m(board_height_m)
    plane = board_height_m + offset
    camera = camera_of(homography, image_px, plane, lens, camera_height_m)
    place_m = None if camera is None else camera[1]
    return Calibration(
        image_px, pool_m, homography, board_height_m, offset, place_m, lens, tag, board.kind, len(seen), rms
    )
