"""Estimators with bad fixes: the robot's and two simple ones compared by error and by closed-loop
distance."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from frogkick.core.progress import shown
from frogkick.front.places import plan_config, swim_path
from frogkick.front.tables import robot_of_table, table_image
from frogkick.report import style
from frogkick.runs.closed_loop import require_time
from frogkick_studies import StudyResult
from frogkick_studies.bad_fixes import METHODS, RATES_HZ, Condition, Outcome, compare_estimators
from frogkick_studies.configs import Estimator

_COLOUR = {"difference": style.MEASURED, "line": style.PREDICTED, "track": style.ESTIMATED}
_MARKER = {"difference": "o", "line": "^", "track": "s"}
_LABEL = {
    "difference": "difference of two fixes (the paper's)",
    "line": "line through the last fixes",
    "track": "the robot's own",
}
_FAULT = {
    "late": "0.3 s\nlate",
    "jitter": "0-0.3 s\nlater",
    "lost": "20 %\nlost",
    "doubled": "20 %\ntwice",
    "held": "20 %\nout of\norder",
    "outliers": "5 %\nwrong",
    "world": "other\nworld",
}
_QUANTITIES = (
    ("position_m", 1e3, "Position at decision time", "RMS error (mm)"),
    ("heading_rad", 180.0 / np.pi, "Heading at decision time", "RMS error (degrees)"),
    ("velocity_mps", 1e3, "Velocity at decision time", "RMS error (mm/s)"),
)
_STYLES: tuple[tuple[str, Literal["-", "--"], str], ...] = (
    ("none", "-", "as the recorded runs' camera"),
    ("all", "--", "all faults together"),
)


@dataclass(frozen=True, eq=False)
class EstimatorStudy(StudyResult):
    """States estimated from late, lost, duplicate and wrong fixes by several methods.

    Attributes:
        outcomes: condition of the camera -> method -> errors of its states.
    """

    outcomes: Mapping[Condition, Mapping[str, Outcome]]
    seeds: int

    def plot(self) -> Figure:
        """Draw three errors by rate, one by fault, and the distance to each path."""
        names = next(iter(self.outcomes.values()))["track"].distance_m
        with style.new_figure(12.5, 7.6) as figure:
            panels = figure.subplots(2, 3)
            for axes, (name, factor, title, label) in zip(panels[0], _QUANTITIES, strict=True):
                for fault, line, _ in _STYLES:
                    _by_rate(axes, self.outcomes, fault, line, lambda o, n=name, f=factor: getattr(o, n) * f)
                _finish(axes, label)
                axes.set_yscale("log")
                style.plain_decades(axes.yaxis)
                axes.set_title(title)
            _by_fault(panels[1, 0], self.outcomes)
            for axes, path in zip(panels[1, 1:], names, strict=False):
                for fault, line, _ in _STYLES:
                    _by_rate(axes, self.outcomes, fault, line, lambda o, p=path: o.distance_m[p] * 1e3)
                _finish(axes, "mean distance to the path (mm)")
                axes.set_ylim(bottom=0.0)
                axes.set_title(f"Closed loop: {path}")
            for axes in panels[1, 1 + len(names) :]:
                axes.set_axis_off()
            handles, labels = panels[0, 0].get_legend_handles_labels()
            for _, line, label in _STYLES:
                handles.append(Line2D([], [], color="0.3", linestyle=line))
                labels.append(label)
            figure.legend(handles, labels, loc="outside lower center", ncols=5)
        return figure

    def as_json(self) -> dict[str, Any]:
        rows = [
            {
                "rate_hz": condition.rate_hz,
                "fault": condition.fault,
                "method": method,
                **dataclasses.asdict(one),
            }
            for condition, methods in self.outcomes.items()
            for method, one in methods.items()
        ]
        return {"outcomes": rows, "seeds": self.seeds}

    def text(self, values: dict[str, Any]) -> str:
        lines = ["fixes/s fault    method        mm  degrees     mm/s  unknown  mm from each path"]
        for condition, methods in self.outcomes.items():
            for method, one in methods.items():
                numbers = (one.position_m * 1e3, math.degrees(one.heading_rad), one.velocity_mps * 1e3)
                away = " ".join(f"{name} {1e3 * far:.1f}" for name, far in one.distance_m.items())
                lines.append(
                    f"{condition.rate_hz:7g} {condition.fault:8} {method:10}"
                    + "".join(f"{number:9.2f}" for number in numbers)
                    + f"{one.unknown:5d}/{one.decisions}  {away}"
                )
        return "\n".join(lines)


def run(config: Estimator) -> EstimatorStudy:
    require_time(config.simulated_time)
    image = table_image(config.tables, config.model)
    robot = robot_of_table(image, config.model)
    paths = [swim_path(name) for name in config.path or ("line", "ellipse")]
    settings = plan_config(robot, config.planner, config.depth)
    with shown(True, "runs") as tell:
        outcomes = compare_estimators(
            robot, image.read_bytes(), paths, settings, config.seeds, config.simulated_time,
            config.rate or RATES_HZ, config.processes, tell,
        )  # fmt: skip
    return EstimatorStudy(outcomes, config.seeds)


def _by_rate(
    axes: Axes,
    outcomes: Mapping[Condition, Mapping[str, Outcome]],
    fault: str,
    line: str,
    value: Callable[..., float],  # of an outcome
) -> None:
    rows = sorted(((c.rate_hz, o) for c, o in outcomes.items() if c.fault == fault), key=lambda row: row[0])
    for method in METHODS:
        axes.plot(
            [rate for rate, _ in rows],
            [value(outcome[method]) for _, outcome in rows],
            _MARKER[method] + line,
            color=_COLOUR[method],
            markersize=4,
            label=_LABEL[method] if line == "-" else None,
        )


def _finish(axes: Axes, label: str) -> None:
    axes.set_xscale("log")
    rates = sorted({float(x) for line in axes.get_lines() for x in np.asarray(line.get_xdata())})
    axes.set_xticks(rates, [f"{rate:g}" for rate in rates])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlabel("fixes per second")
    axes.set_ylabel(label)


def _by_fault(axes: Axes, outcomes: Mapping[Condition, Mapping[str, Outcome]]) -> None:
    alone = {c.fault: (c.rate_hz, o) for c, o in outcomes.items() if c.fault in _FAULT}
    shown = [fault for fault in _FAULT if fault in alone]
    for offset, method in zip((-0.2, 0.0, 0.2), METHODS, strict=True):
        heights = [alone[fault][1][method].position_m * 1e3 for fault in shown]
        axes.bar(np.arange(len(shown)) + offset, heights, 0.19, color=_COLOUR[method])
    axes.set_yscale("log")
    style.plain_decades(axes.yaxis)
    axes.set_xticks(range(len(shown)), [_FAULT[fault] for fault in shown], fontsize=7)
    axes.grid(axis="x", visible=False)
    axes.set_ylabel("position error (mm)")
    rate = next(iter(alone.values()))[0] if alone else 0.0
    axes.set_title(f"One fault at a time, {rate:g} fixes per second")
