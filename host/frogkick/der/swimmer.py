"""One robot in water: place it, fire its limbs, let time pass, ask where it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.der.elimination import Elimination
from frogkick.der.integrator import MAX_HALVINGS, MAX_ITERATIONS, advance, rest_acceleration
from frogkick.der.mesh import Mesh, build_mesh
from frogkick.errors import ConvergenceError, InputError
from frogkick.robot import Actuation, Robot

FloatArray = NDArray[np.float64]

# Errs by 0.5 % of a swimming speed and 0.05 mm of a stroke, at 20 ms of computing per simulated second;
# 1 ms errs by a quarter of that, 4 ms by four times.
STEP_S = 0.002


@dataclass(frozen=True)
class Rods:
    """What all swimmers of one robot share: its mesh, its solver's plan, its stroke."""

    robot: Robot
    mesh: Mesh
    plan: Elimination
    actuation: Actuation


def prepare(robot: Robot, egain_percent: float | None = None, frequency_hz: float | None = None) -> Rods:
    """Build what swimmers share, by default with the limb profile that the robot's actions use.

    Raises:
        InputError: the profile is outside of what was measured.
    """
    mesh, plan = build_mesh(robot)
    return Rods(robot, mesh, plan, robot.actuation(egain_percent, frequency_hz))


class Swimmer:
    """A robot in still water, simulated as rods.

    The pose is that of the body: the mass-weighted mean of all nodes (Huang 2022, Eqs. 10, 12) and the
    signed mass-weighted rotation of the frame's nodes (Eq. 11 loses the sign). Added mass counts as mass.
    """

    def __init__(
        self,
        robot: Robot,
        pose_world: Sequence[float] = (0.0, 0.0, 0.0),
        velocity_body: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        time_s: float = 0.0,
        step_s: float = STEP_S,
        rods: Rods | None = None,
    ) -> None:
        """Place a swimmer with all limbs at rest, moving like a rigid body.

        Args:
            robot: what swims.
            pose_world: x, y (m), heading (rad), world frame.
            velocity_body: forward, left (m/s), turn rate (rad/s, counter-clockwise), body frame.
            time_s: what its clock shows now.
            step_s: longest time step.
            rods: prepare(robot), to share it between swimmers.

        Raises:
            InputError: a value that is not finite, or a step that is not positive.
        """
        pose = np.array(pose_world, dtype=np.float64)
        velocity = np.array(velocity_body, dtype=np.float64)
        if pose.shape != (3,) or velocity.shape != (3,):
            raise InputError(f"pose has {pose.size} and velocity {velocity.size} values: give 3 each")
        if not (np.isfinite(pose).all() and np.isfinite(velocity).all() and math.isfinite(time_s)):
            raise InputError(
                f"swimmer at {pose.tolist()}, {velocity.tolist()} at {time_s} s: values must be finite"
            )
        if not (math.isfinite(step_s) and step_s > 0.0):
            raise InputError(f"time step is {step_s} s: give a positive one, {STEP_S} s by default")
        self.rods = prepare(robot) if rods is None else rods
        self.time_s = float(time_s)
        self._step_s = float(step_s)
        self._strokes: list[list[float]] = [[] for _ in robot.limbs]
        mesh = self.rods.mesh
        c, s = math.cos(pose[2]), math.sin(pose[2])
        turned = np.column_stack(
            [c * mesh.rest_m[:, 0] - s * mesh.rest_m[:, 1], s * mesh.rest_m[:, 0] + c * mesh.rest_m[:, 1]]
        )
        # Nodes are kept relative to a moving origin: far out, rounding would spoil strains of 1e-9.
        self._origin = pose[:2].copy()
        self._x = turned
        self._v = np.column_stack(
            [
                c * velocity[0] - s * velocity[1] - velocity[2] * turned[:, 1],
                s * velocity[0] + c * velocity[1] + velocity[2] * turned[:, 0],
            ]
        )
        idle = np.zeros(len(robot.limbs))
        self._a = rest_acceleration(mesh, self.rods.plan, self._x, self._v, idle, 0.0)
        self.newton_iterations = 0

    def fire(self, limb: int, time_s: float) -> None:
        """Start a stroke of one limb now or later.

        The limb follows the measured profile to its end, then rests. Fired again before that, the larger
        activation of the two strokes wins at each moment: heat adds no more than one full stroke.

        Raises:
            InputError: no such limb, or a time that has passed.
        """
        if not 0 <= limb < len(self._strokes):
            raise InputError(
                f"limb {limb} of robot {self.rods.robot.id!r} is none of 0-{len(self._strokes) - 1}"
            )
        if not (math.isfinite(time_s) and time_s >= self.time_s - 1e-9):
            raise InputError(f"limb {limb} fired for {time_s} s at {self.time_s} s: fire now or later")
        self._strokes[limb].append(float(time_s))

    def fire_mask(self, mask: int, time_s: float) -> None:
        """Start a stroke of each limb whose bit is set."""
        for limb in range(len(self._strokes)):
            if mask >> limb & 1:
                self.fire(limb, time_s)

    def _stroke_table(self) -> FloatArray:
        """(limbs, k) starts of strokes that are not over, NaN-padded."""
        duration = self.rods.actuation.duration_s
        for starts in self._strokes:
            starts[:] = [start for start in starts if start + duration > self.time_s]
        longest = max(1, *(len(starts) for starts in self._strokes))
        table = np.full((len(self._strokes), longest), np.nan)
        for row, starts in zip(table, self._strokes, strict=True):
            row[: len(starts)] = starts
        return table

    def advance(self, until_s: float) -> None:
        """Let time pass, in equal steps no longer than the swimmer's step.

        Raises:
            InputError: a time that has passed.
            ConvergenceError: a step did not converge even when halved again and again, or the state is no
                longer finite; the text gives the state before that step.
        """
        if not (math.isfinite(until_s) and until_s >= self.time_s - 1e-9):
            raise InputError(f"cannot advance to {until_s} s from {self.time_s} s: time goes forward")
        if until_s <= self.time_s:
            return
        mesh, stroke = self.rods.mesh, self.rods.actuation
        reached, residual, iterations = advance(
            mesh,
            self.rods.plan,
            self._x,
            self._v,
            self._a,
            self.time_s,
            until_s,
            self._step_s,
            self._stroke_table(),
            stroke.activation,
            stroke.step_s,
            stroke.drop_per_m,
        )
        self.newton_iterations += iterations
        finite = np.isfinite(self._x).all() and np.isfinite(self._v).all()
        if reached < until_s or not finite:
            self.time_s = reached
            raise ConvergenceError(
                f"rods of {self.rods.robot.id!r} did not converge at {reached:.6f} s: residual "
                f"{residual:.3g} of the force scale after {MAX_ITERATIONS} iterations and {MAX_HALVINGS} "
                f"halvings of {self._step_s:g} s; pose {self.pose_world().tolist()}, velocity "
                f"{self.velocity_body().tolist()}: "
                "check the robot's stiffness and the initial velocity"
            )
        self.time_s = float(until_s)
        shift = (mesh.mass_kg @ self._x) / mesh.mass_kg.sum()
        self._origin += shift
        self._x -= shift

    def _frame(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """The frame's masses, rest arms, arms and velocities, each about its own centre."""
        n, mesh = self.rods.mesh.frame_nodes, self.rods.mesh
        mass = mesh.mass_kg[:n]
        rest, x, v = mesh.rest_m[:n], self._x[:n], self._v[:n]
        total = mass.sum()
        return mass, rest - mass @ rest / total, x - mass @ x / total, v - mass @ v / total

    def _heading(self) -> float:
        mass, rest, arm, _ = self._frame()
        cross = mass @ (rest[:, 0] * arm[:, 1] - rest[:, 1] * arm[:, 0])
        return math.atan2(float(cross), float(mass @ (rest * arm).sum(axis=1)))

    def pose_world(self) -> FloatArray:
        """(3,) x, y (m) and heading (rad, in (-pi, pi]) in the world frame."""
        mass = self.rods.mesh.mass_kg
        centre = self._origin + mass @ self._x / mass.sum()
        return np.array([centre[0], centre[1], self._heading()])

    def velocity_body(self) -> FloatArray:
        """(3,) forward, left (m/s) and turn rate (rad/s) in the body frame."""
        mesh = self.rods.mesh
        vx, vy = mesh.mass_kg @ self._v / mesh.mass_kg.sum()
        heading = self._heading()
        c, s = math.cos(heading), math.sin(heading)
        mass, _, arm, velocity = self._frame()
        turning = mass @ (arm[:, 0] * velocity[:, 1] - arm[:, 1] * velocity[:, 0])
        omega = turning / (mass @ (arm * arm).sum(axis=1))
        return np.array([c * vx + s * vy, c * vy - s * vx, omega])

    def nodes_world(self) -> FloatArray:
        """(n, 2) node positions, m: the frame counter-clockwise, then each limb from root to tip."""
        return self._x + self._origin

    def node_velocities_world(self) -> FloatArray:
        """(n, 2) node velocities, m/s."""
        return self._v.copy()
