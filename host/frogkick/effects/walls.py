"""Effects of the pool's walls and banks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from frogkick.core.errors import InputError, nearest_name
from frogkick.core.poses import rotate
from frogkick.effects.base import Body, Effect, FloatArray, Parameter
from frogkick.robot import Robot

OUTWARD: Mapping[str, tuple[float, float]] = {
    "x_low": (-1.0, 0.0),
    "x_high": (1.0, 0.0),
    "y_low": (0.0, -1.0),
    "y_high": (0.0, 1.0),
}
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

_POINT_M = 0.045
"""Corners of a body of unknown size: half the width of a hand-sized one."""


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
    parameters = (
        Parameter(
            "at_m",
            "m",
            -2.5,
            2.5,
            2.5,
            "where it stands, from the origin towards it",
            step=0.002,
            tolerance=0.002,
        ),
        Parameter("drag_ns_per_m", "N s/m", 0.0, 2.0, 0.0, "resistance to a body that lies at the wall"),
        Parameter(
            "hardness",
            "1",
            0.0,
            0.8,
            0.0,
            "h of the stiffness SOFT_N_PER_M h / (1 - h) at each corner",
            step=0.5,
            grid=HARDNESSES,
            tolerance=0.05,  # the contact changes within tenths of a millimetre
        ),
    )
    options = {"side": "x_high"}

    side: str
    at_m: float
    drag_ns_per_m: float
    hardness: float

    def __init__(self, **values: object) -> None:
        super().__init__(**values)
        if self.side not in OUTWARD:
            raise InputError(
                f"effect {self.title!r}: side is {self.side!r}{nearest_name(str(self.side), OUTWARD)}: "
                f"choose from {', '.join(OUTWARD)}"
            )
        self._corners = [
            (_POINT_M, _POINT_M),
            (-_POINT_M, _POINT_M),
            (-_POINT_M, -_POINT_M),
            (_POINT_M, -_POINT_M),
        ]

    @property
    def stiff(self) -> bool:
        return self.hardness > 0.0

    def check(self, robot: Robot) -> None:
        """Take the robot's size."""
        corners = np.array(robot.frame.corners_m) - np.mean(robot.frame.corners_m, axis=0)
        self._corners = [(float(x), float(y)) for x, y in corners]

    def starts(self, low_m: FloatArray, high_m: FloatArray) -> Sequence[Mapping[str, float]]:
        """Return a position just beyond the runs: a nearer wall would have been more visible in them."""
        across, along = OUTWARD[self.side]
        came_m = max(across * low_m[0], across * high_m[0]) + max(along * low_m[1], along * high_m[1])
        return ({"at_m": float(came_m) + self._half_width_m()},)

    def _half_width_m(self) -> float:
        return float(np.mean([max(abs(x), abs(y)) for x, y in self._corners]))

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
