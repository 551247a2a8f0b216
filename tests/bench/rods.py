"""What the rods cost (``make bench``): one lane and eight, plates, nodes, cores, states, and PyElastica.

All figures are processor time, which neighbours on the machine disturb less than the clock, except where two
processes share a job. Each is the least of several runs: nothing makes a run faster than it can be.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import platform
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tests.bench.elastica_rod import elastica_rod, frogkick_rod
from tests.der.single import simulate_action

from frogkick.der import Rods, prepare
from frogkick.effects import changed_robot, make_effect, rods_of
from frogkick.effects.acting import program_of
from frogkick.effects.swims import simulate_many
from frogkick.library import build_library
from frogkick.robot import Robot, load_robot

ROBOT = load_robot("frog2022")
WIDTHS = (1, 2, 4, 8, 16)


@dataclass(frozen=True)
class Effort:
    """How much to measure: runs of each, widths, states of the largest library."""

    runs: int
    widths: Sequence[int]
    states: Sequence[int]


FULL = Effort(7, WIDTHS, (32, 128, 512))
QUICK = Effort(1, (1, 8), (4,))


def least(runs: int, work: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Seconds of the quickest of some runs, after one that is not counted (it compiles)."""
    work()
    found = []
    for _ in range(runs):
        began = clock()
        work()
        found.append(clock() - began)
    return min(found)


def velocities(lanes: int) -> np.ndarray:
    box = ROBOT.library_box
    low, high = np.array([box.forward_mps, box.left_mps, box.omega_rad_s]).T
    return np.random.default_rng(1).uniform(low, high, size=(lanes, 3))


def per_lane_ms(rods: Rods, lanes: int, width: int, runs: int, action: str = "C") -> float:
    """Milliseconds for each lane and simulated second of one period of an action."""
    robot = rods.robot
    programs = [program_of(robot, robot.action(action))] * lanes
    start = velocities(lanes)
    seconds = least(runs, lambda: simulate_many(rods, start, programs, [robot.period_s], width=width))
    return 1e3 * seconds / lanes / robot.period_s


def refined(robot: Robot, factor: float) -> Robot:
    """The robot with more or fewer segments; their stiffness stays, being the material's."""
    frame = replace(robot.frame, segments=tuple(round(s * factor) for s in robot.frame.segments))
    limbs = tuple(replace(limb, segments=round(limb.segments * factor)) for limb in robot.limbs)
    return replace(robot, frame=frame, limbs=limbs)


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    print(f"\n{title}")
    table = [list(header), *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(header))]
    for row in table:
        print("  " + "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)))


def bench_widths(effort: Effort) -> None:
    rods = prepare(ROBOT)
    alone = least(
        effort.runs,
        lambda: simulate_action(ROBOT, velocities(1)[0].tolist(), "C", ROBOT.period_s, rods=rods),
    )
    rows: list[Sequence[object]] = [("one action alone", f"{1e3 * alone / ROBOT.period_s:.2f}", "")]
    first = 0.0
    for width in effort.widths:
        cost = per_lane_ms(rods, width, width, effort.runs)
        first = first or cost
        rows.append((f"{width} side by side", f"{cost:.2f}", f"{first / cost:.1f} x"))
    show(
        "lanes: ms of one core for each lane and simulated second, action C, 1.425 s",
        ("", "ms", "gain"),
        rows,
    )
    rows = [
        (action.name, f"{per_lane_ms(rods, 8, 8, effort.runs, action.name):.2f}") for action in ROBOT.actions
    ]
    show("actions: the same, 8 side by side", ("action", "ms"), rows)
    rows = [(lanes, f"{per_lane_ms(rods, lanes, 8, effort.runs):.2f}") for lanes in (1, 2, 4, 8, 9, 16, 64)]
    show("a batch of 8 lanes that is not full, or several of them", ("lanes", "ms"), rows)


def bench_plates(effort: Effort) -> None:
    """All actions, each from eight velocities; the robots take turns, because a machine's speed drifts."""
    robots = {
        "as it is": ROBOT,
        "limbs are plates": _with(limb_plate=1.0),
        "their tips shed": _with(limb_plate=1.0, shedding=1.0),
    }
    programs = [program_of(ROBOT, action) for action in ROBOT.actions for _ in range(8)]
    start = np.tile(velocities(8), (len(ROBOT.actions), 1))

    def swim(rods: Rods) -> float:
        began = time.process_time()
        simulate_many(rods, start, programs, [ROBOT.period_s])
        return 1e3 * (time.process_time() - began) / len(programs) / ROBOT.period_s

    every = {name: rods_of(robot) for name, robot in robots.items()}
    costs = np.array([[swim(rods) for rods in every.values()] for _ in range(effort.runs + 1)])[1:]
    ratios = np.median(costs / costs[:, :1], axis=0)
    rows = [
        (name, f"{cost:.2f}", f"{ratio:.2f}")
        for name, cost, ratio in zip(every, costs.min(axis=0), ratios, strict=True)
    ]
    show(
        "plates: ms for each lane and simulated second, nine actions, 8 side by side; median ratio of pairs",
        ("limbs", "ms", "times"),
        rows,
    )


def _with(limb_plate: float, shedding: float = 0.0) -> Robot:
    effect = make_effect({"name": "limb_plate", "added": limb_plate, "shedding": shedding}, Path())
    return changed_robot(ROBOT, [effect])


def bench_nodes(effort: Effort) -> None:
    rows: list[Sequence[object]] = []
    for factor in (0.5, 1.0, 2.0, 4.0)[: 4 if effort.runs > 1 else 2]:
        rods = prepare(refined(ROBOT, factor))
        nodes = len(rods.mesh.mass_kg)
        one, eight = (per_lane_ms(rods, width, width, effort.runs) for width in (1, 8))
        rows.append((nodes, f"{one:.2f}", f"{eight:.2f}", f"{1e3 * eight / nodes:.1f}"))
    show("nodes: ms for each lane and simulated second", ("nodes", "alone", "of 8", "us a node"), rows)


def bench_library(effort: Effort) -> None:
    rows: list[Sequence[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "lib.h5"
        for states in effort.states:
            for workers in sorted({1, min(2, os.cpu_count() or 1)}):
                wall = least(
                    1,
                    lambda s=states, w=workers: build_library(ROBOT, s, 0, w, out, record_s=0.0),
                    time.perf_counter,
                )
                lane_s = states * len(ROBOT.actions) * ROBOT.period_s
                rows.append(
                    (states, workers, f"{wall:.2f}", f"{states / wall:.0f}", f"{1e3 * wall / lane_s:.2f}")
                )
    show(
        "library: states times 9 actions, one period, by the clock (mirror images are simulated once)",
        ("states", "processes", "s", "states/s", "ms a transition-second"),
        rows,
    )


def bench_elastica(effort: Effort) -> None:
    rows: list[Sequence[object]] = []
    for width in (1, 8):
        cost, deflection = frogkick_rod(effort.runs, width)
        rows.append((f"frogkick, of {width}", f"{cost:.4f}", f"{1e3 * deflection:.3f}"))
    if importlib.util.find_spec("elastica") is None:
        print("\nPyElastica is not installed, its row is left out: make bench fetches it")
    else:
        cost, deflection = elastica_rod(min(effort.runs, 2))
        rows.append(("PyElastica", f"{cost:.4f}", f"{1e3 * deflection:.3f}"))
    show(
        "a plain rod of 128 nodes let go in vacuum: s of one core for each rod and simulated second",
        ("", "s", "deflection after 0.5 s, mm"),
        rows,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one run of the least of each")
    effort = QUICK if parser.parse_args(arguments).quick else FULL
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores; the least of {effort.runs}")
    bench_widths(effort)
    bench_plates(effort)
    bench_nodes(effort)
    bench_library(effort)
    bench_elastica(effort)


if __name__ == "__main__":
    main()
