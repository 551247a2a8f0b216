"""24 hours of one robot's life in closed loop; some minutes of it in make test."""

from __future__ import annotations

import numpy as np
from tests.conftest import count
from tests.soak import rig
from tests.soak.harness import CAMERA, KINDS, Life, Plan
from tests.soak.watch import BACK_S, NEAR_M, RUN_S

MINUTES = (30, 24 * 60)
_CALM_S = 130.0
_NATURAL_S = 4500.0  # longer than 2**32 us


def plan_of(minutes: int) -> Plan:
    """Where there is the time for it, the clock comes to a wrap of its own at the end."""
    end_s = 60.0 * minutes
    if minutes < 200:
        return Plan(gap_s=40.0, first=("long off",), calm_s=end_s - _CALM_S)
    return Plan(first=("long off",), calm_s=end_s - _CALM_S, resets_until_s=end_s - _NATURAL_S)


def told(values: list[float]) -> str:
    return f"{np.mean(values):.1f}, at most {max(values):.1f}"


def test_a_robot_comes_through_its_life() -> None:
    minutes = count(*MINUTES)
    life = Life(rig.library(), rig.robot(), rig.tables(), plan_of(minutes), seed=1, truth=rig.truth())
    size = life.robot.ram_bytes()
    life.live(60.0 * minutes)
    figures, total, seen = life.watch.figures, life.robot.total, life.robot.counts
    print(f"{minutes} simulated minutes ({MINUTES[0]} in make test, {MINUTES[1]} in make test-full)")
    print(f"disturbances {figures.disturbances}, {life.robot.lives} lives, wraps {dict(life.robot.wraps)}")
    off_mm = 1e3 * figures.distance_sum_m / figures.distances
    print(f"running again after {told(figures.running_s)} s ({RUN_S:g})")
    print(f"on the route after {told(figures.back_s)} s ({BACK_S:g})")
    print(f"there {off_mm:.1f} mm off it, {1e3 * figures.worst_mean_m:.1f} at worst ({1e3 * NEAR_M:g})")
    print(f"{figures.advanced_m:.1f} m, {dict(seen)}, host {dict(life.counts)}, frames {dict(total)}")
    print(f"grown by (objects, bytes) {life.watch.grown}; RAM of the core {size} bytes throughout")
    assert life.faults == []
    assert life.time_s >= 60.0 * minutes
    assert life.robot.ram_bytes() == size
    # It was as bad as it was meant to be.
    rounds = min(figures.disturbances.get(kind, 0) for kind in KINDS)
    assert rounds >= (1 if minutes < 200 else 24), figures.disturbances
    assert life.robot.wraps["us"] >= (1 if minutes < 200 else 20)
    assert life.robot.lives >= 4 * rounds
    lost = 1.0 - life.counts["fixes"] / (CAMERA.rate_hz * life.time_s)
    assert 0.27 < lost < 0.33
    radio = life.radio
    assert min(radio.lost, radio.doubled, radio.held, radio.damaged) > 5 * minutes
    assert total["again"] > 10 * minutes and total["bad"] > radio.damaged // 2
    assert life.counts["updates"] >= 2 * rounds and life.counts["updates resumed"] >= rounds // 4
    assert 0 < total["committed"] <= total["begun"]
    # And it swam.
    assert figures.pulses > 60 * minutes and seen["pulses in a run"] > 0.98 * figures.pulses
    assert figures.advanced_m > minutes
    assert len(figures.back_s) > 0.4 * sum(figures.disturbances.values())
