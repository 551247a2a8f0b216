"""One simulation at a time, for tests: a gait, an action, or a robot to fire and to look at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from frogkick.core.errors import ConvergenceError
from frogkick.der import STEP_S, Batch, Failure, Rods, Water, prepare
from frogkick.effects.acting import Acting, program_of
from frogkick.effects.swims import Gait, Trajectory, simulate_gaits, simulate_many
from frogkick.robot import Action, Robot


def simulate_gait(
    robot: Robot,
    egain_percent: float,
    frequency_hz: float,
    phase: float,
    cycles: int,
    *,
    step_s: float = STEP_S,
) -> Trajectory:
    """Simulate the robot's cyclic gait from rest, heading along world x.

    The leading limbs fire at the start of each cycle, the lagging limbs ``phase / frequency_hz`` later. The
    speed is defined as the authors': forward motion of the unweighted mean of all nodes from the end of
    cycle 5 to that of cycle 8, or over the last three (or fewer) cycles of a shorter swim. The cost of
    transport counts Robot.pulse_energy_j for each pulse of each limb, and the weight in air.

    Raises:
        InputError: a phase outside [0, 1), no cycle, or a profile outside the measured range.
        ConvergenceError: the simulation failed; the text gives the state.
    """
    (result,) = simulate_gaits(
        robot, [Gait(egain_percent, frequency_hz, phase)], cycles, step_s=step_s, width=1
    )
    if isinstance(result, Failure):
        raise ConvergenceError(f"rods of {robot.id!r} {result}")
    return result


def simulate_action(
    robot: Robot,
    velocity_body: Sequence[float],
    action: Action | str,
    duration_s: float,
    *,
    step_s: float = STEP_S,
    rods: Rods | None = None,
) -> tuple[float, float, float, float, float, float]:
    """Simulate one action from a velocity, limbs at rest.

    Args:
        robot: the robot.
        velocity_body: forward, left (m/s), turn rate (rad/s) at the start.
        action: the action or its name.
        duration_s: duration, s.
        step_s: finest time step.
        rods: its rods if effects change the body; None: prepare(robot).

    Returns:
        Displacement (m, m, rad) in the body frame at the start, then velocity (m/s, m/s, rad/s) in the body
        frame at the end.

    Raises:
        InputError: an unknown action, or values that are not finite.
        ConvergenceError: the simulation failed; the text gives the state.
    """
    chosen = robot.action(action) if isinstance(action, str) else action
    motions = simulate_many(
        prepare(robot) if rods is None else rods,
        np.array([velocity_body], dtype=np.float64),
        [program_of(robot, chosen)],
        [duration_s],
        step_s=step_s,
        width=1,
    )
    if motions.failures:
        raise ConvergenceError(f"rods of {robot.id!r} {motions.failures[0]}")
    dx, dy, dheading = motions.pose_world[0, -1].tolist()
    vx, vy, omega = motions.velocity_body[0, -1].tolist()
    return dx, dy, dheading, vx, vy, omega


class Swimmer:
    """One robot in a batch of its own, in arrays without lanes."""

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
        self.rods = prepare(robot) if rods is None else rods
        pose, velocity = (np.array([each], dtype=np.float64) for each in (pose_world, velocity_body))
        self.batch = Batch([self.rods], pose, velocity, time_s, step_s, 1)
        self.mass_kg, self.inertia_kg_m2 = self.batch.mass_kg, self.batch.inertia_kg_m2

    @property
    def time_s(self) -> float:
        return float(self.batch.time_s[0])

    def fire(self, limb: int, time_s: float, *, gain: float = 1.0) -> None:
        self.batch.fire(0, limb, time_s, gain=gain)

    def fire_mask(self, mask: int, time_s: float) -> None:
        for limb in range(self.batch.limbs):
            if mask >> limb & 1:
                self.fire(limb, time_s)

    def set_water(self, water: Water) -> None:
        self.batch.set_water(0, water)

    def advance(self, until_s: float, acting: Acting | None = None) -> None:
        """Advance it, with effects if they are given."""
        if acting is None:
            self.batch.advance(until_s)
        else:
            acting.advance(self.batch, until_s)
        for failure in self.batch.failures.values():
            raise ConvergenceError(f"rods of {self.rods.robot.id!r} {failure}")

    def pose_world(self) -> np.ndarray:
        return self.batch.pose_world()[0]

    def velocity_body(self) -> np.ndarray:
        return self.batch.velocity_body()[0]

    def nodes_world(self) -> np.ndarray:
        return self.batch.nodes_world()[0]

    def node_velocities_world(self) -> np.ndarray:
        return self.batch.save(0).nodes[1]
