"""Parity scenario: a closed loop from fixes to decisions, the same bits in all builds of the core.

If the table has wear curves, the wear of the limbs is estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from frogkick.link.layout import link_layout
from frogkick.paths import Path as SwimPath
from frogkick.planner.plan import PlanConfig, plan
from frogkick.pool.chip import VirtualChip
from frogkick.pool.chip.image import Layouts
from frogkick.pool.native_robot import COLD_LIMBS, CoreCall, NativeRobot
from frogkick.runs.decision import Decision, DecisionTwin, RobotEvent
from frogkick.runs.record import SentFix
from frogkick.runs.replay import Schedule, compare, replay_on_host, replay_onboard
from frogkick.runs.runlog import PathChange
from frogkick.tables.image import Tables

FIRST_S = 2.0
_BESIDE = (0.01, -0.005, 0.05)
"""x (m), y (m) and heading (rad) by which the path that takes over for a third of the decisions is moved."""

_RATES_HZ = (2.0, 15.0, 60.0)
_WORN_SHARE = 20_000
"""Share (of 32767) that a limb loses after a third of the decisions, if the table has wear curves."""

_SILENCE_S = 1.2
"""A gap in the fixes that is longer than an estimate is valid, and shorter than the gap that ends a run."""


@dataclass(frozen=True, eq=False)
class ParityScenario:
    """A closed loop of one build of the core."""

    calls: list[CoreCall]  # each turn of the core with its outputs
    # decisions, events: of the core, for ``DecisionTwin``
    decisions: list[Decision]
    events: list[RobotEvent]


def schedule_fixes(
    tables: Tables, path: SwimPath, config: PlanConfig, decisions: int, rng: np.random.Generator
) -> Schedule:
    """Fixes of a robot on a path: late, lost, duplicate, out of order, noisy, and outliers.

    The robot moves as the table predicts, with the actions that the planner chooses for its true state, and
    restarts at the path's end. The fixes' rate changes from 2 to 60 Hz, with silences. After a third of the
    decisions a limb is worn.
    """
    period_s = tables.period_us * 1e-6
    start = np.array([path.x_m[0], path.y_m[0], path.tangent_rad[0], 0.0, 0.0, 0.0], dtype=np.float32)
    state, fixes, sequence = start, [], 0
    worn = tables.worn(np.where(np.arange(tables.limbs) == 0, _WORN_SHARE, 0))
    for index in range(-1, decisions):
        made = plan(worn if 3 * index > decisions else tables, path, config, state)
        ahead = made.predicted
        begin_s = FIRST_S + index * period_s
        times = np.arange(0.0, 1.0, 1.0 / (period_s * rng.choice(_RATES_HZ)))
        if index > 2 and rng.random() < 0.05:
            times = times[times * period_s > _SILENCE_S]
        for part in times + rng.uniform(0.0, 1e-3):
            sequence += 1
            if rng.random() < 0.1:
                continue
            turn = np.remainder(ahead[2] - state[2] + np.pi, 2.0 * np.pi) - np.pi
            pose = np.array([*(state[:2] + part * (ahead[:2] - state[:2])), state[2] + part * turn])
            pose += rng.normal(0.0, [2e-4, 2e-4, 3.5e-3])
            if rng.random() < 0.03:
                pose += rng.uniform(-1.0, 1.0, 3)
            capture_s = begin_s + float(part) * period_s
            delay_s = float(
                rng.uniform(0.02, 0.15)
                if rng.random() < 0.9
                else rng.choice([0.3, 0.6, 1.9]) * rng.uniform(0.5, 1.0)
            )
            sent_s, number = capture_s + delay_s, sequence & 0xFFFF
            fix = SentFix(capture_s, delay_s, *pose.tolist(), sent_s=sent_s, sequence=number)
            fixes += [fix] * (2 if rng.random() < 0.05 else 1)
        state = start if made.path_index + 1 >= len(path) else ahead
    fixes.sort(key=lambda fix: fix.sent_s)
    return Schedule(fixes, round(FIRST_S * 1e6), tables.period_us, decisions)


def record_scenario(
    library: Path, tables: Tables, path: SwimPath, config: PlanConfig, decisions: int, seed: int
) -> ParityScenario:
    """Let the native core decide on ``schedule_fixes``.

    Two other paths take over on the way: the path itself a little off, and the path again. ``library`` is
    made by ``firmware build --target native`` with the tables.

    Raises:
        LinkError: the core refuses or does not answer.
    """
    schedule = schedule_fixes(tables, path, config, decisions, np.random.default_rng(seed))
    beside = path.place(_BESIDE)
    then = (PathChange(decisions // 3, beside), PathChange(2 * decisions // 3, path))
    schedule = replace(schedule, then=then)
    robot = NativeRobot(library, tables.limbs, keep_calls=True)
    found, events = replay_onboard(schedule, path, tables, config, robot, learn=bool(tables.limb_wear.size))
    return ParityScenario(robot.calls, found, events)


def twin_mismatches(
    scenario: ParityScenario, tables: Tables, path: SwimPath, config: PlanConfig
) -> list[tuple[int, list[str]]]:
    """Decisions in which the host's twin differs from the scenario in any bit, with the fields."""
    twin = DecisionTwin(tables, path, config, learn=bool(tables.limb_wear.size))
    decided = replay_on_host(scenario.events, twin)
    return compare(scenario.decisions, decided)


def call_mismatches(scenario: ParityScenario, others: Sequence[CoreCall]) -> list[int]:
    """Turns of the core in which another build had different outputs or sent different bytes."""
    pairs = zip(scenario.calls, others, strict=True)
    return [index for index, (first, second) in enumerate(pairs) if first != second]


def live_natively(library: Path, tables: Tables, calls: Sequence[CoreCall]) -> list[CoreCall]:
    """The same turns in another native build of the core."""
    robot = NativeRobot(library, tables.limbs)
    return [robot.turn(call.now_us, call.frame) for call in calls]


def live_on_chip(elf: Path, calls: Sequence[CoreCall]) -> list[CoreCall]:
    """The same turns in the core of a bench image, called on the virtual chip.

    Raises:
        ChipError: the image does what the chip does not allow.
    """
    chip = VirtualChip(elf)
    while not chip.sleeping:
        chip.run_until(chip.time_us + 100_000.0)
    types = Layouts(elf)
    robot, place = chip.symbol("robot"), chip.symbol("fk_bss_end") + 7 & ~7
    outputs = np.dtype(types["fk_outputs_t"])
    frame_at, stream_at, kept_at = place + 64, place + 64 + 1024, place + 64 + 2048
    table = [chip.flash.word(chip.symbol(f"fk_table_image{end}")) for end in ("", "_bytes")]
    chip.call("fk_robot_init", robot, *table)
    chip.ram_write(kept_at, COLD_LIMBS)  # as a native robot begins
    chip.call("fk_robot_note_reset", robot, link_layout().reset["POWER"], kept_at)
    found = []
    for call in calls:
        # A 64-bit argument begins on an even register: r2 for tick, the stack for on_frame.
        low, high = call.now_us & 0xFFFF_FFFF, call.now_us >> 32
        if call.frame:
            chip.ram_write(frame_at, call.frame)
            chip.call("fk_robot_on_frame", robot, frame_at, len(call.frame), 0, low, high)
        chip.call("fk_robot_tick", robot, 0, low, high, place)
        out = np.frombuffer(chip.ram_read(place, outputs.itemsize), dtype=outputs)[0]
        stream = b""
        while count := chip.call("fk_robot_take_tx", robot, stream_at, 1024)[0]:
            stream += chip.ram_read(stream_at, count)
        mask, off = int(out["limb_mask"]), int(out["all_off"])
        values = (mask, off, int(out["pulse_us"]), int(out["next_tick_us"]))
        found.append(CoreCall(call.now_us, call.frame, values, stream))
    return found
