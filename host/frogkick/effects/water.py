"""Effects of the water: currents, drag and added mass."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from frogkick.effects.base import Body, Effect, FloatArray, Parameter
from frogkick.robot import Limb, Robot
from frogkick.robot.shape import Frame

Part = TypeVar("Part", Frame, Limb)


class SteadyCurrent(Effect):
    """A uniform current."""

    name = "steady_current"
    about = "the water moves at one velocity everywhere"
    shown_by = "the same residual in the world's frame whatever the heading; swims in opposite headings"
    parameters = (
        Parameter("x_mps", "m/s", -0.03, 0.03, 0.0, "along world x"),
        Parameter("y_mps", "m/s", -0.03, 0.03, 0.0, "along world y"),
    )

    x_mps: float
    y_mps: float

    @property
    def uniform(self) -> bool:
        return True

    def flow(self, time_s: float, position_world_m: FloatArray) -> Sequence[float]:
        return (self.x_mps, self.y_mps)


class ShearCurrent(Effect):
    """A current that grows linearly across the pool."""

    name = "shear_current"
    about = "the current grows evenly with the distance from a line through the origin"
    shown_by = "a residual in the world's frame that changes with the place; turns where it shears"
    parameters = (
        Parameter("x_per_s", "1/s", -0.1, 0.1, 0.0, "d u_x / d y"),
        Parameter("y_per_s", "1/s", -0.1, 0.1, 0.0, "d u_y / d x"),
    )

    x_per_s: float
    y_per_s: float

    def flow(self, time_s: float, position_world_m: FloatArray) -> Sequence[float]:
        return (self.x_per_s * float(position_world_m[1]), self.y_per_s * float(position_world_m[0]))


class Vortex(Effect):
    """Rankine's vortex: its core turns like a solid, and outside of it the speed falls with the distance."""

    name = "vortex"
    about = "the water whirls around a point (Rankine's vortex)"
    shown_by = "residuals that turn around a point of the pool"
    parameters = (
        Parameter("circulation_m2ps", "m^2/s", -0.05, 0.05, 0.0, "2 pi r u outside of the core"),
        Parameter("x_m", "m", -2.0, 2.0, 0.0, "its centre", step=0.02),
        Parameter("y_m", "m", -2.0, 2.0, 0.0, "its centre", step=0.02),
        Parameter("core_m", "m", 0.02, 1.0, 0.15, "radius of its core", step=0.02),
    )

    circulation_m2ps: float
    x_m: float
    y_m: float
    core_m: float

    def starts(self, low_m: FloatArray, high_m: FloatArray) -> Sequence[Mapping[str, float]]:
        """Return nine positions over the area of the runs: a vortex is only visible nearby."""
        shares = (1.0 / 6.0, 0.5, 5.0 / 6.0)
        places = [(low_m + share * (high_m - low_m)).tolist() for share in shares]
        return [{"x_m": across[0], "y_m": along[1], "core_m": 0.15} for across in places for along in places]

    def flow(self, time_s: float, position_world_m: FloatArray) -> Sequence[float]:
        x, y = float(position_world_m[0]) - self.x_m, float(position_world_m[1]) - self.y_m
        turn = self.circulation_m2ps / (2.0 * math.pi * max(x * x + y * y, self.core_m**2))
        return (-turn * y, turn * x)


class DragScale(Effect):
    """Another drag than in the model, separately for the body and the limbs."""

    name = "drag_scale"
    about = "drag of the frame and of the limbs, times a factor each"
    shown_by = "how fast speed falls while gliding (frame); how far each stroke pushes (limbs)"
    parameters = (
        Parameter("frame", "1", 0.2, 5.0, 1.0, "factor on the frame's drag coefficients"),
        Parameter("limbs", "1", 0.2, 5.0, 1.0, "factor on the limbs' drag coefficients"),
    )

    frame: float
    limbs: float

    def robot(self, robot: Robot) -> Robot:
        limbs = tuple(times_drag(limb, self.limbs) for limb in robot.limbs)
        return replace(robot, frame=times_drag(robot.frame, self.frame), limbs=limbs)


class MassScale(Effect):
    """A body or limbs with more mass, or more added mass, than in the model."""

    name = "mass_scale"
    about = "mass of the frame, and of the limbs, with the water that each takes along, times a factor each"
    shown_by = "surge and turn of single strokes together with how long the robot glides"
    parameters = (
        Parameter("frame", "1", 0.2, 5.0, 1.0, "factor on the frame's mass in motion"),
        Parameter("limbs", "1", 0.2, 5.0, 1.0, "factor on the limbs' mass in motion"),
    )

    frame: float
    limbs: float

    def robot(self, robot: Robot) -> Robot:
        limbs = tuple(times_mass(limb, self.limbs) for limb in robot.limbs)
        return replace(robot, frame=times_mass(robot.frame, self.frame), limbs=limbs)


def times_drag(part: Part, factor: float) -> Part:
    """Return a frame or limb whose drag coefficients are scaled."""
    return replace(part, drag_normal=part.drag_normal * factor, drag_tangential=part.drag_tangential * factor)


def times_mass(part: Part, factor: float) -> Part:
    """Return a frame or limb whose total mass is scaled; its own mass stays the same if possible."""
    plain = part.mass_per_length_kg_per_m
    whole = factor * (plain + part.added_mass_per_length_kg_per_m)
    return replace(
        part,
        mass_per_length_kg_per_m=min(plain, whole),
        added_mass_per_length_kg_per_m=max(0.0, whole - plain),
    )


class YawDrag(Effect):
    """A resistance to turning: a body with height sheds eddies that a flat model lacks."""

    name = "yaw_drag"
    about = "a torque against turning, with the square of the turn rate and in proportion to it"
    shown_by = "how fast the turn rate falls while gliding"
    parameters = (
        Parameter("quadratic_nms2", "N m s^2", -1e-4, 1e-2, 0.0, "torque over turn rate squared"),
        Parameter("linear_nms", "N m s", -1e-4, 1e-2, 0.0, "torque over turn rate"),
    )

    quadratic_nms2: float
    linear_nms: float

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        omega = body.velocity_body[2]
        return (0.0, 0.0, -self.quadratic_nms2 * abs(omega) * omega - self.linear_nms * omega)


class SteadyWrench(Effect):
    """A constant force in the body's frame: a cable, a bent limb, batteries that are not level."""

    name = "steady_wrench"
    about = "a constant force and torque in the body's frame"
    shown_by = "the same residual in the body's frame whatever the action and the heading"
    parameters = (
        Parameter("forward_n", "N", -0.02, 0.02, 0.0, "force forward"),
        Parameter("left_n", "N", -0.02, 0.02, 0.0, "force to the left"),
        Parameter("torque_nm", "N m", -1e-3, 1e-3, 0.0, "counter-clockwise torque"),
    )

    forward_n: float
    left_n: float
    torque_nm: float

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        return (self.forward_n, self.left_n, self.torque_nm)
