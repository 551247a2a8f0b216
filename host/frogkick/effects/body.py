"""Effects of the body: the distribution of its mass, and its construction beyond what the drawing contains.

The motion of a rigid frame depends on its mass, its centre of mass and its moment of inertia. The rods
reproduce these three by a uniform outline and one mass point on massless spokes: a share S of the mass at a
position p from the outline's centre. With the outline's radius of gyration k, the centre of mass is at S p,
and the moment of inertia about the outline's centre is (1 - S) + S p^2 / k^2 of that of the bare outline.

Added mass, drag and thrust of the limbs are confounded in a single run, and only many runs distinguish them.
So a search does not test the effects with ``joint_only`` one at a time. It fits them jointly, and starts from
the values of a robot that was calibrated before (see ``frogkick.identification.calibrated``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from frogkick.core.arrays import dot
from frogkick.core.poses import Fix, rotate
from frogkick.effects.base import Body, Effect, History, Stroke, parameter
from frogkick.effects.limbs import GroupEffect
from frogkick.effects.water import scaled, times_drag, times_mass
from frogkick.robot import Limb, Robot
from frogkick.robot.schema import Frame

_FATIGUE_STROKES = 24  # strokes of a limb that count; the effect of older ones has faded


_LEAST_INERTIA = 0.02
"""Lower bound of the moment of inertia about the centre of mass, as a share of the outline's."""


def gyration_m(frame: Frame) -> float:
    """Return the radius of gyration of a frame's bare outline about the mean of its corners."""
    corners = np.array(frame.corners_m) - np.mean(frame.corners_m, axis=0)
    squares, whole = 0.0, 0.0
    for a, b in pairwise([*corners, corners[0]]):
        length = float(np.hypot(*(b - a)))
        squares += length * (dot(a, a) + dot(a, b) + dot(b, b)) / 3.0
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
    inertia = (1.0 - share) * ((1.0 - had) + had * dot(at, at) / k**2)
    apart = dot(centre, centre) / k**2
    # The root S, between 0 and 1, of S p = centre and (1 - S) + S p^2 / k^2 = inertia.
    less = 1.0 - max(inertia, apart + _LEAST_INERTIA)
    point = 0.5 * (less + math.sqrt(less * less + 4.0 * apart))
    if point < 1e-9:
        return replace(frame, centre_mass_share=0.0, centre_mass_at_m=(0.0, 0.0))
    x, y = (centre / point).tolist()
    return replace(frame, centre_mass_share=point, centre_mass_at_m=(x, y))


def frame_mass_kg(frame: Frame) -> float:
    """Return the mass of a frame, including added mass."""
    around = [*frame.corners_m, frame.corners_m[0]]
    outline_m = sum(math.dist(a, b) for a, b in pairwise(around))
    return outline_m * (frame.mass_per_length_kg_per_m + frame.added_mass_per_length_kg_per_m)


def limb_mass_kg(limb: Limb) -> float:
    """Return the mass of a limb, including added mass."""
    return limb.length_m * (limb.mass_per_length_kg_per_m + limb.added_mass_per_length_kg_per_m)


class CentreMass(Effect):
    """A body whose mass is not on its outline: a filled frame turns more easily than a hoop."""

    name = "centre_mass"
    about = "a share of the frame's mass and added mass sits at its centre, where it resists no turn"
    shown_by = "how far single strokes of one side turn the robot, against how far they push it"
    share = parameter("1", 0.0, 0.95, 0.0, "of the mass that the model has on the outline")

    def robot(self, robot: Robot) -> Robot:
        return replace(robot, frame=with_inertia(robot.frame, (0.0, 0.0), self.share))


class OffCentreMass(Effect):
    """Batteries or electronics that are not balanced: the body turns about another point than its middle.

    Forces of limbs through the old centre of mass then turn the body, and so does the drag of the frame. The
    moment of inertia about the middle stays. A camera still sees the tag, which keeps its place on the frame.
    """

    name = "off_centre_mass"
    about = "the centre of mass, added mass included, lies beside where the model has it"
    shown_by = "turns of strokes that push straight, and the opposite turn while the robot glides"
    forward_m = parameter("m", -0.015, 0.015, 0.0, "centre of mass in front of where the model has it")
    left_m = parameter("m", -0.015, 0.015, 0.0, "centre of mass left of it")

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


class Hull(Effect):
    """A body with height and corners has more added mass, and its limbs push more, than in a flat model."""

    name = "hull"
    about = "the frame's mass with added mass and where it sits, and drag of frame and limbs, times factors"
    shown_by = "surge, turn and glide of all strokes together"
    joint_only = True
    mass = parameter("1", 0.2, 6.0, 1.0, "factor on the frame's mass, added mass included")
    centre_share = parameter("1", 0.0, 0.97, 0.0, "share of that mass at the centre")
    frame_drag = parameter("1", 0.05, 4.0, 1.0, "factor on the frame's drag coefficients")
    limb_drag = parameter("1", 0.2, 12.0, 1.0, "factor on the limbs' drag coefficients")

    def robot(self, robot: Robot) -> Robot:
        frame = times_mass(with_inertia(robot.frame, (0.0, 0.0), self.centre_share), self.mass)
        return scaled(replace(robot, frame=frame), times_drag, self.frame_drag, self.limb_drag)


_PLATES = (
    (1.0, 1.25, 1.5, 1.59, 2.0, 2.5, 3.0, 4.0, 5.0, 6.25, 8.0, 10.0),
    (0.579, 0.642, 0.690, 0.704, 0.757, 0.801, 0.830, 0.872, 0.897, 0.917, 0.934, 0.947),
)
"""Aspect ratio of a rectangular plate, and its added mass over that of an equal part of an infinite one.

Source: DNV-RP-C205."""


def plate_mass_kg_per_m(limb: Limb, density_kg_per_m3: float) -> float:
    """Return the water, kg/m, that moves with a limb across itself, as with a flat plate of its size.

    Its height is its drag width. Source: Lamb 1932, article 71: rho pi / 4 h^2 for a long plate; see _PLATES.
    """
    longer, shorter = max(limb.length_m, limb.drag_width_m), min(limb.length_m, limb.drag_width_m)
    if shorter == 0.0:
        return 0.0
    share = float(np.interp(longer / shorter, *_PLATES))
    return share * density_kg_per_m3 * math.pi / 4.0 * shorter**2 * longer / limb.length_m


class LimbPlate(Effect):
    """A limb is a plate: water moves with it across but not along, and its tip sheds some of the momentum.

    For the paper's limbs, 35.5 mm long and 24 mm high, this is 0.31 kg/m, 23 times the added mass of the
    model's round rod, which acts in all directions. See ``frogkick.der.plates`` for the force.
    """

    name = "limb_plate"
    about = "water that moves with limbs across but not along them, and what of it their tips leave behind"
    shown_by = "steady speeds over frequencies and alloys, which differ by how fast limbs curl back"
    joint_only = True
    added = parameter("1", 0.0, 3.0, 0.0, "share of the added mass of a flat plate of that size; theory: 1")
    shedding = parameter("1", 0.0, 2.0, 0.0, "share of its momentum that a tip leaves behind; theory: 1")

    def robot(self, robot: Robot) -> Robot:
        shedding, limbs = self.shedding if self.added > 0.0 else 0.0, []
        for limb in robot.limbs:
            mass = self.added * plate_mass_kg_per_m(limb, robot.water_density_kg_per_m3)
            limbs.append(replace(limb, plate_mass_per_length_kg_per_m=mass, tip_shedding=shedding))
        return replace(robot, limbs=tuple(limbs))


class LimbMount(GroupEffect):
    """Limbs have other directions at their corners than in the drawing: by glue, or by their rest
    curvature."""

    name = "limb_mount"
    about = "limbs whose name has a word in it are turned at their roots, away from straight back"
    shown_by = "how far strokes push aside and turn, against how far they push forward"
    joint_only = True
    outward_deg = parameter("deg", -45.0, 45.0, 0.0, "turn of the root's tangent")

    def robot(self, robot: Robot) -> Robot:
        limbs = []
        for limb in robot.limbs:
            # A root that points back and to the left turns clockwise to point more to the left.
            outward = math.copysign(1.0, math.sin(limb.direction_rad)) * math.radians(self.outward_deg)
            turned = replace(limb, direction_rad=limb.direction_rad - outward)
            limbs.append(turned if self.acts_on(limb.name) else limb)
        return replace(robot, limbs=tuple(limbs))


class LimbFatigue(GroupEffect):
    """A limb that fired often is warm throughout: each earlier stroke reduces this one."""

    name = "limb_fatigue"
    about = "a stroke loses a share for each earlier one of the same limb, fading with the time since"
    shown_by = "the same action after strokes of the same limbs, against after strokes of others"
    joint_only = True
    loss = parameter("1", -0.3, 0.5, 0.0, "share lost for each stroke of just before")
    fade_s = parameter("s", 0.3, 10.0, 2.5, "time in which that falls to 37 %")

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if self.acts_on(stroke.limb):
            earlier = [then for then, limb in history.strokes if limb == stroke.index][-_FATIGUE_STROKES:]
            use = sum(math.exp((then - stroke.time_s) / self.fade_s) for then in earlier)
            stroke.gain *= max(0.0, 1.0 - self.loss * use)
        return stroke


class MunkMoment(Effect):
    """A body whose added mass differs forward and sideways turns while it drifts, which slows it.

    With forward speed u, speed to the left v, turn rate r, and a mass (added mass included) that is larger
    forward by g, Kirchhoff's equations have the torque g u v and the force -g v r forward. Together they do
    no work. The inertia against acceleration sideways stays that of the rods.

    Source: Munk 1924, NACA report 184; Lamb 1932, article 124.
    """

    name = "munk_moment"
    about = (
        "a torque with forward times sideways speed, and a force backward with sideways speed times turn rate"
    )
    shown_by = "turns while gliding sideways, and speed that is lost in turns, whatever the limbs do"
    joint_only = True
    mass_gap_kg = parameter("kg", -0.4, 0.4, 0.0, "mass forward less that to the side, added mass included")

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        forward, left, turn = body.velocity_body
        return (-self.mass_gap_kg * left * turn, 0.0, self.mass_gap_kg * forward * left)
