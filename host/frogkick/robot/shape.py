"""The shape of a robot: frame and limbs, and their lines for checks and pictures."""

from __future__ import annotations

import html
import math
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float64


@dataclass(frozen=True)
class Frame:
    """The stiff body: a closed polygon of rods, corners counter-clockwise in the body frame.

    Its fields are the keys of ``frogkick.robot.schema.FrameTable``; the last one is set by effects only.
    """

    corners_m: tuple[tuple[float, float], ...]
    segments: tuple[int, ...]
    mass_per_length_kg_per_m: float
    added_mass_per_length_kg_per_m: float  # inertia only
    stretching_stiffness_n: float
    bending_stiffness_n_m2: float
    drag_width_m: float
    drag_normal: float
    drag_tangential: float
    centre_mass_share: float = 0.0
    centre_mass_at_m: tuple[float, float] = (0.0, 0.0)  # of that share, from the centre of the corners


@dataclass(frozen=True)
class Limb:
    """An actuated rod, rooted at a corner of the frame. The order of limbs is the bit order of limb masks.

    Its fields are the keys of ``frogkick.robot.schema.LimbTable``; the last two are set by effects only.
    """

    name: str
    corner: int
    clamp: str
    direction_rad: float  # tangent at its root, body frame, counter-clockwise from forward
    length_m: float
    segments: int
    rest_curvature_per_m: float
    modulus_rest_pa: float  # at activation 0
    modulus_active_pa: float  # at activation 1; linear in between
    second_moment_m4: float  # I, so that EI = modulus * second_moment
    section_m2: float  # A, so that EA = modulus_rest * section
    root_stiffness_ratio: float  # bending stiffness at the root over the limb's own at rest
    mass_per_length_kg_per_m: float
    added_mass_per_length_kg_per_m: float
    drag_width_m: float
    drag_normal: float
    drag_tangential: float
    # water that moves with it across but not along it (effect limb_plate)
    plate_mass_per_length_kg_per_m: float = 0.0
    # share of its momentum that the tip leaves behind; see frogkick.der.plates
    tip_shedding: float = 0.0


def outline_of(frame: Frame) -> Float64:
    """(corners + 1, 2) the frame as a closed line, m."""
    return np.array([*frame.corners_m, frame.corners_m[0]])


def limb_points(frame: Frame, limb: Limb, fall_per_m: float = 0.0) -> Float64:
    """(segments + 1, 2) nodes of a limb from root to tip, m, in the robot file's body coordinates.

    ``fall_per_m`` is the drop of its curvature by a stroke, 1/m.
    """
    curvature = limb.rest_curvature_per_m - math.copysign(fall_per_m, limb.rest_curvature_per_m)
    step = limb.length_m / limb.segments
    turn = 2.0 * math.atan(0.5 * curvature * step)  # between chords: curvature 2 tan(turn / 2) / step
    angle = limb.direction_rad + (np.arange(limb.segments) + 0.5) * turn
    chords = step * np.column_stack([np.cos(angle), np.sin(angle)])
    root = np.array([frame.corners_m[limb.corner]])
    return np.concatenate([root, root + np.cumsum(chords, axis=0)])


def svg_of(frame: Frame, limbs: tuple[Limb, ...], width_px: int = 320) -> str:
    """A robot at rest as an SVG picture from above, forward up, with the limbs' names."""
    lines = {limb.name: limb_points(frame, limb) for limb in limbs}
    outline = outline_of(frame)
    points = np.concatenate([outline, *lines.values()])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.12 * float((high - low).max())
    wide, tall = (float(size) + 2.0 * margin for size in (high - low)[::-1])

    def line(points: Float64) -> str:
        return " ".join(f"{high[1] + margin - y:.5f},{high[0] + margin - x:.5f}" for x, y in points)

    stroke = f"fill='none' stroke-width='{0.012 * wide:.5f}' stroke-linejoin='round'"
    drawn = [f"<polyline points='{line(outline)}' {stroke} stroke='#333'/>"]
    for name, points in lines.items():
        x, y = line(points[-1:]).split(",")
        drawn.append(f"<polyline points='{line(points)}' {stroke} stroke='#1f77b4'/>")
        drawn.append(
            f"<text x='{x}' y='{y}' font-size='{0.045 * wide:.5f}' text-anchor='middle'>"
            f"{html.escape(name)}</text>"
        )
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' width='{width_px}' viewBox='0 0 {wide:.5f} {tall:.5f}'>"
        f"{''.join(drawn)}</svg>"
    )
