"""The monitor sees each broken limit, and nothing where all are kept."""

from __future__ import annotations

import pytest

from frogkick.link.wire import Edge
from frogkick.pool.monitor import Pulse, pulses_of, violations
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")


def train(limb: int, starts_s: list[float], length_s: float = 0.08) -> list[Pulse]:
    return [Pulse(limb, start_s, start_s + length_s) for start_s in starts_s]


@pytest.mark.parametrize(
    "pulses",
    [
        [],
        train(0, [0.0, 0.581, 1.162], 0.08),
        train(0, [0.0], 0.1),
        train(0, [0.0]) + train(1, [0.0]) + train(2, [0.08]) + train(3, [0.08]),
        train(0, [0.0, 0.6, 1.2, 1.8, 5.0, 5.6], 0.1),
    ],
)
def test_within_all_limits(pulses: list[Pulse]) -> None:
    assert violations(ROBOT, pulses) == []


@pytest.mark.parametrize(
    ("pulses", "words"),
    [
        (train(0, [0.0], 0.1001), "front_right on for 0.1001 s at 0.000 s"),
        (train(1, [0.0, 0.5]), "front_left rested 0.4200 s"),
        (train(1, [0.5, 0.0]), "front_left rested 0.4200 s"),
        (train(3, [0.0, 0.05]), "rear_right rested"),
        (train(2, [0.0, 0.6, 1.2, 1.8, 2.4], 0.1), "rear_left on for 0.5000 s within 5.0 s"),
        (train(2, [0.0, 0.6, 1.2, 1.8, 4.95], 0.1), "rear_left on for 0.4500 s within 5.0 s"),
        (train(0, [0.0]) + train(1, [0.04]) + train(2, [0.07]), "3 limbs on at 0.070 s"),
        (train(4, [0.0]), "limb 4 on, which the robot does not have"),
    ],
)
def test_each_broken_limit_is_named(pulses: list[Pulse], words: str) -> None:
    found = violations(ROBOT, pulses)
    assert any(words in line for line in found), found


def test_pulses_of_edges() -> None:
    edges = [Edge(1.0, 0, True), Edge(1.2, 1, True), Edge(1.1, 0, False), Edge(0.5, 2, False)]
    assert pulses_of(edges, 2.0) == [Pulse(0, 1.0, 1.1), Pulse(1, 1.2, 2.0)]
    assert pulses_of([], 1.0) == []
