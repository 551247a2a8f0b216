"""States at the start of a library's transitions, the swims that visit them, and their simulations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.der import WIDTH
from frogkick.library.transitions import RESTED, Failed, Task, Transitions, rigid_task
from frogkick.robot import Mirror, Robot, mirror_of

TASK_ROBOTS = 2 * WIDTH
"""Robots of a task, some 0.4 s of work, for fine progress and a quick end on Ctrl-C."""

SWIM_STROKES = 12  # from rest to cruising takes about six
_HOLD_STROKES_MAX = 4  # an action is held for 1 to 4 strokes, as turns build up over several

_LEFT = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # mirrors (x, y, heading, vx, vy, omega)


@dataclass(frozen=True, eq=False)
class Starts:
    """n states and their simulations, one for each pair of mirror images.

    Attributes:
        tasks: simulations.
        part, row: (n,) the task of each state, and its state within the task.
        mirrored: (n,) whether the state is the mirror image of the simulated one.
        mirror: of the robot; None if it is not symmetric.
    """

    tasks: tuple[Task, ...]
    part: Int64
    row: Int64
    mirrored: Bool
    mirror: Mirror | None

    def __len__(self) -> int:
        return len(self.part)

    def of(self, state: int, simulated: NDArray[np.floating]) -> NDArray[np.floating]:
        """Results (a, .., 6) of a state from those of its simulation."""
        if not self.mirrored[state] or self.mirror is None:
            return simulated
        return np.asarray(simulated[list(self.mirror.actions)] * _LEFT.astype(simulated.dtype))

    def unfolded(self, parts: Sequence[Transitions]) -> Transitions:
        """Transitions from all states by those of the simulations, without recorded motions."""
        first = np.cumsum([0, *(len(part.rows) for part in parts)])
        source = first[self.part] + self.row
        velocity, previous, simulated = (
            np.concatenate([getattr(part, name) for part in parts])[source]
            for name in ("velocity_body", "previous", "rows")
        )
        if self.mirror is not None:
            velocity = np.where(self.mirrored[:, None], velocity * _LEFT[3:], velocity)
            actions = np.array([*self.mirror.actions, RESTED])  # index RESTED is the last entry
            previous = np.where(self.mirrored[:, None], actions[previous], previous)
        rows = np.array([self.of(state, row) for state, row in enumerate(simulated)])
        recorded = np.empty((*rows.shape[:2], 0, 6), dtype=np.float32)
        return Transitions(velocity + 0.0, previous, rows, recorded, self._failed(parts))  # -0.0 is 0.0

    def _failed(self, parts: Sequence[Transitions]) -> tuple[Failed, ...]:
        failures = [{(f.state, f.action): f.reason for f in part.failed} for part in parts]
        found: list[Failed] = []
        for state, (part, row) in enumerate(zip(self.part.tolist(), self.row.tolist(), strict=True)):
            for (source, action), reason in failures[part].items():
                if source == row and self.mirrored[state] and self.mirror is not None:
                    action, reason = self.mirror.actions.index(action), f"its mirror image {reason}"
                if source == row:
                    found.append(Failed(state, action, reason))
        return tuple(sorted(found, key=lambda f: (f.state, f.action)))


def rigid_starts(robot: Robot, velocities: Float64) -> Starts:
    """States with all limbs at rest and (n, 3) body velocities; one of each mirror pair is simulated."""
    mirror = mirror_of(robot)
    plain = velocities + 0.0
    if mirror is None:
        mirrored = np.zeros(len(plain), dtype=bool)
    else:
        mirrored = (plain[:, 1] < 0.0) | ((plain[:, 1] == 0.0) & (plain[:, 2] < 0.0))
    folded = np.where(mirrored[:, None], plain * _LEFT[3:], plain) + 0.0
    place: dict[tuple[float, ...], int] = {}
    source = np.array([place.setdefault(tuple(row), len(place)) for row in folded.tolist()], dtype=np.int64)
    unique = np.array(list(place), dtype=np.float64).reshape(-1, 3)
    tasks = [rigid_task(unique[first : first + TASK_ROBOTS]) for first in range(0, len(unique), TASK_ROBOTS)]
    return Starts(tuple(tasks), source // TASK_ROBOTS, source % TASK_ROBOTS, mirrored, mirror)


Swims = Iterable[Sequence[int]]
"""Actions of each swim from rest, one action a period."""


def random_swims(robot: Robot, seed: int) -> Iterator[list[int]]:
    """Yield the random actions of swims from rest, without end; each action is held for a few strokes."""
    swim = 0
    while True:
        rng = np.random.default_rng([seed, swim])
        actions: list[int] = []
        while len(actions) < SWIM_STROKES:
            action = int(rng.integers(len(robot.actions)))
            actions += [action] * int(rng.integers(1, _HOLD_STROKES_MAX + 1))
        yield actions[:SWIM_STROKES]
        swim += 1


class VisitedStates:
    """Distinct states at the decisions of swims from rest, with their mirror images."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._mirror = mirror_of(robot)
        self._seen: set[tuple[int, ...]] = set()
        self._swims: list[tuple[int, ...]] = []
        self._states: list[tuple[int, int, bool]] = []  # swim, stroke, mirrored

    def __len__(self) -> int:
        return len(self._states)

    def add(self, swims: Swims, states: int) -> None:
        """Add the states of swims up to a number of states."""
        for actions in swims:
            if len(self) >= states:
                return
            had = len(self)
            for stroke in range(len(actions)):
                before = self._moved(actions[:stroke])
                for mirrored, done in ((False, before), (True, self._mirrored(before))):
                    if done not in self._seen and len(self) < states:
                        self._states.append((len(self._swims), stroke, mirrored))
                        self._seen.add(done)
            if len(self) > had:
                self._swims.append(tuple(actions))

    def _moved(self, actions: Sequence[int]) -> tuple[int, ...]:
        """The actions since the first limb fired, which determine the state."""
        masks = [self._robot.actions[a].first_mask | self._robot.actions[a].second_mask for a in actions]
        first = next((i for i, mask in enumerate(masks) if mask), len(actions))
        return tuple(actions[first:])

    def _mirrored(self, actions: tuple[int, ...]) -> tuple[int, ...]:
        return actions if self._mirror is None else tuple(self._mirror.actions[a] for a in actions)

    def starts(self) -> Starts:
        """All visited states, in the order of the first visit."""
        tasks: list[Task] = []
        part, row = np.empty(len(self), np.int64), np.empty(len(self), np.int64)
        order = np.array(self._states, dtype=np.int64).reshape(-1, 3)
        for first in range(0, len(self._swims), WIDTH):
            swims = self._swims[first : first + WIDTH]
            mine = (order[:, 0] >= first) & (order[:, 0] < first + WIDTH)
            strokes = int(order[mine, 1].max(initial=0))
            wanted = np.zeros((len(swims), strokes + 1), dtype=bool)
            wanted[order[mine, 0] - first, order[mine, 1]] = True
            at = np.cumsum(wanted.ravel()).reshape(wanted.shape) - 1
            part[mine], row[mine] = len(tasks), at[order[mine, 0] - first, order[mine, 1]]
            # A shorter swim is padded with its last action, where no state is wanted.
            actions = [list(swim[:strokes]) + [swim[-1]] * (strokes - len(swim)) for swim in swims]
            shaped = np.array(actions, dtype=np.int64).reshape(wanted.shape[0], strokes)
            tasks.append(Task(np.zeros((len(swims), 3)), shaped, wanted))
        return Starts(tuple(tasks), part, row, order[:, 2].astype(bool), self._mirror)
