"""Scenes for the tests of vision: a pool of 1.2 m at 640 x 480 pixels, seen from the side of its middle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from frogkick.core.poses import wrap_angle
from frogkick.vision.board import calibrate_corners
from frogkick.vision.calibration import Calibration, Tag
from frogkick.vision.scene import Conditions, Scene, Thing
from frogkick.vision.sources import Frame
from frogkick.vision.tags import tag_cells, tag_count, tag_white
from frogkick.vision.tracker import Observation, Tracker


class Told(np.random.Generator):
    """A random generator that remembers by how much the tag of the last picture was lifted.

    Attributes:
        heave: in standard deviations: a scene draws it as the only single number of a normal distribution.
    """

    def __init__(self, seed: int) -> None:
        super().__init__(np.random.PCG64(seed))
        self.heave = 0.0

    def standard_normal(self, size: Any = None, *more: Any, **named: Any) -> Any:
        drawn = super().standard_normal(size, *more, **named)
        if size is None:
            self.heave = float(drawn)
        return drawn


def aside(of: Scene, place_m: tuple[float, float]) -> npt.NDArray[np.float64]:
    """(2,) m by which the camera sees a place shifted, for each m of heave."""
    camera = of.view.place_m
    return np.asarray((np.array(place_m) - camera[:2]) / (camera[2] - of.tag_height_m))


def scene(**conditions: float) -> Scene:
    """The usual scene with some disturbances."""
    return Scene(conditions=Conditions(**conditions))


def calibration(of: Scene, **tag: float) -> Calibration:
    """The calibration of ``camera calibrate`` from the four corners and the camera's height."""
    described = Tag(family=of.family, id=of.tag_id, size_m=of.tag_size_m, height_m=of.tag_height_m, **tag)
    height = float(of.view.place_m[2])
    return calibrate_corners(of.corners_px(), of.pool_m, of.view.image_px, described, 0.0, height)


def drawn_pose(of: Scene, rng: np.random.Generator) -> tuple[float, float, float]:
    """A random pose at least a tag's width from the walls, with any heading."""
    edge = of.tag_size_m
    return (
        float(rng.uniform(edge, of.pool_m[0] - edge)),
        float(rng.uniform(edge, of.pool_m[1] - edge)),
        float(rng.uniform(-np.pi, np.pi)),
    )


def errors(
    of: Scene, poses: int, rng: np.random.Generator
) -> tuple[npt.NDArray[np.float64], list[Observation]]:
    """Look for tags at random poses, each in the whole frame.

    Returns:
        (found, 3) errors in x and y, m, and heading, rad; and every observation.
    """
    tracker = Tracker(calibration(of))
    off, seen = [], []
    for _ in range(poses):
        truth = drawn_pose(of, rng)
        tracker.forget()
        one = tracker.observe(of.picture(truth, rng))
        seen.append(one)
        if one.pose is not None:
            pose = one.pose
            off.append([pose.x_m - truth[0], pose.y_m - truth[1], wrap_angle(pose.heading_rad - truth[2])])
    return np.array(off).reshape(-1, 3), seen


def scene_frames(
    scene: Scene,
    pose_at: Callable[[float], tuple[float, float, float] | None],
    rng: np.random.Generator,
    rate_hz: float = 30.0,
) -> Iterator[Frame]:
    """Rendered frames, without end.

    Args:
        scene: pool, camera, tag.
        pose_at: time, s -> x_m, y_m, heading_rad of the tag; None: no tag.
        rng: source of noise, waves, glare.
        rate_hz: frames per second of the time in ``capture_s``.
    """
    sequence = 0
    while True:
        capture = sequence / rate_hz
        yield Frame(scene.picture(pose_at(capture), rng), capture, sequence, False)
        sequence += 1


def clutter(scene: Scene, rng: np.random.Generator) -> list[Thing]:
    """Prints that are not the tag: random cells, other tags, its mirror image, its negative, chessboards."""
    own = tag_cells(scene.family, scene.tag_id)
    things: list[Thing] = []
    for _ in range(int(rng.integers(1, 7))):
        kind = int(rng.integers(5))
        if kind == 0:
            cells = _random_cells(own, scene.family, rng)
        elif kind == 1:
            tags = tag_count(scene.family)
            cells = tag_cells(scene.family, (scene.tag_id + int(rng.integers(1, tags))) % tags)
        elif kind == 2:
            cells = own[:, ::-1]
        elif kind == 3:
            cells = 1 - own
        else:
            cells = np.pad((np.indices((8, 8)).sum(axis=0) % 2).astype(np.float32), 1, constant_values=1)
        x, y = rng.uniform(0, scene.pool_m[0]), rng.uniform(0, scene.pool_m[1])
        size = scene.tag_size_m * rng.uniform(0.7, 1.6)
        things.append((np.ascontiguousarray(cells), x, y, rng.uniform(-np.pi, np.pi), size))
    return things


def _random_cells(
    own: npt.NDArray[np.float32], family: str, rng: np.random.Generator
) -> npt.NDArray[np.float32]:
    """A tag's frame with random cells where its code is."""
    if tag_white(family):
        return np.pad(np.pad(rng.integers(0, 2, (6, 6)), 1), 1, constant_values=1).astype(np.float32)
    cells = rng.integers(0, 2, own.shape).astype(np.float32)
    cells[1:-1, 1:-1] = 0.0
    cells[2:-2, 2:-2] = 1.0
    cells[3:-3, 3:-3] = rng.integers(0, 2, (3, 3))
    return cells
