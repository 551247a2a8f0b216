"""Laws that the catalogue does not have: screened from a grammar of formulas by what runs answer to pushes.

To first order a period's miss is the sum of what each third of it answers to a force, a torque or a flow,
and of what each of its strokes answers to being weaker. These answers are simulated once for all laws: by
pulses in one third of every period, and by limbs that are a little weaker. Then any formula is screened
without a simulation of its own: its values along the run, as the fixes tell it, times the answers. The best
of each kind go into the search beside the catalogue, where they are fitted by simulation like any effect.

Source: Mojgani, Chattopadhyay, Hassanzadeh 2022 (model error as a sparse law of what a filter had to add);
Brunton, Proctor, Kutz 2016 (regression on a library of terms).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frogkick.core.progress import TellStage, silent
from frogkick.effects import Body, Effect, History, Stroke
from frogkick.identification.batching import roll_out
from frogkick.identification.fit import Fitted, Model, coarsened, residuals_of
from frogkick.identification.law_kinds import Kind, kinds_of
from frogkick.identification.penalty import PARAMETER_PENALTY
from frogkick.identification.predict import Lane
from frogkick.identification.screening import COARSE_STEP_S, Column
from frogkick.identification.segments import Segments
from frogkick.identification.steps import deviance_of, linearised_optimum
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

THIRDS = 3
PUSHES = (1e-3, 1e-3, 2e-5)
"""Forward, left (N) and counter-clockwise (N m): small beside what a stroke does."""
FLOW_MPS, GAIN = 2e-3, 0.15
LEG_S = 0.12
"""How often pulses and flows are asked while answers are simulated."""
REFINED = 8
"""Kinds whose shapes are refined beyond the grid, best first."""
BESIDE_S = 0.15
"""A velocity is told from fixes so long before and after."""


class _Push(Effect):
    """A constant wrench in one third of every period."""

    def __init__(self, swim: Segments, third: int, wrench: Sequence[float]) -> None:
        self._on, self._wrench = _thirds(swim, third), tuple(wrench)

    def wrench(self, time_s: float, body: Body) -> Sequence[float]:
        return self._wrench if self._on(time_s) else (0.0, 0.0, 0.0)


class _Stream(Effect):
    """A constant flow in one third of every period."""

    def __init__(self, swim: Segments, third: int, flow: Sequence[float]) -> None:
        self._on, self._flow = _thirds(swim, third), tuple(flow)

    def flow(self, time_s: float, position_world_m: FloatArray) -> Sequence[float]:
        return self._flow if self._on(time_s) else (0.0, 0.0)


class _Weaker(Effect):
    """A limb that straightens by less: what wears counts, and more would answer otherwise than less."""

    def __init__(self, limb: int) -> None:
        self._limb = limb

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        if stroke.index == self._limb:
            stroke.gain *= 1.0 - GAIN
        return stroke


def _thirds(swim: Segments, third: int) -> Any:
    """Whether a time is in one third of a period."""
    starts = np.asarray(swim.start_s)

    def on(time_s: float) -> bool:
        at = int(np.searchsorted(starts, time_s + 1e-6, side="right")) - 1
        if at < 0 or time_s >= swim.end_s[at]:
            return False
        share = (time_s - starts[at] + 1e-6) / (swim.end_s[at] - starts[at])
        return bool(third / THIRDS <= share < (third + 1) / THIRDS)

    return on


@dataclass(frozen=True, eq=False)
class Answers:
    """What periods answer, and where the robot was then, by its fixes; n periods, l limbs.

    Attributes:
        wrench: (n, 9, 3, 3) of each miss by force forward, left (N) and torque (N m) in each third.
        flow: (n, 9, 3, 2) by the water's velocity, world frame (m/s), in each third.
        gain: (n, 9, l) by the gain of each limb's stroke.
        bodies: of each period and third.
        strokes: of each period and limb, with what was fired before; None where the limb did not fire.
    """

    wrench: FloatArray
    flow: FloatArray
    gain: FloatArray
    bodies: list[list[Body]]
    strokes: list[list[tuple[Stroke, History] | None]]


def answers_of(model: Model, swims: Sequence[Segments], rows: NDArray[np.bool_]) -> Answers:
    """Simulate what the runs answer to pushes, flows and weaker strokes; see Answers.

    Args:
        model: nominal.
        swims: the runs.
        rows: which of all their periods count.
    """
    bare = replace(model, robot=coarsened(model.robot), terms=(), leg_s=LEG_S, step_s=COARSE_STEP_S)
    limbs = range(len(model.robot.limbs))
    kinds: list[list[Effect]] = [[] for _ in swims]
    sizes: list[float] = []
    for third in range(THIRDS):
        for axis, size in enumerate(PUSHES):
            wrench = [size * (axis == k) for k in range(3)]
            for own, swim in zip(kinds, swims, strict=True):
                own.append(_Push(swim, third, wrench))
            sizes.append(size)
    for third in range(THIRDS):
        for axis in range(2):
            flow = [FLOW_MPS * (axis == k) for k in range(2)]
            for own, swim in zip(kinds, swims, strict=True):
                own.append(_Stream(swim, third, flow))
            sizes.append(FLOW_MPS)
    for limb in limbs:
        for own in kinds:
            own.append(_Weaker(limb))
        sizes.append(-GAIN)
    lanes: list[Lane] = [bare.lane(swim) for swim in swims]
    for k in range(len(sizes)):
        for own, lane in zip(kinds, lanes[: len(swims)], strict=True):
            lanes.append(replace(lane, effects=(*lane.effects, own[k])))
    rollouts = roll_out(lanes)
    every = [residuals_of(rollouts[i : i + len(swims)], rows) for i in range(0, len(rollouts), len(swims))]
    columns = np.stack(
        [(moved - every[0]) / size for moved, size in zip(every[1:], sizes, strict=True)], axis=2
    )
    columns[(np.abs(columns).max(axis=(1, 2)) > 1e4)] = 0.0  # lost
    pushes, flows = THIRDS * 3, THIRDS * 2
    n = len(columns)
    return Answers(
        columns[:, :, :pushes].reshape(n, 9, THIRDS, 3),
        columns[:, :, pushes : pushes + flows].reshape(n, 9, THIRDS, 2),
        columns[:, :, pushes + flows :],
        [row for row, kept in zip(_bodies(swims), rows, strict=True) if kept],
        [row for row, kept in zip(_strokes(swims, model.robot), rows, strict=True) if kept],
    )


def _body(swim: Segments, at_s: float) -> Body:
    """The robot at a time, by its fixes."""
    times = np.array([at_s - BESIDE_S, at_s, at_s + BESIDE_S])
    x, y, heading = (np.interp(times, swim.time_s, swim.pose[:, axis]) for axis in range(3))
    vx, vy, turn = ((row[2] - row[0]) / (2.0 * BESIDE_S) for row in (x, y, heading))
    c, s = math.cos(heading[1]), math.sin(heading[1])
    velocity = (float(c * vx + s * vy), float(c * vy - s * vx), float(turn))
    return Body(at_s, (float(x[1]), float(y[1]), float(heading[1])), velocity)


def _bodies(swims: Sequence[Segments]) -> Iterator[list[Body]]:
    for swim in swims:
        for start_s, end_s in zip(swim.start_s, swim.end_s, strict=True):
            middles = [start_s + (end_s - start_s) * (third + 0.5) / THIRDS for third in range(THIRDS)]
            yield [_body(swim, float(at_s)) for at_s in middles]


def _strokes(swims: Sequence[Segments], robot: Robot) -> Iterator[list[tuple[Stroke, History] | None]]:
    for swim in swims:
        for start_s, end_s in zip(swim.start_s, swim.end_s, strict=True):
            row: list[tuple[Stroke, History] | None] = [None] * len(robot.limbs)
            for k, (time_s, limb) in enumerate(swim.strokes):
                if start_s - 1e-6 <= time_s < end_s - 1e-6 and row[limb] is None:
                    body = _body(swim, float(start_s))
                    stroke = Stroke(robot.limbs[limb].name, limb, time_s, body=body)
                    row[limb] = stroke, History(list(swim.strokes[:k]))
            yield row


def screened(
    nominal: Fitted,
    swims: Sequence[Segments],
    rows: NDArray[np.bool_],
    robot: Robot,
    progress: TellStage = silent,
) -> tuple[list[Column], list[FloatArray]]:
    """The best of each kind of law, and derivatives of all that were screened.

    Args:
        nominal: the model without effects, with what it missed.
        swims, rows: the runs, and which of their periods count.
        robot: nominal.
        progress: called with a stage, steps done and to do.

    Returns:
        Columns for the search, and (n, 9, p) of every law that was tried, for what the best gains by chance.
    """
    answers = answers_of(nominal.model, swims, rows)
    plain = deviance_of(nominal.residuals)

    def gain_of(kind: Kind, columns: FloatArray) -> float:
        low, high = (np.array([given[k] for given in kind.strengths.values()]) for k in (1, 2))
        damping = 1e-6 * nominal.residuals.size / (high - low) ** 2
        return plain - linearised_optimum(nominal.residuals, columns, low, high, damping)[1]

    def gain_at(kind: Kind, shape: Mapping[str, float]) -> float:
        return gain_of(kind, _columns(kind, shape, answers, robot))

    best, every = list[tuple[float, Kind, Mapping[str, float]]](), list[FloatArray]()
    kinds = kinds_of(robot, swims)
    for done, kind in enumerate(kinds):
        progress("laws", done, len(kinds))
        tried: list[tuple[float, int]] = []
        for number, shape in enumerate(kind.grid):
            columns = _columns(kind, shape, answers, robot)
            if columns.any():
                every.append(columns)
                tried.append((gain_of(kind, columns), number))
        if tried:
            gain, number = max(tried)
            gain -= PARAMETER_PENALTY * (len(kind.strengths) + len(kind.shapes))
            best.append((gain, kind, kind.grid[number]))
    best.sort(key=lambda row: -row[0])
    for rank, (_, kind, shape) in enumerate(best[:REFINED]):
        if kind.shapes:
            shape = _refined(kind, shape, partial(gain_at, kind))
            gain = gain_at(kind, shape)
            best[rank] = gain - PARAMETER_PENALTY * (len(kind.strengths) + len(kind.shapes)), kind, shape
    best.sort(key=lambda row: -row[0])
    kept = []
    for _, kind, shape in best:
        shapes = np.zeros((*nominal.residuals.shape, len(kind.shapes)))
        columns = _columns(kind, shape, answers, robot)
        kept.append(Column(kind.term(shape), np.concatenate([columns, shapes], axis=2)))
    return kept, every


def _refined(
    kind: Kind, shape: Mapping[str, float], gain: Callable[[Mapping[str, float]], float]
) -> Mapping[str, float]:
    """The shape near the best of a grid that gains most, within its bounds."""
    from scipy import optimize

    names = list(kind.shapes)
    low, high = (np.array([kind.shapes[name][k] for name in names]) for k in (1, 2))
    start = np.array([shape[name] for name in names])
    # As far as the grid's neighbours: farther off another place of the grid is better.
    near = np.stack([[each[name] for name in names] for each in kind.grid])
    spread = np.array(
        [
            np.diff(np.unique(column)).min(initial=0.1 * reach)
            for column, reach in zip(near.T, high - low, strict=True)
        ]
    )
    simplex = np.vstack([start, *(start + 0.5 * np.diag(np.minimum(spread, 0.2 * (high - low))))])
    found = optimize.minimize(
        lambda at: -gain(dict(zip(names, np.clip(at, low, high).tolist(), strict=True))),
        start,
        method="Nelder-Mead",
        options={"initial_simplex": np.clip(simplex, low, high), "maxfev": 40 * len(names), "xatol": 1e-4},
    )
    return dict(zip(names, np.clip(found.x, low, high).tolist(), strict=True))


def _columns(kind: Kind, shape: Mapping[str, float], answers: Answers, robot: Robot) -> FloatArray:
    """(n, 9, p) of the misses by each strength of a law at a shape, by the answers."""
    term = kind.term(shape)
    found = []
    for k in range(len(kind.strengths)):
        values = list(term.values)
        unit = min(1.0, 0.5 * term.parameters[k].high)
        values[k] = unit
        law = term.at(values).effect()
        law.check(robot)
        found.append(_answered(law, kind.table["on"], answers) / unit)
    return np.stack(found, axis=2)


def _answered(law: Effect, on: str, answers: Answers) -> FloatArray:
    """(n, 9) what the misses answer to a law."""
    if on == "wrench":
        pushes = np.array([[law.wrench(body.time_s, body) for body in row] for row in answers.bodies])
        return np.asarray(np.einsum("nita,nta->ni", answers.wrench, pushes))
    if on == "flow":
        flows = np.array(
            [[law.flow(b.time_s, np.array(b.pose_world[:2])) for b in row] for row in answers.bodies]
        )
        return np.asarray(np.einsum("nita,nta->ni", answers.flow, flows))
    rng = np.random.default_rng(0)
    more = np.zeros((len(answers.strokes), answers.gain.shape[2]))
    for n, row in enumerate(answers.strokes):
        for limb, given in enumerate(row):
            if given is not None:
                stroke, history = given
                changed = law.stroke(replace(stroke), history, rng)
                more[n, limb] = (changed or stroke).gain - 1.0
    return np.asarray(np.einsum("nil,nl->ni", answers.gain, more))
