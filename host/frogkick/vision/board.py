"""Calibration from boards (chessboard, ChArUco): the lens from pictures of them, and the pool's plane.

The plane comes from a board that is laid on it, or from the pool's four corners in a small file.
"""

from __future__ import annotations

import csv
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from frogkick.core.arrays import Float64, UInt8
from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.vision.calibration import (
    Calibration,
    Lens,
    Tag,
    apply,
    camera_of,
    from_four,
    refraction_offset_m,
)

PICTURES_MIN = 5
PICTURE_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True)
class Board:
    """A printed board."""

    # ``chessboard`` (its first square black) or ``charuco`` (OpenCV's DICT_4X4_50, markers of three quarters
    # of a square)
    kind: str
    columns: int  # squares along
    rows: int  # squares across
    square_m: float  # side of a square

    def __post_init__(self) -> None:
        if self.kind not in ("chessboard", "charuco"):
            raise InputError(f"board {self.kind!r} is not known: chessboard or charuco")
        if not (3 <= self.columns <= 40 and 3 <= self.rows <= 40):
            raise InputError(f"a board of {self.columns} x {self.rows} squares: allowed is 3 to 40 each")
        if self.kind == "charuco" and self.columns * self.rows // 2 > 50:
            raise InputError(
                f"a ChArUco board of {self.columns} x {self.rows} squares needs more than 50 markers"
            )
        if not 0.002 <= self.square_m <= 1.0:
            raise InputError(f"squares of {1e3 * self.square_m:g} mm: allowed is 2 to 1000")

    def charuco(self) -> cv2.aruco.CharucoBoard:
        """The board for OpenCV."""
        markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, 0.75 * self.square_m, markers)

    def find(self, image: UInt8) -> tuple[Float64, Float64] | None:
        """Find the board's inner corners.

        Returns:
            (n, 2) m on the board from its first inner corner, x along its columns, y along its rows, and (n,
            2) pixels. None if the board is not seen.
        """
        if self.kind == "chessboard":
            shape = (self.columns - 1, self.rows - 1)
            ok, corners = cv2.findChessboardCornersSB(image, shape, flags=cv2.CALIB_CB_ACCURACY)
            if not ok:
                return None
            cols, rows = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]))
            home = np.stack([cols.ravel(), rows.ravel()], axis=1) * self.square_m
            seen = corners.reshape(-1, 2).astype(np.float64)
            # OpenCV may start at either end: the first square, beyond the first corner, is black.
            plane, _ = cv2.findHomography(home, seen, 0)
            squares = np.array([[[-0.5, -0.5]], [[0.5, -0.5]]]) * self.square_m
            ends = cv2.perspectiveTransform(squares, np.asarray(plane)).reshape(2, 2)
            height, width = image.shape
            x, y = np.clip(np.rint(ends).astype(int), 0, [width - 1, height - 1]).T
            if image[y[0], x[0]] > image[y[1], x[1]]:
                seen = seen[::-1].copy()
            return home.astype(np.float64), seen
        board = self.charuco()
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
        if ids is None or len(ids) < 6:
            return None
        home = np.asarray(board.getChessboardCorners())[ids.ravel(), :2] - self.square_m
        return home.astype(np.float64), np.asarray(corners).reshape(-1, 2).astype(np.float64)


def picture_files(folder: Path | str) -> list[Path]:
    """A folder's pictures, by name.

    Raises:
        InputError: there is no such folder, or no picture in it.
    """
    place = Path(folder)
    if not place.is_dir():
        raise InputError(f"folder of pictures {str(folder)!r} does not exist: check the path")
    names = [file for file in place.iterdir() if file.suffix.lower() in PICTURE_ENDINGS]
    if not names:
        raise InputError(f"folder {str(folder)!r} holds no picture ({', '.join(PICTURE_ENDINGS)})")
    return sorted(names, key=_by_number)


def _by_number(file: Path) -> tuple[list[tuple[str, int]], str]:
    """Sort key of a name in which numbers count by their value: frame2 comes before frame10."""
    parts = re.findall(r"([^0-9]*)([0-9]*)", file.name.lower())
    return [(text, int(digits or -1)) for text, digits in parts], file.name


def read_picture(path: Path | str) -> UInt8:
    """Read a picture as grey levels, as the camera's sensor delivered it.

    A note in the file that viewers should turn the picture (EXIF) is ignored: a lens and a pool are
    calibrated in the sensor's pixels, which do not turn with the camera. Levels of more than 8 bits are
    scaled down.

    Raises:
        InputError: it is no picture that can be read, or its levels are not whole numbers.
    """
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION | cv2.IMREAD_ANYDEPTH
    image = cv2.imread(str(path), flags) if Path(path).is_file() else None
    if image is None:
        raise InputError(f"{str(path)!r} is not a readable picture: check the path and the file")
    if image.dtype == np.uint16:
        # Sensors of 10, 12 or 14 bits are stored in 16, of which they leave the highest unused.
        bits = next(each for each in (8, 10, 12, 14, 16) if int(image.max()) < 1 << each)
        image = np.right_shift(np.asarray(image, dtype=np.uint16), bits - 8)
    elif image.dtype != np.uint8:
        raise InputError(f"{str(path)!r} has levels of type {image.dtype}: store 8 or 16 bits for each pixel")
    return np.asarray(image, dtype=np.uint8)


def calibrate_lens(board: Board, pictures: Sequence[tuple[str, UInt8]]) -> tuple[Lens, float]:
    """Calibrate the lens from pictures (name, grey levels) of a board in many orientations.

    Returns:
        The lens, and the root mean square of the residuals in pixels.

    Raises:
        InputError: the pictures have several sizes, or the board is seen in fewer than PICTURES_MIN.
    """
    sizes = {image.shape for _, image in pictures}
    if len(sizes) > 1:
        raise InputError(f"the pictures have {len(sizes)} sizes: take all with one setting of the camera")
    seen = [found for _, image in pictures if (found := board.find(image)) is not None]
    if len(seen) < PICTURES_MIN:
        raise InputError(
            f"a {board.kind} board of {board.columns} x {board.rows} squares is seen in {len(seen)} of "
            f"{len(pictures)} pictures, needed are {PICTURES_MIN}: check --squares, light and focus"
        )
    height, width = next(iter(sizes))
    homes = [np.c_[home, np.zeros(len(home))].astype(np.float32) for home, _ in seen]
    ends = [pixels.astype(np.float32) for _, pixels in seen]
    guess = np.array([[width, 0, (width - 1) / 2], [0, width, (height - 1) / 2], [0, 0, 1.0]])
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(
        homes,
        ends,
        (width, height),
        guess,
        np.zeros(5),
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
    )
    if not rms < 2.0:
        raise InputError(
            f"the board's corners are left {rms:.2f} px off, 2 is the limit: is the board flat, are "
            "--squares right, was the camera's focus fixed?"
        )
    lens = Lens(np.asarray(matrix, dtype=np.float64), np.asarray(distortion, dtype=np.float64).ravel()[:5])
    return lens, float(rms)


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
