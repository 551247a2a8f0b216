"""Responses of the residuals to small forces, flows, weaker strokes and wrong fixes, made once for all laws.

A force or a flow acts in one third of every period, and a limb is a little weaker, much weaker or idle in
every LAGS-th period. Fixes act through the filter alone, whose gains do not depend on their values, so the
responses to them are computed without a simulation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.core.poses import body_from_world
from frogkick.effects import Body, Effect, History, Stroke
from frogkick.effects.law import LONG_AGO_S, Law
from frogkick.effects.limbs import WeakenedLimb
from frogkick.identification.batching import roll_out
from frogkick.identification.filter import initial_rate_std
from frogkick.identification.fit import Fitted, Model, coarsened, residuals_of
from frogkick.identification.predict import PHASES, Lane, Rollout, interpolated
from frogkick.identification.screening import COARSE_STEP_S
from frogkick.identification.segments import Data, Segments
from frogkick.robot import Robot

Values = Mapping[str, Float64 | float]

THIRDS = 3
LAGS = 5
"""A residual depends on the strokes of this many periods, its own and those before, because the fixes
determine the velocity at a period's start only in part. Forces act without a break, so the response to a
force in all periods is the better approximation."""
PUSHES = (1e-3, 1e-3, 2e-5)
"""Simulated force forward, left (N) and torque counter-clockwise (N m): small compared with a stroke."""
FLOW_MPS = 2e-3  # simulated flow
LOSSES = (0.15, 0.45, 0.75, 1.0)
"""Simulated losses of a stroke's gain. Several, because a much weaker limb pushes in another direction."""
LEG_S = 0.12  # time between evaluations of forces and flows while responses are simulated
BESIDE_S = 0.15  # a velocity is estimated from the poses this long before and after
FADED = 1e-4  # responses to a fix below this are set to zero
GLIDE_S = 1.0  # time constant with which a correction of the velocity decays by drag


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

    def flow(self, time_s: float, position_world_m: Float64) -> Sequence[float]:
        return self._flow if self._on(time_s) else (0.0, 0.0)


class _Weaker(WeakenedLimb):
    """A limb that straightens less in every LAGS-th period of a run.

    A loss is simulated and not a gain, because limbs wear; the response to more would differ.
    """

    def __init__(self, swim: Segments, limb: int, loss: float, turn: int) -> None:
        super().__init__(limb, 1.0 - loss)
        self._starts, self._turn = np.asarray(swim.start_s), turn

    def stroke(self, stroke: Stroke, history: History, rng: np.random.Generator) -> Stroke:
        mine = _period(self._starts, stroke.time_s) % LAGS == self._turn
        return super().stroke(stroke, history, rng) if mine else stroke


def _period(starts: Float64, time_s: float) -> int:
    """Index of the period that contains a time; -1 before the first one."""
    return int(np.searchsorted(starts, time_s + 1e-6, side="right")) - 1


def _thirds(swim: Segments, third: int) -> Callable[[float], bool]:
    """Return a function that says whether a time is in that third of any period."""
    starts = np.asarray(swim.start_s)

    def on(time_s: float) -> bool:
        at = _period(starts, time_s)
        if at < 0 or time_s >= swim.end_s[at]:
            return False
        share = (time_s - starts[at] + 1e-6) / (swim.end_s[at] - starts[at])
        return bool(third / THIRDS <= share < (third + 1) / THIRDS)

    return on


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses of the residuals, and the robot's state at the same times, estimated from its fixes.

    There are m periods, n of which are used, l limbs and f fixes.
    """

    # (n, 9, 3, 3) derivative of each residual by the force forward, left (N) and the torque (N m) in each
    # third
    wrench: Float64
    flow: Float64  # (n, 9, 3, 2) derivative by the water's velocity in each third, world frame (m/s)
    # (n, 9, LAGS, l, 4) change of each residual if a limb's gain is less by each of LOSSES, in the period
    # itself and in those before it
    lost: Float64
    source: Int64  # (n, LAGS) indices of these periods among all m; -1 for none
    # two sparse (3 n, f) matrices: derivative of each phase's residual by the position of each fix, and by
    # its heading; world frame
    fix: tuple[Any, Any]
    heading: Float64  # (n,) heading at each period's start, rad
    bodies: Values  # variable of laws on wrenches and flows -> (n, 3) its values in each third
    strokes: Values  # variable of laws on strokes -> (m, l) its values; NaN if a limb did not fire
    fixes: Values  # variable of laws on fixes -> (f,) its values
    rates: Float64  # (f, 3) velocity at each fix, world frame (m/s, m/s, rad/s)

    @property
    def idle(self) -> Float64:
        """(n, 9, l) change of each residual if a limb does nothing in the period and in those before."""
        return np.asarray(self.lost[..., -1].sum(axis=2))

    @property
    def fired(self) -> Values:
        """The values of ``strokes`` in the n periods that are used."""
        own = self.source[:, 0]
        return {
            name: values if isinstance(values, float) else values[own]
            for name, values in self.strokes.items()
        }

    def to(self, law: Law, parameters: Values, limbs: Sequence[str]) -> Float64:
        """(n, 9) response of the residuals to a law, with other values of its parameters."""
        shape = np.shape(self.bodies["x_m"])
        if law.on == "wrench":
            given = law.over({**self.bodies, **parameters})
            forward, left, x, y, torque = (
                _finite(given.get(key, 0.0), *shape)
                for key in ("forward_n", "left_n", "x_n", "y_n", "torque_nm")
            )
            turned = body_from_world(self.bodies["heading_rad"], np.stack([x, y, torque], axis=2))
            push = turned + np.stack([forward, left, np.zeros(shape)], axis=2)
            return np.asarray(np.einsum("nita,nta->ni", self.wrench, push))
        if law.on == "flow":
            given = law.over({**self.bodies, **parameters})
            flow = np.stack([_finite(given.get(key, 0.0), *shape) for key in ("x_mps", "y_mps")], axis=2)
            return np.asarray(np.einsum("nita,nta->ni", self.flow, flow))
        if law.on == "stroke":
            gain = law.over({**self.strokes, **parameters}).get("gain", np.array(1.0))
            mine = np.array([law.limb in ("all", name) for name in limbs])
            fired = np.isfinite(self.strokes["time_s"])
            loss = _finite(1.0 - gain, *fired.shape) * mine * fired
            some = np.flatnonzero(mine)
            every = np.concatenate([loss, np.zeros((1, len(mine)))])[self.source]
            return np.asarray(
                np.einsum("nidlk,ndlk->ni", self.lost[:, :, :, some], _between_losses(every[:, :, some]))
            )
        given = law.over({**self.fixes, **parameters})
        x, y, turn, delay = (
            _finite(given.get(key, 0.0), len(self.rates)) for key in ("x_m", "y_m", "heading_rad", "delay_s")
        )
        shown = np.stack([x, y, turn], axis=1) - delay[:, None] * self.rates
        # A residual is fix minus prediction, so what a law adds to the predicted fixes is subtracted.
        left = np.empty((len(self.heading), 3, 3))
        left[:, :, :2] = -(self.fix[0] @ shown[:, :2]).reshape(-1, 3, 2)
        left[:, :, 2] = -(self.fix[1] @ shown[:, 2]).reshape(-1, 3)
        for phase in range(3):
            left[:, phase] = body_from_world(self.heading, left[:, phase])
        return left.reshape(-1, 9)


def _between_losses(loss: Float64) -> Float64:
    """(..., 4) weights that interpolate the responses to LOSSES linearly at a loss."""
    first, *_ = LOSSES
    inside = np.clip(loss, first, LOSSES[-1])
    weights = [np.interp(inside, LOSSES, row) for row in np.eye(len(LOSSES))]
    weights[0] = np.where(loss < first, loss / first, weights[0])
    return np.stack(weights, axis=-1)


def _finite(values: Float64 | float, *shape: int) -> Float64:
    whole = np.broadcast_to(np.asarray(values, dtype=np.float64), shape)
    return np.where(np.isfinite(whole), whole, 0.0)


def responses_of(nominal: Fitted, data: Data) -> Responses:
    """Simulate the responses of runs to forces, flows and weaker strokes, and compute those to fixes."""
    swims, rows = data.swims, data.rows
    model = nominal.model
    count = len(model.robot.limbs)
    kinds: list[tuple[float, Callable[[Segments], Effect]]] = []
    for third, (axis, size) in product(range(THIRDS), enumerate(PUSHES)):
        wrench = [size * (axis == k) for k in range(3)]
        kinds.append((size, partial(_Push, third=third, wrench=wrench)))
    for third, axis in product(range(THIRDS), range(2)):
        flow = [FLOW_MPS * (axis == k) for k in range(2)]
        kinds.append((FLOW_MPS, partial(_Stream, third=third, flow=flow)))
    for turn, limb, loss in product(range(LAGS), range(count), LOSSES):
        kinds.append((1.0, partial(_Weaker, limb=limb, loss=loss, turn=turn)))
    sizes = np.array([size for size, _ in kinds])
    effects = [[effect(swim) for _, effect in kinds] for swim in swims]
    every = [residuals_of(each, rows) for each in rollouts_with(model, effects, swims)]
    columns = np.stack([moved - every[0] for moved in every[1:]], axis=2) / sizes
    columns[(np.abs(columns).max(axis=(1, 2)) > 1e4)] = 0.0  # a simulation diverged
    n, pushes, flows = len(columns), THIRDS * 3, THIRDS * 2
    # A stroke that is weakened in a period's own turn changes that period; in the turn before, the next one.
    order, lags = data.order[:, None], np.arange(LAGS)
    lost = columns[:, :, pushes + flows :].reshape(n, 9, LAGS, count, len(LOSSES))
    lost = np.moveaxis(lost[np.arange(n)[:, None], :, (order - lags) % LAGS], 1, 2)
    source = np.where(order >= lags, np.flatnonzero(rows)[:, None] - lags, -1)
    places, turns = (_joined([_filtered(model, swim, axis) for swim in swims], rows) for axis in (0, 2))
    times = np.concatenate([swim.time_s for swim in swims])
    poses = np.concatenate([swim.pose for swim in swims])
    named = dict(zip(("x_m", "y_m", "heading_rad"), poses.T, strict=True))
    return Responses(
        columns[:, :, :pushes].reshape(n, 9, THIRDS, 3),
        columns[:, :, pushes : pushes + flows].reshape(n, 9, THIRDS, 2),
        lost,
        source,
        (places, turns),
        data.used(rollout.start[:, 2] for rollout in nominal.rollouts),
        _bodies(swims, rows),
        _strokes(swims, model.robot),
        {**named, "time_s": times, "chance": 0.5},
        np.concatenate([_rates(swim, swim.time_s) for swim in swims]),
    )


def rollouts_with(
    model: Model, effects: Sequence[Sequence[Effect]], swims: Sequence[Segments]
) -> list[list[Rollout]]:
    """Rollouts of runs by a model alone, and with each of k effects beside it; simulated coarsely.

    ``effects`` are the k effects of each run.
    """
    bare = replace(model, robot=coarsened(model.robot), leg_s=LEG_S, step_s=COARSE_STEP_S)
    lanes: list[Lane] = [bare.lane(swim) for swim in swims]
    for k in range(len(effects[0])):
        for own, lane in zip(effects, lanes[: len(swims)], strict=True):
            lanes.append(replace(lane, effects=(*lane.effects, own[k])))
    rollouts = roll_out(lanes)
    return [rollouts[i : i + len(swims)] for i in range(0, len(rollouts), len(swims))]


def _rates(swim: Segments, at_s: Float64) -> Float64:
    """(k, 3) velocities at times, from the fixes around them; world frame."""
    before, after = (interpolated(swim.time_s, swim.pose, at_s + beside) for beside in (-BESIDE_S, BESIDE_S))
    return np.asarray((after - before) / (2.0 * BESIDE_S))


def _seen_at(swim: Segments, at_s: Float64) -> dict[str, Float64]:
    """State of the robot at times, estimated from its fixes: variable of laws -> (k,) values."""
    x, y, heading = interpolated(swim.time_s, swim.pose, at_s).T
    forward, left, turn = body_from_world(heading, _rates(swim, at_s)).T
    return {
        "time_s": at_s, "x_m": x, "y_m": y, "heading_rad": heading,
        "forward_mps": forward, "left_mps": left, "turn_radps": turn,
    }  # fmt: skip


def _bodies(swims: Sequence[Segments], rows: Bool) -> Values:
    parts = []
    for swim in swims:
        share = (np.arange(THIRDS) + 0.5) / THIRDS
        at_s = swim.start_s[:, None] + (swim.end_s - swim.start_s)[:, None] * share
        seen = _seen_at(swim, at_s.ravel())
        parts.append({name: values.reshape(-1, THIRDS) for name, values in seen.items()})
    return {name: np.concatenate([part[name] for part in parts])[rows] for name in parts[0]}


def _strokes(swims: Sequence[Segments], robot: Robot) -> Values:
    limbs = len(robot.limbs)
    parts = []
    for swim in swims:
        count = len(swim.start_s)
        seen = {
            name: np.repeat(values[:, None], limbs, axis=1)
            for name, values in _seen_at(swim, swim.start_s).items()
        }
        seen["time_s"] = np.full((count, limbs), np.nan)
        others = [f"since_{limb.name}_s" for limb in robot.limbs]
        for name in ("strokes", "since_s", *others):
            seen[name] = np.zeros((count, limbs))
        fired_s = swim.fired_s(limbs)
        for period, limb in np.argwhere(np.isfinite(fired_s)).tolist():
            at, time_s = (period, limb), float(fired_s[period, limb])
            history = History(list(swim.strokes[: swim.strokes.index((time_s, limb))]))
            seen["time_s"][at], seen["strokes"][at] = time_s, history.pulses
            since = [min(history.since_s(k, time_s), LONG_AGO_S) for k in range(limbs)]
            seen["since_s"][at] = since[limb]
            for name, value in zip(others, since, strict=True):
                seen[name][at] = value
        parts.append(seen)
    return {"chance": 0.5, **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]}}


def _joined(parts: Sequence[Float64], rows: Bool) -> Any:
    """Join (m, 3, f) responses of each run to a sparse (3 n, f) matrix; a fix acts in its own run only."""
    from scipy import sparse

    kept = [
        sparse.csr_matrix(np.where(np.abs(part) < FADED, 0.0, part).reshape(-1, part.shape[2]))
        for part in parts
    ]
    return sparse.block_diag(kept, format="csr")[np.repeat(rows, 3)]


def _filtered(model: Model, swim: Segments, axis: int) -> Float64:
    """(m, 3, f) response of each phase to each fix of a run along one axis, through the Kalman filter.

    A shift of the trajectory persists; a change of its velocity decays with GLIDE_S.
    """
    fix, idle, actuated = (float(each[axis]) for each in model.noise.per_axis())
    times, count = swim.time_s, len(swim.time_s)
    actuation = np.interp(times, *swim.actuated_s)
    found = np.zeros((len(swim.start_s), 3, count))
    first = int(np.searchsorted(times, swim.begin_s))
    shift, rate, at_s = np.zeros(count), np.zeros(count), swim.begin_s
    shift[min(first, count - 1)] = 1.0  # a simulation begins at the first fix
    before = shift, rate, at_s
    p0, p1, p2, now_s = 4.0 * fix, 0.0, initial_rate_std(swim.rest_rate)[axis] ** 2, swim.begin_s
    now_act = float(np.interp(now_s, *swim.actuated_s))

    def moved(state: tuple[Float64, Float64, float], time_s: float) -> Float64:
        since = time_s - state[2]
        grown = GLIDE_S * (1.0 - math.exp(-since / GLIDE_S)) if since > 0.0 else since
        return np.asarray(state[0] + grown * state[1])

    for until_s in swim.segment_times_s.tolist():
        error, error_rate = np.zeros(count), np.zeros(count)
        some, rows = [], []
        now = shift, rate, at_s
        while first < count and swim.arrival_s[first] <= until_s + 1e-9:
            time_s, act = float(times[first]), float(actuation[first])
            gap_s = time_s - now_s
            if gap_s > 0.0:
                drive = idle + actuated * (act - now_act) / gap_s
                error = error + gap_s * error_rate
                p0 += gap_s * (2.0 * p1 + gap_s * p2) + drive * gap_s**3 / 3.0
                p1 += gap_s * p2 + drive * gap_s**2 / 2.0
                p2 += drive * gap_s
                now_s, now_act = time_s, act
            if time_s >= at_s:
                gap = -moved(now, time_s)
            else:  # it arrived late: corrections since then are included
                gap = -(moved(before, time_s) + shift - moved(before, at_s) + (time_s - at_s) * rate)
            gap[first] += 1.0
            variance = p0 + fix
            gain0, gain1 = p0 / variance, p1 / variance
            innovation = gap - error
            error = error + gain0 * innovation
            error_rate = error_rate + gain1 * innovation
            p2 -= gain1 * p1
            p1, p0 = p1 * (1.0 - gain0), p0 * (1.0 - gain0)
            some.append(time_s)
            rows.append(gap)
            first += 1
        for period in np.flatnonzero(np.abs(swim.end_s - until_s) < 1e-6):
            share = (np.array(some) - swim.start_s[period]) / (swim.end_s[period] - swim.start_s[period])
            for phase, (low, high) in enumerate(PHASES):
                inside = np.flatnonzero((low <= share) & (share < high))
                if len(inside):
                    found[period, phase] = np.mean([rows[k] for k in inside], axis=0)
        before = now
        faded = math.exp(-max(until_s - at_s, 0.0) / GLIDE_S)
        shift = moved(now, until_s) + error + (until_s - now_s) * error_rate
        rate, at_s = faded * rate + error_rate, until_s
    return found
