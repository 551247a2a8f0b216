"""A simulated robot in a simulated pool that live in real time, behind a serial port: a ``Listener``."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from frogkick.pool.native_robot import SimulatedPort
from frogkick.pool.pool import Pool, Truth

TRUTH_ROWS = 1000
"""The pool forgets what was true longer ago: it may be open for days."""


class ServedRobot:
    """Bytes in, bytes out; the limbs that the robot actuates move it through the water."""

    sleep_s = 0.005  # until the next tick; so long ago a picture shows at most what was true

    def __init__(
        self,
        switch_on: Callable[[bytes | None], SimulatedPort],
        pool: Pool,
        flash: bytes | None = None,
    ) -> None:
        """Switch the robot on.

        Args:
            switch_on: makes a robot whose clock is 0, from what its flash holds; None: as it was flashed.
            pool: with the robot at rest in it.
            flash: what its flash holds.
        """
        self._switch_on, self._pool = switch_on, pool
        self._lock = threading.Lock()
        self._pool_begin_s = time.monotonic() - pool.time_s
        self._start(flash)
        self.pose_world = self._pose()  # true a moment ago
        self.behind_s = 0.0  # how far the simulation is behind the clock

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
            self.pose_world = self._pose()
            self.behind_s = time.monotonic() - now_s
            return b"".join(data for _, data in self._port.received())

    def put(self, pose_world: tuple[float, float, float]) -> None:
        """Lay the robot down elsewhere, at rest."""
        with self._lock:
            self._pool.put(pose_world)
            self.pose_world = self._pose()

    def restart(self) -> None:
        """Switch the robot off and on: only its flash outlives that."""
        with self._lock:
            self._start(self._port.flash_content())

    def flash_content(self) -> bytes:
        """What outlives a loss of power: tables, and the owner's key."""
        with self._lock:
            return self._port.flash_content()

    def _start(self, flash: bytes | None) -> None:
        self._port = self._switch_on(flash)
        self._begin_s = time.monotonic()

    def _pose(self) -> tuple[float, float, float]:
        x_m, y_m, heading_rad = (float(value) for value in self._pool.state()[0])
        return x_m, y_m, heading_rad
