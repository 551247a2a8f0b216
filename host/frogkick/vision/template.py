"""The tag's printed picture fitted to a frame: corners to a few hundredths of a pixel, with covariance.

A found tag is resampled to its own picture's axes and compared with that picture. Every cell's edge counts,
not only the outline, which at 25 px across is what brings noise down. Unknown besides the eight corner
coordinates: contrast, brightness and its slope in both directions, all linear, so that one product with a
matrix made once gives a step. The picture is held in several blurs; the one that leaves least is taken.

Source: Baker and Matthews 2004, inverse compositional alignment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from frogkick.vision.plane import apply, from_four
from frogkick.vision.tags import tag_cells, tag_margin, tag_white

Array = npt.NDArray[np.float64]
PER_CELL = 4
"""Samples a cell across."""
BLURS = (0.45, 0.7, 1.0, 1.4, 2.0, 2.8)
"""Standard deviations of the picture's blur that are tried, samples: pixels, lens, motion together."""
EDGE = PER_CELL // 2
"""Samples of the picture's outer edge that are left out: what lies around the tag shines into them."""
SUSPECT = 0.06
"""Residual, as a part of the contrast, from which samples that stand out count less."""
FREE = 12
"""Unknowns of a fit."""


@dataclass(frozen=True)
class Template:
    """One tag's picture in one blur, ready to be fitted.

    Attributes:
        side: samples a side, the white around included.
        corners: (4, 2) corners of the tag's square in samples, in the picture's order.
        inside: (side^2,) which samples count.
        columns: (side^2, 12) derivatives by the eight corner coordinates, picture, ones, slopes.
        solve: (12, side^2) its pseudoinverse.
        matched: (cells, side^2) how much of a cell's flip, black to white, a residual holds, cell by cell
            of what is printed.
        unit_covariance: (8, 8) covariance of the corners for unit noise and unit contrast, samples^2.
    """

    side: int
    corners: Array
    inside: npt.NDArray[np.bool_]
    columns: Array
    solve: Array
    matched: Array
    unit_covariance: Array


@dataclass(frozen=True)
class Fit:
    """A fitted tag.

    Attributes:
        corners_px: (4, 2) in the picture's order, pixels of the frame.
        covariance_px2: (8, 8) of the corners x0, y0, x1, ...
        contrast: white minus black, grey levels.
        residual: standard deviation of what the fit leaves, as a part of the contrast.
        worst_cell: the largest part of a flip that any printed cell shows: 0 as printed, 1 wrong.
        moved_px: by how far the last step moved a corner.
    """

    corners_px: Array
    covariance_px2: Array
    contrast: float
    residual: float
    worst_cell: float
    moved_px: float


@cache
def templates(family: str, tag_id: int) -> tuple[Template, ...]:
    """Make a tag's templates, one for each of ``BLURS``."""
    return tuple(_template(family, tag_id, blur) for blur in BLURS)


def _template(family: str, tag_id: int, blur: float) -> Template:
    cells = tag_cells(family, tag_id)
    side = PER_CELL * len(cells)
    picture = cv2.GaussianBlur(
        np.kron(cells, np.ones((PER_CELL, PER_CELL), np.float32)),
        (0, 0),
        blur,
        borderType=cv2.BORDER_REPLICATE,
    ).astype(np.float64)
    gradient_y, gradient_x = np.gradient(picture)
    margin = PER_CELL * tag_margin(family)
    low, high = margin - 0.5, side - margin - 0.5
    corners = np.array([[low, low], [high, low], [high, high], [low, high]])
    rows, cols = np.mgrid[:side, :side].astype(np.float64)
    points = np.stack([cols.ravel(), rows.ravel()], axis=1)
    columns = np.empty((side * side, FREE))
    step = 0.01
    for k in range(8):
        moved = corners.copy()
        moved.flat[k] += step
        shift = (apply(from_four(corners, moved), points) - points) / step
        columns[:, k] = gradient_x.ravel() * shift[:, 0] + gradient_y.ravel() * shift[:, 1]
    centred = (points - points.mean(axis=0)) / side
    columns[:, 8] = picture.ravel()
    columns[:, 9] = 1.0
    columns[:, 10:12] = centred
    inside = np.zeros((side, side), dtype=bool)
    inside[EDGE:-EDGE, EDGE:-EDGE] = True
    columns[~inside.ravel()] = 0.0
    solve = np.asarray(np.linalg.pinv(columns), dtype=np.float64)
    inner = range(tag_white(family), len(cells) - tag_white(family))
    flips = inside.ravel() * np.stack(
        [_blurred_cell(len(cells), row, col, blur) for row in inner for col in inner]
    )
    matched = flips / (flips**2).sum(axis=1, keepdims=True)
    return Template(side, corners, inside.ravel(), columns, solve, matched, (solve @ solve.T)[:8, :8])


def _blurred_cell(cells: int, row: int, col: int, blur: float) -> Array:
    """(side^2,) one white cell on black."""
    one = np.zeros((cells, cells), np.float32)
    one[row, col] = 1.0
    fine = np.kron(one, np.ones((PER_CELL, PER_CELL), np.float32))
    return np.asarray(cv2.GaussianBlur(fine, (0, 0), blur), dtype=np.float64).ravel()


def likeliest_turn(
    image: npt.NDArray[np.uint8], quad_px: Array, bank: tuple[Template, ...]
) -> tuple[int, float]:
    """Which way round a square looks most like the tag.

    Args:
        image: (height, width) grey levels.
        quad_px: (4, 2) corners of a dark square, clockwise in the picture from any of them.
        bank: the tag's templates.

    Returns:
        By how many corners to roll them, and the correlation with the print, -1 to 1.
    """
    which = bank[len(bank) // 2]
    size = (which.side, which.side)
    warped = cv2.warpPerspective(
        image, from_four(which.corners, quad_px), size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    ).astype(np.float64)
    inside = which.inside
    print_ = which.columns[inside, 8] - which.columns[inside, 8].mean()
    print_ /= np.linalg.norm(print_)
    found = []
    for turn in range(4):
        values = np.rot90(warped, turn).ravel()[inside]
        values = values - values.mean()
        found.append(float(print_ @ values) / max(float(np.linalg.norm(values)), 1e-9))
    best = int(np.argmax(found))
    return best, found[best]


def fit_template(
    image: npt.NDArray[np.uint8], corners_px: Array, bank: tuple[Template, ...], steps: int = 10
) -> Fit | None:
    """Fit a tag's picture to a frame, from corners that are right within a cell.

    Args:
        image: (height, width) grey levels.
        corners_px: (4, 2) in the picture's order.
        bank: the tag's templates.
        steps: at most so many.

    Returns:
        The fit; None where it runs away, or where nothing of the tag's contrast is there.
    """
    which = bank[len(bank) // 2]
    home = from_four(which.corners, corners_px)
    size = (which.side, which.side)
    corners = corners_px
    for step in range(steps):
        warped = cv2.warpPerspective(
            image, home, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
        )
        values = np.asarray(warped.ravel() * which.inside, dtype=np.float64)
        if step in (1, 2):  # once the corners are nearly right, the blur can be told
            which = min(bank, key=lambda one: _left(one, values))
        found = which.solve @ values
        contrast = found[8]
        if contrast < 4.0:
            return None
        delta = (found[:8] / contrast).reshape(4, 2)
        if np.abs(delta).max() > 2.0 * PER_CELL:
            return None
        home = home @ from_four(which.corners + delta, which.corners)
        moved = apply(home, which.corners)
        if not np.isfinite(moved).all():
            return None
        last = float(np.abs(moved - corners).max())
        corners = moved
        if last < 0.005:
            break
    if np.abs(corners - corners_px).max() > 0.2 * np.ptp(corners_px):
        return None
    left = values - which.columns @ found
    degrees = int(which.inside.sum()) - FREE
    noise = float(np.sqrt(left @ left / degrees))
    unit = which.unit_covariance
    if noise > SUSPECT * contrast:
        weighed = _weighed(which, values, np.asarray(left, dtype=np.float64))
        if weighed is None:
            return None
        found, unit = weighed
        contrast = found[8]
        if contrast < 4.0:
            return None
        home = home @ from_four(which.corners + (found[:8] / contrast).reshape(4, 2), which.corners)
        corners = apply(home, which.corners)
        left = values - which.columns @ found
        noise = float(np.sqrt(left @ left / degrees))
    worst = float(np.abs(which.matched @ left).max()) / float(contrast)
    # Neighbouring samples share pixels: their noise counts once a pixel.
    side_px = float(np.sqrt(abs(cv2.contourArea(corners.astype(np.float32)))))
    shared = max(1.0, (float(np.ptp(which.corners[:, 0])) / max(side_px, 1.0)) ** 2)
    jacobian = _jacobian(home, which.corners)
    covariance = jacobian @ unit @ jacobian.T * (shared * (noise / contrast) ** 2)
    return Fit(corners, covariance, float(contrast), noise / float(contrast), worst, last)


def _left(which: Template, values: Array) -> float:
    """Sum of squares that a template leaves of resampled grey levels."""
    left = values - which.columns @ (which.solve @ values)
    return float(left @ left)


def _weighed(which: Template, values: Array, left: Array) -> tuple[Array, Array] | None:
    """A step in which samples that stand out, as glare does, count less (Cauchy's weights).

    Returns:
        (12,) unknowns and (8, 8) covariance of the corners for unit noise; None where too little is left.
    """
    for _ in range(4):
        spread = 1.4826 * float(np.median(np.abs(left[which.inside])))
        weights = 1.0 / (1.0 + (left / (2.4 * max(spread, 0.5))) ** 2)
        weighted = which.columns * weights[:, None]
        try:
            inverse = np.linalg.inv(which.columns.T @ weighted)
        except np.linalg.LinAlgError:
            return None
        found = inverse @ (weighted.T @ values)
        left = values - which.columns @ found
    return found, np.asarray(inverse[:8, :8], dtype=np.float64)


def _jacobian(homography: Array, points: Array) -> Array:
    """(8, 8) block diagonal: how a corner moves in the frame for a sample's move in the picture."""
    whole = np.zeros((8, 8))
    for k, point in enumerate(points):
        ends = apply(homography, point + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
        whole[2 * k : 2 * k + 2, 2 * k] = ends[0] - ends[1]
        whole[2 * k : 2 * k + 2, 2 * k + 1] = ends[2] - ends[3]
    return whole
