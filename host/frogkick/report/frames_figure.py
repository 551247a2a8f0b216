"""One picture of the frames and units that every file, option and log of this project uses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon, Rectangle

from frogkick.core.poses import rotation
from frogkick.report import style

POOL_M = (1.2, 0.9)
POSE = (0.62, 0.42, math.radians(35.0))
"""Pose of the robot in the picture: x, y in m, heading in rad."""
SIDE_M, LIMB_M, TAG_M = 0.16, 0.075, 0.085
"""Size of the robot in the picture, twice its real size."""
CAMERA_M, TAG_HEIGHT_M = 1.35, 0.012
UNITS = (
    ("length", "m", "_m; _mm and _cm only on the command line and in pictures"),
    ("angle", "rad", "_rad, in (-pi, pi]; degrees only where a name says _deg"),
    ("time", "s", "_s from the log's start; the robot's own clock in _us"),
    ("speed, turning", "m/s, rad/s", "_mps, _rad_s, in the robot's frame"),
    ("picture", "px", "_px, the middle of the first pixel is (0, 0), y down"),
)


def frames_figure() -> Figure:
    """Draw the frames of pool, robot and tag from above, the heights from the side, and the units."""
    with style.new_figure(10.5, 7.4) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.75, 1.0), height_ratios=(1.0, 0.28))
        _above(figure.add_subplot(grid[0, 0]))
        _beside(figure.add_subplot(grid[0, 1]))
        _units(figure.add_subplot(grid[1, :]))
    return figure


def _arrow(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str) -> None:
    style.arrow(axes, start, end, color=colour, linewidth=2.0, shrinkA=0)


def _text(axes: Axes, point: np.ndarray, words: str, **look: Any) -> None:
    axes.text(float(point[0]), float(point[1]), words, **look)


def _above(axes: Axes) -> None:
    length, width = POOL_M
    water = style.look(facecolor="#eaf4fb", edgecolor=style.FLOOR, linewidth=1.5)
    axes.add_patch(Rectangle((0, 0), length, width, **water))
    for x, y, text in ((0, 0, "(0, 0)"), (length, 0, "(L, 0)"), (*POOL_M, "(L, W)"), (0, width, "(0, W)")):
        look = style.look(textcoords="offset points", ha="center", color="#555555")
        axes.annotate(text, (x, y), (0, -12 if y == 0 else 6), **look)
    _arrow(axes, np.zeros(2), np.array([0.28, 0.0]), style.TRUE)
    _arrow(axes, np.zeros(2), np.array([0.0, 0.28]), style.TRUE)
    axes.text(0.29, 0.02, "x, along the length", color=style.TRUE)
    axes.text(0.015, 0.29, "y", color=style.TRUE)
    axes.plot(0, 0, "o", color=style.TRUE, markersize=11, fillstyle="none", clip_on=False)
    axes.plot(0, 0, ".", color=style.TRUE, clip_on=False)
    axes.text(0.03, 0.05, "z up, 0 on the water", color=style.TRUE)
    axes.text(0.03, width - 0.06, "pool frame (world): origin in the pool's first corner", color=style.TRUE)
    _robot(axes)
    axes.set(xlim=(-0.08, length + 0.05), ylim=(-0.09, width + 0.07), aspect="equal")
    axes.axis("off")
    axes.set_title("from above, as the camera sees it")


def _robot(axes: Axes) -> None:
    x, y, heading = POSE

    def place(forward_m: float, left_m: float) -> np.ndarray:
        return np.asarray(np.array([x, y]) + rotation(heading) @ np.array([forward_m, left_m]))

    half = SIDE_M / 2
    around = ((1, 1), (1, -1), (-1, -1), (-1, 1))
    outline = [place(half * a, half * b) for a, b in around]
    axes.add_patch(Polygon(outline, closed=True, facecolor="white", edgecolor=style.FLOOR, linewidth=2.0))
    tip, names = LIMB_M / math.sqrt(2), ("front_left", "front_right", "rear_left", "rear_right")
    for name, (a, b) in zip(names, ((1, 1), (1, -1), (-1, 1), (-1, -1)), strict=True):
        ends = np.array([place(half * a, half * b), place(half * a - tip, half * b + tip * b)])
        axes.plot(*ends.T, color=style.ALARM, linewidth=3.0, solid_capstyle="round")
        beside = place(half * a - (0.1 if a > 0 else 1.2) * tip, half * b + (1.5 if b > 0 else 1.8) * tip * b)
        _text(axes, beside, name, color=style.ALARM, ha="center", va="center", fontsize=8)
    tag = TAG_M / 2
    square = [place(tag * a, tag * b) for a, b in around]
    axes.add_patch(Polygon(square, closed=True, color="#333333"))
    look = style.look(ha="center", rotation=math.degrees(heading) - 90.0)
    _text(axes, place(0.0, 0.0), "TAG", color="white", va="center", fontweight="bold", **look)
    _text(axes, place(0.6 * half, 0.0), "top", color="#333333", va="bottom", fontsize=8, **look)
    _arrow(axes, place(half, 0.0), place(half + 0.2, 0.0), style.ESTIMATED)
    _arrow(axes, place(0.0, half), place(0.0, half + 0.17), style.ESTIMATED)
    _text(axes, place(half + 0.22, 0.0), "x, forward", color=style.ESTIMATED, va="center")
    _text(axes, place(0.0, half + 0.195), "y, left", color=style.ESTIMATED, ha="right", va="bottom")
    axes.text(
        x + 0.14, y - 0.235, "robot frame (body): origin\nin the middle of its frame", color=style.ESTIMATED
    )
    axes.plot([x, x + 0.5], [y, y], ":", color=style.PREDICTED, linewidth=1.2)
    turn = style.look(theta1=0.0, theta2=math.degrees(heading), color=style.PREDICTED, linewidth=2.0)
    axes.add_patch(Arc((x, y), 0.66, 0.66, **turn))
    middle = np.array([x, y]) + 0.35 * np.array([math.cos(0.42 * heading), math.sin(0.42 * heading)])
    _text(axes, middle, "heading: from +x,\ncounter-clockwise", color=style.PREDICTED, va="center")


def _beside(axes: Axes) -> None:
    axes.fill_between([0.0, 1.0], -0.3, 0.0, color="#eaf4fb")
    axes.axhline(0.0, color=style.TRUE, linewidth=1.5)
    axes.text(0.02, -0.07, "z = 0, the water", color=style.TRUE)
    axes.text(0.02, -0.24, "under water: z < 0, raised by refraction\n(refraction_offset_m)", color="#555555")
    axes.add_patch(Rectangle((0.38, CAMERA_M), 0.12, 0.08, color="#333333"))
    axes.add_patch(Polygon([(0.40, CAMERA_M), (0.48, CAMERA_M), (0.44, CAMERA_M - 0.06)], color="#333333"))
    for end in (0.04, 0.84):
        axes.plot([0.44, end], [CAMERA_M - 0.06, 0.0], ":", color="#888888")
    _arrow(axes, np.array([0.92, 0.0]), np.array([0.92, CAMERA_M]), style.TRUE)
    axes.text(0.89, 0.75, "--camera-height-m", color=style.TRUE, rotation=90, ha="right", va="center")
    tag = 8 * TAG_HEIGHT_M
    axes.add_patch(Rectangle((0.5, 0.0), 0.24, tag - 0.02, facecolor="white", edgecolor=style.FLOOR))
    axes.plot([0.54, 0.7], [tag, tag], color="#333333", linewidth=5.0, solid_capstyle="butt")
    axes.text(0.62, tag + 0.04, "tag, --tag-height-mm\nover the water", ha="center", color=style.ALARM)
    axes.set(xlim=(0.0, 1.0), ylim=(-0.34, CAMERA_M + 0.12))
    axes.axis("off")
    axes.set_title("from the side (not to scale)")


def _units(axes: Axes) -> None:
    axes.axis("off")
    look = style.look(cellLoc="left", loc="center", colWidths=[0.18, 0.22, 0.6], edges="horizontal")
    heads = ["what", "unit inside and in files", "in a name"]
    table = axes.table([list(row) for row in UNITS], colLabels=heads, **look)
    table.auto_set_font_size(False)
    table.set_fontsize(9)
