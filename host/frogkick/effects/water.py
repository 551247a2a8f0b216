"""Effects of the water: currents, drag and added mass, and the pool's walls and banks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.poses import rotate
from frogkick.effects.base import Body, Effect, parameter
from frogkick.robot import Limb, Robot
from frogkick.robot.schema import Frame

Part = TypeVar("Part", Frame, Limb)


class SteadyCurrent(Effect):
    """A uniform current."""

    name = "steady_current"
    uniform = True
    about = "the water moves at one velocity everywhere"
    shown_by = "the same residual in the world's frame whatever the heading; swims in opposite headings"
    x_mps = parameter("m/s", -0.03, 0.03, 0.0, "along world x")
    y_mps = parameter("m/s", -0.03, 0.03, 0.0, "along world y")

    def flow(self, time_s: float, position_world_m: Float64) -> Sequence[float]:
        return (self.x_mps, self.y_mps)


class ShearCurrent(Effect):
    """A current that grows linearly across the pool."""

    name = "shear_current"
    about = "the current grows evenly with the distance from a line through the origin"
    shown_by = "a residual in the world's frame that changes with the place; turns where it shears"
    x_per_s = parameter("1/s", -0.1, 0.1, 0.0, "d u_x / d y")
    y_per_s = parameter("1/s", -0.1, 0.1, 0.0, "d u_y / d x")

    def flow(self, time_s: float, position_world_m: Float64) -> Sequence[float]:
        return (self.x_per_s * float(position_world_m[1]), self.y_per_s * float(position_world_m[0]))


class Vortex(Effect):
    """Rankine's vortex: its core turns like a solid, and outside of it the speed falls with the distance."""

    name = "vortex"
    about = "the water whirls around a point (Rankine's vortex)"
    shown_by = "residuals that turn around a point of the pool"
    circulation_m2ps = parameter("m^2/s", -0.05, 0.05, 0.0, "2 pi r u outside of the core")
    x_m = parameter("m", -2.0, 2.0, 0.0, "its centre", step=0.02)
    y_m = parameter("m", -2.0, 2.0, 0.0, "its centre", step=0.02)
    core_m = parameter("m", 0.02, 1.0, 0.15, "radius of its core", step=0.02)

    def starts(self, low_m: Float64, high_m: Float64) -> Sequence[Mapping[str, float]]:
        """Return nine positions over the area of the runs: a vortex is only visible nearby."""
        shares = (1.0 / 6.0, 0.5, 5.0 / 6.0)
        places = [(low_m + share * (high_m - low_m)).tolist() for share in shares]
        return [{"x_m": across[0], "y_m": along[1], "core_m": 0.15} for across in places for along in places]

    def flow(self, time_s: float, position_world_m: Float64) -> Sequence[float]:
        x, y = float(position_world_m[0]) - self.x_m, float(position_world_m[1]) - self.y_m
        turn = self.circulation_m2ps / (2.0 * math.pi * max(x * x + y * y, self.core_m**2))
        return (-turn * y, turn * x)


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


def scaled(robot: Robot, times: Callable[[Any, float], Any], frame: float, limbs: float) -> Robot:
    """Return a robot whose frame and limbs are scaled by ``times_drag`` or ``times_mass``."""
    each = tuple(times(limb, limbs) for limb in robot.limbs)
    return replace(robot, frame=times(robot.frame, frame), limbs=each)


class DragScale(Effect):
    """Another drag than in the model, separately for the body and the limbs."""

    name = "drag_scale"
    about = "drag of the frame and of the limbs, times a factor each"
    shown_by = "how fast speed falls while gliding (frame); how far each stroke pushes (limbs)"
    frame = parameter("1", 0.2, 5.0, 1.0, "factor on the frame's drag coefficients")
    limbs = parameter("1", 0.2, 5.0, 1.0, "factor on the limbs' drag coefficients")

    def robot(self, robot: Robot) -> Robot:
        return scaled(robot, times_drag, self.frame, self.limbs)


class MassScale(Effect):
    """A body or limbs with more mass, or more added mass, than in the model."""

    name = "mass_scale"
    about = "mass of the frame, and of the limbs, added mass included, times a factor each"
    shown_by = "surge and turn of single strokes together with how long the robot glides"
    frame = parameter("1", 0.2, 5.0, 1.0, "factor on the frame's mass, added mass included")
    limbs = parameter("1", 0.2, 5.0, 1.0, "factor on the limbs' mass, added mass included")

    def robot(self, robot: Robot) -> Robot:
        return scaled(robot, times_mass, self.frame, self.limbs)


class YawDrag(Effect):
    """A resistance to turning: a body with height sheds eddies that a flat model lacks."""

    name = "yaw_drag"
    about = "a torque against turning, with the square of the turn rate and in proportion to it"
    shown_by = "how fast the turn rate falls while gliding"
    quadratic_nms2 = parameter("N m s^2", -1e-4, 1e-2, 0.0, "torque over turn rate squared")
    linear_nms = parameter("N m s", -1e-4, 1e-2, 0.0, "torque over turn rate")

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        omega = body.velocity_body[2]
        return (0.0, 0.0, -self.quadratic_nms2 * abs(omega) * omega - self.linear_nms * omega)


class SteadyWrench(Effect):
    """A constant force in the body's frame: a cable, a bent limb, batteries that are not level."""

    name = "steady_wrench"
    about = "a constant force and torque in the body's frame"
    shown_by = "the same residual in the body's frame whatever the action and the heading"
    forward_n = parameter("N", -0.02, 0.02, 0.0, "force forward")
    left_n = parameter("N", -0.02, 0.02, 0.0, "force to the left")
    torque_nm = parameter("N m", -1e-3, 1e-3, 0.0, "counter-clockwise torque")

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        return (self.forward_n, self.left_n, self.torque_nm)


OUTWARD: Mapping[str, tuple[float, float]] = {
    "x_low": (-1.0, 0.0), "x_high": (1.0, 0.0), "y_low": (0.0, -1.0), "y_high": (0.0, 1.0),
}  # fmt: skip
"""Sides of a pool with walls along the world's axes: the direction from the water towards the wall."""

REACH_M = 0.08
"""Distance from a wall within which water that flows round a body of some 0.1 m resists more."""

SOFT_N_PER_M = 8.0
"""Stiffness at each corner of a wall of hardness 1/2: a robot stops about a centimetre deep in it.

The stiffness is SOFT_N_PER_M h / (1 - h), so that the depth falls linearly with the hardness h, for a fit."""

LOSSY_S = 0.05
"""Damping over stiffness: a limb or a bumper that is pressed in returns little energy."""

HARDNESSES = (0.35, 0.5, 0.65)
"""Starting values of a fit: the drag near a wall does not show how deep the robot gets into it."""

_HALF_M = 0.045
"""Half the width of a body of unknown size: of a hand-sized one."""


class Wall(Effect):
    """A wall or bank along one side of the pool: near it water resists more, and it stops what touches it.

    It acts on each corner of the frame, so a body is turned as well, towards the side that is held back.
    Within REACH_M the resistance grows linearly up to the wall. Beyond the wall a corner is pushed back in
    proportion to its depth, more while it moves in and less while it moves out (LOSSY_S), and never pulled
    (Kelvin-Voigt contact). A bank of weeds has mostly the resistance, a bare wall mostly the push.
    """

    name = "wall"
    in_tables = False
    about = "along one side of the pool water resists more, and a wall pushes back what touches it"
    shown_by = "residuals against one direction of the world, only at that end of the pool; turns along it"
    at_m = parameter(
        "m", -2.5, 2.5, 2.5, "where it stands, from the origin towards it", step=0.002, tolerance=0.002
    )
    drag_ns_per_m = parameter("N s/m", 0.0, 2.0, 0.0, "resistance to a body that lies at the wall")
    hardness = parameter(  # tolerance: the contact changes within tenths of a millimetre
        "1", 0.0, 0.8, 0.0, "h of the stiffness SOFT_N_PER_M h / (1 - h) at each corner",
        step=0.5, grid=HARDNESSES, tolerance=0.05,
    )  # fmt: skip
    options = {"side": "x_high"}

    side: str

    def __init__(self, **values: object) -> None:
        super().__init__(**values)
        self.stiff = self.hardness > 0.0
        if self.side not in OUTWARD:
            raise InputError(
                f"effect {self.title!r}: side is {self.side!r}{nearest_name(str(self.side), OUTWARD)}: "
                f"choose from {', '.join(OUTWARD)}"
            )
        self._corners = [(_HALF_M * x, _HALF_M * y) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]

    def check(self, robot: Robot) -> None:
        """Take the robot's size."""
        corners = np.array(robot.frame.corners_m) - np.mean(robot.frame.corners_m, axis=0)
        self._corners = [(float(x), float(y)) for x, y in corners]

    def starts(self, low_m: Float64, high_m: Float64) -> Sequence[Mapping[str, float]]:
        """Return a position just beyond the runs: a nearer wall would have been more visible in them."""
        across, along = OUTWARD[self.side]
        came_m = max(across * low_m[0], across * high_m[0]) + max(along * low_m[1], along * high_m[1])
        half_m = float(np.mean([max(abs(x), abs(y)) for x, y in self._corners]))
        return ({"at_m": float(came_m) + half_m},)

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        x_m, y_m, heading = body.pose_world
        forward_mps, left_mps, omega = body.velocity_body
        across, along = OUTWARD[self.side]
        out_x, out_y = rotate(-heading, across, along)  # in the body's frame
        room_m = self.at_m - across * x_m - along * y_m
        share = self.drag_ns_per_m / len(self._corners)
        stiffness_n_per_m = SOFT_N_PER_M * self.hardness / (1.0 - self.hardness)
        force_x, force_y, torque = 0.0, 0.0, 0.0
        for x, y in self._corners:
            gap_m = room_m - out_x * x - out_y * y
            if gap_m >= REACH_M:
                continue
            vx, vy = forward_mps - omega * y, left_mps + omega * x
            held = share * min(1.0, 1.0 - gap_m / REACH_M)
            fx, fy = -held * vx, -held * vy
            if gap_m < 0.0:
                deeper_mps = out_x * vx + out_y * vy
                push = max(0.0, stiffness_n_per_m * (LOSSY_S * deeper_mps - gap_m))
                fx, fy = fx - push * out_x, fy - push * out_y
            force_x, force_y = force_x + fx, force_y + fy
            torque += x * fy - y * fx
        return (force_x, force_y, torque)
