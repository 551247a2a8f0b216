"""Runs with a real robot: its address, its protocol, and the source of its position fixes."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from frogkick.core.errors import InputError, nearest_name
from frogkick.core.interrupts import stops_are_interrupts
from frogkick.core.progress import tell_line
from frogkick.effects import World
from frogkick.front.mission import require_room
from frogkick.front.places import built_firmware, start_pose
from frogkick.front.viewing import noted_if_slow, viewed
from frogkick.link.auth import read_keys
from frogkick.link.frames import DELIMITER
from frogkick.link.opening import opened, require_wire
from frogkick.link.wire import FORMS, Wire, is_target, parse_target
from frogkick.paths import Path as SwimPath
from frogkick.paths.hold import hold_at_end
from frogkick.planner.plan import PlanConfig
from frogkick.pool.native_robot import NativeRobot
from frogkick.pool.pool import noise_of_run
from frogkick.robot import Robot
from frogkick.runs.closed_loop import run_session
from frogkick.runs.decision import warm_up
from frogkick.runs.lab_session import LabSession, lab_session
from frogkick.runs.live_log import logged
from frogkick.runs.live_view import tree_of
from frogkick.runs.path_change import NextPath
from frogkick.runs.pool_fixes import PoolFixes
from frogkick.runs.record import DISARMED, DROPPED, ENDED, UNHEARD, Recording, made_of
from frogkick.runs.runlog import RunLog
from frogkick.runs.start_checks import check_battery, check_start, look
from frogkick.runs.summary import refused_fixes
from frogkick.runs.text_robot import TextRobot, pulse_line, require_dialect
from frogkick.runs.tracked_fixes import CameraFixes, LineFixes
from frogkick.tables.image import Tables
from frogkick.vision.calibration import read_calibration
from frogkick.vision.sources import open_source
from frogkick.vision.video import Video

FIRST_FIX_S = 10.0
UNFINISHED = {
    ENDED["STALE"]: "position fixes stopped coming: the robot left the picture, or the camera or tracker "
    "fell behind or ended",
    ENDED["SUPPLY"]: "the robot's supply fell too low: charge all batteries and check the plugs",
    DISARMED: "the robot disarmed itself: 'frogkick log fetch' shows what led to it",
    UNHEARD: "the robot ended the run, and its reason was lost: see its log ('frogkick log fetch')",
    DROPPED: "the connection was lost and the robot ended the run meanwhile: bring the radio nearer, or "
    "check the cable",
}
"""Reason why a run ended before the end of its path or of its time -> the same with advice."""
STDIN = "stdin"
POOL = "pool"


def why_unfinished(run: RunLog) -> str:
    """Return why a run ended before the end of its path or of its time, with advice; "" if it did not."""
    if run.notes != ENDED["STALE"]:
        return UNFINISHED.get(run.notes, "")
    return refused_fixes(run) or ("" if len(run.fixes) else "no position fix came; ") + UNFINISHED[run.notes]


def placed(
    path: SwimPath, then: Sequence[NextPath], begin: str | None, pose_world: Sequence[float]
) -> tuple[SwimPath, tuple[NextPath, ...]]:
    """Return a path, moved to its beginning (see ``Bench``), and the later paths, moved likewise.

    ``pose_world`` is the robot's pose.
    """
    if begin is None:
        return path, tuple(then)
    motion = path.motion_to(pose_world if begin == "here" else parse_begin(begin))
    moved = (one if one.here else replace(one, path=one.path.place(motion)) for one in then)
    return path.place(motion), tuple(moved)


def parse_begin(text: str, what: str = "--begin") -> tuple[float, float, float]:
    """Return x (m), y (m), heading (rad) of the text ``X,Y,DEG``; ``what`` names it in errors."""
    try:
        x_m, y_m, heading_deg = (float(word) for word in text.split(","))
    except ValueError:
        here = ", or here" if what == "--begin" else ""
        raise InputError(f"{what} is {text!r}: give X,Y,DEG in m and degrees{here}") from None
    if not all(math.isfinite(value) and abs(value) <= COORDINATE_MAX for value in (x_m, y_m, heading_deg)):
        raise InputError(f"{what} is {text!r}: give numbers up to {COORDINATE_MAX:g}")
    return x_m, y_m, math.radians(heading_deg)


COORDINATE_MAX = 1000.0


@contextmanager
def session_with(
    wire: Wire, dialect: str, image: Path, robot: Robot, key: Path | None
) -> Iterator[LabSession]:
    """Yield a session over a wire in a robot's protocol; ``key`` is the file of its owner's key."""
    if dialect == "frogkick":
        yield lab_session(wire, key)
        return
    with built_firmware("native", image, robot) as built:
        core = TextRobot(wire, NativeRobot(built.image, len(robot.limbs), heat_known=False), robot)
        try:
            yield LabSession(core)
        finally:
            core.close()


class Operator(Protocol):
    """A person beside a real robot, who permits arming and may stop the run."""

    def wait_to_arm(self) -> None:
        """Return when the robot may be armed."""

    def pressed(self) -> bool:
        """Return whether the run shall stop."""


class _NoOperator:
    def wait_to_arm(self) -> None:
        pass

    def pressed(self) -> bool:
        return False


Operators = Callable[[bool], AbstractContextManager[Operator]]
"""Makes the operator; its argument is whether standard input carries fixes."""


def no_operator(_stdin_is_taken: bool) -> AbstractContextManager[Operator]:
    """Yield an operator that arms without asking and never stops the run."""
    return nullcontext(_NoOperator())


@dataclass(frozen=True)
class Bench:
    """The options of ``run`` for a real robot, by its names. A simulated one has none of them.

    An option that does not fit the robot, or is missing, raises an ``InputError``.
    """

    robot: str
    fixes: str | None = None
    source: str = "0"
    begin: str | None = None
    fix_rate_hz: float = 15.0
    seed: int = 0
    world: World | Path | str | None = None
    dialect: str = "frogkick"
    battery_v: float | None = None
    out: Path | None = None
    video: bool = False
    operator: Operators = no_operator
    wire: Wire | None = None
    key: Path | str | None = None
    view: bool = False
    stop: Callable[[], None] | None = None  # called by the page's button

    def __post_init__(self) -> None:
        robot, fixes = self.robot, self.fixes
        require_dialect(self.dialect)
        if not is_target(robot):
            for name, value in (
                ("--fixes", fixes),
                ("--dialect", None if self.dialect == "frogkick" else self.dialect),
                ("--battery-v", self.battery_v),
                ("--begin", self.begin),
                ("--key", self.key),
                ("--source", None if self.source == "0" else self.source),
            ):
                if value is not None:
                    raise InputError(
                        f"{name} {value} is for a real robot, but --robot is {robot!r}: leave it out, or "
                        f"give --robot {' or '.join(FORMS)}"
                    )
        else:
            self._require_complete()
        if self.video and fixes in (None, STDIN, POOL):
            raise InputError(
                "--video records a camera's pictures, but this run has no camera: give --fixes camera.toml"
            )
        if self.video and self.out is None:
            raise InputError("--video is written next to the log: give --out run.h5")

    def _require_complete(self) -> None:
        """Raise InputError for options that are missing or do not fit a real robot."""
        robot, fixes, begin = self.robot, self.fixes, self.begin
        require_wire(parse_target(robot))
        if self.key is not None:
            read_keys(Path(self.key))
        if self.world is not None and fixes != POOL:
            world = "given" if isinstance(self.world, World) else str(self.world)
            raise InputError(
                f"--world {world!r} is for a simulated pool, but --robot is {robot!r}: leave it out"
            )
        if fixes is None:
            raise InputError(
                f"--robot {robot} needs position fixes, and none are given: pipe them in from a tracker, "
                "as lines 'x_m y_m heading_rad [age_s]', with --fixes stdin, or give the calibration of the "
                "camera over the pool, as --fixes camera.toml; for a kit without limbs --fixes pool"
            )
        if fixes not in (STDIN, POOL) and not fixes.endswith(".toml"):
            raise InputError(
                f"--fixes is {fixes!r}{nearest_name(fixes, (STDIN, POOL))}: choose stdin, pool, or the file "
                "of 'frogkick camera calibrate' (.toml)"
            )
        if fixes == POOL and (begin is not None or self.battery_v is not None):
            name = "--battery-v" if begin is None else "--begin"
            raise InputError(
                f"{name} is for a robot in water, but --fixes pool is for a kit without limbs: leave it out"
            )
        if begin not in (None, "here"):
            parse_begin(str(begin))

    @contextmanager
    def opened(
        self, robot: Robot, tables: Tables, path: SwimPath, world: World
    ) -> Iterator[tuple[LineFixes | CameraFixes | PoolFixes, tuple[float, float] | None]]:
        """Yield the running source, and the pool's length and width if they are known.

        In a simulated pool the robot starts at the path.
        """
        if self.fixes == STDIN:
            yield LineFixes(sys.stdin.fileno(), "standard input"), None
            return
        if self.fixes == POOL:
            rng = noise_of_run(self.seed, path.name, len(path))
            yield PoolFixes(robot, tables, start_pose(path), rng, self.fix_rate_hz, world), None
            return
        calibration = read_calibration(Path(str(self.fixes)))
        name = f"camera {self.source}" if self.source.isdigit() else self.source
        frames = open_source(self.source, calibration.image_px)
        camera = CameraFixes(frames, calibration, name)
        try:
            yield camera, calibration.pool_m
        finally:
            camera.close()


def _compile_planner(tables: Tables, path: SwimPath, config: PlanConfig, drawn: bool) -> None:
    """Compile the host's planner before the robot is armed; later it would delay fixes for minutes."""
    with noted_if_slow(lambda: tell_line("compiling the host's planner (once; a minute or two)")):
        decision = warm_up(tables, path, config)
        if drawn and decision.status == 0:
            tree_of(tables, path, config, decision)


def run_on_bench(
    bench: Bench, world: World, image: Path, recording: Recording, progress: Callable[[float, int], None]
) -> None:
    """Run a real robot. The robot is disarmed however the run ends.

    The checks before the start are reported on stderr, one line each.

    Args:
        bench: the robot and its surroundings.
        world: the true effects of a simulated pool.
        image: table image of the recording's tables.
        recording: says what to follow; its paths are placed, and the run is recorded in it.
        progress: see ``run_session``.
    """
    robot, tables = recording.robot, recording.tables
    path, options = recording.path, recording.options
    key = None if bench.key is None else Path(bench.key)
    battery = "battery: none, a kit" if bench.fixes == POOL else check_battery(robot, bench.battery_v)
    greeting = DELIMITER if bench.dialect == "frogkick" else pulse_line(tables.pulse_us)
    with ExitStack() as stack:
        stack.enter_context(stops_are_interrupts())
        if bench.view or options.check is not None or not options.onboard:
            _compile_planner(tables, path, options.config, bench.view)
        fixes, pool_m = stack.enter_context(bench.opened(robot, tables, path, world))
        camera = fixes if isinstance(fixes, CameraFixes) else None
        fixes.wait_first(FIRST_FIX_S)
        seen = look(fixes, time.monotonic, time.sleep)
        if seen:
            newest = [float(value) for value in seen[-1].pose_world]
            path, then = placed(path, options.then, bench.begin, newest)
            options = replace(options, then=then)
        later = [one.path for one in options.then if not one.here]
        if options.hold_m is not None:
            require_room(path, options.hold_m, options.config)
            later += [hold_at_end(one, options.hold_m).entry for one in (path, *later)]
        checked = check_start(seen, path, pool_m, later)
        wire = bench.wire or stack.enter_context(opened(parse_target(bench.robot), greeting))
        session = stack.enter_context(session_with(wire, bench.dialect, image, robot, key))
        session.handshake(tables)

        def tell(line: str) -> None:
            tell_line(f"start check: {line}")

        for line in (*checked, f"table: {tables.crc32:08x}, the robot's own", battery):
            tell(line)
        session.rest(tell, max(robot.guard.duty_window_s, robot.guard.rest_min_s) + 0.001)
        if bench.out is not None and bench.video and camera is not None:
            video = Video(bench.out, time.monotonic() - session.port.now_s)
            stack.callback(video.close)
            stack.callback(camera.close)  # before the video: its thread writes there
            camera.film(video)
        recording.path, recording.options = path, options
        recording.made = made_of(robot, tables, time.time() - session.port.now_s)
        write = stack.enter_context(logged(bench.out, recording))
        draw = stack.enter_context(viewed(bench.view, recording, camera, bench.stop))

        def keep(grown: Recording) -> None:
            write(grown)
            draw(grown)
            if isinstance(fixes, PoolFixes):
                fixes.follow(grown)

        operator = stack.enter_context(bench.operator(bench.fixes == STDIN))
        operator.wait_to_arm()
        asked = options.stop
        recording.options = replace(options, stop=lambda: operator.pressed() or asked())
        run_session(session, fixes, recording, progress, keep)
