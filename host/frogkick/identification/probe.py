"""Linear dependence of candidate effects, without simulation: which parameters act, which repeat others.

To first order a robot responds linearly to what is done to its strokes, its water, its body and its fixes. A
parameter that changes none of these where the effect vanishes is insensitive there and needs no simulation.
One whose change is a linear combination of others' changes needs none of its own: its derivative is the same
combination.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.effects import Body, Effect, Fix, History, Stroke
from frogkick.identification.terms import Term
from frogkick.robot import Robot

_PROBES = 60
_SUM_ERROR = 1e-6
"""Share of a change that a linear combination of others may leave."""


@dataclass(frozen=True, eq=False)
class Probes:
    """Situations in which effects are evaluated, the same for all."""

    robot: Robot
    strokes: tuple[tuple[int, float, tuple[tuple[float, int], ...]], ...]
    bodies: tuple[Body, ...]

    def responses(self, effect: Effect) -> Float64:
        """(k,) all that an effect does, concatenated."""
        names = [limb.name for limb in self.robot.limbs]
        responses: list[float] = []
        for limb, time_s, before in self.strokes:
            given = Stroke(names[limb], limb, time_s)
            stroke = effect.stroke(given, History(list(before)), np.random.default_rng(0)) or given
            responses += [stroke.gain, stroke.delay_s, stroke.duration_scale]
        for body in self.bodies:
            responses += np.ravel(effect.flow(body.time_s, np.array(body.pose_world[:2]))).tolist()
            responses += _flat(effect.wrench(body.time_s, body))
            given_fix = Fix(body.time_s, 0.08, *body.pose_world)
            fix = effect.fix(given_fix, np.random.default_rng(0)) or given_fix
            responses += [fix.capture_s, fix.x_m, fix.y_m, fix.heading_rad]
        return np.array(responses, dtype=np.float64)


def _flat(given: object) -> list[float]:
    """A wrench, given as three numbers or as a pair and a number."""
    parts = [np.ravel(np.asarray(part, dtype=np.float64)) for part in given]  # type: ignore[attr-defined]
    return [float(value) for value in np.concatenate(parts)]


def probes_of(robot: Robot) -> Probes:
    """Situations for a robot's effects: strokes after other strokes, bodies at random poses."""
    rng = np.random.default_rng(0)
    strokes, bodies = [], []
    for _ in range(_PROBES):
        before: list[tuple[float, int]] = []
        now_s = float(rng.uniform(0.5, 2.0))
        for _ in range(int(rng.integers(0, 12))):
            fired = rng.permutation(len(robot.limbs))[: int(rng.integers(1, len(robot.limbs) + 1))]
            late_s = np.where(rng.random(len(fired)) < 0.5, robot.second_delay_s, 0.0)
            before += sorted(zip((now_s + late_s).tolist(), fired.tolist(), strict=True))
            now_s += robot.period_s
        if before and rng.random() < 0.5:
            now_s = before[-1][0] + robot.second_delay_s
        strokes.append((int(rng.integers(len(robot.limbs))), now_s, tuple(before)))
        pose, velocity = rng.uniform([-1.0, -1.0, -3.0], [1.0, 1.0, 3.0]), rng.normal(0.0, [0.04, 0.01, 0.3])
        bodies.append(Body(now_s, tuple(pose.tolist()), tuple(velocity.tolist())))
    return Probes(robot, tuple(strokes), tuple(bodies))


def changes(probes: Probes, term: Term, step: Float64) -> list[Float64 | None]:
    """Derivative of the responses by each parameter; None if the parameter changes the body."""
    base_effect = term.effect()
    base, base_robot = probes.responses(base_effect), base_effect.robot(probes.robot)
    found: list[Float64 | None] = []
    for k in range(len(term.values)):
        values = list(term.values)
        values[k] += float(step[k])
        moved = term.at(values).effect()
        if moved.robot(probes.robot) != base_robot:
            found.append(None)
        else:
            found.append((probes.responses(moved) - base) / float(step[k]))
    return found


class LinearSpan:
    """Span of the changes that are simulated."""

    def __init__(self) -> None:
        self._rows: list[Float64] = []

    def weights(self, change: Float64) -> Float64 | None:
        """(rows,) weights of the linear combination that a change is; None if it is none.

        Delays are excluded: moving one stroke beside another is not the same as moving both.
        """
        if not self._rows or change[1 : 3 * _PROBES : 3].any():
            return None
        table = np.array(self._rows).T
        sizes = np.linalg.norm(table, axis=0)
        weights = np.linalg.lstsq(table / sizes, change, rcond=1e-9)[0]
        left = change - table / sizes @ weights
        if np.linalg.norm(left) > _SUM_ERROR * np.linalg.norm(change):
            return None
        return np.asarray(weights / sizes)

    def add(self, change: Float64) -> None:
        """Add a change that is not in the span."""
        self._rows.append(change)


def spread_first(items: Sequence[tuple[Float64 | None, object]]) -> list[int]:
    """Order of simulation: changes in few situations first, so that combinations are of simple ones."""
    counts = [0 if change is None else int(np.count_nonzero(change)) for change, _ in items]
    return sorted(range(len(items)), key=lambda index: counts[index])
