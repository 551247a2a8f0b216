"""Several swimmers of one robot simulated side by side."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.core.poses import rotation
from frogkick.der.body import MOTION, SUMS, body_motion, place_nodes
from frogkick.der.compiled import run_steps, set_accelerations, set_sums
from frogkick.der.lanes import Numbers, lane_floats, lane_zeros
from frogkick.der.mesh import Mesh
from frogkick.der.plan import Plan
from frogkick.der.schedule import RINGS_S, Stroke, pace_of, step_times, stroke_activation
from frogkick.der.stepping import EVALUATION_SHARE, FACTOR_EVERY, MAX_ITERATIONS, space_of
from frogkick.der.water import STILL, WATER, Water
from frogkick.robot import Actuation

FloatArray = NDArray[np.float64]

WIDTH = 8  # lanes: the widest vectors of today's processors; with 16 the work space outgrows the cache
MAX_HALVINGS = 8


@dataclass(frozen=True)
class Failure:
    """A lane that could not go on: its clock, its state then, and the last residual over the force scale."""

    time_s: float
    residual: float
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
    """Positions about each lane's moving origin, velocities, accelerations, and the space to step them."""

    def __init__(self, mesh: Mesh, plan: Plan, limbs: int, width: int) -> None:
        self.mesh, self.plan, self.limbs, self.width = mesh, plan, limbs, width
        n = len(mesh.mass_kg)
        self.x_m: Numbers = lane_zeros((n, 2), width)
        self.v_mps: Numbers = lane_zeros((n, 2), width)
        self.a_mps2: Numbers = lane_zeros((n, 2), width)
        self.water = [STILL] * width
        self._space = space_of(mesh, plan, width)

    def pick(self, lanes: Sequence[int]) -> _State:
        """``width`` of its lanes, some of them more than once, in space of their own."""
        twin = _State(self.mesh, self.plan, self.limbs, self.width)
        for to, lane in enumerate(lanes):
            self.copy_lane(lane, twin, to)
        return twin

    def start(self) -> None:
        """Set the accelerations to what acts on limbs at rest."""
        active = lane_zeros((1, 2 * self.limbs + 2), self.width)
        set_accelerations(
            self.mesh, self._space.edges, self.x_m, self.v_mps, active, self._water(), self.a_mps2
        )

    def _water(self) -> Numbers:
        """Nothing where all water is still, which costs nothing."""
        moves = any(water != STILL for water in self.water)
        numbers = lane_zeros((WATER if moves else 0, 1), self.width)
        if moves:
            lane_floats(numbers)[:, 0, :] = np.column_stack([water.numbers() for water in self.water])
        return numbers

    def run(
        self, step_s: Sequence[FloatArray], active: Sequence[FloatArray], factor_every: int, trace: bool
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Take each lane's own steps.

        Args:
            step_s: for each lane (k,) lengths.
            active: for each lane (k, 2 * limbs).
            factor_every: see frogkick.der.stepping.run_steps.
            trace: whether to return the motion after each step.

        Returns:
            The (3, width) report of run_steps, and for each lane (k, MOTION) rows about its origin, or none.
        """
        longest = max(len(steps) for steps in step_s)
        lengths = lane_zeros((longest, 1), self.width)
        strokes = lane_zeros((longest, 2 * self.limbs + 2), self.width)
        for lane, (steps, rows) in enumerate(zip(step_s, active, strict=True)):
            lane_floats(lengths)[: len(steps), 0, lane] = steps
            lane_floats(strokes)[: len(steps), : rows.shape[1], lane] = rows
        report = lane_zeros((3, 1), self.width)
        sums = lane_zeros((longest if trace else 0, SUMS), self.width)
        run_steps(
            self.mesh,
            self.plan,
            self._space,
            self.x_m,
            self.v_mps,
            self.a_mps2,
            lengths,
            strokes,
            self._water(),
            factor_every,
            report,
            sums,
        )
        rows = lane_floats(sums)
        traces = [
            body_motion(np.ascontiguousarray(rows[: len(steps), :, lane])) if trace else np.empty((0, MOTION))
            for lane, steps in enumerate(step_s)
        ]
        return lane_floats(report)[:, 0, :].copy(), traces

    def motion(self) -> FloatArray:
        """(width, MOTION) poses about the origins, velocities, plain means."""
        sums = lane_zeros((1, SUMS), self.width)
        set_sums(self.mesh, self.x_m, self.v_mps, 0, sums)
        return np.asarray(body_motion(np.ascontiguousarray(lane_floats(sums)[0].T)))

    def copy_lane(self, lane: int, other: _State, to: int) -> None:
        """Copy one lane of this state into a lane of another."""
        for mine, theirs in ((self.x_m, other.x_m), (self.v_mps, other.v_mps), (self.a_mps2, other.a_mps2)):
            lane_floats(theirs)[..., to] = lane_floats(mine)[..., lane]
        other.water[to] = self.water[lane]


class _Walk:
    """One lane on its own through hard steps."""

    def __init__(
        self, state: _State, active: Callable[[FloatArray], FloatArray], trace: bool, residual: float
    ) -> None:
        self._state, self._active, self._trace = state, active, trace
        self.residual = residual  # of the last step that failed
        self.corrections = 0.0
        self.ends: list[FloatArray] = []
        self.rows: list[FloatArray] = []

    def take(self, times_s: FloatArray, factor_every: int) -> int:
        """Take steps; return how many succeeded."""
        report, (rows,) = self._state.run(
            [np.diff(times_s)], [self._active(times_s)], factor_every, self._trace
        )
        self.corrections += float(report[2, 0])
        taken = len(times_s) - 1
        if report[0, 0] >= 0.0:
            taken, self.residual = int(report[0, 0]), float(report[1, 0])
        self.ends.append(times_s[1 : taken + 1])
        self.rows.append(rows[:taken])
        return taken

    def cut(self, time_s: float, until_s: float) -> float:
        """Take one step in 2, 4, 8 ... pieces, by Newton's own method; return the time reached."""
        for halving in range(1, MAX_HALVINGS + 1):
            pieces = np.linspace(time_s, until_s, (1 << halving) + 1)
            time_s = float(pieces[self.take(pieces, 1)])
            if time_s == until_s:
                break
        return time_s


class Batch:
    """Robots of one mesh, each in a lane and in water of its own, with its own clock, strokes and steps.

    What a lane does depends neither on the width nor on the other lanes, to the last bit. A lane that fails
    stops where it is and is listed in ``failures``; the others go on.
    """

    def __init__(
        self,
        mesh: Mesh,
        plan: Plan,
        actuations: Sequence[Actuation],
        pose_world: FloatArray,
        velocity_body: FloatArray,
        *,
        limbs: int,
        time_s: float,
        step_s: float,
        width: int = WIDTH,
    ) -> None:
        """Place rigidly moving robots with all limbs at rest.

        Args:
            mesh, plan: of the robot.
            actuations: one for each lane: what its strokes do to a limb.
            pose_world: (lanes, 3) x, y (m), heading (rad), world frame, finite.
            velocity_body: (lanes, 3) forward, left (m/s), turn rate (rad/s), body frame, finite.
            limbs: how many the robot has.
            time_s: what all clocks show now.
            step_s: finest time step, s, positive.
            width: numbers side by side, at least as many as robots; the rest idle.
        """
        self.lanes = len(actuations)
        self.time_s = np.full(self.lanes, float(time_s))
        self.failures: dict[int, Failure] = {}
        self.corrections = np.zeros(self.lanes)
        self._actuations = tuple(actuations)
        self._paces = [pace_of(actuation) for actuation in actuations]
        self._step_s = float(step_s)
        self._strokes: list[list[list[Stroke]]] = [[[] for _ in range(limbs)] for _ in actuations]
        self._state = _State(mesh, plan, limbs, width)
        self._alone: _State | None = None
        # Nodes are kept relative to a moving origin: far out, rounding would spoil strains of 1e-9.
        self._origin = np.array(pose_world[:, :2], dtype=np.float64)
        x, v = place_nodes(mesh, pose_world[:, 2], velocity_body)
        chosen = [*range(self.lanes), *[0] * (width - self.lanes)]  # idle lanes hold a valid state
        lane_floats(self._state.x_m)[...] = x[..., chosen]
        lane_floats(self._state.v_mps)[...] = v[..., chosen]
        self._state.start()

    def fire(
        self, lane: int, limb: int, time_s: float, *, gain: float = 1.0, duration_scale: float = 1.0
    ) -> None:
        """Start a stroke of a lane's limb, now or later by its clock; of two strokes the larger one acts.

        Args:
            gain: share of the measured stroke.
            duration_scale: how much longer than measured the limb takes to curl back once it is straight.
        """
        self._strokes[lane][limb].append(Stroke(float(time_s), float(gain), float(duration_scale)))

    def set_water(self, lane: int, water: Water) -> None:
        """Let the water around a lane's robot move, and push the robot, from now on."""
        self._state.water[lane] = water
        if not self.corrections.any():  # nothing has moved yet: it starts in this water
            self._state.start()

    def shift(self, lane: int, pose_world: Sequence[float], velocity_world: Sequence[float]) -> None:
        """Move a lane's robot as a whole: by (m, m, rad about its centre), and its velocity likewise."""
        turn = rotation(pose_world[2])
        x, v, a = (lane_floats(each) for each in (self._state.x_m, self._state.v_mps, self._state.a_mps2))
        centre = self._state.motion()[lane, :2]
        arms = (x[..., lane] - centre) @ turn.T
        x[..., lane] = centre + arms
        v[..., lane] = v[..., lane] @ turn.T + np.asarray(velocity_world[:2])
        v[..., lane] += velocity_world[2] * np.column_stack([-arms[:, 1], arms[:, 0]])
        a[..., lane] = a[..., lane] @ turn.T
        self._origin[lane] += pose_world[:2]

    def pick(self, lanes: Sequence[int]) -> Batch:
        """Some lanes' robots again, 1 to the width, amid their strokes, to go on from here by themselves."""
        twin, chosen, width = copy.copy(self), list(lanes), self._state.width
        twin.lanes = len(chosen)
        twin.time_s, twin.corrections = self.time_s[chosen], self.corrections[chosen]
        twin.failures = {to: self.failures[k] for to, k in enumerate(chosen) if k in self.failures}
        twin._actuations = tuple(self._actuations[k] for k in chosen)
        twin._paces = [self._paces[k] for k in chosen]
        twin._strokes = [[list(starts) for starts in self._strokes[k]] for k in chosen]
        idle = [chosen[0]] * (width - len(chosen))  # a valid state, as in __init__
        twin._state, twin._alone = self._state.pick([*chosen, *idle]), None
        twin._origin = self._origin[chosen]
        return twin

    def advance(
        self, until_s: float | FloatArray, trace: bool = False
    ) -> list[tuple[FloatArray, FloatArray]]:
        """Let time pass until all clocks, or each its own, show ``until_s``, later than what they show now.

        Args:
            until_s: s; a lane whose clock shows as much already stands still.
            trace: whether to return how the lanes moved.

        Returns:
            For each lane the times (k,) after each step that it took, and (k, MOTION) rows of
            frogkick.der.body.body_motion in the world frame; no rows without ``trace``.
        """
        until = np.broadcast_to(np.asarray(until_s, dtype=np.float64), (self.lanes,))
        times = [np.empty(0)] * self.lanes
        for lane in range(self.lanes):
            if lane not in self.failures and until[lane] > self.time_s[lane]:
                times[lane] = self._times(lane, float(until[lane]))
        going = [lane for lane in range(self.lanes) if len(times[lane])]
        if not going:
            return [(np.empty(0), np.empty((0, MOTION))) for _ in range(self.lanes)]
        active = [self._active(lane, times[lane]) for lane in range(self.lanes)]
        report, rows = self._state.run([np.diff(t) for t in times], active, FACTOR_EVERY, trace)
        self.corrections += report[2, : self.lanes]
        ends = [t[1:] for t in times]
        for lane in going:
            self.time_s[lane] = until[lane]
            if report[0, lane] >= 0.0:
                ends[lane], rows[lane] = self._go_alone(
                    lane, times[lane], int(report[0, lane]), float(report[1, lane]), rows[lane]
                )
            rows[lane][:, 0:2] += self._origin[lane]
            rows[lane][:, 6:8] += self._origin[lane]
        self._recentre(going)
        return [(ends[lane], rows[lane]) for lane in range(self.lanes)]

    def _times(self, lane: int, until_s: float) -> FloatArray:
        now, duration_s = float(self.time_s[lane]), self._actuations[lane].duration_s
        strokes = self._strokes[lane]
        for of_limb in strokes:
            of_limb[:] = [
                each for each in of_limb if each.start_s + max(RINGS_S, duration_s * each.longest) > now
            ]
        every = [each for of_limb in strokes for each in of_limb]
        return step_times(now, until_s, every, self._paces[lane], self._step_s)

    def _active(self, lane: int, times_s: FloatArray) -> FloatArray:
        """(steps, 2 * limbs) activation and fall of the natural curvature of each limb in these steps."""
        strokes = self._strokes[lane]
        table = np.full((len(strokes), max([1, *map(len, strokes)]), 3), np.nan)
        for row, of_limb in zip(table, strokes, strict=True):
            for place, stroke in enumerate(of_limb):
                row[place] = stroke
        actuation = self._actuations[lane]
        at = times_s[:-1] + EVALUATION_SHARE * np.diff(times_s)
        peak_s = self._paces[lane].peak_s
        active = stroke_activation(at, table, actuation.activation, actuation.step_s, peak_s)
        rows = np.empty((len(at), 2 * len(strokes)))
        rows[:, 0::2] = active
        rows[:, 1::2] = actuation.drop_per_m * active
        return rows

    def _go_alone(
        self, lane: int, times_s: FloatArray, step: int, residual: float, before: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Take the steps from a failed one on alone, cutting each that fails in halves again and again.

        Returns:
            Times and rows, as ``advance`` does, about the lane's origin.
        """
        if self._alone is None:
            self._alone = _State(self._state.mesh, self._state.plan, self._state.limbs, 1)
        alone = self._alone
        self._state.copy_lane(lane, alone, 0)
        walk = _Walk(alone, lambda times: self._active(lane, times), len(before) > 0, residual)
        walk.ends, walk.rows = [times_s[1 : step + 1]], [before[:step]]
        reached, now, last = float(times_s[step]), step, len(times_s) - 1
        while now < last:
            reached = walk.cut(float(times_s[now]), float(times_s[now + 1]))
            if reached < times_s[now + 1]:
                break
            now += 1
            if now < last:
                now += walk.take(times_s[now:], FACTOR_EVERY)
                reached = float(times_s[now])
        self.corrections[lane] += walk.corrections
        alone.copy_lane(0, self._state, lane)
        self.time_s[lane] = reached
        if now < last:
            pose, velocity = self.pose_world()[lane].tolist(), self.velocity_body()[lane].tolist()
            self.failures[lane] = Failure(reached, walk.residual, tuple(pose), tuple(velocity))
        return np.concatenate(walk.ends), np.concatenate(walk.rows)

    def _recentre(self, lanes: Sequence[int]) -> None:
        motion = self._state.motion()
        for lane in lanes:
            self._origin[lane] += motion[lane, :2]
            lane_floats(self._state.x_m)[..., lane] -= motion[lane, :2]

    @property
    def mass_kg(self) -> float:
        """What it takes to accelerate a robot, with the water that it takes along."""
        return float(self._state.mesh.mass_kg.sum())

    @property
    def inertia_kg_m2(self) -> float:
        """Moment of inertia about its centre of mass with all limbs at rest, likewise."""
        mesh = self._state.mesh
        return float(mesh.mass_kg @ (mesh.rest_m**2).sum(axis=1))

    def motion_world(self) -> FloatArray:
        """(lanes, MOTION) rows of frogkick.der.body.body_motion, in the world frame."""
        motion = self._state.motion()[: self.lanes]
        motion[:, 0:2] += self._origin
        motion[:, 6:8] += self._origin
        return motion

    def pose_world(self) -> FloatArray:
        """(lanes, 3) x, y (m) and heading (rad, in (-pi, pi]) in the world frame."""
        return self.motion_world()[:, :3]

    def velocity_body(self) -> FloatArray:
        """(lanes, 3) forward, left (m/s) and turn rate (rad/s) in the body frame."""
        return self.motion_world()[:, 3:6]

    def nodes_world(self) -> FloatArray:
        """(lanes, n, 2) node positions, m: the frame counter-clockwise, then each limb from root to tip."""
        nodes = np.moveaxis(lane_floats(self._state.x_m), 2, 0)[: self.lanes]
        return np.asarray(nodes + self._origin[:, None, :])

    def node_velocities_world(self) -> FloatArray:
        """(lanes, n, 2) node velocities, m/s."""
        return np.moveaxis(lane_floats(self._state.v_mps), 2, 0)[: self.lanes].copy()
