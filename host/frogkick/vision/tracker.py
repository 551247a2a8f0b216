"""Tracks the tag from frame to frame: around its last place, in the complete frame after a loss.

Only a tag that can be trusted gives a pose: decoded, only once in the picture, of the right size, flat,
within the pool, and printed like the template. Otherwise an ``Observation`` has a reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from frogkick.core.arrays import Float64, Int64, UInt8
from frogkick.core.errors import InputError
from frogkick.vision.calibration import Calibration
from frogkick.vision.pose import Pose, solve_pose, tag_place
from frogkick.vision.tags import STANDARD, dictionary, find_standard, picture_order
from frogkick.vision.template import Fit, fit_template, likeliest_turn, templates

Reason = Literal[
    "found",
    "no tag",
    "too dark",
    "mirrored",
    "doubled",
    "unclear",
    "not flat",
    "wrong size",
    "outside the pool",
]

RESIDUAL_MAX = 0.16
"""Largest residual of a fit over the contrast; above it the print is half covered, in glare or torn."""
CELL_MAX = 0.5
"""Largest part of a flip, black to white, of any cell of a tag."""
LIKENESS_MIN = 0.6
"""Smallest correlation with the print at which a dark square that was not decoded is fitted."""
SIZE_MAX = 0.12
"""Largest relative error of the tag's size."""
MISFIT_MAX_PX = 0.7
"""Largest root mean square distance of the corners from a flat square's."""
HEADING_SD_MAX_RAD = float(np.deg2rad(0.5))
"""Largest standard deviation of the heading of a pose."""
SPOILT, BENT_PX, SPOILT_SD_MAX_RAD = 0.05, 0.15, float(np.deg2rad(0.12))
"""Residual and misfit from which a fit may follow glare instead of the print, and the limit of the heading's
standard deviation for such a fit, whose true error is larger."""
DARK_LEVEL = 16
"""A picture with a hundredth of its pixels or less above this grey level (of 255) shows no tag."""
MARGIN_M = 0.05
"""Poses are accepted so far beyond the pool's walls."""
SMALL_PX = 45.0
"""A tag with shorter sides is searched in a picture enlarged twofold."""


@dataclass(frozen=True)
class Observation:
    """Result of a frame."""

    pose: Pose | None  # the robot's; None without a tag to be trusted
    reason: Reason  # ``found``, or why there is no pose
    corners_px: Float64 | None = None  # (4, 2) of the tag, in the printed picture's order; None without a tag
    residual: float = float("nan")  # of the fit, over the contrast; NaN without a fit
    windowed: bool = False  # whether the tag was found around its last place


class Tracker:
    """Finds a tag frame by frame, in one thread."""

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._templates = templates(calibration.tag.family, calibration.tag.id)
        self._last: Float64 | None = None
        self._was_seen = False  # the tag, the right way round, since the start
        middle = np.array([[calibration.pool_m[0] / 2, calibration.pool_m[1] / 2]])
        half = calibration.tag.size_m / 2
        ends = calibration.pixels(middle + np.array([[-half, 0.0], [half, 0.0]]))
        self._side_px = float(np.linalg.norm(ends[1] - ends[0]))
        if self._side_px < 12.0:
            raise InputError(
                f"a tag of {1e3 * calibration.tag.size_m:.0f} mm is {self._side_px:.1f} px wide in this "
                "camera, 12 are needed: take a larger tag or a nearer camera"
            )

    def forget(self) -> None:
        """Search the next frame completely."""
        self._last = None

    def observe(self, image: UInt8) -> Observation:
        """Search a frame, (height, width) grey or (height, width, 3) BGR of the calibration's size.

        Raises:
            InputError: the frame does not have the calibration's size.
        """
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        width, height = self._calibration.image_px
        if grey.shape != (height, width):
            raise InputError(
                f"the frame is {grey.shape[1]} x {grey.shape[0]} px, the calibration is for {width} x "
                f"{height}: set the camera to that or calibrate again"
            )
        grey = np.ascontiguousarray(grey, dtype=np.uint8)
        seen = self._look(grey)
        self._last = seen.corners_px if seen.pose is not None else None
        self._was_seen = self._was_seen or seen.corners_px is not None
        if seen.reason == "no tag":
            seen = replace(seen, reason=self._why_none(grey))
        return seen

    def _why_none(self, grey: UInt8) -> Reason:
        """The likely reason why a complete picture shows no tag."""
        if np.percentile(grey, 99.0) <= DARK_LEVEL:
            return "too dark"
        tag = self._calibration.tag
        if not self._was_seen and find_corners(grey[:, ::-1], tag.id, self._side_px, tag.family)[0]:
            return "mirrored"
        return "no tag"

    def _look(self, grey: UInt8) -> Observation:
        height, width = grey.shape
        if self._last is not None:
            reach = 1.2 * max(np.ptp(self._last, axis=0))
            low = np.maximum(np.floor(self._last.min(axis=0) - reach), 0).astype(int)
            high = np.minimum(np.ceil(self._last.max(axis=0) + reach), [width, height]).astype(int)
            near = self._judge(grey, low, high)
            if near.pose is not None:
                return replace(near, windowed=True)
        return self._judge(grey, np.zeros(2, dtype=int), np.array([width, height]))

    def _judge(self, grey: UInt8, low: Int64, high: Int64) -> Observation:
        """Search a part of the frame, fit the tag, and check the fit."""
        window = grey[low[1] : high[1], low[0] : high[0]]
        tag = self._calibration.tag
        decoded, squares = find_corners(window, tag.id, self._side_px, tag.family)
        fits = [fit_template(grey, corners + low, self._templates) for corners in decoded]
        clear = [fit for fit in fits if fit is not None and _as_printed(fit)]
        clear += self._undecoded(grey, [corners + low for corners in squares], clear)
        if len(clear) > 1:
            return Observation(None, "doubled")
        if not clear:
            return Observation(None, "unclear" if decoded else "no tag")
        fit = clear[0]

        def refuse(reason: Reason) -> Observation:
            return Observation(None, reason, fit.corners_px, fit.residual)

        pose = solve_pose(self._calibration, fit.corners_px, fit.covariance_px2)
        if pose is None:
            return refuse("not flat")
        if abs(pose.size_m / tag.size_m - 1.0) > SIZE_MAX:
            return refuse("wrong size")
        if pose.misfit_px > MISFIT_MAX_PX:
            return refuse("not flat")
        spoilt = fit.residual > SPOILT and pose.misfit_px > BENT_PX
        if pose.covariance[2, 2] > (SPOILT_SD_MAX_RAD if spoilt else HEADING_SD_MAX_RAD) ** 2:
            return refuse("unclear")
        length, width = self._calibration.pool_m
        x, y, _ = tag_place(self._calibration, pose.x_m, pose.y_m, pose.heading_rad)
        if not (-MARGIN_M <= x <= length + MARGIN_M and -MARGIN_M <= y <= width + MARGIN_M):
            return refuse("outside the pool")
        return Observation(pose, "found", fit.corners_px, fit.residual)

    def _undecoded(self, grey: UInt8, squares: list[Float64], clear: list[Fit]) -> list[Fit]:
        """Tags among dark squares whose cells are too small or too blurred to be decoded."""
        found: list[Fit] = []
        for square in squares:
            if _near(square, [fit.corners_px for fit in clear + found], self._side_px):
                continue
            turn, likeness = likeliest_turn(grey, square, self._templates)
            if likeness < LIKENESS_MIN:
                continue
            fit = fit_template(grey, np.roll(square, -turn, axis=0), self._templates)
            if fit is None or not _as_printed(fit):
                continue
            if not _near(fit.corners_px, [known.corners_px for known in clear + found], self._side_px):
                found.append(fit)
        return found


def _as_printed(fit: Fit) -> bool:
    return fit.residual <= RESIDUAL_MAX and fit.worst_cell <= CELL_MAX


def _near(corners: Float64, others: list[Float64], side_px: float) -> bool:
    """Whether a square's centre is within half a tag of another's."""
    centre = corners.mean(axis=0)
    return any(np.linalg.norm(centre - other.mean(axis=0)) < 0.5 * side_px for other in others)


def find_corners(
    grey: UInt8, tag_id: int, side_px: float, family: str = "tag36h11"
) -> tuple[list[Float64], list[Float64]]:
    """Find the places where a tag is decoded, and dark squares of its size without a decoded tag.

    Args:
        side_px: the tag's approximate width.
        family: of the tag; squares are found for tag36h11 only.

    Returns:
        (4, 2) corners of each, within about a pixel: of tags in the printed picture's order, of squares
        clockwise. Places closer than half a tag count as one.
    """
    scale = 2 if side_px < SMALL_PX else 1
    image = grey if scale == 1 else cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
    if family == STANDARD:
        return _places(find_standard(np.asarray(image, dtype=np.uint8), tag_id), scale, side_px), []
    longest = max(image.shape)
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    settings.minMarkerPerimeterRate = 4 * 0.5 * scale * side_px / longest
    settings.maxMarkerPerimeterRate = 4 * 2.0 * scale * side_px / longest
    window = max(3, int(scale * side_px / 4) | 1)
    settings.adaptiveThreshWinSizeMin = window
    settings.adaptiveThreshWinSizeMax = 2 * window + 1
    settings.adaptiveThreshWinSizeStep = window + 1
    settings.perspectiveRemovePixelPerCell = 6
    settings.minDistanceToBorder = 1
    settings.errorCorrectionRate = 1.0
    corners, ids, rejected = cv2.aruco.ArucoDetector(dictionary(), settings).detectMarkers(image)
    numbers = [] if ids is None else ids.ravel().tolist()
    ours = [picture_order(quad) for quad, number in zip(corners, numbers, strict=True) if number == tag_id]
    squares = [picture_order(quad) for quad in rejected]
    return _places(ours, scale, side_px), _places(squares, scale, side_px)


def _places(quads: Sequence[Float64], scale: int, side_px: float) -> list[Float64]:
    """Corners in the enlarged picture as pixels of the frame, without repeated places."""
    kept: list[Float64] = []
    for quad in quads:
        # Pixel centres are whole numbers: those of the enlarged picture lie a quarter of a pixel off.
        place = (quad + 0.5) / scale - 0.5
        if not _near(place, kept, side_px):
            kept.append(place)
    return kept
