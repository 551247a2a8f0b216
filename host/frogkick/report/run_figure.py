"""Figures of runs: one run with its distance, actions and errors; two runs compared."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from frogkick.core.arrays import Float64
from frogkick.core.poses import PredictionError, wrap_angle
from frogkick.report import style
from frogkick.runs.path_change import HOLD_LIMIT_M, spans_of
from frogkick.runs.runlog import RunLog
from frogkick.runs.summary import distances_m, learned_limbs, residual, track_of, true_poses_at
from frogkick.tables.layout import LOST_MAX


def run_figure(run: RunLog, title: str) -> Figure:
    """Draw a run by its true poses if it is simulated, else by its fixes. Panels without data are left out.

    Raises:
        InputError: the run has no fixes, or no decisions.
    """
    time_s, poses, by = track_of(run)
    seen = _Seen(time_s, poses, style.TRUE if by == "truth" else style.MEASURED)
    panels: list[Callable[[Axes, RunLog, _Seen], None]] = [_distance] if run.path is not None else []
    panels.append(_actions)
    if run.truth is not None and run.decisions.estimate is not None:
        panels.append(_estimate)
        if run.decisions.predicted is not None:
            panels.append(_prediction)
    if "lost" in run.decisions.extra:
        panels.append(_lost)
    with style.new_figure(11.5, 7.2) as figure:
        figure.suptitle(title, fontweight="bold")
        halves = figure.add_gridspec(1, 2, width_ratios=(1.05, 1.0))
        _track(figure.add_subfigure(halves[0]).subplots(), run, seen)
        every = figure.add_subfigure(halves[1]).subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, draw in zip(every, panels, strict=True):
            draw(axes, run, seen)
        every[-1].set_xlabel("time (s)")
    return figure


class _Seen(NamedTuple):
    """Times (n,) and poses (n, 3) from the first decision on, true or from fixes, and their colour."""

    time_s: Float64
    poses: Float64
    colour: str


def _beside(points: Float64) -> Float64:
    """(n, 2) offsets in points of the screen, to the left of the track, so that letters do not cover it."""
    if len(points) < 2:
        return np.full((len(points), 2), 7.0)
    along = np.gradient(points, axis=0)
    length = np.hypot(along[:, 0], along[:, 1])
    along = np.where(length[:, None] > 0.0, along / np.maximum(length, 1e-9)[:, None], [1.0, 0.0])
    return np.asarray(7.0 * np.column_stack([-along[:, 1], along[:, 0]]))


def _marks(run: RunLog) -> list[str]:
    """A letter or a number for each action, as words at each decision of a track would overlap."""
    if all(len(name) == 1 for name in run.action_names):
        return list(run.action_names)
    return [str(number + 1) for number in range(len(run.action_names))]


def _desired(axes: Axes, run: RunLog) -> None:
    """Draw the desired paths; of one that holds, the approach and the circle unlike a path."""
    holds = [None, *(change.hold for change in run.then)][-len(run.paths) :] if run.paths else []
    drawn: set[str] = set()
    for (_, path), hold in zip(run.paths, holds, strict=True):
        points = 100.0 * path.points_m
        parts = [("desired path", points, style.look(linestyle="--", linewidth=2.5))]
        if hold is not None:
            first = hold[2]
            parts = [("approach of the hold", points[: first + 1], style.look(linestyle=":", linewidth=1.5))]
            parts.append(("circle of the hold", points[first:], style.look(linestyle="-", linewidth=0.8)))
        for label, part, look in parts:
            if len(part) > 1:
                axes.plot(*part.T, color=style.DESIRED, label="_" if label in drawn else label, **look)
                drawn.add(label)


def _walls(axes: Axes, run: RunLog) -> None:
    """Draw the rectangle in which the planner keeps the robot's centre, for a run between walls."""
    known = run.planner
    if not known.get("wall_weight_per_m"):
        return
    low = 100.0 * np.array([known["wall_x_min_m"], known["wall_y_min_m"]])
    wide, tall = 100.0 * np.array([known["wall_x_max_m"], known["wall_y_max_m"]]) - low
    label = "limit of the centre, from the walls"
    axes.add_patch(Rectangle((low[0], low[1]), wide, tall, fill=False, color=style.ALARM, label=label))


def _track(axes: Axes, run: RunLog, seen: _Seen) -> None:
    _desired(axes, run)
    _walls(axes, run)
    usable = run.fixes.usable
    fixes = 100.0 * np.column_stack([run.fixes.x_m, run.fixes.y_m])[usable]
    axes.plot(*fixes.T, ".", color=style.MEASURED, markersize=2.5, label="position fixes")
    if run.truth is not None:
        track = 100.0 * run.truth.pose_world[:, :2]
        axes.plot(*track.T, color=style.TRUE, linewidth=1.5, label="true track")
    ways = (np.interp(run.decisions.time_s, seen.time_s, column) for column in seen.poses[:, :2].T)
    here = 100.0 * np.column_stack(list(ways))
    axes.plot(*here.T, "o", color=seen.colour, markersize=3)
    marks = [_marks(run)[index] if index >= 0 else "?" for index in run.decisions.action]
    for (x, y), mark, offset in zip(here, marks, _beside(here), strict=True):
        look = style.look(textcoords="offset points", ha="center", va="center", fontsize=7, color=seen.colour)
        axes.annotate(mark, (x, y), (offset[0], offset[1]), **look)
    for x_m, y_m in sorted({end_m for _, _, end_m in spans_of(run)}):
        limit = Circle((100.0 * x_m, 100.0 * y_m), 100.0 * HOLD_LIMIT_M, fill=False, color=style.ALARM)
        limit.set(linestyle=":", label=f"within {1e3 * HOLD_LIMIT_M:.0f} mm of the end")
        axes.add_patch(limit)
    if run.path is not None:
        axes.plot(*(100.0 * run.path.points_m[0]), "s", color=style.DESIRED, label="start of the path")
    style.pool_axes(axes)
    axes.set_title("Track over the path, with the actions chosen")
    axes.legend(loc="best")


def _distance(axes: Axes, run: RunLog, seen: _Seen) -> None:
    assert run.path is not None
    distance_mm = 1e3 * distances_m(run.paths, seen.time_s, seen.poses)
    mean_mm = float(distance_mm.mean())
    axes.plot(seen.time_s, distance_mm, color=seen.colour)
    # After the path's end the distance only grows.
    last = run.paths[-1][1]
    before_end = np.flatnonzero(last.nearest_index(seen.poses[:, :2]) < len(last) - 1)
    if before_end.size:
        axes.set_ylim(0.0, 1.15 * max(1.0, mean_mm, float(distance_mm[: before_end[-1] + 2].max())))
    axes.axhline(mean_mm, color=style.DESIRED, linestyle="--")
    axes.set(ylabel="distance (mm)", title=f"Distance to the path, mean {mean_mm:.1f} mm (dashed)")


def _actions(axes: Axes, run: RunLog, seen: _Seen) -> None:
    axes.step(run.decisions.time_s, run.decisions.action, where="post", color=seen.colour, linewidth=0.8)
    axes.plot(run.decisions.time_s, run.decisions.action, "s", color=seen.colour, markersize=4)
    marks = zip(_marks(run), run.action_names, strict=True)
    ticks = [name if mark == name else f"{name} ({mark})" for mark, name in marks]
    axes.set_yticks(range(len(run.action_names)), ticks)
    axes.set(ylabel="action", title="Actions chosen")


def _errors(axes: Axes, time_s: Float64, gap: Float64, colour: str) -> None:
    """Draw errors of poses, (n, 3), over time."""
    position_mm, heading_deg = 1e3 * np.hypot(*gap[:, :2].T), np.rad2deg(np.abs(gap[:, 2]))
    largest = float(np.nanmax([position_mm, heading_deg], initial=1e-3))  # NaN: a decision without a plan
    look = style.look(color=colour, markersize=3, linewidth=0.8)
    axes.plot(time_s, position_mm, "o-", label="position (mm)", **look)
    axes.plot(time_s, heading_deg, "^:", label="heading (deg)", alpha=0.7, **look)
    axes.set(ylabel="error (mm, deg)", ylim=(0.0, 1.35 * largest))
    axes.legend(loc="upper right", ncols=2)


def _estimate(axes: Axes, run: RunLog, seen: _Seen) -> None:
    assert run.decisions.estimate is not None
    time_s = run.decisions.time_s
    truth = true_poses_at(run, time_s)
    gap = run.decisions.estimate[:, :3] - truth[:, :3]
    gap[:, 2] = wrap_angle(gap[:, 2])
    _errors(axes, time_s, gap, style.ESTIMATED)
    axes.set_title("Error of the robot's estimate at each decision")


def _prediction(axes: Axes, run: RunLog, seen: _Seen) -> None:
    time_s, gap_body = residual(run)
    _errors(axes, time_s, gap_body, style.PREDICTED)
    axes.set_title(f"Error one period ahead: {PredictionError.of(gap_body):.1f} RMS")


def _lost(axes: Axes, run: RunLog, seen: _Seen) -> None:
    percent = 100.0 * run.decisions.extra["lost"] / LOST_MAX
    for limb, (name, dash) in enumerate(zip(learned_limbs(run), ("-", "--", "-.", ":") * 2, strict=False)):
        axes.step(run.decisions.time_s, percent[:, limb], where="post", linestyle=dash, label=name)
    axes.set(ylim=(-5.0, 105.0), ylabel="lost (%)", title="Estimated loss of each limb's contribution")
    axes.legend(loc="center right", ncols=2)


COLOURS = (style.TRUE, style.ALARM)
MARKS = ("o", "^")


def compare_figure(runs: tuple[RunLog, RunLog], names: tuple[str, str]) -> Figure:
    """Draw two runs with their names, each from its first decision on.

    Raises:
        InputError: a run has no fixes, or no decisions.
    """
    tracks = [track_of(run) for run in runs]
    with style.new_figure(11.5, 7.2) as figure:
        figure.suptitle(f"{names[0]} and {names[1]}", fontweight="bold")
        halves = figure.add_gridspec(1, 2, width_ratios=(1.05, 1.0))
        _tracks(figure.add_subfigure(halves[0]).subplots(), runs, names, [poses for _, poses, _ in tracks])
        upper, lower = figure.add_subfigure(halves[1]).subplots(2, 1, sharex=True)
        every = sorted({letter for run in runs for letter in (*run.action_names, *run.decided())})
        for run, name, colour, mark, (time_s, poses, _) in zip(
            runs, names, COLOURS, MARKS, tracks, strict=True
        ):
            first_s = run.decisions.time_s[0]
            if run.path is not None:
                distance_mm = 1e3 * distances_m(run.paths, time_s, poses)
                label = f"{name}, mean {distance_mm.mean():.1f} mm"
                upper.plot(time_s - first_s, distance_mm, color=colour, label=label)
            heights = [every.index(letter) for letter in run.decided()]
            # Hollow and larger, so that both can be seen.
            how = {"markersize": 4} if run is runs[0] else {"markersize": 7, "markerfacecolor": "none"}
            lower.plot(run.decisions.time_s - first_s, heights, mark, color=colour, label=name, **how)
        upper.set(ylabel="distance (mm)", title="Distance of each run to its path")
        if upper.lines:
            upper.legend(loc="best")
        lower.set_yticks(range(len(every)), every)
        lower.set(ylabel="action", title="Actions chosen", xlabel="time since the first decision (s)")
        lower.legend(loc="best")
    return figure


def _tracks(axes: Axes, runs: tuple[RunLog, RunLog], names: tuple[str, str], every: list[np.ndarray]) -> None:
    paths = [None if run.path is None else run.path.points_m for run in runs]
    known = [path for path in paths if path is not None]
    same = len(known) == 2 and np.array_equal(known[0], known[1])
    for k, path in enumerate(paths):
        if path is not None and not (k and same):
            label = "desired path" if same or len(known) == 1 else f"desired path of {names[k]}"
            shade = "--" if k == 0 else ":"
            axes.plot(*(100.0 * path).T, color=style.DESIRED, linewidth=2.5, linestyle=shade, label=label)
    for name, colour, mark, poses in zip(names, COLOURS, MARKS, every, strict=True):
        points = 100.0 * poses[:, :2]
        axes.plot(*points.T, color=colour, linewidth=1.5, label=name)
        axes.plot(*points[0], mark, color=colour, markersize=7)
    style.pool_axes(axes)
    axes.set_title("Tracks; marks show their starts")
    axes.legend(loc="best")
