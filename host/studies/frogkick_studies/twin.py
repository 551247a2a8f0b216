"""The calibrated twin: a robot as its recorded runs show it, in the pool with its own effects.

The paper's planner, with the motions that it assumed in its authors' runs, should follow the paths as badly
as in these runs. The robot's own planner, whose table contains the effects, should follow them well.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.errors import InputError
from frogkick.core.files import write_bytes
from frogkick.core.poses import wrap_angle
from frogkick.core.progress import shown
from frogkick.library import quantise
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.robot import Robot, load_robot
from frogkick.runs.recorded.importer import RUN_NAME, clock_problem, path_file, read_recorded
from frogkick.runs.runlog import RunLog
from frogkick.runs.summary import along_paths
from frogkick_codegen.firmware import require_tools
from frogkick_studies import StudyResult
from frogkick_studies.configs import Twin
from frogkick_studies.in_pool import (
    PAPER,
    PAPER_STATES,
    ROBOT,
    Case,
    Outcome,
    PathTask,
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
from frogkick_studies.inverse_planning import (
    AssumedMotions,
    Choices,
    assumed_motions,
    choices_of,
    image_of_motions,
)
from frogkick_studies.loop import loop_figure, table_of_rows

TWIN_STATES, TWIN_SAMPLING = 1000, "planned"
"""Sampling and size of the fitted robot's library.

Its states have a stroke history, on which its effects depend; a table of as many rested states has ten times
the error along the runs."""
_MEASURES = ("mean_distance_m", "progress_mps")
_MOTION = ("forward_m", "left_m", "turn_rad")
FULL, ASSUMED = "full", "believed"
"""Names for ``run_cases`` of the tables of all states of the library that ROBOT's is fitted to, and of the
motions that the authors' planner assumed."""

DISTANCE_MOST_M = 0.010
"""Limit of the mean distance to the paths for the robot's own planner with its own table."""

SKIPPED_MPS = 0.1
"""Progress above this is impossible.

The paper's planner takes the nearest path point as the robot's place: near the start of a nearly closed path
that may be the end, and the run is over."""

TWIN = "twin"


@dataclass(frozen=True)
class Recorded:
    """A recorded run, whose path the twin follows again.

    Attributes:
        choices: the decisions of its planner.
        mean_distance_m, progress_mps: from its fixes, from the first stroke on.
    """

    task: PathTask
    choices: Choices
    mean_distance_m: float
    progress_mps: float


@dataclass(frozen=True)
class Mean:
    """A planner over some paths of equal weight.

    Attributes:
        mean_distance_m, progress_mps, completed: means of its paths' means over the seeds.
        skipped: share of the runs that skipped their path, see SKIPPED_MPS; they are included in the others.
    """

    planner: str
    mean_distance_m: float
    progress_mps: float
    completed: float
    skipped: float


def world_of(robot: Robot) -> Setting:
    """Return the world of the effects of a robot's file."""
    if not robot.effects:
        raise InputError(
            f"robot {robot.title!r} has no [[effect]]: name one that was fitted to runs, as frog2022-measured"
        )
    if robot.folder is None:
        raise InputError(f"robot {robot.title!r} came without its folder: name its TOML file")
    return setting_from(TWIN, robot.effects, robot.folder)


def body_of(robot: Robot) -> Robot:
    """Return the robot without its effects, which the pool gets as a world."""
    return dataclasses.replace(robot, effects=())


def require_related(robot: Robot, nominal: Robot) -> None:
    """Raise an error if one robot cannot be the model of the other."""
    for what in ("id", "period_s", "pulse_s", "second_delay_s", "actions"):
        if getattr(robot, what) != getattr(nominal, what):
            raise InputError(
                f"{robot.title!r} and {nominal.title!r} differ in {what}: one cannot be the other's model"
            )
    if [limb.name for limb in robot.limbs] != [limb.name for limb in nominal.limbs]:
        raise InputError(
            f"{robot.title!r} and {nominal.title!r} have other limbs: name one robot's two files"
        )


def planners_of_twin(robot: Robot, are_motions_known: bool) -> tuple[Planner, ...]:
    """Return the planners to compare; the last one is the robot's own with its own table.

    Before it: the paper's with the nominal robot's table, and with the motions that it assumed (if they are
    known); the robot's with all states of a library that contains the effects.
    """
    own = config_of(robot.planner)
    believed = (Planner("paper, assumed motions", ASSUMED, PlanConfig()),) if are_motions_known else ()
    return (
        Planner("paper", PAPER, PlanConfig()),
        *believed,
        Planner("robot, full table", FULL, own, own=True),
        Planner("robot", ROBOT, own, own=True),
    )


def read_runs(folder: Path) -> list[Recorded]:
    """Read the paper's recorded runs of a folder that have their path beside them."""
    if not folder.is_dir():
        raise InputError(f"--runs {str(folder)!r} is no folder: name one with line1.csv and linep1.csv")
    files = [file for file in sorted(folder.iterdir()) if RUN_NAME.fullmatch(file.name)]
    ready = [file for file in files if path_file(file).exists()]
    if not ready:
        raise InputError(
            f"--runs {str(folder)!r} holds no run with its path: name a folder with line1.csv and linep1.csv"
        )
    return [_recorded(file.stem, read_recorded(file)) for file in ready]


def _recorded(name: str, run: RunLog) -> Recorded:
    fixes, path = run.fixes, run.path
    if path is None or not len(run.decisions):
        raise InputError(f"recorded run {run.source!r} has no stroke in it: leave it out")
    if problem := clock_problem(run):
        raise InputError(f"recorded run {run.source!r} cannot be used: {problem}: leave it out")
    poses = fixes.pose_world
    first_s = run.decisions.time_s[0]
    moving = fixes.usable & (fixes.time_s >= first_s)
    resting = poses[(fixes.quality == 1) & (fixes.time_s < first_s)]
    if not len(resting):
        resting = poses[moving][:1]
    # Headings at rest lie close together, but may lie to both sides of where they wrap.
    turned = wrap_angle(resting[:, 2] - resting[0, 2])
    heading = float(wrap_angle(resting[0, 2] + np.median(turned)))
    start = (float(np.median(resting[:, 0])), float(np.median(resting[:, 1])), heading)
    mean_m, _, progress_mps = along_paths([(-np.inf, path)], fixes.time_s[moving], poses[moving])
    return Recorded(PathTask(name, path, start), choices_of(run), mean_m, progress_mps)


def mean_over(outcomes: Mapping[Case, Outcome], planner: str, paths: Sequence[str]) -> Mean:
    """Return the means of a planner over paths of equal weight.

    Args:
        outcomes: result of ``frogkick_studies.in_pool.run_cases``, of one world.
        paths: names, at least one.
    """
    own = {case: one for case, one in outcomes.items() if case.planner == planner and case.path in paths}
    rows = summaries(own)
    return Mean(
        planner,
        float(np.mean([row.mean_distance_m for row in rows])),
        float(np.mean([row.progress_mps for row in rows])),
        float(np.mean([row.completed for row in rows])),
        float(np.mean([one.progress_mps > SKIPPED_MPS for one in own.values()])),
    )


@dataclass(frozen=True, eq=False)
class TwinStudy(StudyResult):
    """The paper's planner and the robot's in the pool of a robot as its recorded runs show it.

    Attributes:
        nominal: model of the paper's planner.
        rows: means over the seeds, for each planner along each path.
        over: "shapes" and "recorded_paths" -> each planner over these paths with equal weight.
        recorded: the recorded runs.
        believed: the motions that the paper's planner assumed; None without recorded runs.
        planners: their names, the robot's own last.
        table_bytes: sizes of the tables.
    """

    nominal: Robot
    outcomes: Mapping[Case, Outcome]
    rows: Sequence[Summary]
    over: Mapping[str, Sequence[Mean]]
    recorded: Sequence[Recorded]
    believed: AssumedMotions | None
    planners: Sequence[str]
    seeds: int
    table_bytes: Mapping[str, int]

    @property
    def mean_distance_m(self) -> dict[str, float]:
        """Of the robot's own planner, over the shapes and over the recorded runs' paths."""
        return {group: means[-1].mean_distance_m for group, means in self.over.items()}

    @property
    def passed(self) -> bool:
        """Whether it is within DISTANCE_MOST_M over both."""
        return all(one <= DISTANCE_MOST_M for one in self.mean_distance_m.values())

    @property
    def recorded_mean_distance_m(self) -> float | None:
        """Mean over the recorded runs; None without any."""
        return float(np.mean([one.mean_distance_m for one in self.recorded])) if self.recorded else None

    @property
    def _marks(self) -> dict[str, tuple[float, float]]:
        return {one.task.name: (one.mean_distance_m, one.progress_mps) for one in self.recorded}

    def plot(self) -> Figure:
        paths = list(dict.fromkeys(row.path for row in self.rows))
        return loop_figure(self.outcomes, [TWIN], paths, list(self.planners), self._marks)

    def as_json(self) -> dict[str, Any]:
        return {
            "rows": [dataclasses.asdict(row) for row in self.rows],
            "over_paths": {
                group: [dataclasses.asdict(mean) for mean in means] for group, means in self.over.items()
            },
            "recorded": {name: dict(zip(_MEASURES, mark, strict=True)) for name, mark in self._marks.items()},
            "recorded_mean_distance_m": self.recorded_mean_distance_m,
            "believed": None if self.believed is None else self._assumed(self.believed),
            "mean_distance_m": self.mean_distance_m["shapes"],
            "limit_m": DISTANCE_MOST_M,
            "passed": self.passed,
            "seeds": self.seeds,
            "table_bytes": dict(self.table_bytes),
        }

    def _assumed(self, believed: AssumedMotions) -> dict[str, Any]:
        motions = zip(self.nominal.actions, believed.motion.tolist(), strict=True)
        return {
            "motion": {action.name: dict(zip(_MOTION, motion, strict=True)) for action, motion in motions},
            **{name: value for name, value in dataclasses.asdict(believed).items() if name != "motion"},
        }

    def text(self, values: dict[str, Any]) -> str:
        passed = (
            f"the robot's planner {'is within' if self.passed else 'misses'} {1e3 * DISTANCE_MOST_M:g} mm"
        )
        return "\n".join([*self._tracking(), *self._assumed_lines(), passed])

    def _tracking(self) -> list[str]:
        lines = table_of_rows(self.rows)
        lines += [
            f"{one.task.name}: recorded {1e3 * one.mean_distance_m:.1f} mm, {1e3 * one.progress_mps:.1f} mm/s"
            for one in self.recorded
        ]
        wide = max(len(row.planner) for row in self.rows)
        for group, means in self.over.items():
            lines.append(f"{group.replace('_', ' ')}, with equal weights:")
            lines += [
                f"  {mean.planner:{wide}s}  {1e3 * mean.mean_distance_m:6.2f} mm, "
                f"{1e3 * mean.progress_mps:5.1f} mm/s, {100 * mean.completed:3.0f} % completed"
                + (f", {100 * mean.skipped:.0f} % from start to end at once" if mean.skipped else "")
                for mean in means
            ]
        mean_m = self.recorded_mean_distance_m
        return lines if mean_m is None else [*lines, f"  {'recorded':{wide}s}  {1e3 * mean_m:6.2f} mm"]

    def _assumed_lines(self) -> list[str]:
        believed = self.believed
        if believed is None:
            return []
        return [
            f"of {believed.decisions} recorded decisions the paper's planner makes "
            f"{100 * believed.agreement:.0f} % ({100 * believed.held_out_agreement:.0f} % in held-out runs; "
            f"{100 * believed.nominal_agreement:.0f} % with the model's mean motions) if it assumes:",
            *(
                f"  {action.name}: {100 * forward:5.2f} cm forward, {100 * left:5.2f} cm left, "
                f"{math.degrees(turn):6.1f} deg"
                for action, (forward, left, turn) in zip(self.nominal.actions, believed.motion, strict=True)
            ),
        ]


def run(config: Twin) -> TwinStudy:
    """Compare the paper's planner and the robot's in the pool of a robot as its recorded runs show it."""
    robot, nominal = load_robot(config.robot), load_robot(config.model)
    setting = world_of(robot)
    require_related(robot, nominal)
    shapes = shape_names(config.path)
    recorded = [] if config.runs is None else read_runs(config.runs)
    require_tools("native")
    out, processes = config.out, config.processes
    images = {name: out / f"{name}.fkt" for name in (PAPER, FULL, ROBOT)}
    model = library_of(nominal, config.model_library, out / "model.h5", processes, PAPER_STATES, "box")
    write_bytes(images[PAPER], quantise(model))
    own = library_of(robot, config.library, out / "robot.h5", processes, TWIN_STATES, TWIN_SAMPLING)
    write_bytes(images[FULL], quantise(own))
    fit_own_table(own, images[ROBOT])
    believed = None
    if recorded:
        begin = model.displacement_body[model.whole_states()].mean(axis=0)
        believed = assumed_motions([one.choices for one in recorded], nominal, begin)
        images[ASSUMED] = out / f"{ASSUMED}.fkt"
        write_bytes(images[ASSUMED], image_of_motions(nominal, believed.motion))
    planners = planners_of_twin(robot, believed is not None)
    names = [planner.name for planner in planners]
    path_tasks = [one.task for one in recorded]
    ways = [*shapes, *(task.name for task in path_tasks)]
    cases = [Case(TWIN, one, name, seed) for one in ways for name in names for seed in range(config.seeds)]
    with shown(True, "runs") as tell:
        outcomes = run_cases(
            body_of(robot), images, planners, [setting], cases, out, processes, tell, path_tasks
        )
    groups = {"shapes": shapes, "recorded_paths": [task.name for task in path_tasks]}
    return TwinStudy(
        nominal,
        outcomes,
        summaries(outcomes),
        {
            group: [mean_over(outcomes, name, some) for name in names]
            for group, some in groups.items()
            if some
        },
        recorded,
        believed,
        names,
        config.seeds,
        {name: image.stat().st_size for name, image in images.items()},
    )
