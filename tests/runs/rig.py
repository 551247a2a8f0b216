"""What tests of runs, command line and report share: a small table, its firmware, short runs in the pool."""

from __future__ import annotations

import functools
import tempfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from frogkick.core.poses import Fix
from frogkick.front.tables import default_tables
from frogkick.link.wire import RobotPort
from frogkick.paths import Path as SwimPath
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.pool.native_robot import NativeRobot
from frogkick.pool.pool import Camera, Pool
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot, load_robot
from frogkick.runs.closed_loop import run_session
from frogkick.runs.record import Recording, RunOptions
from frogkick.runs.runlog import DecisionFlag, RunLog
from frogkick.runs.session import Session
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.firmware import Firmware, build

SMALL_STATES = 40
PERIOD_S = round(load_robot("frog2022").period_s * 1e6) * 1e-6
"""As ``tables`` has it, which takes seconds to make: not where tests are collected."""

# Lives as long as the test session.
_FOLDER = tempfile.TemporaryDirectory(prefix="frogkick-tests-")


@functools.cache
def small_table() -> Path:
    """An image of a table of few states of random swims: too few for an affine table, so a nearest one.

    Its library takes some seconds, once on a machine.
    """
    return default_tables("frog2022", SMALL_STATES, "visited")


@functools.cache
def tables() -> Tables:
    """The same, opened."""
    return read_image(small_table())


@functools.cache
def robot() -> Robot:
    """The paper's robot."""
    return load_robot("frog2022")


@functools.cache
def firmware(target: str) -> Firmware:
    """Firmware with the small table."""
    return build(target, small_table(), robot(), Path(_FOLDER.name) / target)


def port(place: str) -> RobotPort:
    """A robot just switched on: "virtual" or "pool"."""
    if place == "virtual":
        return VirtualRobot(firmware("bench").image, len(robot().limbs))
    return NativeRobot(firmware("native").image, len(robot().limbs))


class FadingPool(Pool):
    """A pool whose camera sees nothing after some time."""

    last_fix_s = np.inf

    def advance(self, until_s: float) -> list[Fix]:
        return [fix for fix in super().advance(until_s) if fix.capture_s <= self.last_fix_s]


def new_pool(path_name: str, seed: int = 0, start_at: int = 0) -> FadingPool:
    """A pool with the robot at rest at a path's start, along its tangent."""
    path = shape(path_name)
    start = (float(path.x_m[start_at]), float(path.y_m[start_at]), float(path.tangent_rad[start_at]))
    return FadingPool(robot(), start, Camera(), np.random.default_rng(seed))


def recording(
    path: SwimPath, options: RunOptions, pool: Pool | None = None, known: Mapping[str, float] | None = None
) -> Recording:
    """The recording of a run of the small table that is to begin."""
    seed = None if pool is None else 0
    return Recording(robot(), tables(), path, options, "test", seed, known or {}, pool=pool)


def swim(
    place: str,
    path_name: str,
    limit_s: float,
    depth: int = 1,
    onboard: bool = True,
    pool: Pool | None = None,
    progress: Callable[[float, int], None] = lambda _time_s, _index: None,
) -> Recording:
    """A run in the pool."""
    chosen = new_pool(path_name) if pool is None else pool
    options = RunOptions(PlanConfig(depth=depth), onboard, limit_s)
    begun = recording(shape(path_name), options, chosen)
    return run_session(Session(port(place)), chosen, begun, progress)


def without_plan(run: RunLog, rows: Sequence[int]) -> RunLog:
    """A log in which some decisions were made without a plan."""
    made = run.decisions
    assert made.cost is not None and made.estimate is not None and made.predicted is not None
    changed = {name: np.array(getattr(made, name)) for name in ("flags", "cost", "estimate", "predicted")}
    changed["flags"][list(rows)] = DecisionFlag.NO_PLAN
    for name in ("cost", "estimate", "predicted"):
        changed[name][list(rows)] = np.nan
    return replace(run, decisions=replace(made, **changed))


def changed_image(at: int, content: bytes) -> bytes:
    """The small table's image with other bytes at an offset, and a right CRC-32."""
    image = bytearray(small_table().read_bytes())
    image[at : at + len(content)] = content
    image[12:16] = zlib.crc32(image[16:]).to_bytes(4, "little")
    return bytes(image)
