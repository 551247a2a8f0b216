"""Planners in the simulated pool, over paths, seeds and worlds, for the studies ``loop`` and ``twin``.

``Lines`` keeps results in a file, so that an interrupted study resumes; ``verdicts`` uses it as well.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.chunks import Job, code_stamp, run_chunks
from frogkick.core.errors import InputError
from frogkick.core.files import write_bytes, write_text
from frogkick.core.progress import shown
from frogkick.effects import World
from frogkick.effects.registry import make_effects, own_code
from frogkick.front.places import start_pose
from frogkick.library import Library, build_library, fit_table, read_library
from frogkick.library.fitting import BUDGET_BYTES
from frogkick.paths import SHAPES, shape
from frogkick.paths import Path as SwimPath
from frogkick.planner.plan import PlanConfig
from frogkick.pool.native_robot import NativeRobot
from frogkick.pool.pool import Camera, Pool
from frogkick.robot import Robot
from frogkick.runs.closed_loop import run_in_pool
from frogkick.runs.record import RunOptions
from frogkick.tables.image import read_image
from frogkick_codegen.firmware import build

TIME_LIMIT_S = 120.0
PAPER_STATES = 8503
PAPER, ROBOT = "paper", "robot"


@dataclass(frozen=True)
class Case:
    """One run: names of its world, path and planner, and the seed of the camera's noise."""

    world: str
    path: str
    planner: str
    seed: int


@dataclass(frozen=True)
class Outcome:
    """The result of a run; see ``frogkick.runs.runlog.Tracking``."""

    mean_distance_m: float
    progress_mps: float
    completed: bool
    ended: str
    decisions: int


class Lines:
    """A file of JSON objects, one a line, below a head that identifies their conditions.

    Attributes:
        values: the objects that the file had under the same head, in order.
    """

    def __init__(self, file: Path, head: dict[str, str]) -> None:
        """Read the file, or begin it again if its head differs.

        Args:
            file: the file, which is made with its folder if it does not exist.
            head: all that every object depends on.
        """
        self._file = file
        first = json.dumps(head)
        lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
        kept = [line for line in lines[1:] if _read_line(line)] if lines[:1] == [first] else []
        # Results of other code, or a line that was cut off, after which no line may follow.
        if lines != [first, *kept]:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_text(file, "".join(line + "\n" for line in (first, *kept)))
        self.values = [_read_line(line) for line in kept]

    def add(self, values: dict[str, Any]) -> None:
        """Append an object."""
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps(values) + "\n")


def _read_line(line: str) -> dict[str, Any]:
    """Return an object; empty if an interruption cut its line."""
    try:
        values = json.loads(line)
    except json.JSONDecodeError:
        return {}
    return values if isinstance(values, dict) else {}


@dataclass(frozen=True)
class Setting:
    """A world by name. It is created anew for each run, because effects may have a state.

    Attributes:
        tables: tables of its effects, as in a world's TOML file.
        sha256: hash of all that it is made of, hexadecimal.
    """

    name: str
    tables: tuple[Mapping[str, Any], ...] = ()
    folder: Path = Path()
    sha256: str = ""

    def world(self) -> World:
        """Make the world."""
        return World(make_effects(self.tables, self.folder))


def setting_from(name: str, tables: Sequence[Mapping[str, Any]], folder: Path = Path()) -> Setting:
    """Return the world of ``[[effect]]`` tables, with a hash of these and of the files that they name."""
    digest = hashlib.sha256(json.dumps(list(tables), sort_keys=True).encode())
    for file in sorted({str(table["file"]) for table in tables if "file" in table}):
        digest.update(b"\0" + (folder / file).read_bytes())
    return Setting(name, tuple(tables), folder, digest.hexdigest())


@dataclass(frozen=True)
class Planner:
    """One of the planners that are compared.

    Attributes:
        table: name of its table for ``run_cases``: PAPER (all states of the paper's, nearest), ROBOT.
        config: cost, weights, depth.
        own: whether the cost is the robot's own.
        learn: the host plans, with an estimate of the limbs' wear.
    """

    name: str
    table: str
    config: PlanConfig
    own: bool = False
    learn: bool = False


@dataclass(frozen=True, eq=False)
class PathTask:
    """A path, and the pose of the robot at rest when its run begins.

    Attributes:
        start_world: x_m, y_m, heading_rad of the robot.
    """

    name: str
    path: SwimPath
    start_world: tuple[float, float, float]

    @property
    def sha256(self) -> str:
        """Hash of path and start, hexadecimal."""
        columns = (self.path.x_m, self.path.y_m, self.path.tangent_rad)
        digest = hashlib.sha256(b"".join(column.tobytes() for column in columns))
        digest.update(repr(self.start_world).encode())
        return digest.hexdigest()


def shape_task(name: str) -> PathTask:
    """Return a shape by name, from its first point along its tangent."""
    path = shape(name)
    return PathTask(name, path, start_pose(path))


@dataclass(frozen=True)
class Summary:
    """Runs of one planner over the seeds, along one path in one world.

    Attributes:
        mean_distance_m, progress_mps: means over the seeds.
        deviation_m: standard deviation of the mean distance over the seeds.
        completed: share of the runs.
    """

    world: str
    path: str
    planner: str
    mean_distance_m: float
    deviation_m: float
    progress_mps: float
    completed: float


def run_cases(
    robot: Robot,
    tables: Mapping[str, Path],
    planners: Sequence[Planner],
    settings: Sequence[Setting],
    cases: Sequence[Case],
    out: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    path_tasks: Sequence[PathTask] = (),
) -> dict[Case, Outcome]:
    """Run every case, except those whose results ``out`` holds for the same code, tables, world and task.

    Args:
        robot: the robot of pool and firmware, without the effects of its file.
        tables: name of a table in ``planners`` -> table image.
        path_tasks: further paths of the cases besides shapes.
    """
    libraries = {
        name: build("native", path, robot, out / f"firmware-{name}").image for name, path in tables.items()
    }
    worlds = {setting.name: setting.sha256 for setting in settings}
    ways = {task.name: task.sha256 for task in path_tasks}

    def conditions(case: Case) -> str | None:
        return f"{worlds[case.world]} {ways.get(case.path, '')}" if case.world in worlds else None

    lines = Lines(out / "runs.jsonl", {"stamp": _stamp(robot, tables, libraries, planners)})
    kept = {
        case: Outcome(**values["outcome"])
        for values in lines.values
        if conditions(case := Case(**values["case"])) == values["conditions_sha256"]
    }
    waiting = [case for case in cases if case not in kept]
    job = Job(_Ready, (robot, tables, libraries, planners, settings, path_tasks), _run, _warm)
    progress(len(cases) - len(waiting), len(cases))
    for index, outcome in run_chunks(job, waiting, workers):
        case = waiting[index]
        kept[case] = outcome
        lines.add(
            {
                "case": dataclasses.asdict(case),
                "conditions_sha256": conditions(case),
                "outcome": dataclasses.asdict(outcome),
            }
        )
        progress(sum(case in kept for case in cases), len(cases))
    return {case: kept[case] for case in cases}


def summaries(outcomes: Mapping[Case, Outcome]) -> list[Summary]:
    """Return means over the seeds, in the order of the cases."""
    groups: dict[tuple[str, str, str], list[Outcome]] = {}
    for case, outcome in outcomes.items():
        groups.setdefault((case.world, case.path, case.planner), []).append(outcome)
    return [
        Summary(
            *group,
            float(np.mean([run.mean_distance_m for run in runs])),
            float(np.std([run.mean_distance_m for run in runs])),
            float(np.mean([run.progress_mps for run in runs])),
            float(np.mean([run.completed for run in runs])),
        )
        for group, runs in groups.items()
    ]


def stamp_of(robot: Robot, parts: Sequence[bytes]) -> str:
    """Return a hash, hexadecimal, of what a kept result depends on.

    These are the code and its numerical packages, the robot with the effects that its user wrote, and
    ``parts``: contents of files and what else a study sets.
    """
    digest = hashlib.sha256(code_stamp("frogkick_studies").encode() + robot.sha256)
    for part in (own_code(robot), *parts):
        digest.update(hashlib.sha256(part).digest())
    return digest.hexdigest()


def _stamp(
    robot: Robot, tables: Mapping[str, Path], libraries: Mapping[str, Path], planners: Sequence[Planner]
) -> str:
    # A native library is named after all of its sources.
    names = [f"{name} {libraries[name].name}\n".encode() for name in sorted(tables)]
    images = [tables[name].read_bytes() for name in sorted(tables)]
    return stamp_of(robot, [*names, *images, repr(planners).encode()])


class _Ready:
    def __init__(
        self,
        robot: Robot,
        tables: Mapping[str, Path],
        libraries: Mapping[str, Path],
        planners: Sequence[Planner],
        settings: Sequence[Setting],
        path_tasks: Sequence[PathTask],
    ) -> None:
        self.robot, self.libraries = robot, libraries
        self.tables = {name: read_image(path) for name, path in tables.items()}
        self.planners = {planner.name: planner for planner in planners}
        self.settings = {setting.name: setting for setting in settings}
        self.path_tasks = {task.name: task for task in path_tasks}


def _warm(ready: _Ready) -> None:
    Pool(ready.robot, (0.0, 0.0, 0.0), Camera(), np.random.default_rng(0)).advance(0.01)


def _run(ready: _Ready, case: Case) -> Outcome:
    planner = ready.planners[case.planner]
    task = ready.path_tasks.get(case.path) or shape_task(case.path)
    swum = run_in_pool(
        NativeRobot(ready.libraries[planner.table], len(ready.robot.limbs)),
        ready.tables[planner.table],
        ready.robot,
        task.path,
        RunOptions(planner.config, not planner.learn, TIME_LIMIT_S, learn=planner.learn),
        case.seed,
        "study",
        ready.settings[case.world].world(),
        task.start_world,
    )
    tracked = swum.tracking()
    return Outcome(
        tracked.mean_distance_m, tracked.progress_mps, swum.completed, swum.ended, tracked.decisions
    )


def shape_names(given: Sequence[str] | None) -> list[str]:
    """Return names of shapes, each once; the paper's if none is given."""
    names = list(given or SHAPES)
    for name in names:
        shape(name)
    return list(dict.fromkeys(names))


def library_of(
    robot: Robot,
    given: Path | None,
    made: Path,
    workers: int,
    states: int,
    sampling: str,
) -> Library:
    """Read a library of a robot, or make it once.

    Args:
        robot: the robot that it must be of.
        given: its file; None: ``made``.
        made: file that is written if it does not exist.
        states, sampling: as for ``build_library``.
    """
    source = made if given is None else given
    if given is None and not made.exists():
        with shown(True, f"library {made.name}") as tell:
            return build_library(robot, states, 0, workers, made, tell, sampling, record_s=0.0)
    read = read_library(source)
    if _with_planner_of(robot, read.robot()) != _with_planner_of(robot, robot):
        raise InputError(f"library {source.name!r} is not of {robot.title!r} as it is now: build it again")
    return read


def fit_own_table(library: Library, image: Path) -> None:
    """Write the affine table of 64 KiB of a library."""
    with shown(True, "robot's table") as tell:
        write_bytes(image, fit_table(library, "affine", BUDGET_BYTES, tell).image)


def _with_planner_of(other: Robot, robot: Robot) -> Robot:
    """Return a robot with the planner of another one, which does not affect a library."""
    return dataclasses.replace(robot, planner=other.planner)
