"""The longest that the chip computes.

Searches in which nothing is pruned, or each look-up visits every state of a table. Checks of pulses of which
as many are remembered as a robot may ask for.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.planner import synthetic

from frogkick.core.errors import InputError
from frogkick.core.files import write_bytes
from frogkick.estimator.wear import ON
from frogkick.front.plan_time import PlanBound, shape_of
from frogkick.link.layout import link_layout
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig, look_up_most_ns, on_robot, plan, transitions_of
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot, load_robot
from frogkick.runs.chip_check import ChipPlanner
from frogkick.runs.session import Session
from frogkick.tables.image import open_image
from frogkick_codegen import firmware

ROBOT = load_robot("frog2022")
ACTIONS = [(row.name, row.first_mask, row.second_mask) for row in ROBOT.actions]
CYCLES_PER_US = 64


def alike(states: int, levels: int, closer: bool = False) -> bytes:
    """Such a table with the robot's actions."""
    return synthetic.alike(states, levels, closer, action_rows=ACTIONS)


def bench(folder: Path, image: bytes, robot: Robot = ROBOT) -> Path:
    write_bytes(folder / "t.fkt", image)
    return firmware.build("bench", folder / "t.fkt", robot, folder / "out").image


@from_ci
@pytest.mark.parametrize(
    ("states", "levels", "closer"), [(2048, 8, False), (2047, 10, False), (2048, 11, False), (2048, 0, True)]
)
def test_no_look_up_takes_longer_than_the_limit_allows_for(
    states: int, levels: int, closer: bool, tmp_path: Path
) -> None:
    """Equal states; leaves of two, which cut pairs in half; of one; states each nearer than the last."""
    image = alike(states, levels, closer)
    core = ChipPlanner(built := bench(tmp_path, image))
    core.chip.ram_write(core._free, np.array([16383 if closer else 0, 0, 0], "<i4").tobytes())
    row, cycles = core.chip.call("fk_nearest", core._tables, core._free)
    assert row == (states - 1 if closer else 0)
    bound_us = PlanBound(built, tmp_path / "out" / "emitted").look_up_us(shape_of(open_image(image)))
    assert 0.8 * bound_us < cycles / CYCLES_PER_US < bound_us < 1e-3 * look_up_most_ns(states, levels)


@from_ci
@pytest.mark.parametrize(("states", "levels", "actions", "most"), [(4096, 12, 9, 300), (64, 3, 12, 12_500)])
def test_the_longest_search_ends_before_the_watchdog(
    states: int, levels: int, actions: int, most: int, tmp_path: Path
) -> None:
    """Four levels of a cost that prunes nothing, without a limit of time: it would take 10 s, or 1.0 s."""
    image = synthetic.alike(states, levels, actions=actions)
    port = VirtualRobot(bench(tmp_path, image), len(ROBOT.limbs))
    session, path = Session(port), shape("line")
    session.handshake(open_image(image))
    session.send_path(path)
    weights = {"ANGLE_WEIGHT_PER_RAD": 0.0, "PROGRESS_WEIGHT": 0.0, "LEVEL_WEIGHT": 0.0}
    session.set_parameters({**weights, "COST": 0, "TRANSITIONS_MAX": 0})
    state = {"x_m": 0.2, "y_m": 0.3, "heading_rad": 0.0, "vx_mps": 0.0, "vy_mps": 0.0, "omega_rad_s": 0.0}
    rested = {f"limb_use_{limb}": 0 for limb in range(8)}
    session.post("PLAN", {"depth": 4, **state, **rested, "along_points": 0.0})
    asked_s = session.time_s
    while not (answers := session.take("PLAN")) and not port.chip.resets:
        session.step(session.time_s + 0.01)
    assert port.chip.resets == []
    assert session.time_s - asked_s < 0.93
    assert session.request("STATUS")["reset"] == link_layout().reset["POWER"]
    # And it decides what the host does.
    config = PlanConfig(angle_weight_per_rad=0.0, progress_weight=0.0, level_weight=0.0, depth=4)
    tables = open_image(image)
    made = plan(tables, path, on_robot(config, tables), np.array(list(state.values()), np.float32))
    (answer,) = [arrival.frame.values for arrival in answers]
    names = ("action", "depth_reached", "transitions")
    assert [answer[name] for name in names] == [getattr(made, name) for name in names]
    assert 0.9 * most < made.transitions < most


def test_a_table_of_too_many_states_is_refused(tmp_path: Path) -> None:
    """Where not even the first level of a search ends in time."""
    many = alike(24_000, 12)
    assert transitions_of(open_image(many)) > len(ACTIONS)
    more = alike(32_000, 12)
    assert transitions_of(open_image(more)) < len(ACTIONS)
    expected = (
        r"^the table has 32000 states: a look-up may take the chip 35 ms, .* a table of at most 32768 states$"
    )
    with pytest.raises(InputError, match=expected):
        bench(tmp_path, more)


@from_ci
@pytest.mark.parametrize(
    ("at_once", "window_s", "masks", "limbs"), [(2, 7.499, (0b0011, 0b1100), 4), (8, 4.499, (0xFF, 0), 8)]
)
def test_the_longest_check_of_a_pulse_is_in_time(
    at_once: int, window_s: float, masks: tuple[int, int], limbs: int, tmp_path: Path
) -> None:
    """As many rests in the duty window, and limbs at once, as the build takes; it learns; its log is full."""
    guard = replace(ROBOT.guard, limbs_at_once_max=at_once, duty_window_s=window_s)
    times = {"pulse_us": 20_000, "second_delay_us": 20_000}
    wear = synthetic.wear_curves(limbs, 3, 1, 0.1)
    rows = [("A", *masks), ("R", 0, 0)]
    image = synthetic.pack(
        *synthetic.transitions(40, 2, 1), action_rows=rows, limbs=limbs, limb_wear=wear, **times
    )
    port = VirtualRobot(bench(tmp_path, image, replace(ROBOT, guard=guard)), limbs)
    session, strokes = Session(port), 400
    session.handshake(open_image(image))
    session.set_parameters({"LEARN": ON})
    session.request("ARM")
    for _ in range(strokes):
        session.step(session.time_s + 1.6)
        session.request("STROKE", {"action": 0})
    session.step(session.time_s + 1.0)
    status, fired = session.request("STATUS"), masks[0].bit_count() + masks[1].bit_count()
    assert (status["pulses_refused"], session.take("REFUSED")) == (0, [])
    assert sum(edge.level for edge in session.edges) == strokes * fired
    assert session.ask("LOG", {"offset": 0})["lost"], "records are dropped for new ones"
