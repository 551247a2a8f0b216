"""Watches a long life: pins within limits, soon back at work and on the route, memory constant."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from tests.soak.route import POINTS, Route

from frogkick.link.wire import Edge
from frogkick.pool.monitor import Pulse, violations
from frogkick.robot import Robot

RUN_S = 10.0
"""After a disturbance the robot decides again within this; without one it never pauses for longer."""
BACK_S = 45.0
"""After a disturbance it is back on the route within this, and stays there until the next one."""
NEAR_M = 0.05
"""On the route: the true mean distance to it over MEAN_S is below this.

In the route's bends, which are as tight as this swimmer turns, a life that nothing disturbs is farther off
now and then (55.7 mm within four hours). So after BACK_S an excursion is a fault where it lasts longer than
BACK_S, and the worst of a whole life is judged beside an undisturbed life: ``test_soak``."""
MEAN_S = 20
ADVANCE_S, ADVANCE_M = 90, 0.3
"""With BACK_S and this long since the last disturbance it has got on along the route by so much meanwhile."""
UPDATE_S = 180.0
"""What the host wants to do to the table is done after this, whatever gets between."""
BLOCKS_MOST = 3000
RSS_MOST_BYTES = 8 * 2**20
"""What the process may grow by after its warm-up: objects of Python; all memory, where that is told."""
_PINS_S = 60.0


@dataclass
class Figures:
    """What a life came to.

    Attributes:
        disturbances: how many of each kind.
        running_s, back_s: of each disturbance that had the time: until the robot decided again, and until it
            was back on the route.
        distance_sum_m, distances: of the true distance to the route, once a second, when on the route.
        worst_mean_m: largest mean over MEAN_S then.
        advanced_m: along the route.
    """

    disturbances: dict[str, int] = field(default_factory=dict)
    running_s: list[float] = field(default_factory=list)
    back_s: list[float] = field(default_factory=list)
    distance_sum_m: float = 0.0
    distances: int = 0
    worst_mean_m: float = 0.0
    advanced_m: float = 0.0
    decisions: int = 0
    pulses: int = 0


class Watch:
    """See the module.

    Attributes:
        faults: what must not be, one line each.
        figures: what it came to.
    """

    def __init__(self, robot: Robot, route: Route, warm_s: float) -> None:
        self.faults: list[str] = []
        self.figures = Figures()
        self._robot = robot
        self._route = route
        self._quiet_s = 0.0
        self._kind = "start"
        self._decided_s = 0.0
        self._is_running = self._is_back = False
        self._near: deque[float] = deque(maxlen=MEAN_S)
        self._along: deque[float] = deque(maxlen=ADVANCE_S + 1)
        self._index = 0
        self._near_s = 0.0
        self._on: dict[int, float] = {}
        self._pulses: list[Pulse] = []
        self._judged_s = 0.0
        self._warm_s = warm_s
        self._memory: tuple[int, int] | None = None
        self.grown = (0, 0)

    def disturb(self, kind: str, over_s: float) -> None:
        """Something disturbs the robot, and is over at a time."""
        self.figures.disturbances[kind] = self.figures.disturbances.get(kind, 0) + 1
        self.still_disturbed(kind, over_s)

    def still_disturbed(self, kind: str, over_s: float) -> None:
        """It is over only then."""
        self._quiet_s = max(self._quiet_s, over_s)
        self._kind = kind
        self._is_running = self._is_back = False
        self._near.clear()
        self._along.clear()

    def decided(self, time_s: float) -> None:
        """The robot has decided, knowing where it was."""
        self.figures.decisions += 1
        self._decided_s = time_s
        if not self._is_running and time_s >= self._quiet_s:
            self._is_running = True
            self.figures.running_s.append(time_s - self._quiet_s)

    def place(self, time_s: float, position_m: Sequence[float]) -> None:
        """Where the robot truly is, once a second."""
        index, distance_m = self._route.place(position_m)
        step = (index - self._index + POINTS // 2) % POINTS - POINTS // 2
        self._index = index
        self.figures.advanced_m += step * self._route.spacing_m
        if time_s < self._quiet_s:
            return
        self._near.append(distance_m)
        self._along.append(self.figures.advanced_m)
        since_s = time_s - self._quiet_s
        if time_s - max(self._decided_s, self._quiet_s) > RUN_S:
            self._complain(time_s, f"no decision for more than {RUN_S:g} s")
        if len(self._near) < MEAN_S:
            return
        mean_m = float(np.mean(self._near))
        if mean_m < NEAR_M:
            self._near_s = time_s
        if not self._is_back and mean_m < NEAR_M and self._is_running:
            self._is_back = True
            self.figures.back_s.append(since_s)
        if since_s > BACK_S:
            self.figures.distance_sum_m += distance_m
            self.figures.distances += 1
            self.figures.worst_mean_m = max(self.figures.worst_mean_m, mean_m)
            off_s = time_s - max(self._near_s, self._quiet_s + BACK_S)
            if mean_m >= NEAR_M and (not self._is_back or off_s > BACK_S):
                self._complain(time_s, f"{mean_m * 1e3:.1f} mm off the route")
        if since_s > BACK_S + ADVANCE_S and self._along[-1] - self._along[0] < ADVANCE_M:
            self._complain(time_s, f"got on by {self._along[-1] - self._along[0]:.3f} m in {ADVANCE_S} s")

    def _complain(self, time_s: float, what: str) -> None:
        self.faults.append(f"at {time_s:.1f} s, {time_s - self._quiet_s:.1f} s after {self._kind}: {what}")

    def pins(self, edges: Sequence[Edge], time_s: float) -> None:
        """Edges of the pins; judged once a minute, with those before that still count."""
        for edge in edges:
            if edge.level:
                self._on.setdefault(edge.limb, edge.time_s)
            elif edge.limb in self._on:
                self._pulses.append(Pulse(edge.limb, self._on.pop(edge.limb), edge.time_s))
                self.figures.pulses += 1
        if time_s - self._judged_s >= _PINS_S:
            self.judge_pins(time_s)

    def judge_pins(self, time_s: float) -> None:
        """Every pulse since the last time against the robot's limits."""
        still = [Pulse(limb, start_s, time_s) for limb, start_s in self._on.items()]
        self.faults += violations(self._robot, [*self._pulses, *still])
        before_s = time_s - 2.0 * self._robot.guard.duty_window_s
        self._pulses = [pulse for pulse in self._pulses if pulse.end_s > before_s]
        self._judged_s = time_s

    def memory(self, time_s: float) -> None:
        """This process's memory: after its warm-up it must not grow."""
        now = (sys.getallocatedblocks(), _rss_bytes())
        if time_s < self._warm_s:
            return
        if self._memory is None:
            self._memory = now
        self.grown = (now[0] - self._memory[0], now[1] - self._memory[1])
        if self.grown[0] > BLOCKS_MOST or self.grown[1] > RSS_MOST_BYTES:
            self.faults.append(f"at {time_s:.1f} s memory has grown by {self.grown} (objects, bytes)")


def _rss_bytes() -> int:
    """Memory of this process that is in RAM; 0 where the system does not tell it in Linux's way."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096
    except OSError:
        return 0
