"""Effects of the distribution of the body's mass.

The motion of a rigid frame depends on its mass, its centre of mass and its moment of inertia. The rods
reproduce these three by a uniform outline and one mass point on massless spokes: a share S of the mass at a
position p from the outline's centre. With the outline's radius of gyration k, the centre of mass is at S p,
and the moment of inertia about the outline's centre is (1 - S) + S p^2 / k^2 of that of the bare outline.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from frogkick.core.poses import Fix, rotate
from frogkick.effects.base import Effect, Parameter
from frogkick.robot import Robot
from frogkick.robot.shape import Frame, Limb

_LEAST_INERTIA = 0.02
"""Lower bound of the moment of inertia about the centre of mass, as a share of the outline's."""


def gyration_m(frame: Frame) -> float:
    """Return the radius of gyration of a frame's bare outline about the mean of its corners."""
    corners = np.array(frame.corners_m) - np.mean(frame.corners_m, axis=0)
    squares, whole = 0.0, 0.0
    for a, b in pairwise([*corners, corners[0]]):
        length = float(np.hypot(*(b - a)))
        squares += length * float(a @ a + a @ b + b @ b) / 3.0
        whole += length
    return math.sqrt(squares / whole)


def with_inertia(frame: Frame, moved_m: tuple[float, float], share: float) -> Frame:
    """Return a frame with another distribution of its mass.

    Args:
        frame: the frame, which may have a mass point already.
        moved_m: displacement of its centre of mass, body frame.
        share: share by which its moment of inertia about the outline's centre is reduced.
    """
    k = gyration_m(frame)
    had, at = frame.centre_mass_share, np.array(frame.centre_mass_at_m)
    centre = had * at + np.array(moved_m)
    inertia = (1.0 - share) * ((1.0 - had) + had * float(at @ at) / k**2)
    apart = float(centre @ centre) / k**2
    # The root S, between 0 and 1, of S p = centre and (1 - S) + S p^2 / k^2 = inertia.
    less = 1.0 - max(inertia, apart + _LEAST_INERTIA)
    point = 0.5 * (less + math.sqrt(less * less + 4.0 * apart))
    if point < 1e-9:
        return replace(frame, centre_mass_share=0.0, centre_mass_at_m=(0.0, 0.0))
    x, y = (centre / point).tolist()
    return replace(frame, centre_mass_share=point, centre_mass_at_m=(x, y))


class CentreMass(Effect):
    """A body whose mass is not on its outline: a filled frame turns more easily than a hoop."""

    name = "centre_mass"
    about = "a share of the frame's mass in motion sits at its centre, where it resists no turn"
    shown_by = "how far single strokes of one side turn the robot, against how far they push it"
    parameters = (Parameter("share", "1", 0.0, 0.95, 0.0, "of the mass that the model has on the outline"),)

    share: float

    def robot(self, robot: Robot) -> Robot:
        return replace(robot, frame=with_inertia(robot.frame, (0.0, 0.0), self.share))


class OffCentreMass(Effect):
    """Batteries or electronics that are not balanced: the body turns about another point than its middle.

    Forces of limbs through the old centre of mass then turn the body, and so does the drag of the frame. The
    moment of inertia about the middle stays. A camera still sees the tag, which keeps its place on the frame.
    """

    name = "off_centre_mass"
    about = "the centre of mass, with the water taken along, lies beside where the model has it"
    shown_by = "turns of strokes that push straight, and the opposite turn while the robot glides"
    parameters = (
        Parameter("forward_m", "m", -0.015, 0.015, 0.0, "centre of mass in front of where the model has it"),
        Parameter("left_m", "m", -0.015, 0.015, 0.0, "centre of mass left of it"),
    )

    forward_m: float
    left_m: float

    def robot(self, robot: Robot) -> Robot:
        frame, limbs = frame_mass_kg(robot.frame), sum(limb_mass_kg(limb) for limb in robot.limbs)
        whole = (frame + limbs) / frame
        moved = (whole * self.forward_m, whole * self.left_m)
        return replace(robot, frame=with_inertia(robot.frame, moved, 0.0))

    def fix(self, fix: Fix, rng: np.random.Generator) -> Fix:
        x_m, y_m = rotate(fix.heading_rad, self.forward_m, self.left_m)
        fix.x_m -= x_m
        fix.y_m -= y_m
        return fix


def frame_mass_kg(frame: Frame) -> float:
    """Return the mass of a frame, including added mass."""
    around = [*frame.corners_m, frame.corners_m[0]]
    outline_m = sum(math.dist(a, b) for a, b in pairwise(around))
    return outline_m * (frame.mass_per_length_kg_per_m + frame.added_mass_per_length_kg_per_m)


def limb_mass_kg(limb: Limb) -> float:
    """Return the mass of a limb, including added mass."""
    return limb.length_m * (limb.mass_per_length_kg_per_m + limb.added_mass_per_length_kg_per_m)
