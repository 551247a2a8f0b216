"""Planners compared in the simulated pool, over paths, seeds and worlds with effects that no model
contains."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isnan, nan
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.files import existing_file, write_bytes
from frogkick.core.progress import shown
from frogkick.effects import changed_robot, read_world
from frogkick.library import quantise
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.report.style import ALARM, ESTIMATED, MEASURED, PREDICTED, TRUE, styled
from frogkick.robot import Robot, load_robot
from frogkick_codegen.firmware import require_tools
from frogkick_studies import StudyResult
from frogkick_studies.configs import Loop
from frogkick_studies.in_pool import (
    PAPER,
    PAPER_STATES,
    ROBOT,
    Case,
    Outcome,
    Planner,
    Setting,
    Summary,
    fit_own_table,
    library_of,
    run_cases,
    setting_from,
    shape_names,
    summaries,
)

RATIO_MOST = 0.5
"""Largest mean distance of the robot's planner, as a share of the paper's planner's."""
_HIDDEN = (
    {"name": "limb_wear", "limb": "front_left", "gain": 0.85},
    {"name": "limb_memory", "loss": 0.2, "fade_s": 1.5},
    {"name": "warm_up", "loss": 0.3, "fade_strokes": 2.0},
    {"name": "steady_current", "x_mps": 0.002, "y_mps": 0.003},
)
NOMINAL = setting_from("nominal", ())
HIDDEN = setting_from("hidden", _HIDDEN)
"""Effects that are in no table, of a size that recorded runs show."""
_COLOURS = (MEASURED, ALARM, PREDICTED, ESTIMATED, TRUE)
_SWUM_MMPS = 50  # upper limit of the robot's speed, mm/s
_PROGRESS_TICKS_MMPS = (0, 10, 20, 30, 40, 50, 500)
_DISTANCE_TICKS_MM = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)


def planners_of(robot: Robot, learn: bool = False) -> tuple[Planner, ...]:
    """Return the paper's planner; its cost at depth 3 on the robot's table; the robot's at depth 1 to 3.

    With ``learn`` also the robot's on the host, with an estimate of the limbs' wear.
    """
    own = config_of(robot.planner)
    return (
        Planner("paper", PAPER, PlanConfig()),
        Planner("paper, depth 3", ROBOT, PlanConfig(depth=3)),
        *(
            Planner(f"robot, depth {depth}", ROBOT, dataclasses.replace(own, depth=depth), own=True)
            for depth in sorted({1, 2, 3, own.depth})
        ),
        *([Planner("robot, learning", ROBOT, own, learn=True)] if learn else ()),
    )


def setting_of(word: str, robot: Robot) -> Setting:
    """Return a world by name ("nominal", "hidden"), or from a TOML file, whose name becomes the world's."""
    for known in (NOMINAL, HIDDEN):
        if word == known.name:
            return known
    file = existing_file(word, "world file")
    changed_robot(robot, read_world(file).effects)
    tables = tomllib.loads(file.read_text(encoding="utf-8")).get("effect", ())
    return setting_from(file.stem, tables, file.parent)


def settings_of(words: Sequence[str], robot: Robot) -> tuple[Setting, ...]:
    """Return several worlds; see ``setting_of``."""
    settings = tuple(setting_of(word, robot) for word in words)
    names = [setting.name for setting in settings]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"two worlds are named {twice[0]!r}: give each once, and files other names")
    return settings


@dataclass(frozen=True)
class Verdict:
    """The comparison in one world, each path with equal weight.

    Attributes:
        mean_distance_m, progress_mps: of each planner, over the paths.
        ratio_to_paper: of each planner's distance.
        missed: requirements that are not met, as text.
    """

    world: str
    mean_distance_m: dict[str, float]
    progress_mps: dict[str, float]
    ratio_to_paper: dict[str, float]
    missed: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether all requirements are met."""
        return not self.missed


def judge(rows: Sequence[Summary], world: str, planners: Sequence[Planner], depth: int) -> Verdict:
    """Judge the robot's planner in a world, over all paths of the rows.

    The requirements: the robot's own cost at its own depth has at most RATIO_MOST of the paper's planner's
    mean distance at no less progress; and the better one of depth 2 and 3 has no larger distance than depth
    1.

    Args:
        rows: result of ``summaries``; the first planner is the paper's.
        depth: the robot's own depth.
    """
    distance_m, progress_mps = {}, {}
    for planner in planners:
        own = [row for row in rows if (row.world, row.planner) == (world, planner.name)]
        distance_m[planner.name] = float(np.mean([row.mean_distance_m for row in own]))
        progress_mps[planner.name] = float(np.mean([row.progress_mps for row in own]))
    paper = planners[0].name
    robot = {planner.config.depth: planner.name for planner in planners if planner.own}
    shipped = robot[depth]
    missed = []
    # Compared without a division, because the paper's distance may be 0.
    if not distance_m[shipped] <= RATIO_MOST * distance_m[paper]:
        missed.append(f"the distance of {shipped} is more than {RATIO_MOST:g} of the paper's")
    if not progress_mps[shipped] >= progress_mps[paper]:
        missed.append(f"{shipped} makes less progress than the paper's planner")
    if not min(distance_m[robot[2]], distance_m[robot[3]]) <= distance_m[robot[1]]:
        missed.append("the distances at depth 2 and depth 3 are both larger than at depth 1")
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = {name: float(np.divide(value, distance_m[paper])) for name, value in distance_m.items()}
    return Verdict(world, distance_m, progress_mps, ratios, tuple(missed))


@dataclass(frozen=True, eq=False)
class PlannersCompared(StudyResult):
    """The paper's planner and the robot's on the same paths, in the same worlds.

    Attributes:
        rows: means over the seeds, for each planner along each path in each world.
        verdicts: for each world whether the requirements are met.
    """

    outcomes: Mapping[Case, Outcome]
    rows: Sequence[Summary]
    verdicts: Sequence[Verdict]
    planners: Sequence[str]
    seeds: int
    table_bytes: Mapping[str, int]

    @property
    def passed(self) -> bool:
        """Whether all requirements are met in each world."""
        return all(verdict.passed for verdict in self.verdicts)

    def plot(self) -> Figure:
        worlds = [verdict.world for verdict in self.verdicts]
        paths = list(dict.fromkeys(row.path for row in self.rows))
        return loop_figure(self.outcomes, worlds, paths, list(self.planners))

    def as_json(self) -> dict[str, Any]:
        return {
            "rows": [dataclasses.asdict(row) for row in self.rows],
            "over_paths": {
                verdict.world: {**dataclasses.asdict(verdict), "passed": verdict.passed}
                for verdict in self.verdicts
            },
            "seeds": self.seeds,
            "table_bytes": dict(self.table_bytes),
        }

    def text(self, values: dict[str, Any]) -> str:
        lines = table_of_rows(self.rows)
        wide = max(len(row.planner) for row in self.rows)
        for verdict in self.verdicts:
            lines.append(f"{verdict.world}, over all paths:")
            lines += [
                f"  {name:{wide}s}  {1e3 * distance_m:6.2f} mm ({verdict.ratio_to_paper[name]:.2f} of the "
                f"paper's), {1e3 * verdict.progress_mps[name]:5.1f} mm/s"
                for name, distance_m in verdict.mean_distance_m.items()
            ]
            lines += [f"  requirement not met: {text}" for text in verdict.missed] or [
                "  all requirements are met"
            ]
        return "\n".join(lines)


def run(config: Loop) -> PlannersCompared:
    """Compare the paper's planner with the robot's at depth 1 to 3: distance to the path and progress."""
    robot = load_robot(config.robot)
    settings = settings_of(list(config.world or (NOMINAL.name, HIDDEN.name)), robot)
    names = shape_names(config.path)
    require_tools("native")
    out, processes = config.out, config.processes
    images = {PAPER: out / "paper.fkt", ROBOT: config.tables or out / "robot.fkt"}
    read = library_of(robot, config.library, out / "library.h5", processes, PAPER_STATES, "box")
    write_bytes(images[PAPER], quantise(read))
    if config.tables is None:
        fit_own_table(read, images[ROBOT])
    planners = planners_of(robot, config.learn)
    cases = [
        Case(setting.name, name, planner.name, seed)
        for setting in settings
        for name in names
        for planner in planners
        for seed in range(config.seeds)
    ]
    with shown(True, "runs") as tell:
        outcomes = run_cases(robot, images, planners, settings, cases, out, processes, tell)
    rows = summaries(outcomes)
    return PlannersCompared(
        outcomes,
        rows,
        [judge(rows, each.name, planners, robot.planner.depth) for each in settings],
        [planner.name for planner in planners],
        config.seeds,
        {name: image.stat().st_size for name, image in images.items()},
    )


def table_of_rows(rows: Sequence[Summary]) -> list[str]:
    """Return a line of text for each row."""
    wide = [max(len(getattr(row, name)) for row in rows) for name in ("world", "path", "planner")]
    return [
        f"{row.world:{wide[0]}s}  {row.path:{wide[1]}s}  {row.planner:{wide[2]}s}  "
        f"{1e3 * row.mean_distance_m:6.2f} +- {1e3 * row.deviation_m:5.2f} mm, "
        f"{1e3 * row.progress_mps:5.1f} mm/s, {100 * row.completed:3.0f} % completed"
        for row in rows
    ]


def loop_figure(
    outcomes: Mapping[Case, Outcome],
    worlds: Sequence[str],
    paths: Sequence[str],
    planners: Sequence[str],
    recorded: Mapping[str, tuple[float, float]] | None = None,
) -> Figure:
    """Draw a column for each world: a point for each run, a bar for the middle half of the seeds, their
    median.

    Args:
        worlds, paths, planners: names in the order of drawing; the first planner is the paper's, and half of
            its mean distance is drawn beside the others' if nothing is recorded.
        recorded: path -> mean distance (m) and progress (m/s) of a recorded run, drawn across.
    """
    with styled():
        wide = max(5.2, 1.2 * len(paths))
        figure = Figure(figsize=(1.6 + wide * len(worlds), 7.0), layout="constrained")
        axes = figure.subplots(2, len(worlds), squeeze=False, sharey="row", sharex=True)
        for column, world in enumerate(worlds):
            _draw(axes[0, column], outcomes, "mean_distance_m", (world, paths, planners))
            _draw(axes[1, column], outcomes, "progress_mps", (world, paths, planners))
            if recorded is None:
                _draw_half(axes[0, column], outcomes, (world, paths, planners))
            else:
                _draw_across(axes[0, column], [recorded.get(path, (nan, nan))[0] for path in paths])
                _draw_across(axes[1, column], [recorded.get(path, (nan, nan))[1] for path in paths])
            axes[0, column].set_title(f"world: {world}")
            axes[1, column].set_xticks(range(len(paths)), paths)
            axes[1, column].set_xlim(-0.5, len(paths) - 0.5)
            for edge in range(1, len(paths)):
                for row in (0, 1):
                    axes[row, column].axvline(edge - 0.5, color="black", alpha=0.15, linewidth=0.8)
        for row in (0, 1):
            for one in axes[row]:
                one.grid(axis="x", visible=False)
        axes[0, 0].set_ylabel("mean distance to the path (mm)")
        axes[1, 0].set_ylabel("progress along the path (mm/s)")
        drawn = list((recorded or {}).values())
        drawn += [(outcome.mean_distance_m, outcome.progress_mps) for outcome in outcomes.values()]
        farthest_mm, fastest_mmps = (1e3 * max(one[which] for one in drawn) for which in (0, 1))
        slowest_mmps = min(1e3 * outcome.progress_mps for outcome in outcomes.values())
        axes[0, 0].set_yscale("symlog", linthresh=1.0, linscale=0.4)
        axes[0, 0].set_yticks(_DISTANCE_TICKS_MM, [str(tick) for tick in _DISTANCE_TICKS_MM])
        axes[0, 0].set_ylim(-0.1, 1.4 * max(farthest_mm, 1.0))
        axes[0, 0].minorticks_off()
        if fastest_mmps > _SWUM_MMPS:  # a run that took the end of the path for its start
            axes[1, 0].set_yscale("symlog", linthresh=_SWUM_MMPS, linscale=4.0)
            axes[1, 0].set_yticks(_PROGRESS_TICKS_MMPS, [str(tick) for tick in _PROGRESS_TICKS_MMPS])
            axes[1, 0].minorticks_off()
        axes[1, 0].set_ylim(min(0.0, 1.08 * slowest_mmps), max(1.08 * fastest_mmps, 1.0))
        handles: list[Any] = [
            axes[0, 0].plot([], [], "s", color=_COLOURS[index % len(_COLOURS)], label=planner)[0]
            for index, planner in enumerate(planners)
        ]
        dashed = f"half of {planners[0]}'s" if recorded is None else "recorded run"
        if recorded != {}:
            handles += axes[0, 0].plot([], [], "--", color="black", linewidth=1, label=dashed)
        figure.legend(handles=handles, loc="outside upper center", ncols=min(3, len(handles)))
    return figure


def _values(outcomes: Mapping[Case, Outcome], name: str, world: str, path: str, planner: str) -> Float64:
    """Return the values of each seed, in mm or mm/s."""
    return np.array(
        [
            1e3 * getattr(outcome, name)
            for case, outcome in outcomes.items()
            if (case.world, case.path, case.planner) == (world, path, planner)
        ]
    )


def _draw_half(
    axes: Any, outcomes: Mapping[Case, Outcome], which: tuple[str, Sequence[str], Sequence[str]]
) -> None:
    world, paths, planners = which
    values = [_values(outcomes, "mean_distance_m", world, path, planners[0]) for path in paths]
    _draw_across(axes, [0.5e-3 * one.mean() if one.size else nan for one in values])


def _draw_across(axes: Any, values: Sequence[float]) -> None:
    """Draw a dashed line for each path at a value in SI units; NaN: none."""
    for place, value in enumerate(values):
        if not isnan(value):
            axes.plot([place - 0.45, place + 0.45], [1e3 * value] * 2, "--", color="black", linewidth=1)


def _draw(
    axes: Any,
    outcomes: Mapping[Case, Outcome],
    name: str,
    which: tuple[str, Sequence[str], Sequence[str]],
) -> None:
    world, paths, planners = which
    width = 0.8 / len(planners)
    for place, path in enumerate(paths):
        for index, planner in enumerate(planners):
            values = _values(outcomes, name, world, path, planner)
            if not values.size:
                continue
            at = place + (index - 0.5 * (len(planners) - 1)) * width
            colour = _COLOURS[index % len(_COLOURS)]
            low, middle, high = np.percentile(values, [25, 50, 75])
            axes.bar(at, high - low, width * 0.85, low, color=colour, alpha=0.35, linewidth=0)
            axes.plot([at - 0.42 * width, at + 0.42 * width], [middle, middle], color=colour, linewidth=2)
            spread = np.linspace(-0.3, 0.3, values.size) * width if values.size > 1 else 0.0
            axes.plot(at + spread, values, ".", color=colour, markersize=3)
