"""Runs with a robot on the bench: where it is, what it speaks, where its position fixes come from."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from frogkick.cli.places import built_firmware
from frogkick.errors import InputError, nearest_name
from frogkick.link.frames import DELIMITER
from frogkick.link.opening import opened
from frogkick.link.text_dialect import pulse_line, require_dialect
from frogkick.link.wire import Wire, is_target, parse_target
from frogkick.loop.closed_loop import FixSource, Recording, RunOptions, run_session
from frogkick.loop.lab_session import LabSession, lab_session, stops_are_interrupts
from frogkick.loop.line_fixes import LineFixes
from frogkick.loop.text_robot import TextRobot
from frogkick.paths import Path as SwimPath
from frogkick.planner.image import Tables
from frogkick.pool.native_robot import NativeRobot
from frogkick.robot import Robot

FIRST_FIX_S = 10.0
FIXES = ("stdin",)


def require_bench(robot: str, dialect: str, fixes: str | None, world: Path | None) -> None:
    """Refuse what does not go with a real robot, or with a simulated one.

    Raises:
        InputError: it does not.
    """
    require_dialect(dialect)
    if not is_target(robot):
        for name, value in (("--fixes", fixes), ("--dialect", None if dialect == "frogkick" else dialect)):
            if value is not None:
                raise InputError(
                    f"{name} {value} is for a real robot, --robot is {robot!r}: leave it out, or give "
                    "--robot ble:NAME or serial:PORT"
                )
        return
    parse_target(robot)
    if world is not None:
        raise InputError(
            f"--world {str(world)!r} is for a simulated pool, --robot is {robot!r}: leave it out"
        )
    if fixes is None:
        raise InputError(
            f"--robot {robot} swims by position fixes, and none are given: pipe them in from a tracker, "
            "as lines 'x_m y_m heading_rad [age_s]', with --fixes stdin"
        )
    if fixes not in FIXES:
        raise InputError(f"--fixes is {fixes!r}{nearest_name(fixes, FIXES)}: choose {', '.join(FIXES)}")


@contextmanager
def session_with(wire: Wire, dialect: str, image: Path, robot: Robot) -> Iterator[LabSession]:
    """A session over a wire, in a robot's dialect."""
    if dialect == "frogkick":
        yield lab_session(wire)
        return
    with built_firmware("native", image, robot) as built:
        core = TextRobot(wire, NativeRobot(built.image, len(robot.limbs)), robot)
        try:
            yield LabSession(core)
        finally:
            core.close()


def run_on_bench(
    name: str,
    dialect: str,
    image: Path,
    robot: Robot,
    tables: Tables,
    path: SwimPath,
    options: RunOptions,
    progress: Callable[[float, int], None],
) -> Recording:
    """A run with a real robot, by fixes from standard input. Stopped in any way, it disarms the robot first.

    Args:
        name: where the robot is, as the user gave it.
        dialect: what it speaks.
        image: table image of ``tables``.
        robot, tables, path, options, progress: see ``run_session``.

    Raises:
        WireError: the robot cannot be reached.
        LinkError: it refuses or does not answer.
        InputError: no fixes come.
    """
    target = parse_target(name)
    greeting = DELIMITER if dialect == "frogkick" else pulse_line(tables.pulse_us)
    with ExitStack() as stack:
        stack.enter_context(stops_are_interrupts())
        fixes = LineFixes(sys.stdin.fileno(), "standard input")
        fixes.wait_first(FIRST_FIX_S)
        wire = stack.enter_context(opened(target, greeting))
        session = stack.enter_context(session_with(wire, dialect, image, robot))
        source: FixSource = fixes
        return run_session(session, source, tables, path, options, progress)
