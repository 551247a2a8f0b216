"""Effects of the body's construction that its drawing does not contain.

Added mass, drag and thrust of the limbs are confounded in a single run, and only many runs distinguish them.
So a search does not test these effects one at a time. It fits them jointly, and starts from the values of a
robot that was calibrated before (see ``frogkick.identification.calibrated``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from frogkick.effects.base import Body, Effect, History, Parameter, Stroke
from frogkick.effects.inertia import with_inertia
from frogkick.effects.limbs import GroupEffect
from frogkick.effects.water import times_drag, times_mass
from frogkick.robot import Limb, Robot

_FATIGUE_STROKES = 24  # strokes of a limb that count; the effect of older ones has faded


class Hull(Effect):
    """A body with height and corners has more added mass, and its limbs push more, than in a flat model."""

    name = "hull"
    about = "mass with the water taken along and where it sits, drag of frame and limbs, times factors"
    shown_by = "surge, turn and glide of all strokes together"
    joint_only = True
    parameters = (
        Parameter("mass", "1", 0.2, 6.0, 1.0, "factor on the frame's mass in motion"),
        Parameter("centre_share", "1", 0.0, 0.97, 0.0, "share of that mass at the centre"),
        Parameter("frame_drag", "1", 0.05, 4.0, 1.0, "factor on the frame's drag coefficients"),
        Parameter("limb_drag", "1", 0.2, 12.0, 1.0, "factor on the limbs' drag coefficients"),
    )

    mass: float
    centre_share: float
    frame_drag: float
    limb_drag: float

    def robot(self, robot: Robot) -> Robot:
        frame = times_mass(with_inertia(robot.frame, (0.0, 0.0), self.centre_share), self.mass)
        limbs = tuple(times_drag(limb, self.limb_drag) for limb in robot.limbs)
        return replace(robot, frame=times_drag(frame, self.frame_drag), limbs=limbs)


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
    parameters = (
        Parameter(
            "added", "1", 0.0, 3.0, 0.0, "share of the added mass of a flat plate of that size; theory: 1"
        ),
        Parameter(
            "shedding", "1", 0.0, 2.0, 0.0, "share of its momentum that a tip leaves behind; theory: 1"
        ),
    )

    added: float
    shedding: float

    def robot(self, robot: Robot) -> Robot:
        limbs = (self._limb(limb, robot.water_density_kg_per_m3) for limb in robot.limbs)
        return replace(robot, limbs=tuple(limbs))

    def _limb(self, limb: Limb, density_kg_per_m3: float) -> Limb:
        return replace(
            limb,
            plate_mass_per_length_kg_per_m=self.added * plate_mass_kg_per_m(limb, density_kg_per_m3),
            tip_shedding=self.shedding if self.added > 0.0 else 0.0,
        )


class LimbMount(GroupEffect):
    """Limbs have other directions at their corners than in the drawing: by glue, or by their rest
    curvature."""

    name = "limb_mount"
    about = "limbs whose name has a word in it are turned at their roots, away from straight back"
    shown_by = "how far strokes push aside and turn, against how far they push forward"
    joint_only = True
    parameters = (Parameter("outward_deg", "deg", -45.0, 45.0, 0.0, "turn of the root's tangent"),)

    outward_deg: float

    def robot(self, robot: Robot) -> Robot:
        return replace(robot, limbs=tuple(self._limb(limb) for limb in robot.limbs))

    def _limb(self, limb: Limb) -> Limb:
        if not self.acts_on(limb.name):
            return limb
        # A root that points back and to the left turns clockwise to point more to the left.
        side = math.copysign(1.0, math.sin(limb.direction_rad))
        return replace(limb, direction_rad=limb.direction_rad - side * math.radians(self.outward_deg))


class LimbFatigue(GroupEffect):
    """A limb that fired often is warm throughout: each earlier stroke reduces this one."""

    name = "limb_fatigue"
    about = "a stroke loses a share for each earlier one of the same limb, fading with the time since"
    shown_by = "the same action after strokes of the same limbs, against after strokes of others"
    joint_only = True
    parameters = (
        Parameter("loss", "1", -0.3, 0.5, 0.0, "share lost for each stroke of just before"),
        Parameter("fade_s", "s", 0.3, 10.0, 2.5, "time in which that falls to 37 %"),
    )

    loss: float
    fade_s: float

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if self.acts_on(stroke.limb):
            earlier = [then for then, limb in history.strokes if limb == stroke.index][-_FATIGUE_STROKES:]
            use = sum(math.exp((then - stroke.time_s) / self.fade_s) for then in earlier)
            stroke.gain *= max(0.0, 1.0 - self.loss * use)
        return stroke


class MunkMoment(Effect):
    """A body whose added mass differs forward and sideways turns while it drifts, which slows it.

    With forward speed u, speed to the left v and turn rate r, and a mass in motion that is larger forward by
    g, Kirchhoff's equations have the torque g u v and the force -g v r forward. Together they do no work. The
    inertia against acceleration sideways stays that of the rods.

    Source: Munk 1924, NACA report 184; Lamb 1932, article 124.
    """

    name = "munk_moment"
    about = (
        "a torque with forward times sideways speed, and a force backward with sideways speed times turn rate"
    )
    shown_by = "turns while gliding sideways, and speed that is lost in turns, whatever the limbs do"
    joint_only = True
    parameters = (
        Parameter("mass_gap_kg", "kg", -0.4, 0.4, 0.0, "mass in motion forward less that to the side"),
    )

    mass_gap_kg: float

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        forward, left, turn = body.velocity_body
        return (-self.mass_gap_kg * left * turn, 0.0, self.mass_gap_kg * forward * left)
