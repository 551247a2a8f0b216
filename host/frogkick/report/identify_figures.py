"""Figures of an identification: predictions, residuals, candidates, and unexplained residuals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64, Int64
from frogkick.core.poses import PredictionError
from frogkick.identification.fit import EFFECT_PENALTY
from frogkick.identification.outcome import Outcome
from frogkick.identification.search import CandidateScore
from frogkick.identification.segments import Segments
from frogkick.report import style
from frogkick.report.identify_residuals import Residuals, by_limb
from frogkick.robot import Robot

NOMINAL_LABEL, FOUND_LABEL, FLOOR_LABEL = "nominal model", "with identified effects", "noise floor"
BOTH = (("nominal", style.NOMINAL, NOMINAL_LABEL, -0.19), ("found", style.PREDICTED, FOUND_LABEL, 0.19))
TRIED_MOST = 10
AXES = (("forward", "mm", 1e3), ("left", "mm", 1e3), ("heading", "deg", 180.0 / np.pi))


GAP_S = 3.0
"""Gap between runs that are drawn one after the other."""


def position_mm(residuals: Float64) -> Float64:
    """(n,) size of the position part of (n, 3) residuals."""
    return np.asarray(1e3 * np.hypot(residuals[:, 0], residuals[:, 1]))


def _heading_deg(residuals: Float64) -> Float64:
    return np.asarray(np.rad2deg(np.abs(residuals[:, 2])))


Size = Callable[[Float64], Float64]


def _sizes(floor: PredictionError) -> tuple[tuple[str, str, Size, float], ...]:
    """Position and heading: name, unit, size of residuals (n, 3), and the noise floor."""
    return (
        ("position", "mm", position_mm, _value(floor, "position")),
        ("heading", "deg", _heading_deg, _value(floor, "heading")),
    )


def track_figure(outcome: Outcome, periods: Residuals) -> Figure:
    """Draw the test run with the most periods, and enlarged the periods around its largest error."""
    run = int(np.bincount(periods.run).argmax())
    rows = np.flatnonzero(periods.run == run)
    swim = outcome.test[run]
    worst = rows[np.argmax(position_mm(periods.residual_world("nominal")[rows]))]
    near = rows[np.abs(periods.period[rows] - periods.period[worst]) <= 2]
    with style.new_figure(11.0, 5.0) as figure:
        for axes, some in zip(figure.subplots(1, 2), (rows, near), strict=True):
            _track(axes, swim, periods, some, some is near)
        style.legend_below(figure, figure.axes[0])
    return figure


def _track(axes: Axes, swim: Segments, periods: Residuals, some: Int64, large: bool) -> None:
    first, last = periods.period[some[0]], periods.period[some[-1]]
    shown = (swim.time_s >= swim.start_s[first] - 0.1) & (swim.time_s <= swim.end_s[last] + 0.1)
    fixes, ends = 100.0 * swim.pose[shown, :2], 100.0 * periods.measured[some, :2]
    look = style.look(color=style.MEASURED, markersize=4, linewidth=1.0)
    axes.plot(*fixes.T, ".-" if large else "-", label="position fixes", **look)
    look["markersize"] = 7 if large else 4
    axes.plot(*ends.T, "o", label="measured end of a period", **look)
    for which, colour, label, _ in BOTH:
        predicted = getattr(periods, which)[some, :2]
        ways = np.stack([periods.pose[some, :2], predicted, np.full((len(some), 2), np.nan)], axis=1)
        axes.plot(*(100.0 * ways.reshape(-1, 2).T), "--", color=colour, linewidth=1.0)
        look = style.look(color=colour, markersize=9 if large else 6, markeredgewidth=1.8)
        marker = "x" if which == "nominal" else "+"
        axes.plot(*(100.0 * predicted.T), marker, label=f"predicted end, {label}", **look)
    for row in some if large else ():
        name = swim.action_names[periods.action[row]] if periods.action[row] >= 0 else "?"
        middle = 50.0 * (periods.pose[row, :2] + periods.measured[row, :2])
        axes.annotate(name, (middle[0], middle[1]), fontsize=9, fontweight="bold")
    style.pool_axes(axes)
    what = "Enlarged, with actions" if large else f"Run {swim.name}"
    axes.set_title(f"{what}: periods {first + 1} to {last + 1}")


def error_figure(outcome: Outcome) -> Figure:
    """Draw errors before and after, one period and several periods ahead, with the noise floor."""
    tested = outcome.tested
    horizons = outcome.horizons
    with style.new_figure(11.0, 3.6) as figure:
        panels = figure.subplots(1, 4)
        for place, (what, unit, _, level) in enumerate(_sizes(tested.noise_floor)):
            now, ahead = panels[place], panels[place + 2]
            label, title = f"{what} error, RMS ({unit})", what.capitalize()
            for at, (error, (_, colour, *_)) in enumerate(
                zip((tested.before, tested.after), BOTH, strict=True)
            ):
                height = _value(error, what)
                now.bar(at, height, 0.7, color=colour)
                now.text(at, height, f"{height:.2f}", ha="center", va="bottom")
            now.axhline(level, color=style.FLOOR, linestyle="--")
            now.text(2.2, level, f"{level:.2f}", ha="right", va="bottom")
            now.set_xticks((0, 1), ("before", "after"))
            now.set(xlim=(-0.6, 2.2), ylabel=label, title=f"{title}, one period ahead")
            now.margins(y=0.12)
            counts = [each.periods for each in horizons]
            for name, colour, model, _ in BOTH:
                errors = [each.before if name == "nominal" else each.after for each in horizons]
                heights = [_value(error, what) for error in errors]
                ahead.plot(counts, heights, "o-", color=colour, label=model)
            ahead.axhline(level, color=style.FLOOR, linestyle="--", label=f"{FLOOR_LABEL}, one period ahead")
            ahead.set_yscale("log")
            ahead.yaxis.set_major_formatter("{x:g}")
            ahead.yaxis.set_minor_formatter(_few)
            ahead.set_xticks(counts)
            ahead.set(xlabel="periods ahead", ylabel=label, title=f"{title}, several periods")
        style.legend_below(figure, panels[2])
    return figure


def _value(error: PredictionError, what: str) -> float:
    return 1e3 * error.position_rmse_m if what == "position" else float(np.rad2deg(error.heading_rmse_rad))


def _few(value: float, _place: int | None = None) -> str:
    """Labels of a logarithmic axis between its decades: 2 and 5."""
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""


def time_figure(outcome: Outcome, periods: Residuals) -> Figure:
    """Draw the residual of each period of the test runs over time."""
    with style.new_figure(11.0, 4.8) as figure:
        panels = figure.subplots(2, 1, sharex=True)
        lengths = [swim.end_s[-1] - swim.start_s[0] for swim in outcome.test]
        begins = np.concatenate([[0.0], np.cumsum(np.array(lengths) + GAP_S)])
        at_s = begins[periods.run] + periods.time_s
        for axes, (what, unit, size, level) in zip(panels, _sizes(outcome.tested.noise_floor), strict=True):
            for which, colour, label, _ in BOTH:
                residuals = size(periods.residual_world(which))
                for run in np.unique(periods.run):
                    rows = periods.run == run
                    named = label if run == periods.run[0] else None
                    look = style.look(color=colour, markersize=3, linewidth=0.8)
                    axes.plot(at_s[rows], residuals[rows], "o-", label=named, **look)
            axes.axhline(level, color=style.FLOOR, linestyle="--", label=f"{FLOOR_LABEL} (RMS)")
            title = f"{what.capitalize()} error one period ahead, over time"
            axes.set(ylim=(0.0, None), ylabel=f"{what} error ({unit})", title=title)
        for begin_s, swim in zip(begins, outcome.test, strict=False):
            above = ("data", "axes fraction")
            panels[0].annotate(swim.name, (begin_s, 1.0), xycoords=above, fontsize=8, va="top")
        panels[-1].set_xlabel("time in the run, one run after the other (s)")
        style.legend_below(figure, panels[0])
    return figure


def by_action_figure(outcome: Outcome, periods: Residuals) -> Figure:
    """Draw the size of the residuals by action, and below the residual of each limb's strokes."""
    names = outcome.test[0].action_names
    labels = np.unique(periods.action)
    with style.new_figure(11.0, 6.2) as figure:
        halves = figure.add_gridspec(2, 1)
        panels = figure.add_subfigure(halves[0]).subplots(1, 2)
        for axes, (what, unit, size, level) in zip(panels, _sizes(outcome.tested.noise_floor), strict=True):
            for which, colour, label, shift in BOTH:
                residuals = size(periods.residual_world(which))
                heights = [np.sqrt((residuals[periods.action == each] ** 2).mean()) for each in labels]
                axes.bar(np.arange(len(labels)) + shift, heights, 0.36, color=colour, label=label)
            axes.axhline(level, color=style.FLOOR, linestyle="--", label=FLOOR_LABEL)
            called = {each: names[each] if each >= 0 else "?" for each in labels}
            ticks = [f"{called[each]}\n{(periods.action == each).sum()}" for each in labels]
            axes.set_xticks(np.arange(len(labels)), ticks)
            axes.set(xlabel="action and its number of periods", ylabel=f"{what} error, RMS ({unit})")
            axes.set_title(f"{what.capitalize()} error by action")
        of_limbs = [
            (shift, colour, None, *by_limb(periods.residual_body(which), periods.limbs))
            for which, colour, _, shift in BOTH
        ]
        for axis, axes in enumerate(figure.add_subfigure(halves[1]).subplots(1, 3)):
            limb_panel(axes, outcome.robot, axis, of_limbs, "By limb")
            axes.set_xlim(-0.6, len(outcome.robot.limbs) - 0.4)
        style.legend_below(figure, panels[0])
    return figure


def limb_panel(
    axes: Axes,
    robot: Robot,
    axis: int,
    rows: Iterable[tuple[float, str, str | None, Float64, Float64]],
    title: str,
) -> None:
    """Draw the residual of each limb's strokes along one of AXES; bars are two standard errors.

    ``rows`` are shift, colour, label, and the results of ``by_limb``.
    """
    what, unit, scale = AXES[axis]
    places = np.arange(len(robot.limbs))
    for shift, colour, label, each, error in rows:
        values, bars = scale * each[:, axis], 2.0 * scale * error[:, axis]
        axes.errorbar(places + shift, values, bars, fmt="o", color=colour, capsize=3, label=label)
    axes.axhline(0.0, color=style.DESIRED, linewidth=0.8)
    axes.set_xticks(places, [limb.name.replace("_", "\n") for limb in robot.limbs])
    axes.set(xlabel="limb", ylabel=f"residual per stroke ({unit})", title=f"{title}: {what}")


def place_figure(periods: Residuals) -> Figure:
    """Draw the residuals in the pool as arrows, at the same scale for both models."""
    with style.new_figure(11.0, 4.8) as figure:
        residuals = {which: periods.residual_world(which) for which, *_ in BOTH}
        reach = 100.0 * float(np.ptp(periods.pose[:, :2], axis=0).max()) + 1.0
        largest = 0.1 * float(np.percentile(position_mm(residuals["nominal"]), 90))  # cm
        factor = style.round_factor(0.12 * reach / max(largest, 1e-6))
        places = 100.0 * periods.measured[:, :2].T
        for axes, (which, colour, label, _) in zip(figure.subplots(1, 2), BOTH, strict=True):
            axes.plot(*places, ".", color=style.MEASURED, markersize=4)
            arrows = 100.0 * factor * residuals[which][:, :2].T
            axes.quiver(*places, *arrows, width=0.004, color=colour, **style.TO_SCALE)
            style.pool_axes(axes)
            axes.margins(0.15)
            axes.set_title(f"{label.capitalize()}: measured - predicted, magnified {factor:g} times")
    return figure


def candidates_figure(iterations: Sequence[Sequence[CandidateScore]]) -> Figure:
    """Draw the gains of the candidates in each iteration; the dashed line is the smallest accepted gain."""
    iterations = [ranked(tried) for tried in iterations]
    rows = [min(len(tried), TRIED_MOST) for tried in iterations]
    most = max([EFFECT_PENALTY, *(each.gain for tried in iterations for each in tried)])
    with style.new_figure(11.0, 0.9 + 0.27 * sum(rows) + 0.75 * len(rows)) as figure:
        ratios = [count + 1 for count in rows]
        panels = figure.subplots(len(rows), 1, squeeze=False, height_ratios=ratios)[:, 0]
        for index, (axes, tried) in enumerate(zip(panels, iterations, strict=True), 1):
            _iteration(axes, tried)
            axes.set_title(f"Iteration {index}")
        panels[-1].set_xlabel("gain: fall of -2 log likelihood, training runs (1)")
        for axes in panels:
            axes.set_xscale("symlog", linthresh=10.0)
            axes.set_xlim(0.0, 3.0 * most)
    return figure


def ranked(tried: Sequence[CandidateScore]) -> list[CandidateScore]:
    """Return the best start of each effect, the simulated ones first."""
    best: dict[str, CandidateScore] = {}
    for each in sorted(tried, key=lambda each: (not each.chosen, not each.refined, -each.gain)):
        best.setdefault(each.title, each)
    return list(best.values())


def _iteration(axes: Axes, tried: Sequence[CandidateScore]) -> None:
    shown = list(tried)[:TRIED_MOST][::-1]
    for place, each in enumerate(shown):
        colour = style.PREDICTED if each.chosen else style.DESIRED
        axes.barh(place, max(each.gain, 0.0), 0.7, color=colour, alpha=1.0 if each.refined else 0.4)
        fixed = f"held out {each.held_out:+.2f} per period" if each.refined else "by derivatives only"
        axes.text(max(each.gain, 0.0), place, f" {fixed}{', accepted' if each.chosen else ''}", va="center")
    axes.axvline(EFFECT_PENALTY, color=style.FLOOR, linestyle="--")
    axes.set_yticks(range(len(shown)), [each.title for each in shown])
    axes.grid(axis="y", visible=False)


def unexplained_figure(outcome: Outcome) -> Figure:
    """Draw the share of the residuals that each variable explains."""
    shares = dict(sorted(outcome.diagnostics["shares"].items(), key=lambda row: row[1]))
    with style.new_figure(7.5, 0.7 + 0.27 * len(shares)) as figure:
        axes = figure.subplots()
        percent = [100.0 * share for share in shares.values()]
        axes.barh(list(shares), percent, 0.7, color=style.PREDICTED)
        axes.set(xlim=(0.0, 100.0), xlabel="share of the residuals' sum of squares (%)")
        axes.set_title("Residuals on the training runs, explained by")
        axes.grid(axis="y", visible=False)
    return figure


def missing_terms_figure(outcome: Outcome) -> Figure | None:
    """Draw what the model with the identified effects leaves unexplained, over the time of the training runs.

    These are a wrench, failed strokes, and errors of fixes. None if laws were not searched for."""
    missing = outcome.residuals
    if missing is None or missing["wrench"] is None:
        return None
    begins, at_s = {}, 0.0
    for swim in outcome.train:
        begins[swim.name] = at_s - float(swim.start_s[0])
        at_s += float(swim.end_s[-1] - swim.start_s[0]) + GAP_S

    def times(runs: Iterable[str], time_s: Iterable[float]) -> list[float]:
        return [begins[run] + time for run, time in zip(runs, time_s, strict=True)]

    wrench, strokes, fixes = missing["wrench"], missing["strokes"], missing["fixes"]
    spread = np.sqrt(np.array(wrench["covariance"])[:, [0, 4, 8]])
    middle = np.array(times(wrench["run"], wrench["time_s"]))
    runs = np.array(wrench["run"])
    with style.new_figure(11.0, 8.4) as figure:
        force, torque, fired, seen = figure.subplots(4, 1, sharex=True)
        rows = (
            (force, "forward_n", 1e3, style.TRUE, "forward"),
            (force, "left_n", 1e3, style.MEASURED, "left"),
            (torque, "torque_nm", 1e6, style.TRUE, "torque"),
        )
        for k, (axes, key, unit, colour, label) in enumerate(rows):
            values = unit * np.array(wrench[key])
            for name in dict.fromkeys(wrench["run"]):
                mine = runs == name
                band, shown = 2.0 * unit * spread[mine, k], values[mine]
                legend = label if name == wrench["run"][0] else None
                axes.plot(middle[mine], shown, color=colour, linewidth=1.0, label=legend)
                faint = style.look(color=colour, alpha=0.25, linewidth=0)
                axes.fill_between(middle[mine], shown - band, shown + band, **faint)
        force.set_ylabel("missing force (mN)")
        torque.set_ylabel("missing torque (µN m)")
        for limb in outcome.robot.limbs:
            own = [each for each in strokes if each["limb"] == limb.name]
            at = times((each["run"] for each in own), (each["time_s"] for each in own))
            fired.plot(at, [each["log_ratio"] for each in own], ".", markersize=4, label=limb.name)
        fired.axhline(0.0, color=style.FLOOR, linewidth=0.8)
        fired.set_ylabel("fired to not fired\n(log likelihood ratio)")
        at = times(fixes["run"], fixes["time_s"])
        for key, colour in (("x", style.TRUE), ("y", style.MEASURED), ("heading", style.ESTIMATED)):
            seen.plot(at, fixes[key], ".", markersize=2, color=colour, label=key)
        seen.set(ylabel="innovation (std. dev.)", xlabel="time in the training runs, one after the other (s)")
        for axes in (force, fired, seen):
            axes.legend(loc="upper right", fontsize=7, ncols=4)
    return figure
