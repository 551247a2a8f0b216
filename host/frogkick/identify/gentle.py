"""Rods that follow a run: no step gets too long, and a robot amid its strokes can go on elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from frogkick.der import WIDTH, Batch, Rods, Water, prepare
from frogkick.der.lanes import lane_floats
from frogkick.der.schedule import Stroke
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

LONGEST_S = 8e-3
"""No longer steps: some beyond fail to converge, and then their lane goes on alone at the price of eight."""


@dataclass(frozen=True, eq=False)
class Amid:
    """A lane's robot amid its strokes, taken out of a batch.

    Attributes:
        nodes: (n, 2) positions about the origin, velocities, accelerations.
        water: around it.
        strokes: of each limb.
        origin_m: (2,) world frame.
        time_s: its clock.
        failed: it did not get here.
    """

    nodes: tuple[FloatArray, ...]
    water: Water
    strokes: tuple[tuple[Stroke, ...], ...]
    origin_m: FloatArray
    time_s: float
    failed: bool


class Gentle(Batch):
    """Lanes whose steps never get too long, and that can go on elsewhere."""

    def _times(self, lane: int, until_s: float) -> FloatArray:
        ends = super()._times(lane, until_s)
        lengths = np.diff(ends)
        parts = np.maximum(np.ceil(lengths / LONGEST_S - 1e-9).astype(np.int64), 1)
        if parts.max(initial=1) == 1:
            return ends
        place = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        starts = np.repeat(ends[:-1], parts) + np.repeat(lengths / parts, parts) * place
        return np.append(starts, ends[-1])

    def leave(self, lane: int) -> Amid:
        """A lane's robot as it is now."""
        nodes = (self._state.x_m, self._state.v_mps, self._state.a_mps2)
        return Amid(
            tuple(lane_floats(each)[..., lane].copy() for each in nodes),
            self._state.water[lane],
            tuple(tuple(of_limb) for of_limb in self._strokes[lane]),
            self._origin[lane].copy(),
            float(self.time_s[lane]),
            lane in self.failures,
        )

    def enter(self, lane: int, amid: Amid) -> None:
        """Let a robot of the same body go on in a lane."""
        nodes = (self._state.x_m, self._state.v_mps, self._state.a_mps2)
        for mine, theirs in zip(nodes, amid.nodes, strict=True):
            lane_floats(mine)[..., lane] = theirs
        self._state.water[lane] = amid.water
        self._strokes[lane] = [list(of_limb) for of_limb in amid.strokes]
        self._origin[lane], self.time_s[lane] = amid.origin_m, amid.time_s
        self.corrections[lane] = 1.0  # it has moved already: its accelerations stay as they are


def gentle(robot: Robot, pose_world: FloatArray, step_s: float) -> Gentle:
    """Robots at rest: (lanes, 3) poses."""
    rods = _rods(robot)
    return Gentle(
        rods.mesh,
        rods.plan,
        [rods.actuation] * len(pose_world),
        pose_world,
        np.zeros((len(pose_world), 3)),
        limbs=len(robot.limbs),
        time_s=0.0,
        step_s=step_s,
        width=WIDTH,
    )


@lru_cache(maxsize=64)
def _rods(robot: Robot) -> Rods:
    return prepare(robot)
