"""From a tag's corners in a picture to the robot's pose in the pool's frame, with covariance.

The tag is a flat square at a known height: eight coordinates determine four numbers, one of them its size.
The other four show whether it is a square, and the size whether it is the printed tag.

Water tilts the tag. Seen from the side, a slope shears its picture and so turns it: half a metre beside a
camera 1 m above, 0.02 rad of slope are half a degree of heading. The two slopes are estimated with a prior of
calm water from the same shear, which also makes the picture less of a square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.poses import rotation, wrap_angle
from frogkick.vision.calibration import Calibration, Tag

FLOOR_PX = 0.02
"""Smallest standard deviation of a corner, by lens, print and pixels."""


@dataclass(frozen=True)
class Pose:
    """A pose of the robot."""

    # x_m, y_m: pool frame
    x_m: float
    y_m: float
    heading_rad: float  # from +x, counter-clockwise, in (-pi, pi]
    # (3, 3) of x_m, y_m, heading_rad, by the picture's noise and the tag's height, without the calibration's
    # error
    covariance: Float64
    size_m: float  # estimated size of the tag
    misfit_px: float  # root mean square distance of the corners from those of the flat square


def solve_pose(calibration: Calibration, corners_px: Float64, covariance_px2: Float64) -> Pose | None:
    """The pose with the least weighted residuals of the corners.

    Args:
        corners_px: (4, 2) pixels of the picture in the printed picture's order (``tags``).
        covariance_px2: (8, 8) of these.

    Returns:
        None for corners that cannot be those of a tag seen from above (mirrored, folded, beyond the horizon).
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
    weight = np.asarray(np.linalg.inv(covariance_px2 + FLOOR_PX**2 * np.eye(8)), dtype=np.float64)
    flat = _fitted(calibration, square, state, seen_px, weight, 4)
    if flat is None:
        return None
    state, _, left = flat
    misfit_px = float(np.sqrt(np.mean(left**2) * 2))
    sloped = calibration.camera_m is not None and tag.tilt_sd_rad > 0.0
    found = _fitted(calibration, square, np.append(state, np.zeros(2 if sloped else 0)), seen_px, weight, 2)
    if found is None:
        return None
    state, information, left = found
    spread = float(left @ weight @ left + state @ (_prior(tag, state) * state)) / 4.0
    covariance = np.asarray(np.linalg.inv(information)[:3, :3] * max(1.0, spread), dtype=np.float64)
    if calibration.camera_m is not None:
        # A tag that is higher than stated appears farther from the point below the camera.
        above = calibration.camera_m[2] - tag.apparent_height_m
        slip = tag.height_sd_m * (state[:2] - calibration.camera_m[:2]) / above
        covariance[:2, :2] += np.outer(slip, slip)
    heading = state[2] - tag.mount_heading_rad
    offset = rotation(heading) @ np.array(tag.offset_body_m)
    lever = np.eye(3)
    lever[:2, 2] = [offset[1], -offset[0]]
    return Pose(
        float(state[0] - offset[0]),
        float(state[1] - offset[1]),
        float(wrap_angle(heading)),
        lever @ covariance @ lever.T,
        float(state[3]),
        misfit_px,
    )


def _prior(tag: Tag, state: Float64) -> Float64:
    """Weights of a prior of calm water: of the slopes, if the state has them."""
    prior = np.zeros(len(state))
    prior[4:] = 1.0 / max(tag.tilt_sd_rad, 1e-9) ** 2
    return prior


def _fitted(
    calibration: Calibration, square: Float64, state: Float64, seen_px: Float64, weight: Float64, steps: int
) -> tuple[Float64, Float64, Float64] | None:
    """State, information matrix and residuals after some Gauss-Newton steps; None if they diverge.

    Args: square (4, 2) printed corners, state see ``_corners``, seen_px (4, 2) undistorted, weight (8, 8).
    """
    prior = _prior(calibration.tag, state)
    for _ in range(steps):
        expected = _corners(calibration, square, state)
        jacobian = np.empty((8, len(state)))
        for k, step in enumerate((1e-4, 1e-4, 1e-3, 1e-4, 1e-3, 1e-3)[: len(state)]):
            moved = state.copy()
            moved[k] += step
            jacobian[:, k] = (_corners(calibration, square, moved) - expected) / step
        information = jacobian.T @ weight @ jacobian + np.diag(prior)
        gradient = jacobian.T @ weight @ (seen_px.ravel() - expected) - prior * state
        state = state + np.linalg.solve(information, gradient)
        if not np.isfinite(state).all():
            return None
    return state, np.asarray(information), seen_px.ravel() - _corners(calibration, square, state)


def _corners(calibration: Calibration, square: Float64, state: Float64) -> Float64:
    """(8,) undistorted pixels of the tag's corners at x, y, heading, size of the tag, and slopes if any."""
    turned = state[3] * square @ rotation(state[2]).T
    places = state[:2] + turned
    if len(state) > 4 and calibration.camera_m is not None:
        # A corner that is higher than the tag's middle appears farther from the point below the camera.
        rise = turned @ state[4:]
        above = calibration.camera_m[2] - calibration.tag.apparent_height_m
        places = places + (places - calibration.camera_m[:2]) * (rise / (above - rise))[:, None]
    return calibration.pixels(places).ravel()


def tag_place(calibration: Calibration, x_m: float, y_m: float, heading_rad: float) -> Float64:
    """(3,) centre and heading of the tag of a robot at a pose."""
    offset = rotation(heading_rad) @ np.array(calibration.tag.offset_body_m)
    return np.array([x_m + offset[0], y_m + offset[1], heading_rad + calibration.tag.mount_heading_rad])
