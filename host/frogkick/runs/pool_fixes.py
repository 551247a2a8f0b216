"""Position fixes for a kit without limbs: a simulated pool that swims by the strokes the kit says it does.

All but the water is on trial: firmware on the real chip, its clock, its line, this program in real time.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from frogkick.core.poses import Fix
from frogkick.effects import World
from frogkick.pool.camera import Camera
from frogkick.pool.pool import Pool
from frogkick.robot import Robot
from frogkick.runs.closed_loop import Recording
from frogkick.runs.decision import RESTING
from frogkick.tables.image import Tables

LAG_S = 0.1
"""The pool is so far behind the clock: a little more than a camera is late, or a stroke is told late."""
HELD_UP_S = 1.0
"""Time in which nobody asked for so long, as before Enter is pressed, did not pass in the pool."""


class PoolFixes:
    """A ``FixSource`` over a simulated pool in real time.

    Attributes:
        pool: in its own time, ``LAG_S`` behind the clock.
        late: strokes that were told after the pool had passed their beginning; they begin then.
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
        """Put a robot at rest into the water.

        Args:
            robot: the swimmer.
            tables: what each action's limbs and times are.
            pose_world: x_m, y_m, heading_rad of its start.
            rng: source of the camera's noise.
            rate_hz: of the camera.
            world: what is true in the pool besides.
            clock: in s.
        """
        camera = Camera(rate_hz=rate_hz, delay_s=0.0)  # late it is by LAG_S
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
        """When the next picture is due here."""
        return max(self._looked_s + 1e-3, self.pool.next_event_s + LAG_S + self._shift_s)

    def wait_first(self, timeout_s: float) -> None:
        """A simulated camera sees at once."""

    def follow(self, recording: Recording, onboard: bool) -> None:
        """Take the strokes that the robot has told since the last call.

        Args:
            recording: of the run.
            onboard: whether its decisions are on the robot's clock.
        """
        offset_us = recording.clock_offset_us
        for decision in recording.decisions[self._decisions :]:
            begin_us = decision.scheduled_us + decision.plan_us - (offset_us if onboard else 0)
            if decision.status == 0:
                self._strokes.append((begin_us * 1e-6, decision.action))
        self._decisions = len(recording.decisions)
        for event in recording.events[self._events :]:
            if event.action == RESTING:  # the guard refused it, and the robot rests
                refused_s = (event.time_us - offset_us) * 1e-6
                period_s = self._tables.period_us * 1e-6
                self._strokes = [one for one in self._strokes if abs(one[0] - refused_s) > period_s / 2]
        self._events = len(recording.events)

    def advance(self, until_s: float) -> list[Fix]:
        """Swim until a session time; fixes of the pictures taken until then, as late as they are.

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
        """No pin of a real kit is seen."""

    def close(self) -> None:
        """Nothing is held open."""

    def _due(self, due_s: float) -> list[tuple[float, int]]:
        """Limbs to be heated by a pool time, in order, and when each is."""
        second_s = self._tables.second_delay_us * 1e-6
        for begin_s, action in self._strokes:
            if begin_s - self._shift_s > due_s:
                continue
            row = self._tables.actions[action]
            for mask, delay_s in ((row.first_mask, 0.0), (row.second_mask, second_s)):
                at_s = begin_s - self._shift_s + delay_s
                self._pulses += [(at_s, limb) for limb in range(self._tables.limbs) if mask >> limb & 1]
        self._strokes = [one for one in self._strokes if one[0] - self._shift_s > due_s]
        taken = sorted(one for one in self._pulses if one[0] <= due_s)
        self._pulses = [one for one in self._pulses if one[0] > due_s]
        return taken


def _warm_up(pool: Pool) -> None:
    """Let rods swim once where it matters to nobody: their kernels take a while to be loaded."""
    pool.advance(0.01)
    pool.actuate(0, 0.01)
    pool.advance(0.03)
