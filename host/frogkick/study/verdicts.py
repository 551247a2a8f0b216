"""Are verdicts right? Worlds with planted effects, identified from runs alone, and counted.

Each case makes runs of the simulated robot along the paper's paths in a world that identification never
sees: nothing planted, one effect of the catalogue with random parameters, two at once, or an effect of a
user's own file that the catalogue does not have.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.chunks import Job, code_stamp, run_chunks
from frogkick.effects import World
from frogkick.effects.registry import make_effects
from frogkick.files import write_text
from frogkick.identify.outcome import Outcome, identify
from frogkick.identify.swim import Swim, swim_of
from frogkick.identify.verdict import FOUND, NOTHING, UNEXPLAINED
from frogkick.loop.closed_loop import RunOptions, robot_plan_config, run_in_pool
from frogkick.loop.record import run_log
from frogkick.paths import shape
from frogkick.planner.image import Tables, read_image
from frogkick.pool.camera import Camera
from frogkick.pool.native_robot import NativeRobot
from frogkick.pool.pool import Pool
from frogkick.robot import Robot
from frogkick_codegen.firmware import build

Table = dict[str, Any]

TRAIN, TEST = ("sine", "ellipse", "line"), ("ellipse",)
TIME_LIMIT_S = 60.0

NULL, ONE, TWO, OUTSIDE = "nothing", "one", "two", "outside"

OUTSIDE_FILE = "outside.py"
OUTSIDE_TEXT = '''"""Effects that the catalogue does not have."""

import math


class HeadingGain:
    def __init__(self, depth, towards_rad):
        self.depth, self.towards_rad, self.heading_rad = depth, towards_rad, 0.0

    def wrench(self, time_s, body):
        self.heading_rad = body.pose_world[2]
        return 0.0, 0.0, 0.0

    def stroke(self, stroke, history, rng):
        stroke.gain *= 1.0 - self.depth * 0.5 * (1.0 + math.cos(self.heading_rad - self.towards_rad))


class ClockGain:
    def __init__(self, depth, period_s):
        self.depth, self.period_s = depth, period_s

    def stroke(self, stroke, history, rng):
        stroke.gain *= 1.0 - self.depth * 0.5 * (1.0 + math.sin(math.tau * stroke.time_s / self.period_s))


class Weeds:
    """Water that resists here and there."""

    def __init__(self, drag, pitch_m):
        self.drag, self.pitch_m = drag, pitch_m

    def wrench(self, time_s, body):
        x, y, _ = body.pose_world
        here = 0.5 * (1.0 + math.sin(math.tau * x / self.pitch_m) * math.cos(math.tau * y / self.pitch_m))
        forward, left, _ = body.velocity_body
        return -self.drag * here * forward, -self.drag * here * left, 0.0


class Waves:
    def __init__(self, speed_mps, period_s):
        self.speed_mps, self.period_s = speed_mps, period_s

    def flow(self, time_s, position_world_m):
        return self.speed_mps * math.sin(math.tau * time_s / self.period_s), 0.0


class Whirl:
    def __init__(self, turns_per_s):
        self.turns_per_s = turns_per_s

    def flow(self, time_s, position_world_m):
        x, y = position_world_m
        return -y * self.turns_per_s, x * self.turns_per_s


class SlowLens:
    """A camera that is off to one side of its picture."""

    def __init__(self, bend_per_m):
        self.bend_per_m = bend_per_m

    def fix(self, fix, rng):
        fix.x_m += self.bend_per_m * fix.x_m * fix.x_m
        fix.heading_rad += 0.5 * self.bend_per_m * fix.y_m
        return fix
'''


@dataclass(frozen=True)
class Kind:
    """A way to plant something.

    Attributes:
        name: for reports.
        group: NULL, ONE, TWO or OUTSIDE.
        draw: tables of a world, from a random generator.
        alike: titles of effects that are the same thing under another name.
    """

    name: str
    group: str
    draw: Callable[[np.random.Generator], list[Table]]
    alike: tuple[str, ...] = ()


@dataclass(frozen=True)
class Case:
    """A kind by its name, and a seed for its parameters and the camera's noise."""

    kind: str
    seed: int

    @property
    def key(self) -> str:
        """Names it in the file of results."""
        return f"{self.kind}/{self.seed}"


@dataclass(frozen=True)
class Result:
    """What came of a case.

    Attributes:
        verdict: as given.
        right: as asked for this group.
        wrong: "found" although what was planted is not what was named.
        planted, found: in words.
        before, after, floor: position (m) and heading (rad) on the test run.
        cpu_s: of identification.
    """

    verdict: str
    right: bool
    wrong: bool
    planted: list[str]
    found: list[str]
    before: list[float]
    after: list[float]
    floor: list[float]
    periods: int
    cpu_s: float


LIMBS = ("front_left", "front_right", "rear_left", "rear_right")


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.round(rng.uniform(low, high), 5))


def _wear(rng: np.random.Generator) -> Table:
    return {"name": "limb_wear", "limb": str(rng.choice(LIMBS)), "gain": _between(rng, 0.6, 0.9)}


def _slow(rng: np.random.Generator) -> Table:
    limb, slow = str(rng.choice(LIMBS)), _between(rng, 1.5, 2.5)
    return {"name": "limb_wear", "limb": limb, "gain": _between(rng, 0.75, 0.95), "duration_scale": slow}


def _current(rng: np.random.Generator) -> Table:
    speed, way = rng.uniform(0.003, 0.01), rng.uniform(-np.pi, np.pi)
    x, y = float(np.round(speed * np.cos(way), 5)), float(np.round(speed * np.sin(way), 5))
    return {"name": "steady_current", "x_mps": x, "y_mps": y}


def _latency(rng: np.random.Generator) -> Table:
    return {"name": "fix_latency", "delay_s": _between(rng, 0.06, 0.15)}


def _tag(rng: np.random.Generator) -> Table:
    ahead, left, turn = (_sign(rng) * _between(rng, *ends) for ends in ((0, 0.02), (0, 0.02), (0.06, 0.2)))
    return {"name": "tag_offset", "forward_m": ahead, "left_m": left, "turn_rad": turn}


def _yaw(rng: np.random.Generator) -> Table:
    return {"name": "yaw_drag", "linear_nms": _between(rng, 2e-4, 1e-3)}


def _warm(rng: np.random.Generator) -> Table:
    return {"name": "warm_up", "loss": _between(rng, 0.3, 0.6), "fade_strokes": _between(rng, 2.0, 5.0)}


def _memory(rng: np.random.Generator) -> Table:
    return {"name": "limb_memory", "loss": _between(rng, 0.2, 0.5), "fade_s": _between(rng, 1.0, 3.0)}


def _sag(rng: np.random.Generator) -> Table:
    return {"name": "battery_sag", "loss_per_min": _between(rng, 0.2, 0.4)}


def _centre(rng: np.random.Generator) -> Table:
    return {"name": "centre_mass", "share": _between(rng, 0.2, 0.6)}


def _drag(rng: np.random.Generator) -> Table:
    return {"name": "drag_scale", "frame": _between(rng, 1.3, 2.0)}


def _scale(rng: np.random.Generator) -> Table:
    return {"name": "camera_scale", "scale": 1.0 + _sign(rng) * _between(rng, 0.03, 0.08)}


def _mine(kind: str, **values: float) -> list[Table]:
    return [{"file": OUTSIDE_FILE, "class": kind, **values}]


ONES: Mapping[str, Callable[[np.random.Generator], Table]] = {
    "wear": _wear,
    "slow limb": _slow,
    "current": _current,
    "latency": _latency,
    "tag": _tag,
    "yaw drag": _yaw,
    "warm-up": _warm,
    "memory": _memory,
    "sag": _sag,
    "centre mass": _centre,
    "drag": _drag,
    "scale": _scale,
}
PAIRS = (
    ("wear", "current"),
    ("wear", "latency"),
    ("current", "tag"),
    ("yaw drag", "wear"),
    ("memory", "current"),
    ("drag", "wear"),
)


def _drawn(names: Sequence[str], rng: np.random.Generator) -> list[Table]:
    return [ONES[name](rng) for name in names]


def kinds() -> dict[str, Kind]:
    """All ways to plant something, by name."""
    every = [Kind("null", NULL, lambda _rng: [])]
    every += [Kind(name, ONE, partial(_drawn, (name,))) for name in ONES]
    every += [Kind(" + ".join(pair), TWO, partial(_drawn, pair)) for pair in PAIRS]
    every += [
        Kind(
            "heading gain",
            OUTSIDE,
            lambda rng: _mine(
                "HeadingGain", depth=_between(rng, 0.2, 0.5), towards_rad=_between(rng, -3.0, 3.0)
            ),
        ),
        Kind(
            "clock gain",
            OUTSIDE,
            lambda rng: _mine("ClockGain", depth=_between(rng, 0.2, 0.5), period_s=_between(rng, 8.0, 20.0)),
        ),
        Kind(
            "weeds",
            OUTSIDE,
            lambda rng: _mine("Weeds", drag=_between(rng, 0.1, 0.5), pitch_m=_between(rng, 0.2, 0.4)),
        ),
        Kind(
            "waves",
            OUTSIDE,
            lambda rng: _mine(
                "Waves", speed_mps=_between(rng, 0.005, 0.02), period_s=_between(rng, 6.0, 15.0)
            ),
        ),
        Kind(
            "whirl",
            OUTSIDE,
            lambda rng: _mine("Whirl", turns_per_s=_sign(rng) * _between(rng, 0.01, 0.05)),
            ("shear_current", "vortex"),
        ),
        Kind("lens", OUTSIDE, lambda rng: _mine("SlowLens", bend_per_m=_between(rng, 0.1, 0.3))),
    ]
    return {kind.name: kind for kind in every}


def run_cases(
    robot: Robot,
    tables: Path,
    cases: Sequence[Case],
    out: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> dict[Case, Result]:
    """Run every case; those that ``out`` holds already, of the same code, are not run again.

    Args:
        robot: nominal.
        tables: what the robot plans with.
        cases: what to run.
        out: folder for results, firmware and the outside effects' file.
        workers: processes.
        progress: called with cases done and to do.

    Raises:
        FrogkickError: of the robot, the pool or the tables.
    """
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / OUTSIDE_FILE, OUTSIDE_TEXT)
    library = build("native", tables, robot, out / "firmware").image
    stamp = json.dumps({"stamp": code_stamp(), "robot": robot.sha256.hex()})
    file = out / "cases.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    kept: dict[str, Result] = {}
    if lines[:1] == [stamp]:
        for line in lines[1:]:
            values = json.loads(line)
            kept[values.pop("key")] = Result(**values)
    else:
        write_text(file, stamp + "\n")
    waiting = [case for case in cases if case.key not in kept]
    progress(len(cases) - len(waiting), len(cases))
    job = Job(_start, (robot, tables, library, out), _run, lambda _ready: None)
    for index, result in run_chunks(job, waiting, workers):
        kept[waiting[index].key] = result
        with file.open("a", encoding="utf-8") as target:
            target.write(json.dumps({"key": waiting[index].key, **dataclasses.asdict(result)}) + "\n")
        progress(sum(case.key in kept for case in cases), len(cases))
    return {case: kept[case.key] for case in cases}


@dataclass(frozen=True)
class _Ready:
    robot: Robot
    tables: Tables
    library: Path
    folder: Path


def _start(robot: Robot, tables: Path, library: Path, folder: Path) -> _Ready:
    return _Ready(robot, read_image(tables), library, folder)


def swims_of(ready: _Ready, planted: Sequence[Table], seed: int, paths: Sequence[str]) -> list[Swim]:
    """Runs of the simulated robot along paths in a world, as identification reads them from logs."""
    swims = []
    for index, name in enumerate(paths):
        path = shape(name)
        start = (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0]))
        world = World(make_effects(planted, ready.folder))
        pool = Pool(ready.robot, start, Camera(), np.random.default_rng([seed, index]), world)
        options = RunOptions(robot_plan_config(ready.robot), time_limit_s=TIME_LIMIT_S)
        port = NativeRobot(ready.library, len(ready.robot.limbs))
        recording = run_in_pool(port, pool, ready.tables, path, options)
        log = run_log(recording, pool, ready.robot, ready.tables, path, options, seed, "study verdicts")
        swims.append(swim_of(dataclasses.replace(log, truth=None), f"{name}-{index}", ready.robot))
    return swims


def _run(ready: _Ready, case: Case) -> Result:
    kind = kinds()[case.kind]
    seed = [case.seed, *case.kind.encode()]
    planted = kind.draw(np.random.default_rng(seed))
    every = swims_of(ready, planted, case.seed, [*TRAIN, *TEST])
    begun_s = time.process_time()
    outcome = identify(every[: len(TRAIN)], every[len(TRAIN) :], ready.robot)
    return judged(kind, planted, outcome, time.process_time() - begun_s)


def judged(kind: Kind, planted: Sequence[Table], outcome: Outcome, cpu_s: float) -> Result:
    """Hold an outcome against what was planted."""
    named = [recovered(table, outcome) for table in planted]
    titles = {term.name for term in outcome.terms}
    equivalent = bool(kind.alike) and outcome.verdict == FOUND and titles <= set(kind.alike)
    if kind.group == NULL:
        right = outcome.verdict == NOTHING
        wrong = outcome.verdict == FOUND
    elif kind.group == OUTSIDE:
        right = outcome.verdict == UNEXPLAINED or equivalent
        wrong = outcome.verdict == FOUND and not equivalent
    else:
        right = outcome.verdict == FOUND and all(named)
        wrong = outcome.verdict == FOUND and not all(named)
    before, after, floor = (
        [error.position_rmse_m, error.heading_rmse_rad]
        for error in (outcome.tested.before, outcome.tested.after, outcome.tested.noise_floor)
    )
    return Result(
        outcome.verdict,
        right,
        wrong,
        [_words(table) for table in planted],
        [
            f"{term.title}: "
            + ", ".join(f"{p.name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}]" for p in row)
            + (f" (or {', '.join(others)})" if others else "")
            for term, row, others in zip(
                outcome.terms, outcome.parameters, outcome.found.alike if outcome.found else [], strict=True
            )
        ],
        before,
        after,
        floor,
        sum(len(swim.start_s) for swim in outcome.train),
        cpu_s,
    )


def _words(table: Table) -> str:
    values = ", ".join(
        f"{key} {value}" for key, value in table.items() if key not in ("name", "file", "class")
    )
    return f"{table.get('name') or table.get('class')}: {values}"


def recovered(table: Table, outcome: Outcome) -> bool:
    """An effect is among those found, and all its planted parameters are inside their intervals."""
    for term, row in zip(outcome.terms, outcome.parameters, strict=True):
        options = dict(term.table)
        same = all(options[key] == table[key] for key in options if key in table)
        if term.name == table.get("name") and same:
            return all(p.low <= float(table.get(p.name, _nominal(term, p.name))) <= p.high for p in row)
    return False


def _nominal(term: Any, name: str) -> float:
    return next(float(p.nominal) for p in term.parameters if p.name == name)
