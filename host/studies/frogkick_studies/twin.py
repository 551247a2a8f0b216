"""The calibrated twin: a robot as its recorded runs show it, in the pool of its own effects.

There the paper's planner, with what its authors' runs show that it believed of each action, should track as
badly as in these runs, and the robot's own planner, whose table knows the effects, well.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.poses import wrap_angle
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.robot import Robot
from frogkick.runs.record import along_path
from frogkick.runs.recorded import clock_problem, read_recorded
from frogkick.runs.recorded.importer import RUN_NAME, path_file
from frogkick.runs.runlog import RunLog
from frogkick_studies.believed import Choices, choices_of
from frogkick_studies.kept import Case, Outcome
from frogkick_studies.loop import PAPER, ROBOT, Course, Planner, Setting, setting_from, summaries

FULL, BELIEVED = "full", "believed"
"""How ``run_cases`` is told the tables of every state of the library that ROBOT's is fitted to, and of the
motions that the authors' planner believed in."""

DISTANCE_MOST_M = 0.010
"""Mean distance to the paths that the robot's own planner may have, with its own table."""

SKIPPED_MPS = 0.1
"""Progress that no robot makes. The paper's planner takes the nearest path point for where it is: near the
start of a path that all but closes it may find the end, and its run is over."""

TWIN = "twin"


@dataclass(frozen=True)
class Recorded:
    """A recorded run, whose path the twin swims again.

    Attributes:
        course: its path, from where the robot lay before its first stroke.
        choices: what its planner chose, and where.
        mean_distance_m, progress_mps: of its fixes, from the first stroke on.
    """

    course: Course
    choices: Choices
    mean_distance_m: float
    progress_mps: float


@dataclass(frozen=True)
class Mean:
    """A planner over some paths, which weigh alike.

    Attributes:
        planner: its name.
        mean_distance_m, progress_mps, completed: means of its paths' means over the seeds.
        skipped: part of the runs that skipped their path, see SKIPPED_MPS; they are in the other figures too.
    """

    planner: str
    mean_distance_m: float
    progress_mps: float
    completed: float
    skipped: float


def world_of(robot: Robot) -> Setting:
    """The pool in which all is true that the robot's file says it has besides its body.

    Raises:
        InputError: the file says nothing, or its text came without the file of an effect.
    """
    if not robot.effects:
        raise InputError(
            f"robot {robot.title!r} has no [[effect]]: name one that was fitted to runs, as frog2022-measured"
        )
    if robot.folder is None:
        raise InputError(f"robot {robot.title!r} came without its folder: name its TOML file")
    return setting_from(TWIN, robot.effects, robot.folder)


def body_of(robot: Robot) -> Robot:
    """The robot without its effects, which the pool is given as a world."""
    return dataclasses.replace(robot, effects=())


def require_related(robot: Robot, nominal: Robot) -> None:
    """Refuse two robots of which one cannot be the other's model.

    Raises:
        InputError: they differ in id, limbs, actions or times.
    """
    for what in ("id", "period_s", "pulse_s", "second_delay_s", "actions"):
        if getattr(robot, what) != getattr(nominal, what):
            raise InputError(
                f"{robot.title!r} and {nominal.title!r} differ in {what}: one cannot be the other's model"
            )
    if [limb.name for limb in robot.limbs] != [limb.name for limb in nominal.limbs]:
        raise InputError(
            f"{robot.title!r} and {nominal.title!r} have other limbs: name one robot's two files"
        )


def planners_of_twin(robot: Robot, is_believed_known: bool) -> tuple[Planner, ...]:
    """The planners that are compared; the robot's own with its own table is the last.

    Before it: the paper's with the nominal robot's table, and with the motions that it believed in (where
    these are known); the robot's with every state of a library that knows the effects.
    """
    own = config_of(robot.planner)
    believed = (Planner("paper, as it believed", BELIEVED, PlanConfig()),) if is_believed_known else ()
    return (
        Planner("paper", PAPER, PlanConfig()),
        *believed,
        Planner("robot, full table", FULL, own, own=True),
        Planner("robot", ROBOT, own, own=True),
    )


def read_runs(folder: Path) -> list[Recorded]:
    """The paper's recorded runs of a folder that have their path beside them.

    Raises:
        InputError: no such folder, no run in it; one that is damaged, in which nothing moves, or whose
            strokes' times cannot be relied on.
    """
    if not folder.is_dir():
        raise InputError(f"--runs {str(folder)!r} is no folder: name one with line1.csv and linep1.csv")
    files = [file for file in sorted(folder.iterdir()) if RUN_NAME.fullmatch(file.name)]
    ready = [file for file in files if path_file(file).exists()]
    if not ready:
        raise InputError(f"--runs {str(folder)!r} holds no run with its path, as line1.csv and linep1.csv")
    return [_recorded(file.stem, read_recorded(file)) for file in ready]


def _recorded(name: str, run: RunLog) -> Recorded:
    fixes, path = run.fixes, run.path
    if path is None or not len(run.decisions):
        raise InputError(f"recorded run {run.source!r} has no stroke in it: leave it out")
    if problem := clock_problem(run):
        raise InputError(f"recorded run {run.source!r} cannot be used: {problem}: leave it out")
    poses = np.column_stack([fixes.x_m, fixes.y_m, fixes.heading_rad])
    first_s = run.decisions.time_s[0]
    moving = fixes.usable & (fixes.time_s >= first_s)
    resting = poses[(fixes.quality == 1) & (fixes.time_s < first_s)]
    if not len(resting):
        resting = poses[moving][:1]
    # Headings at rest lie close together, but may lie to both sides of where they wrap.
    turned = wrap_angle(resting[:, 2] - resting[0, 2])
    heading = float(wrap_angle(resting[0, 2] + np.median(turned)))
    start = (float(np.median(resting[:, 0])), float(np.median(resting[:, 1])), heading)
    mean_m, _, progress_mps = along_path(path, fixes.time_s[moving], poses[moving])
    return Recorded(Course(name, path, start), choices_of(run), mean_m, progress_mps)


def mean_over(outcomes: Mapping[Case, Outcome], planner: str, paths: Sequence[str]) -> Mean:
    """A planner over paths, which weigh alike.

    Args:
        outcomes: of ``frogkick_studies.loop.run_cases``, of one world.
        planner: its name.
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
