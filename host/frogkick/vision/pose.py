"""From a tag's corners in a picture to the robot's pose in the pool's frame, with covariance.

The tag is a flat square at a known height, so that eight coordinates tell four numbers, its size among them:
the other four say whether it is a square at all, and the size whether it is the tag that was printed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frogkick.vision.calibration import Calibration
from frogkick.vision.plane import wrap

Array = npt.NDArray[np.float64]
FLOOR_PX = 0.02
"""Standard deviation that no corner is better than: lens, print and pixels that no noise tells of."""


@dataclass(frozen=True)
class Pose:
    """Where the robot is.

    Attributes:
        x_m: pool frame.
        y_m: pool frame.
        heading_rad: from +x, counter-clockwise, in (-pi, pi].
        covariance: (3, 3) of x_m, y_m, heading_rad: the picture's noise and the
            tag's height; the calibration's error is not in it.
        capture_s: when the picture was taken, on the source's clock.
        size_m: side of the black square, as seen.
        misfit_px: root mean square of how far the corners are from those of the flat square.
    """

    x_m: float
    y_m: float
    heading_rad: float
    covariance: Array
    capture_s: float
    size_m: float
    misfit_px: float


def solve_pose(
    calibration: Calibration, corners_px: Array, covariance_px2: Array, capture_s: float
) -> Pose | None:
    """Find the pose whose square fits the corners best, each weighted by what is known of it.

    Args:
        calibration: camera, pool and tag.
        corners_px: (4, 2) pixels of the picture in the printed picture's order (``tags``).
        covariance_px2: (8, 8) of those.
        capture_s: passed on.

    Returns:
        The pose; None where the corners cannot be those of a tag that lies in the pool's plane and is seen
        from above (mirrored, folded, beyond the horizon).
    """
    tag = calibration.tag
    seen_px = calibration.undistort(corners_px)
    on_pool = calibration.pool(seen_px)
    if not np.isfinite(on_pool).all():
        return None
    # The picture's corners counter-clockwise from above, x to the tag's top, y to its left.
    square = 0.5 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1.0]])
    centred = on_pool - on_pool.mean(axis=0)
    along = float((centred * square).sum())
    across = float((square[:, 0] * centred[:, 1] - square[:, 1] * centred[:, 0]).sum())
    turned = (square[:, 0] * centred[:, 0] - square[:, 1] * centred[:, 1]).sum()
    mirrored = (square[:, 0] * centred[:, 1] + square[:, 1] * centred[:, 0]).sum()
    if np.hypot(along, across) <= np.hypot(turned, mirrored):
        return None
    state = np.array([*on_pool.mean(axis=0), np.arctan2(across, along), tag.size_m])
    weight = np.linalg.inv(covariance_px2 + FLOOR_PX**2 * np.eye(8))
    for _ in range(4):
        expected = _corners(calibration, square, state)
        jacobian = np.empty((8, 4))
        for k, step in enumerate((1e-4, 1e-4, 1e-3, 1e-4)):
            moved = state.copy()
            moved[k] += step
            jacobian[:, k] = (_corners(calibration, square, moved) - expected) / step
        information = jacobian.T @ weight @ jacobian
        state = state + np.linalg.solve(information, jacobian.T @ weight @ (seen_px.ravel() - expected))
        if not np.isfinite(state).all():
            return None
    left = seen_px.ravel() - _corners(calibration, square, state)
    covariance = np.linalg.inv(information)[:3, :3] * max(1.0, float(left @ weight @ left) / 4.0)
    if calibration.camera_m is not None:
        # A tag that is higher than stated is seen further from the camera's foot.
        above = calibration.camera_m[2] - tag.apparent_height_m
        slip = tag.height_sd_m * (state[:2] - calibration.camera_m[:2]) / above
        covariance[:2, :2] += np.outer(slip, slip)
    heading = state[2] - tag.mount_heading_rad
    c, s = np.cos(heading), np.sin(heading)
    offset = np.array([[c, -s], [s, c]]) @ np.array(tag.offset_body_m)
    lever = np.eye(3)
    lever[:2, 2] = [offset[1], -offset[0]]
    return Pose(
        float(state[0] - offset[0]),
        float(state[1] - offset[1]),
        wrap(float(heading)),
        lever @ covariance @ lever.T,
        capture_s,
        float(state[3]),
        float(np.sqrt(np.mean(left**2) * 2)),
    )


def _corners(calibration: Calibration, square: Array, state: Array) -> Array:
    """(8,) undistorted pixels of the tag's corners at x, y, heading and size of the tag."""
    c, s = np.cos(state[2]), np.sin(state[2])
    turned = state[3] * square @ np.array([[c, s], [-s, c]])
    return calibration.pixels(state[:2] + turned).ravel()


def tag_place(calibration: Calibration, x_m: float, y_m: float, heading_rad: float) -> Array:
    """(3,) centre and heading of the tag of a robot at a pose; the inverse of ``solve_pose``'s end."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    offset = np.array([[c, -s], [s, c]]) @ np.array(calibration.tag.offset_body_m)
    return np.array([x_m + offset[0], y_m + offset[1], heading_rad + calibration.tag.mount_heading_rad])
