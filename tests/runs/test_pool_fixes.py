"""A simulated pool in which a robot swims by the strokes that a kit reports."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from tests.runs import rig

from frogkick.core.poses import Fix
from frogkick.effects import World, read_world
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.pool.pool import Camera, Pool
from frogkick.runs.closed_loop import run_session
from frogkick.runs.decision import RESTING, Decision, RobotEvent
from frogkick.runs.pool_fixes import HELD_UP_S, LAG_S, PoolFixes
from frogkick.runs.record import Recording, RunOptions
from frogkick.runs.session import Session

START = (0.2, -0.1, 0.4)
OFFSET_US = 7_000_000
"""The kit was switched on so long before the session."""


class Clock:
    now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def begun(world: World = World()) -> tuple[PoolFixes, Clock]:  # noqa: B008 - frozen
    clock, rng = Clock(), np.random.default_rng(1)
    return PoolFixes(rig.robot(), rig.tables(), START, rng, world=world, clock=clock), clock


def live(source: PoolFixes, clock: Clock, for_s: float, step_s: float = 0.02) -> list[Fix]:
    """Let time pass. Session time is the clock's time less 950 s."""
    fixes: list[Fix] = []
    for _ in range(round(for_s / step_s)):
        clock.now_s += step_s
        fixes += source.advance(clock.now_s - 950.0)
    return fixes


@pytest.fixture(scope="module")
def decided() -> Decision:
    """A decision that fires limbs of both groups."""
    recording = rig.swim("pool", "line", 6.0)
    index = next(k for k, row in enumerate(rig.tables().actions) if row.first_mask and row.second_mask)
    return dataclasses.replace(recording.decisions[-1], status=0, action=index, plan_us=4_000)


def recording_of(decision: Decision, at_s: float, refused: bool = False, onboard: bool = True) -> Recording:
    """A recording whose robot decided at a session time."""
    scheduled_us = round(at_s * 1e6) + (OFFSET_US if onboard else 0)
    recording = rig.recording(shape("line"), RunOptions(PlanConfig(), onboard))
    recording.clock_offset_us = OFFSET_US
    recording.decisions.append(dataclasses.replace(decision, scheduled_us=scheduled_us))
    if refused:
        recording.events.append(RobotEvent(round(at_s * 1e6) + OFFSET_US, action=RESTING))
    return recording


def test_fixes_are_of_the_start_and_as_late_as_the_pool_is_behind() -> None:
    source, clock = begun()
    fixes = live(source, clock, 2.0)
    assert len(fixes) == pytest.approx(15.0 * (2.0 - LAG_S), abs=1.0)
    for fix in fixes:
        assert fix.pose_world == pytest.approx(START, abs=0.02)
        assert LAG_S - 1e-9 <= fix.arrival_s - fix.capture_s <= LAG_S + 0.02 + 1e-9
    assert np.diff([fix.capture_s for fix in fixes]) == pytest.approx(1.0 / 15.0, abs=1e-9)
    assert 0.0 < source.next_event_s - (clock.now_s - 950.0) < 1.0 / 15.0


@pytest.mark.parametrize("onboard", [True, False], ids=["onboard", "host"])
def test_a_stroke_begins_when_the_robot_began_it(decided: Decision, onboard: bool) -> None:
    """Reported 60 ms late, within the pool's lag, it has the effect of one that was known beforehand."""
    source, clock = begun()
    live(source, clock, 1.0)
    at_s = clock.now_s - 950.0
    live(source, clock, 0.06)
    source.follow(recording_of(decided, at_s, onboard=onboard))
    live(source, clock, 1.4)
    assert source.late == 0
    beside = Pool(rig.robot(), START, Camera(delay_s=0.0), np.random.default_rng(1))
    row, begin_s = rig.tables().actions[decided.action], at_s - 50.0 + 4e-3
    for mask, delay_s in ((row.first_mask, 0.0), (row.second_mask, rig.tables().second_delay_us * 1e-6)):
        beside.advance(begin_s + delay_s)
        for limb in range(4):
            if mask >> limb & 1:
                beside.actuate(limb, begin_s + delay_s)
    beside.advance(source.pool.time_s)
    ours, theirs = source.pool.state()[0], beside.state()[0]
    assert np.hypot(*(ours - START)[:2]) > 5e-3, "it swam"
    assert ours == pytest.approx(theirs, abs=1e-4)


def test_what_is_true_in_the_pool_besides_acts_on_it(decided: Decision, tmp_path: Path) -> None:
    (tmp_path / "worn.toml").write_text(
        "".join(
            f'[[effect]]\nname = "limb_wear"\nlimb = "{limb.name}"\ngain = 0.5\n'
            for limb in rig.robot().limbs
        )
    )
    swum = []
    for world in (World(), read_world(tmp_path / "worn.toml")):
        source, clock = begun(world)
        live(source, clock, 1.0)
        source.follow(recording_of(decided, clock.now_s - 950.0))
        live(source, clock, 1.4)
        swum.append(np.hypot(*(source.pool.state()[0] - START)[:2]))
    assert swum[1] < 0.8 * swum[0]


def test_a_stroke_that_the_guard_refused_moves_nothing(decided: Decision) -> None:
    source, clock = begun()
    live(source, clock, 1.0)
    source.follow(recording_of(decided, clock.now_s - 950.0, refused=True))
    live(source, clock, 1.4)
    assert source.pool.state()[0] == pytest.approx(START, abs=1e-6)


def test_a_stroke_that_is_told_too_late_begins_late_and_is_counted(decided: Decision) -> None:
    source, clock = begun()
    live(source, clock, 1.0)
    source.follow(recording_of(decided, clock.now_s - 950.0 - 0.5))
    live(source, clock, 1.4)
    row = rig.tables().actions[decided.action]
    assert source.late == (row.first_mask | row.second_mask).bit_count()
    assert np.hypot(*(source.pool.state()[0] - START)[:2]) > 5e-3


def test_time_in_which_nobody_asks_does_not_pass_in_the_pool() -> None:
    source, clock = begun()
    live(source, clock, 0.5)
    before_s = source.pool.time_s
    clock.now_s += 60.0 * HELD_UP_S
    fixes = live(source, clock, 0.5)
    assert source.pool.time_s == pytest.approx(before_s + 0.5, abs=0.03)
    assert all(fix.arrival_s - fix.capture_s < 2 * LAG_S for fix in fixes)


def test_it_swims_a_path_as_the_pool_does_whose_pins_are_seen() -> None:
    """The core in simulated time, once with its pins seen, once by its reports."""
    seen = rig.swim("pool", "line", 12.0, depth=2)

    class ByWord(PoolFixes):
        """Its clock is the session's; strokes come from the recording alone."""

        def advance(self, until_s: float) -> list[Fix]:
            clock.now_s = 1000.0 + until_s
            return super().advance(until_s)

    path, clock = shape("line"), Clock()
    start = (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0]))
    source = ByWord(rig.robot(), rig.tables(), start, np.random.default_rng(0), clock=clock)
    begun = rig.recording(path, RunOptions(PlanConfig(depth=2), True, 12.0))
    recording = run_session(Session(rig.port("pool")), source, begun, keep=source.follow)
    assert source.late == 0 and len(recording.decisions) == len(seen.decisions)
    ours, theirs = (one.fixes[-1].pose_world for one in (recording, seen))
    assert np.hypot(*(ours - theirs)[:2]) < 0.02, (ours, theirs)
    assert np.hypot(*ours[:2] - np.array(start[:2], dtype=np.float32)) > 0.1
