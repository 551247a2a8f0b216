"""Poses and motions in the plane, SE(2), and position fixes: m, rad from +x, counter-clockwise."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from frogkick.core.arguments import typed
from frogkick.core.arrays import Float32, Float64


@dataclass(slots=True)
class Fix:
    """A position fix of a camera or a tracker. Effects may change it before it arrives.

    Attributes:
        capture_s: time at which the picture was taken, on the receiver's clock.
        delay_s: from then to its arrival at the robot.
        x_m, y_m, heading_rad: the robot's pose, world frame.
        sequence: number of the fix, wraps at 65,536.
    """

    capture_s: float
    delay_s: float
    x_m: float
    y_m: float
    heading_rad: float
    sequence: int = field(default=0, kw_only=True)

    @property
    def arrival_s(self) -> float:
        """Time of arrival at the robot, on the clock of ``capture_s``."""
        return self.capture_s + self.delay_s

    @property
    def pose_world(self) -> Float32:
        """(3,) x_m, y_m, heading_rad in float32, as in the link's frames."""
        return np.array([self.x_m, self.y_m, self.heading_rad], dtype=np.float32)


@dataclass(frozen=True)
class PredictionError:
    """Root-mean-square error of ``count`` predicted poses; NaN if it is unknown."""

    position_rmse_m: float = math.nan
    heading_rmse_rad: float = math.nan
    count: int = 0

    @classmethod
    def of(cls, gap: Float64) -> PredictionError:
        """Return the error of (n, 3) residuals: measured minus predicted poses, headings wrapped.

        Rows with a NaN are left out.
        """
        known = gap[np.isfinite(gap).all(axis=1)]
        if not len(known):
            return cls()
        return cls(
            float(np.sqrt((known[:, :2] ** 2).sum(axis=1).mean())),
            float(np.sqrt((known[:, 2] ** 2).mean())),
            len(known),
        )

    @property
    def pair(self) -> tuple[float, float]:
        """The errors of position (m) and heading (rad)."""
        return self.position_rmse_m, self.heading_rmse_rad

    def as_json(self) -> dict[str, float]:
        """Its keys in the JSON of commands."""
        return {"position_rmse_m": self.position_rmse_m, "heading_rmse_rad": self.heading_rmse_rad}

    def __str__(self) -> str:
        return f"{self:.2f}"

    def __format__(self, spec: str) -> str:
        place, turn = 1e3 * self.position_rmse_m, math.degrees(self.heading_rmse_rad)
        return f"{place:{spec or '.2f'}} mm and {turn:{spec or '.2f'}} degrees"


@typed
def wrap_angle(angle_rad: ArrayLike) -> Float64:
    """Wrap angles to (-pi, pi], in float64, in the shape given."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    wrapped = np.pi - np.mod(np.pi - angle, 2.0 * np.pi)
    # mod may round up to its divisor: such an angle is -pi, which belongs to +pi.
    return np.where(wrapped <= -np.pi, np.pi, wrapped)


def rotation(heading_rad: float) -> Float64:
    """Return the (2, 2) matrix that rotates a vector from the body frame to the world frame."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([[c, -s], [s, c]])


def rotate(heading_rad: float, x: float, y: float) -> tuple[float, float]:
    """Rotate a vector from the body frame to the world frame; with the negative heading, back."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return c * x - s * y, s * x + c * y


def world_from_body(heading_rad: ArrayLike, vector_body: Float64) -> Float64:
    """Rotate vectors from the body frames to the world frame.

    Args:
        heading_rad: (..) headings of the bodies.
        vector_body: (.., 2) x, y, or (.., 3) with an angle or a turn rate, which is not changed.
    """
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    x, y, *turn = np.moveaxis(vector_body, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, *turn], axis=-1)


def body_from_world(heading_rad: ArrayLike, vector_world: Float64) -> Float64:
    """Rotate vectors from the world frame to the body frames; see ``world_from_body``."""
    return world_from_body(np.negative(heading_rad), vector_world)


def compose(pose: Float64, motion_body: Float64) -> Float64:
    """Return (.., 3) poses after motions (.., 3) in their body frames; the heading is not wrapped."""
    return pose + world_from_body(pose[..., 2], motion_body)


def relative(origin: Float64, pose: Float64) -> Float64:
    """Return poses in the frames of ``origin``, (.., 3), the inverse of ``compose``; not wrapped."""
    return body_from_world(origin[..., 2], pose - origin)
