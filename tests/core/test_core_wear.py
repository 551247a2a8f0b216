"""The estimate of what limbs have lost, in the core: commands of a host, and records of the log."""

from __future__ import annotations

import random
import struct
from typing import Any

import numpy as np
import pytest
from tests.core.core import STATUS, Robot, cases, image
from tests.core.estimator_rig import swim
from tests.core.log_rig import fetched, robot_with_log
from tests.core.test_core_log_replay import replayed
from tests.core.test_core_snapshot import restored, snapshot_of

from frogkick.estimator.follow import IDLE_LACKING_MAX
from frogkick.estimator.wear import HELD, OFF, ON
from frogkick.link.frames import Frame
from frogkick.link.layout import link_layout
from frogkick.runs.chip_twin import ChipTwin, SnapshotError
from frogkick.tables.image import open_image
from frogkick.tables.layout import LIMB_GONE, LOST_MAX

LEARN = link_layout().parameter["LEARN"]


def set_learn(robot: Robot, learn: int) -> str:
    return robot.status("PARAM", {"parameter": LEARN, "value": learn})


def lost_of(robot: Robot) -> list[int]:
    status = robot.ask("STATUS")
    return [int(status[f"lost_{limb}"]) for limb in range(4)]


def test_the_twin_counts_as_the_link_does() -> None:
    assert link_layout().learn == {"OFF": OFF, "ON": ON, "HELD": HELD}


def worn(seed: int, periods: int, learned: Any = None, informed: bool = True) -> Robot:
    """A robot that learns what its limbs have lost from strokes by command, and then decides.

    Args:
        seed, periods: of its strokes.
        learned: RAM that keeps the estimate over a reset; the robot starts from its content.
        informed: whether the fixes of a period have told its heading more than the prediction did.
    """
    given = swim(seed, periods, kick=0.1, name="worn", lost=[[0, 0, 0, 0], [0, 20_000, 0, 32_767]])
    robot, dice = robot_with_log(learned=learned)[0], random.Random(seed)
    fixes = [(time_us + dice.randint(1, 90_000), 0, (time_us, pose)) for time_us, pose in given.fixes]
    strokes = [(start_us, 1, action) for start_us, action in zip(given.starts_us, given.actions, strict=True)]
    robot.tick()
    robot.path()
    assert set_learn(robot, ON) == "OK"
    assert robot.status("ARM") == "OK"
    todo: list[tuple[int, int, Any]] = [*fixes, *strokes]
    for at_us, kind, what in sorted(todo, key=lambda event: event[:2]):
        robot.run_until(at_us)
        if kind == 1:
            if not informed:
                robot.memory.estimator.track.covariance[1].predicted_variance = 0.0
            assert robot.status("STROKE", {"action": what}) == "OK"
            robot.tick()
        else:
            robot.fix(*what[1].tolist(), capture_age_us=at_us - what[0])
    assert robot.start() == "OK"
    robot.tick()
    return robot


def test_nothing_is_learned_of_a_period_whose_heading_no_fix_has_told() -> None:
    assert max(lost_of(worn(1, 60))) > 10_000
    assert lost_of(worn(1, 60, informed=False)) == [0, 0, 0, 0]


@pytest.mark.parametrize("seed", range(1, 1 + cases(3, 30)))
def test_what_limbs_have_lost_is_learned_again(seed: int) -> None:
    """From the first snapshot on, and from later ones, which hold what was learned before."""
    log = fetched(worn(seed, 60))
    reported = replayed(log)
    assert reported.mismatches == []
    assert max(reported.decisions[-1].lost) > 10_000 and log.lost > 100


def test_what_was_learned_is_held_and_forgotten() -> None:
    robot = worn(1, 50)
    assert robot.status("STOP") == "OK"
    learned = lost_of(robot)
    assert learned[1] > 10_000
    assert set_learn(robot, HELD) == set_learn(robot, ON) == "OK" and lost_of(robot) == learned
    assert set_learn(robot, OFF) == "OK" and lost_of(robot) == [0, 0, 0, 0]
    assert set_learn(robot, ON) == "OK" and lost_of(robot) == [0, 0, 0, 0]


def test_a_robot_that_lacks_a_limb_gives_up_after_half_as_many_decisions() -> None:
    robot = worn(1, 60)
    assert robot.status("STOP") == set_learn(robot, HELD) == "OK"
    assert max(lost_of(robot)) >= LIMB_GONE
    assert robot.status("ARM") == robot.fix() == robot.start() == "OK"
    reported: list[Frame] = []
    while not any(frame.name == "ENDED" for frame in reported):
        robot.run_until(robot.now_us + 200_000)
        reported += robot.take_all()
        robot.fix()
    assert reported[-1].values["status"] == STATUS["STALLED"]
    assert reported[-1].values["decisions"] == IDLE_LACKING_MAX + 1
    assert replayed(fetched(robot)).mismatches == []


def test_a_snapshot_in_which_more_is_lost_than_there_is_is_refused() -> None:
    whole = snapshot_of(worn(2, 50))
    wear = ChipTwin(whole, open_image(image())).wear
    everything = struct.pack("<H", LOST_MAX)
    assert wear is not None and wear.codes[3] == LOST_MAX
    assert whole.count(everything) == 1 and restored(whole) == 0
    damaged = whole.replace(everything, struct.pack("<H", LOST_MAX + 1))
    assert restored(damaged) == -1
    with pytest.raises(SnapshotError, match="32768, at most 32767"):
        ChipTwin(damaged, open_image(image()))


def test_there_are_three_ways_to_learn() -> None:
    robot = Robot().begin("ARMED")
    for value, wanted in [(0, "OK"), (1, "OK"), (2, "OK"), (3, "VALUE"), (0.5, "VALUE"), (-1, "VALUE")]:
        assert robot.status("PARAM", {"parameter": LEARN, "value": value}) == wanted
        assert robot.ask("STATUS")["learn"] == (value if wanted == "OK" else HELD)


def test_a_wall_stands_anywhere_in_the_field() -> None:
    robot = Robot().begin("ARMED")
    for value, wanted in [(-1000, "OK"), (1000, "OK"), (-1000.1, "VALUE"), (1000.1, "VALUE")]:
        for name in ("WALL_X_MIN_M", "WALL_Y_MAX_M"):
            parameter = link_layout().parameter[name]
            assert robot.status("PARAM", {"parameter": parameter, "value": value}) == wanted


def test_a_table_without_wear_curves_is_not_learned_with() -> None:
    robot = Robot(image(limb_wear=np.zeros((4, 0, 6)))).begin("ARMED")
    assert (set_learn(robot, ON), set_learn(robot, HELD), set_learn(robot, OFF)) == ("VALUE", "VALUE", "OK")
