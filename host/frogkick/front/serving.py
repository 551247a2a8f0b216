"""A simulated robot for everything that talks with a real one: a serial port, and a camera over its pool."""

from __future__ import annotations

import copy
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.arrays import UInt8
from frogkick.core.errors import InputError, nearest_name
from frogkick.core.files import existing_file, require_writable, write_bytes
from frogkick.core.interrupts import stops_are_interrupts
from frogkick.effects import World, read_world
from frogkick.front.bench import parse_begin
from frogkick.front.places import SIMULATED, built_firmware, require_simulator, tell_effects_left_out
from frogkick.front.tables import Table, load_table
from frogkick.link.pty_line import PtyLine, require_pseudo_terminals
from frogkick.pool.native_robot import NativeRobot, SimulatedPort
from frogkick.pool.pool import Camera, Pool, Truth
from frogkick.robot import Robot
from frogkick.runs.closed_loop import require_seed
from frogkick.vision.calibration import Calibration, read_calibration
from frogkick.vision.check import scene_of
from frogkick.vision.pose import tag_place
from frogkick.vision.scene import Conditions, Scene
from frogkick.vision.video import streamed

Pose = tuple[float, float, float]
RATE_HZ = 20.0
KEPT_EVERY_S = 0.5
BEHIND_S = 2.0
"""A simulation that is this far behind the clock will not catch up; a busy computer delays it by less."""
WORDS = ("put", "hide", "show", "mirror", "unplug", "plug", "restart")
"""The words that an open pool accepts on standard input."""
TRUTH_ROWS = 1000
"""Older true poses are deleted, because the pool may be open for days."""


class ServedPool:
    """An open pool in real time, with a robot behind a serial port (a ``Listener``): bytes in, bytes out.

    The limbs that the robot actuates move it through the water.
    """

    sleep_s = 0.005  # until the next tick; so long ago a picture shows at most what was true
    source = ""  # the camera, as ``--source`` takes it
    picture = ""  # address of a single picture
    line: PtyLine

    def __init__(
        self,
        table: Table,
        begin: Pose,
        pool: Pool,
        scene: Scene,
        calibration: Calibration | None,
        switch_on: Callable[[bytes | None], SimulatedPort],
        flash: Path | None,
        held: bytes | None,
        seed: int,
    ) -> None:
        """Switch the robot on, at rest in the pool.

        Args:
            table: in the robot's firmware.
            begin: x (m), y (m) and heading (rad) at which the robot lies at first.
            switch_on: makes a robot whose clock is 0, from what its flash holds; None: as it was flashed.
            flash: file in which its flash is kept; None: in none.
            held: what that file holds.
            seed: of the pictures' noise.
        """
        self.table, self.begin, self.flash = table, begin, flash
        self._pool, self._scene, self._calibration = pool, scene, calibration
        self._switch_on, self._seed, self._lock = switch_on, seed, threading.Lock()
        self._pool_begin_s = time.monotonic() - pool.time_s
        self._kept: bytes | None = None  # in the flash's file
        self._kept_s, self._taken = 0.0, 0
        self._covered, self._mirrored = False, False  # the tag, the pictures
        self._behind_s = 0.0  # how far the simulation is behind the clock
        self._start(held)
        self._pose = self._true_pose()  # true a moment ago

    def _start(self, flash: bytes | None) -> None:
        self._port = self._switch_on(flash)
        self._begin_s = time.monotonic()

    def _true_pose(self) -> Pose:
        x_m, y_m, heading_rad = (float(value) for value in self._pool.state()[0])
        return x_m, y_m, heading_rad

    def feed(self, data: bytes) -> bytes:
        """Take bytes from the wire."""
        with self._lock:
            if data:
                self._port.send(data, time.monotonic() - self._begin_s)
            return b""

    def tick(self) -> bytes:
        """Let robot and pool live up to now (ConvergenceError: they cannot); return what the robot sent."""
        with self._lock:
            now_s = time.monotonic()
            self._port.advance(now_s - self._begin_s)
            shift_s = self._begin_s - self._pool_begin_s  # pool time minus the robot's
            for edge in self._port.edges():
                if edge.level:
                    at_s = max(edge.time_s + shift_s, self._pool.time_s)
                    self._pool.advance(at_s)
                    self._pool.actuate(edge.limb, at_s)
            self._pool.advance(max(now_s - self._pool_begin_s, self._pool.time_s))
            if len(self._pool.truth.time_s) > TRUTH_ROWS:
                self._pool.truth = Truth()
            self._pose = self._true_pose()
            self._behind_s = time.monotonic() - now_s
            return b"".join(data for _, data in self._port.received())

    @property
    def target(self) -> str:
        """The robot, as ``--robot`` takes it."""
        return f"serial:{self.line.path}"

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``pool``."""
        x_m, y_m, heading_rad = self.begin
        return {
            "target": self.target,
            "source": self.source,
            "picture": self.picture,
            "robot": self.table.robot.id,
            "table_crc": f"{self.table.crc32:08x}",
            "pool_m": list(self._scene.pool_m),
            "begin": f"{x_m:g},{y_m:g},{math.degrees(heading_rad):g}",
        }

    def seen(self) -> UInt8:
        """Render what the camera sees now; several viewers may ask at once."""
        self._taken += 1
        pose = self._pose
        if self._calibration is not None:
            x_m, y_m, heading_rad = (float(value) for value in tag_place(self._calibration, *pose))
            pose = (x_m, y_m, heading_rad)
        rng = np.random.default_rng((self._seed, self._taken))
        image = self._scene.picture(None if self._covered else pose, rng)
        return np.ascontiguousarray(image[:, ::-1]) if self._mirrored else image

    def look_after(self) -> None:
        """Write the flash's file if the flash has changed; call it from time to time."""
        if self.line.error is not None:
            raise self.line.error
        if self._behind_s > BEHIND_S:
            raise InputError(
                f"the simulation is {self._behind_s:.1f} s behind the clock: stop other programs, "
                "or leave out --virtual"
            )
        now_s = time.monotonic()
        if self.flash is not None and now_s - self._kept_s >= KEPT_EVERY_S:
            self._kept_s = now_s
            self.keep()

    def keep(self) -> None:
        """Write the flash's file, if the flash has changed."""
        with self._lock:
            content = self._port.flash_content()  # tables, and the owner's key
        if self.flash is not None and content != self._kept:
            write_bytes(self.flash, content)
            self._kept = content

    def act(self, text: str) -> str:
        """Do what one of ``WORDS`` says; return what was done."""
        word, _, rest = text.strip().partition(" ")
        if word not in WORDS or (rest and word != "put"):
            raise InputError(
                f"{text.strip()!r}{nearest_name(word, WORDS)} is no command of this pool: give one of "
                f"{', '.join(WORDS)}"
            )
        if word == "put":
            pose = _pose_in(self._scene.pool_m, rest.strip(), "put") if rest.strip() else self.begin
            with self._lock:
                self._pool.put(pose)
                self._pose = self._true_pose()
            return f"the robot lies at {pose[0]:g}, {pose[1]:g} m, {math.degrees(pose[2]):g} degrees"
        if word in ("hide", "show"):
            self._covered = word == "hide"
            return "the tag is covered" if self._covered else "the tag is uncovered"
        if word == "mirror":
            self._mirrored = not self._mirrored
            return f"the camera's pictures are {'' if self._mirrored else 'not '}mirrored"
        if word == "restart":
            with self._lock:  # only the robot's flash outlives that
                self._start(self._port.flash_content())
            return "the robot was switched off and on"
        if (word == "plug") is self.line.is_plugged_in:
            return f"the cable is {'plugged in' if word == 'plug' else 'pulled'} already"
        if word == "unplug":
            self.line.pull_out()
            return "the cable is pulled"
        self.line.plug_in()
        return f"the cable is plugged in: {self.target}"


@contextmanager
def served_pool(
    table: Table | Path | str | None = None,
    *,
    model: Robot | str | None = None,
    robot: str = "pool",
    world: World | Path | str | None = None,
    camera: Path | str | None = None,
    begin: str | None = None,
    flash: Path | str | None = None,
    line: Path | str | None = None,
    port: int = 0,
    seed: int = 0,
) -> Iterator[ServedPool]:
    """Open a pool with a simulated robot that lives in real time, as long as the context lives.

    ``robot`` is "pool" (the C core on this computer) or "virtual" (the firmware on the virtual chip). The
    other arguments are the options of the command ``pool``; ``seed`` is that of the pictures' noise and of
    random effects.
    """
    require_pseudo_terminals()
    require_simulator(robot)
    require_seed(seed)
    if not 0 <= port <= 65_535:
        raise InputError(f"--port is {port}: give 1 to 65535, or 0 for a free one")
    kept = None if flash is None else Path(flash)
    require_writable(kept)
    held = existing_file(kept, "flash").read_bytes() if kept is not None and kept.exists() else None
    calibration = None if camera is None else read_calibration(Path(camera))
    scene = Scene() if calibration is None else scene_of(calibration, Conditions())
    length_m, width_m = scene.pool_m
    first = (0.3 * length_m, 0.5 * width_m, 0.0)
    if begin is not None:
        first = _pose_in(scene.pool_m, begin, "--begin")
    used = load_table(table, model)
    described, limbs = used.robot, len(used.robot.limbs)
    # An effect may keep state.
    true = World() if world is None else copy.deepcopy(read_world(world, described))
    tell_effects_left_out(described, true)
    rng = np.random.default_rng(seed)
    with ExitStack() as stack:
        stack.enter_context(stops_are_interrupts())
        image = stack.enter_context(used.file())
        built = stack.enter_context(built_firmware(SIMULATED[robot], image, described))
        switch_on = _maker(robot, built.image, limbs)
        pool = Pool(described, first, Camera(rate_hz=1.0), rng, true)
        pool.advance(1e-3)  # compiles the rods if needed
        opened = ServedPool(used, first, pool, scene, calibration, switch_on, kept, held, seed)
        opened.line = stack.enter_context(PtyLine(None if line is None else Path(line), opened))
        opened.source, opened.picture = stack.enter_context(streamed(opened.seen, RATE_HZ, port))
        try:
            yield opened
        finally:
            opened.keep()


def _maker(name: str, image: Path, limbs: int) -> Callable[[bytes | None], SimulatedPort]:
    """Return what switches a robot on, whose RAM holds nothing, so that its limbs rest first."""
    if name == "pool":
        return lambda flash: NativeRobot(image, limbs, heat_known=False, flash=flash)
    from frogkick.pool.virtual_robot import VirtualRobot

    def switch_on(flash: bytes | None) -> SimulatedPort:
        if flash is not None:
            fresh = np.frombuffer(VirtualRobot(image, limbs).flash_content(), dtype=np.uint8)
            held = np.frombuffer(flash, dtype=np.uint8)
            if len(held) != len(fresh) or (held != fresh)[fresh != 0xFF].any():
                raise InputError(
                    "the flash holds other firmware than this table gives: give the --tables that it was "
                    "made with, or another --flash"
                )
        return VirtualRobot(image, limbs, flash, heat_known=False)

    return switch_on


def _pose_in(pool_m: tuple[float, float], text: str, what: str) -> Pose:
    x_m, y_m, heading_rad = parse_begin(text, what)
    if not (0.0 <= x_m <= pool_m[0] and 0.0 <= y_m <= pool_m[1]):
        raise InputError(
            f"{what} {text} is outside the pool: give x and y from 0,0 to {pool_m[0]:g},{pool_m[1]:g} m"
        )
    return x_m, y_m, heading_rad
