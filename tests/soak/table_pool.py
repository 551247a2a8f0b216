"""A pool whose robot moves as a table says: for lives too long for the rods."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from frogkick.core.poses import Fix
from frogkick.pool.pool import Camera, Pool, Truth
from frogkick.tables.image import Tables

_TOGETHER_S = 0.005  # limbs of one group
_STROKE_S = 0.3  # longer than from the first group to the second
_COAST_S = 1.0  # in which a glide loses all but 1/e of its speed
_NOISE = 0.05  # of each stroke's motion


class TableBatch:
    """What ``Pool`` needs of a batch of one. Half strokes that are no action of the table move nothing."""

    def __init__(self, tables: Tables, pose_world: npt.ArrayLike, rng: np.random.Generator) -> None:
        self.time_s, self.failures, self.limbs = np.zeros(1), dict[int, str](), tables.limbs
        self._rng = rng
        self._period_s = tables.period_us * 1e-6
        self._fire = (tables.pulse_us + tables.second_delay_us) / tables.period_us
        self._states = tables.states.astype(np.float64)
        self._scale = tables.velocity_scale.astype(np.float64)
        self._moves = tables.transitions * np.concatenate(
            [tables.motion_scale.astype(np.float64), self._scale]
        )
        self._rows = {(row.first_mask, row.second_mask): index for index, row in enumerate(tables.actions)}
        self._pose = np.array(pose_world, dtype=np.float64)
        self._speed = np.zeros(3)  # body, as the stroke begins
        self._motion = np.zeros(3)
        self._after = np.zeros(3)
        self._gain = 1.0
        self._begin_s = -1e9
        self._masks = (0, 0)

    def fire(self, limb: int, time_s: float) -> None:
        """A limb is heated: it begins a stroke, or is part of the one that has just begun."""
        since_s = time_s - self._begin_s
        if since_s > _STROKE_S:
            self._pose, self._speed = self._pose_at(time_s), self._speed_at(time_s)
            self._begin_s = time_s
            self._masks = (1 << limb, 0)
            self._gain = 1.0 + _NOISE * float(self._rng.standard_normal())
        elif since_s < _TOGETHER_S:
            self._masks = (self._masks[0] | 1 << limb, self._masks[1])
        else:
            self._masks = (self._masks[0], self._masks[1] | 1 << limb)
        action = self._rows.get(self._masks)
        if action is None:
            self._after, self._motion = self._speed * math.exp(-self._period_s / _COAST_S), np.zeros(3)
            return
        off = self._states - self._speed / self._scale
        move = self._moves[int(np.argmin((off**2).sum(axis=1))), action]
        self._motion, self._after = self._gain * move[:3], move[3:]

    def advance(self, until_s: float) -> None:
        self.time_s[0] = until_s

    def pose_world(self) -> npt.NDArray[np.float64]:
        return self._pose_at(float(self.time_s[0]))[None]

    def velocity_body(self) -> npt.NDArray[np.float64]:
        return self._speed_at(float(self.time_s[0]))[None]

    def _part(self, time_s: float) -> float:
        return max(0.0, (time_s - self._begin_s) / self._period_s)

    def _pose_at(self, time_s: float) -> npt.NDArray[np.float64]:
        part = self._part(time_s)
        forward, left, turn = self._motion * self._way(min(part, 1.0))
        coast = self._after * _COAST_S * (1.0 - math.exp(-max(0.0, part - 1.0) * self._period_s / _COAST_S))
        c, s = math.cos(self._pose[2]), math.sin(self._pose[2])
        x, y = forward + coast[0], left + coast[1]
        return np.array(
            [self._pose[0] + c * x - s * y, self._pose[1] + s * x + c * y, self._pose[2] + turn + coast[2]]
        )

    def _way(self, part: float) -> float:
        """Of a stroke's motion, what is done: it gathers way while limbs fire, then glides."""
        if part <= self._fire:
            done = 0.5 * part * part / self._fire
        else:
            glide = 1.0 - self._fire
            s = (part - self._fire) / glide
            done = 0.5 * self._fire + glide * (s - 0.75 * s * s + s * s * s / 6.0)
        return done / (0.5 * self._fire + (1.0 - self._fire) * (5.0 / 12.0))

    def _speed_at(self, time_s: float) -> npt.NDArray[np.float64]:
        part = self._part(time_s)
        if part < 1.0:
            return self._speed + (self._after - self._speed) * part
        return self._after * math.exp(-(part - 1.0) * self._period_s / _COAST_S)


class _NoEffects:
    effects = ()

    def fire(self, batch: TableBatch, lane: int, limb: int, start_s: float) -> None:
        batch.fire(limb, start_s)

    def advance(self, batch: TableBatch, until_s: float) -> None:
        batch.advance(until_s)


class TablePool(Pool):
    """``Pool`` with such a robot."""

    def __init__(
        self, tables: Tables, pose_world: npt.ArrayLike, camera: Camera, rng: np.random.Generator
    ) -> None:
        self.camera = camera
        self.truth = Truth()
        self._acting = _NoEffects()
        self._batch = TableBatch(tables, pose_world, rng.spawn(1)[0])
        self._rng = rng
        self._captured = 0
        self._sent = 0
        self._waiting: list[tuple[float, int, Fix]] = []
        self._arrived: list[Fix] = []
