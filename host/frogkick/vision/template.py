"""Fits the tag's printed picture to a frame: corners to a few hundredths of a pixel, with covariance.

A found tag is resampled to the axes of its picture and compared with it, over the edges of all cells. Unknown
are the eight corner coordinates, contrast, brightness, and its slope in both directions, all linear, so that
a step is a product with a precomputed matrix. Of several blurs of the picture the one with the least residual
is taken.

Source: Baker and Matthews 2004, inverse compositional alignment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from frogkick.core.arrays import Bool, Float64, UInt8
from frogkick.vision.calibration import apply, from_four
from frogkick.vision.tags import tag_cells, tag_margin, tag_white

PER_CELL = 4
"""Samples across a cell."""
BLURS = (0.45, 0.7, 1.0, 1.4, 2.0, 2.8)
"""Standard deviations of the picture's blurs, samples, by pixels, lens and motion together."""
EDGE = PER_CELL // 2
"""Samples at the picture's edge that are left out, as the surroundings of the tag affect them."""
SUSPECT = 0.06
"""Residual over the contrast from which outlying samples count less."""
STEPS_MAX = 10
"""Largest number of steps of a fit."""
FREE = 12
"""Unknowns of a fit."""


@dataclass(frozen=True)
class Template:
    """A tag's picture in one blur, prepared for the fit."""

    side: int  # samples along a side, with the white around
    corners: Float64  # (4, 2) corners of the tag's square in samples, in the picture's order
    inside: Bool  # (side^2,) whether samples count
    columns: Float64  # (side^2, 12) derivatives by the eight corner coordinates, picture, ones, slopes
    solve: Float64  # (12, side^2) its pseudoinverse
    matched: Float64  # (cells, side^2) matched filters of a flip, black to white, of each printed cell
    unit_covariance: Float64  # (8, 8) covariance of the corners for unit noise and unit contrast, samples^2


@dataclass(frozen=True)
class Fit:
    """A fitted tag."""

    corners_px: Float64  # (4, 2) in the picture's order, pixels of the frame
    covariance_px2: Float64  # (8, 8) of the corners x0, y0, x1, ...
    residual: float  # standard deviation of the residuals over the contrast
    worst_cell: float  # largest part of a flip of a printed cell: 0 as printed, 1 wrong


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


def _blurred_cell(cells: int, row: int, col: int, blur: float) -> Float64:
    """(side^2,) one white cell on black."""
    one = np.zeros((cells, cells), np.float32)
    one[row, col] = 1.0
    fine = np.kron(one, np.ones((PER_CELL, PER_CELL), np.float32))
    return np.asarray(cv2.GaussianBlur(fine, (0, 0), blur), dtype=np.float64).ravel()


def likeliest_turn(image: UInt8, quad_px: Float64, bank: tuple[Template, ...]) -> tuple[int, float]:
    """The orientation of a dark square with the best correlation with the tag.

    ``quad_px`` are (4, 2) corners of the square, clockwise in the picture from any corner. Returned are the
    number of corners to roll them by, and the correlation, -1 to 1.
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


def fit_template(image: UInt8, corners_px: Float64, bank: tuple[Template, ...]) -> Fit | None:
    """Fit a tag's picture to a frame; None if the fit diverges or finds no contrast.

    ``corners_px`` are (4, 2) in the picture's order, right within a cell.
    """
    which = bank[len(bank) // 2]
    home = from_four(which.corners, corners_px)
    size = (which.side, which.side)
    corners = corners_px
    for step in range(STEPS_MAX):
        warped = cv2.warpPerspective(
            image, home, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
        )
        values = np.asarray(warped.ravel() * which.inside, dtype=np.float64)
        if step in (1, 2):  # the corners are nearly right now, so that the blur can be chosen
            which = min(bank, key=lambda template: _residual(template, values))
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
    # Neighbouring samples share pixels, whose noise counts once.
    side_px = float(np.sqrt(abs(cv2.contourArea(corners.astype(np.float32)))))
    shared = max(1.0, (float(np.ptp(which.corners[:, 0])) / max(side_px, 1.0)) ** 2)
    jacobian = _jacobian(home, which.corners)
    covariance = jacobian @ unit @ jacobian.T * (shared * (noise / contrast) ** 2)
    return Fit(corners, covariance, noise / float(contrast), worst)


def _residual(which: Template, values: Float64) -> float:
    """Sum of squared residuals of a template in resampled grey levels."""
    left = values - which.columns @ (which.solve @ values)
    return float(left @ left)


def _weighed(which: Template, values: Float64, left: Float64) -> tuple[Float64, Float64] | None:
    """A step in which outlying samples, as of glare, count less (Cauchy's weights).

    Returns:
        (12,) unknowns and (8, 8) covariance of the corners for unit noise; None if the fit is singular.
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


def _jacobian(homography: Float64, points: Float64) -> Float64:
    """(8, 8) block diagonal: move of a corner in the frame for a move by a sample in the picture."""
    jacobian = np.zeros((8, 8))
    for k, point in enumerate(points):
        ends = apply(homography, point + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
        jacobian[2 * k : 2 * k + 2, 2 * k] = ends[0] - ends[1]
        jacobian[2 * k : 2 * k + 2, 2 * k + 1] = ends[2] - ends[3]
    return jacobian
