"""What every action does from many initial velocities; of mirror images only one is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.der import Rods, program_of, simulate_many
from frogkick.robot import Mirror, Robot, mirror_of

FloatArray = NDArray[np.float64]
SampleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]

SAMPLE_S = 0.05  # spacing of recorded poses: a cubic between two errs by 0.02 mm where a cut can be
_LEFT = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # what mirroring does to (x, y, heading, vx, vy, omega)


@dataclass(frozen=True)
class Failed:
    """A transition that could not be simulated, and why."""

    state: int
    action: int
    reason: str


@dataclass(frozen=True)
class Transitions:
    """Results for k initial velocities and all a actions of a robot.

    Attributes:
        rows: (k, a, 6) after one period: forward, left (m), turn (rad, continuous) in the body frame at the
            start, then velocity (m/s, m/s, rad/s) in the body frame at the end; NaN where it failed.
        recorded: (k, a, s, 6) the same at ``recorded_times``, float32.
        failed: what failed; states counted from 0.
    """

    rows: FloatArray
    recorded: SampleArray
    failed: tuple[Failed, ...]


def recorded_times(robot: Robot, record_s: float) -> FloatArray:
    """(s,) multiples of SAMPLE_S up to ``record_s``, none where that is not beyond the period."""
    count = int(record_s / SAMPLE_S + 1e-9) if record_s > robot.period_s else 0
    return np.asarray(SAMPLE_S * np.arange(1, count + 1), dtype=np.float64)


def simulate_states(rods: Rods, velocities: FloatArray, record_s: float) -> Transitions:
    """Simulate every action of a robot from each of (k, 3) body velocities, as they are."""
    robot = rods.robot
    told = recorded_times(robot, record_s)
    times = np.union1d(told, [robot.period_s])
    at_period = int(np.searchsorted(times, robot.period_s))
    kept = np.isin(times, told)
    landing = [robot.period_s] if times[-1] > robot.period_s else []
    actions = len(robot.actions)
    rows = np.full((len(velocities), actions, 6), np.nan)
    recorded = np.full((len(velocities), actions, len(told), 6), np.nan, dtype=np.float32)
    failed: list[Failed] = []
    for a, action in enumerate(robot.actions):  # neighbours that do the same share their steps
        motions = simulate_many(
            rods, velocities, [program_of(robot, action)] * len(velocities), times, landing_s=landing
        )
        whole = np.concatenate([motions.pose_world, motions.velocity_body], axis=2)
        rows[:, a] = whole[:, at_period]
        recorded[:, a] = whole[:, kept]
        failed += [Failed(k, a, str(failure)) for k, failure in motions.failures.items()]
    return Transitions(rows, recorded, tuple(sorted(failed, key=lambda f: (f.state, f.action))))


@dataclass(frozen=True)
class Pairing:
    """Which simulation stands for which of n states.

    Attributes:
        velocities: (u, 3) initial velocities to simulate.
        source: (n,) row of these for each state.
        mirrored: (n,) whether the state is the mirror image of that row.
        mirror: what mirroring does; None for a robot without.
    """

    velocities: FloatArray
    source: IntArray
    mirrored: NDArray[np.bool_]
    mirror: Mirror | None

    def rows(self, state: int, simulated: NDArray[np.floating]) -> NDArray[np.floating]:
        """Results (a, .., 6) of a state from those of its source."""
        if not self.mirrored[state] or self.mirror is None:
            return simulated
        signs = _LEFT.astype(simulated.dtype)
        return np.asarray(simulated[list(self.mirror.actions)] * signs)

    def failed(self, sources: Sequence[Failed]) -> tuple[Failed, ...]:
        """Failures of all states from those of their sources."""
        by_source: dict[int, list[Failed]] = {}
        for failure in sources:
            by_source.setdefault(failure.state, []).append(failure)
        found: list[Failed] = []
        for state, source in enumerate(self.source.tolist()):
            for failure in by_source.get(source, []):
                if self.mirrored[state] and self.mirror is not None:
                    reason = f"its mirror image {failure.reason}"
                    found.append(Failed(state, self.mirror.actions.index(failure.action), reason))
                else:
                    found.append(Failed(state, failure.action, failure.reason))
        return tuple(sorted(found, key=lambda f: (f.state, f.action)))


def pair_up(robot: Robot, velocities: FloatArray) -> Pairing:
    """Fold (n, 3) body velocities to those that drift left, or straight on and turn left, each once."""
    mirror = mirror_of(robot)
    plain = velocities + 0.0  # -0.0 is 0.0
    if mirror is None:
        mirrored = np.zeros(len(plain), dtype=bool)
    else:
        mirrored = (plain[:, 1] < 0.0) | ((plain[:, 1] == 0.0) & (plain[:, 2] < 0.0))
    folded = np.where(mirrored[:, None], plain * _LEFT[3:], plain) + 0.0
    place: dict[tuple[float, ...], int] = {}
    source = [place.setdefault(tuple(row), len(place)) for row in folded.tolist()]
    unique = np.array(list(place), dtype=np.float64).reshape(-1, 3)
    return Pairing(unique, np.array(source, dtype=np.int64), mirrored, mirror)


def simulate_transitions(rods: Rods, velocities: FloatArray) -> tuple[FloatArray, tuple[Failed, ...]]:
    """Simulate every action of a robot for one period from each of (n, 3) body velocities.

    Returns:
        (n, a, 6) as in Transitions.rows, exactly mirrored for mirrored states; and what failed.
    """
    pairing = pair_up(rods.robot, velocities)
    simulated = simulate_states(rods, pairing.velocities, 0.0)
    rows = [pairing.rows(state, simulated.rows[source]) for state, source in enumerate(pairing.source)]
    return np.array(rows, dtype=np.float64), pairing.failed(simulated.failed)
