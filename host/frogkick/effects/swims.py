"""Swims of robots with the effects of their files: strokes of many, a sequence of actions, or cyclic gaits.

Effects act as in a library (see ``body_effects``): flows of the water do not, because the position in them is
unknown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.core.errors import ConvergenceError, InputError
from frogkick.core.poses import wrap_angle
from frogkick.der import STEP_S, WIDTH, Batch, Failure, Rods, interpolate
from frogkick.der.mesh import build_mesh
from frogkick.effects.acting import Program, changed_robot, lane_effects, program_of, rods_of
from frogkick.effects.registry import effects_of
from frogkick.robot import Action, Actuation, Robot

SAMPLE_S = 0.01  # spacing of trajectories
CYCLES_MAX = 10000

Stage = tuple[Sequence[Program], Float64]
"""Strokes of k simulations that are fired together, and the times (k,) to which they are then advanced."""


@dataclass(frozen=True, eq=False)
class SwimTrace:
    """The motion of a simulation from its first to its last stage, step by step."""

    time_s: Float64  # (n,) 0 and the ends of all time steps
    motion: Float64  # (n, MOTION) rows of frogkick.der.body.body_motion, world frame
    stage_end: Int64  # (stages + 1,) rows at which stages begin and end

    @property
    def node_mean_m(self) -> Float64:
        """(n,) forward position of the unweighted mean of all nodes."""
        return np.asarray(self.motion[:, 6])


def simulate_stages(
    rods: Sequence[Rods],
    velocity_body: Float64,
    stages: Sequence[Stage],
    *,
    step_s: float = STEP_S,
    width: int = WIDTH,
) -> list[SwimTrace | Failure]:
    """Simulate robots from the world's origin, limbs at rest, ``width`` at a time, through all stages.

    Args:
        rods: one for each simulation, of one mesh.
        velocity_body: (k, 3) forward, left (m/s), turn rate (rad/s) at the start.
        step_s: finest time step.
    """
    found: list[SwimTrace | Failure] = []
    for first in range(0, len(rods), width):
        some = slice(first, first + width)
        velocity = velocity_body[some]
        batch = Batch(rods[some], np.zeros_like(velocity), velocity, 0.0, step_s, width)
        acting = lane_effects(rods[0].robot, batch.lanes)
        ends = [[np.zeros(1)] for _ in velocity]
        rows = [[row[None]] for row in batch.motion_world()]
        for programs, until_s in stages:
            for lane, program in enumerate(programs[some]):
                acting.fire_all(batch, lane, program)
            for lane, (times, motion) in enumerate(acting.advance(batch, until_s[some], trace=True)):
                ends[lane].append(times)
                rows[lane].append(motion)
        for lane in range(batch.lanes):
            stage_end = np.cumsum([len(times) for times in ends[lane]]) - 1
            trace = SwimTrace(np.concatenate(ends[lane]), np.concatenate(rows[lane]), stage_end)
            found.append(batch.failures.get(lane, trace))
    return found


@dataclass(frozen=True)
class Motions:
    """Motions of k robots from the world's origin, heading along world x."""

    pose_world: Float64  # (k, s, 3) x, y (m), heading (rad, continuous: not wrapped); NaN after a failure
    velocity_body: Float64  # (k, s, 3) forward, left (m/s), turn rate (rad/s); NaN likewise
    failures: dict[int, Failure]  # simulation -> its failure


def simulate_many(
    rods: Rods,
    velocity_body: Float64,
    programs: Sequence[Program],
    time_s: Sequence[float] | Float64,
    *,
    step_s: float = STEP_S,
    width: int = WIDTH,
) -> Motions:
    """Simulate robots of one mesh from the world's origin, limbs at rest, ``width`` at a time.

    Each result has the same bits, whatever else is simulated with it. A batch takes as long as its lane with
    the most steps, so neighbours should have similar strokes.

    Args:
        rods: of all simulations.
        velocity_body: (k, 3) forward, left (m/s), turn rate (rad/s) at the start.
        programs: (k) strokes of each.
        time_s: (s,) increasing, after 0: times of the results. A step ends at the last of them; the others
            are interpolated between steps (cubic Hermite).
        step_s: finest time step.
        width: lanes of a batch.

    Raises:
        InputError: shapes that do not fit, values that are not finite, or times that do not increase.
    """
    velocity = np.asarray(velocity_body, dtype=np.float64)
    times = np.asarray(time_s, dtype=np.float64)
    if velocity.ndim != 2 or velocity.shape[1] != 3 or len(velocity) != len(programs):
        raise InputError(
            f"velocities have shape {velocity.shape} for {len(programs)} programs: give (k, 3) for k programs"
        )
    if not np.isfinite(velocity).all():
        raise InputError("initial velocities must be finite: one is not")
    if times.ndim != 1 or not len(times) or not (np.diff(times, prepend=0.0) > 0.0).all():
        raise InputError(f"times {times.tolist()} do not increase from 0: give increasing seconds after 0")
    if not (np.isfinite(times[-1]) and np.isfinite(step_s) and step_s > 0.0 and width > 0):
        raise InputError(f"last time {times[-1]} s, step {step_s} s, width {width}: give positive ones")
    pose = np.full((len(programs), len(times), 3), np.nan)
    speed = np.full_like(pose, np.nan)
    failures: dict[int, Failure] = {}
    stage = programs, np.full(len(programs), times[-1])
    swim_traces = simulate_stages([rods] * len(programs), velocity, [stage], step_s=step_s, width=width)
    for k, trace in enumerate(swim_traces):
        if isinstance(trace, Failure):
            failures[k] = trace
        else:
            pose[k], speed[k] = interpolate(trace.time_s, trace.motion, times)
    return Motions(pose, speed, failures)


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """The motion of a simulated robot's body.

    Attributes:
        time_s: (n,) s, from 0 on.
        pose_world: (n, 3) x, y (m), heading (rad, in (-pi, pi]), world frame.
        velocity_body: (n, 3) forward, left (m/s), turn rate (rad/s), body frame.
        speed_mps: mean forward speed of a gait; of actions, the straight distance over the time.
        distance_m: straight distance from start to end.
        cost_of_transport: electrical energy over weight and distance, dimensionless; infinite without forward
            motion, NaN for a robot whose file gives no ``pulse_energy_j``.
    """

    time_s: Float64
    pose_world: Float64
    velocity_body: Float64
    speed_mps: float
    distance_m: float
    cost_of_transport: float

    def __repr__(self) -> str:
        return (
            f"Trajectory({len(self.time_s)} samples, {float(self.time_s[-1]):.2f} s, "
            f"distance {1e3 * self.distance_m:.1f} mm, speed {1e3 * self.speed_mps:.2f} mm/s)"
        )


def trajectory_of(
    time_s: Float64,
    pose_world: Float64,
    velocity_body: Float64,
    speed_mps: float,
    pulses: int,
    robot: Robot,
) -> Trajectory:
    """Put a trajectory together; the cost of transport is mean power over weight and speed.

    Args:
        time_s: (n,); pose_world: (n, 3), heading continuous; velocity_body: (n, 3).
    """
    x_m, y_m, heading = pose_world.T
    cost = robot.cost_of_transport(pulses, float(time_s[-1]), speed_mps)
    distance = math.hypot(x_m[-1] - x_m[0], y_m[-1] - y_m[0])
    poses = np.column_stack([x_m, y_m, wrap_angle(heading)])
    return Trajectory(time_s, poses, velocity_body, speed_mps, distance, cost)


def sample_times(period_s: float, periods: int) -> Float64:
    """Times from 0 to the end of all periods, near SAMPLE_S apart, that hold every period's end."""
    samples = max(1, round(period_s / SAMPLE_S))
    return np.concatenate(
        [[0.0], *((period + np.arange(1, samples + 1) / samples) * period_s for period in range(periods))]
    )


def simulate_actions(
    robot: Robot,
    actions: Sequence[Action | str],
    velocity_body: Sequence[float] = (0.0, 0.0, 0.0),
) -> Trajectory:
    """Simulate a sequence of actions, one each Robot.period_s, heading along world x at the start.

    Args:
        actions: its actions, or their names.
        velocity_body: forward, left (m/s), turn rate (rad/s) at the start.

    Raises:
        InputError: no action, or an unknown one.
        ConvergenceError: the simulation failed; the text gives the state.
    """
    if not actions:
        raise InputError("no action to simulate: give at least one")
    chosen = [robot.action(a) if isinstance(a, str) else a for a in actions]
    program = [
        stroke
        for index, action in enumerate(chosen)
        for stroke in program_of(robot, action, index * robot.period_s)
    ]
    time_s = sample_times(robot.period_s, len(chosen))
    start = np.array([velocity_body], dtype=np.float64)
    motions = simulate_many(rods_of(robot), start, [program], time_s[1:], width=1)
    if motions.failures:
        raise ConvergenceError(f"rods of {robot.id!r} {motions.failures[0]}")
    pose = np.concatenate([np.zeros((1, 3)), motions.pose_world[0]])
    velocity = np.concatenate([start, motions.velocity_body[0]])
    straight = math.hypot(*pose[-1, :2])
    pulses = sum(mask.bit_count() for _, mask in program)
    speed_mps = straight / float(time_s[-1])
    return trajectory_of(time_s, pose, velocity, speed_mps, pulses, robot)


@dataclass(frozen=True)
class Gait:
    """EGaIn fraction and frequency of the limb profile, and the lag of the second group as a share of the
    cycle."""

    egain_percent: float
    frequency_hz: float
    phase: float


def simulate_gaits(
    robot: Robot,
    gaits: Sequence[Gait],
    cycles: int,
    *,
    step_s: float = STEP_S,
    width: int = WIDTH,
) -> list[Trajectory | Failure]:
    """Simulate cyclic gaits from rest, side by side, heading along world x.

    The leading limbs fire at the start of each cycle, the lagging limbs ``phase / frequency_hz`` later. The
    speed is defined as the authors': forward motion of the unweighted mean of all nodes from the end of
    cycle 5 to that of cycle 8, or over the last three (or fewer) cycles of a shorter swim. The cost of
    transport counts Robot.pulse_energy_j for each pulse of each limb, and the weight in air.
    A result's bits do not depend on the width.

    Args:
        robot: the robot, with its profiles and its groups of limbs.
        gaits: phases in [0, 1).
        step_s: finest time step.

    Returns:
        For each gait its trajectory, or the failure.

    Raises:
        InputError: a phase outside [0, 1), no cycle, or a profile outside the measured range; nothing is
            simulated then.
    """
    for gait in gaits:
        if not 0.0 <= gait.phase < 1.0:
            raise InputError(f"phase is {gait.phase}: give a share of the cycle, 0 <= phase < 1")
    if not 1 <= cycles <= CYCLES_MAX:
        raise InputError(f"cycles is {cycles}: give 1 to {CYCLES_MAX}")
    strokes = [robot.actuation(gait.egain_percent, gait.frequency_hz) for gait in gaits]
    some = gait_rods(rods_of(robot), gaits, strokes)
    swim_traces = simulate_gait_traces(some, gaits, cycles, step_s=step_s, width=width)
    last = min(cycles, 8)
    counted = min(last, 3)
    pulses = cycles * (robot.gait_lead_mask.bit_count() + robot.gait_lag_mask.bit_count())
    found: list[Trajectory | Failure] = []
    for gait, trace in zip(gaits, swim_traces, strict=True):
        if isinstance(trace, Failure):
            found.append(trace)
            continue
        period_s = 1.0 / gait.frequency_hz
        mean_m = trace.node_mean_m[trace.stage_end]
        speed = float(mean_m[last] - mean_m[last - counted]) / (counted * period_s)
        time_s = sample_times(period_s, cycles)
        pose, velocity = interpolate(trace.time_s, trace.motion, time_s)
        found.append(trajectory_of(time_s, pose, velocity, speed, pulses, robot))
    return found


def simulate_gait_traces(
    rods: Sequence[Rods],
    gaits: Sequence[Gait],
    cycles: int,
    *,
    step_s: float = STEP_S,
    width: int = WIDTH,
) -> list[SwimTrace | Failure]:
    """Simulate gaits with phases in [0, 1) from rest, heading along world x; each cycle is a stage.

    Args:
        rods: one for each gait, see ``gait_rods``; a gait's frequency and phase give the times of its pulses.
        step_s, width: see ``simulate_stages``.
    """
    if not gaits:
        return []
    found: dict[int, SwimTrace | Failure] = {}
    for same in {id(each.mesh): each.mesh for each in rods}.values():  # a batch has one mesh
        lanes = [k for k, each in enumerate(rods) if each.mesh is same]
        some = [rods[k] for k in lanes], [gaits[k] for k in lanes]
        found |= zip(lanes, _one_mesh(*some, cycles, step_s, width), strict=True)
    return [found[k] for k in range(len(rods))]


def gait_rods(rods: Rods, gaits: Sequence[Gait], strokes: Sequence[Actuation]) -> list[Rods]:
    """Return for each gait the rods with its stroke, and with the mass that its EGaIn gives to the limbs."""
    bodies: dict[float, Rods] = {}
    for percent in {gait.egain_percent for gait in gaits}:
        bodies[percent] = rods
        if any(limb.egain_mass_ratio > 0.0 for limb in rods.robot.limbs):
            robot = replace(rods.robot, egain_percent=percent)
            mesh, symbolic = build_mesh(changed_robot(robot, effects_of(robot)))
            bodies[percent] = replace(rods, robot=robot, mesh=mesh, symbolic=symbolic)
    return [
        replace(
            bodies[gait.egain_percent],
            strokes=rods.robot.strokes(gait.egain_percent, gait.frequency_hz, stroke),
        )
        for gait, stroke in zip(gaits, strokes, strict=True)
    ]


def _one_mesh(
    rods: Sequence[Rods], gaits: Sequence[Gait], cycles: int, step_s: float, width: int
) -> list[SwimTrace | Failure]:
    robot, period_s = rods[0].robot, np.array([1.0 / gait.frequency_hz for gait in gaits])
    groups = [((robot.gait_lead_mask, 0.0), (robot.gait_lag_mask, gait.phase)) for gait in gaits]

    def fired(cycle: int) -> list[Program]:
        return [
            [((cycle + share) * period, mask) for mask, share in group]
            for group, period in zip(groups, period_s, strict=True)
        ]

    stages = [(fired(cycle), (cycle + 1) * period_s) for cycle in range(cycles)]
    still = np.zeros((len(gaits), 3))
    return simulate_stages(rods, still, stages, step_s=step_s, width=width)
