"""A closed-loop run with any robot: simulated, on the virtual chip, by serial line or by Bluetooth."""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.files import require_writable, save_result, sole_writer
from frogkick.core.progress import Progress, shown
from frogkick.effects import World, read_world
from frogkick.front import places
from frogkick.front.bench import Bench, Operators, no_operator, run_on_bench
from frogkick.front.logs import Run
from frogkick.front.mission import Then, hold_radius_m, next_paths, require_room, with_walls
from frogkick.front.tables import Table, load_table
from frogkick.front.viewing import keeps_partial_log, noted_if_slow, run_progress, viewed
from frogkick.link.wire import Wire, is_target
from frogkick.paths import Path as SwimPath
from frogkick.pool.pool import Camera as SimulatedCamera
from frogkick.pool.pool import Pool, noise_of_run
from frogkick.robot import Robot
from frogkick.runs.closed_loop import require_seed, require_time, run_session
from frogkick.runs.decision import LiveCheck
from frogkick.runs.live_log import part_of
from frogkick.runs.record import Recording, RunOptions, made_of
from frogkick.runs.session import Session
from frogkick.runs.summary import BATTERY_V


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
        model: the robot, its name or its TOML file; None: the table's own. The planner believes what its
            table was made with, effects included; in a simulated pool the robot swims without the effects of
            its file, with those of ``world``.
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
    target = None if out is None else Path(out)
    stopped = threading.Event()  # by the button of the page
    bench = Bench(
        robot=robot, fixes=fixes, source=source, begin=begin, fix_rate_hz=fix_rate_hz, seed=seed, world=world,
        dialect=dialect, battery_v=battery_v, out=target, video=video, operator=operator, wire=wire, key=key,
        view=view, stop=stopped.set,
    )  # fmt: skip
    is_real = is_target(robot)
    if not is_real:
        places.require_simulator(robot)
    places.require_plan(plan)
    require_writable(out)
    desired = places.swim_path(path)
    eye = SimulatedCamera(rate_hz=fix_rate_hz)
    require_time(time_limit_s)
    require_seed(seed)
    used = load_table(table, model)
    described = used.robot
    # An effect may keep state.
    true = World() if world is None else copy.deepcopy(read_world(world, described))
    if not is_real:
        places.tell_effects_left_out(described, true)
    check = LiveCheck() if plan == "both" else None
    config = with_walls(places.plan_config(described, planner, depth), inside, used, fixes)
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
        said = run_progress(tell, recording)
        if is_real:
            with keeps_partial_log(target, recording):
                run_on_bench(bench, true, image, recording, said)
        else:
            what = "preparing the simulation and the robot's core (compiled on first use)"
            with noted_if_slow(lambda: tell(0, len(desired), what)):
                port = stack.enter_context(
                    places.simulated_robot(robot, image, described, lambda: compile_rods(described))
                )
            recording.made = made_of(described, used.tables)
            recording.seed = seed
            rng = noise_of_run(seed, desired.name, len(desired))
            recording.pool = Pool(described, places.start_pose(desired), eye, rng, true)
            draw = stack.enter_context(viewed(view, recording, stop=stopped.set))
            with keeps_partial_log(target, recording):
                run_session(Session(port), recording.pool, recording, said, draw)
    found = Run(**vars(recording.log()), checked={} if check is None else check.as_json())
    if target is not None:
        save_result(found.save, target)
        part_of(target).unlink(missing_ok=True)
    return found


def compile_rods(robot: Robot) -> None:
    """Compile the simulation if needed, by simulating a moment of a pool."""
    Pool(robot, (0.0, 0.0, 0.0), SimulatedCamera(), np.random.default_rng(0), World()).advance(1e-3)
