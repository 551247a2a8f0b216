"""How often verdicts are right: synthetic effects in simulated worlds, identified from runs alone.

Each case makes runs of the simulated robot along the paper's paths in a world that identification never
reads: with no effect, one effect of the catalogue with random parameters, two at once, an effect of a user's
own file that the catalogue does not contain, or one or two effects that a law can describe. For the last
group laws are searched as well, and the right kind must be named.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.chunks import Job, run_chunks
from frogkick.core.errors import FrogkickError, InputError
from frogkick.core.files import write_text
from frogkick.core.progress import shown
from frogkick.effects import World
from frogkick.effects.registry import make_effects
from frogkick.front.tables import robot_of_table, table_image
from frogkick.identification import search
from frogkick.identification.batching import cpu_s, run_concurrently
from frogkick.identification.fit import rollouts_of
from frogkick.identification.outcome import identify
from frogkick.identification.segments import Segments, segments_of
from frogkick.identification.verdict import scored
from frogkick.paths import shape
from frogkick.planner.plan import config_of
from frogkick.pool.native_robot import NativeRobot
from frogkick.report import style
from frogkick.robot import Robot
from frogkick.runs.closed_loop import run_in_pool
from frogkick.runs.record import RunOptions
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.firmware import build, require_tools
from frogkick_studies import StudyResult
from frogkick_studies.configs import Verdicts
from frogkick_studies.in_pool import Lines, stamp_of
from frogkick_studies.scoring import Result, score_case
from frogkick_studies.synthetic_effects import (
    LAWS,
    NULL,
    ONE,
    OUTSIDE,
    OUTSIDE_FILE,
    OUTSIDE_TEXT,
    TWO,
    Kind,
    kinds,
)
from frogkick_studies.synthetic_laws import LAWS_FILE, LAWS_TEXT, Table, enough_of

LEAST = {NULL: 0.95, ONE: 0.95, TWO: 0.95, OUTSIDE: 0.95, LAWS: 0.8}
"""Share of the cases of a group that must be right."""

MOST_WRONG = {NULL: 0.02, ONE: 0.02, TWO: 0.02, OUTSIDE: 0.02, LAWS: 0.03}  # share that may be wrongly found

GONE, LEAST_GONE = 0.7, 0.85
"""Laws: share of the error above the noise floor that must be removed, in this share of the cases."""

OVER_FLOOR = (2.0, 20.0)
"""Laws are drawn again until the nominal model's position error on the test run is in this range.

It is in noise floors. The training runs must contain enough of the effect, too."""

DRAWS_MOST = 40  # after this many draws the last one is used

TRAIN, TEST = ("sine", "ellipse", "line"), ("bends",)
MORE = {LAWS: ("circle",)}  # group -> further training paths: laws have four runs

HURRY = 0.5
"""Share of the planner's progress weight on the test path, for other actions in another order, and slower."""
TIME_LIMIT_S = 60.0

GROUP = 24
"""Cases that a process does before their results are written: towards its end batches are less full."""


@dataclass(frozen=True)
class Case:
    """A kind by its name, and a seed for its parameters and the camera's noise."""

    kind: str
    seed: int

    @property
    def key(self) -> str:
        """Names it in the file of results."""
        return f"{self.kind}/{self.seed}"


def run_cases(
    robot: Robot,
    tables: Path,
    cases: Sequence[Case],
    out: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    laws: bool = False,
) -> dict[Case, Result]:
    """Run every case; those that ``out`` holds already, of the same code, are not run again.

    Args:
        tables: what the robot plans with.
        out: folder for results, firmware and the outside effects' file.
        laws: search laws in all groups.
    """
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / OUTSIDE_FILE, OUTSIDE_TEXT)
    write_text(out / LAWS_FILE, LAWS_TEXT)
    library = build("native", tables, robot, out / "firmware").image
    head = {"stamp": stamp_of(robot, [tables.read_bytes()]), "laws": str(laws)}
    lines = Lines(out / "cases.jsonl", head)
    kept = {values["key"]: Result(**values["result"]) for values in lines.values}
    waiting = [case for case in cases if case.key not in kept]
    progress(len(cases) - len(waiting), len(cases))
    size = max(1, min(GROUP, -(-len(waiting) // workers)))
    groups = [waiting[first : first + size] for first in range(0, len(waiting), size)]
    job = Job(_start, (robot, tables, library, out, laws), _run, lambda _ready: None)
    for index, results in run_chunks(job, groups, workers):
        for case, result in zip(groups[index], results, strict=True):
            kept[case.key] = result
            lines.add({"key": case.key, "result": dataclasses.asdict(result)})
        progress(sum(case.key in kept for case in cases), len(cases))
    return {case: kept[case.key] for case in cases}


@dataclass(frozen=True)
class _Ready:
    robot: Robot
    tables: Tables
    library: Path
    folder: Path
    laws: bool


def _start(robot: Robot, tables: Path, library: Path, folder: Path, laws: bool) -> _Ready:
    return _Ready(robot, read_image(tables), library, folder, laws)


def swims_of(ready: _Ready, planted: Sequence[Table], seed: int, paths: Sequence[str]) -> list[Segments]:
    """Runs of the simulated robot along paths in a world, as identification reads them from logs."""
    swims, source = [], "study verdicts"
    for index, name in enumerate(paths):
        world = World(make_effects(planted, ready.folder))
        config = config_of(ready.robot.planner)
        if name in TEST:
            hurry = HURRY * config.progress_weight_per_m
            config = dataclasses.replace(config, progress_weight_per_m=hurry)
        options = RunOptions(config, time_limit_s=TIME_LIMIT_S)
        port = NativeRobot(ready.library, len(ready.robot.limbs))
        swum = run_in_pool(
            port, ready.tables, ready.robot, shape(name), options, [seed, index], source, world
        )
        log = swum.log()
        swims.append(segments_of(dataclasses.replace(log, truth=None), f"{name}-{index}", ready.robot))
    return swims


def _run(ready: _Ready, cases: Sequence[Case]) -> list[Result]:
    """Several cases, their simulations in shared batches: each comes out as it would alone."""
    found: list[Result | None] = [None] * len(cases)
    for index, result in run_concurrently([partial(_run_one, ready, case) for case in cases]):
        found[index] = result
    return [result for result in found if result is not None]


def _run_one(ready: _Ready, case: Case) -> Result:
    kind = kinds()[case.kind]
    seed = [case.seed, *case.kind.encode()]
    planted, train, test, draws = _drawn(ready, case, kind, np.random.default_rng(seed))
    begun_s = cpu_s()
    outcome = identify(train, test, ready.robot, laws=ready.laws or kind.group == LAWS)
    return dataclasses.replace(score_case(kind, planted, outcome, cpu_s() - begun_s), draws=draws)


def _drawn(
    ready: _Ready, case: Case, kind: Kind, rng: np.random.Generator
) -> tuple[list[Table], list[Segments], list[Segments], int]:
    """A world of a kind, its training and test runs, and how often it was drawn."""
    learned = [*TRAIN, *MORE.get(kind.group, ())]
    names = [limb.name for limb in ready.robot.limbs]
    for draws in range(1, DRAWS_MOST + 1):
        planted = kind.draw(rng)
        try:
            every = swims_of(ready, planted, case.seed, [*learned, *TEST])
            train, test = every[: len(learned)], every[len(learned) :]
            low, high = OVER_FLOOR
            if kind.group != LAWS:
                break
            if enough_of(planted, train, names) and low <= error_over_floor(train, test, ready.robot) <= high:
                break
        except FrogkickError:  # such as a robot that is pulled out of the camera's sight
            if kind.group != LAWS or draws == DRAWS_MOST:
                raise
    return planted, train, test, draws


def error_over_floor(train: Sequence[Segments], test: Sequence[Segments], robot: Robot) -> float:
    """The nominal model's position error on the test runs, in noise floors, as identification reports it."""
    data, nominal = search.nominal_fit(train, robot)
    (rollouts,) = rollouts_of([nominal.model], test)
    both = scored(search.Found(data, nominal, nominal), test, rollouts, rollouts)
    return both.before.position_rmse_m / both.noise_floor.position_rmse_m


@dataclass(frozen=True, eq=False)
class VerdictStudy(StudyResult):
    """Synthetic effects in simulated pools, and the results of identification."""

    results: Mapping[Case, Result]

    @property
    def groups(self) -> dict[str, dict[str, Any]]:
        """Group of kinds -> its counts.

        They are: cases, right ones, wrongly found ones, true parameters of identified effects, how many of
        these are inside their intervals, and whether the requirements are met; for laws also in how many
        cases enough of the error is removed.
        """
        known, found = kinds(), {}
        for group, least in LEAST.items():
            some = [result for case, result in self.results.items() if known[case.kind].group == group]
            if some:
                right, wrong = sum(result.right for result in some), sum(result.wrong for result in some)
                found[group] = {
                    "cases": len(some),
                    "right": right,
                    "wrongly_found": wrong,
                    "parameters": sum(result.parameters for result in some),
                    "inside": sum(result.inside for result in some),
                    "passed": right >= least * len(some) and wrong <= MOST_WRONG[group] * len(some),
                }
                if group == LAWS:
                    gone = sum(result.gone is not None and result.gone >= GONE for result in some)
                    found[group]["gone"] = gone
                    found[group]["passed"] &= gone >= LEAST_GONE * len(some)
        return found

    @property
    def passed(self) -> bool:
        """Whether in every group enough are right."""
        return all(group["passed"] for group in self.groups.values())

    def plot(self) -> Figure:
        """A matplotlib figure: verdicts and errors by kind."""
        return verdicts_figure(self.results)

    def as_json(self) -> dict[str, Any]:
        """Return the groups' counts, and the result of each case."""
        return {
            "groups": self.groups,
            "cases": [
                {"kind": case.kind, "seed": case.seed, **result.as_json()}
                for case, result in self.results.items()
            ],
        }

    def text(self, values: dict[str, Any]) -> str:
        """Return a line for each case, and one for each group of kinds."""
        lines = []
        for case, result in self.results.items():
            errors = " / ".join(
                f"{1e3 * position:.2f} mm {57.29578 * heading:.2f} deg"
                for position, heading in (result.before, result.after, result.floor)
            )
            lines.append(
                f"{'ok' if result.right else 'NO'} {case.key}: "
                f"true {'; '.join(result.planted) or 'no effect'}; {result.verdict}: "
                f"{'; '.join(result.found) or 'no effect'}; {errors}; {result.cpu_s:.0f} s"
                + (f"; drawn {result.draws} times" if result.draws > 1 else "")
            )
        lines += [
            f"{name}: {group['right']} of {group['cases']} right, {group['wrongly_found']} wrongly found, "
            f"{group['inside']} of {group['parameters']} parameters inside their intervals"
            + (f", {group['gone']} with {100.0 * GONE:.0f} % of the error removed" if "gone" in group else "")
            for name, group in self.groups.items()
        ]
        return "\n".join(lines)


def run(config: Verdicts) -> VerdictStudy:
    """Put synthetic effects in simulated pools, identify them from the runs, and count the verdicts."""
    known = kinds()
    for name in config.kind or ():
        if name not in known:
            raise InputError(f"--kind is {name!r}: choose from {', '.join(known)}")
    require_tools("native")
    image = table_image(config.tables, None)
    robot = robot_of_table(image, None)
    wanted = cases_of(config.kind or list(known), config.first, config.seeds, config.cases)
    with shown(True, "cases") as tell:
        return VerdictStudy(
            run_cases(
                robot, image, wanted, config.out, config.workers or os.cpu_count() or 1, tell, config.laws
            )
        )


def cases_of(names: Sequence[str], first: int, seeds: int, each: int | None) -> list[Case]:
    """Cases of some kinds: ``seeds`` of each kind, or ``each`` of each group, its kinds in turn."""
    if each is None:
        return [Case(name, seed) for seed in range(first, first + seeds) for name in names]
    found = []
    for group in LEAST:
        some = [name for name in names if kinds()[name].group == group]
        found += [Case(some[k % len(some)], first + k // len(some)) for k in range(each if some else 0)]
    return found


def verdicts_figure(results: Mapping[Case, Result]) -> Figure:
    """Left: share of right verdicts for each kind. Right: errors over the noise floor, before and after."""
    names = list(dict.fromkeys(case.kind for case in results))
    place = np.arange(len(names))[::-1]
    with style.styled():
        figure = Figure(figsize=(11.0, 2.2 + 0.28 * len(names)), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for at, name in zip(place, names, strict=True):
            some = [result for case, result in results.items() if case.kind == name]
            share = 100.0 * float(np.mean([result.right for result in some]))
            wrong = 100.0 * float(np.mean([result.wrong for result in some]))
            left.barh(at, share, 0.7, color=style.TRUE, label="right" if at == place[0] else None)
            left.barh(at, wrong, 0.3, color=style.ALARM, label="wrongly found" if at == place[0] else None)
            left.text(2.0, at, str(len(some)), va="center", color="white", fontsize=7)
            for errors, colour, label in (
                ("before", style.DESIRED, "nominal"),
                ("after", style.TRUE, "with identified effects"),
            ):
                over = [getattr(result, errors)[0] / result.floor[0] for result in some]
                right.plot(
                    over,
                    np.full(len(over), at),
                    "|",
                    color=colour,
                    markersize=9,
                    label=label if at == place[0] else None,
                )
        left.axvline(95.0, color=style.DESIRED, linestyle="--", linewidth=0.8)
        left.set_xlim(0.0, 100.0)
        left.set_yticks(place, names)
        left.set_xlabel("of the cases, % (white: how many)")
        left.set_title("Verdicts")
        left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.6 / figure.get_figheight()), ncols=2)
        right.axvline(1.0, color=style.ALARM, linestyle="--", linewidth=0.8)
        right.set_xscale("log")
        right.set_xlabel("position error one period ahead / noise floor (test runs)")
        right.set_title("Errors before and after")
        right.set_xlim(0.5, None)
        right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.6 / figure.get_figheight()), ncols=2)
    return figure
