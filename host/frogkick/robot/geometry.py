"""Errors in a robot's geometry, warnings about its shape, actions and limits, and its mirror symmetry."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Bool, Float64, dot
from frogkick.core.errors import InputError
from frogkick.robot.model import Robot, limb_points, outline_of
from frogkick.robot.schema import Frame, Limb

SEGMENT_MIN_M = 1e-4  # shorter segments are likely errors of a unit
TURN_MAX_DEG = 170.0  # discrete curvature grows as tan(turn / 2)


def _cross(a: Float64, b: Float64) -> Float64:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def crossings(first: Float64, second: Float64) -> Bool:
    """(n - 1, m - 1) whether segments of two lines (n, 2) and (m, 2) cross; touching lines do not."""
    a, b = first[:-1, None], first[1:, None]
    c, d = second[None, :-1], second[None, 1:]
    apart_cd = _cross(b - a, c - a) * _cross(b - a, d - a) < 0.0
    apart_ab = _cross(d - c, a - c) * _cross(d - c, b - c) < 0.0
    return np.asarray(apart_cd & apart_ab)


def _edge(frame: Frame, index: int) -> Float64:
    return outline_of(frame)[index : index + 2]


def require_geometry(frame: Frame, limbs: tuple[Limb, ...]) -> None:
    """Check that frame and limbs can be built.

    Raises:
        InputError: a segment is too short, an edge turns too far, or two of them cross.
    """
    n = len(frame.corners_m)
    for i in range(n):
        length_m = math.dist(*_edge(frame, i))
        if length_m < SEGMENT_MIN_M * frame.segments[i]:
            raise InputError(
                f"frame edge {i} of {length_m:.3g} m has {frame.segments[i]} segments: "
                f"make each {SEGMENT_MIN_M:g} m or longer"
            )
        along, before = np.diff(_edge(frame, i), axis=0)[0], np.diff(_edge(frame, (i - 1) % n), axis=0)[0]
        turn_deg = math.degrees(math.atan2(float(_cross(before, along)), dot(before, along)))
        if abs(turn_deg) > TURN_MAX_DEG:
            raise InputError(
                f"the frame turns by {turn_deg:.0f} degrees at corner {i}: edges may turn by up to "
                f"{TURN_MAX_DEG:g}, so move the corner"
            )
        for j in range(i):
            if crossings(_edge(frame, i), _edge(frame, j)).any():
                raise InputError(
                    f"frame edges {j} and {i} cross: list frame.corners_m in order round the body"
                )
    shapes = [limb_points(frame, limb) for limb in limbs]
    for limb, shape in zip(limbs, shapes, strict=True):
        if limb.length_m < SEGMENT_MIN_M * limb.segments:
            raise InputError(
                f"limb {limb.name!r} of {limb.length_m:.3g} m has {limb.segments} segments: "
                f"make each {SEGMENT_MIN_M:g} m or longer"
            )
        turn_rad = limb.length_m * abs(limb.rest_curvature_per_m)
        if turn_rad > math.tau or crossings(shape, shape).any():
            raise InputError(
                f"limb {limb.name!r} crosses itself at rest: length_m times rest_curvature_per_m "
                f"is {turn_rad:.4g} rad, a circle 6.28: lower one"
            )
        own = {limb.corner, (limb.corner - 1) % n}
        for i in range(n):
            if i not in own and crossings(shape, _edge(frame, i)).any():
                raise InputError(
                    f"limb {limb.name!r} crosses frame edge {i} at rest: check its corner, "
                    "direction_deg and the sign of rest_curvature_per_m"
                )
    for i, shape in enumerate(shapes):
        for j in range(i):
            if crossings(shape, shapes[j]).any():
                raise InputError(
                    f"limbs {limbs[j].name!r} and {limbs[i].name!r} cross at rest: check their "
                    "corners, direction_deg and lengths"
                )


def _names(limbs: list[str]) -> str:
    return ("limb " if len(limbs) == 1 else "limbs ") + ", ".join(limbs)


def _limb_warnings(robot: Robot) -> list[str]:
    found: list[str] = []
    fired = 0
    for action in robot.actions:
        fired |= action.first_mask | action.second_mask
    idle = [limb.name for i, limb in enumerate(robot.limbs) if not fired >> i & 1]
    if idle:
        found.append(f"{_names(idle)}: no action fires it")
    n = len(robot.frame.corners_m)
    over = [
        limb.name
        for limb in robot.limbs
        if any(
            crossings(limb_points(robot.frame, limb), _edge(robot.frame, i)).any()
            for i in (limb.corner, (limb.corner - 1) % n)
        )
    ]
    if over:
        found.append(f"{_names(over)}: curled over the frame edge at its root; no contact is simulated")
    drops_per_m = [stroke.drop_per_m for stroke in robot.strokes()]
    active = [
        limb_points(robot.frame, limb, drop) for limb, drop in zip(robot.limbs, drops_per_m, strict=True)
    ]
    for i, limb in enumerate(robot.limbs):
        for j in range(i):
            if crossings(active[i], active[j]).any():
                found.append(f"limbs {robot.limbs[j].name}, {limb.name}: cross where both are active")
        drop_per_m = drops_per_m[i]
        if drop_per_m > abs(limb.rest_curvature_per_m):
            found.append(
                f"limb {limb.name}: a stroke takes {drop_per_m:.1f} 1/m off its curvature of "
                f"{abs(limb.rest_curvature_per_m):g}: it bends the other way"
            )
    return found


def _mirror_warnings(robot: Robot) -> list[str]:
    """Limbs at mirrored corners that are not mirror images of each other."""
    found: list[str] = []
    places = [robot.frame.corners_m[limb.corner] for limb in robot.limbs]
    for i, limb in enumerate(robot.limbs):
        for j in range(i):
            other = robot.limbs[j]
            if math.hypot(places[i][0] - places[j][0], places[i][1] + places[j][1]) > 1e-6:
                continue
            bend = limb.rest_curvature_per_m + other.rest_curvature_per_m
            turn = math.remainder(limb.direction_rad + other.direction_rad, 2.0 * math.pi)
            wrong = [
                name
                for name, is_wrong in (
                    ("rest_curvature_per_m", abs(bend) > 1e-6),
                    ("direction_deg", abs(turn) > 1e-6),
                    ("clamp", limb.clamp == other.clamp),
                )
                if is_wrong
            ]
            if wrong:
                found.append(
                    f"limbs {other.name}, {limb.name}: at mirrored corners but no mirror images in "
                    + ", ".join(wrong)
                )
    return found


def _guard_warnings(robot: Robot) -> list[str]:
    guard = robot.guard
    found: list[str] = []
    if robot.pulse_s > guard.pulse_max_s:
        found.append(
            f"pulse_s {robot.pulse_s:g} is above guard.pulse_max_s {guard.pulse_max_s:g}: all is refused"
        )
    overlap = robot.second_delay_s < robot.pulse_s
    for action in robot.actions:
        first, second = action.first_mask.bit_count(), action.second_mask.bit_count()
        most = first + second if overlap else max(first, second)
        if most > guard.limbs_at_once_max:
            found.append(
                f"action {action.name}: {most} limbs at once, guard.limbs_at_once_max is "
                f"{guard.limbs_at_once_max}: refused"
            )
        if action.first_mask & action.second_mask:
            found.append(f"action {action.name}: a limb in both groups: the guard refuses its second pulse")
    if robot.period_s - robot.second_delay_s - robot.pulse_s < guard.rest_min_s:
        found.append(
            f"guard.rest_min_s {guard.rest_min_s:g}: a limb fired second and then first within period_s "
            f"{robot.period_s:g} is refused"
        )
    if robot.pulse_s / robot.period_s > guard.duty_max:
        found.append(
            f"guard.duty_max {guard.duty_max:g}: a limb fired each period is on for "
            f"{robot.pulse_s / robot.period_s:.3f} of the time: refused after a while"
        )
    return found


def robot_warnings(robot: Robot) -> tuple[str, ...]:
    """Warnings, one line each: idle limbs, overlaps, broken symmetry, refused strokes."""
    return (*_limb_warnings(robot), *_mirror_warnings(robot), *_guard_warnings(robot))


_CLOSE = 1e-12  # relative to the frame, and in radians: rounding of decimal numbers in a file


@dataclass(frozen=True)
class Mirror:
    """The mirroring: limb i becomes limb limbs[i], action a becomes action actions[a]."""

    limbs: tuple[int, ...]
    actions: tuple[int, ...]


def mirror_of(robot: Robot) -> Mirror | None:
    """The mirroring of a robot; None if its frame, limbs, actions or library box are not symmetric.

    A robot with effects counts as not symmetric.
    """
    if robot.effects:
        return None
    corners = _mirrored_corners(robot.frame)
    box = robot.library_box
    if corners is None or any(low != -high for low, high in (box.left_mps, box.omega_rad_s)):
        return None
    limbs: list[int] = []
    for limb in robot.limbs:
        found = [i for i, other in enumerate(robot.limbs) if _are_mirrored(limb, other, corners)]
        if len(found) != 1:
            return None
        limbs.append(found[0])

    def turned(mask: int) -> int:
        return sum(1 << limbs[i] for i in range(len(limbs)) if mask >> i & 1)

    masks = [(action.first_mask, action.second_mask) for action in robot.actions]
    mirrored = [(turned(first), turned(second)) for first, second in masks]
    if len(set(masks)) != len(masks) or set(masks) != set(mirrored):
        return None
    return Mirror(tuple(limbs), tuple(masks.index(pair) for pair in mirrored))


def _mirrored_corners(frame: Frame) -> list[int] | None:
    """The mirror image of each corner; None if the frame is not symmetric."""
    count = len(frame.corners_m)
    scale = _CLOSE * max(math.hypot(*corner) for corner in frame.corners_m)
    opposite: list[int] = []
    for x, y in frame.corners_m:
        near = [i for i, (u, v) in enumerate(frame.corners_m) if math.hypot(u - x, v + y) <= scale]
        if len(near) != 1:
            return None
        opposite.append(near[0])
    for i in range(count):  # edge i, from corner i to the next, comes out as the edge before opposite[i]
        edge = (opposite[i] - 1) % count
        if opposite[(i + 1) % count] != edge or frame.segments[i] != frame.segments[edge]:
            return None
    return opposite


def _are_mirrored(one: Limb, other: Limb, corners: list[int]) -> bool:
    turned = math.remainder(one.direction_rad + other.direction_rad, 2.0 * math.pi)
    return (
        corners[one.corner] == other.corner
        and one.clamp != other.clamp
        and abs(turned) <= _CLOSE * 10.0
        and one.rest_curvature_per_m == -other.rest_curvature_per_m
        and all(
            getattr(one, name) == getattr(other, name)
            for name in Limb.__dataclass_fields__
            if name not in ("name", "corner", "clamp", "direction_rad", "rest_curvature_per_m")
        )
    )
