"""One robot in water: place it, fire its limbs, advance it, read its pose."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import ConvergenceError, InputError
from frogkick.der.batch import Batch
from frogkick.der.mesh import Rods, prepare
from frogkick.der.schedule import STEP_S
from frogkick.der.water import Water
from frogkick.robot import Robot


class Swimmer:
    """A robot in water, simulated as rods. Its pose is defined in ``frogkick.der.body``."""

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
        """Place a rigidly moving swimmer with all limbs at rest.

        Args:
            pose_world: x, y (m), heading (rad), world frame.
            velocity_body: forward, left (m/s), turn rate (rad/s, counter-clockwise), body frame.
            time_s: initial time of its clock.
            step_s: finest time step.
            rods: prepare(robot), to share it between swimmers.
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
        self._batch = Batch([self.rods], pose[None], velocity[None], time_s, float(step_s), 1)

    @property
    def time_s(self) -> float:
        """Its time, s."""
        return float(self._batch.time_s[0])

    @property
    def mass_kg(self) -> float:
        """Its mass, including added mass."""
        return self._batch.mass_kg

    @property
    def inertia_kg_m2(self) -> float:
        """Moment of inertia about its centre of mass with all limbs at rest, including added mass."""
        return self._batch.inertia_kg_m2

    def fire(self, limb: int, time_s: float, *, gain: float = 1.0, duration_scale: float = 1.0) -> None:
        """Start a stroke of one limb now or later.

        The limb follows the measured profile to its end, then rests. If it is fired again before that, the
        larger of the two activations acts at each moment, because heat adds no more than one full stroke.

        Args:
            limb: index of the limb.
            time_s: start of the stroke.
            gain: share of the measured stroke, 0 to 2.
            duration_scale: duration of the limb's return over the measured one, 0.1 to 10.
        """
        limbs = len(self.rods.robot.limbs)
        if not 0 <= limb < limbs:
            raise InputError(f"limb {limb} of robot {self.rods.robot.id!r} is none of 0-{limbs - 1}")
        if not (math.isfinite(time_s) and time_s >= self.time_s - 1e-9):
            raise InputError(f"limb {limb} fired for {time_s} s at {self.time_s} s: fire now or later")
        if not (0.0 <= gain <= 2.0 and 0.1 <= duration_scale <= 10.0):
            raise InputError(
                f"stroke of limb {limb} has gain {gain} and duration scale {duration_scale}: "
                "give 0 to 2 and 0.1 to 10"
            )
        self._batch.fire(0, limb, time_s, gain=gain, duration_scale=duration_scale)

    def set_water(self, water: Water) -> None:
        """Set the flow around it and its external acceleration from now on; see frogkick.der.water."""
        self._batch.set_water(0, water)

    def fire_mask(self, mask: int, time_s: float) -> None:
        """Start a stroke of each limb whose bit is set."""
        for limb in range(len(self.rods.robot.limbs)):
            if mask >> limb & 1:
                self.fire(limb, time_s)

    def advance(self, until_s: float) -> None:
        """Advance in steps that frogkick.der.schedule chooses; the last one ends at ``until_s``.

        Raises:
            InputError: a time that has passed.
            ConvergenceError: a step did not converge after repeated bisection, or the state became
                non-finite; the text gives the state before that step.
        """
        if not (math.isfinite(until_s) and until_s >= self.time_s - 1e-9):
            raise InputError(f"cannot advance to {until_s} s from {self.time_s} s: time goes forward")
        if 0 in self._batch.failures:
            raise ConvergenceError(self._failed())
        self._batch.advance(until_s)
        if 0 in self._batch.failures:
            raise ConvergenceError(self._failed())

    def _failed(self) -> str:
        return f"rods of {self.rods.robot.id!r} {self._batch.failures[0]}"

    def pose_world(self) -> Float64:
        """(3,) x, y (m) and heading (rad, in (-pi, pi]) in the world frame."""
        return np.asarray(self._batch.pose_world()[0])

    def velocity_body(self) -> Float64:
        """(3,) forward, left (m/s) and turn rate (rad/s) in the body frame."""
        return np.asarray(self._batch.velocity_body()[0])

    def nodes_world(self) -> Float64:
        """(n, 2) node positions, m: the frame counter-clockwise, then each limb from root to tip."""
        return np.asarray(self._batch.nodes_world()[0])

    def node_velocities_world(self) -> Float64:
        """(n, 2) node velocities, m/s."""
        return np.asarray(self._batch.node_velocities_world()[0])
