"""Robots, tables, paths and firmware by the names that a user gives them."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from frogkick.core.errors import InputError, nearest_name
from frogkick.core.progress import tell_line
from frogkick.effects import World
from frogkick.link.wire import FORMS, RobotPort
from frogkick.paths import OTHER_SHAPES, SHAPES, from_csv, shape
from frogkick.paths import Path as SwimPath
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.pool.native_robot import NativeRobot
from frogkick.robot import Robot
from frogkick.runs.record import config_of_log
from frogkick.runs.runlog import RunLog
from frogkick_codegen.firmware import CHIPS, Firmware, build, require_tools

SIMULATED = {"virtual": "bench", "pool": "native"}
"""Simulated robot -> target of the firmware that it runs."""
PLANS = ("onboard", "host", "both")
"""Who decides."""
PLANNERS = ("robot", "paper")


def require_simulator(name: str, builds: bool = True) -> None:
    """Refuse an unknown simulated robot, or one whose firmware cannot be built here if that is asked for."""
    if name not in SIMULATED:
        raise InputError(
            f"--robot is {name!r}{nearest_name(str(name), SIMULATED)}: choose virtual (the firmware on the "
            "virtual chip), pool (the same core on this computer), or a real robot: "
            f"{', '.join(FORMS)}"
        )
    if builds:
        require_tools(SIMULATED[name])


def tell_effects_left_out(robot: Robot, world: World) -> None:
    """Say on stderr that a pool without effects is not that of a model which has some."""
    if robot.effects and not world.effects:
        names = ", ".join(dict.fromkeys(str(effect["name"]) for effect in robot.effects))
        tell_line(
            f"frogkick: the model {robot.id!r} has effects ({names}), and the pool has none: the robot swims "
            "there without them, and the planner believes what its table was made with; write them into a "
            "file for --world to have them in the pool"
        )


@contextmanager
def built_firmware(target: str, tables: Path, robot: Robot) -> Iterator[Firmware]:
    """Build firmware into a temporary folder that lives as long as the context."""
    with tempfile.TemporaryDirectory(prefix="frogkick-") as folder:
        yield build(target, tables, robot, Path(folder))


@contextmanager
def simulated_robot(
    name: str,
    tables: Path,
    robot: Robot,
    meanwhile: Callable[[], None] = lambda: None,
    learned: bytes = b"",
) -> Iterator[RobotPort]:
    """Return a simulated robot: "virtual" (image on the virtual chip) or "pool" (core on this computer).

    ``meanwhile`` is called while the compiler runs in another process, so that a second core is used.
    ``learned`` is the robot's persistent wear estimate (``kept_wear``).
    """
    require_simulator(name)
    with tempfile.TemporaryDirectory(prefix="frogkick-") as folder:
        with ThreadPoolExecutor(1) as beside:
            building = beside.submit(build, SIMULATED[name], tables, robot, Path(folder))
            meanwhile()
            built = building.result()
        if SIMULATED[name] in CHIPS:
            from frogkick.pool.virtual_robot import VirtualRobot

            yield VirtualRobot(built.image, len(robot.limbs), learned=learned)
        else:
            yield NativeRobot(built.image, len(robot.limbs), learned=learned)


def require_plan(plan: str) -> None:
    """Raise InputError unless ``plan`` says who decides."""
    if plan not in PLANS:
        raise InputError(f"plan is {plan!r}{nearest_name(plan, PLANS)}: choose {', '.join(PLANS)}")


def plan_config(
    robot: Robot, planner: str | None, depth: int | None, run: RunLog | None = None
) -> PlanConfig:
    """Return a planner's configuration, with another depth if one is given.

    Args:
        robot: robot whose TOML file configures the planner "robot".
        planner: "robot" or "paper"; None: that of the run, or the paper's if the run has none.
        depth: depth that replaces the configured one.
        run: a log that may hold its planner.
    """
    if planner not in (None, *PLANNERS):
        raise InputError(f"planner is {planner!r}{nearest_name(planner, PLANNERS)}: choose robot or paper")
    if planner == "robot":
        config = config_of(robot.planner)
    elif planner is None and run is not None and run.planner:
        config = config_of_log(run)
    else:
        config = PlanConfig()
    chosen = config.depth if depth is None else depth
    if isinstance(chosen, bool) or not isinstance(chosen, int | np.integer) or not 1 <= chosen <= 4:
        raise InputError(f"--depth is {chosen!r}, allowed is 1 to 4: give a whole number of that range")
    return dataclasses.replace(config, depth=chosen)


def swim_path(name: SwimPath | Path | str) -> SwimPath:
    """Return a path by its shape's name or from a file. A file with too many points is reported on stderr."""
    if isinstance(name, SwimPath):
        return name
    if not isinstance(name, str | Path):
        raise InputError(
            f"path is given as {type(name).__name__}: give a shape's name, a CSV file, or a path, such as "
            "that of fk.paths.from_waypoints"
        )
    name = str(name)
    if name in SHAPES | OTHER_SHAPES:
        return shape(name)
    if not name:
        raise InputError(f"--path is empty: choose {', '.join(SHAPES)}, or name a CSV file")
    if not Path(name).exists() and "." not in name and "/" not in name:
        shape(name)  # names the nearest right one
    return from_csv(name, tell_line)


def start_pose(path: SwimPath) -> tuple[float, float, float]:
    """Return the pose at the path's first point, along its tangent."""
    return float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0])
