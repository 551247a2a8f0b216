"""Rods that replay runs: bounded steps, and checkpoints of a robot between its strokes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from frogkick.der import WIDTH, Batch, Rods, Water, prepare
from frogkick.der.body import MOTION, SUMS, body_motion
from frogkick.der.compiled import run_steps
from frogkick.der.lanes import Numbers, lane_floats, lane_zeros
from frogkick.der.schedule import RINGS_S, Stroke
from frogkick.der.stepping import EVALUATION_SHARE, FACTOR_EVERY
from frogkick.identification.step_layout import lane_times, lay_out
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

LONGEST_S = 8e-3
"""Longest step. Some longer ones fail to converge, and then their lane goes on alone at the cost of eight
lanes."""


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A lane's robot between its strokes, saved from a batch.

    Attributes:
        nodes: (n, 2) positions about the origin, velocities, accelerations.
        water: around it.
        strokes: of each limb.
        origin_m: (2,) world frame.
        time_s: its clock.
        failed: its simulation failed before.
    """

    nodes: tuple[FloatArray, ...]
    water: Water
    strokes: tuple[tuple[Stroke, ...], ...]
    origin_m: FloatArray
    time_s: float
    failed: bool


class Gentle(Batch):
    """A batch of bounded steps whose lanes can be saved and restored."""

    def __init__(self, rods: Rods, pose_world: FloatArray, limbs: int, step_s: float) -> None:
        super().__init__(
            rods.mesh,
            rods.plan,
            [rods.actuation] * len(pose_world),
            pose_world,
            np.zeros((len(pose_world), 3)),
            limbs=limbs,
            time_s=0.0,
            step_s=step_s,
            width=WIDTH,
        )
        self._active_strokes: dict[int, list[list[Stroke]]] = {}
        self._stroke_arrays: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def fire(
        self, lane: int, limb: int, time_s: float, *, gain: float = 1.0, duration_scale: float = 1.0
    ) -> None:
        super().fire(lane, limb, time_s, gain=gain, duration_scale=duration_scale)
        self._active_strokes.pop(lane, None)

    def advance(
        self, until_s: float | FloatArray, trace: bool = False
    ) -> list[tuple[FloatArray, FloatArray]]:
        """As in Batch, with the steps of all lanes laid out at once."""
        until = np.array(np.broadcast_to(np.asarray(until_s, dtype=np.float64), (self.lanes,)))
        moving = until > self.time_s
        moving[list(self.failures)] = False
        if not moving.any():
            return [(np.empty(0), np.empty((0, MOTION))) for _ in range(self.lanes)]
        starts_s, scales, strokes = self._strokes_now()
        actuation, pace, state = self._actuations[0], self._paces[0], self._state
        shape = (pace.coarseness, pace.every_s, pace.over_s, pace.peak_s)
        times, counts = lane_times(
            self.time_s, until, moving, starts_s, scales, shape, self._step_s, LONGEST_S
        )
        longest = int(counts.max()) - 1
        lengths = lane_zeros((longest, 1), state.width)
        active = lane_zeros((longest, 2 * state.limbs + 2), state.width)
        lay_out(
            times,
            counts,
            strokes,
            (actuation.activation, actuation.step_s, pace.peak_s),
            actuation.drop_per_m,
            EVALUATION_SHARE,
            lane_floats(lengths),
            lane_floats(active),
        )
        steps = [max(int(count) - 1, 0) for count in counts]
        report, rows = self._run(lengths, active, steps, trace)
        self.corrections += report[2, : self.lanes]
        ends = [times[lane, 1 : count + 1] for lane, count in enumerate(steps)]
        some = np.flatnonzero(moving).tolist()
        for lane in some:
            self.time_s[lane] = until[lane]
            if report[0, lane] >= 0.0:
                mine = times[lane, : counts[lane]]
                ends[lane], rows[lane] = self._go_alone(
                    lane, mine, int(report[0, lane]), float(report[1, lane]), rows[lane]
                )
            rows[lane][:, 0:2] += self._origin[lane]
            rows[lane][:, 6:8] += self._origin[lane]
        self._recentre(some)
        return [(ends[lane], rows[lane]) for lane in range(self.lanes)]

    def _run(
        self, lengths: Numbers, active: Numbers, steps: Sequence[int], trace: bool
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Run steps that are laid out already; see ``run`` of the state."""
        state = self._state
        report = lane_zeros((3, 1), state.width)
        sums = lane_zeros((len(lengths) if trace else 0, SUMS), state.width)
        run_steps(
            state.mesh,
            state.plan,
            state._space,
            state.x_m,
            state.v_mps,
            state.a_mps2,
            lengths,
            active,
            state._water(),
            FACTOR_EVERY,
            report,
            sums,
        )
        rows = lane_floats(sums)
        traces = [
            body_motion(np.ascontiguousarray(rows[:count, :, lane])) if trace else np.empty((0, MOTION))
            for lane, count in enumerate(steps)
        ]
        return lane_floats(report)[:, 0, :].copy(), traces

    def _strokes_now(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(lanes, m) starts and duration scales of strokes in order, and (lanes, limbs, m, 3) all fields."""
        for lane in range(self.lanes):
            if lane not in self._active_strokes:
                self._active_strokes[lane] = self._active_strokes_of(lane)
                self._stroke_arrays = None
        if self._stroke_arrays is None:
            every = [self._active_strokes[lane] for lane in range(self.lanes)]
            most = max([1, *(len(of_limb) for lane in every for of_limb in lane)])
            limbs = self._state.limbs
            starts_s = np.full((self.lanes, limbs * most), np.inf)
            scales = np.ones((self.lanes, limbs * most))
            strokes = np.full((self.lanes, limbs, most, 3), np.nan)
            for lane, of_lane in enumerate(every):
                known = sorted(stroke for of_limb in of_lane for stroke in of_limb)
                for place, stroke in enumerate(known):
                    starts_s[lane, place], scales[lane, place] = stroke.start_s, stroke.duration_scale
                for limb, of_limb in enumerate(of_lane):
                    for place, stroke in enumerate(of_limb):
                        strokes[lane, limb, place] = stroke
            self._stroke_arrays = starts_s, scales, strokes
        return self._stroke_arrays

    def _active_strokes_of(self, lane: int) -> list[list[Stroke]]:
        """A lane's strokes that still act."""
        now, duration_s = float(self.time_s[lane]), self._actuations[lane].duration_s
        for of_limb in self._strokes[lane]:
            of_limb[:] = [
                each for each in of_limb if each.start_s + max(RINGS_S, duration_s * each.longest) > now
            ]
        return self._strokes[lane]

    def shift_some(self, moves: Mapping[int, tuple[FloatArray, FloatArray]]) -> None:
        """``shift`` several lanes, each by a pose and a velocity: (3,) each, world frame."""
        centres = self._state.motion()[:, :2]
        x, v, a = (lane_floats(each) for each in (self._state.x_m, self._state.v_mps, self._state.a_mps2))
        for lane, (pose, velocity) in moves.items():
            c, s = math.cos(pose[2]), math.sin(pose[2])
            turn = np.array([[c, -s], [s, c]])
            arms = (x[..., lane] - centres[lane]) @ turn.T
            x[..., lane] = centres[lane] + arms
            v[..., lane] = v[..., lane] @ turn.T + velocity[:2]
            v[..., lane] += velocity[2] * np.column_stack([-arms[:, 1], arms[:, 0]])
            a[..., lane] = a[..., lane] @ turn.T
            self._origin[lane] += pose[:2]

    def save(self, lane: int) -> Checkpoint:
        """Save a lane's robot as it is now."""
        nodes = (self._state.x_m, self._state.v_mps, self._state.a_mps2)
        return Checkpoint(
            tuple(lane_floats(each)[..., lane].copy() for each in nodes),
            self._state.water[lane],
            tuple(tuple(of_limb) for of_limb in self._strokes[lane]),
            self._origin[lane].copy(),
            float(self.time_s[lane]),
            lane in self.failures,
        )

    def restore(self, lane: int, checkpoint: Checkpoint) -> None:
        """Restore a robot of the same body in a lane."""
        nodes = (self._state.x_m, self._state.v_mps, self._state.a_mps2)
        for mine, theirs in zip(nodes, checkpoint.nodes, strict=True):
            lane_floats(mine)[..., lane] = theirs
        self._state.water[lane] = checkpoint.water
        self._strokes[lane] = [list(of_limb) for of_limb in checkpoint.strokes]
        self._active_strokes.pop(lane, None)
        self._origin[lane], self.time_s[lane] = checkpoint.origin_m, checkpoint.time_s
        self.corrections[lane] = 1.0  # it has moved already: its accelerations stay as they are


def gentle(robot: Robot, pose_world: FloatArray, step_s: float) -> Gentle:
    """Robots at rest: (lanes, 3) poses."""
    return Gentle(_rods(robot), pose_world, len(robot.limbs), step_s)


@lru_cache(maxsize=64)
def _rods(robot: Robot) -> Rods:
    return prepare(robot)
