"""Mirror symmetry of a robot, left to right, which saves half of its simulations."""

from __future__ import annotations

import math
from dataclasses import dataclass

from frogkick.robot.model import Robot
from frogkick.robot.shape import Frame, Limb

_CLOSE = 1e-12  # relative to the frame, and in radians: rounding of decimal numbers in a file


@dataclass(frozen=True)
class Mirror:
    """The mirroring: limb i becomes limb limbs[i], action a becomes action actions[a]."""

    limbs: tuple[int, ...]
    actions: tuple[int, ...]


def mirror_of(robot: Robot) -> Mirror | None:
    """The mirroring of a robot; None if its frame, limbs, actions or library box are not symmetric.

    A robot with effects counts as not symmetric.
    """
    if robot.effects:
        return None
    corners = _mirrored_corners(robot.frame)
    box = robot.library_box
    if corners is None or any(low != -high for low, high in (box.left_mps, box.omega_rad_s)):
        return None
    limbs: list[int] = []
    for limb in robot.limbs:
        found = [i for i, other in enumerate(robot.limbs) if _are_mirrored(limb, other, corners)]
        if len(found) != 1:
            return None
        limbs.append(found[0])

    def turned(mask: int) -> int:
        return sum(1 << limbs[i] for i in range(len(limbs)) if mask >> i & 1)

    masks = [(action.first_mask, action.second_mask) for action in robot.actions]
    mirrored = [(turned(first), turned(second)) for first, second in masks]
    if len(set(masks)) != len(masks) or set(masks) != set(mirrored):
        return None
    return Mirror(tuple(limbs), tuple(masks.index(pair) for pair in mirrored))


def _mirrored_corners(frame: Frame) -> list[int] | None:
    """The mirror image of each corner; None if the frame is not symmetric."""
    count = len(frame.corners_m)
    scale = _CLOSE * max(math.hypot(*corner) for corner in frame.corners_m)
    opposite: list[int] = []
    for x, y in frame.corners_m:
        near = [i for i, (u, v) in enumerate(frame.corners_m) if math.hypot(u - x, v + y) <= scale]
        if len(near) != 1:
            return None
        opposite.append(near[0])
    for i in range(count):  # edge i, from corner i to the next, comes out as the edge before opposite[i]
        edge = (opposite[i] - 1) % count
        if opposite[(i + 1) % count] != edge or frame.segments[i] != frame.segments[edge]:
            return None
    return opposite


def _are_mirrored(one: Limb, other: Limb, corners: list[int]) -> bool:
    turned = math.remainder(one.direction_rad + other.direction_rad, 2.0 * math.pi)
    return (
        corners[one.corner] == other.corner
        and one.clamp != other.clamp
        and abs(turned) <= _CLOSE * 10.0
        and one.rest_curvature_per_m == -other.rest_curvature_per_m
        and all(
            getattr(one, name) == getattr(other, name)
            for name in Limb.__dataclass_fields__
            if name not in ("name", "corner", "clamp", "direction_rad", "rest_curvature_per_m")
        )
    )
