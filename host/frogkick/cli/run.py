"""``frogkick run``: follow a path in closed loop."""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from frogkick.cli.common import JsonOption, SeedOption, progress_bar, require_writable, show, stderr
from frogkick.cli.lab import Bench, Sight, require_bench, require_film, run_on_bench
from frogkick.cli.places import (
    DepthOption,
    PlannerName,
    PlannerOption,
    TablesOption,
    plan_config,
    require_simulated,
    robot_of_table,
    simulated_robot,
    start_pose,
    swim_path,
    table_image,
)
from frogkick.cli.run_terminal import Told
from frogkick.cli.viewing import viewed
from frogkick.effects import World, read_world
from frogkick.link.wire import is_target
from frogkick.loop.camera_fixes import CameraFixes
from frogkick.loop.closed_loop import Recording, RunOptions, require_time, run_in_pool
from frogkick.loop.live_check import LiveCheck
from frogkick.loop.live_log import logged, part_of
from frogkick.loop.record import BATTERY_V, run_log, tracking_of_recording
from frogkick.loop.runlog_file import write_run
from frogkick.paths import Path as SwimPath
from frogkick.planner.image import read_image
from frogkick.pool.camera import Camera
from frogkick.pool.pool import Pool

WorldOption = Annotated[
    Path | None, typer.Option(help="TOML of effects that are true in the pool and no model knows.")
]


class PlanWhere(enum.StrEnum):
    """Who decides."""

    onboard = "onboard"
    host = "host"
    both = "both"


def run(
    robot: Annotated[
        str,
        typer.Option(
            help="virtual: firmware on the virtual chip; pool: the core here; real: ble:NAME, serial:PORT."
        ),
    ] = "virtual",
    plan: Annotated[
        PlanWhere,
        typer.Option(help="Who decides: the robot, the host, or the robot checked live by the host."),
    ] = PlanWhere.onboard,
    path: Annotated[
        str, typer.Option(help="line, sine, ellipse, circle, bends, eight, or CSV file")
    ] = "line",
    planner: PlannerOption = PlannerName.robot,
    depth: DepthOption = None,
    tables: TablesOption = None,
    model: Annotated[str | None, typer.Option(help="Robot TOML or name; default: the table's robot.")] = None,
    simulated_time: Annotated[
        float, typer.Option(help="Longest pool time, s; real for a real robot.")
    ] = 120.0,
    fix_rate: Annotated[float, typer.Option(help="Position fixes per second, simulated.")] = 15.0,
    fixes: Annotated[
        str | None,
        typer.Option(
            help="A real robot's: camera.toml of 'camera calibrate', or stdin = a tracker's lines "
            "'x_m y_m heading_rad [age_s]'; pool = simulated, for a kit without limbs."
        ),
    ] = None,
    source: Annotated[
        str, typer.Option(help="The camera of --fixes camera.toml: number, video, folder of pictures.")
    ] = "0",
    begin: Annotated[
        str | None, typer.Option(help="A real robot's path begins at X,Y,DEG (m, degrees), or here.")
    ] = None,
    dialect: Annotated[
        str, typer.Option(help="A real robot's: frogkick, or frog2022 = the authors' firmware, as text.")
    ] = "frogkick",
    world: WorldOption = None,
    seed: SeedOption = 0,
    out: Annotated[Path | None, typer.Option(help="Log to write (HDF5).")] = None,
    view: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Draw the run in the browser, over a camera's picture; simulated ones in real time.",
        ),
    ] = False,
    video: Annotated[
        bool, typer.Option("--video", help="Keep the camera's pictures beside --out: .avi, .frames.csv.")
    ] = False,
    battery_v: Annotated[
        float | None,
        typer.Option(help="Of a real robot's lowest battery, measured by hand at rest; too low is refused."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Arm a real robot without asking for Enter.")] = False,
    json: JsonOption = False,
) -> None:
    """Follow a path: position fixes in, strokes out. Exit 1 if the guard's limits were broken, or robot and
    host decide differently (--plan both).

    At a terminal a real robot is armed by Enter, and any key stops the run. However it ends, the robot is
    disarmed first.
    """
    require_bench(robot, dialect, fixes, world, battery_v, begin)
    require_film(video, fixes, out)
    is_real = is_target(robot)
    if not is_real:
        require_simulated(robot)
    require_writable(out)
    desired, camera = swim_path(path), Camera(rate_hz=fix_rate)
    require_time(simulated_time)
    true_world = World() if world is None else read_world(world)
    image = table_image(tables, model)
    described = robot_of_table(image, model)
    opened = read_image(image)
    check = LiveCheck() if plan is PlanWhere.both else None
    config = plan_config(described, planner, depth)
    options = RunOptions(config, plan is not PlanWhere.host, simulated_time, check)
    name = f"run --robot {robot.replace('/', ' ').replace(chr(92), ' ')} --plan {plan.value}"
    known = {} if battery_v is None else {BATTERY_V: battery_v}
    pool = None
    with ExitStack() as stack:
        bar = stack.enter_context(progress_bar(desired.name))
        told = Told(bar, len(desired), opened, check)
        if is_real:
            sight = Sight(str(fixes), source, begin, fix_rate, true_world, seed)
            bench = Bench(robot, dialect, sight, battery_v, out if video else None, yes)
            log = logged(out, described, opened, options, name, known)

            @contextmanager
            def kept(placed: SwimPath, eye: CameraFixes | None) -> Iterator[Keep]:
                drawn = viewed(view, described, opened, placed, options, camera=eye)
                with log(placed) as write, drawn as draw:
                    yield all_of(told.keep, write, draw)

            stack.enter_context(names_what_is_left(out))
            recording, desired = run_on_bench(
                bench, image, described, opened, desired, options, kept, told.progress
            )
        else:
            port = stack.enter_context(simulated_robot(robot, image, described))
            pool = Pool(described, start_pose(desired), camera, np.random.default_rng(seed), true_world)
            draw = stack.enter_context(viewed(view, described, opened, desired, options, pool))
            keep = all_of(told.keep, draw)
            recording = run_in_pool(port, pool, opened, desired, options, told.progress, keep)
    tracked = tracking_of_recording(recording, pool, described, desired)
    if out is not None:
        known_seed = None if is_real else seed
        write_run(out, run_log(recording, pool, described, opened, desired, options, known_seed, name, known))
        part_of(out).unlink(missing_ok=True)
    checked = {} if check is None else check.as_json()
    show({**tracked.as_json(), **checked, "ended": recording.ended}, json)
    if tracked.limit_violations:
        raise typer.Exit(1)


Keep = Callable[[Recording], None]


def all_of(*keepers: Keep) -> Keep:
    """Give a recording to each, in order."""

    def keep(recording: Recording) -> None:
        for one in keepers:
            one(recording)

    return keep


@contextmanager
def names_what_is_left(out: Path | None) -> Iterator[None]:
    """Where a run breaks off, say where its log is so far."""
    try:
        yield
    except BaseException:
        if out is not None and part_of(out).exists():
            stderr.print(f"frogkick: what was recorded until then is in {str(part_of(out))!r}")
        raise


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(run)
