"""Effects that act on the robots of a batch, for pool, library and identification."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.poses import Fix, rotate
from frogkick.der import STILL, Batch, Rods, Water, prepare
from frogkick.effects.base import (
    Body,
    Effect,
    History,
    Stroke,
    call_hook,
    fix_by,
    numbers_by,
    robot_by,
    stroke_by,
)
from frogkick.effects.law import Law
from frogkick.effects.registry import effects_of
from frogkick.robot import Action, Robot

LEG_S = 0.02
"""Zero-order hold: flows and wrenches are constant for this time, and are then evaluated again."""

_APART_M = 0.01
"""The flow's gradient is a finite difference between points so far on either side of the centre."""

_BEYOND = 1e9
"""A pose or velocity (SI units) of a simulation that has diverged: its next step fails by itself."""


@typed
def changed_robot(robot: Robot, effects: Sequence[Effect]) -> Robot:
    """Return the robot with the body that the effects change.

    Raises:
        InputError: an effect does not fit the robot, or gives an invalid one.
    """
    for effect in effects:
        call_hook(effect, "check", robot)
        robot = robot_by(effect, robot)
    return robot


@typed
def rods_of(robot: Robot) -> Rods:
    """Return the rods of a robot with the body that the effects of its file change.

    Raises:
        InputError: one of its effects cannot be made or does not fit it.
    """
    return replace(prepare(changed_robot(robot, effects_of(robot))), robot=robot)


@typed
def body_effects(robot: Robot) -> tuple[Effect, ...]:
    """Return the effects of a robot's file that belong to its body, without randomness.

    These are all effects but flows of the water, and laws that depend on what a library does not contain
    (``Effect.in_tables``).
    """
    return tuple(
        effect.likeliest()
        for effect in effects_of(robot)
        if not effect.overrides("flow") and (effect.in_tables or not isinstance(effect, Law))
    )


class Acting:
    """Effects on the robots of a batch's lanes, each with its own history and random generator."""

    def __init__(
        self,
        effects: Sequence[Effect],
        robot: Robot,
        rngs: Sequence[np.random.Generator],
        leg_s: float = LEG_S,
    ) -> None:
        """Prepare effects that fit ``robot``.

        Args:
            robot: result of ``changed_robot``.
            rngs: a generator for each lane, for random effects.
            leg_s: see LEG_S.
        """
        self.effects = tuple(effects)
        self.histories = [History() for _ in rngs]
        self._names = [limb.name for limb in robot.limbs]
        self.rngs = list(rngs)
        self._flows = [effect for effect in effects if effect.overrides("flow")]
        self._wrenches = [effect for effect in effects if effect.overrides("wrench")]
        self._uniform = all(effect.uniform for effect in self._flows)
        self.leg_s = leg_s if self._flows or self._wrenches else math.inf
        self.asks_body = any(effect.asks_body for effect in effects)

    def copy(self) -> Acting:
        """Return an independent copy: effects and histories."""
        return self.pick(range(len(self.histories)))

    def pick(self, lanes: Sequence[int]) -> Acting:
        """Return an independent copy of some lanes; see Batch.pick."""
        twin = copy.copy(self)
        twin.histories = [History(list(self.histories[lane].strokes)) for lane in lanes]
        twin.rngs = [copy.deepcopy(self.rngs[lane]) for lane in lanes]
        return twin

    def stroke(self, lane: int, limb: int, time_s: float, body: Body | None = None) -> Stroke:
        """Return the stroke of a lane's limb, and add it to the history.

        Args:
            time_s: start of its pulse.
            body: state of the robot, for effects that need it (``asks_body``).

        Raises:
            InputError: an effect gave a stroke that is not finite, or of another limb or time.
        """
        given_stroke = (self._names[limb], limb, time_s)
        stroke = Stroke(*given_stroke, body=body)
        for effect in self.effects:
            stroke = stroke_by(effect, stroke, self.histories[lane], self.rngs[lane])
        self.histories[lane].strokes.append((time_s, limb))
        if not _finite(stroke.gain, stroke.delay_s, stroke.duration_scale):
            raise InputError(f"effects {self.effects} give a stroke of {stroke}: values must be finite")
        if (stroke.limb, stroke.index, stroke.time_s) != given_stroke:
            raise InputError(
                f"effects {self.effects} give a stroke of {stroke}, which was one of {given_stroke[0]!r} at "
                f"{time_s:g} s: change its gain, delay_s and duration_scale only"
            )
        stroke.gain = min(2.0, max(0.0, stroke.gain))
        stroke.delay_s = max(0.0, stroke.delay_s)
        stroke.duration_scale = min(10.0, max(0.1, stroke.duration_scale))
        return stroke

    def fire(self, batch: Batch, lane: int, limb: int, time_s: float, own: int | None = None) -> None:
        """Start a stroke of a lane's limb, with the effects; ``own`` is their lane, if it has another number.

        Raises:
            InputError: see ``stroke``.
        """
        if not self.effects:
            batch.fire(lane, limb, time_s)
            return
        body = None
        if self.asks_body:
            pose, velocity = batch.pose_world()[lane], batch.velocity_body()[lane]
            if _diverged(pose, velocity):
                batch.fire(lane, limb, time_s)
                return
            body = body_at(time_s, pose, velocity)
        stroke = self.stroke(lane if own is None else own, limb, time_s, body)
        start_s = time_s + stroke.delay_s
        batch.fire(lane, limb, start_s, gain=stroke.gain, duration_scale=stroke.duration_scale)

    def fire_all(self, batch: Batch, lane: int, program: Program, own: int | None = None) -> None:
        """Start all strokes of a lane's program, in their order; for ``own`` see ``fire``."""
        for time_s, mask in program:
            for limb in range(batch.limbs):
                if mask >> limb & 1:
                    self.fire(batch, lane, limb, time_s, own)

    def advance(
        self, batch: Batch, until_s: float | Float64, trace: bool = False
    ) -> list[tuple[Float64, Float64]]:
        """Advance all lanes; flows and wrenches are evaluated again every ``leg_s``.

        Returns:
            See Batch.advance.
        """
        if math.isinf(self.leg_s):
            return batch.advance(until_s, trace)
        until = np.broadcast_to(np.asarray(until_s, dtype=np.float64), (batch.lanes,))
        traces: list[list[tuple[Float64, Float64]]] = []
        while True:
            left_s = until - batch.time_s
            left_s[list(batch.failures)] = 0.0
            going = np.flatnonzero(left_s > 0.0)
            if not len(going) and traces:
                break
            motion = batch.motion_world()
            for lane in going.tolist():
                now_s, row = float(batch.time_s[lane]), motion[lane]
                batch.set_water(lane, self.water(batch, now_s, row[:3], row[3:6]))
            ends = np.where(left_s <= 1.5 * self.leg_s, until, batch.time_s + self.leg_s)
            traces.append(batch.advance(np.where(left_s > 0.0, ends, batch.time_s), trace))
        legs = [[leg[lane] for leg in traces] for lane in range(batch.lanes)]
        return [(np.concatenate([a for a, _ in each]), np.concatenate([b for _, b in each])) for each in legs]

    def fix(self, fix: Fix) -> Fix | None:
        """Return a fix of the first lane's robot as the effects change it; None if one of them drops it.

        Raises:
            InputError: an effect gave a fix that is not finite.
        """
        seen: Fix | None = fix
        for effect in self.effects:
            if seen is None:
                return None
            seen = fix_by(effect, seen, self.rngs[0])
        if seen is not None and not _finite(
            seen.capture_s, seen.delay_s, seen.x_m, seen.y_m, seen.heading_rad
        ):
            raise InputError(f"effects {self.effects} give a fix of {seen}: values must be finite")
        return seen

    def water(self, batch: Batch, time_s: float, pose: Float64, velocity: Float64) -> Water:
        """Return flow and external acceleration around a body, linear in the position.

        Args:
            batch: has the robots' mass and moment of inertia.
            pose: (3,) world frame.
            velocity: (3,) body frame.
        """
        if not (self._flows or self._wrenches) or _diverged(pose, velocity):
            return STILL
        gradient = ((0.0, 0.0), (0.0, 0.0))
        centre = np.asarray(pose[:2], dtype=np.float64)
        flow, push = self._flow(time_s, centre), self._push(time_s, batch, pose, velocity)
        if not self._uniform:
            slopes = []
            for side in (np.array([_APART_M, 0.0]), np.array([0.0, _APART_M])):
                ahead, behind = self._flow(time_s, centre + side), self._flow(time_s, centre - side)
                slopes.append([(a - b) / (2 * _APART_M) for a, b in zip(ahead, behind, strict=True)])
            along_x, along_y = slopes
            gradient = ((along_x[0], along_y[0]), (along_x[1], along_y[1]))
        return Water(flow, gradient, (push[0], push[1]), push[2])

    def _flow(self, time_s: float, position_m: Float64) -> tuple[float, float]:
        x, y = 0.0, 0.0
        for effect in self._flows:
            more_x, more_y = numbers_by(effect, "flow", 2, time_s, position_m)
            x, y = x + more_x, y + more_y
        return x, y

    def _push(
        self, time_s: float, batch: Batch, pose: Float64, velocity: Float64
    ) -> tuple[float, float, float]:
        """Return accelerations, world frame: m/s^2, m/s^2, rad/s^2."""
        if not self._wrenches:
            return (0.0, 0.0, 0.0)
        seen, heading = body_at(time_s, pose, velocity), float(pose[2])
        forward, left, torque = 0.0, 0.0, 0.0
        for effect in self._wrenches:
            along, aside, turn = numbers_by(effect, "wrench", 3, time_s, seen)
            forward, left, torque = forward + along, left + aside, torque + turn
        force_x, force_y = rotate(heading, forward, left)
        return force_x / batch.mass_kg, force_y / batch.mass_kg, torque / batch.inertia_kg_m2


def lane_effects(robot: Robot, lanes: int, extra: Sequence[Effect] = ()) -> Acting:
    """Return ``body_effects`` of a robot, and ``extra``, in lanes; random effects draw the same in each."""
    return Acting((*body_effects(robot), *extra), robot, [np.random.default_rng(0) for _ in range(lanes)])


Program = Sequence[tuple[float, int]]
"""Strokes of one robot: (time_s, limb_mask), bit i = limb i."""


def program_of(robot: Robot, action: Action, start_s: float = 0.0) -> Program:
    """Return the strokes of an action that starts at ``start_s``."""
    strokes = [(start_s, action.first_mask), (start_s + robot.second_delay_s, action.second_mask)]
    return [(time, mask) for time, mask in strokes if mask]


def body_at(time_s: float, pose: Float64, velocity: Float64) -> Body:
    """Return a body from its pose (3,), world frame, and its velocity (3,), body frame."""
    x, y, heading = np.asarray(pose, dtype=np.float64).tolist()
    forward, left, omega = np.asarray(velocity, dtype=np.float64).tolist()
    return Body(time_s, (x, y, heading), (forward, left, omega))


def _diverged(pose: Float64, velocity: Float64) -> bool:
    """Return whether a simulation is beyond all bounds, so that no effect can say anything about it."""
    return not all(abs(value) < _BEYOND for value in (*pose.tolist(), *velocity.tolist()))


def _finite(*given: Any) -> bool:
    try:
        return all(math.isfinite(value) for value in given)
    except (TypeError, ValueError, OverflowError):  # no numbers
        return False
