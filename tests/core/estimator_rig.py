"""Random streams and swims for tests of the estimator: fixes with every fault; the C beside the Python."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from tests.core.core import ACTION_ROWS, FFI, PERIOD_US, RESTING, STATUS, core, image, pick
from tests.planner import synthetic

from frogkick.estimator.estimator import FUTURE_US, STALE_US, UNKNOWN_US, Estimator
from frogkick.estimator.track import PERIOD_LEAST_US
from frogkick.estimator.wear import HELD, OFF, ON
from frogkick.tables.image import Tables, open_image

Pose = npt.NDArray[np.float32]
ESTIMATOR_BYTES_MAX = 2560

# One whose limbs wear, one that knows the limbs' use and their wear, one without a resting action, one with
# slow limbs, one of short periods.
IMAGES = {
    "usual": lambda: image(limb_wear=np.zeros((4, 0, 6))),
    "worn": lambda: image(),
    "affine": lambda: synthetic.affine_image(
        40, len(ACTION_ROWS), action_rows=ACTION_ROWS, limb_wear=synthetic.wear_curves(4, 5, 6)
    ),
    "restless": lambda: image(action_rows=[(n, f or 1, s) for n, f, s in ACTION_ROWS]),
    "slow limbs": lambda: image(second_delay_us=900_000),
    "short": lambda: image(period_us=330_000),
}


@cache
def table(name: str) -> tuple[bytes, Tables]:
    content = IMAGES[name]()
    return content, open_image(content)


class CEstimator:
    """The estimator in C, with the methods of the one in Python."""

    def __init__(self, name: str = "usual", made: Any = None) -> None:
        self._core = core() if made is None else made
        self._memory = FFI.new("fk_test_estimator_t *")
        content = table(name)[0]
        self._image = FFI.new("uint64_t[]", (len(content) + 7) // 8)
        FFI.memmove(self._image, content, len(content))
        at = FFI.cast("uint8_t *", self._image)
        assert self._core.fk_test_estimator_init(self._memory, at, len(content)) == 0
        self._state, self._numbers = np.zeros(6, dtype=np.float32), FFI.new("uint32_t[10]")

    def add(self, capture_us: int, pose: Pose, sequence: int) -> int:
        given = FFI.from_buffer("float[]", np.asarray(pose, dtype=np.float32))
        return int(self._core.fk_test_estimator_add(self._memory, capture_us, given, sequence & 0xFFFF))

    def act(self, at_us: int, action: int) -> None:
        self._core.fk_test_estimator_act(self._memory, at_us, action)

    def learn(self, learn: int) -> None:
        self._core.fk_test_estimator_learn(self._memory, learn)

    def end_period(self, at_us: int) -> None:
        self._core.fk_test_estimator_end_period(self._memory, at_us)

    def at(self, at_us: int) -> tuple[bytes, tuple[int, ...]] | None:
        state = FFI.from_buffer("float[]", self._state, require_writable=True)
        status = self._core.fk_test_estimator_at(self._memory, at_us, state, self._numbers)
        assert status in (0, STATUS["STALE"])
        return None if status else (self._state.tobytes(), tuple(self._numbers))

    def state(self, at_us: int) -> npt.NDArray[np.float64]:
        found = self.at(at_us)
        assert found is not None
        return np.frombuffer(found[0], dtype=np.float32).astype(np.float64)

    def inside(self) -> tuple[bytes, tuple[int, ...]]:
        """Its whole state as bytes, and (instants, fixes, restarts)."""
        values, counts = np.zeros(200, dtype=np.float32), FFI.new("uint32_t[3]")
        to = FFI.from_buffer("float[]", values, require_writable=True)
        used = self._core.fk_test_estimator_inside(self._memory, to, counts)
        return values[:used].tobytes(), tuple(counts)

    def newest(self) -> npt.NDArray[np.float32]:
        """(2,) predicted position at the newest instant."""
        values, (instants, *_) = self.inside()
        return np.frombuffer(values, np.float32)[: 6 * instants].reshape(3, -1)[:2, -2]

    def spoil(self, speed: int, value: float) -> None:
        self._core.fk_test_estimator_spoil(self._memory, speed, value)


class Twin:
    """The estimator in Python, its results as bytes."""

    def __init__(self, name: str = "usual") -> None:
        self._twin = Estimator(table(name)[1])
        self.add, self.act, self.learn = self._twin.add, self._twin.act, self._twin.track.learn

    def at(self, at_us: int) -> tuple[bytes, tuple[int, ...]] | None:
        found = self._twin.at(at_us)
        if found is None:
            return None
        return found.state.tobytes(), (found.fix_sequence, found.fixes, *map(int, found.limb_use))

    def end_period(self, at_us: int) -> None:
        if self._twin.at(at_us) is not None:
            self._twin.track.end_period(at_us)

    def inside(self) -> tuple[bytes, tuple[int, ...]]:
        track = self._twin.track
        count = len(track.instants)
        values = [track.mean, track.covariance] if count else []
        values.append(track.process_noise)
        if (wear := track.wear) is not None:
            sums = wear._information[np.tril_indices(len(wear._vector))]
            values += [sums, wear._vector, wear.current, wear.codes]
        content = b"".join(part.astype(np.float32).tobytes() for part in values)
        return content, (count, self._twin._fixes, self._twin.restarts)

    def spoil(self, speed: int, value: float) -> None:
        self._twin.track.mean[0, speed - 2] = value


WILD = np.array(
    [np.nan, np.inf, -np.inf, 1000.0, -1000.0, 1000.0001, -1e30, 0.0, -0.0, 1e-40, 3.1415927, -3.1415927],
    dtype=np.float32,
)


@dataclass
class Stream:
    """Random inputs of an estimator in their order: (kind, time_us, value, sequence).

    The value is a pose, an action, or whether to learn what limbs have lost.
    """

    table: str
    events: list[tuple[str, int, Any, int]]


def stream(seed: int) -> Stream:
    """Fixes with every fault, decisions, queries, gaps, and a robot that is moved by hand."""
    if seed % 100 == 7:
        return obedient(seed)
    if seed % 40 == 14:
        return worn(seed)
    rng = np.random.default_rng(seed)
    name = str(rng.choice([name for name in IMAGES if name != "worn"], p=[0.4, 0.3, 0.1, 0.1, 0.1]))
    begin_us = pick(rng, [2 * 10**6, 3 * 10**6 + 1, 2**32 - 2 * 10**6, 2**53, 2**62])
    period_us = pick(rng, [table(name)[1].period_us, 1_423_000, 1_428_000, 500_000])
    rate_hz = pick(rng, [2, 5, 10, 15, 30, 60])
    end_us = begin_us + int(rng.choice([6, 12, 25, 150], p=[0.6, 0.3, 0.08, 0.02]) * 1e6 / rate_hz)
    late_us = pick(rng, [0, 80_000, 300_000])
    pose = np.array([*rng.uniform(-2, 2, 2), pick(rng, [0.0, 3.1, -3.1, rng.uniform(-20, 20)])])
    if rng.random() < 0.05:
        pose[:2] = rng.uniform(-999, 999, 2)
    speed = np.array([*rng.normal(0, 0.03, 2), rng.normal(0, 0.2)])
    wild = pick(rng, [0.0, 0.02, 0.3])
    events: list[tuple[int, tuple[str, int, Any, int]]] = []
    time_us, sequence = begin_us + int(rng.integers(0, 200_000)), pick(rng, [0, 65_530])
    while time_us < end_us:
        kind = rng.random()
        if kind < 0.01:
            time_us += pick(rng, [400_000, 700_000, 3_000_000, 20_000_000])  # nothing is seen
        elif kind < 0.02:
            pose[:2] += rng.uniform(-0.3, 0.3, 2)  # by hand
        fix = (pose + rng.normal(0, [2e-4, 2e-4, 3e-3])).astype(np.float32)
        if rng.random() < wild:
            fix[int(rng.integers(3))] = pick(rng, [*WILD, *rng.uniform(-0.5, 0.5, 12)])
        arrival_us = time_us + int(late_us * rng.uniform(0.5, 1.5))
        event = ("fix", time_us, fix, sequence)
        if rng.random() > 0.1:
            events.append((arrival_us, event))
        if rng.random() < 0.05:  # twice; the second time with an age that is not its own
            again = ("fix", time_us + pick(rng, [0, 9000]), fix, sequence)
            events.append((arrival_us + int(rng.integers(0, 10**6)), again))
        moved_us = max(1, round(1e6 / rate_hz * pick(rng, [1.0, 1.0, rng.uniform(0.5, 1.5)])))
        time_us, sequence = time_us + moved_us, (sequence + 1) & 0xFFFF
        pose = pose + speed * moved_us * 1e-6
    at_us = begin_us + int(rng.integers(0, 10**6))
    while at_us < end_us:
        action = int(rng.integers(0, len(ACTION_ROWS) + 1))
        asked_us = at_us + pick(rng, [0, 0, 15_000, 160_000, 350_000])
        if rng.random() < 0.8:
            events += [(asked_us, (what, at_us, None, 0)) for what in ("at", "end_period")]
        if rng.random() < 0.9:
            events.append((asked_us, ("act", at_us, action, 0)))
        if rng.random() < 0.1:  # refused, or another instead
            again_us = at_us + pick(rng, [0, 0, 10_000, PERIOD_LEAST_US, 200_000])
            events.append((max(asked_us, again_us), ("act", again_us, RESTING, 0)))
        at_us += period_us if rng.random() < 0.95 else int(rng.integers(0, 3 * 10**6))
    for _ in range(3):
        asked_us = int(rng.integers(begin_us, end_us + 10**6))
        lead_us = int(pick(rng, [0, 1, -1, -FUTURE_US, STALE_US, -900_000, rng.integers(-600_000, 600_000)]))
        events.append((asked_us, ("at", asked_us + lead_us, None, 0)))
    for arrival_us, event in events[::17]:
        limit_us = pick(rng, [STALE_US, STALE_US + 1, -FUTURE_US, -FUTURE_US - 1])
        if event[0] == "fix":
            events.append((arrival_us, ("at", event[1] + limit_us, None, 0)))
    if name == "affine" and seed % 4 == 0:  # of any miss something is learned
        switched_us = [begin_us - 1, *rng.integers(begin_us, end_us, int(rng.choice([0, 0, 3]))).tolist()]
        events += [(int(us), ("learn", 0, pick(rng, [ON, ON, HELD, OFF]), 0)) for us in switched_us]
    if seed % 10 == 3:  # a fix from elsewhere is believed once nothing was seen for long enough
        last_us = max((event[1] for _, event in events if event[0] == "fix"), default=begin_us)
        seen_us = last_us + UNKNOWN_US + pick(rng, [0, 1])
        elsewhere = (pose + 0.5).astype(np.float32)
        events.append((max(seen_us, *(us for us, _ in events)), ("fix", seen_us, elsewhere, sequence)))
    return Stream(name, [event for _, event in sorted(events, key=lambda row: row[0])])


def obedient(seed: int) -> Stream:
    """A robot that moves exactly as the table predicts."""
    return _told("usual", swim(seed, 12, kick=0.0), [])


def worn(seed: int) -> Stream:
    """A robot that learns what its limbs have lost; some are worn, and more so from a moment on."""
    rng = np.random.default_rng([seed, 1])
    lost = [rng.choice([0, 0, rng.integers(32768), 32767], 4).tolist() for _ in range(2)]
    if (dice := np.random.default_rng([seed, 2])).random() < 0.25:  # all alike, and then perhaps one more
        lost = [[int(dice.integers(3000, 25_000))] * 4] * 2
        lost[1] = [*lost[1][:3], pick(dice, [lost[1][3], 32767])]
    given = swim(seed, int(rng.integers(8, 40)), kick=pick(rng, [0.0, 0.1, 0.5]), name="worn", lost=lost)
    begin_us, end_us = given.starts_us[0], given.starts_us[-1]
    switched_us = [begin_us - 1, *rng.integers(begin_us, end_us, int(rng.choice([0, 0, 2]))).tolist()]
    modes = [ON, *rng.choice([ON, ON, HELD, OFF], len(switched_us) - 1).tolist()]
    return _told("worn", given, [(us, ("learn", 0, m, 0)) for us, m in zip(switched_us, modes, strict=True)])


def _told(name: str, given: Swim, more: list[tuple[int, tuple[str, int, Any, int]]]) -> Stream:
    """The inputs of an estimator whose robot swims like this, and further ones, in order of time."""
    fixes = [(arrival_us, ("fix", time_us, pose, k)) for arrival_us, time_us, pose, k in on_time(given)]
    acts = list(zip(given.starts_us, given.actions, strict=True))
    asked = [(time_us, (what, time_us, None, 0)) for time_us, _ in acts for what in ("at", "end_period")]
    acted = [(time_us, ("act", time_us, action, 0)) for time_us, action in acts]
    every: list[tuple[int, tuple[str, int, Any, int]]] = [*fixes, *asked, *acted, *more]
    return Stream(name, [event for _, event in sorted(every, key=lambda row: row[0])])


def answers(life: Stream, estimator: CEstimator | Twin) -> list[object]:
    """All results of an estimator for a stream, and its state at the end."""
    said: list[object] = []
    for what, time_us, given, sequence in life.events:
        if what == "fix":
            said.append(("fix", estimator.add(time_us, given, sequence)))
        elif what == "act":
            estimator.act(time_us, given)
        elif what == "learn":
            estimator.learn(given)
        elif what == "end_period":
            estimator.end_period(time_us)
        else:
            said.append(("at", estimator.at(time_us)))
    return [*said, estimator.inside()]


@dataclass
class Swim:
    """A robot whose speed differs from the table's at random after each stroke, and its fixes.

    Attributes:
        starts_us: decision times.
        actions: at each.
        truth: (n, 6) state at each: pose world, velocity body.
        fixes: (capture_us, pose) in order.
    """

    starts_us: list[int]
    actions: list[int]
    truth: npt.NDArray[np.float64]
    fixes: list[tuple[int, Pose]]


def swim(
    seed: int,
    periods: int = 20,
    rate_hz: float = 15.0,
    noisy: bool = True,
    kick: float = 1.0,
    name: str = "usual",
    lost: list[list[int]] | None = None,
) -> Swim:
    """Simulate a swim in float64 by separate formulas: speed linear while limbs fire, then (u + u^2) / 2.

    ``kick`` scales the random change of speed of each stroke; ``lost`` is what the limbs have lost in the
    first half and in the second.
    """
    rng = np.random.default_rng(seed)
    arrays = table(name)[1]
    fire = 160_000 / PERIOD_US
    period_s = PERIOD_US * 1e-6
    state = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-3, 3), 0.02, 0.0, 0.0])
    begin_us = 5_000_000
    truth, actions, fixes = [state], [], []
    due_us = begin_us + int(rng.integers(0, 50_000))
    for period in range(periods):
        action = int(rng.integers(0, len(ACTION_ROWS)))
        heading = state[2]
        turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        code = np.round(state[3:] / arrays.velocity_scale)
        row = int(((arrays.states - code) ** 2).sum(axis=1).argmin())
        values = arrays.transitions[row, action]
        if lost is not None:
            values = values + arrays.worn(lost[2 * period // periods]).shift[action]
            values[:3] = np.clip(values[:3], -arrays.motion_limit, arrays.motion_limit)
        motion, after = values[:3] * arrays.motion_scale, values[3:] * arrays.velocity_scale
        kicked = kick * rng.normal(0, [0.002, 0.002, 0.02])
        motion, after = motion + 0.8 * period_s * kicked, after + 0.7 * kicked
        end = np.array([*(state[:2] + turn @ motion[:2]), heading + motion[2], *after])
        out = turn @ state[3:5]
        turned = np.array([[np.cos(end[2]), -np.sin(end[2])], [np.sin(end[2]), np.cos(end[2])]])
        begin_speed, end_speed = np.array([*out, state[5]]), np.array([*(turned @ after[:2]), after[2]])
        way = (end[:3] - state[:3]) / period_s
        glide = 1 - fire
        top = (way - begin_speed * fire / 2 - end_speed * glide * 7 / 12) / (fire / 2 + glide * 5 / 12)
        start_us = begin_us + period * PERIOD_US
        while due_us < start_us + PERIOD_US:
            x = (due_us - start_us) / PERIOD_US
            grid = np.linspace(0, x, 400)
            u = 1 - np.clip((grid - fire) / glide, 0, 1)
            share = np.where(grid < fire, grid / fire, (u + u * u) / 2)[:, None]
            base = np.where((grid < fire)[:, None], begin_speed, end_speed)
            pose = state[:3] + np.trapezoid(base + share * (top - base), grid, axis=0) * period_s
            noise = rng.normal(0, [2e-4, 2e-4, np.deg2rad(0.2)]) if noisy else 0.0
            fixes.append((due_us, (pose + noise).astype(np.float32)))
            due_us += round(1e6 / rate_hz)
        actions.append(action)
        truth.append(end)
        state = end
    starts_us = [begin_us + period * PERIOD_US for period in range(periods)]
    return Swim(starts_us, actions, np.array(truth), fixes)


def follow(
    given: Swim, fixes: list[tuple[int, int, Pose, int]], made: CEstimator | Twin | None = None
) -> Any:
    """Errors (n, 6) at the decisions; fixes as (arrival, capture, pose, sequence)."""
    estimator = CEstimator() if made is None else made
    waiting, errors = sorted(fixes, key=lambda row: row[0]), []
    for index, start_us in enumerate(given.starts_us):
        while waiting and waiting[0][0] <= start_us:
            _, capture_us, pose, sequence = waiting.pop(0)
            estimator.add(capture_us, pose, sequence)
        if (found := estimator.at(start_us)) is not None:
            error = np.frombuffer(found[0], dtype=np.float32).astype(np.float64) - given.truth[index]
            error[2] = np.angle(np.exp(1j * error[2]))
            errors.append(error)
        estimator.act(start_us, given.actions[index])
    return np.array(errors)


def on_time(given: Swim, late_us: int = 80_000) -> list[tuple[int, int, Pose, int]]:
    return [(time_us + late_us, time_us, pose, k) for k, (time_us, pose) in enumerate(given.fixes)]


def rms(errors: Any, first: int = 3) -> npt.NDArray[np.float64]:
    """(3,) of position, heading, velocity, once the first decisions are over."""
    squares = errors[first:] ** 2
    of = [squares[:, :2].sum(axis=1), squares[:, 2], squares[:, 3:5].sum(axis=1)]
    return np.sqrt(np.mean(of, axis=1))
