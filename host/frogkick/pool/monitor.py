"""Checks pulses at the pins against the robot's limits, independently of the C guard."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from frogkick.link.wire import Edge
from frogkick.robot import Robot

# Edges have the resolution of a 1 MHz timer, and a duty sum adds several of them.
_TOLERANCE_S = 2e-5


@dataclass(frozen=True)
class Pulse:
    """A pulse of a limb, in pool time."""

    limb: int
    start_s: float
    end_s: float


def pulses_of(edges: Sequence[Edge], until_s: float) -> list[Pulse]:
    """The pulses of pin edges; a pulse that is on at ``until_s`` ends there."""
    on: dict[int, float] = {}
    pulses = []
    for edge in sorted(edges, key=lambda e: e.time_s):
        if edge.level and edge.limb not in on:
            on[edge.limb] = edge.time_s
        elif not edge.level and edge.limb in on:
            pulses.append(Pulse(edge.limb, on.pop(edge.limb), edge.time_s))
    return pulses + [Pulse(limb, start_s, until_s) for limb, start_s in on.items()]


def violations(robot: Robot, pulses: Sequence[Pulse]) -> list[str]:
    """The violated limits of a robot's guard, one line each, for all pulses at the pins in any order."""
    guard = robot.guard
    found = [
        f"limb {pulse.limb} on, which the robot does not have"
        for pulse in pulses
        if pulse.limb >= len(robot.limbs)
    ]
    longest_s = _TOLERANCE_S + max((pulse.end_s - pulse.start_s for pulse in pulses), default=0.0)
    for limb in range(len(robot.limbs)):
        mine = sorted((p for p in pulses if p.limb == limb), key=lambda pulse: pulse.start_s)
        starts_s = [pulse.start_s for pulse in mine]
        name = robot.limbs[limb].name
        for index, pulse in enumerate(mine):
            length_s = pulse.end_s - pulse.start_s
            if length_s > guard.pulse_max_s + _TOLERANCE_S:
                found.append(f"{name} on for {length_s:.4f} s at {pulse.start_s:.3f} s")
            if index and pulse.start_s - mine[index - 1].end_s < guard.rest_min_s - _TOLERANCE_S:
                found.append(f"{name} rested {pulse.start_s - mine[index - 1].end_s:.4f} s")
            window_start_s = pulse.end_s - guard.duty_window_s
            first = bisect_left(starts_s, window_start_s - longest_s)
            lately = mine[first : bisect_left(starts_s, pulse.end_s)]
            on_s = sum(max(0.0, min(p.end_s, pulse.end_s) - max(p.start_s, window_start_s)) for p in lately)
            if on_s > guard.duty_max * guard.duty_window_s + _TOLERANCE_S:
                found.append(f"{name} on for {on_s:.4f} s within {guard.duty_window_s} s")
    every = sorted(pulses, key=lambda pulse: pulse.start_s)
    starts_s = [pulse.start_s for pulse in every]
    for pulse in pulses:
        # The largest number of limbs is on just after a start.
        at_s = pulse.start_s + _TOLERANCE_S
        begun = every[bisect_left(starts_s, at_s - longest_s) : bisect_right(starts_s, at_s)]
        together = len({p.limb for p in begun if at_s < p.end_s})
        if together > guard.limbs_at_once_max:
            found.append(f"{together} limbs on at {pulse.start_s:.3f} s")
    return found
