"""The estimator: C against its Python twin bit for bit, and against the theory of least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from tests.core.core import FFI, STATUS, cases, core, library, mutated

from frogkick.planner.estimator import FUTURE_US, STALE_US, WINDOW_US, Estimator


class CEstimator:
    """The estimator in C, with the twin's two methods."""

    def __init__(self, made: Any = None) -> None:
        self._core = core() if made is None else made
        self._memory = FFI.new("uint64_t[]", (self._core.fk_test_estimator_bytes() + 7) // 8)
        self._core.fk_estimator_init(self._memory)
        self._state, self._numbers = np.zeros(6, dtype=np.float32), FFI.new("uint32_t[2]")

    def add(self, capture_us: int, pose: npt.NDArray[np.float32], sequence: int) -> bool:
        status = self._core.fk_test_estimator_add(
            self._memory, capture_us, FFI.from_buffer("float[]", pose), sequence
        )
        assert status in (0, STATUS["RANGE"])
        return bool(status == 0)

    def at(self, at_us: int) -> tuple[bytes, int, int] | None:
        state = FFI.from_buffer("float[]", self._state, require_writable=True)
        status = self._core.fk_test_estimator_at(self._memory, at_us, state, self._numbers)
        assert status in (0, STATUS["STALE"])
        return None if status else (self._state.tobytes(), self._numbers[0], self._numbers[1])


class Twin:
    """The Python estimator, its answers as bytes."""

    def __init__(self) -> None:
        self._twin = Estimator()

    def add(self, capture_us: int, pose: npt.NDArray[np.float32], sequence: int) -> bool:
        return self._twin.add(capture_us, pose, sequence)

    def at(self, at_us: int) -> tuple[bytes, int, int] | None:
        found = self._twin.at(at_us)
        return None if found is None else (found.state.tobytes(), found.fix_sequence, found.fixes)


WILD = np.array(
    [np.nan, np.inf, -np.inf, 1000.0, -1000.0, 1000.0001, -1e30, 0.0, -0.0, 1e-40, 3.1415927, -3.1415927],
    dtype=np.float32,
)


def answers(seed: int, estimator: CEstimator | Twin) -> list[object]:
    """Everything an estimator says to one random sequence of fixes and questions."""
    rng = np.random.default_rng(seed)
    said: list[object] = []
    time_us = int(rng.choice([0, 1, 10**6, 2**32 - 200_000, 2**53, 2**62]))
    step_us = 1e6 / rng.uniform(2.0, 60.0)
    pose = np.array([*rng.uniform(-2, 2, 2), rng.choice([0.0, 3.0, -3.1, rng.uniform(-20, 20)])])
    speed = np.array([*rng.normal(0, 0.05, 2), rng.normal(0, 0.5)])
    if rng.random() < 0.05:
        pose[:2] = rng.uniform(-999, 999, 2)
    last_us = time_us
    for sequence in range(int(rng.integers(1, 13))):
        kind = rng.random()
        capture_us = time_us
        if kind < 0.05:  # late, out of order, or the same again
            capture_us = max(0, time_us - int(rng.choice([step_us, 2 * step_us, step_us + 1, 1])))
        elif kind < 0.10:  # a gap since the fix before
            time_us = last_us + int(rng.choice([WINDOW_US - 1, WINDOW_US, WINDOW_US + 1, 600_000, 3_000_000]))
            capture_us = time_us
        fix = (pose + rng.normal(0, [2e-4, 2e-4, 3e-3])).astype(np.float32)
        if rng.random() < 0.08:
            fix[int(rng.integers(3))] = rng.choice(WILD)
        said.append(estimator.add(capture_us, fix, sequence))
        last_us = capture_us
        if rng.random() < 0.4:
            lead_us = int(
                rng.choice(
                    [0, 70_000, 80_000, 1, -1, STALE_US, STALE_US + 1, -FUTURE_US, -FUTURE_US - 1, 10**7,
                     int(rng.integers(-120_000, 520_000))]
                )
            )  # fmt: skip
            said.append(estimator.at(max(0, capture_us + lead_us)))
        moved_us = max(1, round(step_us * rng.choice([1.0, 1.0, rng.uniform(0.5, 1.5)])))
        if rng.random() < 0.01:
            moved_us = int(rng.integers(1, 4))  # two pictures at almost one time: huge velocities
        time_us += moved_us
        pose = pose + speed * moved_us * 1e-6
    return [*said, estimator.at(time_us)]


def test_the_twin_gives_the_same_bits() -> None:
    estimates = none = 0
    for seed in range(cases(20_000, 400_000)):
        ours, theirs = answers(seed, CEstimator()), answers(seed, Twin())
        assert ours == theirs, f"replay with answers({seed}, CEstimator()), answers({seed}, Twin())"
        estimates += sum(isinstance(said, tuple) for said in ours)
        none += sum(said is None for said in ours)
    assert min(estimates, none) > cases(20_000, 400_000) // 4, "some kind of answer hardly occurred"


MUTATIONS = {
    "order of the sum": ("for (uint32_t i = 0u; i < used; ++i) {\n        t_sum",
                         "for (uint32_t i = used; i-- > 0u;) {\n        t_sum"),
    "order of the products": ("dt = t_s[i] - t_mean;", "dt = t_s[used - 1u - i] - t_mean;"),
    "association": ("newest->x_m + (x_mean + vx_mps * lead_s)", "(newest->x_m + x_mean) + vx_mps * lead_s"),
    "heading not wrapped": ("dh_rad[used] = fk_wrap_angle(fix->heading_rad - newest->heading_rad)",
                            "dh_rad[used] = fix->heading_rad - newest->heading_rad"),
    "window": ("age_us <= FK_FIX_WINDOW_US", "age_us < FK_FIX_WINDOW_US"),
    "stale": ("lead_us > FK_FIX_STALE_US", "lead_us >= FK_FIX_STALE_US"),
    "future": ("lead_us < -FK_FIX_FUTURE_US", "lead_us <= -FK_FIX_FUTURE_US"),
    "duplicates": ("fix->capture_us <= estimator", "fix->capture_us < estimator"),
    "field": ("value >= -limit && value <= limit", "value > -limit && value < limit"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_changed_estimator_is_not_the_twin(name: str) -> None:
    changed = library(mutated("fk_estimator.c", *MUTATIONS[name]))
    for seed in range(4000):
        if answers(seed, CEstimator(changed)) != answers(seed, Twin()):
            return
    pytest.fail(f"an estimator with another {name} gave the twin's bits 4000 times")


@pytest.mark.parametrize("rate_hz", [5, 15, 30])
@pytest.mark.parametrize("lead_s", [0.0, 0.08, 0.4])
def test_on_a_straight_swim_the_error_is_that_of_least_squares(rate_hz: int, lead_s: float) -> None:
    """Variance of a line's value at t: sigma^2 (1/n + (t - mean)^2 / sum (t_i - mean)^2); unbiased."""
    sigma = np.array([2e-4, 2e-4, 3.5e-3])
    velocity = np.array([0.03, -0.01, 0.2])
    steps = int(WINDOW_US * 1e-6 * rate_hz)
    times_us = np.array([1_000_000 + round(k * 1e6 / rate_hz) for k in range(8)])
    inside = times_us[times_us >= times_us[-1] - WINDOW_US]
    assert len(inside) == steps + 1
    t = (inside - inside[-1]) * 1e-6
    spread = ((t - t.mean()) ** 2).sum()
    expected = sigma * np.sqrt(1 / len(t) + (lead_s - t.mean()) ** 2 / spread)
    expected_velocity = sigma / np.sqrt(spread)
    rng = np.random.default_rng(3)
    errors, velocity_errors = [], []
    for _ in range(cases(3000, 30_000)):
        start = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-4, 4)])
        estimator = CEstimator()
        for index, time_us in enumerate(times_us):
            pose = start + velocity * (time_us - times_us[0]) * 1e-6 + sigma * rng.standard_normal(3)
            assert estimator.add(int(time_us), pose.astype(np.float32), index)
        at_us = int(times_us[-1]) + round(lead_s * 1e6)
        found = estimator.at(at_us)
        assert found is not None and found[1:] == (7, len(t))
        state = np.frombuffer(found[0], dtype=np.float32).astype(np.float64)
        error = state[:3] - (start + velocity * (at_us - times_us[0]) * 1e-6)
        error[2] = np.angle(np.exp(1j * error[2]))
        errors.append(error)
        turn = np.exp(1j * state[2]) * complex(state[3], state[4])  # back into the world frame
        velocity_errors.append(np.array([turn.real, turn.imag, state[5]]) - velocity)
    if len(errors) < 1000:
        return  # gcov's short run counts lines, it does not measure
    for name, found_errors, sd in (
        ("pose", np.array(errors), expected),
        ("velocity", np.array(velocity_errors), expected_velocity),
    ):
        n = len(found_errors)
        # Five standard errors of a mean and of a standard deviation.
        assert (np.abs(found_errors.mean(axis=0)) < 5 * sd / np.sqrt(n) + 1e-6).all(), name
        assert (np.abs(found_errors.std(axis=0) / sd - 1) < 5 / np.sqrt(2 * n)).all(), name


def test_one_fix_knows_no_velocity_and_eight_are_kept() -> None:
    estimator = CEstimator()
    assert estimator.at(0) is None
    assert estimator.add(1000, np.array([1, 2, 7], dtype=np.float32), 65_535)
    found = estimator.at(1000 + STALE_US)
    assert found is not None and found[1:] == (65_535, 1)
    state = np.frombuffer(found[0], dtype=np.float32)
    assert state[:2].tolist() == [1.0, 2.0] and not state[3:].any()
    assert state[2] == pytest.approx(7 - 2 * np.pi, abs=1e-6)
    for index in range(20):
        assert estimator.add(2000 + index, np.array([1, 2, 3], dtype=np.float32), index)
    found = estimator.at(2000)
    assert found is not None and found[1:] == (19, 8)


def test_across_pi_the_heading_turns_the_short_way() -> None:
    estimator = CEstimator()
    for index, heading in enumerate([3.10, 3.13, -3.1231853, -3.0931853]):
        assert estimator.add(1_000_000 + index * 50_000, np.array([0, 0, heading], dtype=np.float32), index)
    found = estimator.at(1_150_000)
    assert found is not None
    state = np.frombuffer(found[0], dtype=np.float32)
    assert state[2] == pytest.approx(-3.0931853, abs=1e-5)
    assert state[5] == pytest.approx(0.6, abs=1e-4)
