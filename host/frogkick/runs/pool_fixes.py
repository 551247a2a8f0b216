"""Position fixes for a kit without limbs, from a simulated pool that gets the strokes the kit reports.

Only the robot in its water is simulated. Firmware, chip, clock, serial line and this program run in real
time.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from frogkick.core.poses import Fix
from frogkick.effects import World
from frogkick.pool.pool import Camera, Pool
from frogkick.robot import Robot
from frogkick.runs.decision import RESTING
from frogkick.runs.record import Recording
from frogkick.tables.image import Tables

LAG_S = 0.1
"""Delay of the pool behind the clock, slightly more than that of a camera or of a reported stroke."""
HELD_UP_S = 1.0
"""The pool's clock skips a longer time without a call, as while the program waits for Enter."""


class PoolFixes:
    """A ``FixSource`` over a simulated pool in real time.

    Attributes:
        pool: in its own time, ``LAG_S`` behind the clock.
        late: number of strokes that were reported after the pool had passed their start, which start late.
    """

    def __init__(
        self,
        robot: Robot,
        tables: Tables,
        pose_world: tuple[float, float, float],
        rng: np.random.Generator,
        rate_hz: float = 15.0,
        world: World = World(),  # noqa: B008 - frozen
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start with a robot at rest at x_m, y_m, heading_rad.

        ``rng`` and ``rate_hz`` are of the simulated camera, ``world`` holds the effects in the pool.
        """
        camera = Camera(rate_hz=rate_hz, delay_s=0.0)  # LAG_S is its delay
        _warm_up(Pool(robot, pose_world, camera, np.random.default_rng(0)))
        self.pool = Pool(robot, pose_world, camera, rng, world)
        self.late = 0
        self._tables, self._clock = tables, clock
        self._begin_s = self._asked_s = clock()
        self._shift_s = 0.0  # session time minus the pool's
        self._looked_s = 0.0
        self._decisions = self._events = 0
        self._strokes: list[tuple[float, int]] = []
        self._pulses: list[tuple[float, int]] = []

    @property
    def next_event_s(self) -> float:
        """Time of the next picture."""
        return max(self._looked_s + 1e-3, self.pool.next_event_s + LAG_S + self._shift_s)

    def wait_first(self, timeout_s: float) -> None:
        """Return at once: a simulated camera sees immediately."""

    def follow(self, recording: Recording) -> None:
        """Take the strokes that the robot has reported since the last call."""
        offset_us = recording.clock_offset_us
        for decision in recording.decisions[self._decisions :]:
            begin_us = (
                decision.scheduled_us + decision.plan_us - (offset_us if recording.options.onboard else 0)
            )
            if decision.status == 0:
                self._strokes.append((begin_us * 1e-6, decision.action))
        self._decisions = len(recording.decisions)
        for event in recording.events[self._events :]:
            if event.action == RESTING:  # the guard refused it, and the robot rests
                refused_s = (event.time_us - offset_us) * 1e-6
                period_s = self._tables.period_us * 1e-6
                self._strokes = [s for s in self._strokes if abs(s[0] - refused_s) > period_s / 2]
        self._events = len(recording.events)

    def advance(self, until_s: float) -> list[Fix]:
        """Advance the pool to a session time; return the fixes that arrived.

        Raises:
            ConvergenceError: the rod simulation failed.
        """
        now_s = self._clock()
        if now_s - self._asked_s > HELD_UP_S:
            self._begin_s += now_s - self._asked_s
        self._asked_s, self._looked_s = now_s, until_s
        self._shift_s = until_s - (now_s - self._begin_s)
        due_s = now_s - self._begin_s - LAG_S
        fixes: list[Fix] = []
        for at_s, limb in self._due(due_s):
            if at_s < self.pool.time_s:
                self.late += 1
            else:
                fixes += self.pool.advance(at_s)
            self.pool.actuate(limb, max(at_s, self.pool.time_s))
        if due_s > self.pool.time_s:
            fixes += self.pool.advance(due_s)
        for fix in fixes:
            fix.capture_s += self._shift_s
            fix.delay_s = until_s - fix.capture_s
        return fixes

    def actuate(self, limb: int, start_s: float) -> None:
        """No effect: the pins of a real kit are not seen."""

    def _due(self, due_s: float) -> list[tuple[float, int]]:
        """Take the pulses (pool time, limb) that start by a pool time, in order."""
        second_s = self._tables.second_delay_us * 1e-6
        for begin_s, action in self._strokes:
            if begin_s - self._shift_s > due_s:
                continue
            row = self._tables.actions[action]
            for mask, delay_s in ((row.first_mask, 0.0), (row.second_mask, second_s)):
                at_s = begin_s - self._shift_s + delay_s
                self._pulses += [(at_s, limb) for limb in range(self._tables.limbs) if mask >> limb & 1]
        self._strokes = [stroke for stroke in self._strokes if stroke[0] - self._shift_s > due_s]
        taken = sorted(pulse for pulse in self._pulses if pulse[0] <= due_s)
        self._pulses = [pulse for pulse in self._pulses if pulse[0] > due_s]
        return taken


def _warm_up(pool: Pool) -> None:
    """Load the rods' kernels by a short simulation."""
    pool.advance(0.01)
    pool.actuate(0, 0.01)
    pool.advance(0.03)
