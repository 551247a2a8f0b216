"""24 hours of one robot's life in closed loop; some minutes of it in make test."""

from __future__ import annotations

import numpy as np
import pytest
from tests.conftest import count, from_ci
from tests.soak import rig
from tests.soak.harness import CAMERA, KINDS, Life, Plan
from tests.soak.route import Route
from tests.soak.watch import BACK_S, NEAR_M, RUN_S, Figures, Watch
from tests.soak.witness import SeenRobot

MINUTES = (30, 24 * 60)
_CALM_S = 130.0
_NATURAL_S = 4500.0  # longer than 2**32 us


def plan_of(minutes: int) -> Plan:
    """Where there is the time for it, the clock comes to a wrap of its own at the end."""
    end_s = 60.0 * minutes
    if minutes < 200:
        return Plan(gap_s=40.0, first=("long off",), calm_s=end_s - _CALM_S)
    return Plan(first=("long off",), calm_s=end_s - _CALM_S, resets_until_s=end_s - _NATURAL_S)


class OneLife(SeenRobot):
    """Nothing ends its life in 24 hours."""

    rows = 1_000_000


def undisturbed(minutes: int) -> Figures:
    """A life by the same camera and radio, that nothing disturbs."""
    plan = Plan(begin_s=float("inf"))
    life = Life(rig.library(), rig.robot(), rig.tables(), plan, 1, rig.truth(), made=OneLife)
    life.live(60.0 * minutes)
    assert life.faults == []
    assert life.robot.lives == 1 and life.watch.figures.disturbances == {}
    return life.watch.figures


def mean_and_most(values: list[float]) -> str:
    return f"{np.mean(values):.1f}, at most {max(values):.1f}"


@pytest.mark.parametrize(
    ("off_s", "found"), [((), False), ((60, 80), False), ((60, 140), True), ((0, 70), True), ((0, 30), False)]
)
def test_a_robot_that_stays_beside_its_route_is_found(off_s: tuple[int, ...], found: bool) -> None:
    route = Route()
    watch = Watch(rig.robot(), route, 0.0)
    watch.disturb("noise", 0.0)
    for time_s in range(1, 200):
        watch.decided(float(time_s))
        at = route.points_m[time_s * 8 % len(route.points_m)]
        is_off = bool(off_s) and off_s[0] <= time_s < off_s[1]
        watch.place(float(time_s), at * (1.0 + 0.06 / np.hypot(*at)) if is_off else at)
    assert bool(watch.faults) is found, watch.faults
    if off_s and off_s[0] > 0:
        assert 0.05 < watch.figures.worst_mean_m < 0.06


@from_ci
def test_a_robot_comes_through_its_life() -> None:
    minutes = count(*MINUTES, 20)
    life = Life(rig.library(), rig.robot(), rig.tables(), plan_of(minutes), seed=1, truth=rig.truth())
    size = life.robot.ram_bytes()
    life.live(60.0 * minutes)
    figures, total, seen = life.watch.figures, life.robot.total, life.robot.counts
    print(f"{minutes} simulated minutes")
    print(f"disturbances {figures.disturbances}, {life.robot.lives} lives, wraps {dict(life.robot.wraps)}")
    off_mm = 1e3 * figures.distance_sum_m / figures.distances
    print(f"running again after {mean_and_most(figures.running_s)} s ({RUN_S:g})")
    print(f"on the route after {mean_and_most(figures.back_s)} s ({BACK_S:g})")
    calm = undisturbed(minutes)
    calm_mm = 1e3 * calm.distance_sum_m / calm.distances
    worst_m = max(NEAR_M, calm.worst_mean_m)
    print(f"there {off_mm:.1f} mm off it, {1e3 * figures.worst_mean_m:.1f} at worst ({1e3 * worst_m:.1f})")
    print(f"undisturbed {calm_mm:.1f} mm off it, {1e3 * calm.worst_mean_m:.1f} at worst")
    print(f"{figures.advanced_m:.1f} m, {dict(seen)}, host {dict(life.counts)}, frames {dict(total)}")
    print(f"grown by (objects, bytes) {life.watch.grown}; RAM of the core {size} bytes throughout")
    assert life.faults == []
    assert life.time_s >= 60.0 * minutes
    # Once it is back it follows the route as if nothing had ever been.
    assert figures.worst_mean_m < worst_m
    assert figures.distance_sum_m / figures.distances < 1.15 * calm.distance_sum_m / calm.distances
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
