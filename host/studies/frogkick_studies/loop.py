"""Does looking ahead pay? Planners in the simulated pool, over paths, seeds and worlds no model knows."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.chunks import Job, code_stamp, run_chunks
from frogkick.core.errors import InputError
from frogkick.core.files import existing_file
from frogkick.effects import World, changed_robot, read_world
from frogkick.effects.registry import make_effects
from frogkick.paths import Path as SwimPath
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.pool.camera import Camera
from frogkick.pool.native_robot import NativeRobot
from frogkick.pool.pool import Pool
from frogkick.robot import Robot
from frogkick.runs.closed_loop import RunOptions, run_in_pool
from frogkick.runs.record import tracking_of_recording
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.firmware import build
from frogkick_studies.kept import Case, Kept, Outcome

TIME_LIMIT_S = 120.0
PAPER, ROBOT = "paper", "robot"
RATIO_MOST = 0.5
"""What part of the paper's planner's distance the robot's own may have."""
_HIDDEN = (
    {"name": "limb_wear", "limb": "front_left", "gain": 0.85},
    {"name": "limb_memory", "loss": 0.2, "fade_s": 1.5},
    {"name": "warm_up", "loss": 0.3, "fade_strokes": 2.0},
    {"name": "steady_current", "x_mps": 0.002, "y_mps": 0.003},
)


@dataclass(frozen=True)
class Setting:
    """A world by name, which can be made again for every run: effects may keep things to themselves.

    Attributes:
        name: for reports and results.
        tables: of its effects, as in a world's TOML.
        folder: where files of its effects are.
        sha256: of all that it is made of, hex.
    """

    name: str
    tables: tuple[Mapping[str, Any], ...] = ()
    folder: Path = Path()
    sha256: str = ""

    def world(self) -> World:
        """Make it."""
        return World(make_effects(self.tables, self.folder))


def setting_from(name: str, tables: Sequence[Mapping[str, Any]], folder: Path = Path()) -> Setting:
    """The world of some ``[[effect]]`` tables, with a hash of these and of the files that they name."""
    digest = hashlib.sha256(json.dumps(list(tables), sort_keys=True).encode())
    for file in sorted({str(table["file"]) for table in tables if "file" in table}):
        digest.update(b"\0" + (folder / file).read_bytes())
    return Setting(name, tuple(tables), folder, digest.hexdigest())


NOMINAL = setting_from("nominal", ())
HIDDEN = setting_from("hidden", _HIDDEN)
"""Effects that are in no table, of a size that recorded runs show."""


@dataclass(frozen=True)
class Planner:
    """One of the planners that are compared.

    Attributes:
        name: for reports.
        table: how ``run_cases`` is told its table: PAPER (every state of the paper's, nearest), ROBOT.
        config: cost, weights, depth.
        own: the cost is the robot's own.
    """

    name: str
    table: str
    config: PlanConfig
    own: bool = False


@dataclass(frozen=True, eq=False)
class Course:
    """A path, and where the robot lies at rest when its run begins.

    Attributes:
        name: for reports and results.
        path: to follow, world frame.
        start_world: x_m, y_m, heading_rad of the robot.
    """

    name: str
    path: SwimPath
    start_world: tuple[float, float, float]

    @property
    def sha256(self) -> str:
        """Of path and start, hex."""
        columns = (self.path.x_m, self.path.y_m, self.path.tangent_rad)
        digest = hashlib.sha256(b"".join(column.tobytes() for column in columns))
        digest.update(repr(self.start_world).encode())
        return digest.hexdigest()


def course_of(name: str) -> Course:
    """A shape by name, from its first point along its tangent.

    Raises:
        InputError: no such shape.
    """
    path = shape(name)
    return Course(name, path, (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0])))


@dataclass(frozen=True)
class Summary:
    """Runs of one planner over the seeds, of one path in one world.

    Attributes:
        world, path, planner: of the runs.
        mean_distance_m, progress_mps: means over the seeds.
        deviation_m: standard deviation of the mean distance over the seeds.
        completed: part of the runs.
    """

    world: str
    path: str
    planner: str
    mean_distance_m: float
    deviation_m: float
    progress_mps: float
    completed: float


def planners_of(robot: Robot) -> tuple[Planner, ...]:
    """The paper's planner; its cost at depth 3 on the robot's table; the robot's at depth 1 to 3."""
    own = config_of(robot.planner)
    return (
        Planner("paper", PAPER, PlanConfig()),
        Planner("paper, depth 3", ROBOT, PlanConfig(depth=3)),
        *(
            Planner(f"robot, depth {depth}", ROBOT, dataclasses.replace(own, depth=depth), own=True)
            for depth in sorted({1, 2, 3, own.depth})
        ),
    )


def setting_of(word: str, robot: Robot) -> Setting:
    """The world of a name ("nominal", "hidden") or of a TOML file, which is then named after the file.

    Raises:
        InputError: no such file, or a wrong effect in it, or one that does not fit the robot.
    """
    for known in (NOMINAL, HIDDEN):
        if word == known.name:
            return known
    file = existing_file(word, "world file")
    changed_robot(robot, read_world(file).effects)
    tables = tomllib.loads(file.read_text(encoding="utf-8")).get("effect", ())
    return setting_from(file.stem, tables, file.parent)


def settings_of(words: Sequence[str], robot: Robot) -> tuple[Setting, ...]:
    """The worlds of names or TOML files; see ``setting_of``.

    Raises:
        InputError: see there; or two of one name.
    """
    settings = tuple(setting_of(word, robot) for word in words)
    names = [setting.name for setting in settings]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"two worlds are named {twice[0]!r}: give each once, and files other names")
    return settings


def run_cases(
    robot: Robot,
    tables: Mapping[str, Path],
    planners: Sequence[Planner],
    settings: Sequence[Setting],
    cases: Sequence[Case],
    out: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    courses: Sequence[Course] = (),
) -> dict[Case, Outcome]:
    """Run every case; not again those that ``out`` holds of the same code, tables, world and course.

    Args:
        robot: the swimmer, as the pool and the firmware have it without the effects of its file.
        tables: what planners call their table -> table image.
        planners, settings: by which the cases name theirs.
        cases: what to run.
        out: folder for results and firmware.
        workers: processes.
        progress: called with cases done and to do.
        courses: that cases name besides shapes.

    Raises:
        FrogkickError: of the robot, the pool or the tables.
    """
    libraries = {
        name: build("native", path, robot, out / f"firmware-{name}").image for name, path in tables.items()
    }
    worlds = {setting.name: setting.sha256 for setting in settings}
    ways = {course.name: course.sha256 for course in courses}

    def conditions(case: Case) -> str | None:
        return f"{worlds[case.world]} {ways.get(case.path, '')}" if case.world in worlds else None

    stamp = _stamp(robot, tables, libraries, planners)
    kept = Kept(out / "runs.jsonl", stamp, conditions)
    waiting = [case for case in cases if case not in kept.outcomes]
    given = (robot, dict(tables), libraries, tuple(planners), tuple(settings), tuple(courses))
    job = Job(_start, given, _run, _warm)
    progress(len(cases) - len(waiting), len(cases))
    for index, outcome in run_chunks(job, waiting, workers):
        kept.add(waiting[index], outcome)
        progress(sum(case in kept.outcomes for case in cases), len(cases))
    return {case: kept.outcomes[case] for case in cases}


def summaries(outcomes: Mapping[Case, Outcome]) -> list[Summary]:
    """Means over the seeds, in the order of the cases."""
    groups: dict[tuple[str, str, str], list[Outcome]] = {}
    for case, outcome in outcomes.items():
        groups.setdefault((case.world, case.path, case.planner), []).append(outcome)
    found = []
    for (world, path, planner), runs in groups.items():
        distance = np.array([run.mean_distance_m for run in runs])
        found.append(
            Summary(
                world,
                path,
                planner,
                float(distance.mean()),
                float(distance.std()),
                float(np.mean([run.progress_mps for run in runs])),
                float(np.mean([run.completed for run in runs])),
            )
        )
    return found


@dataclass(frozen=True)
class Verdict:
    """Whether looking ahead pays in one world, paths weighing alike.

    Attributes:
        world: its name.
        mean_distance_m, progress_mps: of each planner, over the paths.
        ratio_to_paper: of each planner's distance.
        missed: what was asked for and is not so, in words; empty where all is.
    """

    world: str
    mean_distance_m: dict[str, float]
    progress_mps: dict[str, float]
    ratio_to_paper: dict[str, float]
    missed: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """All that was asked for is so."""
        return not self.missed


def judge(rows: Sequence[Summary], world: str, planners: Sequence[Planner], depth: int) -> Verdict:
    """Judge the robot's planner in a world, over all paths of the rows.

    Asked are, of the robot's own cost at its own depth, at most RATIO_MOST of the paper's planner's mean
    distance at no less progress; and of the better one of depth 2 and 3, no more distance than of depth 1.

    Args:
        rows: of ``summaries``; the first planner is the paper's.
        world: its name.
        planners: all of the rows'.
        depth: the robot's own.
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
    # Compared without dividing: a planner that keeps a path exactly leaves nothing to divide by.
    if not distance_m[shipped] <= RATIO_MOST * distance_m[paper]:
        missed.append(f"{shipped} is further off than {RATIO_MOST:g} of the paper's distance")
    if not progress_mps[shipped] >= progress_mps[paper]:
        missed.append(f"{shipped} makes less progress than the paper's planner")
    if not min(distance_m[robot[2]], distance_m[robot[3]]) <= distance_m[robot[1]]:
        missed.append("neither depth 2 nor depth 3 is as near as depth 1")
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = {name: float(np.divide(value, distance_m[paper])) for name, value in distance_m.items()}
    return Verdict(world, distance_m, progress_mps, ratios, tuple(missed))


def _stamp(
    robot: Robot, tables: Mapping[str, Path], libraries: Mapping[str, Path], planners: Sequence[Planner]
) -> str:
    digest = hashlib.sha256(code_stamp("frogkick_studies").encode() + robot.sha256)
    for name in sorted(tables):
        # A native library is named after all of its sources.
        digest.update(f"{name} {libraries[name].name}\n".encode() + tables[name].read_bytes())
    digest.update(repr(planners).encode())
    return digest.hexdigest()


@dataclass(frozen=True)
class _Ready:
    robot: Robot
    tables: dict[str, Tables]
    libraries: dict[str, Path]
    planners: dict[str, Planner]
    settings: dict[str, Setting]
    courses: dict[str, Course]


def _start(
    robot: Robot,
    tables: dict[str, Path],
    libraries: dict[str, Path],
    planners: tuple[Planner, ...],
    settings: tuple[Setting, ...],
    courses: tuple[Course, ...],
) -> _Ready:
    return _Ready(
        robot,
        {name: read_image(path) for name, path in tables.items()},
        libraries,
        {planner.name: planner for planner in planners},
        {setting.name: setting for setting in settings},
        {course.name: course for course in courses},
    )


def _warm(ready: _Ready) -> None:
    Pool(ready.robot, (0.0, 0.0, 0.0), Camera(), np.random.default_rng(0)).advance(0.01)


def _run(ready: _Ready, case: Case) -> Outcome:
    planner = ready.planners[case.planner]
    course = ready.courses.get(case.path) or course_of(case.path)
    world, rng = ready.settings[case.world].world(), np.random.default_rng(case.seed)
    pool = Pool(ready.robot, course.start_world, Camera(), rng, world)
    recording = run_in_pool(
        NativeRobot(ready.libraries[planner.table], len(ready.robot.limbs)),
        pool,
        ready.tables[planner.table],
        course.path,
        RunOptions(planner.config, time_limit_s=TIME_LIMIT_S),
    )
    tracked = tracking_of_recording(recording, pool, ready.robot, course.path)
    return Outcome(
        tracked.mean_distance_m,
        tracked.progress_mps,
        recording.completed,
        recording.ended,
        tracked.decisions,
    )
