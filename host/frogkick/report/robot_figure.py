"""Figures of a robot as it is simulated, of its actions, and of measured strokes with their fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from frogkick.core.arrays import Float64
from frogkick.der import prepare
from frogkick.der.mesh import Mesh
from frogkick.report import style
from frogkick.robot import Robot, in_a_row, limb_points
from frogkick.robot.profile import MeasuredStroke, Profile


def robot_figure(robot: Robot) -> Figure:
    """Draw a robot's nodes, edges and limbs in its body frame, in mm: at rest, and all limbs fully active.

    Frame and limbs at rest are the simulation's own mesh. The active shapes are the natural ones: those of a
    limb at the peak of a stroke, without water.
    """
    mesh = prepare(robot).mesh
    nodes_mm = 1e3 * (mesh.rest_m + _mesh_origin(robot, mesh))
    with style.new_figure(8.2, 8.2) as figure:
        axes = figure.subplots()
        _frame(axes, robot, mesh, nodes_mm)
        _limbs(axes, robot, mesh, nodes_mm)
        _centre_and_forward(axes, robot, mesh, nodes_mm)
        _window(axes)
        axes.set(
            xlabel="y, left (mm)",
            ylabel="x, forward (mm)",
            title=f"{robot.title}\n{robot.id}: {len(robot.limbs)} limbs, {len(robot.actions)} actions, "
            f"{len(mesh.rest_m)} nodes, {1e3 * robot.mass_kg:.0f} g",
        )
        axes.legend(handles=_legend(robot), loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3)
    return figure


def actions_figure(robot: Robot, ends: Float64) -> Figure:
    """Draw each action: the limbs that it heats, and how far it moves and turns the robot.

    ``ends`` are (actions, 3) motions from rest in one period, body frame at its start: m, m, rad.
    """
    columns = min(5, len(robot.actions))
    rows = -(-len(robot.actions) // columns)
    outline = 1e3 * np.array([*robot.frame.corners_m, robot.frame.corners_m[0]])
    rest = [1e3 * limb_points(robot.frame, limb) for limb in robot.limbs]
    active = [
        1e3 * limb_points(robot.frame, limb, stroke.drop_per_m)
        for limb, stroke in zip(robot.limbs, robot.strokes(), strict=True)
    ]
    points = np.vstack([outline, *rest, *active])
    low, high = points.min(axis=0) - 5.0, points.max(axis=0) + 5.0
    with style.new_figure(1.9 * columns, 2.3 * rows) as figure:
        every = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in every[len(robot.actions) :]:
            axes.remove()
        for axes, action, end in zip(every, robot.actions, ends, strict=False):
            _line(axes, outline, "-", color=style.DESIRED, linewidth=1.5)
            for index in range(len(robot.limbs)):
                first, second = action.first_mask >> index & 1, action.second_mask >> index & 1
                colour = style.ALARM if first else style.PREDICTED if second else style.TRUE
                shapes, width = (active, 2.5) if first or second else (rest, 1.0)
                _line(axes, shapes[index], "-", color=colour, linewidth=width)
            far_mm, turn_deg = 1e3 * math.hypot(end[0], end[1]), round(math.degrees(end[2]))
            if far_mm >= 0.5:  # a shorter arrow would be only its head
                tip = (1e3 * end[1], 1e3 * end[0])
                style.arrow(axes, (0.0, 0.0), tip, color="black", shrinkA=0, shrinkB=0)
            axes.set(xlim=(high[1], low[1]), ylim=(low[0], high[0]))
            axes.set_aspect("equal", adjustable="box")
            axes.set_axis_off()
            axes.set_title(f"{action.name}: {far_mm:.0f} mm, {turn_deg:+d} deg", loc="center")
    return figure


def _window(axes: Axes) -> None:
    """Show all of the robot at equal scales, with room for the limbs' names at its sides."""
    box = axes.dataLim
    half = max(0.72 * box.width, 0.58 * box.height)
    middle_x, middle_y = 0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1)
    # x forward is drawn upwards, so left is left: the robot as seen from above, swimming up the page.
    axes.set(xlim=(middle_x + half, middle_x - half), ylim=(middle_y - half, middle_y + half))
    axes.set_aspect("equal", adjustable="box")


def _mesh_origin(robot: Robot, mesh: Mesh) -> Float64:
    """Return the offset from the mesh's nodes to the robot file's coordinates, m."""
    return np.asarray(np.array(robot.frame.corners_m[0]) - mesh.rest_m[0])


def _line(axes: Axes, points_mm: Float64, form: str, **look: Any) -> None:
    axes.plot(points_mm[:, 1], points_mm[:, 0], form, **look)


def _away(robot: Robot, corner: int) -> tuple[float, float]:
    """Unit vector on the page, from the middle of the frame to a corner."""
    middle = np.mean(robot.frame.corners_m, axis=0)
    x, y = np.array(robot.frame.corners_m[corner]) - middle
    length = max(math.hypot(x, y), 1e-9)
    return -y / length, x / length


def _frame(axes: Axes, robot: Robot, mesh: Mesh, nodes_mm: Float64) -> None:
    ring = nodes_mm[[*range(mesh.frame_nodes), 0]]
    _line(axes, ring, "-", color=style.DESIRED, linewidth=2.0)
    _line(axes, ring, ".", color="black", markersize=3)
    for index, corner_m in enumerate(robot.frame.corners_m):
        corner = 1e3 * np.array([corner_m])
        _line(axes, corner, "s", color=style.DESIRED, markersize=7)
        away = _away(robot, index)
        # Outside the frame, where the limbs are.
        side = -1.0 if any(limb.corner == index for limb in robot.limbs) else 1.0
        beside = (side * 28.0 * away[0], side * 20.0 * away[1])
        look = style.look(textcoords="offset points", ha="center", va="center", color=style.DESIRED)
        axes.annotate(f"corner {index}", (corner[0, 1], corner[0, 0]), beside, fontsize=7, **look)


def _limbs(axes: Axes, robot: Robot, mesh: Mesh, nodes_mm: Float64) -> None:
    strokes = robot.strokes()
    node = mesh.frame_nodes
    corner_node = np.concatenate([[0], np.cumsum(robot.frame.segments)[:-1]])
    for index, limb in enumerate(robot.limbs):
        root = corner_node[limb.corner]
        rest = nodes_mm[[root, *range(node, node + limb.segments)]]
        node += limb.segments
        active = 1e3 * limb_points(robot.frame, limb, strokes[index].drop_per_m)
        _line(axes, active, ".-", color=style.ALARM, markersize=3, linewidth=1.2)
        _line(axes, rest, ".-", color=style.TRUE, markersize=4, linewidth=2.0)
        _line(axes, rest[-1:], "o", color=style.TRUE, markersize=5, markerfacecolor="white")
        step = 1 if limb.clamp == "next" else -1
        edge = nodes_mm[[root, (root + 2 * step) % mesh.frame_nodes]]
        _line(axes, edge, "-", color="black", linewidth=4.0, alpha=0.55, solid_capstyle="butt")
        fires = [a.name for a in robot.actions if (a.first_mask | a.second_mask) >> index & 1]
        actions = "\n".join(wrap(in_a_row(fires), 24, break_on_hyphens=False, break_long_words=False))
        tip = active[-1]
        # The page's x is -y of the body.
        right, up = -math.sin(limb.direction_rad), math.cos(limb.direction_rad)
        look = style.look(textcoords="offset points", ha="left" if right > 0.0 else "right", va="center")
        colour, fired_by = style.TRUE if actions else style.ALARM, f"actions {actions or 'none'}"
        beside = (10.0 * right, 16.0 * up)
        axes.annotate(
            f"{index} {limb.name}\n{fired_by}", (tip[1], tip[0]), beside, color=colour, fontsize=8, **look
        )


def _centre_and_forward(axes: Axes, robot: Robot, mesh: Mesh, nodes_mm: Float64) -> None:
    centre = 1e3 * _mesh_origin(robot, mesh)
    axes.plot([centre[1]], [centre[0]], "x", color="black", markersize=9, markeredgewidth=2)
    length = 0.3 * float(np.ptp(nodes_mm[: mesh.frame_nodes, 0]))
    tip = (centre[1], centre[0] + length)
    style.arrow(axes, (centre[1], centre[0]), tip, color="black", linewidth=1.5)
    axes.annotate("forward", tip, xytext=(4, 2), textcoords="offset points")
    axes.plot([0.0], [0.0], "+", color=style.DESIRED, markersize=9)


def _legend(robot: Robot) -> list[Line2D]:
    falls = sorted({round(stroke.drop_per_m) for stroke in robot.strokes()})
    fall = "/".join(f"{each}" for each in falls)
    at = f"{robot.egain_percent:g} % EGaIn, {robot.profile_frequency_hz:g} Hz"
    entries: dict[str, dict[str, Any]] = {
        "frame: nodes, corners": {"color": style.DESIRED, "marker": "s", "markersize": 5},
        "limb at rest; circle: tip": {"color": style.TRUE, "marker": "o", "markerfacecolor": "white"},
        f"limb active: -{fall} 1/m ({at})": {"color": style.ALARM, "marker": "."},
        "edge that the root bends against": {"color": "black", "linewidth": 4, "alpha": 0.55},
        "centre of mass (with added mass)": {"color": "black", "marker": "x", "linestyle": "none"},
        "origin of the file's coordinates": {"color": style.DESIRED, "marker": "+", "linestyle": "none"},
    }
    return [Line2D([], [], label=label, **look) for label, look in entries.items()]


def stroke_figure(strokes: Sequence[MeasuredStroke], profiles: Sequence[Profile]) -> Figure:
    """Draw each measured stroke and the profile that was fitted to it."""
    with style.new_figure(8.0, 1.0 + 2.4 * len(strokes)) as figure:
        rows = figure.subplots(len(strokes), 1, squeeze=False, sharex=True)[:, 0]
        for axes, stroke, profile in zip(rows, strokes, profiles, strict=True):
            time_s = np.linspace(0.0, profile.duration_s, 400)
            axes.plot(stroke.time_s, stroke.curvature_per_m, ".", color=style.TRUE, label="measured")
            axes.plot(time_s, profile.curvature_per_m(time_s), color=style.ALARM, label="fitted")
            axes.set(
                title=f"{stroke.name}: {profile.frequency_hz:.3g} Hz, error {profile.rms_per_m:g} 1/m RMS",
                ylabel="curvature (1/m)",
            )
            axes.legend(loc="best")
        rows[-1].set_xlabel("time since the start of the pulse (s)")
    return figure
