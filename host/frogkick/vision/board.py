"""Boards for calibration (chessboard, ChArUco), pictures of them, and the lens from these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from frogkick.core.arrays import Float64, UInt8
from frogkick.core.errors import InputError
from frogkick.vision.calibration import Lens

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


def read_pictures(folder: Path | str) -> list[tuple[str, UInt8]]:
    """Read a folder's pictures, by name, as grey levels.

    Raises:
        InputError: there is no such folder, no picture in it, or one that cannot be read.
    """
    place = Path(folder)
    if not place.is_dir():
        raise InputError(f"folder of pictures {str(folder)!r} does not exist: check the path")
    names = sorted(file for file in place.iterdir() if file.suffix.lower() in PICTURE_ENDINGS)
    if not names:
        raise InputError(f"folder {str(folder)!r} holds no picture ({', '.join(PICTURE_ENDINGS)})")
    return [(file.name, read_picture(file)) for file in names]


def read_picture(path: Path | str) -> UInt8:
    """Read a picture as grey levels.

    Raises:
        InputError: it is no picture that can be read.
    """
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if Path(path).is_file() else None
    if image is None:
        raise InputError(f"{str(path)!r} is not a readable picture: check the path and the file")
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
