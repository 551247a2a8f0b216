"""Algorithm 1 in float32 (numba): the onboard planner's twin, bit for bit.

Written from the format and the rules, not from the C: neighbours by brute force instead of a tree, every
branch costed in full instead of cut, recursion-free by counting through the action sequences. What the
two share is the order of float32 operations, and that is the contract:

- only + - * / sqrt in float32, each rounded once. numba would turn ``int * float32`` into float64, so every
  integer is made a float32 first and every constant is one; no fastmath, so nothing is fused;
- integers where a comparison decides; ties take the lowest index.

All kernels stand in this one file: numba's cache looks at the file of the outermost function only, and would
keep old code for a helper that changed in another file.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from frogkick.planner.layout import VELOCITY_CODE_MAX

Array = npt.NDArray[Any]

OK = 0
ERROR_NOT_FINITE = -2
ERROR_RANGE = -3
ERROR_DEPTH = -4
ERROR_WEIGHT = -5
ERROR_PATH_COUNT = -6
ERROR_PATH_POINT = -7

DEPTH_MAX = 4
PATH_POINTS_MAX = 100
POSITION_MAX_M = np.float32(1000)
HEADING_MAX_RAD = np.float32(1000)
ANGLE_MAX_RAD = np.float32(2100)
WEIGHT_MAX = np.float32(1e6)

_F0 = np.float32(0)
_F1 = np.float32(1)
_HALF = np.float32(0.5)
_PI = np.float32(3.14159274)
_NAN = np.float32(np.nan)
_SHIFT = np.float32(12582912)  # 1.5 * 2**23: adding and subtracting rounds to the nearest integer
_TURN_1 = np.float32(6.28125)  # 2 pi in three parts: products with a count of turns are exact
_TURN_2 = np.float32(0.00193548203)
_TURN_3 = np.float32(-1.74845553e-07)
_TURNS_PER_RAD = np.float32(0.159154937)
_QUARTER_1 = np.float32(1.5703125)  # pi / 2 likewise
_QUARTER_2 = np.float32(0.000483870506)
_QUARTER_3 = np.float32(-4.37113883e-08)
_QUARTERS_PER_RAD = np.float32(0.636619747)
_S0 = np.float32(-0.166666552)  # least-maximum fits on |r| <= pi / 4 + 0.001
_S1 = np.float32(0.00833215471)
_S2 = np.float32(-0.000195144545)
_C0 = np.float32(0.0416666456)
_C1 = np.float32(-0.00138873595)
_C2 = np.float32(2.44375333e-05)
_CODE_MAX = np.float32(VELOCITY_CODE_MAX)


@njit(cache=True)
def wrap_angle(angle: np.float32) -> np.float32:
    """Wrap an angle to (-pi, pi]; NaN beyond +-2100 rad."""
    if not (abs(angle) <= ANGLE_MAX_RAD):
        return _NAN
    if -_PI < angle <= _PI:
        return angle
    turns = (angle * _TURNS_PER_RAD + _SHIFT) - _SHIFT
    wrapped = ((angle - turns * _TURN_1) - turns * _TURN_2) - turns * _TURN_3
    if wrapped > _PI:
        wrapped = ((wrapped - _TURN_1) - _TURN_2) - _TURN_3
    if wrapped <= -_PI:
        wrapped = ((wrapped + _TURN_1) + _TURN_2) + _TURN_3
    return min(wrapped, _PI)


@njit(cache=True)
def sincos(angle: np.float32) -> tuple[np.float32, np.float32]:
    """Return (sine, cosine) of an angle in rad; NaN beyond +-2100 rad."""
    if not (abs(angle) <= ANGLE_MAX_RAD):
        return _NAN, _NAN
    quarters = (angle * _QUARTERS_PER_RAD + _SHIFT) - _SHIFT
    r = ((angle - quarters * _QUARTER_1) - quarters * _QUARTER_2) - quarters * _QUARTER_3
    r2 = r * r
    sine = r + r * r2 * (_S0 + r2 * (_S1 + r2 * _S2))
    cosine = (_F1 - _HALF * r2) + r2 * r2 * (_C0 + r2 * (_C1 + r2 * _C2))
    quadrant = int(quarters) % 4
    if quadrant == 1:
        return cosine, -sine
    if quadrant == 2:
        return -sine, -cosine
    if quadrant == 3:
        return -cosine, sine
    return sine, cosine


@njit(cache=True)
def velocity_code(velocity: np.float32, codes_per_velocity: np.float32) -> Any:
    """Return a velocity as a code, rounded half away from zero, clamped to +-16383."""
    code = velocity * codes_per_velocity
    size = min(abs(code), _CODE_MAX)
    whole = int(size)
    if size - np.float32(whole) >= _HALF:
        whole += 1
    return -whole if code < _F0 else whole


@njit(cache=True)
def nearest_state(states: Array, code_0: Any, code_1: Any, code_2: Any) -> int:
    """Return the row nearest to a velocity in codes, the lowest on ties; 64-bit sums."""
    best = np.int64(2) ** 62
    row = 0
    for index in range(states.shape[0]):
        d0 = np.int64(states[index, 0]) - code_0
        d1 = np.int64(states[index, 1]) - code_1
        d2 = np.int64(states[index, 2]) - code_2
        distance2 = d0 * d0 + d1 * d1 + d2 * d2
        if distance2 < best:
            best = distance2
            row = index
    return row


@njit(cache=True)
def nearest_point(x_m: Array, y_m: Array, x: np.float32, y: np.float32) -> tuple[int, np.float32]:
    """Return the index of the nearest path point, the lowest on ties, and the squared distance, m^2."""
    index = 0
    best = np.float32(np.inf)
    for point in range(len(x_m)):
        dx = x_m[point] - x
        dy = y_m[point] - y
        distance2 = dx * dx + dy * dy
        if distance2 < best:
            best = distance2
            index = point
    return index, best


@njit(cache=True)
def pose_cost(path: Array, weights: Array, x: np.float32, y: np.float32, heading: np.float32) -> Any:
    """Return the cost of a pose: path (3, n) float32 x, y, tangent; weights (4,) float32."""
    index, distance2 = nearest_point(path[0], path[1], x, y)
    angle = abs(wrap_angle(heading - path[2, index]))
    progress = np.float32(index) / np.float32(path.shape[1] - 1)
    return (weights[0] * np.sqrt(distance2) + weights[1] * angle) + weights[2] * (_F1 - progress)


@njit(cache=True)
def check(path: Array, weights: Array, depth: int, state: Array) -> int:
    """Return OK or the code of the first thing that is wrong, in the C's order."""
    if not 1 <= depth <= DEPTH_MAX:
        return ERROR_DEPTH
    for weight in weights:
        if not (_F0 <= weight <= WEIGHT_MAX) or (weight == _F0 and np.signbit(weight)):
            return ERROR_WEIGHT
    if not 2 <= path.shape[1] <= PATH_POINTS_MAX:
        return ERROR_PATH_COUNT
    for point in range(path.shape[1]):
        if not (abs(path[0, point]) <= POSITION_MAX_M and abs(path[1, point]) <= POSITION_MAX_M):
            return ERROR_PATH_POINT
        if not abs(path[2, point]) <= HEADING_MAX_RAD:
            return ERROR_PATH_POINT
    for value in state:
        if not np.isfinite(value):
            return ERROR_NOT_FINITE
    if abs(state[0]) > POSITION_MAX_M or abs(state[1]) > POSITION_MAX_M or abs(state[2]) > HEADING_MAX_RAD:
        return ERROR_RANGE
    return OK


@njit(cache=True)
def step(pose: Array, motion: Array, motion_scale: Array, after: Array) -> None:
    """Write the pose after an action: (x, y, wrapped heading) float32, motion in int16 codes."""
    forward = np.float32(motion[0]) * motion_scale[0]
    left = np.float32(motion[1]) * motion_scale[1]
    turn = np.float32(motion[2]) * motion_scale[2]
    sine, cosine = sincos(pose[2])
    after[0] = pose[0] + (cosine * forward - sine * left)
    after[1] = pose[1] + (sine * forward + cosine * left)
    after[2] = wrap_angle(pose[2] + turn)


@njit(cache=True)
def plan_one(
    states: Array,
    transitions: Array,
    velocity_scale: Array,
    motion_scale: Array,
    path: Array,
    weights: Array,
    depth: int,
    state: Array,
    numbers: Array,
    values: Array,
) -> None:
    """Plan from one state.

    Writes ``numbers`` (4,) int32: status, action, nearest state, path index, and ``values`` (7,) float32:
    cost, predicted x, y, heading, vx, vy, omega; all zero where the status is an error.
    """
    numbers[:] = 0
    values[:] = _F0
    numbers[0] = check(path, weights, depth, state)
    if numbers[0] != OK:
        return
    actions = transitions.shape[1]
    poses = np.zeros((DEPTH_MAX + 1, 3), dtype=np.float32)
    rows = np.zeros(DEPTH_MAX + 1, dtype=np.int64)
    sums = np.zeros(DEPTH_MAX + 1, dtype=np.float32)
    sequence = np.zeros(DEPTH_MAX, dtype=np.int64)
    poses[0, 0] = state[0]
    poses[0, 1] = state[1]
    poses[0, 2] = wrap_angle(state[2])
    rows[0] = nearest_state(
        states,
        velocity_code(state[3], _F1 / velocity_scale[0]),
        velocity_code(state[4], _F1 / velocity_scale[1]),
        velocity_code(state[5], _F1 / velocity_scale[2]),
    )
    best_action = -1
    best_cost = _F0
    changed = 0  # the first level whose action differs from the sequence before
    while changed >= 0:
        for level in range(changed, depth):
            entry = transitions[rows[level], sequence[level]]
            step(poses[level], entry, motion_scale, poses[level + 1])
            factor = _F1 + weights[3] * np.float32(depth - 1 - level)
            after = poses[level + 1]
            cost = pose_cost(path, weights, after[0], after[1], after[2])
            sums[level + 1] = sums[level] + cost * factor
            if level + 1 < depth:
                rows[level + 1] = nearest_state(
                    states, np.int64(entry[3]), np.int64(entry[4]), np.int64(entry[5])
                )
        if best_action < 0 or sums[depth] < best_cost:
            best_cost = sums[depth]
            best_action = sequence[0]
        changed = depth - 1
        while changed >= 0:
            sequence[changed] += 1
            if sequence[changed] < actions:
                break
            sequence[changed] = 0
            changed -= 1
    entry = transitions[rows[0], best_action]
    step(poses[0], entry, motion_scale, values[1:4])
    for axis in range(3):
        values[4 + axis] = np.float32(entry[3 + axis]) * velocity_scale[axis]
    values[0] = best_cost
    numbers[1] = best_action
    numbers[2] = rows[0]
    numbers[3] = nearest_point(path[0], path[1], state[0], state[1])[0]


@njit(cache=True)
def plan_many(
    states: Array,
    transitions: Array,
    velocity_scale: Array,
    motion_scale: Array,
    path: Array,
    weights: Array,
    depths: Array,
    queries: Array,
    numbers: Array,
    values: Array,
) -> None:
    """Plan from each row of ``queries`` (k, 6) float32 with its own depth (k,)."""
    for k in range(len(queries)):
        plan_one(
            states,
            transitions,
            velocity_scale,
            motion_scale,
            path,
            weights,
            depths[k],
            queries[k],
            numbers[k],
            values[k],
        )
