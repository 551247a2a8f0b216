"""The simulated pool: a robot as rods in water, and a camera over it with late and noisy position fixes."""

from __future__ import annotations

import heapq
import math
import zlib
from dataclasses import dataclass, field, replace

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import ConvergenceError, InputError
from frogkick.core.poses import Fix, wrap_angle
from frogkick.der import Batch, prepare
from frogkick.effects import Acting, World, changed_robot
from frogkick.robot import Robot


@dataclass(frozen=True)
class Camera:
    """Rate, delay, noise and faults of the fixes. The defaults were measured on the paper's recorded runs."""

    rate_hz: float = 15.0  # fixes per second (every second frame of a 30 Hz camera was logged)
    # from capture to arrival at the robot; the recorded label-to-motion time of 0.07 to 0.09 s
    delay_s: float = 0.08
    position_noise_m: float = 0.2e-3  # standard deviation of each coordinate, measured at rest
    heading_noise_rad: float = float(np.deg2rad(0.2))  # standard deviation of the heading, measured at rest
    jitter_s: float = 0.0  # largest additional delay, uniformly distributed
    lost: float = 0.0  # share of pictures without a fix
    # share of fixes that arrive twice, the second time up to 0.2 s later with an unchanged age
    doubled: float = 0.0
    held: float = 0.0  # share of fixes that arrive after those of the next two pictures
    outliers: float = 0.0  # share of wrong fixes
    outlier_m: float = 0.5  # largest error of a wrong fix in each coordinate; its heading is random

    def __post_init__(self) -> None:
        limits = {
            "rate_hz": (1.0, 120.0),
            "delay_s": (0.0, 1.0),
            "position_noise_m": (0.0, 0.1),
            "heading_noise_rad": (0.0, 1.0),
            "jitter_s": (0.0, 2.0),
            "outlier_m": (0.0, 10.0),
            **dict.fromkeys(("lost", "doubled", "held", "outliers"), (0.0, 1.0)),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(
                    f"camera {name} is {value}, allowed is {low} to {high}: give a number in that range"
                )


def noise_of_run(seed: int, path_name: str, points: int) -> np.random.Generator:
    """Random generator for a run along a path.

    With one seed, runs along different paths have different noise, because identification assumes the fixes
    of several runs to be independent. Runs along one path have the same noise, so that they can be compared.
    """
    return np.random.default_rng([seed, zlib.crc32(f"{path_name} {points}".encode())])


def measure(
    camera: Camera, sequence: int, capture_s: float, pose_world: Float64, rng: np.random.Generator
) -> Fix:
    """The fix of a true pose (3,) in a picture of pool time ``capture_s``; three draws from ``rng``."""
    sigma = np.array([camera.position_noise_m, camera.position_noise_m, camera.heading_noise_rad])
    noisy = np.asarray(pose_world, dtype=np.float64) + sigma * rng.standard_normal(3)
    noisy[2] = wrap_angle(noisy[2])
    return Fix(capture_s, camera.delay_s, *noisy.astype(np.float32).tolist(), sequence=sequence & 0xFFFF)


def deliver(camera: Camera, fix: Fix, rng: np.random.Generator) -> list[Fix]:
    """The fixes that arrive for a measured one: none, one (late or wrong), or two.

    A camera without jitter and faults draws nothing from ``rng``.
    """
    if not (camera.jitter_s or camera.lost or camera.doubled or camera.held or camera.outliers):
        return [fix]
    lost, doubled, held, wrong = rng.random(4) < (camera.lost, camera.doubled, camera.held, camera.outliers)
    late_s = camera.jitter_s * rng.random() + (2.5 / camera.rate_hz if held else 0.0)
    off_m, turn_rad = rng.uniform(-camera.outlier_m, camera.outlier_m, 2), rng.uniform(-np.pi, np.pi)
    again_s = rng.uniform(0.0, 0.2)
    if lost:
        return []
    came = replace(fix, delay_s=fix.delay_s + late_s)
    if wrong:
        came = replace(came, x_m=fix.x_m + off_m[0], y_m=fix.y_m + off_m[1], heading_rad=turn_rad)
    return [came, replace(came, capture_s=came.capture_s + again_s)] if doubled else [came]


WATER_MOST_MPS = 1.0
"""Fastest water at the start of a robot: ten times what a robot swims, and far more than it can follow."""


@dataclass
class Truth:
    """True motion, a row for each camera picture, which no planner sees."""

    time_s: list[float] = field(default_factory=list)  # pool time of each row
    pose_world: list[Float64] = field(default_factory=list)  # x_m, y_m, heading_rad of each row
    velocity_body: list[Float64] = field(default_factory=list)  # vx_mps, vy_mps, omega_rad_s of each row


class Pool:
    """A robot that is actuated by pulses and seen by a camera. The physics is the rod simulation."""

    def __init__(
        self,
        robot: Robot,
        pose_world: tuple[float, float, float],
        camera: Camera,
        rng: np.random.Generator,
        world: World = World(),  # noqa: B008 - frozen
    ) -> None:
        """Start with a robot at rest.

        Args:
            robot: the robot without the effects of ``world``.
            pose_world: x_m, y_m, heading_rad of its start.
            rng: for the camera's noise; random effects get streams of their own.
            world: effects on the robot, the water and the camera.

        Raises:
            InputError: an effect that does not fit, water that is faster than WATER_MOST_MPS at the start, or
                a pose that is not finite.
        """
        self.robot = robot
        self.camera = camera
        self.truth = Truth()
        self._true_robot = changed_robot(robot, world.effects)
        self._acting = Acting(world.effects, self._true_robot, rng.spawn(1))
        self._rods = prepare(self._true_robot)
        self._batch = self._at_rest(pose_world, 0.0)
        if (water_mps := self._water_mps()) > WATER_MOST_MPS:
            raise InputError(
                f"the effects of the world move the water at {water_mps:g} m/s where the robot starts, "
                f"{WATER_MOST_MPS:g} m/s is the most that is simulated: correct the current in its file"
            )
        self._rng = rng
        self._captured = 0
        self._sent = 0
        self._waiting: list[tuple[float, int, Fix]] = []

    @property
    def time_s(self) -> float:
        """Time of the simulation, from 0 at the start."""
        return float(self._batch.time_s[0])

    @property
    def next_event_s(self) -> float:
        """Time of the next picture or the next arrival of a fix."""
        arrival_s = self._waiting[0][0] if self._waiting else np.inf
        return float(min(self._next_capture_s, arrival_s))

    @property
    def _next_capture_s(self) -> float:
        return (self._captured + 1) / self.camera.rate_hz

    def state(self) -> tuple[Float64, Float64]:
        """True pose (3,) in the world and velocity (3,) in the body frame, which no planner sees."""
        return self._batch.pose_world()[0], self._batch.velocity_body()[0]

    def put(self, pose_world: tuple[float, float, float]) -> None:
        """Place the robot elsewhere, at rest; the history of its limbs is kept."""
        self._batch = self._at_rest(pose_world, self.time_s)

    def _at_rest(self, pose_world: tuple[float, float, float], time_s: float) -> Batch:
        if not all(map(math.isfinite, pose_world)):
            raise InputError(f"the robot lies at {pose_world}: give a finite x_m, y_m, heading_rad")
        return Batch([self._rods], np.array([pose_world]), np.zeros((1, 3)), time_s, width=1)

    def actuate(self, limb: int, start_s: float) -> None:
        """Start a limb's measured stroke, of the nominal pulse, at a pool time not before ``time_s``.

        Raises:
            InputError: no limb of the robot, a time that has passed, or one that is not finite.
        """
        if not 0 <= limb < self._batch.limbs:
            raise InputError(f"limb of robot {self.robot.id!r} is {limb}: give 0 to {self._batch.limbs - 1}")
        if not self.time_s - 1e-9 <= start_s < math.inf:
            raise InputError(f"limb {limb} fired for {start_s} s at {self.time_s} s: fire now or later")
        self._acting.fire(self._batch, 0, limb, start_s)

    def advance(self, until_s: float) -> list[Fix]:
        """Advance to a pool time (ConvergenceError: the rods fail); return the fixes that have arrived."""
        arrived = []
        while self.next_event_s <= until_s:
            event_s = self.next_event_s
            if self._next_capture_s <= event_s:
                self._capture()
            else:
                arrived.append(heapq.heappop(self._waiting)[2])
        self._swim(until_s)
        return arrived

    def _swim(self, until_s: float) -> None:
        # Times of a picture and a decision may differ by rounding; rods cannot take a step of 1e-15 s.
        if until_s - self.time_s > 1e-9:
            self._acting.advance(self._batch, until_s)
            for failure in self._batch.failures.values():
                raise ConvergenceError(f"rods of {self.robot.id!r} {failure}{self._world_too()}")

    def _water_mps(self) -> float:
        """Speed of the water at the robot."""
        pose, velocity = self.state()
        return math.hypot(*self._acting.water(self._batch, self.time_s, pose, velocity).flow_mps)

    def _world_too(self) -> str:
        """The end of an error's text: what else may be wrong if the world has effects."""
        names = ", ".join(effect.title for effect in self._acting.effects)
        moved = f"the water moves at {self._water_mps():.3g} m/s there"
        return f", and the effects of the world ({names}): {moved}" if names else ""

    def _capture(self) -> None:
        self._swim(self._next_capture_s)
        pose, velocity = self.state()
        self.truth.time_s.append(self.time_s)
        self.truth.pose_world.append(pose)
        self.truth.velocity_body.append(velocity)
        fix = self._seen(measure(self.camera, self._captured, self._next_capture_s, pose, self._rng))
        self._captured += 1
        for arriving in deliver(self.camera, fix, self._rng) if fix is not None else ():
            self._sent += 1
            heapq.heappush(self._waiting, (arriving.arrival_s, self._sent, arriving))

    def _seen(self, fix: Fix) -> Fix | None:
        """A fix after the effects of the world; None if it is lost."""
        if not self._acting.effects:
            return fix
        seen = self._acting.fix(replace(fix))
        if seen is None:
            return None
        delay_s = max(seen.delay_s, fix.capture_s - seen.capture_s)  # it arrives after the picture
        heading_rad = math.remainder(seen.heading_rad, math.tau)
        return replace(seen, delay_s=delay_s, heading_rad=heading_rad, sequence=fix.sequence)
