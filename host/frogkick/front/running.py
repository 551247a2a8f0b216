"""A closed-loop run with any robot: simulated, on the virtual chip, by serial line or by Bluetooth."""

from __future__ import annotations

import copy
import os
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.errors import EXTRAS, InputError, require
from frogkick.core.files import require_writable, save_result, sole_writer
from frogkick.core.progress import Progress, shown
from frogkick.effects import World, read_world
from frogkick.front.bench import (
    Bench,
    Operators,
    no_operator,
    require_bench,
    require_video,
    run_on_bench,
)
from frogkick.front.html import page_of
from frogkick.front.mission import (
    Then,
    clearance_m,
    hold_json,
    hold_radius_m,
    next_paths,
    require_room,
    then_json,
    with_walls,
)
from frogkick.front.places import (
    plan_config,
    require_plan,
    require_simulator,
    simulated_robot,
    start_pose,
    swim_path,
)
from frogkick.front.tables import Table, load_table
from frogkick.front.viewing import RunProgress, keeps_partial_log, played, viewed
from frogkick.link.wire import Wire, is_target
from frogkick.paths import Path as SwimPath
from frogkick.pool.pool import Camera as SimulatedCamera
from frogkick.pool.pool import Pool, noise_of_run
from frogkick.robot import Robot
from frogkick.runs.closed_loop import require_seed, require_time, run_session
from frogkick.runs.decision import LiveCheck
from frogkick.runs.export_csv import columns_of, export_csv
from frogkick.runs.live_log import part_of
from frogkick.runs.record import (
    BATTERY_V,
    Recording,
    RunOptions,
    limb_events,
    lost_of,
    made_of,
)
from frogkick.runs.recorded.importer import import_recorded
from frogkick.runs.recorded.importer import load_run as load_log
from frogkick.runs.runlog import RunLog, Tracking
from frogkick.runs.runlog_file import write_run
from frogkick.runs.session import Session
from frogkick.runs.summary import Comparison, Summary, compare_runs, summary, tracking_of_log

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


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
        return tracking_of_log(self)

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
        return summary(self)

    def compare(self, other: Run | Path | str) -> Comparison:
        """Compare this run with another, or its file, each from its first decision on."""
        return compare_runs(self, run_of(other))

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
        played(self, speed)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``run``."""
        learned = {"lost": lost_of(self), "limb_events": limb_events(self)}
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

    Args:
        data_dir: folder of runs and paths, such as ``line1.csv`` and ``linep1.csv``, or one with ``control``.
        out: folder for the logs.
        progress: of the runs: True for a bar, or a function of (done, all).

    Returns:
        A row of numbers for each run, with ``file``; for a run without a path ``run`` and ``skipped``.
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


@typed
def run(
    table: Table | Path | str | None = None,
    path: SwimPath | str = "line",
    *,
    robot: str = "pool",
    model: Robot | str | None = None,
    world: World | Path | str | None = None,
    plan: str = "onboard",
    planner: str = "robot",
    depth: int | None = None,
    learn: bool = False,
    inside: str | Sequence[float] | None = None,
    then: Then | Sequence[Then] = (),
    hold: bool = False,
    seed: int = 0,
    time_limit_s: float = 120.0,
    fix_rate_hz: float = 15.0,
    fixes: str | None = None,
    source: str = "0",
    begin: str | None = None,
    dialect: str = "frogkick",
    battery_v: float | None = None,
    operator: Operators = no_operator,
    wire: Wire | None = None,
    key: Path | str | None = None,
    out: Path | str | None = None,
    view: bool = False,
    video: bool = False,
    progress: Progress = False,
) -> Run:
    """Follow a path in closed loop: position fixes come in, and strokes go out.

    A real robot is armed when all checks have passed and ``operator`` agrees. It is disarmed at any end.

    Args:
        table: the robot's table or its file; None: the robot's default table.
        path: the desired path in the world frame, a shape's name or a path file.
        robot: "pool" (the C core on this computer in a simulated pool), "virtual" (the firmware on the
            virtual chip, in the same pool), "ble:NAME" or "serial:PORT".
        model: the robot, its name or its TOML file; None: the table's own.
        world: effects that act in the simulated pool but are in no model, or their TOML file.
        plan: who decides: "onboard" (the robot), "host", or "both" (the robot while the host checks it).
        planner: planner whose weights and depth are used: "robot" (its TOML file) or "paper".
        depth: of the planner's search, 1 to 4; None: the planner's own.
        learn: estimate the wear of each limb during the run, on the robot or the host, and plan with it. A
            robot continues from its earlier estimate; a run without ``learn`` makes it forget.
        inside: walls to keep off: x, y, x, y of opposite corners, m, or "pool": those of the calibration.
        then: paths that take over without a stop: "ellipse@20" or ("ellipse", 20.0) at 20 s after the first
            decision; "ellipse@20@here", ("ellipse", 20.0, "here"): it begins where the robot then is.
        hold: at its path's end the robot circles it until a later path takes over or the run is ended.
        seed: seed of the simulated camera's noise, which differs from path to path.
        time_limit_s: time limit, s; of the pool if that is simulated.
        fix_rate_hz: simulated position fixes per second.
        fixes: of a real robot: camera.toml, "stdin" (lines ``x_m y_m heading_rad [age_s]``) or "pool".
        source: camera of a calibration: a number, an address, a video or a folder of pictures.
        begin: where a real robot's path begins: "X,Y,DEG" (m, degrees) or "here"; None: unchanged.
        dialect: protocol of a real robot: "frogkick", or "frog2022" for the authors' own firmware.
        battery_v: voltage of a real robot's lowest battery, measured with a meter. The run refuses a low
            battery.
        operator: asked before a real robot is armed, and may stop the run.
        wire: an open link to a real robot; None: a link is opened for this run and closed after it.
        key: key file of a real robot that has an owner; None: the user's own, see ``connect``.
        out: log to write (HDF5); with a real robot it is written during the run.
        view: draw the run in the browser, with a stop button; a simulated run then goes in real time.
        video: record the camera's pictures next to ``out``.
        progress: True for a bar, or a function of (path points passed, all).

    Raises:
        InputError: an argument that cannot be used, or low batteries.
        WireError: the robot cannot be reached.
        LinkError: the robot refuses or does not answer.
        CheckError: robot and host decided differently (``plan="both"``).
    """
    named = str(world) if isinstance(world, Path | str) else None if world is None else "given"
    require_bench(robot, dialect, fixes, named, battery_v, begin, None if key is None else str(key), source)
    target = None if out is None else Path(out)
    require_video(video, fixes, target)
    is_real = is_target(robot)
    if not is_real:
        require_simulator(robot)
    require_plan(plan)
    require_writable(target)
    desired = swim_path(path)
    eye = SimulatedCamera(rate_hz=fix_rate_hz)
    require_time(time_limit_s)
    require_seed(seed)
    used = load_table(table, model)
    described = used.robot
    # An effect may keep state.
    true = World() if world is None else copy.deepcopy(read_world(world, described))
    check = LiveCheck() if plan == "both" else None
    stopped = threading.Event()  # by the button of the page
    config = with_walls(plan_config(described, planner, depth), inside, used, fixes)
    following = next_paths(then, time_limit_s)
    hold_m = hold_radius_m(used.tables, described.id) if hold else None
    if hold_m is not None and not is_real:
        require_room(desired, hold_m, config)
    options = RunOptions(
        config, plan != "host", time_limit_s, check, stopped.is_set, learn, following, hold_m
    )
    name = f"run --robot {robot.replace('/', ' ').replace(chr(92), ' ')} --plan {plan}"
    known = {} if battery_v is None else {BATTERY_V: battery_v}
    with ExitStack() as stack:
        stack.enter_context(sole_writer(target))
        image = stack.enter_context(used.file())
        tell = stack.enter_context(shown(progress, desired.name))
        recording = Recording(described, used.tables, desired, options, name, known=known)
        said = RunProgress(tell, recording)
        if is_real:
            bench = Bench(
                name=robot, fixes=str(fixes), source=source, begin=begin, rate_hz=fix_rate_hz, world=true,
                seed=seed, dialect=dialect, battery_v=battery_v, out=target, film=video, operator=operator,
                wire=wire, key=None if key is None else Path(key), drawn=view, stop=stopped.set,
            )  # fmt: skip
            with keeps_partial_log(target, recording):
                run_on_bench(bench, image, recording, said.progress)
        else:
            with said.preparing():
                port = stack.enter_context(
                    simulated_robot(robot, image, described, lambda: compile_rods(described))
                )
            recording.made = made_of(described, used.tables, _now_unix_s())
            recording.seed = seed
            rng = noise_of_run(seed, desired.name, len(desired))
            recording.pool = Pool(described, start_pose(desired), eye, rng, true)
            draw = stack.enter_context(viewed(view, recording, stop=stopped.set))
            with keeps_partial_log(target, recording):
                run_session(Session(port), recording.pool, recording, said.progress, draw)
    found = Run(**vars(recording.log()), checked={} if check is None else check.as_json())
    if target is not None:
        save_result(found.save, target)
        part_of(target).unlink(missing_ok=True)
    return found


def compile_rods(robot: Robot) -> None:
    """Compile the simulation if needed, by simulating a moment of a pool."""
    Pool(robot, (0.0, 0.0, 0.0), SimulatedCamera(), np.random.default_rng(0), World()).advance(1e-3)


def _now_unix_s() -> float:
    """Return the wall clock, or SOURCE_DATE_EPOCH if it is set, so that the same run gives the same bytes."""
    fixed = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        now_s = float(fixed) if fixed else time.time()
        datetime.fromtimestamp(now_s, UTC)
    except (ValueError, OverflowError, OSError):
        raise InputError(f"SOURCE_DATE_EPOCH is {fixed!r}: give seconds since 1970, or unset it") from None
    return now_s
