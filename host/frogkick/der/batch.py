"""Several swimmers of one robot, simulated in the lanes of a batch."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64, dot, matmul
from frogkick.core.compiled import BARE, cached_njit, stamp_of
from frogkick.core.poses import rotation
from frogkick.der import body, stepping
from frogkick.der.body import MOTION, SUMS, body_motion, place_nodes
from frogkick.der.lanes import SimdArray, lane_floats, lane_zeros
from frogkick.der.mesh import Mesh, Rods
from frogkick.der.schedule import COARSEST_OF_PLATES, EULER_STEP_S, STEP_S, Schedule, ScheduledStroke
from frogkick.der.solve import SymbolicFactorisation
from frogkick.der.stepping import FACTOR_EVERY, MAX_ITERATIONS, SCHEMES, Nodes, Scheme, workspace_of
from frogkick.der.water import STILL, WATER, Water


def _compiled(stamp: int) -> tuple[Any, Any, Any]:
    @cached_njit(**BARE)
    def run_steps(  # type: ignore[no-untyped-def]
        mesh, symbolic, work, scheme, nodes, step_s, active, water, factor_every, report, sums
    ):
        return stamp * 0 + stepping.run_steps(
            mesh, symbolic, work, scheme, nodes, step_s, active, water, factor_every, report, sums
        )

    @cached_njit(**BARE)
    def set_accelerations(mesh, work, nodes, active, water):  # type: ignore[no-untyped-def]
        stepping.set_accelerations(mesh, work, nodes, active, water)
        return stamp

    @cached_njit(**BARE)
    def set_sums(mesh, x_m, v_mps, row, sums):  # type: ignore[no-untyped-def]
        body.set_sums(mesh, x_m, v_mps, row, sums)
        return stamp

    return run_steps, set_accelerations, set_sums


run_steps, set_accelerations, set_sums = _compiled(stamp_of("frogkick.der"))
"""The outermost functions of several files, which are cached on disk: see frogkick.core.compiled."""

WIDTH = 8  # lanes: processors have vectors of 8 float64; the work space of 16 lanes exceeds the cache
MAX_HALVINGS = 8


@dataclass(frozen=True)
class Failure:
    """Where the simulation of a lane failed."""

    time_s: float  # end of the last step that succeeded
    residual: float  # residual of the step that failed, over ``Mesh.force_scale_n``
    # pose_world, velocity_body: state at ``time_s``: m, m, rad; m/s, m/s, rad/s
    pose_world: tuple[float, float, float]
    velocity_body: tuple[float, float, float]

    def __str__(self) -> str:
        return (
            f"did not converge at {self.time_s:.6f} s: residual {self.residual:.3g} of the force scale after "
            f"{MAX_ITERATIONS} corrections and {MAX_HALVINGS} halvings of the step; pose "
            f"{list(self.pose_world)}, velocity {list(self.velocity_body)}: check the robot's stiffness and "
            "the initial velocity"
        )


class _State:
    """Positions about each lane's moving origin, velocities, accelerations, and work space."""

    def __init__(self, mesh: Mesh, symbolic: SymbolicFactorisation, scheme: Scheme, width: int) -> None:
        self.mesh, self.symbolic, self.scheme, self.width = mesh, symbolic, scheme, width
        self.nodes = Nodes(*(lane_zeros((len(mesh.mass_kg), 2), width) for _ in range(3)))
        self.water = [STILL] * width
        self._work = workspace_of(mesh, symbolic, width)

    def pick(self, lanes: Sequence[int]) -> _State:
        """Return a copy of ``width`` lanes, which may repeat."""
        picked = _State(self.mesh, self.symbolic, self.scheme, self.width)
        for to, lane in enumerate(lanes):
            self.copy_lane(lane, picked, to)
        return picked

    def start(self) -> None:
        """Set the accelerations from the forces on limbs at rest."""
        active = lane_zeros((1, 2 * self.mesh.limbs + 2), self.width)
        set_accelerations(self.mesh, self._work, self.nodes, active, self._water())

    def _water(self) -> SimdArray:
        """Return the water of all lanes; of length 0, which costs nothing, if it is still everywhere."""
        moves = any(water != STILL for water in self.water)
        numbers = lane_zeros((WATER if moves else 0, 1), self.width)
        if moves:
            lane_floats(numbers)[:, 0, :] = np.array([water.numbers() for water in self.water]).T
        return numbers

    def run(
        self, lengths: SimdArray, active: SimdArray, steps: Sequence[int], factor_every: int, trace: bool
    ) -> tuple[Float64, list[Float64]]:
        """Take the steps of each lane.

        Args:
            lengths, active: see frogkick.der.schedule.lay_out.
            steps: number of steps of each lane.
            factor_every: see frogkick.der.stepping.run_steps.
            trace: whether to return the motion after each step.

        Returns:
            The (3, width) report of run_steps, and for each lane (k, MOTION) rows about its origin, or none.
        """
        report = lane_zeros((3, 1), self.width)
        sums = lane_zeros((len(lengths) if trace else 0, SUMS), self.width)
        fixed, water = (self.mesh, self.symbolic, self._work, self.scheme), self._water()
        run_steps(*fixed, self.nodes, lengths, active, water, factor_every, report, sums)
        rows = lane_floats(sums)
        every, ends = np.empty((0, MOTION)), np.cumsum(steps).tolist()
        if trace:  # of all lanes in one call
            every = body_motion(np.concatenate([rows[:count, :, lane] for lane, count in enumerate(steps)]))
        traces = [every[end - count : end] for end, count in zip(ends, steps, strict=True)]
        return lane_floats(report)[:, 0, :].copy(), traces

    def motion(self) -> Float64:
        """Return (width, MOTION) poses about the origins, velocities, unweighted means."""
        sums = lane_zeros((1, SUMS), self.width)
        set_sums(self.mesh, self.nodes.x_m, self.nodes.v_mps, 0, sums)
        return np.asarray(body_motion(np.ascontiguousarray(lane_floats(sums)[0].T)))

    def copy_lane(self, lane: int, other: _State, to: int) -> None:
        """Copy one lane of this state into a lane of another."""
        for mine, theirs in zip(self.nodes, other.nodes, strict=True):
            lane_floats(theirs)[..., to] = lane_floats(mine)[..., lane]
        other.water[to] = self.water[lane]


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The state of a lane's robot in the middle of its strokes."""

    nodes: tuple[Float64, ...]  # (n, 2) positions about the origin, velocities, accelerations
    water: Water  # the water around it
    strokes: tuple[tuple[ScheduledStroke, ...], ...]  # strokes of each limb
    origin_m: Float64  # (2,) origin, world frame
    time_s: float  # its clock
    failed: bool  # whether its simulation has failed


class Batch:
    """Robots of one mesh, each in a lane with its own water, clock, strokes and steps.

    The result of a lane has the same bits for any width and any other lanes. A lane that fails stops and is
    listed in ``failures``; the other lanes continue.

    Attributes:
        lanes: number of robots.
        limbs: number of limbs of each.
        time_s: (lanes,) their clocks.
        failures: lane -> its failure.
        corrections: (lanes,) corrections of all time steps so far, which are the cost of a simulation.
    """

    def __init__(
        self,
        rods: Sequence[Rods],
        pose_world: Float64,
        velocity_body: Float64,
        time_s: float = 0.0,
        step_s: float = STEP_S,
        width: int = WIDTH,
        longest_s: float = math.inf,
    ) -> None:
        """Place rigidly moving robots with all limbs at rest.

        Args:
            rods: of each lane; they may differ only in their strokes.
            pose_world: (lanes, 3) x, y (m), heading (rad), world frame, finite.
            velocity_body: (lanes, 3) forward, left (m/s), turn rate (rad/s), body frame, finite.
            time_s: initial time of all clocks.
            step_s: finest time step, s, positive; a robot with the integrator backward-euler has its own.
            width: number of lanes, at least as many as robots; the other lanes are idle.
            longest_s: upper bound of the steps, in addition to the step-size profile.
        """
        mesh, self.lanes = rods[0].mesh, len(rods)
        self.limbs = mesh.limbs
        self.time_s = np.full(self.lanes, float(time_s))
        self.failures: dict[int, Failure] = {}
        self.corrections = np.zeros(self.lanes)
        if len(mesh.plate_edges):
            longest_s = min(longest_s, COARSEST_OF_PLATES * step_s)
        scheme = SCHEMES[rods[0].robot.integrator]
        if rods[0].robot.integrator == "backward-euler":
            step_s = longest_s = EULER_STEP_S
        strokes = [each.strokes for each in rods]
        self._schedule = Schedule(strokes, scheme.share, step_s, longest_s)
        self._state = _State(mesh, rods[0].symbolic, scheme, width)
        self._alone: _State | None = None
        # Nodes are kept relative to a moving origin: far out, rounding would spoil strains of 1e-9.
        self._origin = np.array(pose_world[:, :2], dtype=np.float64)
        x, v = place_nodes(mesh, pose_world[:, 2], velocity_body)
        chosen = [*range(self.lanes), *[0] * (width - self.lanes)]  # idle lanes hold a valid state
        lane_floats(self._state.nodes.x_m)[...] = x[..., chosen]
        lane_floats(self._state.nodes.v_mps)[...] = v[..., chosen]
        self._state.start()

    def fire(
        self, lane: int, limb: int, time_s: float, *, gain: float = 1.0, duration_scale: float = 1.0
    ) -> None:
        """Start a stroke of a lane's limb, now or later by its clock. Of two strokes at once the larger acts.

        Args:
            time_s: start of the stroke.
            gain: share of the measured stroke.
            duration_scale: duration of the limb's return over the measured one.
        """
        self._schedule.fire(lane, limb, ScheduledStroke(float(time_s), float(gain), float(duration_scale)))

    def set_water(self, lane: int, water: Water) -> None:
        """Set the flow around a lane's robot and its external acceleration from now on."""
        self._state.water[lane] = water
        if not self.corrections.any():  # nothing has moved yet: it starts in this water
            self._state.start()

    def shift(self, moves: Mapping[int, tuple[Float64, Float64]]) -> None:
        """Move the robots of lanes rigidly, as a correction by a measured pose does.

        Args:
            moves: lane -> (3,) displacement (m, m, rad about the centre of mass) and (3,) change of the
                velocity (m/s, m/s, rad/s), world frame.
        """
        centres = self._state.motion()[:, :2]
        x, v, a = (lane_floats(each) for each in self._state.nodes)
        for lane, (pose, velocity) in moves.items():
            turn = rotation(pose[2])
            arms = matmul(x[..., lane] - centres[lane], turn.T)
            x[..., lane] = centres[lane] + arms
            v[..., lane] = matmul(v[..., lane], turn.T) + velocity[:2]
            v[..., lane] += velocity[2] * np.column_stack([-arms[:, 1], arms[:, 0]])
            a[..., lane] = matmul(a[..., lane], turn.T)
            self._origin[lane] += pose[:2]

    def save(self, lane: int) -> Checkpoint:
        """Return the state of a lane's robot."""
        return Checkpoint(
            tuple(lane_floats(each)[..., lane].copy() for each in self._state.nodes),
            self._state.water[lane],
            self._schedule.strokes(lane),
            self._origin[lane].copy(),
            float(self.time_s[lane]),
            lane in self.failures,
        )

    def restore(self, lane: int, saved: Checkpoint) -> None:
        """Put a saved robot of the same body into a lane."""
        for mine, theirs in zip(self._state.nodes, saved.nodes, strict=True):
            lane_floats(mine)[..., lane] = theirs
        self._state.water[lane] = saved.water
        self._schedule.put(lane, saved.strokes)
        self._origin[lane], self.time_s[lane] = saved.origin_m, saved.time_s
        self.corrections[lane] = 1.0  # it has moved already: its accelerations stay as they are

    def pick(self, lanes: Sequence[int]) -> Batch:
        """Return a copy of 1 to ``width`` lanes with their current strokes."""
        picked, chosen, width = copy.copy(self), list(lanes), self._state.width
        picked.lanes = len(chosen)
        picked.time_s, picked.corrections = self.time_s[chosen], self.corrections[chosen]
        picked.failures = {to: self.failures[k] for to, k in enumerate(chosen) if k in self.failures}
        picked._schedule = self._schedule.pick(chosen)
        idle = [chosen[0]] * (width - len(chosen))  # a valid state, as in __init__
        picked._state, picked._alone = self._state.pick([*chosen, *idle]), None
        picked._origin = self._origin[chosen]
        return picked

    def advance(self, until_s: float | Float64, trace: bool = False) -> list[tuple[Float64, Float64]]:
        """Advance until the clocks of the lanes show ``until_s``.

        Args:
            until_s: time for all lanes or for each; a lane whose clock is there already does not move.
            trace: whether to return the motion.

        Returns:
            For each lane the times (k,) at the ends of its steps, and (k, MOTION) rows of
                ``frogkick.der.body.body_motion``, world frame; no rows without ``trace``.
        """
        until = np.array(np.broadcast_to(np.asarray(until_s, dtype=np.float64), (self.lanes,)))
        going = until > self.time_s
        going[list(self.failures)] = False
        if not going.any():
            return [(np.empty(0), np.empty((0, MOTION))) for _ in range(self.lanes)]
        times, counts = self._schedule.times(self.time_s, until, going)
        laid = self._schedule.laid(times, counts, self._state.width)
        steps = np.maximum(counts - 1, 0).tolist()
        report, rows = self._state.run(*laid, steps, FACTOR_EVERY, trace)
        self.corrections += report[2, : self.lanes]
        ends = [times[lane, 1 : count + 1] for lane, count in enumerate(steps)]
        some = np.flatnonzero(going).tolist()
        for lane in some:
            self.time_s[lane] = until[lane]
            if report[0, lane] >= 0.0:
                mine = times[lane, : counts[lane]]
                ends[lane], rows[lane] = self._continue_alone(
                    lane, mine, int(report[0, lane]), float(report[1, lane]), rows[lane]
                )
            if trace:
                rows[lane][:, 0:2] += self._origin[lane]
                rows[lane][:, 6:8] += self._origin[lane]
        self._recentre(some)
        return [(ends[lane], rows[lane]) for lane in range(self.lanes)]

    def _continue_alone(
        self, lane: int, times_s: Float64, step: int, residual: float, before: Float64
    ) -> tuple[Float64, Float64]:
        """Continue a lane alone from a failed step on, bisecting each step that fails.

        Returns:
            Times and rows, as ``advance`` does, about the lane's origin.
        """
        if self._alone is None:
            self._alone = _State(self._state.mesh, self._state.symbolic, self._state.scheme, 1)
        alone = self._alone
        self._state.copy_lane(lane, alone, 0)
        ends, rows = [times_s[1 : step + 1]], [before[:step]]

        def take_steps(times: Float64, factor_every: int) -> int:
            """Take steps, and return how many succeeded."""
            nonlocal residual
            taken = len(times) - 1
            laid = self._schedule.laid(times[None], np.array([len(times)]), 1, lane)
            report, (moved,) = alone.run(*laid, [taken], factor_every, len(before) > 0)
            self.corrections[lane] += float(report[2, 0])
            if report[0, 0] >= 0.0:
                taken, residual = int(report[0, 0]), float(report[1, 0])
            ends.append(times[1 : taken + 1])
            rows.append(moved[:taken])
            return taken

        def bisect_step(time_s: float, until_s: float) -> float:
            """Bisect a step into 2, 4, 8 ... parts with the full Newton method; return the time reached."""
            for halving in range(1, MAX_HALVINGS + 1):
                pieces = np.linspace(time_s, until_s, (1 << halving) + 1)
                time_s = float(pieces[take_steps(pieces, 1)])
                if time_s == until_s:
                    break
            return time_s

        reached, now, last = float(times_s[step]), step, len(times_s) - 1
        while now < last:
            reached = bisect_step(float(times_s[now]), float(times_s[now + 1]))
            if reached < times_s[now + 1]:
                break
            now += 1
            if now < last:
                now += take_steps(times_s[now:], FACTOR_EVERY)
                reached = float(times_s[now])
        alone.copy_lane(0, self._state, lane)
        self.time_s[lane] = reached
        if now < last:
            pose, velocity = self.pose_world()[lane].tolist(), self.velocity_body()[lane].tolist()
            self.failures[lane] = Failure(reached, residual, tuple(pose), tuple(velocity))
        return np.concatenate(ends), np.concatenate(rows)

    def _recentre(self, lanes: Sequence[int]) -> None:
        centres, x = self._state.motion()[:, :2], lane_floats(self._state.nodes.x_m)
        some = slice(0, self.lanes) if len(lanes) == self.lanes else lanes
        self._origin[some] += centres[some]
        x[..., some] -= centres[some].T

    @cached_property
    def mass_kg(self) -> float:
        """Mass of a robot, including added mass."""
        return float(self._state.mesh.mass_kg.sum())

    @cached_property
    def inertia_kg_m2(self) -> float:
        """Moment of inertia about the centre of mass with all limbs at rest, including added mass."""
        mesh = self._state.mesh
        return dot(mesh.mass_kg, (mesh.rest_m**2).sum(axis=1))

    def motion_world(self) -> Float64:
        """Return (lanes, MOTION) rows of frogkick.der.body.body_motion, world frame."""
        motion = self._state.motion()[: self.lanes]
        motion[:, 0:2] += self._origin
        motion[:, 6:8] += self._origin
        return motion

    def pose_world(self) -> Float64:
        """Return (lanes, 3) x, y (m) and heading (rad, in (-pi, pi]), world frame."""
        return self.motion_world()[:, :3]

    def velocity_body(self) -> Float64:
        """Return (lanes, 3) forward, left (m/s) and turn rate (rad/s), body frame."""
        return self.motion_world()[:, 3:6]

    def nodes_world(self) -> Float64:
        """Return (lanes, n, 2) node positions, m, world frame, in the order of ``Mesh``."""
        nodes = np.moveaxis(lane_floats(self._state.nodes.x_m), 2, 0)[: self.lanes]
        return np.asarray(nodes + self._origin[:, None, :])
