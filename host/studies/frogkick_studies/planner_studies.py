"""Studies of the robot's planner beside the paper's: in the simulated pool, and in that of a worn twin."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.files import require_writable, write_bytes
from frogkick.core.progress import Progress, shown
from frogkick.library import Library, build_library, fit_table, quantise, read_library
from frogkick.library.fitting import BUDGET_BYTES
from frogkick.paths import SHAPES, shape
from frogkick.robot import Robot, load_robot
from frogkick_codegen.firmware import require_tools
from frogkick_studies import believed as beliefs
from frogkick_studies import loop as planners_in_loop
from frogkick_studies import twin
from frogkick_studies.kept import Case, Outcome
from frogkick_studies.loop import HIDDEN, NOMINAL, PAPER, ROBOT, Summary, Verdict
from frogkick_studies.twin import Recorded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PlannersCompared", "Summary", "TwinStudy", "compare_in_twin", "compare_planners"]

PAPER_STATES = 8503
TWIN_STATES, TWIN_SAMPLING = 1000, "planned"
"""Of the library that is made of the fitted robot: in it limbs have a history, which its effects act by. A
table of as many rested ones is ten times further off where runs go."""
_MEASURES = ("mean_distance_m", "progress_mps")
_MOTION = ("forward_m", "left_m", "turn_rad")


@dataclass(frozen=True, eq=False, repr=False)
class PlannersCompared:
    """The paper's planner and the robot's on the same paths, in the same worlds.

    Attributes:
        outcomes: each run.
        rows: means over the seeds, of each planner along each path in each world.
        verdicts: for each world whether the robot's planner does what is asked of it.
        planners: their names.
        seeds: runs of each.
        table_bytes: sizes of both tables.
    """

    outcomes: Mapping[Case, Outcome]
    rows: Sequence[Summary]
    verdicts: Sequence[Verdict]
    planners: Sequence[str]
    seeds: int
    table_bytes: Mapping[str, int]

    @property
    def passed(self) -> bool:
        """Whether in every world all that is asked is so."""
        return all(verdict.passed for verdict in self.verdicts)

    def plot(self) -> Figure:
        """A matplotlib figure: distance and progress of each planner."""
        from frogkick_studies.loop_figure import loop_figure

        worlds = [verdict.world for verdict in self.verdicts]
        paths = list(dict.fromkeys(row.path for row in self.rows))
        return loop_figure(self.outcomes, worlds, paths, list(self.planners))

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study loop``, without its picture."""
        return {
            "rows": [dataclasses.asdict(row) for row in self.rows],
            "over_paths": {
                verdict.world: {**dataclasses.asdict(verdict), "passed": verdict.passed}
                for verdict in self.verdicts
            },
            "seeds": self.seeds,
            "table_bytes": dict(self.table_bytes),
        }

    def __repr__(self) -> str:
        told = ", ".join(f"{v.world} {'passed' if v.passed else 'missed'}" for v in self.verdicts)
        return f"PlannersCompared({len(self.planners)} planners, {len(self.outcomes)} runs; {told})"


def compare_planners(
    out: Path | str,
    *,
    robot: Robot | str = "frog2022",
    paths: Sequence[str] | None = None,
    worlds: Sequence[str] | None = None,
    seeds: int = 20,
    library: Path | None = None,
    tables: Path | None = None,
    workers: int | None = None,
    progress: Progress = False,
) -> PlannersCompared:
    """Distance to the path and progress: the paper's planner against the robot's, depth 1 to 3.

    Args:
        out: folder for libraries, tables and results; a second start goes on in it.
        robot: it, or its name or TOML file.
        paths: names of shapes; None: line, sine and ellipse.
        worlds: "nominal" (the plain pool), "hidden" (with a few effects that no model knows), or TOML files
            of effects; None: the first two.
        seeds: runs of each, by the camera's noise.
        library: for both tables; None: one of 8503 states, made once.
        tables: the robot's own; None: affine, 64 KiB, of that library.
        workers: processes; None: one for each core.
        progress: True for bars, or a function of (done, all) of each stage.

    Raises:
        InputError: an unknown path or world, or a library of another robot.
        ToolchainError: no compiler for the core.
    """
    described = load_robot(robot)
    settings = planners_in_loop.settings_of(list(worlds or (NOMINAL.name, HIDDEN.name)), described)
    names = _shape_names(paths)
    folder = Path(out)
    require_tools("native")
    require_writable(folder, folder=True)
    processes = workers or os.cpu_count() or 1
    images = {PAPER: folder / "paper.fkt", ROBOT: folder / "robot.fkt" if tables is None else tables}
    read = _library_of(described, library, folder / "library.h5", processes, PAPER_STATES, "box", progress)
    write_bytes(images[PAPER], quantise(read))
    if tables is None:
        _fit_own_table(read, images[ROBOT], progress)
    planners = planners_in_loop.planners_of(described)
    cases = [
        Case(setting.name, name, planner.name, seed)
        for setting in settings
        for name in names
        for planner in planners
        for seed in range(seeds)
    ]
    with shown(progress, "runs") as tell:
        outcomes = planners_in_loop.run_cases(
            described, images, planners, settings, cases, folder, processes, tell
        )
    rows = planners_in_loop.summaries(outcomes)
    return PlannersCompared(
        outcomes,
        rows,
        [planners_in_loop.judge(rows, each.name, planners, described.planner.depth) for each in settings],
        [planner.name for planner in planners],
        seeds,
        {name: image.stat().st_size for name, image in images.items()},
    )


def _shape_names(given: Sequence[str] | None) -> list[str]:
    """Names of shapes, each once, the paper's where none is given.

    Raises:
        InputError: no such shape.
    """
    names = list(given or SHAPES)
    for name in names:
        shape(name)
    return list(dict.fromkeys(names))


def _library_of(
    robot: Robot,
    given: Path | None,
    made: Path,
    workers: int,
    states: int,
    sampling: str,
    progress: Progress,
) -> Library:
    """Read a library of a robot, or one made once.

    Args:
        robot: whose it has to be.
        given: its file, None for ``made``.
        made: written where it is not there yet, of ``states`` and ``sampling`` as for ``build_library``.
        workers: processes.
        progress: of making it.

    Raises:
        InputError: it is of another robot, or of another version of it.
    """
    source = made if given is None else given
    if given is None and not made.exists():
        with shown(progress, f"library {made.name}") as tell:
            build_library(robot, states, 0, workers, made, tell, sampling, record_s=0.0)
    read = read_library(source)
    if _with_planner_of(robot, read.robot()) != _with_planner_of(robot, robot):
        raise InputError(f"library {source.name!r} is not of {robot.title!r} as it is now: build it again")
    return read


def _fit_own_table(library: Library, image: Path, progress: Progress) -> None:
    """Write the affine table of 64 KiB of a library.

    Raises:
        InputError: it has too few states.
    """
    with shown(progress, "robot's table") as tell:
        write_bytes(image, fit_table(library, "affine", BUDGET_BYTES, tell).image)


def _with_planner_of(other: Robot, robot: Robot) -> Robot:
    """A robot with the planner of another one, which changes nothing in a library, and without its text."""
    return dataclasses.replace(robot, planner=other.planner, toml="", sha256=b"")


@dataclass(frozen=True, eq=False, repr=False)
class TwinStudy:
    """The paper's planner and the robot's in the pool of a robot as its recorded runs show it.

    Attributes:
        nominal: what the paper's planner takes the robot for.
        outcomes: each run.
        rows: means over the seeds, of each planner along each path.
        over: "shapes" and "recorded_paths" -> each planner over these paths, which weigh alike.
        recorded: the recorded runs.
        believed: the motions that the paper's planner believed in; None without recorded runs.
        planners: their names, the robot's own last.
        seeds: runs of each.
        table_bytes: sizes of the tables.
    """

    nominal: Robot
    outcomes: Mapping[Case, Outcome]
    rows: Sequence[Summary]
    over: Mapping[str, Sequence[twin.Mean]]
    recorded: Sequence[Recorded]
    believed: beliefs.Believed | None
    planners: Sequence[str]
    seeds: int
    table_bytes: Mapping[str, int]

    @property
    def limit_m(self) -> float:
        """Mean distance to the paths that the robot's own planner may have."""
        return twin.DISTANCE_MOST_M

    @property
    def mean_distance_m(self) -> dict[str, float]:
        """Of the robot's own planner, over the shapes and over the recorded runs' paths."""
        return {group: means[-1].mean_distance_m for group, means in self.over.items()}

    @property
    def passed(self) -> bool:
        """Whether it is within ``limit_m`` over both."""
        return all(one <= self.limit_m for one in self.mean_distance_m.values())

    @property
    def recorded_mean_distance_m(self) -> float | None:
        """Mean over the recorded runs; None where there are none."""
        return float(np.mean([one.mean_distance_m for one in self.recorded])) if self.recorded else None

    @property
    def _marks(self) -> dict[str, tuple[float, float]]:
        return {one.course.name: (one.mean_distance_m, one.progress_mps) for one in self.recorded}

    def plot(self) -> Figure:
        """A matplotlib figure: distance and progress of each planner, and of the recorded runs."""
        from frogkick_studies.loop_figure import loop_figure

        paths = list(dict.fromkeys(row.path for row in self.rows))
        return loop_figure(self.outcomes, [twin.TWIN], paths, list(self.planners), self._marks)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study twin``, without its picture."""
        return {
            "rows": [dataclasses.asdict(row) for row in self.rows],
            "over_paths": {
                group: [dataclasses.asdict(mean) for mean in means] for group, means in self.over.items()
            },
            "recorded": {name: dict(zip(_MEASURES, mark, strict=True)) for name, mark in self._marks.items()},
            "recorded_mean_distance_m": self.recorded_mean_distance_m,
            "believed": None if self.believed is None else self._told(self.believed),
            "mean_distance_m": self.mean_distance_m["shapes"],
            "limit_m": self.limit_m,
            "passed": self.passed,
            "seeds": self.seeds,
            "table_bytes": dict(self.table_bytes),
        }

    def _told(self, believed: beliefs.Believed) -> dict[str, Any]:
        motions = zip(self.nominal.actions, believed.motion.tolist(), strict=True)
        return {
            "motion": {action.name: dict(zip(_MOTION, motion, strict=True)) for action, motion in motions},
            **{name: value for name, value in dataclasses.asdict(believed).items() if name != "motion"},
        }

    def __repr__(self) -> str:
        told = ", ".join(f"{group} {1e3 * far:.1f} mm" for group, far in self.mean_distance_m.items())
        return f"TwinStudy({len(self.outcomes)} runs; the robot's {told}, limit {1e3 * self.limit_m:g} mm)"


def compare_in_twin(
    out: Path | str,
    *,
    robot: Robot | str = "frog2022-measured",
    model: Robot | str = "frog2022",
    paths: Sequence[str] | None = None,
    runs: Path | None = None,
    seeds: int = 6,
    library: Path | None = None,
    model_library: Path | None = None,
    workers: int | None = None,
    progress: Progress = False,
) -> TwinStudy:
    """The paper's planner and the robot's in the pool of a robot as its recorded runs show it.

    Args:
        out: folder for libraries, tables and results; a second start goes on in it.
        robot: it, or its name or TOML file; its effects are true in the pool.
        model: what the paper's planner takes it for.
        paths: names of shapes; None: line, sine and ellipse.
        runs: folder of the paper's recorded runs: their paths too, from where they began, and the paper's
            planner also with what it believed of each action, as its recorded decisions show.
        seeds: runs of each, by the camera's noise.
        library: of the robot; None: one of 1000 planned states, made once.
        model_library: of the model; None: one of 8503 states, made once.
        workers: processes; None: one for each core.
        progress: True for bars, or a function of (done, all) of each stage.

    Raises:
        InputError: a robot without effects, a model that cannot be its own, or recorded runs of no use.
        ToolchainError: no compiler for the core.
    """
    described, nominal = (load_robot(each) for each in (robot, model))
    setting = twin.world_of(described)
    twin.require_related(described, nominal)
    shapes = _shape_names(paths)
    recorded = [] if runs is None else twin.read_runs(runs)
    folder = Path(out)
    require_tools("native")
    require_writable(folder, folder=True)
    folder.mkdir(parents=True, exist_ok=True)
    processes = workers or os.cpu_count() or 1
    images = {name: folder / f"{name}.fkt" for name in (PAPER, twin.FULL, ROBOT)}
    told = _library_of(nominal, model_library, folder / "model.h5", processes, PAPER_STATES, "box", progress)
    write_bytes(images[PAPER], quantise(told))
    own = _library_of(
        described, library, folder / "robot.h5", processes, TWIN_STATES, TWIN_SAMPLING, progress
    )
    write_bytes(images[twin.FULL], quantise(own))
    _fit_own_table(own, images[ROBOT], progress)
    believed = None
    if recorded:
        begin = told.displacement_body[told.whole_states()].mean(axis=0)
        believed = beliefs.believed_motions([one.choices for one in recorded], nominal, begin)
        images[twin.BELIEVED] = folder / f"{twin.BELIEVED}.fkt"
        write_bytes(images[twin.BELIEVED], beliefs.image_of_motions(nominal, believed.motion))
    planners = twin.planners_of_twin(described, believed is not None)
    names = [planner.name for planner in planners]
    courses = [one.course for one in recorded]
    ways = [*shapes, *(course.name for course in courses)]
    cases = [Case(twin.TWIN, one, name, seed) for one in ways for name in names for seed in range(seeds)]
    body = twin.body_of(described)
    with shown(progress, "runs") as tell:
        outcomes = planners_in_loop.run_cases(
            body, images, planners, [setting], cases, folder, processes, tell, courses
        )
    groups = {"shapes": shapes, "recorded_paths": [course.name for course in courses]}
    return TwinStudy(
        nominal,
        outcomes,
        planners_in_loop.summaries(outcomes),
        {
            group: [twin.mean_over(outcomes, name, some) for name in names]
            for group, some in groups.items()
            if some
        },
        recorded,
        believed,
        names,
        seeds,
        {name: image.stat().st_size for name, image in images.items()},
    )
