"""Does looking ahead pay? Planners in the simulated pool, over paths, seeds and worlds no model knows."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.chunks import Job, code_stamp, run_chunks
from frogkick.effects import World
from frogkick.effects.registry import make_effects
from frogkick.files import write_text
from frogkick.loop.closed_loop import RunOptions, run_in_pool
from frogkick.loop.record import tracking_of_recording
from frogkick.paths import shape
from frogkick.planner.image import Tables, read_image
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.pool.camera import Camera
from frogkick.pool.native_robot import NativeRobot
from frogkick.pool.pool import Pool
from frogkick.robot import Robot
from frogkick_codegen.firmware import build

TIME_LIMIT_S = 120.0
PAPER, ROBOT = "paper", "robot"
HIDDEN = (
    {"name": "limb_wear", "limb": "front_left", "gain": 0.85},
    {"name": "limb_memory", "loss": 0.2, "fade_s": 1.5},
    {"name": "warm_up", "loss": 0.3, "fade_strokes": 2.0},
    {"name": "steady_current", "x_mps": 0.002, "y_mps": 0.003},
)
"""What is true in the world "hidden" and in no table: of a size that recorded runs show."""
WORLDS: Mapping[str, Sequence[Mapping[str, Any]]] = {"nominal": (), "hidden": HIDDEN}


@dataclass(frozen=True)
class Planner:
    """One of the planners that are compared.

    Attributes:
        name: for reports.
        table: PAPER (every state of the paper's, nearest) or ROBOT.
        config: cost, weights, depth.
    """

    name: str
    table: str
    config: PlanConfig


@dataclass(frozen=True)
class Case:
    """One run: names of its world, path and planner, and the seed of the camera's noise."""

    world: str
    path: str
    planner: str
    seed: int

    @property
    def key(self) -> str:
        """Names it in the file of results."""
        return f"{self.world}/{self.path}/{self.planner}/{self.seed}"


@dataclass(frozen=True)
class Outcome:
    """What a run gave; see ``frogkick.loop.record.Tracking``."""

    mean_distance_m: float
    progress_mps: float
    completed: bool
    ended: str
    decisions: int


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
        *(Planner(f"robot, depth {d}", ROBOT, dataclasses.replace(own, depth=d)) for d in (1, 2, 3)),
    )


def run_cases(
    robot: Robot,
    tables: Mapping[str, Path],
    planners: Sequence[Planner],
    cases: Sequence[Case],
    out: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> dict[Case, Outcome]:
    """Run every case; those that ``out`` holds already, of the same code and tables, are not run again.

    Args:
        robot: the swimmer, in the pool and in the tables.
        tables: PAPER and ROBOT -> table image.
        planners: by which the cases name theirs.
        cases: what to run.
        out: folder for results and firmware.
        workers: processes.
        progress: called with cases done and to do.

    Raises:
        FrogkickError: of the robot, the pool or the tables.
    """
    images = {name: path.read_bytes() for name, path in tables.items()}
    stamp = _stamp(robot, images, planners)
    kept = _Kept(out / "runs.jsonl", stamp)
    libraries = {
        name: build("native", path, robot, out / f"firmware-{name}").image for name, path in tables.items()
    }
    waiting = [case for case in cases if case.key not in kept.outcomes]
    job = Job(_start, (robot, dict(tables), libraries, tuple(planners)), _run, _warm)
    progress(len(cases) - len(waiting), len(cases))
    for index, outcome in run_chunks(job, waiting, workers):
        kept.add(waiting[index], outcome)
        progress(sum(case.key in kept.outcomes for case in cases), len(cases))
    return {case: kept.outcomes[case.key] for case in cases}


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


def over_paths(
    rows: Iterable[Summary], world: str, planner: str, paths: Sequence[str]
) -> tuple[float, float]:
    """Mean distance (m) and progress (m/s) of a planner in a world, paths weighing alike."""
    picked = [row for row in rows if (row.world, row.planner) == (world, planner) and row.path in paths]
    return (
        float(np.mean([row.mean_distance_m for row in picked])),
        float(np.mean([row.progress_mps for row in picked])),
    )


def _stamp(robot: Robot, images: Mapping[str, bytes], planners: Sequence[Planner]) -> str:
    digest = hashlib.sha256(code_stamp().encode() + robot.sha256)
    for name in sorted(images):
        digest.update(name.encode() + b"\0" + images[name])
    digest.update(repr(planners).encode() + json.dumps(WORLDS, sort_keys=True).encode())
    return digest.hexdigest()


class _Kept:
    """Results in a file, a line each; the first line says what they are of."""

    def __init__(self, file: Path, stamp: str) -> None:
        self.outcomes: dict[str, Outcome] = {}
        self._file = file
        lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
        if lines[:1] == [json.dumps({"stamp": stamp})]:
            for line in lines[1:]:
                values = _read_line(line)
                if values is not None:
                    self.outcomes[str(values.pop("key"))] = Outcome(**values)
        else:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_text(file, json.dumps({"stamp": stamp}) + "\n")

    def add(self, case: Case, outcome: Outcome) -> None:
        """Keep a result."""
        self.outcomes[case.key] = outcome
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": case.key, **dataclasses.asdict(outcome)}) + "\n")


def _read_line(line: str) -> dict[str, Any] | None:
    """A kept result; None where a stop cut the line."""
    try:
        values = json.loads(line)
    except json.JSONDecodeError:
        return None
    return values if isinstance(values, dict) else None


@dataclass(frozen=True)
class _Ready:
    robot: Robot
    tables: dict[str, Tables]
    libraries: dict[str, Path]
    planners: dict[str, Planner]


def _start(
    robot: Robot, tables: dict[str, Path], libraries: dict[str, Path], planners: tuple[Planner, ...]
) -> _Ready:
    opened = {name: read_image(path) for name, path in tables.items()}
    return _Ready(robot, opened, libraries, {planner.name: planner for planner in planners})


def _warm(ready: _Ready) -> None:
    pool = _pool(ready.robot, "line", "nominal", 0)
    pool.advance(0.01)


def _pool(robot: Robot, path_name: str, world: str, seed: int) -> Pool:
    path = shape(path_name)
    start = (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0]))
    effects = World(make_effects(WORLDS[world], Path()))
    return Pool(robot, start, Camera(), np.random.default_rng(seed), effects)


def _run(ready: _Ready, case: Case) -> Outcome:
    planner, path = ready.planners[case.planner], shape(case.path)
    pool = _pool(ready.robot, case.path, case.world, case.seed)
    recording = run_in_pool(
        NativeRobot(ready.libraries[planner.table], len(ready.robot.limbs)),
        pool,
        ready.tables[planner.table],
        path,
        RunOptions(planner.config, time_limit_s=TIME_LIMIT_S),
    )
    tracked = tracking_of_recording(recording, pool, ready.robot, path)
    return Outcome(
        tracked.mean_distance_m,
        tracked.progress_mps,
        recording.completed,
        recording.ended,
        tracked.decisions,
    )
