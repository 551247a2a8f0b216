"""Rendered pictures of a pool with a known pose: perspective, lens, blur, noise, light, glare, waves, prints.

The renderer is independent of the calibration's maps: it traces the ray of each pixel from a pinhole to the
tag, tilted and heaved by waves, or to the water, and averages the tag's cells over the pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from frogkick.core.arrays import Float32, Float64, UInt8
from frogkick.core.errors import InputError
from frogkick.vision.tags import tag_cells, tag_margin

Thing = tuple[Float32, float, float, float, float]
"""A print: (n, n) cells (0 black, 1 white), x_m, y_m, heading_rad, side (m) without the outermost ring."""


@dataclass(frozen=True)
class Viewpoint:
    """A pinhole camera over the pool."""

    image_px: tuple[int, int]  # width, height
    matrix_px: Float64  # (3, 3) camera matrix
    rotation: Float64  # (3, 3) pool to camera: x right, y down, z forward
    place_m: Float64  # (3,) in the pool's frame
    distortion: Float64  # (5,) k1, k2, p1, p2, k3 of OpenCV's model

    @property
    def px_per_m(self) -> float:
        """Pixels per metre straight below the camera."""
        return float(self.matrix_px[0, 0] / self.place_m[2])

    def pixels(self, points_m: Float64) -> Float64:
        """(n, 2) pixels, lens included, of (n, 3) points of the pool's frame."""
        turn, _ = cv2.Rodrigues(self.rotation)
        shift = -self.rotation @ self.place_m
        seen, _ = cv2.projectPoints(points_m, turn, shift, self.matrix_px, self.distortion)
        return np.asarray(seen.reshape(-1, 2), dtype=np.float64)

    def rays(self, pixels: Float64) -> Float64:
        """(n, 3) directions in the pool's frame of (n, 2) pixels."""
        flat = pixels
        if self.distortion.any():
            criteria = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 20, 1e-9)
            points = np.ascontiguousarray(pixels).reshape(-1, 1, 2)
            undistorted = cv2.undistortPointsIter(
                points, self.matrix_px, self.distortion, np.eye(3), self.matrix_px, criteria
            )
            flat = np.asarray(undistorted, dtype=np.float64).reshape(-1, 2)
        turned = np.linalg.inv(self.matrix_px).T @ self.rotation
        return np.asarray(flat[:, :1] * turned[0] + flat[:, 1:] * turned[1] + turned[2])


def looking_at(
    place_m: tuple[float, float, float] = (0.7, 0.25, 1.35),
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0),
) -> Viewpoint:
    """A camera of 640 x 480 square pixels at a place, aimed at the middle of the water, x to the right.

    ``distortion`` is k1, k2, p1, p2, k3 of its lens.
    """
    width, height, focal_px = 640, 480, 640.0
    matrix = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1.0]])
    forward = np.array([0.6, 0.45, 0.0]) - place_m
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Viewpoint((width, height), matrix, rotation, np.array(place_m), np.array(distortion))


@dataclass(frozen=True)
class Conditions:
    """Disturbances of a picture."""

    blur_px: float = 0.6  # standard deviation of the lens's blur
    noise: float = 2.0  # standard deviation of each pixel, grey levels of 255
    light_slope: float = 0.2  # relative loss of brightness from the picture's right to its left
    glare: int = 0  # number of blobs of sunlight on the water
    glare_on_tag: float = 0.0  # brightness of a blob at the tag's side, 0 to 1
    wave_height_m: float = 0.0  # standard deviation of the tag's heave, which also tilts it
    wave_length_m: float = 0.3  # of the waves; determines the tilt
    ripple_px: float = 0.0  # amplitude of the displacement of the tag's picture by ripples
    cover: float = 0.0  # part of the tag's side that is covered
    # black, white: grey levels of the tag's ink and paper
    black: float = 45.0
    white: float = 200.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("blur_px", 0.0, 20.0), ("noise", 0.0, 100.0), ("light_slope", 0.0, 0.9), ("glare", 0, 50),
            ("glare_on_tag", 0.0, 1.0), ("wave_height_m", 0.0, 0.05), ("wave_length_m", 0.02, 10.0),
            ("ripple_px", 0.0, 20.0), ("cover", 0.0, 1.0), ("black", 0.0, 255.0), ("white", 0.0, 255.0),
        ):  # fmt: skip
            if not low <= getattr(self, name) <= high:
                raise InputError(f"scene {name} is {getattr(self, name)}, allowed is {low} to {high}")


@dataclass(frozen=True)
class Scene:
    """A pool, a camera and a tag."""

    view: Viewpoint = field(default_factory=looking_at)  # the camera
    pool_m: tuple[float, float] = (1.2, 0.9)  # length, width
    family: str = "tag36h11"  # of the tag
    tag_id: int = 0  # of the tag
    tag_size_m: float = 0.047  # side of the square that is its size (``tag_margin``)
    tag_height_m: float = 0.012  # of its face over the still water
    conditions: Conditions = field(default_factory=Conditions)  # disturbances of the pictures

    def corners_px(self) -> Float64:
        """(4, 2) pixels of the pool's corners: origin, along x, opposite, along y."""
        length, width = self.pool_m
        return self.view.pixels(np.array([[0, 0, 0], [length, 0, 0], [length, width, 0], [0, width, 0.0]]))

    @cached_property
    def still(self) -> Float32:
        """(height, width) grey levels of the pool alone: tiles, walls, a floor beyond."""
        width, height = self.view.image_px
        cols, rows = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        rays = self.view.rays(np.stack([cols.ravel(), rows.ravel()], axis=1))
        place = self.view.place_m
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(rays[:, 2] < 0, -place[2] / rays[:, 2], np.inf)
            x, y = (place[i] + far * rays[:, i] for i in (0, 1))
            inside = (x >= 0) & (x <= self.pool_m[0]) & (y >= 0) & (y <= self.pool_m[1])
            rim = (x > -0.03) & (x < self.pool_m[0] + 0.03) & (y > -0.03) & (y < self.pool_m[1] + 0.03)
            tiles = 115 + 8 * np.sign(np.sin(x * np.pi / 0.1) * np.sin(y * np.pi / 0.1))
            level = np.where(inside, tiles, np.where(rim, 165.0, 70.0))
        return np.nan_to_num(level, nan=70.0).reshape(height, width).astype(np.float32)

    def picture(
        self, pose: tuple[float, float, float] | None, rng: np.random.Generator, extra: Sequence[Thing] = ()
    ) -> UInt8:
        """Render a frame.

        Args:
            pose: x_m, y_m, heading_rad of the tag, the heading towards its printed top; None: no tag.
            rng: for noise, waves, glare.
            extra: further prints.

        Returns:
            (height, width) grey levels.
        """
        c = self.conditions
        level = self.still.copy()
        ripple = self._surface(rng)
        if c.wave_height_m or c.ripple_px:
            level += 14 * ripple
        things = [*extra]
        if pose is not None:
            things.append(self.print_of(self.tag_id, pose, self.tag_size_m))
        for thing in things:
            self._print(level, thing, rng)
        width, height = self.view.image_px
        spots = [(rng.uniform(0, width), rng.uniform(0, height), 1.0) for _ in range(c.glare)]
        if pose is not None and c.glare_on_tag:
            way = rng.uniform(0, 2 * np.pi)
            x, y = np.array(pose[:2]) + 0.4 * self.tag_size_m * np.array([np.cos(way), np.sin(way)])
            spots.append((*self.view.pixels(np.array([[x, y, self.tag_height_m]]))[0], c.glare_on_tag))
        for x, y, strength in spots:
            _glare(level, x, y, strength, rng)
        if c.light_slope:
            level *= np.linspace(1 - c.light_slope, 1, width, dtype=np.float32)
        if c.blur_px:
            level = np.asarray(cv2.GaussianBlur(level, (0, 0), c.blur_px), dtype=np.float32)
        if c.noise:
            level += c.noise * rng.standard_normal(level.shape, dtype=np.float32)
        return np.clip(np.rint(level), 0, 255).astype(np.uint8)

    def print_of(self, tag_id: int, pose: tuple[float, float, float], size_m: float) -> Thing:
        """A tag of the scene's family for ``extra``; ``size_m`` as in ``tag_size_m``."""
        cells = tag_cells(self.family, tag_id)
        wide = len(cells)
        return (cells, *pose, size_m * (wide - 2) / (wide - 2 * tag_margin(self.family)))

    def _surface(self, rng: np.random.Generator) -> Float32:
        """A random surface of unit deviation over the picture, with the length of the waves."""
        width, height = self.view.image_px
        long_px = max(4.0, self.conditions.wave_length_m * self.view.px_per_m / 3)
        small = rng.standard_normal((int(height / long_px) + 3, int(width / long_px) + 3), dtype=np.float32)
        return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.float32)

    def _print(self, level: Float32, thing: Thing, rng: np.random.Generator) -> None:
        """Draw a printed square with its white edge; each pixel is the mean of 5 x 5 rays."""
        cells, x, y, heading, size = thing
        c = self.conditions
        heave = c.wave_height_m * rng.standard_normal()
        tilt = 2 * np.pi * c.wave_height_m / c.wave_length_m * rng.standard_normal(2)
        normal = np.array([-tilt[0], -tilt[1], 1.0]) / np.sqrt(1 + tilt @ tilt)
        top = np.array([np.cos(heading), np.sin(heading), 0.0])
        top -= (top @ normal) * normal
        top /= np.linalg.norm(top)
        left = np.cross(normal, top)
        centre = np.array([x, y, self.tag_height_m + heave])
        half = size / 2 * len(cells) / (len(cells) - 2)
        ends = self.view.pixels(centre + half * np.array([top + left, top - left, -top - left, left - top]))
        height, width = level.shape
        low = np.maximum(np.floor(ends.min(axis=0)) - 2, 0).astype(int)
        high = np.minimum(np.ceil(ends.max(axis=0)) + 3, [width, height]).astype(int)
        if (high <= low).any():
            return
        fine = 5
        part = (np.arange(fine) + 0.5) / fine - 0.5
        us = (np.arange(low[0], high[0])[:, None] + part).ravel()
        vs = (np.arange(low[1], high[1])[:, None] + part).ravel()
        grid = np.stack(np.meshgrid(us, vs), axis=-1).reshape(-1, 2)
        if c.ripple_px:
            phase = rng.uniform(0, 2 * np.pi, 2)
            wave = 2 * np.pi / max(4.0, c.wave_length_m * self.view.px_per_m)
            grid = grid + c.ripple_px * np.sin(wave * grid[:, ::-1] + phase)
        rays = self.view.rays(grid)
        place = self.view.place_m
        hits = place + rays * (((centre - place) @ normal) / _dot(rays, normal))[:, None] - centre
        up, side = (_dot(hits, axis) for axis in (top, left))
        row = np.floor((half - up) / (2 * half) * len(cells)).astype(int)
        col = np.floor((half - side) / (2 * half) * len(cells)).astype(int)
        on = (row >= 0) & (row < len(cells)) & (col >= 0) & (col < len(cells))
        ink = cells[np.where(on, row, 0), np.where(on, col, 0)]
        colour = c.black + (c.white - c.black) * ink
        if c.cover:
            colour = np.where(side > half * (1 - 2 * c.cover), 90.0, colour)
        shape = (len(vs) // fine, fine, len(us) // fine, fine)
        share = on.reshape(shape).mean(axis=(1, 3))
        drawn = (colour * on).reshape(shape).mean(axis=(1, 3))
        region = level[low[1] : high[1], low[0] : high[0]]
        region[:] = region * (1 - share) + drawn


def _dot(rows: Float64, axis: Float64) -> Float64:
    """rows @ axis, without the threads of a matrix product."""
    return np.asarray(rows[:, 0] * axis[0] + rows[:, 1] * axis[1] + rows[:, 2] * axis[2])


def _glare(level: Float32, x_px: float, y_px: float, strength: float, rng: np.random.Generator) -> None:
    """Add an ellipse of light that saturates in its middle."""
    height, width = level.shape
    long, short = rng.uniform(8, 30), rng.uniform(3, 10)
    turn = rng.uniform(0, np.pi)
    reach = int(3 * long)
    c0, c1 = max(0, int(x_px) - reach), min(width, int(x_px) + reach)
    r0, r1 = max(0, int(y_px) - reach), min(height, int(y_px) + reach)
    if c1 <= c0 or r1 <= r0:
        return
    cols, rows = np.meshgrid(np.arange(c0, c1) - x_px, np.arange(r0, r1) - y_px)
    along = cols * np.cos(turn) + rows * np.sin(turn)
    across = rows * np.cos(turn) - cols * np.sin(turn)
    blob = 320 * strength * np.exp(-0.5 * ((along / long) ** 2 + (across / short) ** 2))
    level[r0:r1, c0:c1] = np.minimum(level[r0:r1, c0:c1] + blob, 255)
