"""Effects of the body's construction that its drawing does not contain.

Added mass, drag and thrust of the limbs can only be distinguished by many runs together. So a search does not
test these effects one at a time; they are fitted to runs jointly, starting from the values of a robot that
was measured (see frogkick.identification.calibrated).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from frogkick.effects.base import Body, Effect, History, Parameter, Stroke
from frogkick.effects.inertia import with_inertia
from frogkick.effects.limbs import require_group
from frogkick.robot import Limb, Robot

_FATIGUE_STROKES = 24  # of a limb, that are remembered: older ones have faded


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
        frame = robot.frame
        plain = frame.mass_per_length_kg_per_m
        whole = self.mass * (plain + frame.added_mass_per_length_kg_per_m)
        body = replace(
            with_inertia(frame, (0.0, 0.0), self.centre_share),
            mass_per_length_kg_per_m=min(plain, whole),
            added_mass_per_length_kg_per_m=max(0.0, whole - plain),
            drag_normal=frame.drag_normal * self.frame_drag,
            drag_tangential=frame.drag_tangential * self.frame_drag,
        )
        return replace(robot, frame=body, limbs=tuple(self._limb(limb) for limb in robot.limbs))

    def _limb(self, limb: Limb) -> Limb:
        return replace(
            limb,
            drag_normal=limb.drag_normal * self.limb_drag,
            drag_tangential=limb.drag_tangential * self.limb_drag,
        )


class LimbWater(Effect):
    """A limb is a plate as high as the body, with more added mass than the round rod of the model.

    The added mass of a plate is the water in the circle over its height (rho pi / 4 h^2): for the paper's
    limbs, 24 mm high, 33 times the 13.7 g/m of a rod of their section.
    """

    name = "limb_water"
    about = "water that the limbs take along, times a factor: strokes push by it, fast curling back brakes"
    shown_by = "steady speeds over frequencies and alloys, which differ by how fast limbs curl back"
    joint_only = True
    parameters = (Parameter("added", "1", 0.0, 40.0, 1.0, "factor on the limbs' added mass"),)

    added: float

    def robot(self, robot: Robot) -> Robot:
        limbs = (
            replace(limb, added_mass_per_length_kg_per_m=limb.added_mass_per_length_kg_per_m * self.added)
            for limb in robot.limbs
        )
        return replace(robot, limbs=tuple(limbs))


class LimbMount(Effect):
    """Limbs have other directions at their corners than in the drawing: by glue, or by their rest
    curvature."""

    name = "limb_mount"
    about = "limbs whose name has a word in it are turned at their roots, away from straight back"
    shown_by = "how far strokes push aside and turn, against how far they push forward"
    joint_only = True
    parameters = (Parameter("outward_deg", "deg", -45.0, 45.0, 0.0, "turn of the root's tangent"),)
    options = {"group": None}

    group: str
    outward_deg: float

    def check(self, robot: Robot) -> None:
        require_group(self, self.group, robot)

    def robot(self, robot: Robot) -> Robot:
        return replace(robot, limbs=tuple(self._limb(limb) for limb in robot.limbs))

    def _limb(self, limb: Limb) -> Limb:
        if self.group not in limb.name.split("_"):
            return limb
        # A root that points back and to the left turns clockwise to point more to the left.
        side = math.copysign(1.0, math.sin(limb.direction_rad))
        return replace(limb, direction_rad=limb.direction_rad - side * math.radians(self.outward_deg))


class LimbFatigue(Effect):
    """A limb that fired often is warm throughout: each earlier stroke reduces this one."""

    name = "limb_fatigue"
    about = "a stroke loses a share for each earlier one of the same limb, fading with the time since"
    shown_by = "the same action after strokes of the same limbs, against after strokes of others"
    joint_only = True
    parameters = (
        Parameter("loss", "1", -0.3, 0.5, 0.0, "share lost for each stroke of just before"),
        Parameter("fade_s", "s", 0.3, 10.0, 2.5, "time in which that falls to 37 %"),
    )
    options = {"group": None}

    group: str
    loss: float
    fade_s: float

    def check(self, robot: Robot) -> None:
        require_group(self, self.group, robot)

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if self.group in stroke.limb.split("_"):
            earlier = [then for then, limb in history.strokes if limb == stroke.index][-_FATIGUE_STROKES:]
            use = sum(math.exp((then - stroke.time_s) / self.fade_s) for then in earlier)
            stroke.gain *= max(0.0, 1.0 - self.loss * use)
        return stroke


class MunkMoment(Effect):
    """A body whose added mass differs forward and sideways turns while it drifts (Munk's moment)."""

    name = "munk_moment"
    about = "a torque in proportion to forward times sideways speed"
    shown_by = "turns while gliding sideways, whatever the limbs do"
    joint_only = True
    parameters = (
        Parameter("mass_gap_kg", "kg", -0.4, 0.4, 0.0, "mass in motion forward less that to the side"),
    )

    mass_gap_kg: float

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        forward, left, _ = body.velocity_body
        return (0.0, 0.0, self.mass_gap_kg * forward * left)
