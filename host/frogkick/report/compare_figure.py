"""The picture of two runs side by side: both tracks, distances over time, both rows of actions."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick.runs.runlog import RunLog
from frogkick.runs.summary import track_of

COLOURS = (style.TRUE, style.ALARM)
MARKS = ("o", "^")


def compare_figure(runs: tuple[RunLog, RunLog], names: tuple[str, str]) -> Figure:
    """Draw two runs, each from its first decision on.

    Args:
        runs: runs with decisions and poses.
        names: name of each run for the legend.

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
                distance_mm = 1e3 * run.path.distance_m(poses[:, :2])
                label = f"{name}, mean {distance_mm.mean():.1f} mm"
                upper.plot(time_s - first_s, distance_mm, color=colour, label=label)
            heights = [every.index(letter) for letter in run.decided()]
            # Hollow and larger, so that one shows around the other.
            how = {"markersize": 4} if run is runs[0] else {"markersize": 7, "markerfacecolor": "none"}
            lower.plot(run.decisions.time_s - first_s, heights, mark, color=colour, label=name, **how)
        upper.set_ylabel("distance (mm)")
        upper.set_title("Distance, each to its own path")
        if upper.lines:
            upper.legend(loc="best")
        lower.set_yticks(range(len(every)), every)
        lower.set_ylabel("action")
        lower.set_title("Actions chosen")
        lower.set_xlabel("time since the first decision (s)")
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
