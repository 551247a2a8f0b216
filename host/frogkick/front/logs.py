"""Runs that are over: their logs in memory and in files, and what can be done with them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frogkick.core.arguments import typed
from frogkick.core.errors import EXTRAS, InputError, require
from frogkick.core.files import require_writable
from frogkick.core.progress import Progress, shown, tell_line
from frogkick.report.style import page_of
from frogkick.robot import Robot, built_in_robots, load_robot, parse_robot
from frogkick.runs import summary as summaries
from frogkick.runs.export_csv import columns_of, export_csv
from frogkick.runs.recorded.importer import import_recorded
from frogkick.runs.recorded.importer import load_run as load_log
from frogkick.runs.runlog import RunLog, Tracking
from frogkick.runs.runlog_file import write_run
from frogkick.runs.summary import Comparison, Summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from frogkick.identification.segments import Segments


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Run(RunLog):
    """One closed-loop run: its log, how well the path was followed, and what can be done with it.

    An ``InputError`` is raised for a number that needs a decision or a fix which the run does not have, for a
    file that cannot be written, and for a package that is not installed.

    Attributes:
        robot_id: id of the robot.
        source: name of the file or program that the run comes from.
        fixes, decisions, strokes: the columns of the log, see the reference of run logs.
        path, then: the path from the first decision on, and those that took over.
        truth: the true motion in a simulated pool; None for a real robot.
        measured, planner, made: numbers about the run, the planner's settings, and the provenance of the log.
        checked: number of decisions that agreed, if robot and host both decided.
    """

    checked: Mapping[str, Any] = field(default_factory=dict)

    @property
    def log(self) -> RunLog:
        """The run itself: fixes, decisions, strokes, path, and the true motion of a simulated pool."""
        return self

    @cached_property
    def tracking(self) -> Tracking:
        """Distances to the path (m), progress (m/s), counts."""
        return summaries.tracking_of_log(self)

    @property
    def ended(self) -> str:
        """The reason why it ended, in words."""
        return self.notes

    @cached_property
    def actions(self) -> tuple[str, ...]:
        """The action of each decision, by name; "?" if it is not known."""
        return tuple(self.decided())

    def save(self, file: Path | str) -> None:
        """Write the log (HDF5), which ``load_run`` reads back."""
        write_run(file, self)

    def summary(self) -> Summary:
        """Return the run in numbers, for logs of any source; unknown values are None."""
        return summaries.summary(self)

    def compare(self, other: Run | Path | str) -> Comparison:
        """Compare this run with another, or its file, each from its first decision on."""
        return summaries.compare_runs(self, run_of(other))

    def export_csv(self, folder: Path | str) -> list[Path]:
        """Write a CSV for each group of columns, units in their names, and ``run.json``; return the files."""
        return [Path(folder) / name for name in export_csv(self, Path(folder))]

    def export_mcap(self, file: Path | str) -> dict[str, int]:
        """Write an MCAP file for Foxglove, ``run.mcap``, and its layout, ``run.layout.json``.

        Returns:
            The number of messages of each topic.
        """
        require("MCAP", *EXTRAS["mcap"])
        from frogkick.runs.export_mcap import export_mcap

        return export_mcap(self, Path(file))

    def to_pandas(self) -> dict[str, DataFrame]:
        """Return a pandas table for each group of columns of ``export_csv``: fixes, decisions, ...

        Units are in the columns' names. Missing values are NaN.
        """
        require("Tables of pandas", *EXTRAS["pandas"])
        from pandas import DataFrame

        return {name: DataFrame(columns) for name, columns in columns_of(self)}

    def plot(self) -> Figure:
        """Return a matplotlib figure (``savefig`` writes it): track, distance, actions, prediction errors."""
        from frogkick.report.run_figure import run_figure

        return run_figure(self, f"{self.robot_id}: {self.source}")

    def play(self, speed: float = 1.0) -> None:
        """Play the run in the browser until its end, the page's button or Ctrl-C; it starts with the page.

        Args:
            speed: above 0; 2: twice real time.
        """
        from frogkick.front.viewing import played

        played(self, speed)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``run``."""
        from frogkick.front.mission import clearance_m, hold_json, then_json

        learned = {"lost": summaries.lost_of(self), "limb_events": summaries.limb_events(self)}
        then = {"then": then_json(self), "hold": hold_json(self)}
        rest = {"wall_clearance_m": clearance_m(self), "ended": self.ended}
        return {**self.tracking.as_json(), **self.checked, **learned, **then, **rest}

    def __repr__(self) -> str:
        name = "no path" if self.path is None else self.path.name
        try:
            followed = f"mean distance {1e3 * self.tracking.mean_distance_m:.2f} mm"
        except InputError:  # a log may be of a robot without fixes
            followed = "not seen swimming"
        return (
            f"Run({self.robot_id!r} along {name}: {len(self.decisions)} decisions, {followed}, {self.ended})"
        )

    def _repr_html_(self) -> str:
        try:
            return page_of(repr(self), self.as_json(), self.plot() if len(self.decisions) > 1 else None)
        except InputError:
            return page_of(repr(self), {"ended": self.ended})


@typed
def import_runs(data_dir: Path | str, out: Path | str, progress: Progress = False) -> list[dict[str, Any]]:
    """Write recorded runs of the paper as logs. Faults are repaired or marked; no data is invented.

    The arguments are those of the command ``import``. Returned is a row of numbers for each run, with
    ``file``; for a run without a path ``run`` and ``skipped``.
    """
    require_writable(Path(out), folder=True)
    with shown(progress, "import") as tell:
        return import_recorded(data_dir, out, tell)


@typed
def load_run(file: Path | str) -> Run:
    """Read a run: a log of frogkick (.h5), or a recorded run of the paper (``line1.csv`` beside its path).

    Raises:
        InputError: the file is missing, incomplete, or not a run.
    """
    return Run(**vars(load_log(file)))


def run_of(given: Run | Path | str) -> Run:
    """A run in memory as it is, or read from its file; see ``load_run``."""
    return given if isinstance(given, Run) else load_run(given)


def id_of_runs(runs: Sequence[RunLog | Segments]) -> str:
    """Return the id of the robot of all runs.

    Raises:
        InputError: they are of several robots.
    """
    names = sorted({run.robot_id for run in runs})
    if len(names) != 1:
        raise InputError(f"the runs are of robots {', '.join(names)}: give runs of one")
    return names[0]


def knows_robot(run: RunLog) -> bool:
    """Whether a log has the file of its robot."""
    text = run.made.get("robot_toml")
    return text is not None and tomllib.loads(text)["id"] == run.robot_id


def robot_of(logs: Sequence[tuple[Run, str]], asked: Robot | str | None = None) -> Robot:
    """Return the robot of some runs: the one that is asked for, else the one in their logs, else by its id.

    A line on stderr says where another robot of the same id, in a log or built in, differs from it.

    Raises:
        InputError: the runs are of several robots, or their robot is not known.
    """
    texts = {run.made["robot_toml"]: name for run, name in logs if knows_robot(run)}
    if asked is not None:
        used = load_robot(asked)
        for text, name in texts.items():
            if differs := _differs(text, used.toml):
                tell_line(
                    f"frogkick: run {name!r} was made with a robot {used.id!r} whose file differs in "
                    f"{differs} from the one that is given and used"
                )
        return used
    robot_id = id_of_runs([run for run, _name in logs])
    if not texts:
        return load_robot(robot_id)
    (text, name), *others = reversed(texts.items())
    for other, its_name in others:
        if differs := _differs(other, text):
            raise InputError(
                f"runs {its_name!r} and {name!r} were made with two robots {robot_id!r}, which differ in "
                f"{differs}: give the one to use with --robot"
            )
    used = parse_robot(text, f"the robot in run {name!r}")
    if any("file" in effect for effect in used.effects):
        raise InputError(
            f"run {name!r} was made with a robot that has an effect in a file of its own: give the robot's "
            "file with --robot"
        )
    if robot_id in built_in_robots() and (differs := _differs(text, load_robot(robot_id).toml)):
        tell_line(
            f"frogkick: run {name!r} was made with a robot {robot_id!r} that differs in {differs} from the "
            "built-in one: the one in the log is used"
        )
    return used


_NO_MATTER = ("title", "planner", "library")  # of a robot's file: no motion depends on them
_DIFFERENCES_NAMED = 3


def _differs(one: str, other: str) -> str:
    """The keys in which two robots' texts of the same id differ, for people; "" if there are none."""
    tables, found = [tomllib.loads(text) for text in (one, other)], list[str]()
    if tables[0]["id"] != tables[1]["id"]:
        return ""  # it is said elsewhere whose run it is

    def walk(here: Any, there: Any, where: str) -> None:
        if isinstance(here, dict) and isinstance(there, dict):
            for key in {**here, **there}:
                walk(here.get(key), there.get(key), f"{where}.{key}" if where else key)
        elif isinstance(here, list) and isinstance(there, list) and len(here) == len(there):
            for left, right in zip(here, there, strict=True):
                named = left.get("name") if isinstance(left, dict) else None
                walk(left, right, f"{where}.{named}" if named else where)
        elif here != there and where not in found:
            found.append(where)

    here, there = ({key: table[key] for key in table if key not in _NO_MATTER} for table in tables)
    walk(here, there, "")
    more = len(found) - _DIFFERENCES_NAMED
    return ", ".join(found[:_DIFFERENCES_NAMED]) + (f" and {more} more keys" if more > 0 else "")
