"""Pictures of an identification: predictions, residuals by cause, time and place, and the candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64
from frogkick.core.poses import PredictionError
from frogkick.identification.fit import EFFECT_PENALTY
from frogkick.identification.outcome import Outcome
from frogkick.identification.search import CandidateScore
from frogkick.report import style
from frogkick.report.identify_residuals import Residuals, by_limb

NOMINAL_LABEL, FOUND_LABEL, FLOOR_LABEL = "nominal model", "with identified effects", "noise floor"
BOTH = (("nominal", style.NOMINAL, NOMINAL_LABEL, -0.19), ("found", style.PREDICTED, FOUND_LABEL, 0.19))
TRIED_MOST = 10
AXES = (("forward", "mm", 1e3), ("left", "mm", 1e3), ("heading", "deg", 180.0 / np.pi))


def position_mm(residuals: Float64) -> Float64:
    """(n,) size of the position part of (n, 3) residuals."""
    return np.asarray(1e3 * np.hypot(residuals[:, 0], residuals[:, 1]))


def heading_deg(residuals: Float64) -> Float64:
    """(n,) size of the heading part of (n, 3) residuals."""
    return np.asarray(np.rad2deg(np.abs(residuals[:, 2])))


Size = Callable[[Float64], Float64]


def _sizes(floor: PredictionError) -> tuple[tuple[str, str, Size, float], ...]:
    return (
        ("position", "mm", position_mm, 1e3 * floor.position_rmse_m),
        ("heading", "deg", heading_deg, float(np.rad2deg(floor.heading_rmse_rad))),
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
            tolerance = some is near
            shown = (swim.time_s >= swim.start_s[periods.period[some[0]]] - 0.1) & (
                swim.time_s <= swim.end_s[periods.period[some[-1]]] + 0.1
            )
            axes.plot(
                *(100.0 * swim.pose[shown, :2].T),
                ".-" if tolerance else "-",
                color=style.MEASURED,
                linewidth=1.0,
                markersize=4,
                label="position fixes",
            )
            axes.plot(
                *(100.0 * periods.measured[some, :2].T),
                "o",
                color=style.MEASURED,
                markersize=7 if tolerance else 4,
                label="measured end of a period",
            )
            for which, colour, label, _ in BOTH:
                ends = getattr(periods, which)[some]
                ways = np.stack(
                    [periods.pose[some, :2], ends[:, :2], np.full((len(some), 2), np.nan)], axis=1
                )
                axes.plot(*(100.0 * ways.reshape(-1, 2).T), "--", color=colour, linewidth=1.0)
                axes.plot(
                    *(100.0 * ends[:, :2].T),
                    "x" if which == "nominal" else "+",
                    color=colour,
                    markersize=9 if tolerance else 6,
                    markeredgewidth=1.8,
                    label=f"predicted end, {label}",
                )
            if tolerance:
                for row in some:
                    name = swim.action_names[periods.action[row]] if periods.action[row] >= 0 else "?"
                    middle = 50.0 * (periods.pose[row, :2] + periods.measured[row, :2])
                    axes.annotate(name, middle, fontsize=9, fontweight="bold")
            style.pool_axes(axes)
            first, last = periods.period[some[0]] + 1, periods.period[some[-1]] + 1
            what = "Enlarged, with actions" if tolerance else f"Run {swim.name}"
            axes.set_title(f"{what}: periods {first} to {last}")
        style.legend_below(figure, figure.axes[0])
    return figure


def error_figure(outcome: Outcome) -> Figure:
    """Draw errors before and after, one period and several periods ahead, with the noise floor."""
    tested = outcome.tested
    horizons = outcome.horizons
    with style.new_figure(11.0, 3.6) as figure:
        panels = figure.subplots(1, 4)
        for place, (what, unit, _, level) in enumerate(_sizes(tested.noise_floor)):
            now, ahead = panels[place], panels[place + 2]
            for at, (error, colour) in enumerate(
                ((tested.before, style.NOMINAL), (tested.after, style.PREDICTED))
            ):
                height = _value(error, what)
                now.bar(at, height, 0.7, color=colour)
                now.text(at, height, f"{height:.2f}", ha="center", va="bottom")
            now.axhline(level, color=style.FLOOR, linestyle="--")
            now.text(2.2, level, f"{level:.2f}", ha="right", va="bottom")
            now.set_xlim(-0.6, 2.2)
            now.set_xticks((0, 1), ("before", "after"))
            now.set_ylabel(f"{what} error, RMS ({unit})")
            now.set_title(f"{what.capitalize()}, one period ahead")
            now.margins(y=0.12)
            for name, colour, label, _ in BOTH:
                errors = [each.before if name == "nominal" else each.after for each in horizons]
                ahead.plot(
                    [each.periods for each in horizons],
                    [_value(error, what) for error in errors],
                    "o-",
                    color=colour,
                    label=label,
                )
            ahead.axhline(level, color=style.FLOOR, linestyle="--", label=f"{FLOOR_LABEL}, one period ahead")
            ahead.set_yscale("log")
            ahead.yaxis.set_major_formatter("{x:g}")
            ahead.yaxis.set_minor_formatter(_few)
            ahead.set_xticks([each.periods for each in horizons])
            ahead.set_xlabel("periods ahead")
            ahead.set_ylabel(f"{what} error, RMS ({unit})")
            ahead.set_title(f"{what.capitalize()}, several periods")
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
        begins = np.concatenate([[0.0], np.cumsum(np.array(lengths) + 3.0)])
        at_s = begins[periods.run] + periods.time_s
        for axes, (what, unit, size, level) in zip(panels, _sizes(outcome.tested.noise_floor), strict=True):
            for which, colour, label, _ in BOTH:
                residuals = size(periods.residual_world(which))
                for run in np.unique(periods.run):
                    rows = periods.run == run
                    axes.plot(
                        at_s[rows],
                        residuals[rows],
                        "o-",
                        color=colour,
                        markersize=3,
                        linewidth=0.8,
                        label=label if run == periods.run[0] else None,
                    )
            axes.axhline(level, color=style.FLOOR, linestyle="--", label=f"{FLOOR_LABEL} (RMS)")
            axes.set_ylim(0.0, None)
            axes.set_ylabel(f"{what} error ({unit})")
            axes.set_title(f"{what.capitalize()} error one period ahead, over time")
        for run, swim in enumerate(outcome.test):
            panels[0].annotate(
                swim.name, (begins[run], 1.0), xycoords=("data", "axes fraction"), fontsize=8, va="top"
            )
        panels[-1].set_xlabel("time in the run, one run after the other (s)")
        style.legend_below(figure, panels[0])
    return figure


def cause_figure(outcome: Outcome, periods: Residuals) -> Figure:
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
            ticks = [
                f"{names[each] if each >= 0 else '?'}\n{(periods.action == each).sum()}" for each in labels
            ]
            axes.set_xticks(np.arange(len(labels)), ticks)
            axes.set_xlabel("action and its number of periods")
            axes.set_ylabel(f"{what} error, RMS ({unit})")
            axes.set_title(f"{what.capitalize()} error by action")
        limbs = [limb.name.replace("_", "\n") for limb in outcome.robot.limbs]
        lower = figure.add_subfigure(halves[1]).subplots(1, 3)
        of_limbs = {which: by_limb(periods.residual_body(which), periods.limbs) for which, *_ in BOTH}
        for axes, (axis, (what, unit, scale)) in zip(lower, enumerate(AXES), strict=True):
            for which, colour, _, shift in BOTH:
                each, error = of_limbs[which]
                axes.errorbar(
                    np.arange(len(limbs)) + shift,
                    scale * each[:, axis],
                    2.0 * scale * error[:, axis],
                    fmt="o",
                    color=colour,
                    capsize=3,
                )
            axes.axhline(0.0, color=style.DESIRED, linewidth=0.8)
            axes.set_xticks(np.arange(len(limbs)), limbs)
            axes.set_xlim(-0.6, len(limbs) - 0.4)
            axes.set_xlabel("limb")
            axes.set_ylabel(f"residual per stroke ({unit})")
            axes.set_title(f"By limb: {what}")
        style.legend_below(figure, panels[0])
    return figure


def place_figure(periods: Residuals) -> Figure:
    """Draw the residuals in the pool as arrows, at the same scale for both models."""
    with style.new_figure(11.0, 4.8) as figure:
        residuals = {which: periods.residual_world(which) for which, *_ in BOTH}
        reach = 100.0 * float(np.ptp(periods.pose[:, :2], axis=0).max()) + 1.0
        largest = 0.1 * float(np.percentile(position_mm(residuals["nominal"]), 90))  # cm
        magnified = 0.12 * reach / max(largest, 1e-6)
        factor = 10.0 ** np.floor(np.log10(magnified))
        factor *= 5.0 if magnified > 5.0 * factor else 2.0 if magnified > 2.0 * factor else 1.0
        for axes, (which, colour, label, _) in zip(figure.subplots(1, 2), BOTH, strict=True):
            axes.plot(*(100.0 * periods.measured[:, :2].T), ".", color=style.MEASURED, markersize=4)
            axes.quiver(
                *(100.0 * periods.measured[:, :2].T),
                *(100.0 * factor * residuals[which][:, :2].T),
                angles="xy",
                scale_units="xy",
                scale=1.0,
                width=0.004,
                color=colour,
            )
            style.pool_axes(axes)
            axes.margins(0.15)
            axes.set_title(f"{label.capitalize()}: measured - predicted, magnified {factor:g} times")
    return figure


def tried_figure(iterations: Sequence[Sequence[CandidateScore]]) -> Figure:
    """Draw the gains of the candidates in each iteration; the dashed line is the least accepted gain."""
    iterations = [_best_each(tried) for tried in iterations]
    most = [min(len(tried), TRIED_MOST) for tried in iterations]
    with style.new_figure(11.0, 0.9 + 0.27 * sum(most) + 0.75 * len(most)) as figure:
        panels = figure.subplots(
            len(iterations), 1, squeeze=False, height_ratios=[count + 1 for count in most]
        )
        for index, (axes, tried) in enumerate(zip(panels[:, 0], iterations, strict=True), 1):
            _iteration(axes, tried)
            axes.set_title(f"Iteration {index}")
        panels[-1, 0].set_xlabel("fall of -2 log likelihood on the training runs (1)")
        for axes in panels[:, 0]:
            axes.set_xscale("symlog", linthresh=10.0)
            axes.set_xlim(
                0.0, 3.0 * max([EFFECT_PENALTY, *(each.gain for tried in iterations for each in tried)])
            )
    return figure


def _best_each(tried: Sequence[CandidateScore]) -> list[CandidateScore]:
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


def rest_figure(outcome: Outcome) -> Figure:
    """Draw the share of the residuals that each variable explains."""
    shares = sorted(outcome.diagnostics["shares"].items(), key=lambda row: row[1])
    with style.new_figure(7.5, 0.7 + 0.27 * len(shares)) as figure:
        axes = figure.subplots()
        axes.barh(
            [name for name, _ in shares], [100.0 * share for _, share in shares], 0.7, color=style.PREDICTED
        )
        axes.set_xlim(0.0, 100.0)
        axes.set_xlabel("share of the residuals' sum of squares (%)")
        axes.set_title("Residuals on the training runs, explained by")
        axes.grid(axis="y", visible=False)
    return figure
